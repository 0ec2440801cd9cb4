"""What the wheels carry and pull along a motion that was measured."""

from collections.abc import Callable, Collection, Iterator, Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from lunarsci.errors import RequestError
from lunarsci.io.inputs import InputFile, Source, read_input
from lunarsci.io.tables import csv_bytes
from lunarsci.options import request_of
from lunarsci.regolith.belief import SoilBelief, first_belief, read_belief
from lunarsci.regolith.prior import PARAMETERS, prior_hash
from lunarsci.result import Doubt, MadeFrom, Result, job
from lunarsci.twin.ground.driven_soil import DrivenSoil, doubt_of, soil_record
from lunarsci.twin.jobs.drive_inputs import SOURCES, DriveInputs, read_drive_inputs
from lunarsci.twin.jobs.forces import load_record
from lunarsci.twin.jobs.requests import LoadsRequest
from lunarsci.twin.judgement.tables import WheelLoads, force_table, held_table, wheel_loads
from lunarsci.twin.lanes import FINISHED
from lunarsci.twin.plans.motion import Motion, read_motion
from lunarsci.twin.plans.plan import Plan
from lunarsci.twin.simulation.prescribed_motion import (
    BALANCE_ERROR,
    DRAWS,
    FORCES,
    TOTALS,
    AlternatingEstimate,
    LoadEnsemble,
    PoseStates,
    PrescribedLoads,
    alternate,
    correlation_length,
    draw_loads,
    prescribed_loads,
    read_pose_states,
)

if TYPE_CHECKING:
    from matplotlib.figure import Figure


METHODS = ["Kalman (1960), J. Basic Eng. 82, 35, 10.1115/1.3662552", "Rahimi & Recht (2007), NIPS 20, 1177"]


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class MotionLoads(Result):
    """Forces of the wheels along a motion, on one soil.

    Attributes
    ----------
    inputs, motion : what moved where, and the motion's file.
    forces : poses, wheel states and the residual wrench.
    wheels : summary of each wheel.
    """

    schema = "twin-forces/1"
    inputs: DriveInputs
    motion: InputFile
    forces: PrescribedLoads
    wheels: Sequence[WheelLoads]

    @property
    def made_from(self) -> MadeFrom:
        inputs = self.inputs
        return MadeFrom(inputs=inputs.inputs, tables=inputs.tables, sources=SOURCES, options=inputs.options)

    @property
    def doubt(self) -> Doubt:
        return Doubt.of(*self.inputs.questions, self.forces.doubt)

    @property
    def title(self) -> str:
        """What the forces are of, for tables and pictures."""
        poses = f"{len(self.forces.motion.time_s)} poses on {self.inputs.terrain.name}"
        return f"Wheel forces along {self.motion.name}, {poses}"

    @property
    def missing(self) -> dict[str, float] | None:
        """The residual wrench over all poses; None where no pose has forces."""
        return _missing(self.forces) if self.wheels else None

    def may_have(self, key: str) -> Collection[str]:
        return self.inputs.rover.wheels if key == "wheels" else ()

    def to_dict(self) -> dict[str, Any]:
        result = {"of": "motion", "members": 1, "missing": self.missing, "soil": self.inputs.soil_record()}
        return load_record(self.inputs, self.wheels) | result

    def rows(self) -> list[dict[str, Any]]:
        """One a pose and wheel."""
        return list(held_table(self.forces).to_dict("records"))  # type: ignore[arg-type]

    def figures(self) -> "Iterator[Figure]":
        from lunarsci.twin.figures.wheel_states import force_figure

        result, title = self.forces, self.title.replace(name := self.motion.name, Path(name).name)
        drawn = (self.inputs.rover.wheels, (result.motion.time_s, "time [s]"), result.states, title, result.residual_n)
        yield force_figure(*drawn, synthetic=self.inputs.terrain.synthetic)


