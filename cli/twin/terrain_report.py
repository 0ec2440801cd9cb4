"""From a terrain to maps, from a target to a path, and from both to a `Report`."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

import numpy as np
import numpy.typing as npt
import typer

from lunarsci.csv_table import csv_bytes
from lunarsci.inputs import read_input
from lunarsci.provenance import sha256
from lunarsci.regolith.soil import read_soil, soil_hash
from lunarsci.rovers.description import MadeFor, RoverDescription, made_for, read_rover
from lunarsci.twin.ground.driven_soil import DrivenSoil, lay_soil_on, soil_record
from lunarsci.twin.ground.hazards import GroundMaps, Traversability, assess, ground_maps, map_scales
from lunarsci.twin.ground.mobility import Mobility, read_mobility
from lunarsci.twin.ground.synthetic import synthetic_longji, synthetic_terrain
from lunarsci.twin.ground.terrain import Terrain
from lunarsci.twin.ground.terrain_files import TerrainFile, maps_bytes, maps_geotiff, read_terrain_file, terrain_bytes
from lunarsci.twin.jobs.drive_inputs import DEFAULT_SOIL
from lunarsci.twin.plans.plan import read_plan
from lunarsci.twin.plans.plan_files import plan_text
from lunarsci.twin.plans.rover_check import RoverCheck, limits_of_rover
from lunarsci.twin.routes.planner import PlannedPath, path_table, plan_path
from lunarsci.twin.rover import Rover, build_rover

from ..shared.report import Report
from ..shared.table import TextTable

if TYPE_CHECKING:
    from matplotlib.figure import Figure

__all__ = ["PathRequest", "TerrainInputs", "read_site", "terrain_report"]

Progress = Callable[[int, int], None]
SOURCES = [
    "Goldberg, Maimone & Matthies (2002), IEEE Aerospace Conf., 10.1109/AERO.2002.1035370",
    "Ding et al. (2024), Nat. Commun. 15, 2098, 10.1038/s41467-024-46233-8",
]
ROCK_SOURCES = [
    "Golombek & Rapp (1997), J. Geophys. Res. 102, 4117, 10.1029/96JE03319",
    "Di et al. (2016), Planet. Space Sci. 120, 103, 10.1016/j.pss.2015.11.012",
    "Wu et al. (2021), Earth Planet. Sci. Lett. 553, 116666",
]
MAKERS: dict[str, tuple[Callable[..., Terrain], tuple[str, ...]]] = {
    "synthetic-longji": (synthetic_longji, ("seed", "spacing_m", "rock_share", "rms_m")),
    "synthetic": (
        synthetic_terrain,
        ("seed", "spacing_m", "rock_share", "rms_m", "extent_m", "slope_deg", "craters"),
    ),
}
OPTION = {
    "seed": "--seed",
    "spacing_m": "--spacing",
    "rock_share": "--rocks",
    "rms_m": "--roughness",
    "extent_m": "--extent",
    "slope_deg": "--ground-slope",
    "craters": "--craters",
}
UNSEEN = "rocks and edges smaller than two spacings of the grid are not in it"


@dataclass(frozen=True, slots=True, kw_only=True)
class TerrainInputs:
    """What is looked at, with what rover in mind, and the hashes of the inputs."""

    terrain: Terrain
    rover: Rover
    description: RoverDescription
    mobility: Mobility
    inputs: dict[str, str]
    tables: dict[str, str]
    seed: int | None
    rocks: bool
    driven: DrivenSoil
    check: RoverCheck

    @property
    def made_for(self) -> MadeFor:
        """The rover and the limits, for what is written."""
        return made_for(self.description, {name: getattr(self.mobility, name) for name in _limit_names()})

    def surface(self, baseline_m: float | None, progress: Progress) -> Traversability:
        """The maps, compared with the limits."""
        own, wheel = map_scales(self.rover)
        maps = ground_maps(self.terrain, own if baseline_m is None else baseline_m, wheel, progress)
        return assess(self.terrain, maps, self.mobility)


@dataclass(frozen=True, slots=True, kw_only=True)
class PathRequest:
    """The path that is wanted: start pose, target with or without a heading, speed. [m, m, deg], [m/s]"""

    start: tuple[float, ...]
    target: tuple[float, ...] | None
    speed_m_s: float | None

    @classmethod
    def parse(cls, start: str, target: str | None, speed_m_s: float | None) -> "PathRequest":
        """From the text of the options."""
        place = None if target is None else _numbers("--target", target, (2, 3))
        return cls(start=_numbers("--start", start, (3,)), target=place, speed_m_s=speed_m_s)

    def plan(self, site: TerrainInputs, surface: Traversability, progress: Progress) -> PlannedPath | None:
        """The path, None without a target."""
        if self.target is None:
            return None
        x, y, *heading = self.target
        found = plan_path(
            surface,
            site.rover,
            (self.start[0], self.start[1], self.start[2]),
            (x, y),
            final_heading_deg=heading[0] if heading else None,
            speed_m_s=self.speed_m_s,
            limits=limits_of_rover(read_plan().limits, site.description, site.rover),
            name=f"path to x {x:g} m, y {y:g} m on {site.terrain.name}",
            progress=progress,
        )
        return replace(found, plan=replace(found.plan, made_for=site.made_for))


def read_site(
    terrain: str, rover: str, soil: str | None, ground: Mapping[str, Any], limits: Mapping[str, float | None]
) -> TerrainInputs:
    """Read or make the terrain, and read the rover with its limits."""
    given = {name: value for name, value in ground.items() if value is not None}
    for name in given:
        if name not in MAKERS.get(terrain, (None, ()))[1]:
            raise typer.BadParameter(f"{OPTION[name]} does not apply to {terrain}; leave it out")
    description = read_rover(rover)
    built, own_soil = build_rover(description), read_soil(soil or DEFAULT_SOIL)
    inputs: dict[str, str] = {} if terrain in MAKERS else {terrain: read_input(terrain).sha256}
    made = TerrainFile(MAKERS[terrain][0](own_soil, **given)) if terrain in MAKERS else None
    file = made or read_terrain_file(terrain, own_soil)
    laid, driven = lay_soil_on(file, terrain, own_soil, soil or DEFAULT_SOIL, asked=soil is not None)
    unused = driven.of == "terrain" and not driven.rest
    used, tables = ({}, {}) if unused else soil_hash(soil or DEFAULT_SOIL)
    check = RoverCheck(description, built, asked=True)
    check.terrain(file.made_for, terrain)
    check.soil(driven, terrain)
    return TerrainInputs(
        terrain=laid,
        rover=built,
        description=description,
        mobility=read_mobility(description, built).with_limits(**limits),
        inputs=inputs | used,
        tables=tables | {f"{rover} (rover)": sha256(description.text.encode())},
        seed=given.get("seed"),
        rocks=bool(given.get("rock_share")),
        driven=driven,
        check=check,
    )


def _numbers(option: str, text: str, counts: tuple[int, ...]) -> tuple[float, ...]:
    try:
        numbers = tuple(float(part) for part in text.split(","))
    except ValueError:
        numbers = ()
    if len(numbers) not in counts:
        wanted = " or ".join(",".join(("X", "Y", "HEADING")[:count]) for count in counts)
        raise typer.BadParameter(f"{option} '{text}' is not {wanted}, numbers with commas between them")
    return numbers


def terrain_report(site: TerrainInputs, surface: Traversability, path: PlannedPath | None, *, geotiff: bool) -> Report:
    """The report of `twin terrain`."""
    files: dict[str, Callable[[], bytes]] = {
        "terrain.npz": lambda: terrain_bytes(site.terrain, made_for=site.made_for),
        "maps.npz": lambda: maps_bytes(surface),
    }
    if geotiff:
        files["maps.tif"] = lambda: maps_geotiff(surface)
    if path is not None:
        files["plan.toml"] = lambda: plan_text(path.plan).encode()
        files["path.csv"] = lambda: csv_bytes(path_table(path, surface))

    def figures() -> "list[Figure]":
        from lunarsci.twin.figures.terrain_maps import terrain_maps

        return [terrain_maps(surface, path)]

    result = _result(site, surface, path)
    return Report(
        schema="twin-terrain/1",
        result=result,
        tables=[_ground_table(site, surface, result), *([] if path is None else [_path_table(path, surface)])],
        rows=[{"quantity": name, **values} for name, values in result["maps"].items()],
        figures=figures,
        inputs=site.inputs,
        data_tables=site.tables,
        sources=[*SOURCES, *(ROCK_SOURCES if site.rocks else [])],
        seed=site.seed,
        files=files,
        options={"soil": site.driven.name} if site.driven.of == "default" else {},
    )


def _result(site: TerrainInputs, surface: Traversability, path: PlannedPath | None) -> dict[str, Any]:
    terrain, mobility = site.terrain, site.mobility
    hazard, unknown = float(surface.hazard.mean()), float(surface.unknown.mean())
    limits = {name: getattr(mobility, name) for name in _limit_names()}
    return {
        "terrain": {
            "name": terrain.name,
            "synthetic": terrain.synthetic,
            "x_m": [terrain.x_m[0], terrain.x_m[-1]],
            "y_m": [terrain.y_m[0], terrain.y_m[-1]],
            "spacing_m": terrain.spacing_m,
            "nodes": [terrain.height_m.shape[1], terrain.height_m.shape[0]],
            "height_m": [np.nanmin(terrain.height_m), np.nanmax(terrain.height_m)],
            "hole_share": float(np.isnan(terrain.height_m).mean()),
        },
        "rover": site.description.name,
        "made_for": site.check.made_for,
        "soil": soil_record(site.driven, terrain),
        "baseline_m": surface.maps.baseline_m,
        "wheel_window_m": surface.maps.wheel_window_m,
        "maps": _spreads(surface.maps),
        "limits": {name: {"value": value, "assumed": name in mobility.assumed} for name, value in limits.items()},
        "traversable_share": 1.0 - hazard - unknown,
        "hazard_share": hazard,
        "unknown_share": unknown,
        "path": None if path is None else _path_result(path),
        "notes": _notes(site, surface),
    }


def _limit_names() -> tuple[str, ...]:
    return ("max_slope_deg", "max_step_m", "max_roughness_m", "min_turning_radius_m", "hazard_distance_m")


def _spreads(maps: GroundMaps) -> dict[str, dict[str, float | None]]:
    return {name: _spread(getattr(maps, name)) for name in ("slope_deg", "roughness_m", "step_m")}


def _spread(values: npt.NDArray[np.float32]) -> dict[str, float | None]:
    known = values[~np.isnan(values)]
    names = ("p5", "p50", "p95", "max")
    if not known.size:
        return dict.fromkeys(names)
    return dict(zip(names, np.percentile(known, (5, 50, 95, 100)).tolist(), strict=True))


def _path_result(path: PlannedPath) -> dict[str, Any]:
    end = path.end
    return {
        "arcs": [{"length_m": arc.length_m, "curvature_per_m": arc.curvature_per_m} for arc in path.plan.legs],
        "start": {"x_m": path.plan.x_m, "y_m": path.plan.y_m, "heading_deg": path.plan.heading_deg},
        "target": {"x_m": path.target_m[0], "y_m": path.target_m[1]},
        "end": {"x_m": end[0], "y_m": end[1], "heading_deg": float(np.degrees(end[2]))},
        "miss_m": path.miss_m,
        "length_m": path.plan.length_m,
        "speed_m_s": path.plan.speed_m_s,
        "cost_m": path.cost_m,
        "min_hazard_distance_m": path.min_hazard_distance_m,
        "max_slope_deg": path.max_slope_deg,
        "max_slope_on_path_deg": path.max_slope_on_path_deg,
        "max_step_m": path.max_step_m,
        "max_roughness_m": path.max_roughness_m,
        "max_curvature_per_m": path.max_curvature_per_m,
    }


def _notes(site: TerrainInputs, surface: Traversability) -> list[str]:
    notes = [UNSEEN, *site.check.remarks]
    if site.terrain.synthetic:
        notes.append("the terrain is synthetic; this says nothing about a real site")
    if site.mobility.assumed:
        notes.append(f"assumed limits: {', '.join(site.mobility.assumed)}")
    if surface.maps.baseline_m > 1.5 * map_scales(site.rover)[0]:
        notes.append(
            f"the grid is coarse for this rover: slope is that of squares of {surface.maps.baseline_m:g} m, and a step "
            f"that of {surface.maps.wheel_window_m:g} m"
        )
    return notes


def _ground_table(site: TerrainInputs, surface: Traversability, result: Mapping[str, Any]) -> TextTable:
    terrain, limits = result["terrain"], site.mobility
    unlimited = {"slope_deg": limits.max_slope_deg, "roughness_m": limits.max_roughness_m, "step_m": limits.max_step_m}
    rows = []
    for name, spread in result["maps"].items():
        limit = unlimited[name]
        cells = ["-" if value is None else f"{value:.4g}" for value in spread.values()]
        rows.append([name, *cells, "-" if limit is None else f"{limit:g}"])
    nx, ny = terrain["nodes"]
    title = (
        f"{terrain['name']}: x {terrain['x_m'][0]:g} to {terrain['x_m'][1]:g} m, y {terrain['y_m'][0]:g} to "
        f"{terrain['y_m'][1]:g} m, {nx} x {ny} nodes every {terrain['spacing_m']:g} m"
    )
    notes = [
        f"heights {terrain['height_m'][0]:.3f} to {terrain['height_m'][1]:.3f} m, holes {terrain['hole_share']:.1%}",
        f"may be driven on: {result['traversable_share']:.1%}; hazards {result['hazard_share']:.1%}; "
        f"unknown, near holes or the edge, {result['unknown_share']:.1%}",
        f"slope and roughness under {surface.maps.baseline_m:g} m x {surface.maps.baseline_m:g} m, steps within "
        f"{surface.maps.wheel_window_m:g} m",
        *result["notes"],
    ]
    return TextTable(["map", "p5", "p50", "p95", "max", "limit"], rows, title=title, notes=notes)


def _path_table(path: PlannedPath, surface: Traversability) -> TextTable:
    rows = [
        [str(number), f"{arc.length_m:.3f}", f"{arc.curvature_per_m:.4f}", _radius(arc.curvature_per_m)]
        for number, arc in enumerate(path.plan.legs, start=1)
    ]
    end, limits = path.end, surface.mobility
    notes = [
        f"{path.plan.length_m:.3f} m long, ends at x {end[0]:.3f} m, y {end[1]:.3f} m, "
        f"heading {np.degrees(end[2]):.1f} deg, {1e3 * path.miss_m:.1f} mm from the target",
        f"under the footprint: slope {path.max_slope_deg:.2f} of {limits.max_slope_deg:g} deg, step "
        f"{path.max_step_m:.3f} of {limits.max_step_m:g} m; nearest hazard {path.min_hazard_distance_m:.2f} m, "
        f"{limits.hazard_distance_m:g} m to be kept",
    ]
    return TextTable(["arc", "length [m]", "curvature [1/m]", "radius [m]"], rows, title=path.plan.name, notes=notes)


def _radius(curvature_per_m: float) -> str:
    return f"{1.0 / abs(curvature_per_m):.2f}" if abs(curvature_per_m) > 1e-4 else "-"
