"""Real minerals: what each regression says of them beside their analyses, and whether it knows where not to be used."""

from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from matplotlib.path import Path as MplPath

from lunarsci.spectra.bands import SpectrumBands, measure_batch
from lunarsci.spectra.chemistry.bands import FIELDS, chemistry, from_centres, gaffey_pairs, lines_of
from lunarsci.spectra.chemistry.plane import regressions
from lunarsci.spectra.mgm.fit import fit_spectra
from lunarsci.spectra.mgm.model import mgm_model
from lunarsci.spectra.mgm.result import MgmFit
from lunarsci.spectra.readers.dispatch import read_spectra

pytestmark = pytest.mark.reference
PURE = 0.97
FEWEST = 5


def truth(folder: Path) -> pd.DataFrame:
    """Analyses in mol %, shares of olivine and orthopyroxene where there is nothing else."""
    rows = pd.read_csv(folder / "spectra/relab/manifest.csv").set_index("id")
    opx, cpx, olivine = rows.vol_opx > PURE, rows.vol_cpx > PURE, rows.vol_ol > PURE
    mixed = (rows.vol_cpx < 0.02) & (rows.vol_plg < 0.02) & rows.vol_opx.between(1 - PURE, PURE)
    known = pd.DataFrame(index=rows.index)
    for key in ("fs", "wo", "en"):
        known[key] = 100 * np.where(opx, rows[f"opx_{key}"], np.where(cpx, rows[f"cpx_{key}"], np.nan))
    # Bands of pyroxenes without iron are those of impurities.
    known.loc[known.fs == 0, ["fs", "wo", "en"]] = np.nan
    known["fo"] = 100 * np.where(olivine, rows.fo, np.nan)
    known["fa"] = 100 - known.fo
    known["opx_share"] = np.where(mixed, rows.vol_opx / (rows.vol_opx + rows.vol_ol), np.nan)
    known["ol_share"] = 1 - known.opx_share
    return known.assign(pure=opx | cpx, olivine=rows.vol_ol)


def estimates(folder: Path) -> pd.DataFrame:
    """One row per spectrum and key; `line` is the row of the table that was used."""
    known = truth(folder)
    rows = []
    for item in measure_batch(read_spectra(str(folder / "spectra/relab/reflectance.csv")), continuum_name="hull"):
        assert isinstance(item, SpectrumBands)
        one, two = item.bands["1000"].center_nm, item.bands["2000"].center_nm
        wo, fs, _ = gaffey_pairs(np.array([one], float), np.array([two], float))
        lines = {"wo": lines_of("wo")[wo[0]].key, "fs": lines_of("fs")[fs[0]].key}
        for key, found in chemistry(item).items():
            line = lines[found.quantity] if "gaffey" in key and key != "en_gaffey" else key
            value = known.loc[item.id, found.quantity]
            rows.append((item.id, key, line, found.value - value, found.sigma, found.in_range, found.reason))
    return pd.DataFrame(rows, columns=["id", "key", "line", "error", "sigma", "in_range", "reason"])


@pytest.fixture(scope="module")
def found(reference_data: Path) -> pd.DataFrame:
    return estimates(reference_data)


def rms(values: "pd.Series[float]") -> float:
    return float(np.sqrt((values**2).mean()))


def test_errors_of_the_table_are_those_measured_here(found: pd.DataFrame) -> None:
    used = found[found.in_range].dropna(subset=["error"])
    for key, errors in used.groupby("line").error:
        if key not in regressions() or regressions()[str(key)].place == "chondrite":
            continue
        line = regressions()[str(key)]
        if len(errors) >= FEWEST:
            assert line.error_relab == pytest.approx(rms(errors), rel=0.03), (key, rms(errors), len(errors))
        else:
            assert line.error_relab == 0, key


