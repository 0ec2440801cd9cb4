"""Sampler of the posterior of a Modified Gaussian Model, compiled: a population carried from the prior to the data.

Particles begin as draws from the prior. The data's share beta of the objective is then raised in steps from 0 to 1; at
each step the particles are weighted, resampled, and moved by Hamiltonian trajectories that bounce off the bounds. All
that the prior allows is there at the start, so separate minima keep their weights.

Del Moral, Doucet & Jasra (2006), J. R. Stat. Soc. B 68, 411, 10.1111/j.1467-9868.2006.00553.x (sequential Monte Carlo);
Neal (2011), Handbook of Markov Chain Monte Carlo, ch. 5, 10.1201/b10905 (Hamiltonian trajectories, bounds); Buchholz,
Chopin & Jacob (2021), Bayesian Anal. 16, 745, 10.1214/20-BA1222 (their tuning inside such a population).
"""

import math
from typing import Any

import numpy as np

from lunarsci.compiled import VECTORS, compiled
from lunarsci.spectra.mgm.forward import FWHM_OVER_SIGMA, residuals
from lunarsci.spectra.mgm.gaussian import gaussian
from lunarsci.spectra.mgm.normal import prior_share

__all__ = ["FAMILIES", "run_population"]

KEPT = 0.5
"""Share of the particles that a step of beta leaves, as an effective number."""
WANTED_ACCEPTANCE, TUNING = 0.75, 1.0
FIRST_STEP, LEAST_STEP, MOST_STEP = 0.3, 1e-3, 0.7
TRAJECTORY = 3.0
"""Length in standard deviations. A normal law is forgotten after pi / 2; valleys here are curved and longer."""
MOST_LEAPS, MOST_BOUNCES = 400, 200
FORGOTTEN, SETTLED = 0.7, 0.15
"""Correlation of the most persistent parameter with its values before the moves, below which these were enough: at a
step of beta, and before draws are kept."""
MOST_MOVES, MOST_SETTLING, FIRST_MOVES, FRESH = 30, 80, 10, 8
"""Trajectories per particle at most; FRESH of them with one metric while the population settles."""
RIDGE = 1e-10
FAMILIES, PARTED = 16, 0.01
"""Particles are labelled when beta passes this; the moves have forgotten by then where they came from."""
LN_2, EXPONENT_BITS = math.log(2.0), 52
ROOT_HALF = int(np.array(math.sqrt(0.5)).view(np.int64))
"""The bits of the root of 1/2; numbers from there on count as of the next power of 2."""
LEAST_CONTINUUM = 1e-12


@compiled
def _chi2(channels: Any, logarithmic: bool, point: Any, room: Any) -> float:
    wavelength, columns, data, root_weight = channels
    jacobian, residual, work, powers = room
    chi2: float = residuals(
        point, wavelength, columns, logarithmic, data, root_weight, residual, jacobian, work, powers
    )
    return chi2


@compiled
def _energies(target: Any, point: Any, room: Any, energy: Any) -> None:
    """Halves of chi-square, of the prior's share, and of the squared distance of the continuum from its start."""
    channels, _, logarithmic, prior, precision, start = target[:6]
    energy[0] = 0.5 * _chi2(channels, logarithmic, point, room[0])
    energy[1] = 0.5 * prior_share(point, prior, precision)
    energy[2] = 0.0
    for m in range(start.shape[1]):
        energy[2] += 0.5 * start[1, m] * (point[m] - start[0, m]) ** 2


