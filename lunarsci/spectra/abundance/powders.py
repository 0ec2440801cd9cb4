"""What powders of one mineral look like: a mean and the ways in which end members differ from it."""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from lunarsci.arrays import FloatArray
from lunarsci.errors import ParameterError
from lunarsci.spectra.abundance.mixing import MixingLaw
from lunarsci.spectra.readers.library import EndMember

MOST_SHAPES = 8
SPARE = 3
"""Shapes are fewer than the end members by this many."""
LEADING_SHAPES, RIDGE = 5, 0.1
"""Level as a function of the first shapes, by ridge regression: iron moves bands and deepens them. Assumed."""
OWN_LEVEL = 0.5
"""Standard deviation of a mineral's t beside what all minerals of a mixture share (its grain size); assumed."""
SINGLE_LEVEL = 0.05
"""The same where one end member is given, which then is the powder itself; assumed."""
SAME_SIEVE, UNKNOWN_SIZE = 0.1, 0.77
"""Standard deviations of the logarithm of a powder's grain size: beside those of the same sieve, and where none is
stated. Measured: cross-sections of two powders of one sieve had ratios of exp(0.07), exp(-0.10) and exp(-0.22) in
mixtures of known modes (XP-CMP of 0-45 and 75-125 um, MIX210), 0.14 by the square root of 2; the 238 embedded end
members of known size."""
REFERENCE_UM, UNKNOWN_UM = 40.0, 60.0
"""Grain size that end members are brought to, and the one taken where none is stated; the latter assumed."""
SMOOTH, SMOOTH_NM, SMOOTH_KEPT = 0.05, 150.0, 0.999
"""Standard deviation, width and share kept of what t of a real powder has beside its shapes; assumed."""
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
    share: `powders` has a level common to all, and here stay the part that goes with the first shapes and `OWN_LEVEL`.
    One end member alone is taken as the powder itself, of its own grain size: only its level varies, a little.

    Raises
    ------
    ParameterError where no end member of the mineral reaches over all channels.
    """
    own = [item for item in end_members if item.mineral == mineral]
    values = np.array([reflectance_at(item, wavelength_nm) for item in own]).reshape(len(own), wavelength_nm.size)
    there = np.isfinite(values).all(axis=1)
    if not there.any():
        raise ParameterError(
            f"no end member of {mineral} reaches from {wavelength_nm[0]:g} to {wavelength_nm[-1]:g} nm; give a library "
            "that has one, or leave the mineral out"
        )
    members = [item for item, usable in zip(own, there, strict=True) if usable]
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
    flat = np.full((1, wavelength_nm.size), OWN_LEVEL if len(level) > 1 else SINGLE_LEVEL)
    return MineralPopulation(
        mineral, len(level), mean_shape + mean_level, np.concatenate([shapes, flat]), grain_size(members)
    )


def loosened(found: MineralPopulation, wavelength_nm: FloatArray) -> MineralPopulation:
    """The law with smooth shapes beside those of its end members: many spectra show what one cannot."""
    apart = (wavelength_nm[:, None] - wavelength_nm) / SMOOTH_NM
    sizes, directions = np.linalg.eigh(SMOOTH**2 * np.exp(-0.5 * apart**2))
    sizes, directions = sizes[::-1], directions[:, ::-1]
    count = int(np.searchsorted(np.cumsum(sizes), SMOOTH_KEPT * sizes.sum())) + 1
    smooth = np.sqrt(sizes[:count, None]) * directions[:, :count].T
    return replace(found, shapes=np.concatenate([found.shapes[:-1], smooth, found.shapes[-1:]]))


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
    known = {key: value for key in USUAL if (value := getattr(item, key)) is not None}
    return 1.0 if all(USUAL[key][0] <= value <= USUAL[key][1] for key, value in known.items()) else UNUSUAL_WEIGHT


def specimen_weights(members: Sequence[EndMember]) -> FloatArray:
    """Weights that sum to 1: unusual compositions less, powders of one specimen together less than their number."""
    siblings = [sum(item.specimen == other.specimen != "" for other in members) or 1 for item in members]
    weight = np.array([usual_weight(item) for item in members]) / np.array(siblings) ** SPECIMEN_POWER
    return np.asarray(weight / weight.sum())


COMMON_LEVEL = 1.0
"""Standard deviation of the level that all minerals of a mixture share, their grain size; assumed."""


@dataclass(frozen=True, eq=False)
class Powders:
    """Powders of the minerals as functions of standard normal parameters: shapes of each, grain sizes, then the level.

    Grains that are coarser by a factor offer less cross-section per volume by the same factor: those of an only end
    member as it states (`grain_size`); and a mineral whose own level is raised by d is coarser by e^d in `Albedo`
    (`section` of the law).
    """

    law: MixingLaw
    minerals: Sequence[MineralPopulation]

    @cached_property
    def size(self) -> int:
        """Number of parameters."""
        return sum(len(item.shapes) for item in self.minerals) + int(self._grains[1].shape[1]) + 1

    @cached_property
    def _grains(self) -> tuple[FloatArray, FloatArray]:
        return grains([item.grain_size for item in self.minerals])

    @cached_property
    def starts(self) -> list[int]:
        """Position of each mineral's first parameter."""
        counts = [len(item.shapes) for item in self.minerals]
        return [sum(counts[:i]) for i in range(len(counts))]

    @property
    def common(self) -> float:
        """Derivative of every t by the last parameter, the level of all."""
        return COMMON_LEVEL

    def at(self, shared: FloatArray) -> tuple[FloatArray, FloatArray]:
        """x of each mineral and dx / dt, both (m, n)."""
        level = shared[-1] * self.common
        pairs = [
            self.law.mixing(item.mean + shared[start : start + len(item.shapes)] @ item.shapes + level)
            for start, item in zip(self.starts, self.minerals, strict=True)
        ]
        x, slope = (np.array(part) for part in zip(*pairs, strict=True))
        return x, slope

    @cached_property
    def sections(self) -> FloatArray:
        """Derivative of the logarithm of each mineral's cross-section per volume by the parameters, (m, size)."""
        rows = np.zeros((len(self.minerals), self.size))
        for row, start, item in zip(rows, self.starts, self.minerals, strict=True):
            row[start + len(item.shapes) - 1] = -self.law.section * item.shapes[-1, 0]
        _, apart = self._grains
        rows[:, self.size - 1 - apart.shape[1] : -1] = -apart
        return rows

    def section(self, shared: FloatArray) -> FloatArray:
        """Cross-section per volume of each mineral, 1 for grains of `REFERENCE_UM`, (m,)."""
        return np.asarray(np.exp(self.sections @ shared - self._grains[0]))

    def by_parameters(self, slope: FloatArray) -> list[tuple[slice, FloatArray]]:
        """Where each mineral's own parameters stand, and dx of that mineral by them, (k, n)."""
        return [
            (slice(start, start + len(item.shapes)), row * item.shapes)
            for start, item, row in zip(self.starts, self.minerals, slope, strict=True)
        ]
