"""The closing sentence about a spectrum says what is sure, and never more than its keys do."""

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from matplotlib.text import Text

import lunarsci
from lunarsci.errors import ParameterError
from lunarsci.minerals import MINERALS
from lunarsci.spectra.jobs.verdicts import bands_verdict, fit_verdict, fits_counted, shares_counted, shares_verdict
from lunarsci.spectra.mgm.assemblages import standing, verdict
from lunarsci.spectra.mgm.batch import batch_of
from lunarsci.spectra.mgm.columns import rows_one_by_one

GRID = np.arange(500.0, 2450.0, 10.0)


def made_up(seed: int = 0, **centers: float) -> tuple[np.ndarray, np.ndarray]:
    """MADE UP: bands of a pyroxene as Gaussians in ln R, with 0.2 % noise."""
    one, two = centers.get("one", 915.0), centers.get("two", 1850.0)
    ln = -1.6 - 0.35 * np.exp(-0.5 * ((GRID - one) / 75) ** 2) - 0.25 * np.exp(-0.5 * ((GRID - two) / 240) ** 2)
    return GRID, np.exp(ln + 0.002 * np.random.default_rng(seed).standard_normal(GRID.size))


@pytest.fixture(scope="module")
def fitted() -> dict[str, Any]:
    return lunarsci.fit(made_up(), assemblage="OPX-CPX", starts=2).to_dict()["spectra"][0]


def test_an_assumed_assemblage_is_said_to_be_one(fitted: dict[str, Any]) -> None:
    said = fit_verdict(fitted)
    assert "OPX-CPX was assumed" in said and "--assemblage auto" in said and "bands of orthopyroxene" in said


def test_an_assumed_mineral_without_one_of_its_bands_may_be_absent() -> None:
    """A pyroxene has two bands: where one is not there, no composition is told of it."""
    [record] = lunarsci.fit(made_up(), assemblage="OL-OPX-CPX", starts=2).to_dict()["spectra"]
    said = fit_verdict(record)
    assert "all bands of orthopyroxene; none of olivine, clinopyroxene" in said and "Fs of orthopyroxene" in said
    for band in record["bands"]:
        band["strength"] *= band["name"] != "OPX 1"
    said = fit_verdict(record)
    assert "some bands, not all, of orthopyroxene: may be absent" in said and "no composition is determined" in said


def chosen(**probabilities: float) -> dict[str, Any]:
    """What was made of assemblages of these probabilities, `_` for `-`."""
    found = {key.replace("_", "-"): chance for key, chance in probabilities.items()}
    rows = [{"assemblage": key, "probability": chance} for key, chance in found.items()]
    return {"candidates": rows, "strong": False, "status": verdict(found)}


def test_only_what_is_sure_is_called_so(fitted: dict[str, Any]) -> None:
    said = fit_verdict(fitted | {"choice": chosen(CPX=0.61, OL_CPX=0.26, CPX_PLG=0.11, OL_OPX=0.02)})
    assert said.startswith("a pyroxene is sure, which one is open (orthopyroxene 2 %, clinopyroxene 98 %)")
    assert "; open: olivine 28 %, plagioclase 11 %;" in said
    assert "not needed" not in said
    olivine = fit_verdict(fitted | {"choice": chosen(OL_OPX_CPX=0.98, OPX_CPX=0.02)})
    assert olivine.startswith("sure: olivine, orthopyroxene, clinopyroxene; not needed to fit, but not ruled out: plag")
    none = fit_verdict(fitted | {"choice": chosen(CPX=0.72, OL=0.28)})
    assert none.startswith("no mineral is sure; open: olivine 28 %, clinopyroxene 72 %; not needed")
    assert "if the fit is right, " in none or "no composition" in none


def test_of_many_fits_is_counted_what_is_sure() -> None:
    good = {"bands": [1], "status": "converged"}
    sure = {"sure": ["olivine"], "open": ["orthopyroxene"], "not_needed": ["plagioclase"]}
    records = [good | {"id": f"s{k}", "choice": sure} for k in range(5)]
    records.append(good | {"id": "x", "choice": sure | {"sure": []}, "status": "converged; strained: R"})
    records += [good | {"id": "y", "choice": None}, {"id": "z", "bands": [], "choice": None, "status": "no result"}]
    assert fits_counted(records) == [
        "sure, of 6 spectra: olivine in 5",
        "open, of 6 spectra: orthopyroxene in 6",
        "probably absent, or not needed to fit, of 6 spectra: plagioclase in 6",
        "no mineral is sure: 1 of 6 spectra",
        "the assemblage was assumed: 1 of 8 spectra",
        "no fit: 1 of 8 spectra",
        "in doubt: 1 of 8 spectra (x), see `status`",
    ]


