"""Shares from the ratio of band strengths: how far they err where others measured, and what their intervals hold."""

from collections.abc import Callable
from pathlib import Path
from types import ModuleType

import numpy as np
import pandas as pd
import pytest

from lunarsci.io.inputs import read_input
from lunarsci.io.tables import table_rows
from lunarsci.spectra.abundance.nbsr import PYROXENES, nbsr_abundance
from lunarsci.spectra.abundance.result import Abundance
from lunarsci.spectra.mgm.fit import fit_spectra
from lunarsci.spectra.mgm.model import mgm_model
from lunarsci.spectra.mgm.result import MgmFit
from lunarsci.spectra.readers.dispatch import read_spectra

pytestmark = pytest.mark.reference


def shares(folder: Path, name: str, assemblage: str = "OL-OPX-CPX") -> dict[str, Abundance]:
    """By id of the spectra of a folder."""
    spectra = read_spectra(read_input(str(folder / f"spectra/{name}.csv")))
    fits = fit_spectra(spectra, mgm_model(assemblage))
    found = {fit.id: nbsr_abundance(fit) for fit in fits if isinstance(fit, MgmFit)}
    return {id: one for id, one in found.items() if one is not None}


def truth(folder: Path, name: str) -> pd.Series:
    """Orthopyroxene in pyroxene of spectra that have any. [-]"""
    rows = pd.read_csv(folder / f"spectra/{name}/manifest.csv").set_index("id")
    pyroxene = rows["vol_opx"] + rows["vol_cpx"]
    return (rows["vol_opx"] / pyroxene)[pyroxene > 0.1]


@pytest.fixture(scope="module")
def make(load_benchmark: Callable[[str], ModuleType]) -> ModuleType:
    return load_benchmark("../../spectra_data/make_nbsr_calibration")


@pytest.mark.parametrize("assemblage", ["OL-OPX-CPX", "OPX-CPX"])
def test_the_table_is_what_its_script_makes(make: ModuleType, reference_data: Path, assemblage: str) -> None:
    """Intervals of series that were left out hold as often as they say, and shares in domain are good."""
    [row] = [row for row in table_rows("nbsr_calibrations.csv") if row["assemblage"] == assemblage]
    found = make.known(reference_data / "spectra", assemblage)
    assert (len(found), found["series"].nunique()) == (int(row["spectra"]), int(row["series"]))
    assert make.scale_law(found) == pytest.approx([float(row["ln_scale"]), float(row["ln_scale_of_pairs"])], abs=0.02)
    held = make.left_out(found)
    assert held == pytest.approx({key: float(row[key]) for key in held}, abs=0.01)
    assert 0.62 < held["held_68"] < 0.74 and 0.92 < held["held_95"] < 0.985
    assert held["in_domain"] > 0.45 and held["good_of_these"] > 0.9


@pytest.mark.parametrize("name", ["relab", "minerals", "meteorites"])
def test_intervals_hold_in_each_set(reference_data: Path, name: str) -> None:
    known, found = truth(reference_data, name), shares(reference_data, f"{name}/reflectance")
    own = [(one.fractions[0], known[id]) for id, one in found.items() if id in known]
    assert len(own) > 60
    assert np.mean([one.low95 <= value <= one.high95 for one, value in own]) > 0.88
    good = [abs(one.fractions[0].fraction - known[id]) < 0.15
            for id, one in found.items() if id in known and one.in_domain]  # fmt: skip
    assert len(good) > 20 and np.mean(good) > 0.9


def test_both_shares_are_the_ratio(reference_data: Path) -> None:
    for one in shares(reference_data, "relab/reflectance").values():
        first, second = one.fractions
        assert (first.mineral, second.mineral) == PYROXENES
        assert first.fraction + second.fraction == pytest.approx(1.0)
        assert first.low95 <= first.low <= first.fraction <= first.high <= first.high95
        assert (first.low95, first.high95) == pytest.approx((1 - second.high95, 1 - second.low95))


def test_weathered_ground_has_wide_intervals_and_is_out_of_domain(reference_data: Path) -> None:
    found = shares(reference_data, "ce4/reflectance_factor")
    assert len(found) >= 60
    weathered = [one for one in found.values() if "weathered" in one.status]
    assert len(weathered) > 40
    for one in weathered:
        assert not one.in_domain
        assert one.fractions[0].high95 - one.fractions[0].low95 > 0.5
