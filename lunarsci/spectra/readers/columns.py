"""Columns of a table by their names: wavelength, spectra, errors, none of these, what is computed from reflectance.

Absorbance of a reflectance spectrum is log10(1/R); F = (1 - R)^2 / (2 R) is Kubelka & Munk (1931), Z. tech. Phys. 12,
593. Both are the usual forms of near-infrared spectrometers; no library of formats converts them. Tables that say
something of spectra by their ids are read here, too.
"""

import re
import unicodedata
from collections import Counter
from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import lru_cache
from typing import Any

import numpy as np

from lunarsci.arrays import FloatArray, IntArray
from lunarsci.errors import DataError, warn
from lunarsci.io.inputs import InputFile
from lunarsci.names import some_of
from lunarsci.spectra.readers.table import (
    MAX_FRACTION,
    PERCENT_SIGN,
    Column,
    SpectrumTable,
    name_tokens,
    only_percent,
    stated_unit,
    without_unit,
)
from lunarsci.spectra.rows import named_table, quoted


@dataclass(frozen=True, slots=True)
class ColumnQuantity:
    """What a column holds: its name, how a name says so, and the reflectance of it."""

    name: str
    words: re.Pattern[str]
    reflectance: Callable[[FloatArray], FloatArray]


def of_decadic(values: FloatArray) -> FloatArray:
    """R = 10^-x. [-]"""
    return np.asarray(10.0**-values)


def of_natural(values: FloatArray) -> FloatArray:
    """R = e^-x. [-]"""
    return np.asarray(np.exp(-values))


def of_kubelka_munk(values: FloatArray) -> FloatArray:
    """R = 1 + F - (F^2 + 2 F)^(1/2), the root of F = (1 - R)^2 / (2 R) below 1; F >= 0. [-]"""
    return np.asarray(1.0 + values - np.sqrt(values**2 + 2.0 * values))


_R = r"\(?r(ef\w*\.?)?\)?"
QUANTITIES = (
    ColumnQuantity("log10(1/R)", re.compile(rf"(?<![a-z])log(10)?[(\[]?1/{_R}|-log(10)?{_R}(?![a-z])"), of_decadic),
    ColumnQuantity("ln(1/R)", re.compile(rf"(?<![a-z])ln[(\[]?1/{_R}|-ln{_R}(?![a-z])"), of_natural),
    ColumnQuantity("ln R", re.compile(rf"(?<![a-z-])ln{_R}$"), lambda values: of_natural(-values)),
    ColumnQuantity("log10 R", re.compile(rf"(?<![a-z-])log(10)?{_R}$"), lambda values: of_decadic(-values)),
    ColumnQuantity(
        "the function of Kubelka and Munk",
        re.compile(r"kubelka|^k[-/]?m$|(?<![a-z])k-m(?![a-z])|^f\(r\W*\w*\)|^k/s$|remissionfunction"),
        of_kubelka_munk,
    ),
    ColumnQuantity("absorbance, log10(1/R)", re.compile(r"absorbance|^abs\.?([(\[].*)?$"), of_decadic),
)
"""What is known of, the first that fits a name in lower case without blanks."""


@lru_cache(maxsize=4096)
def quantity_of(name: str) -> ColumnQuantity | None:
    """What a column holds by its name; None for a reflectance, as far as the name says."""
    plain = re.sub(r"[\s_]", "", unicodedata.normalize("NFKC", name).replace("−", "-").casefold())
    return next((one for one in QUANTITIES if one.words.search(plain)), None)


def as_reflectance(table: SpectrumTable) -> tuple[SpectrumTable, list[str]]:
    """A table whose `block`, and errors, are reflectances where columns hold something else; and what to say."""
    spectra, notes, reflectances = list(table.spectra), dict[str, str](), table.reflectances
    for row, (column, sigma) in enumerate(table.spectra):
        if (quantity := quantity_of(column.name)) is None:
            continue
        values = reflectances[row].copy()
        with np.errstate(invalid="ignore", over="ignore"):
            reflectances[row] = quantity.reflectance(values)
            spectra[row] = _named(column), None if sigma is None else _error(sigma, values, quantity)
        notes.setdefault(
            quantity.name,
            f"column {column.label} read as {quantity.name} and made reflectance; if it is one already, name it so",
        )
    return replace(table, spectra=tuple(spectra), block=reflectances), list(notes.values())


