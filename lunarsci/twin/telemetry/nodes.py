"""From rows of telemetry to the nodes at which the motion is found, from these to motion and slips of wheels."""

import dataclasses
import math
from dataclasses import dataclass, replace
from typing import Any, NamedTuple

import numpy as np

from lunarsci.arrays import BoolArray, FloatArray, IndexArray
from lunarsci.errors import DataError
from lunarsci.twin.plans.motion import Motion
from lunarsci.twin.plans.path import CREEP_M_S
from lunarsci.twin.rover import Rover
from lunarsci.twin.simulation.prescribed_motion import PrescribedLoads
from lunarsci.twin.telemetry.filter import EFFECTS, SCALE, ErrorChain, Nodes, ReferenceMotion, at_nodes
from lunarsci.twin.telemetry.hypotheses import Priors
from lunarsci.twin.telemetry.reading import OBEYED, STILL, Telemetry
from lunarsci.twin.telemetry.smoother import Smoothed, prior_process, probable
from lunarsci.twin.telemetry.wheel_motion import (
    ON_THE_SPOT,
    WheelMotion,
    ground_velocities,
    mean_speed,
    shape_effect,
    slope_effect,
    wheel_rows,
)

NODE_M = 0.1
"""Way between the moments at which the motion is found. [m]"""
SAME_S = 1e-3
"""Times that differ by less are one. Half or twice as much moves no slip, as measured. [s]"""
MOST_NODES = 30_000
"""That are smoothed at once: 3 km without positions. `tests/benchmarks/load.py` tells their memory."""
STIFFNESSES = (0.1, 0.17, 0.28, 0.48, 0.8)
"""Candidates for the stiffness of the ground against side slip, as a share of that against slip. Twice as many move
slips by 0.01 of their errors at most, as measured by `tests/benchmarks/telemetry_constants.py`."""
AGREEMENT, LEAST_EFFECT = 0.4, 0.1
"""How well, in ln, the stiffness and the coefficients of slip and side slip agree, and the least of these; half or
twice as much moves slips by 0.07 of their errors at most, as measured."""
MEASURED = ("fix_m", "fix_covariance_m2", "fix_shared_m2", "yaw_deg", "yaw_deg_sigma", "roll_deg", "pitch_deg")
"""Columns of `Telemetry` that are by the clock of the positions."""
UNKNOWN_SLIP = 3.0**-0.5
"""Standard deviation of a slip of which nothing is known but that it is -1 to 1: half the width over the root of 3, by
definition of a uniform distribution. [-]"""
SLIP_FLOOR, SIDE_SLIP_FLOOR_DEG = 0.001, 0.08
"""What is left where all sensors are all but perfect, measured: 0.0005 to 0.0009 and 0.04 to 0.06 deg on six made-up
drives over ground of 0 to 5 mm roughness; the steering's own error of 0.1 deg, of which a few rows are averaged, adds
0.06 deg."""


def any_rim_turns(rim_m_s: FloatArray) -> BoolArray:
    """Whether any rim turns, or it is not known; `wheel_motion` has 0 at rest. (n,)"""
    return np.asarray((rim_m_s != 0).any(axis=1))


class Rows(NamedTuple):
    """Rows of telemetry, and what follows from them.

    Attributes
    ----------
    telemetry : n rows.
    wheels : how the wheels moved between them.
    steering_rad : of each wheel. (n, wheels) [rad]
    gaps : steps between rows that are too long to say how the rover moved. (n - 1,)
    """

    telemetry: Telemetry
    wheels: WheelMotion
    steering_rad: FloatArray
    gaps: BoolArray


