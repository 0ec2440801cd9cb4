"""The soil that explains a drive: the twin drives the same plan on many soils and keeps those that meet what was
measured.

Every simulated drive obeys the balance of forces, so that sinkage, slip and side slip along the whole path, and where
it led, speak of the soil together, with or without measured forces. Soils that explain a drive lie along curves
(cohesion, friction and shear modulus make up for each other), so the posterior is carried as particles, not taken
for normal. Where the best soil leaves residuals larger than the errors, or alike for long stretches, the twin's physics
misses something, and errors are widened by as much before the soil is believed.

Slip and sinkage of a drive need not be those of one soil of the twin's law: another law, rover or terrain, or a track
that was measured wrong. The update then finds the soil in between, and allows for it as an error that all wheels share;
`SlipLean` says which way predictions lean then.
"""

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.special import chdtri, expit

from lunarsci.arrays import SIGNIFICANCE, BoolArray, FloatArray, at_times
from lunarsci.errors import ParameterError
from lunarsci.ranges import NOT_NEGATIVE, check_range
from lunarsci.regolith.belief import SoilBelief
from lunarsci.regolith.physics_discrepancy import PhysicsDiscrepancy
from lunarsci.regolith.prior import PARAMETERS, strange
from lunarsci.twin.assimilation.posterior import (
    DrivePosterior,
    PosteriorMode,
    draw_particles,
    find_mode,
    inflation_of,
    posterior_of,
    wheel_errors,
)
from lunarsci.twin.assimilation.residuals import (
    FIX_ERROR_M,
    HUBER,
    MODEL_SHARES,
    OBSERVED,
    POSITION,
    SAMPLE_M,
    STEP_S,
    DriveBias,
    DriveRecord,
    DriveResiduals,
    states_at,
)
from lunarsci.twin.ground.terrain import Terrain
from lunarsci.twin.plans.plan import Plan
from lunarsci.twin.rover import Rover
from lunarsci.twin.simulation.discrepancy import TURNS, exposed, turn_matrix, way_matrix
from lunarsci.twin.simulation.ensemble import MOST_BEYOND, Prediction, predict
from lunarsci.units import DEG

