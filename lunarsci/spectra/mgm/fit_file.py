"""Start and result files (`*.fit`) of the MGM program distributed by RELAB, read and written.

Line 1 is a folder, 2 the file of the spectrum, 3 and 4 the axes of a plot, three numbers each; 5 the rms and the
improvement of the rms at which a fit stops; 6 the letter of the continuum; 7 its coefficients c0 to c3 and 8 their
uncertainties, two lines that result files without a continuum (N) lack; 9 the number of bands; then for each band a
line of centre [nm], FWHM [nm] and strength [ln reflectance] and a line of their uncertainties, 1.96 standard
deviations. Result files give those of a centre as the full width of its interval, which is below 0 where the interval
reaches over the wavenumber 0. Text behind the numbers of a line is a comment, which may name a band's mineral.

Below the readers is what the program and this library say of a fit, each in the words of the other: a model of a file
(`model_of`), a file of a fit (`fit_file_of`), and the parameters of both (`ProgramParameters`). The program's
coefficients are those of powers of the wavenumber [cm^-1] or of the wavelength [nm]; ours of the same variable mapped
to -1 to 1. Its centres are wavenumbers with uncertainties whose intervals it takes and gives in wavelength.
"""

import dataclasses
import math
import re
import warnings
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from itertools import chain, takewhile
from typing import NoReturn

import numpy as np

from lunarsci.arrays import BoolArray, FloatArray
from lunarsci.errors import DataError, LunarSciWarning, ParameterError
from lunarsci.io.inputs import InputFile, text
from lunarsci.minerals import MINERALS
from lunarsci.spectra.mgm import MgmContinuum
from lunarsci.spectra.mgm.assemblages import Assemblage, BandPrior
from lunarsci.spectra.mgm.model import KINDS, NM_PER_UM, RANGE_NM, TIE_SIGMA, MgmModel, continuum_basis
from lunarsci.spectra.mgm.result import MgmFit

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
"""Below it a wavelength is taken for one in um: reflectance spectra are of 0.1 to 5 um."""
Numbers = tuple[float, ...]
"""Those of one line of a file."""


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
        for line, good, fault in _lines_of(self):
            if not good:
                raise ParameterError(f"line {line}: {fault}")

    @property
    def first_band_line(self) -> int:
        """Line of the first band's values."""
        return FIRST_BAND_LINE if self.coefficients else FIRST_BAND_LINE - 2


def _lines_of(file: FitFile) -> Iterator[tuple[int, bool, str]]:
    """Number of each line, whether it is right, and what is wrong if not."""
    for line, name in ((1, file.folder), (2, file.spectrum)):
        plain = name == name.strip() and not re.search(r"[\r\n\0]", name)
        yield line, plain, f"name {_shown(name)} begins or ends with a blank or breaks the line; give it without"
    yield 2, bool(file.spectrum), "is empty; it must name the file of the spectrum"
    for line, axis in ((3, file.plot_axis), (4, file.wavelength_axis)):
        yield line, _are_numbers(axis, 3), "the axis of the plot is not three finite numbers up to 1e15; give them"
    limits = (file.rms_limit, file.improvement_limit)
    yield 5, _are_numbers(limits, 2, lowest=0), f"limits of the rms {limits}; give finite ones, 0 or above"
    unknown = f"continuum {_shown(file.continuum)} is unknown; give one letter of {', '.join(CONTINUA)}"
    yield 6, file.continuum in CONTINUA, unknown
    if file.continuum != "N" or file.coefficients or file.coefficients_95:
        fault = "the continuum is not four finite coefficients up to 1e15; give c0 to c3, 0 where unused"
        yield 7, _are_numbers(file.coefficients, 4), fault
        fault = "the uncertainties of the continuum are not four finite numbers from 0 to 1e15; give them"
        yield 8, _are_numbers(file.coefficients_95, 4, lowest=0), fault
    yield file.first_band_line - 1, bool(file.bands), "no band; give one or more"
    for number, band in enumerate(file.bands):
        for after, good, fault in _lines_of_band(band):
            yield file.first_band_line + 2 * number + after, good, f"band {number + 1}: {fault}"


