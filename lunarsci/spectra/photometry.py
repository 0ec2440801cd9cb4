"""Photometric correction: angles of an observation, phase functions f(g), disk functions D(i, e, g), how models differ.

The radiance factor RADF = pi I / E0 is cos i times the reflectance factor, and RADF = D(i, e, g) f(g). A disk function
matters only as a ratio between two geometries; the three here are scaled differently.
"""

from abc import ABC, abstractmethod
from collections.abc import Callable
from dataclasses import dataclass
from functools import cache
from math import acos, atan2, cos, degrees, isfinite, pi, pow, radians, sin

import numpy as np

from lunarsci.arrays import FloatArray
from lunarsci.errors import DataError, ParameterError
from lunarsci.io.inputs import InputFile
from lunarsci.io.tables import table_rows
from lunarsci.spectra.rows import named_table, number

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
"""Below it a wavelength is one in um: reflectance spectra are of 0.1 to 5 um."""


class PhaseFunction(ABC):
    """f(g) relative to the standard geometry, at the wavelengths asked for."""

    name: str
    """How results call it."""
    source: str
    """What to cite, or the file it came from."""

    @abstractmethod
    def log_ratio(self, phase_deg: float, wavelength_nm: FloatArray) -> FloatArray:
        """ln f(g) / f(30 deg), shape of `wavelength_nm`. [-]"""

    def edge_shift(self, phase_deg: float, wavelength_nm: FloatArray) -> FloatArray:
        """What ln R would gain where the curve went on beyond its last wavelengths instead of being held there. [-]"""
        return np.zeros(np.shape(wavelength_nm))

    @abstractmethod
    def remark(self, phase_deg: float, wavelength_nm: FloatArray) -> str:
        """What to know when it is used beyond where it was established; '' within."""


@dataclass(frozen=True, slots=True)
class FlatPhase(PhaseFunction):
    """f = 1: the disk function alone."""

    name: str = "flat"
    source: str = "none: f = 1"

    def log_ratio(self, phase_deg: float, wavelength_nm: FloatArray) -> FloatArray:
        """Zeros, shape of `wavelength_nm`. [-]"""
        return np.zeros(np.shape(wavelength_nm))

    def remark(self, phase_deg: float, wavelength_nm: FloatArray) -> str:
        """What the lack of a phase function means away from 30 deg."""
        if phase_deg == STANDARD.phase_deg:
            return ""
        return f"phase {phase_deg:.1f} deg: the flat phase function leaves brightness and colour at that phase angle"


@dataclass(frozen=True, slots=True, eq=False)
class SelenePhase(PhaseFunction):
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
        result = []
        if not low <= phase_deg <= high:
            unchecked = f", and beyond {COMPARED_DEG:g} deg nothing checks it" if phase_deg > COMPARED_DEG else ""
            result.append(
                f"phase {phase_deg:.1f} deg extrapolates the formula fitted to {low:g}-{high:g} deg{unchecked}"
            )
        return _remark_of(self.name, [*result, _beyond(wavelength_nm, self.wavelength_nm)])


@dataclass(frozen=True, slots=True, eq=False)
class TablePhase(PhaseFunction):
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

    def remark(self, phase_deg: float, wavelength_nm: FloatArray) -> str:
        """Names the phase angle outside the table, and the count of channels beyond its wavelengths."""
        low, high = self.phase_deg[0], self.phase_deg[-1]
        result = []
        if not low <= phase_deg <= high:
            result.append(f"phase {phase_deg:.1f} deg lies outside its {low:g}-{high:g} deg; the edge value is held")
        return _remark_of(self.name, [*result, _beyond(wavelength_nm, self.wavelength_nm)])


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


def _remark_of(name: str, parts: list[str]) -> str:
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
        names = ", ".join(PHASE_FUNCTIONS)
        raise ParameterError(f"phase function '{name}' is unknown; choose one of: {names}, or give a table")
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
    table, expected = named_table(source, "phase_deg", least=2), "name them phase_deg,f or phase_deg,750,1500 (nm)"
    names = table.names[1:]
    wavelength = np.empty(0) if names == ("f",) else np.array([number(name) or np.nan for name in names], float)
    ascend = (wavelength >= _SHORTEST_NM) & np.isfinite(wavelength) & (np.diff(wavelength, prepend=0.0) > 0)
    if table.names[0] != "phase_deg" or not names or not ascend.all():
        listed = ", ".join(table.names[:5])
        raise DataError(f"{source.name}: its columns ({listed}) are no phase_deg and ascending wavelengths; {expected}")
    phase, *curves = (table.numbers(name) for name in table.names)
    table.refuse(~((phase >= 0) & (phase < 180)), "phase_deg", "phase angles lie from 0 to below 180 deg")
    table.refuse(np.diff(phase, prepend=-1.0) <= 0, "phase_deg", "phase angles ascend; sort the rows, keep one of each")
    if not phase[0] <= STANDARD.phase_deg <= phase[-1]:
        ends = f"{phase[0]:g} to {phase[-1]:g}"
        raise DataError(f"{source.name}: phase_deg runs from {ends}; it must contain {STANDARD.phase_deg:g} deg")
    for name, curve in zip(names, curves, strict=True):
        table.refuse(~(np.isfinite(curve) & (curve > 0)), name, "f is a number above 0 everywhere")
    return TablePhase(source.stem, source.name, phase, wavelength, np.log(np.column_stack(curves)))