def _named(column: Column) -> Column:
    """A column of reflectance in its place."""
    return replace(column, unit="fraction", unit_text=column.name)


def _error(sigma: Column, values: FloatArray, quantity: ColumnQuantity) -> Column:
    """Half the way between the reflectances one standard deviation to either side."""
    up, down = quantity.reflectance(values - sigma.values), quantity.reflectance(values + sigma.values)
    return replace(sigma, values=np.abs(up - down) / 2, unit="fraction")


def with_absolute_errors(table: SpectrumTable) -> tuple[SpectrumTable, list[str]]:
    """A table whose relative errors are made errors of their reflectances; and what to say where no unit is named."""
    spectra, notes = list(table.spectra), list[str]()
    for row, (column, sigma) in enumerate(table.spectra):
        if sigma is None or not _is_relative(sigma.name, column.name):
            continue
        share, named = sigma.values, PERCENT_SIGN.search(sigma.name) is not None
        in_percent = named or bool(np.nanmedian(share) > LARGE_ERROR)
        if not named:
            unit = "percent" if in_percent else "shares of 1"
            notes.append(f"column {sigma.label} read as relative errors in {unit}; name its unit to decide otherwise")
        absolute = np.abs(table.reflectances[row]) * (share / 100 if in_percent else share)
        spectra[row] = column, replace(sigma, name="", values=absolute, unit=column.unit)
    return replace(table, spectra=tuple(spectra), block=table.reflectances), notes


def _is_relative(name: str, of: str) -> bool:
    """Whether the name of errors says that they are relative, apart from what they are the errors of."""
    words = Counter(name_tokens(name)) - Counter(name_tokens(of))
    return any(re.fullmatch(r"rel|relativ\w*|rel(err|sd|std|unc)\w*|rsd", word) for word in words)


def rows_by_id(source: InputFile, key: str = "id") -> dict[str, tuple[int, dict[str, str]]]:
    """Line number and cells, by column name in lower case, of each `id`, or name in another column.

    Raises DataError for a table without that column or rows, with a column twice, a row of another length, and a name
    that is empty or comes twice.
    """
    table = named_table(source, key)
    names = [name if key == "id" else name.casefold() for name in table.cells(key)]
    first = {name: row.line for name, row in zip(reversed(names), reversed(table.rows), strict=True)}
    again = [not name or first[name] != row.line for name, row in zip(names, table.rows, strict=True)]
    table.refuse(
        np.array(again),
        key,
        f"each row has {'an id' if key == 'id' else f'a {key}'} of its own; complete it, or keep one",
    )
    rows = zip(names, table.rows, strict=True)
    return {name: (row.line, dict(zip(table.names, row.fields, strict=True))) for name, row in rows}


