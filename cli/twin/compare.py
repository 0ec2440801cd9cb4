"""`lunarsci twin compare`: what was predicted beside what happened."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from lunarsci.options import refuse_where
from lunarsci.twin.jobs.requests import TrialsRequest

from ..shared.command import command
from ..shared.emit import Report
from ..shared.options import Output, option
from ..shared.table import TextTable
from .history import discrepancy_table
from .options import AS_WRITTEN, GROUND, HEIGHT_UNIT, INTERPOLATION, SOIL

if TYPE_CHECKING:
    from lunarsci.twin.comparison.forecast import Miss
    from lunarsci.twin.comparison.scores import EndCheck, PathCheck
    from lunarsci.twin.comparison.verdict import DriveComparison
    from lunarsci.twin.jobs.compare import ComparedDrive
    from lunarsci.twin.jobs.compare_trials import ScoredTrials

FORECAST = "prediction.json"
"""By which a folder of `twin predict -o` is known."""
TRIAL_UNITS = {"slip_ratio": ("slip", "-"), "side_slip_deg": ("side slip", "deg"), "end_m": ("end", "m")}
"""Words and unit of what trials are scored by."""
FILE: dict[str, Any] = {"kind": str | None, "metavar": "FILE"}
OPTIONS = {
    "positions": option(**FILE),
    "plan": option(**FILE),
    "belief": option(**FILE),
    "rover": option(show_default="that of the prediction or the trial"),
    "seed": option(min=0),
    "terrain": option(show_default="the plane that a public trial tells of", panel=GROUND),
    "height_unit": HEIGHT_UNIT,
    "gravity": option(show_default="that of a public trial, or moon", panel=GROUND),
    "interpolation": INTERPOLATION,
    "as_written": AS_WRITTEN,
    "soil": option(show_default="priors", panel=SOIL),
    "members": option(min=1, show_default="64 of a belief", panel=SOIL),
}
Inputs = Annotated[
    list[str],
    typer.Argument(
        metavar="PREDICTED_DIR STATES.csv | TRIAL...",
        help="Folder that `twin predict -o` wrote before the drive, and its measured wheel states (time_s, wheel, "
        "sinkage_m, slip_ratio, ..., NAME_sigma); or any number of trials: folders or tables of public data sets, "
        "folders with many of them, telemetry.",
    ),
]
SavedBelief = Annotated[
    Path | None, typer.Option(metavar="FILE", help="Takes the belief of --belief with what was learned (JSON).")
]
UNITS = {
    "sinkage_m": ("mm", 1e3),
    "slip_ratio": ("-", 1.0),
    "side_slip_deg": ("deg", 1.0),
    "normal_force_n": ("N", 1.0),
    "drawbar_pull_n": ("N", 1.0),
    "lateral_force_n": ("N", 1.0),
}
EXAMPLES = (
    "lunarsci twin compare predicted states/states.csv --plan plan.toml",
    "lunarsci twin compare predicted states/states.csv \\\n  --positions states/positions.csv --json",
)


@command("compare", EXAMPLES, OPTIONS, batch=True)
def compare(inputs: Inputs, request: TrialsRequest, output: Output, save: SavedBelief = None) -> Report:
    """Was the prediction to be trusted: the end of a drive, its path and its wheel states beside what was predicted.

    If the prediction is right, the real drive is one more of those predicted, with errors of measurement. If it is
    farther off than all but 1 in 100 would be, the prediction was not to be trusted; the reason is named, and the exit
    code is 3. Below 1 in 10 it is `not contradicted`: hardly confirmed, exit code 0. If wheels turned otherwise than
    planned, or states are doubtful, it is doubtful (exit code 3). Times count from the start of the plan. What was not
    measured is named and not judged.

    With --belief and --save a belief learns from the miss how far the twin's physics is off: regions of later
    predictions grow or shrink. Compare first, then `twin update` the saved belief.

    With trials in place of a prediction the twin is scored on published drives. Each is driven from its first pose by
    the turns of its wheels alone. Slip, side slip and end are compared with those of its positions, and with the way of
    the wheels without slip. A trial that cannot be read is named, and the others are scored (exit code 1).
    """
    if not _is_prediction(inputs, request):
        return _trials(inputs, request, output, save)
    _check_prediction(inputs, request, save)
    output.check_extra("--save", save, (".json",))
    return _drive(inputs, request, save)


def _is_prediction(inputs: list[str], request: TrialsRequest) -> bool:
    """Whether a folder of a prediction was named, or is meant by what is given beside it."""
    from lunarsci.twin.jobs.compare_trials import OF_A_PREDICTION

    meant = len(inputs) == 2 and any(getattr(request, name) is not None for name in OF_A_PREDICTION)
    return meant or (Path(inputs[0]) / FORECAST).is_file()


def _check_prediction(inputs: list[str], request: TrialsRequest, save: Path | None) -> None:
    """Raises RequestError for what does not belong to a prediction made before the drive."""
    from lunarsci.twin.jobs.compare_trials import OF_TRIALS

    given = [name for name in OF_TRIALS if getattr(request, name) != getattr(TrialsRequest(), name)]
    refuse_where({
        f"{inputs[0]} is a prediction; give one file of measured states beside it": len(inputs) != 2,
        **{f"`{name}` belongs to trials, and {inputs[0]} is a prediction; leave it out": True for name in given},
        "`belief` FILE and `save` FILE belong together; give both, or neither":
            (request.belief is None) != (save is None),
    })  # fmt: skip


def _drive(inputs: list[str], request: TrialsRequest, save: Path | None) -> Report:
    from lunarsci.twin.jobs.compare import compare

    compared = compare(inputs[0], inputs[1], request)
    belief = compared.belief
    extras = {save: lambda: belief.to_json().encode()} if save and belief else {}
    return Report(compared, result_tables(compared), extras=extras)


def _trials(inputs: list[str], request: TrialsRequest, output: Output, save: Path | None) -> Report:
    from lunarsci.twin.jobs import compare_trials as job

    refuse_where({
        "`save` keeps what a belief learns from a prediction, not from trials; leave it out": save is not None
    })  # fmt: skip
    scored = job.compare_trials(inputs, request, progress=output.progress("trials"))
    return Report(scored, trial_tables(scored))


def result_tables(compared: ComparedDrive) -> list[TextTable]:
    """The verdict with what it rests on, and what a belief learned of it."""
    tables, before, after = _tables(compared), compared.before, compared.belief
    if before is None or after is None:
        return tables
    return [*tables, discrepancy_table(after.discrepancy, before.discrepancy)]


def _tables(compared: ComparedDrive) -> list[TextTable]:
    from lunarsci.twin.comparison.forecast import miss_of

    matched, judged, states = compared.matched, compared.comparison, compared.states
    forecast, pace = matched.forecast, compared.pace
    drives = (
        f"{judged.finished} of {judged.members} drives that arrived"
        if judged.finished < judged.members
        else f"{judged.members} drives"
    )
    title = f"{compared.verdict.upper()}: {forecast.plan.name}, {drives} of {forecast.origin}, beside {states}"
    notes = [
        *(f"because {reason}" for reason in judged.reasons),
        *(f"near the edge: {text}" for text in judged.near),
    ]
    notes += [f"because {compared.doubt}"] if compared.verdict == "doubtful" else []
    head = TextTable(
        ["place", "what", "value"],
        [*_end_rows(judged.end), *_miss_rows(miss_of(matched)), *_path_rows(judged.path)],
        title=title,
        notes=notes,
    )
    tables = [head if head.rows else TextTable([], [], title=title, notes=notes)]
    if judged.bands:
        tables.append(_band_table(judged))
    left_out = [f"not compared: {name} ({why})" for name, why in judged.not_compared.items()]
    unchecked = "the plan's speed was not checked: the states do not say how fast the wheels turned (rim_m_s)"
    driven = [unchecked if pace is None else pace.text]
    return [
        *tables,
        TextTable([], [], title="What this rests on", notes=[*_whole(judged), *driven, *judged.notes, *left_out]),
    ]


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
        rows.append([place, "probability by chance", f"{end.standing.p:.2g}"])
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


def _band_table(judged: DriveComparison) -> TextTable:
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
    for check in judged.bands:
        unit, factor = UNITS[check.quantity]
        rows.append(
            [
                "sinkage" if check.quantity == "sinkage_m" else check.quantity,
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
        "bias: measured less predicted; worth: independent values among n, as neighbours are alike; bands include "
        "errors of measurement"
    )
    return TextTable(headers, rows, title="Wheel states beside their predicted bands", notes=[note])


def _or_dash(value: float | None, form: str) -> str:
    return "-" if value is None else format(value, form)


def _whole(judged: DriveComparison) -> list[str]:
    """The surprise of the whole drive and what was looked for along it."""
    lines = []
    if (whole := judged.surprise) is not None:
        pieces = "1 piece" if whole.pieces == 1 else f"{whole.pieces} pieces"
        place = whole.standing
        lines.append(
            f"surprise of the whole drive: {place.distance:.1f} sd in {place.dimensions} dimensions ({pieces} of the "
            f"drive, {', '.join(whole.quantities)}); its probability by chance is {place.p:.2g}, its ln density "
            f"{place.ln_density:.1f}"
        )
    if (change := judged.change) is not None:
        lines.append(
            f"the ground changes most after {change.distance_m:.1f} m; the probability by chance is {change.p:.2g}"
        )
    return lines


def _miss_rows(miss: Miss | None) -> list[list[str]]:
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


def trial_tables(scored: ScoredTrials) -> list[TextTable]:
    """One row a trial, then one for each quantity over all trials."""
    record = scored.to_dict()
    notes = [
        "error: root mean square of predicted less measured over the states, or the distance between the ends; wheels: "
        "the same error of a drive without slip",
        f"predicted on soils of {record['soil']['name']}",
        *([f"{made} of the trials are synthetic"] if (made := sum(trial.synthetic for trial in scored.trials)) else []),
        *(f"{trial.trial} is doubtful: {trial.doubt}" for trial in scored.trials if trial.doubt),
    ]
    headers = ["trial", "way [m]", "drives", "slip", "predicted", "error", "wheels", "side slip error [deg]", "wheels"]
    headers += ["end error [m]", "wheels", "90 % radius [m]", "inside"]
    rows = [_row(row) for row in record["trials"]]
    heads = ["over all trials", "unit", "trials", "values", "median error", "rms", "in 90 % regions", "wheels: median"]
    summary = [_summary_row(row) for row in record["summary"]]
    trials = "1 trial" if len(rows) == 1 else f"{len(rows)} trials"
    title = f"{trials} beside what the twin predicts from the wheels"
    return [
        TextTable(headers, rows, title=title, notes=notes),
        TextTable([*heads, "wheels: rms"], summary, title="Errors over all trials"),
    ]


def _row(row: dict[str, Any]) -> list[str]:
    inside = row.get("end_m_in_90")
    return [
        row["trial"],
        f"{row['way_m']:.2f}",
        f"{row['finished']} of {row['members']}",
        *(_cell(row.get(f"slip_ratio_{part}")) for part in ("measured", "predicted", "error", "error_wheels_alone")),
        *(_cell(row.get(f"side_slip_deg_{part}"), ".2f") for part in ("error", "error_wheels_alone")),
        *(_cell(row.get(f"end_m_{part}")) for part in ("error", "error_wheels_alone")),
        _cell(row["end_radius_90_m"]),
        "-" if inside is None else "yes" if inside else "no",
    ]


def _summary_row(row: dict[str, Any]) -> list[str]:
    name, unit = TRIAL_UNITS[row["quantity"]]
    held = row["in_90"]
    return [
        name,
        unit,
        str(row["trials"]),
        str(row["values"]),
        *(f"{row[part]:.3g}" for part in ("median_error", "rms")),
        "-" if held is None else f"{100 * held:.0f} %",
        *(f"{row[part]:.3g}" for part in ("median_error_wheels_alone", "rms_wheels_alone")),
    ]


def _cell(value: float | None, form: str = ".3f") -> str:
    return "-" if value is None else format(value, form)
