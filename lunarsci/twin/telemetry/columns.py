"""Which columns telemetry must have, and what is said where some are missing or named otherwise."""

import difflib
import math
import re

from lunarsci.errors import DataError
from lunarsci.twin.rover import Rover

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
