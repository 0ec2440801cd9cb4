"""Names that logs of other software have for the columns of telemetry, and tables of ROS.

Tables of ROS are read as well: `rostopic echo -p` (%time, field.pose.pose.position.x), bagpy (header.stamp.secs), ros2
bags (header.stamp.nanosec) and PlotJuggler (__time, /joint_states/wheel_FL/position). Units and axes are those of REP
103: s, m, rad, x ahead, z up; covariances those of geometry_msgs/PoseWithCovariance: 6 x 6 of x, y, z and turns about
them, row by row.
"""

import re
from collections import Counter
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING

import numpy as np

from lunarsci.arrays import BoolArray, FloatArray
from lunarsci.errors import DataError
from lunarsci.io.tables import numbers_of
from lunarsci.units import SIZES, UNIT_ENDING, columns_by_unit

if TYPE_CHECKING:
    import pandas as pd

ERRORS = ("xx_m2", "xy_m2", "yy_m2")
"""Columns of the covariance of a position."""
_PLACED = r"(?:(?:vo|vio|odom\w*|pos\w*|est|loc)_)?"
_LIKELY = {
    r"t|t_?s|time|timestamp|stamp|secs?|seconds|utc": ("time", "s"),
    rf"{_PLACED}(x|east\w*)(_pos\w*)?": ("x", "m"),
    rf"{_PLACED}(y|north\w*)(_pos\w*)?": ("y", "m"),
    rf"{_PLACED}(yaw|heading|hdg|psi)": ("yaw", "deg"),
}
"""Names of columns without their units, what they stand for, and the unit where none is named."""
# Words for ends and sides of a rover in names of wheels, and for covariances and clocks in logs of other software.
_ENDS = {"f": "F", "front": "F", "r": "R", "rear": "R", "b": "R", "back": "R"}
_ENDS |= dict.fromkeys(("m", "mid", "middle", "center", "centre"), "M")
_SIDES = {"l": "L", "left": "L", "r": "R", "right": "R"}
_STEERED = {"steer", "steering", "steered", "corner", "delta"}
_COMMANDED = {"cmd", "command", "commanded", "setpoint", "target"}
_OF_A_WHEEL = {
    **dict.fromkeys(("deg", *SIZES["deg"]), ("angle", {"angle", "position", "pos", "encoder", "enc", "turned"})),
    **dict.fromkeys(("deg_s", *SIZES["deg_s"]), ("rate", {"rate", "velocity", "vel", "speed", "omega", "w"})),
    **dict.fromkeys(("m_s", *SIZES["m_s"]), ("speed", {"velocity", "vel", "speed", "rim", *_COMMANDED})),
}
"""What a number of a wheel is by its unit, and the words that may say so."""
_PLAIN = {"wheel", "wheels", "side", "joint", "motor", "drive", "measured", "meas", ""}
_COVARIANCES = {"0": "xx_m2", "1": "xy_m2", "7": "yy_m2", "35": "yaw_variance"}
_STAMPS = {"time", "__time", "timestamp", "stamp", "rosbagtimestamp"}
_STEERS = re.compile(r"steer|corner|azimuth", re.IGNORECASE)
STAMP_UNITS = ((1e17, "ns"), (1e14, "us"), (1e11, "ms"))
"""Stamps from these on are in these units: the clock began in 1970 and stands below 1e10 s."""


def columns_meant(name: str, wheels: Sequence[str]) -> list[str]:
    """The columns of telemetry that a name of another log stands for, in its unit; of a side, those of all its wheels.

    >>> columns_meant("t", ()), columns_meant("vo_x_mm", ()), columns_meant("wheel_left_rad", ("FL", "FR", "RL", "RR"))
    (['time_s'], ['x_mm'], ['angle_FL_rad', 'angle_RL_rad'])
    """
    ending = UNIT_ENDING.search(name)
    stem, unit = (name[: ending.start()], ending[1]) if ending and ending.end() == len(name) else (name, "")
    for words, (meant, usual) in _LIKELY.items():
        if re.fullmatch(words, stem, re.IGNORECASE):
            return [f"{meant}_{unit or usual}"]
    parts = {word.lower() for word in re.split(r"[_\W]+", stem)}
    wheel, side = _wheel_in(stem.lower()), [_SIDES[word] for word in parts if word in _SIDES]
    of = [one for one in wheels if one == wheel or (not wheel and one[-1:] in side)]
    words_left = parts - _PLAIN - {wheel.lower()} - ({*_ENDS, *_SIDES} if wheel else {*_SIDES})
    unit = unit or ("rad_s" if words_left and words_left <= {"w", "omega"} else "")
    kind, may_say = _OF_A_WHEEL.get(unit, ("", set[str]()))
    if kind == "angle" and words_left & _STEERED:
        kind, may_say = ("steering" if words_left & _COMMANDED else "steered"), {*may_say, *_STEERED, *_COMMANDED}
    return [f"{kind}_{one}_{unit}" for one in of] if kind and len(side) < 2 and words_left <= may_say else []