@compiled(fastmath=VECTORS)  # type: ignore[untyped-decorator]
def _force(target: Any, beta: float, point: Any, room: Any, force: Any) -> bool:
    """Minus the slope of the energy, from the coarse channels; False where the continuum is not above 0.

    Any field of force keeps a trajectory reversible and its volume; that it is the energy's own slope to within a
    fraction of a per cent only decides how many trajectories are accepted, by the energy on all channels.
    """
    (wavelength, columns, data, root_weight), logarithmic, prior, precision, start = target[1:6]
    shapes, rest, level, powers = room[1]
    degrees, channels = columns.shape
    for i in range(channels):
        level[i] = 0.0
    for m in range(degrees):
        coefficient, column = point[m], columns[m]
        for i in range(channels):
            level[i] += column[i] * coefficient
    if not _subtract_continuum(data, level, logarithmic, powers, rest):
        return False
    for row in range(degrees, point.size, 3):
        strength, shape = point[row + 2], shapes[row]
        gaussian(wavelength, point[row], FWHM_OVER_SIGMA / point[row + 1], shape, powers)
        for i in range(channels):
            rest[i] -= strength * shape[i]
    for i in range(channels):
        rest[i] *= root_weight[i] * root_weight[i] * beta
    _project(point, wavelength, columns, rest, level, shapes, force)
    for p in range(point.size):
        pull, own = 0.0, precision[p]
        for q in range(point.size):
            pull += own[q] * (point[q] - prior[q])
        force[p] -= pull
    for m in range(degrees):
        force[m] -= (1.0 - beta) * start[1, m] * (point[m] - start[0, m])
    return True


@compiled(fastmath=VECTORS)  # type: ignore[untyped-decorator]
def _subtract_continuum(data: Any, level: Any, logarithmic: bool, powers: Any, rest: Any) -> bool:
    """Fill `rest` with data - ln C and turn `level` into what a change of C means for ln C.

    ln C = k ln 2 + 2 artanh((f - 1) / (f + 1)) with f in 0.7-1.4; the series to the eleventh power leaves 1e-11.
    """
    if logarithmic:
        for i in range(level.size):
            rest[i] = data[i] - level[i]
            level[i] = 1.0
        return True
    lowest = level[0]
    for i in range(level.size):
        lowest = min(lowest, level[i])
    if not lowest > LEAST_CONTINUUM:
        return False
    bits, fraction = level.view(np.int64), powers.view(np.float64)
    for i in range(level.size):
        exponent = (bits[i] - ROOT_HALF) >> EXPONENT_BITS
        rest[i] = exponent * LN_2
        powers[i] = bits[i] - (exponent << EXPONENT_BITS)
    for i in range(level.size):
        t = (fraction[i] - 1.0) / (fraction[i] + 1.0)
        u = t * t
        series = ((((u / 11.0 + 1.0 / 9.0) * u + 1.0 / 7.0) * u + 0.2) * u + 1.0 / 3.0) * u + 1.0
        rest[i] = data[i] - rest[i] - 2.0 * t * series
        level[i] = 1.0 / level[i]
    return True


@compiled(fastmath=VECTORS)  # type: ignore[untyped-decorator]
def _project(point: Any, wavelength: Any, columns: Any, rest: Any, level: Any, shapes: Any, force: Any) -> None:
    """Sums of `rest` times the derivatives of ln R."""
    degrees, channels = columns.shape
    for m in range(degrees):
        column, total = columns[m], 0.0
        for i in range(channels):
            total += rest[i] * column[i] * level[i]
        force[m] = total
    for row in range(degrees, point.size, 3):
        centre, inverse, strength, shape = point[row], FWHM_OVER_SIGMA / point[row + 1], point[row + 2], shapes[row]
        by_centre, by_fwhm, by_strength = 0.0, 0.0, 0.0
        for i in range(channels):
            x = (wavelength[i] - centre) * inverse
            share = rest[i] * shape[i]
            by_strength += share
            by_centre += share * x
            by_fwhm += share * x * x
        force[row] = by_centre * strength * inverse
        force[row + 1] = by_fwhm * strength / point[row + 1]
        force[row + 2] = by_strength


