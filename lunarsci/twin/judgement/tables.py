"""Drives as tables: wheel states against distance, paths, ends, the spread of quantities over the members; what each
wheel carried and pulled, a check for loads that no wheel of a slow rover has, and forces with their uncertainty, the
input of the joint identification of a soil.

In every table `rover` and `ground` are as `Rover.written` and `Terrain.written` name them, so that whoever reads it can
refuse states of another rover or ground.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from lunarsci.arrays import BoolArray, FloatArray, at_times, spans
from lunarsci.names import counted
from lunarsci.regolith.states import FROM_MOTION
from lunarsci.twin.judgement.quantities import along
from lunarsci.twin.simulation.dynamics import MOST_LOAD
from lunarsci.twin.simulation.ensemble import OFFSET_COLUMNS, PATH_COLUMNS, STATE_COLUMNS, Prediction
from lunarsci.twin.simulation.prescribed_motion import FORCES, LoadEnsemble, PoseStates, PrescribedLoads

if TYPE_CHECKING:
    import pandas as pd

PROFILED = {
    "tilt_deg": "deg",
    "roll_deg": "deg",
    "pitch_deg": "deg",
    "clearance_m": "m",
    "keep_out_m": "m",
    "miss_m": "m",
    "normal_force_n": "N",
    "slip_ratio": "-",
    "side_slip_deg": "deg",
    "sinkage_m": "m",
}
"""Quantities of the profiles, and their units."""
SHARES = (5, 50, 95, 0, 100)
"""Of the members, in the order of a profile's columns. [%]"""
PIECE = 32
"""Members of a piece of a table: some megabytes; assumed."""
ALL = "all"
"""In the column `wheel` of a profile: all wheels together."""
QUANTITIES = (
    "normal_force_n",
    "drawbar_pull_n",
    "lateral_force_n",
    "resistance_torque_nm",
    "sinkage_m",
    "slip_ratio",
    "side_slip_deg",
)
"""Columns of `STATE_COLUMNS` that `wheel_loads` sums up, units in their names; slip ratios have none."""


def spread(values: FloatArray, reached: BoolArray) -> FloatArray:
    """p05, p50, p95, min and max over members (and wheels) at each sample, NaN where no member came. (5, samples)

    `values` is (members, samples) or (members, samples, wheels); `reached`, the samples that were driven, (members,
    samples). Percentiles interpolate linearly; NaN is left out.
    """
    values = values if values.ndim == 3 else values[..., None]
    counted = reached[..., None] & ~np.isnan(values)
    rows, whole = np.full((5, values.shape[1]), np.nan), counted.all(axis=(0, 2))
    if whole.any():
        rows[:, whole] = np.percentile(values[:, whole], SHARES, axis=(0, 2))
    for sample in np.flatnonzero(counted.any(axis=(0, 2)) & ~whole):
        rows[:, sample] = np.percentile(values[:, sample][counted[:, sample]], SHARES)
    return rows


def available(prediction: Prediction) -> list[str]:
    """Those of the profiled quantities that rover and plan give."""
    lacking = {"clearance_m": prediction.rover.body is None, "keep_out_m": not prediction.plan.exclusion_zones}
    return [name for name in PROFILED if not lacking.get(name, False)]


def profile_table(prediction: Prediction) -> "pd.DataFrame":
    """One row for each sample and quantity, wheels apart and together.

    Columns distance_m (as commanded), time_s, quantity, wheel (a name, `all`, or empty for the chassis), p05, p50, p95,
    min, max over the members that came so far, unit. Quantities as in `PROFILED`: without `clearance_m` for a rover
    without a body, without `keep_out_m` for a plan without such circles.
    """
    import pandas as pd

    parts = []
    for name in available(prediction):
        values = along(prediction, name)
        series = {"": values}
        if values.ndim == 3:
            series = {ALL: values} | {wheel: values[..., w] for w, wheel in enumerate(prediction.rover.wheels)}
        for wheel, part in series.items():
            rows = dict(zip(("p05", "p50", "p95", "min", "max"), spread(part, prediction.reached), strict=True))
            head = {"distance_m": prediction.distance_m, "time_s": prediction.time_s, "quantity": name, "wheel": wheel}
            parts.append(pd.DataFrame({**head, **rows, "unit": PROFILED[name]}))
    table = pd.concat(parts, ignore_index=True)
    return table[table["p50"].notna()].reset_index(drop=True)