def _resampled(rows: Rows, times: FloatArray, measured_s: FloatArray) -> Rows:
    """The same at more times, with positions, headings and attitude at those that are given for each old row.

    Wheels turn evenly between rows.
    """
    old = rows.telemetry
    step = np.clip(np.searchsorted(old.time_s, times[:-1], side="right") - 1, 0, len(old.time_s) - 2)
    inside = (measured_s >= times[0]) & (measured_s <= times[-1])
    columns: dict[str, Any] = {"time_s": times}
    for field in dataclasses.fields(old):
        values = getattr(old, field.name)
        if isinstance(values, np.ndarray) and field.name != "time_s":
            measured = field.name in MEASURED
            at, some = (measured_s[inside], values[inside]) if measured else (old.time_s, values)
            columns[field.name] = np.full((len(times), *values.shape[1:]), np.nan)
            columns[field.name][np.searchsorted(times, at)] = some
    between = {name: getattr(rows.wheels, name)[step] for name in ("rim_m_s", "measured", "trusted")}
    steered = np.column_stack([np.interp(times, old.time_s, column) for column in rows.steering_rad.T])
    return Rows(replace(old, **columns), replace(rows.wheels, **between), steered, rows.gaps[step])


def densified(rows: Rows) -> Rows:
    """The same with rows between those that are far apart, but over gaps: the ground changes within a wheel's way.

    Positions, headings and attitude are blank in the new ones.
    """
    times = rows.telemetry.time_s
    way = mean_speed(rows.wheels.rim_m_s) * np.diff(times)
    parts = np.where(rows.gaps, 1, np.maximum(np.rint(way / NODE_M), 1)).astype(int)
    if (parts == 1).all():
        return rows
    at = np.append(0, np.cumsum(parts))
    dense = np.interp(np.arange(at[-1] + 1), at, times)
    dense[at] = times
    return _resampled(rows, dense, times)


def shifted_back(rows: Rows, lag_s: float) -> Rows:
    """With positions, headings and attitude at the time of the wheels that made them: a lag earlier.

    Those that are then before the first row or after the last one are left out.
    """
    if lag_s == 0.0:
        return rows
    times = rows.telemetry.time_s
    at = times - lag_s
    nearest = times[np.clip(np.searchsorted(times, at - SAME_S), 0, len(times) - 1)]
    at = np.where(np.abs(nearest - at) < SAME_S, nearest, at)
    return _resampled(rows, np.union1d(times, at[(at >= times[0]) & (at <= times[-1])]), at)


def overlapping(rows: Rows, lag_s: float) -> Rows:
    """With those positions and headings alone that have a row a lag before."""
    times = rows.telemetry.time_s
    outside = (times - lag_s < times[0]) | (times - lag_s > times[-1])
    blank = {name: getattr(rows.telemetry, name).copy() for name in ("fix_m", "yaw_deg")}
    for values in blank.values():
        values[outside] = np.nan
    return rows._replace(telemetry=replace(rows.telemetry, **blank))


def _drives(wheels: WheelMotion, twist: FloatArray) -> BoolArray:
    """Between which rows the rover drives: not at a halt, nor turning on the spot. (n - 1,)"""
    speed = np.hypot(twist[:, 0], twist[:, 1])
    return np.asarray(
        wheels.moving & (speed > ON_THE_SPOT * mean_speed(wheels.rim_m_s)) & (speed > STILL * wheels.usual_m_s)
    )


def nodes_of(sent: Rows, twist: FloatArray, way_m: FloatArray) -> tuple[Nodes, IndexArray]:
    """Nodes and the rows they are. Raises DataError for more of them than there is to be memory for."""
    telemetry, wheels, _, gaps = sent
    drives, rests = _drives(wheels, twist), ~any_rim_turns(wheels.rim_m_s)
    stage = np.floor(way_m / NODE_M)
    chosen = telemetry.fixed | np.append(True, np.diff(stage) > 0)
    changes = (drives[1:] != drives[:-1]) | (rests[1:] != rests[:-1])
    chosen[:-1] |= np.append(False, changes) | gaps
    chosen[1:] |= gaps
    chosen[-1] = True
    rows = np.flatnonzero(chosen)
    if len(rows) > MOST_NODES:
        fixes = int(telemetry.fixed.sum())
        raise DataError(
            f"{telemetry.file}: {len(rows):,} moments, of {way_m[-1]:.4g} m and {fixes:,} positions; "
            f"{MOST_NODES:,} are smoothed at once: take a part with `since` and `until`, or fewer positions"
        )
    times = telemetry.time_s
    steps = np.diff(times)

    def total(values: FloatArray) -> FloatArray:
        return np.asarray(np.add.reduceat(values, rows[:-1], axis=0))

    length = np.diff(times[rows])
    blind = total((gaps * steps * np.nan_to_num(mean_speed(wheels.rim_m_s))).astype(float))
    kinds = drives[rows[:-1]]
    return (
        Nodes(
            time_s=times[rows],
            twist=total(twist * steps[:, None]) / length[:, None],
            way_m=np.diff(way_m[rows]),
            gap_sigma_m=OBEYED * blind,
            restarts=np.append(False, kinds[1:] != kinds[:-1]),
            fix_m=telemetry.fix_m[rows],
            fix_covariance_m2=telemetry.fix_covariance_m2[rows],
            yaw_rad=np.radians(telemetry.yaw_deg[rows]),
            yaw_sigma_rad=np.radians(telemetry.yaw_deg_sigma[rows]),
            chain=_chain(telemetry, rows),
        ),
        rows,
    )