@compiled
def _correct(target: Any, groups: Any, best: Any, room: Any) -> None:
    """Set the coarse data so that residuals and slope at `best` are those of all channels.

    Means of the residuals alone leave out how noise and slopes go together within a coarse channel.
    """
    channels, coarse, logarithmic, _, precision = target[:5]
    _chi2(channels, logarithmic, best, room[0])
    coarse[2][:] = 0.0
    _chi2(coarse, logarithmic, best, room[1])
    jacobian, wanted, root_weight, model = room[1][0], np.zeros(room[1][1].size), coarse[3], room[1][1]
    for i in range(groups.size):
        wanted[groups[i]] += channels[3][i] * room[0][1][i] / root_weight[groups[i]]
    size = best.size
    matrix, missing = np.empty((size, size)), np.zeros(size)
    for p in range(size):
        missing[p] = (room[0][0][p] * room[0][1]).sum() - (jacobian[p] * wanted).sum()
        for q in range(p + 1):
            matrix[p, q] = (jacobian[p] * jacobian[q]).sum() + precision[p, q]
        matrix[p, p] *= 1.0 + RIDGE
    if _cholesky(matrix):
        _solve(matrix, missing)
        for p in range(size):
            wanted += missing[p] * jacobian[p]
    for j in range(root_weight.size):
        coarse[2][j] = (wanted[j] - model[j]) / root_weight[j]


@compiled
def _cholesky(matrix: Any) -> bool:
    """Overwrite the lower triangle by its Cholesky factor; False where there is none."""
    for k in range(matrix.shape[0]):
        for j in range(k + 1):
            total = matrix[k, j]
            for i in range(j):
                total -= matrix[k, i] * matrix[j, i]
            if j < k:
                matrix[k, j] = total / matrix[j, j]
            elif total > 0.0:
                matrix[k, k] = math.sqrt(total)
            else:
                return False
    return True


@compiled
def _solve(factor: Any, right: Any) -> None:
    for k in range(right.size):
        for i in range(k):
            right[k] -= factor[k, i] * right[i]
        right[k] /= factor[k, k]
    for k in range(right.size - 1, -1, -1):
        for i in range(k + 1, right.size):
            right[k] -= factor[i, k] * right[i]
        right[k] /= factor[k, k]


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
    target: Any, beta: float, factor: Any, step: float, generator: Any, point: Any, energy: Any, room: Any
) -> float:
    """One Hamiltonian trajectory of `point`, accepted or not; its `energy` follows. Returns 1 where accepted."""
    trial, momentum, velocity, gradient, ending = room[2]
    free, change = target[8], 0.0
    step *= generator.uniform(0.8, 1.2)
    for k in range(momentum.size):
        momentum[k] = generator.standard_normal()
        change -= 0.5 * momentum[k] ** 2
    trial[:] = point
    leaps = min(MOST_LEAPS, math.ceil(TRAJECTORY / step))
    if not _force(target, beta, trial, room, gradient):
        return 0.0
    for leap in range(leaps):
        _push(factor, free, gradient, 0.5 * step if leap == 0 else step, momentum)
        _velocity(factor, momentum, velocity)
        if not _drift(target, factor, trial, momentum, velocity, step):
            return 0.0
        if not _force(target, beta, trial, room, gradient):
            return 0.0
    _push(factor, free, gradient, 0.5 * step, momentum)
    for k in range(momentum.size):
        change += 0.5 * momentum[k] ** 2
    _energies(target, trial, room, ending)
    change += beta * (ending[0] - energy[0]) + ending[1] - energy[1] + (1.0 - beta) * (ending[2] - energy[2])
    if not math.log(generator.random()) < -change:
        return 0.0
    point[:], energy[:] = trial, ending
    return 1.0


@compiled
def _move_all(
    target: Any, beta: float, factor: Any, tuning: Any, generator: Any, particles: Any, energies: Any, room: Any
) -> None:
    """One trajectory of every particle; `tuning` is the step's length, to be adapted, and the acceptance."""
    accepted = 0.0
    for i in range(particles.shape[0]):
        accepted += _trajectory(target, beta, factor, tuning[0], generator, particles[i], energies[i], room)
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


@compiled
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


@compiled
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
    if not _cholesky(covariance):
        return False
    factor[:, :] = covariance
    return True