def _lines_of_band(band: FitBand) -> Iterator[tuple[int, bool, str]]:
    """Rules of its two lines: which of them, 0 or 1, whether it holds, and the fault where it does not."""
    in_um = 0 < band.center_nm < LEAST_NM and abs(band.fwhm_nm) < LEAST_NM
    yield 0, _are_numbers(band.values, 3), "centre, FWHM or strength is not finite or beyond 1e15; give three numbers"
    yield 0, not abs(band.center_nm) < LEAST, "centre of 0 nm, which has no wavenumber; give another"
    yield 0, not in_um, f"centre of {band.center_nm:g} nm; these files are in nm, is this um?"
    yield 0, not abs(band.fwhm_nm) < LEAST, "FWHM of 0 nm; give one above 0"
    unknown = f"mineral {_shown(band.mineral)} is unknown; give one of {', '.join(MINERALS)}, or none"
    yield 0, not band.mineral or band.mineral in MINERALS, unknown
    good = _are_numbers(band.uncertainties, 3) and _are_numbers(band.uncertainties[1:], 2, lowest=0)
    yield 1, good, "uncertainties are not finite, beyond 1e15 or, of FWHM and strength, below 0; values come first"


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
    """The bands, the first of which is in line `first`, behind that of their number."""
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
    named = [keys[word] for word in re.findall(r"[a-z]+", comment.lower()) if word in keys]
    return named[0] if named else ""


def _parts(line: str) -> list[str]:
    """What stands between blanks, tabs and commas; one empty string where there is nothing."""
    return [part for part in re.split(r"[\s,]+", line) if part] or [""]


@dataclass(frozen=True, slots=True)
class _Lines:
    """Lines of a file, `rows`; their numbers begin at 1. `name` is the file's in messages."""

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


NORMAL_95 = 1.96
"""Standard deviations in an uncertainty of the file: 95 % of a normal law."""
LIMITS = (2e-3, 1e-6)
"""Rms of ln R, and improvement of it, at which a fit stops in published files of the program of Sunshine, Pieters &
Pratt (1990)."""
PLOT_AXIS = (-170.0, 25.0, 10.0)
WAVENUMBER_NM = 1e7
"""Wavenumber [cm^-1] times wavelength [nm]."""
NARROWEST_UM = 1e-3
"""Lower bound of widths, but for a band that a file has narrower. [um]"""
FLATTEST = 1e9
"""Standard deviation, um or ln R, beyond which a wider one changes nothing but rounding."""
ASSEMBLAGE = "fit file"
REGIONS = (("uv", 400.0), ("visible", 750.0), ("um1", 1500.0), ("um2", math.inf))
"""Regions and their upper ends; assumed. [nm]"""
UNSEEN = 1e-9
"""A fixed continuum coefficient that changes the reflectance by less is none. [-]"""
HELD = 1e-150
"""An uncertainty, in any unit, that holds a value. [cm^-1, nm, -]"""
LEAST_COEFFICIENT = 1e-12
LEAST_BAND = np.array([1e-6, 1e-6, 1e-9])
"""What result files have instead of 0, at which the program fails: of the reflectance at the largest wavenumber or
wavelength, and of centre [nm], FWHM [nm] and strength [-]."""


def full_width(value: FloatArray, around: FloatArray) -> FloatArray:
    """Wavenumbers between wavelengths `value` - `around` and `value` + `around`, or the reverse. [cm^-1, nm]

    1e7 / (value - around) - 1e7 / (value + around); below 0 where the interval reaches over 0, infinite at its edge.
    """
    with np.errstate(divide="ignore"):
        return np.asarray(2 * WAVENUMBER_NM * around / (value**2 - around**2))


def beyond(center_nm: FloatArray, width_nm: FloatArray) -> FloatArray:
    """Error of a centre [nm] whose interval in wavenumber has a width below 0 in wavelength, since it reaches over 0.

    The positive e with `full_width(v, e)` = width, v the centre's wavenumber, as an error of the wavelength.
    """
    wavenumber = WAVENUMBER_NM / center_nm
    width = np.minimum(width_nm, -LEAST_BAND[0])
    error = -(WAVENUMBER_NM + np.hypot(WAVENUMBER_NM, width * wavenumber)) / width
    return np.asarray(error * center_nm**2 / WAVENUMBER_NM)


def raw_basis(continuum: MgmContinuum, wavelength_nm: FloatArray) -> FloatArray:
    """Powers, (n, m), of the file's variable, as `continuum_basis` has those of the mapped one."""
    m = continuum_basis(continuum, wavelength_nm).shape[1]
    return np.vander(_raw_variable(continuum, wavelength_nm), m, increasing=True)


def largest_powers(continuum: MgmContinuum, count: int) -> FloatArray:
    """(count,) largest values of the powers of the file's variable between 400 and 2600 nm."""
    return np.asarray(_raw_variable(continuum, np.array(RANGE_NM)).max() ** np.arange(count))


