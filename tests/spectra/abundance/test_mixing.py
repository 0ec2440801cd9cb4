"""Hapke's reflectance against closed forms, an exact solution, and its own inverse.

Submicroscopic iron: its absorption against Rayleigh's formula, its effect on a spectrum.
"""

import numpy as np
import pytest

from lunarsci.spectra.abundance.mixing import GRAIN_INDEX, Albedo, HapkeSurface, Weathering, iron_absorption
from lunarsci.spectra.spectrum import Spectrum
from tests.spectra.abundance.test_estimate import MINERALS, SHARES, made, one


@pytest.mark.parametrize(("incidence", "emission"), [(30, 0), (0, 0), (60, 45)])
def test_without_absorption_it_is_the_closed_form(incidence: float, emission: float) -> None:
    """w = 1: H(x) = 1 + 2 x, so R = (1 + 2 m0)(1 + 2 m) / (4 (m0 + m))."""
    mu0, mu = np.cos(np.radians([incidence, emission]))
    expected = (1 + 2 * mu0) * (1 + 2 * mu) / (4 * (mu0 + mu))
    assert HapkeSurface(incidence, emission).reflectance(np.array([1.0]))[0] == pytest.approx(expected)


def test_dark_grains_scatter_once() -> None:
    """R goes to w / (4 (m0 + m)) where w goes to 0."""
    albedo = np.array([1e-5])
    surface = HapkeSurface(30, 0)
    mu0 = np.cos(np.radians(30))
    assert surface.reflectance(albedo)[0] == pytest.approx(1e-5 / (4 * (mu0 + 1)), rel=1e-3)


@pytest.mark.parametrize(("albedo", "cosine"), [(0.5, 0.5), (0.9, 0.5), (0.99, 1.0)])
def test_h_is_within_four_per_cent_of_chandrasekhar(albedo: float, cosine: float) -> None:
    """H of isotropic scattering by iteration of 1 / H(m) = (1 - w)^1/2 + w / 2 int n H(n) / (m + n) dn."""
    nodes, weights = np.polynomial.legendre.leggauss(200)
    x, weight = (nodes + 1) / 2, weights / 2
    h = np.ones_like(x)
    for _ in range(2000):
        kernel = (weight * x * h / (x[:, None] + x)).sum(axis=1)
        h = 1 / (np.sqrt(1 - albedo) + albedo / 2 * kernel)
    solved = 1 / (np.sqrt(1 - albedo) + albedo / 2 * (weight * x * h / (cosine + x)).sum())
    gamma = np.sqrt(1 - albedo)
    assert (1 + 2 * cosine) / (1 + 2 * cosine * gamma) == pytest.approx(solved, rel=0.04)
    angle = np.degrees(np.arccos(cosine))
    both = HapkeSurface(angle, angle).reflectance(np.array([albedo]))[0] if angle < 90 else np.nan
    assert both == pytest.approx(albedo / (8 * cosine) * solved**2, rel=0.08)


def test_albedo_undoes_reflectance() -> None:
    surface = HapkeSurface()
    albedo = np.linspace(0.02, 0.9999, 50)
    assert surface.albedo(surface.reflectance(albedo)) == pytest.approx(albedo, abs=1e-6)
    ln_reflectance, slope = surface.ln_reflectance(albedo[:-1])
    assert np.exp(ln_reflectance) == pytest.approx(surface.reflectance(albedo[:-1]), rel=1e-4)
    ends = [np.log(surface.reflectance(albedo[:-1] + step)) for step in (-1e-6, 1e-6)]
    assert slope == pytest.approx((ends[1] - ends[0]) / 2e-6, rel=2e-2)


GRID = np.arange(460.0, 2441.0, 20.0)


def test_absorption_is_that_of_small_spheres() -> None:
    """Rayleigh: proportional to Im((m^2 - 1) / (m^2 + 2)) / wavelength, m relative to the grain."""
    index = {500.0: 1.996 + 3.067j, 1000.0: 2.868 + 4.192j, 2000.0: 3.483 + 6.879j}

    def sphere(wavelength: float) -> float:
        m = index[wavelength] / GRAIN_INDEX
        return float(((m**2 - 1) / (m**2 + 2)).imag / wavelength)

    expected = [sphere(wavelength) / sphere(1000.0) for wavelength in index]
    assert iron_absorption(np.array(list(index))) == pytest.approx(expected, rel=1e-12)


def test_iron_darkens_and_reddens() -> None:
    weathering = Weathering(iron_absorption(GRID))
    albedo = np.full((1, GRID.size), 0.9)
    surface = HapkeSurface()
    fresh = surface.reflectance(albedo)[0]
    old = surface.reflectance(weathering.darken(albedo, np.zeros(1))[0])[0]
    assert (old < fresh).all()
    assert (np.diff(old / fresh) > 0).all()


@pytest.mark.parametrize("amount", [0.0, 1.0])
def test_iron_of_a_usual_soil_absorbs_by_the_law_before_any_spectrum(amount: float) -> None:
    """(1 - w) / w grows at 1000 nm by a logarithm of -1 with a deviation of 1.5."""
    weathering = Weathering(iron_absorption(np.array([1000.0])))
    darker = weathering.darken(np.array([[0.9]]), np.array([amount]))[0]
    assert 1 / darker[0, 0] - 1 / 0.9 == pytest.approx(np.exp(-1.0 + 1.5 * amount))


def test_derivatives_are_differences() -> None:
    weathering = Weathering(iron_absorption(GRID))
    albedo, amount = np.linspace(0.3, 0.99, GRID.size)[None], np.array([0.4])
    _, by_albedo, by_amount = weathering.darken(albedo, amount)
    step = 1e-6
    up, down = (weathering.darken(albedo + sign * step, amount)[0] for sign in (1, -1))
    assert by_albedo == pytest.approx((up - down) / (2 * step), rel=1e-6)
    up, down = (weathering.darken(albedo, amount + sign * step)[0] for sign in (1, -1))
    assert by_amount == pytest.approx((up - down) / (2 * step), rel=1e-6)


def test_a_weathered_mixture_is_found_with_iron_and_missed_without() -> None:
    fresh = made(SHARES)
    law = Albedo(HapkeSurface())
    albedo = law.surface.albedo(fresh.reflectance)[None]
    channels = np.clip(fresh.wavelength_nm, 450, 2500)
    darker = Weathering(iron_absorption(channels)).darken(albedo, np.array([0.3]))[0]
    old = Spectrum("old", fresh.wavelength_nm, law.surface.reflectance(darker)[0])
    errors = {}
    for iron in (True, False):
        found = one(old, MINERALS, method="hapke", iron=iron)
        errors[iron] = max(abs(one.fraction - share) for one, share in zip(found, SHARES, strict=True))
    assert errors[True] < 0.15 < errors[False]
