"""Narrow absorptions of water, hydroxyl and carbonates are not taken for a pyroxene's, nor glass and spinel."""

from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest

import lunarsci
from lunarsci.spectra.band_status import BAND_SHARE, BandArrays, narrow_absorptions
from lunarsci.spectra.bands import measure_batch
from lunarsci.spectra.jobs.verdicts import bands_verdict, other_cause
from lunarsci.spectra.mgm.assemblages import standing, verdict
from lunarsci.spectra.spectrum import Spectrum

VOLUMES = ["vol_opx", "vol_cpx"]
GRID = np.arange(450.0, 2451.0, 5.0)
Band = tuple[float, float, float]
OPX: tuple[Band, ...] = ((0.45, 920.0, 190.0), (0.35, 1880.0, 540.0))
WATER: tuple[Band, ...] = ((0.12, 1415.0, 55.0), (0.35, 1920.0, 95.0))
"""MADE UP: strength in ln R, centre and full width at half maximum; of water as broad as in powders that hold some."""


def made_up(*bands: Band, seed: int = 0, noise: float = 0.002, nm: np.ndarray = GRID) -> tuple[np.ndarray, np.ndarray]:
    ln = np.log(0.35 + 3e-5 * (nm - 1000.0))
    for strength, centre, width in bands:
        ln = ln - strength * np.exp(-4 * np.log(2) * ((nm - centre) / width) ** 2)
    return nm, np.exp(ln + noise * np.random.default_rng(seed).standard_normal(nm.size))


def arrays(nm: np.ndarray, rows: np.ndarray) -> BandArrays:
    return measure_batch([Spectrum(str(k), nm, row) for k, row in enumerate(rows)]).arrays


def measured(*bands: Band, **how: Any) -> tuple[dict[str, Any], str]:
    found = lunarsci.bands(made_up(*bands, **how))
    [record] = found.to_dict()["spectra"]
    return record, found.untrusted


@pytest.mark.parametrize("width", [50.0, 80.0, 120.0])
@pytest.mark.parametrize(("centre", "cause"), [(1915.0, "water or hydroxyl"), (2315.0, "hydroxyl or a carbonate")])
def test_a_narrow_absorption_is_no_band_of_a_pyroxene(centre: float, cause: str, width: float) -> None:
    record, doubt = measured((0.3, 1000.0, 300.0), (0.4, centre, width))
    assert record["bc2000_nm"] is None and not any(item and item["in_range"] for item in record["chemistry"].values())
    status = record["band2000_status"]
    at, wide = (
        float(text.split()[k]) for text, k in ((status.partition(" at ")[2], 0), (status.partition(", ")[2], 0))
    )
    assert abs(at - centre) <= 10 and abs(wide - width) <= 15 and cause in status
    assert "pyroxene is open" in bands_verdict(record) and "a narrow absorption" in doubt
    assert record["band2000_status"].endswith("no pyroxene's in 15 of 16 laboratory spectra with such a one")


@pytest.mark.parametrize("centre", [1850.0, 1950.0, 2050.0, 2150.0, 2250.0, 2320.0])
def test_bands_as_wide_as_those_of_pyroxenes_stay(centre: float) -> None:
    """The narrowest is that of OPX 2 less two standard deviations of its prior (`mgm_bands.csv`)."""
    for seed, width in enumerate((400.0, 500.0, 600.0, 700.0)):
        record, doubt = measured((0.4, 960.0, 210.0), (0.3, centre, width), seed=seed)
        assert record["bc2000_nm"] is not None and "narrow" not in record["band2000_status"] and not doubt


def test_water_beside_a_pyroxene_is_said_and_leaves_its_band() -> None:
    record, doubt = measured(*OPX, (0.05, 1415.0, 55.0), (0.12, 1920.0, 95.0))
    assert record["bc2000_nm"] is not None and not doubt
    assert "in it a narrow absorption at 1920 nm" in record["band2000_status"]
    assert "narrow" not in measured(*OPX)[0]["band2000_status"]


@pytest.mark.parametrize("step", [5.0, 20.0])
def test_noise_makes_no_narrow_absorption(step: float) -> None:
    nm = np.arange(450.0, 2451.0, step)
    rows = np.array([made_up(*OPX, seed=seed, noise=0.03, nm=nm)[1] for seed in range(400)])
    one = np.ones(len(rows))
    share = narrow_absorptions(nm, rows, 1900.0 * one, 0.1 * one)[2]
    assert np.mean(share > 0) < 0.01