def _chain(telemetry: Telemetry, rows: IndexArray) -> ErrorChain | None:
    """How errors of positions follow each other; None where they are independent."""
    if telemetry.fix_shared_m2 is None or not np.nan_to_num(telemetry.fix_shared_m2[rows]).any():
        return None
    follows, noise = np.tile(np.eye(2), (len(rows), 1, 1)), np.zeros((len(rows), 2, 2))
    before = np.eye(2)
    for k in np.flatnonzero(telemetry.fixed[rows]):
        covariance, shared = telemetry.fix_covariance_m2[rows[k]], telemetry.fix_shared_m2[rows[k]]
        follows[k] = shared @ np.linalg.inv(before)
        noise[k] = covariance - follows[k] @ shared.T
        before = covariance
    return ErrorChain(follows, noise)


def motion_at(
    rover: Rover,
    telemetry: Telemetry,
    nodes: Nodes,
    smoothed: Smoothed,
    wheels: WheelMotion,
    steering_rad: FloatArray,
    rows: IndexArray,
    sway_m: FloatArray,
) -> Motion:
    """The smoothed motion of the rover's origin, with the wheels as they were measured, else as the others say."""
    rim = _rim_speed_at_nodes(telemetry.time_s, wheels.rim_m_s, rows)
    steered = np.column_stack([_centred_mean(column, rows) for column in np.degrees(steering_rad).T])
    given = np.isfinite(rim)
    lost: BoolArray = ~given & given.any(axis=1, keepdims=True)
    if lost.any():
        along, _ = wheel_rows(rover, np.radians(steered))
        rim = np.where(lost, np.einsum("nwi,ni->nw", along, at_nodes(nodes.twist)), rim)
    sign, scale = np.where(rim < 0, -1.0, 1.0), math.exp(smoothed.posterior.mean[SCALE])
    rim = sign * np.maximum(scale * np.abs(np.nan_to_num(rim)), CREEP_M_S)
    return Motion(
        time_s=nodes.time_s,
        x_m=smoothed.state[:, 0] + sway_m[:, 0],
        y_m=smoothed.state[:, 1] + sway_m[:, 1],
        yaw_deg=np.degrees(smoothed.state[:, 2]),
        steering_deg=np.clip(steered, -90.0, 90.0),
        speed_m_s=rim,
    )


def _rim_speed_at_nodes(time_s: FloatArray, between: FloatArray, rows: IndexArray) -> FloatArray:
    """Means between the nodes before and after each node, from means between rows. (nodes, wheels)

    Where the rover stands on one side the other counts alone: how long it stands says nothing of how it came there.
    """
    steps = np.diff(time_s)[:, None]
    given = np.isfinite(between) & any_rim_turns(between)[:, None]
    total = np.vstack([np.zeros(between.shape[1]), np.cumsum(np.where(given, between, 0.0) * steps, axis=0)])
    spent = np.vstack([np.zeros(between.shape[1]), np.cumsum(given * steps, axis=0)])
    low, high = rows[np.maximum(np.arange(len(rows)) - 1, 0)], rows[np.minimum(np.arange(len(rows)) + 1, len(rows) - 1)]
    with np.errstate(invalid="ignore"):
        return np.asarray(
            (total[high] - total[low]) / np.where(spent[high] > spent[low], spent[high] - spent[low], np.nan)
        )


