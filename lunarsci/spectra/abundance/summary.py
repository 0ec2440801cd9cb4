"""From posteriors under several mixing laws to fractions with intervals."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from lunarsci.spectra.abundance.result import Abundance, MineralFraction
from lunarsci.spectra.abundance.unmix import Posterior
from lunarsci.spectra.spectrum import FloatArray

__all__ = ["Outcome", "abundances", "shortest_interval"]

DRAWS, SEED = 4000, 0
LEVELS = (0.6827, 0.95)
ABSENT = 0.005
"""Below this an interval is taken to begin at 0."""
MOST_STRANGE = 0.15
"""Misfit and strain together, per channel, up to which a spectrum counts as a mixture of the end members. One by one,
43 of 53 laboratory mixtures are below (the others are coarser than 45 um), one of 95 spectra of lunar soil and rock,
and seven of 113 powders of one mineral with the three others named."""


@dataclass(frozen=True, slots=True, eq=False)
class Outcome:
    """What `unmix` found for the spectra of a suite, under each law.

    `untested` says why no measurement vouches for it; empty where one does.
    """

    method: str
    minerals: tuple[str, ...]
    posteriors: tuple[Posterior, ...]
    model_error: float
    untested: str = ""


def abundances(names: Sequence[str], outcome: Outcome) -> list[Abundance]:
    """Posterior means and shortest intervals of all spectra, laws weighted by their evidence."""
    evidence = np.array([item.ln_evidence for item in outcome.posteriors])
    weight = np.exp(evidence - evidence.max())
    weight /= weight.sum()
    counts = np.maximum(1, np.round(DRAWS * weight).astype(int))
    drawn = zip(outcome.posteriors, counts, strict=True)
    draws = np.concatenate([item.draws(int(count), SEED + k) for k, (item, count) in enumerate(drawn)])
    misfit = sum(share * item.ln_residual**2 for share, item in zip(weight, outcome.posteriors, strict=True))
    strain = sum(share * item.strain for share, item in zip(weight, outcome.posteriors, strict=True))
    square = np.mean(misfit, axis=1)
    strange = square / outcome.model_error**2 + strain / outcome.posteriors[0].ln_residual.shape[1]
    return [
        _abundance(name, outcome, draws[:, index], float(np.sqrt(square[index])), float(strange[index]))
        for index, name in enumerate(names)
    ]


def _abundance(name: str, outcome: Outcome, draws: FloatArray, rms: float, strange: float) -> Abundance:
    mean = draws.mean(axis=0)
    edges = [shortest_interval(draws, level) for level in LEVELS]
    fractions = tuple(
        MineralFraction(
            mineral,
            float(mean[k]),
            *(float(value) for low, high in edges for value in (min(low[k], mean[k]), max(high[k], mean[k]))),
        )
        for k, mineral in enumerate(outcome.minerals)
    )
    inside = strange <= MOST_STRANGE and not outcome.untested
    reason = (
        f"out of domain: less like these minerals than laboratory mixtures are (strangeness {strange:.2f}, up to "
        f"{MOST_STRANGE:g} is usual); coarse grains, weathering, opaques, glass or other minerals"
    )
    if outcome.untested:
        reason = f"out of domain: {outcome.untested}"
    status = "like laboratory mixtures of these minerals" if inside else reason
    return Abundance(name, outcome.method, fractions, _correlation(draws), inside, status, rms)


def _correlation(draws: FloatArray) -> FloatArray:
    """Of the fractions; 0 beside one that does not vary."""
    covariance = np.cov(draws.T)
    spread = np.sqrt(np.diag(covariance))
    scale = np.outer(spread, spread)
    found = np.divide(covariance, scale, out=np.zeros_like(covariance), where=scale > 0)
    np.fill_diagonal(found, 1.0)
    return np.asarray(found)


def shortest_interval(draws: FloatArray, level: float) -> tuple[FloatArray, FloatArray]:
    """Ends of the shortest interval that holds a share `level` of draws, (k,) each, from (n, k)."""
    ordered = np.sort(draws, axis=0)
    held = int(np.ceil(level * len(ordered)))
    width = ordered[held - 1 :] - ordered[: len(ordered) - held + 1]
    begin = np.argmin(width, axis=0)
    low = np.take_along_axis(ordered, begin[None], axis=0)[0]
    high = np.take_along_axis(ordered, begin[None] + held - 1, axis=0)[0]
    return np.where(low < ABSENT, 0.0, low), np.where(high > 1 - ABSENT, 1.0, high)
