"""One end member: the spectrum of one mineral, with what is known of the sample."""

import math
from dataclasses import dataclass
from typing import Any

import numpy as np

from lunarsci.errors import DataError
from lunarsci.spectra.spectrum import FloatArray

__all__ = ["CHEMISTRY", "MINERALS", "EndMember", "mineral_named"]

MINERALS = ("olivine", "orthopyroxene", "clinopyroxene", "plagioclase", "opaque", "glass", "other")
CHEMISTRY = {
    "olivine": ("fo",),
    "orthopyroxene": ("fs", "en", "wo"),
    "clinopyroxene": ("fs", "en", "wo"),
    "plagioclase": ("an",),
}
"""Which components describe which mineral; the others have none."""
_ALIASES = {
    "ol": "olivine",
    "opx": "orthopyroxene",
    "lcp": "orthopyroxene",
    "cpx": "clinopyroxene",
    "hcp": "clinopyroxene",
    "plg": "plagioclase",
    "plag": "plagioclase",
    "ilmenite": "opaque",
    "ilm": "opaque",
}


def mineral_named(name: str) -> str | None:
    """One of `MINERALS` by its name or usual abbreviation, None for a blank. Raises DataError for any other."""
    word = name.strip().casefold()
    if not word:
        return None
    found = _ALIASES.get(word, word)
    if found not in MINERALS:
        raise DataError(f"mineral {name!r} is not known; use one of {', '.join(MINERALS)}")
    return found


@dataclass(frozen=True, slots=True, eq=False)
class EndMember:
    """The reflectance spectrum of one mineral, channels without a measurement left out.

    Attributes
    ----------
    id : name of the spectrum, not empty.
    mineral : one of `MINERALS`; None where nobody said.
    wavelength_nm : shape (n,), n >= 1, finite, above 0, strictly ascending. [nm]
    reflectance : shape (n,), finite, fraction of 1; what is not above 0 or above 1 is for `check_library` to find. [-]
    fo, fs, en, wo, an : forsterite, ferrosilite, enstatite, wollastonite, anorthite; mole fraction 0 to 1, or None. [-]
    min_um, max_um : grain sizes, 0 or more, min_um <= max_um, or None. [um]
    source : where the spectrum comes from.

    Raises
    ------
    DataError when a rule above is broken; the message begins with the id.
    """

    id: str
    mineral: str | None
    wavelength_nm: FloatArray
    reflectance: FloatArray
    fo: float | None = None
    fs: float | None = None
    en: float | None = None
    wo: float | None = None
    an: float | None = None
    min_um: float | None = None
    max_um: float | None = None
    source: str = ""

    def __post_init__(self) -> None:
        if not self.id.strip():
            raise DataError("an end member has no id; name its column")
        if self.mineral is not None and self.mineral not in MINERALS:
            raise DataError(f"{self.id}: mineral {self.mineral!r} is not known; use one of {', '.join(MINERALS)}")
        for name in ("wavelength_nm", "reflectance"):
            values = np.array(getattr(self, name), dtype=float)
            values.setflags(write=False)
            object.__setattr__(self, name, values)
        self._check_channels()
        self._check_sample()

    def _check_channels(self) -> None:
        wavelength, reflectance = self.wavelength_nm, self.reflectance
        if wavelength.ndim != 1 or wavelength.size == 0 or wavelength.shape != reflectance.shape:
            raise DataError(f"{self.id}: {wavelength.shape} wavelengths and {reflectance.shape} reflectances; give one "
                            "of each per channel, and at least one channel")  # fmt: skip
        if not (np.isfinite(wavelength).all() and np.isfinite(reflectance).all()):
            raise DataError(f"{self.id}: a wavelength or reflectance is not finite; leave that channel out")
        if wavelength[0] <= 0 or not (np.diff(wavelength) > 0).all():
            raise DataError(f"{self.id}: wavelengths are not above 0 and strictly ascending; sort them")

    def _check_sample(self) -> None:
        for name in ("fo", "fs", "en", "wo", "an"):
            value = getattr(self, name)
            if value is not None and not 0 <= value <= 1:
                raise DataError(f"{self.id}: {name} = {value:g} is no mole fraction; give 0 to 1, not per cent")
        for name in ("min_um", "max_um"):
            value = getattr(self, name)
            if value is not None and not (value >= 0 and math.isfinite(value)):
                raise DataError(f"{self.id}: {name} = {value:g} is no grain size; give um, 0 or more")
        if self.min_um is not None and self.max_um is not None and self.min_um > self.max_um:
            raise DataError(f"{self.id}: grain sizes run from {self.min_um:g} down to {self.max_um:g} um; swap them")

    def sample(self) -> dict[str, Any]:
        """Everything but the id and the spectrum, as plain values."""
        names = ("mineral", "fo", "fs", "en", "wo", "an", "min_um", "max_um", "source")
        return {name: getattr(self, name) for name in names}
