"""Sampler of the posterior of a Modified Gaussian Model: a population carried from the prior to the data.

Particles begin as draws from the prior. The data's share beta of the objective is then raised in steps from 0 to 1; at
each step the particles are weighted, resampled, and moved by Hamiltonian trajectories that bounce off the bounds. All
that the prior allows is there at the start, so separate minima keep their weights.

What touches every particle is compiled, the steps of beta are not: as one function they took twice as long to compile.

Del Moral, Doucet & Jasra (2006), J. R. Stat. Soc. B 68, 411, 10.1111/j.1467-9868.2006.00553.x (sequential Monte Carlo);
Neal (2011), Handbook of Markov Chain Monte Carlo, ch. 5, 10.1201/b10905 (Hamiltonian trajectories, bounds); Buchholz,
Chopin & Jacob (2021), Bayesian Anal. 16, 745, 10.1214/20-BA1222 (their tuning inside such a population).
"""

import math
from typing import Any

import numpy as np

from lunarsci.compiled import VECTORS, compiled
from lunarsci.spectra.mgm.forward import RIDGE, correct_coarse, energies_of, force_of, lower_factor

KEPT = 0.5
"""Share of the particles that a step of beta leaves, as an effective number."""
WANTED_ACCEPTANCE, TUNING = 0.75, 1.0
FIRST_STEP, LEAST_STEP, MOST_STEP = 0.3, 1e-3, 0.7
SHORTEST, LONGEST = 0.5, 3.5
"""Lengths of trajectories in standard deviations, uniformly at random: a normal law is forgotten after pi / 2 and back,
mirrored, after pi; the curved valleys of this model are longer."""
MOST_LEAPS, MOST_BOUNCES = 400, 200
FORGOTTEN, SETTLED = 0.8, 0.12
"""Correlation of the most persistent parameter with its values before the moves, below which these were enough: at a
step of beta, and before draws are kept."""
MOST_MOVES, FIRST_MOVES, LEAST_SETTLING, MOST_SETTLING, FRESH = 30, 10, 24, 64, 8
"""Trajectories per particle; FRESH of them with one metric while the population settles."""
PARTED = 0.01
"""Particles are labelled when beta passes this; the moves have forgotten by then where they came from."""


@compiled(fastmath=VECTORS)  # type: ignore[untyped-decorator]
def _velocity(factor: Any, momentum: Any, velocity: Any) -> None:
    for k in range(momentum.size):
        total, row = 0.0, factor[k]
        for i in range(k + 1):
            total += row[i] * momentum[i]
        velocity[k] = total


@compiled(fastmath=VECTORS)  # type: ignore[untyped-decorator]
def _push(factor: Any, free: Any, gradient: Any, step: float, momentum: Any) -> None:
    for k in range(momentum.size):
        push, row = step * gradient[free[k]], factor[k]
        for i in range(k + 1):
            momentum[i] += push * row[i]


@compiled
def _drift(target: Any, factor: Any, point: Any, momentum: Any, velocity: Any, time: float) -> bool:
    """Move for `time`, bouncing off the bounds; False where that takes too many bounces."""
    lower, upper, free = target[6:9]
    for _ in range(MOST_BOUNCES):
        first, wall = time, -1
        for k in range(free.size):
            p = free[k]
            if velocity[k] > 0.0 and point[p] + velocity[k] * first > upper[p]:
                first, wall = max(0.0, (upper[p] - point[p]) / velocity[k]), k
            elif velocity[k] < 0.0 and point[p] + velocity[k] * first < lower[p]:
                first, wall = max(0.0, (lower[p] - point[p]) / velocity[k]), k
        for k in range(free.size):
            p = free[k]
            point[p] = min(max(point[p] + velocity[k] * first, lower[p]), upper[p])
        if wall < 0:
            return True
        time -= first
        row, norm = factor[wall], 0.0
        for i in range(wall + 1):
            norm += row[i] * row[i]
        for i in range(wall + 1):
            momentum[i] -= 2.0 * velocity[wall] / norm * row[i]
        _velocity(factor, momentum, velocity)
    return False


