"""ln Bayes factors of compositions against brute force: simulated rocks counted, and integrals on a grid."""

import numpy as np
import pytest
from scipy.stats import multivariate_normal, norm

from lunarsci.spectra.origin.composition import MINERALS, Composition
from lunarsci.spectra.origin.match import composition_evidence, ln_shares_broad, ln_shares_crater

ROCK = {"olivine": (0.25, 0.05), "orthopyroxene": (0.35, 0.06), "clinopyroxene": (0.40, 0.06)}


def evidence(rock: dict, crater: dict, systematic: float = 0.1) -> float:
    found = composition_evidence(
        Composition(rock), Composition(crater), systematic=systematic, band_systematic_nm=10
    ).ln_modes
    assert found is not None
    return found


@pytest.mark.parametrize("share", [0.03, 0.3, 0.7])
def test_two_minerals_against_a_grid(share: float) -> None:
    """One share x in 0..1: a truncated normal law times a normal error, and a uniform law, both by quadrature."""
    sigma, systematic = 0.04, 0.08
    rock = Composition(
        {"orthopyroxene": (share, sigma), "clinopyroxene": (1 - share, sigma)}, {}, np.array([[1.0, -1], [-1, 1]])
    )
    crater = Composition({"orthopyroxene": (0.4, 0.2), "clinopyroxene": (0.6, 0.2)}, {}, np.array([[1.0, -1], [-1, 1]]))
    found = composition_evidence(rock, crater, systematic=systematic, band_systematic_nm=10).ln_modes
    x = np.linspace(0, 1, 200_001)
    # A systematic of s in each mineral is s / sqrt(2) in the share: the difference counts, the sum is fixed.
    noise = np.hypot(sigma, systematic / np.sqrt(2))
    prior = norm.pdf(x, 0.4, 0.2)
    likelihood = norm.pdf(share, x, noise)
    expected = np.log((prior * likelihood).sum() / prior.sum()) - np.log(likelihood.mean())
    assert found == pytest.approx(expected, abs=0.01)


@pytest.mark.parametrize("mean", [(0.25, 0.35, 0.40), (0.05, 0.05, 0.90), (0.6, 0.3, 0.1)])
def test_three_minerals_against_a_sum_over_the_triangle(mean: tuple) -> None:
    """Normal laws in the plane of shares that add up to 1, over 250,000 even triangles; twice as fine moves 1e-4."""
    n = 500
    i, j = np.mgrid[:n, :n]
    first = np.column_stack([i[i + j < n], j[i + j < n]]) + 1 / 3
    second = np.column_stack([i[i + j < n - 1], j[i + j < n - 1]]) + 2 / 3
    pair = np.concatenate([first, second]) / n
    shares = np.column_stack([pair, 1 - pair.sum(axis=1)])
    plane = np.array([[1, -1, 0], [1, 1, -2]]) / np.sqrt([[2], [6]])
    seen, noise, scatter = np.array([0.25, 0.35, 0.40]), 0.1**2 * np.eye(3), 0.08**2 * (np.eye(3) - 1 / 3)
    measured = multivariate_normal(plane @ seen, plane @ noise @ plane.T).pdf(shares @ plane.T)
    crater = multivariate_normal(plane @ mean, plane @ scatter @ plane.T).pdf(shares @ plane.T)
    expected = np.log((measured * crater).sum() / crater.sum()), np.log(measured.mean())
    assert ln_shares_crater(seen, noise, np.array(mean), scatter) == pytest.approx(expected[0], abs=0.01)
    assert ln_shares_broad(seen, noise) == pytest.approx(expected[1], abs=0.001)


def test_axes_that_a_covariance_leaves_open_do_not_matter() -> None:
    """Equal variances have no axes of their own: a last digit, or another processor's eigenvectors, turns them."""
    seen, mean, noise = np.array([0.1, 0.2, 0.3, 0.4]), np.array([0.02, 0.1, 0.08, 0.8]), 0.1**2 * np.eye(4)
    rng = np.random.default_rng(0)
    found = []
    for _ in range(5):
        tilt = rng.standard_normal((4, 4))
        found.append(ln_shares_crater(seen, noise + 1e-16 * (tilt + tilt.T), mean, 0.08**2 * np.eye(4)))
    assert np.ptp(found) < 1e-9


