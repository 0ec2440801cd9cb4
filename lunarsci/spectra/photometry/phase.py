"""Angles of one observation, and phase functions f(g): how the radiance factor falls with the phase angle.

The disk function is divided out of it.
"""

from dataclasses import dataclass
from functools import cache
from math import acos, cos, degrees, isfinite, radians, sin
from typing import Protocol

import numpy as np

from lunarsci.arrays import FloatArray
from lunarsci.errors import DataError, ParameterError
from lunarsci.io import inputs
from lunarsci.io.inputs import InputFile
from lunarsci.io.tables import table_rows
from lunarsci.spectra.rows import Row, check_widths, number, numbers, quoted, separator_of, split_fields, split_lines

_LIMITS_DEG = {"incidence": 90.0, "emission": 90.0, "phase": 180.0}
_ROUNDING_DEG = 0.5  # assumed: labels round the angles, or give them at slightly different points


@dataclass(frozen=True, slots=True)
class Geometry:
    """Where the light comes from and where it goes to, seen from the surface.

    Attributes
    ----------
    incidence_deg, emission_deg : from the normal of the surface to the Sun and to the observer, 0 <= angle < 90. [deg]
    phase_deg : between the two directions, 0 <= angle < 180; |i - e| <= g <= i + e to within 0.5 deg. [deg]

    Raises
    ------
    ParameterError when an angle is out of its range, or the three do not make a spherical triangle.
    """

    incidence_deg: float
    emission_deg: float
    phase_deg: float

    def __post_init__(self) -> None:
        for name, limit in _LIMITS_DEG.items():
            angle = getattr(self, f"{name}_deg")
            if not (isfinite(angle) and 0 <= angle < limit):
                where = "; the surface is not lit" if name == "incidence" and angle >= limit else ""
                raise ParameterError(f"{name} angle {angle:g} deg: must lie from 0 to below {limit:g} deg{where}")
        low, high = self.phase_range_deg
        if not low - _ROUNDING_DEG <= self.phase_deg <= high + _ROUNDING_DEG:
            raise ParameterError(
                f"phase angle {self.phase_deg:g} deg cannot occur at incidence {self.incidence_deg:g} and emission "
                f"{self.emission_deg:g} deg ({low:g} to {high:g} deg can); check the three angles"
            )

    @property
    def phase_range_deg(self) -> tuple[float, float]:
        """Smallest and largest phase angle that go with the other two. [deg]"""
        return abs(self.incidence_deg - self.emission_deg), self.incidence_deg + self.emission_deg

    @property
    def cos_incidence(self) -> float:
        """mu0. [-]"""
        return cos(radians(self.incidence_deg))

    @property
    def cos_emission(self) -> float:
        """mu. [-]"""
        return cos(radians(self.emission_deg))


def phase_angle_deg(incidence_deg: float, emission_deg: float, azimuth_difference_deg: float) -> float:
    """Phase angle from cos g = cos i cos e + sin i sin e cos(azimuth difference), 0 to 180. [deg]"""
    i, e, turn = radians(incidence_deg), radians(emission_deg), radians(azimuth_difference_deg)
    return degrees(acos(max(-1.0, min(1.0, cos(i) * cos(e) + sin(i) * sin(e) * cos(turn)))))


STANDARD = Geometry(30.0, 0.0, 30.0)
"""The geometry that lunar reflectances are usually reduced to, as those of M3 (Besse et al. 2013, Icarus 222, 229)."""


TABLE = "selene_sp_phase.csv"
PHASE_FUNCTIONS = ("flat", "sp-low", "sp-mid", "sp-high")
FITTED_DEG = (5.0, 85.0)
"""Phase angles of the observations that the SELENE parameters were fitted to: Yokota et al. (2011),
10.1016/j.icarus.2011.07.028. [deg]"""
COMPARED_DEG = 112.0
"""Largest phase angle at which they were compared with others, measured: 23 Chang'E-4 spectra of lunar day 10. [deg]"""
_DEGREE = 2
_SHORTEST_NM = 100.0
"""Below it a wavelength is one in um; assumed."""


class PhaseFunction(Protocol):
    """f(g) relative to the standard geometry, at the wavelengths asked for."""

    @property
    def name(self) -> str:
        """How results call it."""

    @property
    def source(self) -> str:
        """What to cite, or the file it came from."""

    def log_ratio(self, phase_deg: float, wavelength_nm: FloatArray) -> FloatArray:
        """ln f(g) / f(30 deg), shape of `wavelength_nm`. [-]"""

    def edge_shift(self, phase_deg: float, wavelength_nm: FloatArray) -> FloatArray:
        """What ln R would gain where the curve went on beyond its last wavelengths instead of being held there. [-]"""

    def remark(self, phase_deg: float, wavelength_nm: FloatArray) -> str:
        """What to know when it is used beyond where it was established; '' within."""


