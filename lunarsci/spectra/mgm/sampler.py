"""Sampler of the posterior of a Modified Gaussian Model: a population carried from the prior to the data.

`tempering` says how; here, particles move by Hamiltonian trajectories that bounce off the bounds. All that the prior
allows is there at the start, so separate minima keep their weights.

Neal (2011), Handbook of Markov Chain Monte Carlo, ch. 5, 10.1201/b10905 (Hamiltonian trajectories, bounds); Buchholz,
Chopin & Jacob (2021), Bayesian Anal. 16, 745, 10.1214/20-BA1222 (their tuning inside such a population).
"""

import math
from contextlib import suppress
from dataclasses import dataclass
from typing import Any

import numpy as np

from lunarsci.arrays import FloatArray, IntArray
from lunarsci.compiled import VECTORS, compiled
from lunarsci.spectra.mgm.forward import RIDGE, correct_coarse, energies_of, force_of
from lunarsci.tempering import Moves, carry, forget

WANTED_ACCEPTANCE, TUNING = 0.75, 1.0
FIRST_STEP, LEAST_STEP, MOST_STEP = 0.3, 1e-3, 0.7
SHORTEST, LONGEST = 0.5, 3.5
"""Lengths of trajectories in standard deviations, uniformly at random: a normal law is forgotten after pi / 2 and back,
mirrored, after pi; the curved valleys of this model are longer."""
MOST_LEAPS, MOST_BOUNCES = 400, 200
AT_A_STEP, SETTLING = Moves(1, 30, 0.8, mirrored=True), Moves(24, 64, 0.12, mirrored=True)
"""Trajectories of each particle at a step of beta, and before draws are kept."""
FIRST_MOVES, FRESH = 10, 8
"""Trajectories before the first step, which tune their length, and with one metric while the population settles."""
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


@dataclass(slots=True, eq=False)
class _Particles:
    """A population of `tempering`; `run_population` says what `target`, `groups`, `factor` and `ancestors` are.

    `energies` (n, 3) are those of `energies_of`; `tuning` has the step's length and the acceptance of the last moves.
    Once `settling`, the metric is the population's own, renewed after every `FRESH` moves.
    """

    target: Any
    groups: Any
    factor: Any
    generator: np.random.Generator
    all_points: FloatArray
    ancestors: IntArray
    energies: FloatArray
    space: Any
    tuning: FloatArray
    settling: bool = False
    settled: int = 0

    @property
    def points(self) -> FloatArray:
        return self.all_points[:, self.target[8]]

    @property
    def ln_likelihood(self) -> FloatArray:
        """What beta brings in: the data, less the law that fades as they come."""
        return self.energies[:, 2] - self.energies[:, 0]

    def resample(self, beta: float, weight: FloatArray, chosen: IntArray) -> None:
        self._take_metric(0.5 * (weight + 1.0 / weight.size))
        for rows in (self.all_points, self.energies, self.ancestors):
            rows[:] = rows[chosen]
        best = self.all_points[np.argmin(self.energies[:, 0] + self.energies[:, 1])]
        correct_coarse(self.target, self.groups, best, self.space)

    def move(self, beta: float) -> None:
        if self.settling:
            if self.settled % FRESH == 0:
                self._take_metric(np.full(len(self.energies), 1.0 / len(self.energies)))
            self.settled += 1
        _move_all(
            self.target, beta, self.factor, self.tuning, self.generator, self.all_points, self.energies, self.space
        )

    def _take_metric(self, weight: FloatArray) -> None:
        """The factor of the weighted covariance, where it has one."""
        covariance = np.cov(self.points.T, ddof=0, aweights=weight).reshape(self.factor.shape)
        covariance[np.diag_indices_from(covariance)] *= 1.0 + RIDGE
        with suppress(np.linalg.LinAlgError):
            self.factor[:] = np.linalg.cholesky(covariance)


def _workspace(size: int, channels: int) -> Any:
    return np.empty((size, channels)), np.empty(channels), np.empty(channels)


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
    energies, tuning = np.empty((count, 3)), np.array([FIRST_STEP, 0.0])
    _energies_of_all(target, particles, space, energies)
    population = _Particles(target, groups, factor, generator, particles, ancestors, energies, space, tuning)
    for _ in range(FIRST_MOVES):
        population.move(0.0)
    report[:], ancestors[:] = 0.0, np.arange(count)
    for step in carry(population, generator, AT_A_STEP):
        report[:2] += 1, step.moves
        if step.beta < PARTED:
            ancestors[:] = np.arange(count)
    population.settling = True
    report[1] += forget(population, 1.0, SETTLING)[0]
    population.settling = False
    for r in range(draws.shape[0]):
        population.move(1.0)
        report[2] += tuning[1] / draws.shape[0]
        draws[r], objective[r] = particles, 2.0 * (energies[:, 0] + energies[:, 1])
    report[3] = tuning[0]
