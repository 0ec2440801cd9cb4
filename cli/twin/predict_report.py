"""From a predicted drive to a `Report`."""

from collections.abc import Callable, Iterator
from dataclasses import asdict
from functools import cache
from pathlib import Path
from typing import TYPE_CHECKING, Any

from lunarsci.csv_table import csv_bytes
from lunarsci.provenance import sha256, to_json
from lunarsci.twin.comparison.forecast import FILE, forecast_document, forecast_of
from lunarsci.twin.jobs.drive_inputs import SOURCES, DriveInputs
from lunarsci.twin.judgement.load_check import check_loads, load_notes
from lunarsci.twin.judgement.safety import Judgement, Verdict, judge
from lunarsci.twin.judgement.sensitivity import EndpointSensitivity, endpoint_sensitivity, step_error_m
from lunarsci.twin.judgement.tables import endpoint_table, path_table, profile_table, state_table
from lunarsci.twin.simulation.ensemble import Prediction

from ..shared.progress import progress
from ..shared.report import Report
from ..shared.table import TextTable

if TYPE_CHECKING:
    from matplotlib.figure import Figure

__all__ = [
    "predict_report",
    "verdict_tables",
]

CORRELATED = ("belief", "samples")
"""Kinds of soils whose parameters go together, so that none of them moves the end by itself."""


def predict_report(
    scene: DriveInputs,
    prediction: Prediction,
    soils: str,
    soil: dict[str, Any],
    *,
    seed: int | None = None,
    film: Path | None = None,
    quiet: bool = False,
) -> Report:
    """The report of `twin predict`, with a film where a file for one is named.

    `soils` says what the soils are, `soil` is their record for the result, `seed` what something was drawn by.
    """
    verdict = judge(prediction, scene.plan)
    shares = [] if soils in CORRELATED else endpoint_sensitivity(prediction)
    step_error = step_error_m(prediction)

    return Report(
        schema="twin-predict/1",
        result=_result(scene, prediction, verdict)
        | {
            "soil": soil,
            "sensitivity": None if soils in CORRELATED else [asdict(share) for share in shares],
            "step_error_m": step_error,
        },
        tables=[
            *verdict_tables(scene, prediction, verdict),
            *_sensitivity_tables([] if soils in CORRELATED else shares, step_error),
        ],
        rows=[asdict(limit) for limit in verdict.limits],
        figures=lambda: _pages(prediction, verdict),
        extras={} if film is None else {film: lambda: _film(prediction, verdict, film, quiet)},
        inputs=scene.inputs,
        data_tables=scene.tables,
        sources=SOURCES,
        seed=seed,
        files={
            **_kept(scene, prediction, soils, soil),
            "endpoints.csv": lambda: csv_bytes(endpoint_table(prediction)),
            "profiles.csv": lambda: csv_bytes(profile_table(prediction)),
        },
        untrusted="" if verdict.verdict == "go" else f"no-go: {'; '.join(verdict.reasons)}",
        options=scene.options | {"seed": prediction.seed},
    )


def _kept(
    scene: DriveInputs, prediction: Prediction, soils: str, soil: dict[str, Any]
) -> dict[str, Callable[[], bytes]]:
    """What `twin compare` reads after the drive: every drive's states and paths, and what they belong to."""
    tables = {
        "states.csv": cache(lambda: csv_bytes(state_table(prediction))),
        "paths.csv": cache(lambda: csv_bytes(path_table(prediction))),
    }
    kept = forecast_of(prediction, soils=soils, rover_sha256=sha256(scene.description.text.encode()), soil=soil)
    return {**tables, FILE: lambda: to_json(forecast_document(kept, tables)).encode()}


def _pages(prediction: Prediction, verdict: Verdict) -> "Iterator[Figure]":
    from lunarsci.twin.figures.boxes import box_pages, profile_page
    from lunarsci.twin.figures.fan import path_fan

    yield path_fan(prediction, verdict)
    yield profile_page(prediction, verdict)
    yield from box_pages(prediction)


def _film(prediction: Prediction, verdict: Verdict, target: Path, quiet: bool) -> bytes:
    from lunarsci.twin.figures.animation import animate

    with progress("filming", quiet=quiet) as update:
        return animate(prediction, verdict, target, progress=update)


