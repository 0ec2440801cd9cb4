"""Bounded Levenberg-Marquardt, eight descents at a time, compiled.

Each lane follows one job, a start on one spectrum; a lane whose job has ended takes the next. What a lane does depends
on its own job alone, so the result of a job is the same in any company.
"""

import math
from typing import Any, NamedTuple

import numpy as np

from lunarsci.arrays import FloatArray, IndexArray
from lunarsci.compiled import uncounted
from lunarsci.compiled.formulas import LANES
from lunarsci.compiled.lanes import aligned, load, spread, store
from lunarsci.spectra.mgm.forward import (
    BLOCK,
    clip_to_bounds,
    damped,
    evaluate,
    factorise,
    free_again,
    hold,
    invert,
    matrix_side,
    padded_matrix,
    predicted_decrease,
    prior_pull,
    prior_share,
    rows_of_sums,
    rows_of_work,
    solve_step,
    update,
)

CONVERGED, ITERATION_LIMIT, NOT_FINITE, GIVEN_UP = 0, 1, 2, 3
"""Statuses of a descent: at a minimum; not yet there; a start without a model; above its bar."""
FIRST_DAMPING, LATER_DAMPING = 1e-3, 1e-6
"""Damping at which a descent begins: from afar, and near a minimum."""
BELIEF = 1.3
"""Times what a step promises is what a descent may still gain; where that stays above its bar it is given up."""
LEAST_DAMPING, MOST_DAMPING = 1e-9, 1e12
"""Range of Marquardt's damping; a descent that reaches the upper end is over."""
GENTLE_DAMPING = 1e-2
"""Below this a step that promises nothing means that there is nothing to gain."""

CHI2, SHARE, SCALE, DAMPING, INCREASE, PREDICTED, PROMISED, TAKEN, RENEWED, TRIAL_SHARE, PIVOT, CROSSED = range(12)
"""Rows of a workspace's `state`.

* At the point: `CHI2` and the prior's `SHARE` of the objective, `SCALE` that multiplies chi-square while tempered.
* `DAMPING`, and `INCREASE`, its factor when a step is refused.
* Of the step: `PREDICTED` decrease of the objective as just solved, `PROMISED` that of the step being tried, `PIVOT`
  least of its matrix, `CROSSED` above 0 where it was stopped at a bound, `TRIAL_SHARE` the prior's share at the trial.
* `TAKEN`: 1 where the trial became the point; `RENEWED`: 1 where bounds are looked at anew.
"""
MOST_ROUNDS = 2
"""Solutions of one step while bounds are crossed; more cost more than they gain."""
EMPTY, NEW, TRYING = 0, 1, 2
"""Phases of a lane."""
GOES_ON, AGAIN = -1, -2
"""A step is to be tried; it is to be solved again. Otherwise a descent ends with its status."""


class FitProblem(NamedTuple):
    """What all spectra of a call have in common: an `MgmModel` of p parameters as the kernels take it (`problem_of`).

    Parameters are in its order and units: continuum coefficients, then centre, FWHM, strength. [-, um, um, ln R]

    Attributes
    ----------
    degrees : number m of continuum coefficients.
    logarithmic : whether the polynomial is ln C, and not C.
    prior, precision : (p,) mean and (p, p) inverse covariance of the prior, 0 where it is flat.
    lower, upper : (p,) bounds; equal where a parameter is fixed.
    """

    degrees: int
    logarithmic: bool
    prior: Any
    precision: Any
    lower: Any
    upper: Any

    def in_singles(self) -> "FitProblem":
        """The same, for a workspace of singles."""
        numbers = ("prior", "precision", "lower", "upper")
        return self._replace(**{name: getattr(self, name).astype(np.float32) for name in numbers})


class DescentOptions(NamedTuple):
    """How to descend.

    While `tempering` and chi-square is larger than the number of channels, the data's share of the objective is divided
    by their ratio, as if the errors were that much larger: the prior then keeps the first steps in the region it knows,
    and half the steps are enough. The last steps, to convergence, are on the objective itself. `tolerance` is the
    decrease to be expected, in chi-square, at which a descent has converged; with `ahead` it still takes the step that
    is expected to bring it, and its objective is what is expected there.

    `first_damping` is Marquardt's, relative to the diagonal. `slack` is for descents with a bar: how much more than its
    step promises one may still gain, in chi-square, before it is given up (`_is_hopeless`).
    """

    tempering: bool
    first_damping: float
    tolerance: float
    max_iterations: int
    ahead: bool = False
    slack: float = math.inf