LOMMEL_SEELIGER_INCIDENCE_DEG = 65.0
"""Above, Lommel-Seeliger counts as too slow; assumed, within the 57-77 deg at which `lommel_seeliger` says that it
is."""
MCEWEN_PHASE_DEG = 103.9
"""Where the polynomial of `mcewen_weight` goes through zero: McEwen (1996), Lunar Planet. Sci. XXVII, 841. [deg]"""
GRAZING_DEG = 80.0
"""Above, no disk function was compared with measurements; assumed."""


def lommel_seeliger(geometry: Geometry) -> float:
    """Lommel-Seeliger: D = mu0 / (mu0 + mu). [-]

    Light scattered once in a dark, flat, infinitely deep layer. Without shadows of relief it falls too slowly towards
    the terminator: on 23 Chang'E-4 spectra of two patches (lunar day 10, incidence 57-77 deg) it leaves 6-7 % between
    geometries of one patch whatever the phase function is.

    Hapke (2012), Theory of Reflectance and Emittance Spectroscopy, 10.1017/CBO9781139025683.
    """
    return geometry.cos_incidence / (geometry.cos_incidence + geometry.cos_emission)


def akimov(geometry: Geometry) -> float:
    """Akimov's disk function without parameters, of an extremely rough surface. [-]

    D = cos(g/2) cos[pi / (pi - g) (gamma - g/2)] (cos beta)^(g / (pi - g)) / cos gamma, with the photometric longitude
    and latitude from mu = cos beta cos gamma and mu0 = cos beta cos(gamma - g). At g = 0, where gamma is undetermined,
    D = 1. For a surface that is rough at every angle of view: not within some 10 deg of limb or terminator.

    A phase angle outside the triangle of the other two (`Geometry` lets 0.5 deg pass) is moved to its edge.

    Shkuratov et al. (2011), Planet. Space Sci. 59, 1326, 10.1016/j.pss.2011.06.011.
    """
    low, high = geometry.phase_range_deg
    phase = radians(min(max(geometry.phase_deg, low), high))
    longitude = atan2(geometry.cos_incidence - geometry.cos_emission * cos(phase), geometry.cos_emission * sin(phase))
    cos_latitude = min(geometry.cos_emission / cos(longitude), 1.0)
    stretch = pi / (pi - phase)
    rough = pow(cos_latitude, phase / (pi - phase))
    return cos(phase / 2) * cos(stretch * (longitude - phase / 2)) * rough / cos(longitude)


def mcewen(geometry: Geometry) -> float:
    """Lunar-Lambert: D = 2 L mu0 / (mu0 + mu) + (1 - L) mu0 with L from `mcewen_weight`. [-]

    McEwen (1996), A precise lunar photometric function, Lunar Planet. Sci. XXVII, 841.
    """
    weight = mcewen_weight(geometry.phase_deg)
    return 2 * weight * lommel_seeliger(geometry) + (1 - weight) * geometry.cos_incidence


def mcewen_weight(phase_deg: float) -> float:
    """Share of Lommel-Seeliger in `mcewen`: L = 1 - 0.019 g + 2.42e-4 g^2 - 1.46e-6 g^3, not below 0. [-]

    phase_deg : 0 to 180. Above 103.9 deg the polynomial is negative and D could be; as in the reduction of the SELENE
    Spectral Profiler (Kouyama et al. 2016, 10.1016/j.pss.2016.02.003), L is 0 there: Lambert's law.
    """
    return max(1 - 0.019 * phase_deg + 2.42e-4 * phase_deg**2 - 1.46e-6 * phase_deg**3, 0.0)


DISKS: dict[str, Callable[[Geometry], float]] = {
    "lommel-seeliger": lommel_seeliger,
    "akimov": akimov,
    "mcewen": mcewen,
}


def disk_function(name: str) -> Callable[[Geometry], float]:
    """The disk function of that name. Raises ParameterError for an unknown one."""
    if name not in DISKS:
        raise ParameterError(f"disk function '{name}' is unknown; choose one of: {', '.join(DISKS)}")
    return DISKS[name]


