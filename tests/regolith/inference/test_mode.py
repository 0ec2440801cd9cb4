"""States whose errors are alike count as fewer: copies of states tell no more than the states, and intervals say so."""

from collections.abc import Mapping
from dataclasses import replace

import numpy as np
import pytest

from lunarsci.regolith.inference.mode import (
    Mode,
    find_mode,
    mode_with_errors,
    mode_without_outliers,
    predictive_densities,
)
from lunarsci.regolith.inference.posterior import infer_soil
from lunarsci.regolith.inference.problem import (
    JointProblem,
    error_covariance,
    forces_at,
    part_of,
    problem_of,
    states_alike,
)
from lunarsci.regolith.prior import PARAMETERS, Law, default_prior, values_of
from lunarsci.regolith.states import COLUMNS, MeasurementErrors, WheelStates
from lunarsci.regolith.wheel import read_wheel

WHEEL, PRIOR = read_wheel("yutu2"), default_prior()
DISTINCT, COPIES = 8, 9
CENTER = np.array([PRIOR[name].center for name in PARAMETERS])
INPUTS = np.column_stack([
    [0.006, 0.007, 0.009, 0.010, 0.012, 0.013, 0.015, 0.016],
    [0.10, 0.30, -0.10, 0.20, 0.05, 0.40, -0.05, 0.25],
    [4.0, -6.0, 8.0, -3.0, 5.0, -8.0, 7.0, -4.0],
])  # fmt: skip


def measured(seed: int = 0) -> WheelStates:
    """Synthetic: eight states on the soil of the priors' centre, with the errors of the paper."""
    values = np.column_stack([INPUTS, forces_at(values_of(PRIOR, CENTER), INPUTS, WHEEL, None)])
    errors = MeasurementErrors()
    sigmas = np.column_stack([errors.of(name, values[:, k]) for k, name in enumerate(COLUMNS)])
    noisy = values + sigmas * np.random.default_rng(seed).standard_normal(values.shape)
    return WheelStates(tuple(map(str, range(DISTINCT))), noisy, sigmas)


def copied(states: WheelStates) -> WheelStates:
    rows = np.tile(np.arange(DISTINCT), COPIES)
    return WheelStates(tuple(map(str, range(len(rows)))), states.values[rows], states.sigmas[rows])


def problem(states: WheelStates, laws: Mapping[str, Law] = PRIOR) -> JointProblem:
    return problem_of(states, np.ones(len(states.id), dtype=bool), WHEEL, laws, None, (0.02,) * 3)


def slopes(of: JointProblem, point: np.ndarray) -> np.ndarray:
    """Whitened residuals by transformed parameters, by central differences. (3 n, 8)"""
    step = 1e-3 * of.width
    ahead, behind = (of.white(point + sign * np.diag(step)).reshape(len(point), -1) for sign in (1, -1))
    return np.asarray(((ahead - behind) / (2 * step[:, None])).T)


def test_copies_of_states_count_as_the_states() -> None:
    """Whitened residuals w of nine copies add up to 9 w, of which the variance is to be 9: that is 9 times mean w^2."""
    single, many = problem(measured()), problem(copied(measured()))
    white = single.white(CENTER[None])[0]
    assert states_alike(many, CENTER) == pytest.approx(COPIES * float((white**2).mean()), rel=1e-9)
    points = CENTER + 0.3 * np.random.default_rng(1).standard_normal((5, 8)) * single.width
    nine = replace(many, alike=float(COPIES))
    assert nine.ln_likelihood(points) == pytest.approx(single.ln_likelihood(points), rel=1e-9)
    assert nine.objective(points[0]) == pytest.approx(single.objective(points[0]), rel=1e-9)


