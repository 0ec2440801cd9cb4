"""Fits of an image: the contest of minima is run at some pixels, the others start from the nearest of these, and
neighbours whose solutions differ try each other's until nobody finds anything lower.

Two minima of one spectrum nearly always differ in which bands absorb at all: 95 % of the pairs did, in made-up images
and in images of measured spectra. Neighbours are asked by that.

The image is cut into tiles of `TILE` pixels, counted from its first line and sample; a tile's fits depend on what is in
the tile alone: not on blocks, threads or the order in which they are worked on.
"""

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np

from lunarsci.arrays import BoolArray, FloatArray, IndexArray
from lunarsci.compiled import compiled, each_in_threads
from lunarsci.errors import DataError, ParameterError
from lunarsci.spectra.mgm.batch import NOT_FITTED, FitBatch, describe_rows, joined, problem_of
from lunarsci.spectra.mgm.data import MgmRows, prepare_rows
from lunarsci.spectra.mgm.fit import (
    DEFAULT_STARTS,
    MAX_ITERATIONS,
    TOLERANCE,
    hops_of,
    same_channels,
    scaled,
    starting_points,
)
from lunarsci.spectra.mgm.levenberg_marquardt import (
    CONVERGED,
    Channels,
    DescentOptions,
    KernelFits,
    descend,
    workspace_for,
)
from lunarsci.spectra.mgm.model import MgmModel
from lunarsci.spectra.mgm.multistart import Multistart

TILE = 32
CONTEST_EVERY = 8
"""Pixels from one contest to the next, along lines and samples."""
DENSEST = 2
RESTLESS = 0.08
"""Share of a tile's pixels that took over a neighbour's minimum above which contests are run twice as densely."""
MOST_ROUNDS = 12
FIRST_DAMPING = 1e-3
WORTH = 0.01
"""By how much another minimum must be lower to be taken, in chi-square: a tenth of a standard error."""
ORIGINS = ("single_descent", "from_neighbour", "contest", "not_fitted")
SINGLE, NEIGHBOUR, CONTEST, NOWHERE = range(4)


@dataclass(frozen=True, slots=True, eq=False)
class RegionFits:
    """Fits of the pixels of an image.

    Attributes
    ----------
    batch : of n pixels.
    origin : (n,) where a pixel's minimum came from, a place in `ORIGINS`.
    unsettled : (n,) whether a neighbour still changed when the rounds were over.
    """

    batch: FitBatch
    origin: IndexArray
    unsettled: BoolArray


def fit_region(
    wavelength_nm: FloatArray,
    reflectance: FloatArray,
    places: IndexArray,
    model: MgmModel,
    *,
    sigma: FloatArray | None = None,
    model_error: float | None = None,
    starts: int = DEFAULT_STARTS,
    contest_every: int = CONTEST_EVERY,
) -> RegionFits:
    """Fits of an image's pixels, in which neighbours help.

    Parameters
    ----------
    wavelength_nm, reflectance, sigma, model_error : of n pixels, as `fit_arrays` takes them. [nm, -]
    places : (n, 2) line and sample of each, whole numbers from 0.
    model : as `mgm_model` makes it.
    starts : of a contest, as in `fit_arrays`.
    contest_every : a contest every so many lines and samples, 1 to 32, and more densely in tiles where much is taken
        over from neighbours. With 1 no minimum is above that of `fit_arrays`.

    Raises
    ------
    ParameterError as `fit_arrays`, and for a `contest_every` outside of that range.
    """
    if not 1 <= contest_every <= TILE:
        raise ParameterError(f"a contest every {contest_every} pixels; give 1 to {TILE}")
    count, p = len(reflectance), model.prior.size
    spectra = _Spectra.of(wavelength_nm, reflectance, model, sigma, model_error)
    chi2, objective, iterations, sigmas = np.full((4, count), np.nan)
    status, competing = np.full(count, float(NOT_FITTED)), np.full(count, np.inf)
    solved = KernelFits(
        np.full((count, p), np.nan), np.empty((0, p, p)), chi2, objective, iterations, status, competing, sigmas
    )
    origin, unsettled = np.full(count, NOWHERE), np.zeros(count, dtype=bool)
    tiles = list(_tiles(places, spectra.fitted))

    def some(number: int) -> None:
        rows = tiles[number]
        search = Tile(spectra.part(rows), places[rows], model, starts)
        search.solve(contest_every)
        search.write(solved, rows)
        origin[rows], unsettled[rows] = search.origin, search.changed

    each_in_threads(some, len(tiles))
    return RegionFits(spectra.described(model, solved), origin, unsettled)


def _tiles(places: IndexArray, fitted: BoolArray) -> Iterator[IndexArray]:
    """Pixels to be fitted, tile by tile, in each by line and sample."""
    rows = np.flatnonzero(fitted)
    if not rows.size:
        return
    tile, (line, sample) = places[rows] // TILE, places[rows].T
    order = np.lexsort((sample, line, *tile.T))
    edges = np.flatnonzero((np.diff(tile[order], axis=0) != 0).any(axis=1)) + 1
    yield from np.split(rows[order], edges)


