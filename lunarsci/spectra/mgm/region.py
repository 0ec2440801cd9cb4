"""Fits of an image: the contest of minima is run at some pixels, the others start from the nearest of these, and
try the solutions of other pixels near them, until nobody finds anything lower.

Two minima of one spectrum nearly always differ in which bands absorb at all, their kind: 95 % of the pairs did, in
made-up images and in images of measured spectra. A pixel tries other kinds than its own, from the likest spectra, with
the bands of that kind alone; nine in ten of these descents are given up after two steps.

The image is cut into tiles of `TILE` pixels, counted from its first line and sample; a tile's fits depend on what is in
the tile alone: not on blocks, threads or the order in which they are worked on.

Kinds of solutions, which bands absorb: the model of these alone, and which pixels try whose.
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
    same_channels,
    scaled,
    search_of,
)
from lunarsci.spectra.mgm.levenberg_marquardt import (
    CONVERGED,
    FIRST_DAMPING,
    LATER_DAMPING,
    Channels,
    DescentOptions,
    FitProblem,
    Linearised,
    Workspace,
    descend,
    workspace_for,
)
from lunarsci.spectra.mgm.model import MgmModel
from lunarsci.spectra.mgm.multistart import KernelFits, Multistart


def kinds_of(points: FloatArray, model: MgmModel) -> IndexArray:
    """The kind of each of `points`, (n, p): a whole number whose bits say which bands absorb, (n,)."""
    absorbs = points[:, model.degrees + 2 :: 3] != 0
    return np.asarray(absorbs @ (1 << np.arange(absorbs.shape[1])), dtype=np.intp)


@dataclass(frozen=True, slots=True, eq=False)
class PartModel:
    """A model without the bands that do not absorb in a kind, its prior that of the others at strengths 0 of these.

    A band that does not absorb has no data: its centre and width are those that the prior expects from the others.

    Attributes
    ----------
    index : (k,) places of its parameters among the p of the model.
    problem : as the kernel takes it, with k parameters.
    model : the whole.
    rest, following : (p - k,) places of the others, and what they do when its parameters leave the prior, (k, p - k).
    """

    index: IndexArray
    problem: FitProblem
    rest: IndexArray
    following: FloatArray
    model: MgmModel

    @classmethod
    def of(cls, model: MgmModel, kind: int) -> "PartModel":
        """The part of a model for a kind."""
        m, bands = model.degrees, (model.prior.size - model.degrees) // 3
        inside = np.repeat((kind >> np.arange(bands)) & 1 == 1, 3)
        index = np.concatenate([np.arange(m), m + np.flatnonzero(inside)])
        rest = m + np.flatnonzero(~inside)
        held = ~inside & (np.arange(inside.size) % 3 == 2)
        covariance = np.zeros((inside.size, inside.size))
        covariance[np.ix_(~held, ~held)] = np.linalg.inv(model.precision[m:, m:][np.ix_(~held, ~held)])
        precision_here = np.linalg.inv(covariance[np.ix_(inside, inside)])
        precision = np.array(model.precision[np.ix_(index, index)])
        precision[m:, m:] = precision_here
        following = np.zeros((index.size, rest.size))
        following[m:] = precision_here @ covariance[np.ix_(inside, ~inside)]
        whole = problem_of(model)
        parts = (np.ascontiguousarray(bound[index]) for bound in (model.lower, model.upper))
        problem = FitProblem(m, whole.logarithmic, model.prior[index], precision, *parts)
        return cls(index, problem, rest, following, model)

    def whole(self, points: FloatArray) -> FloatArray:
        """Parameters of the whole model, (n, p), from those of the part, (n, k)."""
        model = self.model
        points_all = np.empty((len(points), model.prior.size))
        points_all[:, self.index] = points
        others = model.prior[self.rest] + (points - self.problem.prior) @ self.following
        points_all[:, self.rest] = np.clip(others, model.lower[self.rest], model.upper[self.rest])
        points_all[:, self.rest[2::3]] = 0.0
        return points_all


@compiled
def _is_another(kind: int, kind_here: int) -> bool:
    """Whether a kind is to be tried: one that only lacks two or more of the own bands has never won."""
    lacking, apart = kind_here & ~kind, kind_here ^ kind
    return bool(apart != 0 and not (lacking == apart and apart & (apart - 1) != 0))


@compiled
def askers(
    grid: Any, tile: Any, place: Any, keys: Any, summary: Any, changed: Any, reach: int, most: int
) -> Any:  # fmt: skip
    """Pairs of a pixel and one within `reach` whose solution it tries: of `most` other kinds, where a pixel of it
    changed, the likest.

    Parameters
    ----------
    grid : (tiles, `TILE`, `TILE`) number of the pixel at each line and sample of a tile, -1 for none.
    tile, place : (n,) number of each pixel's tile, and (n, 2) its line and sample in that.
    keys : (n,) kind of its solution (`kinds_of`).
    summary : (n, s) by which spectra are compared.
    changed : (n,) whether its solution changed in the round before.
    """
    _, lines, samples = grid.shape
    rows, lenders = np.empty(most * keys.size, dtype=np.int64), np.empty(most * keys.size, dtype=np.int64)
    count_all, near, apart = 0, np.empty((2 * reach + 1) ** 2, dtype=np.int64), np.empty((2 * reach + 1) ** 2)
    for pixel in range(keys.size):
        count, window = 0, grid[tile[pixel]]
        for y in range(max(0, place[pixel, 0] - reach), min(lines, place[pixel, 0] + reach + 1)):
            for x in range(max(0, place[pixel, 1] - reach), min(samples, place[pixel, 1] + reach + 1)):
                other = window[y, x]
                if other < 0 or not changed[other] or not _is_another(keys[other], keys[pixel]):
                    continue
                unlike = 0.0
                for i in range(summary.shape[1]):
                    unlike += (summary[other, i] - summary[pixel, i]) ** 2
                at = 0
                while at < count and keys[near[at]] != keys[other]:
                    at += 1
                if at == count:
                    near[count], apart[count], count = other, unlike, count + 1
                elif unlike < apart[at]:
                    near[at], apart[at] = other, unlike
        for k in np.argsort(apart[:count])[:most]:
            rows[count_all], lenders[count_all] = pixel, near[k]
            count_all += 1
    return rows[:count_all], lenders[:count_all]


@compiled
def likest_of(rows: Any, solved: Any, tile: Any, place: Any, data: Any, root: Any, most: int) -> Any:
    """For each of `rows`, of the `most` nearest of `solved` in its tile, the likest; tiles ascend in `solved`.

    `rows` and `solved` are numbers of pixels; `tile` and `place` as in `askers`; `data` and `root`, (n, c), are ln R
    and the root of its weight.
    """
    result = np.empty(rows.size, dtype=np.int64)
    near, apart = np.empty(most, dtype=np.int64), np.empty(most, dtype=np.int64)
    others = tile[solved]
    for number in range(rows.size):
        pixel, count = rows[number], 0
        for k in range(np.searchsorted(others, tile[pixel]), np.searchsorted(others, tile[pixel] + 1)):
            other = solved[k]
            away = (place[pixel, 0] - place[other, 0]) ** 2 + (place[pixel, 1] - place[other, 1]) ** 2
            if count == most and away >= apart[most - 1]:
                continue
            at = min(count, most - 1)
            while at > 0 and apart[at - 1] > away:
                near[at], apart[at] = near[at - 1], apart[at - 1]
                at -= 1
            near[at], apart[at], count = other, away, min(count + 1, most)
        least = np.inf
        for k in range(count):
            unlike = 0.0
            for i in range(data.shape[1]):
                if root[near[k], i] > 0.0:
                    unlike += ((data[near[k], i] - data[pixel, i]) * root[pixel, i]) ** 2
            if unlike < least:
                result[number], least = near[k], unlike
    return result


TILE = 32
"""Lines, and samples, of a tile."""
TOGETHER = 8
"""Tiles searched together in one thread, so that the lanes of the processor are busy to the end."""
CONTEST_EVERY = 8
"""Pixels from one contest to the next, along lines and samples; chosen by `tests/benchmarks/bench_map.py`."""
DENSEST = 2
"""Pixels from one contest to the next at which they become no denser."""
RESTLESS = 0.08
"""Share of pixels of a tile that took a minimum of a neighbour, above which contests are twice as dense; assumed."""
MOST_ROUNDS = 12
"""Of an exchange between neighbours."""
NEAREST = 4
"""Solved pixels among which one looks for the likest spectrum, to start from its solution."""
FAR, NEAR = 8, 4
"""How far, in lines and samples, a pixel looks for other kinds of solutions, and for those that are new."""
TRIED = 3
"""Kinds that it tries at once, those of the likest spectra."""
SUMMARY = 10
"""Channels that are put together to compare spectra."""
NEARLY, FINALLY = 1e-2, 3e-4
"""Decrease to be expected at which a descent on the bands of a kind ends, and one on all bands; that step is taken."""
SLACK = 5.0
"""How much more than its step promises a descent may still gain, in chi-square."""
ROUGHLY = DescentOptions(False, FIRST_DAMPING, NEARLY, MAX_ITERATIONS, ahead=True)
"""How to descend in singles, before a minimum is finished in doubles."""
WORTH = 0.01
"""By how much another minimum must be lower to be taken, in chi-square: that of a tenth of a standard error;
assumed."""
ORIGINS = ("single_descent", "from_neighbour", "contest", "not_fitted")
SINGLE, NEIGHBOUR, CONTEST, NOWHERE = range(4)
"""Where a pixel's minimum came from: one descent, a neighbour's solution, a contest from all starts, no fit."""


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
    groups = [tiles[first : first + TOGETHER] for first in range(0, len(tiles), TOGETHER)]

    def some(number: int) -> None:
        rows = np.concatenate(groups[number])
        tile = np.repeat(np.arange(len(groups[number])), [len(pixels) for pixels in groups[number]])
        search = Search(spectra.part(rows), tile, places[rows] % TILE, model, starts)
        search.solve(contest_every)
        search.write(solved, rows)
        origin[rows], unsettled[rows] = search.origin, search.changed

    each_in_threads(some, len(groups))
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
    """Prepared spectra of n pixels on all channels, without weight where one cannot be used; filled by `of`.

    Attributes
    ----------
    groups : pixels with the same usable channels, and their spectra on these.
    channels : ln R less `level`, and the rest, as the kernel takes them.
    level : (n,) mean of ln R, which a model that is free of scale does without; 0 for others. [-]
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
            some, noise = reflectance[np.ix_(rows, keep)], None if sigma is None else sigma[np.ix_(rows, keep)]
            try:
                ready = prepare_rows(wavelength_nm[keep], some, sigma=noise, model_error=model_error, whole=model.whole)
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
            ends = KernelFits(*(
                getattr(solved, name)[rows] if name != "covariance" else solved.covariance
                for name in KernelFits.__dataclass_fields__
            ))  # fmt: skip
            points = scaled(model, ends.parameters, self.level[rows])
            parts.append((rows, describe_rows(ready, model, ends, points)))
        alone = len(parts) == 1 and len(parts[0][0]) == len(self.level)
        return parts[0][1] if alone else joined(len(self.level), parts, model)


