"""Whether the posteriors of `spectra match` are as often right as they say: `python tests/benchmarks/bench_match.py`.

Rocks are drawn by hand: a crater from the prior, modes from its own (normal laws, those below 0 drawn again, divided by
their sum), the disagreement of two methods and the measurement error added to each mode, values below 0 set to 0 and
the sum to 1, as programs report them. Every posterior of every rock, other sources included, is one forecast, sorted
into ten bins of equal count and of equal width. Then the same with rocks from a world that the prior or the
errors describe wrongly.
"""

import argparse
from collections.abc import Sequence
from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np

from lunarsci.io.tables import table_rows
from lunarsci.minerals import WITH_BANDS
from lunarsci.spectra.origin.catalogue import Crater, embedded_catalogue
from lunarsci.spectra.origin.composition import ERRORS, Composition, Rock, widened
from lunarsci.spectra.origin.match import OTHER, MatchSettings, RockMatches, match_rocks
from lunarsci.spectra.origin.prior import CHANG_E_4, PriorSettings, Range, crater_priors

ERROR = 0.05
SCATTER = 0.05
INVENTED = {
    "Zhinyu": (0.10, 0.20, 0.45, 0.25),
    "Finsen": (0.10, 0.45, 0.10, 0.35),
    "Von Kármán L": (0.35, 0.15, 0.30, 0.20),
    "Maksutov": (0.05, 0.15, 0.10, 0.70),
    "Davisson": (0.15, 0.25, 0.15, 0.45),
    "Antoniadi": (0.40, 0.30, 0.10, 0.20),
}
"""Made-up modes of olivine, orthopyroxene, clinopyroxene and plagioclase: what a complete catalogue might hold."""
BINS = 10


class Reliability(NamedTuple):
    """By bin: mean forecast, share that came true, number of forecasts."""

    forecast: np.ndarray
    observed: np.ndarray
    count: np.ndarray

    @property
    def worst(self) -> float:
        """Largest difference between forecast and truth."""
        return float(np.abs(self.forecast - self.observed).max())

    @property
    def chance(self) -> np.ndarray:
        """Standard error of the share that came true, if the forecasts are right and independent."""
        return np.sqrt(np.maximum(self.forecast * (1 - self.forecast), 1e-9) / self.count)


def complete_catalogue() -> list[Crater]:
    """The embedded craters, six of them with invented modes."""
    return [
        replace(crater, composition=_composition(INVENTED[crater.name])) if crater.name in INVENTED else crater
        for crater in embedded_catalogue()
    ]


def _composition(values: Sequence[float]) -> Composition:
    return Composition({name: (value, SCATTER) for name, value in zip(WITH_BANDS, values, strict=True)})


def drawn_modes(crater: Crater | None, rng: np.random.Generator) -> np.ndarray:
    """True modes (4,) of a rock of a crater; of any composition where the crater's is unknown or there is none."""
    if crater is None or not crater.composition.modes:
        return rng.dirichlet(np.ones(len(WITH_BANDS)))
    mean, sigma = np.array([crater.composition.modes[name] for name in WITH_BANDS]).T
    while True:
        modes = rng.normal(mean, sigma)
        if (modes >= 0).all():
            return np.asarray(modes / modes.sum())


def simulate(
    craters: Sequence[Crater], priors: np.ndarray, count: int, systematic: float, seed: int
) -> tuple[list[Rock], np.ndarray]:
    """Rocks, and the place of each one's source; the last place is another source."""
    rng = np.random.default_rng(seed)
    sources = rng.choice(len(priors), size=count, p=priors)
    rocks = []
    for number, source in enumerate(sources):
        truth = drawn_modes(craters[source] if source < len(craters) else None, rng)
        seen = np.zeros(truth.size)
        while not seen.any():
            seen = truth + rng.normal(0, systematic, truth.size) + rng.normal(0, ERROR, truth.size)
            seen = np.maximum(seen, 0)
        modes = {name: (float(value), ERROR) for name, value in zip(WITH_BANDS, seen / seen.sum(), strict=True)}
        rocks.append(Rock(str(number), Composition(modes)))
    return rocks, sources


