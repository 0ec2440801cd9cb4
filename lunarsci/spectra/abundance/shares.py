"""Shares of a spectrum from two estimates: networks (`learned`), and mixtures of end members (`estimate`).

The networks answer always. Mixtures of end members take part where the minerals are named: their weight w falls with
what they miss of the spectrum, with the plagioclase that the networks foretell, and with how dark the target is. The
pooled probabilities p of the shares are made sharper or blunter, and mixed with knowing nothing:

    p' = (1 - d) p^s / sum p^s + d / 21,

    ln s, logit d = c0 + c1 dark + c2 strange + c3 rock + c4 w + c5 missing + c6 shallow

That a mineral is there has the odds that p' gives to shares above 5 %, brought to a power and multiplied, both by how
much of the spectrum is missing.

`share_calibration.csv` has the coefficients, each learned from spectra of known modes by the logarithmic score, with
networks and end members that knew nothing of their sample series; and the levels at which intervals hold 68 and 95 %.

Where it is asked for, shares of minerals in rocks that were brought back from the Moon are the prior: a mixture of
Dirichlet distributions, one about each rock of `lunar_rock_modes.csv`, of parameters 1 + modes/h (Aitchison & Lauder
1985, Applied Statistics 34, 129). The five classes of the table count alike, the rocks of a class alike. The width h is
that by which each rock is likeliest by the others. Of pyroxene that was not divided in counting, pigeonite among it,
any part may be orthopyroxene: of mare basalts nothing is known of it but by the spectrum.

Shares s of m minerals drawn from the prior are weighed by what the spectrum says of each mineral k,

    w = prod_k [(1 - d) p_k(s_k)/p0_k(s_k) + d]^((m - 1)/m),

p_k its probabilities without the doubt d, which weighs nothing, and p0_k those of the mixtures that the networks
learned from. The power is there since m shares that sum to 1 have m - 1 degrees of freedom.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cache, cached_property
from itertools import combinations
from typing import TypeAlias

import numpy as np

from lunarsci.arrays import BoolArray, FloatArray
from lunarsci.io.tables import table_rows
from lunarsci.minerals import WEIGHED
from lunarsci.spectra.abundance.kinds import WEATHERED, KindVerdict
from lunarsci.spectra.abundance.learned import SHARES, Foretold, only, shared_out
from lunarsci.spectra.abundance.result import Abundance, MineralFraction

ROCK_MODES = "lunar_rock_modes.csv"
PRIOR = "lunar-rocks"
"""Name of the prior of rocks that were brought back, and the table of their modes."""
RETURNED = 0.9
"""Probability that a rock is of the kinds that were returned, before its spectrum is seen; assumed."""
POWDERS = (0.5, 0.28, 0.13, 0.09)
"""Of 1, 2, 3, 4 minerals in mixtures that the networks learned from, as `make_share_networks.py` has them; measured:
a mineral alone is so often drawn as 6 to 11 %, and absent as 44 to 57 %."""
DRAWN, RETAINED = 40_000, 4000
"""Shares that are drawn, and those retained; measured: with 20 spectra of RELAB they weigh as much as 660 or more that
weigh alike, 5,900 in the median, so that a mean errs by 0.04 of the standard deviation at most."""
LEAST = 0.005
"""Least mode where the width is found: none or a trace; assumed."""
WIDTHS = np.geomspace(0.002, 0.5, 60)
"""Of which the likeliest is taken, 0.013 as measured, far from both ends."""


def rocks() -> tuple[FloatArray, FloatArray, FloatArray]:
    """Modes of olivine, orthopyroxene, clinopyroxene and plagioclase (n, 4) and of undivided pyroxene (n,), which sum
    to 1, and weights of the rocks (n,)."""
    rows = table_rows(ROCK_MODES)
    counted = np.array([[float(row[name] or 0.0) for name in (*WEIGHED, "pyroxene")] for row in rows])
    counted /= counted.sum(axis=1, keepdims=True)
    _, place, count = np.unique([row["class"] for row in rows], return_inverse=True, return_counts=True)
    return counted[:, :-1], counted[:, -1], 1.0 / (count[place] * count.size)


@cache
def width() -> float:
    """The h of the highest likelihood of each rock by the others, of olivine, pyroxene and plagioclase. [-]"""
    from scipy.special import gammaln

    modes, undivided, weight = rocks()
    parts = np.column_stack([modes[:, 0], modes[:, 1] + modes[:, 2] + undivided, modes[:, 3]])
    ln_parts = np.log(np.maximum(parts, LEAST))
    others = weight * (1.0 - np.eye(len(weight)))
    others /= others.sum(axis=1, keepdims=True)
    likelihood = []
    for h in WIDTHS:
        power = parts / h + (0.0, 1.0, 0.0)
        norm = gammaln((power + 1.0).sum(axis=1)) - gammaln(power + 1.0).sum(axis=1)
        likelihood.append(weight @ np.log(others * np.exp(norm + ln_parts @ power.T) @ np.ones(len(weight))))
    return float(WIDTHS[int(np.argmax(likelihood))])


@cache
def drawn_rocks(allowed: tuple[bool, ...]) -> FloatArray:
    """Shares (DRAWN, 4) of rocks without the minerals that may not be there."""
    rng = np.random.default_rng(0)
    modes, undivided, weight = rocks()
    row = rng.choice(len(weight), DRAWN, p=weight)
    part = rng.random(DRAWN) * undivided[row]
    mean = modes[row] + np.stack([0 * part, part, undivided[row] - part, 0 * part], axis=-1)
    return _of(rng.standard_gamma(1.0 + mean / width()), allowed)


@cache
def drawn_powders(allowed: tuple[bool, ...]) -> tuple[FloatArray, FloatArray]:
    """Shares (DRAWN, 4) as the networks learned them, each mineral alike, and how often there are `SHARES`, (4, 21)."""
    rng = np.random.default_rng(1)
    count = rng.choice(np.arange(1, len(POWDERS) + 1), DRAWN, p=POWDERS)
    there = rng.random((DRAWN, len(WEIGHED))).argsort(axis=1) < count[:, None]
    shares = _of(rng.standard_gamma(1.0, there.shape) * there, allowed)
    return shares, shared_out(shares).mean(axis=0)


def _of(amounts: FloatArray, allowed: tuple[bool, ...]) -> FloatArray:
    amounts = amounts * allowed
    amounts = amounts[amounts.sum(axis=1) > 0]
    return np.asarray(amounts / amounts.sum(axis=1, keepdims=True))


def posterior(probabilities: FloatArray, doubt: float, allowed: tuple[bool, ...]) -> tuple[FloatArray, float]:
    """Shares (RETAINED, 4) of rocks that a spectrum may be of, and the probability that it is of one like these.

    `probabilities` : of `SHARES` of each mineral by the spectrum, (4, 21), doubt included.
    """
    rock, (powder, usual) = drawn_rocks(allowed), drawn_powders(allowed)
    sure = np.maximum(probabilities - doubt / SHARES.size, 0.0)
    ratio = sure / np.maximum(usual, 1e-9) + doubt
    weigh, other = (_weights(shares, ratio, allowed) for shares in (rock, powder))
    odds = RETURNED * weigh.mean() / ((1.0 - RETURNED) * other.mean())
    retained = np.random.default_rng(2).choice(len(rock), RETAINED, p=weigh / weigh.sum())
    return rock[retained], float(odds / (1.0 + odds))


def _weights(shares: FloatArray, ratio: FloatArray, allowed: tuple[bool, ...]) -> FloatArray:
    places = np.flatnonzero(allowed)
    each = [np.log(np.maximum(np.interp(shares[:, k], SHARES, ratio[k]), 1e-9)) for k in places]
    return np.asarray(np.exp((places.size - 1) / places.size * np.sum(each, axis=0)))


TABLE = "share_calibration.csv"
Coefficients: TypeAlias = Mapping[tuple[str, str], float]
"""By quantity and term."""
GOOD = 0.15
"""How near all shares must be for a good answer; assumed."""
LIKELY = 0.7
"""Probability of each share being so near from which a spectrum is in domain; measured: then 95 % had all shares so
near, and 81 % of mixtures, with sample series left out (`share_validation.csv`); of 0.70 to 0.75 74 %."""
SOME = float(SHARES[1])
"""Share above which a mineral counts as there: the least that the networks know."""
OPEN = (0.1, 0.9)
"""Probabilities of that between which a mineral is open; assumed."""
UNTESTED = "it looks weathered, and shares were not tested on weathered spectra"
NOTHING = 0.5
"""Probability of knowing nothing from which no share is named: the more probable."""
FINE = np.linspace(0.0, 1.0, 201)
"""Shares at which distributions are tabulated."""
MAFIC = ("olivine", "orthopyroxene", "clinopyroxene")
RATIOS = {"olivine_in_mafic": (("olivine",), MAFIC), "orthopyroxene_in_pyroxene": (("orthopyroxene",), MAFIC[1:])}


@dataclass(frozen=True, slots=True, eq=False)
class Mixed:
    """What mixtures of end members say of n spectra.

    Attributes
    ----------
    probabilities : (n, 4, 21) of `SHARES` of each mineral.
    strange, rms_ln : (n,) what mixtures miss, and root mean square of ln R less theirs.
    series : whether the spectra were taken together.
    trusted : whether the end members are the user's own.
    """

    probabilities: FloatArray
    strange: FloatArray
    rms_ln: FloatArray
    series: bool = False
    trusted: bool = False

    @property
    def weight_name(self) -> str:
        """Of the coefficients of its weight."""
        return "weight_series" if self.series else "weight"


@dataclass(frozen=True, eq=False)
class CalibratedShares:
    """Calibrated shares of n spectra, which `abundances` makes results of.

    Attributes
    ----------
    probabilities : (n, 4, 21) of `SHARES` of each mineral of `WEIGHED`.
    doubt : (n,) probability of knowing nothing.
    weight : (n,) of mixtures of end members, beside networks; series : whether those were taken together.
    missing : (n,) part of the channels that is missing.
    alone, returned : with the prior of returned rocks, the answer without it, and the probabilities, (n,), that the
        rocks are like those.
    """

    probabilities: FloatArray
    doubt: FloatArray
    weight: FloatArray
    missing: FloatArray
    alone: "CalibratedShares | None" = None
    returned: FloatArray | None = None
    series: bool = False

    @cached_property
    def mean(self) -> FloatArray:
        """Shares (n, 4); they sum to 1."""
        mean = self.probabilities @ SHARES
        return np.asarray(mean / mean.sum(axis=1, keepdims=True))

    @cached_property
    def below(self) -> FloatArray:
        """Probability of less than each of `FINE`, (n, 4, 201)."""
        return np.asarray(self.probabilities @ _below_each())

    @cached_property
    def median(self) -> FloatArray:
        """Medians of the shares, (n, 4)."""
        return _share_at(self.below, np.full(self.mean.shape, 0.5))

    def near(self, mean: FloatArray | None = None) -> FloatArray:
        """Least probability, over the minerals, of a share within `GOOD` of a mean (n, 4), by default its own, (n,)."""
        below, mean = self.below, self.mean if mean is None else mean
        ends = [_at(below, np.clip(mean + sign * GOOD, 0.0, 1.0)) for sign in (-1, 1)]
        return np.asarray((ends[1] - ends[0]).min(axis=1))

    def ln_odds_of_some(self) -> FloatArray:
        """That there is more than `SOME` of each mineral, by its share's probabilities, (n, 4)."""
        some = np.clip(1.0 - _at(self.below, np.full(self.mean.shape, SOME)), 1e-4, 1.0 - 1e-4)
        return np.asarray(np.log(some / (1.0 - some)))

    def present(self, calibration: Coefficients) -> FloatArray:
        """Probability of more than `SOME` of each mineral, (n, 4), as often right as it says."""
        terms = present_terms(self.ln_odds_of_some(), self.missing[:, None])
        return _logistic(np.sum([calibration["logit_present", key] * term for key, term in terms.items()], axis=0))

    def drawn(self, row: int) -> FloatArray:
        """Shares (RETAINED, 4) of one spectrum: of rocks, or each mineral by itself: they sum to 1 on the mean."""
        if self.alone is not None and self.returned is not None:
            alone = self.alone
            rocks, _ = posterior(alone.probabilities[row], alone.doubt[row], alone.there(row))
            like_them = np.linspace(0.0, 1.0, RETAINED, endpoint=False)[:, None] < self.returned[row]
            return np.where(like_them, rocks, alone.drawn(row))
        uniform = np.random.default_rng(0).random((RETAINED, len(WEIGHED)))
        each = [np.interp(uniform[:, k], self.below[row, k], FINE) for k in range(len(WEIGHED))]
        return np.column_stack(each) * self.there(row)

    def exchanged(self, row: int, some: Sequence[int]) -> tuple[int, int] | None:
        """Of some minerals the two whose sum is known best, if it is better known than either share."""
        square = self.probabilities[row] @ SHARES**2 - (self.probabilities[row] @ SHARES) ** 2
        pairs = {(a, b): square.sum() - square[a] - square[b] for a, b in combinations(some, 2)}
        best = min(pairs, key=lambda pair: pairs[pair], default=None)
        return best if best and pairs[best] < min(square[list(best)]) else None

    def there(self, row: int) -> tuple[bool, ...]:
        """Which minerals there may be in a spectrum."""
        return tuple((self.probabilities[row, :, 0] < 1.0).tolist())

    def intervals(self, calibration: Coefficients) -> tuple[FloatArray, FloatArray]:
        """Intervals of 68 and of 95 % about the mean, (n, 4, 2) each; the median is in them as well.

        To either side of the mean they hold the same part of the probability that there is, the level: F the
        probability of less than the mean, they reach from the quantile F (1 - level) to F + (1 - F) level. The least
        and the largest share that networks know stand for 0 and 1. Shares sum to 1: none has less, or more, than the
        ends of the others leave.
        """
        middle, intervals = _at(self.below, self.mean), []
        least, most = np.minimum(self.mean, self.median), np.maximum(self.mean, self.median)
        for name in ("level68", "level95"):
            mixed = calibration[name, "series" if self.series else "mixed"]
            level = np.where(self.weight < 0.5, calibration[name, "alone"], mixed)
            level = np.minimum(level + calibration[name, "missing"] * self.missing, 1.0)[:, None]
            first, last = middle * (1.0 - level), middle + (1.0 - middle) * level
            low = np.where(self.probabilities[..., 0] >= first, 0.0, _share_at(self.below, first))
            high = np.where(self.probabilities[..., -1] >= 1.0 - last, 1.0, _share_at(self.below, last))
            left = [1.0 - (end.sum(axis=1, keepdims=True) - end) for end in (high, low)]
            low, high = np.maximum(low, left[0]), np.minimum(high, left[1])
            intervals.append(np.stack([np.minimum(low, least), np.maximum(high, most)], axis=-1))
        return intervals[0], intervals[1]