class Search:
    """The search of the minima of some tiles, each of which knows nothing of the others.

    Attributes
    ----------
    spectra : of n pixels, as the kernel takes them; `counts`, (n,), of channels with weight.
    tile, place, grid, summary : as in `askers`.
    spaces, parts : workspaces by number of parameters and kind of numbers, and models by kind.
    points, outcomes : (n, p), and (n, 4) chi-square, objective, iterations and status.
    competing, competing_sigmas : (n,) as in `KernelFits`.
    origin, changed : (n,) as in `RegionFits`; whether a pixel changed in the last round.
    """

    def __init__(
        self, spectra: Channels, tile: IndexArray, place: IndexArray, model: MgmModel, starts: int
    ) -> None:  # fmt: skip
        self.spectra, self.model, self.starts, self.problem = spectra, model, starts, problem_of(model)
        self.tile, self.place = tile, place
        self.grid = np.full((tile[-1] + 1, TILE, TILE), -1)
        self.grid[tile, place[:, 0], place[:, 1]] = np.arange(len(tile))
        rows, size = len(tile), model.prior.size
        self.counts = np.count_nonzero(spectra.root_weight, axis=1).astype(float)
        self.spaces: dict[tuple[int, Any], Workspace] = {}
        self.parts: dict[int, PartModel] = {}
        self.points, self.outcomes = np.zeros((rows, size)), np.full((rows, 4), np.inf)
        self.competing, self.competing_sigmas = np.full(rows, np.inf), np.zeros(rows)
        self.origin, self.changed = np.full(rows, SINGLE), np.ones(rows, dtype=bool)
        cuts = np.arange(0, spectra.data.shape[1], SUMMARY)
        self.summary = np.add.reduceat(spectra.data, cuts, axis=1)

    def solve(self, every: int) -> None:
        """Contests every so many pixels, a descent from the likest of the nearest solved elsewhere, and the exchange;
        again with more contests in tiles that are restless."""
        active = np.ones(len(self.grid), dtype=bool)
        self._contest(self._lattice(every, active))
        for step in (every // 2, every // 4, 1):
            solved = np.isfinite(self.outcomes[:, 1])
            rows = self._lattice(max(1, step), active)
            rows = rows[~solved[rows]]
            starts = self.points[self._likest(rows, np.flatnonzero(solved))]
            self._take(rows, *self._on_all_bands(rows, self._roughly(rows, starts)))
        active &= self._exchange() > RESTLESS
        while active.any() and every > DENSEST:
            every //= 2
            rows = self._lattice(every, active)
            self.changed[:] = False
            self._contest(rows[self.origin[rows] != CONTEST])
            active &= self._exchange() > RESTLESS

    def write(self, solved: KernelFits, rows: IndexArray) -> None:
        """Write what was found into the rows of a whole."""
        solved.parameters[rows] = self.points
        for column, values in zip(
            (solved.chi2, solved.objective, solved.iterations, solved.status), self.outcomes.T, strict=True
        ):
            column[rows] = values
        solved.competing[rows], solved.competing_sigmas[rows] = self.competing, self.competing_sigmas

    def _lattice(self, every: int, tiles: BoolArray) -> IndexArray:
        """Pixels of some tiles every so many lines and samples; the first of a tile that has none there."""
        inside = self.grid[:, every // 2 :: every, every // 2 :: every].reshape(len(self.grid), -1)
        first = np.searchsorted(self.tile, np.flatnonzero((inside < 0).all(axis=1) & tiles))
        chosen = inside[tiles]
        return np.concatenate([chosen[chosen >= 0], first])

    def _likest(self, rows: IndexArray, solved: IndexArray) -> IndexArray:
        """For some pixels: of the `NEAREST` solved ones of their tile that with the likest spectrum."""
        data, root = self.spectra.data, self.spectra.root_weight
        return np.asarray(likest_of(rows, solved, self.tile, self.place, data, root, NEAREST), dtype=np.intp)

    def _contest(self, rows: IndexArray) -> None:
        """Search the minima of some pixels from all starts and by all hops."""
        if not rows.size:
            return
        search = Multistart(self.spectra.part(rows), self.problem, TOLERANCE, MAX_ITERATIONS)
        starts, hops = search_of(self.model, self.spectra.data[rows], self.starts)
        search.start(starts)
        search.hop(hops)
        before = self.outcomes[rows, 1]
        self._take(rows, search.best, search.outcome)
        closer = (search.outcome[:, 1] <= before) & (search.competing < self.competing[rows])
        self.competing[rows[closer]] = search.competing[closer]
        self.competing_sigmas[rows[closer]] = search.competing_sigmas[closer]
        self.origin[rows] = CONTEST
        self.changed[rows] = True

    def _exchange(self) -> FloatArray:
        """Let pixels try the kinds of solutions near them until nobody gains; the share that took one over, by tile."""
        gained = np.zeros(len(self.points), dtype=bool)
        for reach in (FAR, *(NEAR for _ in range(MOST_ROUNDS))):
            kinds = kinds_of(self.points, self.model)
            rows, lenders = askers(self.grid, self.tile, self.place, kinds, self.summary, self.changed, reach, TRIED)
            self.changed[:] = False
            if not rows.size:
                break
            points, outcomes = self._on_their_bands(rows, self.points[lenders], self.outcomes[rows, 1] - WORTH)
            lower = (outcomes[:, 3] == CONVERGED) & (outcomes[:, 1] < self.outcomes[rows, 1] - WORTH)
            rows = rows[lower]
            won = self._take(rows, *self._on_all_bands(rows, points[lower]))
            self.changed[won], gained[won] = True, True
            self.origin[won] = NEIGHBOUR
        return np.asarray(np.bincount(self.tile, gained) / np.bincount(self.tile))

    def _on_their_bands(
        self, rows: IndexArray, starts: FloatArray, bars: FloatArray
    ) -> tuple[FloatArray, FloatArray]:  # fmt: skip
        """Where starts lead to when only the bands that absorb there may, and the outcomes; above its bar a descent is
        given up."""
        points, outcomes = np.empty(starts.shape), np.empty((len(rows), 4))
        kinds = kinds_of(starts, self.model)
        order = np.argsort(kinds, kind="stable")
        for some in np.split(order, np.flatnonzero(np.diff(kinds[order])) + 1):
            kind = int(kinds[some[0]])
            part = self.parts[kind] = self.parts.get(kind) or PartModel.of(self.model, kind)
            ends = np.ascontiguousarray(starts[np.ix_(some, part.index)])
            options = ROUGHLY._replace(slack=SLACK)
            outcomes[some] = self._descend(part.problem.in_singles(), options, rows[some], ends, bars[some])
            points[some] = part.whole(ends)
        return points, outcomes

    def _roughly(self, rows: IndexArray, starts: FloatArray) -> FloatArray:
        """Near where starts lead to."""
        points = np.array(starts)
        self._descend(self.problem.in_singles(), ROUGHLY, rows, points, np.empty(0))
        return points

    def _on_all_bands(self, rows: IndexArray, starts: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Where starts near a minimum lead to, and the outcomes."""
        points = np.array(starts)
        options = DescentOptions(False, LATER_DAMPING, FINALLY, MAX_ITERATIONS, ahead=True)
        return points, self._descend(self.problem, options, rows, points, np.empty(0))

    def _descend(
        self, problem: FitProblem, options: DescentOptions, rows: IndexArray, points: FloatArray, bars: FloatArray
    ) -> FloatArray:
        """Move `points` (jobs, k), in singles where the problem is; the outcomes."""
        size, kind, outcomes = points.shape[1], problem.prior.dtype, np.empty((len(rows), 4))
        space = self.spaces.get((size, kind)) or workspace_for(
            size, problem.degrees, self.spectra.data.shape[1], kind.type
        )
        self.spaces[size, kind] = space
        descend(self.spectra, self.counts, problem, options, rows, points, outcomes, space, Linearised.of(size), bars)
        return outcomes

    def _take(self, rows: IndexArray, points: FloatArray, outcomes: FloatArray) -> IndexArray:
        """Take the lowest for each pixel where it is lower by `WORTH`, or the first; the pixels that did."""
        fine = (outcomes[:, 3] == CONVERGED) | ~np.isfinite(self.outcomes[rows, 1])
        order = np.lexsort((outcomes[:, 1], rows))
        order = order[fine[order]]
        order = order[np.diff(rows[order], prepend=-1) > 0]
        taken: IndexArray = rows[order]
        gain = self.outcomes[taken, 1] - outcomes[order, 1]
        taken, order, gain = taken[~(gain < WORTH)], order[~(gain < WORTH)], gain[~(gain < WORTH)]
        self.competing[taken], self.competing_sigmas[taken] = gain, np.inf
        self.points[taken], self.outcomes[taken] = points[order], outcomes[order]
        return taken
