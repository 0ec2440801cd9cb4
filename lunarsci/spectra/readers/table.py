"""The table of a file of spectra, as every reader of a format makes it, and the units of its columns.

Readers give named columns with the units the file states, before any rule is applied. The file's word on a unit wins
where the values do not contradict it; else the caller's; else, for wavelengths, the values decide and a LunarSciWarning
says so.
"""

import re
import unicodedata
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import lru_cache
from operator import itemgetter
from typing import Any, Literal

import numpy as np

from lunarsci.arrays import FloatArray, spans
from lunarsci.errors import DataError, warn
from lunarsci.io.inputs import InputFile
from lunarsci.memory import as_named
from lunarsci.spectra.rows import quoted
from lunarsci.spectra.solar import solar_spectrum

WavelengthUnit = Literal["nm", "um", "angstrom", "1/cm"]
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
    unit : 'nm', 'um', 'angstrom', 'cm-1', 'fraction' or 'percent' where the file has a field for units; None
        where only the name may tell.
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
    block : (n, rows) values of all `spectra` as one array, which whoever makes spectra of it may change; None where
        the reader has none.
    """

    source: InputFile
    format: str
    wavelength: Column
    spectra: tuple[tuple[Column, Column | None], ...]
    places: tuple[str, ...]
    metadata: Mapping[str, Any] = field(default_factory=dict)
    systematic: Mapping[int, tuple[tuple[str, Column], ...]] = field(default_factory=dict)
    block: FloatArray | None = None

    @property
    def reflectances(self) -> FloatArray:
        """(n, rows) values of all spectra; `block` where there is one."""
        return np.array([column.values for column, _ in self.spectra]) if self.block is None else self.block

    def taken(self, rows: Any, gain: FloatArray | float = 1.0) -> "SpectrumTable":
        """Some rows, by places or a mask, of the table with reflectances and their errors times `gain`, (n, rows)."""
        gains = np.broadcast_to(gain, self.reflectances.shape)

        def scaled(column: Column, k: int) -> Column:
            return replace(column, values=(column.values * gains[k])[rows])

        return replace(
            self,
            wavelength=replace(self.wavelength, values=self.wavelength.values[rows]),
            spectra=tuple((scaled(r, k), None if s is None else scaled(s, k)) for k, (r, s) in enumerate(self.spectra)),
            places=tuple(np.array(self.places)[rows].tolist()),
            systematic={k: tuple((name, scaled(c, k)) for name, c in each) for k, each in self.systematic.items()},
            block=(self.reflectances * gains)[:, rows],
        )


_NM = {"nm", "nanometer", "nanometers", "nanometre", "nanometres"}
_UM = {"um", "μm", "micron", "microns", "micrometer", "micrometers", "micrometre", "micrometres"}
_ANGSTROM = {"å", "angstrom", "angstroms", "ångström", "ångstrom", "aa", "ang"}
_RECIPROCAL = {"wavenumber", "wavenumbers", "wellenzahl", "cm1", "kayser"}
_OTHER = {"ev", "mev", "kev", "hz", "ghz", "thz", "energy", "frequency", "cm", "mm", "m", "pm"}
_NOT_A_UNIT = {"in", "air", "vacuum", "vac", "center", "centre", "centers", "centres"}
_BRACKETS = re.compile(r"[(\[{]([^)\]}]*)[)\]}]")
_PERCENT = re.compile(
    r"\s*[(\[{]\s*(?:in\s*)?(?:%|percent|per cent|pct|prozent)\s*(?:r|refl[a-z]*\.?)?\s*[)\]}]$|_(?:percent|pct)$|"
    r"(?:(?<=[^\d\s,;/%-])|(?<=[a-z_]\d)|(?<=[a-z_]\d\d))\s*[\s,;/]\s*%$|^\s*%\s*(?=[a-z])",
    re.IGNORECASE,
)
"""How names end that state percent; '50 %' is a share of something."""
PERCENT_SIGN = re.compile(r"%|(?<![a-z])(?:percent|per cent|pct|prozent)(?![a-z])", re.IGNORECASE)
_OF_REFLECTANCE = re.compile(
    r"r\d*|rf|ref|refl\w*|reflex\w*|reflek\w*|r[ée]flect\w*|remission|brf|hdrf|total|diffuse|abs|absolute|rel|relative|"
    r"bidirectional|hemispherical|directional|factor|tgt|target|sample|values?|signal|mean|avg|average|y|in|of|as|the"
)
"""Words of a name beside the sign of percent that say nothing but reflectance."""
_FRACTION = re.compile(r"\s*[(\[{]\s*(?:fraction|0-1|-)\s*[)\]}]$", re.IGNORECASE)

_MAY_SAY_UNIT = re.compile(r"[(\[{%]|per ?cent|pct|prozent", re.IGNORECASE)
"""Where a name has none of these, nothing above is in it."""
_NAMES_CACHED = 4096
_MEDIANS_AT_ONCE = 4096

_FACTOR_NM = {"nm": 1.0, "um": 1000.0, "angstrom": 0.1}
_SYMBOL = {"nm": "nm", "um": "µm", "angstrom": "Å", "cm-1": "cm⁻¹"}
_OF_OPTIONS = {"1/cm": "cm-1"}
"""Units that a file and an option write in two ways."""
_PLAUSIBLE_NM = (50.0, 200_000.0)
"""Wavelengths of a reflectance spectrum, from the ultraviolet to the far infrared; assumed."""
SURELY: dict[WavelengthUnit, tuple[float, float]] = {"nm": (200.0, 5000.0), "um": (0.2, 5.0)}
"""Values that can only be meant in that unit; assumed."""
USUAL_SCALE = 10_000.0
"""What reflectances in whole numbers are multiplied by where a file is silent, as those of MODIS are: Vermote (2021),
10.5067/MODIS/MOD09A1.061."""
SCALES = {"fraction": 1.0, "percent": 0.01, "ten-thousandths": 1.0 / USUAL_SCALE}
_REFLECTANCE = re.compile(r"r|rf|ref|refl\w*|reflex\w*|reflek\w*|r[ée]flect\w*|reff|remission|brf|hdrf|albedo")
"""Words that say reflectance."""
MAX_FRACTION = 2.0
"""A median above this is no reflectance in fractions, even scaled to 1 at some wavelength; assumed."""
SUN_VARIES = 0.7
"""Scatter of ln of the Sun's irradiance over the channels from which it tells radiance from reflectance: 450-1700 nm.
Measured: beyond it all of 508 spectra of laboratories and VNIS in percent are read, and 1 to 13 of their radiances;
`reflectance_unit` decides otherwise."""
_MIN_PERCENT = 1.0
"""A median below this is no reflectance in percent; assumed."""
MOST_LIKELY_PERCENT = 100.0
"""What a perfect diffuser has, by definition."""
MAX_PERCENT = 100.0 * MAX_FRACTION


@dataclass(frozen=True, slots=True)
class ReflectanceChoice:
    """How a reflectance column is read.

    `scale` turns it into fractions of 1; `origin` is who said so: 'file', 'caller' or 'values'; `remark` is
    'overruled' when the file's word was taken against the caller's, 'unlikely' when the values speak against the
    caller's, else None.
    """

    scale: float
    origin: str
    remark: str | None


@lru_cache(maxsize=_NAMES_CACHED)
def name_tokens(name: str) -> tuple[str, ...]:
    """Lower-case words of a column name, both code points of µ made one: 'Wavelength (µm)' -> ('wavelength', 'μm')."""
    return tuple(t for t in re.split(r"[^\w%]+|_", unicodedata.normalize("NFKC", name).casefold()) if t)


def length_unit(word: str) -> WavelengthUnit | None:
    """Nanometres or micrometres by any of their usual words, else None."""
    word = unicodedata.normalize("NFKC", word).casefold()
    return "nm" if word in _NM else "um" if word in _UM else None


def spectral_unit(words: Sequence[str]) -> str | None:
    """'angstrom', or 'cm-1' for wavenumbers, where words in lower case say so; else None."""
    if _RECIPROCAL & {*words} or {"cm", "1"} <= {*words}:
        return "cm-1"
    return "angstrom" if _ANGSTROM & {*words} else None


def wavelength_unit_in(name: str, file: str) -> str | None:
    """Unit that a wavelength column's name states, or None; 'nm', 'um', 'angstrom', 'cm-1'.

    Raises DataError for another.
    """
    tokens = name_tokens(name)
    if (other := spectral_unit(tokens)) is not None:
        return other
    if re.search(r"[(\[]\s*A\s*[)\]]$", name):
        return "angstrom"
    units = {unit for unit in map(length_unit, tokens) if unit is not None}
    if len(units) == 1:
        return units.pop()
    bracketed = [t for content in _BRACKETS.findall(name) for t in name_tokens(content) if t not in _NOT_A_UNIT]
    unknown = bracketed or [t for t in tokens if t in _OTHER]
    if units or unknown:
        what = "two units" if units else f"the unit '{' '.join(unknown)[:40]}'"
        raise DataError(
            f"{file}: wavelength column {quoted(name)} has {what}; convert it and name it wavelength_nm or _um"
        )
    return None


def wavelength_nm(column: Column, stated: WavelengthUnit | None, file: str) -> tuple[FloatArray, dict[str, Any]]:
    """Convert wavelengths, all finite and above 0, to nm; also return what to record about the unit.

    Raises DataError when the unit cannot be told, or the file's word contradicts the values and nothing is stated.
    """
    low, high = float(column.values.min()), float(column.values.max())
    result, word = column.unit or wavelength_unit_in(column.name, file), stated and _OF_OPTIONS.get(stated, stated)
    what = f"{file}: wavelengths {low:g}-{high:g} (column {column.label})"
    unit, origin = _wavelength_choice(result, word, low, high, what)
    if origin == "file" and word not in (None, unit):
        warn(f"{file}: wavelengths read as {_SYMBOL[unit]}, which the file states and the values allow, not {stated}")
    record = {"wavelength_unit": column.unit_text or unit, "wavelength_unit_from": origin}
    return to_nm(column.values, unit), record


def to_nm(values: FloatArray, unit: str) -> FloatArray:
    """Wavelengths of numbers in a unit; those of wavenumbers in vacuum. [nm]"""
    return np.asarray(1e7 / values if unit == "cm-1" else values * _FACTOR_NM[unit])


def _wavelength_choice(result: str | None, stated: str | None, low: float, high: float, what: str) -> tuple[str, str]:
    """Unit of wavelengths from `low` to `high`, and who said so: the file, the caller or the values."""
    if result is not None and _plausible(result, low, high):
        return result, "file"
    if stated is not None:
        if not _plausible(stated, low, high):
            warn(f"{what} read as {_SYMBOL[stated]} because it was stated; the values do not look like it")
        return stated, "caller"
    for unit, (least, most) in SURELY.items():
        if result is None and least <= low and high <= most:
            name = f"name the column wavelength_{unit} or give `wavelength_unit` {unit}"
            if what == as_named(what):  # what is in memory has no file whose column could be named
                warn(f"{what} read as {_SYMBOL[unit]}; {name}")
            return unit, "values"
    why = f"cannot be {_SYMBOL[result]} as the file says" if result else "have no unit and the values do not tell it"
    raise DataError(f"{what} {why}; give `wavelength_unit` nm or um, angstrom or 1/cm")


def _plausible(unit: str, low: float, high: float) -> bool:
    ends = to_nm(np.array([low, high]), unit)
    return bool(ends.min() >= _PLAUSIBLE_NM[0] and ends.max() <= _PLAUSIBLE_NM[1])


def without_unit(name: str) -> str:
    """Name of a reflectance column less the percent or fraction it states: 'rock (%)' -> 'rock'."""
    if not _MAY_SAY_UNIT.search(name):
        return name.strip() or name
    if only_percent(name):
        return " ".join(re.sub(r"[()\[\]{}]", " ", PERCENT_SIGN.sub(" ", name)).split()).strip("_ ,;/") or name
    return _FRACTION.sub("", _PERCENT.sub("", name)).strip() or name


@lru_cache(maxsize=_NAMES_CACHED)
def only_percent(name: str) -> bool:
    """Whether a name says reflectance in percent and nothing else: 'Reflect. %', '%R', 'Tgt./Ref. %'."""
    rest, count = PERCENT_SIGN.subn(" ", name)
    return count > 0 and all(_OF_REFLECTANCE.fullmatch(word) for word in name_tokens(rest))


def medians_above_0(values: FloatArray) -> FloatArray:
    """Median of what is above 0 in each row, NaN where nothing is. (n, channels) to (n,)"""
    result = np.empty(len(values))
    for block in spans(len(values), _MEDIANS_AT_ONCE):
        subset = slice(block.start, block.stop)
        above = values[subset] > 0
        ordered, count = np.sort(np.where(above, values[subset], np.inf), axis=1), above.sum(axis=1)[:, None]
        middle = np.concatenate([np.maximum(count - 1, 0) // 2, np.minimum(count // 2, values.shape[1] - 1)], axis=1)
        result[subset] = np.where(count[:, 0] > 0, np.take_along_axis(ordered, middle, axis=1).mean(axis=1), np.nan)
    return result


def reflectance_unit(
    column: Column, median: float, stated: ReflectanceUnit | None, file: str, by_size: str | None = None
) -> ReflectanceChoice:
    """Decide the unit of a reflectance column from the file's word, the caller's, and its size, as `unit_by_size` does.

    Raises DataError when the file's word contradicts the values and nothing is stated, or when without any word the
    median is above 2 and its size tells nothing.
    """
    result = stated_unit(column)
    if result is not None and not _contradicts(result, median):
        return ReflectanceChoice(SCALES[result], "file", "overruled" if stated not in (None, result) else None)
    if stated is not None:
        return ReflectanceChoice(SCALES[stated], "caller", "unlikely" if _contradicts(stated, median) else None)
    if result is None and (by_size is not None or not _contradicts("fraction", median)):
        return ReflectanceChoice(SCALES[by_size or "fraction"], "values", None)
    why = "no fraction; give `reflectance_unit` percent, or calibrate it if it is radiance or DN"
    if median > MAX_PERCENT:
        why = "which looks like radiance or DN, not reflectance; calibrate it first"
    elif result is not None:
        why = f"which is no {result} as the file says; give `reflectance_unit` fraction or percent"
    raise DataError(f"{file}: column {column.label} has a median of {median:.4g}, {why}")


def unit_by_size(
    columns: Sequence[Column], values: FloatArray, medians: FloatArray, wavelength: FloatArray
) -> tuple[str | None, str]:
    """Unit of reflectances (n, c) whose file and caller name none, by the largest median of them, and what to say.

    Percent up to 100, ten-thousandths of whole numbers up to 10,000; None where these are fractions, or could as well
    be radiance: where the name does not say reflectance they vary more than sunlight reflected by them would. [nm]
    """
    unstated = [k for k, column in enumerate(columns) if medians[k] > MAX_FRACTION and stated_unit(column) is None]
    if not unstated:
        return None, ""
    row = max(unstated, key=lambda k: float(medians[k]))
    top, finite = columns[row], values[row][np.isfinite(values[row])]
    whole = bool((finite == np.round(finite)).all() and finite.max() <= USUAL_SCALE)
    unit = "percent" if medians[row] <= MOST_LIKELY_PERCENT else "ten-thousandths" if whole else None
    if unit is None or not (_says_reflectance(top.name) or _is_no_radiance(values[row], wavelength)):
        return None, ""
    what = {"percent": "percent", "ten-thousandths": f"reflectance times {USUAL_SCALE:g}"}[unit]
    return unit, f"column {top.label}, median {medians[row]:.4g}, read as {what}; `reflectance_unit` decides otherwise"


def _says_reflectance(name: str) -> bool:
    return any(_REFLECTANCE.fullmatch(word) for word in name_tokens(name))


def _is_no_radiance(values: FloatArray, wavelength: FloatArray) -> bool:
    """Whether values vary less as they are than divided by the Sun's irradiance, as radiance does not."""
    sun = solar_spectrum("e490")
    with np.errstate(invalid="ignore"):
        lit = (values > 0) & (wavelength >= sun.wavelength_nm[0]) & (wavelength <= sun.wavelength_nm[-1])
    level, of_sun = np.log(values[lit]), np.log(np.interp(wavelength[lit], sun.wavelength_nm, sun.irradiance))
    return bool(lit.any() and of_sun.std() > SUN_VARIES and level.std() < (level - of_sun).std())


