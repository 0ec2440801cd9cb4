"""The probability that a rock comes from each of the candidate craters: a prior, and what the rock is made of."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Any, overload

import numpy as np

from lunarsci.arrays import BoolArray, FloatArray, IntArray
from lunarsci.errors import ParameterError
from lunarsci.io.records import Codes, Listed, Records, Same
from lunarsci.names import some_of
from lunarsci.parallel.blocks import Progress, arrays_in_blocks
from lunarsci.provenance import sha256
from lunarsci.spectra.origin.catalogue import Crater, Point, azimuth_deg
from lunarsci.spectra.origin.composition import Composition, Rock
from lunarsci.spectra.origin.evidence import CompositionEvidence, CompositionRows, EvidenceRows, evidence_rows
from lunarsci.spectra.origin.prior import CraterPrior, PriorSettings, crater_priors, launch_speed_m_s

OTHER = "other source"
NAMED = 4
"""Sources that a sentence names."""
BLOCK_ROWS = 256
"""Rocks of a block, which is so in any memory: some tenths of a second of one core."""
DECIDES = 3.0
"""ln Bayes factor, and ln odds of the posterior, of one source against all others, from which it is decided (about
20 : 1, 'strong' in Kass & Raftery 1995, 10.1080/01621459.1995.10476572)."""
REMAIN = 1.0 / (1.0 + np.exp(-DECIDES))
"""Posterior that is the same, by Kass & Raftery 1995, 10.1080/01621459.1995.10476572: sources that have it together
remain where none has it alone."""


@dataclass(frozen=True, slots=True, kw_only=True)
class MatchSettings:
    """`systematic` of a mineral's share between two methods [-], of a band centre [nm], and the prior's settings."""

    systematic: float = 0.10
    band_systematic_nm: float = 10.0
    use_modes: bool = True
    use_bands: bool = True
    prior: PriorSettings

    def __post_init__(self) -> None:
        if not 0 <= self.systematic <= 1:
            raise ParameterError(f"systematic is {self.systematic:g}; it is a fraction from 0 to 1")
        if not 0 <= self.band_systematic_nm <= 500:
            raise ParameterError(f"systematic of the bands is {self.band_systematic_nm:g} nm; it must be 0 to 500")


@dataclass(frozen=True, slots=True)
class CraterMatch:
    """One rock and one crater; `posterior` is prior times exp of the ln Bayes factor, over the sum of all."""

    crater: Crater
    prior: CraterPrior
    evidence: CompositionEvidence
    posterior: float
    azimuth_deg: float | None
    launch_speed_m_s: float | None

    @property
    def ln_bayes_factor(self) -> float:
        """Composition alone, against a rock of any composition."""
        return self.evidence.ln_total

    @property
    def contains_site(self) -> bool:
        """Whether the site lies within the rim, so that it has no ejecta there."""
        return self.prior.ejecta_m is None

    def to_dict(self) -> dict[str, Any]:
        """The keys of a crater in `lunarsci spectra match --json`."""
        low, high = self.crater.age_ma
        return {
            "name": self.crater.name,
            "latitude_deg": self.crater.latitude_deg,
            "longitude_deg": self.crater.longitude_deg,
            "diameter_km": self.crater.diameter_km,
            "age_low_ma": low,
            "age_high_ma": high,
            "distance_km": self.prior.distance_km,
            "azimuth_deg": self.azimuth_deg,
            "contains_site": self.contains_site,
            "ejecta_m": self.prior.ejecta_m,
            "launch_speed_m_s": self.launch_speed_m_s,
            "log_bayes_factor": self.ln_bayes_factor,
            "log_bayes_factor_modes": self.evidence.ln_modes,
            "log_bayes_factor_bands": self.evidence.ln_bands,
            "compared": self.evidence.basis,
            "prior": self.prior.probability,
            "posterior": self.posterior,
            "terms": {
                "survival": self.prior.survival,
                "above_surface": self.prior.above_surface,
                "stages": dict(self.prior.stages),
            },
            "sources": dict(self.crater.sources),
        }


@dataclass(frozen=True, slots=True)
class RockMatch:
    """One rock: all craters in the catalogue's order, the probability of other sources, whether one source is decided,
    and a sentence."""

    rock: Rock
    craters: tuple[CraterMatch, ...]
    other_prior: float
    other_posterior: float
    decided: bool
    status: str

    def to_dict(self) -> dict[str, Any]:
        """The keys of a rock in `lunarsci spectra match --json`."""
        return match_records([self])[0]

    @property
    def best(self) -> str | None:
        """Name of the crater it comes from, or that it is another source; None where that is not decided."""
        return self.remaining[0] if self.decided else None

    @property
    def remaining(self) -> tuple[str, ...]:
        """The fewest sources that have a posterior of `REMAIN` together, the likeliest first."""
        return tuple(name for name, _ in _remaining(self.craters, self.other_posterior))


def match_records(matches: Sequence[RockMatch]) -> Records:
    """Rocks of one site in `lunarsci spectra match --json`; all but a few keys of a crater are the same for all."""
    made_of = [match.rock.composition for match in matches]
    modes = [{name: {"fraction": v, "sigma": s} for name, (v, s) in item.modes.items()} for item in made_of]
    bands = [{name: {"center_nm": v, "sigma_nm": s} for name, (v, s) in item.bands.items()} for item in made_of]
    craters = [
        {
            **{key: Same(value) for key, value in crater.to_dict().items()},
            **_of_rocks([m.craters[place] for m in matches]),
        }
        for place, crater in enumerate(matches[0].craters)
    ]
    other = {"log_bayes_factor": Same(0.0), "prior": Same(matches[0].other_prior)}
    return Records(
        {
            "id": [match.rock.id for match in matches],
            "modes": modes,
            "bands": bands,
            "craters": Listed(craters),
            "other": other | {"posterior": np.array([match.other_posterior for match in matches])},
            "best": [match.best for match in matches],
            "remaining": [list(match.remaining) for match in matches],
            "remarks": [list(match.rock.remarks) for match in matches],
            "status": [match.status for match in matches],
        }
    )


def match_table(matches: Sequence[RockMatch]) -> Records:
    """The same in `--csv`: a row for each crater of each rock, and for other sources; `best` where that is decided."""
    first = [*map(_crater_row, matches[0].craters), {"name": OTHER, "prior": matches[0].other_prior}]
    row = np.tile(np.arange(len(first)), len(matches))
    names = dict.fromkeys(name for cells in first for name in cells)
    same = {name: Codes(row, [cells.get(name) for cells in first]) for name in names}
    own = [_of_rocks([match.craters[place] for match in matches]) for place in range(len(first) - 1)]
    nothing = np.full(len(matches), np.nan)
    rest: dict[str, Any] = {
        "log_bayes_factor": 0 * row[: len(matches)],
        "posterior": [match.other_posterior for match in matches],
    }
    differ = {
        key: np.column_stack([*(cells[key] for cells in own), rest.get(key, nothing)]).ravel()
        for key in own[0]
        if key != "compared"
    }
    compared = [text for match in matches for text in (*(item.evidence.basis for item in match.craters), "")]
    rocks = Codes(np.repeat(np.arange(len(matches)), len(first)), [match.rock.id for match in matches])
    best = [cells["name"] == match.best for match in matches for cells in first]
    return Records({"rock": rocks, **same, **differ, "compared": compared, "best": best})


def _crater_row(item: CraterMatch) -> dict[str, Any]:
    record = item.to_dict()
    terms, sources = record.pop("terms"), record.pop("sources")
    stages = {f"stage_{name}": share for name, share in terms["stages"].items()}
    flat = {"survival": terms["survival"], "above_surface": terms["above_surface"], **stages}
    return {**record, **flat, "sources": "; ".join(sources.values())}


def _of_rocks(matches: Sequence[CraterMatch]) -> dict[str, Any]:
    """Keys of one crater that differ from rock to rock."""
    evidence = [match.evidence for match in matches]
    return {
        "log_bayes_factor": np.array([item.ln_total for item in evidence]),
        "log_bayes_factor_modes": np.array([item.ln_modes for item in evidence], float),
        "log_bayes_factor_bands": np.array([item.ln_bands for item in evidence], float),
        "compared": [item.basis for item in evidence],
        "posterior": np.array([match.posterior for match in matches]),
    }


@dataclass(frozen=True, slots=True, eq=False)
class MatchRows:
    """n rocks and c craters.

    Attributes
    ----------
    priors, evidence : of the craters, and what the compositions say.
    posterior : of each crater (n, c), and of other sources (n,).
    """

    priors: Sequence[CraterPrior]
    evidence: EvidenceRows
    posterior: FloatArray
    other_posterior: FloatArray


def match_arrays(rocks: CompositionRows, craters: Sequence[Crater], site: Point, settings: MatchSettings) -> MatchRows:
    """Match many rocks, or pixels of a map, with candidate craters; the same numbers as `match_rocks`.

    Raises ParameterError where no crater can have delivered a rock to the site.
    """
    priors, seen = crater_priors(craters, site, settings.prior), _compared(rocks, settings)
    compositions = [crater.composition for crater in craters]
    arrays = _columns_of_matches(seen, craters=compositions, weights=_weights(priors, settings), settings=settings)
    return _rows_of_matches(arrays, priors, seen, compositions)


def match_rocks(
    rocks: Sequence[Rock], craters: Sequence[Crater], site: Point, settings: MatchSettings,
    progress: Progress | None = None,
) -> "RockMatches":  # fmt: skip
    """Match rocks found at one site (latitude, longitude in deg) with candidate craters.

    Raises ParameterError where no crater can have delivered a rock to the site.
    """
    priors = crater_priors(craters, site, settings.prior)
    seen = _compared(CompositionRows.of([rock.composition for rock in rocks]), settings)
    compositions, weights = [crater.composition for crater in craters], _weights(priors, settings)
    arrays = arrays_in_blocks(
        partial(_columns_of_matches, craters=compositions, weights=weights, settings=settings),
        len(rocks),
        BLOCK_ROWS,
        stage="match",
        about=lambda: {
            "rocks": seen.digest(),
            "craters": sha256(repr(compositions).encode() + weights.tobytes()),
            "systematic": f"{settings.systematic:g}, {settings.band_systematic_nm:g} nm",
        },
        fetch=lambda block: seen.part(slice(block.start, block.stop)),
        progress=progress,
    )
    return RockMatches(rocks, craters, _rows_of_matches(arrays, priors, seen, compositions), site, settings)


def _compared(rocks: CompositionRows, settings: MatchSettings) -> CompositionRows:
    """What of the rocks is compared."""
    nothing = np.full_like(rocks.modes, np.nan), np.full_like(rocks.centers_nm, np.nan)
    modes = rocks.modes if settings.use_modes else nothing[0]
    return replace(rocks, modes=modes, centers_nm=rocks.centers_nm if settings.use_bands else nothing[1])


def _weights(priors: Sequence[CraterPrior], settings: MatchSettings) -> FloatArray:
    """Prior weights of the craters, and of other sources."""
    return np.array([*(prior.probability for prior in priors), settings.prior.other_weight])


def _columns_of_matches(
    seen: CompositionRows, *, craters: Sequence[Composition], weights: FloatArray, settings: MatchSettings
) -> dict[str, Any]:
    errors = {"systematic": settings.systematic, "band_systematic_nm": settings.band_systematic_nm}
    evidence = evidence_rows(seen, craters, **errors)
    posterior = _posterior(weights, np.column_stack([evidence.ln_total, np.zeros(len(seen.modes))]))
    return {"ln_modes": evidence.ln_modes, "ln_bands": evidence.ln_bands, "posterior": posterior}


def _rows_of_matches(
    arrays: Mapping[str, FloatArray], priors: Sequence[CraterPrior], seen: CompositionRows,
    craters: Sequence[Composition],
) -> MatchRows:  # fmt: skip
    evidence, posterior = EvidenceRows(arrays["ln_modes"], arrays["ln_bands"], seen, craters), arrays["posterior"]
    return MatchRows(priors, evidence, posterior[:, :-1], posterior[:, -1])


class RockMatches(Sequence[RockMatch]):
    """A match of each rock, made of the arrays `found` when it is asked for."""

    def __init__(
        self, rocks: Sequence[Rock], craters: Sequence[Crater], found: MatchRows, site: Point, settings: MatchSettings
    ) -> None:
        self.rocks, self.craters, self.found, self.other = rocks, craters, found, settings.prior.other_weight
        self._flight = [
            (azimuth_deg(site, crater.center), launch_speed_m_s(crater.diameter_km, prior.distance_km))
            for crater, prior in zip(craters, found.priors, strict=True)
        ]
        tested = np.array([not rock.untested for rock in rocks], dtype=bool)
        self.decided = tested & _decided(found, _weights(found.priors, settings)) & ~_own_crater(found)

    def __len__(self) -> int:
        return len(self.rocks)

    @overload
    def __getitem__(self, index: int) -> RockMatch: ...
    @overload
    def __getitem__(self, index: slice) -> list[RockMatch]: ...
    def __getitem__(self, index: int | slice) -> RockMatch | list[RockMatch]:
        if isinstance(index, slice):
            return [self[row] for row in range(*index.indices(len(self)))]
        row, found = range(len(self))[index], self.found
        own = tuple(
            CraterMatch(
                crater, found.priors[k], found.evidence.at(row, k), float(found.posterior[row, k]), *self._flight[k]
            )
            for k, crater in enumerate(self.craters)
        )
        rest, decided = float(found.other_posterior[row]), bool(self.decided[row])
        return RockMatch(self.rocks[row], own, self.other, rest, decided, _status(self.rocks[row], own, rest, decided))


def _posterior(priors: FloatArray, ln_factors: FloatArray) -> FloatArray:
    """Priors (c,) times exp of the ln Bayes factors (n, c), over their sum; exact however small they are."""
    with np.errstate(divide="ignore"):
        ln = np.log(priors) + ln_factors
    weights = np.exp(ln - ln.max(axis=1, keepdims=True))
    found: FloatArray = weights / weights.sum(axis=1, keepdims=True)
    return found


def _decided(found: MatchRows, weights: FloatArray) -> BoolArray:
    """Whether of each rock one source is decided: its posterior against all others, and what composition adds to that.

    ln[p / (1 - p)] of the likeliest, with p its posterior, and the same less that of its prior, are `DECIDES` at least:
    with a prior of 20 : 1 alone nothing is decided.
    """
    posterior = np.column_stack([found.posterior, found.other_posterior])
    first = np.argmax(posterior, axis=1)
    odds, before = (_ln_odds(shares, first) for shares in (posterior, np.broadcast_to(weights, posterior.shape)))
    with np.errstate(invalid="ignore"):
        decided: BoolArray = (odds >= DECIDES) & (odds - before >= DECIDES)
    return decided


def _own_crater(found: MatchRows) -> BoolArray:
    """Whether composition goes at least as well with a crater that the site lies in as with the likeliest source."""
    inside = np.array([prior.ejecta_m is None for prior in found.priors], dtype=bool)
    factors = np.column_stack([found.evidence.ln_total, np.zeros(len(found.posterior))])
    first = np.argmax(np.column_stack([found.posterior, found.other_posterior]), axis=1)
    own: FloatArray = np.where(inside, factors[:, :-1], -np.inf).max(axis=1, initial=-np.inf)
    alike: BoolArray = (own > 0.0) & (own >= factors[np.arange(len(first)), first])
    return alike


def _ln_odds(shares: FloatArray, place: IntArray) -> FloatArray:
    """ln of one share (n, s) of each row over the sum of the others."""
    own = np.arange(shares.shape[1]) == place[:, None]
    with np.errstate(divide="ignore"):
        found: FloatArray = np.log(shares[own]) - np.log(np.where(own, 0.0, shares).sum(axis=1))
    return found


def _remaining(matches: Sequence[CraterMatch], other: float) -> list[tuple[str, float]]:
    """Names and posteriors of the fewest sources that have `REMAIN` together, the likeliest first."""
    named = sorted([(OTHER, other), *((m.crater.name, m.posterior) for m in matches)], key=lambda one: -one[1])
    below = np.cumsum([share for _, share in named]) < REMAIN
    return named[: int(below.sum()) + 1]


def _fitting_inside(matches: Sequence[CraterMatch], first: str) -> str:
    """Craters that the site lies in and composition goes with at least as well as with the likeliest source."""
    told = next((item.ln_bayes_factor for item in matches if item.crater.name == first), 0.0)
    inside = [item for item in matches if item.contains_site and item.ln_bayes_factor > 0.0]
    return some_of([item.crater.name for item in inside if item.ln_bayes_factor >= told], NAMED)


def _status(rock: Rock, matches: Sequence[CraterMatch], other: float, decided: bool) -> str:
    """One sentence: which source it is or which remain, and whether it is composition or the prior that says so."""
    left = _remaining(matches, other)
    first = f"{left[0][0]} ({left[0][1]:.2f})"
    shown = some_of([f"{name} ({share:.2f})" for name, share in left], NAMED)
    remain = f"not decided: {shown} remain" if len(left) > 1 else f"not decided: {first} leads"
    if not any(item.evidence.minerals or item.evidence.bands for item in matches):
        known = rock.composition.modes or rock.composition.bands
        what = "shares of its minerals" if rock.composition.modes else "band centres"
        why = f"no crater has {what} to compare with" if known else "no composition of the rock is known"
        return f"{remain}; composition decides nothing: {why}; the posterior is the prior"
    if decided and left[0][0] == OTHER:
        return "goes with none of the craters whose composition is known: another source is likelier than all of them"
    if decided:
        return f"likeliest {first}; composition speaks strongly"
    if len(left) == 1 and not rock.untested:
        if own := _fitting_inside(matches, left[0][0]):
            return (
                f"{remain}; composition goes as well with {own}, in which the site lies: it may be a rock of its floor"
            )
        return f"{remain} by the prior; composition adds less than 20 : 1 for it"
    factors = [item.ln_bayes_factor for item in matches if not item.contains_site]
    spread = max(factors) - min(factors)
    if spread < DECIDES:
        return f"{remain}; composition hardly decides, the prior does (ln Bayes factors differ by {spread:.1f})"
    held = ", if its shares hold, which are not to be quoted: they are outside of what was tested"
    strongly = f"composition speaks strongly (ln Bayes factors differ by {spread:.1f})"
    return f"{remain}; {strongly}{held if rock.untested else ''}"
