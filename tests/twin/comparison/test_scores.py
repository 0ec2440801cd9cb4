"""The parts of a comparison against published laws and other ways to work them out."""

from types import SimpleNamespace

import numpy as np
import pytest
from scipy import integrate, stats

from lunarsci.twin.comparison.scores import (
    correlation_length,
    crps,
    energy_score,
    inside,
    predictive_rank,
    region_edge,
    squared_distances,
    standardised,
    standing,
    worst_of,
)


def test_crps_of_a_large_normal_ensemble_is_its_closed_form() -> None:
    """Gneiting & Raftery (2007), Eq 21: sigma [z (2 Phi(z) - 1) + 2 phi(z) - 1/sqrt(pi)]."""
    members = stats.norm.ppf((np.arange(4000) + 0.5) / 4000)[:, None] * 2.0 + np.array([0.0, 1.0, -3.0])
    observed = np.array([0.5, -2.0, 4.0])
    z = (observed - np.array([0.0, 1.0, -3.0])) / 2.0
    expected = 2.0 * (z * (2 * stats.norm.cdf(z) - 1) + 2 * stats.norm.pdf(z) - 1 / np.sqrt(np.pi))
    assert crps(observed, members) == pytest.approx(expected, abs=0.003)


def test_crps_is_the_integral_of_the_squared_difference_of_the_distributions() -> None:
    """For the ensemble as a law of its own, pairs with itself included: (M-1)/M of the second term."""
    members, observed = np.array([0.0, 1.0, 1.5, 4.0]), 2.2
    fair = float(crps(np.array([observed]), members[:, None])[0])
    pairs = np.abs(members[:, None] - members).sum() / (2 * 4 * 3)
    own_law = fair + pairs * (1 - 3 / 4)
    x = np.linspace(-2.0, 6.0, 80_001)
    steps = (members[:, None] <= x).mean(axis=0)
    assert own_law == pytest.approx(integrate.trapezoid((steps - (x >= observed)) ** 2, x), abs=1e-3)
    assert crps(np.array([observed]), members[:1, None]) == pytest.approx(2.2)


def test_a_value_is_standardised_by_members_and_its_own_error() -> None:
    """Members 1, 3 and 5: mean 3, variance 4, and 4 / 3 more as the mean of three is not known better. One member has
    no variance."""
    record = SimpleNamespace(values=np.array([[9.0]]))
    three = SimpleNamespace(predicted=np.array([[[1.0]], [[3.0]], [[5.0]]]), sigma=np.array([[2.0]]), record=record)
    alone = SimpleNamespace(predicted=np.array([[[1.0]]]), sigma=np.array([[2.0]]), record=record)
    rows = np.array([True])
    assert standardised(three, 0, rows) == pytest.approx(6.0 / np.sqrt(4.0 + 4.0 / 3.0 + 4.0))  # type: ignore[arg-type]
    assert standardised(alone, 0, rows) == pytest.approx(4.0)  # type: ignore[arg-type]


def test_energy_score_is_least_for_the_law_that_is_right() -> None:
    random = np.random.default_rng(0)
    truths = random.normal(size=(400, 2))
    mean = {
        width: np.mean([energy_score(truth, width * random.normal(size=(60, 2))) for truth in truths])
        for width in (0.3, 1.0, 3.0)
    }
    assert mean[1.0] < mean[0.3] and mean[1.0] < mean[3.0]


def test_ranks_are_even_if_the_prediction_is_right() -> None:
    random = np.random.default_rng(1)
    members, sigma = random.normal(size=(64, 4000)), np.full(4000, 0.5)
    found = predictive_rank(random.normal(size=4000) + 0.5 * random.normal(size=4000), sigma, members)
    assert stats.kstest(found, "uniform").pvalue > 0.01
    assert found.min() > 0 and found.max() < 1


def test_a_rank_among_three_members_by_hand() -> None:
    """(0.5 + sum of Phi) / (3 + 1): Phi(1) = 0.841345 one standard error above a member; 1/8 and 7/8 beyond all."""
    observed, sigma = np.array([4.0, -90.0, 90.0]), np.array([2.0, 1.0, 1.0])
    members = np.array([[2.0, 0.0, 0.0], [4.0, 1.0, 1.0], [4.0, 2.0, 2.0]])
    expected = [(0.5 + 0.841345 + 0.5 + 0.5) / 4, 1 / 8, 7 / 8]
    assert predictive_rank(observed, sigma, members) == pytest.approx(expected, abs=1e-6)


def test_the_correlation_length_of_an_autoregressive_series_is_the_known_one() -> None:
    """(1 + rho) / (1 - rho) for order 1: Sokal (1997)."""
    random = np.random.default_rng(2)
    for rho in (0.0, 0.5, 0.8):
        found = []
        for _ in range(40):
            noise = random.normal(size=2000)
            series = np.empty(2000)
            series[0] = noise[0] / np.sqrt(1 - rho**2)
            for k in range(1, 2000):
                series[k] = rho * series[k - 1] + noise[k]
            found.append(correlation_length(series))
        assert np.mean(found) == pytest.approx((1 + rho) / (1 - rho), rel=0.1)
    assert correlation_length(np.full(50, 3.0)) == pytest.approx(50.0, rel=0.2)
    assert correlation_length(np.zeros(5)) == 1.0