class Channels(NamedTuple):
    """Spectra of n channels each, as the kernels take them; `channels_of` makes them of prepared spectra.

    Attributes
    ----------
    wavelength : (rows, n), or (1, n) where all share it. [um]
    basis : (rows, m, n) or (1, m, n), the columns of `continuum_basis` as rows. [-]
    data : (rows, n) ln R. [-]
    root_weight : (rows, n) 1 / standard deviation of ln R, 0 for a channel that does not count. [-]
    """

    wavelength: Any
    basis: Any
    data: Any
    root_weight: Any

    def part(self, rows: Any) -> "Channels":
        """Some of the spectra; wavelengths and basis that all share stay shared."""
        wavelength, basis = self.wavelength, self.basis
        if len(wavelength) > 1:
            wavelength, basis = wavelength[rows], basis[rows]
        return Channels(wavelength, basis, self.data[rows], self.root_weight[rows])


class Linearised(NamedTuple):
    """What the objective is made of where descents end, job by job; (0, ...) for what is not wanted.

    Attributes
    ----------
    curvatures : (jobs, p, p) J J', upper triangles, J the derivatives of ln R times the root of the weight.
    slopes : (jobs, p) J r.
    residuals : (jobs, n) r, data - model times the root of the weight, at the last point that was tried; NaN where the
        model has no value.
    """

    curvatures: Any
    slopes: Any
    residuals: Any

    @classmethod
    def of(cls, size: int, jobs: int = 0) -> "Linearised":
        """Of descents with so many parameters, curvatures of so many jobs alone."""
        return cls(np.empty((jobs, size, size)), np.empty((0, size)), np.empty((0, 0)))


class Workspace(NamedTuple):
    """Arrays of eight columns, a lane each, of doubles or singles, to work in: n channels, padded to a multiple of
    `BLOCK`, p parameters.

    Attributes
    ----------
    wavelength : (n, 8), ascending. [um]
    basis : (m n, 8) of the continuum, channel i of coefficient c at c n + i. [-]
    data, roots : (n, 8) ln R, and the root of the weight, 0 beyond the last channel. [-]
    work : (`rows_of_work`, 8) derivatives of one block of channels.
    sums : (`rows_of_sums`, 8) their products, summed over all channels (`evaluate`).
    curvature : (p p, 8) upper triangle of J J', J the derivatives of ln R times the root of the weight.
    matrix : padded system of a step (`padded_matrix`).
    point, trial : (p, 8) parameters where the lane stands, and where its step leads.
    slope : (p, 8) J r at the point, r the residuals: half of how fast chi-square falls.
    pull, trial_pull : (p, 8) precision (p - prior) at the point and the trial.
    step : (p, 8) change of the parameters.
    free : (p, 8) 1 where a parameter may move, 0 where it stops at a bound or is fixed.
    held, units, solution : (p, 8), (p p, 8), (p, 8) of parameters that crossed a bound (`hold`).
    residuals : (n, 8) data - model, times the root of the weight, of the trial.
    former : (n, 8) residuals of a trial before (`_shift_slope`).
    state : (12, 8) numbers of the descent, at rows `CHI2` to `CROSSED`.
    """

    wavelength: Any
    basis: Any
    data: Any
    roots: Any
    work: Any
    sums: Any
    curvature: Any
    matrix: Any
    point: Any
    trial: Any
    slope: Any
    pull: Any
    trial_pull: Any
    step: Any
    free: Any
    held: Any
    units: Any
    solution: Any
    residuals: Any
    former: Any
    state: Any