@cache
def calibration() -> Coefficients:
    """Coefficients by quantity and term."""
    return {(row["quantity"], row["term"]): float(row["value"]) for row in table_rows(TABLE)}


def _below_each() -> FloatArray:
    """(21, 201): probability of less than each of `FINE` of a share near one of `SHARES`, with a triangle around it."""
    x = (FINE - SHARES[:, None]) * (SHARES.size - 1)
    below = np.where(x < 0, 0.5 * np.clip(1 + x, 0, 1) ** 2, 1 - 0.5 * np.clip(1 - x, 0, 1) ** 2)
    below[0] = 2 * below[0] - 1
    below[-1] *= 2
    return np.asarray(np.clip(below, 0.0, 1.0))


def _at(below: FloatArray, share: FloatArray) -> FloatArray:
    """Values of (n, 4, 201) at shares (n, 4)."""
    place = share * (FINE.size - 1)
    low = np.minimum(place.astype(int), FINE.size - 2)
    ends = (np.take_along_axis(below, (low + k)[..., None], axis=-1)[..., 0] for k in (0, 1))
    first, second = ends
    return np.asarray(first + (place - low) * (second - first))


def _share_at(below: FloatArray, level: FloatArray) -> FloatArray:
    """Quantiles (n, 4) of levels (n, 4), of distributions (n, 4, 201)."""
    last = np.argmax(below >= level[..., None], axis=-1)
    first = np.maximum(last - 1, 0)
    low, high = (np.take_along_axis(below, k[..., None], axis=-1)[..., 0] for k in (first, last))
    part = np.divide(level - low, high - low, out=np.zeros_like(low), where=high > low)
    return np.asarray((first + np.clip(part, 0.0, 1.0)) / (FINE.size - 1))


