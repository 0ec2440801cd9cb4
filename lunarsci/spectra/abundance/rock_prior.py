"""Shares of minerals in rocks that were brought back from the Moon, as a prior, and what a spectrum makes of it.

The prior is a mixture of Dirichlet distributions, one about each rock of `lunar_rock_modes.csv`, of parameters
1 + modes/h (Aitchison & Lauder 1985, Applied Statistics 34, 129). The five classes of the table count alike, the rocks
of a class alike. The width h is that by which each rock is likeliest by the others. Of pyroxene that was not divided in
counting, pigeonite among it, any part may be orthopyroxene: of mare basalts nothing is known of it but by the spectrum.

Shares s of m minerals drawn from the prior are weighed by what the spectrum says of each mineral k,

    w = prod_k [(1 - d) p_k(s_k)/p0_k(s_k) + d]^((m - 1)/m),

p_k its probabilities without the doubt d, which weighs nothing, and p0_k those of the mixtures that the networks
learned from. The power is there since m shares that sum to 1 have m - 1 degrees of freedom.
"""

from functools import cache

import numpy as np

from lunarsci.arrays import FloatArray
from lunarsci.io.tables import table_rows
from lunarsci.spectra.abundance.learned import MINERALS, SHARES, shared_out

TABLE = "lunar_rock_modes.csv"
PRIOR = "lunar-rocks"
RETURNED = 0.9
"""Probability that a rock is of the kinds that were returned, before its spectrum is seen; assumed."""
POWDERS = (0.5, 0.28, 0.13, 0.09)
"""Of 1, 2, 3, 4 minerals in mixtures that the networks learned from, as `make_share_networks.py` has them; measured:
a mineral alone is so often drawn as 6 to 11 %, and absent as 44 to 57 %."""
DRAWN, KEPT = 40_000, 4000
"""Shares that are drawn, and those kept; assumed enough."""
LEAST = 0.005
"""Least mode where the width is found: none or a trace; assumed."""
WIDTHS = np.geomspace(0.002, 0.5, 60)
"""Of which the likeliest is taken; assumed wide enough: it lies far from both ends."""


def rocks() -> tuple[FloatArray, FloatArray, FloatArray]:
    """Modes of olivine, orthopyroxene, clinopyroxene and plagioclase (n, 4) and of undivided pyroxene (n,), which sum
    to 1, and weights of the rocks (n,)."""
    rows = table_rows(TABLE)
    counted = np.array([[float(row[name] or 0.0) for name in (*MINERALS, "pyroxene")] for row in rows])
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
    found = []
    for h in WIDTHS:
        power = parts / h + (0.0, 1.0, 0.0)
        norm = gammaln((power + 1.0).sum(axis=1)) - gammaln(power + 1.0).sum(axis=1)
        found.append(weight @ np.log(others * np.exp(norm + ln_parts @ power.T) @ np.ones(len(weight))))
    return float(WIDTHS[int(np.argmax(found))])


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
    there = rng.random((DRAWN, len(MINERALS))).argsort(axis=1) < count[:, None]
    shares = _of(rng.standard_gamma(1.0, there.shape) * there, allowed)
    return shares, shared_out(shares).mean(axis=0)


def _of(amounts: FloatArray, allowed: tuple[bool, ...]) -> FloatArray:
    amounts = amounts * allowed
    amounts = amounts[amounts.sum(axis=1) > 0]
    return np.asarray(amounts / amounts.sum(axis=1, keepdims=True))


def posterior(probabilities: FloatArray, doubt: float, allowed: tuple[bool, ...]) -> tuple[FloatArray, float]:
    """Shares (KEPT, 4) of rocks that a spectrum may be of, and the probability that it is of one like those returned.

    `probabilities` : of `SHARES` of each mineral by the spectrum, (4, 21), doubt included.
    """
    rock, (powder, usual) = drawn_rocks(allowed), drawn_powders(allowed)
    sure = np.maximum(probabilities - doubt / SHARES.size, 0.0)
    ratio = sure / np.maximum(usual, 1e-9) + doubt
    weigh, other = (_weights(shares, ratio, allowed) for shares in (rock, powder))
    odds = RETURNED * weigh.mean() / ((1.0 - RETURNED) * other.mean())
    kept = np.random.default_rng(2).choice(len(rock), KEPT, p=weigh / weigh.sum())
    return rock[kept], float(odds / (1.0 + odds))


def _weights(shares: FloatArray, ratio: FloatArray, allowed: tuple[bool, ...]) -> FloatArray:
    own = np.flatnonzero(allowed)
    each = [np.log(np.maximum(np.interp(shares[:, k], SHARES, ratio[k]), 1e-9)) for k in own]
    return np.asarray(np.exp((own.size - 1) / own.size * np.sum(each, axis=0)))
