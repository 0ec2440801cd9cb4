"""From files to a scene, and from a predicted drive to a `Report`."""

from collections.abc import Callable, Iterable, Iterator
from dataclasses import asdict, dataclass, field, replace
from functools import cache
from pathlib import Path
from typing import TYPE_CHECKING, Any

import typer

from lunarsci.errors import ParameterError
from lunarsci.inputs import read_input
from lunarsci.provenance import sha256, to_json
from lunarsci.regolith.belief import SoilBelief, read_belief
from lunarsci.regolith.soil import known_soils, read_soil, soil_hash
from lunarsci.rovers.description import RoverDescription, read_rover
from lunarsci.twin.comparison.forecast import FILE, forecast_document, forecast_of
from lunarsci.twin.ground.driven_soil import DrivenSoil, lay_soil_on, soil_record
from lunarsci.twin.ground.synthetic import synthetic_longji
from lunarsci.twin.ground.terrain import SOIL_COLUMNS, Terrain
from lunarsci.twin.ground.terrain_files import TerrainFile, read_terrain_file
from lunarsci.twin.judgement.load_check import check_loads, load_notes
from lunarsci.twin.judgement.safety import Judgement, Verdict, judge
from lunarsci.twin.judgement.sensitivity import EndpointSensitivity, endpoint_sensitivity, step_error_m
from lunarsci.twin.judgement.tables import endpoint_table, path_table, profile_table, state_table
from lunarsci.twin.plans.plan import Fixes, Plan, parse_fixes, read_plan
from lunarsci.twin.rover import Rover, build_rover
from lunarsci.twin.simulation.ensemble import Prediction

from ..shared.progress import progress
from ..shared.report import Report
from ..shared.table import TextTable
from .made_for import RoverCheck

if TYPE_CHECKING:
    import pandas as pd
    from matplotlib.figure import Figure

__all__ = [
    "DEFAULT_SOIL",
    "DriveInputs",
    "SoilOfBelief",
    "csv_bytes",
    "predict_report",
    "read_scene",
    "soil_notes",
    "verdict_tables",
]

SYNTHETIC = "synthetic-longji"
SOURCES = [
    "Ding et al. (2024), Nat. Commun. 15, 2098, 10.1038/s41467-024-46233-8",
    "Janosi & Hanamoto (1961), Proc. 1st Int. Conf. Mechanics of Soil-Vehicle Systems, Turin, 707",
]


DEFAULT_ROVER, DEFAULT_SOIL = "yutu2", "longji"
"""Where none is given; the soil also lies under a belief, where it is nowhere used: this replaces every parameter."""


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
class DriveInputs:
    """What drives where: the parsed inputs of a prediction and their hashes; `soil` where that is a belief.

    `driven` says where the soil of the terrain comes from, `options` what was taken for options that were left out,
    `made_for` which rovers plan and terrain were made for, and `remarks` what there is to say about these.
    """

    rover: Rover
    description: RoverDescription
    terrain: Terrain
    plan: Plan
    inputs: dict[str, str]
    tables: dict[str, str]
    driven: DrivenSoil
    soil: SoilOfBelief | None = None
    options: dict[str, Any] = field(default_factory=dict)
    made_for: dict[str, Any] = field(default_factory=dict)
    remarks: tuple[str, ...] = ()
    ruts: bool = False
    before: Plan | None = None

    def soil_record(self, drawn: Iterable[str] = (), named: DrivenSoil | None = None) -> dict[str, Any]:
        """The soil for a result; `drawn` are the parameters that every drive has for itself, `named` their file."""
        found = soil_record(named or self.driven, self.terrain, drawn)
        return found if self.soil is None else found | self.soil.to_dict()


