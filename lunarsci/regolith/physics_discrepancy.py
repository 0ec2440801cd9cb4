"""What the physics of the twin's drives is off by beside the soil: shares of the way and of wheel states, learned.

A soil found by one drive holds what the twin's law could make of it. The next drive misses by what it could not: the
rover comes less or more far, and to the side, by a share of the way that stays alike over metres. How large such shares
are is itself known from few drives, so that their variance has a law, and they are Student's t: heavy-tailed while few.
"""

import math
from collections.abc import Mapping
from dataclasses import asdict, dataclass, field, replace
from typing import Any

import numpy as np
from scipy.special import polygamma, psi, stdtrit

from lunarsci.arrays import FloatArray
from lunarsci.ranges import POSITIVE, check_each, refuse

AXES = ("along", "across")
"""Of the way: ahead, and to the left."""
SHARED = ("sinkage_m", "drawbar_pull_n", "lateral_force_n")
"""Quantities of the wheels with a share of their own. Slip and side slip follow from those of the way."""
FEWEST_DEGREES, MOST_DEGREES = 2.5, 40.0
"""Of freedom: below 2 there is no variance, and drives on other ground are never all alike; assumed."""
DEGREES = f"[{FEWEST_DEGREES}, {MOST_DEGREES}]"
"""The same as a range that is checked."""
WAY_TO_STATE_ERROR, STATE_DRIVES = 0.6, 5.0
"""Share of the way that the next drive is off by, over the share of its states that a drive left unexplained [-], and
how many drives that counts as at most; measured: see `FIRST`."""
GRID, REACH = 41, 8.0
"""Points over the logarithm of a variance, and how many of its standard deviations they reach to either side."""


@dataclass(frozen=True, slots=True)
class VarianceLaw:
    """Scaled inverse chi-square law of the variance of a share: variance = degrees scale^2 / chi^2(degrees).

    Attributes
    ----------
    degrees : of freedom, 2.5 to 40: about how many drives it rests on.
    scale : typical size of the share, > 0. [-]

    A share whose variance has this law is `scale` times Student's t (Gelman et al. 2013, Bayesian Data Analysis, 3rd
    ed., ch. 2.6). Raises ParameterError.
    """

    degrees: float
    scale: float

    def __post_init__(self) -> None:
        check_each("a discrepancy's", self, {"degrees": DEGREES, "scale": POSITIVE})

    @property
    def variance(self) -> float:
        """Of the share, tails included. [-]"""
        return self.scale**2 * self.degrees / (self.degrees - 2.0)

    def half_width(self, probability: float) -> float:
        """The share that is not exceeded to either side with this probability. [-]"""
        return float(self.scale * stdtrit(self.degrees, 0.5 + 0.5 * probability))

    def sizes(self, count: int, random: np.random.Generator) -> FloatArray:
        """Standard deviations drawn from the law. (count,) [-]"""
        return np.asarray(self.scale * np.sqrt(self.degrees / random.chisquare(self.degrees, count)))

    def grid(self) -> tuple[FloatArray, FloatArray]:
        """Logarithms of variances, and ln of their density up to a constant. (GRID,), (GRID,)"""
        spread = float(np.sqrt(polygamma(1, 0.5 * self.degrees)))
        ln_variance = 2.0 * math.log(self.scale) + spread * np.linspace(-REACH, REACH, GRID)
        density = -0.5 * self.degrees * (ln_variance + self.scale**2 * np.exp(-ln_variance))
        return ln_variance, density

    def after_error(self, miss: float, other: float, size: float) -> "VarianceLaw":
        """After a drive on which a quantity of this `size` was off by `miss`; `other` is variance of other origin."""
        ln_variance, density = self.grid()
        total = np.exp(ln_variance) * size**2 + other
        return _matched(ln_variance, np.exp(density - 0.5 * (np.log(total) + miss**2 / total)))

    def after_drives(self, share: float, drives: float) -> "VarianceLaw":
        """After so many drives that were off by just this share; conjugate."""
        degrees = self.degrees + drives
        squared = (self.degrees * self.scale**2 + drives * share**2) / degrees
        return VarianceLaw(_within(degrees), math.sqrt(squared))

    def forgotten(self, share: float, first: "VarianceLaw") -> "VarianceLaw":
        """So much of the way back to the prior, 0 to 1."""
        degrees, scale = ((1 - share) * a + share * b for a, b in zip(self._logs(), first._logs(), strict=True))
        return VarianceLaw(_within(math.exp(degrees)), math.exp(scale))

    def _logs(self) -> tuple[float, float]:
        return math.log(self.degrees), math.log(self.scale)


def _within(degrees: float) -> float:
    return min(max(degrees, FEWEST_DEGREES), MOST_DEGREES)


def _matched(ln_variance: FloatArray, weight: FloatArray) -> VarianceLaw:
    """The law with this mean and variance of the logarithm, from a density on an even grid.

    `weight` (GRID,) need not add up to 1.
    """
    from scipy.optimize import brentq

    weight = weight / weight.sum()
    mean = float(weight @ ln_variance)
    spread = float(weight @ (ln_variance - mean) ** 2)
    low, high = (float(polygamma(1, 0.5 * degrees)) for degrees in (MOST_DEGREES, FEWEST_DEGREES))
    degrees = MOST_DEGREES
    if spread > low:
        root = brentq(lambda nu: polygamma(1, 0.5 * nu) - min(spread, high), FEWEST_DEGREES, MOST_DEGREES)
        degrees = _within(float(root))
    ln_scale = 0.5 * (mean - math.log(0.5 * degrees) + float(psi(0.5 * degrees)))
    return VarianceLaw(degrees, math.exp(ln_scale))


