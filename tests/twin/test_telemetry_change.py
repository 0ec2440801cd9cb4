"""How fast slip changes is found from the data, and the intervals hold on ground of waves. All of it is synthetic."""

import dataclasses
import warnings

import numpy as np
import pytest
from bench_states import LEVELS, PLAN, SENT, coarser, found_in, of_other_radius, scores, truth_of

from lunarsci.errors import LunarSciWarning
from lunarsci.regolith.soil import read_soil
from lunarsci.twin.ground.terrain import build_terrain
from lunarsci.twin.plans.plan import Leg
from lunarsci.twin.rover import Rover
from lunarsci.twin.simulation.ensemble import STATE_COLUMNS, predict
from lunarsci.twin.telemetry.filter import Nodes
from lunarsci.twin.telemetry.simulated import SensorErrors, simulate_telemetry
from lunarsci.twin.telemetry.smoother import AMPLITUDES, LENGTHS_M, change_of


def test_intervals_hold_on_waved_ground() -> None:
    """Four drives on four soils over waves of 2 m, with dense and usual positions; drives count, not states.

    The rover file's radius is off as much as radii are thought to be.
    """
    shares = []
    for seed in range(4):
        truth = truth_of("same", "2 m", seed)
        every, errors = SENT[("usual", "slow")[seed % 2]]
        sent = of_other_radius(simulate_telemetry(coarser(truth, every), errors, seed), seed)
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", LunarSciWarning)
            states = found_in(sent, truth.terrain)
        error, sigma = scores(states, truth)["slip_ratio"]
        shares.append([(np.abs(error) < z * sigma).mean() for _, z in LEVELS])
    inner, outer = np.mean(shares, axis=0)
    assert inner > 0.5 and outer > 0.85


PLACE_M = 0.1 * np.arange(100) + 0.05


def traverse_of(deviation: np.ndarray, sigma_m: float, every: int, seed: int = 0) -> Nodes:
    """A straight way along which the rover goes less or more far than its wheels by a share."""
    count, way = len(deviation) + 1, 0.1
    random = np.random.default_rng(seed)
    x = np.append(0.0, np.cumsum(way * (1.0 + deviation))) + sigma_m * random.normal(size=count)
    fix = np.column_stack([x, sigma_m * random.normal(size=count)])
    fix[np.arange(count) % every > 0] = np.nan
    return Nodes(
        time_s=2.0 * np.arange(count),
        twist=np.tile([0.05, 0.0, 0.0], (count - 1, 1)),
        way_m=np.full(count - 1, way),
        loose=np.zeros(count - 1),
        apart=np.zeros(count - 1, dtype=bool),
        fix_m=fix,
        fix_covariance_m2=np.tile(sigma_m**2 * np.eye(2), (count, 1, 1)),
        yaw_rad=np.radians(0.1) * random.normal(size=count),
        yaw_sigma_rad=np.full(count, np.radians(0.1)),
    )


@pytest.mark.parametrize(("amplitude", "wave_m"), [(0.06, 2.0), (0.06, 6.0), (0.006, 6.0)])
def test_amplitude_and_length_are_found_where_positions_are_good(amplitude: float, wave_m: float) -> None:
    """A process of Matern 3/2 is about as smooth as a wave is long over 4; its amplitude is that of the wave, or, as a
    wave is smoother, up to half more. Between seeds these scatter by a tenth."""
    found = change_of(traverse_of(amplitude * np.sqrt(2.0) * np.sin(2.0 * np.pi * PLACE_M / wave_m), 0.002, 2))
    assert 0.95 < found.usual[0] / amplitude < 1.65
    assert found.usual[1] < 0.4 * amplitude or amplitude < 0.01
    assert found.information[0] > 0.3
    if amplitude > 0.01:
        assert 0.3 * wave_m < found.usual_length_m[0] < 0.5 * wave_m


