"""Shares of a spectrum by comparison with random mixtures: those most like it, corrected to it by regression.

Approximate Bayesian computation with a local linear correction: Beaumont, Zhang & Balding (2002), Genetics 162, 2025.
Spectra are compared along the few directions in which mixtures differ most beside the discrepancy of the model
(`Discrepancy`), so that what the discrepancy alone makes takes no part; or by what a quadratic regression on leading
principal components foretells of the shares and of the rock type (Fearnhead & Prangle 2012,
10.1111/j.1467-9868.2011.01010.x), which is sharper where many things darken a rock. Discrepancy and the noise of the
spectrum are added to the mixtures.

Kinds of target: what is known of one before its spectrum is seen, and what shares found of it are worth.

Rock types and discrepancies are prior knowledge. `abundance_calibration.csv` has what was measured: how far shares of
spectra of known modes were off, suite by suite, with whatever is of the suite left out of the library. Intervals are
scaled so that they hold those errors (split conformal prediction with suites as the units: Lei et al. 2018,
10.1080/01621459.2017.1307116; Dunn, Wasserman & Ramdas 2023, 10.1080/01621459.2022.2060112): K suites vouch for a level
of K / (K + 1) and none higher.
"""

import math
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cache, cached_property

import numpy as np

from lunarsci.arrays import FloatArray, IntArray
from lunarsci.spectra.abundance.random_mixtures import RandomMixtures, RockType
from lunarsci.tables import table_rows

NEIGHBOURS, RIDGE = {False: 600, True: 400}, 3.0
"""Random mixtures compared closely, by components and by what is foretold; and the ridge of the local regression in
units of one of them; assumed."""
GLOBAL_RIDGE, FARTHEST = 10.0, 4.0
"""Ridge of the regression over all of them, and where components are cut off, in standard deviations; assumed."""
WIDTH_NM, ORIGIN_UM = 120.0, 1.45
"""Length over which details of real spectra hang together, assumed about a third of a band; and the middle of the
range."""
CONTROLS, NEAREST, SEED = 200, 10, 1
"""Random mixtures that show how near the nearest ones usually are."""
EDGE_NM, EDGE_FALL_NM = 450.0, 100.0
"""Where the edge in the ultraviolet is as wide as `Discrepancy.edge`, and over how much it falls by e; assumed."""
USUAL = 0.99
"""Share of random mixtures whose nearest neighbours say what is usual; assumed."""


@dataclass(frozen=True, slots=True)
class Discrepancy:
    """Standard deviations of what ln R of a real powder has beside the model's.

    Attributes
    ----------
    level, slope, bend : of what is constant, linear (per um) and quadratic (per um^2) in wavelength. [-]
    detail : of what varies over `WIDTH_NM`. [-]
    channel : of what differs between channels of 20 nm. [-]
    edge : of the edge in the ultraviolet at 450 nm, which traces of iron and titanium make. [-]
    """

    level: float
    slope: float
    bend: float
    detail: float
    channel: float = 0.005
    edge: float = 0.0

    def covariance(self, wavelength_nm: FloatArray) -> FloatArray:
        """(c, c) of ln R."""
        u = wavelength_nm / 1e3 - ORIGIN_UM
        terms = np.array([self.level * np.ones_like(u), self.slope * u, self.bend * (u**2 - np.mean(u**2))])
        apart = (wavelength_nm[:, None] - wavelength_nm) / WIDTH_NM
        edge = self.edge * np.exp((EDGE_NM - wavelength_nm) / EDGE_FALL_NM)
        detail = (self.detail**2 + edge[:, None] * edge) * np.exp(-0.5 * apart**2)
        return np.asarray(terms.T @ terms + detail + self.channel**2 * np.eye(u.size))


