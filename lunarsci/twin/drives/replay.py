"""The twin driven by the wheels of a drive as they were measured, beside the way that these wheels go without slip.

Scores beside trials are of slip, side slip and end, for each trial and for all.
"""

import dataclasses
import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any, Self

import numpy as np

from lunarsci.arrays import BoolArray, FloatArray, IntArray
from lunarsci.errors import ParameterError
from lunarsci.regolith.physics_discrepancy import PhysicsDiscrepancy
from lunarsci.twin.assimilation.residuals import OBSERVED, DriveRecord
from lunarsci.twin.comparison.forecast import MatchedObservations, forecast_of, match_observations
from lunarsci.twin.comparison.scores import ALL, check_bands, check_end, region_ellipse
from lunarsci.twin.ground.terrain import Terrain, soil_overrides
from lunarsci.twin.lanes import outcome_texts
from lunarsci.twin.plans.motion import Motion
from lunarsci.twin.plans.path import STILL_M_S, UNDER_WAY, Commands, make_schedule
from lunarsci.twin.plans.plan import SLOWEST_M_S, Leg, Plan
from lunarsci.twin.rover import Rover
from lunarsci.twin.simulation.discrepancy import with_discrepancy
from lunarsci.twin.simulation.ensemble import Prediction, for_people
from lunarsci.twin.simulation.members import SLOW, DriveSetup, drive_all, drive_finer
from lunarsci.twin.telemetry.reading import Telemetry, filled
from lunarsci.twin.telemetry.wheel_motion import fitted_twist, wheel_rows

STEP_S, STEP_M = 0.1, 0.01
"""Longest step, in time and in way of the fastest rim; assumed, as the embedded plan has 0.1 s and 5 mm. [s, m]"""
SAMPLE_S = 0.5
"""Between samples; assumed. [s]"""
SIDEWAYS = 1e-6
"""Weight of what wheels do not move sideways, against what they roll, where no wheel steers: it counts where these
leave a velocity open, hardly where skid steering drags wheels aside; assumed."""
SCORED, END = ("slip_ratio", "side_slip_deg"), "end_m"
"""Columns of wheel states that are scored, and the name of the ends."""


@dataclass(frozen=True, slots=True, eq=False)
class WheelTurns:
    """How far the wheels of a drive rolled, as measured.

    Attributes
    ----------
    time_s : from 0 on, ascending. (n,) [s]
    rolled_m : way of each rim r_s theta, negative backwards. (n, wheels) [m]
    steered_rad : steering of each wheel. (n, wheels) [rad]
    """

    time_s: FloatArray
    rolled_m: FloatArray
    steered_rad: FloatArray

    @classmethod
    def of(cls, telemetry: Telemetry, rover: Rover, begin_s: float) -> "WheelTurns":
        """Those of telemetry from a time on: measured angles, else rates, else commanded speeds."""
        time = telemetry.time_s - begin_s
        columns = [_rolled_m(telemetry, rover, k) for k in range(len(rover.wheels))]
        steered = [filled(time, np.radians(column)) for column in telemetry.turned_deg.T]
        whole = cls(time, np.column_stack(columns), np.column_stack(steered))
        times = np.append(0.0, time[time > 0.0])
        return cls(times, whole._at(times, whole.rolled_m), whole._at(times, whole.steered_rad))

    def commands(self, times_s: FloatArray) -> Commands:
        """Steering at the end, and mean speed of each rim, of the steps between some times. (1, steps, wheels)"""
        rolled, steered = (self._at(times_s, values) for values in (self.rolled_m, self.steered_rad))
        speed = np.diff(rolled, axis=0) / np.diff(times_s)[:, None]
        return Commands(steered[None, 1:], np.where(np.abs(speed) > STILL_M_S, speed, 0.0)[None])

    def _at(self, times_s: FloatArray, values: FloatArray) -> FloatArray:
        return np.column_stack([np.interp(times_s, self.time_s, column) for column in values.T])


