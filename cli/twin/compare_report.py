"""From a kept prediction and a measured drive to a `Report`."""

import dataclasses
import warnings
from collections.abc import Callable
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from lunarsci.errors import DataError, LunarSciWarning, ParameterError
from lunarsci.inputs import InputFile, read_input
from lunarsci.provenance import sha256
from lunarsci.regolith.belief import SoilBelief, read_belief
from lunarsci.rovers.description import read_rover
from lunarsci.twin.assimilation.drive_record import DriveRecord, read_record
from lunarsci.twin.comparison.checks import ALL, BandCheck, EndCheck, PathCheck
from lunarsci.twin.comparison.forecast import Forecast, read_forecast
from lunarsci.twin.comparison.matched import MatchedObservations, Miss, match_observations, miss_of, taught
from lunarsci.twin.comparison.scores import Standing
from lunarsci.twin.comparison.verdict import DriveComparison, compare
from lunarsci.twin.plans.plan import read_plan
from lunarsci.twin.plans.plan_files import plan_text
from lunarsci.twin.rover import Rover, build_rover

from ..shared.report import Report
from ..shared.table import TextTable
from .discrepancy import discrepancy_table

__all__ = ["Lesson", "Met", "compare_report", "learn", "read_meeting"]

SOURCES = [
    "Hotelling (1931), Ann. Math. Stat. 2, 360, 10.1214/aoms/1177732979",
    "Besag & Clifford (1989), Biometrika 76, 633, 10.1093/biomet/76.4.633",
    "Gneiting & Raftery (2007), J. Am. Stat. Assoc. 102, 359, 10.1198/016214506000001437",
    "Sokal (1997), Monte Carlo methods in statistical mechanics, 10.1007/978-1-4899-0319-8_6",
]
UNITS = {
    "sinkage_m": ("mm", 1e3),
    "slip_ratio": ("-", 1.0),
    "side_slip_deg": ("deg", 1.0),
    "normal_force_n": ("N", 1.0),
    "drawbar_pull_n": ("N", 1.0),
    "lateral_force_n": ("N", 1.0),
}


@dataclass(frozen=True, slots=True)
class Met:
    """A prediction and a drive, and the files they come from."""

    matched: MatchedObservations
    inputs: dict[str, str]
    tables: dict[str, str]
    states: str


def read_meeting(predicted: Path, states: str, positions: str | None, plan: str | None, rover: str) -> Met:
    """Read them. Raises DataError, also for a plan or rover that is not the predicted one."""
    forecast, inputs = read_forecast(predicted)
    description = read_rover(rover)
    digest = sha256(description.text.encode())
    if digest != forecast.rover_sha256:
        raise DataError(
            f"{predicted}: predicted for {forecast.rover} as another file than {rover} has it; give --rover as then"
        )
    if plan is not None:
        _check_plan(plan, forecast)
        inputs[plan] = read_input(plan).sha256
    files = {path: read_input(path) for path in (states, positions) if path is not None}
    record, independent = _record(files[states], files[positions] if positions else None, build_rover(description))
    try:
        matched = match_observations(forecast, record, independent)
    except ParameterError as error:
        raise DataError(f"{states}: {error}") from error
    inputs.update({path: file.sha256 for path, file in files.items()})
    return Met(matched, inputs, {f"{rover} (rover)": digest}, states)


def _check_plan(plan: str, forecast: Forecast) -> None:
    """Legs, start, speed and fixes must be those that were predicted; limits, sweeps and circles do not count."""
    driven, predicted = (
        plan_text(dataclasses.replace(one, name="", limits=(), sweep=(), keep_out=(), made_for=None))
        for one in (read_plan(plan), forecast.plan)
    )
    if driven != predicted:
        raise DataError(f"{plan}: not the plan that {forecast.origin} predicted; name the folder of its own prediction")


def _record(
    states: InputFile, positions: InputFile | None, rover: Rover
) -> tuple[DriveRecord, npt.NDArray[np.bool_] | None]:
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
    record = dataclasses.replace(once, values=whole.values, sigmas=whole.sigmas)
    return record, np.isfinite(once.values)


@dataclass(frozen=True, slots=True, eq=False)
class Lesson:
    """A belief before and after a comparison, and the file that takes the latter."""

    before: SoilBelief
    after: SoilBelief
    save: Path

    @property
    def extras(self) -> dict[Path, Callable[[], bytes]]:
        """The file that was asked for."""
        return {self.save: lambda: self.after.to_json().encode()}