_WAVENUMBER = {"wavenumber", "wavenumbers", "wellenzahl"}
_WAVELENGTH = {"wavelength", "wavelengths", "wellenlänge", "wellenlaenge", "wellenlange", *_WAVENUMBER}
_WAVELENGTH_SHORT = {
    *("wl", "wvl", "wvls", "wav", "wave", "lambda", "λ", "nm", "um", "μm", "micron", "microns", "cm", "å", "angstrom"),
    *("nanometer", "nanometers", "micrometer", "micrometers", "spectral"),
}
_UNIT_WORDS = {
    *("nm", "um", "μm", "micron", "microns", "nanometer", "nanometers", "micrometer", "micrometers"),
    *("å", "angstrom", "angstroms", "cm", "1", "axis"),
}
_POSITION_WORDS = {"band", "channel", "center", "centre", "central", "mean"}
_ANGSTROM = re.compile(r"[(\[]\s*A\s*[)\]]$")
_NOT_A_SPECTRUM = {
    *("fwhm", "bandwidth", "resolution", "band", "bands", "channel", "channels", "index", "pixel"),
    *("flag", "flags", "quality", "mask", "weight", "weights", "kanal", "nr", "chan", "count", "counts", "n"),
}
_NOT_REFLECTANCE = {
    *("radiance", "irradiance", "transmittance", "emissivity", "cal", "calibration", "dn", "rad", "irrad", "raw"),
}
_SIGMA = {"sigma", "1sigma", "σ", "1σ", "std", "sd", "se", "sem", "error", "err", "unc", "+-", "rms", "rsd", "scatter"}
_SIGMA_WORD = re.compile(
    r"st(d|and)?(ard)?(abw|afw|dev|err)|s(t|tan)?dev|(mess)?(fehler|unsicher)|uncert|incert|[ée]cart ?type|erreur|"
    r"desv(est|t|iaci)|deviazione|погрешн|ошибк|стандартноеоткл|误差|誤差|标准差|標準偏差|niepewno|odchyl|os[äa]kerhet|"
    r"onzekerheid|errore"
)
"""How names of errors begin in the languages of Europe, Russian, Chinese and Japanese."""
_PLUS_MINUS = re.compile(r"±|\+/-|\+-")
_LAST_WORD, _GAP = re.compile(r"^(.+)[ _.-]([^ _.-]+)$"), re.compile(r"[ _.-]")
_FOREIGN_UNITS = {
    *("ms", "s", "sec", "µs", "μs", "us", "min", "°c", "degc", "celsius", "°f", "degf", "kelvin", "dn", "adu"),
    *("counts", "cts", "count", "mv", "v", "volt", "ma", "mw", "nm", "nanometer", "deg", "°", "hz", "khz", "hpa", "db"),
}
"""Units in brackets of columns that are no reflectance: times, temperatures, raw numbers, widths, angles."""
MOST_NAMED = 4
ERROR_SHARE, ERROR_MOST, LARGE_ERROR = 0.05, 0.02, 0.3
"""A column of no more than this share of the one before it, and this reflectance, looks like its error; above the
larger share it looks like none; assumed."""
_BRACKETED = re.compile(r"[(\[{]([^)\]}]*)[)\]}]\s*$")
_RADIANT = re.compile(r"\b[mµμu]?w\b.*\b[cmµμu]?m\b|\bsr\b|\bwatt|m-?[²2]")
"""Units of radiance and irradiance."""
_SYSTEMATIC = re.compile(r"^(.+?)_systematic_(\w+)$", re.IGNORECASE)
_PLAIN = {
    *("reflectance", "reflexion", "refl", "reflectivity", "ref", "r", "rf", "reff", "radf", "brf", "i/f", "iof"),
    *("albedo", "value", "values", "data", "y", "spectrum", "mean", "average", "intensity", "radiancefactor"),
    *("reflectancefactor", "bidirectionalreflectance", "absolutereflectance"),
}


@dataclass(frozen=True, slots=True)
class Roles:
    """Places, from 0, of the wavelength column and of each spectrum's reflectance and uncertainty (or None).

    `systematic` has the named columns of systematic shifts of a spectrum, by the place of its reflectance.
    """

    wavelength: int
    spectra: tuple[tuple[int, int | None], ...]
    systematic: Mapping[int, tuple[tuple[str, int], ...]] = field(default_factory=dict)

    def table(
        self, source: InputFile, format: str, read: Callable[[int], Column], places: tuple[str, ...],
        metadata: Mapping[str, Any], block: FloatArray | None = None,
    ) -> SpectrumTable:  # fmt: skip
        """The table of a file whose columns are read from their places."""
        wavelength = read(self.wavelength)
        systematic = {
            index: tuple((name, read(k)) for name, k in self.systematic[place])
            for index, (place, _) in enumerate(self.spectra)
            if place in self.systematic
        }
        spectra = tuple((read(r), None if s is None else read(s)) for r, s in self.spectra)
        return SpectrumTable(source, format, wavelength, spectra, places, metadata, systematic, block)


CHANNELS = re.compile(r"^(bands?|channels?|spectral)$", re.IGNORECASE)
"""Names of an axis of channels."""