@pytest.mark.parametrize("share", [0.0, 0.3, 0.8])
def test_the_design_effect_is_that_of_a_cluster_sample(share: float) -> None:
    """Kish (1965, ch. 5): 1 + (m - 1) rho for groups of m values, a share rho of whose variance is common.

    With 24 groups a draw scatters by sqrt(2 / 24), the mean of 200 by 2 %; values below 1 count as 1.
    """
    random = np.random.default_rng(2)
    states = copied(measured())
    plain = replace(
        problem(states), input_sigma=np.zeros((72, 3)), force_sigma=np.ones((72, 3)), model_error=(0.0,) * 3
    )
    exact, group = plain.at(CENTER), np.tile(np.arange(DISTINCT), COPIES)
    found = []
    for _ in range(200):
        own, common = random.standard_normal((72, 3)), random.standard_normal((DISTINCT, 3))[group]
        errors = np.sqrt(1 - share) * own + np.sqrt(share) * common
        found.append(states_alike(replace(plain, forces=exact + errors), CENTER))
    expected = 1 + (COPIES - 1) * share
    if share:
        assert np.mean(found) == pytest.approx(expected, rel=0.06)
    else:
        # The mean of a positive part: 1 + E max(x, 0), x normal with a standard deviation of sqrt(2 / 24).
        assert np.mean(found) == pytest.approx(1 + np.sqrt(2 / 24 / (2 * np.pi)), abs=0.04)


@pytest.fixture(scope="module")
def mode() -> Mode:
    return mode_with_errors(problem(copied(measured())))


def widened(found: Mode, free: slice = slice(None)) -> np.ndarray:
    """Covariance that eight states give, each once, with errors as much larger as the residuals are. (p, p)"""
    once = np.arange(DISTINCT)
    larger = float((part_of(found.problem, once).white(found.point[None]) ** 2).mean())
    j = slopes(part_of(replace(found.fitted, alike=1.0), once), found.point)[:, free]
    return np.linalg.inv(np.diag(found.problem.width[free] ** -2.0) + j.T @ j / larger)


def test_copies_of_states_narrow_no_interval(mode: Mode) -> None:
    assert mode.inliers.all() and mode.alike > 3.0
    assert mode.covariance == pytest.approx(widened(mode), rel=1e-3, abs=1e-5 * float(mode.covariance.max()))


def test_sampled_intervals_and_profiles_are_widened_alike() -> None:
    """With one unknown parameter, whose law is nearly normal."""
    laws = {name: law if name == "stiffness_kpa_m_n" else replace(law, sd=0.0) for name, law in PRIOR.items()}
    states = copied(measured())
    sigma = float(np.sqrt(widened(mode_with_errors(problem(states, laws)), slice(1))[0, 0]))
    assert sigma < 0.3 * PRIOR["stiffness_kpa_m_n"].width
    for options in ({}, {"profile": True}, {"sample": True}):
        posterior = infer_soil(states, WHEEL, laws, draws=400, **options)
        assert posterior.how == next(iter(options), "normal")
        ends = np.log(posterior.intervals()["stiffness_kpa_m_n"][1:])
        # The widths of 400 draws scatter by 5 %.
        assert [ends[1] - ends[0], (ends[3] - ends[2]) / 1.96] == pytest.approx([2 * sigma] * 2, rel=0.15), options


def test_a_group_is_predicted_as_by_a_fit_without_it() -> None:
    """The density of its residuals about the mode of all others, by a fit of these, in their errors and what is left
    open of the soil; the linear step differs by what the model bends."""
    best = mode_without_outliers(problem(measured()))
    groups, expected = np.arange(DISTINCT) // 2, []
    for group in range(DISTINCT // 2):
        others, left = (part_of(best.problem, rows) for rows in (groups != group, groups == group))
        point, covariance = find_mode(others, best.point)
        away, j = left.white(point[None])[0].ravel(), slopes(left, point)
        spread = np.eye(len(away)) + j @ covariance @ j.T
        errors = error_covariance(left, left.residuals_and_slopes(point[None])[1][0], np.array(left.model_error))
        size = np.linalg.slogdet(spread)[1] + np.linalg.slogdet(errors)[1].sum()
        expected.append(-0.5 * (away @ np.linalg.solve(spread, away) + size))
    assert predictive_densities(best, groups) == pytest.approx(expected, abs=0.3)
