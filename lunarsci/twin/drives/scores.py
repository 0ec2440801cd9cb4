"""The twin beside trials: slip, side slip and end of each and of all, and the way of the wheels beside it."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from lunarsci.arrays import BoolArray, FloatArray
from lunarsci.errors import ParameterError
from lunarsci.regolith.physics_discrepancy import PhysicsDiscrepancy
from lunarsci.twin.assimilation.drive_record import OBSERVED, DriveRecord
from lunarsci.twin.comparison.checks import ALL, check_bands, check_end, region_ellipse
from lunarsci.twin.comparison.forecast import forecast_of
from lunarsci.twin.comparison.matched import MatchedObservations, match_observations
from lunarsci.twin.drives.replay import WheelTurns, replayed, slips_alone
from lunarsci.twin.ground.terrain import Terrain
from lunarsci.twin.lanes import outcome_texts
from lunarsci.twin.plans.motion import Motion
from lunarsci.twin.rover import Rover
from lunarsci.twin.simulation.discrepancy import with_discrepancy
from lunarsci.twin.simulation.ensemble import Prediction

SCORED, END = ("slip_ratio", "side_slip_deg"), "end_m"
"""Columns of wheel states that are scored, and the name of the ends."""


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
        found: dict[str, Any] = {"trial": self.trial, **self.about}
        for name, score in self.scores.items():
            if name != END:
                found |= {f"{name}_measured": score.measured, f"{name}_predicted": score.predicted}
            found |= {f"{name}_error": _rms(score.off), f"{name}_error_wheels_alone": _rms(score.off_alone)}
            found[f"{name}_in_90"] = score.in_90
        return found | {"end_radius_90_m": self.end_radius_m, "doubt": self.doubt or None, "synthetic": self.synthetic}


def score_trial(
    name: str, rover: Rover, terrain: Terrain, motion: "Motion", turns: WheelTurns, record: DriveRecord,
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
        "states": int(matched.known[:, [OBSERVED.index(column) for column in SCORED]].any(axis=1).sum()),
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
    record, found = matched.record, {}
    whole = {check.quantity: check.coverage_90 for check in check_bands(matched) if check.wheel == ALL}
    wheel = np.array([rover.wheels.index(name) for name in record.wheel], dtype=int)
    times, row = np.unique(record.time_s, return_inverse=True)
    still = [slips_alone(rover, turns, float(time)) for time in times]
    alone = np.array(still).reshape(len(times), 2, len(rover.wheels))
    for number, name in enumerate(SCORED):
        column = OBSERVED.index(name)
        known: BoolArray = matched.known[:, column]
        if known.any():
            measured, predicted = record.values[known, column], matched.predicted[:, known, column].mean(axis=0)
            found[name] = QuantityScore(
                measured=float(np.median(measured)),
                predicted=float(np.median(predicted)),
                off=predicted - measured,
                off_alone=alone[row, number, wheel][known] - measured,
                in_90=whole.get(name),
            )
    return found


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
        found = [trial.scores[name] for trial in trials if name in trial.scores]
        if not found:
            continue
        off, alone = (np.concatenate([getattr(score, part) for score in found]) for part in ("off", "off_alone"))
        held = [(score.in_90, len(score.off)) for score in found if score.in_90 is not None]
        rows.append({
            "quantity": name,
            "trials": len(found),
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