def pooled(
    foretold: Foretold, mixed: Mixed | None, dark: FloatArray, table: Coefficients
) -> tuple[FloatArray, FloatArray]:
    """Probabilities of both estimates together, (n, 4, 21), and the weight of the end members', (n,)."""
    if mixed is None:
        return foretold.probabilities, np.zeros(len(dark))
    weight = weight_of_mixtures(foretold, mixed, dark, table)
    part = weight[:, None, None]
    return (1.0 - part) * foretold.probabilities + part * mixed.probabilities, weight


def weight_of_mixtures(foretold: Foretold, mixed: Mixed, dark: FloatArray, table: Coefficients
                       ) -> FloatArray:  # fmt: skip
    """Of the end members' estimate beside the networks', (n,); 1 where the user knows them. [-]"""
    if mixed.trusted:
        return np.ones(len(dark))
    terms = weight_terms(foretold, mixed, dark)
    return _logistic(np.sum([table[mixed.weight_name, key] * term for key, term in terms.items()], axis=0))


def weight_terms(foretold: Foretold, mixed: Mixed, dark: FloatArray) -> dict[str, FloatArray]:
    """What the weight depends on."""
    plagioclase = foretold.probabilities[:, WEIGHED.index("plagioclase")] @ SHARES
    odds = np.log((dark + 1e-3) / (1.0 - dark + 1e-3))
    return {"constant": np.ones_like(dark), "ln_strange": np.log(mixed.strange), "plagioclase": plagioclase,
            "ln_odds_dark": odds}  # fmt: skip


