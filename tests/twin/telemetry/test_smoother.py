"""Distances of positions and headings from what all others say, chi-square, and the spread between assumptions.

How fast slip changes is found from the data, and the intervals hold on ground of waves. All of it is synthetic.
"""

import dataclasses
import warnings
from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from bench_states import LEVELS, PLAN, SENT, coarser, found_in, of_other_radius, scores, truth_of

from lunarsci.errors import LunarSciWarning
from lunarsci.regolith.soil import read_soil
from lunarsci.twin.ground.terrain import build_terrain
from lunarsci.twin.plans.plan import Leg
from lunarsci.twin.rover import Rover
from lunarsci.twin.simulation.ensemble import STATE_COLUMNS, predict
from lunarsci.twin.telemetry import smoother
from lunarsci.twin.telemetry.filter import Nodes
from lunarsci.twin.telemetry.nodes import WheelVelocities, slips_of
from lunarsci.twin.telemetry.simulated import SensorErrors, simulate_telemetry
from lunarsci.twin.telemetry.smoother import AMPLITUDES, LENGTHS_M, SlipProcess, change_of, smooth

COUNT, WAY_M = 21, 0.1
CHANGE = SlipProcess.fixed(np.array([0.03, 0.02, 0.01]), np.full(3, 1.0))
ERRORS_M2 = np.array([[5e-5, 2e-5], [2e-5, 3e-5]])


def straight(seed: int, yaw_sigma_rad: float = 0.002) -> Nodes:
    """Straight on, 3 % less far than the wheels say, with errors of positions and headings; so short that it is linear.

    Every third position and every fourth heading is not measured.
    """
    random = np.random.default_rng(seed)
    noise = random.standard_normal((COUNT, 2)) @ np.linalg.cholesky(ERRORS_M2).T
    fix = noise + np.column_stack([0.97 * WAY_M * np.arange(COUNT), np.zeros(COUNT)])
    yaw = yaw_sigma_rad * random.standard_normal(COUNT)
    fix[1::3], yaw[2::4] = np.nan, np.nan
    return Nodes(
        time_s=2.0 * np.arange(COUNT),
        twist=np.tile([0.05, 0.0, 0.0], (COUNT - 1, 1)),
        way_m=np.full(COUNT - 1, WAY_M),
        gap_sigma_m=np.zeros(COUNT - 1),
        restarts=np.zeros(COUNT - 1, dtype=bool),
        fix_m=fix,
        fix_covariance_m2=np.tile(ERRORS_M2, (COUNT, 1, 1)),
        yaw_rad=yaw,
        yaw_sigma_rad=np.full(COUNT, yaw_sigma_rad),
    )


def without(values: np.ndarray, k: int) -> np.ndarray:
    left = values.copy()
    left[k] = np.nan
    return left


def test_distances_are_those_from_where_the_motion_is_without_the_measurement() -> None:
    nodes = straight(0)
    found = smooth(nodes, CHANGE)
    residuals = smoother._residuals(
        nodes, found.reference, found.state, lambda rows: rows @ found.covariance @ np.swapaxes(rows, 1, 2)
    )
    places, headings = smoother._distances(nodes, found.reference, *residuals)
    assert np.array_equal(np.isfinite(places), np.isfinite(nodes.fix_m[:, 0]))
    assert np.array_equal(np.isfinite(headings), np.isfinite(nodes.yaw_rad))
    for k in (0, 5, 8, 20):
        other = smooth(replace(nodes, fix_m=without(nodes.fix_m, k)), CHANGE)
        off = nodes.fix_m[k] - other.state[k, :2]
        spread = ERRORS_M2 + other.covariance[k, :2, :2]
        assert places[k] == pytest.approx(off @ np.linalg.solve(spread, off), rel=1e-3)
    for k in (0, 5, 11, 20):
        other = smooth(replace(nodes, yaw_rad=without(nodes.yaw_rad, k)), CHANGE)
        spread_rad2 = nodes.yaw_sigma_rad[k] ** 2 + other.covariance[k, 2, 2]
        expected = (nodes.yaw_rad[k] - other.state[k, 2]) ** 2 / spread_rad2
        assert headings[k] == pytest.approx(expected, rel=1e-3, abs=1e-6)


