"""Bounded Levenberg-Marquardt from many starts, eight at a time, compiled.

Each lane follows one job, a start on one spectrum; a lane whose job has ended takes the next. What a lane does depends
on its own job alone, so the result of a job is the same in any company.
"""

import math
from typing import Any, NamedTuple

import numpy as np

from lunarsci.compiled import compiled
from lunarsci.spectra.mgm.covariance import update
from lunarsci.spectra.mgm.lanes import LANES, aligned, load, store
from lunarsci.spectra.mgm.moments import BLOCK, ORIGIN, evaluate, rows_of_sums, rows_of_work
from lunarsci.spectra.mgm.normal import (
    clip_to_bounds,
    free_again,
    padded_matrix,
    predicted_decrease,
    prior_pull,
    solve_step,
)

__all__ = [
    "CONVERGED", "ITERATION_LIMIT", "NOT_FINITE", "Channels", "Room", "Rules", "Task", "channels_of", "descend",
    "fill_lane", "room_for",
]  # fmt: skip

CONVERGED, ITERATION_LIMIT, NOT_FINITE = 0, 1, 2
LEAST_DAMPING, MOST_DAMPING = 1e-9, 1e12
GENTLE_DAMPING = 1e-2
"""Below this a step that promises nothing means that there is nothing to gain."""

CHI2, SHARE, SCALE, DAMPING, INCREASE, PREDICTED, PROMISED, TAKEN, RENEWED, TRIAL_SHARE, PIVOT, CROSSED = range(12)
"""Rows of a room's `state`: of the objective's parts at the point, of the damping, of the step proposed."""
MOST_ROUNDS = 2
"""Solutions of one step while bounds are crossed; more cost more than they gain."""
EMPTY, NEW, TRYING = 0, 1, 2
"""Phases of a lane."""
GOES_ON, AGAIN = -1, -2
"""A step is to be tried; it is to be solved again. Otherwise a descent ends with its status."""


class Task(NamedTuple):
    """What all spectra of a call have in common."""

    degrees: int
    logarithmic: bool
    prior: Any
    precision: Any
    lower: Any
    upper: Any


class Rules(NamedTuple):
    """How to descend.

    While `tempering` and chi-square is larger than the number of channels, the data's share of the objective is divided
    by their ratio, as if the errors were that much larger: the prior then keeps the first steps in the region it knows,
    and half the steps are enough. The last steps, to convergence, are on the objective itself. `tolerance` is the
    decrease to be expected, in chi-square, at which a descent has converged.
    """

    tempering: bool
    first_damping: float
    tolerance: float
    max_iterations: int


class Channels(NamedTuple):
    """Spectra by rows: wavelength (rows, n) [um], basis (rows, m, n), ln R (rows, n), root of the weight (rows, n)."""

    wavelength: Any
    columns: Any
    data: Any
    root_weight: Any

    def part(self, rows: Any) -> "Channels":
        """Some of the spectra; wavelengths and basis that all share stay shared."""
        wavelength, columns = self.wavelength, self.columns
        if len(wavelength) > 1:
            wavelength, columns = wavelength[rows], columns[rows]
        return Channels(wavelength, columns, self.data[rows], self.root_weight[rows])


class Room(NamedTuple):
    """Arrays of eight columns to work in."""

    places: Any
    columns: Any
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
    residuals: Any
    state: Any