def _raw_variable(continuum: MgmContinuum, wavelength_nm: FloatArray) -> FloatArray:
    """Wavenumber [cm^-1] or wavelength [nm]."""
    return WAVENUMBER_NM / wavelength_nm if continuum.startswith("wavenumber") else wavelength_nm


def to_raw(continuum: MgmContinuum) -> FloatArray:
    """Matrix, (m, m), that takes coefficients of powers of the mapped variable u to those of the file's variable v.

    With u = a v + b, the coefficient of v^j is the sum over k of binomial(k, j) a^j b^(k - j) c_k.
    """
    ends = np.array(RANGE_NM)
    basis = continuum_basis(continuum, ends)
    m = basis.shape[1]
    if not m:
        return np.zeros((0, 0))
    v, u = _raw_variable(continuum, ends), basis[:, 1]
    a = (u[1] - u[0]) / (v[1] - v[0])
    b = u[0] - a * v[0]
    return np.array([[math.comb(k, j) * a**j * b ** (k - j) if k >= j else 0.0 for k in range(m)] for j in range(m)])


def read_start(input: InputFile, minerals: str | None = None) -> tuple[MgmModel, FitFile]:
    """A `.fit` file and its model; `minerals` as `parse_minerals` takes them.

    Warns with LunarSciWarning where coefficients of 0 are held though they have uncertainties, and where a result file
    says by an uncertainty below 0 that it does not know a centre. Raises DataError for a
    file that is none, ParameterError for minerals that are none.
    """
    file = read_fit_file(input)
    pairs = enumerate(zip(file.coefficients, file.coefficients_95, strict=True))
    held = [f"c{k}" for k, (value, error) in pairs if value == 0 < error and file.continuum != "N"]
    wide = [str(number) for number, band in enumerate(file.bands, start=1) if band.center_95_nm < 0]
    for names, template in (
        (held, "{} of 0 stay 0, as in the RELAB program; a small number frees them"),
        (
            wide,
            "centre of band {}: an uncertainty below 0 means that it is unknown, and damps by its amount; give one",
        ),
    ):
        if names:
            warnings.warn(f"{input.name}: {template.format(', '.join(names))}", LunarSciWarning, stacklevel=2)
    return model_of(file, parse_minerals(minerals) if minerals else None), file


def model_of(file: FitFile, minerals: Mapping[int, str] | None = None) -> MgmModel:
    """The model of a `.fit` file: its values as prior means, its uncertainties over 1.96 as standard deviations.

    An uncertainty of 0, or one that cannot move ln R by a millionth or a centre or width by a thousandth of a
    nanometre, fixes the value, and so does a continuum coefficient of 0; a polynomial whose highest coefficients are 0
    becomes one of lower degree. Other continuum coefficients that are fixed tie ours to each other. Strengths may be of
    either sign, and no value has other bounds than widths above 1 nm. All channels of a spectrum are fitted. Bands are
    called `band 1`, `band 2`, ...; their minerals are those of the file, or of `minerals`: by number of the band, a key
    of `MINERALS`. The uncertainty of a centre counts on either side, so that a result file, which states the width of
    both sides together, is a prior twice as wide; one below 0 is the wide interval that result files mean by it.

    Raises ParameterError for a band that is not there, and a mineral that is unknown.
    """
    continuum, mean, precision, fixed = _continuum_prior(file)
    bands = tuple(_band_prior(number, band) for number, band in enumerate(_named(file.bands, minerals or {}), start=1))
    unit = np.array([NM_PER_UM, NM_PER_UM, 1.0])
    values = np.array([(band.center_nm, abs(band.fwhm_nm), band.strength) for band in file.bands]) / unit
    around = np.array([band.uncertainties for band in file.bands])
    around[:, 0] = np.where(around[:, 0] < 0, beyond(values[:, 0] * NM_PER_UM, around[:, 0]), around[:, 0])
    sigma = np.minimum(around / unit / NORMAL_95, FLATTEST)
    locked = np.concatenate([fixed, (sigma < TIE_SIGMA).ravel()])
    prior = np.concatenate([mean, values.ravel()])
    m = mean.size
    whole = np.zeros((prior.size, prior.size))
    whole[:m, :m] = precision
    whole[m:, m:] = np.diag(np.where(sigma < TIE_SIGMA, TIE_SIGMA, sigma).ravel() ** -2)
    lower, upper = np.full(prior.size, -np.inf), np.full(prior.size, np.inf)
    lower[m + 1 :: 3] = np.minimum(NARROWEST_UM, prior[m + 1 :: 3])
    names = tuple(f"c{k}" for k in range(m)) + tuple(f"{band.key}_{kind}" for band in bands for kind in KINDS)
    lower, upper = np.where(locked, prior, lower), np.where(locked, prior, upper)
    return MgmModel(Assemblage(ASSEMBLAGE, bands, ()), continuum, names, prior, whole, lower, upper, whole=True)


