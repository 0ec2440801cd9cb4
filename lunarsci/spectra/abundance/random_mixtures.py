"""Random mixtures: what spectra the minerals of a library, darkened or not, can give.

A draw has shares of the minerals from the law of a kind of rock (`RockType`), for each mineral a powder between two end
members (or the only one, of the grain size that it states), grain sizes, and what is dark beside the minerals: an
opaque phase, metal and troilite or glass as a further powder, submicroscopic iron on all grains. Mixing is that of
`mixing`.

Sources: mixing Hapke (1981), 10.1029/JB086iB04p03039; iron below 50 nm, which reddens, Hapke (2001),
10.1029/2000JE001338; larger iron, which only darkens, Lucey & Riner (2011), 10.1016/j.icarus.2010.12.004.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np

from lunarsci.arrays import FloatArray, IntArray
from lunarsci.errors import ParameterError
from lunarsci.spectra.abundance.mixing import MixingLaw, iron_absorption
from lunarsci.spectra.abundance.powders import grain_size, grains, ln_size, reflectance_at, specimen_weights
from lunarsci.spectra.library.end_member import EndMember

PHASES = ("none", "opaque", "metal-troilite", "glass")
IRON = ("none", "nanophase", "larger")
"""What darkens beside the minerals: a further powder, and iron on all grains."""
OWN_SIZE, COMMON_SIZE = 0.4, 0.6
"""Standard deviations of the logarithm of grain size: of one mineral beside the others, of all together; assumed."""
BLENDED = 0.5
"""Share of draws whose powder lies between two end members; the others are one; assumed."""
OPAQUE_ALBEDO, RED_POWER = (0.04, 0.2), (0.2, 1.0)
"""Range of the albedo of opaque phases at 1 um, and of the power of wavelength with which that of metal and troilite
rises; Britt & Pieters (1994), 10.1016/0016-7037(94)90288-7 show both; the ranges are assumed."""
GLASS_ALBEDO, GLASS_POWER, GLASS_DEPTH = (0.3, 0.7), (0.2, 0.8), (0.0, 0.3)
"""Albedo of glass at 1 um, power of wavelength with which it rises, and depth of its bands; assumed."""
GLASS_BANDS_UM = ((1.08, 0.16, 1.0), (1.9, 0.3, 0.6))
"""Centre, standard deviation and relative depth of the bands of iron in glass: Bell, Mao & Weeks (1976), Proc. Lunar
Sci. Conf. 7, 2543; widths and ranges assumed."""
AT_ONCE = 1000
"""Draws that are mixed together; as many as stay in the processor's cache."""
LN_IRON, LN_IRON_SPREAD = -2.0, 1.2
"""Logarithm of the absorption that iron adds at 1000 nm, in units of (1 - w) / w; assumed."""


@dataclass(frozen=True, slots=True)
class RockType:
    """What a kind of rock may hold.

    Attributes
    ----------
    name, weight : how often it is drawn.
    concentration : of a Dirichlet law of the shares, by mineral; 1 where none is given.
    leading : where above 0, concentration of one mineral, any, that leads the others.
    dark, dark_share : probability of a dark powder, and range of its share of the cross-section.
    iron : probability of submicroscopic iron.
    chemistry : by mineral a component and its range in mole fractions, from which end members are taken.
    source : of these.
    """

    name: str
    weight: float
    concentration: Mapping[str, float] = field(default_factory=dict)
    leading: float = 0.0
    dark: float = 0.5
    dark_share: tuple[float, float] = (0.005, 0.5)
    iron: float = 0.3
    chemistry: Mapping[str, tuple[str, float, float]] = field(default_factory=dict)
    source: str = "assumed"

    def shares(self, minerals: Sequence[str], count: int, rng: np.random.Generator) -> FloatArray:
        """Random shares of the minerals, (count, m); they sum to 1."""
        base = 0.4 if self.leading else 1.0
        law = np.tile([self.concentration.get(name, base) for name in minerals], (count, 1))
        if self.leading:
            law[np.arange(count), rng.integers(0, len(minerals), count)] = self.leading
        drawn = rng.gamma(law) + 1e-12
        return np.asarray(drawn / drawn.sum(axis=1, keepdims=True))


