"""The probability that a rock comes from each of the candidate craters: a prior, and what the rock is made of.

ln Bayes factors of compositions are against any composition. Compared are shares of the minerals that both have, and
band centres. The rock differs from the crater's mean by its own error, the scatter within the crater, and what two
methods disagree by (the systematic). The yardstick, ln Bayes factor 0, is a rock of which nothing is known: shares
uniform over all that add up to 1, centres uniform over the range of lunar minerals. A crater whose composition is not
known is no better and no worse than that. `assumptions` says in sentences what a match assumes.
"""

from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cache, partial
from math import exp, factorial, pi, sqrt
from typing import Any, overload

import numpy as np

from lunarsci.arrays import BoolArray, FloatArray, IntArray
from lunarsci.constants import MOON_RADIUS_KM
from lunarsci.io.records import Codes, Listed, Records, Same
from lunarsci.minerals import WITH_BANDS
from lunarsci.names import some_of
from lunarsci.parallel.blocks import arrays_in_blocks
from lunarsci.provenance import sha256
from lunarsci.ranges import SHARE, check_ranges
from lunarsci.result import Progress
from lunarsci.spectra.origin.catalogue import Crater, Point, azimuth_deg
from lunarsci.spectra.origin.composition import SMALLEST_SIGMA, Composition, Rock, closed
from lunarsci.spectra.origin.mineral_map import MapReport
from lunarsci.spectra.origin.prior import (
    CraterPrior,
    PriorSettings,
    Range,
    crater_priors,
    launch_speed_m_s,
    surface_age_ma,
)

BAND_RANGE_NM = {"bc1000_nm": (880.0, 1070.0), "bc2000_nm": (1780.0, 2350.0)}
"""Centres a lunar rock may have, from Mg-orthopyroxene to augite and olivine mixtures; assumed. [nm]"""
DRAWS = 8192
LEAST_INSIDE = 0.5 / DRAWS
"""Share of draws inside where none is: the ln Bayes factor is then an upper bound near its true value."""


@dataclass(frozen=True, slots=True)
class CompositionEvidence:
    """ln Bayes factors of a crater's composition against any composition.

    Attributes
    ----------
    ln_modes, ln_bands : of the shares and of the centres; None where they cannot be compared.
    minerals, bands : what was compared.
    """

    ln_modes: float | None
    ln_bands: float | None
    minerals: tuple[str, ...]
    bands: tuple[str, ...]

    @property
    def ln_total(self) -> float:
        """Their sum, 0 where nothing could be compared; as if both were independent."""
        return (self.ln_modes or 0.0) + (self.ln_bands or 0.0)

    @property
    def basis(self) -> str:
        """What was compared, in words."""
        compared = [*(["modes " + "+".join(self.minerals)] if self.minerals else []), *self.bands]
        return ", ".join(compared) if compared else "nothing: no mineral or band is known of both"


