"""Loads and soil in turn: loads on the believed soil, the soil from measured states and these loads, and so on.

Forces that came from a soil cannot prove it. What is new is measured: sinkage under the load of each wheel, and slip
against what all wheels together have to pull. Only these two are used: the loads, and the totals of drawbar pulls and
lateral forces, which the balance tells nearly without the soil; not how the totals share out among the wheels. Every
round begins with the same belief, never with the last round's, so nothing is counted twice.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from lunarsci.arrays import FloatArray, at_times
from lunarsci.errors import ParameterError
from lunarsci.regolith.belief import SoilBelief
from lunarsci.regolith.inference.totals import BalancedStates, TotalsPosterior, infer_from_totals
from lunarsci.twin.ground.terrain import Terrain
from lunarsci.twin.loads.load_ensemble import BALANCE_ERROR, DRAWS, LoadEnsemble, draw_loads
from lunarsci.twin.loads.prescribed_motion import PoseStates, contact_jacobian, net_wrench
from lunarsci.twin.plans.motion import Motion
from lunarsci.twin.rover import Rover

SOIL_STILL, FORCES_STILL = 0.1, 0.01
"""Largest move of the soil's mean, in what remains of its standard deviations, and of pulls and lateral forces as a
share of themselves, in a round that has converged; assumed."""
OPPOSITE, NOT_SMALLER = -0.5, 0.8
"""Cosine between two moves of the soil below which the second goes back, and the share of the first that it has at
least where the rounds do not calm down; assumed."""
MOST_ROUNDS, WORST_REDUCED = 50, 1.5
"""Rounds, and reduced chi-square of the states beyond which no soil explains them; assumed."""
ALIKE = math.sqrt(2.0 * math.pi)
"""Correlation lengths over which errors count as one: the integral of exp(-d^2 / 2)."""


@dataclass(frozen=True, slots=True, eq=False)
class Round:
    """What one round changed.

    `soil` and `forces` are moves as in `SOIL_STILL` and `FORCES_STILL`; `step` is the soil's, by parameter, in standard
    deviations that remain (8,); `sd_ratio` what remains of those before any drive; reduced chi-squares.
    """

    soil: float
    forces: float
    step: FloatArray
    sd_ratio: dict[str, float]
    reduced_sinkages: float
    reduced_totals: float


@dataclass(frozen=True, slots=True, eq=False)
class AlternatingEstimate:
    """The soil and the forces on it after the last round, the rounds, and whether they converged."""

    posterior: TotalsPosterior
    forces: LoadEnsemble
    rounds: tuple[Round, ...]
    verdict: str

    @property
    def converged(self) -> bool:
        """Whether the last round changed next to nothing."""
        return self.verdict == "converged"

    @property
    def doubt(self) -> str:
        """Why the soil is not to be trusted; empty where it may be."""
        if not self.converged:
            rounds = len(self.rounds)
            return f"forces and soil: {self.verdict} within {rounds} rounds; give more, or look at the states"
        if (worst := max(self.posterior.reduced)) <= WORST_REDUCED:
            return ""
        return f"no soil explains the states (reduced chi-square {worst:.1f}); look at their errors and at the terrain"


def alternate(
    rover: Rover,
    terrain: Terrain,
    motion: Motion,
    states: PoseStates,
    belief: SoilBelief,
    *,
    rounds: int,
    draws: int = DRAWS,
    correlation_m: float,
    balance_error: float = BALANCE_ERROR,
    seed: int = 0,
    progress: Callable[[int, int], None] | None = None,
) -> AlternatingEstimate:
    """Forces and soil in turn, until a round changes next to nothing.

    Parameters
    ----------
    rover, terrain, motion, correlation_m, balance_error : as in `draw_loads`.
    states : measured states; sinkage and slip ratio are needed.
    belief : what is held of the soil before this drive, every round's beginning.
    rounds : at most, 1 to 50.
    draws : soils and motions on which the forces of each round are computed.
    seed : of these; the same in each round, so that rounds differ by their soils alone.
    progress : called with (done, total).

    Raises ParameterError for rounds out of range, and states without anything to learn from.
    """
    if not 1 <= rounds <= MOST_ROUNDS:
        raise ParameterError(f"{rounds} rounds; give 1 to {MOST_ROUNDS}")

    def forces_on(soil: SoilBelief, number: int) -> LoadEnsemble:
        return draw_loads(
            rover,
            terrain,
            motion,
            soil.draws(draws, seed),
            {name: middle for name, (middle, _, _) in soil.intervals().items()},
            correlation_m=correlation_m,
            balance_error=balance_error,
            seed=seed,
            progress=lambda done, total: progress(number * total + done, (rounds + 1) * total) if progress else None,
        )

    forces, before, done = forces_on(belief, 0), belief, list[Round]()
    while True:
        found = infer_from_totals(balanced_states(forces, states, balance_error), rover.wheel, belief)
        after = forces_on(found.belief, len(done) + 1)
        done.append(_round(before, found, forces, after))
        forces, before = after, found.belief
        verdict = verdict_of(done)
        if verdict == "converged" or len(done) == rounds:
            return AlternatingEstimate(found, forces, tuple(done), verdict)


def verdict_of(rounds: list[Round]) -> str:
    """`converged`, `oscillates` or `does not converge`, after some rounds."""
    last = rounds[-1]
    if last.soil < SOIL_STILL and last.forces < FORCES_STILL:
        return "converged"
    if len(rounds) > 1:
        one, two = rounds[-2].step, last.step
        size = float(np.linalg.norm(one) * np.linalg.norm(two))
        if one @ two < OPPOSITE * size and np.linalg.norm(two) > NOT_SMALLER * np.linalg.norm(one):
            return "oscillates"
    return "does not converge"


def balanced_states(forces: LoadEnsemble, states: PoseStates, balance_error: float) -> BalancedStates:
    """Measured states with the loads and totals of their times.

    Errors of the motion, and of the slope in the balance, are alike over the correlation length; the states within it
    count together as one.
    """
    held, rover = forces.held, forces.held.rover
    times, values, sigmas = states.by_pose(len(rover.wheels))
    load, load_sigma = (part[..., 0] for part in (forces.after, forces.after_sigma))
    levers = contact_jacobian(held)
    told = (load, load_sigma, levers[..., 1:], net_wrench(held, levers))
    kept = [np.where(forces.known.reshape(-1, *([1] * (part.ndim - 1))), part, np.nan) for part in told]
    load, load_sigma, levers, totals = (at_times(times, held.motion.time_s, part, beyond=False) for part in kept)
    reach = float(np.hypot(*rover.wheel_positions_m[:, :2].T).max())
    error = balance_error * rover.mass_kg * rover.gravity_m_s2 * np.array([1.0, 1.0, reach])
    used = np.isfinite(totals).all(axis=1) & np.isfinite(values[..., :2]).any(axis=(1, 2))
    rolled = np.interp(times[used], held.motion.time_s, held.motion.rolled_m)
    poses, way = int(used.sum()), float(np.ptp(rolled)) if used.any() else 0.0
    alike = float(np.clip(ALIKE * forces.correlation_m * (poses - 1) / way, 1.0, poses)) if way > 0 else max(1.0, poses)
    return BalancedStates(
        inputs=values,
        input_sigma=sigmas,
        load=load,
        load_sigma=np.nan_to_num(load_sigma),
        levers=np.nan_to_num(levers),
        totals=totals,
        totals_sigma=np.tile(error, (len(times), 1)),
        alike=alike,
    )


def _round(before: SoilBelief, found: TotalsPosterior, one: LoadEnsemble, two: LoadEnsemble) -> Round:
    sd = np.sqrt(np.diag(found.belief.covariance))
    step = (found.belief.mean - before.mean) / sd
    known = one.known & two.known
    pulls = two.after[known, :, 1:]
    moved = np.sqrt(np.mean((pulls - one.after[known, :, 1:]) ** 2) / np.mean(pulls**2))
    sinkages, totals = found.reduced
    return Round(float(np.abs(step).max()), float(moved), step, found.belief.sd_ratio, sinkages, totals)