def outside(name: str, geometry: Geometry) -> str:
    """What to know when a disk function is used beyond where it is good; '' within."""
    disk_function(name)
    if name == "lommel-seeliger" and geometry.incidence_deg > LOMMEL_SEELIGER_INCIDENCE_DEG:
        return (
            f"incidence {geometry.incidence_deg:.1f} deg: above {LOMMEL_SEELIGER_INCIDENCE_DEG:g} deg Lommel-Seeliger, "
            "which knows no shadows of relief, leaves differences of 6-7 % between geometries; compare with akimov"
        )
    if name == "mcewen" and geometry.phase_deg > MCEWEN_PHASE_DEG:
        return (
            f"phase {geometry.phase_deg:.1f} deg: the weight L of McEwen's polynomial would be negative above "
            f"{MCEWEN_PHASE_DEG:g} deg and is held at 0 (Lambert)"
        )
    if name == "akimov" and max(geometry.incidence_deg, geometry.emission_deg) > GRAZING_DEG:
        return (
            f"incidence {geometry.incidence_deg:.1f} and emission {geometry.emission_deg:.1f} deg: Akimov's function "
            f"is not good above {GRAZING_DEG:g} deg, near terminator and limb"
        )
    return ""


SPREAD_PHASES = ("sp-low", "sp-mid", "sp-high")
_MOST_MODES = 2
_NEGLIGIBLE = 1e-6
_GRAZING = 1e6


def correction_factor(geometry: Geometry, wavelength_nm: FloatArray, disk: str, phase: PhaseFunction) -> FloatArray:
    """Factor from a reflectance factor (REFF) at some geometry to that at 30, 0, 30 deg, shape (n,). [-]

    cos i / cos 30 * D(30, 0, 30) / D(i, e, g) * f(30) / f(g), where RADF = REFF cos i = D f. For Lommel-Seeliger this
    is (cos i + cos e) / (cos 30 + 1) * f(30) / f(g): unlike the form for RADF it has no ratio of cosines of i.

    Parameters
    ----------
    geometry : of the observation.
    wavelength_nm : shape (n,). [nm]
    disk : `lommel-seeliger`, `akimov` or `mcewen`; `remarks` says where each is good.
    phase : the phase function, itself established with one disk function (SELENE: `mcewen`) and used with any.

    Raises
    ------
    ParameterError for an unknown disk function, or where it vanishes (incidence or emission within 0.1 deg of 90).

    Besse et al. (2013), Icarus 222, 229 (Lommel-Seeliger); Yokota et al. (2011), Icarus 215, 639.
    """
    function = disk_function(disk)
    here, standard = function(geometry), function(STANDARD)
    if not here * _GRAZING > geometry.cos_incidence:
        raise ParameterError(
            f"{disk} vanishes at incidence {geometry.incidence_deg:g}, emission {geometry.emission_deg:g}, phase "
            f"{geometry.phase_deg:g} deg; such grazing angles cannot be corrected"
        )
    level = geometry.cos_incidence / STANDARD.cos_incidence * standard / here
    return level * np.exp(-phase.log_ratio(geometry.phase_deg, wavelength_nm))


def remarks(geometry: Geometry, wavelength_nm: FloatArray, disk: str, phase: PhaseFunction) -> list[str]:
    """What a reader of the corrected spectrum should know: use of a model beyond where it is good."""
    result = (outside(disk, geometry), phase.remark(geometry.phase_deg, wavelength_nm))
    return [remark for remark in result if remark]


def model_spread(geometry: Geometry, wavelength_nm: FloatArray, disk: str, phase: PhaseFunction) -> FloatArray:
    """How far nine models of the correction lie from the one used: modes of ln factor, shape (k, n), k <= 2. [-]

    d_m = ln(factor_m / factor) for each of three disk functions with each of three SELENE phase functions, and
    C = mean of d_m d_m^T about the model used, not about their mean. A mode is an eigenvector of C times the root of
    its eigenvalue: one standard deviation that all channels share. The two largest hold more than 99 % of the trace of
    C; the second is kept however small its share, since the first is little but a level and the second is what bends
    bands (0.3-5 % where the level is 1-50 %). None are returned where all models agree (at 30, 0, 30 deg). The channel
    where a mode is largest has the positive sign.

    This is the spread between models in use, a stand-in for the unknown error of any one of them: it is not its
    statistical error, and the nine are no sample of anything. Parameters and errors as for `correction_factor`.
    """
    used = correction_factor(geometry, wavelength_nm, disk, phase)
    phases = [phase_function(name) for name in SPREAD_PHASES]
    models = [correction_factor(geometry, wavelength_nm, name, each) for name in DISKS for each in phases]
    distance = np.log(np.array(models) / used)
    _, size, shape = np.linalg.svd(distance / np.sqrt(len(models)), full_matrices=False)
    modes = (size[:, None] * shape)[:_MOST_MODES]
    modes = modes[np.abs(modes).max(axis=1) > _NEGLIGIBLE]
    largest = np.take_along_axis(modes, np.abs(modes).argmax(axis=1)[:, None], axis=1)
    return np.asarray(modes * np.sign(largest), dtype=np.float64)
