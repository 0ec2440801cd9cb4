"""`lunarsci twin predict`: whether the next drive is safe."""

from __future__ import annotations

import math
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

import typer

from lunarsci.twin.jobs.requests import PredictRequest

from ..shared.command import command
from ..shared.emit import Report
from ..shared.options import SPREAD, Output, option
from ..shared.table import TextTable
from ..shared.talk import progress
from .options import AS_WRITTEN, BEFORE, CHARGE, DRIVE, EXACT_TERRAIN, KEEP_OUT, RUTS, SUN, PlanFile

if TYPE_CHECKING:
    from lunarsci.twin.jobs.predict import PredictedDrives
    from lunarsci.twin.judgement.safety import Judgement, Verdict
    from lunarsci.twin.simulation.ensemble import Prediction


OPTIONS = DRIVE | {
    "risk": option(),
    "as_written": AS_WRITTEN,
    "ruts": RUTS,
    "before": BEFORE,
    "exact_terrain": EXACT_TERRAIN,
    "keep_out": KEEP_OUT,
    "sun": SUN,
    "charge": CHARGE,
}
EXAMPLES = (
    "lunarsci twin predict plan.toml --soil lunar-typical",
    "lunarsci twin predict plan.toml --sweep friction_angle_deg=30:50:3 \\\n  -o predicted",
)
ONE_SOIL = "the verdict is about this one soil; {} drives on others"
HEADERS = (
    "quantity (worst of {drives})",
    "p50",
    "{share} of drives",
    "worst",
    "limit",
    "margin",
    "unit",
    "verdict",
    "limit from",
)
QUANTITIES = {"sinkage_m": ("sinkage", "mm", 1e3)}
"""Names, units and factors of quantities that tables show otherwise than files: sinkage in mm throughout."""


@command("predict", EXAMPLES, OPTIONS, folder=True, blocks=SPREAD)
def predict(
    output: Output,
    request: PredictRequest,
    plan: PlanFile = None,
    animate: Annotated[
        Path | None, typer.Option(metavar="FILE", help="The drive as a film: .gif, or .mp4 where ffmpeg is installed.")
    ] = None,
    tables: Annotated[
        Literal["csv", "parquet"],
        typer.Option(help="Form of the tables of -o DIR; Parquet has all digits, is smaller, and is written faster."),
    ] = "csv",
) -> Report:
    """Drive a plan over many soils and say whether it stays within the limits: go; no-go or not determined, exit 3.

    The rule: 95 % of the drives keep each limit, all end, and none enters ground to keep out of, runs its battery empty
    or passes with its body over ground of unknown height. Limits that a plan leaves out are the rover's own. Where
    neither plan, terrain nor --soil states a soil, it is drawn from the priors. A plan of `twin plan --risk` carries
    the accepted risk; it is go where the probability to break any limit or not to end is at most that.

    -o DIR writes wheel states and forces to states.csv, paths to paths.csv, ends to endpoints.csv, the spread of all
    quantities against distance to profiles.csv, and prediction.json for `twin compare`. A plan of `twin plan` is driven
    by the rover that it was made for, if this comes with lunarsci; give a rover of your own by --rover.

    On a terrain whose nodes lie wider apart than a wheel is large, every drive has a draw of the Moon's roughness
    between them. Where that decides, the verdict is not-determined, and the result says which spacing of heights would
    decide.

    On soils of a belief every drive also carries a draw of the error of the twin's physics, in its place, slip, side
    slip, sinkage and forces. The result says how much of the ends' variance that is.
    """
    from lunarsci.twin.jobs import predict as job

    if animate is not None:
        _check_film(output, animate)
    if tables != "csv" and output.path is None:
        raise typer.BadParameter("--tables is of the tables in a folder; add -o DIR")
    predicted = job.predict(plan, request, progress=output.progress("driving"))
    films = {} if animate is None else {animate: lambda: _film(predicted, animate, output.quiet)}
    return Report(predicted, result_tables(predicted), files=predicted.files(tables=tables), extras=films)


def result_tables(predicted: PredictedDrives) -> list[TextTable]:
    """The verdict with its limits, and what it hangs on."""
    return [*_verdict_tables(predicted), *_sensitivity_tables(predicted)]


def _check_film(output: Output, animate: Path) -> None:
    from lunarsci.twin.figures.animation import FORMATS, check_format

    output.check_extra("--animate", animate, FORMATS)
    check_format(animate)


def _film(predicted: PredictedDrives, target: Path, quiet: bool) -> bytes:
    with progress("filming", quiet=quiet) as update:
        return predicted.film(target, update)


