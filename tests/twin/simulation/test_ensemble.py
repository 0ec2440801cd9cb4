"""Ensembles, verdicts, tables and the picture."""

import dataclasses
import itertools

import numpy as np
import pytest

from lunarsci.compiled import set_threads
from lunarsci.errors import ParameterError
from lunarsci.twin.figures.prediction import path_fan
from lunarsci.twin.ground.synthetic import synthetic_longji
from lunarsci.twin.ground.terrain import Terrain
from lunarsci.twin.judgement.endpoint import covering_circle
from lunarsci.twin.judgement.keeping import extremes
from lunarsci.twin.judgement.quantities import least_of_95, tilt_deg
from lunarsci.twin.judgement.safety import judge
from lunarsci.twin.judgement.tables import endpoint_table, path_table, state_table
from lunarsci.twin.plans.plan import Limit, parse_sweep, read_plan
from lunarsci.twin.rover import Rover
from lunarsci.twin.simulation.ensemble import PATH_COLUMNS, Prediction, member_parameters, predict

SWEEP = tuple(map(parse_sweep, ("friction_angle_deg=25:55:3", "lateral_modulus_mm=15:45:2")))


@pytest.fixture(scope="module")
def ground() -> Terrain:
    return synthetic_longji(spacing_m=0.1)


@pytest.fixture(scope="module")
def prediction(yutu2: Rover, ground: Terrain) -> Prediction:
    return predict(yutu2, ground, read_plan(), sweep=SWEEP, sample_m=0.2)


@pytest.fixture(scope="module")
def broken(yutu2: Rover, ground: Terrain) -> Prediction:
    """Some members finish, some do not: the soft ones never settle."""
    sweep = (parse_sweep("stiffness_kpa_m_n=0.001:1443:3"),)
    return predict(yutu2, ground, read_plan(), sweep=sweep, sample_m=0.5)


def test_any_number_of_threads_gives_the_same_bits(yutu2: Rover, ground: Terrain, prediction: Prediction) -> None:
    try:
        set_threads(1)
        alone = predict(yutu2, ground, read_plan(), sweep=SWEEP, sample_m=0.2)
    finally:
        set_threads(0)
    assert np.array_equal(alone.paths, prediction.paths) and np.array_equal(alone.states, prediction.states)


def test_a_member_is_the_drive_on_its_own_soil(yutu2: Rover, ground: Terrain, prediction: Prediction) -> None:
    values = {name: float(column[3]) for name, column in prediction.parameters.items()}
    alone = predict(yutu2, ground.with_soil(**values), read_plan(), sweep=(), sample_m=0.2)
    assert np.allclose(alone.paths[0], prediction.paths[3], atol=1e-9)


def test_the_trends_are_the_published_ones(prediction: Prediction) -> None:
    """Ding et al. (2024): slip falls as phi grows, side slip grows with K_y, all ends within 0.762 m."""
    phi, k_y = prediction.parameters["friction_angle_deg"], prediction.parameters["lateral_modulus_mm"]
    slip, side = prediction.states[..., 3].mean(axis=(1, 2)), np.abs(prediction.states[..., 4]).mean(axis=(1, 2))
    assert (np.diff([slip[phi == value].mean() for value in (25.0, 40.0, 55.0)]) < 0).all()
    assert side[k_y == 45.0].mean() > 1.5 * side[k_y == 15.0].mean()
    assert prediction.miss_m.max() < 0.762


def test_grid_and_latin_hypercube() -> None:
    grid = member_parameters(SWEEP, None, 0)
    assert list(zip(*grid.values(), strict=True)) == [(p, k) for p in (25.0, 40.0, 55.0) for k in (15.0, 45.0)]
    drawn = member_parameters(SWEEP, 16, 7)
    for name, low, high in (("friction_angle_deg", 25.0, 55.0), ("lateral_modulus_mm", 15.0, 45.0)):
        strata = np.floor((drawn[name] - low) / (high - low) * 16)
        assert sorted(strata) == list(range(16))
        assert np.array_equal(drawn[name], member_parameters(SWEEP, 16, 7)[name])
    for sweep, members in ((SWEEP, 0), (SWEEP * 2, None), ((parse_sweep("cohesion_pa=0:9:200000"),), None)):
        with pytest.raises(ParameterError):
            member_parameters(sweep, members, 0)