def present_terms(ln_odds: FloatArray, missing: FloatArray) -> dict[str, FloatArray]:
    """What the probability that a mineral is there depends on; the less is seen, the less may its odds count."""
    return {"constant": np.ones_like(ln_odds), "ln_odds": ln_odds, "missing": missing + 0 * ln_odds,
            "ln_odds_missing": missing * ln_odds}  # fmt: skip


def _logistic(x: FloatArray) -> FloatArray:
    return np.asarray(1.0 / (1.0 + np.exp(-np.asarray(x))))


def how_dark(kinds: Sequence[KindVerdict]) -> FloatArray:
    """Probability of a target that is no mixture of powders of minerals, (n,); certain where the kind is stated."""
    return np.array([
        float(kind.kind != "powder-mixture") if kind.stated else 1.0 - kind.probabilities["powder-mixture"]
        for kind in kinds
    ])  # fmt: skip


def solid_rock(kinds: Sequence[KindVerdict]) -> FloatArray:
    """1 where a solid rock is stated, else 0, (n,)."""
    return np.array([float(kind.stated and kind.kind == "solid-rock") for kind in kinds])


def sharpened(
    pooled: FloatArray,
    allowed: FloatArray,
    terms: Mapping[str, FloatArray],
    table: Coefficients,
) -> tuple[FloatArray, FloatArray]:
    """The calibrated probabilities and the doubt, as the head of this module has them."""
    power = np.exp(sum(table["ln_sharpness", key] * term for key, term in terms.items()))
    doubt = _logistic(np.sum([table["logit_doubt", key] * term for key, term in terms.items()], axis=0))
    sharp = np.maximum(pooled, 1e-6) ** power[:, None, None]
    sharp /= sharp.sum(axis=-1, keepdims=True)
    mixed = (1.0 - doubt)[:, None, None] * sharp + doubt[:, None, None] / SHARES.size
    return _summing_to_one(only(mixed, allowed), allowed), doubt