def is_spectral_axis(name: str, values: Any) -> bool:
    """Whether the coordinate of an axis of channels has their wavelengths, and does not count them from 0 or 1. (n,)

    >>> is_spectral_axis("band", np.array([1, 2, 3])), is_spectral_axis("band", np.array([450.0, 455.0]))
    (False, True)
    """
    counts = values.dtype.kind in "iuf" and values[0] in (0, 1) and (np.diff(values) == 1).all()
    return bool(CHANNELS.match(name)) and values.dtype.kind in "iuf" and not counts


def is_wavelength(name: str) -> bool:
    """Whether a name says wavelength: 'wavelength_nm', 'Channel wavelength', 'wl [µm]', 'nm'."""
    tokens = name_tokens(_ANGSTROM.sub(" angstrom", name))
    while tokens and tokens[0] in _POSITION_WORDS:
        tokens = tokens[1:]
    if not tokens:
        return False
    # 'wl' and the like also begin sample names: they count only when nothing but a unit follows.
    return tokens[0] in _WAVELENGTH or (tokens[0] in _WAVELENGTH_SHORT and set(tokens[1:]) <= _UNIT_WORDS)


def is_not_a_spectrum(name: str) -> bool:
    """Whether a name says something other than reflectance: 'fwhm_nm', 'band', 'solar_irradiance'."""
    tokens = name_tokens(name)
    if "fwhm" in tokens or (len(tokens) == 1 and tokens[0] in _NOT_A_SPECTRUM):
        return True
    unit = "" if (match := _BRACKETED.search(name)) is None else match[1].strip().casefold()
    if unit in _FOREIGN_UNITS or _RADIANT.search(unit):
        return True
    # 'radiance factor' is a reflectance, a 'calibration factor' is none.
    foreign = _NOT_REFLECTANCE & set(tokens)
    return bool(foreign) and not (foreign == {"radiance"} and "factor" in tokens)


def assign_roles(
    names: Sequence[str], source: InputFile, *, wavelength: int | None = None, left_out: Collection[int] = ()
) -> Roles:
    """Give each named column its role.

    `wavelength` and `left_out` are what the caller already knows from units. Columns left out are named in a
    LunarSciWarning. Raises DataError for duplicate names, none or several wavelength columns, no reflectance column,
    or an uncertainty that belongs to no column or to several.
    """
    _check_unique(names, source.name)
    kinds = [_kind_of(name) for name in names]
    if wavelength is None:
        wavelength = _wavelength_place(names, kinds, source.name)
    others = [k for k in range(len(names)) if k != wavelength]
    systematic = _systematic(names, others, source.name)
    shifts = {place for columns in systematic.values() for _, place in columns}
    others = [k for k in others if k not in shifts]
    dropped = [k for k in others if k in left_out or kinds[k] in ("nothing", "wavelength")]
    reflectances = [k for k in sorted({*others} - {*dropped}) if kinds[k] != "error"]
    computed = [k for k in reflectances if kinds[k] == "computed"]
    dropped += computed if len(computed) < len(reflectances) else ()
    rest = sorted({*others} - {*dropped})
    sigmas = _sigmas(names, rest, {k for k in rest if kinds[k] == "error"}, source.name)
    listed = ", ".join(quoted(names[k]) for k in dropped)
    errors = {*sigmas.values()}
    spectra = tuple((k, sigmas.get(k)) for k in rest if k not in errors)
    if not spectra:
        why = f" beside {listed}" if dropped else ""
        raise DataError(
            f"{source.name}: no reflectance column{why}; a spectrum needs a wavelength and a reflectance column"
        )
    if dropped:
        message = f"{source.name}: left out {listed}: no reflectance by name, unit or content"
        warn(message)
    return Roles(wavelength, spectra, systematic)


def _kind_of(name: str) -> str:
    """What a name says that a column is: a wavelength, nothing of a spectrum, its error, a reflectance."""
    if is_wavelength(name):
        return "nothing" if _is_wavelength_error(name) else "wavelength"
    if is_not_a_spectrum(name) or _is_wavelength_error(name):
        return "nothing"
    return "error" if says_error(name) else "reflectance" if quantity_of(name) is None else "computed"


