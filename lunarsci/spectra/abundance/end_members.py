"""What unmixing compares: spectra on common channels, the embedded end members on them, and modes that are stated."""

from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from lunarsci.arrays import FloatArray
from lunarsci.errors import DataError, ParameterError
from lunarsci.io.inputs import InputFile
from lunarsci.io.tables import table_rows
from lunarsci.minerals import ABBREVIATIONS, COMPONENTS
from lunarsci.spectra.abundance.learned import GRID_NM, STEP_NM
from lunarsci.spectra.mgm.forward import model_and_jacobian
from lunarsci.spectra.mgm.model import MgmModel, mgm_model, unit_of
from lunarsci.spectra.readers.columns import rows_by_id
from lunarsci.spectra.readers.library import NEEDED_NM, EndMember, mineral_named
from lunarsci.spectra.rows import number, quoted
from lunarsci.spectra.spectrum import WIDEST_GAP_NM, Spectrum, reaches_over

LOWEST_NM, HIGHEST_NM = map(float, GRID_NM[[0, -1]])
FARTHEST_NM = 5.0
"""How far means of one channel may lie apart where spectra are compared together; assumed."""


@dataclass(frozen=True, slots=True, eq=False)
class CommonChannels:
    """Spectra on channels common to all.

    Attributes
    ----------
    wavelength_nm : (n,) mean wavelengths. [nm]
    ln_reflectance, noise : (s, n) means of ln R, and their standard errors. [-]
    """

    wavelength_nm: FloatArray
    ln_reflectance: FloatArray
    noise: FloatArray


def on_common_channels(spectra: Sequence[Spectrum]) -> CommonChannels:
    """Means over channels of `STEP_NM`; a channel that one spectrum lacks is left out of all.

    Raises
    ------
    DataError for a spectrum that does not reach over `NEEDED_NM`, and spectra that have no channels in common.
    """
    binned = [_binned(spectrum) for spectrum in spectra]
    common = sorted(set.intersection(*(set(channels) for channels in binned)))
    table = np.array([[channels[index] for index in common] for channels in binned])
    wavelength = table[..., 0]
    alike = np.flatnonzero(np.ptp(wavelength, axis=0) <= FARTHEST_NM)
    low, high = np.array(common)[alike][[0, -1]] * STEP_NM + LOWEST_NM if alike.size else (np.inf, -np.inf)
    if low > NEEDED_NM[0] or high + STEP_NM < NEEDED_NM[1]:
        raise DataError("the spectra have too few channels in common to be unmixed together; resample them alike")
    table = table[:, alike]
    return CommonChannels(table[..., 0].mean(axis=0), table[..., 1], table[..., 2])


def reaches(spectrum: Spectrum) -> bool:
    """Whether a spectrum reaches over `NEEDED_NM`."""
    return reaches_over(spectrum.wavelength_nm[spectrum.usable], *NEEDED_NM)


def _binned(spectrum: Spectrum) -> dict[int, tuple[float, float, float]]:
    """Mean wavelength, mean ln R and its standard error by number of the channel."""
    usable = spectrum.usable
    wavelength, reflectance = spectrum.wavelength_nm[usable], spectrum.reflectance[usable]
    if not reaches(spectrum):
        raise DataError(
            f"{spectrum.id}: unmixing needs {NEEDED_NM[0]:g} to {NEEDED_NM[1]:g} nm, without gaps above "
            f"{WIDEST_GAP_NM:g} nm between usable channels"
        )
    noise = 0.0 * wavelength if spectrum.uncertainty is None else spectrum.uncertainty[usable] / reflectance
    inside = np.flatnonzero((wavelength >= LOWEST_NM) & (wavelength < HIGHEST_NM))
    number, index = np.unique(np.floor((wavelength[inside] - LOWEST_NM) / STEP_NM), return_inverse=True)
    count = np.bincount(index)
    mean_nm, mean = (np.bincount(index, row[inside]) / count for row in (wavelength, np.log(reflectance)))
    error = np.sqrt(np.bincount(index, noise[inside] ** 2)) / count
    return {int(key): row for key, *row in zip(number, mean_nm, mean, error, strict=True)}  # type: ignore[misc]


TABLE = "end_members.csv"
OPAQUE = "opaque"
OPAQUE_REFLECTANCE = 0.062
"""Flat within 0.007 from 400 to 2500 nm: ilmenite HS231.3B of the USGS library (Kokaly et al. 2017, 10.3133/ds1035)."""
CACHED_GRIDS = 8


