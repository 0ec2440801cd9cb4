"""The share of the load by which a model misses forces: where likelihood and wide law around 0.03 are highest."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.optimize import brentq

from lunarsci.regolith.inference.problem import JointProblem, common_share, problem_of, shares_of, tail_of
from lunarsci.regolith.prior import PARAMETERS, default_prior
from lunarsci.regolith.states import WheelStates
from lunarsci.regolith.wheel import read_wheel

PRIOR = default_prior()
CENTER = np.array([PRIOR[name].center for name in PARAMETERS])
COUNT, LOAD_N = 24, 40.0


@pytest.fixture(scope="module")
def missed() -> tuple[JointProblem, np.ndarray]:
    """States under 40 N that nothing else is wrong with, and their residuals over the load. (24, 3)"""
    random = np.random.default_rng(0)
    inputs = np.column_stack(
        [random.uniform(0.006, 0.018, COUNT), random.uniform(-0.2, 0.4, COUNT), np.full(COUNT, 5.0)]
    )
    nothing = np.zeros((COUNT, 6))
    states = WheelStates(tuple(map(str, range(COUNT))), np.column_stack([inputs, np.ones((COUNT, 3))]), nothing)
    found = problem_of(states, np.ones(COUNT, dtype=bool), read_wheel("yutu2"), PRIOR, None, (0.0,) * 3)
    forces = found.at(CENTER)
    shares = np.column_stack([np.zeros(COUNT), random.normal(0.0, 0.02, COUNT), random.normal(0.0, 0.06, COUNT)])
    forces[:, 1:] += LOAD_N * shares[:, 1:]
    shares[:, 0] = 1.0 - forces[:, 0] / LOAD_N
    forces[:, 0] = LOAD_N
    return replace(found, forces=forces), shares


def likeliest(shares: np.ndarray, used: float) -> float:
    """Where n ln s + n / (n - p) sum r^2 / (2 s^2) + ln(s / 0.03)^2 / 2 is lowest: p of n residuals r were used up."""
    n = shares.size
    larger = n / (n - used) * float((shares**2).sum())
    return float(np.exp(brentq(lambda ln: n - larger * np.exp(-2.0 * ln) + ln - np.log(0.03), -8.0, 2.0)))


@pytest.mark.parametrize("freedom", [0.0, 5.0, 24.0])
def test_shares_are_those_of_the_likelihood_and_what_the_fit_used_up_enlarges_residuals(
    missed: tuple[JointProblem, np.ndarray], freedom: float
) -> None:
    problem, shares = missed
    used = freedom / shares.size
    each = [likeliest(shares[:, k], used * COUNT) for k in range(3)]
    assert shares_of(problem, CENTER, freedom) == pytest.approx(each, rel=1e-5)
    assert common_share(problem, CENTER, freedom) == pytest.approx(likeliest(shares.ravel(), freedom), rel=1e-5)


def test_residuals_of_a_fit_with_many_parameters_count_at_most_four_fold(
    missed: tuple[JointProblem, np.ndarray],
) -> None:
    problem, shares = missed
    most = likeliest(shares.ravel(), 0.75 * shares.size)
    assert common_share(problem, CENTER, float(shares.size)) == pytest.approx(most, rel=1e-5)


def test_tails_are_those_of_the_residuals_whatever_their_size() -> None:
    """Of 2000 draws of Student's law the degrees are told to a tenth; few residuals leave the law before, with 10."""
    random = np.random.default_rng(5)
    for degrees in (3.0, 6.0):
        drawn = random.standard_t(degrees, 2000)
        assert tail_of(drawn) == pytest.approx(degrees, rel=0.15)
        assert tail_of(0.01 * drawn) == pytest.approx(tail_of(drawn), rel=1e-6)
    assert tail_of(random.standard_normal(2000)) > 20.0
    assert 8.0 < tail_of(random.standard_normal(3)) < 15.0