@compiled
def _trajectory(
    target: Any, beta: float, factor: Any, step: float, generator: Any, point: Any, energy: Any, space: Any
) -> float:
    """One Hamiltonian trajectory of `point`, accepted or not; its `energy` follows. Returns 1 where accepted."""
    trial, momentum, velocity, gradient, ending = space[2]
    free, change = target[8], 0.0
    step *= generator.uniform(0.8, 1.2)
    for k in range(momentum.size):
        momentum[k] = generator.standard_normal()
        change -= 0.5 * momentum[k] ** 2
    trial[:] = point
    leaps = min(MOST_LEAPS, math.ceil(generator.uniform(SHORTEST, LONGEST) / step))
    if not force_of(target, beta, trial, space, gradient):
        return 0.0
    for leap in range(leaps):
        _push(factor, free, gradient, 0.5 * step if leap == 0 else step, momentum)
        _velocity(factor, momentum, velocity)
        if not _drift(target, factor, trial, momentum, velocity, step):
            return 0.0
        if not force_of(target, beta, trial, space, gradient):
            return 0.0
    _push(factor, free, gradient, 0.5 * step, momentum)
    for k in range(momentum.size):
        change += 0.5 * momentum[k] ** 2
    energies_of(target, trial, space, ending)
    change += beta * (ending[0] - energy[0]) + ending[1] - energy[1] + (1.0 - beta) * (ending[2] - energy[2])
    if not math.log(generator.random()) < -change:
        return 0.0
    point[:], energy[:] = trial, ending
    return 1.0


@compiled(nogil=True)  # type: ignore[untyped-decorator]
def _move_all(
    target: Any, beta: float, factor: Any, tuning: Any, generator: Any, particles: Any, energies: Any, space: Any
) -> None:
    """One trajectory of every particle; `tuning` is the step's length, to be adapted, and the acceptance."""
    accepted = 0.0
    for i in range(particles.shape[0]):
        accepted += _trajectory(target, beta, factor, tuning[0], generator, particles[i], energies[i], space)
    tuning[1] = accepted / particles.shape[0]
    tuning[0] *= math.exp(TUNING * (tuning[1] - WANTED_ACCEPTANCE))
    tuning[0] = min(max(tuning[0], LEAST_STEP), MOST_STEP)


@compiled
def _weights(energies: Any, rise: float, weights: Any) -> float:
    """Fill the normalised weights of a rise of beta; return the effective number of particles."""
    least = math.inf
    for i in range(weights.size):
        least = min(least, energies[i, 0] - energies[i, 2])
    total, squares = 0.0, 0.0
    for i in range(weights.size):
        weights[i] = math.exp(-rise * (energies[i, 0] - energies[i, 2] - least))
        total += weights[i]
        squares += weights[i] ** 2
    for i in range(weights.size):
        weights[i] /= total
    return total * total / squares


@compiled(nogil=True)  # type: ignore[untyped-decorator]
def _next_beta(beta: float, energies: Any, weights: Any) -> float:
    """The beta that leaves the wanted share of the particles, 1 at most; fills their weights."""
    wanted = KEPT * weights.size
    if _weights(energies, 1.0 - beta, weights) >= wanted:
        return 1.0
    low, high = -100.0, math.log(1.0 - beta)
    for _ in range(60):
        middle = 0.5 * (low + high)
        if _weights(energies, math.exp(middle), weights) >= wanted:
            low = middle
        else:
            high = middle
    _weights(energies, math.exp(low), weights)
    return beta + math.exp(low)


@compiled(nogil=True)  # type: ignore[untyped-decorator]
def _factor_of(particles: Any, weights: Any, free: Any, factor: Any) -> bool:
    """Cholesky factor of the weighted covariance of the free parameters; False where it has none."""
    size = free.size
    mean = np.zeros(size)
    for i in range(weights.size):
        for k in range(size):
            mean[k] += weights[i] * particles[i, free[k]]
    covariance = np.zeros((size, size))
    apart = np.empty(size)
    for i in range(weights.size):
        for k in range(size):
            apart[k] = particles[i, free[k]] - mean[k]
        for k in range(size):
            for j in range(k + 1):
                covariance[k, j] += weights[i] * apart[k] * apart[j]
    for k in range(size):
        covariance[k, k] *= 1.0 + RIDGE
    if not lower_factor(covariance):
        return False
    for k in range(size):
        for j in range(size):
            factor[k, j] = covariance[k, j]
    return True


@compiled(nogil=True)  # type: ignore[untyped-decorator]
def _drawn(weights: Any, offset: float) -> Any:
    """Systematic resampling: indices in proportion to the weights."""
    count = weights.size
    chosen = np.empty(count, dtype=np.int64)
    total, source = weights[0], 0
    for i in range(count):
        while source < count - 1 and total < (i + offset) / count:
            source += 1
            total += weights[source]
        chosen[i] = source
    return chosen


@compiled(nogil=True)  # type: ignore[untyped-decorator]
def _correlation(before: Any, after: Any, free: Any) -> float:
    """Largest over the free parameters, either sign, of the correlation between two states of the population."""
    largest, count = 0.0, before.shape[0]
    for k in range(free.size):
        p = free[k]
        a, b = before[:, p].mean(), after[:, p].mean()
        ab, aa, bb = 0.0, 0.0, 0.0
        for i in range(count):
            u, v = before[i, p] - a, after[i, p] - b
            ab += u * v
            aa += u * u
            bb += v * v
        largest = max(largest, abs(ab) / math.sqrt(aa * bb) if aa > 0.0 and bb > 0.0 else 1.0)
    return largest