PARTICLES, FEWEST_PARTICLES = 128, 32
"""In the population of an update, by default and at least."""
ROUNDS = 2
"""Of widening errors by what the best soil leaves, and looking for it again."""
MOST_INFLATION = 5.0
"""Factor of the errors beyond which it is asked whether the twin explains a drive: sensors that measure better than the
twin's law holds are no fault of the drive. Assumed."""
UNEXPLAINED = 0.8
"""Root mean square of what the best soil leaves of a quantity, as a share of that of the quantity, from which on the
twin explains nothing of it, as with a wrong sign or unit; of a position, as a share of the way, a tenth. Assumed."""
UNEXPLAINED_OF_WAY = 0.1
"""See `UNEXPLAINED`."""
SLIGHT = {
    "sinkage_m": 0.002,
    "slip_ratio": 0.03,
    "side_slip_deg": 1.0,
    "normal_force_n": 1.0,
    "drawbar_pull_n": 0.5,
    "lateral_force_n": 0.5,
}
"""What is left of a quantity and is no reason to refuse, however small the quantity; assumed."""
MOST_OF_A_WHEEL = 0.3
"""What single wheels may be off by throughout, of a slip of 1 along or across, of the mean sinkage, or of the load;
assumed."""
SLIP_OF_1 = {"slip_ratio": 1.0, "side_slip_deg": DEG}
"""By definition: a speed across that is the one along is a side slip of 1 rad, to the first order."""
LARGE = {name: "normal_force_n" if name.endswith("_n") else name for name in OBSERVED}
"""The quantity whose size errors of each quantity are held against: forces against the load."""
LEAST_FLOOR = 0.05
"""Multiple of `MODEL_ERRORS` that is always added, so that a force of 0 measured to 3 % has an error; assumed."""
FOLLOWED = 2.0**0.5
"""By which the miss of an end is taken larger than what the soil that was found with it leaves: the variance that held
for returns in an independent simulator; assumed elsewhere."""
SETTLED = 0.3
"""Autocorrelation of particles above which they have not spread out; assumed."""
SURPRISING = math.sqrt(chdtri(len(PARAMETERS), SIGNIFICANCE) / len(PARAMETERS))
"""Prior shift that a soil of the belief has with a chance of `SIGNIFICANCE` at most: above it the ground differs."""
WIDENED = 2.0
"""Factor of the errors of positions from which on it is warned of: one soil of this law does not lead where the rover
went. So it is of 1 of 70 right beliefs and of 10 of 38 of other physics, rovers and tracks that nothing else doubts,
measured by `tests/benchmarks/leaning.py` (docs/validation/drive.md). [-]"""
STILL = 1.1
"""Factor of the errors in a round that has converged; assumed."""
LEAST_LEAN, LEAN_ERRORS, LEAN_SOILS = 0.02, 2.0, 64
"""Slip that a belief may lean by: so much, or so many standard errors where that is more; and soils that tell the
spread. Of 70 right beliefs the farthest lean by 0.017 and by 1.7 errors, measured by `tests/benchmarks/leaning.py`
(docs/validation/drive.md). [-]"""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class SoilUpdate:
    """What a drive says of the soil.

    Attributes
    ----------
    belief : after the drive; the one before it where `refused` says why nothing was learned.
    prediction : the drive on the soil that explains it best.
    residuals : simulated less measured, over the errors of single values as they were widened: states (n, 6), columns
        `OBSERVED`, NaN where not measured. [-]
    outliers : values of states that count as such. (n, 6)
    inflation : by quantity, what its errors were multiplied by as the twin's physics misses it by more; 1 otherwise.
    wheel_errors : by quantity, standard deviation of what each wheel was found to be off by throughout, in its unit.
    chi_square, values : of the values that are no outliers, and their number, positions included.
    prior_shift : distance of the new mean from the old one in standard deviations of the old belief, root mean square
        over the parameters of the soil: about 1 or less where the ground is the one that was believed. [-]
    autocorrelation : largest correlation of the particles with where they were before their last moves. [-]
    refused : empty, or why the belief was not moved.
    ruts_probability : that wheels met the ruts of those before them, 0 or 1 where that was given; the belief is of
        both, each as probable as it is. [-]
    """

    belief: SoilBelief
    prediction: Prediction
    residuals: FloatArray
    outliers: BoolArray
    inflation: Mapping[str, float]
    wheel_errors: Mapping[str, float]
    chi_square: float
    values: int
    prior_shift: float
    autocorrelation: float
    refused: str
    ruts_probability: float = 0.0

    @property
    def reduced(self) -> float:
        """Chi-square for each value kept. [-]"""
        return self.chi_square / max(self.values, 1)

    @property
    def settled(self) -> bool:
        """Whether the particles have spread out; if not, intervals are too narrow."""
        return self.autocorrelation <= SETTLED

    @property
    def learned_from(self) -> str:
        """How many values the soil was learned from, and of what."""
        inliers = (np.isfinite(self.residuals) & ~self.outliers).sum(axis=0)
        parts = [f"{count} of {name}" for name, count in zip(OBSERVED, inliers, strict=True) if count]
        places = self.values - int(inliers.sum())
        parts += [f"{places} of {places // 2} positions (x and y)"] if places else []
        return f"{self.values} values: {', '.join(parts)}"

    @property
    def other_ground(self) -> str:
        """What to do where the drive was hardly on the ground that was believed; empty where it was."""
        if self.refused or self.prior_shift <= SURPRISING:
            return ""
        return (
            f"the soil found lies {self.prior_shift:.1f} standard deviations from what was believed: is it the same "
            "ground? begin without --soil, or with --forget, at a new site"
        )

    @property
    def doubt(self) -> str:
        """Why predictions from what was learned are doubtful, although no value refuses it; empty where they are not.

        In simulations one soil that explained a drive only with errors so much larger put the return off by 0.5 m.
        """
        worst = max(self.inflation, key=lambda name: self.inflation[name], default="")
        if self.refused:
            return ""
        belief = self.belief
        learned_from = [
            f"{text}: no soil or wheel of the priors has that; look for a wrong rover, terrain or track depth"
            for text in strange(belief.laws, belief.mean, np.sqrt(np.diag(belief.covariance)))
        ]
        if worst and self.inflation[worst] > MOST_INFLATION:
            learned_from.append(
                f"one soil explains {worst} only with {self.inflation[worst]:.1f} times its errors: the ground may "
                "change along the way or carry ruts, so predictions from this belief are doubtful"
            )
        return "; ".join(learned_from)

    @property
    def caution(self) -> str:
        """What to know of the positions where it is not doubt enough; empty where there is nothing."""
        factor = self.inflation.get(POSITION, 1.0)
        if self.refused or not WIDENED < factor <= MOST_INFLATION:
            return ""
        return (
            f"one soil explains the positions only with {factor:.1f} times their errors: ends predicted from it may be "
            "off by more than is said; look at rover, plan and terrain"
        )


