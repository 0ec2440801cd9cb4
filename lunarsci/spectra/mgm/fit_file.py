"""Start and result files (`*.fit`) of the MGM program distributed by RELAB, read and written.

Line 1 is a folder, 2 the file of the spectrum, 3 and 4 two axes of three numbers, of which the second begins with the
shortest and longest wavelength [nm]; 5 the rms and the improvement of the rms at which a fit stops; 6 the letter of the
continuum; 7 its coefficients c0 to c3 and 8 their uncertainties; 9 the number of bands; then for each band a line of
centre [nm], FWHM [nm] and strength [ln reflectance] and a line of their uncertainties. Uncertainties are 1.96 standard
deviations.
"""

import dataclasses
import math
import re
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import chain
from typing import NoReturn

import numpy as np

from lunarsci.arrays import BoolArray, FloatArray
from lunarsci.errors import DataError, ParameterError
from lunarsci.inputs import InputFile, text
from lunarsci.spectra.mgm import MgmContinuum
from lunarsci.spectra.mgm.assemblages import Assemblage, BandPrior
from lunarsci.spectra.mgm.model import KINDS, NM_PER_UM, RANGE_NM, TIE_SIGMA, MgmModel, continuum_basis
from lunarsci.spectra.mgm.result import MgmFit
from lunarsci.spectra.spectrum import Spectrum

__all__ = [
    "LIMITS", "NORMAL_95", "FitBand", "FitFile", "fit_file_of", "fit_file_text", "model_of", "read_fit_file",
    "spectrum_within",
]  # fmt: skip

NUMBER = re.compile(r"[+-]?(\d+\.?\d*|\.\d+)([eEdD][+-]?\d+)?", re.ASCII)
FIRST_BAND_LINE = 10
LONGEST_SHOWN = 40
LEAST_NM = 10.0
"""Below it a wavelength is taken for one in um."""
Numbers = tuple[float, ...]


@dataclass(frozen=True, slots=True)
class FitBand:
    """One band of a `.fit` file: values, and uncertainties of 1.96 standard deviations. [nm, nm, ln reflectance]"""

    center_nm: float
    fwhm_nm: float
    strength: float
    center_95_nm: float
    fwhm_95_nm: float
    strength_95: float

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
    plot_axis : three numbers of the plot's vertical axis; kept, not used.
    wavelength_axis : shortest and longest wavelength [nm], and a third number; kept, not used.
    rms_limit, improvement_limit : of ln R. [-]
    continuum : Q polynomial and T straight line in wavenumber, P and S the same in wavelength, N none.
    coefficients, coefficients_95 : c0 to c3 of a polynomial in wavenumber [cm^-1] or wavelength [nm], and 1.96 standard
        deviations of each. T and S use the first two, N none.
    bands : one or more. An uncertainty of 0 means that the value is fixed. A centre below 0 is that of a band of which
        the spectrum sees only a wing.

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
        for line, fault in chain(_header_faults(self), _continuum_faults(self), _band_faults(self.bands)):
            raise ParameterError(f"line {line}: {fault}")


def _header_faults(file: FitFile) -> Iterator[tuple[int, str]]:
    for line, name in ((1, file.folder), (2, file.spectrum)):
        if name != name.strip() or re.search(r"[\r\n\0]", name):
            yield line, f"name {_shown(name)} begins or ends with a blank or breaks the line; give it without"
    if not file.spectrum:
        yield 2, "is empty; it must name the file of the spectrum"
    if not _are_numbers(file.plot_axis, 3):
        yield 3, "the axis of the plot is not three finite numbers; give them"
    if not (_are_numbers(file.wavelength_axis, 3) and 0 < file.wavelength_axis[0] < file.wavelength_axis[1]):
        yield 4, "the wavelengths do not ascend from above 0; give the shortest, the longest [nm] and a third number"
    elif file.wavelength_axis[1] < LEAST_NM:
        yield 4, f"wavelengths up to {file.wavelength_axis[1]:g} nm; these files are in nm, is this um?"
    if not _are_numbers((file.rms_limit, file.improvement_limit), 2, lowest=0):
        yield 5, f"limits of the rms {file.rms_limit:g} and {file.improvement_limit:g}; give finite ones, 0 or above"


