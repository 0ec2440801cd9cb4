"""Band centre, depth and area on spectra whose bands are known, and their errors against repeated noise."""

import numpy as np
import pytest

from lunarsci.errors import DataError
from lunarsci.spectra.bands import BandFailure, SpectrumBands, measure_bands, measure_batch
from lunarsci.spectra.spectrum import Spectrum

GRID = np.arange(450.0, 2396.0, 5.0)
CENTRE_1, CENTRE_2, WIDTH_1, WIDTH_2 = 947.0, 1983.0, 70.0, 110.0


def reflectance(depth_1: float = 0.30, depth_2: float = 0.20) -> np.ndarray:
    """Two symmetric bands under a straight line; hull and linear continua recover the line."""
    bands = 1 - depth_1 * np.exp(-0.5 * ((GRID - CENTRE_1) / WIDTH_1) ** 2)
    bands *= 1 - depth_2 * np.exp(-0.5 * ((GRID - CENTRE_2) / WIDTH_2) ** 2)
    return (0.10 + 4e-5 * GRID) * bands


def measured(values: np.ndarray, **options: object) -> SpectrumBands:
    return measure_bands(Spectrum("known", GRID, values), **options)  # type: ignore[arg-type]


@pytest.mark.parametrize("name", ["hull", "linear", "conic"])
def test_symmetric_bands_are_found_where_they_are(name: str) -> None:
    bands = measured(reflectance(), continuum_name=name).bands
    assert bands["1000"].center_nm == pytest.approx(CENTRE_1, abs=1.0)
    assert bands["2000"].center_nm == pytest.approx(CENTRE_2, abs=2.0)
    assert bands["1000"].depth == pytest.approx(0.30, abs=0.005)
    assert bands["2000"].depth == pytest.approx(0.20, abs=0.005)


def test_area_is_the_integral_of_the_band() -> None:
    bands = measured(reflectance(), continuum_name="hull").bands
    assert bands["1000"].area_nm == pytest.approx(0.30 * WIDTH_1 * np.sqrt(2 * np.pi), rel=0.02)
    assert bands["2000"].area_nm == pytest.approx(0.20 * WIDTH_2 * np.sqrt(2 * np.pi), rel=0.02)


def test_results_do_not_depend_on_brightness() -> None:
    dark, bright = (measured(factor * reflectance(), continuum_name="hull").to_dict() for factor in (1.0, 3.7))
    for key in ("bc1000_nm", "bd1000", "ba2000_nm", "bc2000_sigma_nm"):
        assert bright[key] == pytest.approx(dark[key], rel=1e-9)


@pytest.mark.slow
@pytest.mark.parametrize("name", ["hull", "conic"])
def test_standard_errors_are_the_scatter_of_repeated_measurements(name: str) -> None:
    rng, noise = np.random.default_rng(5), 0.0012
    sigma = np.full(GRID.size, noise)
    rows = []
    for _ in range(400):
        spectrum = Spectrum("n", GRID, reflectance() + rng.normal(scale=noise, size=GRID.size), sigma)
        rows.append(measure_bands(spectrum, continuum_name=name).to_dict())
    for value, error in (
        ("bc1000_nm", "bc1000_sigma_nm"),
        ("bc2000_nm", "bc2000_sigma_nm"),
        ("bd1000", "bd1000_sigma"),
        ("ba1000_nm", "ba1000_sigma_nm"),
        ("ba2000_nm", "ba2000_sigma_nm"),
    ):
        scatter = np.std([row[value] for row in rows], ddof=1)
        assert np.median([row[error] for row in rows]) == pytest.approx(scatter, rel=0.2), value


@pytest.mark.parametrize("seed", range(12))
def test_no_band_is_said_and_not_invented(seed: int) -> None:
    rng = np.random.default_rng(seed)
    flat = Spectrum("flat", GRID, 0.2 + rng.normal(scale=0.002, size=GRID.size), np.full(GRID.size, 0.002))
    record = measure_bands(flat, continuum_name="hull").to_dict()
    for key in ("1000", "2000"):
        assert record[f"bc{key}_nm"] is None
        assert record[f"band{key}_status"].startswith("no ")