@dataclass(frozen=True, slots=True)
class FlatPhase:
    """f = 1: the disk function alone."""

    name: str = "flat"
    source: str = "none: f = 1"

    def log_ratio(self, phase_deg: float, wavelength_nm: FloatArray) -> FloatArray:
        """Zeros, shape of `wavelength_nm`. [-]"""
        return np.zeros(np.shape(wavelength_nm))

    def edge_shift(self, phase_deg: float, wavelength_nm: FloatArray) -> FloatArray:
        """Zeros, shape of `wavelength_nm`. [-]"""
        return np.zeros(np.shape(wavelength_nm))

    def remark(self, phase_deg: float, wavelength_nm: FloatArray) -> str:
        """What the lack of a phase function means away from 30 deg."""
        if phase_deg == STANDARD.phase_deg:
            return ""
        return f"phase {phase_deg:.1f} deg: the flat phase function leaves brightness and colour at that phase angle"


@dataclass(frozen=True, slots=True, eq=False)
class SelenePhase:
    """Phase function of one albedo group of the Moon from the SELENE (Kaguya) Spectral Profiler.

    The tabulated parameters scatter from channel to channel and jump between detectors (944/955 nm) and where the table
    was extended with other data (1644/1710 nm); on a spectrum that would pass for noise and bands. What is used is, at
    the phase angle wanted, the parabola in wavelength that fits ln f(g)/f(30) of all 204 channels best. The channels
    scatter about it with an rms of 0.003-0.005 at 60 deg, 0.007-0.013 at 90 deg and 0.013-0.030 at 110 deg. Degree 2 is
    the lowest that follows the curvature at small phase angles. It has no inflection and departs from its chords over
    750-1500 and 1500-2050 nm by 0.005 or less at 60-90 deg, where degree 5 makes humps of up to 0.024. Channels left
    out in blocks of 20 are predicted better by degree 5 at 10 and 60 deg (0.003-0.007, degree 2 0.004-0.007), and by no
    degree from 3 to 8 at all phase angles and in all groups.

    Attributes
    ----------
    name, source : for results.
    wavelength_nm : channels, shape (n,), 512.6 to 2053.3. [nm]
    b0, h, c, g : parameters of `selene_phase`, shape (n,) each. [-]
    """

    name: str
    source: str
    wavelength_nm: FloatArray
    b0: FloatArray
    h: FloatArray
    c: FloatArray
    g: FloatArray

    def log_ratio(self, phase_deg: float, wavelength_nm: FloatArray) -> FloatArray:
        """ln f(g) / f(30 deg), smoothed over wavelength; the value at the edge is held beyond 512.6-2053.3 nm. [-]

        phase_deg : fitted to 5-85; an extrapolation elsewhere, up to 180. [deg]
        """
        return np.asarray(self._smooth(phase_deg)(_held(wavelength_nm, self.wavelength_nm)), dtype=np.float64)

    def _smooth(self, phase_deg: float) -> np.polynomial.Polynomial:
        at, standard = (
            selene_phase(angle, self.b0, self.h, self.c, self.g) for angle in (phase_deg, STANDARD.phase_deg)
        )
        return np.polynomial.Polynomial.fit(self.wavelength_nm, np.log(at / standard), _DEGREE)

    def edge_shift(self, phase_deg: float, wavelength_nm: FloatArray) -> FloatArray:
        """What ln R gains where the parabola goes on beyond 512.6-2053.3 nm instead of being held; 0 within. [-]"""
        smooth = self._smooth(phase_deg)
        held = smooth(_held(wavelength_nm, self.wavelength_nm))
        return np.asarray(held - smooth(np.asarray(wavelength_nm, dtype=float)), dtype=np.float64)

    def remark(self, phase_deg: float, wavelength_nm: FloatArray) -> str:
        """Names the phase angle outside 5-85 deg, and the count of channels beyond the wavelengths."""
        low, high = FITTED_DEG
        found = []
        if not low <= phase_deg <= high:
            unchecked = f", and beyond {COMPARED_DEG:g} deg nothing checks it" if phase_deg > COMPARED_DEG else ""
            found.append(
                f"phase {phase_deg:.1f} deg extrapolates the formula fitted to {low:g}-{high:g} deg{unchecked}"
            )
        return _said(self.name, [*found, _beyond(wavelength_nm, self.wavelength_nm)])


