"""Intervals of fitted parameters, whatever method they come from, and the ratios that both methods derive."""

from dataclasses import dataclass
from typing import Any

import numpy as np

from lunarsci.spectra.mgm.model import MgmModel
from lunarsci.spectra.mgm.result import REACH_NM
from lunarsci.spectra.spectrum import FloatArray

__all__ = ["Interval", "Intervals", "ratio_names", "ratio_rows", "ratios_of"]


@dataclass(frozen=True, slots=True)
class Interval:
    """One parameter's 68.27 % and 95 % intervals, in the unit of its name: nm for centres and widths.

    `value` is the parameter at the minimum for a profile, the median for draws. An end that is a bound of the parameter
    is that bound; NaN where the interval could not be closed.
    """

    name: str
    value: float
    low68: float
    high68: float
    low95: float
    high95: float

    def to_dict(self) -> dict[str, Any]:
        """Plain Python."""
        return {name: getattr(self, name) for name in self.__slots__}


@dataclass(frozen=True, slots=True)
class Intervals:
    """Intervals of one fit: `method` is `profile` or `sample`; `remarks` say what limits their use."""

    method: str
    intervals: tuple[Interval, ...]
    remarks: tuple[str, ...]

    def __getitem__(self, name: str) -> Interval:
        """The interval of a parameter; KeyError where it has none."""
        for interval in self.intervals:
            if interval.name == name:
                return interval
        raise KeyError(name)

    def to_dict(self) -> dict[str, Any]:
        """Plain Python."""
        return {
            "method": self.method,
            "intervals": [interval.to_dict() for interval in self.intervals],
            "remarks": list(self.remarks),
        }


def ratio_rows(model: MgmModel, wavelength_nm: FloatArray) -> dict[str, tuple[int, int]]:
    """Positions of the strengths of orthopyroxene and clinopyroxene by region, `um1` and `um2`.

    Only where the assemblage has both and the channels, ascending, reach over both bands. [nm]
    """
    rows: dict[str, tuple[int, int]] = {}
    for region, (low, high) in REACH_NM.items():
        found = {
            band.mineral: model.degrees + 3 * k + 2
            for k, band in enumerate(model.assemblage.bands)
            if band.region == region
        }
        if {"orthopyroxene", "clinopyroxene"} <= found.keys() and wavelength_nm[0] <= low and wavelength_nm[-1] >= high:
            rows[region] = (found["orthopyroxene"], found["clinopyroxene"])
    return rows


def ratio_names(model: MgmModel, wavelength_nm: FloatArray) -> tuple[str, ...]:
    """`nbsr_um1_opx` and `nbsr_um2_opx`, as far as `ratio_rows` finds them."""
    return tuple(f"nbsr_{region}_opx" for region in ratio_rows(model, wavelength_nm))


def ratios_of(points: FloatArray, model: MgmModel, wavelength_nm: FloatArray) -> dict[str, FloatArray]:
    """s_OPX / (s_OPX + s_CPX) by name, shape (n,), of parameter vectors, shape (n, p); NaN where both are 0. [-]

    Kanner, Mustard & Gendrin (2007), Icarus 187, 442, 10.1016/j.icarus.2006.10.025.
    """
    found = {}
    for region, (opx, cpx) in ratio_rows(model, wavelength_nm).items():
        total = points[:, opx] + points[:, cpx]
        with np.errstate(invalid="ignore"):
            found[f"nbsr_{region}_opx"] = np.asarray(points[:, opx] / total, dtype=np.float64)
    return found
