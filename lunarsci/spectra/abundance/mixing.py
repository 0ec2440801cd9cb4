"""How powders mix, in single-scattering albedo (Hapke) or in -ln R (absorbance), and how powders of a mineral vary.

Hapke (1981), J. Geophys. Res. 86, 3039, 10.1029/JB086iB04p03039.

Every law has a quantity x that mixes linearly by volume, and its own t, which grows by a constant where all absorption
grows by a factor: a coarser powder of one mineral is, nearly, the same t moved up by `size_exponent` times the
logarithm of the grain size. Series of sieved powders (RELAB PE-CMP, PP-CMP; USGS PYX02, GDS70; 7-180 um) give 0.8-1.2
in `Albedo` and 0.4-0.6 in `Absorbance`. Powders of one mineral are a mean t and the ways in which end members differ
from it.

Iron particles far smaller than the wavelength darken and redden a mixture: they add 36 pi phi z / L to the absorption
coefficient of a grain, with z = n^3 n_Fe k_Fe / ((n_Fe^2 - k_Fe^2 + 2 n^2)^2 + (2 n_Fe k_Fe)^2), n the index of the
grain and L the wavelength: Hapke (2001), J. Geophys. Res. 106, 10039, 10.1029/2000JE001338. Here it is added to
(1 - w) / w, which is nearly the absorption coefficient times the grain size.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import TypeAlias

import numpy as np

from lunarsci.arrays import FloatArray
from lunarsci.errors import ParameterError
from lunarsci.io.tables import table_rows
from lunarsci.spectra.readers.library import EndMember

IRON_TABLE = "iron_optical_constants.csv"
GRAIN_INDEX = 1.7
"""Refractive index of the silicate around the iron: olivine and pyroxenes have 1.64 to 1.77 with little iron, Deer,
Howie & Zussman (1992), An Introduction to the Rock-Forming Minerals, Longman."""
UNIT_NM = 1000.0
TYPICAL_LN, SPREAD_LN = -1.0, 1.5
"""Mean and standard deviation of the logarithm of the absorption added at 1000 nm, in units of (1 - w) / w; assumed."""


def iron_absorption(wavelength_nm: FloatArray) -> FloatArray:
    """Absorption of submicroscopic iron, 1 at 1000 nm, from 450 to 2500 nm. [-]"""
    rows = [tuple(map(float, row.values())) for row in table_rows(IRON_TABLE)]
    table_nm, index, extinction = (np.array(column) for column in list(zip(*rows, strict=True))[:3])

    def at(wanted: FloatArray) -> FloatArray:
        n_fe, k_fe = np.interp(wanted, table_nm, index), np.interp(wanted, table_nm, extinction)
        below = (n_fe**2 - k_fe**2 + 2 * GRAIN_INDEX**2) ** 2 + (2 * n_fe * k_fe) ** 2
        return np.asarray(n_fe * k_fe / below / wanted)

    return at(wavelength_nm) / at(np.array([UNIT_NM]))


@dataclass(frozen=True, slots=True, eq=False)
class Weathering:
    """Absorption by iron on given channels, `absorption` (n,), 1 at 1000 nm; its amount is exp(-1 + 1.5 z), with z
    standard normal. [-]"""

    absorption: FloatArray

    def darken(self, albedo: FloatArray, amount: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Albedo with iron, its derivative by the one without, and by z; (s, n) each, from (s, n) and (s,)."""
        added = np.exp(TYPICAL_LN + SPREAD_LN * amount)[:, None] * self.absorption
        darkened = 1.0 / (1.0 / albedo + added)
        return darkened, (darkened / albedo) ** 2, -(darkened**2) * added * SPREAD_LN


TABLE = 4001
"""Values of gamma = (1 - w)^(1/2) at which the inverse is tabulated: 1e-7 of w between them."""


