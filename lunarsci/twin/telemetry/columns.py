"""Which columns telemetry must have, how tables of ROS name them, and what to say where some are missing.

Of ROS: `rostopic echo -p` (%time, field.pose.pose.position.x), bagpy (header.stamp.secs), ros2 bags
(header.stamp.nanosec) and PlotJuggler (__time, /joint_states/wheel_FL/position). Units and axes are those of REP 103:
s, m, rad, x ahead, z up; covariances those of geometry_msgs/PoseWithCovariance: 6 x 6 of x, y, z and turns about them,
row by row.
"""

import difflib
import math
import re
from typing import TYPE_CHECKING

import numpy as np

from lunarsci.arrays import FloatArray
from lunarsci.errors import DataError
from lunarsci.io.tables import numbers_of
from lunarsci.twin.rover import Rover

if TYPE_CHECKING:
    import pandas as pd

NEEDED = ("time_s", "x_m", "y_m", "yaw_deg")
ERRORS = ("xx_m2", "xy_m2", "yy_m2")
WHEEL = re.compile(r"(?:speed|steering|angle|rate|steered)_([A-Za-z0-9]+)_(?:m_s|deg|deg_s)")
DEG = math.degrees(1.0)
UNITS = {
    "m": {"mm": 1e-3, "cm": 1e-2, "dm": 0.1, "km": 1e3},
    "m2": {"mm2": 1e-6, "cm2": 1e-4},
    "s": {"ns": 1e-9, "us": 1e-6, "ms": 1e-3, "min": 60.0, "h": 3600.0},
    "deg": {"rad": DEG, "mrad": 1e-3 * DEG, "turns": 360.0},
    "deg_s": {"rad_s": DEG, "rpm": 6.0},
    "m_s": {"cm_s": 1e-2, "mm_s": 1e-3, "km_h": 1.0 / 3.6},
}
"""What names may end in: the unit that is meant, and those that are read as well with their size in it."""
UNIT = re.compile(rf"_({'|'.join([*UNITS, *(unit for others in UNITS.values() for unit in others)])})(?=$|_sigma$)")


def named_columns(names: list[str]) -> dict[str, tuple[str, float]]:
    """Columns by the names that telemetry has for them, in which column each is, and what it is multiplied by.

    `yaw_rad` is `yaw_deg` in another unit, where there is none in this one.
    """
    found = {name: (name, 1.0) for name in names}
    for name in names:
        if match := UNIT.search(name):
            for own, others in UNITS.items():
                if match[1] in others:
                    meant = f"{name[: match.start()]}_{own}{name[match.end() :]}"
                    found.setdefault(meant, (name, others[match[1]]))
    return found


def check_telemetry_columns(file: str, names: list[str], rover: Rover, *, placed: bool) -> None:
    """Raises DataError for wheels of another rover, and for columns that are missing, with what may be meant.

    Positions are needed where they do not come from elsewhere (`placed`).
    """
    _check_strange(file, names, rover)
    _check_all_there(file, names, rover, placed=placed)
    _check_wheels(file, names, rover)
    _check_needed(file, names, placed=placed)


def _check_all_there(file: str, names: list[str], rover: Rover, *, placed: bool) -> None:
    """Raises DataError, with all of them, where more than one quantity is missing, and not only some wheels."""
    missing = [name for name in NEEDED if name not in names and (placed or name not in ("x_m", "y_m"))]
    told = [f"{name}{_guess(name, names)}" for name in missing]
    for forms in (("angle_{}_deg", "rate_{}_deg_s", "speed_{}_m_s"), ("steered_{}_deg", "steering_{}_deg")):
        without = [wheel for wheel in rover.wheels if not any(form.format(wheel) in names for form in forms)]
        if without:
            which = "each wheel W" if len(without) == len(rover.wheels) else f"W = {', '.join(without)}"
            guess = _guess(forms[0].format(without[0]), names) if len(without) == len(rover.wheels) else ""
            told.append(f"{' or '.join(form.format('W') for form in forms)} of {which}{guess}")
    if len(told) > 1 and (missing or not _wheels_in(names)):
        raise DataError(
            f"{file}: columns are missing: {', '.join(told)}; steered_W_deg is 0 for wheels that stay straight; "
            "`lunarsci template telemetry` has all"
        )


def _guess(needed: str, names: list[str]) -> str:
    bare = UNIT.sub("", needed)
    other = [name for name in names if UNIT.sub("", name) == bare] or difflib.get_close_matches(needed, names, 1, 0.75)
    return f" ({other[0]}?)" if other else ""


def _check_needed(file: str, names: list[str], *, placed: bool) -> None:
    for needed in NEEDED:
        if needed not in names and (placed or needed not in ("x_m", "y_m")):
            told = f"{_hint(needed, names)}; `lunarsci template telemetry` has all columns"
            raise DataError(f"{file}: no column {needed}{told}")


def _hint(needed: str, names: list[str]) -> str:
    """The column that may be meant: one with a name like it."""
    near = difflib.get_close_matches(needed, names, n=1, cutoff=0.7)
    return f"; is it '{near[0]}'? rename it" if near else f"; there are: {', '.join(names[:12])}"


def _check_strange(file: str, names: list[str], rover: Rover) -> None:
    strange = [wheel for wheel in _wheels_in(names) if wheel not in rover.wheels]
    if strange:
        own = ", ".join(rover.wheels)
        raise DataError(
            f"{file}: '{strange[0]}' is no wheel of {rover.name}, which has {own}; give the right one as `rover`"
        )


def _wheels_in(names: list[str]) -> list[str]:
    return sorted({match[1] for name in names if (match := WHEEL.fullmatch(name))})


def _check_wheels(file: str, names: list[str], rover: Rover) -> None:
    found = _wheels_in(names)
    for wheel in rover.wheels:
        for what, forms in (("turned", ("angle", "rate", "speed")), ("was steered", ("steered", "steering"))):
            units = {"rate": "deg_s", "speed": "m_s"}
            columns = [f"{form}_{wheel}_{units.get(form, 'deg')}" for form in forms]
            if not any(column in names for column in columns):
                hint = f"; the file has the wheels {', '.join(found)}" if found else ""
                raise DataError(
                    f"{file}: how {wheel} {what} is not given; add {' or '.join(columns)}{hint}; each wheel needs a "
                    "turn and a steering (0 if it stays straight), as in `lunarsci template telemetry`; or give the "
                    "`rover` that has these wheels"
                )


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
