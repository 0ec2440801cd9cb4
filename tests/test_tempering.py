"""Sequential Monte Carlo, beside laws that can be written down."""

import numpy as np
import pytest

from lunarsci.regolith.inference.posterior import carry_population
from lunarsci.tempering import correlation, effective_number, largest_power, systematic, weights


def test_effective_number_of_equal_points_is_theirs() -> None:
    weight = weights(np.array([0.0, 0.0, -np.inf, 0.0, -800.0]))
    assert weight.sum() == pytest.approx(1.0)
    assert effective_number(weight) == pytest.approx(3.0)


@pytest.mark.parametrize(("off", "wanted"), [(3.0, 1.5), (40.0, 1.9), (1e-3, 1.9999999)])
def test_power_of_two_points_is_the_one_that_follows(off: float, wanted: float) -> None:
    """Weights 1 and w are worth (1 + w)^2 / (1 + w^2) points; solved for w = exp(-power * off)."""
    w = (1 - np.sqrt(2 * wanted - wanted**2)) / (wanted - 1)
    assert largest_power(np.array([5.0, 5.0 - off]), wanted, most=1e9) == pytest.approx(-np.log(w) / off, rel=1e-6)


def test_a_density_that_leaves_enough_is_taken_as_it_is() -> None:
    assert largest_power(np.array([0.0, -0.1, -0.2]), 2.0) == 1.0
    assert largest_power(np.array([0.0, -0.1, -0.2]), 2.0, most=0.3) == 0.3


def test_fewer_possible_points_than_wanted_still_go_on() -> None:
    """Of ten possible points half count after the step, as of a population that is all possible."""
    ln_density = np.where(np.arange(40) < 10, -np.linspace(0.0, 90.0, 40), -np.inf)
    power = largest_power(ln_density, 20.0)
    assert effective_number(weights(power * ln_density)) == pytest.approx(5.0)


def test_systematic_draws_are_within_one_of_the_share() -> None:
    random = np.random.default_rng(0)
    weight = random.dirichlet(np.full(50, 0.3))
    for offset in random.random(200):
        counts = np.bincount(systematic(weight, float(offset)), minlength=50)
        assert (np.abs(counts - 50 * weight) < 1).all()


def test_systematic_draws_are_unbiased() -> None:
    weight = np.array([0.07, 0.5, 0.03, 0.4])
    offsets = (np.arange(2000) + 0.5) / 2000
    counts = np.mean([np.bincount(systematic(weight, offset), minlength=4) for offset in offsets], axis=0)
    assert counts == pytest.approx(4 * weight, abs=2e-3)


def test_correlation_counts_mirrored_points_where_asked_and_what_stood_still_is_not_forgotten() -> None:
    before = np.random.default_rng(1).standard_normal((500, 2))
    assert correlation(before, before) == pytest.approx(1.0) == correlation(before, -before, mirrored=True)
    assert correlation(before, -before) == pytest.approx(-1.0)
    assert correlation(np.ones((9, 1)), np.ones((9, 1))) == 1.0


def test_a_normal_law_is_reached_from_a_prior_far_off() -> None:
    """Prior N(0, 1) in three coordinates, one datum of their sum with sigma 0.1 at 6: a normal law in closed form.

    2000 points tell a mean to 0.022 standard deviations and a variance to 3 %; the bounds are four times that.
    """
    ones, sigma = np.ones(3), 0.1
    covariance = np.linalg.inv(np.eye(3) + np.outer(ones, ones) / sigma**2)
    mean = covariance @ ones * 6.0 / sigma**2

    def ln_likelihood(points: np.ndarray) -> np.ndarray:
        return -0.5 * ((points.sum(axis=1) - 6.0) / sigma) ** 2

    points, left = carry_population(ln_likelihood, np.zeros(3), ones, 2000, np.random.default_rng(3))
    assert left < 0.2
    root = np.linalg.inv(np.linalg.cholesky(covariance))
    white = (points - mean) @ root.T
    assert np.abs(white.mean(axis=0)).max() < 4 * 0.022
    assert np.abs(np.cov(white.T) - np.eye(3)).max() < 4 * 0.032