@dataclass(frozen=True)
class HapkeSurface:
    """A powder of grains that scatter alike to all sides, seen without opposition effect and correction for filling.

    The reflectance factor is  R = w H(m0) H(m) / (4 (m0 + m)),  H(x) = (1 + 2 x) / (1 + 2 x (1 - w)^(1/2)),  m0 and m
    the cosines of incidence and emission, below 90. [deg]
    """

    incidence_deg: float = 30.0
    emission_deg: float = 0.0

    def reflectance(self, albedo: FloatArray) -> FloatArray:
        """Reflectance factor of single-scattering albedos, 0 to 1, any shape. [-]"""
        mu0, mu = (math.cos(math.radians(angle)) for angle in (self.incidence_deg, self.emission_deg))
        gamma = np.sqrt(1.0 - np.asarray(albedo, dtype=np.float64))
        both = math.prod((1.0 + 2.0 * x) / (1.0 + 2.0 * x * gamma) for x in (mu0, mu))
        return np.asarray(albedo / (4.0 * (mu0 + mu)) * both)

    @cached_property
    def _table(self) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Ascending albedos, ln R of them and d ln R / dw."""
        gamma = np.linspace(1.0, 0.0, TABLE)[1:]
        albedo = 1.0 - gamma**2
        ln_reflectance = np.log(self.reflectance(albedo))
        return albedo, ln_reflectance, np.gradient(ln_reflectance, albedo)

    def albedo(self, reflectance: FloatArray) -> FloatArray:
        """Single-scattering albedo of reflectance factors above 0; those above that of w = 1 give 1. [-]"""
        albedo, ln_reflectance, _ = self._table
        return np.interp(np.log(reflectance), ln_reflectance, albedo)

    def ln_reflectance(self, albedo: FloatArray) -> tuple[FloatArray, FloatArray]:
        """ln R and its derivative by the albedo, by interpolation."""
        table, ln_reflectance, slope = self._table
        return np.interp(albedo, table, ln_reflectance), np.interp(albedo, table, slope)


LEAST, MOST = 1e-5, 1.0 - 1e-5
BRIGHTEST = 0.999
"""Reflectance from which on a powder counts as this bright: absorbance must stay above 0. Assumed."""


@dataclass(frozen=True, eq=False)
class Albedo:
    """x is the single-scattering albedo w, which adds by cross-section: by volume where grains are of one size;
    t = ln((1 - w) / w).

    `size_exponent` : by how much t grows with the logarithm of the grain size; `section` : by how much the logarithm of
    cross-section per volume falls with t of coarser grains. `element` is t of the reflectance of one mineral's powder;
    `mixing` x of t and dx / dt; `ln_reflectance` ln R of x and d ln R / dx; arrays of any shape.

    Mustard & Pieters (1989), J. Geophys. Res. 94, 13619, 10.1029/JB094iB10p13619.
    """

    surface: HapkeSurface
    name: str = "hapke"
    size_exponent: float = 1.0
    section: float = 1.0

    def element(self, reflectance: FloatArray) -> FloatArray:
        albedo = np.clip(self.surface.albedo(reflectance), LEAST, MOST)
        return np.asarray(np.log((1.0 - albedo) / albedo))

    def mixing(self, element: FloatArray) -> tuple[FloatArray, FloatArray]:
        albedo = 1.0 / (1.0 + np.exp(element))
        return albedo, -albedo * (1.0 - albedo)

    def ln_reflectance(self, mixed: FloatArray) -> tuple[FloatArray, FloatArray]:
        return self.surface.ln_reflectance(np.clip(mixed, LEAST, MOST))


@dataclass(frozen=True, eq=False)
class Absorbance:
    """As `Albedo`: x is the apparent absorbance -ln R; t = ln x. No theory of scattering, but near the truth for bright
    powders.

    Clark & Roush (1984), J. Geophys. Res. 89, 6329, 10.1029/JB089iB07p06329 (apparent absorbance).
    """

    name: str = "absorbance"
    size_exponent: float = 0.5
    section: float = 0.0

    def element(self, reflectance: FloatArray) -> FloatArray:
        return np.asarray(np.log(-np.log(np.clip(reflectance, LEAST, BRIGHTEST))))

    def mixing(self, element: FloatArray) -> tuple[FloatArray, FloatArray]:
        absorbance = np.exp(element)
        return absorbance, absorbance

    def ln_reflectance(self, mixed: FloatArray) -> tuple[FloatArray, FloatArray]:
        return -mixed, np.full_like(mixed, -1.0)


MixingLaw: TypeAlias = Albedo | Absorbance


def mixing_laws(method: str, *, iron: bool = False) -> tuple[MixingLaw, ...]:
    """The laws that a method compares; iron needs `hapke`. Raises ParameterError for another method."""
    hapke, absorbance = Albedo(HapkeSurface()), Absorbance()
    laws: dict[str, tuple[MixingLaw, ...]] = {"hapke": (hapke,), "unmix": (hapke,) if iron else (hapke, absorbance)}
    laws |= {} if iron else {"absorbance": (absorbance,)}
    if method not in laws:
        raise ParameterError(f"method '{method}'; give one of {', '.join(laws)}")
    return laws[method]


MOST_SHAPES = 8
SPARE = 3
"""Shapes are fewer than the end members by this many."""
LEADING_SHAPES, RIDGE = 5, 0.1
"""Level as a function of the first shapes, by ridge regression: iron moves bands and deepens them. Assumed."""
MINERAL_LEVEL = 0.5
"""Standard deviation of a mineral's t beside what all minerals of a mixture share (its grain size); assumed."""
SAME_SIEVE, UNKNOWN_SIZE = 0.1, 0.77
"""Standard deviations of the logarithm of a powder's grain size: beside those of the same sieve, and where none is
stated. Measured: cross-sections of two powders of one sieve had ratios of exp(0.07), exp(-0.10) and exp(-0.22) in
mixtures of known modes (XP-CMP of 0-45 and 75-125 um, MIX210), 0.14 by the square root of 2; the 238 embedded end
members of known size."""
REFERENCE_UM, UNKNOWN_UM = 40.0, 60.0
"""Grain size that end members are brought to, and the one taken where none is stated; the latter assumed."""
SMOOTH, SMOOTH_NM, SMOOTH_SHARE = 0.05, 150.0, 0.999
"""Standard deviation, width and share kept of what t of a real powder has beside its shapes, or beside the only end
member; assumed."""
UNUSUAL_WEIGHT = 0.3
"""Weight of such an end member; assumed."""
SPECIMEN_POWER = 0.7
"""Powders of one specimen weigh together as their number to the power 1 - 0.7; assumed."""
USUAL = {"fo": (0.4, 1.0), "fs": (0.03, 0.6)}
"""Mole fractions outside these are rare on the Moon and count `UNUSUAL_WEIGHT`; assumed."""