def learn(met: Met, belief: str, save: Path) -> Lesson:
    """Teach the belief of a file. Raises DataError for one that knows the drive, and predictions of no belief."""
    source = read_input(belief)
    before, digest = read_belief(source), met.inputs[met.states]
    if met.matched.forecast.soils != "belief":
        raise DataError(f"{met.matched.forecast.origin}: predicted on ranges of soils, and teaches nothing of a belief")
    if before.discrepancy.has_scored(digest):
        raise DataError(f"{belief} has learned from {met.states} already; compare first, then update by the drive")
    met.inputs[belief] = source.sha256
    law = taught(met.matched, before.discrepancy).with_score(
        states=Path(met.states).name, sha256=digest, plan=met.matched.forecast.plan.name, how="comparison"
    )
    return Lesson(before, replace(before, discrepancy=law), save)


def compare_report(met: Met, seed: int, lesson: Lesson | None = None) -> Report:
    """The report of `twin compare`; `lesson` is what it taught a belief."""
    matched, found = met.matched, compare(met.matched, seed)
    taught = [] if lesson is None else [discrepancy_table(lesson.after.discrepancy, lesson.before.discrepancy)]
    origin = matched.forecast.origin

    def figures() -> Any:
        from lunarsci.twin.figures.comparison import comparison_figure

        return [comparison_figure(matched, found, f"{origin} beside {met.states}")]

    return Report(
        schema="twin-compare/1",
        result=_result(matched, found)
        | {"discrepancy": None if lesson is None else lesson.after.discrepancy.to_dict()},
        tables=[*_tables(matched, found, met.states), *taught],
        rows=[_band_row(check, found) for check in found.bands],
        figures=figures,
        inputs=met.inputs,
        data_tables=met.tables,
        sources=SOURCES,
        seed=seed,
        extras={} if lesson is None else lesson.extras,
        untrusted=f"the prediction is not to be trusted: {'; '.join(found.reasons)}" if found.reasons else "",
    )


def _result(matched: MatchedObservations, found: DriveComparison) -> dict[str, Any]:
    forecast, whole = matched.forecast, found.surprise
    return {
        "verdict": found.verdict,
        "reasons": list(found.reasons),
        "notes": list(found.notes),
        "plan": forecast.plan.name,
        "rover": forecast.rover,
        "terrain": {"name": forecast.terrain, "synthetic": forecast.synthetic},
        "soils": forecast.soils,
        "soil": dict(forecast.soil) or {"of": "not kept"},
        "members": found.members,
        "finished": found.finished,
        "compared": list(found.compared),
        "not_compared": found.not_compared,
        "end": None if found.end is None else _end(found.end),
        "miss": None if (miss := miss_of(matched)) is None else asdict(miss),
        "path": None if found.path is None else asdict(found.path),
        "quantities": [_band_row(check, found) for check in found.bands],
        "surprise": None
        if whole is None
        else {"pieces": whole.pieces, "quantities": list(whole.quantities)} | _standing(whole.standing),
        "change": None if found.change is None else asdict(found.change),
        "invalid_share": found.invalid_share,
    }


def _standing(found: Standing | None) -> dict[str, Any]:
    if found is None:
        return {"mahalanobis": None, "dimensions": None, "p": None, "ln_density": None}
    return {
        "mahalanobis": found.distance,
        "dimensions": found.dimensions,
        "p": found.p,
        "ln_density": found.ln_density,
    }


def _end(end: EndCheck) -> dict[str, Any]:
    rows = asdict(end)
    rows.pop("standing")
    return rows | _standing(end.standing)


def _band_row(check: BandCheck, found: DriveComparison) -> dict[str, Any]:
    """The probabilities are of all wheels together."""
    together = check.wheel == ALL
    bias = found.bias.quantities.get(check.quantity) if together and found.bias else None
    return asdict(check) | {
        "bias_p": None if bias is None else bias.p,
        "coverage_p": found.coverage.p.get(check.quantity) if together and found.coverage else None,
    }


