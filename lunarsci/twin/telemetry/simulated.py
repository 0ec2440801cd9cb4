"""The telemetry a drive would send, sensor errors included: a made-up drive whose truth is known."""

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from lunarsci.arrays import BoolArray, FloatArray, IntArray
from lunarsci.errors import ParameterError
from lunarsci.ranges import NOT_NEGATIVE, POSITIVE, check_each
from lunarsci.twin.plans.path import all_commands, commands_at, fix_errors, make_schedule
from lunarsci.twin.simulation.ensemble import PATH_COLUMNS, STATE_COLUMNS, Prediction

if TYPE_CHECKING:
    import pandas as pd

TRAVEL_SHARE = 0.04 / 3.0
"""Error of visual localisation as a share of the distance: 4 % read as three standard deviations, Ding et al. (2024),
10.1038/s41467-024-46233-8."""
FINER = 10
"""Steps of the wheel angle's sum in each interval between rows."""
TRACK_WIDTHS = 0.7
"""Way between points of the track in wheel widths, assumed: the error of a depth is that of one wheel's footprint."""
SPARSE_WIDTHS, SPARSE_SHARE = 1.05, 0.1
"""Way in wheel widths between points that can be picked of the recorded places, beyond which a wheel may stand farther
than half its width from any, and the share of the way where that may be; then there are places between; assumed."""
FILLED_WIDTHS = 0.1
"""Way between those in wheel widths; assumed."""
DENSE_M = 0.01
"""Points of a wheel's path at which its rut is known. [m]"""


@dataclass(frozen=True, slots=True, kw_only=True)
class SensorErrors:
    """How often and how well a rover measures itself; errors are independent and normal.

    Attributes
    ----------
    fix_distance_m : commanded distance between localised positions, > 0. [m]
    fix_sigma_m : standard error of each in x and in y; None takes `TRAVEL_SHARE` of the distance between them. [m]
    yaw_deg, tilt_deg : of heading, and of roll and pitch; assumed, as of an inertial unit with sun sightings. [deg]
    wheel_angle_deg, wheel_rate_deg_s, steered_deg : of a wheel's angle, rate and steering; assumed. [deg, deg/s, deg]
    track_m : of a track's depth: 1 mm as three standard deviations, Ding et al. (2024). [m]

    Raises ParameterError for a distance that is not positive and errors below 0.
    """

    fix_distance_m: float = 0.5
    fix_sigma_m: float | None = None
    yaw_deg: float = 0.1
    tilt_deg: float = 0.1
    wheel_angle_deg: float = 0.1
    wheel_rate_deg_s: float = 0.1
    steered_deg: float = 0.1
    track_m: float = 0.00033

    def __post_init__(self) -> None:
        ranges = {name: POSITIVE if name.startswith("fix_") else NOT_NEGATIVE for name in self.__slots__}
        check_each("sensor error", self, ranges)

    @property
    def position_m(self) -> float:
        """Standard error of a localised position in x and in y. [m]"""
        return TRAVEL_SHARE * self.fix_distance_m if self.fix_sigma_m is None else self.fix_sigma_m


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class SyntheticDrive:
    """A made-up drive.

    Attributes
    ----------
    prediction : the drive itself, one member: the truth.
    errors, seed : what its telemetry was blurred with.
    telemetry : a row for each time, as a rover would send it; column `synthetic` is true throughout. With position
        fixes column `halted` is true at halts.
    halts : rows of telemetry at which the rover found out where it was before it steered on; empty without fixes.
    track : depth of the track at points along it, with its error.
    """

    prediction: Prediction
    errors: SensorErrors
    seed: int
    telemetry: "pd.DataFrame"
    track: "pd.DataFrame"
    halts: IntArray


def simulate_telemetry(prediction: Prediction, errors: SensorErrors, seed: int = 0) -> SyntheticDrive:
    """Telemetry and track of the only member of a prediction.

    A localised position is sent at the start, after each `fix_distance_m` of the commanded way, and at the end. At a
    halt of a plan with fixes it is the one by which the rover then steers, with the errors of these fixes. The
    wheels turn as commanded. Where a wheel passed, the track keeps the depth of the deepest one that did: the ground
    neither rises again nor fills in.

    Raises ParameterError for several members or a drive of no motion.
    """
    if prediction.members != 1 or int(prediction.recorded[0]) < 3:
        many = f"telemetry is of one drive, not of {prediction.members}; give one soil"
        raise ParameterError(many if prediction.members != 1 else f"nothing to send: {prediction.outcome_text(0)}")
    random = np.random.default_rng(seed)
    halts = _halts(prediction)
    return SyntheticDrive(
        prediction=prediction,
        errors=errors,
        seed=seed,
        telemetry=_telemetry(prediction, errors, random, halts),
        track=_track(prediction, errors, random),
        halts=np.array(sorted(halts), dtype=np.int64),
    )