def _rolled_m(telemetry: Telemetry, rover: Rover, wheel: int) -> FloatArray:
    """Way of a rim since the first row. (n,) [m]"""
    time, radius = telemetry.time_s, rover.wheel.shearing_radius_m
    angle, rate = np.radians(telemetry.angle_deg[:, wheel]), np.radians(telemetry.rate_deg_s[:, wheel])
    if (counted := np.isfinite(angle)).any():
        # Angles that begin anew after each turn stay within one.
        anew = np.ptp(angle[counted]) <= 2.0 * math.pi
        angle[counted] = np.unwrap(angle[counted]) if anew else angle[counted]
        return np.asarray(radius * filled(time, angle))
    speed = radius * rate if np.isfinite(rate).any() else telemetry.speed_m_s[:, wheel]
    speed = filled(time, speed)
    return np.append(0.0, np.cumsum(0.5 * (speed[1:] + speed[:-1]) * np.diff(time)))


@dataclass(frozen=True, slots=True)
class Replay(DriveSetup):
    """A scene whose wheels turn as they were measured."""

    turns: WheelTurns = field(default_factory=lambda: WheelTurns(*np.zeros((3, 0, 0))))

    def commands(self) -> Commands:
        return self.turns.commands(self.times_s)

    @property
    def slow(self) -> BoolArray:
        pace = np.append(_pace(self.commands()), 0.0)
        return np.asarray((pace > 0.0) & (pace < SLOW))

    def finer(self, factor: int, only: IntArray) -> Self:
        times = np.linspace(0.0, self.times_s[-1], (len(self.times_s) - 1) * factor + 1)
        return dataclasses.replace(self, times_s=times, every=self.every * factor, only=only)


def _pace(commands: Commands) -> FloatArray:
    """Mean speed of the rims in each step, as a share of the usual one while they turn. (steps,)"""
    mean = np.abs(commands.speed_m_s[0]).mean(axis=-1)
    turning = mean[mean > STILL_M_S]
    return np.asarray(mean / np.median(turning) if turning.size else mean)


def replayed(
    rover: Rover,
    terrain: Terrain,
    turns: WheelTurns,
    start: tuple[float, float, float],
    soils: Mapping[str, FloatArray],
    *,
    name: str = "",
    seed: int = 0,
    progress: Callable[[int, int], None] | None = None,
) -> Prediction:
    """Drives whose wheels turn as they were measured, one for each soil.

    Parameters
    ----------
    start : x, y and heading of the rover's origin at time 0. [m, m, deg]
    soils : parameter to one value for each member; empty for the terrain's own soil.

    The `planned` poses of the result are those of `wheels_alone`. Raises ParameterError for a soil that is none.
    """
    whole = turns.commands(turns.time_s)
    fastest = float(np.abs(whole.speed_m_s).max(initial=SLOWEST_M_S))
    samples = max(1, math.ceil(turns.time_s[-1] / SAMPLE_S))
    every = max(1, math.ceil(turns.time_s[-1] / samples / min(STEP_S, STEP_M / fastest)))
    times = np.linspace(0.0, turns.time_s[-1], samples * every + 1)
    count = len(next(iter(soils.values()))) if soils else 1
    plan = _stand_in(name, start, turns.commands(times))
    draws = None if terrain.errors is None else terrain.errors.draws(count, seed)
    scene = Replay(rover, terrain, make_schedule(plan, rover), times, every, seed, draws=draws, turns=turns)
    overrides = soil_overrides(dict(soils), count)
    driven = drive_all(scene, overrides, samples + 1, progress)
    finer = drive_finer(scene, overrides, driven)
    paths, states, results, _ = driven
    halted = np.append(_pace(turns.commands(times[::every])), 0.0) < 1.0 - UNDER_WAY
    for_people(scene, paths, states, results[:, 1], halted)
    alone = wheels_alone(rover, turns, start, times)[::every]
    return Prediction(
        rover=rover,
        terrain=terrain,
        plan=plan,
        seed=seed,
        time_step_s=scene.time_step_s,
        parameters=dict(soils),
        time_s=times[::every],
        distance_m=np.append(0.0, np.cumsum(np.hypot(*np.diff(alone[:, :2], axis=0).T))),
        planned=alone,
        paths=paths,
        states=states,
        halted=halted,
        recorded=results[:, 1],
        outcome=results[:, 0],
        ruts=np.zeros(len(overrides), dtype=np.bool_),
        finer=finer,
        draws=draws,
    )