def test_what_a_fit_took_from_the_correlation_is_given_back() -> None:
    """White noise less a fit of 5 numbers to 21 values is anticorrelated; its length stays about 1."""
    random = np.random.default_rng(3)
    design = np.polynomial.legendre.legvander(np.linspace(-1, 1, 21), 4)
    project = np.eye(21) - design @ np.linalg.pinv(design)
    # A moving mean over three has a length of three.
    white, smooth = [], []
    for _ in range(300):
        noise = random.normal(size=23)
        white.append(correlation_length(project @ noise[:21], 5))
        smooth.append(correlation_length(project @ np.convolve(noise, np.ones(3), "valid"), 5))
    assert 1.0 <= np.median(white) < 1.6 and 2.0 < np.median(smooth) < 4.5


def test_regions_of_hotelling_hold_their_share() -> None:
    """Normal members and truth, no error of measurement: the region is exact."""
    random, root = np.random.default_rng(4), np.array([[1.0, 0.0], [0.7, 0.2]])
    held = {0.5: 0, 0.9: 0}
    for _ in range(2000):
        members, truth = random.normal(size=(12, 2)) @ root.T, root @ random.normal(size=2)
        for share in held:
            held[share] += inside(truth - members.mean(axis=0), members, np.zeros((2, 2)), share)
    for share, count in held.items():
        assert abs(count / 2000 - share) < 3 * np.sqrt(share * (1 - share) / 2000)
    assert region_edge(0.95, 1_000_000, 2) == pytest.approx(stats.chi2.ppf(0.95, 2), rel=1e-3)
    assert region_edge(0.95, 2, 2) == np.inf


def test_distances_of_members_are_those_of_leaving_one_out() -> None:
    random = np.random.default_rng(5)
    members, error = random.normal(size=(15, 3)), np.zeros((3, 3))
    found = squared_distances(members, error, random)
    for m in range(15):
        others = np.delete(members, m, axis=0)
        spread = np.cov(others.T) * (1 + 1 / 14)
        off = members[m] - others.mean(axis=0)
        assert found[m] == pytest.approx(off @ np.linalg.solve(spread, off))


@pytest.mark.parametrize("law", ["normal", "skew", "heavy"])
def test_probabilities_are_even_whatever_the_law(law: str) -> None:
    """Truths of the members' own law, with errors of measurement: p below 0.05 in 5 %, below 0.01 in at most 1.6 %."""
    random = np.random.default_rng(6)
    draw = {
        "normal": lambda size: random.normal(size=size),
        "skew": lambda size: np.exp(random.normal(size=size)),
        "heavy": lambda size: random.standard_t(2, size=size),
    }[law]
    error = np.diag([0.1, 0.5, 0.0])
    found = []
    for _ in range(800):
        members = draw((64, 3))
        truth = draw(3) + np.sqrt(np.diag(error)) * random.normal(size=3)
        one = standing(truth, members, error, int(random.integers(1 << 30)))
        assert one is not None
        found.append(one.p)
    shares = {level: float(np.mean(np.array(found) < level)) for level in (0.01, 0.05, 0.5)}
    assert shares[0.01] < 1 / 65 + 3 * np.sqrt(0.015 / 800)
    assert shares[0.05] == pytest.approx(0.05, abs=0.025) and shares[0.5] == pytest.approx(0.5, abs=0.06)


def test_far_off_is_found_and_too_few_members_are_not_asked() -> None:
    random = np.random.default_rng(7)
    members = random.normal(size=(64, 3))
    far = standing(np.array([8.0, 0.0, 0.0]), members, np.zeros((3, 3)))
    assert far is not None and far.p < 1e-3 and far.farther == 0
    near = standing(members.mean(axis=0), members, np.zeros((3, 3)))
    assert near is not None and near.p == pytest.approx(1.0) and near.ln_density > far.ln_density
    assert standing(np.zeros(3), members[:5], np.zeros((3, 3))) is None
    # The density is that of the normal law.
    law = stats.multivariate_normal(members.mean(axis=0), np.cov(members.T) * (1 + 1 / 64))
    assert near.ln_density == pytest.approx(law.logpdf(members.mean(axis=0)))


def test_the_most_improbable_of_several_counts_for_how_many_there_are() -> None:
    random = np.random.default_rng(8)
    found = []
    for _ in range(500):
        members, truth = random.normal(size=(64, 5, 1)), random.normal(size=(5, 1))
        one = worst_of(truth, members, np.zeros((5, 1, 1)), int(random.integers(1 << 30)))
        assert one is not None
        found.append(one[2])
    assert np.mean(np.array(found) < 0.1) == pytest.approx(0.1, abs=0.04)
    one = worst_of(np.array([[0.0], [9.0]]), random.normal(size=(64, 2, 1)), np.zeros((2, 1, 1)))
    assert one is not None and one[0] == 1 and one[2] < 1e-3
