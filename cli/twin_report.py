"""From files to a scene, and from a predicted drive to a `Report`."""

from collections.abc import Callable, Iterator
from dataclasses import asdict, dataclass, replace
from functools import cache
from pathlib import Path
from typing import TYPE_CHECKING, Any

import typer

from lunarsci.errors import ParameterError
from lunarsci.inputs import read_input
from lunarsci.provenance import sha256, to_json
from lunarsci.regolith.belief import SoilBelief, read_belief
from lunarsci.regolith.soil import read_soil, soil_hash
from lunarsci.rovers.description import RoverDescription, read_rover
from lunarsci.twin.comparison.forecast import FILE, forecast_document, forecast_of
from lunarsci.twin.ensemble import Prediction
from lunarsci.twin.ground.longji import synthetic_longji
from lunarsci.twin.ground.terrain import Terrain
from lunarsci.twin.ground.terrain_files import read_terrain
from lunarsci.twin.judgement.profiles import profile_table
from lunarsci.twin.judgement.safety import Judgement, Verdict, judge
from lunarsci.twin.judgement.sensitivity import EndpointSensitivity, endpoint_sensitivity, step_error_m
from lunarsci.twin.judgement.tables import endpoint_table, path_table, state_table
from lunarsci.twin.plans.plan import Fixes, Plan, parse_fixes, read_plan
from lunarsci.twin.rover import Rover, build_rover

from .progress import progress
from .report import Report
from .table import TextTable

if TYPE_CHECKING:
    import pandas as pd
    from matplotlib.figure import Figure

__all__ = ["Scene", "SoilOfBelief", "csv_bytes", "predict_report", "read_scene", "soil_notes", "verdict_tables"]

SYNTHETIC = "synthetic-longji"
SOURCES = [
    "Ding et al. (2024), Nat. Commun. 15, 2098, 10.1038/s41467-024-46233-8",
    "Janosi & Hanamoto (1961), Proc. 1st Int. Conf. Mechanics of Soil-Vehicle Systems, Turin, 707",
]


UNDER_A_BELIEF = "longji"
"""Laid on a terrain without soil, and nowhere used: a belief replaces every parameter."""


@dataclass(frozen=True, slots=True)
class SoilOfBelief:
    """A belief that takes the place of the terrain's soil, and the file it comes from."""

    path: str
    belief: SoilBelief

    @property
    def learned(self) -> int:
        """Drives that it rests on, without those from which nothing was learned."""
        return sum(not entry.get("refused") for entry in self.belief.history)

    def to_dict(self) -> dict[str, Any]:
        """For the result."""
        return {"belief": self.path, "drives": len(self.belief.history), "learned_from": self.learned}


@dataclass(frozen=True, slots=True)
class Scene:
    """What drives where: the parsed inputs of a prediction and their hashes; `soil` where that is a belief."""

    rover: Rover
    description: RoverDescription
    terrain: Terrain
    plan: Plan
    inputs: dict[str, str]
    tables: dict[str, str]
    soil: SoilOfBelief | None = None


def read_scene(
    plan: str | None, rover: str, terrain: str, soil: str, interpolation: str = "smooth", fixes: str | None = None
) -> Scene:
    """Read plan, rover, terrain and soil, which may be a belief (.json); `fixes` replaces those of the plan."""
    description = read_rover(rover)
    believed, inputs, tables = _read_soil_hash(soil)
    ground = read_soil(UNDER_A_BELIEF if believed else soil)
    for path in (plan, None if terrain == SYNTHETIC else terrain):
        if path is not None:
            inputs[path] = read_input(path).sha256
    surface = synthetic_longji(ground) if terrain == SYNTHETIC else read_terrain(terrain, ground)
    drive = read_plan(plan)
    return Scene(
        build_rover(description),
        description,
        replace(surface, interpolation=interpolation),
        drive if fixes is None else replace(drive, fixes=_parsed_fixes(fixes)),
        inputs,
        tables | {f"{rover} (rover)": sha256(description.text.encode())},
        believed,
    )