def _check_unique(names: Sequence[str], file: str) -> None:
    twice = [name for name, count in Counter(names).items() if count > 1 and name and not says_error(name)]
    if twice:
        raise DataError(f"{file}: two columns are named {quoted(twice[0])}; give each column its own name")


RIGHT_TABLE = "a right table is `wavelength_nm,NAME`, below it `450,0.061` and so on; `lunarsci demo` writes rock.ecsv"
"""What a table of spectra looks like, and which command makes one."""


def _wavelength_place(names: Sequence[str], kinds: Sequence[str], file: str) -> int:
    """Place of the wavelength column: that with such a name, else the first. Raises DataError for two, or none."""
    result = [k for k, what in enumerate(kinds) if what == "wavelength"]
    result = [k for k in result if not _WAVENUMBER & {*name_tokens(names[k])}] or result
    if len(result) > 1:
        raise DataError(
            f"{file}: {quoted(names[result[0]])} and {quoted(names[result[1]])} are both wavelengths; keep one of them"
        )
    if result:
        return result[0]
    if names[0] and set(name_tokens(names[0])) & _NOT_A_SPECTRUM:
        raise DataError(f"{file}: no wavelength column, {quoted(names[0])} is none; add one: {RIGHT_TABLE}")
    return 0


def _is_wavelength_error(name: str) -> bool:
    match = _LAST_WORD.match(name)
    if match is not None and says_error(match[2]) and is_wavelength(match[1]):
        return True
    return is_wavelength(name) and bool(_SIGMA & set(name_tokens(name)))


def says_error(name: str) -> bool:
    """Whether a name says that a column holds errors, and nothing else: 'SD', 'Std.Abw.', 'incertitude'."""
    if _PLUS_MINUS.match(name.strip()):
        return True
    word = "".join(name_tokens(_PLUS_MINUS.sub(" sd ", name)))
    word = word.replace("%", "").removeprefix("relative").removeprefix("rel") or word
    word = word.removeprefix("avg").removeprefix("mean").removeprefix("average") or word
    return word in _SIGMA or _SIGMA_WORD.match(word) is not None


def _sigmas(names: Sequence[str], places: Sequence[int], errors: Collection[int], file: str) -> dict[int, int]:
    """Place of the uncertainty of each reflectance place that has one; names of `errors` say nothing else."""
    plain = {names[k]: k for k in places} | {without_unit(names[k]): k for k in places}
    pairs: dict[int, int] = {}
    bare = []
    for k in places:
        name = _PLUS_MINUS.sub(" sd", without_unit(names[k])).strip()
        last, owner = _LAST_WORD.match(name), _owner(name, plain)
        if owner is not None:
            _pair(pairs, owner, k, names, file)
        elif k in errors or (name != names[k] and says_error(name)):
            bare.append(k)
        elif last is not None and says_error(last[2]):
            _pair(pairs, None, k, names, file)
    if not bare:
        return pairs
    taken = {*pairs, *pairs.values(), *bare}
    alone = [k for k in places if k not in taken]
    plainly = alone if len(alone) == 1 else [k for k in alone if names[k] and is_plain(without_unit(names[k]))]
    for k in bare:
        before = k - 1 if k - 1 in alone and len(bare) > 1 else None
        _pair(pairs, plainly[0] if len(plainly) == 1 and before is None else before, k, names, file)
    return pairs


def _owner(name: str, plain: Mapping[str, int]) -> int | None:
    """Place of the column that another one, by its name, has the errors of: 'A Std.Abw.', 'err_A'."""
    for gap in _GAP.finditer(name):
        before, after = name[: gap.start()].strip(), name[gap.end() :].strip()
        if says_error(after) and before in plain:
            return plain[before]
        if says_error(before) and after in plain:
            return plain[after]
    return None


def _systematic(names: Sequence[str], places: Sequence[int], file: str) -> dict[int, tuple[tuple[str, int], ...]]:
    """By the place of a reflectance, the columns COLUMN_systematic_NAME that say how errors shift all its channels."""
    plain = {without_unit(names[k]): k for k in places}
    result: dict[int, list[tuple[str, int]]] = {}
    for k in places:
        match = _SYSTEMATIC.match(without_unit(names[k]))
        if match is None:
            continue
        if match[1] not in plain:
            raise DataError(f"{file}: there is no column {quoted(match[1])} that {quoted(names[k])} belongs to; add it")
        result.setdefault(plain[match[1]], []).append((match[2], k))
    return {owner: tuple(columns) for owner, columns in result.items()}