class RealError(NamedTuple):
    """Errors of the four shares that `spectra unmix` found of one spectrum, and the standard deviations it stated."""

    error: np.ndarray
    sigma: np.ndarray


def real_errors(kinds: Sequence[str] = ("powder-mixture", "dark-rock-powder", "solid-rock")) -> list[RealError]:
    """Of spectra in which all four minerals were named, each judged without its suite."""
    rows = [row for row in table_rows(ERRORS) if row["class"] in kinds and all(row[f"error_{m}"] for m in WITH_BANDS)]
    return [
        RealError(*(np.array([float(row[f"{part}_{m}"]) for m in WITH_BANDS]) for part in ("error", "sigma")))
        for row in rows
    ]


def simulate_real(
    craters: Sequence[Crater], priors: np.ndarray, count: int, seed: int, systematic: float, stated: str
) -> tuple[list[Rock], np.ndarray]:
    """As `simulate`, with errors as `spectra unmix` has them, drawn as they are, all minerals of a spectrum together.

    `stated` are those that the match is told: `own` of the spectrum, `quoted` 0.05, or `widened` from that by the kind.
    """
    rng = np.random.default_rng(seed)
    sources = rng.choice(len(priors), size=count, p=priors)
    kinds = ("powder-mixture", "dark-rock-powder", "solid-rock")
    known = [(kind, one) for kind in kinds for one in real_errors([kind])]
    rocks = []
    for number, source in enumerate(sources):
        truth = drawn_modes(craters[source] if source < len(craters) else None, rng)
        kind, real = known[rng.integers(len(known))]
        seen = np.zeros(truth.size)
        while not seen.any():
            seen = np.maximum(truth + rng.normal(0, systematic, truth.size) + real.error, 0)
        told = real.sigma if stated == "own" else np.full(truth.size, ERROR)
        modes = {m: (float(v), float(s)) for m, v, s in zip(WITH_BANDS, seen / seen.sum(), told, strict=True)}
        modes = widened(modes, kind)[0] if stated == "widened" else modes
        rocks.append(Rock(str(number), Composition(modes)))
    return rocks, sources


def prior_vector(craters: Sequence[Crater], settings: PriorSettings) -> np.ndarray:
    """Prior of every crater and of other sources, which add up to 1."""
    found = [item.probability for item in crater_priors(craters, CHANG_E_4, settings)]
    return np.array([*found, settings.other_weight])


def reliability(
    craters: Sequence[Crater], settings: MatchSettings, *drawn: Any, **how: Any
) -> tuple[Reliability, Reliability, float]:
    """Reliability in bins of equal count and of equal width, and how often the likeliest source is the true one.

    Of rocks that are drawn as for `matched`.
    """
    matches, sources = matched(craters, settings, *drawn, **how)
    posteriors = np.array([[*(item.posterior for item in m.craters), m.other_posterior] for m in matches])
    hits = np.arange(posteriors.shape[1]) == sources[:, None]
    possible = prior_vector(craters, settings.prior) > 0
    pairs = posteriors[:, possible].ravel(), hits[:, possible].ravel()
    return by_count(*pairs), by_width(*pairs), float(np.mean(posteriors.argmax(axis=1) == sources))


def matched(
    craters: Sequence[Crater],
    settings: MatchSettings,
    count: int,
    seed: int,
    world: PriorSettings | None = None,
    systematic: float | None = None,
    stated: str | None = None,
) -> tuple[RockMatches, np.ndarray]:
    """Matches of simulated rocks, and the place of each one's source.

    `world` and `systematic` are the truth that rocks are drawn from; left out, what the matching assumes. With
    `stated` errors are real, see `simulate_real`.
    """
    truth = prior_vector(craters, world or settings.prior)
    used = settings.systematic if systematic is None else systematic
    if stated:
        rocks, sources = simulate_real(craters, truth / truth.sum(), count, seed, used, stated)
    else:
        rocks, sources = simulate(craters, truth / truth.sum(), count, used, seed)
    return match_rocks(rocks, craters, CHANG_E_4, settings), sources


class Decided(NamedTuple):
    """Rocks whose source is called decided, how many of these calls are right, and of how many rocks."""

    called: int
    right: int
    rocks: int