def _read_soil_hash(soil: str) -> tuple[SoilOfBelief | None, dict[str, str], dict[str, str]]:
    """The belief, where the soil is one, and hashes of the user's files and of own tables."""
    if not soil.lower().endswith(".json"):
        return None, *soil_hash(soil)
    source = read_input(soil)
    return SoilOfBelief(soil, read_belief(source)), {soil: source.sha256}, {}


def _parsed_fixes(text: str) -> Fixes:
    try:
        return parse_fixes(text)
    except ParameterError as error:
        raise typer.BadParameter(f"--{error}") from error


def soil_notes(scene: Scene, members: int) -> list[str]:
    """What a belief in the place of the terrain's soil means for the drives."""
    if scene.soil is None:
        return []
    found = scene.soil
    drives = "no drive yet, only on the priors" if not found.belief.history else f"{len(found.belief.history)} drive(s)"
    unread = len(found.belief.history) - found.learned
    less = f", {unread} of which taught nothing" if unread else ""
    return [
        f"soil: {members} drawn from the belief {found.path}, which rests on {drives}{less}; it takes the place of the "
        "terrain's soil"
    ]


CORRELATED = ("belief", "samples")
"""Kinds of soils whose parameters go together, so that none of them moves the end by itself."""


def predict_report(
    scene: Scene, prediction: Prediction, soils: str = "sweep", *, film: Path | None = None, quiet: bool = False
) -> Report:
    """The report of `twin predict`, with a film where a file for one is named; `soils` says what they are."""
    verdict = judge(prediction, scene.plan)
    shares = [] if soils in CORRELATED else endpoint_sensitivity(prediction)
    step_error = step_error_m(prediction)

    return Report(
        schema="twin-predict/1",
        result=_result(scene, prediction, verdict)
        | {
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
        seed=prediction.seed,
        files={
            **_kept(scene, prediction, soils),
            "endpoints.csv": lambda: csv_bytes(endpoint_table(prediction)),
            "profiles.csv": lambda: csv_bytes(profile_table(prediction)),
        },
        untrusted="" if verdict.verdict == "go" else f"no-go: {'; '.join(verdict.reasons)}",
    )


def _kept(scene: Scene, prediction: Prediction, soils: str) -> dict[str, Callable[[], bytes]]:
    """What `twin compare` reads after the drive: every drive's states and paths, and what they belong to."""
    tables = {
        "states.csv": cache(lambda: csv_bytes(state_table(prediction))),
        "paths.csv": cache(lambda: csv_bytes(path_table(prediction))),
    }
    kept = forecast_of(prediction, soils=soils, rover_sha256=sha256(scene.description.text.encode()))
    return {**tables, FILE: lambda: to_json(forecast_document(kept, tables)).encode()}


def _pages(prediction: Prediction, verdict: Verdict) -> "Iterator[Figure]":
    from lunarsci.twin.figures.boxes import box_pages
    from lunarsci.twin.figures.fan import path_fan
    from lunarsci.twin.figures.profiles import profile_page

    yield path_fan(prediction, verdict)
    yield profile_page(prediction, verdict)
    yield from box_pages(prediction)


def _film(prediction: Prediction, verdict: Verdict, target: Path, quiet: bool) -> bytes:
    from lunarsci.twin.figures.animation import animate

    with progress("filming", quiet=quiet) as update:
        return animate(prediction, verdict, target, progress=update)


def _result(scene: Scene, prediction: Prediction, verdict: Verdict) -> dict[str, Any]:
    return asdict(verdict) | {
        "members": prediction.members,
        "path_length_m": scene.plan.length_m,
        "time_step_s": prediction.time_step_s,
        "plan": scene.plan.name,
        "terrain": {"name": scene.terrain.name, "synthetic": scene.terrain.synthetic},
        "soil": None if scene.soil is None else scene.soil.to_dict(),
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


def verdict_tables(scene: Scene, prediction: Prediction, verdict: Verdict) -> list[TextTable]:
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
        *soil_notes(scene, prediction.members),
        *_endpoint_notes(verdict),
        *verdict.reasons,
        *verdict.notes,
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


def csv_bytes(table: "pd.DataFrame") -> bytes:
    """A table as CSV, nine significant digits."""
    text: str = table.to_csv(index=False, float_format="%.9g", lineterminator="\n")
    return text.encode()