def state_tables(prediction: Prediction) -> "Iterator[pd.DataFrame]":
    """`state_table` in pieces, which take less memory one after the other than all of it."""
    return (state_table(prediction, members) for members in spans(prediction.members, PIECE))


def state_table(prediction: Prediction, members: range | None = None) -> "pd.DataFrame":
    """States and forces of each wheel: one row for each member, distance and wheel, as far as the member came.

    Of some of the members, or of all of them.

    Columns member, distance_m, time_s, wheel, x_m, y_m (wheel centre), sinkage_m, slip_ratio, side_slip_deg,
    normal_force_n, drawbar_pull_n, lateral_force_n, resistance_torque_nm, valid, rover, ground. `distance_m` is as
    commanded. States at a halt are not valid: forces there belong to no slip, and a soil identified from them would be
    wrong.
    """
    import pandas as pd

    first, last = (0, prediction.members) if members is None else (members.start, members.stop)
    member, sample = np.nonzero(prediction.reached[first:last])
    member += first
    values = prediction.states[member, sample].reshape(-1, len(STATE_COLUMNS))
    table = pd.DataFrame(values, columns=list(STATE_COLUMNS))
    names = prediction.rover.wheels
    count = len(names)
    table["valid"] = (table["valid"] > 0.5) & ~np.repeat(prediction.halted[sample], count)
    table.insert(0, "member", np.repeat(member, count))
    table.insert(1, "distance_m", np.repeat(prediction.distance_m[sample], count))
    table.insert(2, "time_s", np.repeat(prediction.time_s[sample], count))
    table.insert(
        3, "wheel", pd.Series(pd.Categorical.from_codes(np.tile(np.arange(count), len(member)), pd.Index(names)))
    )
    for name, text in (("rover", prediction.rover.written), ("ground", prediction.terrain.written)):
        table[name] = pd.Categorical.from_codes(np.zeros(len(table), dtype=np.int8), pd.Index([text]))
    return table


def drive_layers(prediction: Prediction) -> dict[str, tuple[tuple[str, ...], Any]]:
    """The same states and poses as `state_table` and `path_table` have, by member, time and wheel; NaN where none came.

    Of each name its axes and values; `wheel_x_m` and `wheel_y_m` are wheel centres, `x_m` and `y_m` the rover's origin.
    """
    of_drive, of_wheel = ("member", "time_s"), ("member", "time_s", "wheel")
    reached, places = prediction.reached, np.moveaxis(prediction.places_m, -1, 0)
    poses = dict(zip(PATH_COLUMNS, np.moveaxis(prediction.paths, -1, 0), strict=True))
    poses |= dict(zip(PATH_COLUMNS[:2], places, strict=True))
    states = dict(zip(STATE_COLUMNS, np.moveaxis(prediction.states, -1, 0), strict=True))
    valid = (states.pop("valid") > 0.5) & (reached & ~prediction.halted)[..., None]
    names = {"x_m": "wheel_x_m", "y_m": "wheel_y_m"}
    return {
        "member": (("member",), np.arange(prediction.members)),
        "time_s": (("time_s",), prediction.time_s),
        "wheel": (("wheel",), np.array(prediction.rover.wheels)),
        "distance_m": (("time_s",), prediction.distance_m),
        **{name: (("member",), values) for name, values in prediction.parameters.items()},
        "outcome": (("member",), np.array([prediction.outcome_text(m) for m in range(prediction.members)])),
        **{name: (of_drive, np.where(reached, values, np.nan)) for name, values in poses.items()},
        **{
            names.get(name, name): (of_wheel, np.where(reached[..., None], values, np.nan))
            for name, values in states.items()
        },
        "valid": (of_wheel, valid),
    }


def held_table(result: PrescribedLoads) -> "pd.DataFrame":
    """States and forces of each wheel of a rover that is held to a given motion: one row for each pose and wheel.

    Columns time_s, wheel, then as in `state_table`, then missing_ahead_n, missing_left_n, missing_moment_nm: what the
    wheels together do not supply, rover and ground. Poses without equilibrium have no numbers.
    """
    import pandas as pd

    names = result.rover.wheels
    table = pd.DataFrame(result.states.reshape(-1, len(STATE_COLUMNS)), columns=list(STATE_COLUMNS))
    table["valid"] = table["valid"] > 0.5
    table.insert(0, "time_s", np.repeat(result.motion.time_s, len(names)))
    table.insert(1, "wheel", np.tile(names, len(result.motion.time_s)))
    for name, values in zip(
        ("missing_ahead_n", "missing_left_n", "missing_moment_nm"),
        (*result.residual_n.T, result.residual_nm),
        strict=True,
    ):
        table[name] = np.repeat(values, len(names))
    return table.assign(rover=result.rover.written, ground=result.terrain.written)