def _continuum_faults(file: FitFile) -> Iterator[tuple[int, str]]:
    if file.continuum not in CONTINUA:
        yield 6, f"continuum {_shown(file.continuum)} is unknown; give one letter of {', '.join(CONTINUA)}"
    if not _are_numbers(file.coefficients, 4):
        yield 7, "the continuum is not four finite coefficients; give c0 to c3, 0 where unused"
    if not _are_numbers(file.coefficients_95, 4, lowest=0):
        yield 8, "the uncertainties of the continuum are not four finite numbers of 0 or above; give them"


def _band_faults(bands: Sequence[FitBand]) -> Iterator[tuple[int, str]]:
    if not bands:
        yield 9, "no band; give one or more"
    for number, band in enumerate(bands, start=1):
        line = FIRST_BAND_LINE + 2 * (number - 1)
        if not _are_numbers(band.values, 3):
            yield line, f"band {number}: centre, FWHM or strength is not finite; give three numbers"
        if band.center_nm == 0:
            yield line, f"band {number}: centre of 0 nm, which has no wavenumber; give another"
        if 0 < band.center_nm < LEAST_NM and 0 < band.fwhm_nm < LEAST_NM:
            yield line, f"band {number}: centre of {band.center_nm:g} nm; these files are in nm, is this um?"
        if not band.fwhm_nm > 0:
            yield line, f"band {number}: FWHM of {band.fwhm_nm:g} nm; give one above 0"
        if not _are_numbers(band.uncertainties, 3, lowest=0):
            fault = (
                "uncertainties are not finite numbers of 0 or above; each band has a line of values, then one of them"
            )
            yield line + 1, f"band {number}: {fault}"


def _are_numbers(values: Numbers, count: int, lowest: float = -math.inf) -> bool:
    return len(values) == count and all(math.isfinite(value) and value >= lowest for value in values)


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
    try:
        return FitFile(
            folder=lines.rows[0],
            spectrum=lines.line(2, "file of the spectrum"),
            plot_axis=lines.numbers(3, 3, "axis of the plot"),
            wavelength_axis=lines.numbers(4, 3, "shortest and longest wavelength, and a third number"),
            rms_limit=rms_limit,
            improvement_limit=improvement_limit,
            continuum=letter.group(),
            coefficients=lines.numbers(7, 4, "continuum c0, c1, c2, c3"),
            coefficients_95=lines.numbers(8, 4, "uncertainties of the continuum"),
            bands=_read_bands(lines),
        )
    except ParameterError as error:
        raise DataError(f"{input.name}: {error}") from error


def _read_bands(lines: "_Lines") -> tuple[FitBand, ...]:
    [count] = lines.numbers(9, 1, "number of bands")
    if count < 1 or not count.is_integer():
        lines.refuse(9, f"{count:g} is no number of bands; give 1 or more")
    bands = []
    for number in range(1, int(count) + 1):
        line, name = FIRST_BAND_LINE + 2 * (number - 1), f"band {number} of {count:g}"
        values = lines.numbers(line, 3, f"centre, FWHM and strength of {name}")
        bands.append(FitBand(*values, *lines.numbers(line + 1, 3, f"uncertainties of {name}")))
    after = FIRST_BAND_LINE + 2 * len(bands)
    for line in range(after, len(lines.rows) + 1):
        if NUMBER.fullmatch(_parts(lines.rows[line - 1])[0]):
            lines.refuse(line, f"holds numbers behind the last of {count:g} bands; correct line 9, or remove the line")
    return tuple(bands)


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

    def numbers(self, number: int, count: int, what: str) -> Numbers:
        parts = _parts(self.line(number, what))
        values = [float(part.upper().replace("D", "E")) for part in parts[: count + 1] if NUMBER.fullmatch(part)]
        if len(values) != count or not all(NUMBER.fullmatch(part) for part in parts[:count]):
            self.refuse(number, f"{_shown(' '.join(parts))} are not {count} numbers ({what}); give them")
        return tuple(values)


def fit_file_text(file: FitFile) -> str:
    """The file as text that `read_fit_file` reads back equal, every digit kept."""
    rows = [
        file.folder,
        file.spectrum,
        _row(file.plot_axis, ","),
        _row(file.wavelength_axis, ","),
        _row((file.rms_limit, file.improvement_limit), ","),
        file.continuum,
        _row(file.coefficients),
        _row(file.coefficients_95),
        str(len(file.bands)),
        *(_row(values) for band in file.bands for values in (band.values, band.uncertainties)),
    ]
    return "\n".join(rows) + "\n"


