"""The prediction as tables: wheel states against distance, paths, ends.

How the quantities of a drive spread over the members at each distance.
"""

from typing import TYPE_CHECKING

import numpy as np

from lunarsci.arrays import BoolArray, FloatArray
from lunarsci.twin.judgement.quantities import along
from lunarsci.twin.loads.prescribed_motion import PrescribedLoads
from lunarsci.twin.simulation.ensemble import OFFSET_COLUMNS, PATH_COLUMNS, STATE_COLUMNS, Prediction

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
ALL = "all"


def spread(values: FloatArray, reached: BoolArray) -> FloatArray:
    """p05, p50, p95, min and max over members (and wheels) at each sample, NaN where no member came. (5, samples)

    `values` is (members, samples) or (members, samples, wheels). Percentiles interpolate linearly; NaN is left out.
    """
    values = values if values.ndim == 3 else values[..., None]
    known = reached[..., None] & ~np.isnan(values)
    rows = np.full((5, values.shape[1]), np.nan)
    for sample in np.flatnonzero(known.any(axis=(0, 2))):
        rows[:, sample] = np.percentile(values[:, sample][known[:, sample]], (5, 50, 95, 0, 100))
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
        for wheel, own in series.items():
            rows = dict(zip(("p05", "p50", "p95", "min", "max"), spread(own, prediction.reached), strict=True))
            head = {"distance_m": prediction.distance_m, "time_s": prediction.time_s, "quantity": name, "wheel": wheel}
            parts.append(pd.DataFrame({**head, **rows, "unit": PROFILED[name]}))
    table = pd.concat(parts, ignore_index=True)
    return table[table["p50"].notna()].reset_index(drop=True)


def state_table(prediction: Prediction) -> "pd.DataFrame":
    """States and forces of each wheel: one row for each member, distance and wheel, as far as the member came.

    Columns member, distance_m, time_s, wheel, x_m, y_m (wheel centre), sinkage_m, slip_ratio, side_slip_deg,
    normal_force_n, drawbar_pull_n, lateral_force_n, resistance_torque_nm, valid, rover, ground. `distance_m` is as
    commanded. States at a halt are not valid: forces there belong to no slip, and a soil identified from them would be
    wrong.
    """
    import pandas as pd

    member, sample = np.nonzero(prediction.reached)
    values = prediction.states[member, sample].reshape(-1, len(STATE_COLUMNS))
    table = pd.DataFrame(values, columns=list(STATE_COLUMNS))
    names = prediction.rover.wheels
    count = len(names)
    table["valid"] = (table["valid"] > 0.5) & ~np.repeat(prediction.halted[sample], count)
    table.insert(0, "member", np.repeat(member, count))
    table.insert(1, "distance_m", np.repeat(prediction.distance_m[sample], count))
    table.insert(2, "time_s", np.repeat(prediction.time_s[sample], count))
    table.insert(3, "wheel", np.tile(names, len(member)))
    return table.assign(rover=prediction.rover.written, ground=prediction.terrain.written)


def held_table(found: PrescribedLoads) -> "pd.DataFrame":
    """States and forces of each wheel along a given motion: one row for each pose and wheel.

    Columns time_s, wheel, then as in `state_table`, then missing_ahead_n, missing_left_n, missing_moment_nm: what the
    wheels together do not supply, rover and ground. Poses without equilibrium have no numbers.
    """
    import pandas as pd

    names = found.rover.wheels
    table = pd.DataFrame(found.states.reshape(-1, len(STATE_COLUMNS)), columns=list(STATE_COLUMNS))
    table["valid"] = table["valid"] > 0.5
    table.insert(0, "time_s", np.repeat(found.motion.time_s, len(names)))
    table.insert(1, "wheel", np.tile(names, len(found.motion.time_s)))
    for name, values in zip(
        ("missing_ahead_n", "missing_left_n", "missing_moment_nm"),
        (*found.residual_n.T, found.residual_nm),
        strict=True,
    ):
        table[name] = np.repeat(values, len(names))
    return table.assign(rover=found.rover.written, ground=found.terrain.written)


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