@dataclass(frozen=True, slots=True, eq=False)
class _Spectra:
    """Prepared spectra of n pixels on all channels, without weight where one cannot be used.

    Attributes
    ----------
    groups : pixels with the same usable channels, and their spectra on these.
    channels : ln R less `level`, (n,), and the rest, as the kernel takes them.
    fitted : (n,) whether there are enough channels.
    """

    groups: list[tuple[IndexArray, MgmRows]]
    channels: Channels
    level: FloatArray
    fitted: BoolArray

    @classmethod
    def of(
        cls, wavelength_nm: FloatArray, reflectance: FloatArray, model: MgmModel, sigma: FloatArray | None,
        model_error: float | None,
    ) -> "_Spectra":  # fmt: skip
        usable = np.isfinite(reflectance) & (reflectance > 0)
        data, root = np.zeros(reflectance.shape), np.zeros(reflectance.shape)
        level, fitted = np.zeros(len(data)), np.zeros(len(data), dtype=bool)
        groups = []
        for rows in same_channels(usable):
            keep = usable[rows[0]]
            own, noise = reflectance[np.ix_(rows, keep)], None if sigma is None else sigma[np.ix_(rows, keep)]
            try:
                ready = prepare_rows(wavelength_nm[keep], own, sigma=noise, model_error=model_error, whole=model.whole)
            except DataError:
                continue
            at = np.ix_(rows, np.searchsorted(wavelength_nm, ready.wavelength_nm))
            ln_reflectance = np.log(ready.reflectance)
            level[rows] = ln_reflectance.mean(axis=1) if model.scale_free else 0.0
            data[at], root[at] = ln_reflectance - level[rows][:, None], np.sqrt(ready.weight)
            fitted[rows] = True
            groups.append((rows, ready))
        inside = (root > 0).any(axis=0)
        grid = wavelength_nm[inside]
        basis = np.ascontiguousarray(model.basis(grid).T)[None]
        return cls(groups, Channels((grid / 1e3)[None], basis, data[:, inside], root[:, inside]), level, fitted)

    def part(self, rows: IndexArray) -> Channels:
        """Some of them, as the kernel takes them."""
        return self.channels.part(rows)

    def described(self, model: MgmModel, solved: KernelFits) -> FitBatch:
        """Errors, ratios and flags of all."""
        parts = []
        for rows, ready in self.groups:
            own = KernelFits(*(
                getattr(solved, name)[rows] if name != "covariance" else solved.covariance
                for name in KernelFits.__dataclass_fields__
            ))  # fmt: skip
            points = scaled(model, own.parameters, self.level[rows])
            parts.append((rows, describe_rows(ready, model, own, points)))
        return joined(len(self.level), parts, model)