def test_reduced_chi_square_is_that_of_the_generalised_least_squares() -> None:
    """Residuals of good positions have chi-square of tr(R S^-1), S of prior and errors R together.

    Headings are known, so that x and y are sums of a start, a constant share and a Matern 3/2 process each.
    """
    nodes = straight(1, yaw_sigma_rad=1e-7)
    nodes = replace(nodes, yaw_rad=np.zeros(COUNT))
    change = SlipProcess.fixed(np.array([0.03, 0.02, 1e-6]), np.full(3, 1.0))
    known = np.flatnonzero(np.isfinite(nodes.fix_m[:, 0]))
    places = WAY_M * np.arange(COUNT)
    middles = places[:-1] + 0.5 * WAY_M
    apart = np.sqrt(3.0) * np.abs(middles[:, None] - middles)
    lower = WAY_M * np.vstack([np.zeros(COUNT - 1), np.tri(COUNT - 1)])
    steps = 2e-4**2 * np.minimum.outer(np.arange(COUNT), np.arange(COUNT))
    prior = np.zeros((COUNT, 2, COUNT, 2))
    for axis, amplitude, mean in ((0, 0.03, 0.3), (1, 0.02, 0.1)):
        process = amplitude**2 * (1 + apart) * np.exp(-apart) + mean**2
        prior[:, axis, :, axis] = lower @ process @ lower.T + 10.0**2 + steps
    prior = prior[known][:, :, known].reshape(2 * len(known), -1)
    errors = np.kron(np.eye(len(known)), ERRORS_M2)
    start = nodes.fix_m[known] - np.column_stack([places[known], np.zeros(len(known))]) - nodes.fix_m[0]
    residual = errors @ np.linalg.solve(prior + errors, start.ravel())
    found = smooth(nodes, change)
    freedom = np.trace(np.linalg.solve(prior + errors, errors))
    assert 20.5 < freedom < 21.5 and residual.size == 28
    assert found.reduced_chi_square == pytest.approx(residual @ np.linalg.solve(errors, residual) / 21, rel=3e-3)


@pytest.mark.parametrize("held_bytes", [1, smoother.HELD_BYTES], ids=["in turn", "at once"])
def test_errors_hold_the_spread_between_assumptions(monkeypatch: pytest.MonkeyPatch, held_bytes: int) -> None:
    """The law of total variance for three equally probable processes: mean of the variances, variance of the means."""
    monkeypatch.setattr(smoother, "HELD_BYTES", held_bytes)
    nodes = straight(2)
    nodes.fix_m[:, 0] += 0.03 * np.sin(2.0 * np.pi * np.arange(COUNT) / 10)
    amplitude = np.array([[0.002, 0.002, 0.001], [0.03, 0.02, 0.01], [0.1, 0.1, 0.05]])
    length = np.array([[2.0, 1.0, 1.0], [1.0, 1.0, 1.0], [0.5, 0.3, 1.0]])
    alone = [smooth(nodes, SlipProcess.fixed(*pair)) for pair in zip(amplitude, length, strict=True)]
    found = smooth(nodes, replace(CHANGE, amplitude=amplitude, length_m=length, walk=np.zeros(3)))
    means = np.array([one.state[:, :9] for one in alone])
    within = np.mean([one.covariance[:, :9, :9] for one in alone], axis=0)
    apart = means - means.mean(axis=0)
    between = np.einsum("mni,mnj->nij", apart, apart) / 3
    sizes = np.sqrt(np.einsum("nii->ni", within + between))
    assert np.abs((found.state[:, :9] - means.mean(axis=0)) / sizes).max() < 0.01
    away = (found.covariance[:, :9, :9] - within - between) / sizes[:, :, None] / sizes[:, None, :]
    assert np.abs(away).max() < 0.01
    assert (np.einsum("nii->ni", between) / sizes**2)[:, 3].max() > 0.2