def _pair(pairs: dict[int, int], owner: int | None, sigma: int, names: Sequence[str], file: str) -> None:
    if owner is None or owner in pairs:
        beside = f", beside {quoted(names[pairs[owner]])} of {quoted(names[owner])}" if owner is not None else ""
        raise DataError(
            f"{file}: it is unclear whose uncertainty {quoted(names[sigma])} is{beside}; name it COLUMN_sigma after "
            "its column, one of each"
        )
    pairs[owner] = sigma


def only_spectra(table: SpectrumTable, deleted: IntArray) -> tuple[SpectrumTable, IntArray]:
    """A table, and numbers of its spectra, less columns of one value above any reflectance, and of row numbers.

    They are named in a LunarSciWarning, and so is a column that looks like the error of the one before it.
    """
    if len(table.spectra) < 2:
        return table, deleted
    values = table.reflectances
    low, high = np.fmin.reduce(values, axis=1), np.fmax.reduce(values, axis=1)
    unnamed = np.array([stated_unit(column) is None for column, _ in table.spectra])
    running = (np.diff(values, axis=1) == 1.0).all(axis=1) & (values.shape[1] > 2)
    large = low > MAX_FRACTION
    plain = large.any() and any(
        top <= MAX_FRACTION and one.name and is_plain(one.name)
        for top, (one, _) in zip(high.tolist(), table.spectra, strict=True)
    )
    constant = unnamed & (large & ((low == high) | plain) | running)
    if constant.any() and not constant.all():
        retained, left = (np.flatnonzero(which).tolist() for which in (~constant, constant))
        dropped = some_of([table.spectra[k][0].label for k in left], MOST_NAMED)
        why = "the same value in all rows" if (low == high)[constant].all() else "raw numbers beside a reflectance"
        why = "the number of the row" if running[constant].all() else why
        warn(f"{table.source.name}: left out {dropped}: {why}, no reflectance")
        shifts = {new: table.systematic[old] for new, old in enumerate(retained) if old in table.systematic}
        table = replace(
            table, spectra=tuple(table.spectra[k] for k in retained), systematic=shifts, block=values[retained]
        )
        high, deleted = high[retained], deleted[retained]
    pairs = zip(table.spectra, table.spectra[1:], high[1:].tolist(), strict=False)
    for (before, errors), (column, sigma), most in pairs:
        if errors is None and sigma is None and most <= ERROR_MOST and _looks_like_error(before.values, column.values):
            text = f"column {column.label} is below {100 * ERROR_SHARE:g} % of {before.label} before it"
            sigma_name = quoted(without_unit(before.name) + "_sigma")
            warn(f"{table.source.name}: {text}: if it is its error, name it {sigma_name}")
    return table, deleted


def _looks_like_error(values: FloatArray, beside: FloatArray) -> bool:
    with np.errstate(invalid="ignore"):
        both = (values > 0) & (beside > 0)
        return bool(both.any() and np.median(beside[both] / values[both]) <= ERROR_SHARE)


def spectrum_ids(columns: Sequence[Column], source: InputFile) -> list[str]:
    """Ids of the spectra: the column names; the file's stem where the one name says only 'reflectance' or nothing.

    Raises DataError when two columns would get one id.
    """
    if len(columns) == 1:
        name = without_unit(columns[0].name)
        return [source.stem if is_plain(name) or quantity_of(name) else name]
    ids = [without_unit(c.name) if c.name else f"{source.stem}:column-{c.position}" for c in columns]
    _check_unique(ids, source.name)
    return ids


def is_plain(name: str) -> bool:
    """Whether a name says nothing but 'reflectance', units and remarks in brackets apart."""
    bare = re.sub(r"[(\[{].*", "", name).strip().casefold()
    return not bare or bare in _PLAIN or "".join(name_tokens(bare)) in _PLAIN or only_percent(f"{bare} %")
