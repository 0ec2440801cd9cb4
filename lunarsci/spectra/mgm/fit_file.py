"""Start and result files (`*.fit`) of the MGM program distributed by RELAB, read and written.

Line 1 is a folder, 2 the file of the spectrum, 3 and 4 the axes of a plot, three numbers each; 5 the rms and the
improvement of the rms at which a fit stops; 6 the letter of the continuum; 7 its coefficients c0 to c3 and 8 their
uncertainties, two lines that result files without a continuum (N) lack; 9 the number of bands; then for each band a
line of centre [nm], FWHM [nm] and strength [ln reflectance] and a line of their uncertainties, 1.96 standard
deviations. Result files give those of a centre as the full width of its interval, which is below 0 where the interval
reaches over the wavenumber 0. Text behind the numbers of a line is a comment, which may name a band's mineral.
"""

import re
from collections.abc import Iterator
from dataclasses import dataclass, field
from itertools import chain, takewhile
from typing import NoReturn

from lunarsci.errors import DataError, ParameterError
from lunarsci.io.inputs import InputFile, text
from lunarsci.spectra.mgm import MgmContinuum
from lunarsci.spectra.mgm.assemblages import MINERALS

CONTINUA: dict[str, tuple[MgmContinuum, ...]] = {
    "Q": ("wavenumber", "wavenumber-quadratic", "wavenumber-cubic"),
    "T": ("wavenumber", "wavenumber-quadratic", "wavenumber-cubic"),
    "P": ("wavelength", "wavelength-quadratic", "wavelength-cubic"),
    "S": ("wavelength", "wavelength-quadratic", "wavelength-cubic"),
    "N": ("none",),
}
"""By letter: what it may become, by degree, whose coefficients of 0 are held. Files of straight lines say T and S."""
NUMBER = re.compile(r"[+-]?(\d++\.?+\d*+|\.\d++)([eEdD][+-]?\d+)?", re.ASCII)
FIRST_BAND_LINE = 10
LONGEST_SHOWN = 40
LARGEST, LEAST = 1e15, 1e-6
"""Beyond these no number of a file, and no centre or width, belongs to a spectrum."""
LEAST_NM = 10.0
"""Below it a wavelength is taken for one in um; assumed."""
Numbers = tuple[float, ...]


@dataclass(frozen=True, slots=True)
class FitBand:
    """One band of a `.fit` file: values, and uncertainties of 1.96 standard deviations. [nm, nm, ln reflectance]

    `mineral` is a key of `MINERALS`, or empty where none is named.
    """

    center_nm: float
    fwhm_nm: float
    strength: float
    center_95_nm: float
    fwhm_95_nm: float
    strength_95: float
    mineral: str = field(default="", kw_only=True)

    @property
    def values(self) -> Numbers:
        """Centre, FWHM and strength. [nm, nm, -]"""
        return self.center_nm, self.fwhm_nm, self.strength

    @property
    def uncertainties(self) -> Numbers:
        """Their uncertainties, 1.96 standard deviations. [nm, nm, -]"""
        return self.center_95_nm, self.fwhm_95_nm, self.strength_95


@dataclass(frozen=True, slots=True)
class FitFile:
    """The content of a `.fit` file.

    Attributes
    ----------
    folder, spectrum : where the program looks for the spectrum, and its file.
    plot_axis, wavelength_axis : three numbers each of the plot's vertical and horizontal axis; kept, not used.
    rms_limit, improvement_limit : of ln R. [-]
    continuum : Q polynomial and T straight line in wavenumber, P and S the same in wavelength, N none.
    coefficients, coefficients_95 : c0 to c3 of a polynomial in wavenumber [cm^-1] or wavelength [nm], and 1.96 standard
        deviations of each. A coefficient of 0 is held. N uses none, and both may be empty.
    bands : one or more. An uncertainty of 0 means that the value is fixed. A centre below 0 is that of a band of which
        the spectrum sees only a wing. The signs of its uncertainty and of a FWHM, which the program may write below 0,
        have no meaning.

    Raises
    ------
    ParameterError when a value is not finite or out of range; the message begins with the line of the file.
    """

    folder: str
    spectrum: str
    plot_axis: Numbers
    wavelength_axis: Numbers
    rms_limit: float
    improvement_limit: float
    continuum: str
    coefficients: Numbers
    coefficients_95: Numbers
    bands: tuple[FitBand, ...]

    def __post_init__(self) -> None:
        for line, fault in chain(_header_faults(self), _continuum_faults(self), _band_faults(self)):
            raise ParameterError(f"line {line}: {fault}")

    @property
    def first_band_line(self) -> int:
        """Line of the first band's values."""
        return FIRST_BAND_LINE if self.coefficients else FIRST_BAND_LINE - 2


