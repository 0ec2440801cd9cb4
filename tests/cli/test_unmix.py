"""`lunarsci spectra unmix`: all four minerals or named ones, several spectra at once, stated modes, kinds, soils."""

import csv
import io
import json
import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from lunarsci.spectra.abundance.end_members import embedded_end_members
from lunarsci.spectra.abundance.result import Abundance, MineralFraction, share_pages

NM = np.arange(450.0, 2451.0, 10.0)
SHARES = {"a": (0.8, 0.2), "b": (0.6, 0.4), "c": (0.35, 0.65), "d": (0.1, 0.9)}
NAMED = ("--assemblage", "OL-OPX", "--quiet")


def written(path: Path, columns: dict[str, Any]) -> Path:
    values = np.column_stack([NM, *columns.values()])
    np.savetxt(path, values, "%.6f", ",", header=",".join(("wavelength_nm", *columns)), comments="")
    return path


@pytest.fixture(scope="module")
def mixtures(tmp_path_factory: pytest.TempPathFactory, once: None) -> Path:
    """Four synthetic mixtures of one olivine and one orthopyroxene, mixed in -ln R; unmixed once for equal options."""
    library = {item.id: np.log(item.reflectance) for item in embedded_end_members(NM)}
    olivine, pyroxene = library["AG-TJM-008"], library["PE-CMP-030"]
    columns = {id: np.exp(a * olivine + b * pyroxene) for id, (a, b) in SHARES.items()}
    return written(tmp_path_factory.mktemp("mixtures") / "mixtures.csv", columns)


def found(run, *arguments: object) -> dict[str, Any]:
    done = run("spectra", "unmix", *arguments, "--json")
    assert done.code == 0, done.err
    return {record["id"]: record["abundance"] for record in json.loads(done.out)["result"]["spectra"]}


def test_all_four_minerals_are_weighed_where_none_is_named(run, mixtures: Path) -> None:
    held = []
    for id, shares in found(run, mixtures, "--quiet").items():
        four = [shares[name] for name in ("olivine", "orthopyroxene", "clinopyroxene", "plagioclase")]
        assert sum(item["fraction"] for item in four) == pytest.approx(1.0)
        assert shares["not_weighed"] == [] and shares["learned"] == 1.0
        for item, share in zip(four, (*SHARES[id], 0.0, 0.0), strict=True):
            held.append(item["low95"] <= share <= item["high95"])
            assert 0 <= item["present"] <= 1
    assert sum(held) >= 14, "of 16 intervals of 95 %"
    named = found(run, mixtures, *NAMED)
    assert all(shares["learned"] < 1.0 and "plagioclase" not in shares for shares in named.values())


def test_the_prior_of_returned_rocks_is_named_and_its_modes_are_cited(run, mixtures: Path) -> None:
    done = run("spectra", "unmix", mixtures, "--kind", "solid-rock", "--prior", "lunar-rocks", "--json", "--quiet")
    document = json.loads(done.out)
    for record in document["result"]["spectra"]:
        shares = record["abundance"]
        assert shares["prior"] == "lunar-rocks" and 0 < shares["returned"] < 1
        assert "prior of returned rocks" in shares["status"] and "published" in shares
    assert "lunar_rock_modes.csv" in {table["name"] for table in document["provenance"]["tables"]}
    assert any("Lunar Sample Compendium" in source for source in document["provenance"]["sources"])
    plain = found(run, mixtures, "--quiet")
    assert {(shares["prior"], shares["returned"]) for shares in plain.values()} == {("powders", None)}


def test_spectra_together_are_found_and_differ_from_one_by_one(run, mixtures: Path) -> None:
    together = found(run, mixtures, *NAMED, "--together")
    alone = found(run, mixtures, *NAMED)
    errors = [abs(together[id]["olivine"]["fraction"] - share) for id, (share, _) in SHARES.items()]
    assert max(errors) < 0.12
    assert together["b"] != alone["b"]
    order = [together[id]["olivine"]["fraction"] for id in SHARES]
    assert order == sorted(order, reverse=True)


def test_known_modes_sharpen_the_others(run, mixtures: Path, tmp_path: Path) -> None:
    known = tmp_path / "known.csv"
    known.write_text("id,olivine,vol_opx\na,0.8,0.2\nc,,\nd,0.1,0.9\n")
    told = found(run, mixtures, *NAMED, "--known", known)
    assert told["a"]["olivine"]["fraction"] == told["a"]["olivine"]["low95"] == pytest.approx(0.8)
    assert told["a"]["status"] == "modes as stated"
    for id in ("b", "c"):
        assert told[id]["olivine"]["fraction"] == pytest.approx(SHARES[id][0], abs=0.05)
    done = run("spectra", "unmix", mixtures, *NAMED, "--known", known, "--json")
    inputs = json.loads(done.out)["provenance"]["inputs"]
    assert any(str(known) in str(item) for item in inputs)