@pytest.mark.parametrize("rim_m_s", [0.05, -0.05], ids=["forwards", "backwards"])
def test_errors_of_slips_are_those_of_drawn_velocities(rim_m_s: float) -> None:
    """Of a wheel that slips, one that skids and one that slides sideways: 200,000 velocities, so that a standard
    deviation is known to 0.2 %. What is left with perfect sensors is added, 0.001 and 0.08 deg. ln of the scale of the
    rims is known to 2 %: all wheels slip by so much more or less."""
    random = np.random.default_rng(4)
    along, across = random.normal(size=(1, 3, 3)), random.normal(size=(1, 3, 3))
    v_x, v_y = rim_m_s * np.array([[0.8, 1.3, 0.7]]), rim_m_s * np.array([[0.1, -0.05, 0.5]])
    root = 2e-4 * random.normal(size=(3, 3))
    drawn, scales = random.standard_normal((200_000, 3)) @ root.T, 0.02 * random.standard_normal((200_000, 1))

    def slips(by: np.ndarray, scale: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        x, y = v_x + by @ along[0].T, v_y + by @ across[0].T
        travel, backwards = x / rim_m_s / np.exp(scale), np.sign(rim_m_s)
        slip = np.where(travel <= 1, 1 - travel, 1 / travel - 1)
        return slip, np.degrees(np.arctan2(backwards * y, backwards * x))

    covariance = np.zeros((1, 4, 4))
    covariance[0, :3, :3], covariance[0, 3, 3] = root @ root.T, 0.02**2
    velocities = WheelVelocities(v_x=v_x, v_y=v_y, along=along, across=across, covariance=covariance)
    motion: Any = SimpleNamespace(speed_m_s=np.full((1, 3), rim_m_s))
    slip, side, slip_sigma, side_sigma, shared = slips_of(velocities, motion)
    assert slip[0] == pytest.approx([0.2, 1 / 1.3 - 1, 0.3])
    assert side[0] == pytest.approx(slips(np.zeros((1, 3)), np.zeros((1, 1)))[1][0])
    expected = [np.hypot(of.std(axis=0), floor) for of, floor in zip(slips(drawn, scales), (0.001, 0.08), strict=True)]
    assert (expected[0] > 0.003).all() and (expected[1] > 0.3).all()
    assert slip_sigma[0] == pytest.approx(expected[0], rel=0.01)
    assert shared[0] == pytest.approx(slips(0.0 * drawn[:10_000], scales[:10_000])[0].std(axis=0), rel=0.05)
    assert side_sigma[0] == pytest.approx(expected[1], rel=0.01)


@pytest.mark.slow
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


@pytest.fixture
def unknown_slopes(monkeypatch: pytest.MonkeyPatch) -> None:
    """An amplitude of 0.02 is believed, as of ground that changes slip so much."""
    monkeypatch.setattr(smoother, "LEAST", 0.02)


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
        gap_sigma_m=np.zeros(count - 1),
        restarts=np.zeros(count - 1, dtype=bool),
        fix_m=fix,
        fix_covariance_m2=np.tile(sigma_m**2 * np.eye(2), (count, 1, 1)),
        yaw_rad=np.radians(0.1) * random.normal(size=count),
        yaw_sigma_rad=np.full(count, np.radians(0.1)),
    )


@pytest.mark.slow
@pytest.mark.parametrize(("amplitude", "wave_m"), [(0.06, 2.0), (0.06, 6.0), (0.006, 6.0)])
@pytest.mark.usefixtures("unknown_slopes")
def test_amplitude_and_length_are_found_where_positions_are_good(amplitude: float, wave_m: float) -> None:
    """A process of Matern 3/2 is about as smooth as a wave is long over 4; its amplitude is that of the wave, or, as a
    wave is smoother, up to half more. Between seeds these scatter by a tenth."""
    found = change_of(traverse_of(amplitude * np.sqrt(2.0) * np.sin(2.0 * np.pi * PLACE_M / wave_m), 0.002, 2))
    assert 0.95 < found.usual[0] / amplitude < 1.65
    assert found.usual[1] < 0.4 * amplitude or amplitude < 0.01
    assert found.information[0] > 0.3
    if amplitude > 0.01:
        assert 0.3 * wave_m < found.usual_length_m[0] < 0.5 * wave_m


@pytest.mark.slow
@pytest.mark.usefixtures("unknown_slopes")
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


@pytest.mark.slow
@pytest.mark.usefixtures("unknown_slopes")
def test_what_is_not_known_of_the_change_stays_open() -> None:
    """Coarse positions tell nothing: the candidates are as far apart as was believed."""
    few = change_of(traverse_of(np.zeros(40), 0.5, 20))
    many = change_of(traverse_of(np.zeros(100), 0.002, 2))
    assert few.information[0] < 0.05 and many.information[0] > 0.3
    assert np.ptp(np.log(few.amplitude[:, 0])) > 1.5
    assert set(np.round(np.log(few.amplitude[:, 0]), 9)) <= set(np.round(np.log(AMPLITUDES), 9))
    assert set(few.length_m.ravel()) <= set(np.exp(np.log(LENGTHS_M)))
    assert many.usual[0] < few.usual[0]


@pytest.mark.slow
@pytest.mark.usefixtures("unknown_slopes")
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


@pytest.mark.slow
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


@pytest.mark.slow
def test_rows_far_apart_see_the_ground_between_them() -> None:
    """Telemetry every 0.25 m has nodes as dense as any, and no more positions."""
    truth = truth_of("same", "1.2 m", 0)
    states = found_in(simulate_telemetry(coarser(truth, 5), SensorErrors(), 0), truth.terrain)
    assert np.diff(states.nodes.time_s).max() < 4.0
    assert np.isfinite(states.nodes.fix_m[:, 0]).sum() == np.isfinite(states.telemetry.fix_m[:, 0]).sum()
    assert len(states.telemetry.time_s) < 0.5 * len(states.nodes.time_s)