def test_amplitudes_of_drawn_processes_are_found_within_their_spread() -> None:
    """Of 10 processes of Matern 3/2: in ln the amplitudes scatter by 0.15, which is less than the spread says, as that
    covers the steps between candidates too."""
    amplitude, random, off = 0.06, np.random.default_rng(0), []
    apart = np.sqrt(3.0) * np.abs(PLACE_M[:, None] - PLACE_M) / 0.7
    root = np.linalg.cholesky(amplitude**2 * (1.0 + apart) * np.exp(-apart) + 1e-12 * np.eye(len(PLACE_M)))
    for seed in range(10):
        found = change_of(traverse_of(root @ random.standard_normal(len(PLACE_M)), 0.002, 2, seed))
        off.append((np.log(found.usual[0] / amplitude), found.spread[0]))
    away, spread = np.array(off).T
    assert away.mean() == pytest.approx(0.0, abs=0.15)
    assert 0.45 < np.sqrt((away**2).mean()) / np.sqrt((spread**2).mean()) < 1.15


def test_what_is_not_known_of_the_change_stays_open() -> None:
    """Coarse positions tell nothing: the candidates are as far apart as was believed."""
    few = change_of(traverse_of(np.zeros(40), 0.5, 20))
    many = change_of(traverse_of(np.zeros(100), 0.002, 2))
    assert few.information[0] < 0.05 and many.information[0] > 0.3
    assert np.ptp(np.log(few.amplitude[:, 0])) > 1.5
    assert set(np.round(np.log(few.amplitude[:, 0]), 9)) <= set(np.round(np.log(AMPLITUDES), 9))
    assert set(few.length_m.ravel()) <= set(np.exp(np.log(LENGTHS_M)))
    assert many.usual[0] < few.usual[0]


def test_where_positions_say_nothing_what_was_believed_remains() -> None:
    """Candidates under a normal law of width 1.7 in ln about 0.02: their mean and standard deviation."""
    found = change_of(traverse_of(np.zeros(40), 1e3, 20))
    ln = np.log(AMPLITUDES)
    weight = np.exp(-0.5 * ((ln - np.log(0.02)) / 1.7) ** 2)
    mean = weight @ ln / weight.sum()
    spread = np.sqrt(weight @ (ln - mean) ** 2 / weight.sum())
    assert found.usual[:2] == pytest.approx(np.exp([mean, mean]), rel=1e-3)
    assert found.spread[:2] == pytest.approx([spread, spread], rel=1e-3)
    assert found.information[:2] == pytest.approx([0.0, 0.0], abs=1e-6)
    assert found.usual_length_m[:2] == pytest.approx(np.exp(np.log(LENGTHS_M).mean()), rel=1e-3)


def test_slip_follows_a_slope_between_positions(yutu2: Rover) -> None:
    """Up and down a wave between positions 2 m apart: the slope says what positions do not."""
    x = np.arange(-2.0, 10.01, 0.05)
    height = 0.03 * np.cos(2.0 * np.pi * x / 3.0)
    waved = build_terrain("waved", -2.0, -3.0, 0.05, np.repeat(height[None, :], 121, axis=0), read_soil("longji"))
    plan = dataclasses.replace(PLAN, legs=(Leg(7.0),))
    drive = predict(yutu2, waved, plan, sweep=(), time_step_s=0.05, sample_m=0.05)
    states = found_in(simulate_telemetry(drive, SensorErrors(fix_distance_m=2.0, fix_sigma_m=0.005), 1), waved)
    column = STATE_COLUMNS.index("slip_ratio")
    dense = np.interp(states.motion.time_s[3:-3], drive.time_s, drive.states[0, :, :, column].mean(axis=1))
    middle = states.held.states[3:-3, :, column].mean(axis=1)
    assert np.std(dense) > 0.01
    assert np.corrcoef(middle, dense)[0, 1] > 0.85


def test_rows_far_apart_see_the_ground_between_them() -> None:
    """Telemetry every 0.25 m has nodes as dense as any, and no more positions."""
    truth = truth_of("same", "1.2 m", 0)
    states = found_in(simulate_telemetry(coarser(truth, 5), SensorErrors(), 0), truth.terrain)
    assert np.diff(states.nodes.time_s).max() < 4.0
    assert np.isfinite(states.nodes.fix_m[:, 0]).sum() == np.isfinite(states.telemetry.fix_m[:, 0]).sum()
    assert len(states.telemetry.time_s) < 0.5 * len(states.nodes.time_s)