def _centred_mean(values: FloatArray, rows: IndexArray) -> FloatArray:
    """Mean of a column over the rows nearer to each node than to others, both ways alike."""
    result = np.empty(len(rows))
    for k, row in enumerate(rows):
        reach = min(row - rows[k - 1] if k else 0, rows[k + 1] - row if k + 1 < len(rows) else 0) // 2
        result[k] = values[row - reach : row + reach + 1].mean()
    return result


def with_ground_effects(
    rover: Rover, nodes: Nodes, held: PrescribedLoads, sway_m: FloatArray, priors: Priors, reference: ReferenceMotion
) -> Nodes:
    """Nodes that know what the shape and the slopes of the ground do to the motion, from a motion that is about right.

    How stiff the ground is against side slip is a mean in ln over `STIFFNESSES`, weighed by how probable each makes
    positions and headings, and by how it agrees with the coefficients that it leads to: their inverse ratio.

    Parameters
    ----------
    sway_m : of the rover's origin (see `sway_m`), which `held` contains. (n, 2) [m]
    priors, reference : of the motion without the ground.
    """
    ln_weight = []
    for stiffness in STIFFNESSES:
        tried = _ground_effects(rover, nodes, held, sway_m, stiffness)
        constants, ln_likelihood = probable(tried, prior_process(tried), priors, reference)
        along, across = np.maximum(constants[3:5], LEAST_EFFECT)
        ln_weight.append(ln_likelihood - 0.5 * (np.log(stiffness * across / along) / AGREEMENT) ** 2)
    weight = np.exp(np.array(ln_weight) - max(ln_weight))
    mean = float(np.exp(weight @ np.log(STIFFNESSES) / weight.sum()))
    return _ground_effects(rover, nodes, held, sway_m, mean)


def _ground_effects(rover: Rover, nodes: Nodes, held: PrescribedLoads, sway_m: FloatArray, stiffness: float) -> Nodes:
    place = np.column_stack([held.motion.x_m, held.motion.y_m]) - sway_m
    shape = shape_effect(rover, held, place, stiffness)
    # A rover that stands is moved by no shape, however long the step is.
    moved = np.where(nodes.way_m[:, None] > 0, 0.5 * (shape[1:] + shape[:-1]), 0.0)
    effect = turn_effect(nodes)
    effect[:, :, :2] = slope_effect(rover, held, stiffness)
    return replace(nodes, twist=nodes.twist + moved, fix_m=nodes.fix_m - sway_m, effect=effect)


def turn_effect(nodes: Nodes) -> FloatArray:
    """Deviations for coefficients of 1 where slopes are not known: what turns do alone. (n, 3, 5)"""
    effect, pace = np.zeros((len(nodes.time_s), 3, len(EFFECTS))), rim_speed_at(nodes)
    turn = np.divide(at_nodes(nodes.twist)[:, 2], pace, out=np.zeros_like(pace), where=pace > 0)
    effect[:, 2, 2] = effect[:, 1, 3] = effect[:, 0, 4] = turn
    return effect


def rim_speed_at(nodes: Nodes) -> FloatArray:
    """Mean speed of the rims at the nodes. (n,) [m/s]"""
    return at_nodes(nodes.way_m / np.diff(nodes.time_s))


def twist_at(nodes: Nodes, smoothed: Smoothed) -> FloatArray:
    """Velocity ahead, to the left, and turn at the nodes. (n, 3) [m/s, m/s, rad/s]"""
    scale = 1.0 + smoothed.posterior.mean[SCALE]
    return np.asarray(scale * at_nodes(nodes.twist) + rim_speed_at(nodes)[:, None] * smoothed.deviation)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class WheelVelocities:
    """Velocity of every wheel along and across its plane on the ground, at the nodes.

    Attributes
    ----------
    v_x, v_y : forward as the rover has it, and to the left. (n, wheels) [m/s]
    along, across : what they are per velocity of the rover (see `wheel_rows`). (n, wheels, 3)
    covariance : of the rover's velocities and of ln of the rims' scale. (n, 4, 4)
    """

    v_x: FloatArray
    v_y: FloatArray
    along: FloatArray
    across: FloatArray
    covariance: FloatArray