@dataclass(frozen=True, slots=True)
class PhysicsDiscrepancy:
    """What drives are off by beside their soil.

    Attributes
    ----------
    along, across : of the way: how much farther, and how much to the left, a rover comes than the twin says. [-]
    quantities : of `SHARED` quantities, as a share of their size. [-]
    scored : what it was learned from, oldest first: plain values, with the SHA-256 of the states.

    Raises ParameterError for other quantities.
    """

    along: VarianceLaw
    across: VarianceLaw
    quantities: Mapping[str, VarianceLaw]
    scored: tuple[Mapping[str, Any], ...] = field(default=())

    def __post_init__(self) -> None:
        refuse({f"a discrepancy needs laws of {', '.join(SHARED)}": {*self.quantities} != {*SHARED}})

    def covariance_m2(self, way_m2: FloatArray) -> FloatArray:
        """Of an end whose way has the matrix `way_m2`, tails included. (2, 2) from (2, 2) [m2]"""
        return np.asarray(self.along.variance * way_m2 + self.across.variance * across_of(way_m2))

    def after_end(self, miss_m: FloatArray, other_m2: FloatArray, way_m2: FloatArray) -> "PhysicsDiscrepancy":
        """After a drive whose end was missed.

        Parameters
        ----------
        miss_m : measured less predicted. (2,) [m]
        other_m2 : covariance of the miss without discrepancy: of the soil, and of the measured place. (2, 2) [m2]
        way_m2 : matrix of the way, as of `way_matrix`. (2, 2) [m2]
        """
        (one, of_one), (other, of_other) = self.along.grid(), self.across.grid()
        total = (
            np.exp(one)[:, None, None, None] * way_m2
            + np.exp(other)[None, :, None, None] * across_of(way_m2)
            + other_m2
        )
        squared = np.einsum("i,abij,j->ab", miss_m, np.linalg.inv(total), miss_m)
        ln_weight = of_one[:, None] + of_other - 0.5 * (np.linalg.slogdet(total)[1] + squared)
        weight = np.exp(ln_weight - ln_weight.max())
        return replace(self, along=_matched(one, weight.sum(axis=1)), across=_matched(other, weight.sum(axis=0)))

    def after_states(self, unexplained: float) -> "PhysicsDiscrepancy":
        """After a drive whose best soil leaves such a share of its wheel states unexplained, beside their errors.

        Where the states of a drive do not fit its best soil, the next drive misses by more: as measured, by 0.6 of that
        share, which counts as up to five drives. States that fit say nothing: the next drive goes where slopes are
        others, and what a law is off by there does not show here.
        """
        missed = WAY_TO_STATE_ERROR * unexplained
        along, across = (
            law.after_drives(math.hypot(law.scale, missed), STATE_DRIVES * missed**2 / (missed**2 + law.scale**2))
            for law in (self.along, self.across)
        )
        return replace(self, along=along, across=across)

    def after_quantity(self, name: str, miss: float, other: float, size: float) -> "PhysicsDiscrepancy":
        """After a drive on which a quantity was off by `miss` in the mean, all in its unit; `other` is a variance."""
        law = self.quantities[name].after_error(miss, other, size)
        return replace(self, quantities={**self.quantities, name: law})

    def with_source(self, **score: Any) -> "PhysicsDiscrepancy":
        """With one more line of what it rests on."""
        return replace(self, scored=(*self.scored, score))

    def has_scored(self, sha256: str) -> bool:
        """Whether the drive with these states taught it already."""
        return any(entry.get("sha256") == sha256 for entry in self.scored)

    def forgotten(self, share: float) -> "PhysicsDiscrepancy":
        """So much of the way back to the priors, 0 to 1. What it rests on stays, and counts no second time."""
        return replace(
            self,
            along=self.along.forgotten(share, FIRST.along),
            across=self.across.forgotten(share, FIRST.across),
            quantities={name: law.forgotten(share, FIRST.quantities[name]) for name, law in self.quantities.items()},
        )

    def to_dict(self) -> dict[str, Any]:
        """As plain values."""
        return {
            "along": asdict(self.along),
            "across": asdict(self.across),
            "quantities": {name: asdict(law) for name, law in self.quantities.items()},
            "scored": [dict(entry) for entry in self.scored],
        }

    @classmethod
    def of(cls, document: Mapping[str, Any] | None) -> "PhysicsDiscrepancy":
        """From plain values; `FIRST` from None. Raises KeyError, TypeError, ValueError for what is none."""
        if document is None:
            return FIRST
        along, across = (VarianceLaw(**document[axis]) for axis in AXES)
        quantities = {str(name): VarianceLaw(**law) for name, law in document["quantities"].items()}
        return cls(along, across, quantities, tuple(dict(entry) for entry in document.get("scored", ())))


def across_of(way_m2: FloatArray) -> FloatArray:
    """The matrix of the way with every step turned to the left. (2, 2)"""
    return np.array([[way_m2[1, 1], -way_m2[0, 1]], [-way_m2[0, 1], way_m2[0, 0]]])


FIRST = PhysicsDiscrepancy(
    along=VarianceLaw(3.0, 0.018),
    across=VarianceLaw(3.0, 0.011),
    quantities={name: VarianceLaw(5.0, 0.1) for name in SHARED},
)
"""Before any drive. The likelihood of 37 returns by a quasi-static rover, stress integrals and ruts, whose way out sent
telemetry, is largest near these shares of the way, with `WAY_TO_STATE_ERROR` and `STATE_DRIVES` as they are
(`tests/benchmarks/loop.py --training --seed 97 --positions telemetry`: grounds and soils that no reported number is
of). What contact angles and radius of the wheels may be is part of the soil's own spread. Those of wheel states are
assumed."""