def _halts(prediction: Prediction) -> dict[int, FloatArray]:
    """Rows at which the rover is localised at a halt, and how far off in x and y it then believes to be. [m]"""
    if prediction.plan.fixes is None:
        return {}
    schedule = make_schedule(prediction.plan, prediction.rover)
    off = fix_errors(schedule, 1, prediction.seed)[0]
    rows = [int(np.abs(prediction.time_s - run.begin_s).argmin()) for run in schedule.runs[1:]]
    return {row: error[:2] for row, error in zip(rows, off[1:], strict=True) if row < int(prediction.recorded[0])}


def _telemetry(
    prediction: Prediction, errors: SensorErrors, random: np.random.Generator, halts: Mapping[int, FloatArray]
) -> "pd.DataFrame":
    import pandas as pd

    count = int(prediction.recorded[0])
    path = {name: prediction.paths[0, :count, k] for k, name in enumerate(PATH_COLUMNS)}
    time = prediction.time_s[:count]
    fixed, sigma = _fix_rows(prediction.distance_m[:count], errors.fix_distance_m), np.full(count, errors.position_m)
    off = sigma * random.normal(size=(2, count))
    fixes = prediction.plan.fixes
    for row, error in halts.items():
        fixed[row] = True
        if fixes is not None and fixes.position_sigma_m > 0:
            off[:, row], sigma[row] = error, fixes.position_sigma_m
    columns: dict[str, FloatArray | list[str]] = {"time_s": time}
    for name, error in zip(("x_m", "y_m"), off, strict=True):
        columns[name] = np.where(fixed, path[name] + error, np.nan)
    for name, value in (("xx_m2", sigma**2), ("xy_m2", 0.0 * sigma), ("yy_m2", sigma**2)):
        columns[name] = np.where(fixed, value, np.nan)
    columns["yaw_deg"] = path["yaw_deg"] + errors.yaw_deg * random.normal(size=count)
    columns["yaw_deg_sigma"] = np.full(count, errors.yaw_deg)
    for name in ("roll_deg", "pitch_deg"):
        columns[name] = path[name] + errors.tilt_deg * random.normal(size=count)
    columns |= _wheel_columns(prediction, time, errors, random)
    if fixes is not None:
        columns["halted"] = [str(bool(halted)).lower() for halted in prediction.halted[:count]]
    columns["synthetic"] = ["true"] * count
    return pd.DataFrame(columns)


def _fix_rows(distance_m: FloatArray, every_m: float) -> BoolArray:
    """The first rows at which each multiple of a distance is reached, and the last row. (n,)"""
    stage = np.floor(distance_m / every_m + 1e-9)
    rows = np.append(True, np.diff(stage) > 0)
    rows[-1] = True
    return np.asarray(rows)


def _wheel_columns(
    prediction: Prediction, time_s: FloatArray, errors: SensorErrors, random: np.random.Generator
) -> dict[str, FloatArray]:
    rover = prediction.rover
    schedule = make_schedule(prediction.plan, rover)
    commands = commands_at(rover, schedule, time_s, prediction.steered)
    fine = np.interp(np.arange((len(time_s) - 1) * FINER + 1) / FINER, np.arange(len(time_s)), time_s)
    speed = all_commands(rover, schedule, fine, prediction.steered).speed_m_s[0]
    way = np.vstack([np.zeros(len(rover.wheels)), np.cumsum(speed * np.diff(fine)[:, None], axis=0)])[::FINER]
    per_m = math.degrees(1.0 / rover.wheel.shearing_radius_m)
    columns: dict[str, FloatArray] = {}
    for k, wheel in enumerate(rover.wheels):
        blur = random.normal(size=(3, len(time_s)))
        columns[f"speed_{wheel}_m_s"] = commands.speed_m_s[:, k]
        columns[f"steering_{wheel}_deg"] = np.degrees(commands.steering_rad[:, k])
        columns[f"angle_{wheel}_deg"] = per_m * way[:, k] + errors.wheel_angle_deg * blur[0]
        columns[f"rate_{wheel}_deg_s"] = per_m * commands.speed_m_s[:, k] + errors.wheel_rate_deg_s * blur[1]
        columns[f"steered_{wheel}_deg"] = np.degrees(commands.steering_rad[:, k]) + errors.steered_deg * blur[2]
    return columns


