"""Forces and soil in turn on a simulated drive with a hidden soil, and the inference from totals alone (synthetic)."""

import dataclasses

import numpy as np
import pandas as pd
import pytest

from lunarsci.errors import ParameterError
from lunarsci.regolith.belief import SoilBelief, first_belief
from lunarsci.regolith.forces import closed_form_forces
from lunarsci.regolith.inference.totals import BalancedStates, infer_from_totals
from lunarsci.regolith.inversion import sinkage_under_load
from lunarsci.regolith.prior import PARAMETERS, values_of
from lunarsci.regolith.soil import Soil
from lunarsci.twin.ground.synthetic import synthetic_longji
from lunarsci.twin.loads.load_ensemble import AlternatingEstimate, Round, alternate, verdict_of
from lunarsci.twin.loads.prescribed_motion import FORCE_COLUMNS, PoseStates, prescribed_loads
from lunarsci.twin.plans.motion import Motion, drawn_motions
from lunarsci.twin.plans.path import commands_at, make_schedule
from lunarsci.twin.plans.plan import Leg, Plan
from lunarsci.twin.rover import Rover
from lunarsci.twin.simulation.ensemble import STATE_COLUMNS, predict

OFF = np.array([-0.9, 0.4, 0.6, -0.5, -0.7, 0.7, 0.8, -0.6])
"""The hidden soil, in standard deviations of the priors."""
POSES = 24
SINKAGE_SIGMA, SLIP_SIGMA, SIDE_SIGMA = 0.0005, 0.01, 0.7


@pytest.fixture(scope="module")
def hidden() -> np.ndarray:
    """Its transforms."""
    first = first_belief()
    return np.asarray(first.mean + OFF * np.sqrt(np.diag(first.covariance)))


def off_by(belief: SoilBelief, truth: np.ndarray) -> np.ndarray:
    """In standard deviations that remain."""
    return np.asarray((belief.mean - truth) / np.sqrt(np.diag(belief.covariance)))


@pytest.fixture(scope="module")
def exact(yutu2: Rover, hidden: np.ndarray) -> BalancedStates:
    """Poses whose sinkages and forces are found state by state, by other functions than the inference uses."""
    rng = np.random.default_rng(0)
    soil = Soil(**dict(zip(PARAMETERS, values_of(first_belief().laws, hidden), strict=True)))
    load, slip = rng.uniform(25.0, 50.0, (POSES, 6)), rng.uniform(-0.1, 0.4, (POSES, 1)) + np.zeros((1, 6))
    side = rng.uniform(-6.0, 6.0, (POSES, 6))
    depth = np.empty((POSES, 6))
    for p in range(POSES):
        for m in range(6):
            depth[p, m] = sinkage_under_load(yutu2.wheel, soil, load[p, m], slip[p, m], side[p, m])
    forces = closed_form_forces(yutu2.wheel, soil, depth, slip, side)
    levers = np.zeros((POSES, 3, 6, 2))
    levers[:, 0, :, 0], levers[:, 1, :, 1] = 1.0, -1.0
    levers[:, 2] = rng.uniform(-0.6, 0.6, (POSES, 6, 2))
    pulls = np.stack([forces.drawbar_pull_n, forces.lateral_force_n], axis=-1)
    return BalancedStates(
        inputs=np.stack([depth, slip, side], axis=-1),
        input_sigma=np.tile([1e-6, 1e-5, 1e-4], (POSES, 6, 1)),
        load=load,
        load_sigma=np.full((POSES, 6), 0.01),
        levers=levers,
        totals=np.einsum("ptmf,pmf->pt", levers, pulls),
        totals_sigma=np.full((POSES, 3), 0.01),
    )


def test_loads_and_totals_give_the_soil_back(yutu2: Rover, exact: BalancedStates, hidden: np.ndarray) -> None:
    found = infer_from_totals(exact, yutu2.wheel, first_belief(), model_error=1e-4)
    assert np.abs(off_by(found.belief, hidden)).max() < 1.0
    assert max(found.belief.sd_ratio.values()) < 0.1
    assert max(found.reduced) < 0.1 and found.values == (6 * POSES, 3 * POSES)


