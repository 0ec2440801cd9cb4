"""Hapke's reflectance against closed forms, an exact solution, and its own inverse."""

import numpy as np
import pytest

from lunarsci.errors import ParameterError
from lunarsci.spectra.abundance.mixing import HapkeSurface


@pytest.mark.parametrize(("incidence", "emission"), [(30, 0), (0, 0), (60, 45)])
def test_without_absorption_it_is_the_closed_form(incidence: float, emission: float) -> None:
    """w = 1: H(x) = 1 + 2 x, so R = (1 + 2 m0)(1 + 2 m) / (4 (m0 + m))."""
    mu0, mu = np.cos(np.radians([incidence, emission]))
    expected = (1 + 2 * mu0) * (1 + 2 * mu) / (4 * (mu0 + mu))
    assert HapkeSurface(incidence, emission).reflectance(np.array([1.0]))[0] == pytest.approx(expected)


def test_dark_grains_scatter_once() -> None:
    """R goes to w P / (4 (m0 + m)) where w goes to 0."""
    albedo = np.array([1e-5])
    surface = HapkeSurface(30, 0, phase=1.7)
    mu0 = np.cos(np.radians(30))
    assert surface.reflectance(albedo)[0] == pytest.approx(1e-5 * 1.7 / (4 * (mu0 + 1)), rel=1e-3)


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


@pytest.mark.parametrize("filling", [0.0, 0.3, 0.6])
def test_albedo_undoes_reflectance(filling: float) -> None:
    surface = HapkeSurface(filling=filling)
    albedo = np.linspace(0.02, 0.9999, 50)
    assert surface.albedo(surface.reflectance(albedo)) == pytest.approx(albedo, abs=1e-6)
    ln_reflectance, slope = surface.ln_reflectance(albedo[:-1])
    assert np.exp(ln_reflectance) == pytest.approx(surface.reflectance(albedo[:-1]), rel=1e-4)
    ends = [np.log(surface.reflectance(albedo[:-1] + step)) for step in (-1e-6, 1e-6)]
    assert slope == pytest.approx((ends[1] - ends[0]) / 2e-6, rel=2e-2)


def test_denser_packing_is_brighter() -> None:
    """Hapke (2008): K grows with the filling, and with it the reflectance of dark grains."""
    albedo = np.array([0.2, 0.5])
    loose, dense = (HapkeSurface(filling=filling).reflectance(albedo) for filling in (0.1, 0.5))
    assert np.all(dense > loose)
    assert HapkeSurface(filling=1e-9).porosity_factor == pytest.approx(1.0, abs=1e-5)


@pytest.mark.parametrize("wrong", [{"incidence_deg": 90}, {"emission_deg": -1}, {"phase": 0}, {"filling": 0.8}])
def test_impossible_surfaces_are_refused(wrong: dict[str, float]) -> None:
    with pytest.raises(ParameterError):
        HapkeSurface(**wrong)