def assimilate(
    rover: Rover,
    terrain: Terrain,
    plan: Plan,
    record: DriveRecord,
    belief: SoilBelief,
    *,
    particles: int = PARTICLES,
    model_error: float = 1.0,
    seed: int = 0,
    teach: bool = True,
    ruts: bool | None = None,
    wheel: bool = True,
    progress: Callable[[int, int], None] | None = None,
) -> SoilUpdate:
    """Update the belief of a soil by a drive.

    The belief's discrepancy learns what the best soil leaves unexplained of the states, and how far it misses the last
    position, with twice the variance, as the soil followed it. What the twin's physics is off by is drawn anew for each
    drive, though it is much the same on the next: many updates on the same ground narrow a belief more than they
    should.

    Parameters
    ----------
    rover, terrain, plan : what was driven where; the belief takes the place of the terrain's soil.
    record : what was measured on the way.
    belief : before the drive; its mean and covariance count, not its population.
    particles : in the population, 32 or more.
    model_error : of the twin's physics, as a multiple of `MODEL_SHARES` and `MODEL_ERRORS`; 0 where the drive is the
        twin's own. [-]
    seed : of the population.
    ruts : whether simulated wheels meet the ruts of those before them; None asks the drive, which is as likely with as
        without them beforehand. `SoilUpdate.prediction` is of the more probable one.
    wheel : whether contact angles and effective radius of the wheels are unknown, too, and in the belief afterwards;
        False takes those of the rover's file, or what the belief holds of them.
    teach : whether the discrepancy learns, False where a comparison taught it this drive already.
    progress : called with (done, total).

    Raises ParameterError for a record of another rover, with fewer values than parameters, or a drive that no soil of
    the belief carries to its end.
    """
    check_range("particles", particles, f"[{FEWEST_PARTICLES}, inf)")
    check_range("model_error", model_error, NOT_NEGATIVE)
    random = np.random.default_rng(seed)
    common = {name: model_error * share for name, share in MODEL_SHARES.items()}
    bias = DriveBias(common, turns=model_error * float(np.sqrt(TURNS.variance)))
    floor = max(model_error, LEAST_FLOOR)
    prior = belief.opened(rover.wheel) if wheel else belief
    drive = DriveResiduals(rover, terrain, plan, record, prior, bias=bias, floor=floor)
    fits = _fits(drive, random, ruts)
    posterior, mode = fits[0].posterior, fits[0].mode
    residual = posterior.residuals(mode.point[None])[0][0]
    states, places = posterior.drive.parts(residual)
    counted, inflation = posterior.drive.counted, posterior.drive.inflation
    outliers = counted & (np.abs(states) > HUBER)
    inliers = counted & ~outliers
    wheels = _in_units(posterior.drive)
    expected = posterior.drive.states_at(posterior.coordinates.transforms(mode.point))
    best = posterior.drive.simulated(posterior.coordinates.transforms(mode.point[None]))
    refused = _refusal(posterior.drive, int(outliers.sum()), wheels, expected, best)
    learned, left = belief, 0.0
    if not refused:
        points, met, left = _drawn(fits, particles, random, progress)
        discrepancy = _taught(belief.discrepancy, posterior.drive, expected, best) if teach else belief.discrepancy
        moments = (points.mean(axis=0), np.cov(points.T))
        learned = SoilBelief(prior.laws, *moments, belief.history, points, belief.verdict, discrepancy, met)
    moved = (posterior.coordinates.transforms(mode.point) if refused else learned.mean) - prior.mean
    moved = moved[: len(PARAMETERS)]
    return SoilUpdate(
        belief=learned,
        prediction=best,
        residuals=np.where(counted, posterior.drive.states_as_measured(residual), np.nan),
        outliers=outliers,
        inflation=inflation,
        wheel_errors=wheels,
        chi_square=float((states[inliers] ** 2).sum() + (places**2).sum()),
        values=int(inliers.sum() + places.size),
        prior_shift=float(np.sqrt(moved @ np.linalg.solve(belief.soil.covariance, moved) / len(moved))),
        autocorrelation=left,
        refused=refused,
        ruts_probability=sum(fit.probability for fit in fits if fit.posterior.drive.ruts),
    )