def path_table(prediction: Prediction) -> "pd.DataFrame":
    """Pose of the rover's origin: one row for each member and distance, as far as the member came.

    Columns member, distance_m, time_s, x_m, y_m, z_m, roll_deg, pitch_deg (positive nose down), yaw_deg, rover, ground.
    With a discrepancy of the physics also offset_x_m and offset_y_m, which x_m and y_m hold; the other columns do not.
    """
    import pandas as pd

    member, sample = np.nonzero(prediction.reached)
    table = pd.DataFrame(prediction.paths[member, sample], columns=list(PATH_COLUMNS))
    table[["x_m", "y_m"]] = prediction.places_m[member, sample]
    if prediction.discrepancy is not None:
        table[list(OFFSET_COLUMNS)] = prediction.discrepancy.offsets_m[member, sample]
    table.insert(0, "member", member)
    table.insert(1, "distance_m", prediction.distance_m[sample])
    table.insert(2, "time_s", prediction.time_s[sample])
    return table.assign(rover=prediction.rover.written, ground=prediction.terrain.written)


def endpoint_table(prediction: Prediction) -> "pd.DataFrame":
    """One row for each member: member, its swept soil parameters, x_m, y_m, miss_m, outcome (a sentence)."""
    import pandas as pd

    ends = prediction.endpoints_m
    return pd.DataFrame(
        {
            "member": np.arange(prediction.members),
            **prediction.parameters,
            "x_m": ends[:, 0],
            "y_m": ends[:, 1],
            "miss_m": prediction.miss_m,
            "outcome": [prediction.outcome_text(m) for m in range(prediction.members)],
        }
    )


def force_table(result: LoadEnsemble, states: PoseStates | None = None) -> "pd.DataFrame":
    """Forces of each wheel after the balance: one row for each measured state, or for each pose and wheel.

    The columns of the measured states stay as they were read; normal_force_n, drawbar_pull_n, lateral_force_n, each
    with `_sigma`, are those of their times, between the poses of the motion. Without measured states there are time_s,
    distance_m (rolled by the rims), wheel, x_m, y_m, sinkage_m, slip_ratio, side_slip_deg of `LoadEnsemble.held`, the
    rover held to the motion on the middle one of the soils. `valid` is false for states that were not valid, at and
    beside halts and gaps, and where there are no forces. `forces_from` says that these were computed of a motion, so
    that their errors are alike, `rover` whose wheels they are, `ground` where they were.
    """
    import pandas as pd

    if states is None:
        return _of_the_motion(result)
    table = states.table.copy()
    gone = [f"{name}{end}" for name in FORCES for end in ("", "_sigma")]
    table = table.drop(columns=[name for name in (*gone, "valid") if name in table])
    poses = result.held.motion.time_s
    rows = np.arange(len(table))
    mean, sigma = (
        at_times(states.time_s, poses, part, beyond=False)[rows, states.wheel]
        for part in (result.after, result.after_sigma)
    )
    for k, name in enumerate(FORCES):
        table[name], table[f"{name}_sigma"] = mean[:, k], sigma[:, k]
    table["forces_from"] = FROM_MOTION
    table["valid"] = states.valid & np.isfinite(mean).all(axis=1) & (mean[:, 0] > 0)
    return pd.DataFrame(table).assign(rover=result.held.rover.written, ground=result.held.terrain.written)


def _of_the_motion(result: LoadEnsemble) -> "pd.DataFrame":
    """`force_table` without measured states: a row for each pose and wheel."""
    import pandas as pd

    held, wheels = result.held, result.held.rover.wheels
    count = len(held.motion.time_s)
    flat = held.states.reshape(-1, len(STATE_COLUMNS))
    columns = {
        "time_s": np.repeat(held.motion.time_s, len(wheels)),
        "distance_m": np.repeat(held.motion.rolled_m, len(wheels)),
        "wheel": np.tile(wheels, count),
    }
    names = ("x_m", "y_m", "sinkage_m", "slip_ratio", "side_slip_deg")
    columns |= {name: flat[:, STATE_COLUMNS.index(name)] for name in names}
    mean, sigma = result.after.reshape(-1, 3), result.after_sigma.reshape(-1, 3)
    for k, name in enumerate(FORCES):
        columns |= {name: mean[:, k], f"{name}_sigma": sigma[:, k]}
    columns["forces_from"] = np.full(len(mean), FROM_MOTION)
    marked = flat[:, STATE_COLUMNS.index("valid")] > 0.5
    columns["valid"] = marked & np.isfinite(mean).all(axis=1) & (mean[:, 0] > 0)
    return pd.DataFrame(columns).assign(rover=held.rover.written, ground=held.terrain.written)