def test_intervals_hold_the_soil_as_often_as_they_say(yutu2: Rover, exact: BalancedStates, hidden: np.ndarray) -> None:
    """Errors as the inference takes them: sinkage of each wheel, slip and side slip common to a pose, totals."""
    rng, misses = np.random.default_rng(1), []
    sigma = np.array([0.0003, 0.002, 0.2])
    for _ in range(12):
        common = rng.standard_normal((POSES, 1, 3)) * sigma
        noise = np.where([True, False, False], rng.standard_normal((POSES, 6, 3)) * sigma, common)
        states = dataclasses.replace(
            exact,
            inputs=exact.inputs + noise,
            input_sigma=np.tile(sigma, (POSES, 6, 1)),
            totals=exact.totals + 0.5 * rng.standard_normal((POSES, 3)),
            totals_sigma=np.full((POSES, 3), 0.5),
        )
        misses.append(off_by(infer_from_totals(states, yutu2.wheel, first_belief(), model_error=1e-3).belief, hidden))
    inside = np.abs(misses) < 1.0
    assert 0.55 < inside.mean() < 0.85 and (np.abs(misses) < 1.96).mean() > 0.88


def test_totals_of_a_pose_are_not_used_where_a_wheel_is_missing(yutu2: Rover, exact: BalancedStates) -> None:
    inputs = exact.inputs.copy()
    inputs[:, 2, 0] = np.nan
    found = infer_from_totals(dataclasses.replace(exact, inputs=inputs), yutu2.wheel, first_belief())
    left = found.belief.sd_ratio
    assert found.values == (5 * POSES, 0)
    assert left["stiffness_kpa_m_n"] < 0.5 and left["friction_angle_deg"] > 0.8, "loads rest on shear only a little"
    assert left["lateral_modulus_mm"] == pytest.approx(1.0, abs=1e-3)
    with pytest.raises(ParameterError, match="nothing is learned"):
        dataclasses.replace(exact, inputs=np.full_like(inputs, np.nan))
    with pytest.raises(ParameterError, match="is wanted"):
        dataclasses.replace(exact, totals=exact.totals[:, :2])


@pytest.fixture(scope="module")
def drive(yutu2: Rover, hidden: np.ndarray) -> tuple[np.ndarray, Motion, PoseStates]:
    """True forces, motion and states of a simulated drive, with errors."""
    plan = Plan(name="test", legs=(Leg(2.5, 0.15), Leg(2.5, -0.1)), speed_m_s=0.05)
    values = values_of(first_belief().laws, hidden)
    soil = {name: np.array([value]) for name, value in zip(PARAMETERS, values, strict=True)}
    result = predict(yutu2, synthetic_longji(), plan, samples=soil, time_step_s=0.05)
    commands, time = commands_at(yutu2, make_schedule(plan, yutu2), result.time_s), result.time_s
    exact = Motion(
        time_s=time,
        x_m=result.paths[0, :, 0],
        y_m=result.paths[0, :, 1],
        yaw_deg=result.paths[0, :, 5],
        steering_deg=np.degrees(commands.steering_rad),
        speed_m_s=commands.speed_m_s,
        sigmas=np.tile((0.005, 0.005, 0.3), (len(time), 1)),
        halted=result.halted,
    )
    rng = np.random.default_rng(3)
    motion = next(drawn_motions(exact, 1, 0.5, rng))
    from lunarsci.twin.ground.terrain import soil_overrides

    seen = prescribed_loads(
        yutu2, synthetic_longji(), motion, soil_overrides(soil, 1)[0]
    ).states  # slips of that motion
    true = result.states[0]
    depth = true[..., STATE_COLUMNS.index("sinkage_m")] + SINKAGE_SIGMA * rng.standard_normal(true.shape[:2])
    slip, side = (seen[..., STATE_COLUMNS.index(name)] for name in ("slip_ratio", "side_slip_deg"))
    states = PoseStates(
        pd.DataFrame({"time_s": np.repeat(time, 6)}),
        np.repeat(time, 6),
        np.tile(np.arange(6), len(time)),
        np.column_stack([depth.ravel(), slip.ravel(), side.ravel()]),
        np.tile([SINKAGE_SIGMA, SLIP_SIGMA, SIDE_SIGMA], (depth.size, 1)),
        np.isfinite(slip.ravel()),
    )
    return true[..., FORCE_COLUMNS], motion, states