def _stage(
    target: Any, groups: Any, beta: float, factor: Any, tuning: Any, generator: Any, particles: Any, energies: Any,
    ancestors: Any, weights: Any, space: Any,
) -> Any:  # fmt: skip
    """Raise beta, resample and move; returns the new beta and how many trajectories each particle made."""
    beta = _next_beta(beta, energies, weights)
    even = 0.5 * (weights + 1.0 / weights.size)
    _factor_of(particles, even, target[8], factor)
    chosen = _drawn(weights, generator.random())
    particles[:], energies[:], ancestors[:] = particles[chosen], energies[chosen], ancestors[chosen]
    correct_coarse(target, groups, particles[np.argmin(energies[:, 0] + energies[:, 1])], space)
    before, moves, kept = particles.copy(), 0, 1.0
    while kept > FORGOTTEN and moves < MOST_MOVES:
        _move_all(target, beta, factor, tuning, generator, particles, energies, space)
        kept, moves = _correlation(before, particles, target[8]), moves + 1
    return beta, moves


def _settle(
    target: Any, factor: Any, tuning: Any, generator: Any, particles: Any, energies: Any, weights: Any, space: Any
) -> int:
    """Move on the posterior itself until the resampled copies have parted; returns how often."""
    before, moves, kept = particles.copy(), 0, 1.0
    while moves < LEAST_SETTLING or (kept > SETTLED and moves < MOST_SETTLING):
        if moves % FRESH == 0:
            _factor_of(particles, weights, target[8], factor)
        _move_all(target, 1.0, factor, tuning, generator, particles, energies, space)
        kept, moves = _correlation(before, particles, target[8]), moves + 1
    return moves


def _workspace(size: int, channels: int) -> Any:
    return np.empty((size, channels)), np.empty(channels), np.empty(channels), np.empty(channels, dtype=np.int64)


@compiled(nogil=True)  # type: ignore[untyped-decorator]
def _energies_of_all(target: Any, particles: Any, space: Any, energies: Any) -> None:
    for i in range(particles.shape[0]):
        energies_of(target, particles[i], space, energies[i])


def run_population(
    target: Any, groups: Any, factor: Any, generator: Any, particles: Any, ancestors: Any, draws: Any,
    objective: Any, report: Any,
) -> None:  # fmt: skip
    """Carry `particles` (n, p), draws from the prior, to the posterior; fill `draws` (rounds, n, p) with it, and
    `objective` (rounds, n) with their chi-square and prior share together.

    Parameters
    ----------
    target : (channels, coarse channels, logarithmic, prior, precision, `start`, lower, upper, indices of the free
        parameters). Channels are wavelength [um], basis (m, n), ln R, root of the weight; `start` (2, m) holds centre
        and inverse variance of a normal law of the continuum coefficients that fades as the data come in, so that flat
        priors have somewhere to begin.
    groups : (n,) to which coarse channel each channel belongs; the coarse data are overwritten.
    factor : (f, f) Cholesky factor of the prior's covariance, with that law in it; overwritten.
    ancestors : (n,) becomes from which particle at beta = `PARTED` each descends.
    report : becomes steps of beta, trajectories per particle, mean acceptance and step length at the end.
    """
    free, (count, size) = target[8], particles.shape
    points = (np.empty(size), np.empty(free.size), np.empty(free.size), np.empty(size), np.empty(3))
    space = (_workspace(size, target[0][0].size), _workspace(size, target[1][0].size), points)
    tuning, weights, energies = np.array([FIRST_STEP, 0.0]), np.empty(count), np.empty((count, 3))
    _energies_of_all(target, particles, space, energies)
    for _ in range(FIRST_MOVES):
        _move_all(target, 0.0, factor, tuning, generator, particles, energies, space)
    beta, report[:] = 0.0, 0.0
    ancestors[:] = np.arange(count)
    while beta < 1.0:
        beta, moves = _stage(
            target, groups, beta, factor, tuning, generator, particles, energies, ancestors, weights, space
        )
        report[0] += 1
        report[1] += moves
        if beta < PARTED:
            ancestors[:] = np.arange(count)
    weights[:] = 1.0 / count
    report[1] += _settle(target, factor, tuning, generator, particles, energies, weights, space)
    for r in range(draws.shape[0]):
        _move_all(target, 1.0, factor, tuning, generator, particles, energies, space)
        report[2] += tuning[1] / draws.shape[0]
        draws[r], objective[r] = particles, 2.0 * (energies[:, 0] + energies[:, 1])
    report[3] = tuning[0]