def _stand_in(name: str, start: tuple[float, float, float], commands: Commands) -> Plan:
    """A plan for what asks for one: the start, and whether the rover is under way there."""
    first = float(commands.speed_m_s[0, 0].mean())
    leg = Leg(length_m=1.0) if first >= SLOWEST_M_S else Leg(stop_s=1.0)
    x, y, heading = start
    speed = max(first, SLOWEST_M_S)
    return Plan(name=name or "drive", legs=(leg,), speed_m_s=speed, x_m=x, y_m=y, heading_deg=heading)


def rigid_twist(rover: Rover, commands: Commands) -> FloatArray:
    """Velocity ahead, to the left [m/s] and turn [rad/s] that fit all rims best: the plain baseline. (steps, 3)

    Least squares of what each wheel rolls in its own plane, and does not move sideways; of a rover that steers no wheel
    the latter only decides the rest.
    """
    rims = commands.speed_m_s[0]
    weight = np.ones_like(rims), np.full_like(rims, 1.0 if rover.steered else SIDEWAYS)
    return fitted_twist(*wheel_rows(rover, commands.steering_rad[0]), rims, 0.0 * rims, weight)


def slips_alone(rover: Rover, turns: WheelTurns, time_s: float) -> tuple[FloatArray, FloatArray]:
    """Slip ratio [-] and side slip [deg] of each wheel at a time, of a rover that moves as its wheels fit best."""
    commands = turns.commands(np.array([time_s - 0.5 * SAMPLE_S, time_s + 0.5 * SAMPLE_S]))
    along, across = (part[0] @ rigid_twist(rover, commands)[0] for part in wheel_rows(rover, commands.steering_rad[0]))
    with np.errstate(divide="ignore", invalid="ignore"):
        travel = along / commands.speed_m_s[0, 0]
        slip = np.where(travel <= 1.0, 1.0 - travel, 1.0 / travel - 1.0)
    return np.nan_to_num(slip), np.degrees(np.arctan2(across, np.abs(along)))