def test_a_table_has_a_row_of_each_spectrum_where_bands_are_left_out() -> None:
    found = lunarsci.fit([made_up(seed) for seed in range(7)], assemblage="OPX")
    each, bands = found.to_table(parts=False), found.to_table()
    assert len(each) == 7 < len(bands) and "fs_in_range" in each.colnames
    assert "center_nm" in bands.colnames and "center_nm" not in each.colnames
    assert "the assemblage was assumed" in str(found)
    last = str(each["id"][-1])
    assert any(text.get_text().startswith(last) for text in found.plot(last).findobj(Text))
    with pytest.raises(ParameterError, match="page 'nobody' is none of this result's, 2 in all"):
        found.plot("nobody")


def test_craters_have_a_row_of_each_rock_where_parts_are_left_out() -> None:
    found = lunarsci.match(modes="ol=0.25:0.05,opx=0.35:0.05,cpx=0.4:0.05", name="fin")
    [row] = found.to_pandas(parts=False).to_dict("records")
    assert (row["rock"], len(found), len(found.to_table())) == ("fin", 1, 11)
    assert row["status"] == found["fin"]["status"] and row["likeliest"] in row["status"]
    assert ".untrusted says why" in repr(found)


def test_one_of_two_pyroxenes_is_sure_where_neither_is(fitted: dict[str, Any]) -> None:
    """As of the boulder ce4-083-rock: nothing without a pyroxene fits it, and either does."""
    boulder = fitted | {"choice": chosen(CPX=0.55, OL_CPX=0.11, OPX_CPX=0.15, OL_OPX=0.17, OL=0.02)}
    said = fit_verdict(boulder)
    assert said.startswith("a pyroxene is sure, which one is open (orthopyroxene 32 %, clinopyroxene 81 %); open: ")
    assert "olivine 30 %" in said and "no mineral is sure" not in said


def test_what_a_script_takes_agrees_with_the_verdict() -> None:
    [auto] = lunarsci.fit(made_up(), assemblage="auto", starts=1).records
    chances = {one["assemblage"]: one["probability"] for one in auto["choice"]["candidates"]}
    found = standing(chances, auto["choice"]["present"])
    assert {key: auto["choice"][key] for key in found} == found
    assert auto["choice"]["group_probability"]["pyroxene"] > 0.99
    [row, *_] = rows_one_by_one([auto | {"choice": auto["choice"] | {"sure": ["olivine", "pyroxene"]}}], {})
    assert (row["sure"], row["open"]) == ("olivine+pyroxene", "+".join(found["open"]))
    assert row["probability_of_pyroxene"] > 0.99


def test_what_one_pyroxene_fits_is_not_said_without_a_second_one() -> None:
    alone = lunarsci.fit(made_up(), assemblage="OL-OPX", starts=2)
    [record] = alone.to_dict()["spectra"]
    assert {key: item["domain"] for key, item in record["compositions"].items()} == {
        "fo": "",
        "fs": "no second pyroxene",
    }
    assert "mol % (if no second pyroxene)" in fit_verdict(record)
    assert {row["fs_domain"] for row in alone.rows()} == {"no second pyroxene"}
    assert alone._record(0, "")["compositions"] == record["compositions"]
    both = lunarsci.fit(made_up(), assemblage="OPX-CPX", starts=2).to_dict()["spectra"][0]
    assert {item["domain"] for item in both["compositions"].values()} == {""}


def test_what_is_there_is_answered_by_unmix_and_not_by_the_fit(reference_data: Path) -> None:
    """RELAB MIX230, XP-CMP-010, pomix1006: 73 % orthopyroxene, 51 % clinopyroxene, 49 % olivine, beside another."""
    ids = ("MIX230", "XP-CMP-010", "pomix1006")
    result = lunarsci.fit(str(reference_data / "spectra/relab/reflectance.csv"), assemblage="auto", id=ids).records
    hidden = ("orthopyroxene", "clinopyroxene", "olivine")
    for name, record in zip(hidden, (one for id in ids for one in result if one["id"] == id), strict=True):
        choice, said = record["choice"], fit_verdict(record)
        assert name in choice["sure"] and name in said.partition(";")[0], said
        assert "centres are those of no" not in said
        assert "Wo of clinopyroxene" not in said, "there is a second pyroxene"
        need = choice["mineral_probability"]
        assert all((f"{key} {100 * value:.0f} %" in said) is (value < 0.93) for key, value in need.items()
                   if key in choice["sure"])  # fmt: skip
        assert "the fit alone gives" in said and "believe `spectra unmix`" in said


