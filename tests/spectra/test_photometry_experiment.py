"""Which correction makes one surface look the same from everywhere: a synthetic stand-in for a measured experiment.

Chang'E-4 looked at two patches on lunar day 10 (23 spectra, incidence 57-77, emission 48.3 and 44.4, phase 55-112 deg).
On these, the scatter of ln REFF within the patches was, at 750 and 1500 nm: uncorrected 0.057/0.051 and 0.045/0.043;
Lommel-Seeliger with its own best quadratic f(g) 0.064/0.060 and 0.068/0.059; Akimov with the bright SELENE group
0.018/0.020 and 0.011/0.010. The angles and the surface here are synthetic: the angles fill the same ranges, the
surface follows Akimov times the bright group, computed channel by channel and apart from the code under test.
"""

import math
from collections.abc import Callable

import numpy as np
import pytest

from lunarsci.spectra.photometry import DISKS, Geometry, correction_factor, phase_function

CHANNELS = {750.0: (0.997, 0.0892, -0.253, 0.199), 1500.0: (0.714, 0.1238, -0.308, 0.164)}
ALBEDO = (0.10, 0.12)
EMISSION = (48.3, 44.4)
COUNT = (12, 11)


def geometries() -> list[tuple[int, Geometry]]:
    """Patch and angles: phase evenly over 55-112 deg where a triangle allows, incidence by the golden section."""
    golden = (math.sqrt(5) - 1) / 2
    found = []
    for patch, (count, emission) in enumerate(zip(COUNT, EMISSION, strict=True)):
        for k in range(count):
            incidence = 57 + 20 * ((k + 1) * golden % 1)
            low, high = max(55.0, abs(incidence - emission) + 0.1), min(112.0, incidence + emission - 0.1)
            found.append((patch, Geometry(incidence, emission, low + (high - low) * k / (count - 1))))
    return found


SEEN = geometries()
PATCH = np.array([patch for patch, _ in SEEN])


def surface(patch: int, i: float, e: float, g: float, channel: tuple[float, float, float, float]) -> float:
    """REFF of the synthetic surface."""
    b0, h, c, asymmetry = channel
    i, e, g = (math.radians(angle) for angle in (i, e, g))
    longitude = math.atan((math.cos(i) / math.cos(e) - math.cos(g)) / math.sin(g))
    latitude = math.acos(min(math.cos(e) / math.cos(longitude), 1.0))
    disk = math.cos(g / 2) * math.cos(math.pi / (math.pi - g) * (longitude - g / 2))
    disk *= math.cos(latitude) ** (g / (math.pi - g)) / math.cos(longitude)
    lobes = [(1 - x * x) / (1 + x * x - 2 * x * math.cos(g)) ** 1.5 for x in (asymmetry, -asymmetry)]
    phase = (1 + b0 / (1 + math.tan(g / 2) / h)) * ((1 - c) / 2 * lobes[0] + (1 + c) / 2 * lobes[1])
    return ALBEDO[patch] * disk * phase / math.cos(i)


def observed(wavelength_nm: float) -> np.ndarray:
    channel = CHANNELS[wavelength_nm]
    return np.log([surface(p, g.incidence_deg, g.emission_deg, g.phase_deg, channel) for p, g in SEEN])


def corrected(wavelength_nm: float, disk: str, phase: str) -> np.ndarray:
    factors = [correction_factor(g, np.array([wavelength_nm]), disk, phase_function(phase))[0] for _, g in SEEN]
    return observed(wavelength_nm) + np.log(factors)


def scatter(values: np.ndarray) -> float:
    """The larger of the standard deviations within the two patches."""
    return max(float(np.std(values[patch == PATCH])) for patch in (0, 1))


def own_quadratic(values: np.ndarray) -> np.ndarray:
    """Residuals of the best quadratic in g common to both patches, whose albedos are free."""
    phase = np.array([g.phase_deg for _, g in SEEN])
    basis = np.column_stack([PATCH == 0, PATCH == 1, phase, phase**2]).astype(float)
    return values - basis @ np.linalg.lstsq(basis, values, rcond=None)[0]


def test_there_are_23_geometries_in_the_ranges_of_the_experiment() -> None:
    assert len(SEEN) == 23
    ranges: dict[str, tuple[Callable[[Geometry], float], float, float]] = {
        "incidence": (lambda g: g.incidence_deg, 57, 77),
        "phase": (lambda g: g.phase_deg, 55, 112),
    }
    for angle, low, high in ranges.values():
        values = [angle(g) for _, g in SEEN]
        assert low <= min(values) < low + 3 and high - 3 < max(values) <= high


@pytest.mark.parametrize("wavelength_nm", CHANNELS)
def test_lommel_seeliger_fails_with_any_one_phase_function(wavelength_nm: float) -> None:
    assert 0.06 < scatter(own_quadratic(corrected(wavelength_nm, "lommel-seeliger", "flat"))) < 0.10
    for phase in ("flat", "sp-low", "sp-mid", "sp-high"):
        assert scatter(corrected(wavelength_nm, "lommel-seeliger", phase)) > 0.08


@pytest.mark.parametrize("wavelength_nm", CHANNELS)
def test_the_right_model_flattens_and_finds_the_albedos(wavelength_nm: float) -> None:
    values = corrected(wavelength_nm, "akimov", "sp-high")
    assert scatter(values) < 0.011  # what smoothing over wavelength costs: the true surface has single channels
    difference = values[PATCH == 1].mean() - values[PATCH == 0].mean()
    assert difference == pytest.approx(math.log(ALBEDO[1] / ALBEDO[0]), abs=0.003)
    assert scatter(own_quadratic(corrected(wavelength_nm, "akimov", "flat"))) < 0.002


@pytest.mark.parametrize("wavelength_nm", CHANNELS)
def test_the_order_of_the_models(wavelength_nm: float) -> None:
    best = scatter(corrected(wavelength_nm, "akimov", "sp-high"))
    near = scatter(corrected(wavelength_nm, "akimov", "sp-mid"))
    none = scatter(observed(wavelength_nm))
    others = [scatter(corrected(wavelength_nm, disk, "sp-mid")) for disk in ("lommel-seeliger", "mcewen")]
    assert best < near < min(none, *others)
    assert 0.07 < none < 0.10
    assert all(0.08 < other < 0.16 for other in others)
    quadratics = {d: scatter(own_quadratic(corrected(wavelength_nm, d, "flat"))) for d in DISKS}
    assert quadratics["akimov"] < 0.1 * quadratics["mcewen"] < 0.1 * quadratics["lommel-seeliger"]