def read_scene(
    plan: str | None,
    rover: str | None,
    terrain: str,
    soil: str | None = None,
    interpolation: str = "smooth",
    fixes: str | None = None,
    *,
    soil_counts: bool = True,
    judged: bool = False,
    ruts: bool | None = None,
    before: str | None = None,
) -> DriveInputs:
    """Read plan, rover, terrain and soil, which may be a belief (.json); `fixes` replaces those of the plan.

    A rover that is None is Yutu-2. A soil that is given lies everywhere, whatever the terrain's file carries; without
    one this is driven on, and where it has none, `longji`. Where soils are of no account (`soil_counts`) none is said
    to be used. The limits of a plan that is `judged` must be those of the rover, or no laxer. `before` is a plan that
    was driven on the same ground before, whose ruts are met. `ruts` that are None are met with such a plan, and where
    the belief's last drive met them.
    """
    description = read_rover(rover or DEFAULT_ROVER)
    built = build_rover(description)
    believed, inputs, tables = _read_soil_hash(soil)
    if before is not None and ruts is False:
        raise typer.BadParameter("--before leaves nothing but ruts, and --no-ruts leaves them out; give one of them")
    if ruts is None:
        ruts = before is not None or (believed is not None and believed.belief.ruts)
    for path in (plan, None if terrain == SYNTHETIC else terrain, before):
        if path is not None:
            inputs[path] = read_input(path).sha256
    file, surface, driven = _read_ground(terrain, soil, believed)
    if soil_counts and (driven.rest or driven.name) in known_soils():
        tables |= soil_hash(driven.rest or driven.name)[1]
    drive = read_plan(plan)
    if fixes is not None and len(drive.legs) < 2:
        raise typer.BadParameter(f"--fixes steer the next leg, and {drive.origin} has only one; leave them out")
    check = RoverCheck(description, built, asked=rover is not None)
    drive = check.plan(drive, plan, judged=judged)
    check.terrain(file.made_for, terrain)
    if soil_counts:
        check.soil(driven, terrain)
    return DriveInputs(
        built,
        description,
        replace(surface, interpolation=interpolation),
        drive if fixes is None else replace(drive, fixes=_parsed_fixes(fixes)),
        inputs,
        tables | {f"{description.origin} (rover)": sha256(description.text.encode())},
        driven,
        believed,
        {"rover": description.origin} | ({"soil": driven.name} if driven.of == "default" and soil_counts else {}),
        check.made_for,
        tuple(check.remarks),
        ruts,
        None if before is None else read_plan(before),
    )


def _read_ground(
    terrain: str, soil: str | None, believed: SoilOfBelief | None
) -> tuple[TerrainFile, Terrain, DrivenSoil]:
    """The terrain's file, the terrain with the soil that is driven on, and where this comes from."""
    name = DEFAULT_SOIL if soil is None or believed else soil
    own = read_soil(name)
    file = TerrainFile(synthetic_longji(own)) if terrain == SYNTHETIC else read_terrain_file(terrain, own)
    surface, driven = lay_soil_on(file, terrain, own, name, asked=soil is not None and believed is None)
    return file, surface, driven if believed is None else DrivenSoil(believed.path, "belief")


def _read_soil_hash(soil: str | None) -> tuple[SoilOfBelief | None, dict[str, str], dict[str, str]]:
    """The belief, where the soil is one, and hashes of the user's files and of own tables."""
    if soil is None:
        return None, {}, {}
    if not soil.lower().endswith(".json"):
        return None, *soil_hash(soil)
    source = read_input(soil)
    return SoilOfBelief(soil, read_belief(source)), {soil: source.sha256}, {}


def _parsed_fixes(text: str) -> Fixes:
    try:
        return parse_fixes(text)
    except ParameterError as error:
        raise typer.BadParameter(f"--{error}") from error


def soil_notes(scene: DriveInputs, prediction: Prediction) -> list[str]:
    """Which soil the drives have, where it is not the common one, and what a belief in its place means for them."""
    if scene.soil is None:
        named = scene.driven.of != "default" and len(prediction.parameters) < len(SOIL_COLUMNS)
        rest = f", what it lacks of {scene.driven.rest}" if scene.driven.rest else ""
        return [f"soil: that of {scene.driven.name}{rest}"] if named else []
    members = prediction.members
    found = scene.soil
    start = "no drive yet, only on " + ("the priors" if found.belief.verdict is None else "a fit to wheel states")
    drives = start if not found.belief.history else f"{len(found.belief.history)} drive(s)"
    unread = len(found.belief.history) - found.learned
    less = f", {unread} of which taught nothing" if unread else ""
    return [
        f"soil: {members} drawn from the belief {found.path}, which rests on {drives}{less}; it takes the place of the "
        "terrain's soil"
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
        *soil_notes(scene, prediction),
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


def csv_bytes(table: "pd.DataFrame") -> bytes:
    """A table as CSV, nine significant digits."""
    text: str = table.to_csv(index=False, float_format="%.9g", lineterminator="\n")
    return text.encode()