def wheels_alone(rover: Rover, turns: WheelTurns, start: tuple[float, float, float], times_s: FloatArray) -> FloatArray:
    """Poses of a rover whose wheels do not slip: x, y, heading at some times. (n, 3) [m, m, rad]"""
    twist = rigid_twist(rover, turns.commands(times_s))
    step = np.diff(times_s)
    heading = math.radians(start[2]) + np.append(0.0, np.cumsum(twist[:, 2] * step))
    middle = 0.5 * (heading[1:] + heading[:-1])
    ahead, left = twist[:, 0] * step, twist[:, 1] * step
    x = start[0] + np.append(0.0, np.cumsum(np.cos(middle) * ahead - np.sin(middle) * left))
    y = start[1] + np.append(0.0, np.cumsum(np.sin(middle) * ahead + np.cos(middle) * left))
    return np.stack([x, y, heading], axis=-1)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class TrialSoils:
    """The soils that trials are predicted on.

    Attributes
    ----------
    kind : `belief`, `samples` or `one`, as of `Forecast`.
    samples : parameter to one value for each member; empty for the soil of the terrain.
    discrepancy : of the twin's physics, by a belief; None without.
    """

    kind: str
    samples: Mapping[str, FloatArray] = field(default_factory=dict)
    discrepancy: PhysicsDiscrepancy | None = None


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class QuantityScore:
    """One quantity of a trial: measured values beside the mean of the members and beside the wheels alone.

    Attributes
    ----------
    measured, predicted : medians over the states; of an end None.
    off, off_alone : predicted less measured, of the twin and of the wheels alone; distances for an end. (n,)
    in_90 : share of the values in their predicted 90 % region; None with too few members for one. [-]
    """

    measured: float | None
    predicted: float | None
    off: FloatArray
    off_alone: FloatArray
    in_90: float | None


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class TrialScore:
    """A trial beside its prediction.

    Attributes
    ----------
    trial : as it was named.
    about : rover, gravity, ground, duration, way and number of states and members, for the row of the trial.
    scores : of `slip_ratio`, `side_slip_deg` and `end_m`, those that were measured.
    end_radius_m : geometric mean of the semi-axes of the 90 % region of the end; None without one. [m]
    doubt : why the measured states are doubtful; empty where they are not.
    synthetic : whether the trial says that it is made up.
    """

    trial: str
    about: Mapping[str, Any]
    scores: Mapping[str, QuantityScore]
    end_radius_m: float | None
    doubt: str = ""
    synthetic: bool = False

    def row(self) -> dict[str, Any]:
        """One row of a table of trials."""
        result: dict[str, Any] = {"trial": self.trial, **self.about}
        for name, score in self.scores.items():
            if name != END:
                result |= {f"{name}_measured": score.measured, f"{name}_predicted": score.predicted}
            result |= {f"{name}_error": _rms(score.off), f"{name}_error_wheels_alone": _rms(score.off_alone)}
            result[f"{name}_in_90"] = score.in_90
        return result | {"end_radius_90_m": self.end_radius_m, "doubt": self.doubt or None, "synthetic": self.synthetic}


def score_trial(
    name: str, rover: Rover, terrain: Terrain, motion: Motion, turns: WheelTurns, record: DriveRecord,
    soils: TrialSoils, seed: int = 0,
) -> TrialScore:  # fmt: skip
    """Predict a drive from its first pose by its wheels alone, and hold it against what was measured.

    Parameters
    ----------
    motion : the measured one; its first pose and that one's errors are where members start.
    turns, record : both from that pose's time on.

    Raises ParameterError where nothing compares, such as where no member of the ensemble comes to the end.
    """
    start = (float(motion.x_m[0]), float(motion.y_m[0]), float(motion.yaw_deg[0]))
    prediction = replayed(rover, terrain, turns, start, soils.samples, name=name, seed=seed)
    if not prediction.finished.any():
        raise ParameterError(f"no predicted drive came to its end: {'; '.join(outcome_texts(prediction.outcome))}")
    if soils.discrepancy is not None:
        prediction = _moved(prediction, soils.discrepancy, seed)
    if motion.sigmas is not None:
        prediction = _started(prediction, motion.sigmas[0], seed)
    matched = match_observations(forecast_of(prediction, soils=soils.kind), record)
    about = {
        "rover": rover.name,
        "gravity_m_s2": rover.gravity_m_s2,
        "ground": terrain.name,
        "duration_s": float(turns.time_s[-1]),
        "way_m": float(prediction.distance_m[-1]),
        "states": int(matched.counted[:, [OBSERVED.index(column) for column in SCORED]].any(axis=1).sum()),
        "members": prediction.members,
        "finished": int(prediction.finished.sum()),
    }
    scores = _state_scores(matched, rover, turns)
    end, radius = check_end(matched, seed), None
    if end is not None:
        off, alone = np.array([end.error_m]), np.array([end.planned_error_m])
        held = float(end.regions["90"]) if end.regions else None
        scores[END] = QuantityScore(measured=None, predicted=None, off=off, off_alone=alone, in_90=held)
        last = int(record.fix_time_s.argmax())
        region = region_ellipse(matched.places[:, last], matched.place_error_m2[last], 0.9)
        radius = None if region is None else float(np.sqrt(region.semi_major_m * region.semi_minor_m))
    return TrialScore(trial=name, about=about, scores=scores, end_radius_m=radius)