@dataclass(frozen=True, slots=True)
class Spread:
    """Of one quantity over the poses of a drive, and over the members of an ensemble, all counted alike.

    All numbers are in the unit of the quantity; p05 to p95 are percentiles.
    """

    mean: float
    min: float
    p05: float
    p50: float
    p95: float
    max: float


@dataclass(frozen=True, slots=True)
class WheelLoads:
    """What one wheel carried and pulled.

    Attributes
    ----------
    wheel : its name.
    quantities : each of `QUANTITIES` to its spread.
    valid_share : share of its states in which the wheel model holds. [-]
    """

    wheel: str
    quantities: dict[str, Spread]
    valid_share: float


def wheel_loads(wheels: Sequence[str], states: FloatArray) -> list[WheelLoads]:
    """Summaries of wheel states (..., wheels, 10), columns `STATE_COLUMNS`, one a wheel.

    A pose with a state that is no number is left out. Empty where no state is a number.
    """
    flat = states.reshape(-1, len(wheels), states.shape[-1])
    flat = flat[np.isfinite(flat).all(axis=(1, 2))]
    if not len(flat):
        return []
    valid = flat[..., STATE_COLUMNS.index("valid")].mean(axis=0)
    return [
        WheelLoads(
            wheel, {name: _spread(flat[:, k, STATE_COLUMNS.index(name)]) for name in QUANTITIES}, float(valid[k])
        )
        for k, wheel in enumerate(wheels)
    ]


def _spread(values: FloatArray) -> Spread:
    p05, p50, p95 = np.percentile(values, (5, 50, 95))
    return Spread(float(values.mean()), float(values.min()), float(p05), float(p50), float(p95), float(values.max()))


@dataclass(frozen=True, slots=True)
class LoadCheck:
    """Wheel loads over every member, sample and wheel that was driven.

    Attributes
    ----------
    weight_n : of the rover. [N]
    least_n, most_n : of any wheel, None where nothing was driven. [N]
    hanging_share, overloaded_share : of the wheel states, without any load and beyond twice the weight. [-]
    hanging_members, overloaded_members : drives that have such states.
    """

    weight_n: float
    least_n: float | None
    most_n: float | None
    hanging_share: float
    hanging_members: int
    overloaded_share: float
    overloaded_members: int


def check_loads(prediction: Prediction) -> LoadCheck:
    """Look for wheels at 0 N, and above twice the weight, `MOST_LOAD`: no slow rover loads a wheel so."""
    loads = prediction.states[..., STATE_COLUMNS.index("normal_force_n")]
    driven = np.broadcast_to(prediction.reached[..., None], loads.shape)
    weight = prediction.rover.mass_kg * prediction.rover.gravity_m_s2
    hanging, over = driven & (loads <= 0.0), driven & (loads > MOST_LOAD * weight)
    count = max(int(driven.sum()), 1)
    return LoadCheck(
        weight_n=float(weight),
        least_n=float(loads[driven].min()) if driven.any() else None,
        most_n=float(loads[driven].max()) if driven.any() else None,
        hanging_share=float(hanging.sum() / count),
        hanging_members=int(hanging.any(axis=(1, 2)).sum()),
        overloaded_share=float(over.sum() / count),
        overloaded_members=int(over.any(axis=(1, 2)).sum()),
    )


def mean_loads_n(prediction: Prediction) -> list[float]:
    """Least and largest of the mean loads of the wheels, over all that was driven. (2,) [N]"""
    loads = prediction.states[prediction.reached][..., STATE_COLUMNS.index("normal_force_n")].mean(axis=0)
    return [float(loads.min()), float(loads.max())]


def load_notes(result: LoadCheck) -> list[str]:
    """One sentence for each kind that occurs."""
    notes = []
    if result.hanging_members:
        notes.append(
            f"in {counted(result.hanging_members, 'drive')} a wheel carries nothing, and others carry its load"
        )
    if result.overloaded_members:
        notes.append(
            f"in {counted(result.overloaded_members, 'drive')} a wheel carries up to {result.most_n:.0f} N, more "
            f"than twice the weight of {result.weight_n:.0f} N: a fall, a hit, or a computation that lost its meaning"
        )
    return notes