def parse_minerals(text: str) -> dict[int, str]:
    """`4=OPX,5=CPX` as {4: "OPX", 5: "CPX"}, minerals by number of the band.

    Raises ParameterError for anything else.
    """
    minerals: dict[int, str] = {}
    for part in text.split(","):
        number, equals, mineral = (piece.strip() for piece in part.partition("="))
        if not (equals and number.isascii() and number.isdigit()) or int(number[:9]) in minerals:
            raise ParameterError(f"minerals '{text}': write NUMBER=MINERAL for each band once, such as 4=OPX,5=CPX")
        minerals[int(number[:9])] = mineral.upper()
    return minerals


def _named(bands: tuple[FitBand, ...], minerals: Mapping[int, str]) -> tuple[FitBand, ...]:
    for number, mineral in minerals.items():
        if not 1 <= number <= len(bands) or mineral not in MINERALS:
            names = ", ".join(MINERALS)
            raise ParameterError(f"band {number} is no '{mineral}'; give bands 1 to {len(bands)}, and one of {names}")
    return tuple(
        dataclasses.replace(band, mineral=minerals.get(number, band.mineral)) for number, band in enumerate(bands, 1)
    )


def _band_prior(number: int, band: FitBand) -> BandPrior:
    region = next(name for name, end in REGIONS if band.center_nm < end)
    errors = [abs(value) / NORMAL_95 for value in band.uncertainties]
    return BandPrior(
        f"band {number}", MINERALS.get(band.mineral, "any"), region, "", band.center_nm, 0.0, errors[0],
        abs(band.fwhm_nm), errors[1], errors[2], ASSEMBLAGE,
    )  # fmt: skip


def _continuum_prior(file: FitFile) -> tuple[MgmContinuum, FloatArray, FloatArray, BoolArray]:
    """Kind of continuum, mean and precision of the mapped coefficients, and which of these are fixed."""
    choices = CONTINUA[file.continuum]
    if not file.coefficients or file.continuum == "N":
        return choices[-1], np.zeros(0), np.zeros((0, 0)), np.zeros(0, dtype=bool)
    raw, sigma = np.array(file.coefficients), np.array(file.coefficients_95) / NORMAL_95
    largest = largest_powers(choices[-1], raw.size)
    tied = (sigma * largest < TIE_SIGMA) | (raw == 0)
    count = raw.size
    while count > 2 and tied[count - 1] and abs(raw[count - 1]) * largest[count - 1] < UNSEEN:
        count -= 1
    raw, sigma, tied = raw[:count], sigma[:count], tied[:count]
    continuum = choices[count - 2]
    matrix = to_raw(continuum)
    mean = np.linalg.solve(matrix, raw)
    precision = matrix[~tied].T @ np.diag(sigma[~tied] ** -2.0) @ matrix[~tied]
    directions = np.linalg.qr(matrix[tied].T)[0]
    precision = precision + directions @ directions.T / TIE_SIGMA**2
    return continuum, mean, precision, np.full(count, bool(tied.all()))