def test_one_pyroxene_that_the_fit_needs_may_stand_for_the_other() -> None:
    """Where `unmix` is untested it is a pyroxene that is sure; elsewhere the one that `unmix` sees."""
    assert standing({"CPX": 1.0})["sure"] == ["pyroxene"]
    assert standing({"OPX-CPX": 1.0})["sure"] == ["orthopyroxene", "clinopyroxene"]
    seen = dict.fromkeys(MINERALS.values(), 0.02) | {"orthopyroxene": 0.99, "clinopyroxene": 0.5}
    assert standing({"CPX": 1.0}, seen)["sure"] == ["orthopyroxene"]
    unsure = standing({"CPX": 1.0}, seen | {"orthopyroxene": 0.6})
    assert (unsure["sure"], unsure["open"]) == (["pyroxene"], ["orthopyroxene", "clinopyroxene"])
    other = verdict({"CPX": 1.0}, seen | {"orthopyroxene": 0.6}, cause="a spinel?")
    assert other.startswith("no mineral is sure; pyroxene is fitted, but open: a spinel?")


def test_a_strained_fit_is_in_doubt(fitted: dict[str, Any]) -> None:
    said = fit_verdict(fitted | {"status": "converged; strained: NBSR at 1 and 2 µm contradict each other"})
    assert "in doubt, strained: NBSR at 1 and 2 µm contradict" in said


def test_a_picture_says_that_a_fit_is_in_doubt_as_the_text_does() -> None:
    result = lunarsci.fit(made_up(one=870.0, two=1760.0), assemblage="OPX", starts=2)
    titles = " ".join(" ".join(axes.get_title() for axes in result.plot().axes).split())
    assert f"in doubt, {result.records[0]['status'].partition('; ')[2]}" in titles


@pytest.mark.parametrize(
    ("first", "second", "said"),
    [(None, None, "no band"), (930.0, None, "none at 2 µm"), (None, 1900.0, "pyroxene and spinel are both open")],
)
def test_bands_that_are_missing_are_missed(first: float | None, second: float | None, said: str) -> None:
    record: dict[str, Any] = {"bc1000_nm": first, "bc2000_nm": second, "chemistry": {}}
    for key in ("1000", "2000"):
        record |= {f"bc{key}_sigma_nm": 0.04, f"bc{key}_systematic_nm": None, f"bc{key}_method_nm": 5.7}
    record["band1000_status"] = "ok" if first else "no result: too few usable channels in its window"
    record["band2000_status"] = "ok" if second else "no band: its depth is within 4.5 sigma of 0"
    told = bands_verdict(record)
    assert said in told
    assert told.count(".0 ± 0.04 (noise) ± 5.7 (method) nm") == sum(one is not None for one in (first, second))


def test_a_centre_that_depends_on_the_method_says_so(reference_data: Path) -> None:
    found = lunarsci.bands(str(reference_data / "spectra/ce4/reflectance_factor.csv"), continuum="hull")
    told = 0
    for record, own in zip(found.to_dict()["spectra"], found.measured, strict=True):
        for key in ("1000", "2000"):
            spread = record[f"bc{key}_method_nm"]
            parts = (record[f"bc{key}_systematic_nm"], record[f"bc{key}_gaussian_nm"])
            least = max((one for one in parts if one is not None), default=None)
            assert spread == least or (key == "2000" and spread > (least or 0.0)), "the cut, of the 2 um band alone"
            wide = bool(record[f"bc{key}_nm"]) and spread > max(20, 3 * record[f"bc{key}_sigma_nm"])
            assert (record[f"band{key}_status"] == "centre depends on the method") is wide
            assert own.bands[key].status == record[f"band{key}_status"]
            told += wide
    assert told > 0