@dataclass(frozen=True, slots=True, eq=False)
class RandomMixtures:
    """Draws, and the spectra that they give.

    Attributes
    ----------
    minerals : m names.
    shares : (n, m) by volume, which sum to 1. [-]
    ln_reflectance : (n, c)
    rock_type, phase, iron : (n,) place in the rock types, in `PHASES`, in `IRON`.
    dark_share : (n,) share of the dark powder in the cross-section. [-]
    """

    minerals: tuple[str, ...]
    shares: FloatArray
    ln_reflectance: FloatArray
    rock_type: IntArray
    phase: IntArray
    iron: IntArray
    dark_share: FloatArray

    @classmethod
    def joined(cls, parts: "Sequence[RandomMixtures]") -> "RandomMixtures":
        """All draws of several."""
        names = ("shares", "ln_reflectance", "rock_type", "phase", "iron", "dark_share")
        return cls(parts[0].minerals, *(np.concatenate([getattr(part, name) for part in parts]) for name in names))


@dataclass(frozen=True, slots=True)
class Darkening:
    """What may be dark: phases and iron by their places; all of them where none is stated."""

    phases: tuple[int, ...] = (1, 2, 3)
    iron: tuple[int, ...] = (1, 2)
    phase_stated: bool = False
    iron_stated: bool = False


def random_mixtures(
    minerals: Sequence[str],
    end_members: Sequence[EndMember],
    wavelength_nm: FloatArray,
    laws: Sequence[MixingLaw],
    rock_types: Sequence[RockType],
    count: int,
    *,
    darkening: Darkening | None = None,
    seed: int = 0,
) -> RandomMixtures:
    """Draw mixtures of the minerals, in equal parts by each law.

    Parameters
    ----------
    minerals : of the end members, two or more.
    wavelength_nm : (c,) channels. [nm]
    count : about how many are drawn.

    Raises
    ------
    ParameterError where a mineral has no end member over all channels.
    """
    rng = np.random.default_rng(seed)
    total = sum(item.weight for item in rock_types) * len(laws)
    parts = []
    for law in laws:
        powders = [_Powders.of(name, end_members, wavelength_nm, law) for name in minerals]
        for place, rock in enumerate(rock_types):
            number = round(count * rock.weight / total)
            for start in range(0, number, AT_ONCE):
                some = min(AT_ONCE, number - start)
                drawn = rock.shares(minerals, some, rng)
                dark = _Dark.drawn(rock, some, darkening or Darkening(), rng)
                ln_reflectance = _mixed(powders, drawn, rock, dark, law, wavelength_nm, rng)
                types = np.full(some, place)
                parts.append(
                    RandomMixtures(tuple(minerals), drawn, ln_reflectance, types, dark.phase, dark.iron, dark.share)
                )
    return RandomMixtures.joined(parts)


@dataclass(frozen=True, slots=True, eq=False)
class _Powders:
    """End members of one mineral: t of one grain size (k, n), and weights (k,)."""

    members: list[EndMember]
    element: FloatArray
    weight: FloatArray

    @classmethod
    def of(
        cls, mineral: str, end_members: Sequence[EndMember], wavelength_nm: FloatArray, law: MixingLaw
    ) -> "_Powders":
        own = [item for item in end_members if item.mineral == mineral]
        values = np.array([reflectance_at(item, wavelength_nm) for item in own]).reshape(len(own), wavelength_nm.size)
        there = np.isfinite(values).all(axis=1)
        if not there.any():
            raise ParameterError(f"no end member of {mineral} reaches over all channels; give a library that has one")
        members = [item for item, usable in zip(own, there, strict=True) if usable]
        size = np.array([0.0 if len(members) == 1 else ln_size(item) for item in members])
        element = law.element(values[there]) - law.size_exponent * size[:, None]
        return cls(members, element, specimen_weights(members))

    def drawn(self, count: int, rock: RockType, rng: np.random.Generator) -> FloatArray:
        """t of random powders, (count, n)."""
        weight = self.weight * np.array([_suits(item, rock) for item in self.members])
        weight = weight / weight.sum() if weight.sum() > 0 else self.weight / self.weight.sum()
        one, other = (rng.choice(len(weight), count, p=weight) for _ in range(2))
        part = np.where(rng.random(count) < BLENDED, rng.random(count), 0.0)[:, None]
        return np.asarray(self.element[one] * (1 - part) + self.element[other] * part)