@pytest.mark.parametrize(
    "bad", [{"time_step_s": 0.0}, {"sample_m": -1.0}, {"time_step_s": 1e-9}, {"seed": -1}, {"members": 9**5}]
)
def test_steps_that_are_none_are_refused(yutu2: Rover, ground: Terrain, bad: dict[str, float]) -> None:
    with pytest.raises(ParameterError):
        predict(yutu2, ground, read_plan(), **bad)


def test_progress_counts_members(yutu2: Rover, ground: Terrain, straight) -> None:  # type: ignore[no-untyped-def]
    seen: list[tuple[int, int]] = []
    plan, sweep = straight(0.5), (parse_sweep("friction_angle_deg=30:40:40"),)
    predict(yutu2, ground, plan, sweep=sweep, progress=lambda done, total: seen.append((done, total)))
    assert seen[0] == (0, 40)
    assert seen[-1] == (40, 40)
    assert sorted(later[0] - earlier[0] for earlier, later in itertools.pairwise(seen)) == [8, 16, 16]


def test_ctrl_c_is_heard(yutu2: Rover, ground: Terrain, straight) -> None:  # type: ignore[no-untyped-def]
    def stop(done: int, total: int) -> None:
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        predict(yutu2, ground, straight(0.5), sweep=SWEEP, progress=stop)


def test_the_verdict_follows_the_limits(prediction: Prediction) -> None:
    verdict = judge(prediction)
    assert verdict.verdict == "go" and verdict.reasons == ()
    assert any("synthetic" in note for note in verdict.notes)
    miss = next(j for j in verdict.limits if j.quantity == "endpoint_miss_m")
    assert miss.p50 == pytest.approx(np.percentile(prediction.miss_m, 50))
    assert miss.p95 == miss.max, "of six drives, 95 % are all six"
    assert miss.margin == pytest.approx(1.0 - prediction.miss_m.max())
    assert prediction.miss_m[miss.worst_member] == miss.max == verdict.endpoint.covering_radius_m
    strict = dataclasses.replace(prediction.plan, limits=(Limit("endpoint_miss_m", "m", 0.01, "test", True),))
    refused = judge(prediction, strict)
    assert refused.verdict == "no-go" and "endpoint_miss_m" in refused.reasons[0]


def test_the_ends_are_described(prediction: Prediction) -> None:
    endpoint, ends = judge(prediction).endpoint, prediction.endpoints_m
    assert (endpoint.x_m, endpoint.y_m) == pytest.approx(tuple(ends.mean(axis=0)))
    deviation = ends - ends.mean(axis=0)
    assert np.array(endpoint.covariance_m2) == pytest.approx(deviation.T @ deviation / (len(ends) - 1))
    # A circle about the destination holds all, and no smaller one about anywhere is larger than it.
    assert endpoint.scatter_radius_m <= endpoint.covering_radius_m
    assert endpoint.bias_m == pytest.approx(np.hypot(*(ends.mean(axis=0) - prediction.planned[-1, :2])))


def test_the_smallest_circle_of_known_figures() -> None:
    assert covering_circle(np.array([[0.0, 0.0], [2.0, 0.0], [1.0, 0.2]])) == pytest.approx((1.0, 0.0, 1.0))
    assert covering_circle(np.array([[0.0, 0.0], [1.0, 0.0], [0.5, np.sqrt(0.75)]]))[2] == pytest.approx(1 / np.sqrt(3))
    assert covering_circle(np.array([[1.0, 2.0]] * 5)) == pytest.approx((1.0, 2.0, 0.0))
    line = np.column_stack([np.linspace(0.0, 4.0, 9), np.linspace(0.0, 3.0, 9)])
    assert covering_circle(line)[2] == pytest.approx(2.5)
    cloud = np.random.default_rng(2).normal(size=(200, 2))
    x, y, radius = covering_circle(cloud)
    distance = np.hypot(cloud[:, 0] - x, cloud[:, 1] - y)
    assert distance.max() <= radius * (1 + 1e-12) and np.sum(distance > radius * (1 - 1e-9)) >= 2