def _track(prediction: Prediction, errors: SensorErrors, random: np.random.Generator) -> "pd.DataFrame":
    """Points along the tracks, with the depth that the deepest wheel left there."""
    import pandas as pd

    count = int(prediction.recorded[0])
    states = prediction.states[0, :count]
    x, y, z = (states[..., STATE_COLUMNS.index(name)] for name in ("x_m", "y_m", "sinkage_m"))
    width = prediction.rover.wheel.width_m
    points = _spaced(_filled(x, y, width), TRACK_WIDTHS * width)
    depth = deepest_at(points, (x, y, z), 0.5 * prediction.rover.wheel.width_m).max(axis=1)
    sigma = errors.track_m
    return pd.DataFrame(
        {
            "x_m": points[:, 0],
            "y_m": points[:, 1],
            "rut_m": depth + sigma * random.normal(size=len(depth)),
            "rut_m_sigma": np.full(len(depth), sigma),
            "synthetic": ["true"] * len(depth),
        }
    )


def _filled(x_m: FloatArray, y_m: FloatArray, width_m: float) -> FloatArray:
    """Wheel centres (n, wheels) as points, with others between them where they are sparse for the wheel. (p, 2) [m]"""
    places = np.stack([x_m, y_m], axis=-1)
    steps = np.hypot(*np.moveaxis(np.diff(places, axis=0), -1, 0))
    picked = np.ceil(TRACK_WIDTHS * width_m / np.maximum(steps, 1e-9)) * steps
    if steps.size == 0 or np.mean(picked > SPARSE_WIDTHS * width_m) <= SPARSE_SHARE:
        return places.reshape(-1, 2)
    rows = np.arange(0.0, len(places) - 1 + 1e-9, min(1.0, FILLED_WIDTHS * width_m / steps.max()))
    low = np.minimum(rows.astype(int), len(places) - 2)
    share = (rows - low)[:, None, None]
    return np.asarray((1.0 - share) * places[low] + share * places[low + 1]).reshape(-1, 2)


def _spaced(points_m: FloatArray, least_m: float) -> FloatArray:
    """Points without those nearer than a distance to an earlier one. (p, 2) [m]"""
    from scipy.spatial import cKDTree

    far = np.ones(len(points_m), dtype=bool)
    near: Any = cKDTree(points_m).query_ball_point(points_m, least_m)
    for row, others in enumerate(near):
        if far[row]:
            far[[other for other in others if other > row]] = False
    return points_m[far]


def deepest_at(points_m: FloatArray, wheels: tuple[FloatArray, FloatArray, FloatArray], reach_m: float) -> FloatArray:
    """Value of each wheel where its path passes within a distance of points, -inf where it does not.

    Parameters
    ----------
    points_m : (p, 2) [m]
    wheels : x, y [m] and the value of every wheel along the drive. (n, wheels)

    Returns
    -------
    (p, wheels); of several passes of a wheel the one that comes nearest.
    """
    from scipy.spatial import cKDTree

    x, y, values = wheels
    result = np.full((len(points_m), x.shape[1]), -np.inf)
    for k in range(x.shape[1]):
        way = np.append(0.0, np.cumsum(np.hypot(np.diff(x[:, k]), np.diff(y[:, k]))))
        dense = np.linspace(0.0, way[-1], max(2, math.ceil(way[-1] / DENSE_M) + 1))
        place = np.column_stack([np.interp(dense, way, x[:, k]), np.interp(dense, way, y[:, k])])
        nearest_points: Any = cKDTree(place).query(points_m, distance_upper_bound=reach_m)
        distance, nearest = nearest_points
        near = np.isfinite(distance)
        result[near, k] = np.interp(dense, way, values[:, k])[nearest[near]]
    return result