def _missing(result: PrescribedLoads) -> dict[str, float]:
    finite = result.outcome == FINISHED
    ahead, left = result.residual_n[finite].mean(axis=0)
    return {
        "rms_share_of_weight": result.residual_share,
        "mean_ahead_n": float(ahead),
        "mean_left_n": float(left),
        "rms_moment_nm": float(np.sqrt((result.residual_nm[finite] ** 2).mean())),
    }


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class UncertainLoads(Result):
    """Forces of the wheels along an uncertain motion, on soils that are drawn.

    Attributes
    ----------
    inputs, given : what moved where; the files of motion, states and belief by name of the option.
    states : measured states that get the forces, None where none are given.
    forces, turned : forces of all wheels before and after the balance; forces and soil in turn, None where not asked.
    draws, correlation_m, basis, balance_error, seed : what was drawn; what the correlation length rests on.
    doubt_of_belief : why that is doubtful; empty where it is not.
    """

    schema = "twin-forces/1"
    inputs: DriveInputs
    given: dict[str, InputFile]
    states: PoseStates | None
    forces: LoadEnsemble
    turned: AlternatingEstimate | None
    draws: int
    correlation_m: float
    basis: str
    balance_error: float
    seed: int
    doubt_of_belief: str = ""

    @property
    def made_from(self) -> MadeFrom:
        inputs = self.inputs
        tables = inputs.tables | ({} if "belief" in self.given else prior_hash())
        sources = [*SOURCES, *METHODS]
        return MadeFrom(inputs=inputs.inputs, tables=tables, sources=sources, seed=self.seed, options=inputs.options)

    @property
    def doubt(self) -> Doubt:
        of_forces = self.forces.doubt or (self.forces.doubt_of_soils if self.turned is None else self.turned.doubt)
        return Doubt.of(*self.inputs.questions, of_forces, self.doubt_of_belief)

    @property
    def title(self) -> str:
        """What the forces are of, for tables and pictures."""
        poses = f"{int(self.forces.with_forces.sum())} of {len(self.forces.with_forces)} poses"
        return f"Wheel forces along {self.given['motion'].name}, {poses}, on {self.inputs.terrain.name}"

    @property
    def belief(self) -> SoilBelief | None:
        """The soil after the last round, with the drive in its history; None without rounds."""
        if self.turned is None:
            return None
        belief, states = self.turned.posterior.belief, self.given["states"]
        entry = {
            "states": Path(states.name).name,
            "sha256": states.sha256,
            "of": "forces and soil in turn",
            "rounds": len(self.turned.rounds),
            "verdict": self.turned.verdict,
            "doubt": self.turned.doubt,
        }
        return replace(belief, history=(*belief.history, entry))

    def may_have(self, key: str) -> Collection[str]:
        return self.inputs.rover.wheels if key == "wheels" else ()

    def to_dict(self) -> dict[str, Any]:
        inputs, result, belief = self.inputs, self.forces, self.given.get("belief")
        driven = DrivenSoil("priors", "priors") if belief is None else DrivenSoil(belief.name, "belief")
        uncertain = result.held.motion.sigmas is not None
        return inputs.about() | {
            "of": "uncertain motion",
            "weight_n": inputs.rover.mass_kg * inputs.rover.gravity_m_s2,
            "draws": self.draws,
            "poses": {"known": int(result.with_forces.sum()), "all": len(result.with_forces)},
            "motion_errors": {"correlation_m": self.correlation_m, "basis": self.basis} if uncertain else None,
            "balance_error": self.balance_error,
            "wheels": _wheels(result),
            "shares": _shares(result) if result.with_forces.any() else None,
            "totals": _totals(result) if result.with_forces.any() else None,
            "iteration": None if self.turned is None else _iteration(self.turned),
            "soil": soil_record(driven, inputs.terrain, PARAMETERS),
        }

    def rows(self) -> list[dict[str, Any]]:
        """One a measured state, or a pose and wheel."""
        return list(force_table(self.forces, self.states).to_dict("records"))  # type: ignore[arg-type]

    def files(self) -> dict[str, Callable[[], bytes]]:
        """`forces.csv`, an input of `identify`: name to what makes the content."""
        return {"forces.csv": lambda: csv_bytes(force_table(self.forces, self.states))}

    def figures(self) -> "Iterator[Figure]":
        from lunarsci.twin.figures.wheel_states import force_band_figure

        title = self.title.replace(motion := self.given["motion"].name, Path(motion).name)
        yield force_band_figure(self.forces, title, synthetic=self.inputs.terrain.synthetic)


