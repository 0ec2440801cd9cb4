"""Units of quantities, by the ends of their names."""

import math
import re

DEG = math.degrees(1.0)

UNITS = {
    "torque_nm": "N m",
    "moment_nm": "N m",
    "kpa_m_n": "",
    "per_um": "1 / um",
    "per_m": "1 / m",
    "deg_s": "deg / s",
    "m_s": "m / s",
    "m2": "m2",
    "nm": "nm",
    "um": "um",
    "mm": "mm",
    "km": "km",
    "ma": "Myr",
    "deg": "deg",
    "kpa": "kPa",
    "pa": "Pa",
    "kg": "kg",
    "px": "pix",
    "m": "m",
    "n": "N",
    "s": "s",
    "j": "J",
    "w": "W",
}
"""Unit by the last part of a key, the longest first; that of `stiffness_kpa_m_n` depends on the exponent, so none."""
SIZES = {
    "m": {"mm": 1e-3, "cm": 1e-2, "dm": 0.1, "km": 1e3},
    "m2": {"mm2": 1e-6, "cm2": 1e-4},
    "s": {"ns": 1e-9, "us": 1e-6, "ms": 1e-3, "min": 60.0, "h": 3600.0},
    "deg": {"rad": DEG, "mrad": 1e-3 * DEG, "turns": 360.0},
    "deg_s": {"rad_s": DEG, "rpm": 6.0},
    "m_s": {"cm_s": 1e-2, "mm_s": 1e-3, "km_h": 1.0 / 3.6},
}
"""What names of columns may end in: the unit that is meant, and those that are read as well with their size in it."""
UNIT_ENDING = re.compile(
    rf"_({'|'.join([*SIZES, *(unit for others in SIZES.values() for unit in others)])})(?=$|_sigma$)"
)
ENDS = ("_sigma", "_low", "_high", "_low68", "_high68", "_low95", "_high95")


def unit_of(key: str) -> str:
    """The unit that a key's suffix names, for astropy; '' where it names none.

    >>> unit_of("center_nm"), unit_of("resistance_torque_nm"), unit_of("slip_ratio"), unit_of("sinkage_m_sigma")
    ('nm', 'N m', '', 'm')
    """
    bare = next((key.removesuffix(end) for end in ENDS if key.endswith(end)), key)
    return next((unit for suffix, unit in UNITS.items() if f"_{bare}".endswith(f"_{suffix}")), "")


def columns_by_unit(names: list[str]) -> dict[str, tuple[str, float]]:
    """Columns by the names that are meant, in which column each is, and what it is multiplied by.

    `yaw_rad` is `yaw_deg` in another unit, where there is none in this one.

    >>> columns_by_unit(["yaw_deg", "rut_mm_sigma"])["rut_m_sigma"]
    ('rut_mm_sigma', 0.001)
    """
    columns = {name: (name, 1.0) for name in names}
    for name in names:
        if match := UNIT_ENDING.search(name):
            for unit, others in SIZES.items():
                if match[1] in others:
                    meant = f"{name[: match.start()]}_{unit}{name[match.end() :]}"
                    columns.setdefault(meant, (name, others[match[1]]))
    return columns