def room_for(size: int, degrees: int, channels: int) -> Room:
    """Room for fits of `size` parameters to so many channels."""
    count, bands = -(-channels // BLOCK) * BLOCK, (size - degrees) // 3
    rows = (
        count, degrees * count, count, count, rows_of_work(degrees, bands), rows_of_sums(degrees, bands), size * size,
        1, size, size, size, size, size, size, size, count, CROSSED + 1,
    )  # fmt: skip
    return Room(*(aligned(number) for number in rows))._replace(matrix=padded_matrix(size))


@compiled
def channels_of(room: Any) -> Any:
    """The part of a room that holds spectra."""
    return room.places, room.columns, room.data, room.roots


@compiled
def fill_lane(spectra: Any, row: int, room: Any, lane: int) -> None:
    """Copy a spectrum into a lane; channels beyond its last are that one again, without weight."""
    own = min(row, spectra.wavelength.shape[0] - 1)
    channels, count = spectra.data.shape[1], room.places.shape[0]
    for i in range(count):
        j = min(i, channels - 1)
        room.places[i, lane] = spectra.wavelength[own, j] - ORIGIN
        room.data[i, lane] = spectra.data[row, j]
        room.roots[i, lane] = spectra.root_weight[row, j] if i < channels else 0.0
        for m in range(spectra.columns.shape[1]):
            room.columns[m * count + i, lane] = spectra.columns[own, m, j]


class _Crew(NamedTuple):
    """Of each lane: its phase, its job, iterations done, the status with which it ends, whether it is still tempered,
    and whether its next step is not found yet."""

    phase: Any
    job: Any
    iterations: Any
    end: Any
    tempered: Any
    asked: Any


@compiled
def _take_jobs(
    spectra: Any, task: Any, rules: Any, rows: Any, points: Any, room: Any, crew: Any, following: int
) -> int:  # fmt: skip
    """Give each empty lane the next job, its start moved within the bounds; the number of the job after these."""
    state = room.state
    for lane in range(LANES):
        if crew.phase[lane] == EMPTY and following < rows.size:
            crew.job[lane], crew.phase[lane], crew.iterations[lane] = following, NEW, 0
            crew.tempered[lane] = rules.tempering
            state[SCALE, lane], state[DAMPING, lane], state[INCREASE, lane] = 1.0, rules.first_damping, 4.0
            fill_lane(spectra, rows[following], room, lane)
            for p in range(points.shape[1]):
                room.trial[p, lane] = min(max(points[following, p], task.lower[p]), task.upper[p])
            following += 1
    return following


@compiled
def _damp_more(state: Any, lane: int) -> None:
    state[DAMPING, lane] = max(state[DAMPING, lane], 1e-4) * state[INCREASE, lane]
    state[INCREASE, lane] *= 2.0


@compiled
def _judge(state: Any, lane: int, chi2: float, phase: Any, tolerance: float) -> int:
    """Take a trial or refuse it, and change the damping accordingly."""
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


@compiled
def _judge_all(used: Any, rows: Any, rules: Any, degrees: int, room: Any, crew: Any) -> None:
    """Judge the trials of all lanes that are at work; the points of those taken move there."""
    state, sums = room.state, room.sums
    last, at_chi2 = sums.shape[0] - 1, (degrees + 1) ** 2 - 1
    for lane in range(LANES):
        crew.end[lane], state[TAKEN, lane] = GOES_ON, 0.0
        if crew.phase[lane] == EMPTY:
            continue
        chi2 = sums[at_chi2, lane] if sums[last, lane] > 0.0 else math.inf
        crew.end[lane] = _judge(state, lane, chi2, crew.phase, rules.tolerance)
        if state[TAKEN, lane] > 0.0:
            channels = used[rows[crew.job[lane]]]
            state[SCALE, lane] = channels / chi2 if crew.tempered[lane] and chi2 > channels else 1.0
            for p in range(room.point.shape[0]):
                room.point[p, lane] = room.trial[p, lane]
                room.pull[p, lane] = room.trial_pull[p, lane]
        spent = crew.iterations[lane] >= rules.max_iterations or state[DAMPING, lane] >= MOST_DAMPING
        if crew.end[lane] == GOES_ON and spent:
            crew.end[lane] = ITERATION_LIMIT


@compiled
def _weigh(state: Any, lane: int, settled: bool) -> int:
    """What to do with a step that keeps within the bounds."""
    if not state[PIVOT, lane] > 0.0:
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


@compiled
def _step(task: Any, room: Any, held_steps: int) -> None:
    """Solve for the steps of all lanes and clip them to the bounds."""
    state, scale = room.state, load(room.state, SCALE)
    free_again(
        room.point, task.lower, task.upper, scale, room.slope, room.pull, load(state, RENEWED), room.free, room.step
    )
    pivot = solve_step(
        room.curvature, task.precision, scale, load(state, DAMPING) + 1.0, room.slope, room.pull, room.free,
        held_steps, room.matrix, room.step,
    )  # fmt: skip
    store(state, PIVOT, pivot)
    store(state, CROSSED, clip_to_bounds(room.point, task.lower, task.upper, room.step, room.free))
    decrease = predicted_decrease(room.curvature, task.precision, scale, room.slope, room.pull, room.step)
    store(state, PREDICTED, decrease)


@compiled
def _set_trial(task: Any, room: Any, lane: int) -> None:
    """Where a lane's step leads; the lane's solution may change while others solve theirs again."""
    room.state[PROMISED, lane] = room.state[PREDICTED, lane]
    for p in range(room.point.shape[0]):
        trial = room.point[p, lane] + room.step[p, lane]
        room.trial[p, lane] = min(max(trial, task.lower[p]), task.upper[p])


@compiled
def _propose(task: Any, rules: Any, room: Any, crew: Any) -> None:
    """A step in every lane that is at work, solved as often as bounds and damping ask for.

    A step that crosses bounds is solved again with the parameters that crossed held there; if it crosses others then,
    it is tried as it is clipped, unless it promises nothing: only steps that are a minimum say that a descent is over.
    """
    state, waiting, held, rounds = room.state, 0, 0, 0
    for lane in range(LANES):
        crew.end[lane], crew.asked[lane] = GOES_ON, crew.phase[lane] == TRYING
        state[RENEWED, lane] = 1.0 if crew.asked[lane] else 0.0
        waiting += crew.asked[lane]
    while waiting > 0:
        rounds += 1
        _step(task, room, held)
        for lane in range(LANES):
            state[RENEWED, lane] = 0.0
            if not crew.asked[lane]:
                continue
            settled = state[PREDICTED, lane] <= rules.tolerance * state[SCALE, lane]
            if state[CROSSED, lane] > 0.0 and state[PIVOT, lane] > 0.0 and (settled or rounds < MOST_ROUNDS):
                held = 1
                continue
            crew.iterations[lane] += 1
            verdict = _weigh(state, lane, settled)
            if verdict == AGAIN:
                if crew.iterations[lane] < rules.max_iterations and state[DAMPING, lane] < MOST_DAMPING:
                    crew.tempered[lane] = crew.tempered[lane] and state[SCALE, lane] != 1.0
                    state[RENEWED, lane] = 1.0
                    continue
                verdict = ITERATION_LIMIT
            crew.end[lane], crew.asked[lane], waiting = verdict, False, waiting - 1
            _set_trial(task, room, lane)


@compiled
def _dismiss(room: Any, crew: Any, points: Any, outcomes: Any, curvatures: Any) -> int:
    """Write what the lanes that end have come to and empty them; how many are left at work."""
    state, size, left = room.state, points.shape[1], 0
    for lane in range(LANES):
        if crew.phase[lane] != EMPTY and crew.end[lane] >= 0:
            job, status = crew.job[lane], crew.end[lane]
            for p in range(size):
                points[job, p] = room.trial[p, lane] if status == NOT_FINITE else room.point[p, lane]
                for q in range(p, size if curvatures.shape[0] > 0 else p):
                    curvatures[job, p, q] = room.curvature[p * size + q, lane]
            outcomes[job, 0], outcomes[job, 1] = state[CHI2, lane], state[CHI2, lane] + state[SHARE, lane]
            outcomes[job, 2], outcomes[job, 3] = crew.iterations[lane], status
            crew.phase[lane] = EMPTY
        left += crew.phase[lane] != EMPTY
    return left


@compiled(nogil=True)  # type: ignore[untyped-decorator]
def descend(
    spectra: Any, used: Any, task: Any, rules: Any, rows: Any, points: Any, outcomes: Any, room: Any, curvatures: Any
) -> None:  # fmt: skip
    """Move each of `points` (jobs, p) to the minimum that its neighbourhood leads to on spectrum `rows[job]`, which has
    `used[row]` channels with weight; its row of `outcomes` becomes chi-square, objective, iterations, status.

    `curvatures`, (jobs, p, p) or (0, p, p) where not wanted, become J J' at the end, upper triangles.
    """
    crew = _Crew(
        np.zeros(LANES, dtype=np.int64), np.zeros(LANES, dtype=np.int64), np.zeros(LANES, dtype=np.int64),
        np.zeros(LANES, dtype=np.int64), np.zeros(LANES, dtype=np.bool_), np.zeros(LANES, dtype=np.bool_),
    )  # fmt: skip
    following, left = 0, 0
    while left > 0 or following < rows.size:
        following = _take_jobs(spectra, task, rules, rows, points, room, crew, following)
        evaluate(channels_of(room), room.trial, task.degrees, task.logarithmic, 1, room.work, room.residuals, room.sums)
        store(room.state, TRIAL_SHARE, prior_pull(room.trial, task.prior, task.precision, room.trial_pull))
        _judge_all(used, rows, rules, task.degrees, room, crew)
        update(room.sums, room.trial, task.degrees, load(room.state, TAKEN), room.curvature, room.slope)
        _dismiss(room, crew, points, outcomes, curvatures)
        _propose(task, rules, room, crew)
        left = _dismiss(room, crew, points, outcomes, curvatures)