def test_a_constant_has_no_band() -> None:
    record = measured(np.full(GRID.size, 0.1)).to_dict()
    assert record["bc1000_nm"] is None
    assert record["bc2000_nm"] is None


def test_an_olivine_has_no_2_um_band() -> None:
    """One wide band at 1050 nm and a flat infrared, as olivine has."""
    values = 0.4 * (1 - 0.5 * np.exp(-0.5 * ((GRID - 1050) / 180) ** 2))
    record = measured(values).to_dict()
    assert record["bc1000_nm"] == pytest.approx(1050, abs=15)
    assert record["bc2000_nm"] is None


def test_the_conic_falls_back_where_it_falls_to_zero() -> None:
    """A convex spectrum turns the parabola down: it is below zero at 2 um."""
    bent = np.interp(GRID, [450, 700, 950, 1345, 1580, 2000, 2400], [0.30, 0.50, 0.25, 0.72, 0.60, 0.30, 0.55])
    record = measured(bent, smooth_points=0).to_dict()
    assert record["continuum"]["2000"] != "conic"
    assert "conic not used" in record["band2000_note"]
    assert record["bc2000_nm"] == pytest.approx(2000, abs=30)


def test_the_conic_is_not_used_where_it_runs_away() -> None:
    """A spectrum that bends upwards at 1.5 um: the parabola leaves it far below and would put the band at 2.3 um."""
    bands = 1 - 0.3 * np.exp(-0.5 * ((GRID - CENTRE_1) / WIDTH_1) ** 2)
    bands *= 1 - 0.05 * np.exp(-0.5 * ((GRID - CENTRE_2) / WIDTH_2) ** 2)
    line = 0.05 + 0.10 * ((GRID - 450) / 1130) ** 2
    values = np.where(GRID < 1580, line, 0.15 + 2e-5 * (GRID - 1580)) * bands
    record = measured(values).to_dict()
    assert record["continuum"]["2000"] == "hull"
    assert record["bc2000_nm"] == pytest.approx(CENTRE_2, abs=15)


def test_a_wide_asymmetric_band_is_fitted_near_its_minimum() -> None:
    """An olivine-like band: three Gaussians, whose common minimum is found directly on the noiseless curve."""
    ratio = np.exp(
        sum(
            -s * np.exp(-0.5 * ((GRID - c) / w) ** 2) for s, c, w in ((0.3, 860, 90), (0.5, 1045, 75), (0.4, 1215, 180))
        )
    )
    record = measured(0.5 * ratio, continuum_name="hull", smooth_points=11).to_dict()
    assert record["bc1000_nm"] == pytest.approx(GRID[np.argmin(ratio)], abs=8)


def test_a_short_spectrum_measures_what_it_holds() -> None:
    short = GRID < 1700
    record = measure_bands(Spectrum("short", GRID[short], reflectance()[short]), continuum_name="hull").to_dict()
    assert record["bc1000_nm"] == pytest.approx(CENTRE_1, abs=2)
    assert record["band2000_status"] == "no result: the spectrum covers 1580-1695 nm of it"


def test_masked_channels_are_left_out() -> None:
    spoiled = reflectance()
    spoiled[100:103] = 5.0
    mask = np.zeros(GRID.size, bool)
    mask[100:103] = True
    record = measure_bands(Spectrum("masked", GRID, spoiled, mask=mask), continuum_name="hull").to_dict()
    assert record["bc1000_nm"] == pytest.approx(CENTRE_1, abs=2)


def test_too_few_channels_is_an_error_alone_and_a_reason_in_a_batch() -> None:
    tiny = Spectrum("tiny", GRID[:8], reflectance()[:8])
    with pytest.raises(DataError, match="tiny: 8 usable channels"):
        measure_bands(tiny)
    failed, good = measure_batch([tiny, Spectrum("good", GRID, reflectance())])
    assert isinstance(failed, BandFailure)
    assert failed.status.startswith("no result: 8 usable")
    assert isinstance(good, SpectrumBands)
    assert failed.to_dict().keys() == good.to_dict().keys()
