"""The twin beside drives that others recorded: one command scores slip, side slip and end of any number of trials."""

import warnings
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

import numpy as np

from lunarsci.errors import BatchError, DataError, Failure, LunarSciError, LunarSciWarning
from lunarsci.io.inputs import InputFile
from lunarsci.io.tables import csv_bytes
from lunarsci.options import refuse_where, request_of
from lunarsci.regolith.soil import read_soil
from lunarsci.result import Doubt, Result, job
from lunarsci.twin.assimilation.residuals import read_drive_states
from lunarsci.twin.drives.layouts import trials_in
from lunarsci.twin.drives.replay import TrialScore, TrialSoils, WheelTurns, score_trial, summary_of
from lunarsci.twin.ground.driven_soil import OF_A_BELIEF, PRIORS, GivenSoil, read_soil_samples
from lunarsci.twin.ground.terrain import Terrain
from lunarsci.twin.jobs.compare import whole_record
from lunarsci.twin.jobs.drive_inputs import soil_hashes
from lunarsci.twin.jobs.requests import StatesRequest, TrialsRequest
from lunarsci.twin.jobs.states import MeasuredStates, states
from lunarsci.twin.plans.motion import read_motion

if TYPE_CHECKING:
    import pandas as pd
    from matplotlib.figure import Figure


OF_A_PREDICTION = ("positions", "plan", "belief")
OF_TRIALS = ("terrain", "height_unit", "gravity", "interpolation", "soil", "members")
SOURCES = [
    "Hopkins et al. (2025), Rover Mobility in a Lunar Analogue Dataset, iSpaRo",
    "Lamarre et al. (2020), Int. J. Robot. Res. 39, 641, 10.1177/0278364920908922",
    "Gneiting & Raftery (2007), J. Am. Stat. Assoc. 102, 359, 10.1198/016214506000001437",
]


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class ScoredTrials(Result):
    """Trials beside their predictions.

    Attributes
    ----------
    trials : the scores, in the order in which they were found.
    soils : what they were predicted on, and its name.
    failed : trials that could not be read or scored.
    inputs, tables, seed : for `made_from`.
    """

    schema = "twin-trials/1"
    sources = SOURCES
    trials: tuple[TrialScore, ...]
    soils: tuple[str, str]
    failed: tuple[Failure, ...]
    inputs: dict[str, str]
    tables: dict[str, str]
    seed: int

    @property
    def failures(self) -> Sequence[Failure]:
        return self.failed

    @property
    def doubt(self) -> Doubt:
        doubtful = [trial.trial for trial in self.trials if trial.doubt]
        if not doubtful:
            return Doubt()
        return Doubt.of(
            f"the measured states of {len(doubtful)} of {len(self.trials)} trials are doubtful, first {doubtful[0]}"
        )

    def to_dict(self) -> dict[str, Any]:
        kind, name = self.soils
        return {
            "soil": {"of": kind, "name": name},
            "baseline": "wheels alone: the rigid motion that the wheels' turns fit best, without slip",
            "summary": summary_of(self.trials),
            "trials": self.rows(),
        }

    def rows(self) -> list[dict[str, Any]]:
        return [trial.row() for trial in self.trials]

    def figures(self) -> "Iterator[Figure]":
        from lunarsci.twin.figures.comparison import trials_figure

        what = "1 trial" if len(self.trials) == 1 else f"{len(self.trials)} trials"
        title = f"{what} beside what the twin predicts from the wheels"
        yield trials_figure(self.trials, title, synthetic=any(trial.synthetic for trial in self.trials))


