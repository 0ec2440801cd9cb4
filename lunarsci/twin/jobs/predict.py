"""Whether the next drive is safe: a plan driven on many soils, and held against its limits."""

from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from functools import cache
from pathlib import Path
from typing import TYPE_CHECKING, Any, ClassVar

from lunarsci.errors import within_option
from lunarsci.io.inputs import Source, read_input
from lunarsci.io.tables import TABLE_FORMS
from lunarsci.options import refuse_where, request_of
from lunarsci.provenance import sha256, to_json
from lunarsci.regolith.prior import Question
from lunarsci.result import Doubt, MadeFrom, Progress, Result, job
from lunarsci.twin.assimilation.segments import planned_places
from lunarsci.twin.comparison.forecast import FILE, forecast_document, forecast_of
from lunarsci.twin.ground.finer_ground import Unresolved, with_unresolved
from lunarsci.twin.ground.hazards import read_mobility, rover_footprint
from lunarsci.twin.ground.illumination import parse_sun
from lunarsci.twin.ground.missed_rocks import missed_rocks
from lunarsci.twin.jobs.drive_inputs import SOURCES, DriveInputs, Soils, read_drive_inputs
from lunarsci.twin.jobs.requests import PoweredRequest, PredictRequest
from lunarsci.twin.judgement import tables as judged
from lunarsci.twin.judgement.endpoint import (
    EndpointSensitivity,
    TerrainShares,
    endpoint_sensitivity,
    likely_drives,
    step_error_m,
    terrain_shares,
)
from lunarsci.twin.judgement.energy import PowerUse, energy_record, power_record, power_use
from lunarsci.twin.judgement.keeping import limits_judged
from lunarsci.twin.judgement.safety import Verdict, judge, undecided
from lunarsci.twin.judgement.tables import check_loads
from lunarsci.twin.lanes import OUTCOMES
from lunarsci.twin.plans.plan import Plan
from lunarsci.twin.plans.risk import AcceptedRisk
from lunarsci.twin.simulation.discrepancy import with_discrepancy
from lunarsci.twin.simulation.ensemble import PowerState, Prediction

if TYPE_CHECKING:
    from matplotlib.figure import Figure


CORRELATED = ("belief", "samples")
"""Kinds of soils whose parameters go together, so that none of them moves the end by itself."""