def _summing_to_one(probabilities: FloatArray, allowed: FloatArray) -> FloatArray:
    """Of one mineral the share is 1; of two that of one is 1 less that of the other, which both tell."""
    closed, count = probabilities.copy(), (allowed > 0).sum(axis=1)
    closed[count == 1] = np.where((allowed[count == 1] > 0)[:, :, None], SHARES == 1.0, SHARES == 0.0)
    for row in np.flatnonzero(count == 2):
        one, two = np.flatnonzero(allowed[row])
        closed[row, one] = 0.5 * (closed[row, one] + closed[row, two, ::-1])
        closed[row, two] = closed[row, one, ::-1]
    return closed


def terms_of(
    foretold: Foretold,
    dark: FloatArray,
    rock: FloatArray,
    weight: FloatArray,
    table: Coefficients,
) -> dict[str, FloatArray]:
    """What sharpness and doubt depend on; `strange` counts standard deviations beyond the usual distance."""
    far = np.maximum((foretold.ln_distance - table["ln_distance", "usual"]) / table["ln_distance", "spread"], 0.0)
    return {"constant": np.ones_like(dark), "dark": dark, "strange": far, "rock": rock, "mixed": weight,
            "missing": foretold.missing, "shallow": foretold.shallow}  # fmt: skip