def embedded_end_members(wavelength_nm: FloatArray) -> tuple[EndMember, ...]:
    """The embedded library on the given channels: spectra rebuilt from their bands and continua.

    Within `lowest_nm` to `highest_nm` of the table a rebuilt spectrum differs from the measured one by `rms_ln_percent`
    (0.5-1 %, root mean square of ln R); beyond, it is an extrapolation, so channels outside 450-2450 nm are refused.
    The last is `opaque`, a flat dark spectrum. Spectra on the grids asked for last are kept.

    Raises ParameterError for channels outside that range.
    """
    if wavelength_nm.size and not (wavelength_nm[0] >= LOWEST_NM and wavelength_nm[-1] <= HIGHEST_NM):
        raise ParameterError("the embedded end members reach from 450 to 2450 nm; give channels within")
    return _on_grid(np.asarray(wavelength_nm, dtype=np.float64).tobytes())


@lru_cache(CACHED_GRIDS)
def _on_grid(channels: bytes) -> tuple[EndMember, ...]:
    wavelength = np.frombuffer(channels)
    models = {mineral: mgm_model(family) for mineral, family in ABBREVIATIONS.items()}
    opaque = EndMember("ilmenite", OPAQUE, wavelength, np.full(wavelength.size, OPAQUE_REFLECTANCE), source="usgs")
    return (*(_rebuilt(row, models[row["mineral"]], wavelength) for row in table_rows(TABLE)), opaque)


def _rebuilt(values: Mapping[str, str], model: MgmModel, wavelength_nm: FloatArray) -> EndMember:
    point = np.array([float(values[name]) / unit_of(name) for name in model.names])
    modelled = model_and_jacobian(point, wavelength_nm / 1e3, model.basis(wavelength_nm), model.logarithmic)
    if modelled is None:
        raise ParameterError(f"{TABLE}: {values['id']} has a continuum that is not above 0")
    chemistry = {key: float(values[key]) / 100 for key in COMPONENTS if values[key]}
    sizes = {key: float(values[key]) for key in ("min_um", "max_um") if values[key]}
    return EndMember(
        values["id"],
        values["mineral"],
        wavelength_nm,
        np.exp(modelled[0]),
        source=values["source"],
        specimen=values["specimen"],
        **chemistry,
        **sizes,
    )


PREFIX = "vol_"
"""May stand before a mineral's name in the header."""


@dataclass(frozen=True, slots=True)
class StatedModes:
    """By id of the spectrum.

    Attributes
    ----------
    shares : by volume of all minerals, where every one is stated. [-]
    absent : minerals stated as 0 where others are sought.
    """

    shares: Mapping[str, Mapping[str, float]]
    absent: Mapping[str, Sequence[str]]


def read_modes(source: InputFile) -> StatedModes:
    """Read a table with the column `id` and one per mineral, in full or as `vol_ol` and the like.

    A row of numbers is a mixture whose modes are known; an empty cell is sought, and a 0 beside it says that a mineral
    is absent. Other columns are ignored.

    Raises DataError for a table without ids or minerals, a cell that is no share from 0 to 1, and a row that states
    some shares above 0 but not all.
    """
    rows = rows_by_id(source)
    minerals = _minerals(next(iter(rows.values()))[1], source.name)
    stated: dict[str, dict[str, float]] = {}
    absent: dict[str, list[str]] = {}
    for id, (line, row) in rows.items():
        place = f"{source.name}: line {line}"
        shares = {
            mineral: _share(row[column], f"{place}, column {column}")
            for column, mineral in minerals.items()
            if row[column]
        }
        if len(shares) == len(minerals):
            stated[id] = shares
        elif any(shares.values()):
            raise DataError(f"{place}: some shares are stated, others are not; state all, or leave those sought empty")
        else:
            absent[id] = list(shares)
    return StatedModes(stated, absent)


def _minerals(row: Mapping[str, str], file: str) -> dict[str, str]:
    """Mineral by column."""
    columns: dict[str, str] = {}
    for column in row:
        with suppress(DataError):
            if mineral := mineral_named(column.removeprefix(PREFIX)):
                columns[column] = mineral
    if len(set(columns.values())) != max(1, len(columns)):
        raise DataError(f"{file}: needs columns named after minerals, such as olivine or vol_ol, one of each")
    return columns


def _share(cell: str, place: str) -> float:
    value = number(cell)
    if value is None or not 0 <= value <= 1:
        raise DataError(f"{place}: {quoted(cell)} is no share; give 0 to 1, or leave it empty where it is sought")
    return value
