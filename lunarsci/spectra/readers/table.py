"""What every format reader hands over: named columns with the units the file states, before any rule is applied."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any, Literal

from lunarsci.inputs import InputFile
from lunarsci.spectra.rows import quoted
from lunarsci.spectra.spectrum import FloatArray

__all__ = ["Column", "ReflectanceUnit", "SpectrumTable", "StatedUnits", "WavelengthUnit"]


WavelengthUnit = Literal["nm", "um"]
ReflectanceUnit = Literal["fraction", "percent"]


@dataclass(frozen=True, slots=True)
class StatedUnits:
    """Units the caller states for a file that does not; None where nothing is stated."""

    wavelength: WavelengthUnit | None = None
    reflectance: ReflectanceUnit | None = None


@dataclass(frozen=True, slots=True)
class Column:
    """One numeric column.

    Attributes
    ----------
    name : as the file has it, '' where it has none.
    values : shape (rows,), NaN where there is no number.
    position : place in the file, from 1.
    unit : 'nm', 'um', 'fraction' or 'percent' where the file has a field for units; None where only the name may tell.
    unit_text : the unit as the file writes it, where `values` had to be converted.
    """

    name: str
    values: FloatArray
    position: int
    unit: str | None = None
    unit_text: str | None = None

    @property
    def label(self) -> str:
        """How messages name the column."""
        return quoted(self.name) if self.name else str(self.position)


@dataclass(frozen=True, slots=True)
class SpectrumTable:
    """The columns of one file, by role.

    Attributes
    ----------
    source, format : the file and the reader's name.
    wavelength : the one wavelength column.
    spectra : (reflectance, one standard deviation or None) for each spectrum.
    systematic : (name, shift) of the errors that all channels of a spectrum share, by its index in `spectra`.
    places : where each row stands in the file ('line 12'), for messages.
    metadata : what the file says about itself.
    """

    source: InputFile
    format: str
    wavelength: Column
    spectra: tuple[tuple[Column, Column | None], ...]
    places: tuple[str, ...]
    metadata: Mapping[str, Any] = field(default_factory=dict)
    systematic: Mapping[int, tuple[tuple[str, Column], ...]] = field(default_factory=dict)