@dataclass(frozen=True, slots=True, eq=False)
class TablePhase:
    """A tabulated phase function, linear in ln f between its nodes, its edge values held beyond them.

    Attributes
    ----------
    name, source : of the file.
    phase_deg : shape (m,), ascending, 30 within. [deg]
    wavelength_nm : shape (n,), ascending; empty for one curve at all wavelengths. [nm]
    log_f : shape (m, n), or (m, 1) for one curve. [-]
    """

    name: str
    source: str
    phase_deg: FloatArray
    wavelength_nm: FloatArray
    log_f: FloatArray

    def log_ratio(self, phase_deg: float, wavelength_nm: FloatArray) -> FloatArray:
        """ln f(g) / f(30 deg), shape of `wavelength_nm`. [-]"""
        angles = (phase_deg, STANDARD.phase_deg)
        at, standard = np.array([np.interp(angles, self.phase_deg, curve) for curve in self.log_f.T]).T
        if self.wavelength_nm.size == 0:
            return np.full(np.shape(wavelength_nm), (at - standard)[0])
        return np.asarray(np.interp(wavelength_nm, self.wavelength_nm, at - standard), dtype=np.float64)

    def edge_shift(self, phase_deg: float, wavelength_nm: FloatArray) -> FloatArray:
        """0: nothing is known beyond a table's wavelengths. [-]"""
        return np.zeros(np.shape(wavelength_nm))

    def remark(self, phase_deg: float, wavelength_nm: FloatArray) -> str:
        """Names the phase angle outside the table, and the count of channels beyond its wavelengths."""
        low, high = self.phase_deg[0], self.phase_deg[-1]
        found = []
        if not low <= phase_deg <= high:
            found.append(f"phase {phase_deg:.1f} deg lies outside its {low:g}-{high:g} deg; the edge value is held")
        return _said(self.name, [*found, _beyond(wavelength_nm, self.wavelength_nm)])


def _held(wavelength_nm: FloatArray, channels_nm: FloatArray) -> FloatArray:
    return np.clip(wavelength_nm, channels_nm[0], channels_nm[-1])


def _beyond(wavelength_nm: FloatArray, channels_nm: FloatArray) -> str:
    if channels_nm.size == 0:
        return ""
    asked = np.atleast_1d(wavelength_nm)
    count = int(np.sum((asked < channels_nm[0]) | (asked > channels_nm[-1])))
    if not count:
        return ""
    lie = "channel lies" if count == 1 else "channels lie"
    edges = f"{channels_nm[0]:g}-{channels_nm[-1]:g} nm"
    return f"{count} of {asked.size} {lie} outside its {edges}, where the edge value is held"


def _said(name: str, parts: list[str]) -> str:
    text = "; ".join(part for part in parts if part)
    return f"phase function {name}: {text}" if text else ""


def selene_phase(phase_deg: float, b0: FloatArray, h: FloatArray, c: FloatArray, g: FloatArray) -> FloatArray:
    """f = (1 + B0 / (1 + tan(g/2) / h)) [(1 - c)/2 P(+G) + (1 + c)/2 P(-G)], P by `henyey_greenstein`; shape of b0.

    An opposition surge of height B0 and width h, and scattering with a backward (+G) and a forward (-G) lobe.

    phase_deg : 0 <= g < 180. [deg]
    b0, h : above 0; c : -1 to 1; g : asymmetry G, 0 to 1. [-]

    Yokota et al. (2011), Icarus 215, 639, 10.1016/j.icarus.2011.07.028.
    """
    surge = 1 + b0 / (1 + np.tan(np.radians(phase_deg) / 2) / h)
    lobes = (1 - c) / 2 * henyey_greenstein(phase_deg, g) + (1 + c) / 2 * henyey_greenstein(phase_deg, -g)
    return np.asarray(surge * lobes, dtype=np.float64)


def henyey_greenstein(phase_deg: float, asymmetry: FloatArray) -> FloatArray:
    """P = (1 - x^2) / (1 + x^2 - 2 x cos g)^1.5; x above 0 scatters back to the source, -1 < x < 1. [-]

    Henyey & Greenstein (1941), Astrophys. J. 93, 70, 10.1086/144246.
    """
    cosine = np.cos(np.radians(phase_deg))
    return np.asarray((1 - asymmetry**2) / (1 + asymmetry**2 - 2 * asymmetry * cosine) ** 1.5, dtype=np.float64)


def phase_function(name: str) -> PhaseFunction:
    """The phase function of that name: `flat` (f = 1), or `sp-low`, `sp-mid`, `sp-high` from SELENE, for the dark,
    middle and bright albedo group of the Moon (mare to bright highland).

    Raises ParameterError for an unknown name.
    """
    if name not in PHASE_FUNCTIONS:
        known = ", ".join(PHASE_FUNCTIONS)
        raise ParameterError(f"phase function '{name}' is unknown; choose one of: {known}, or give a table")
    return FlatPhase() if name == "flat" else _selene(name.removeprefix("sp-"))