def test_what_of_shares_may_be_quoted_is_said() -> None:
    share = {"fraction": 0.45, "median": 0.49, "low95": 0.1, "high95": 0.89, "present": 0.97}
    shares: dict[str, Any] = {"in_domain": False, "status": "out of domain: too uncertain", "orthopyroxene": share}
    record: dict[str, Any] = {
        "kind": {"name": "not-determined"},
        "normative": None,
        "abundance": shares | {"ratios": {}},
    }
    told = "orthopyroxene 45 % (95 %: 10 to 89)"
    assert shares_verdict(record) == f"uncertain; quote the 95 % intervals alone: {told}; likely there: orthopyroxene"
    ratio = {"olivine_in_mafic": {"fraction": 0.3, "median": 0.28, "low95": 0.0, "high95": 0.75}}
    rock = record | {"abundance": shares | {"in_domain": True, "ratios": ratio}}
    assert shares_verdict(rock).startswith(told)
    assert shares_verdict(rock).endswith("; ratios: olivine in mafic 30 % (95 %: 0 to 75)")
    open_one = record | {"abundance": shares | {"orthopyroxene": share | {"fraction": None}, "status": "nothing known"}}
    assert shares_verdict(open_one) == "no share to be quoted: nothing known"
    absent = record | {"abundance": shares | {"orthopyroxene": share | {"low95": 0.0}, "ratios": {}}}
    assert "; not excluded: orthopyroxene" in shares_verdict(absent)
    assert "likely there" not in shares_verdict(absent) + str(shares_counted([absent]))
    soil = record | {"kind": {"name": "weathered-soil"}}
    assert shares_verdict(soil).startswith("no shares of minerals")
    assert shares_counted([record, rock, soil]) == [
        "in domain: 1 of 3 spectra; of the others quote the 95 % intervals alone",
        "likely there: orthopyroxene in 3",
        "weathered soils, not unmixed: 1 of 3 spectra",
    ]


def test_centres_that_no_such_mineral_has_strain_a_fit() -> None:
    """An absorption at 880 nm asks for an orthopyroxene of less iron than none."""
    found = lunarsci.fit(made_up(one=870.0, two=1760.0), assemblage="OPX", starts=2)
    [record] = found.to_dict()["spectra"]
    assert record["compositions"]["fs"]["in_range"] is False
    assert "centres beyond those of any orthopyroxene" in record["status"]
    usual = lunarsci.fit(made_up(), assemblage="OPX", starts=2).to_dict()["spectra"][0]
    assert usual["compositions"]["fs"]["in_range"] and "centres beyond" not in usual["status"]


def test_a_mineral_whose_centres_no_such_mineral_has_is_not_sure() -> None:
    """As of the powder JA-CMP-007, a pyroxene that three bands of an olivine of Fo 142 fit best."""
    alone = standing({"OL": 0.8, "OL-CPX": 0.2}), standing({"OL": 0.8, "OL-CPX": 0.2}, beyond=["olivine"])
    assert [found["sure"] for found in alone] == [["olivine"], []] and "olivine" in alone[1]["open"]
    assert "its centres are those of no olivine: open" in verdict({"OL": 0.8, "OL-CPX": 0.2}, beyond=["olivine"])
    found = lunarsci.fit(made_up(one=860.0, two=1760.0), assemblage="auto", starts=2)
    [record] = found.to_dict()["spectra"]
    beyond = [m for m in ("olivine", "orthopyroxene", "clinopyroxene") if f"any {m}" in record["status"]]
    assert beyond and not set(beyond) & set(record["choice"]["sure"])


@pytest.mark.parametrize(("second", "told"), [(0.60, False), (0.43, True)])
def test_ratios_that_contradict_each_other_strain_a_fit(second: float, told: bool) -> None:
    """0.79 +- 0.04 against 0.43 +- 0.08, as of a boulder under OPX-CPX."""
    fit = lunarsci.fit(made_up(), assemblage="OPX-CPX", starts=2).good[0]
    batch = replace(batch_of(fit), iterations=np.zeros(1))
    batch.um1[0], batch.um2[0] = (0.79, 0.21, 0.04, np.nan), (second, 1 - second, 0.08, np.nan)
    assert bool(batch.ratios_differ[0]) is told
    assert ("NBSR at 1 and 2 µm contradict" in batch.statuses()[0]) is told


def test_boulders_of_change_4_are_strained_where_olivine_is_asked_for_in_vain(reference_data: Path) -> None:
    found = lunarsci.fit(str(reference_data / "spectra/ce4/reflectance_factor.csv"))
    status = {record["id"]: record["status"] for record in found.records}
    assert "centres beyond those of any olivine" in status["ce4-010-rock"]
    assert sum("centres beyond" in text for text in status.values()) == 26


def test_a_choice_by_weak_evidence_is_untrusted() -> None:
    weak = lunarsci.fit(made_up(), assemblage="auto", starts=1)
    choice = weak.choices[0]
    assert bool(weak.untrusted) is not choice.strong

    for strong in (True, False):
        told = replace(weak, choices={0: replace(choice, strong=strong)}).untrusted
        assert ("the assemblage is not decided for spectrum 1" in told) is not strong