@job
def compare_trials(
    trials: str | Sequence[str],
    request: TrialsRequest | None = None,
    *,
    progress: Callable[[int, int], None] | None = None,
    **options: Any,
) -> ScoredTrials:
    """Score the twin on trials: drives of public data sets, folders with many of them, or telemetry of one's own.

    Each drive is predicted from its first pose by the turns of its wheels alone, on every soil, and held against the
    slips, side slips and the end that its positions tell; beside it stands the way of the wheels without slip. A trial
    that cannot be used is told, and the others are scored. Raises BatchError where none can.

    Examples
    --------
    >>> scores = lunarsci.compare_trials("drive/telemetry.csv", rover="yutu2").to_table()
    """
    asked = request_of(TrialsRequest, request, options)
    refuse_where({
        f"`{name}` belongs to a prediction made before the drive, not to trials; leave it out":
            getattr(asked, name) is not None
        for name in OF_A_PREDICTION
    })  # fmt: skip
    given_soil = GivenSoil.read(asked.soil or PRIORS)
    soils, scores, failed = _soils(given_soil, asked), list["TrialScore"](), list[Failure]()
    (inputs, tables), names = soil_hashes(given_soil, None), list[str]()
    for one in [trials] if isinstance(trials, str) else trials:
        try:
            names += [name for name in trials_in(str(one)) if name not in names]
        except DataError as error:
            failed.append(Failure.of(str(one), error))
    for number, name in enumerate(names):
        try:
            measured = _measured(name, asked)
            scores.append(_scored(name, measured, given_soil, soils, asked.seed))
        except LunarSciError as error:
            failed.append(Failure.of(name, error))
        else:
            inputs |= measured.inputs.inputs
            tables |= measured.inputs.tables
        if progress is not None:
            progress(number + 1, len(names))
    if not scores:
        raise BatchError.of(failed or [Failure.of("trials", "there are none; name folders or files of drives")])
    return ScoredTrials(
        trials=tuple(scores),
        soils=(given_soil.origin, given_soil.name or str(given_soil.named)),
        failed=tuple(failed),
        inputs=inputs,
        tables=tables,
        seed=asked.seed,
    )


def _soils(given: GivenSoil, asked: TrialsRequest) -> TrialSoils:
    refuse_where({
        f"{given.name} as `soil` is a map of one site; give a belief, samples or a soil": given.soil_map is not None,
        f"`members` of one soil, {given.named}, are all alike; leave it out, or give soils to draw":
            given.one_soil and asked.members is not None,
    })  # fmt: skip
    if given.belief is not None:
        drawn = given.belief.draws(asked.members or OF_A_BELIEF, asked.seed)
        return TrialSoils(kind="belief", samples=drawn, discrepancy=given.belief.discrepancy)
    if given.file is not None:
        members = given.members(asked.members)
        return TrialSoils(kind="samples", samples=read_soil_samples(given.file, members, asked.seed))
    return TrialSoils(kind="one")


def _measured(name: str, asked: TrialsRequest) -> MeasuredStates:
    """Wheel states of a trial; what is found wrong stays with it, as there may be many."""
    given = {key: getattr(asked, key) for key in ("rover", "terrain", "height_unit", "gravity", "interpolation")}
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", LunarSciWarning)
        return states(name, None, StatesRequest(**given))


def _scored(name: str, measured: MeasuredStates, given: GivenSoil, soils: TrialSoils, seed: int) -> TrialScore:
    inputs, drive, tables = measured.inputs, measured.drive, measured.tables
    inputs.check.belief(given.name, given.belief)
    motion = read_motion(_file(name, tables["motion.csv"]), inputs.rover)
    begin = float(motion.time_s[0])
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", LunarSciWarning)
        states = read_drive_states(_file(name, tables["states.csv"], begin), inputs.rover)
        record, _ = whole_record(states, _file(name, tables["positions.csv"], begin), inputs.rover)
    terrain = _on_soil(inputs.terrain, given.named)
    turns = WheelTurns.of(drive.telemetry, inputs.rover, begin)
    score = score_trial(name, inputs.rover, terrain, motion, turns, record, soils, seed)
    return replace(score, doubt=str(measured.doubt), synthetic=drive.telemetry.synthetic)


def _on_soil(terrain: Terrain, named: str | None) -> Terrain:
    return terrain if named is None else replace(terrain, soil=np.array(read_soil(named).vector()).reshape(1, 1, 8))


def _file(name: str, table: "pd.DataFrame", begin_s: float = 0.0) -> InputFile:
    """A table with times from some begin on, rows before it left out, as a file."""
    later = table[table["time_s"] >= begin_s]
    return InputFile(name, csv_bytes(later.assign(time_s=later["time_s"] - begin_s)))