def test_four_minerals_any_composition_against_drawn_rocks() -> None:
    rng = np.random.default_rng(2)
    seen, noise = np.array([0.02, 0.1, 0.08, 0.8]), 0.12**2 * np.eye(4)
    broad = rng.dirichlet(np.ones(4), 600_000)
    basis = np.linalg.svd(np.ones((1, 4)))[2][1:]
    kernel = multivariate_normal(basis @ seen, basis @ noise @ basis.T)
    assert ln_shares_broad(seen, noise) == pytest.approx(np.log(kernel.pdf(broad @ basis.T).mean()), abs=0.03)


def test_a_crater_like_the_rock_is_better_and_an_unlike_one_worse_and_precision_sharpens_both() -> None:
    like, unlike = dict(ROCK), {name: ROCK[other] for name, other in zip(ROCK, reversed(ROCK), strict=True)}
    far = {"olivine": (0.9, 0.03), "orthopyroxene": (0.05, 0.03), "clinopyroxene": (0.05, 0.03)}
    assert evidence(ROCK, like) > evidence(ROCK, unlike) > evidence(ROCK, far)
    assert evidence(ROCK, like) > 0 > evidence(ROCK, far)
    assert evidence(ROCK, like, 0.0) > evidence(ROCK, like, 0.2)
    assert evidence(ROCK, far, 0.0) < evidence(ROCK, far, 0.2) < 0


def test_units_of_the_modes_do_not_matter_only_shares_do() -> None:
    """Half a rock of mafics beside plagioclase that the crater's entry does not know."""
    halved = {name: (value / 2, sigma / 2) for name, (value, sigma) in ROCK.items()}
    with_plagioclase = {**halved, "plagioclase": (0.5, 0.02)}
    crater = {"olivine": (0.2, 0.1), "orthopyroxene": (0.5, 0.1), "clinopyroxene": (0.3, 0.1)}
    found = composition_evidence(
        Composition(with_plagioclase), Composition(crater), systematic=0.1, band_systematic_nm=10
    )
    assert found.minerals == MINERALS[:3]
    assert found.ln_modes == pytest.approx(evidence(ROCK, crater))


def test_an_unknown_composition_says_neither_for_nor_against_and_says_so() -> None:
    found = composition_evidence(Composition(ROCK), Composition(), systematic=0.1, band_systematic_nm=10)
    assert (found.ln_modes, found.ln_bands, found.ln_total) == (None, None, 0.0)
    assert "nothing that both have" in found.basis


def test_one_mineral_in_common_is_not_compared() -> None:
    crater = {"olivine": (0.2, 0.1), "plagioclase": (0.5, 0.1)}
    found = composition_evidence(Composition(ROCK), Composition(crater), systematic=0.1, band_systematic_nm=10)
    assert found.ln_modes is None


def test_minerals_that_one_of_both_lacks_altogether_are_not_divided_by_nothing() -> None:
    crater = {"olivine": (0.0, 0.0), "orthopyroxene": (0.0, 0.0), "plagioclase": (1.0, 0.0)}
    rock = {"olivine": (0.5, 0.1), "orthopyroxene": (0.5, 0.1)}
    found = composition_evidence(Composition(rock), Composition(crater), systematic=0.1, band_systematic_nm=10)
    assert found.ln_modes is None


def test_bands_against_a_grid() -> None:
    rock, crater = Composition({}, {"bc1000_nm": (930, 5)}), Composition({}, {"bc1000_nm": (925, 8)})
    found = composition_evidence(rock, crater, systematic=0.1, band_systematic_nm=10)
    x = np.linspace(880, 1070, 50_001)
    broad = norm.pdf(930, x, np.hypot(5, 10)).mean()
    wide = np.linspace(700, 1200, 200_001)
    known = (norm.pdf(wide, 925, 8) * norm.pdf(930, wide, np.hypot(5, 10))).sum() * (wide[1] - wide[0])
    assert found.ln_bands == pytest.approx(np.log(known / broad), abs=1e-3)
    assert found.bands == ("bc1000_nm",)
    assert found.ln_modes is None


@pytest.mark.parametrize("systematic", [0.0, 0.1])
def test_a_rock_that_overlaps_with_nothing_has_a_finite_factor(systematic: float) -> None:
    crater = {"olivine": (1.0, 0.0), "orthopyroxene": (0.0, 0.0), "clinopyroxene": (0.0, 0.0)}
    rock = {"olivine": (0.0, 0.001), "orthopyroxene": (0.0, 0.001), "clinopyroxene": (1.0, 0.001)}
    found = evidence(rock, crater, systematic)
    assert np.isfinite(found)
    assert found < -20
