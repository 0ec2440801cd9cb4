"""One reflectance spectrum, checked when it is made."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import numpy.typing as npt

from lunarsci.errors import DataError

__all__ = ["BoolArray", "FloatArray", "Spectrum"]

FloatArray = npt.NDArray[np.float64]
BoolArray = npt.NDArray[np.bool_]


@dataclass(frozen=True, slots=True, eq=False)
class Spectrum:
    """A reflectance spectrum on ascending wavelengths.

    Attributes
    ----------
    id : name of the spectrum, as a reader or its file gives it.
    wavelength_nm : shape (n,), finite, above 0, strictly ascending. [nm]
    reflectance : shape (n,), fraction of 1 (reflectance factor); NaN where there is no measurement. [-]
    uncertainty : shape (n,) one standard deviation, above 0 where reflectance is finite, or None if unknown. [-]
    mask : shape (n,), True where a channel must not be used; always True where reflectance is not finite or not above
        0. May be left out.
    metadata : whatever the file said about it (instrument, geometry, units found, notes of the reader).
    systematic : name of an error that all channels share to the shift of the reflectance by one standard deviation of
        it, shape (n,) each, signed, 0 where a channel must not be used; empty where none is known. [-]

    Raises
    ------
    DataError when a rule above is broken; the message begins with the id.
    """

    id: str
    wavelength_nm: FloatArray
    reflectance: FloatArray
    uncertainty: FloatArray | None = None
    mask: BoolArray | None = None
    metadata: Mapping[str, Any] = field(default_factory=dict)
    systematic: Mapping[str, FloatArray] = field(default_factory=dict)

    def __post_init__(self) -> None:
        wavelength = np.array(self.wavelength_nm, dtype=float)
        reflectance = np.array(self.reflectance, dtype=float)
        self._check_wavelength(wavelength)
        self._check_shape("reflectance", reflectance, wavelength)
        with np.errstate(invalid="ignore"):
            unusable = ~np.isfinite(reflectance) | ~(reflectance > 0)
        if self.mask is not None:
            mask = np.array(self.mask, dtype=bool)
            self._check_shape("mask", mask, wavelength)
            unusable = unusable | mask
        uncertainty = None
        if self.uncertainty is not None:
            uncertainty = np.array(self.uncertainty, dtype=float)
            self._check_shape("uncertainty", uncertainty, wavelength)
            if not (uncertainty[~unusable] > 0).all():
                raise DataError(f"{self.id}: an uncertainty is not above 0; leave the column out if errors are unknown")
        for name, value in (
            ("wavelength_nm", wavelength),
            ("reflectance", reflectance),
            ("uncertainty", uncertainty),
            ("mask", unusable),
        ):
            if value is not None:
                value.setflags(write=False)
            object.__setattr__(self, name, value)
        object.__setattr__(self, "systematic", self._checked_systematic(unusable))

    def _checked_systematic(self, unusable: BoolArray) -> dict[str, FloatArray]:
        checked = {}
        for name, values in self.systematic.items():
            shift = np.array(values, dtype=float)
            self._check_shape(f"systematic '{name}'", shift, unusable)
            if not np.isfinite(shift[~unusable]).all():
                raise DataError(f"{self.id}: systematic '{name}' is not known in every usable channel; complete it")
            shift[unusable] = 0.0
            shift.setflags(write=False)
            checked[name] = shift
        return checked

    def _check_wavelength(self, wavelength: FloatArray) -> None:
        if wavelength.ndim != 1 or wavelength.size == 0:
            raise DataError(f"{self.id}: no channels; a spectrum needs a wavelength and a reflectance column")
        if not (np.isfinite(wavelength).all() and (wavelength > 0).all()):
            raise DataError(f"{self.id}: a wavelength is missing or not above 0 nm; correct or delete that row")
        if not (np.diff(wavelength) > 0).all():
            raise DataError(f"{self.id}: wavelengths are not strictly ascending; sort them and keep one row each")

    def _check_shape(self, name: str, values: npt.NDArray[Any], channels: npt.NDArray[Any]) -> None:
        if values.shape != channels.shape:
            raise DataError(f"{self.id}: {name} has shape {values.shape}, the wavelengths have {channels.shape}")

    @property
    def usable(self) -> BoolArray:
        """True for the channels that may be used; shape (n,)."""
        return ~np.asarray(self.mask, dtype=bool)
