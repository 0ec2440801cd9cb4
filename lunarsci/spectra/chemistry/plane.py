"""The plane of the two band centres (Adams 1974, 10.1029/JB079i032p04829) and what may lie where in it."""

import math
from dataclasses import dataclass
from functools import cache

import numpy as np

from lunarsci.spectra.chemistry.regressions import regressions
from lunarsci.spectra.spectrum import FloatArray
from lunarsci.tables import table_rows

__all__ = ["OLIVINE_NM", "PLANE_TABLE", "Anchor", "anchors", "objection"]

PLANE_TABLE = "pyroxene_plane.csv"
OLIVINE_NM = (1046.0, 1090.0)
"""Minimum of the 1 um band of 26 olivines, Fo 92-0; measured on RELAB and USGS spectra, upper hull."""
CPX_NM = 1016.0
"""From here on, Wo about 30, the centres no longer tell clinopyroxenes apart by calcium: they scatter about the end of
the trend."""
PYROXENE_TOLERANCE_NM = 30.0
"""How far the 1 um centre of a pyroxene may lie from the trend; see `tests/spectra/chemistry/test_laboratory.py`."""
OPX_LINE = (5.81, -3425.0)
"""2 um centre of synthetic orthopyroxenes by that at 1 um: 5.81 BC1000 - 3425 nm; measured as the trend was."""
OPX_TOLERANCE_NM = 60.0
OPX_MOST_FS = 55.0
"""Fs of an orthopyroxene from which the lines of Gaffey et al. must not be used, which end at Fs 50; assumed."""
OPX_MOST_NM = 2065.0
"""2 um centre of synthetic ferrosilite, the most that an orthopyroxene has."""
OLIVINE_SHIFT_NM = 8.0
"""Olivine moves the 1 um centre of a chondrite above that of its pyroxene by at least this much; assumed."""
WEAK_SHARE = 0.1
"""Depth of the 2 um band over that of the 1 um band below which the rock may be olivine; assumed. Of 26 olivines one
exceeds it, by a trace of pyroxene."""


@dataclass(frozen=True, slots=True)
class Anchor:
    """Band centres of a synthetic pyroxene. [nm, mol %]"""

    bc1000_nm: float
    bc2000_nm: float
    fs: float
    wo: float


@cache
def anchors() -> tuple[Anchor, ...]:
    """The anchors of the trend, orthopyroxenes first."""
    names = ("bc1000_nm", "bc2000_nm", "fs", "wo")
    return tuple(Anchor(*(float(row[name]) for name in names)) for row in table_rows(PLANE_TABLE))


def objection(place: str, bc1000_nm: float, bc2000_nm: float | None, depth_ratio: float) -> str:
    """Why a spectrum does not lie where a regression was made; empty where it does.

    Parameters
    ----------
    place : `pyroxene`, `orthopyroxene`, `hed`, `olivine`, `chondrite`, `mixture`, or `any`.
    bc1000_nm, bc2000_nm : band centres; None where there is no 2 um band. [nm]
    depth_ratio : depth of the 2 um band over that of the 1 um band, 0 where there is none. [-]
    """
    if place == "olivine":
        return _no_olivine(bc1000_nm, depth_ratio)
    if place == "any":
        return ""
    if bc2000_nm is None:
        return "there is no 2 µm band"
    return _JUDGES[place](bc1000_nm, bc2000_nm)


def _no_olivine(bc1000_nm: float, depth_ratio: float) -> str:
    if depth_ratio > WEAK_SHARE:
        return "there is a 2 µm band: pyroxene"
    low, high = OLIVINE_NM
    return "" if low <= bc1000_nm <= high else f"the 1 µm centre is not between {low:g} and {high:g} nm"


def _no_pyroxene(bc1000_nm: float, bc2000_nm: float) -> str:
    off = _off_trend(bc1000_nm, bc2000_nm)
    if abs(off) > PYROXENE_TOLERANCE_NM:
        return _where(off)
    iron = regressions()["fs_trend_bc2000"].value(bc2000_nm)
    if not _no_orthopyroxene(bc1000_nm, bc2000_nm) and iron > OPX_MOST_FS:
        return f"the centres are those of an orthopyroxene with Fs {iron:.0f}, and the lines end at 50"
    return ""


def _no_orthopyroxene(bc1000_nm: float, bc2000_nm: float) -> str:
    off = bc2000_nm - OPX_LINE[0] * bc1000_nm - OPX_LINE[1]
    return "the two centres are not those of an orthopyroxene" if abs(off) > OPX_TOLERANCE_NM else ""


def _no_hed(bc1000_nm: float, bc2000_nm: float) -> str:
    """The regressions of both bands must agree, within three times their errors."""
    for quantity in ("fs", "wo"):
        one, two = (regressions()[f"{quantity}_burbine_{key}"] for key in ("bc1000", "bc2000"))
        if abs(one.value(bc1000_nm) - two.value(bc2000_nm)) > 3 * math.hypot(one.error, two.error):
            return "the two centres are not those of a howardite, eucrite or diogenite"
    return ""


def _no_mixture(bc1000_nm: float, bc2000_nm: float) -> str:
    if bc1000_nm > OLIVINE_NM[0]:
        return "the 1 µm band is that of olivine or augite"
    return "the 2 µm band is that of clinopyroxene" if bc2000_nm > OPX_MOST_NM else ""


def _no_chondrite(bc1000_nm: float, bc2000_nm: float) -> str:
    if _off_trend(bc1000_nm, bc2000_nm) < OLIVINE_SHIFT_NM:
        return "the two centres are those of pyroxene without olivine"
    return _no_mixture(bc1000_nm, bc2000_nm)


_JUDGES = {
    "pyroxene": _no_pyroxene,
    "orthopyroxene": _no_orthopyroxene,
    "hed": _no_hed,
    "mixture": _no_mixture,
    "chondrite": _no_chondrite,
}


def _where(off_nm: float) -> str:
    if off_nm > 0:
        return f"the 1 µm centre lies {off_nm:.0f} nm above the pyroxenes: olivine or several pyroxenes"
    return f"the 1 µm centre lies {-off_nm:.0f} nm below the pyroxenes"


def _off_trend(bc1000_nm: float, bc2000_nm: float) -> float:
    """1 um centre less the nearest that a pyroxene with this 2 um centre has. [nm]"""
    lower, upper = (float(np.interp(bc2000_nm, *branch)) for branch in _branches())
    upper = max(upper, OLIVINE_NM[0]) if bc2000_nm > _end() else upper
    return bc1000_nm - float(np.clip(bc1000_nm, min(lower, upper), max(lower, upper)))


def _end() -> float:
    return min(anchor.bc2000_nm for anchor in anchors() if anchor.bc1000_nm >= CPX_NM) - PYROXENE_TOLERANCE_NM


def _branches() -> tuple[tuple[FloatArray, FloatArray], tuple[FloatArray, FloatArray]]:
    """(2 um, 1 um) centres of orthopyroxenes, and of the way from Fs 20 to the calcium-rich end. [nm]"""
    poor = [anchor for anchor in anchors() if anchor.wo == 0]
    rich = [poor[1], *(anchor for anchor in anchors() if anchor.wo > 0)]
    rich = sorted(rich, key=lambda anchor: anchor.bc2000_nm)
    return _curve(poor), _curve(rich)


def _curve(items: list[Anchor]) -> tuple[FloatArray, FloatArray]:
    return np.array([item.bc2000_nm for item in items]), np.array([item.bc1000_nm for item in items])
