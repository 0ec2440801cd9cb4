"""The joint posterior of a soil: coverage, what is determined, outliers, and its sampler."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.stats import chi2

from lunarsci.errors import DataError, LunarSciWarning, ParameterError
from lunarsci.io.inputs import InputFile
from lunarsci.regolith.inference.posterior import SoilPosterior, carry_population, infer_soil
from lunarsci.regolith.inference.problem import forces_at, problem_of
from lunarsci.regolith.prior import PARAMETERS, Law, default_prior, read_prior, values_of
from lunarsci.regolith.states import COLUMNS, MeasurementErrors, WheelStates, read_states
from lunarsci.regolith.wheel import ContactModel, read_wheel

WHEEL = read_wheel("yutu2")
PRIOR = default_prior()
SOILS, STATES = 200, 30


def measured(truth: np.ndarray, count: int, rng: np.random.Generator, model: ContactModel | None = None) -> WheelStates:
    """Synthetic: states under loads of 20-50 N, with the errors of the paper drawn on everything measured."""
    slip, side = rng.uniform(-0.2, 0.4, count), rng.uniform(0.5, 8, count) * rng.choice([-1, 1], count)
    load = rng.uniform(20, 50, count)
    low, high = np.full(count, 1e-4), np.full(count, 0.1)
    for _ in range(50):
        middle = (low + high) / 2
        light = forces_at(truth, np.column_stack([middle, slip, side]), WHEEL, model)[:, 0] < load
        low, high = np.where(light, middle, low), np.where(light, high, middle)
    inputs = np.column_stack([low, slip, side])
    values = np.column_stack([inputs, forces_at(truth, inputs, WHEEL, model)])
    errors = MeasurementErrors()

    def sigmas(of: np.ndarray) -> np.ndarray:
        return np.column_stack([errors.of(name, of[:, k]) for k, name in enumerate(COLUMNS)])

    noisy = values + sigmas(values) * rng.standard_normal(values.shape)
    return WheelStates(tuple(map(str, range(count))), noisy, sigmas(noisy))


def drawn_soil(rng: np.random.Generator) -> np.ndarray:
    centers, widths = (np.array([getattr(PRIOR[name], key) for name in PARAMETERS]) for key in ("center", "width"))
    return values_of(PRIOR, centers + widths * rng.standard_normal(len(PARAMETERS)))


@pytest.fixture(scope="module")
def recovered() -> list[tuple[np.ndarray, SoilPosterior]]:
    rng = np.random.default_rng(1)
    found = []
    for seed in range(SOILS):
        truth = drawn_soil(rng)
        found.append((truth, infer_soil(measured(truth, STATES, rng), WHEEL, model_error=0.0, seed=seed)))
    return found


def transformed(values: np.ndarray) -> np.ndarray:
    """Parameters in their units as the laws of the priors take them. (..., 8)"""
    return np.stack([PRIOR[name].transformed(values[..., k]) for k, name in enumerate(PARAMETERS)], axis=-1)


def test_errors_of_soils_are_as_large_as_stated(recovered: list[tuple[np.ndarray, SoilPosterior]]) -> None:
    """Of 200 errors over their standard deviations the root mean square scatters by 5 %, of all eight together by 2 %.
    Drawn intervals are as wide as the standard deviations say."""
    off = np.array([(posterior.mode - transformed(truth)) / posterior.sd for truth, posterior in recovered])
    assert np.sqrt((off**2).mean(axis=0)) == pytest.approx(np.ones(8), abs=0.15)
    assert np.sqrt((off**2).mean()) == pytest.approx(1.0, abs=0.06)
    ends = transformed(np.array([[*posterior.intervals().values()] for _, posterior in recovered]).swapaxes(1, 2))
    sd = np.array([posterior.sd for _, posterior in recovered])
    for low, high, sigmas in ((1, 2, 1.0), (3, 4, 1.96)):
        wide = (ends[:, high] - ends[:, low]) / (2 * sigmas * sd)
        assert wide.mean(axis=0) == pytest.approx(np.ones(8), abs=0.01)


def test_residuals_of_soils_are_smaller_by_what_the_fit_used_up(
    recovered: list[tuple[np.ndarray, SoilPosterior]],
) -> None:
    """Chi-square is n less 1 - (sd / prior sd)^2 of each parameter, here 7 of 90 in the mean, within 1.1 % for 200."""
    widths = np.array([PRIOR[name].width for name in PARAMETERS])
    left = [posterior.degrees - float((1 - (posterior.sd / widths) ** 2).sum()) for _, posterior in recovered]
    found = [posterior.chi_square for _, posterior in recovered]
    assert sum(found) / sum(left) == pytest.approx(1.0, abs=0.035)
    reduced = [posterior.verdict.reduced_chi_square for _, posterior in recovered]
    assert reduced == pytest.approx(list(np.divide(found, left)))


@pytest.mark.parametrize("name", PARAMETERS)
def test_intervals_hold_the_truth_as_often_as_they_say(
    recovered: list[tuple[np.ndarray, SoilPosterior]], name: str
) -> None:
    """Of soils drawn from the prior; three standard errors of a share of 200 are 0.1."""
    k = PARAMETERS.index(name)
    inside = []
    for truth, posterior in recovered:
        if name in posterior.determined:
            _, low, high, low95, high95 = posterior.intervals()[name]
            inside.append((low <= truth[k] <= high, low95 <= truth[k] <= high95))
    assert len(inside) > SOILS / 2
    one, two = np.mean(inside, axis=0)
    assert 0.61 <= one <= 0.79
    assert two >= 0.90


def test_what_the_states_cannot_tell_stays_as_wide_as_the_prior() -> None:
    """One slip and no side force: neither the slope with slip nor the lateral pair is learned."""
    rng = np.random.default_rng(2)
    states = measured(drawn_soil(rng), 20, rng)
    values = states.values.copy()
    values[:, 5] = np.nan
    posterior = infer_soil(WheelStates(states.id, values, states.sigmas), WHEEL)
    for name in ("external_friction_angle_deg", "lateral_modulus_mm"):
        assert posterior.shrinkage[name] == pytest.approx(0, abs=1e-6)
        assert name not in posterior.determined


def test_what_is_left_of_the_prior_is_that_of_the_intervals_shown() -> None:
    """Few, scattered states: the width that is left is that of the draws, and half a profile's 68 % interval."""
    rng = np.random.default_rng(2)
    states = measured(drawn_soil(rng), 4, rng)
    sampled, profiled = infer_soil(states, WHEEL, sample=True), infer_soil(states, WHEEL, profile=True)
    for place, name in enumerate(sampled.names):
        law = sampled.prior[name]
        spread = law.transformed(sampled.draws[:, place]).std(ddof=1)
        assert 1 - sampled.shrinkage[name] == pytest.approx(spread / law.width, rel=1e-6), name
        half = np.ptp(law.transformed(np.array(profiled.intervals()[name][1:3]))) / 2
        assert 1 - profiled.shrinkage[name] == pytest.approx(half / law.width, rel=1e-6), name