@cache
def _selene(group: str) -> SelenePhase:
    rows = [row for row in table_rows(TABLE) if row["group"] == group]
    columns = [np.array([float(row[key]) for row in rows]) for key in ("wavelength_nm", "b0", "h", "c", "g")]
    for column in columns:
        column.setflags(write=False)
    return SelenePhase(f"sp-{group}", "Yokota et al. (2011), Icarus 215, 639, 10.1016/j.icarus.2011.07.028", *columns)


def read_phase_function(source: InputFile) -> TablePhase:
    """Read a user's phase function from a text table.

    Columns `phase_deg, f` for all wavelengths alike, or `phase_deg` and one column per wavelength named by its
    nanometres (`phase_deg, 750, 1500`). Any scale of f will do; phase angles ascend and 30 deg lies between them.

    Raises
    ------
    DataError for another header, text or blanks among the numbers, f not above 0, angles that do not ascend or do not
    reach 30 deg, or fewer than two rows.
    """
    lines, _ = split_lines(inputs.text(source))
    if not lines:
        raise DataError(f"{source.name}: holds only comments; check how it was made or downloaded")
    separator = separator_of(lines)
    header, *rows = [Row(n, split_fields(line, separator, f"{source.name}: line {n}")) for n, line in lines]
    wavelength = _wavelengths(header.fields, source.name)
    if len(rows) < 2:
        raise DataError(f"{source.name}: {len(rows)} rows below the header; a phase function needs two or more")
    check_widths(rows, source.name, len(header.fields))
    decimal_comma = separator == ";"
    columns = [numbers(rows, k, quoted(n), source.name, decimal_comma) for k, n in enumerate(header.fields)]
    _check_phase(columns[0], rows, source.name)
    for name, column in zip(header.fields[1:], columns[1:], strict=True):
        _check_values(column, rows, name, source.name)
    return TablePhase(source.stem, source.name, columns[0], wavelength, np.log(np.column_stack(columns[1:])))


def _wavelengths(names: tuple[str, ...], file: str) -> FloatArray:
    """Wavelengths in the header, shape (n,); empty for the one column `f`."""
    expected = "the header must be phase_deg,f or phase_deg and wavelengths in nm (phase_deg,750,1500)"
    if names[0].casefold() != "phase_deg" or len(names) < 2:
        raise DataError(f"{file}: the first column is {quoted(names[0])}; {expected}")
    if len(names) == 2 and names[1].casefold() == "f":
        return np.empty(0)
    found = [number(name) for name in names[1:]]
    for name, value in zip(names[1:], found, strict=True):
        if value is None or not np.isfinite(value) or value <= 0:
            raise DataError(f"{file}: column {quoted(name)} is no wavelength; {expected}")
        if value < _SHORTEST_NM:
            raise DataError(f"{file}: column {quoted(name)} would be {value:g} nm; write wavelengths in nm, not um")
    values = np.array(found, dtype=float)
    if not (np.diff(values) > 0).all():
        raise DataError(f"{file}: the wavelengths in the header do not ascend; sort the columns and keep one of each")
    return values


def _check_phase(phase: FloatArray, rows: list[Row], file: str) -> None:
    for row, angle in zip(rows, phase, strict=True):
        if not 0 <= angle < 180:
            what = "is missing" if np.isnan(angle) else f"is {angle:g} deg"
            raise DataError(f"{file}: line {row.line}: phase_deg {what}; it must lie from 0 to below 180 deg")
    backward = np.flatnonzero(np.diff(phase) <= 0)
    if backward.size:
        line = rows[int(backward[0]) + 1].line
        raise DataError(f"{file}: line {line}: phase_deg does not ascend; sort the rows and keep one of each")
    if not phase[0] <= STANDARD.phase_deg <= phase[-1]:
        raise DataError(
            f"{file}: phase_deg runs from {phase[0]:g} to {phase[-1]:g}; it must contain {STANDARD.phase_deg:g} deg, "
            "to which reflectances are reduced"
        )


def _check_values(values: FloatArray, rows: list[Row], name: str, file: str) -> None:
    for row, value in zip(rows, values, strict=True):
        if not (np.isfinite(value) and value > 0):
            what = "is missing" if np.isnan(value) else f"is {value:g}"
            raise DataError(f"{file}: line {row.line}, column {quoted(name)}: f {what}; it must be above 0")