def _row(values: Numbers, separator: str = "\t") -> str:
    return separator.join(repr(float(value)).removesuffix(".0") for value in values)


NORMAL_95 = 1.96
"""Standard deviations in an uncertainty of the file: 95 % of a normal law."""
LIMITS = (2e-3, 1e-6)
"""Rms of ln R, and improvement of it, at which a fit stops in the files that have been published."""
PLOT_AXIS = (-170.0, 25.0, 10.0)
NARROWEST_UM = 1e-3
FLATTEST = 1e9
"""Standard deviation, um or ln R, beyond which a wider one changes nothing but rounding."""
ASSEMBLAGE = "fit file"
REGIONS = (("uv", 400.0), ("visible", 750.0), ("um1", 1500.0), ("um2", math.inf))
"""Regions and their upper ends. [nm]"""
CONTINUA: dict[str, tuple[MgmContinuum, ...]] = {
    "Q": ("wavenumber", "wavenumber-quadratic", "wavenumber-cubic"),
    "T": ("wavenumber",),
    "P": ("wavelength", "wavelength-quadratic", "wavelength-cubic"),
    "S": ("wavelength",),
    "N": ("none",),
}
"""By letter: what it may become, by degree. Q, T: a polynomial, a straight line in wavenumber; P, S: in wavelength."""


def model_of(file: FitFile) -> MgmModel:
    """The model of a `.fit` file: its values as prior means, its uncertainties over 1.96 as standard deviations.

    An uncertainty of 0, or one that cannot move ln R by a millionth or a centre or width by a thousandth of a
    nanometre, fixes the value; a polynomial whose highest coefficients are fixed at 0 becomes one of lower degree.
    Other continuum coefficients that are fixed tie ours to each other. Strengths may be of either sign, and no value
    has other bounds than widths above 1 nm. Bands are called `band 1`, `band 2`, ...
    """
    continuum, mean, precision, fixed = _continuum_prior(file)
    bands = tuple(_band_prior(number, band) for number, band in enumerate(file.bands, start=1))
    unit = np.array([NM_PER_UM, NM_PER_UM, 1.0])
    values = np.array([band.values for band in file.bands]) / unit
    sigma = np.minimum(np.array([band.uncertainties for band in file.bands]) / unit / NORMAL_95, FLATTEST)
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
    return MgmModel(Assemblage(ASSEMBLAGE, bands, ()), continuum, names, prior, whole, lower, upper)


def _band_prior(number: int, band: FitBand) -> BandPrior:
    region = next(name for name, end in REGIONS if band.center_nm < end)
    errors = [value / NORMAL_95 for value in band.uncertainties]
    return BandPrior(
        f"band {number}", "any", region, "", band.center_nm, 0.0, errors[0], band.fwhm_nm, errors[1], errors[2],
        ASSEMBLAGE,
    )  # fmt: skip


def _continuum_prior(file: FitFile) -> tuple[MgmContinuum, FloatArray, FloatArray, BoolArray]:
    """Kind of continuum, mean and precision of the mapped coefficients, and which of these are fixed."""
    choices = CONTINUA[file.continuum]
    most = continuum_basis(choices[-1], np.array(RANGE_NM)).shape[1]
    raw, sigma = np.array(file.coefficients[:most]), np.array(file.coefficients_95[:most]) / NORMAL_95
    largest = _raw_variable(choices[-1]).max() ** np.arange(most)
    tied = sigma * largest < TIE_SIGMA
    count = most
    while count > 2 and tied[count - 1] and raw[count - 1] == 0:
        count -= 1
    raw, sigma, tied = raw[:count], sigma[:count], tied[:count]
    continuum = choices[-1] if len(choices) == 1 else choices[count - 2]
    to_raw = _to_raw(continuum)
    mean = np.linalg.solve(to_raw, raw)
    precision = to_raw[~tied].T @ np.diag(sigma[~tied] ** -2.0) @ to_raw[~tied]
    directions = np.linalg.qr(to_raw[tied].T)[0]
    precision = precision + directions @ directions.T / TIE_SIGMA**2
    return continuum, mean, precision, np.full(count, bool(tied.all()))