def _result(scene: DriveInputs, prediction: Prediction, verdict: Verdict) -> dict[str, Any]:
    return asdict(verdict) | {
        "members": prediction.members,
        "path_length_m": scene.plan.length_m,
        "time_step_s": prediction.time_step_s,
        "finer_members": prediction.finer_members,
        "ruts": prediction.ruts,
        "before": None if prediction.before is None else prediction.before.name,
        "plan": scene.plan.name,
        "terrain": {"name": scene.terrain.name, "synthetic": scene.terrain.synthetic},
        "loads": asdict(check_loads(prediction)),
        "rover": scene.rover.name,
        "made_for": scene.made_for,
        "physics": _physics(prediction, verdict),
        "sweep": {name: {"low": values.min(), "high": values.max()} for name, values in prediction.parameters.items()},
        "assumed_of_rover": list(scene.description.assumed),
    }


def _physics(prediction: Prediction, verdict: Verdict) -> dict[str, Any] | None:
    """What the twin is off by beside its soils, and its part of the variance of the ends; None where none was asked."""
    if prediction.discrepancy is None:
        return None
    law = prediction.discrepancy.law
    share = None if verdict.endpoint is None else verdict.endpoint.physics_share
    return {"discrepancy": law.to_dict(), "learned_from": len(law.scored), "share_of_end_variance": share}


def verdict_tables(scene: DriveInputs, prediction: Prediction, verdict: Verdict) -> list[TextTable]:
    """The verdict for people: head line, limits, notes."""
    rows = [
        [
            limit.quantity,
            *(f"{value:.4g}" for value in (limit.p50, limit.kept_by_95, limit.worst)),
            _bound(limit),
            f"{limit.margin:.4g}",
            limit.unit,
            "ok" if limit.ok else "broken",
            "assumed" if limit.assumed else "",
        ]
        for limit in verdict.limits
    ]
    headers = [
        "quantity (worst of each drive)",
        "p50",
        "95 % keep",
        "worst",
        "limit",
        "margin",
        "unit",
        "verdict",
        "limit is",
    ]
    drives = "1 drive" if prediction.members == 1 else f"{prediction.members} drives"
    title = f"{verdict.verdict.upper()}: {scene.plan.name}; {drives} on {scene.terrain.name}"
    notes = [
        *scene.soil_notes(prediction.members, len(prediction.parameters)),
        *scene.remarks,
        *_endpoint_notes(verdict),
        *verdict.reasons,
        *verdict.notes,
        *load_notes(check_loads(prediction)),
        _worst_note(verdict),
    ]
    return [TextTable(headers, rows, title=title, notes=notes)]


def _bound(limit: Judgement) -> str:
    return f"{'≤' if limit.sense == 'at most' else '≥'} {limit.limit:.4g}"


def _worst_note(verdict: Verdict) -> str:
    soil = ", ".join(f"{name} {value:.4g}" for name, value in verdict.worst.parameters.items())
    return f"worst drive: member {verdict.worst.member}{f' ({soil})' if soil else ''}, {verdict.worst.why}"


def _sensitivity_tables(shares: list[EndpointSensitivity], step_error: float | None) -> list[TextTable]:
    rows = [[share.parameter, f"{share.x_m:.3f}", f"{share.y_m:.3f}", f"{100 * share.share:.0f} %"] for share in shares]
    notes = [] if step_error is None else [f"the time step puts ends off by about {1e3 * step_error:.1f} mm"]
    if not rows:
        return [TextTable([], [], title=notes[0])] if notes else []
    headers = ["over the range of", "x [m]", "y [m]", "of the variance"]
    return [TextTable(headers, rows, title="What moves the end", notes=notes)]


def _endpoint_notes(verdict: Verdict) -> list[str]:
    end = verdict.endpoint
    if end is None:
        return []
    notes = [
        f"ends: mean {end.bias_m:.3f} m from the destination, all within {end.covering_radius_m:.3f} m of it, "
        f"within {end.scatter_radius_m:.3f} m of each other's middle"
    ]
    if (share := end.physics_share) is not None:
        notes.append(
            f"of the variance of the ends {100 * (1 - share):.0f} % is soil, {100 * share:.0f} % what the physics "
            "is off by; limits are held against both"
        )
    if (ellipse := end.ellipse) is not None:
        notes.append(
            f"error ellipse: {ellipse.semi_major_m:.3f} m x {ellipse.semi_minor_m:.3f} m (1 σ), major axis at "
            f"{round(ellipse.azimuth_deg) % 180}° from x; times {ellipse.factor_95:.2f} for 95 %, if normal"
        )
    return notes