@dataclass(frozen=True, slots=True, eq=False)
class DriveFit:
    """The most probable soil with ruts, or without, errors widened to what it leaves; how probable it makes them."""

    posterior: DrivePosterior
    mode: PosteriorMode
    probability: float = 1.0


def _fits(drive: DriveResiduals, random: np.random.Generator, ruts: bool | None) -> list[DriveFit]:
    """What explains a drive, the more probable first: with ruts, without, or both, by the evidence for each."""
    first = _best_soil(replace(drive, ruts=bool(ruts)), random)
    if ruts is not None:
        return [DriveFit(*first)]
    try:
        other = _best_soil(replace(drive, ruts=True), random, first[1].point[None])
    except ParameterError:
        return [DriveFit(*first)]
    share = float(expit(other[0].ln_evidence(other[1]) - first[0].ln_evidence(first[1])))
    return sorted((DriveFit(*first, 1.0 - share), DriveFit(*other, share)), key=lambda fit: -fit.probability)


def _drawn(
    fits: Sequence[DriveFit],
    particles: int,
    random: np.random.Generator,
    progress: Callable[[int, int], None] | None,
) -> tuple[FloatArray, BoolArray, float]:
    """Draws of all fits, of each as many as it is probable: transforms (particles, p), whether they meet ruts
    (particles,), and the largest correlation.
    """
    counts = [round(fit.probability * particles) for fit in fits]
    parts, met, left = [], list[bool](), 0.0
    for fit, count in zip(fits, [particles - sum(counts[1:]), *counts[1:]], strict=True):
        if count:
            enough = max(count, FEWEST_PARTICLES)
            drawn, correlation = draw_particles(fit.posterior, fit.mode, enough, random, progress)
            parts.append(fit.posterior.coordinates.transforms(drawn[:count]))
            met += count * [fit.posterior.drive.ruts]
            left = max(left, correlation)
    return np.vstack(parts), np.array(met), left


def _best_soil(
    drive: DriveResiduals, random: np.random.Generator, starts: FloatArray | None = None
) -> tuple[DrivePosterior, PosteriorMode]:
    """The most probable soil, with errors widened to what it leaves; `starts` as in `find_mode`."""
    posterior, mode = _mode_of(drive, random, starts)
    for _ in range(ROUNDS):
        residual = posterior.residuals(mode.point[None])[0][0]
        wheels = wheel_errors(drive, drive.states_as_measured(residual))
        wider = inflation_of(drive, *drive.parts(residual))
        grown = any(size > STILL * drive.bias.wheels.get(name, 0.0) for name, size in wheels.items())
        if not grown and all(factor < STILL for factor in wider.values()) and drive.expected is not None:
            break
        counted = dict(drive.inflation)
        drive = replace(
            drive,
            expected=drive.states_at(posterior.coordinates.transforms(mode.point)),
            inflation=counted | {name: factor * counted.get(name, 1.0) for name, factor in wider.items()},
            bias=replace(drive.bias, wheels={name: size / wider.get(name, 1.0) for name, size in wheels.items()}),
        )
        posterior, mode = _mode_of(drive, random, mode.point[None])
    return posterior, mode


