"""Unmixing against numerical derivatives, sampled posteriors and mixtures made by other code."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.optimize import least_squares

from lunarsci.errors import DataError, ParameterError
from lunarsci.spectra.abundance.end_members import embedded_end_members
from lunarsci.spectra.abundance.estimate import METHODS, estimate_abundance
from lunarsci.spectra.abundance.hapke import HapkeSurface
from lunarsci.spectra.abundance.mixing import Absorbance, Albedo, MixingLaw
from lunarsci.spectra.abundance.population import population
from lunarsci.spectra.abundance.unmix import NEUTRAL, _Problem, softmax, unmix
from lunarsci.spectra.library import EndMember
from lunarsci.spectra.spectrum import FloatArray, Spectrum

GRID = np.arange(460.0, 2441.0, 20.0)
LAWS: list[MixingLaw] = [Albedo(HapkeSurface()), Absorbance()]
MINERALS = ("olivine", "orthopyroxene", "clinopyroxene")
SHARES = np.array([0.5, 0.3, 0.2])


def own() -> dict[str, EndMember]:
    """One end member of each mineral: its first in the table."""
    found: dict[str, EndMember] = {}
    for item in embedded_end_members(np.arange(450.0, 2451.0, 5.0)):
        found.setdefault(str(item.mineral), item)
    return found


def hapke_mixture(end_members: dict[str, EndMember], shares: FloatArray) -> FloatArray:
    """By bisection for w and the formula written out: incidence 30, emission 0 deg, isotropic."""
    mu0 = np.cos(np.pi / 6)

    def reflectance(w: FloatArray) -> FloatArray:
        g = np.sqrt(1 - w)
        h = [(1 + 2 * x) / (1 + 2 * x * g) for x in (mu0, 1.0)]
        return np.asarray(w / (4 * (mu0 + 1)) * h[0] * h[1])

    mixed = 0.0
    for mineral, share in zip(MINERALS, shares, strict=True):
        wanted = end_members[mineral].reflectance
        low, high = np.zeros_like(wanted), np.ones_like(wanted)
        for _ in range(60):
            middle = (low + high) / 2
            below = reflectance(middle) < wanted
            low, high = np.where(below, middle, low), np.where(below, high, middle)
        mixed = mixed + share * low
    return reflectance(np.asarray(mixed))


@pytest.mark.parametrize("law", LAWS, ids=lambda law: law.name)
def test_a_law_undoes_itself_and_has_its_derivatives(law: MixingLaw) -> None:
    reflectance = np.linspace(0.03, 0.85, 40)
    element = law.element(reflectance)
    mixed, slope = law.mixing(element)
    ln_reflectance, by_mixed = law.ln_reflectance(mixed)
    assert np.exp(ln_reflectance) == pytest.approx(reflectance, rel=1e-4)
    ends = [law.ln_reflectance(law.mixing(element + step)[0])[0] for step in (-1e-3, 1e-3)]
    assert by_mixed * slope == pytest.approx((ends[1] - ends[0]) / 2e-3, rel=2e-2)


@pytest.mark.parametrize("law", LAWS, ids=lambda law: law.name)
def test_derivatives_of_the_model_agree_with_differences(law: MixingLaw) -> None:
    library = embedded_end_members(GRID)
    minerals = [population(name, library, GRID, law) for name in MINERALS]
    u = GRID / 1e3 - 1.45
    problem = _Problem(law, minerals, np.array([u**0, u, u**2]), np.zeros_like(u), np.ones_like(u))
    point = np.random.default_rng(0).normal(scale=0.3, size=problem.size)
    jacobian = problem.model(point)[1]
    assert len(NEUTRAL) == 3
    for k in range(problem.size):
        step = np.zeros(problem.size)
        step[k] = 1e-3
        difference = (problem.model(point + step)[0] - problem.model(point - step)[0]) / 2e-3
        assert np.allclose(jacobian[k], difference, rtol=0.03, atol=1e-3 * np.abs(jacobian).max()), k


def test_a_mixture_of_the_end_members_themselves_is_found_in_full() -> None:
    """Made by the same physics written out; the level and the neutral part are free, so a little is lost to them."""
    ends = own()
    spectrum = Spectrum("made", ends["olivine"].wavelength_nm, hapke_mixture(ends, SHARES))
    found = estimate_abundance(spectrum, MINERALS, method="hapke", end_members=list(ends.values()), model_error=0.002)
    assert [item.fraction for item in found.fractions] == pytest.approx(SHARES, abs=0.03)
    assert found.in_domain
    for item, share in zip(found.fractions, SHARES, strict=True):
        assert item.low95 <= share <= item.high95


def test_absorbance_mixes_as_written() -> None:
    ends = own()
    ln_reflectance = sum(share * np.log(ends[name].reflectance) for name, share in zip(MINERALS, SHARES, strict=True))
    spectrum = Spectrum("made", ends["olivine"].wavelength_nm, np.exp(ln_reflectance))
    library = list(ends.values())
    right = estimate_abundance(spectrum, MINERALS, method="absorbance", end_members=library, model_error=0.002)
    assert [item.fraction for item in right.fractions] == pytest.approx(SHARES, abs=0.03)
    wrong = estimate_abundance(spectrum, MINERALS, method="hapke", end_members=library, model_error=0.002)
    both = estimate_abundance(spectrum, MINERALS, method="unmix", end_members=library, model_error=0.002)
    assert wrong.rms_ln is not None
    assert right.rms_ln is not None
    assert wrong.rms_ln > 3 * right.rms_ln
    assert [i.fraction for i in both.fractions] == pytest.approx([i.fraction for i in right.fractions], abs=0.01)


def test_the_minimum_is_that_of_scipy() -> None:
    law = LAWS[0]
    library = embedded_end_members(GRID)
    minerals = [population(name, library, GRID, law) for name in MINERALS]
    reflectance = np.exp(np.interp(GRID, own()["olivine"].wavelength_nm, np.log(hapke_mixture(own(), SHARES))))
    sigma = np.full(GRID.size, 0.02)
    found = unmix(GRID, reflectance, sigma, minerals, law)
    u = GRID / 1e3 - 1.45
    neutral = np.array([np.ones_like(u), u, u**2 - np.mean(u**2)])
    problem = _Problem(law, minerals, neutral, np.log(reflectance), 1 / sigma)
    scale = problem.scaled()

    def rows(point: FloatArray) -> FloatArray:
        return np.concatenate([(problem.model(point)[0] - problem.ln_reflectance) / sigma, point / scale])

    starts = np.zeros((4, problem.size))
    starts[[0, 1, 2], [0, 1, 2]] = 2.0
    best = min((least_squares(rows, start) for start in starts), key=lambda end: float(end.cost))
    assert found.objective == pytest.approx(2 * best.cost, rel=2e-3)
    assert softmax(found.logits) == pytest.approx(softmax(best.x[:3]), abs=0.01)


def test_one_end_member_varies_in_level_only() -> None:
    law = LAWS[0]
    single = population("olivine", [own()["olivine"]], GRID, law)
    assert single.shapes.shape == (1, GRID.size)
    assert np.ptp(single.shapes) == 0
    assert single.mean == pytest.approx(
        law.element(np.interp(GRID, own()["olivine"].wavelength_nm, own()["olivine"].reflectance))
    )


def test_a_population_has_the_covariance_of_its_shapes() -> None:
    """Without the level, the leading shapes give back most of the scatter of the end members."""
    law = LAWS[1]
    library = [replace(item, fo=None, fs=None) for item in embedded_end_members(GRID)]
    found = population("clinopyroxene", library, GRID, law)
    element = law.element(np.array([item.reflectance for item in library if item.mineral == "clinopyroxene"]))
    apart = element - element.mean(axis=1, keepdims=True)
    shapes = found.shapes[:-1] - found.shapes[:-1].mean(axis=1, keepdims=True)
    explained = (shapes**2).sum() / apart.var(axis=0).sum()
    assert 0.9 < explained <= 1.0 + 1e-9


@pytest.mark.parametrize("method", METHODS)
def test_shares_sum_to_one_and_lie_in_their_intervals(method: str) -> None:
    ends = own()
    noise = np.random.default_rng(1).normal(scale=0.005, size=ends["olivine"].wavelength_nm.size)
    reflectance = hapke_mixture(ends, SHARES) * np.exp(noise)
    found = estimate_abundance(Spectrum("made", ends["olivine"].wavelength_nm, reflectance), MINERALS, method=method)
    assert sum(item.fraction for item in found.fractions) == pytest.approx(1.0)
    for item in found.fractions:
        assert 0 <= item.low95 <= item.low <= item.fraction <= item.high <= item.high95 <= 1
    assert found.correlation is not None
    assert np.allclose(np.diag(found.correlation), 1)
    again = estimate_abundance(Spectrum("made", ends["olivine"].wavelength_nm, reflectance), MINERALS, method=method)
    assert again.fractions == found.fractions


def test_units_order_and_a_mask_do_not_matter() -> None:
    ends = own()
    wavelength = ends["olivine"].wavelength_nm
    reflectance = hapke_mixture(ends, SHARES)
    mask = np.arange(wavelength.size) % 40 == 7
    spoiled = np.where(mask, 3.0, reflectance)
    first = estimate_abundance(Spectrum("a", wavelength[~mask], reflectance[~mask]), MINERALS)
    second = estimate_abundance(Spectrum("a", wavelength, spoiled, mask=mask), MINERALS)
    assert first.fractions == second.fractions


def test_a_spectrum_of_something_else_is_out_of_domain() -> None:
    wavelength = own()["olivine"].wavelength_nm
    strange = 0.2 + 0.1 * np.sin(wavelength / 60)
    found = estimate_abundance(Spectrum("strange", wavelength, strange), MINERALS)
    assert not found.in_domain
    assert "out of domain" in found.status


@pytest.mark.parametrize(
    ("options", "error"),
    [
        ({"minerals": ("olivine",)}, ParameterError),
        ({"minerals": ("olivine", "olivine")}, ParameterError),
        ({"minerals": ("olivine", "cheese")}, ParameterError),
        ({"method": "magic"}, ParameterError),
        ({"model_error": 0.0}, ParameterError),
        ({"spectrum": Spectrum("short", np.arange(800.0, 1200.0, 5), np.full(80, 0.2))}, DataError),
    ],
)
def test_impossible_requests_are_refused(options: dict[str, object], error: type[Exception]) -> None:
    wavelength = own()["olivine"].wavelength_nm
    arguments: dict[str, object] = {"spectrum": Spectrum("flat", wavelength, np.full(wavelength.size, 0.2))}
    arguments |= {"minerals": MINERALS} | options
    with pytest.raises(error):
        estimate_abundance(**arguments)  # type: ignore[arg-type]