class Tile:
    """The search of the minima of one tile.

    Attributes
    ----------
    points, outcomes : (n, p), and (n, 4) chi-square, objective, iterations and status.
    origin, changed : (n,) as in `RegionFits`; whether a pixel changed in the last round.
    """

    def __init__(self, spectra: Channels, places: IndexArray, model: MgmModel, starts: int) -> None:
        self.spectra, self.model, self.starts, self.problem = spectra, model, starts, problem_of(model)
        self.place = places - places.min(axis=0) // TILE * TILE
        self.grid = np.full((TILE, TILE), -1)
        self.grid[tuple(self.place.T)] = np.arange(len(places))
        rows, size = len(places), model.prior.size
        self.used = np.count_nonzero(spectra.root_weight, axis=1).astype(float)
        self.space = workspace_for(size, model.degrees, spectra.data.shape[1])
        self.points, self.outcomes = np.zeros((rows, size)), np.full((rows, 4), np.inf)
        self.competing, self.competing_sigmas = np.full(rows, np.inf), np.zeros(rows)
        self.origin, self.changed = np.full(rows, SINGLE), np.ones(rows, dtype=bool)

    def solve(self, every: int) -> None:
        """Contests every so many pixels, a descent from the nearest of them elsewhere, and the exchange."""
        asked = self._lattice(every)
        self._contest(asked)
        distance = ((self.place[:, None] - self.place[asked]) ** 2).sum(axis=2)
        others = np.flatnonzero(self.origin == SINGLE)
        self._try(others, self.points[asked[distance[others].argmin(axis=1)]], np.empty(0))
        restless = self._exchange()
        while restless > RESTLESS and every > DENSEST:
            every //= 2
            asked = self._lattice(every)
            self.changed[:] = False
            self._contest(asked[self.origin[asked] != CONTEST])
            restless = self._exchange()

    def write(self, solved: KernelFits, rows: IndexArray) -> None:
        """Write what was found into the rows of a whole."""
        solved.parameters[rows] = self.points
        for column, values in zip(
            (solved.chi2, solved.objective, solved.iterations, solved.status), self.outcomes.T, strict=True
        ):
            column[rows] = values
        solved.competing[rows], solved.competing_sigmas[rows] = self.competing, self.competing_sigmas

    def _lattice(self, every: int) -> IndexArray:
        """Pixels every so many lines and samples, or the first of the tile."""
        inside = self.grid[every // 2 :: every, every // 2 :: every].ravel()
        inside = inside[inside >= 0]
        return inside if inside.size else np.zeros(1, dtype=np.intp)

    def _contest(self, rows: IndexArray) -> None:
        """Search the minima of some pixels from all starts and by all hops."""
        if not rows.size:
            return
        search = Multistart(self.spectra.part(rows), self.problem, TOLERANCE, MAX_ITERATIONS)
        search.start(starting_points(self.model, self.spectra.data[rows], self.starts))
        search.hop(hops_of(self.model))
        before = self.outcomes[rows, 1]
        self._take(rows, search.best, search.outcome)
        closer = (search.outcome[:, 1] <= before) & (search.competing < self.competing[rows])
        self.competing[rows[closer]] = search.competing[closer]
        self.competing_sigmas[rows[closer]] = search.competing_sigmas[closer]
        self.origin[rows] = CONTEST
        self.changed[rows] = True

    def _exchange(self) -> float:
        """Let neighbours try each other's solutions until nobody gains; the share of pixels that took one over."""
        gained = np.zeros(len(self.points), dtype=bool)
        for _ in range(MOST_ROUNDS):
            keys = _kind_of(self.points, self.model)
            rows, lenders = _askers(self.grid, keys, self.outcomes[:, 1], self.changed)
            self.changed[:] = False
            if not rows.size:
                break
            bars = self.outcomes[rows, 1] - WORTH
            won = self._try(rows, self.points[lenders], bars)
            self.changed[won], gained[won] = True, True
            self.origin[won] = NEIGHBOUR
        return float(gained.mean())

    def _try(self, rows: IndexArray, starts: FloatArray, bars: FloatArray) -> IndexArray:
        """Descend on spectra `rows` from as many starts; the pixels that found something lower."""
        if not rows.size:
            return rows
        points, outcomes = np.array(starts), np.empty((len(rows), 4))
        options = DescentOptions(False, FIRST_DAMPING, TOLERANCE, MAX_ITERATIONS)
        nothing = np.empty((0, starts.shape[1], starts.shape[1]))
        descend(self.spectra, self.used, self.problem, options, rows, points, outcomes, self.space, nothing, bars)
        return self._take(rows, points, outcomes)

    def _take(self, rows: IndexArray, points: FloatArray, outcomes: FloatArray) -> IndexArray:
        """Take the lowest for each pixel where it is lower by `WORTH`, or the first; the pixels that did."""
        fine = (outcomes[:, 3] == CONVERGED) | ~np.isfinite(self.outcomes[rows, 1])
        order = np.lexsort((outcomes[:, 1], rows))
        order = order[fine[order]]
        order = order[np.diff(rows[order], prepend=-1) > 0]
        own: IndexArray = rows[order]
        gain = self.outcomes[own, 1] - outcomes[order, 1]
        own, order, gain = own[~(gain < WORTH)], order[~(gain < WORTH)], gain[~(gain < WORTH)]
        self.competing[own], self.competing_sigmas[own] = gain, np.inf
        self.points[own], self.outcomes[own] = points[order], outcomes[order]
        return own


def _kind_of(points: FloatArray, model: MgmModel) -> IndexArray:
    """A number for each pixel, (n,), alike where the same bands absorb."""
    absorbs = points[:, model.degrees + 2 :: 3] != 0
    return np.asarray(absorbs @ (1 << np.arange(absorbs.shape[1])), dtype=np.intp)


@compiled
def _askers(grid: Any, keys: Any, objective: Any, changed: Any) -> Any:
    """Pairs of a pixel and a neighbour whose solution it tries: of each other kind about it the lowest that changed."""
    lines, samples = grid.shape
    rows, lenders = np.empty(8 * keys.size, dtype=np.int64), np.empty(8 * keys.size, dtype=np.int64)
    found, near = 0, np.empty(8, dtype=np.int64)
    for y in range(lines):
        for x in range(samples):
            if grid[y, x] < 0:
                continue
            count = 0
            for b in range(max(0, y - 1), min(lines, y + 2)):
                for a in range(max(0, x - 1), min(samples, x + 2)):
                    other = grid[b, a]
                    if other < 0 or not changed[other] or keys[other] == keys[grid[y, x]]:
                        continue
                    known = 0
                    while known < count and keys[near[known]] != keys[other]:
                        known += 1
                    if known == count:
                        near[count], count = other, count + 1
                    elif objective[other] < objective[near[known]]:
                        near[known] = other
            for k in range(count):
                rows[found], lenders[found] = grid[y, x], near[k]
                found += 1
    return rows[:found], lenders[:found]