def wheel_velocities(rover: Rover, nodes: Nodes, smoothed: Smoothed, held: PrescribedLoads) -> WheelVelocities:
    """Velocities of the wheels where the rover moves as smoothed, held to the ground; as on a plane where it does not
    come to rest on the soil that is assumed."""
    along, across = wheel_rows(rover, np.radians(held.motion.steering_deg))
    off_x, off_y = (np.nan_to_num(part) for part in ground_velocities(rover, held, smoothed.state[:, :2]))
    twist, onto = twist_at(nodes, smoothed), np.zeros((len(nodes.time_s), 4, 4))
    onto[:, [0, 1, 2], [0, 1, 2]] = rim_speed_at(nodes)[:, None]
    onto[:, :3, 3], onto[:, 3, 3] = at_nodes(nodes.twist), 1.0
    return WheelVelocities(
        v_x=off_x + np.einsum("nwi,ni->nw", along, twist),
        v_y=off_y + np.einsum("nwi,ni->nw", across, twist),
        along=along,
        across=across,
        covariance=onto @ smoothed.deviation_covariance @ np.swapaxes(onto, 1, 2),
    )


class Slips(NamedTuple):
    """Slips of the wheels with their standard errors.

    Attributes
    ----------
    slip_ratio, slip_ratio_sigma : slip ratio and its error. (n, wheels) [-]
    side_slip_deg, side_slip_deg_sigma : side slip and its error. (n, wheels) [deg]
    slip_ratio_shared : part of the slip's error that all states share. (n, wheels) [-]
    """

    slip_ratio: FloatArray
    side_slip_deg: FloatArray
    slip_ratio_sigma: FloatArray
    side_slip_deg_sigma: FloatArray
    slip_ratio_shared: FloatArray


def slips_of(velocities: WheelVelocities, motion: Motion) -> Slips:
    """Slips of wheels that turn as in a motion; what is not known of the scale of their rims is an error they share."""
    rim, sign = np.abs(motion.speed_m_s), np.sign(motion.speed_m_s)
    v_x, v_y = sign * velocities.v_x, sign * velocities.v_y
    travel = v_x / rim
    # Where the rover slides back slip is 1, as the twin has it.
    slip = np.where(travel <= 1.0, 1.0 - np.maximum(travel, 0.0), 1.0 / np.maximum(travel, 1.0) - 1.0)
    side = np.degrees(np.arctan2(v_y, np.abs(v_x)))
    across, covariance = velocities.across, velocities.covariance
    by = np.concatenate([sign[..., None] * velocities.along / rim[..., None], -travel[..., None]], axis=-1)
    steep = np.where(slip >= 0, 1.0, (1.0 + np.minimum(slip, 0.0)) ** 2)
    travel_sigma = np.sqrt(np.einsum("mwi,mij,mwj->mw", by, covariance, by))
    slip_sigma = np.minimum(np.hypot(steep * travel_sigma, SLIP_FLOOR), UNKNOWN_SLIP)
    scale_sigma = np.sqrt(np.maximum(covariance[:, 3, 3], 1e-300))[:, None]
    shared = steep * np.abs(np.einsum("mwi,mi->mw", by, covariance[:, :, 3])) / scale_sigma
    # A wheel that does not move at all, as at a halt, has no direction; its state is not measured.
    squared = np.maximum(v_x**2 + v_y**2, CREEP_M_S**2)
    weights = (across * np.abs(v_x)[..., None] - velocities.along * (np.sign(v_x) * v_y)[..., None]) / squared[
        ..., None
    ]
    side_sigma = np.degrees(np.sqrt(np.einsum("mwi,mij,mwj->mw", weights, covariance[:, :3, :3], weights)))
    return Slips(slip, side, slip_sigma, np.hypot(side_sigma, SIDE_SLIP_FLOOR_DEG), np.minimum(shared, slip_sigma))
