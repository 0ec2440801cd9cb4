"""Columns of telemetry as tables of ROS name them: stamps, positions, quaternions, covariances, and joints of wheels.

`rostopic echo -p` (%time, field.pose.pose.position.x), bagpy (header.stamp.secs), ros2 bags (header.stamp.nanosec) and
PlotJuggler (__time, /joint_states/wheel_FL/position). Units and axes are those of REP 103: s, m, rad, x ahead, z up;
covariances those of geometry_msgs/PoseWithCovariance: 6 x 6 of x, y, z and turns about them, row by row.
"""

import re
from typing import TYPE_CHECKING

import numpy as np

from lunarsci.arrays import FloatArray
from lunarsci.errors import DataError
from lunarsci.io.tables import numbers_of

if TYPE_CHECKING:
    import pandas as pd

_ENDS = {"f": "F", "front": "F", "m": "M", "mid": "M", "middle": "M", "center": "M", "centre": "M"}
_ENDS |= {"r": "R", "rear": "R", "b": "R", "back": "R"}
_SIDES = {"l": "L", "left": "L", "r": "R", "right": "R"}
_COVARIANCES = {"0": "xx_m2", "1": "xy_m2", "7": "yy_m2", "35": "yaw_variance"}
_STAMPS = {"time", "__time", "timestamp", "stamp", "rosbagtimestamp"}
_STEERS = re.compile(r"steer|corner|azimuth", re.IGNORECASE)
STAMP_UNITS = ((1e17, 1e-9), (1e14, 1e-6), (1e11, 1e-3))
"""Stamps from these on are in these units of s: the clock began in 1970 and stands below 1e10 s. [-, s]"""


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


def own_names(names: list[str]) -> list[str]:
    """Columns that a table of ROS has in lunarsci's words; none for any other table."""
    found = {meaning_of(name) for name in names} - {""}
    if not found & {"x_m", "qw"} or not found & {"stamp", "secs"}:
        return []
    turned = {"time_s", *(("yaw_deg",) if "qw" in found else ())}
    return sorted(found - {"stamp", "secs", "nsecs", "qx", "qy", "qz", "qw", "yaw_variance"} | turned)


def in_own_words(file: str, table: "pd.DataFrame") -> "pd.DataFrame":
    """A table of ROS with lunarsci's columns; any other as it is. Raises DataError for two places of one rover."""
    names = [str(name) for name in table.columns]
    if not own_names(names) or "time_s" in names:
        return table
    found: dict[str, str] = {}
    for name in sorted(names, key=lambda one: "odom" in one.lower()):
        meaning = meaning_of(name)
        other = found.get(meaning, "")
        if meaning in ("x_m", "qw") and other and ("odom" in other.lower()) == ("odom" in name.lower()):
            raise DataError(f"{file}: '{other}' and '{name}' are both the rover's; keep the localised ones")
        found.setdefault(meaning, name)

    def numbers(meaning: str) -> FloatArray:
        return numbers_of(file, found[meaning], table[found[meaning]])

    made = {"time_s": _seconds(found, numbers("stamp") if "secs" not in found else numbers("secs"))}
    if "secs" in found and "nsecs" in found:
        made["time_s"] = made["time_s"] + 1e-9 * numbers("nsecs")
    for meaning in found:
        if meaning.endswith("_m"):
            made[meaning] = numbers(meaning)
        elif meaning.endswith(("_deg", "_deg_s")):
            made[meaning] = np.degrees(numbers(meaning))
    if all(f"q{axis}" in found for axis in "xyzw"):
        made |= _attitude(np.column_stack([numbers(f"q{axis}") for axis in "xyzw"]))
    errors = {name: numbers(name) for name in ("xx_m2", "xy_m2", "yy_m2", "yaw_variance") if name in found}
    if {"xx_m2", "xy_m2", "yy_m2"} <= {*errors} and (errors["xx_m2"] > 0).any():
        made |= {name: errors[name] for name in ("xx_m2", "xy_m2", "yy_m2")}
    if "yaw_variance" in errors and (errors["yaw_variance"] > 0).any():
        made["yaw_deg_sigma"] = np.degrees(np.sqrt(np.maximum(errors["yaw_variance"], 0.0)))
    return table.drop(columns=[*found.values()]).assign(
        **{name: ["" if np.isnan(one) else repr(float(one)) for one in values] for name, values in made.items()}
    )


def _seconds(found: dict[str, str], stamps: FloatArray) -> FloatArray:
    """Stamps in s: `rostopic echo -p` has ns whatever they are, others by their size."""
    name = found.get("stamp", "")
    if "secs" not in found and (name.startswith("%") or name.startswith("field.")):
        return 1e-9 * stamps
    most = float(np.nanmax(stamps, initial=0.0))
    return next((size for least, size in STAMP_UNITS if most >= least), 1.0) * stamps


def _attitude(quaternion: FloatArray) -> dict[str, FloatArray]:
    """Yaw, roll, pitch of quaternions x, y, z, w, pitch positive nose down; NaN where they are none. (n, 4) [deg]"""
    from scipy.spatial.transform import Rotation

    turns = np.full((len(quaternion), 3), np.nan)
    norm = np.linalg.norm(quaternion, axis=1)
    known = np.isfinite(norm) & (norm > 0)
    if known.any():
        turns[known] = Rotation.from_quat(quaternion[known]).as_euler("ZYX", degrees=True)[:, [0, 2, 1]]
    return dict(zip(("yaw_deg", "roll_deg", "pitch_deg"), turns.T, strict=True))