@dataclass(frozen=True, slots=True)
class GrainSize:
    """Of the powder that t stands for: logarithm over `REFERENCE_UM`, its standard deviation, and the sieve, if any."""

    ln_size: float = 0.0
    sigma: float = 0.0
    sieve_um: tuple[float, float] | None = None


@dataclass(frozen=True, slots=True, eq=False)
class MineralPopulation:
    """Normal law of t (see `mixing`) of a mineral's powders.

    Attributes
    ----------
    mineral, count : name, and number of end members it was made from.
    mean : (n,) t of the mean powder.
    shapes : (k, n) shifts of t by one standard deviation each, independent of each other; the last is the level.
    grain_size : of these powders.
    """

    mineral: str
    count: int
    mean: FloatArray
    shapes: FloatArray
    grain_size: GrainSize


def population(
    mineral: str, end_members: Sequence[EndMember], wavelength_nm: FloatArray, law: MixingLaw
) -> MineralPopulation:
    """The law of a mineral, from one end member or many.

    t of every end member is brought to `REFERENCE_UM` first. Then follows a principal component analysis of t less its
    mean over the channels, the level. Levels of powders differ mostly by grain size, which the minerals of one mixture
    share: `powders` has a level common to all. Here stay the part that goes with the first shapes, and `MINERAL_LEVEL`.
    One end member alone is taken as the powder itself, of its own grain size: only its level varies, a little.

    Raises
    ------
    ParameterError where no end member of the mineral reaches over all channels.
    """
    powders = [item for item in end_members if item.mineral == mineral]
    values = np.array([reflectance_at(item, wavelength_nm) for item in powders]).reshape(
        len(powders), wavelength_nm.size
    )
    there = np.isfinite(values).all(axis=1)
    if not there.any():
        raise ParameterError(
            f"no end member of {mineral} reaches from {wavelength_nm[0]:g} to {wavelength_nm[-1]:g} nm; give a library "
            "that has one, or leave the mineral out"
        )
    members = [item for item, usable in zip(powders, there, strict=True) if usable]
    coarser = np.array([0.0 if len(members) == 1 else ln_size(item) for item in members])
    element = law.element(values[there]) - law.size_exponent * coarser[:, None]
    weight = specimen_weights(members)
    level = element.mean(axis=1)
    apart = element - level[:, None]
    mean_shape, mean_level = weight @ apart, float(weight @ level)
    centred = apart - mean_shape
    _, sizes, directions = np.linalg.svd(centred * np.sqrt(weight)[:, None], full_matrices=False)
    count = max(0, min(MOST_SHAPES, len(level) - SPARE))
    shapes = sizes[:count, None] * directions[:count]
    if count:
        lead = min(LEADING_SHAPES, count)
        scores = centred @ directions[:lead].T / sizes[:lead]
        normal = scores.T @ (weight[:, None] * scores) + RIDGE * np.eye(lead)
        shapes[:lead] += np.linalg.solve(normal, scores.T @ (weight * (level - mean_level)))[:, None]
    flat = np.full((1, wavelength_nm.size), MINERAL_LEVEL if len(level) > 1 else SMOOTH)
    return MineralPopulation(
        mineral, len(level), mean_shape + mean_level, np.concatenate([shapes, flat]), grain_size(members)
    )


