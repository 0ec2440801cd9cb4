"""Kinds of solutions, which bands absorb: the model of these alone, and which pixels try whose."""

from dataclasses import dataclass
from typing import Any

import numpy as np

from lunarsci.arrays import FloatArray, IndexArray
from lunarsci.compiled import compiled
from lunarsci.spectra.mgm.batch import problem_of
from lunarsci.spectra.mgm.levenberg_marquardt import FitProblem
from lunarsci.spectra.mgm.model import MgmModel


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
    problem : as the kernel takes it.
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
        own = np.linalg.inv(covariance[np.ix_(inside, inside)])
        precision = np.array(model.precision[np.ix_(index, index)])
        precision[m:, m:] = own
        following = np.zeros((index.size, rest.size))
        following[m:] = own @ covariance[np.ix_(inside, ~inside)]
        whole = problem_of(model)
        parts = (np.ascontiguousarray(bound[index]) for bound in (model.lower, model.upper))
        problem = FitProblem(m, whole.logarithmic, model.prior[index], precision, *parts)
        return cls(index, problem, rest, following, model)

    def whole(self, points: FloatArray) -> FloatArray:
        """Parameters of the whole model, (n, p), from those of the part, (n, k)."""
        model = self.model
        found = np.empty((len(points), model.prior.size))
        found[:, self.index] = points
        others = model.prior[self.rest] + (points - self.problem.prior) @ self.following
        found[:, self.rest] = np.clip(others, model.lower[self.rest], model.upper[self.rest])
        found[:, self.rest[2::3]] = 0.0
        return found


@compiled
def _is_another(kind: int, own: int) -> bool:
    """Whether a kind is to be tried: one that only lacks two or more of the own bands has never won."""
    lacking, apart = own & ~kind, own ^ kind
    return bool(apart != 0 and not (lacking == apart and apart & (apart - 1) != 0))


@compiled(nogil=True)  # type: ignore[untyped-decorator]
def askers(
    grid: Any, tile: Any, place: Any, keys: Any, summary: Any, changed: Any, reach: int, most: int
) -> Any:  # fmt: skip
    """Pairs of a pixel and one within `reach` whose solution it tries: of `most` other kinds, where a pixel of it
    changed, the likest."""
    _, lines, samples = grid.shape
    rows, lenders = np.empty(most * keys.size, dtype=np.int64), np.empty(most * keys.size, dtype=np.int64)
    found, near, apart = 0, np.empty((2 * reach + 1) ** 2, dtype=np.int64), np.empty((2 * reach + 1) ** 2)
    for own in range(keys.size):
        count, window = 0, grid[tile[own]]
        for y in range(max(0, place[own, 0] - reach), min(lines, place[own, 0] + reach + 1)):
            for x in range(max(0, place[own, 1] - reach), min(samples, place[own, 1] + reach + 1)):
                other = window[y, x]
                if other < 0 or not changed[other] or not _is_another(keys[other], keys[own]):
                    continue
                unlike = 0.0
                for i in range(summary.shape[1]):
                    unlike += (summary[other, i] - summary[own, i]) ** 2
                at = 0
                while at < count and keys[near[at]] != keys[other]:
                    at += 1
                if at == count:
                    near[count], apart[count], count = other, unlike, count + 1
                elif unlike < apart[at]:
                    near[at], apart[at] = other, unlike
        for k in np.argsort(apart[:count])[:most]:
            rows[found], lenders[found] = own, near[k]
            found += 1
    return rows[:found], lenders[:found]


@compiled(nogil=True)  # type: ignore[untyped-decorator]
def likest_of(rows: Any, solved: Any, tile: Any, place: Any, data: Any, root: Any, most: int) -> Any:
    """For each of `rows`, of the `most` nearest of `solved` in its tile, the likest; tiles ascend in `solved`."""
    found = np.empty(rows.size, dtype=np.int64)
    near, apart = np.empty(most, dtype=np.int64), np.empty(most, dtype=np.int64)
    others = tile[solved]
    for number in range(rows.size):
        own, count = rows[number], 0
        for k in range(np.searchsorted(others, tile[own]), np.searchsorted(others, tile[own] + 1)):
            other = solved[k]
            away = (place[own, 0] - place[other, 0]) ** 2 + (place[own, 1] - place[other, 1]) ** 2
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
                    unlike += ((data[near[k], i] - data[own, i]) * root[own, i]) ** 2
            if unlike < least:
                found[number], least = near[k], unlike
    return found