def _header_faults(file: FitFile) -> Iterator[tuple[int, str]]:
    for line, name in ((1, file.folder), (2, file.spectrum)):
        if name != name.strip() or re.search(r"[\r\n\0]", name):
            yield line, f"name {_shown(name)} begins or ends with a blank or breaks the line; give it without"
    if not file.spectrum:
        yield 2, "is empty; it must name the file of the spectrum"
    for line, axis in ((3, file.plot_axis), (4, file.wavelength_axis)):
        if not _are_numbers(axis, 3):
            yield line, "the axis of the plot is not three finite numbers up to 1e15; give them"
    if not _are_numbers((file.rms_limit, file.improvement_limit), 2, lowest=0):
        yield 5, f"limits of the rms {file.rms_limit:g} and {file.improvement_limit:g}; give finite ones, 0 or above"


def _continuum_faults(file: FitFile) -> Iterator[tuple[int, str]]:
    if file.continuum not in CONTINUA:
        yield 6, f"continuum {_shown(file.continuum)} is unknown; give one letter of {', '.join(CONTINUA)}"
    if file.continuum == "N" and file.coefficients == file.coefficients_95 == ():
        return
    if not _are_numbers(file.coefficients, 4):
        yield 7, "the continuum is not four finite coefficients up to 1e15; give c0 to c3, 0 where unused"
    if not _are_numbers(file.coefficients_95, 4, lowest=0):
        yield 8, "the uncertainties of the continuum are not four finite numbers from 0 to 1e15; give them"


def _band_faults(file: FitFile) -> Iterator[tuple[int, str]]:
    if not file.bands:
        yield file.first_band_line - 1, "no band; give one or more"
    for number, band in enumerate(file.bands, start=1):
        for beyond, fault in _faults_of(band):
            yield file.first_band_line + 2 * (number - 1) + beyond, f"band {number}: {fault}"


def _faults_of(band: FitBand) -> Iterator[tuple[int, str]]:
    """Of a band: how many lines behind its first, and what is wrong there."""
    if not _are_numbers(band.values, 3):
        yield 0, "centre, FWHM or strength is not finite or beyond 1e15; give three numbers"
    if abs(band.center_nm) < LEAST:
        yield 0, "centre of 0 nm, which has no wavenumber; give another"
    if 0 < band.center_nm < LEAST_NM and abs(band.fwhm_nm) < LEAST_NM:
        yield 0, f"centre of {band.center_nm:g} nm; these files are in nm, is this um?"
    if abs(band.fwhm_nm) < LEAST:
        yield 0, "FWHM of 0 nm; give one above 0"
    if band.mineral and band.mineral not in MINERALS:
        yield 0, f"mineral {_shown(band.mineral)} is unknown; give one of {', '.join(MINERALS)}, or none"
    if not (_are_numbers(band.uncertainties, 3) and _are_numbers(band.uncertainties[1:], 2, lowest=0)):
        yield (
            1,
            "uncertainties are not finite, beyond 1e15 or, of FWHM and strength, below 0; values come first",
        )


def _are_numbers(values: Numbers, count: int, lowest: float = -LARGEST) -> bool:
    return len(values) == count and all(lowest <= value <= LARGEST for value in values)


def _shown(part: str) -> str:
    return repr(part if len(part) <= LONGEST_SHOWN else part[:LONGEST_SHOWN] + "...")


def read_fit_file(input: InputFile) -> FitFile:
    """Read a `.fit` file. Blanks, tabs or commas part numbers; text behind the last number of a line is a comment.

    Lines may end in LF, CR LF or CR. Warns with LunarSciWarning where a name is not UTF-8. Raises DataError, with file
    and line, for anything that does not follow the layout.
    """
    lines = _Lines(input.name, [line.strip() for line in re.split(r"\r\n|\r|\n", text(input).rstrip())])
    letter = re.match(r"[A-Z](?![A-Z0-9])", lines.line(6, "letter of the continuum").upper())
    if not letter:
        lines.refuse(6, f"begins with no letter that stands alone; give one of {', '.join(CONTINUA)}")
    rms_limit, improvement_limit = lines.numbers(5, 2, "limits of the rms and of its improvement")
    lacking = letter.group() == "N" and len(lines.leading_numbers(7)) == 1
    try:
        return FitFile(
            folder=lines.rows[0],
            spectrum=lines.line(2, "file of the spectrum"),
            plot_axis=lines.numbers(3, 3, "vertical axis of the plot"),
            wavelength_axis=lines.numbers(4, 3, "horizontal axis of the plot"),
            rms_limit=rms_limit,
            improvement_limit=improvement_limit,
            continuum=letter.group(),
            coefficients=() if lacking else lines.numbers(7, 4, "continuum c0, c1, c2, c3"),
            coefficients_95=() if lacking else lines.numbers(8, 4, "uncertainties of the continuum"),
            bands=_read_bands(lines, FIRST_BAND_LINE - 2 if lacking else FIRST_BAND_LINE),
        )
    except ParameterError as error:
        raise DataError(f"{input.name}: {error}") from error