def names_meant(names: Sequence[str], wheels: Sequence[str]) -> Mapping[str, list[str]]:
    """Of each column whose name is none of lunarsci's, what it stands for, where no other one stands for the same."""
    present = columns_by_unit([*names])
    meant = {name: columns_meant(name, wheels) for name in names}
    plain = {name: [*columns_by_unit(columns)] for name, columns in meant.items()}
    times = Counter(one for columns in plain.values() for one in {*columns})
    return {
        name: columns
        for name, columns in meant.items()
        if columns and all(one not in present and times[one] == 1 for one in plain[name])
    }


def as_meant(table: "pd.DataFrame", wheels: Sequence[str]) -> "tuple[pd.DataFrame, str]":
    """A table with the columns that its names stand for beside its own, and what was read as what; '' for nothing."""
    import pandas as pd

    meant = dict(names_meant([str(name) for name in table.columns], wheels))
    for name in [name for name, columns in meant.items() if columns == ["time_s"] and not UNIT_ENDING.search(name)]:
        stamps = pd.to_numeric(table[name], errors="coerce").to_numpy(dtype=float)
        meant[name] = [f"time_{_unit_of_stamps(stamps)}"]
    added = {column: table[name] for name, columns in meant.items() for column in columns}
    return table.assign(**added), ", ".join(f"'{name}' as {' and '.join(columns)}" for name, columns in meant.items())


def meaning_of(name: str) -> str:
    """What a column of ROS is: `stamp`, `x_m`, `qw`, `angle_FL_deg`, ...; '' for any other.

    >>> meaning_of("field.pose.pose.position.x"), meaning_of("/joint_states/front_left_wheel/velocity")
    ('x_m', 'rate_FL_deg_s')
    """
    words = [word.lower() for word in re.split(r"[./]+", name.strip().lstrip("%/")) if word]
    if not words:
        return ""
    if words[-1] in _STAMPS and (len(words) == 1 or "header" in words):
        return "stamp"
    if "stamp" in words[:-1] and words[-1] in ("secs", "sec", "nsecs", "nsec", "nanosec"):
        return "nsecs" if words[-1].startswith("n") else "secs"
    if words[-2:-1] == ["position"] and words[-1] in ("x", "y"):
        return f"{words[-1]}_m"
    if words[-2:-1] == ["orientation"] and words[-1] in ("x", "y", "z", "w"):
        return f"q{words[-1]}"
    place = re.fullmatch(r".*pose[\W_]?covariance[\W_]?(\d+)\W?", ".".join(words))
    if place:
        return _COVARIANCES.get(place[1], "")
    if len(words) > 1 and words[-1] in ("position", "velocity") and (wheel := _wheel_in(words[-2])):
        if _STEERS.search(words[-2]):
            return f"steered_{wheel}_deg" if words[-1] == "position" else ""
        return f"angle_{wheel}_deg" if words[-1] == "position" else f"rate_{wheel}_deg_s"
    return ""


def _wheel_in(joint: str) -> str:
    words = re.split(r"[_\W]+", joint)
    for word in words:
        for first, other in ((word[:1], word[1:]), (word[1:], word[:1])):
            if len(word) == 2 and first in _ENDS and other in _SIDES:
                return _ENDS[first] + _SIDES[other]
    ends = [_ENDS[word] for word in words if len(word) > 2 and word in _ENDS]
    sides = [_SIDES[word] for word in words if len(word) > 2 and word in _SIDES]
    return ends[0] + sides[0] if ends and sides else ""