def uncertainty_scale(sigma: Column, reflectance: Column, scale: float, file: str) -> float:
    """Factor for a column of standard deviations: `scale`, that of its reflectance, unless the file says otherwise.

    Raises DataError when only the column's name says otherwise: it might then mean per cent of the value.
    """
    result = stated_unit(sigma)
    if result is None or result == stated_unit(reflectance) or SCALES[result] == scale:
        return scale
    if sigma.unit is None:
        raise DataError(
            f"{file}: column {sigma.label} is in {result} and its reflectance is not; give both in one unit"
        )
    return SCALES[result]


def check_alike(columns: Sequence[Column], medians: Sequence[float], unit: str | None, file: str) -> None:
    """Reflectances without a unit of their own must be possible in one and the same.

    Raises DataError, which names two that are not: one of them is no reflectance, or has another unit.
    """
    least = _MIN_PERCENT if unit == "percent" else MAX_FRACTION
    unstated = [(m, c) for c, m in zip(columns, medians, strict=True) if m > 0 and stated_unit(c) is None]
    if unit == "fraction" or not unstated:
        return
    (low, one), (high, other) = min(unstated, key=itemgetter(0)), max(unstated, key=itemgetter(0))
    if low < least < high:
        raise DataError(
            f"{file}: columns {one.label} and {other.label} have medians of {low:.3g} and {high:.3g}, not reflectances "
            f"in one unit; take out what is none, or write units into the names, as in {quoted(other.name + ' (%)')}"
        )


def stated_unit(column: Column) -> str | None:
    """'fraction' or 'percent' where a column says so, by its name or its file."""
    if column.unit is not None:
        return column.unit
    if not _MAY_SAY_UNIT.search(column.name):
        return None
    if _PERCENT.search(column.name) or only_percent(column.name):
        return "percent"
    return "fraction" if _FRACTION.search(column.name) else None


def _contradicts(unit: str, median: float) -> bool:
    return median > MAX_FRACTION if unit == "fraction" else median < _MIN_PERCENT or median > MAX_PERCENT