UNKNOWN_CHEMISTRY = 0.1
"""Weight of an end member without an analysis where a rock type asks for one; assumed."""


def _suits(item: EndMember, rock: RockType) -> float:
    if item.mineral is None or item.mineral not in rock.chemistry:
        return 1.0
    key, low, high = rock.chemistry[item.mineral]
    value = getattr(item, key)
    return UNKNOWN_CHEMISTRY if value is None else float(low <= value <= high)


@dataclass(frozen=True, slots=True, eq=False)
class _Dark:
    """Dark powder and iron of each draw."""

    phase: IntArray
    share: FloatArray
    iron: IntArray
    absorption: FloatArray
    rng: np.random.Generator

    @classmethod
    def drawn(cls, rock: RockType, count: int, allowed: Darkening, rng: np.random.Generator) -> "_Dark":
        is_dark = rng.random(count) < (1.0 if allowed.phase_stated else rock.dark)
        phase = np.where(is_dark, rng.choice(allowed.phases, count), 0)
        share = np.where(
            is_dark, np.exp(rng.uniform(np.log(rock.dark_share[0]), np.log(rock.dark_share[1]), count)), 0.0
        )
        has_iron = rng.random(count) < (1.0 if allowed.iron_stated else rock.iron)
        iron = np.where(has_iron, rng.choice(allowed.iron, count), 0)
        absorption = np.where(has_iron, np.exp(rng.normal(LN_IRON, LN_IRON_SPREAD, count)), 0.0)
        return cls(phase, share, iron, absorption, rng)

    def reflecting(self, wavelength_nm: FloatArray) -> FloatArray:
        """Albedo of the dark powder, (count, n)."""
        um, count, rng = wavelength_nm / 1e3, len(self.phase), self.rng
        glass = self.phase == PHASES.index("glass")
        level = np.where(glass, rng.uniform(*GLASS_ALBEDO, count), rng.uniform(*OPAQUE_ALBEDO, count))
        power = np.where(glass, rng.uniform(*GLASS_POWER, count), rng.uniform(*RED_POWER, count))
        power = np.where(self.phase == PHASES.index("opaque"), 0.0, power)
        depth = np.where(glass, rng.uniform(*GLASS_DEPTH, count), 0.0)
        band = sum(part * np.exp(-0.5 * ((um - center) / width) ** 2) for center, width, part in GLASS_BANDS_UM)
        return np.asarray(np.minimum(level[:, None] * um ** power[:, None] * (1 - depth[:, None] * band), 0.95))

    def iron_absorption(self, wavelength_nm: FloatArray) -> FloatArray:
        """Added to (1 - w) / w, (count, n): by nanophase iron falling with wavelength, by larger iron the same."""
        reddens = (self.iron == IRON.index("nanophase"))[:, None]
        return np.asarray(self.absorption[:, None] * np.where(reddens, iron_absorption(wavelength_nm), 1.0))


def _mixed(
    powders: Sequence[_Powders],
    shares: FloatArray,
    rock: RockType,
    dark: _Dark,
    law: MixingLaw,
    wavelength_nm: FloatArray,
    rng: np.random.Generator,
) -> FloatArray:
    """ln R of the draws."""
    count = len(shares)
    common = rng.normal(0.0, COMMON_SIZE, count)
    stated, apart = grains([grain_size(powder.members) for powder in powders])
    coarser = stated + rng.standard_normal((count, apart.shape[1])) @ apart.T
    mixed, section = np.zeros((count, wavelength_nm.size)), np.zeros(count)
    for place, powder in enumerate(powders):
        own = rng.normal(0.0, OWN_SIZE, count)
        size = law.size_exponent * (own + common)
        part = shares[:, place] * np.exp(-law.section * own - coarser[:, place])
        mixed += part[:, None] * law.mixing(powder.drawn(count, rock, rng) + size[:, None])[0]
        section += part
    kept = 1.0 - dark.share[:, None]
    mixed = kept * mixed / section[:, None] + (1.0 - kept) * law.of_albedo(dark.reflecting(wavelength_nm))
    albedo = 1.0 / (1.0 / law.to_albedo(mixed) + dark.iron_absorption(wavelength_nm))
    return np.asarray(np.log(law.surface.reflectance(albedo)))