def test_a_spectrum_is_judged_alike_in_any_company() -> None:
    rows = np.array([made_up(*bands, seed=7)[1] for bands in (OPX, (OPX[0], *WATER), OPX)])
    together, alone = arrays(GRID, rows), [arrays(GRID, rows[k : k + 1]) for k in range(3)]
    for name in ("numbers", "codes"):
        np.testing.assert_array_equal(getattr(together, name), np.concatenate([getattr(one, name) for one in alone]))
    assert np.isnan(together.bands["2000"].center_nm).tolist() == [False, True, False]


def test_glass_and_spinel_leave_pyroxene_open() -> None:
    """Glass as in Horgan et al. (2014): 1 um at 1060-1200 nm, 2 um at 1900-2050 nm; spinel as in Pieters et al."""
    glass, _ = measured((0.3, 1100.0, 450.0), (0.12, 1950.0, 560.0))
    assert "those of glass" in bands_verdict(glass)
    for bands in (((0.4, 2000.0, 550.0),), ((0.06, 1000.0, 200.0), (0.4, 2000.0, 550.0))):
        spinel, _ = measured(*bands)
        assert "pyroxene is open" in bands_verdict(spinel) and "spinel" in bands_verdict(spinel)
    assert not other_cause(measured(*OPX)[0])


def test_a_pyroxene_that_is_open_is_never_sure() -> None:
    for chances in ({"CPX": 1.0}, {"OPX": 0.5, "CPX": 0.5}, {"OL-CPX": 1.0}):
        found = standing(chances, None, (), "a reason")
        assert not {"pyroxene", "orthopyroxene", "clinopyroxene"} & set(found["sure"])
        assert "pyroxene is fitted, but open: a reason" in verdict(chances, None, (), "a reason")
        assert not any(
            "is sure" in part for part in verdict(chances, None, (), "a reason").split("; ") if part[:2] != "no"
        )
    assert "a reason" not in verdict({"OL": 1.0}, None, (), "a reason")


def test_a_fit_does_not_call_water_a_sure_pyroxene() -> None:
    found = lunarsci.fit(
        [made_up((0.1, 1250.0, 450.0), *WATER), made_up(*OPX, (0.12, 1920.0, 95.0))], assemblage="auto"
    )
    wet, pyroxene = (record["choice"] for record in found.to_dict()["spectra"])
    assert not {"pyroxene", "orthopyroxene", "clinopyroxene"} & set(wet["sure"]) and not wet["strong"]
    assert "narrow absorption at 1920 nm" in wet["status"] and "not decided" in found.untrusted
    assert {"orthopyroxene", "clinopyroxene", "pyroxene"} & set(pyroxene["sure"])
    assert "in the 2 µm band a narrow absorption at 1920 nm" in pyroxene["status"]


@pytest.mark.reference
def test_narrow_absorptions_of_laboratory_and_rover_spectra(reference_data: Path) -> None:
    """What stands in `BAND_SHARE`: on the suites that were not looked at for it, and on Chang'E-4."""
    counts = {"pyroxene": [0, 0], "none": [0, 0]}
    folders = [reference_data / "spectra" / name for name in ("relab", "minerals", "meteorites")]
    manifests = [pd.read_csv(folder / "manifest.csv").set_index("id")[VOLUMES].fillna(0.0) for folder in folders]
    suites = sorted({name[:2] for manifest in manifests for name in manifest.index})[1::2]
    for folder, manifest in zip(folders, manifests, strict=True):
        table = pd.read_csv(folder / "reflectance.csv").set_index("wavelength_nm").dropna(axis=1)
        names = [name for name in table if name[:2] in suites]
        bands = arrays(table.index.to_numpy(float), table[names].to_numpy().T).bands["2000"]
        for name, centre, narrow in zip(names, bands.center_nm, bands.narrow_nm, strict=True):
            share = manifest.loc[name].sum()
            kind = "pyroxene" if share >= 0.1 else "none"
            if (np.isfinite(centre) or np.isfinite(narrow)) and not 0 < share < 0.1:
                counts[kind][0] += np.isnan(centre)
                counts[kind][1] += 1
    assert counts == {"pyroxene": [1, 80], "none": [15, 25]}, f"a share of {BAND_SHARE} or more"
    rover = lunarsci.bands(str(reference_data / "spectra/ce4/reflectance_factor.csv")).to_dict()["spectra"]
    assert len(rover) == 88 and not any("narrow" in record["band2000_status"] for record in rover)
