"""End members: spectra of single minerals, embedded as bands and continuum, or the user's own."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from lunarsci.errors import ParameterError
from lunarsci.spectra.library import EndMember
from lunarsci.spectra.mgm.forward import model_and_jacobian
from lunarsci.spectra.mgm.model import mgm_model, unit_of
from lunarsci.spectra.spectrum import FloatArray
from lunarsci.tables import table_rows

__all__ = ["FAMILY_OF", "TABLE", "MineralSpectrum", "embedded_end_members", "of_library"]

TABLE = "end_members.csv"
FAMILY_OF = {"olivine": "OL", "orthopyroxene": "OPX", "clinopyroxene": "CPX", "plagioclase": "PLG"}
"""Assemblage by which a mineral's spectra are described."""
CHEMISTRY = ("fo", "fs", "en", "wo", "an")


@dataclass(frozen=True, slots=True, eq=False)
class MineralSpectrum:
    """A powder of one mineral.

    Attributes
    ----------
    id, source : name, and the library it comes from.
    mineral : one of `FAMILY_OF`.
    chemistry : `fo`, `fs`, `en`, `wo`, `an` as far as they are known. [mol %]
    wavelength_nm, reflectance : (n,) each, ascending; reflectance above 0. [nm, -]

    Raises
    ------
    ParameterError for another mineral, and arrays that do not fit together.
    """

    id: str
    source: str
    mineral: str
    chemistry: dict[str, float]
    wavelength_nm: FloatArray
    reflectance: FloatArray

    def __post_init__(self) -> None:
        if self.mineral not in FAMILY_OF:
            raise ParameterError(f"{self.id}: mineral '{self.mineral}'; give one of {', '.join(FAMILY_OF)}")
        if self.wavelength_nm.ndim != 1 or self.wavelength_nm.shape != self.reflectance.shape:
            raise ParameterError(f"{self.id}: wavelengths and reflectance differ in shape")
        if not (np.all(np.diff(self.wavelength_nm) > 0) and np.all(self.reflectance > 0)):
            raise ParameterError(f"{self.id}: wavelengths must ascend and reflectance be above 0")

    def at(self, wavelength_nm: FloatArray) -> FloatArray:
        """Reflectance between the own channels, NaN beyond them. [-]"""
        return np.interp(wavelength_nm, self.wavelength_nm, self.reflectance, left=np.nan, right=np.nan)


def embedded_end_members(wavelength_nm: FloatArray) -> tuple[MineralSpectrum, ...]:
    """The embedded library on the given channels: spectra rebuilt from their bands and continua.

    Within `lowest_nm` to `highest_nm` of the table a rebuilt spectrum differs from the measured one by `rms_ln_percent`
    (0.5-1 %, root mean square of ln R); beyond, it is an extrapolation, so channels outside 450-2450 nm are refused.

    Raises ParameterError for channels outside that range.
    """
    if wavelength_nm.size and not (wavelength_nm[0] >= 450 and wavelength_nm[-1] <= 2450):
        raise ParameterError("the embedded end members reach from 450 to 2450 nm; give channels within")
    return tuple(_rebuilt(row, wavelength_nm) for row in table_rows(TABLE))


def _rebuilt(values: Mapping[str, str], wavelength_nm: FloatArray) -> MineralSpectrum:
    model = mgm_model(FAMILY_OF[values["mineral"]])
    point = np.array([float(values[name]) / unit_of(name) for name in model.names])
    found = model_and_jacobian(point, wavelength_nm / 1e3, model.basis(wavelength_nm), model.logarithmic)
    if found is None:
        raise ParameterError(f"{TABLE}: {values['id']} has a continuum that is not above 0")
    chemistry = {key: float(values[key]) for key in CHEMISTRY if values[key]}
    return MineralSpectrum(
        values["id"], values["source"], values["mineral"], chemistry, wavelength_nm, np.exp(found[0])
    )


def of_library(members: Sequence[EndMember]) -> list[MineralSpectrum]:
    """Those of a user's library that are one of `FAMILY_OF`; channels without a reflectance above 0 are left out."""
    found = []
    for item in members:
        if item.mineral in FAMILY_OF:
            there = item.reflectance > 0
            stated = {key: 100 * value for key in CHEMISTRY if (value := getattr(item, key)) is not None}
            found.append(
                MineralSpectrum(
                    item.id, item.source, item.mineral, stated, item.wavelength_nm[there], item.reflectance[there]
                )
            )
    return found