@compiled
def _resample(weights: Any, offset: float, particles: Any, energies: Any, ancestors: Any) -> None:
    """Systematic resampling: particles, energies and ancestors drawn in proportion to the weights."""
    count = weights.size
    chosen = np.empty(count, dtype=np.int64)
    total, source = weights[0], 0
    for i in range(count):
        while source < count - 1 and total < (i + offset) / count:
            source += 1
            total += weights[source]
        chosen[i] = source
    particles[:, :] = particles[chosen].copy()
    energies[:, :] = energies[chosen].copy()
    ancestors[:] = ancestors[chosen].copy()


@compiled
def _correlation(before: Any, after: Any, free: Any) -> float:
    """Largest over the free parameters of the correlation between two states of the population."""
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
        largest = max(largest, ab / math.sqrt(aa * bb) if aa > 0.0 and bb > 0.0 else 1.0)
    return largest


@compiled
def _stage(
    target: Any, groups: Any, beta: float, factor: Any, tuning: Any, generator: Any, particles: Any, energies: Any,
    ancestors: Any, weights: Any, room: Any,
) -> Any:  # fmt: skip
    """Raise beta, resample and move; returns the new beta and how many trajectories each particle made."""
    beta = _next_beta(beta, energies, weights)
    even = 0.5 * (weights + 1.0 / weights.size)
    _factor_of(particles, even, target[8], factor)
    _resample(weights, generator.random(), particles, energies, ancestors)
    _correct(target, groups, particles[np.argmin(energies[:, 0] + energies[:, 1])], room)
    before, moves, kept = particles.copy(), 0, 1.0
    while kept > FORGOTTEN and moves < MOST_MOVES:
        _move_all(target, beta, factor, tuning, generator, particles, energies, room)
        kept, moves = _correlation(before, particles, target[8]), moves + 1
    return beta, moves


@compiled
def _settle(
    target: Any, factor: Any, tuning: Any, generator: Any, particles: Any, energies: Any, weights: Any, room: Any
) -> int:
    """Move on the posterior itself until the resampled copies have parted; returns how often."""
    before, moves, kept = particles.copy(), 0, 1.0
    while kept > SETTLED and moves < MOST_SETTLING:
        if moves % FRESH == 0:
            _factor_of(particles, weights, target[8], factor)
        _move_all(target, 1.0, factor, tuning, generator, particles, energies, room)
        kept, moves = _correlation(before, particles, target[8]), moves + 1
    return moves


@compiled
def _room(size: int, channels: int) -> Any:
    return np.empty((size, channels)), np.empty(channels), np.empty(channels), np.empty(channels, dtype=np.int64)


@compiled(nogil=True)  # type: ignore[untyped-decorator]
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
    ancestors : (n,) becomes to which of `FAMILIES` families each particle belongs.
    report : becomes steps of beta, trajectories per particle, mean acceptance and step length at the end.
    """
    free, (count, size) = target[8], particles.shape
    points = (np.empty(size), np.empty(free.size), np.empty(free.size), np.empty(size), np.empty(3))
    room = (_room(size, target[0][0].size), _room(size, target[1][0].size), points)
    tuning, weights, energies = np.array([FIRST_STEP, 0.0]), np.empty(count), np.empty((count, 3))
    for i in range(count):
        _energies(target, particles[i], room, energies[i])
    for _ in range(FIRST_MOVES):
        _move_all(target, 0.0, factor, tuning, generator, particles, energies, room)
    beta, report[:] = 0.0, 0.0
    ancestors[:] = np.arange(count) % FAMILIES
    while beta < 1.0:
        beta, moves = _stage(
            target, groups, beta, factor, tuning, generator, particles, energies, ancestors, weights, room
        )
        report[0] += 1
        report[1] += moves
        if beta < PARTED:
            ancestors[:] = np.arange(count) % FAMILIES
    weights[:] = 1.0 / count
    report[1] += _settle(target, factor, tuning, generator, particles, energies, weights, room)
    for r in range(draws.shape[0]):
        _move_all(target, 1.0, factor, tuning, generator, particles, energies, room)
        report[2] += tuning[1] / draws.shape[0]
        draws[r] = particles
        for i in range(count):
            objective[r, i] = 2.0 * (energies[i, 0] + energies[i, 1])
    report[3] = tuning[0]