def answer(
    foretold: Foretold,
    allowed: FloatArray,
    dark: FloatArray,
    rock: FloatArray,
    mixed: Mixed | None = None,
    table: Coefficients | None = None,
) -> CalibratedShares:
    """Calibrated probabilities of shares of n spectra.

    Parameters
    ----------
    foretold : by the networks.
    allowed : (n, 4) 1 for minerals that there may be, else 0.
    dark, rock : (n,) probability of no mixture of powders, and of a solid rock. [-]
    mixed : what mixtures of end members say, if anything.
    """
    table = table or calibration()
    both, weight = pooled(foretold, mixed, dark, table)
    calibrated = sharpened(both, allowed, terms_of(foretold, dark, rock, weight, table), table)
    return CalibratedShares(*calibrated, weight, foretold.missing, series=mixed is not None and mixed.series)


def with_rocks(alone: CalibratedShares) -> CalibratedShares:
    """The answer where spectra are of rocks like those that were returned, unless they are like none of them.

    Nothing is left of the doubt: where the spectra say nothing it is the prior.
    """
    both, returned = alone.probabilities.copy(), np.empty(len(alone.doubt))
    for row in range(len(returned)):
        rocks, returned[row] = posterior(alone.probabilities[row], alone.doubt[row], alone.there(row))
        both[row] += returned[row] * (shared_out(rocks).mean(axis=0) - both[row])
    return CalibratedShares(both, np.zeros_like(returned), alone.weight, alone.missing, alone, returned, alone.series)


def abundances(
    names: Sequence[str],
    method: str,
    foretold: Foretold,
    allowed: FloatArray,
    kinds: Sequence[KindVerdict],
    mixed: Mixed | None = None,
    prior: str = "powders",
    free: CalibratedShares | None = None,
) -> list[Abundance]:
    """Shares of the minerals that there may be, by volume, with intervals and a verdict.

    `free` is the answer of networks to all minerals, where fewer are allowed: it counts as much for the domain. Of 51
    answers to the right minerals on RELAB (powders, pairs and triples) 53 % are in domain then, 93 % of them good (88
    and 82 % without it), of 870 without a mineral of 10 % or more 5 % (83 %): `tests/benchmarks/named_minerals.py`.
    """
    rock = solid_rock(kinds)
    unweighted = answer(foretold, allowed, how_dark(kinds), rock, mixed)
    result = with_rocks(unweighted) if prior == PRIOR else unweighted
    mean, present = result.mean, result.present(calibration())
    near, near_alone = (
        one.near() if free is None else 0.5 * (one.near() + free.near(one.mean)) for one in (result, unweighted)
    )
    trusted = near_alone >= LIKELY
    ends = np.concatenate(result.intervals(calibration()), axis=-1)
    results = []
    for row, name in enumerate(names):
        determined = result.doubt[row] < NOTHING
        value, middle = (one[row] if determined else np.full(len(WEIGHED), np.nan) for one in (mean, result.median))
        numbers = np.column_stack([value, ends[row], present[row], middle]).tolist()
        fractions = tuple(
            MineralFraction(mineral, *ends_of)
            for k, (mineral, ends_of) in enumerate(zip(WEIGHED, numbers, strict=True))
            if allowed[row, k]
        )
        weathered = kinds[row].weathered >= WEATHERED
        inside = bool(determined and trusted[row] and near[row] >= LIKELY and not weathered)
        status = _status(result, row, near[row], weathered, fractions)
        if mixed is not None and result.weight[row] < SOME:
            status += "; the networks alone gave the shares, as mixtures of end members do not count here"
        left = None if mixed is None else float(mixed.rms_ln[row])
        one = Abundance(name, method, fractions, inside, status, left, learned=float(1.0 - result.weight[row]),
                        prior=prior)  # fmt: skip
        if result.returned is not None:
            one = _with_prior(
                one, float(result.returned[row]), mean[row] - unweighted.mean[row], unweighted.doubt[row] >= NOTHING
            )
        results.append(replace(one, ratios=_ratios(result.drawn(row), allowed[row] > 0)) if rock[row] else one)
    return results