def test_a_wrong_state_is_left_out_and_changes_little() -> None:
    rng = np.random.default_rng(6)
    states = measured(drawn_soil(rng), 30, rng)
    values = states.values.copy()
    values[7, 4] += 15.0
    clean, spoiled = infer_soil(states, WHEEL), infer_soil(WheelStates(states.id, values, states.sigmas), WHEEL)
    assert clean.outliers == ()
    assert spoiled.outliers == ("7",)
    assert np.abs(spoiled.mode - clean.mode).max() < 1.0 * clean.sd.max()


@pytest.fixture(scope="module")
def many() -> tuple[WheelStates, SoilPosterior]:
    """So many states that the posterior is nearly normal."""
    rng = np.random.default_rng(4)
    states = measured(drawn_soil(rng), 100, rng)
    return states, infer_soil(states, WHEEL, seed=1)


def test_the_sampler_finds_a_bent_posterior_that_quadrature_gives() -> None:
    """Two states, two free parameters: quantiles against a fine grid, where the normal approximation fails."""
    states = read_states(
        InputFile(
            "s.csv",
            b"sinkage_m,slip_ratio,side_slip_deg,normal_force_n,drawbar_pull_n,lateral_force_n\n"
            b"0.008,0.3,0,30,8,\n0.010,0.2,0,36,7,\n",
        ),
        WHEEL,
    )
    free = ("cohesion_pa", "friction_angle_deg")
    laws = {name: law if name in free else replace(law, sd=0.0) for name, law in PRIOR.items()}
    laws["cohesion_pa"] = replace(PRIOR["cohesion_pa"], sd=1.5)
    problem = problem_of(states, np.array([True, True]), WHEEL, laws, None, (0.02,) * 3)
    sampled, _ = carry_population(problem.ln_likelihood, problem.center, problem.width, 4000, np.random.default_rng(0))
    at = [PARAMETERS.index(name) for name in free]
    axes = [problem.center[k] + problem.width[k] * np.linspace(-6, 6, 121) for k in at]
    points = np.tile(problem.center, (121 * 121, 1))
    points[:, at] = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, 2)
    ln_post = problem.ln_likelihood(points) - 0.5 * np.sum(((points - problem.center) / problem.width) ** 2, axis=1)
    weight = np.exp(ln_post - np.nanmax(ln_post)).reshape(121, 121)
    for k, axis in enumerate(axes):
        cumulated = np.cumsum(weight.sum(axis=1 - k))
        truth = np.interp([0.1, 0.25, 0.5, 0.75, 0.9], cumulated / cumulated[-1], axis)
        spread = truth[-1] - truth[0]
        assert np.quantile(sampled[:, at[k]], [0.1, 0.25, 0.5, 0.75, 0.9]) == pytest.approx(truth, abs=0.06 * spread)