def test_opaques_and_iron_are_terms_of_the_end_members(run, mixtures: Path) -> None:
    for option in ("--opaque", "--iron"):
        for more in ((), ("--together",)):
            modes = found(run, mixtures, *NAMED, option, *more)["a"]
            assert sum(modes[name]["fraction"] for name in ("olivine", "orthopyroxene")) == pytest.approx(1)
        done = run("spectra", "unmix", mixtures, option)
        assert done.code == 2 and "name the minerals" in done.err[-1]
    done = run("spectra", "unmix", mixtures, *NAMED, "--method", "absorbance", "--iron")
    assert done.code == 2 and "--iron needs" in done.err[-1]
    done = run("spectra", "unmix", mixtures, "--assemblage", "OL-SPINEL")
    assert done.code == 2 and "'SPINEL' is no mineral that is weighed" in done.err[-1]


def test_the_first_table_is_the_shares(run, mixtures: Path, tmp_path: Path) -> None:
    text = run("spectra", "unmix", mixtures, *NAMED).out
    assert text.splitlines()[0] == "shares of olivine, orthopyroxene by volume, with 95 % intervals"
    one = run("spectra", "unmix", mixtures, *NAMED, "--id", "a").out
    assert one.splitlines()[0] == "a: shares of minerals by volume"
    assert len(one.splitlines()) < 16
    row = next(csv.DictReader(io.StringIO(run("spectra", "unmix", mixtures, *NAMED, "--csv").out)))
    assert float(row["olivine_low95"]) <= float(row["olivine"]) <= float(row["olivine_high95"])
    assert row["in_domain"] in ("true", "false") and row["kind"]
    picture = tmp_path / "shares.pdf"
    assert run("spectra", "unmix", mixtures, *NAMED, "--plot", picture).code == 0
    assert len(re.findall(rb"/Type /Page\b", picture.read_bytes())) == 1


@pytest.mark.parametrize(
    ("table", "message"),
    [
        ("id,olivine,opx\nz,1,0\n", "none of its ids"),
        ("id,olivine,cpx\na,0.5,0.5\n", "name all, with shares of 1"),
        ("id,olivine,opx\na,0.5,0.2\n", "sum to 0.7"),
        ("id,olivine,opx\na,0.5\n", "the header has 3 names and the rows 2 fields"),
    ],
)
def test_tables_of_modes_that_do_not_fit_are_refused(
    run, mixtures: Path, tmp_path: Path, table: str, message: str
) -> None:
    known = tmp_path / "known.csv"
    known.write_text(table)
    done = run("spectra", "unmix", mixtures, *NAMED, "--known", known)
    assert done.code == 1
    assert done.out == ""
    assert message in done.err[-1]


def test_spectra_of_one_name_are_told_apart_but_not_by_a_table(run, mixtures: Path, tmp_path: Path) -> None:
    twin = tmp_path / "twin.csv"
    twin.write_text(mixtures.read_text())
    done = run("spectra", "unmix", mixtures, twin, *NAMED, "--together", "--json")
    assert done.code == 0, done.err
    records = json.loads(done.out)["result"]["spectra"]
    assert [record["id"] for record in records] == [*SHARES, *SHARES]
    assert records[0]["abundance"]["olivine"] == pytest.approx(records[4]["abundance"]["olivine"], abs=0.03)
    known = tmp_path / "known.csv"
    known.write_text("id,olivine,opx\na,0.8,0.2\n")
    done = run("spectra", "unmix", mixtures, twin, *NAMED, "--known", known)
    assert done.code == 1
    assert "'a' is the id of two spectra" in done.err[-1]