def _with_prior(one: Abundance, returned: float, moved: FloatArray, alone: bool) -> Abundance:
    """What the prior of returned rocks did: `moved` (4,) the shares; `alone` where the spectrum says nothing."""
    k = int(np.argmax(np.abs(moved)))
    none = "" if one.in_domain or "out of domain" in one.status else "out of domain: without the prior it would be; "
    status = none + one.status
    change = f"{abs(100 * moved[k]):.0f} percentage points {'higher' if moved[k] > 0 else 'lower'}"
    moves = f"{WEIGHED[k]} is {change} by the prior of returned rocks (it is like them with a "
    moves += f"probability of {returned:.2f})"
    moves += "; the spectrum says nearly nothing, so that this is their mean" if alone else ""
    return replace(one, prior=PRIOR, returned=returned, status=f"{status}; {moves}")


def shares_of_rows(
    foretold: Foretold,
    allowed: FloatArray,
    dark: FloatArray,
    rock: FloatArray,
    weathered: BoolArray,
    mixed: Mixed | None = None,
) -> tuple[FloatArray, FloatArray, BoolArray]:
    """Of many spectra shares (n, 4), low, high, low95 and high95 (n, 4, 4), and whether they are in domain (n,)."""
    result = answer(foretold, allowed, dark, rock, mixed)
    determined = result.doubt < NOTHING
    mean = np.where(determined[:, None], result.mean, np.nan)
    ends = np.concatenate(result.intervals(calibration()), axis=-1)
    return mean, ends, determined & ~weathered & (result.near() >= LIKELY)


def _status(
    result: CalibratedShares, row: int, near: float, weathered: bool, fractions: Sequence[MineralFraction]
) -> str:
    if result.doubt[row] >= NOTHING:
        return "not determined: unlike all spectra of known shares, so that nothing is known of these minerals"
    if len(fractions) == 1:
        return "the only mineral that there may be"
    parts = [f"each share is within {100 * GOOD:.0f} % of the truth with a probability of {near:.2f}"]
    if weathered:
        parts.insert(0, UNTESTED)
    if weathered or near < LIKELY:
        parts[0] = f"out of domain: {parts[0]}"
    return "; ".join([*parts, *_open(result, row, fractions)])


def _open(result: CalibratedShares, row: int, fractions: Sequence[MineralFraction]) -> list[str]:
    """Minerals that may be there or not, and those of them that stand for each other."""
    open_ones = [item.mineral for item in fractions if OPEN[0] < item.present < OPEN[1]]
    pair, parts = result.exchanged(row, [WEIGHED.index(name) for name in open_ones]), []
    if pair is not None:
        names = [WEIGHED[k] for k in pair]
        between = ", or a pyroxene between both, such as pigeonite" if {*MAFIC[1:]} == {*names} else ""
        total = 100 * result.mean[row, list(pair)].sum()
        parts = [f"not told apart: {' or '.join(names)}{between} (together {total:.0f} %)"]
        open_ones = [name for name in open_ones if name not in names]
    return parts + ([f"may be absent: {' or '.join(open_ones)}"] if open_ones else [])


def _ratios(drawn: FloatArray, there: BoolArray) -> tuple[MineralFraction, ...]:
    """Shares of one mineral in several, of shares that were drawn, (n, 4)."""
    ratios = []
    for name, (above, among) in RATIOS.items():
        places = [[WEIGHED.index(mineral) for mineral in some] for some in (above, among)]
        if not there[places[1]].all():
            continue
        value = drawn[:, places[0]].sum(axis=1) / np.maximum(drawn[:, places[1]].sum(axis=1), 1e-6)
        middle = float((value < value.mean()).mean())
        levels = [end for a in (0.68, 0.95) for end in (middle * (1.0 - a), middle + (1.0 - middle) * a)]
        low, high, low95, high95, median = np.quantile(value, [*levels, 0.5]).tolist()
        ratios.append(MineralFraction(name, float(value.mean()), low, high, low95, high95, median=median))
    return tuple(ratios)