@dataclass(frozen=True, slots=True, eq=False)
class CompositionRows:
    """Compositions of n rocks, NaN where something is not known.

    Attributes
    ----------
    modes, mode_sigmas : fractions of `WITH_BANDS`. (n, 4)
    centers_nm, center_sigmas_nm : of `BAND_RANGE_NM`. (n, 2)
    correlation : of the modes, (n, 4, 4); independent where None.
    """

    modes: FloatArray
    mode_sigmas: FloatArray
    centers_nm: FloatArray
    center_sigmas_nm: FloatArray
    correlation: FloatArray | None = None

    @classmethod
    def of(cls, rocks: Sequence[Composition]) -> "CompositionRows":
        size = len(rocks)
        modes, bands = np.full((2, size, len(WITH_BANDS)), np.nan), np.full((2, size, len(BAND_RANGE_NM)), np.nan)
        correlation = np.broadcast_to(np.eye(len(WITH_BANDS)), (size, len(WITH_BANDS), len(WITH_BANDS))).copy()
        for row, rock in enumerate(rocks):
            places = [WITH_BANDS.index(name) for name in rock.modes]
            for place, value in zip(places, rock.modes.values(), strict=True):
                modes[:, row, place] = value
            if rock.correlation is not None:
                correlation[row][np.ix_(places, places)] = rock.correlation
            for place, name in enumerate(BAND_RANGE_NM):
                bands[:, row, place] = rock.bands.get(name, (np.nan, np.nan))
        return cls(modes[0], modes[1], bands[0], bands[1], correlation)

    def part(self, rows: slice) -> "CompositionRows":
        """Some of them."""
        return CompositionRows(*(None if one is None else one[rows] for one in self._arrays))  # type: ignore[arg-type]

    def digest(self) -> str:
        """SHA-256 of all of them."""
        return sha256(b"".join(np.ascontiguousarray(one).tobytes() for one in self._arrays if one is not None))

    @property
    def _arrays(self) -> tuple[FloatArray | None, ...]:
        return self.modes, self.mode_sigmas, self.centers_nm, self.center_sigmas_nm, self.correlation

    def shares(self, rows: IntArray, minerals: Sequence[int]) -> tuple[FloatArray, FloatArray]:
        """Mean (r, k) and covariance (r, k, k) of the shares of some minerals, by number."""
        places = np.array(minerals)
        sigmas = np.maximum(self.mode_sigmas[np.ix_(rows, places)], SMALLEST_SIGMA)
        covariance = sigmas[:, :, None] * sigmas[:, None, :]
        if self.correlation is None:
            covariance = covariance * np.eye(len(minerals))
        else:
            covariance = self.correlation[np.ix_(rows, places, places)] * covariance
        return closed(self.modes[np.ix_(rows, places)], covariance)


@dataclass(frozen=True, slots=True, eq=False)
class EvidenceRows:
    """ln Bayes factors of n rocks and c craters, NaN where nothing could be compared. (n, c)"""

    ln_modes: FloatArray
    ln_bands: FloatArray
    rocks: CompositionRows
    craters: Sequence[Composition]

    @property
    def ln_total(self) -> FloatArray:
        """Their sum, 0 where nothing could be compared; as if both were independent. (n, c)"""
        return np.nan_to_num(self.ln_modes, nan=0.0) + np.nan_to_num(self.ln_bands, nan=0.0)

    def at(self, rock: int, crater: int) -> CompositionEvidence:
        """Of one rock and one crater."""
        modes, bands = self.ln_modes[rock, crater], self.ln_bands[rock, crater]
        entry = self.craters[crater]
        minerals = [m for k, m in enumerate(WITH_BANDS) if m in entry.modes and np.isfinite(self.rocks.modes[rock, k])]
        centers = [b for k, b in enumerate(BAND_RANGE_NM) if b in entry.bands and _has_center(self.rocks, k)[rock]]
        return CompositionEvidence(
            None if np.isnan(modes) else float(modes),
            None if np.isnan(bands) else float(bands),
            () if np.isnan(modes) else tuple(minerals),
            () if np.isnan(bands) else tuple(centers),
        )


def _has_center(rocks: CompositionRows, band: int) -> BoolArray:
    given: BoolArray = np.isfinite(rocks.centers_nm[:, band]) & np.isfinite(rocks.center_sigmas_nm[:, band])
    return given


def evidence_rows(
    rocks: CompositionRows, craters: Sequence[Composition], *, systematic: float, band_systematic_nm: float
) -> EvidenceRows:
    """ln Bayes factors of the compositions of rocks, each crater against any composition.

    `systematic` is the standard deviation of the difference between two methods in the share of one mineral [-];
    `band_systematic_nm` that of a band centre [nm]. With fewer than two minerals in common modes are not compared.
    """
    shape = (len(rocks.modes), len(craters))
    ln_modes, ln_bands = np.full(shape, np.nan), np.full(shape, np.nan)
    for minerals, numbers, rows in _comparable(rocks, craters):
        seen, error = rocks.shares(rows, minerals)
        error = error + systematic**2 * np.eye(len(minerals))
        broad = ln_shares_broad(seen, error)
        for number in numbers:
            mean, scatter = craters[number].shares([WITH_BANDS[place] for place in minerals])
            ln_modes[rows, number] = ln_shares_crater(seen, error, mean, scatter) - broad
    for number, crater in enumerate(craters):
        for place, name in enumerate(BAND_RANGE_NM):
            if name in crater.bands:
                rows = np.flatnonzero(_has_center(rocks, place))
                seen, error = rocks.centers_nm[rows, place], rocks.center_sigmas_nm[rows, place]
                factor = _ln_band(name, seen, error, *crater.bands[name], band_systematic_nm)
                ln_bands[rows, number] = np.nan_to_num(ln_bands[rows, number], nan=0.0) + factor
    return EvidenceRows(ln_modes, ln_bands, rocks, craters)