def _tables(matched: MatchedObservations, found: DriveComparison, states: str) -> list[TextTable]:
    forecast = matched.forecast
    drives = (
        f"{found.finished} of {found.members} drives" if found.finished < found.members else f"{found.members} drives"
    )
    title = f"{found.verdict.upper()}: {forecast.plan.name}, {drives} of {forecast.origin}, beside {states}"
    notes = [f"because {reason}" for reason in found.reasons]
    head = TextTable(
        ["place", "what", "value"],
        [*_end_rows(found.end), *miss_rows(miss_of(matched)), *_path_rows(found.path)],
        title=title,
        notes=notes,
    )
    tables = [head if head.rows else TextTable([], [], title=title, notes=notes)]
    if found.bands:
        tables.append(_band_table(found))
    left_out = [f"not compared: {name} ({why})" for name, why in found.not_compared.items()]
    return [*tables, TextTable([], [], title="What this rests on", notes=[*_whole(found), *found.notes, *left_out])]


def _end_rows(end: EndCheck | None) -> list[list[str]]:
    if end is None:
        return []
    place = "end" if end.at_end else f"at {end.time_s:.0f} s"
    rows = [
        [place, "from the middle of the predicted", f"{end.error_m:.3f} m"],
        [place, "from the planned", f"{end.planned_error_m:.3f} m"],
        [place, "energy score", f"{end.energy_score_m:.3f} m"],
    ]
    if end.standing is not None:
        rows.append([place, "Mahalanobis distance", f"{end.standing.distance:.2f} sd"])
        rows.append([place, "probability of such by chance", f"{end.standing.p:.2g}"])
        held = [f"{share} %" for share, yes in end.regions.items() if yes]
        rows.append([place, "smallest region that holds it", held[0] if held else "none up to 99 %"])
    return rows


def _path_rows(path: PathCheck | None) -> list[list[str]]:
    if path is None:
        return []
    rows = [
        ["path", f"rms error at {len(path.fixes)} positions", f"{path.rms_m:.3f} m"],
        ["path", f"largest, at {path.worst.time_s:.0f} s, {path.worst.distance_m:.2f} m", f"{path.max_m:.3f} m"],
    ]
    if path.inside_90 is not None:
        rows.append(["path", "positions in their 90 % regions", f"{100 * path.inside_90:.0f} %"])
    return rows


def _band_table(found: DriveComparison) -> TextTable:
    headers = [
        "quantity",
        "wheel",
        "n",
        "worth",
        "bias",
        "bias [sd]",
        "rms",
        "rms [sd]",
        "in 90 % bands",
        "CRPS",
        "unit",
    ]
    rows = []
    for check in found.bands:
        unit, factor = UNITS[check.quantity]
        rows.append(
            [
                check.quantity,
                check.wheel,
                str(check.n),
                f"{check.effective:.1f}",
                f"{factor * check.bias:+.3g}",
                _or_dash(check.bias_standard, "+.2f"),
                f"{factor * check.rms:.3g}",
                _or_dash(check.rms_standard, ".2f"),
                "-" if check.coverage_90 is None else f"{100 * check.coverage_90:.0f} %",
                f"{factor * check.crps:.2g}",
                unit,
            ]
        )
    note = (
        "bias: measured less predicted; worth: independent values, as neighbours are alike; bands hold measured errors"
    )
    return TextTable(headers, rows, title="Wheel states beside their predicted bands", notes=[note])


def _or_dash(value: float | None, form: str) -> str:
    return "-" if value is None else format(value, form)


def _whole(found: DriveComparison) -> list[str]:
    """The surprise of the whole drive and what was looked for along it."""
    lines = []
    if (whole := found.surprise) is not None:
        pieces = "1 piece" if whole.pieces == 1 else f"{whole.pieces} pieces"
        own = whole.standing
        lines.append(
            f"surprise of the whole: {own.distance:.1f} sd in {own.dimensions} dimensions ({pieces} of the drive, "
            f"{', '.join(whole.quantities)}), probability by chance {own.p:.2g}, ln density {own.ln_density:.1f}"
        )
    if (change := found.change) is not None:
        lines.append(f"largest change of the ground: about {change.distance_m:.1f} m on, by chance {change.p:.2g}")
    return lines


def miss_rows(miss: Miss | None) -> list[list[str]]:
    """The last position beside the middle of the soils, for people."""
    if miss is None:
        return []
    return [
        ["miss", "along, across (left)", f"{miss.along_m:+.3f} m, {miss.across_m:+.3f} m"],
        [
            "miss",
            "as shares of the way",
            f"{100 * miss.along_share:+.2f} %, {100 * miss.across_share:+.2f} % of {miss.way_m:.1f} m",
        ],
        [
            "miss",
            "1 sd of soils, place, physics",
            f"{miss.soil_m:.3f} m, {miss.position_m:.3f} m, {miss.physics_m:.3f} m",
        ],
    ]