def test_profile_limits_are_those_of_the_normal_law_where_it_holds_and_bend_where_not(
    many: tuple[WheelStates, SoilPosterior],
) -> None:
    states, plain = many
    profiled = infer_soil(states, WHEEL, profile=True)
    assert (plain.how, profiled.how) == ("normal", "profile")
    for name in ("stiffness_kpa_m_n", "sinkage_exponent", "shear_modulus_mm"):
        one, two = plain.intervals()[name], profiled.intervals()[name]
        assert two[2] - two[1] == pytest.approx(one[2] - one[1], rel=0.06)
        assert two[3] < two[1] < two[0] < two[2] < two[4]


def test_a_profile_is_the_lowest_objective_along_a_parameter() -> None:
    """At a limit by profile no point of a cloud around it with the same value of the parameter does better."""
    rng = np.random.default_rng(7)
    states = measured(drawn_soil(rng), 12, rng)
    found = infer_soil(states, WHEEL, model_error=0.02, profile=True)
    problem = problem_of(states, np.ones(12, dtype=bool), WHEEL, PRIOR, None, (0.02,) * 3)
    lowest, k = problem.objective(found.mode), PARAMETERS.index("friction_angle_deg")
    edge = found.intervals()["friction_angle_deg"][2]
    cloud = found.mode + rng.standard_normal((4000, 8)) @ np.linalg.cholesky(found.covariance).T
    cloud[:, k] = PRIOR["friction_angle_deg"].transformed(np.array(edge))
    away = (cloud - problem.center) / problem.width
    best = np.nanmin(-2 * problem.ln_likelihood(cloud) + np.sum(away**2, axis=1)) - lowest
    assert 1.0 - 0.02 <= best < 3.0


