"""Submicroscopic iron on the grains of a mixture, which darkens and reddens it.

Iron particles far smaller than the wavelength add 36 pi phi z / L to the absorption coefficient of a grain, with
z = n^3 n_Fe k_Fe / ((n_Fe^2 - k_Fe^2 + 2 n^2)^2 + (2 n_Fe k_Fe)^2), n the index of the grain and L the wavelength:
Hapke (2001), J. Geophys. Res. 106, 10039, 10.1029/2000JE001338. Here it is added to (1 - w) / w, which is nearly the
absorption coefficient times the grain size.
"""

from dataclasses import dataclass

import numpy as np

from lunarsci.spectra.spectrum import FloatArray
from lunarsci.tables import table_rows

__all__ = ["IRON_TABLE", "Weathering", "iron_absorption"]

IRON_TABLE = "iron_optical_constants.csv"
GRAIN_INDEX = 1.7
"""Refractive index of the silicate around the iron; assumed, pyroxene and olivine have 1.65-1.75."""
UNIT_NM = 1000.0
TYPICAL_LN, SPREAD_LN = -1.0, 1.5
"""Mean and standard deviation of the logarithm of the absorption added at 1000 nm, in units of (1 - w) / w; assumed."""


def iron_absorption(wavelength_nm: FloatArray) -> FloatArray:
    """Absorption of submicroscopic iron, 1 at 1000 nm, from 450 to 2500 nm. [-]"""
    rows = [tuple(map(float, row.values())) for row in table_rows(IRON_TABLE)]
    table_nm, index, extinction = (np.array(column) for column in list(zip(*rows, strict=True))[:3])

    def at(wanted: FloatArray) -> FloatArray:
        n_fe, k_fe = np.interp(wanted, table_nm, index), np.interp(wanted, table_nm, extinction)
        below = (n_fe**2 - k_fe**2 + 2 * GRAIN_INDEX**2) ** 2 + (2 * n_fe * k_fe) ** 2
        return np.asarray(n_fe * k_fe / below / wanted)

    return at(wavelength_nm) / at(np.array([UNIT_NM]))


@dataclass(frozen=True, slots=True, eq=False)
class Weathering:
    """Absorption by iron on given channels; its amount is exp(-1 + 1.5 z), with z standard normal."""

    absorption: FloatArray

    def darken(self, albedo: FloatArray, amount: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Albedo with iron, its derivative by the one without, and by z; (s, n) each, from (s, n) and (s,)."""
        added = np.exp(TYPICAL_LN + SPREAD_LN * amount)[:, None] * self.absorption
        darkened = 1.0 / (1.0 / albedo + added)
        return darkened, (darkened / albedo) ** 2, -(darkened**2) * added * SPREAD_LN