def _state_scores(matched: MatchedObservations, rover: Rover, turns: WheelTurns) -> dict[str, QuantityScore]:
    record, result = matched.record, {}
    whole = {check.quantity: check.coverage_90 for check in check_bands(matched) if check.wheel == ALL}
    wheel = np.array([rover.wheels.index(name) for name in record.wheel], dtype=int)
    times, row = np.unique(record.time_s, return_inverse=True)
    still = [slips_alone(rover, turns, float(time)) for time in times]
    alone = np.array(still).reshape(len(times), 2, len(rover.wheels))
    for number, name in enumerate(SCORED):
        column = OBSERVED.index(name)
        counted: BoolArray = matched.counted[:, column]
        if counted.any():
            measured, predicted = record.values[counted, column], matched.predicted[:, counted, column].mean(axis=0)
            result[name] = QuantityScore(
                measured=float(np.median(measured)),
                predicted=float(np.median(predicted)),
                off=predicted - measured,
                off_alone=alone[row, number, wheel][counted] - measured,
                in_90=whole.get(name),
            )
    return result


def _moved(prediction: Prediction, law: PhysicsDiscrepancy, seed: int) -> Prediction:
    """With what the twin's physics is off by, along the way that the members go, as long as the wheels rolled it."""
    step = np.hypot(*np.diff(prediction.planned[:, :2], axis=0).T)
    heading = np.radians(np.median(prediction.paths[..., 5], axis=0))
    heading = 0.5 * (heading[1:] + heading[:-1])
    along = np.cumsum(step[:, None] * np.stack([np.cos(heading), np.sin(heading)], axis=-1), axis=0)
    way = prediction.planned.copy()
    way[1:, :2] = way[0, :2] + along
    moved = with_discrepancy(replace(prediction, planned=way), law, seed)
    return replace(moved, planned=prediction.planned)


def _started(prediction: Prediction, sigmas: FloatArray, seed: int) -> Prediction:
    """With the path of each member moved, and turned about the start, by a draw of its errors."""
    drawn = np.random.default_rng([seed, 23]).standard_normal((prediction.members, 3)) * sigmas
    turn, paths = np.radians(drawn[:, 2])[:, None], prediction.paths.copy()
    x, y = np.moveaxis(paths[..., :2] - prediction.planned[0, :2], -1, 0)
    paths[..., 0] = prediction.planned[0, 0] + drawn[:, :1] + np.cos(turn) * x - np.sin(turn) * y
    paths[..., 1] = prediction.planned[0, 1] + drawn[:, 1:2] + np.sin(turn) * x + np.cos(turn) * y
    paths[..., 5] += drawn[:, 2:]
    return replace(prediction, paths=paths)


def summary_of(trials: Sequence[TrialScore]) -> list[dict[str, Any]]:
    """Over all trials, a row for each quantity: all values of all trials count alike, and each end as one."""
    rows = []
    for name in (*SCORED, END):
        result = [trial.scores[name] for trial in trials if name in trial.scores]
        if not result:
            continue
        off, alone = (np.concatenate([getattr(score, part) for score in result]) for part in ("off", "off_alone"))
        held = [(score.in_90, len(score.off)) for score in result if score.in_90 is not None]
        rows.append({
            "quantity": name,
            "trials": len(result),
            "values": len(off),
            "median_error": float(np.median(np.abs(off))),
            "rms": _rms(off),
            "in_90": sum(share * count for share, count in held) / sum(count for _, count in held) if held else None,
            "median_error_wheels_alone": float(np.median(np.abs(alone))),
            "rms_wheels_alone": _rms(alone),
        })  # fmt: skip
    return rows


def _rms(values: FloatArray) -> float:
    return float(np.sqrt((values**2).mean()))