@pytest.fixture(scope="module")
def turned(yutu2: Rover, drive: tuple[np.ndarray, Motion, PoseStates]) -> AlternatingEstimate:
    _, motion, states = drive
    options = {"draws": 16, "correlation_m": 0.5, "seed": 2}
    return alternate(yutu2, synthetic_longji(), motion, states, first_belief(), rounds=8, **options)  # type: ignore[arg-type]


@pytest.mark.slow
def test_forces_and_soil_in_turn_converge_and_hold_the_hidden_soil(
    turned: AlternatingEstimate, hidden: np.ndarray
) -> None:
    assert turned.converged and 1 < len(turned.rounds) < 8
    assert turned.rounds[-1].soil < 0.1 and turned.rounds[-1].forces < 0.01
    belief = turned.posterior.belief
    assert np.abs(off_by(belief, hidden)).max() < 3.0
    left = belief.sd_ratio
    assert left["stiffness_kpa_m_n"] < 0.5 and left["sinkage_exponent_slip"] < 0.7
    assert left["cohesion_pa"] > 0.7, "slips of a few per cent cannot tell cohesion from friction"
    assert max(turned.posterior.reduced) < 1.5


@pytest.mark.slow
def test_forces_on_the_soil_that_was_found_are_the_true_ones(turned: AlternatingEstimate, drive) -> None:  # type: ignore[no-untyped-def]
    known = turned.forces.known.copy()
    known[:3] = known[-3:] = False
    off = (turned.forces.after - drive[0])[known]
    sigma = turned.forces.after_sigma[known]
    assert np.sqrt((off**2).mean(axis=(0, 1))).max() < 0.5
    assert (np.abs(off) < sigma).mean() > 0.6 and (np.abs(off) < 2 * sigma).mean() > 0.9


@pytest.mark.slow
def test_the_soil_does_not_follow_from_where_the_rounds_begin(yutu2: Rover, turned: AlternatingEstimate, drive) -> None:  # type: ignore[no-untyped-def]
    """Forces that came from a soil must not prove it: with other soils drawn for them the same soil is found."""
    _, motion, states = drive
    options = {"draws": 16, "correlation_m": 0.5, "seed": 77}
    other = alternate(yutu2, synthetic_longji(), motion, states, first_belief(), rounds=8, **options)  # type: ignore[arg-type]
    one, two = turned.posterior.belief, other.posterior.belief
    assert np.abs((one.mean - two.mean) / np.sqrt(np.diag(one.covariance))).max() < 0.3


def made_up(soil: float, forces: float, *step: float) -> Round:
    return Round(soil, forces, np.array(step), {}, 1.0, 1.0)


def test_rounds_converge_oscillate_or_neither() -> None:
    far, near = made_up(2.0, 0.2, 2.0, 0.0), made_up(0.05, 0.001, 0.05, 0.0)
    assert verdict_of([far, near]) == "converged"
    assert verdict_of([far]) == "does not converge"
    assert verdict_of([far, made_up(1.9, 0.2, -1.9, 0.1)]) == "oscillates"
    assert verdict_of([far, made_up(1.0, 0.1, -1.0, 0.1)]) == "does not converge"
    assert verdict_of([far, made_up(0.05, 0.2, 0.05, 0.0)]) == "does not converge"


def test_rounds_out_of_range_are_refused(yutu2: Rover, drive) -> None:  # type: ignore[no-untyped-def]
    _, motion, states = drive
    with pytest.raises(ParameterError, match="1 to 50"):
        alternate(yutu2, synthetic_longji(), motion, states, first_belief(), rounds=0, correlation_m=0.5)