def _comparable(
    rocks: CompositionRows, craters: Sequence[Composition]
) -> Iterator[tuple[tuple[int, ...], list[int], IntArray]]:
    """Minerals by number, the craters that have them in common with some rocks, and the numbers of these rocks."""
    given = np.isfinite(rocks.modes)
    for kind in np.unique(given, axis=0):
        rows = np.flatnonzero((given == kind).all(axis=1))
        groups: dict[tuple[int, ...], list[int]] = {}
        for number, crater in enumerate(craters):
            minerals = tuple(k for k, name in enumerate(WITH_BANDS) if kind[k] and name in crater.modes)
            if len(minerals) > 1 and sum(crater.modes[WITH_BANDS[k]][0] for k in minerals) > 0:
                groups.setdefault(minerals, []).append(number)
        for minerals, numbers in groups.items():
            present = rows[rocks.modes[np.ix_(rows, np.array(minerals))].sum(axis=1) > 0]
            if present.size:
                yield minerals, numbers, present


def ln_shares_broad(seen: FloatArray, error: FloatArray) -> FloatArray:
    """ln density of measured shares (..., n) with errors (..., n, n) if the true ones are uniform over all of sum 1.

    The integral of N(seen; x, error) over the simplex over its volume: the share of draws from N(seen, error) inside.
    """
    y, cov = _reduced(seen, error)
    inside: FloatArray = np.log(_inside(y, cov)) - np.log(_volume(seen.shape[-1]))
    return inside


def ln_shares_crater(seen: FloatArray, error: FloatArray, mean: FloatArray, scatter: FloatArray) -> FloatArray:
    """ln density of measured shares (..., n) if the true ones are N(mean, scatter) cut to shares of 0 or more.

    N(seen; mean, error + scatter) times the probability of valid shares after, over that before the rock was seen.
    """
    y, noise = _reduced(seen, error)
    m, prior = _reduced(mean, scatter)
    total = noise + prior
    gain = np.swapaxes(np.linalg.solve(total, np.broadcast_to(prior, total.shape)), -1, -2)
    residual = y - m
    after_mean, after = m + (gain @ residual[..., None])[..., 0], prior - gain @ prior
    squares = (residual * np.linalg.solve(total, residual[..., None])[..., 0]).sum(axis=-1)
    ln_normal = -0.5 * (squares + np.linalg.slogdet(total)[1] + y.shape[-1] * np.log(2 * np.pi))
    density: FloatArray = ln_normal + (np.log(_inside(after_mean, after)) - np.log(_inside(m, prior)))
    return density


@cache
def _basis(size: int) -> FloatArray:
    """Orthonormal directions (size - 1, size) of differences between shares: Helmert's rows."""
    rows = [[1.0] * k + [-float(k)] + [0.0] * (size - k - 1) for k in range(1, size)]
    return np.array([np.array(row) / np.linalg.norm(row) for row in rows])


@cache
def _normal_draws(size: int) -> FloatArray:
    """Standard normal points (DRAWS, size - 1) that fill space evenly, the same in every run."""
    from scipy.special import ndtri
    from scipy.stats import qmc

    points = qmc.Sobol(size - 1, scramble=False).random(2 * DRAWS)[DRAWS:]
    return np.asarray(ndtri(points), float)


def _reduced(shares: FloatArray, covariance: FloatArray) -> tuple[FloatArray, FloatArray]:
    basis = _basis(shares.shape[-1])
    return (shares - 1 / shares.shape[-1]) @ basis.T, basis @ covariance @ basis.T