def _mode_of(
    drive: DriveResiduals, random: np.random.Generator, starts: FloatArray | None = None
) -> tuple[DrivePosterior, PosteriorMode]:
    """The posterior of a drive, and its mode; `starts` as in `find_mode`. Raises ParameterError where it has none."""
    posterior = posterior_of(drive)
    mode = find_mode(posterior, random, starts)
    if mode is None:
        raise ParameterError("no soil of the belief carries the rover to the end; was this the plan that was driven?")
    return posterior, mode


def _in_units(drive: DriveResiduals) -> dict[str, float]:
    """Errors that wheels have of their own, in the unit of the quantity."""
    sigma = {name: drive.sigma[drive.counted[:, k], k] for k, name in enumerate(OBSERVED)}
    return {name: float(size * np.median(sigma[name])) for name, size in drive.bias.wheels.items()}


def _taught(
    before: PhysicsDiscrepancy, drive: DriveResiduals, expected: FloatArray, best: Prediction
) -> PhysicsDiscrepancy:
    """The discrepancy after a drive, by what the soil that explains it best leaves of its states and of its end."""
    law = before
    if drive.counted[:, :3].any():
        law = law.after_states(unexplained_share(drive, expected, best))
    times = drive.record.fix_time_s
    if not len(times):
        return law
    last = int(times.argmax())
    place = at_times(times[last : last + 1], best.time_s, best.paths[..., :2], axis=-2)[0, 0]
    so_far = slice(0, int(np.searchsorted(best.time_s, times[last])) + 1)
    counted = drive.record.fix_covariance_m2[last] + FIX_ERROR_M**2 * np.eye(2)
    counted += turn_matrix(drive.plan, best.planned[so_far], best.distance_m[so_far], best.paths[:, so_far])
    miss = FOLLOWED * (drive.record.fix_m[last] - place)
    return law.after_end(miss, counted, way_matrix(best.planned[so_far, :2], best.paths[:, so_far, :3]))


def unexplained_share(drive: DriveResiduals, expected: FloatArray, best: Prediction) -> float:
    """What errors of sinkage, slip and side slip were widened by, root of the summed squares. [-]

    As a share of the mean sinkage, and of the part of the way that the physics can be off in.
    """
    planned, paths = best.planned[:, :2], best.paths[..., :3]
    way = float(exposed(planned, paths).mean())
    total = 0.0
    for k, name in enumerate(OBSERVED[:3]):
        rows, factor = drive.counted[:, k], drive.inflation.get(name, 1.0)
        if not rows.any() or factor <= 1.0:
            continue
        added = float(np.median(drive.sigma[rows, k])) * np.sqrt(1.0 - factor**-2)
        size = float(np.abs(expected[rows, k]).mean()) if name == "sinkage_m" else way
        total += ((np.radians(added) if name == "side_slip_deg" else added) / max(size, 1e-9)) ** 2
    return float(np.sqrt(total))


def _refusal(
    drive: DriveResiduals, outliers: int, wheels: Mapping[str, float], expected: FloatArray, best: Prediction
) -> str:
    """Why nothing is learned from a drive, one sentence; empty where something is.

    `outliers` is how many values are, `wheels` as `SoilUpdate.wheel_errors`; `expected` (n, 6) and `best` are the
    states and the drive on the best soil.
    """
    look = "look for a wrong plan, terrain or clock, or begin anew with another belief"
    if outliers > MOST_BEYOND * (values := int(drive.counted.sum())):
        return f"{outliers} of {values} values are explained by no soil of the belief; {look}"
    left = _unexplained(drive, expected, best)
    worst = max(left, key=lambda name: left[name], default="")
    if worst and left[worst] > 1.0:
        factor = drive.inflation[worst]
        return f"the best soil misses {worst} by {factor:.1f} times its errors; look at its sign and unit, or {look}"
    for name, size in wheels.items():
        typical = float(np.abs(expected[:, OBSERVED.index(LARGE[name])]).mean())
        if size > MOST_OF_A_WHEEL * SLIP_OF_1.get(name, typical):
            return f"single wheels are off in {name} by {size:.3g} throughout; are wheels exchanged?"
    return ""


