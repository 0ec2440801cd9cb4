"""What was predicted beside what happened, and what a belief's discrepancy learns from the miss."""

import warnings
from collections.abc import Iterator
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from lunarsci.arrays import BoolArray
from lunarsci.errors import DataError, LunarSciWarning, within_file
from lunarsci.figure import file_label
from lunarsci.io.inputs import InputFile, Source, read_input
from lunarsci.memory import AsFiles
from lunarsci.options import request_of
from lunarsci.provenance import sha256
from lunarsci.regolith.belief import SoilBelief, read_belief
from lunarsci.regolith.columns import GROUND, ground_name, short_name, written_in
from lunarsci.regolith.prior import Question, asked_in
from lunarsci.regolith.states import StateTable
from lunarsci.result import Doubt, MadeFrom, Result, job
from lunarsci.rovers import DEFAULT_ROVER, read_rover, rover_names
from lunarsci.twin.assimilation.residuals import DriveRecord, pace_of, read_drive_states, read_record
from lunarsci.twin.comparison import verdict
from lunarsci.twin.comparison.forecast import (
    Forecast,
    MatchedObservations,
    match_observations,
    miss_of,
    read_forecast,
    taught,
)
from lunarsci.twin.comparison.scores import ALL, BandCheck, EndCheck, Standing
from lunarsci.twin.comparison.verdict import DriveComparison
from lunarsci.twin.ground.driven_soil import doubt_of
from lunarsci.twin.jobs.requests import CompareRequest
from lunarsci.twin.plans.plan import plan_text, read_plan
from lunarsci.twin.rover import Rover, build_rover, rover_questions
from lunarsci.twin.telemetry.checks import WheelPace

if TYPE_CHECKING:
    from matplotlib.figure import Figure


SOURCES = [
    "Hotelling (1931), Ann. Math. Stat. 2, 360, 10.1214/aoms/1177732979",
    "Besag & Clifford (1989), Biometrika 76, 633, 10.1093/biomet/76.4.633",
    "Gneiting & Raftery (2007), J. Am. Stat. Assoc. 102, 359, 10.1198/016214506000001437",
    "Sokal (1997), Monte Carlo methods in statistical mechanics, 10.1007/978-1-4899-0319-8_6",
]


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class ComparedDrive(Result):
    """A prediction beside a drive.

    Attributes
    ----------
    matched, comparison : predicted values at the times of the measured ones, and what follows from them.
    states : name of the file of states.
    rover : how to ask for the rover that was predicted.
    pace : how fast the wheels turned beside the plan; None where the states do not say.
    before, belief : before and after it learned from the miss; None where none was given.
    inputs, tables, seed : for `made_from`.
    questions : numbers that no rover or wheel has as they are written.
    """

    schema = "twin-compare/1"
    matched: MatchedObservations
    comparison: DriveComparison
    states: str
    rover: str
    pace: WheelPace | None
    before: SoilBelief | None
    belief: SoilBelief | None
    inputs: dict[str, str]
    tables: dict[str, str]
    seed: int
    questions: tuple[Question, ...] = ()

    @property
    def made_from(self) -> MadeFrom:
        options = {"rover": self.rover}
        return MadeFrom(inputs=self.inputs, tables=self.tables, sources=SOURCES, seed=self.seed, options=options)

    @property
    def doubt(self) -> Doubt:
        reasons, predicted = self.comparison.reasons, str(self.matched.forecast.soil.get("doubt") or "")
        paced, states = self.pace.doubt if self.pace else "", self.matched.record.doubt
        driven = f"another drive than the predicted one: {paced}" if paced else ""
        measured = f"doubtful states: {states}" if states else ""
        doubted = Doubt(tuple(reasons), "the prediction is not to be trusted")
        before = f"predicted from doubtful soils: {predicted}" if predicted else ""
        learned = "" if predicted else doubt_of("that learns", self.belief)
        return Doubt.of(*self.questions, doubted, driven, measured, before, learned)

    @property
    def verdict(self) -> str:
        """That of the comparison; `doubtful` where it speaks for the prediction, of a drive that is doubtful."""
        doubtful = self.questions or self.matched.record.doubt or (self.pace is not None and self.pace.off)
        return "doubtful" if doubtful and not self.comparison.reasons else self.comparison.verdict

    def to_dict(self) -> dict[str, Any]:
        forecast, comparison = self.matched.forecast, self.comparison
        whole, miss = comparison.surprise, miss_of(self.matched)
        return {
            "verdict": self.verdict,
            "reasons": list(comparison.reasons),
            "near": list(comparison.near),
            "pace": None if self.pace is None else self.pace.to_dict(),
            "notes": list(comparison.notes),
            "plan": forecast.plan.name,
            "rover": forecast.rover,
            "terrain": {"name": forecast.terrain, "synthetic": forecast.synthetic},
            "soils": forecast.soils,
            "soil": dict(forecast.soil) or {"of": "not kept"},
            "members": comparison.members,
            "finished": comparison.finished,
            "compared": list(comparison.compared),
            "not_compared": comparison.not_compared,
            "end": None if comparison.end is None else _end(comparison.end),
            "miss": None if miss is None else asdict(miss),
            "path": None if comparison.path is None else asdict(comparison.path),
            "quantities": self.rows(),
            "surprise": None
            if whole is None
            else {"pieces": whole.pieces, "quantities": list(whole.quantities)} | _standing(whole.standing),
            "change": None if comparison.change is None else asdict(comparison.change),
            "invalid_share": comparison.invalid_share,
            "discrepancy": None if self.belief is None else self.belief.discrepancy.to_dict(),
        } | asked_in(self.questions)

    def rows(self) -> list[dict[str, Any]]:
        """One a quantity, of all wheels and of each."""
        return [_band_row(check, self.comparison) for check in self.comparison.bands]

    def figures(self) -> "Iterator[Figure]":
        from lunarsci.twin.figures.comparison import comparison_figure

        title = f"{file_label(str(self.matched.forecast.origin))} beside {file_label(self.states)}"
        yield comparison_figure(self.matched, self.comparison, title, self.verdict)