def _verdict_tables(predicted: PredictedDrives) -> list[TextTable]:
    """The verdict for people: head line, limits, notes."""
    from lunarsci.regolith.columns import short_name
    from lunarsci.twin.judgement.safety import headword
    from lunarsci.twin.judgement.tables import check_loads, load_notes

    verdict, prediction = predicted.verdict, predicted.prediction
    rows = [_limit_row(limit) for limit in verdict.limits]
    drives = "1 drive" if prediction.members == 1 else f"{prediction.members} drives"
    head = f"{headword(verdict)}{', doubtful' if predicted.soils.doubt else ''}"
    title = (
        f"{head}: {prediction.plan.name}; {drives} of {short_name(prediction.rover.name)} on {prediction.terrain.name}"
    )
    notes = [
        *predicted.soils.doubt.reasons,
        *([_one_soil(predicted)] if prediction.members == 1 else []),
        *predicted.inputs.soil_notes(prediction.members, len(prediction.parameters)),
        *_rut_notes(prediction),
        *predicted.inputs.remarks,
        *_endpoint_notes(verdict),
        *_terrain_notes(predicted),
        *_keep_out_notes(verdict),
        *verdict.reasons,
        *([] if verdict.verdict == "go" else [_next(predicted)]),
        *verdict.notes,
        *load_notes(check_loads(prediction)),
        *_energy_notes(predicted),
        _worst_note(verdict),
    ]
    share = verdict.limits[0].share if verdict.limits else 0.95
    of = "each drive" if verdict.arrived == verdict.members else f"{verdict.arrived} that arrived"
    headers = [header.format(share=f"{100 * share:g} %", drives=of) for header in HEADERS]
    if prediction.members == 1:
        headers, *rows = ([row[0], *row[3:]] for row in (headers, *rows))
    return [TextTable(headers if rows else [], rows, title=title, notes=[*dict.fromkeys(notes)])]


def _one_soil(predicted: PredictedDrives) -> str:
    return ONE_SOIL.format("--members 64" if predicted.soils.kind == "belief" else "--soil priors --members 64")


def _rut_notes(prediction: Prediction) -> list[str]:
    """In how many drives wheels meet ruts, where the belief leaves it open."""
    met = int(prediction.ruts.sum())
    if met in (0, prediction.members):
        return []
    return [f"in {met} of {prediction.members} drives wheels meet the ruts of others, as probably as in the last drive"]


def _next(predicted: PredictedDrives) -> str:
    """What may help after a no-go: of drives that leave the ground that is known, where that is."""
    states, terrain, plan = predicted.verdict.validity, predicted.prediction.terrain, predicted.prediction.plan
    off, hole = states.members_off_map, states.members_in_hole
    (x0, x1), (y0, y1) = ((axis[0], axis[-1]) for axis in (terrain.x_m, terrain.y_m))
    start = f"the plan starts at x {plan.x_m:.4g} m, y {plan.y_m:.4g} m"
    inside = x0 <= plan.x_m <= x1 and y0 <= plan.y_m <= y1
    ground = (
        "heights that reach farther, or a way farther from their edge"
        if inside
        else "a plan and heights of the same place"
    )
    parts = [
        *([f"{ground}: they span x {x0:.4g} to {x1:.4g} m and y {y0:.4g} to {y1:.4g} m, and {start}"] if off else []),
        *([f"heights without holes along the way, or a way round them: {start}"] if hole else []),
        *(_other_drives(predicted) if off + hole < predicted.verdict.members else []),
    ]
    return f"what may help: {'; '.join(parts)}"


def _other_drives(predicted: PredictedDrives) -> list[str]:
    """What other drives may help, but for those that were made already."""
    belief, plan = predicted.inputs.given.belief, predicted.prediction.plan
    learned = belief is not None and bool(belief.history)
    chosen = plan.made_for is not None and plan.accepted_risk is not None
    return [
        f"{'another short drive' if learned else 'a short drive first'}, from which `twin update` learns the soil with "
        "the track's depth",
        *([] if plan.fixes else ["halts to be localised (--fixes)"]),
        "another target" if chosen else "another way (`twin plan --risk`)",
    ]


def _limit_row(limit: Judgement) -> list[str]:
    name, unit, factor = QUANTITIES.get(limit.quantity, (limit.quantity, limit.unit, 1.0))
    return [
        name,
        *(_cell(factor * value) for value in (limit.p50, limit.kept, limit.worst)),
        f"{'≤' if limit.sense == 'at most' else '≥'} {factor * limit.limit:.4g}",
        _cell(factor * limit.margin),
        unit,
        "ok" if limit.ok else "broken" if math.isfinite(limit.judged) else "unknown",
        "assumed" if limit.assumed else "rover" if limit.source.startswith("the rover's") else "plan",
    ]


def _cell(value: float) -> str:
    """A number; a clearance over ground of unknown height is none."""
    return f"{value:.3g}" if math.isfinite(value) else "-"


def _energy_notes(predicted: PredictedDrives) -> list[str]:
    from lunarsci.twin.judgement.energy import energy_record

    energy = energy_record(predicted.prediction)
    if energy is None:
        return []
    most = f" (median; 95 % of the drives: at most {energy['p95_j']:.3g} J)" if predicted.prediction.members > 1 else ""
    return [
        f"the motors do {energy['p50_j']:.3g} J of work at the wheels{most} in {energy['duration_s']:.0f} s; losses in "
        "motors, gears and electronics come on top",
        *_power_notes(predicted),
    ]