def loosened(law: MineralPopulation, wavelength_nm: FloatArray) -> MineralPopulation:
    """The law with smooth shapes beside those of its end members: many spectra show what one cannot."""
    apart = (wavelength_nm[:, None] - wavelength_nm) / SMOOTH_NM
    sizes, directions = np.linalg.eigh(SMOOTH**2 * np.exp(-0.5 * apart**2))
    sizes, directions = sizes[::-1], directions[:, ::-1]
    count = int(np.searchsorted(np.cumsum(sizes), SMOOTH_SHARE * sizes.sum())) + 1
    smooth = np.sqrt(sizes[:count, None]) * directions[:, :count].T
    return replace(law, shapes=np.concatenate([law.shapes[:-1], smooth, law.shapes[-1:]]))


def ln_size(item: EndMember) -> float:
    """Logarithm of the grain size over `REFERENCE_UM`."""
    if not item.max_um:
        return math.log(UNKNOWN_UM / REFERENCE_UM)
    return math.log(((item.min_um or 0.0) + item.max_um) / 2 / REFERENCE_UM)


def grain_size(members: Sequence[EndMember]) -> GrainSize:
    """That of an only end member; several are brought to `REFERENCE_UM`, which says little if most state no size."""
    stated = [item for item in members if item.max_um]
    if len(members) > 1:
        return GrainSize(sigma=UNKNOWN_SIZE if 2 * len(stated) < len(members) else 0.0)
    size = ln_size(members[0])
    if not stated:
        return GrainSize(size, UNKNOWN_SIZE)
    return GrainSize(size, SAME_SIEVE, (stated[0].min_um or 0.0, stated[0].max_um or 0.0))