def power_of(request: PoweredRequest) -> PowerState | None:
    """Battery and light; None where neither is given. Raises RequestError."""
    if request.sun is None and request.charge is None:
        return None
    with within_option("sun"):
        sun = None if request.sun is None else parse_sun(request.sun)
    return PowerState(charge=1.0 if request.charge is None else request.charge, sun=sun)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class PredictedDrives(Result):
    """Predicted drives, and what they mean.

    Attributes
    ----------
    soils : what drove where, on which soils.
    prediction : paths, wheel states and forces of all drives.
    verdict : go, no-go or not determined, and why.
    sensitivity : what the end owes to each uncertain parameter; None where parameters go together.
    step_error_m : how far the time step puts ends off; None where that is not known. [m]
    terrain_shares : part of the variance of ends, slip, tilt and sinkage that errors of the terrain make, by quantity;
        None where its heights are exact. [-]
    power : electrical power and battery; None where neither Sun nor charge was given.
    questions : numbers that no Moon, soil or rover has as they are written; while any is open the verdict is.
    unresolved : what the terrain's nodes are too far apart to show, of which every drive has a draw; None for nothing.
    """

    schema: ClassVar[str] = "twin-predict/1"
    soils: Soils
    prediction: Prediction
    verdict: Verdict
    sensitivity: list[EndpointSensitivity] | None = None
    step_error_m: float | None = None
    terrain_shares: TerrainShares | None = None
    power: PowerUse | None = None
    unresolved: Unresolved | None = None
    questions: tuple[Question, ...] = ()

    @property
    def inputs(self) -> DriveInputs:
        """What drove where."""
        return self.soils.inputs

    @property
    def made_from(self) -> MadeFrom:
        inputs = self.inputs
        options = inputs.options | {"seed": self.prediction.seed}
        seed = self.soils.drawn_by
        return MadeFrom(inputs=inputs.inputs, tables=inputs.tables, sources=SOURCES, seed=seed, options=options)

    @property
    def doubt(self) -> Doubt:
        return Doubt.of(self.verdict.doubt, self.soils.doubt)

    def to_dict(self) -> dict[str, Any]:
        prediction, fitted, before = self.prediction, self.soils.verdict, self.inputs.before
        swept = prediction.parameters.items()
        return {
            **asdict(self.verdict),
            "doubt": str(self.soils.doubt) or None,
            "chance": self.verdict.chance.to_dict(),
            **self.inputs.about(),
            "members": prediction.members,
            "path_length_m": prediction.plan.length_m,
            "time_step_s": prediction.time_step_s,
            "finer_members": prediction.finer_members,
            "ruts": bool(prediction.ruts.any()),
            "ruts_share": float(prediction.ruts.mean()),
            "before": None if before is None else before.name,
            "plan": prediction.plan.name,
            "loads": asdict(check_loads(prediction)),
            "energy": energy_record(prediction),
            "power": None if self.power is None else power_record(prediction, self.power),
            "physics": self._physics(),
            "questions": [asdict(asked) for asked in self.questions],
            "unresolved": None if self.unresolved is None else asdict(self.unresolved),
            "terrain_errors": None if self.terrain_shares is None else asdict(self.terrain_shares),
            "sweep": {name: {"low": values.min(), "high": values.max()} for name, values in swept},
            "soil": self.soils.record(),
            "sensitivity": None if self.sensitivity is None else [asdict(share) for share in self.sensitivity],
            "step_error_m": self.step_error_m,
            **({} if fitted is None else {"soil_verdict": fitted.to_dict()}),
        }

    def _physics(self) -> dict[str, Any] | None:
        """What the twin is off by beside its soils, and its part of the variance of the ends; None where not asked."""
        if self.prediction.discrepancy is None:
            return None
        law = self.prediction.discrepancy.law
        share = None if self.verdict.endpoint is None else self.verdict.endpoint.physics_share
        return {"discrepancy": law.to_dict(), "learned_from": len(law.scored), "share_of_end_variance": share}

    def may_have(self, key: str) -> Collection[str]:
        limits = [limit.quantity for limit in limits_judged(self.prediction)] if key == "limits" else []
        return OUTCOMES if key == "outcomes" else limits

    def rows(self) -> Sequence[Mapping[str, Any]]:
        return [asdict(limit) for limit in self.verdict.limits]

    def layers(self) -> dict[str, Any]:
        return judged.drive_layers(self.prediction)

    def figures(self) -> "Iterator[Figure]":
        from lunarsci.twin.figures.prediction import box_pages, path_fan, profile_page

        yield path_fan(self.prediction, self.verdict)
        yield profile_page(self.prediction, self.verdict)
        yield from box_pages(self.prediction)

    def as_input(self, role: str) -> dict[str, Callable[[], bytes]]:
        whole = role in ("predicted", "start", "results")
        return {**self.files(), "result.json": lambda: self.to_json().encode()} if whole else {}

    def film(self, target: Path, progress: Progress | None = None) -> bytes:
        """The drive as a film, in the format of the target's suffix: .gif, or .mp4 where ffmpeg is installed."""
        from lunarsci.twin.figures.animation import animate

        return animate(self.prediction, self.verdict, target, progress=progress)

    def files(self, *, tables: str = "csv") -> dict[str, Callable[[], bytes]]:
        """The tables of all drives, and what `compare` reads after the drive: name to what makes the content.

        `tables` is their form, of `TABLE_FORMS`. Raises RequestError for another.
        """
        prediction, rover = self.prediction, sha256(self.inputs.description.text.encode())
        refuse_where({f"`tables` is {tables!r}; give {' or '.join(TABLE_FORMS)}": tables not in TABLE_FORMS})
        write = TABLE_FORMS[tables]
        hashed = {
            f"states.{tables}": cache(lambda: write(judged.state_tables(prediction))),
            f"paths.{tables}": cache(lambda: write(judged.path_table(prediction))),
        }
        forecast = forecast_of(prediction, soils=self.soils.kind, rover_sha256=rover, soil=self.soils.record())
        return {
            **hashed,
            FILE: lambda: to_json(forecast_document(forecast, hashed)).encode(),
            f"endpoints.{tables}": lambda: write(judged.endpoint_table(prediction)),
            f"profiles.{tables}": lambda: write(judged.profile_table(prediction)),
        }


