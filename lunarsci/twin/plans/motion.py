"""A motion of the rover that is given, as from localisation: where it was when, and what its wheels were told."""

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import numpy.typing as npt

from lunarsci.errors import DataError, ParameterError
from lunarsci.twin.plans.plan import Plan
from lunarsci.twin.plans.schedule import commands_at, make_schedule
from lunarsci.twin.rover import Rover

if TYPE_CHECKING:
    import pandas as pd

__all__ = ["Motion", "read_motion"]

FloatArray = npt.NDArray[np.float64]
POSE_COLUMNS = ("time_s", "x_m", "y_m", "yaw_deg")


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Motion:
    """Poses of the rover's origin, and commands of its wheels.

    Attributes
    ----------
    time_s : ascending. (n,) [s]
    x_m, y_m, yaw_deg : pose in the plane of the map, yaw from x to the left. (n,) [m, m, deg]
    steering_deg : steering angle of each wheel, positive to the left, -90 to 90. (n, wheels) [deg]
    speed_m_s : speed of each rim over ground, r_s omega, not 0; negative backwards. (n, wheels) [m/s]

    Raises ParameterError for fewer than three poses, times that do not ascend, or values that are not finite.
    """

    time_s: FloatArray
    x_m: FloatArray
    y_m: FloatArray
    yaw_deg: FloatArray
    steering_deg: FloatArray
    speed_m_s: FloatArray

    def __post_init__(self) -> None:
        if len(self.time_s) < 3:
            raise ParameterError(f"the motion has {len(self.time_s)} poses; give at least 3")
        for name in ("time_s", "x_m", "y_m", "yaw_deg", "steering_deg", "speed_m_s"):
            values = getattr(self, name)
            if not np.isfinite(values).all():
                row = int(np.argwhere(~np.isfinite(values))[0][0])
                raise ParameterError(f"motion {name} is not finite at pose {row}; leave such poses out")
        late = np.flatnonzero(np.diff(self.time_s) <= 0)
        if late.size:
            raise ParameterError(f"motion time_s does not ascend after pose {late[0]}; sort it and drop duplicates")
        if (np.abs(self.steering_deg) > 90.0).any():
            raise ParameterError("motion steering_deg is beyond 90 deg; a wheel that runs backwards has speed < 0")
        if (self.speed_m_s == 0).any():
            raise ParameterError("motion speed_m_s is 0 somewhere; slip has no meaning for a wheel that does not turn")


def read_motion(path: str | Path, rover: Rover, plan: Plan | None = None, member: int | None = None) -> Motion:
    """Read a motion from CSV.

    Columns time_s, x_m, y_m, yaw_deg as in the `paths.csv` of a prediction; optionally member, of which one is read;
    and the commands of each wheel, `steering_FL_deg` and `speed_FL_m_s` and so on. Without these columns the commands
    are those of `plan` at the same times. Raises DataError.
    """
    import pandas as pd

    try:
        table = pd.read_csv(path, comment="#")
        missing = [name for name in POSE_COLUMNS if name not in table]
        if missing:
            raise ParameterError(f"no column {missing[0]}; a motion needs {', '.join(POSE_COLUMNS)}")
        table = _one_member(table, member)
        pose = {name: _column(table, name) for name in POSE_COLUMNS}
        steering, speed = _commands(table, rover, plan, pose["time_s"])
        return Motion(**pose, steering_deg=steering, speed_m_s=speed)
    except OSError as error:
        raise DataError(f"{path}: {error.strerror or error}") from error
    except ValueError as error:
        raise DataError(f"{path}: {error}") from error


def _one_member(table: "pd.DataFrame", member: int | None) -> "pd.DataFrame":
    if "member" not in table:
        return table
    numbers = table["member"].unique()
    if member is None and len(numbers) > 1:
        raise ParameterError(f"{len(numbers)} members; choose one with --member")
    chosen = numbers[0] if member is None else member
    if chosen not in numbers:
        raise ParameterError(f"no member {chosen}; there are {numbers.min()} to {numbers.max()}")
    return table[table["member"] == chosen]


def _column(table: "pd.DataFrame", name: str) -> FloatArray:
    import pandas as pd

    return np.asarray(pd.to_numeric(table[name], errors="raise"), dtype=float)


def _commands(
    table: "pd.DataFrame", rover: Rover, plan: Plan | None, time_s: FloatArray
) -> tuple[FloatArray, FloatArray]:
    names = [(f"steering_{wheel}_deg", f"speed_{wheel}_m_s") for wheel in rover.wheels]
    given = [name for pair in names for name in pair if name in table]
    if len(given) == 2 * len(names):
        steering, speed = ([_column(table, pair[k]) for pair in names] for k in range(2))
        return np.column_stack(steering), np.column_stack(speed)
    if given:
        missing = next(name for pair in names for name in pair if name not in table)
        raise ParameterError(f"no column {missing}, but {given[0]}; give the commands of all wheels, or a plan")
    if plan is None:
        raise ParameterError(f"no columns {names[0][0]}, {names[0][1]}, ...; add the commands, or give the plan")
    commands = commands_at(rover, make_schedule(plan, rover), time_s)
    return np.degrees(commands.steering_rad), commands.speed_m_s