def ros_names(names: list[str]) -> list[str]:
    """Columns that a table of ROS has in lunarsci's words; none for any other table."""
    meanings = {meaning_of(name) for name in names} - {""}
    if not meanings & {"x_m", "qw"} or not meanings & {"stamp", "secs"}:
        return []
    turned = {"time_s", *(("yaw_deg",) if "qw" in meanings else ())}
    return sorted(meanings - {"stamp", "secs", "nsecs", "qx", "qy", "qz", "qw", "yaw_variance"} | turned)


def named_otherwise(columns: Sequence[str]) -> list[str]:
    """Columns of telemetry and positions that are there by other names, such as those of ROS, or in other units."""
    ros = ros_names([*columns])
    if not any(name.startswith("angle_") for name in ros):  # places, whichever way the rover looks
        ros = [name for name in ros if name != "yaw_deg"]
    meant = [one for columns_of in names_meant(columns, ("FL", "FR", "RL", "RR")).values() for one in columns_of]
    if any(name.startswith(("angle_", "rate_")) for name in meant):
        ros += [*meant, *columns_by_unit(meant)]
    return ros + [name for name in columns_by_unit([*columns]) if name not in columns]


def from_ros(file: str, table: "pd.DataFrame") -> "pd.DataFrame":
    """A table of ROS with lunarsci's columns; any other as it is. Raises DataError for two places of one rover."""
    names = [str(name) for name in table.columns]
    if not ros_names(names) or "time_s" in names:
        return table
    columns: dict[str, str] = {}
    for name in sorted(names, key=lambda one: "odom" in one.lower()):
        meaning = meaning_of(name)
        other = columns.get(meaning, "")
        if meaning in ("x_m", "qw") and other and ("odom" in other.lower()) == ("odom" in name.lower()):
            raise DataError(f"{file}: '{other}' and '{name}' are both the rover's; keep the localised ones")
        columns.setdefault(meaning, name)
    if "secs" in columns:
        columns.pop("stamp", None)
    values = {meaning: numbers_of(file, name, table[name]) for meaning, name in columns.items() if meaning}
    made = {"time_s": _seconds(columns, values.get("secs", values.get("stamp", np.zeros(0))))}
    if "secs" in values and "nsecs" in values:
        made["time_s"] = made["time_s"] + 1e-9 * values["nsecs"]
    for meaning, column in values.items():
        if meaning.endswith("_m"):
            made[meaning] = column
        elif meaning.endswith(("_deg", "_deg_s")):
            made[meaning] = np.degrees(column)
    if all(f"q{axis}" in values for axis in "xyzw"):
        attitude = yaw_roll_pitch(np.column_stack([values[f"q{axis}"] for axis in "xyzw"]))
        made |= dict(zip(("yaw_deg", "roll_deg", "pitch_deg"), attitude.T, strict=True))
    if {*ERRORS} <= {*values} and (values["xx_m2"] > 0).any():
        made |= {name: values[name] for name in ERRORS}
    if "yaw_variance" in values and (values["yaw_variance"] > 0).any():
        made["yaw_deg_sigma"] = np.degrees(np.sqrt(np.maximum(values["yaw_variance"], 0.0)))
    return table.drop(columns=[*columns.values()]).assign(
        **{name: ["" if np.isnan(one) else repr(float(one)) for one in column] for name, column in made.items()}
    )


def _seconds(columns: dict[str, str], stamps: FloatArray) -> FloatArray:
    """Stamps in s: `rostopic echo -p` has ns whatever they are, others by their size."""
    if "secs" not in columns and columns.get("stamp", "").startswith(("%", "field.")):
        return 1e-9 * stamps
    return SIZES["s"].get(_unit_of_stamps(stamps), 1.0) * stamps


def _unit_of_stamps(stamps: FloatArray) -> str:
    most = float(np.nanmax(stamps, initial=0.0))
    return next((unit for least, unit in STAMP_UNITS if most >= least), "s")


def yaw_roll_pitch(quaternion: FloatArray) -> FloatArray:
    """Of quaternions x, y, z, w, pitch positive nose down; NaN where they are none. (n, 3) [deg]

    Body axes x ahead, y left, z up, as ROS has them (REP 103).
    """
    from scipy.spatial.transform import Rotation

    turns = np.full((len(quaternion), 3), np.nan)
    norm = np.linalg.norm(quaternion, axis=1)
    proper: BoolArray = np.isfinite(norm) & (norm > 0)
    if proper.any():
        turns[proper] = Rotation.from_quat(quaternion[proper]).as_euler("ZYX", degrees=True)[:, [0, 2, 1]]
    return turns
