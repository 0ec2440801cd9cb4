"""Libraries as files: an ECSV table of spectra, whose header says what each of them is.

The table is one of spectra like any other (`wavelength_nm`, then one column per end member, empty where it has no
channel), so every command reads it; `end_members` in its header holds mineral, chemistry, grain size and source by id.
"""

import io
import warnings
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from lunarsci.errors import DataError, LunarSciWarning
from lunarsci.inputs import InputFile
from lunarsci.provenance import plain
from lunarsci.spectra.library.end_member import EndMember, mineral_named
from lunarsci.spectra.readers import read_spectra
from lunarsci.spectra.readers.columns import assign_roles
from lunarsci.spectra.readers.table import ReflectanceUnit, WavelengthUnit
from lunarsci.spectra.spectrum import FloatArray, Spectrum

__all__ = ["FORMAT", "end_member", "read_library", "to_ecsv"]

FORMAT = "lunarsci-library/1"
_NUMBERS = ("fo", "fs", "en", "wo", "an", "min_um", "max_um")


def read_library(
    source: InputFile,
    *,
    wavelength_unit: WavelengthUnit | None = None,
    reflectance_unit: ReflectanceUnit | None = None,
) -> list[EndMember]:
    """Read the end members of a library, in file order; of any other file of spectra, without what describes them.

    Spectra without a reflectance in any channel are left out, which the reader's LunarSciWarning says. The units are
    those of `read_spectra`. Raises DataError, one line with the file, when the file or an entry of its header cannot be
    used. Whether the spectra are fit for use is another question: `check_library` answers it.
    """
    spectra = read_spectra(source, wavelength_unit=wavelength_unit, reflectance_unit=reflectance_unit)
    measured = [spectrum for spectrum in spectra if np.isfinite(spectrum.reflectance).any()]
    if not measured:
        raise DataError(f"{source.name}: none of its {len(spectra)} spectra has a reflectance; check the file")
    return [_member(spectrum, source.name) for spectrum in measured]


def _member(spectrum: Spectrum, file: str) -> EndMember:
    header = spectrum.metadata.get("header")
    described = header.get("end_members", {}) if isinstance(header, Mapping) else {}
    if not isinstance(described, Mapping):
        raise DataError(f"{file}: 'end_members' in the header is no mapping; write the library again")
    column = str(spectrum.metadata.get("column", ""))
    id = column if column in described else spectrum.id
    return _in_file(spectrum, id, described.get(column, {}), file)


def _in_file(spectrum: Spectrum, id: str, sample: Any, file: str) -> EndMember:
    try:
        return end_member(spectrum, sample, id=id)
    except DataError as error:
        raise DataError(f"{file}: {error}") from error


def end_member(spectrum: Spectrum, sample: Any, *, id: str | None = None) -> EndMember:
    """An end member from a spectrum, its channels with a reflectance, and the fields of `EndMember` by name.

    Fields that are left out or None are unknown. Raises DataError for a value that is none, or a spectrum without any.
    """
    name = id or spectrum.id
    if not isinstance(sample, Mapping):
        raise DataError(f"{name}: its description is no mapping of names to values; write the library again")
    measured = np.isfinite(spectrum.reflectance)
    if not measured.any():
        raise DataError(f"{name}: has no reflectance in any channel; delete it")
    try:
        mineral = mineral_named(str(sample.get("mineral") or ""))
    except DataError as error:
        raise DataError(f"{name}: {error}") from error
    return EndMember(
        name,
        mineral,
        spectrum.wavelength_nm[measured],
        spectrum.reflectance[measured],
        **{key: _number(sample.get(key), f"{name}: {key}") for key in _NUMBERS},
        source=str(sample.get("source") or ""),
    )


def _number(value: Any, what: str) -> float | None:
    if value is None or value == "":
        return None
    try:
        return float(value)
    except (TypeError, ValueError) as error:
        raise DataError(f"{what} is {str(value)[:40]!r}, no number; correct it or leave it out") from error


def to_ecsv(members: Sequence[EndMember], provenance: Mapping[str, Any] | None = None) -> bytes:
    """The library as an ECSV file; `provenance` goes into its header.

    Raises DataError for no end members, for two of one id, and for an id that would be read as something else.
    """
    from astropy.table import MaskedColumn, Table

    _check_ids([member.id for member in members])
    grid: FloatArray = np.unique(np.concatenate([member.wavelength_nm for member in members]))
    table = Table({"wavelength_nm": grid})
    table["wavelength_nm"].unit = "nm"
    for member in members:
        values = np.full(grid.size, np.nan)
        values[np.searchsorted(grid, member.wavelength_nm)] = member.reflectance
        table[member.id] = MaskedColumn(values, mask=np.isnan(values), unit="")
    described = {member.id: plain(member.sample()) for member in members}
    table.meta.update({"format": FORMAT, "end_members": described})
    if provenance is not None:
        table.meta["provenance"] = plain(provenance)
    buffer = io.StringIO()
    table.write(buffer, format="ascii.ecsv")
    return buffer.getvalue().encode()


def _check_ids(ids: Sequence[str]) -> None:
    if not ids:
        raise DataError("a library needs at least one end member; none is left")
    twice = next((id for id in ids if ids.count(id) > 1), None)
    if twice is not None:
        raise DataError(f"{twice}: two end members have this id; rename one of them")
    for id in ids:
        with warnings.catch_warnings():
            warnings.simplefilter("error", LunarSciWarning)
            try:
                roles = assign_roles(["wavelength_nm", id, f"not {id}"], InputFile("library", b""))
                fits = [place for place, _ in roles.spectra] == [1, 2]
            except (DataError, LunarSciWarning):
                fits = False
        if not fits:
            raise DataError(f"{id!r}: this id would be read as a column of another kind; rename the spectrum")