@pytest.mark.parametrize(
    ("key", "count", "inside", "outside"),
    [
        ("fs_gaffey", 70, 23, 30),
        ("wo_gaffey", 54, 12, 13),
        ("en_gaffey", 52, 15.5, 17.5),
        ("fs_trend_bc1000", 25, 11, 190),
        ("fs_trend_bc2000", 22, 9.5, 92),
        ("fs_burbine_bc1000", 23, 22, 85),
        ("fs_burbine_bc2000", 19, 16, 46),
        ("wo_burbine_bc1000", 23, 7.1, 12),
        ("wo_burbine_bc2000", 19, 8.5, 10.6),
        ("fo_bc1000", 10, 14, 4.5),
        ("opx_cloutis", 6, 0.05, 0.2),
    ],
)
def test_rms_errors_stay_what_they_are(
    found: pd.DataFrame, key: str, count: int, inside: float, outside: float | None
) -> None:
    """Rms error of those it says may be used and of the others, bounds just above what is measured. [mol % or -]"""
    rows = found[found.key == key].dropna(subset=["error"])
    good, bad = rows[rows.in_range].error, rows[~rows.in_range].error
    assert abs(len(good) - count) <= 2
    assert 0.8 * inside < rms(good) < inside
    assert len(bad) == 0 if outside is None else 0.5 * outside < rms(bad) < outside


def test_stated_errors_are_the_scatter(found: pd.DataFrame) -> None:
    """68 % within one sigma, if errors were normal; those with few large ones hold more."""
    rows = found[found.in_range].dropna(subset=["error"])
    within = (rows.error.abs() < rows.sigma).groupby(rows.key).mean()
    counted = rows.groupby("key").size()
    assert within[counted >= 20].between(0.5, 0.95).all(), within
    assert 0.6 < (rows.error.abs() < rows.sigma).mean() < 0.9


def test_rocks_with_olivine_are_told_from_pyroxenes(found: pd.DataFrame, reference_data: Path) -> None:
    """The 1 um centre above the pyroxenes gives away every second rock with more than a quarter of olivine, no more."""
    known = truth(reference_data)
    flagged = found[found.key == "fs_gaffey"].set_index("id").reason.str.contains("above the pyroxenes")
    here = known.loc[flagged.index]
    assert flagged[here.pure].mean() < 0.03
    assert 0.35 < flagged[here.olivine > 0.25].mean() < 0.60


def test_fields_of_the_picture_hold_the_pyroxenes(reference_data: Path) -> None:
    """The counts in the caption of `FIELDS`."""
    known = truth(reference_data)
    known = known[known.pure & known.fs.notna()]
    found = measure_batch(read_spectra(str(reference_data / "spectra/relab/reflectance.csv")), continuum_name="hull")
    centres = {item.id: tuple(item.bands[key].center_nm for key in ("1000", "2000")) for item in found}
    counts = []
    for (_, corners, _), (low, high) in zip(FIELDS, ((-1, 5.01), (5.01, 25.5), (25.5, 60)), strict=True):
        names = known.index[(known.wo > low) & (known.wo <= high)]
        inside = sum(MplPath([*corners, corners[0]]).contains_point(centres[name]) for name in names)
        counts.append((inside, len(names)))
    assert counts == [(30, 31), (24, 27), (24, 24)]


@pytest.mark.slow
def test_forsterite_from_fitted_bands(reference_data: Path) -> None:
    """Rms of Fo on 12 RELAB olivines: M1-2 9.6, M2 17, M1-1 24 mol %; the trends were measured with another model."""
    known = truth(reference_data).fo.dropna()
    spectra = [s for s in read_spectra(str(reference_data / "spectra/relab/reflectance.csv")) if s.id in known.index]
    errors: dict[str, list[float]] = {"fo_m1_1": [], "fo_m2": [], "fo_m1_2": []}
    for fit in fit_spectra(spectra, mgm_model("OL", compositions={"fo": (50.0, 40.0)})):
        assert isinstance(fit, MgmFit)
        bands = {band.name: band for band in fit.bands}
        names = {"m1_1": "OL M1-1", "m2": "OL M2", "m1_2": "OL M1-2"}
        centres = {key: (bands[name].center_nm, bands[name].center_sigma_nm) for key, name in names.items()}
        for key, item in from_centres(centres).items():
            errors[key].append(item.value - known[fit.id])
    measured = {key: rms(pd.Series(values)) for key, values in errors.items()}
    assert measured["fo_m1_2"] == pytest.approx(9.6, abs=0.2)
    assert measured["fo_m1_2"] < measured["fo_m2"] < measured["fo_m1_1"] < 26