def _inside(mean: FloatArray, covariance: FloatArray) -> FloatArray:
    """Probability that shares with these means and covariances (in differences) are all 0 or more. (..., n - 1)

    By the symmetric root of the covariance, which is one; its eigenvectors are not where variances are equal, and then
    those of one processor's LAPACK are not another's.
    """
    values, vectors = np.linalg.eigh(covariance)
    root = vectors * np.sqrt(np.maximum(values, 0.0))[..., None, :] @ np.swapaxes(vectors, -1, -2)
    size = mean.shape[-1] + 1
    basis, draws = _basis(size), _normal_draws(size).T
    shares_inside = np.empty(mean.shape[:-1])
    for place in np.ndindex(shares_inside.shape):
        shares = basis.T @ (mean[place][:, None] + root[place] @ draws) + 1 / size
        shares_inside[place] = np.count_nonzero(shares.min(axis=0) >= 0) / DRAWS
    return np.maximum(shares_inside, LEAST_INSIDE)


def _volume(size: int) -> float:
    """Volume of the shares that add up to 1, in the coordinates of `_basis`: sqrt(n) / (n - 1)!"""
    return sqrt(size) / factorial(size - 1)


def _ln_band(
    name: str, seen: FloatArray, error: FloatArray, mean: float, scatter: float, systematic_nm: float
) -> FloatArray:
    """ln Bayes factors of centres (n,): a normal law about the crater's against a uniform one over the range."""
    from scipy.stats import norm

    low, high = BAND_RANGE_NM[name]
    noise = np.hypot(error, systematic_nm)
    broad = (norm.cdf(high, seen, noise) - norm.cdf(low, seen, noise)) / (high - low)
    factor: FloatArray = norm.logpdf(seen, mean, np.hypot(noise, scatter)) - np.log(
        np.maximum(broad, np.finfo(float).tiny)
    )
    return factor


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
        check_ranges(self, {SHARE: "systematic", "[0, 500]": "band_systematic_nm"})


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
    per_crater = [_of_rocks([match.craters[place] for match in matches]) for place in range(len(first) - 1)]
    nothing = np.full(len(matches), np.nan)
    rest: dict[str, Any] = {
        "log_bayes_factor": 0 * row[: len(matches)],
        "posterior": [match.other_posterior for match in matches],
    }
    differ = {
        key: np.column_stack([*(cells[key] for cells in per_crater), rest.get(key, nothing)]).ravel()
        for key in per_crater[0]
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


def match_rocks(
    rocks: Sequence[Rock], craters: Sequence[Crater], site: Point, settings: MatchSettings,
    progress: Progress | None = None,
) -> "RockMatches":  # fmt: skip
    """Match rocks found at one site (latitude, longitude in deg) with candidate craters.

    Raises ParameterError where no crater can have delivered a rock to the site.
    """
    priors = crater_priors(craters, site, settings.prior)
    seen = _compared(CompositionRows.of([rock.composition for rock in rocks]), settings)
    compositions = [crater.composition for crater in craters]
    weights = np.array([*(prior.probability for prior in priors), settings.prior.other_weight])
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
    evidence = EvidenceRows(arrays["ln_modes"], arrays["ln_bands"], seen, compositions)
    return RockMatches(rocks, craters, priors, evidence, arrays["posterior"], weights, site)


def _compared(rocks: CompositionRows, settings: MatchSettings) -> CompositionRows:
    """What of the rocks is compared."""
    nothing = np.full_like(rocks.modes, np.nan), np.full_like(rocks.centers_nm, np.nan)
    modes = rocks.modes if settings.use_modes else nothing[0]
    return replace(rocks, modes=modes, centers_nm=rocks.centers_nm if settings.use_bands else nothing[1])


def _columns_of_matches(
    seen: CompositionRows, *, craters: Sequence[Composition], weights: FloatArray, settings: MatchSettings
) -> dict[str, Any]:
    errors = {"systematic": settings.systematic, "band_systematic_nm": settings.band_systematic_nm}
    evidence = evidence_rows(seen, craters, **errors)
    posterior = _posterior(weights, np.column_stack([evidence.ln_total, np.zeros(len(seen.modes))]))
    return {"ln_modes": evidence.ln_modes, "ln_bands": evidence.ln_bands, "posterior": posterior}


class RockMatches(Sequence[RockMatch]):
    """A match of each rock, made when it is asked for.

    `priors` of the c craters and `evidence` of what the compositions say; `posterior` (n, c + 1) and prior `weights`
    (c + 1,) of each crater, and last of other sources.
    """

    def __init__(
        self, rocks: Sequence[Rock], craters: Sequence[Crater], priors: Sequence[CraterPrior], evidence: EvidenceRows,
        posterior: FloatArray, weights: FloatArray, site: Point,
    ) -> None:  # fmt: skip
        self.rocks, self.craters, self.priors, self.evidence = rocks, craters, priors, evidence
        self.posterior, self.weights = posterior, weights
        self._flight = [
            (azimuth_deg(site, crater.center), launch_speed_m_s(crater.diameter_km, prior.distance_km))
            for crater, prior in zip(craters, priors, strict=True)
        ]
        tested = np.array([not rock.untested for rock in rocks], dtype=bool)
        self.decided = tested & self._speaks() & ~self._fits_crater_of_site()

    def __len__(self) -> int:
        return len(self.rocks)

    @overload
    def __getitem__(self, index: int) -> RockMatch: ...
    @overload
    def __getitem__(self, index: slice) -> list[RockMatch]: ...
    def __getitem__(self, index: int | slice) -> RockMatch | list[RockMatch]:
        if isinstance(index, slice):
            return [self[row] for row in range(*index.indices(len(self)))]
        row = range(len(self))[index]
        *shares, rest = self.posterior[row].tolist()
        items = zip(self.craters, self.priors, shares, self._flight, strict=True)
        craters = tuple(
            CraterMatch(crater, prior, self.evidence.at(row, k), share, *flight)
            for k, (crater, prior, share, flight) in enumerate(items)
        )
        decided, rock = bool(self.decided[row]), self.rocks[row]
        status = _status(rock, craters, rest, decided)
        return RockMatch(rock, craters, float(self.weights[-1]), rest, decided, status)

    def _speaks(self) -> BoolArray:
        """Whether of each rock one source is decided: its posterior against all others, and what composition adds.

        ln[p / (1 - p)] of the likeliest, with p its posterior, and the same less that of its prior, are `DECIDES` at
        least: with a prior of 20 : 1 alone nothing is decided.
        """
        first = np.argmax(self.posterior, axis=1)
        weights = np.broadcast_to(self.weights, self.posterior.shape)
        odds, before = (_ln_odds(shares, first) for shares in (self.posterior, weights))
        with np.errstate(invalid="ignore"):
            return np.asarray((odds >= DECIDES) & (odds - before >= DECIDES))

    def _fits_crater_of_site(self) -> BoolArray:
        """Whether composition goes as well with a crater that the site lies in as with the likeliest source."""
        inside = np.array([prior.ejecta_m is None for prior in self.priors], dtype=bool)
        factors = np.column_stack([self.evidence.ln_total, np.zeros(len(self))])
        first = factors[np.arange(len(self)), np.argmax(self.posterior, axis=1)]
        best = np.where(inside, factors[:, :-1], -np.inf).max(axis=1, initial=-np.inf)
        return np.asarray((best > 0.0) & (best >= first))


def _posterior(priors: FloatArray, ln_factors: FloatArray) -> FloatArray:
    """Priors (c,) times exp of the ln Bayes factors (n, c), over their sum; exact however small they are."""
    with np.errstate(divide="ignore"):
        ln = np.log(priors) + ln_factors
    weights = np.exp(ln - ln.max(axis=1, keepdims=True))
    result: FloatArray = weights / weights.sum(axis=1, keepdims=True)
    return result


def _ln_odds(shares: FloatArray, place: IntArray) -> FloatArray:
    """ln of one share (n, s) of each row over the sum of the others."""
    chosen = np.arange(shares.shape[1]) == place[:, None]
    with np.errstate(divide="ignore"):
        return np.asarray(np.log(shares[chosen]) - np.log(np.where(chosen, 0.0, shares).sum(axis=1)))


def _remaining(matches: Sequence[CraterMatch], other: float) -> list[tuple[str, float]]:
    """Names and posteriors of the fewest sources that have `REMAIN` together, the likeliest first."""
    named = sorted([(OTHER, other), *((m.crater.name, m.posterior) for m in matches)], key=lambda one: -one[1])
    below = np.cumsum([share for _, share in named]) < REMAIN
    return named[: int(below.sum()) + 1]


def _fitting_inside(matches: Sequence[CraterMatch], first: str) -> str:
    """Craters that the site lies in and composition goes with at least as well as with the likeliest source."""
    least = next((item.ln_bayes_factor for item in matches if item.crater.name == first), 0.0)
    inside = [item for item in matches if item.contains_site and item.ln_bayes_factor > 0.0]
    return some_of([item.crater.name for item in inside if item.ln_bayes_factor >= least], NAMED)


def _status(rock: Rock, matches: Sequence[CraterMatch], other: float, decided: bool) -> str:
    """One sentence: which source it is or which remain, and whether it is composition or the prior that says so."""
    left = _remaining(matches, other)
    first = f"{left[0][0]} ({left[0][1]:.2f})"
    shown = some_of([f"{name} ({share:.2f})" for name, share in left], NAMED)
    remain = f"not decided: {shown} remain" if len(left) > 1 else f"not decided: {first} leads"
    if not any(item.evidence.minerals or item.evidence.bands for item in matches):
        given = rock.composition.modes or rock.composition.bands
        what = "shares of its minerals" if rock.composition.modes else "band centres"
        unknown = "; ".join(rock.remarks) or "no composition of the rock is known"
        why = f"no crater has {what} to compare with" if given else unknown
        return f"{remain}; composition decides nothing: {why}; the posterior is the prior"
    if decided and left[0][0] == OTHER:
        return "goes with none of the craters whose composition is known: another source is likelier than all of them"
    if decided:
        return f"likeliest {first}; the composition favours it strongly"
    if len(left) == 1 and not rock.untested:
        if inside := _fitting_inside(matches, left[0][0]):
            return f"{remain}; composition goes as well with {inside}, in which the site lies: it may be of its floor"
        return f"{remain} by the prior; composition adds less than 20 : 1 for it"
    untested = "; do not rely on it: the method was not tested on rocks like this one, so its shares may be wrong"
    return f"{remain}; {_by_composition(matches)}{untested if rock.untested else ''}"


def _by_composition(matches: Sequence[CraterMatch]) -> str:
    """For and against which craters composition speaks, and what that does to their places; the others are left."""
    there = [item for item in matches if item.prior.probability > 0]
    places = [sorted(there, key=key) for key in (lambda one: -one.prior.probability, lambda one: -one.posterior)]
    compared = [item for item in there if item.evidence.minerals or item.evidence.bands]
    parts = []
    for item in sorted(compared, key=lambda one: -abs(one.ln_bayes_factor)):
        before, now = (order.index(item) + 1 for order in places)
        moved = f"place {before} by the prior, {now} with it" if before != now else f"place {now} as by the prior"
        value = item.ln_bayes_factor
        side = f"{'strongly ' * (abs(value) >= DECIDES)}{'for' if value > 0 else 'against'}"
        odds = f"{exp(value):.2g} : 1" if value > 0 else f"1 : {exp(-value):.2g}"
        parts.append(f"{side} {item.crater.name} (odds {odds}, {moved})")
    rest = "; the others stand as by the prior: nothing of theirs can be compared" if len(compared) < len(there) else ""
    return f"composition speaks {some_of(parts, NAMED)}{rest}"


def assumptions(
    matches: RockMatches,
    given: tuple[str, Sequence[MapReport]],
    site_of_rocks: tuple[Point, bool],
    settings: MatchSettings,
) -> list[str]:
    """In sentences; `given` are where the craters are from and what maps gave of them, `site_of_rocks` the site of the
    rocks and whether it is that of Chang'E-4 because none was given."""
    (source, maps), (site, site_assumed) = given, site_of_rocks
    prior, whose = settings.prior, ", that of Chang'E-4, since none was given (assumed)" if site_assumed else ""
    lines = [
        f"site {site[0]:g}, {site[1]:g} deg{whose}; craters from {source}",
        f"two methods disagree by {settings.systematic:g} in the share of a mineral and "
        f"{settings.band_systematic_nm:g} nm in a band centre, one standard deviation (assumed)",
        f"other sources than these craters: prior {prior.other_weight:g}, any composition (assumed)",
        *_craters_notes(matches[0].craters, settings),
        *_not_compared(matches),
    ]
    if prior.kind == "uniform":
        return [*lines, "prior: all craters alike but those that contain the site", *_map_notes(maps)]
    return [*lines, *_prior_notes(site, settings, matches[0].craters), *_map_notes(maps)]


def _not_compared(matches: RockMatches) -> list[str]:
    """Minerals of rocks that no crater states, where any states modes."""
    stated = {mineral for crater in matches.craters for mineral in crater.composition.modes}
    of_rocks = np.atleast_1d(np.isfinite(matches.evidence.rocks.modes).any(axis=0))
    left = [mineral for k, mineral in enumerate(WITH_BANDS) if of_rocks[k] and mineral not in stated]
    text = f"no crater states its {' or '.join(left)}: shares of the rocks are compared without"
    return [text] if left and stated else []


def _craters_notes(items: Sequence[CraterMatch], settings: MatchSettings) -> list[str]:
    unknown = [i.crater.name for i in items if not i.crater.composition.comparable and not i.contains_site]
    inside = [i.crater.name for i in items if i.contains_site]
    both = [i.crater.name for i in items if i.evidence.minerals and i.evidence.bands]
    lines = []
    if unknown:
        lines.append(f"composition unknown, so that ln BF is 0, neither for nor against: {', '.join(unknown)}")
    if inside:
        lines.append(f"contain the site, where they left no ejecta, and are left out: {', '.join(inside)}")
    if both:
        lines.append(
            "modes and bands are counted as independent, which from one spectrum they are not (--use): "
            f"{', '.join(both)}"
        )
    return lines


def _prior_notes(site: Point, settings: MatchSettings, items: Sequence[CraterMatch]) -> list[str]:
    prior = settings.prior
    surface = surface_age_ma(site, prior)
    lines = [
        f"prior: ejecta thickness ({prior.law}, transient crater), within a factor of {prior.thickness_factor:g}",
        f"ejecta of craters older than {surface:g} Ma lie below the surface and count nothing",
        "ages uniform in the logarithm over their range; where the catalogue has none 1-4200 Ma (assumed)",
    ]
    if prior.exposure:
        lines.append(
            f"half of all boulders of 2 m are destroyed in {_shown(prior.rock_life_ma)} Ma (Basilevsky et al. 2013); "
            f"rock of {prior.rock_size_m:g} m, life with size^{prior.life_exponent:g} (assumed)"
        )
    else:
        lines.append("rocks last for ever (--no-exposure)")
    if prior.re_excavation:
        lines.append(
            f"buried ejecta come up with younger ejecta ({prior.stirring:g} times Oberbeck's ratio) and by small local "
            f"craters ({_shown(prior.gardening_m)} m, assumed: it decides between young and old craters)"
        )
    else:
        lines.append("buried ejecta stay buried (--no-re-excavation)")
    far = [i.crater.name for i in items if i.prior.distance_km > pi / 2 * MOON_RADIUS_KM]
    if far:
        lines.append(f"beyond a quarter of the Moon the laws are too low, ejecta converge: {', '.join(far)}")
    return lines


def _shown(span: Range) -> str:
    return f"{span.low:g}" if span.low == span.high else f"{span.low:g}-{span.high:g}"


def _map_notes(reports: Sequence[MapReport]) -> list[str]:
    return list(Counter(sorted(f"{item.crater}: {item.status}" for item in reports)))