def _read_bands(lines: "_Lines", first: int) -> tuple[FitBand, ...]:
    [count] = lines.numbers(first - 1, 1, "number of bands")
    if count < 1 or not count.is_integer():
        lines.refuse(first - 1, f"{count:g} is no number of bands; give 1 or more")
    bands = []
    for number in range(1, int(count) + 1):
        line, name = first + 2 * (number - 1), f"band {number} of {count:g}"
        values = lines.numbers(line, 3, f"centre, FWHM and strength of {name}")
        errors = lines.numbers(line + 1, 3, f"uncertainties of {name}")
        bands.append(FitBand(*values, *errors, mineral=_mineral_in(lines.rows[line - 1])))
    after = first + 2 * len(bands)
    for line in range(after, len(lines.rows) + 1):
        if lines.leading_numbers(line):
            fault = f"holds numbers behind the last of {count:g} bands; correct line {first - 1}, or remove the line"
            lines.refuse(line, fault)
    return tuple(bands)


def _mineral_in(comment: str) -> str:
    """The first mineral that a line names, by its abbreviation or its name."""
    keys = {word: key for key, name in MINERALS.items() for word in (key.lower(), name)}
    found = [keys[word] for word in re.findall(r"[a-z]+", comment.lower()) if word in keys]
    return found[0] if found else ""


def _parts(line: str) -> list[str]:
    """What stands between blanks, tabs and commas; one empty string where there is nothing."""
    return [part for part in re.split(r"[\s,]+", line) if part] or [""]


@dataclass(frozen=True, slots=True)
class _Lines:
    """Lines of a file; their numbers begin at 1."""

    name: str
    rows: list[str]

    def refuse(self, number: int, fault: str) -> NoReturn:
        raise DataError(f"{self.name}: line {number}: {fault}")

    def line(self, number: int, what: str) -> str:
        if number > len(self.rows):
            self.refuse(number, f"is missing ({what}); the file looks cut off, restore its end")
        if not self.rows[number - 1]:
            self.refuse(number, f"is empty ({what}); fill it in, or remove it")
        return self.rows[number - 1]

    def leading_numbers(self, number: int) -> list[str]:
        """The numbers that a line begins with; none where there is no such line."""
        parts = _parts(self.rows[number - 1]) if number <= len(self.rows) else []
        return list(takewhile(NUMBER.fullmatch, parts))

    def numbers(self, number: int, count: int, what: str) -> Numbers:
        parts = _parts(self.line(number, what))
        values = [float(part.upper().replace("D", "E")) for part in parts[: count + 1] if NUMBER.fullmatch(part)]
        if len(values) != count or not all(NUMBER.fullmatch(part) for part in parts[:count]):
            self.refuse(number, f"{_shown(' '.join(parts))} are not {count} numbers ({what}); give them")
        return tuple(values)


def fit_file_text(file: FitFile) -> str:
    """The file as text that `read_fit_file` reads back equal, every digit kept; minerals are comments."""
    rows = [
        file.folder,
        file.spectrum,
        _row(file.plot_axis, ","),
        _row(file.wavelength_axis, ","),
        _row((file.rms_limit, file.improvement_limit), ","),
        file.continuum,
        *(_row(values) for values in (file.coefficients, file.coefficients_95) if values),
        str(len(file.bands)),
        *chain.from_iterable((_row(band.values) + _comment(band), _row(band.uncertainties)) for band in file.bands),
    ]
    return "\n".join(rows) + "\n"


def _comment(band: FitBand) -> str:
    return f"\t{band.mineral}" if band.mineral else ""


def _row(values: Numbers, separator: str = "\t") -> str:
    return separator.join(repr(float(value)).removesuffix(".0") for value in values)