@job
def compare(
    predicted: str | Path | AsFiles, states: Source, request: CompareRequest | None = None, **options: Any
) -> ComparedDrive:
    """Hold a prediction, the result of `predict` or a folder of `twin predict -o`, against measured wheel states.

    Raises DataError for files that do not fit together, and for a belief that knows the drive.

    Examples
    --------
    >>> verdict = lunarsci.compare("predicted", "states/states.csv", plan="plan.toml").to_dict()["verdict"]
    """
    asked = request_of(CompareRequest, request, options)
    forecast, inputs = read_forecast(str(predicted))
    named = short_name(forecast.rover)
    rover = asked.rover or (named if named in rover_names() else DEFAULT_ROVER)
    description = read_rover(rover)
    digest = sha256(description.text.encode())
    if digest != forecast.rover_sha256:
        raise DataError(
            f"{predicted}: predicted with the rover {forecast.rover}, of another file than "
            f"{rover}; give that file as `rover`"
        )
    if asked.plan is not None:
        inputs |= _check_plan(read_input(asked.plan), forecast)
    source, fixes = read_input(states), None if asked.positions is None else read_input(asked.positions)
    built = replace(build_rover(description), gravity_m_s2=forecast.gravity_m_s2)
    table = read_drive_states(source, built)
    driven = ground_name(written_in(source.name, table.table, GROUND))
    if driven and driven != ground_name(forecast.terrain):
        text = f"{source.name}: was made on '{driven}', and predicted on '{forecast.terrain}': is it the same drive?"
        warnings.warn(text, LunarSciWarning, stacklevel=2)
    record, independent = whole_record(table, fixes, built)
    with within_file(source.name):
        matched = match_observations(forecast, record, independent)
    inputs |= {file.name: file.sha256 for file in (source, fixes) if file}
    lesson = None if asked.belief is None else read_input(asked.belief)
    before, after = (None, None) if lesson is None else _taught(matched, lesson, source)
    inputs |= {} if lesson is None else {lesson.name: lesson.sha256}
    comparison = verdict.compare(matched, asked.seed)
    if comparison.near:
        warnings.warn(
            f"{source.name}: nothing contradicts the prediction, but it is hardly confirmed: "
            f"{'; '.join(comparison.near)}",
            LunarSciWarning,
            stacklevel=2,
        )
    return ComparedDrive(
        matched=matched,
        comparison=comparison,
        states=source.name,
        rover=rover,
        pace=pace_of(record, built, forecast.plan),
        before=before,
        belief=after,
        inputs=inputs,
        tables={f"{rover} (rover)": digest},
        seed=asked.seed,
        questions=() if asked.as_written else (*rover_questions(built), *table.questions(built.wheel)),
    )