def _power_notes(predicted: PredictedDrives) -> list[str]:
    from lunarsci.twin.judgement.energy import power_record

    power = predicted.prediction.rover.power
    if predicted.power is None or power is None:
        return []
    record = power_record(predicted.prediction, predicted.power)
    light = record["panels"]["lit_share"]
    sun = "no Sun given" if light is None else f"panels give {record['panels']['p50_wh']:.3g} Wh, {light:.0%} of it lit"
    empty = record["empty_drives"]
    assumed = " (assumed)" if "power.battery_wh" in predicted.inputs.description.assumed else ""
    return [
        f"the rover draws {record['drawn']['p50_wh']:.3g} Wh of electrical energy (median; 95 % of the drives: at most "
        f"{record['drawn']['p95_wh']:.3g} Wh); {sun}",
        f"the battery of {power.battery_wh:g} Wh{assumed} falls to {record['battery']['p50_least_wh']:.3g} Wh (median; "
        f"95 % of the drives: at least {record['battery']['p05_least_wh']:.3g} Wh)"
        + (f"; it runs empty in {empty} of {predicted.prediction.members} drives" if empty else ""),
    ]


def _worst_note(verdict: Verdict) -> str:
    soil = ", ".join(f"{name} {value:.4g}" for name, value in verdict.worst.parameters.items())
    return f"worst drive: member {verdict.worst.member}{f' ({soil})' if soil else ''}: {verdict.worst.why}"


def _sensitivity_tables(predicted: PredictedDrives) -> list[TextTable]:
    shares, step_error = predicted.sensitivity or [], predicted.step_error_m
    rows = [[share.parameter, f"{share.x_m:.3f}", f"{share.y_m:.3f}", f"{100 * share.share:.0f} %"] for share in shares]
    step = f"the simulation's time step of {predicted.prediction.time_step_s:.2g} s moves the ends by about "
    notes = [] if step_error is None else [f"{step}{_length(step_error)}"]
    if not rows:
        return [TextTable([], [], title=notes[0])] if notes else []
    headers = ["over the range of", "x [m]", "y [m]", "of the variance"]
    return [TextTable(headers, rows, title="What moves the end", notes=notes)]


def _terrain_notes(predicted: PredictedDrives) -> list[str]:
    """What errors of the terrain make of the drives."""
    shares = predicted.terrain_shares
    if shares is None:
        return ["every drive has its own draw of the ground"] if predicted.prediction.draws is not None else []
    parts = {"end": shares.end, "slip": shares.slip_ratio, "tilt": shares.tilt_deg, "sinkage": shares.sinkage_m}
    of_each = ", ".join(f"{name} {100 * share:.0f} %" for name, share in parts.items() if share is not None)
    return [
        f"every drive has its own draw of the ground: errors of the terrain move the ends by {_length(shares.end_m)} "
        f"(rms), and make this part of the variance: {of_each} ({shares.pairs} pairs of drives)"
    ]


def _length(length_m: float) -> str:
    """An estimate that is known to two digits."""
    factor, unit = (1e3, "mm") if length_m < 0.0995 else (1e2, "cm") if length_m < 0.995 else (1.0, "m")
    return f"{factor * length_m:.2g} {unit}"


def _keep_out_notes(verdict: Verdict) -> list[str]:
    """The circle that drives come nearest to, where none is entered."""
    near = next(iter(verdict.keep_outs), None)
    if near is None or near.margin_m < 0:
        return []
    return [
        f"nearest to ground to keep out of: {near.margin_m:.2f} m from '{near.name}' at x {near.zone_x_m:.2f} m, "
        f"y {near.zone_y_m:.2f} m, after {near.distance_m:.1f} m of the way"
    ]


def _endpoint_notes(verdict: Verdict) -> list[str]:
    from lunarsci.twin.judgement.safety import arrivals

    end = verdict.endpoint
    if end is None:
        return []
    along, across = "far" if end.ahead_m > 0 else "short", "left" if end.left_m > 0 else "right"
    some = "" if verdict.arrived == verdict.members else f" of {arrivals(verdict.arrived, verdict.members)}"
    notes = [
        f"the mean end{some} lies {end.bias_m:.3f} m from the destination: {abs(end.ahead_m):.3f} m too {along} and "
        f"{abs(end.left_m):.3f} m to the {across}",
        f"all ends lie within {end.covering_radius_m:.3f} m of the destination; the smallest circle about them has a "
        f"radius of {end.scatter_radius_m:.3f} m",
    ]
    if (share := end.physics_share) is not None and share >= 0.005:
        notes.append(
            f"the unknown soil makes {100 * (1 - share):.0f} % of the variance of the ends, the error of the twin's "
            f"physics {100 * share:.0f} %; the verdict includes both"
        )
    if (ellipse := end.ellipse) is not None:
        notes.append(
            f"error ellipse of the ends (1 σ): {ellipse.semi_major_m:.3f} m x {ellipse.semi_minor_m:.3f} m, its major "
            f"axis at {round(ellipse.azimuth_deg) % 180}° from x; an ellipse {ellipse.factor_95:.2f} times as large "
            "holds 95 % of normally distributed ends"
        )
    return notes