@job
def loads(
    motion: Source,
    plan: "Source | Plan | None" = None,
    request: LoadsRequest | None = None,
    *,
    progress: Callable[[int, int], None] | None = None,
    **options: Any,
) -> MotionLoads | UncertainLoads:
    """Forces of every wheel along a measured motion; a `plan` has the wheels' commands where the motion has none.

    Raises DataError for what cannot be read, RequestError for options that are impossible.

    Examples
    --------
    >>> forces = lunarsci.loads("states/motion.csv", states="states/states.csv").to_table()
    """
    asked = request_of(LoadsRequest, request, options)
    inputs = read_drive_inputs(plan, *asked.ground, soil=asked.soil, soil_counts=not asked.uncertain)
    if not inputs.given.one_soil:
        raise RequestError("a motion is held on one soil; give the belief as `belief`")
    given = {"motion": motion, "states": asked.states, "belief": asked.belief}
    files = {name: read_input(source) for name, source in given.items() if source is not None}
    inputs.inputs.update({file.name: file.sha256 for file in files.values()})
    inputs.check.tables(file for name, file in files.items() if name != "belief")
    poses = read_motion(files["motion"], inputs.rover, inputs.plan if plan is not None else None, asked.member)
    inputs = inputs.asked(heights=asked.heights_without_unit, as_written=asked.as_written)
    if asked.uncertain:
        return _uncertain(inputs, files, poses, asked, progress)
    result = prescribed_loads(inputs.rover, inputs.terrain, poses)
    loads, moved = wheel_loads(inputs.rover.wheels, result.states), files["motion"]
    return MotionLoads(inputs=inputs, motion=moved, forces=result, wheels=loads)


def _uncertain(
    inputs: DriveInputs,
    files: dict[str, InputFile],
    motion: Motion,
    asked: LoadsRequest,
    progress: Callable[[int, int], None] | None,
) -> UncertainLoads:
    if asked.correlation is not None and motion.sigmas is None:
        raise RequestError("`correlation` is of the motion's errors, and it has none; add x_m_sigma and others")
    states = read_pose_states(files["states"], inputs.rover) if "states" in files else None
    belief = read_belief(files["belief"]).soil if "belief" in files else first_belief()
    length, basis = correlation_length(motion, states) if asked.correlation is None else (asked.correlation, "given")
    draws, seed = asked.draws or DRAWS, asked.seed or 0
    error = BALANCE_ERROR if asked.balance_error is None else asked.balance_error
    drawn: dict[str, Any] = {"correlation_m": length, "balance_error": error, "seed": seed, "progress": progress}
    drive, turned = (inputs.rover, inputs.terrain, motion), None
    if asked.iterate is not None and states is not None:
        turned = alternate(*drive, states, belief, rounds=asked.iterate, draws=draws, **drawn)
        result = turned.forces
    else:
        middle = {name: value for name, (value, _, _) in belief.intervals().items()}
        result = draw_loads(*drive, belief.draws(draws, seed), middle, **drawn)
    return UncertainLoads(
        inputs=inputs,
        given=files,
        states=states,
        forces=result,
        turned=turned,
        draws=draws,
        correlation_m=length,
        basis=basis,
        balance_error=error,
        seed=seed,
        doubt_of_belief=doubt_of(files["belief"].name if "belief" in files else "", belief),
    )


def _shares(result: LoadEnsemble) -> dict[str, Any]:
    """Where the variance of each force comes from, before and after the balance."""
    both = {"before": False, "after": True}
    return {
        name: {when: asdict(result.shares(k, balanced=balanced)) for when, balanced in both.items()}
        for k, name in enumerate(FORCES)
    }


def _wheels(result: LoadEnsemble) -> list[dict[str, Any]]:
    finite = result.with_forces
    if not finite.any():
        return []
    return [
        {"wheel": wheel}
        | {
            name: {
                "mean": float(result.after[finite, w, k].mean()),
                "sigma": _rms(result.after_sigma[finite, w, k]),
                "mean_before": float(result.before[finite, w, k].mean()),
                "sigma_before": _rms(result.before_sigma[finite, w, k]),
            }
            for k, name in enumerate(FORCES)
        }
        for w, wheel in enumerate(result.held.rover.wheels)
    ]


def _totals(result: LoadEnsemble) -> dict[str, dict[str, float]]:
    finite = result.with_forces
    return {
        name: {
            "missing_before": _rms(result.residual_before[finite, k]),
            "missing_after": _rms(result.residual_after[finite, k]),
            "sigma_before": _rms(result.total_before[finite, k]),
            "sigma_after": _rms(result.total_after[finite, k]),
        }
        for k, name in enumerate(TOTALS)
    }


def _iteration(turned: AlternatingEstimate) -> dict[str, Any]:
    belief = turned.posterior.belief
    left = belief.sd_ratio
    return {
        "verdict": turned.verdict,
        "converged": turned.converged,
        "rounds": [
            {
                "soil_moved_sd": each.soil,
                "forces_moved_share": each.forces,
                "reduced_chi_square_sinkages": each.reduced_sinkages,
                "reduced_chi_square_totals": each.reduced_totals,
            }
            for each in turned.rounds
        ],
        "parameters": {
            name: {"median": median, "low": low, "high": high, "left_of_prior": left[name]}
            for name, (median, low, high) in belief.intervals().items()
        },
    }


def _rms(values: Any) -> float:
    return float((values**2).mean() ** 0.5)