def test_the_exact_model_recovers_what_it_made() -> None:
    rng = np.random.default_rng(5)
    truth = drawn_soil(rng)
    states = measured(truth, 40, rng, ContactModel())
    posterior = infer_soil(states, WHEEL, model=ContactModel(), model_error=0.0)
    away = posterior.mode - transformed(truth)
    assert away @ np.linalg.solve(posterior.covariance, away) < chi2.ppf(0.999, 8)
    low, high = chi2.interval(0.99, posterior.degrees - 7)  # of 8 parameters about 7 are determined
    assert low < posterior.chi_square < high


def test_a_known_parameter_stays_where_it_is() -> None:
    rng = np.random.default_rng(6)
    prior = dict(PRIOR) | {"cohesion_pa": Law("ln", 520.0, 0.0)}
    posterior = infer_soil(measured(drawn_soil(rng), 10, rng), WHEEL, prior)
    assert posterior.intervals()["cohesion_pa"] == pytest.approx([520.0] * 5, rel=1e-4)


def test_combinations_are_orthogonal_and_the_best_is_bearing() -> None:
    rng = np.random.default_rng(7)
    posterior = infer_soil(measured(drawn_soil(rng), 30, rng), WHEEL)
    left, weights = posterior.combinations()[0]
    assert left < 0.05
    assert abs(weights["stiffness_kpa_m_n"]) > 0.3
    rows = np.array([list(w.values()) for _, w in posterior.combinations()])
    assert rows @ rows.T == pytest.approx(np.eye(8), abs=1e-9)


def test_priors_of_a_file_take_the_place_of_the_default_ones() -> None:
    text = b"[cohesion_pa]\nmedian = 1000\nsd = 0.1\n[sinkage_exponent_slip]\nof = 'value'\nmedian = 0\nsd = 0.01\n"
    laws = read_prior(InputFile("mine.toml", text))
    assert (laws["cohesion_pa"].of, laws["cohesion_pa"].median) == ("ln", 1000)
    assert laws["sinkage_exponent_slip"].width == 0.01
    assert laws["friction_angle_deg"] == PRIOR["friction_angle_deg"]


@pytest.mark.parametrize(
    ("text", "message"),
    [
        (b"[cohesion_pa\n", "not valid TOML"),
        (b"[colour]\nmedian = 1\nsd = 1\n", "'colour' is not a soil parameter"),
        (b"[cohesion_pa]\nmedian = -1\nsd = 1\n", "prior's median is -1"),
        (b"[cohesion_pa]\nmedian = 1\n", "cohesion_pa"),
        (b"[friction_angle_deg]\nmedian = 95\nsd = 1\n", "above 0, below 90"),
        (b"[cohesion_pa]\nof = 'sqrt'\nmedian = 1\nsd = 1\n", "not a transform"),
    ],
)
def test_priors_that_make_no_sense_are_refused(text: bytes, message: str) -> None:
    with pytest.raises(DataError, match=message):
        read_prior(InputFile("mine.toml", text))


def test_states_that_cannot_be_used_are_counted() -> None:
    rng = np.random.default_rng(9)
    states = measured(drawn_soil(rng), 10, rng)
    values = states.values.copy()
    values[3, 1] = np.nan
    with pytest.warns(LunarSciWarning, match="1 of 10 states"):
        infer_soil(WheelStates(states.id, values, states.sigmas), WHEEL)


def test_states_without_slip_are_refused() -> None:
    states = WheelStates(("a",), np.array([[0.01, np.nan, np.nan, 30.0, 1.0, np.nan]]), np.ones((1, 6)))
    with pytest.raises(ParameterError, match="slip ratio"):
        infer_soil(states, WHEEL)


@pytest.mark.parametrize(
    "options", [{"model_error": -0.1}, {"draws": 10}, {"prior": {"cohesion_pa": PRIOR["cohesion_pa"]}}]
)
def test_impossible_requests_are_refused(options: dict[str, object]) -> None:
    rng = np.random.default_rng(8)
    with pytest.raises(ParameterError):
        infer_soil(measured(drawn_soil(rng), 5, rng), WHEEL, **options)
