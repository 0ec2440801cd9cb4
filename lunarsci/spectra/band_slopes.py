"""How quantities of an absorption band depend on each reflectance, eight spectra at once."""

from typing import Any, NamedTuple

from lunarsci.arrays import FloatArray
from lunarsci.compiled.formulas import LANES, formula
from lunarsci.compiled.lanes import choose, load, spread, store
from lunarsci.spectra.band_polynomial import (
    CURVE,
    DEPTH_HERE,
    HEFT,
    HEFT_SLOPE,
    NOISE,
    OF_CURVE,
    OF_RATIO,
    OF_TERM,
    ONTO,
    OWN,
    OWN_NODE,
    OWN_WEIGHT,
    PER_LEVEL,
    PLACE,
    RATIO,
    RESIDUAL,
    RIGHT,
    SHARE,
    BandWork,
    X,
    polynomial,
    solved,
)
from lunarsci.spectra.continuum import TERMS, Indices, Ties
from lunarsci.spectra.lane_rows import uncounted


class Smoother(NamedTuple):
    """A linear operator of spectra on the same n channels, each of which takes few others.

    Attributes
    ----------
    first, weights : the first channel that it takes at each channel, and the weights from there, (n,), (n, w).
    """

    first: Indices
    weights: FloatArray


class BandGrid(NamedTuple):
    """What spectra on the same n channels share.

    Attributes
    ----------
    wavelength_nm, steps_nm : channels and their gradient, (n,). [nm]
    smoother, adjoint : the smoothing, and its transpose.
    ties : of the continua.
    """

    wavelength_nm: FloatArray
    steps_nm: FloatArray
    smoother: Smoother
    adjoint: Smoother
    ties: Ties


@uncounted
def smooth(g: Smoother, t: Any, source: int, out: int) -> None:
    """Rows from `out` on take what the operator makes of those from `source` on."""
    firsts, weights = g
    for j in range(firsts.size):
        first, total = source + firsts[j], spread(0.0)
        for m in range(weights.shape[1]):
            total += load(t, first + m) * weights[j, m]
        store(t, out + j, total)


@formula
def _along(along: Any, residual: Any, slope: Any, heft: Any, share: Any, per_depth: Any, total: Any) -> Any:
    of_share = along * residual * slope * per_depth
    return along * heft, -of_share, total + of_share * share


@uncounted
def slopes(g: BandGrid, work: BandWork, first: int, behind: int, out: int) -> Any:
    """Derivatives to each reflectance, into rows, of a quantity whose derivatives to the coefficients are in RIGHT; its
    variance."""
    t, k, count = work.t, work.k, g.wavelength_nm.size
    s0, s1, s2, s3, s4 = solved(
        k, load(k, RIGHT), load(k, RIGHT + 1), load(k, RIGHT + 2), load(k, RIGHT + 3), load(k, RIGHT + 4)
    )
    per_depth, total = 1.0 / load(k, DEPTH_HERE), spread(0.0)
    for j in range(first, behind):
        of_ratio, of_curve, total = _along(
            polynomial(load(t, X * count + j), s0, s1, s2, s3, s4), load(t, RESIDUAL * count + j),
            load(t, HEFT_SLOPE * count + j), load(t, HEFT * count + j), load(t, SHARE * count + j), per_depth, total,
        )  # fmt: skip
        store(t, OF_RATIO * count + j, of_ratio)
        store(t, OF_CURVE * count + j, of_curve)
    return per_channel(g, work, first, behind, out, total)


@uncounted
def per_channel(g: BandGrid, work: BandWork, first: int, behind: int, out: int, of_deepest: Any) -> Any:
    """Derivatives to both ratios, OF_RATIO and OF_CURVE, into derivatives to the reflectance; the variance.

    `of_deepest` is a derivative to the smoothed ratio at the deepest channel, besides.
    """
    t, k, count = work.t, work.k, g.wavelength_nm.size
    place, one, two, three = load(k, PLACE), spread(0.0), spread(0.0), spread(0.0)
    for j in range(first, behind):
        onto, of_level, direct = _parts(
            load(t, OF_RATIO * count + j), load(t, OF_CURVE * count + j), load(t, (RATIO + OWN) * count + j),
            load(t, (CURVE + OWN) * count + j), load(t, (PER_LEVEL + OWN) * count + j), of_deepest, place, float(j),
        )  # fmt: skip
        node = load(t, OWN_NODE * count + j)
        two += of_level * load(t, (OWN_WEIGHT + 1) * count + j)
        three += of_level * load(t, (OWN_WEIGHT + 2) * count + j)
        store(t, out * count + j, direct)
        store(t, OF_RATIO * count + j, of_level)
        store(t, ONTO * count + j, onto + node * two)
        two = choose(node, spread(0.0), two)
    for j in range(behind, count):
        node = load(t, OWN_NODE * count + j)
        store(t, out * count + j, spread(0.0))
        store(t, ONTO * count + j, node * two)
        two = choose(node, spread(0.0), two)
    for j in range(behind - 1, first - 1, -1):
        node = load(t, OWN_NODE * count + j)
        one += load(t, OF_RATIO * count + j) * load(t, OWN_WEIGHT * count + j)
        store(t, ONTO * count + j, load(t, ONTO * count + j) + node * one)
        one = choose(node, spread(0.0), one)
    for j in range(first - 1, -1, -1):
        node = load(t, OWN_NODE * count + j)
        store(t, out * count + j, spread(0.0))
        store(t, ONTO * count + j, node * one)
        one = choose(node, spread(0.0), one)
    _to_ties(work, one, two, three, count)
    return _smoothed_back(g.adjoint, t, out)


@formula
def _parts(
    of_ratio: Any, of_curve: Any, ratio: Any, curve: Any, per_level: Any, of_deepest: Any, place: Any, j: Any
) -> Any:
    of_curve = of_curve + choose(abs(place - j) < 0.5, of_deepest, 0.0)
    return of_curve * per_level, -(of_ratio * ratio + of_curve * curve) * per_level, of_ratio * per_level


@uncounted
def _to_ties(work: BandWork, one: Any, two: Any, three: Any, count: int) -> None:
    """What derivatives to the level give to the channels of the continuum's terms; the hull's nodes have theirs."""
    t, k, tie = work.t, work.k, work.tie[OWN]
    store(k, OF_TERM, one)
    store(k, OF_TERM + 1, two)
    store(k, OF_TERM + 2, three)
    for term in range(TERMS):
        for lane in range(LANES):
            t[ONTO * count + tie[term, lane], lane] += k[OF_TERM + term, lane]


@uncounted
def _smoothed_back(g: Smoother, t: Any, out: int) -> Any:
    """Add what the smoothed reflectance of other channels takes from each; the variance."""
    firsts, weights = g
    count, variance = firsts.size, spread(0.0)
    for j in range(count):
        first, total = ONTO * count + firsts[j], load(t, out * count + j)
        for m in range(weights.shape[1]):
            total += load(t, first + m) * weights[j, m]
        store(t, out * count + j, total)
        off = total * load(t, NOISE * count + j)
        variance += off * off
    return variance