@pytest.fixture(scope="module")
def soil(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Dark and red with a shallow band, as mature soil is; synthetic."""
    band = 1 - 0.08 * np.exp(-0.5 * ((NM - 960.0) / 90.0) ** 2)
    values = (0.055 + 0.09 * (NM - 450.0) / 1000.0) * band
    return written(tmp_path_factory.mktemp("soil") / "soil.csv", {"soil": values})


def test_a_weathered_soil_is_not_unmixed(run, soil: Path, tmp_path: Path) -> None:
    done = run("spectra", "unmix", soil, "--kind", "weathered-soil", "--json", "--plot", tmp_path / "shares.pdf")
    assert done.code == 3
    assert "shares of soil are not determined: a soil that space has weathered" in done.err[-1] + done.err[0]
    [record] = json.loads(done.out)["result"]["spectra"]
    assert record["kind"]["weathered"] > 0.9
    for mineral in ("olivine", "orthopyroxene", "clinopyroxene", "plagioclase"):
        share = record["abundance"][mineral]
        assert share["fraction"] is None
        assert (share["low"], share["high"]) == (0, 1)
    assert record["abundance"]["in_domain"] is False
    iron = record["normative"]["feo_wt"]
    assert iron["low95"] < iron["low"] < iron["value"] < iron["high"] < iron["high95"]
    text = run("spectra", "unmix", soil, "--kind", "weathered-soil")
    assert "no modes of minerals" in text.out
    assert len(re.findall(rb"/Type /Page\b", (tmp_path / "shares.pdf").read_bytes())) == 2
    shown = run("spectra", "unmix", soil, "--kind", "weathered-soil", "--csv")
    assert "normative_feo_wt,normative_feo_low_wt" in shown.out


def test_a_stored_share_is_trusted_as_its_own_spectrum_is(run, mixtures: Path, soil: Path, tmp_path: Path) -> None:
    """A soil beside a powder: the soil leaves with 3, the powder with 0, and all of them together with 3."""
    kept = tmp_path / "both.json"
    powder = tmp_path / "powder.csv"
    powder.write_text(mixtures.read_text())
    assert run("spectra", "unmix", powder, soil, "-o", kept).code == 3
    records = json.loads(kept.read_text())["result"]["spectra"]
    for number, record in enumerate(records):
        asked = run("info", kept, "--field", f"result.spectra.{number}.kind.weathered")
        assert asked.code == (3 if record["kind"]["name"] == "weathered-soil" else 0)
    assert [record["kind"]["name"] for record in records].count("weathered-soil") == 1
    assert run("info", kept, "--field", "result.spectra").code == 3


def test_a_rock_has_shares_with_wide_intervals_and_ratios_beside_published_ones(run, tmp_path: Path) -> None:
    values = (0.055 + 0.09 * (NM - 450.0) / 1000.0) * (1 - 0.25 * np.exp(-0.5 * ((NM - 960.0) / 90.0) ** 2))
    deep = written(tmp_path / "rock.csv", {"rock": values})
    done = run("spectra", "unmix", deep, "--kind", "solid-rock", "--json")
    assert done.code == 0
    rock = json.loads(done.out)["result"]["spectra"][0]["abundance"]
    assert [*rock["ratios"]] == ["olivine_in_mafic", "orthopyroxene_in_pyroxene"]
    for ratio in rock["ratios"].values():
        ends = [0, ratio["low95"], ratio["low"], ratio["fraction"], ratio["high"], ratio["high95"], 1]
        assert ends == sorted(ends)
    assert "Ding et al. (2024)" in rock["published"]
    assert max(rock[name]["high95"] - rock[name]["low95"] for name in ("olivine", "orthopyroxene")) > 0.3
    shown = run("spectra", "unmix", deep, "--kind", "solid-rock").out
    assert shown.splitlines()[0] == "rock: shares of minerals by volume"
    assert "ratios of mafic minerals" in shown


def test_channels_of_any_instrument_are_enough(run, tmp_path: Path) -> None:
    """43 channels, none from 1.3 to 1.6 um; half a spectrum has an answer, too, with wider intervals."""
    [olivine] = [item for item in embedded_end_members(NM) if item.id == "AG-TJM-008"]
    widths = {}
    for name, there in {"few": (NM % 40 == 10) & ((NM < 1300) | (NM > 1600)), "half": NM < 1100}.items():
        path = tmp_path / f"{name}.csv"
        rows = "\n".join(f"{a:g},{b:.5f}" for a, b in zip(NM[there], olivine.reflectance[there], strict=True))
        path.write_text(f"wavelength_nm,{name}\n{rows}\n")
        share = found(run, path, "--quiet")[name]["olivine"]
        assert share["high95"] > 0.9
        widths[name] = share["high95"] - share["low95"]
    assert widths["few"] < widths["half"]


def test_the_page_of_shares_names_spectra_and_minerals() -> None:
    share = [MineralFraction(name, 0.5, 0.4, 0.6, 0.3, 0.7) for name in ("olivine", "orthopyroxene")]
    [page] = share_pages([Abundance(id, "unmix", tuple(share), id == "a", "", 0.01) for id in ("a", "b")])
    assert [panel.get_title() for panel in page.axes] == ["olivine", "orthopyroxene"]
    assert [label.get_text() for label in page.axes[0].get_yticklabels()] == ["a", "b"]
    faces = [line.get_markerfacecolor() for line in page.axes[0].lines if line.get_marker() == "o"]
    assert faces[1] == "white" != faces[0]