@dataclass(frozen=True, slots=True, eq=False)
class ProgramParameters:
    """The parameters that the program steps, (p,), as against those of `MgmModel`, called the kernel's here.

    Those of the program are coefficients of powers of the file's variable, then centre, FWHM and strength of each band.
    [cm^-1, nm, ln R] Those of the kernel are coefficients of the mapped variable, then the same. [um, um, ln R]

    Attributes
    ----------
    model : of the kernel's parameters.
    units : (p,) what the kernel's parameters are to be multiplied by for 1, nm, nm, ln R.
    precision : (p,) 1 / variance of the prior; 0 where there is none.
    held, values : (p,) which may not move, and what they and the others start from.
    planes, targets : (k, p) and (k,) of ties, planes @ parameters = targets, with centres in nm.
    scale : (p,) size of a parameter, with centres in nm.
    """

    model: MgmModel
    units: FloatArray
    precision: FloatArray
    held: BoolArray
    values: FloatArray
    planes: FloatArray
    targets: FloatArray
    scale: FloatArray

    @property
    def tied(self) -> bool:
        """Whether parameters are tied to each other."""
        return len(self.planes) > 0

    def of_kernel(self, kernel: FloatArray) -> FloatArray:
        """The program's parameters of the kernel's, with those held and tied where they belong."""
        m, program = self.model.degrees, kernel * self.units
        program[:m] = to_raw(self.model.continuum) @ kernel[:m]
        program[m::3] = WAVENUMBER_NM / program[m::3]
        return self.obeying_ties(np.where(self.held, self.values, program))

    def to_kernel(self, program: FloatArray) -> FloatArray:
        """The kernel's parameters of the program's."""
        m, kernel = self.model.degrees, program.copy()
        kernel[:m] = np.linalg.solve(to_raw(self.model.continuum), program[:m])
        kernel[m::3] = WAVENUMBER_NM / program[m::3]
        return np.where(self.model.fixed, self.model.lower, kernel / self.units)

    def kernel_slopes(self, program: FloatArray) -> FloatArray:
        """Derivatives, (p, p), of the kernel's parameters by the program's."""
        m, slopes = self.model.degrees, np.diag(self._slope(program) / self.units)
        slopes[:m, :m] = np.linalg.inv(to_raw(self.model.continuum))
        return slopes

    def directions(self, program: FloatArray) -> FloatArray:
        """(p, q) directions in which the parameters may move from here."""
        free = np.eye(program.size)[:, ~self.held]
        if not self.tied:
            return free
        from scipy.linalg import null_space

        along = free @ null_space((self.planes * self.scale)[:, ~self.held])
        return np.asarray((self.scale / self._slope(program))[:, None] * along)

    def obeying_ties(self, program: FloatArray) -> FloatArray:
        """The nearest parameters of the program, (p,), that obey the ties; distances are in units of `scale`."""
        if not self.tied:
            return program
        m, free, there = self.model.degrees, ~self.held, program.copy()
        there[m::3] = WAVENUMBER_NM / there[m::3]
        inverse = np.linalg.pinv((self.planes * self.scale)[:, free])
        there[free] += self.scale[free] * (inverse @ (self.targets - self.planes @ there))
        there[m::3] = WAVENUMBER_NM / there[m::3]
        return there

    def _slope(self, program: FloatArray) -> FloatArray:
        """(p,) derivatives of the parameters with centres in nm by those with centres in cm^-1."""
        m, slope = self.model.degrees, np.ones(program.size)
        slope[m::3] = -WAVENUMBER_NM / program[m::3] ** 2
        return slope


def parameters_of(model: MgmModel, file: FitFile | None = None) -> ProgramParameters:
    """The program's parameters of a model: with the uncertainties of the file that it is of, or of its own prior.

    The 1.96 standard deviations of a centre c with the uncertainty u are the full width in wavenumber between c - u and
    c + u; coefficients and bands are independent of each other. Coefficients of 0 in the file are held.
    """
    m, matrix = model.degrees, to_raw(model.continuum)
    units = np.concatenate([np.ones(m), np.tile([NM_PER_UM, NM_PER_UM, 1.0], len(model.assemblage.bands))])
    values, held = np.where(model.fixed, model.lower, model.prior) * units, model.fixed.copy()
    values[:m], held[:m] = matrix @ values[:m], held[:m].all()
    if file is None:
        around = NORMAL_95 * model.sigma * units
        centres = values[m::3].copy()
    else:
        written = np.concatenate([file.coefficients[:m], *(band.values for band in file.bands)])
        values = np.where(held, values, written)
        held[:m] |= values[:m] == 0
        around = np.concatenate([file.coefficients_95[:m], *(band.uncertainties for band in file.bands)])
        centres = written[m::3]
    around[m::3] = np.abs(full_width(centres, around[m::3]))
    values[m::3] = WAVENUMBER_NM / values[m::3]
    held |= around < HELD
    planes, targets = _planes(model, matrix, units)
    scale = np.concatenate([1 / largest_powers(model.continuum, m), units[m:]])
    precision = np.where(held, 0.0, (np.where(held, 1.0, around) / NORMAL_95) ** -2)
    return ProgramParameters(model, units, precision, held, values, planes, targets, scale)


