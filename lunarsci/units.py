"""Units of quantities, by the ends of their names."""

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
ENDS = ("_sigma", "_low", "_high", "_low68", "_high68", "_low95", "_high95")


def unit_of(key: str) -> str:
    """The unit that a key's suffix names, for astropy; '' where it names none.

    >>> unit_of("center_nm"), unit_of("resistance_torque_nm"), unit_of("slip_ratio"), unit_of("sinkage_m_sigma")
    ('nm', 'N m', '', 'm')
    """
    bare = next((key.removesuffix(end) for end in ENDS if key.endswith(end)), key)
    return next((unit for suffix, unit in UNITS.items() if f"_{bare}".endswith(f"_{suffix}")), "")