def test_members_that_do_not_finish_make_it_a_no_go(broken: Prediction) -> None:
    assert not broken.finished.all() and broken.finished.any()
    verdict = judge(broken)
    assert verdict.verdict == "no-go" and "did not settle" in verdict.reasons[0]
    assert sum(verdict.outcomes.values()) == 3
    assert np.isfinite(broken.paths).all()
    table = state_table(broken)
    assert set(table["member"]) == set(np.flatnonzero(broken.recorded))


def test_nothing_finished_is_judged_all_the_same(yutu2: Rover, ground: Terrain) -> None:
    lost = predict(yutu2, ground, dataclasses.replace(read_plan(), x_m=500.0), sweep=SWEEP)
    verdict = judge(lost)
    assert verdict.verdict == "no-go" and verdict.endpoint is None and verdict.limits == ()
    assert state_table(lost).empty and path_table(lost).empty and len(endpoint_table(lost)) == 6
    path_fan(lost, verdict).canvas.draw()


def test_tilt_is_the_angle_to_the_vertical() -> None:
    assert tilt_deg(3.0, 0.0) == pytest.approx(3.0)
    assert tilt_deg(-45.0, 45.0) == pytest.approx(60.0)


def test_tables_hold_what_the_arrays_hold(prediction: Prediction) -> None:
    states, samples = state_table(prediction), len(prediction.distance_m)
    assert list(states.columns) == [
        *("member", "distance_m", "time_s", "wheel", "x_m", "y_m", "sinkage_m", "slip_ratio", "side_slip_deg"),
        *("normal_force_n", "drawbar_pull_n", "lateral_force_n", "resistance_torque_nm", "valid", "rover", "ground"),
    ]
    assert set(states["rover"]) == {"yutu2; wheels 150 x 150 mm"}
    assert len(states) == 6 * samples * len(prediction.rover.wheels) and states["valid"].dtype == bool
    row = states[(states["member"] == 4) & (states["wheel"] == "RL")].iloc[10]
    assert row["sinkage_m"] == prediction.states[4, 10, 4, 2]
    assert row["time_s"] == pytest.approx(row["distance_m"] / 0.05)
    paths = path_table(prediction)
    assert list(paths.columns) == ["member", "distance_m", "time_s", *PATH_COLUMNS, "rover", "ground"]
    assert len(paths) == 6 * samples
    ends = endpoint_table(prediction)
    assert list(ends.columns)[:3] == ["member", "friction_angle_deg", "lateral_modulus_mm"]
    assert set(ends["outcome"]) == {"finished"}


def test_invalid_states_are_flagged(yutu2: Rover, straight, slope) -> None:  # type: ignore[no-untyped-def]
    """22 deg uphill in loose soil: the wheels spin beyond |s| = 0.6."""
    result = predict(yutu2, slope(0.4).with_soil(friction_angle_deg=28.0, cohesion_pa=0.0), straight(1.0), sweep=())
    states = state_table(result)
    assert not states.loc[states["slip_ratio"].abs() > 0.6, "valid"].any()
    assert judge(result).invalid_share > 0.3
    assert extremes(result, "slip_ratio")[0] > 0.6
    with pytest.raises(ParameterError):
        extremes(result, "colour")


def test_the_picture_has_units_on_every_axis_and_says_synthetic(prediction: Prediction) -> None:
    figure = path_fan(prediction, judge(prediction))
    figure.canvas.draw()
    labels = [axes.get_ylabel() or axes.get_xlabel() for axes in figure.axes]  # of a colour bar below
    assert len(labels) == 6 and all("[" in label for label in labels)
    assert figure.get_suptitle().startswith("SYNTHETIC: ")


def test_the_least_that_95_of_100_drives_reach() -> None:
    assert least_of_95(np.random.default_rng(0).permutation(np.arange(1.0, 101.0))) == 6.0
    assert least_of_95(np.array([0.3, 0.1, 0.2])) == 0.1