def _planes(model: MgmModel, matrix: FloatArray, units: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Ties of the model, and mapped coefficients that are fixed while others are not."""
    m, size = model.degrees, model.prior.size
    fixed = [k for k in range(m) if model.fixed[k] and not model.fixed[:m].all()]
    rows = np.array([row for row, _ in model.planes] + [np.eye(size)[k] for k in fixed]).reshape(-1, size)
    targets = np.array([target for _, target in model.planes] + [model.lower[k] for k in fixed])
    rows = rows / units
    rows[:, :m] = rows[:, :m] @ np.linalg.inv(matrix)
    return rows, targets


def fit_file_of(fit: MgmFit, header: FitFile | None = None) -> FitFile:
    """A fit as a result file: values, and 1.96 standard deviations of each; of a centre the width of its interval.

    Folder, spectrum, axes, limits and, where it can hold the continuum, the letter are those of `header`, or else none,
    the spectrum's id, its channels and the limits of the published files. What is 0 becomes a number too small to
    matter, since zeros stop the program.

    Raises ParameterError where the continuum is `log-quadratic`, which these files cannot express, and where an error
    is unknown.
    """
    letter = _letter(fit.model.continuum, header)
    rows = np.hstack(_band_rows(fit))
    if not np.isfinite(rows).all():
        raise ParameterError(f"{fit.id}: the fit has no errors, and a .fit file needs them; fix or remove a band")
    coefficients, coefficients_95 = _raw_coefficients(fit)
    result = FitFile(
        folder="",
        spectrum=" ".join(fit.id.split()) or "spectrum",
        plot_axis=PLOT_AXIS,
        wavelength_axis=(float(fit.wavelength_nm[0]), float(fit.wavelength_nm[-1]), 1.0),
        rms_limit=LIMITS[0],
        improvement_limit=LIMITS[1],
        continuum=letter,
        coefficients=tuple(coefficients.tolist()),
        coefficients_95=tuple(coefficients_95.tolist()),
        bands=tuple(FitBand(*row) for row in rows.clip(-LARGEST, LARGEST).tolist()),
    )
    if header is None:
        return result
    header_fields = ("folder", "spectrum", "plot_axis", "wavelength_axis", "rms_limit", "improvement_limit")
    return dataclasses.replace(result, **{name: getattr(header, name) for name in header_fields})


def _band_rows(fit: MgmFit) -> tuple[FloatArray, FloatArray]:
    """Centre, FWHM and strength of each band, and what the file has as their uncertainties, (k, 3) each. [nm, nm, -]"""
    m, unit = fit.model.degrees, np.array([NM_PER_UM, NM_PER_UM, 1.0])
    values = fit.parameters[m:].reshape(-1, 3) * unit
    errors = NORMAL_95 * np.sqrt(np.diag(fit.covariance)[m:]).reshape(-1, 3) * unit
    wavenumber = WAVENUMBER_NM / values[:, 0]
    errors[:, 0] = full_width(wavenumber, errors[:, 0] * WAVENUMBER_NM / values[:, 0] ** 2)
    return np.where(values == 0, -LEAST_BAND, values), np.where(errors == 0, LEAST_BAND, errors)


def _raw_coefficients(fit: MgmFit) -> tuple[FloatArray, FloatArray]:
    """Coefficients c0 to c3 of the file, and 1.96 standard deviations of each."""
    m, matrix = fit.model.degrees, to_raw(fit.model.continuum)
    raw, error = np.zeros(4), np.zeros(4)
    raw[:m] = matrix @ fit.parameters[:m]
    # A coefficient that is tied has a variance of 0, which rounding may take below it.
    error[:m] = NORMAL_95 * np.sqrt(np.diag(matrix @ fit.covariance[:m, :m] @ matrix.T).clip(min=0.0))
    least = LEAST_COEFFICIENT / largest_powers(fit.model.continuum, 4)
    return np.where(np.abs(raw) < least, least, raw), np.where(error < least, least, error)


def _letter(continuum: MgmContinuum, header: FitFile | None) -> str:
    """Letter of a continuum: that of the start, else of a straight line the one for straight lines."""
    if header and continuum in CONTINUA[header.continuum]:
        return header.continuum
    letters = [letter for letter, choices in CONTINUA.items() if continuum in choices]
    if not letters:
        names = ", ".join(dict.fromkeys(name for choices in CONTINUA.values() for name in choices))
        raise ParameterError(f"a .fit file has no letter for the continuum {continuum}; fit with one of: {names}")
    straight = continuum == CONTINUA[letters[0]][0]
    return letters[-1] if straight else letters[0]