def decided(matches: RockMatches, sources: np.ndarray) -> Decided:
    """How often a source is called decided, and rightly."""
    names = [*(crater.name for crater in matches.craters), OTHER]
    calls = [(one.best, names[source]) for one, source in zip(matches, sources, strict=True) if one.best is not None]
    return Decided(len(calls), sum(best == true for best, true in calls), len(matches))


def by_count(forecasts: np.ndarray, hits: np.ndarray) -> Reliability:
    """Ten bins with equally many forecasts each."""
    return _reliability(np.array_split(np.argsort(forecasts), BINS), forecasts, hits)


def by_width(forecasts: np.ndarray, hits: np.ndarray) -> Reliability:
    """Ten bins of 0.1; those without forecasts left out."""
    place = np.minimum((forecasts * BINS).astype(int), BINS - 1)
    return _reliability([np.flatnonzero(place == k) for k in np.unique(place)], forecasts, hits)


def _reliability(parts: Sequence[np.ndarray], forecasts: np.ndarray, hits: np.ndarray) -> Reliability:
    return Reliability(
        np.array([forecasts[part].mean() for part in parts]),
        np.array([hits[part].mean() for part in parts]),
        np.array([part.size for part in parts]),
    )


WRONG_WORLDS: dict[str, tuple[dict[str, object], float | None]] = {
    "rocks from any crater alike": ({"kind": "uniform"}, None),
    "nothing is dug up again": ({"re_excavation": False}, None),
    "ten times more gardening": ({"gardening_m": Range(0.01, 1.0)}, None),
    "ejecta alone, rocks last for ever": ({"exposure": False, "re_excavation": False}, None),
    "half of all rocks are from elsewhere": ({"other_weight": 0.5}, None),
    "methods disagree by 0.2": ({}, 0.2),
}


def main() -> None:
    """Print the tables."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--rocks", type=int, default=1000)
    parser.add_argument("--seed", type=int, default=0)
    options = parser.parse_args()
    settings = MatchSettings(prior=PriorSettings())
    for name, craters in (("embedded", embedded_catalogue()), ("with invented modes", complete_catalogue())):
        count, width, right = reliability(craters, settings, options.rocks, options.seed)
        print(f"\ncatalogue {name}, {options.rocks} rocks: likeliest source right {right:.2f}")
        for kind, table in (("equal count", count), ("equal width", width)):
            print(f"  bins of {kind}, worst {table.worst:.3f}")
            for forecast, observed, number, error in zip(*table, table.chance, strict=True):
                print(f"    posterior {forecast:.3f}   came true {observed:.3f}   chance {error:.3f}   n {number}")
    print("\nerrors that spectra unmix has, suites left out, catalogue with invented modes")
    for stated in ("own", "widened", "quoted"):
        tables = reliability(complete_catalogue(), settings, options.rocks, options.seed, stated=stated)
        high = tables[1].forecast >= 0.7
        pairs = zip(tables[1].forecast[high], tables[1].observed[high], strict=True)
        print(
            f"  {stated:8} likeliest right {tables[2]:.2f}   worst bin off by {tables[0].worst:.3f} (equal count), "
            f"{tables[1].worst:.3f} (equal width); " + ", ".join(f"{p:.2f} came true {o:.2f}" for p, o in pairs)
        )
    print("\nrocks whose source is called decided, catalogue with invented modes")
    for name, (change, systematic) in {"as assumed": ({}, None), **WRONG_WORLDS}.items():
        world = replace(settings.prior, **change)
        found = decided(*matched(complete_catalogue(), settings, options.rocks, options.seed, world, systematic))
        print(f"  {name:40s} {found.called} of {found.rocks}, right {found.right}")
    for catalogue, craters in (("embedded", embedded_catalogue()), ("with invented modes", complete_catalogue())):
        print(f"\nrocks from another world than assumed, catalogue {catalogue}")
        for name, (change, systematic) in WRONG_WORLDS.items():
            world = replace(settings.prior, **change)
            count, width, right = reliability(craters, settings, options.rocks, options.seed, world, systematic)
            off = f"{count.worst:.3f} (equal count), {width.worst:.3f} (equal width)"
            print(f"  {name:40s} likeliest right {right:.2f}   worst bin off by {off}")


if __name__ == "__main__":
    main()