def _raw_variable(continuum: MgmContinuum) -> FloatArray:
    """The file's variable at both ends of the interval that ours maps to -1 and 1. [cm^-1 or nm]"""
    ends = np.array(RANGE_NM)
    return 1e7 / ends if continuum.startswith("wavenumber") else ends


def _to_raw(continuum: MgmContinuum) -> FloatArray:
    """Matrix, (m, m), that takes coefficients of powers of the mapped variable u to those of the file's variable v.

    With u = a v + b, the coefficient of v^j is the sum over k of binomial(k, j) a^j b^(k - j) c_k.
    """
    basis = continuum_basis(continuum, np.array(RANGE_NM))
    m = basis.shape[1]
    if not m:
        return np.zeros((0, 0))
    v, u = _raw_variable(continuum), basis[:, 1]
    a = (u[1] - u[0]) / (v[1] - v[0])
    b = u[0] - a * v[0]
    return np.array([[math.comb(k, j) * a**j * b ** (k - j) if k >= j else 0.0 for k in range(m)] for j in range(m)])


def fit_file_of(fit: MgmFit, header: FitFile | None = None) -> FitFile:
    """A fit as a result file: values, and 1.96 standard deviations of each.

    Folder, spectrum, axes and limits are those of `header`, or else none, the spectrum's id, its channels and the
    limits of the published files. A quadratic continuum becomes a polynomial whose c3 is 0 and fixed.

    Raises ParameterError where the continuum is `log-quadratic`, which these files cannot express, and where an error
    is unknown.
    """
    m = fit.model.degrees
    sigma = NORMAL_95 * np.sqrt(np.diag(fit.covariance))
    if not np.isfinite(sigma).all():
        raise ParameterError(f"{fit.id}: the fit has no errors, and a .fit file needs them; fix or remove a band")
    letter = _letter(fit.model.continuum)
    to_raw = _to_raw(fit.model.continuum)
    raw, raw_error = np.zeros(4), np.zeros(4)
    raw[:m] = to_raw @ fit.parameters[:m]
    # A coefficient that is tied has a variance of 0, which rounding may take below it.
    raw_error[:m] = NORMAL_95 * np.sqrt(np.diag(to_raw @ fit.covariance[:m, :m] @ to_raw.T).clip(min=0.0))
    unit = np.array([NM_PER_UM, NM_PER_UM, 1.0])
    values, errors = fit.parameters[m:].reshape(-1, 3) * unit, sigma[m:].reshape(-1, 3) * unit
    rows = np.hstack([values, errors]).tolist()
    found = FitFile(
        folder="",
        spectrum=" ".join(fit.id.split()) or "spectrum",
        plot_axis=PLOT_AXIS,
        wavelength_axis=(float(fit.wavelength_nm[0]), float(fit.wavelength_nm[-1]), 1.0),
        rms_limit=LIMITS[0],
        improvement_limit=LIMITS[1],
        continuum=letter,
        coefficients=tuple(raw.tolist()),
        coefficients_95=tuple(raw_error.tolist()),
        bands=tuple(FitBand(*row) for row in rows),
    )
    if header is None:
        return found
    kept = ("folder", "spectrum", "plot_axis", "wavelength_axis", "rms_limit", "improvement_limit")
    return dataclasses.replace(found, **{name: getattr(header, name) for name in kept})


def _letter(continuum: MgmContinuum) -> str:
    """Letter of a continuum: of a straight line, the one for straight lines."""
    found = [letter for letter, choices in CONTINUA.items() if continuum in choices]
    if not found:
        known = ", ".join(choices[-1] for choices in CONTINUA.values())
        raise ParameterError(f"a .fit file has no letter for the continuum {continuum}; fit with one of: {known}")
    return found[-1]


def spectrum_within(spectrum: Spectrum, file: FitFile) -> Spectrum:
    """The spectrum with the channels outside the file's wavelength range masked."""
    low, high, _ = file.wavelength_axis
    outside = (spectrum.wavelength_nm < low) | (spectrum.wavelength_nm > high)
    return dataclasses.replace(spectrum, mask=~spectrum.usable | outside)
