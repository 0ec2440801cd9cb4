"""Modes of measured mixtures, with their own end members and with a library that holds nothing of their series."""

from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from lunarsci.inputs import read_input
from lunarsci.spectra.abundance.end_members import embedded_end_members
from lunarsci.spectra.abundance.estimate import estimate_abundance
from lunarsci.spectra.abundance.result import Abundance
from lunarsci.spectra.library import EndMember
from lunarsci.spectra.readers import read_spectra
from lunarsci.spectra.spectrum import Spectrum

pytestmark = pytest.mark.reference
CHANNELS = np.arange(450.0, 2451.0, 5.0)
COLUMNS = {"olivine": "vol_ol", "orthopyroxene": "vol_opx", "clinopyroxene": "vol_cpx", "plagioclase": "vol_plg"}
SERIES = {
    "XP-CMP": (("orthopyroxene", "clinopyroxene"), ("PE-CMP-03", "PP-CMP-02")),
    "AG-TJM": (tuple(COLUMNS), ("AG-TJM",)),
    "pomix": (("olivine", "orthopyroxene"), ("PP-EAC-087", "PP-EAC-016")),
    "OOCMIX": (("olivine", "orthopyroxene", "clinopyroxene"), ("PP-EAC-087", "PP-EAC-016")),
    "MIX03": (("olivine", "clinopyroxene"), ("PP-EAC-087", "PP-EAC-016")),
    "MIX23": (("orthopyroxene", "clinopyroxene"), ("PYX040", "PP-EAC-001")),
}
"""Minerals of a series, and what the library must not hold when it is judged."""


@pytest.fixture(scope="module")
def spectra(reference_data: Path) -> dict[str, Spectrum]:
    return {s.id: s for s in read_spectra(read_input(str(reference_data / "spectra/relab/reflectance.csv")))}


@pytest.fixture(scope="module")
def modes(reference_data: Path) -> pd.DataFrame:
    return pd.read_csv(reference_data / "spectra/relab/manifest.csv").set_index("id")[list(COLUMNS.values())]


@pytest.fixture(scope="module")
def unmixed(spectra: dict[str, Spectrum], modes: pd.DataFrame) -> dict[str, Abundance]:
    """Every mixture by a library without its series."""
    library = embedded_end_members(CHANNELS)
    found = {}
    for series, (minerals, kept_out) in SERIES.items():
        end_members = [item for item in library if not item.id.startswith((series, *kept_out))]
        for name in modes.index[modes.index.str.startswith(series) & (modes.max(axis=1) < 0.99)]:
            found[name] = estimate_abundance(spectra[name], minerals, end_members=end_members)
    return found


def errors(found: dict[str, Abundance], modes: pd.DataFrame, mineral: str) -> np.ndarray:
    """Fraction less truth wherever the mineral was asked for. [%]"""
    return np.array(
        [
            100 * (item.fraction - modes.loc[name, COLUMNS[mineral]])
            for name, abundance in found.items()
            for item in abundance.fractions
            if item.mineral == mineral
        ]
    )


def rmse(values: np.ndarray) -> float:
    return float(np.sqrt(np.mean(values**2)))


def test_a_library_without_the_series_errs_by_a_tenth(unmixed: dict[str, Abundance], modes: pd.DataFrame) -> None:
    """Measured: olivine 14.4, orthopyroxene 8.9, clinopyroxene 12.9 vol %, minerals of the series named."""
    assert len(unmixed) == 53
    assert rmse(errors(unmixed, modes, "orthopyroxene")) < 10
    assert rmse(errors(unmixed, modes, "clinopyroxene")) < 14
    assert rmse(errors(unmixed, modes, "olivine")) < 16
    assert rmse(errors(unmixed, modes, "plagioclase")) < 21


@pytest.mark.xfail(strict=True, reason="aimed at, not reached with the generic library: 14 and 13 vol %")
def test_a_library_without_the_series_errs_by_ten_at_most(unmixed: dict[str, Abundance], modes: pd.DataFrame) -> None:
    assert all(rmse(errors(unmixed, modes, name)) <= 10 for name in ("olivine", "orthopyroxene", "clinopyroxene"))


def test_sixty_eight_per_cent_intervals_hold_about_that_share(
    unmixed: dict[str, Abundance], modes: pd.DataFrame
) -> None:
    inside = [
        item.low <= modes.loc[name, COLUMNS[item.mineral]] <= item.high
        for name, abundance in unmixed.items()
        for item in abundance.fractions
    ]
    assert 0.60 <= np.mean(inside) <= 0.76
    wide = [
        item.low95 <= modes.loc[name, COLUMNS[item.mineral]] <= item.high95
        for name, abundance in unmixed.items()
        for item in abundance.fractions
    ]
    assert np.mean(wide) > 0.8, "0.83 measured: they are too narrow, and the docs say so"


@pytest.mark.parametrize(
    ("sizes", "end_members"), [((0, 45), ("PE-CMP-030", "PP-CMP-021")), ((75, 127), ("PE-CMP-032", "PP-CMP-023"))]
)
def test_own_end_members_give_pyroxenes_within_five_per_cent(
    reference_data: Path, spectra: dict[str, Spectrum], modes: pd.DataFrame, sizes: tuple[int, int],
    end_members: tuple[str, str],
) -> None:  # fmt: skip
    rows = pd.read_csv(reference_data / "spectra/relab/manifest.csv").set_index("id")
    of_size = (rows["min_um"] >= sizes[0]) & (rows["max_um"] <= sizes[1])
    names = rows.index[rows.index.str.startswith("XP-CMP") & of_size]
    assert len(names) == 7
    minerals = ("orthopyroxene", "clinopyroxene")
    library = [
        EndMember(name, mineral, spectra[name].wavelength_nm, spectra[name].reflectance)
        for name, mineral in zip(end_members, minerals, strict=True)
    ]
    found = {name: estimate_abundance(spectra[name], minerals, end_members=library) for name in names}
    assert rmse(errors(found, modes, "orthopyroxene")) <= 5


def test_laboratory_mixtures_are_in_domain_and_rover_spectra_are_not(
    unmixed: dict[str, Abundance], reference_data: Path
) -> None:
    """Weathered soil and dark rock are no mixtures of laboratory minerals."""
    assert np.mean([abundance.in_domain for abundance in unmixed.values()]) >= 0.80
    rover = read_spectra(read_input(str(reference_data / "spectra/ce4/reflectance_factor.csv")))
    rocks = [estimate_abundance(spectrum, tuple(COLUMNS)) for spectrum in rover]
    assert len(rocks) == 88
    assert not any(item.in_domain for item in rocks)