def _check_plan(file: InputFile, forecast: Forecast) -> dict[str, str]:
    """Hash of the plan. Legs, start, speed and fixes must be as predicted; limits, sweeps and circles do not count."""
    driven, predicted = (
        plan_text(replace(one, name="", limits=(), sweep=(), exclusion_zones=(), made_for=None, accepted_risk=None))
        for one in (read_plan(file), forecast.plan)
    )
    if driven != predicted:
        raise DataError(
            f"{file.name}: not the plan that {forecast.origin} predicted; name the folder of its own prediction"
        )
    return {file.name: file.sha256}


def whole_record(states: StateTable, positions: InputFile | None, rover: Rover) -> tuple[DriveRecord, BoolArray | None]:
    """The record, and which of its values are no second reading of the positions.

    With positions the reader leaves out values that were derived from them. Here these are compared all the same, as
    the bands of slip are of interest, but are not to count twice.
    """
    whole = read_record(states, rover)
    if positions is None:
        return whole, None
    with warnings.catch_warnings():
        # What is left out or said of the states was said above.
        warnings.simplefilter("ignore", LunarSciWarning)
        once = read_record(states, rover, positions=positions)
    if once.values.shape != whole.values.shape:
        return once, None
    record = replace(once, values=whole.values, sigmas=whole.sigmas)
    return record, np.isfinite(once.values)


def _taught(matched: MatchedObservations, belief: InputFile, states: InputFile) -> tuple[SoilBelief, SoilBelief]:
    """The belief of a file before and after it learned from the miss."""
    before, forecast = read_belief(belief), matched.forecast
    if forecast.soils != "belief":
        raise DataError(f"{forecast.origin}: predicted on ranges of soils, and teaches nothing of a belief")
    if before.discrepancy.has_scored(states.sha256):
        raise DataError(
            f"{belief.name} has learned from {states.name} already; compare first, then update by the drive"
        )
    line = {"states": Path(states.name).name, "sha256": states.sha256, "plan": forecast.plan.name, "how": "comparison"}
    return before, replace(before, discrepancy=taught(matched, before.discrepancy).with_source(**line))


def _standing(standing: Standing | None) -> dict[str, Any]:
    if standing is None:
        return {"mahalanobis": None, "dimensions": None, "p": None, "ln_density": None}
    return {
        "mahalanobis": standing.distance,
        "dimensions": standing.dimensions,
        "p": standing.p,
        "ln_density": standing.ln_density,
    }


def _end(end: EndCheck) -> dict[str, Any]:
    rows = asdict(end)
    rows.pop("standing")
    return rows | _standing(end.standing)


def _band_row(check: BandCheck, comparison: DriveComparison) -> dict[str, Any]:
    """The probabilities are of all wheels together."""
    together = check.wheel == ALL
    bias = comparison.bias.quantities.get(check.quantity) if together and comparison.bias else None
    return asdict(check) | {
        "bias_p": None if bias is None else bias.p,
        "coverage_p": comparison.coverage.p.get(check.quantity) if together and comparison.coverage else None,
    }
