"""The closing sentence about a spectrum says what is sure, and never more than its keys do."""

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import lunarsci
from lunarsci.spectra.jobs.verdicts import bands_verdict, fit_verdict, shares_verdict
from lunarsci.spectra.mgm.batch import batch_of

GRID = np.arange(500.0, 2450.0, 10.0)
CHANCES = {"olivine": 0.28, "orthopyroxene": 0.03, "clinopyroxene": 0.98, "plagioclase": 0.11}


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


def test_only_what_is_sure_is_called_so(fitted: dict[str, Any]) -> None:
    chosen = fitted | {"choice": {"mineral_probability": CHANCES, "strong": False}}
    said = fit_verdict(chosen)
    assert said.startswith("sure: clinopyroxene; open: olivine (28 %), plagioclase (11 %); not needed: orthopyroxene")
    none = fitted | {"choice": {"mineral_probability": CHANCES | {"clinopyroxene": 0.92}, "strong": False}}
    assert fit_verdict(none).startswith("no mineral is sure; open: olivine (28 %), clinopyroxene (92 %)")
    assert "if so, " in said or "no composition" in said


def test_a_strained_fit_is_in_doubt(fitted: dict[str, Any]) -> None:
    said = fit_verdict(fitted | {"status": "converged; strained: NBSR at 1 and 2 µm contradict each other"})
    assert "in doubt, strained: NBSR at 1 and 2 µm contradict" in said


@pytest.mark.parametrize(
    ("first", "second", "said"),
    [(None, None, "no band"), (930.0, None, "none at 2 µm"), (None, 1900.0, "pyroxene is there, no more is said")],
)
def test_bands_that_are_missing_are_missed(first: float | None, second: float | None, said: str) -> None:
    assert said in bands_verdict({"bc1000_nm": first, "bc2000_nm": second, "chemistry": {}})


def test_no_share_out_of_domain_is_to_be_quoted() -> None:
    share = {"fraction": 0.49, "low95": 0.1, "high95": 0.89}
    unmix = {"method": "unmix", "in_domain": False, "status": "out of domain: too uncertain", "orthopyroxene": share}
    nbsr = {"method": "nbsr", "in_domain": True, "status": "line", "orthopyroxene": share | {"fraction": 0.4}}
    record: dict[str, Any] = {
        "kind": {"name": "not-determined", "stated": False, "probabilities": {"rock": 0.76, "soil": 0.24}}
    }
    record |= {"normative": None, "abundance": unmix, "abundances": {"unmix": unmix}}
    assert "no share to be quoted: too uncertain" in shares_verdict(record)
    assert "not decided (rock 76 %, soil 24 %), state `--kind`" in shares_verdict(record)
    both = shares_verdict(record | {"abundances": {"unmix": unmix, "nbsr": nbsr}})
    assert "by `nbsr`, with its interval: orthopyroxene 40 % (95 %: 10 to 89)" in both and "49" not in both


def test_centres_that_no_such_mineral_has_strain_a_fit() -> None:
    """An absorption at 880 nm asks for an orthopyroxene of less iron than none."""
    found = lunarsci.fit(made_up(one=870.0, two=1760.0), assemblage="OPX", starts=2)
    [record] = found.to_dict()["spectra"]
    assert record["compositions"]["fs"]["in_range"] is False
    assert "centres beyond those of any orthopyroxene" in record["status"]
    usual = lunarsci.fit(made_up(), assemblage="OPX", starts=2).to_dict()["spectra"][0]
    assert usual["compositions"]["fs"]["in_range"] and "centres beyond" not in usual["status"]


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
    assert sum("centres beyond" in text for text in status.values()) == 25


def test_a_choice_by_weak_evidence_is_untrusted() -> None:
    weak = lunarsci.fit(made_up(), assemblage="auto", starts=1)
    choice = weak.choices[0]
    assert bool(weak.untrusted) is not choice.strong

    for strong in (True, False):
        told = replace(weak, choices={0: replace(choice, strong=strong)}).untrusted
        assert ("the assemblage is not decided for spectrum 1" in told) is not strong