def grains(sizes: Sequence[GrainSize]) -> tuple[FloatArray, FloatArray]:
    """Logarithms of the grain sizes of minerals, (m,), and their independent deviations, (m, k).

    Grains of any diameter within a sieve are taken as alike in number; powders of one sieve share what it leaves open.
    """
    sieves = sorted({item.sieve_um for item in sizes if item.sieve_um})
    apart = np.zeros((len(sizes), len(sizes) + len(sieves)))
    for row, item in enumerate(sizes):
        apart[row, row] = item.sigma
        if item.sieve_um:
            low, high = item.sieve_um
            apart[row, len(sizes) + sieves.index(item.sieve_um)] = (high - low) / (high + low) / math.sqrt(3)
    return np.array([item.ln_size for item in sizes]), apart[:, apart.any(axis=0)]


def reflectance_at(item: EndMember, wavelength_nm: FloatArray) -> FloatArray:
    """Reflectance between the channels where it is above 0, NaN beyond them."""
    there = item.reflectance > 0
    if not there.any():
        return np.full(wavelength_nm.size, np.nan)
    return np.interp(wavelength_nm, item.wavelength_nm[there], item.reflectance[there], left=np.nan, right=np.nan)


def usual_weight(item: EndMember) -> float:
    """1, or `UNUSUAL_WEIGHT` for a composition that is rare on the Moon."""
    given = {key: value for key in USUAL if (value := getattr(item, key)) is not None}
    return 1.0 if all(USUAL[key][0] <= value <= USUAL[key][1] for key, value in given.items()) else UNUSUAL_WEIGHT


def specimen_weights(members: Sequence[EndMember]) -> FloatArray:
    """Weights that sum to 1: unusual compositions less, powders of one specimen together less than their number."""
    siblings = [sum(item.specimen == other.specimen != "" for other in members) or 1 for item in members]
    weight = np.array([usual_weight(item) for item in members]) / np.array(siblings) ** SPECIMEN_POWER
    return np.asarray(weight / weight.sum())


@dataclass(frozen=True, eq=False)
class Powders:
    """Powders of the minerals as functions of standard normal parameters: shapes of each, grain sizes, then the level.

    The level, which all minerals of a mixture share, is their grain size: a standard deviation of 1 in t, assumed.
    Grains that are coarser by a factor offer less cross-section per volume by the same factor: those of an only end
    member as it states (`grain_size`); and a mineral whose own level is raised by d is coarser by e^d in `Albedo`
    (`section` of the law).

    Attributes
    ----------
    places : of the parameters of each mineral's shapes, among all (size,).
    sections : derivatives of the logarithm of each mineral's cross-section per volume by the parameters, (m, size).
    """

    law: MixingLaw
    minerals: Sequence[MineralPopulation]

    @cached_property
    def places(self) -> list[slice]:
        ends = np.cumsum([len(item.shapes) for item in self.minerals]).tolist()
        return [slice(end - len(item.shapes), end) for end, item in zip(ends, self.minerals, strict=True)]

    @cached_property
    def _grains(self) -> tuple[FloatArray, FloatArray]:
        return grains([item.grain_size for item in self.minerals])

    @property
    def size(self) -> int:
        """Number of parameters."""
        return int(self.places[-1].stop + self._grains[1].shape[1]) + 1

    def at(self, shared: FloatArray) -> tuple[FloatArray, FloatArray]:
        """x of each mineral and dx / dt, both (m, n)."""
        pairs = zip(self.places, self.minerals, strict=True)
        mixed = [self.law.mixing(item.mean + shared[place] @ item.shapes + shared[-1]) for place, item in pairs]
        x, slope = (np.array(part) for part in zip(*mixed, strict=True))
        return x, slope

    @cached_property
    def sections(self) -> FloatArray:
        _, apart = self._grains
        rows = np.zeros((len(self.minerals), self.size))
        for row, place, item in zip(rows, self.places, self.minerals, strict=True):
            row[place.stop - 1] = -self.law.section * item.shapes[-1, 0]
        rows[:, self.size - 1 - apart.shape[1] : -1] = -apart
        return rows

    def section(self, shared: FloatArray) -> FloatArray:
        """Cross-section per volume of each mineral, 1 for grains of `REFERENCE_UM`, (m,)."""
        return np.asarray(np.exp(self.sections @ shared - self._grains[0]))