@job
def predict(
    plan: "Source | Plan | None" = None,
    request: PredictRequest | None = None,
    *,
    progress: Progress | None = None,
    **options: Any,
) -> PredictedDrives:
    """Drive a plan over many soils, and say whether it stays within its limits.

    `plan` is a TOML file or a plan, the embedded one of Yutu-2 if None; options are those of the request.

    Raises DataError for what cannot be read, RequestError for options that are impossible.

    Examples
    --------
    >>> drives = lunarsci.predict("plan.toml", soil="priors", members=8)
    >>> answer = drives.untrusted or "go"
    """
    asked = request_of(PredictRequest, request, options)
    inputs = read_drive_inputs(
        plan,
        *asked.ground,
        soil=asked.soil,
        fixes=asked.fixes,
        judged=True,
        ruts=asked.ruts,
        before=asked.before,
        terrain_errors=not asked.exact_terrain,
        keep_out=asked.keep_out,
        priors=not asked.sweep,
    )
    questions = inputs.asked(heights=asked.heights_without_unit, as_written=asked.as_written).questions
    inputs, unresolved = (inputs, None) if asked.exact_terrain else _rough(inputs, asked.seed or 0)
    if asked.risk is not None:
        inputs = replace(inputs, plan=replace(inputs.plan, accepted_risk=AcceptedRisk(asked.risk)))
    soils = Soils.of(inputs, asked.sweep or None, inputs.given.members(asked.members), asked.seed or 0)
    soils.warn_of_seed(asked.seed)
    prediction = predict_drives(soils, asked.time_step, asked.sample, progress)
    result = _judged(soils, prediction, asked, unresolved)
    notes = (*result.verdict.notes, *_unseen(inputs), *_missed(inputs, asked.keep_out))
    return _asked_about(replace(result, verdict=replace(result.verdict, notes=notes)), questions)


def _unseen(inputs: DriveInputs) -> Iterator[str]:
    """How much of the ground below the planned way no picture shows."""
    share = inputs.terrain.filled_share(
        planned_places(inputs.plan, inputs.rover), rover_footprint(inputs.rover).half_width_m
    )
    if share > 0:
        yield (
            f"{100 * share:.2g} % of the ground along the way was not seen: there the heights are those about the gap, "
            "and their error is the spread of these"
        )


def _missed(inputs: DriveInputs, files: Sequence[str]) -> Iterator[str]:
    """What searches for rocks behind keep-out files may have missed along the planned way."""
    rover, outline = inputs.rover, rover_footprint(inputs.rover)
    step = read_mobility(inputs.description, rover).max_step_m
    for name in files:
        text = missed_rocks(read_input(name), planned_places(inputs.plan, rover), 2 * outline.half_width_m, step)
        if text is not None:
            yield text


def _asked_about(result: PredictedDrives, questions: tuple[Question, ...]) -> PredictedDrives:
    """A verdict is not determined while questions are open."""
    if not questions:
        return result
    reasons = (*map(str, questions), *result.verdict.reasons)
    verdict = replace(result.verdict, verdict="not-determined", reasons=reasons)
    return replace(result, questions=questions, verdict=verdict)


def _rough(inputs: DriveInputs, seed: int) -> tuple[DriveInputs, Unresolved | None]:
    """With ground drawn between the nodes of a terrain that is too coarse for the rover's wheels."""
    if inputs.terrain.errors is not None:
        return inputs, None
    places = planned_places(inputs.plan, inputs.rover)
    terrain, unresolved = with_unresolved(inputs.terrain, places, inputs.rover.wheel, seed)
    return replace(inputs, terrain=terrain, rough=unresolved is not None), unresolved


def predict_drives(soils: Soils, time_step_s: float, sample_m: float, progress: Progress | None) -> Prediction:
    """All drives on these soils, without what the twin's physics is off by."""
    from lunarsci.twin.simulation.ensemble import predict

    return predict(**soils.of_members(), time_step_s=time_step_s, sample_m=sample_m, progress=progress)


def _judged(
    soils: Soils, prediction: Prediction, asked: PredictRequest, unresolved: Unresolved | None
) -> PredictedDrives:
    """With what the twin's physics is off by, where the soils are of a belief or a map of beliefs."""

    def whole(drives: Prediction) -> Prediction:
        law = soils.discrepancy
        drives = drives if law is None else with_discrepancy(drives, law, soils.seed)
        return replace(drives, power=power_of(asked))

    plain = likely_drives(prediction)
    shares = terrain_shares(prediction, plain)
    prediction = whole(prediction)
    soils.warn_of_fit()
    verdict = judge(prediction, soils.inputs.plan)
    if unresolved is not None and plain is not None and verdict.verdict == "no-go":
        verdict = undecided(verdict, judge(whole(plain), soils.inputs.plan), unresolved)
    return PredictedDrives(
        soils=soils,
        prediction=prediction,
        verdict=verdict,
        sensitivity=None if soils.kind in CORRELATED else endpoint_sensitivity(prediction),
        step_error_m=step_error_m(prediction),
        terrain_shares=shares,
        power=None if prediction.power is None else power_use(prediction),
        unresolved=unresolved,
    )