def workspace_for(size: int, degrees: int, channels: int, kind: type[np.floating[Any]] = np.float64) -> Workspace:
    """Workspace for fits of `size` parameters to so many channels, in doubles or singles."""
    count, bands = -(-channels // BLOCK) * BLOCK, (size - degrees) // 3
    rows = (
        count, degrees * count, count, count, rows_of_work(degrees, bands), rows_of_sums(degrees, bands), size * size,
        1, size, size, size, size, size, size, size, size, size * size, size, count, count, CROSSED + 1,
    )  # fmt: skip
    space = Workspace(*(aligned(number, kind=kind) for number in rows))
    return space._replace(matrix=padded_matrix(size, kind))


@uncounted
def fill_lane(spectra: Any, row: int, space: Any, lane: int) -> None:
    """Copy a spectrum into a lane; channels beyond its last are that one again, without weight."""
    shared_row = min(row, spectra.wavelength.shape[0] - 1)
    channels, count = spectra.data.shape[1], space.wavelength.shape[0]
    for i in range(count):
        j = min(i, channels - 1)
        space.wavelength[i, lane] = spectra.wavelength[shared_row, j]
        space.data[i, lane] = spectra.data[row, j]
        space.roots[i, lane] = spectra.root_weight[row, j] if i < channels else 0.0
        for m in range(spectra.basis.shape[1]):
            space.basis[m * count + i, lane] = spectra.basis[shared_row, m, j]


class _Jobs(NamedTuple):
    """What each lane is at; arrays (8,).

    Attributes
    ----------
    phase : `EMPTY`, `NEW` before its start is judged, or `TRYING`.
    job : place of its job among the points.
    iterations : done so far.
    end : status with which it ends, or `GOES_ON`.
    tempered : whether the data's share is still divided (`DescentOptions`).
    asked : whether its next step is still to be solved for.
    """

    phase: Any
    job: Any
    iterations: Any
    end: Any
    tempered: Any
    asked: Any


@uncounted
def _take_jobs(
    spectra: Any, problem: Any, options: Any, rows: Any, points: Any, space: Any, jobs: Any, following: int
) -> int:  # fmt: skip
    """Give each empty lane the next job, its start moved within the bounds; the number of the job after these."""
    state = space.state
    for lane in range(LANES):
        if jobs.phase[lane] == EMPTY and following < rows.size:
            jobs.job[lane], jobs.phase[lane], jobs.iterations[lane] = following, NEW, 0
            jobs.tempered[lane] = options.tempering
            state[SCALE, lane], state[DAMPING, lane], state[INCREASE, lane] = 1.0, options.first_damping, 4.0
            fill_lane(spectra, rows[following], space, lane)
            for p in range(points.shape[1]):
                space.trial[p, lane] = min(max(points[following, p], problem.lower[p]), problem.upper[p])
            following += 1
    return following


@uncounted
def _damp_more(state: Any, lane: int) -> None:
    """More damping, after a step that was refused or has no solution; by a growing factor."""
    state[DAMPING, lane] = max(state[DAMPING, lane], 1e-4) * state[INCREASE, lane]
    state[INCREASE, lane] *= 2.0


@uncounted
def _judge(state: Any, lane: int, chi2: float, phase: Any, tolerance: float) -> int:
    """Take a trial of this chi-square or refuse it, and change the damping accordingly; a status, or `GOES_ON`."""
    share = state[TRIAL_SHARE, lane]
    if phase[lane] == NEW:
        if not math.isfinite(chi2):
            state[CHI2, lane], state[SHARE, lane] = math.nan, math.inf
            return NOT_FINITE
        phase[lane] = TRYING
    else:
        gain = state[SCALE, lane] * (state[CHI2, lane] - chi2) + state[SHARE, lane] - share
        predicted = state[PROMISED, lane]
        if not gain > 0.0:
            if predicted <= 10.0 * tolerance and state[SCALE, lane] == 1.0:
                return CONVERGED
            _damp_more(state, lane)
            return GOES_ON
        shrink = max(0.1, 1.0 - (2.0 * gain / predicted - 1.0) ** 3)
        state[DAMPING, lane] = max(state[DAMPING, lane] * shrink, LEAST_DAMPING)
        state[INCREASE, lane] = 4.0
    state[TAKEN, lane], state[CHI2, lane], state[SHARE, lane] = 1.0, chi2, share
    return GOES_ON


@uncounted
def _judge_all(counts: Any, rows: Any, options: Any, degrees: int, space: Any, jobs: Any) -> None:
    """Judge the trials of all lanes that are at work; the points of those taken move there."""
    state, sums = space.state, space.sums
    last, at_chi2 = sums.shape[0] - 1, (degrees + 1) ** 2 - 1
    for lane in range(LANES):
        jobs.end[lane], state[TAKEN, lane] = GOES_ON, 0.0
        if jobs.phase[lane] == EMPTY:
            continue
        chi2 = sums[at_chi2, lane] if sums[last, lane] > 0.0 else math.inf
        jobs.end[lane] = _judge(state, lane, chi2, jobs.phase, options.tolerance)
        if state[TAKEN, lane] > 0.0:
            channels = counts[rows[jobs.job[lane]]]
            state[SCALE, lane] = channels / chi2 if jobs.tempered[lane] and chi2 > channels else 1.0
            for p in range(space.point.shape[0]):
                space.point[p, lane] = space.trial[p, lane]
                space.pull[p, lane] = space.trial_pull[p, lane]
        spent = jobs.iterations[lane] >= options.max_iterations or state[DAMPING, lane] >= MOST_DAMPING
        if jobs.end[lane] == GOES_ON and spent:
            jobs.end[lane] = ITERATION_LIMIT


@uncounted
def _weigh(state: Any, lane: int, settled: bool, tolerance: float) -> int:
    """What to do with a step that keeps within the bounds: `GOES_ON`, `AGAIN` or a status.

    `settled` : whether it promises less than the tolerance. One that promises a rise, where bounds cut off a step that
    went far beyond them, says nothing of a minimum.
    """
    if not state[PIVOT, lane] > 0.0 or state[PREDICTED, lane] < -tolerance * state[SCALE, lane]:
        _damp_more(state, lane)
        return AGAIN
    if not settled:
        return GOES_ON
    if state[DAMPING, lane] > GENTLE_DAMPING:
        state[DAMPING, lane], state[INCREASE, lane] = state[DAMPING, lane] * 0.1, 4.0
        return AGAIN
    if state[SCALE, lane] == 1.0:
        return CONVERGED
    state[SCALE, lane] = 1.0
    return AGAIN


@uncounted
def _clip(problem: Any, space: Any) -> None:
    """Clip the steps of all lanes to the bounds, and what is then to be expected of them."""
    state, scale = space.state, load(space.state, SCALE)
    crossed = clip_to_bounds(space.point, problem.lower, problem.upper, space.step, space.free, space.held)
    store(state, CROSSED, crossed)
    decrease = predicted_decrease(space.curvature, problem.precision, scale, space.slope, space.pull, space.step)
    store(state, PREDICTED, decrease)


@uncounted
def _step(problem: Any, space: Any) -> None:
    """Solve for the steps of all lanes and clip them to the bounds."""
    state, scale = space.state, load(space.state, SCALE)
    free_again(
        space.point, problem.lower, problem.upper, scale, space.slope, space.pull, load(state, RENEWED), space.free,
        space.step, space.held,
    )  # fmt: skip
    pivot = solve_step(
        space.curvature, problem.precision, scale, load(state, DAMPING) + 1.0, space.slope, space.pull, space.free,
        space.matrix, space.step,
    )  # fmt: skip
    store(state, PIVOT, pivot)
    _clip(problem, space)


@uncounted
def _set_trial(problem: Any, space: Any, lane: int) -> None:
    """Where a lane's step leads; the lane's solution may change while others solve theirs again."""
    space.state[PROMISED, lane] = space.state[PREDICTED, lane]
    for p in range(space.point.shape[0]):
        trial = space.point[p, lane] + space.step[p, lane]
        space.trial[p, lane] = min(max(trial, problem.lower[p]), problem.upper[p])


@uncounted
def _is_hopeless(state: Any, lane: int, bars: Any, options: Any, jobs: Any) -> bool:
    """Whether a descent, past its first steps and hardly damped, will end above its bar (`descend`)."""
    if bars.size == 0 or state[SCALE, lane] != 1.0 or state[DAMPING, lane] > GENTLE_DAMPING:
        return False
    here, predicted = state[CHI2, lane] + state[SHARE, lane], state[PREDICTED, lane]
    return bool(here - min(BELIEF * predicted, predicted + options.slack) > bars[jobs.job[lane]])


@uncounted
def _verdict(options: Any, bars: Any, state: Any, lane: int, settled: bool, jobs: Any) -> int:
    """What becomes of a lane's step: `GOES_ON`, `AGAIN` with other damping, or a status."""
    jobs.iterations[lane] += 1
    verdict: int = _weigh(state, lane, settled, options.tolerance)
    if verdict == GOES_ON and _is_hopeless(state, lane, bars, options, jobs):
        return GIVEN_UP
    if verdict == AGAIN:
        if jobs.iterations[lane] >= options.max_iterations or state[DAMPING, lane] >= MOST_DAMPING:
            return ITERATION_LIMIT
        jobs.tempered[lane] = jobs.tempered[lane] and state[SCALE, lane] != 1.0
    return verdict


@uncounted
def _propose(problem: Any, options: Any, bars: Any, space: Any, jobs: Any) -> None:
    """A step in every lane that is at work, solved as often as bounds and damping ask for.

    A step that crosses bounds is solved again with the parameters that crossed held there; if it crosses others then,
    it is tried as it is clipped, unless it promises nothing: only steps that are a minimum say that a descent is over.
    """
    state, waiting = space.state, 0
    for lane in range(LANES):
        jobs.end[lane], jobs.asked[lane] = GOES_ON, jobs.phase[lane] == TRYING
        state[RENEWED, lane] = 1.0 if jobs.asked[lane] else 0.0
        waiting += jobs.asked[lane]
    while waiting > 0:
        _step(problem, space)
        rounds, crossing = 0, True
        for lane in range(LANES):
            state[RENEWED, lane] = 0.0
        while crossing:
            rounds, crossing = rounds + 1, False
            for lane in range(LANES):
                if not jobs.asked[lane] or state[RENEWED, lane] > 0.0:
                    continue
                settled = state[PREDICTED, lane] <= options.tolerance * state[SCALE, lane]
                if state[CROSSED, lane] > 0.0 and state[PIVOT, lane] > 0.0 and (settled or rounds < MOST_ROUNDS):
                    crossing = True
                    continue
                verdict = _verdict(options, bars, state, lane, settled, jobs)
                if verdict == AGAIN:
                    state[RENEWED, lane] = 1.0
                    continue
                jobs.end[lane], jobs.asked[lane], waiting = verdict, False, waiting - 1
                _set_trial(problem, space, lane)
            if crossing:
                hold(space.matrix, space.held, space.units, space.solution, space.free, space.step)
                _clip(problem, space)


@uncounted
def _dismiss(problem: Any, ahead: bool, space: Any, jobs: Any, points: Any, outcomes: Any, ends: Any) -> int:
    """Write what the lanes that end have come to, or, `ahead`, where they go, and empty them; how many are left."""
    state, size, left = space.state, points.shape[1], 0
    for lane in range(LANES):
        if jobs.phase[lane] != EMPTY and jobs.end[lane] >= 0:
            job, status = jobs.job[lane], jobs.end[lane]
            goes = ahead and status == CONVERGED
            for p in range(size):
                points[job, p] = space.trial[p, lane] if goes or status == NOT_FINITE else space.point[p, lane]
                for q in range(p, size if ends.curvatures.shape[0] > 0 else p):
                    ends.curvatures[job, p, q] = space.curvature[p * size + q, lane]
            for p in range(size if ends.slopes.shape[0] > 0 else 0):
                ends.slopes[job, p] = space.slope[p, lane]
            for i in range(ends.residuals.shape[1]):
                ends.residuals[job, i] = space.residuals[i, lane] if status != NOT_FINITE else math.nan
            chi2, share = state[CHI2, lane], state[SHARE, lane]
            if goes:
                expected = chi2 + share - state[PROMISED, lane]
                share = prior_share(points[job], problem.prior, problem.precision)
                chi2 = expected - share
            outcomes[job, 0], outcomes[job, 1] = chi2, chi2 + share
            outcomes[job, 2], outcomes[job, 3] = jobs.iterations[lane], status
            jobs.phase[lane] = EMPTY
        left += jobs.phase[lane] != EMPTY
    return left


def descend(
    spectra: Channels, counts: FloatArray, problem: FitProblem, options: DescentOptions, rows: IndexArray,
    points: FloatArray, outcomes: FloatArray, space: Workspace, ends: Linearised, bars: FloatArray,
) -> None:  # fmt: skip
    """Move each of `points` (jobs, p) to the minimum that its neighbourhood leads to on spectrum `rows[job]`, which has
    `counts[row]` channels with weight; its row of `outcomes` becomes chi-square, objective, iterations, status.

    `ends` is filled; where it has residuals nothing may be moved (`linearised`). A descent that will not come below its
    bar, (jobs,), is given up; (0,) for none.
    """
    numbers, flags = np.zeros((4, LANES), dtype=np.int64), np.zeros((2, LANES), dtype=np.bool_)
    _descend(spectra, counts, problem, options, rows, points, outcomes, space, ends, bars, _Jobs(*numbers, *flags))


@uncounted
def _descend(
    spectra: Any, counts: Any, problem: Any, options: Any, rows: Any, points: Any, outcomes: Any, space: Any,
    ends: Any, bars: Any, jobs: Any,
) -> None:  # fmt: skip
    """`descend`, compiled: lanes take jobs, are judged, propose a step and leave, until no job is left."""
    following, left = 0, 0
    curved = 1 if options.max_iterations > 0 or ends.curvatures.shape[0] > 0 else 0
    channels = (space.wavelength, space.basis, space.data, space.roots)
    while left > 0 or following < rows.size:
        following = _take_jobs(spectra, problem, options, rows, points, space, jobs, following)
        evaluate(
            channels, space.trial, problem.degrees, problem.logarithmic, curved, space.work, space.residuals, space.sums
        )
        store(space.state, TRIAL_SHARE, prior_pull(space.trial, problem.prior, problem.precision, space.trial_pull))
        _judge_all(counts, rows, options, problem.degrees, space, jobs)
        update(space.sums, space.trial, problem.degrees, load(space.state, TAKEN), space.curvature, space.slope)
        _dismiss(problem, False, space, jobs, points, outcomes, ends)
        _propose(problem, options, bars, space, jobs)
        left = _dismiss(problem, options.ahead, space, jobs, points, outcomes, ends)


def linearised(
    spectra: Channels, problem: FitProblem, points: FloatArray, space: Workspace, curved: bool = False
) -> Linearised:
    """Residuals and slopes at `points`, (n, p), of as many spectra, and where asked for the curvatures; by descents
    that do not move."""
    count, size = points.shape
    curvatures = np.empty((count if curved else 0, size, size))
    ends = Linearised(curvatures, np.empty((count, size)), np.empty(spectra.data.shape))
    outcomes, options = np.empty((count, 4)), DescentOptions(False, FIRST_DAMPING, math.inf, 0)
    rows, weighed = np.arange(count), np.full(count, np.inf)
    descend(spectra, weighed, problem, options, rows, np.array(points), outcomes, space, ends, np.empty(0))
    return ends


@uncounted
def _invert_all(curvatures: Any, problem: Any, space: Any, covariances: Any) -> None:
    """`inverses` into `covariances`, (jobs, p, p)."""
    jobs, size, state = curvatures.shape[0], curvatures.shape[1], space.state
    one, side = spread(1.0), matrix_side(space.matrix)
    for first in range(0, jobs, LANES):
        for p in range(size):
            store(space.free, p, one)
            for q in range(p, size):
                for lane in range(LANES):
                    space.curvature[p * size + q, lane] = curvatures[min(first + lane, jobs - 1), p, q]
        damped(space.curvature, problem.precision, one, one, space.free, size, side, space.matrix)
        store(state, 0, factorise(space.matrix, side))
        invert(space.matrix, size, side, space.curvature)
        for lane in range(min(LANES, jobs - first)):
            regular = state[0, lane] > 0.0
            for p in range(size):
                for q in range(p, size):
                    value = space.curvature[p * size + q, lane] if regular else np.nan
                    covariances[first + lane, p, q] = value
                    covariances[first + lane, q, p] = value


def inverses(curvatures: FloatArray, problem: FitProblem, space: Workspace) -> FloatArray:
    """(J J' + precision)^-1 from the upper triangles of J J', (jobs, p, p); NaN where there is none."""
    covariances = np.empty_like(curvatures)
    _invert_all(curvatures, problem, space, covariances)
    return covariances