def _unexplained(drive: DriveResiduals, expected: FloatArray, best: Prediction) -> dict[str, float]:
    """What the best soil leaves of each quantity whose errors were widened most, over what it may leave. [-]"""
    result = {}
    for name in (name for name, factor in drive.inflation.items() if factor > MOST_INFLATION):
        if name == POSITION:
            places = at_times(drive.record.fix_time_s, best.time_s, best.paths[..., :2], axis=-2)[0]
            off = np.hypot(*(places - drive.record.fix_m).T)
            way = np.interp(drive.record.fix_time_s, best.time_s, best.distance_m)
            result[name] = _rms(off) / max(UNEXPLAINED_OF_WAY * _rms(way), FIX_ERROR_M)
            continue
        k = OBSERVED.index(name)
        rows = drive.counted[:, k]
        values = drive.record.values[rows, k]
        result[name] = _rms(values - expected[rows, k]) / max(UNEXPLAINED * _rms(values), SLIGHT[name])
    return result


def _rms(values: FloatArray) -> float:
    """Root mean square."""
    return float(np.sqrt((values**2).mean()))


@dataclass(frozen=True, slots=True, kw_only=True)
class SlipLean:
    """Median slip of a drive as measured, and on the soils that are believed after it.

    Attributes
    ----------
    stretch : of the way that it is about, such as `2.0 to 5.1 m: `; empty for the whole drive.
    measured, simulated : medians over the measured states, the latter the middle one of drives on soils of the belief,
        as a prediction of the same plan from it has them. [-]
    spread : standard deviation of the latter over these soils. [-]
    sigma : error of the former, that of a single state, as neighbours share their errors. [-]
    """

    measured: float
    simulated: float
    spread: float
    sigma: float
    stretch: str = ""

    @classmethod
    def of(cls, record: DriveRecord, result: SoilUpdate, stretch: str = "", least: int = 1) -> "SlipLean | None":
        """Of a record with the slips that positions tell, too; None for fewer slips than `least`."""
        column, best = OBSERVED.index("slip_ratio"), result.prediction
        counted = np.isfinite(record.values[:, column])
        if counted.sum() < least or result.refused:
            return None
        soils = result.belief.draws(LEAN_SOILS)
        ruts = best.ruts if result.belief.meets_ruts is None else result.belief.draws_with_ruts(LEAN_SOILS)
        driven = predict(
            best.rover, best.terrain, best.plan, samples=soils, time_step_s=STEP_S, sample_m=SAMPLE_M, ruts=ruts
        )
        states = states_at(record, driven.time_s, driven.states[driven.finished], best.rover.wheels)
        slips = np.median(states[:, counted, column], axis=1)
        return cls(
            measured=float(np.median(record.values[counted, column])),
            simulated=float(np.median(slips)),
            spread=float(slips.std(ddof=1)) if slips.size > 1 else 0.0,
            sigma=float(np.median(record.sigmas[counted, column])),
            stretch=stretch,
        )

    @property
    def error(self) -> float:
        """Standard error of the difference. [-]"""
        return float(np.hypot(self.spread, self.sigma))

    @property
    def off(self) -> bool:
        """Whether the soil found surely makes wheels slip otherwise than they did."""
        return abs(self.simulated - self.measured) > max(LEAST_LEAN, LEAN_ERRORS * self.error)

    @property
    def doubt(self) -> str:
        """What it means, and what to do; empty where it is within its errors."""
        if not self.off:
            return ""
        more = "more" if self.simulated > self.measured else "less"
        errors = abs(self.simulated - self.measured) / self.error
        return (
            f"{self.stretch}median slip is {self.simulated:.3f} predicted by this belief, {self.measured:.3f} measured "
            f"({errors:.1f} standard errors): predictions slip {more} than the rover does; look for a wrong rover, "
            "track depth or terrain"
        )

    @property
    def text(self) -> str:
        """Both medians and the error of their difference, and why tables of predictions show more."""
        result = f"{self.measured:.3f} measured, {self.simulated:.3f} predicted from what is believed now"
        return (
            f"{self.stretch}median slip ratio: {result}; the difference has a standard error of {self.error:.3f}; "
            "`twin predict` lists the largest slip of each drive, which is more"
        )

    def to_dict(self) -> dict[str, float | bool]:
        """For a result."""
        return {
            "measured": self.measured,
            "simulated": self.simulated,
            "spread": self.spread,
            "sigma": self.sigma,
            "off": self.off,
        }