@dataclass(frozen=True, slots=True, eq=False)
class DrawnShares:
    """Weighted draws of what a spectrum may show.

    Attributes
    ----------
    draws : (k, m) shares, `weight` (k,) of them, which sums to 1. [-]
    index : (k,) places of the draws in the random mixtures.
    unlike : distance from the nearest random mixtures, in units of that which `USUAL` of them keep to their like.
    rms_ln : root mean square of what ln R has beside that of the draws' weighted mean and what powders differ by
        without bands (`Discrepancy`): a constant, a slope and a bend, here the best ones. [-]
    misfit : what ln R has beside that mean, all of it, in standard deviations of the discrepancy and the noise: root
        mean square over independent directions. [-]
    worst_nm, worst_ln : where what `rms_ln` is of is largest beside what is allowed, and how much. [nm, -]
    """

    draws: FloatArray
    weight: FloatArray
    index: IntArray
    unlike: float
    rms_ln: float
    misfit: float
    worst_nm: float
    worst_ln: float


@dataclass(frozen=True, eq=False)
class Comparison:
    """Random mixtures ready to be compared with spectra on their channels.

    Attributes
    ----------
    components : how many directions are compared.
    foretold : whether what they foretell is compared, not they themselves.
    """

    mixtures: RandomMixtures
    wavelength_nm: FloatArray
    discrepancy: Discrepancy
    components: int
    foretold: bool

    @cached_property
    def _bandless(self) -> FloatArray:
        """(c, 3) orthogonal columns: what is constant, linear and quadratic in wavelength."""
        return np.asarray(np.linalg.qr(np.vander(self.wavelength_nm / 1e3 - ORIGIN_UM, 3))[0])

    @cached_property
    def _axes(self) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Mean spectrum, axes (c, p), and the clean mixtures along them (n, p), of variance 1 with the discrepancy."""
        from scipy.linalg import eigh

        clean = self.mixtures.ln_reflectance
        mean, apart = clean.mean(axis=0), self.discrepancy.covariance(self.wavelength_nm)
        total = np.cov(clean.T) + apart
        sizes, axes = np.linalg.eigh(total) if self.foretold else eigh(total, apart)
        axes = axes[:, ::-1][:, : self.components] / np.sqrt(sizes[::-1][: self.components])
        return mean, axes, (clean - mean) @ axes

    def _noisy(self, noise: FloatArray) -> FloatArray:
        """Components (n, p) with the model's discrepancy and the noise (c,) of a spectrum."""
        _, axes, clean = self._axes
        covariance = axes.T @ (self.discrepancy.covariance(self.wavelength_nm) + np.diag(noise**2)) @ axes
        normal = np.random.default_rng(SEED).standard_normal(clean.shape)
        return np.asarray(clean + normal @ np.linalg.cholesky(covariance).T)

    @cached_property
    def _noiseless(self) -> tuple[FloatArray, FloatArray]:
        """Components and what is compared, without noise of a spectrum."""
        noisy = self._noisy(np.zeros_like(self.wavelength_nm))
        return noisy, self._compared(noisy)

    @cached_property
    def _regression(self) -> tuple[FloatArray, FloatArray]:
        """Coefficients of what is foretold, and what makes its errors independent."""
        types = np.eye(int(self.mixtures.rock_type.max()) + 1)[self.mixtures.rock_type][:, 1:]
        wanted = np.column_stack([self.mixtures.shares[:, 1:], types])
        design = _quadratic(self._noisy(np.zeros_like(self.wavelength_nm)))
        normal = design.T @ design
        normal[np.arange(1, len(normal)), np.arange(1, len(normal))] += GLOBAL_RIDGE
        found = np.linalg.solve(normal, design.T @ wanted)
        sizes, axes = np.linalg.eigh(np.atleast_2d(np.cov((wanted - design @ found).T)))
        return np.asarray(found), axes / np.sqrt(sizes)

    def _compared(self, components: FloatArray) -> FloatArray:
        if not self.foretold:
            return components
        found, independent = self._regression
        return np.asarray((_quadratic(components) @ found) @ independent)

    @cached_property
    def _usual(self) -> float:
        noisy, _ = self._noiseless
        chosen = np.random.default_rng(SEED).choice(len(noisy), min(CONTROLS, len(noisy) // 2), replace=False)
        rest = np.delete(noisy, chosen, axis=0)
        return float(np.quantile(_nearest(rest, noisy[chosen]), USUAL))

    def draws(self, ln_reflectance: FloatArray, noise: FloatArray) -> DrawnShares:
        """What one spectrum shows, (c,), with the standard errors of its ln R."""
        mean, axes, _ = self._axes
        seen = (ln_reflectance - mean) @ axes
        noisy, points = self._noiseless
        if noise.any():
            noisy = self._noisy(noise)
            points = self._compared(noisy)
        apart = points - self._compared(seen[None])
        square = np.sum(apart**2, axis=1)
        count = min(NEIGHBOURS[self.foretold], len(square) - 1)
        index = np.argpartition(square, count)[:count]
        weight = 1.0 - square[index] / square[index].max() * (1 - 1e-9)
        weight /= weight.sum()
        draws = np.maximum(_corrected(self.mixtures.shares[index], apart[index], weight), 0.0)
        draws /= draws.sum(axis=1, keepdims=True)
        left = ln_reflectance - weight @ self.mixtures.ln_reflectance[index]
        allowed = self.discrepancy.covariance(self.wavelength_nm) + np.diag(noise**2)
        misfit = float(np.sqrt(left @ np.linalg.solve(allowed, left) / left.size))
        left -= self._bandless @ (self._bandless.T @ left)
        worst = int((np.abs(left) / np.sqrt(np.diag(allowed))).argmax())
        unlike = float(_nearest(noisy, seen[None])[0]) / self._usual
        rms_ln = float(np.sqrt(np.mean(left**2)))
        return DrawnShares(
            draws, weight, index, unlike, rms_ln, misfit, float(self.wavelength_nm[worst]), float(left[worst])
        )


def _quadratic(components: FloatArray) -> FloatArray:
    """1, the components and all their products of two."""
    cut = np.clip(components, -FARTHEST, FARTHEST)
    one, other = np.triu_indices(cut.shape[1])
    return np.column_stack([np.ones(len(cut)), cut, cut[:, one] * cut[:, other]])


def _nearest(points: FloatArray, seen: FloatArray) -> FloatArray:
    """Mean distance of each row of `seen` from the nearest of the points."""
    square = np.sum(seen**2, axis=1)[:, None] + np.sum(points**2, axis=1) - 2 * seen @ points.T
    nearest = np.partition(square, NEAREST, axis=1)[:, :NEAREST]
    return np.asarray(np.sqrt(np.maximum(nearest, 0.0)).mean(axis=1))


def _corrected(shares: FloatArray, apart: FloatArray, weight: FloatArray) -> FloatArray:
    """Shares moved to where the spectrum is, by a weighted ridge regression on the distance from it."""
    scale = apart.std(axis=0) + 1e-12
    design = np.column_stack([np.ones(len(apart)), apart / scale])
    weighted = design * (weight / weight.max())[:, None]
    normal = weighted.T @ design
    normal[np.arange(1, len(normal)), np.arange(1, len(normal))] += RIDGE
    slopes = np.linalg.solve(normal, weighted.T @ shares)
    return np.asarray(shares - design[:, 1:] @ slopes[1:])


TABLE = "abundance_calibration.csv"
POWDER, DARK, SOLID = "powder-mixture", "dark-rock-powder", "solid-rock"
CHONDRITE = "ordinary-chondrite"
"""Rock type that is named where it is likelier than all others; its class is calibrated by itself."""
MOST_WIDE = 0.12
"""Half of the widest interval of 68 % with which a spectrum is in domain: its worst share is mostly within 0.15,
measured on the suites left out."""
POWDER_TYPES = (
    RockType("any", 0.5),
    RockType("led-by-one", 0.5, leading=6.0),
)
"""Half of the powders of any shares, half led by one mineral; assumed."""
ROCK_TYPES = (
    RockType("any", 0.3),
    RockType(
        CHONDRITE,
        0.3,
        {"olivine": 20.0, "orthopyroxene": 11.2, "clinopyroxene": 3.6, "plagioclase": 5.2},
        dark=1.0,
        dark_share=(0.05, 0.7),
        iron=0.5,
        chemistry={"olivine": ("fo", 0.65, 0.88), "orthopyroxene": ("fs", 0.10, 0.35)},
        source="modes of ordinary chondrites: Dunn et al. (2010), Meteorit. Planet. Sci. 45, 123; the rest assumed",
    ),
    RockType("led-by-one", 0.2, leading=6.0),
    RockType(
        "basalt",
        0.2,
        {"olivine": 0.8, "orthopyroxene": 3.0, "clinopyroxene": 2.0, "plagioclase": 4.2},
        source="eucrites and mare basalts hold pyroxene and plagioclase in like parts; numbers assumed",
    ),
)
"""Modes of ordinary chondrites by Dunn et al. (2010), Meteorit. Planet. Sci. 45, 123; weights and all else assumed."""


@dataclass(frozen=True, slots=True)
class Target:
    """A kind of target.

    Attributes
    ----------
    kind : one of `kinds.KINDS` that can be unmixed.
    rock_types : what it may be.
    discrepancy : what real spectra have beside the model's.
    components, foretold : how spectra are compared (`posterior`).
    most_misfit : of a spectrum whose shares may be told.

    Detail, level and the way of comparison are those with which errors of suites left out were least, of 1, 2 and 3 %,
    10 and 20 %, and the two ways.
    """

    kind: str
    rock_types: tuple[RockType, ...]
    discrepancy: Discrepancy
    components: int
    foretold: bool
    most_misfit: float = math.inf


_POWDERS = Discrepancy(level=0.1, slope=0.05, bend=0.03, detail=0.01, edge=1.0)
"""Level, detail and edge are measured, as `Target` says; slope and bend assumed."""
MOST_MISFIT = 2.0
"""Chosen on half of measured and of made-up spectra of powders (`tests/benchmarks/contradicted.py`). Of dark rocks the
misfit does not tell right shares from wrong ones."""
_ROCKS = Discrepancy(level=0.2, slope=0.1, bend=0.05, detail=0.03)
"""As `_POWDERS`, measured and assumed alike; rocks differ more from powders than these from each other."""
TARGETS = {
    POWDER: Target(POWDER, POWDER_TYPES, _POWDERS, 12, False, MOST_MISFIT),
    DARK: Target(DARK, ROCK_TYPES, _ROCKS, 25, True),
    SOLID: Target(SOLID, ROCK_TYPES, _ROCKS, 25, True),
}


@dataclass(frozen=True, slots=True)
class KindCalibration:
    """What suites of known modes say of shares of one class of targets.

    Attributes
    ----------
    name : a kind, or `CHONDRITE`.
    suites, count : ids of the suites and number of spectra; none where nothing of known modes was measured.
    factor68, factor95 : by which standard deviations are multiplied to hold 68 and 95 % of the errors.
    most_unlike : largest distance from random mixtures (`posterior`) that a spectrum of known modes had.
    held68, held95 : share of the errors that intervals hold, each suite judged by the others. [-]
    precision, recall : of the verdict `in_domain` in the same way, where good is the worst mineral within 15 %. [-]
    """

    name: str
    suites: tuple[str, ...]
    count: int
    factor68: float
    factor95: float
    most_unlike: float
    held68: float
    held95: float
    precision: float
    recall: float

    @property
    def certified(self) -> float:
        """Highest level that so many suites can vouch for. [-]"""
        return len(self.suites) / (len(self.suites) + 1)


@cache
def calibrations() -> Mapping[str, KindCalibration]:
    """By name."""
    rows = {row["name"]: row for row in table_rows(TABLE)}
    return {
        name: KindCalibration(
            name,
            tuple(row["suites"].split()),
            int(row["count"]),
            *(
                float(row[key])
                for key in ("factor68", "factor95", "most_unlike", "held68", "held95", "precision", "recall")
            ),
        )
        for name, row in rows.items()
    }
