"""Maps of a terrain, and where a rover may drive."""

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any, ClassVar

from lunarsci.errors import ParameterError, RequestError, within_option
from lunarsci.heights import TERRAINS
from lunarsci.heights.grid import layers_on
from lunarsci.heights.projections import lonlat_of, projection_notes
from lunarsci.io.inputs import read_input
from lunarsci.io.tables import csv_bytes
from lunarsci.options import request_of
from lunarsci.provenance import sha256
from lunarsci.regolith.soil import read_soil, soil_hash
from lunarsci.result import MadeFrom, Progress, Result
from lunarsci.rovers import DEFAULT_ROVER, MadeFor, RoverDescription, made_for, read_rover
from lunarsci.twin.ground import synthetic
from lunarsci.twin.ground.driven_soil import DEFAULT_SOIL, DrivenSoil, lay_soil_on, soil_record
from lunarsci.twin.ground.hazards import (
    CostLayer,
    Mobility,
    Traversability,
    Zones,
    assess,
    ground_maps,
    map_layers,
    map_scales,
    maps_bytes,
    maps_geotiff,
    parse_classes,
    parse_cost,
    read_cost_layer,
    read_keep_outs,
    read_mobility,
    shadow_layer,
)
from lunarsci.twin.ground.illumination import sunlit
from lunarsci.twin.ground.terrain import Terrain, TerrainFile, read_terrain_file, terrain_bytes
from lunarsci.twin.jobs.drive_inputs import SYNTHETIC, on_gravity
from lunarsci.twin.jobs.requests import MAKERS, GroundRequest, TerrainRequest
from lunarsci.twin.plans.made_for_check import MadeForCheck
from lunarsci.twin.plans.plan import plan_text
from lunarsci.twin.routes.planner import PlannedPath, path_geojson, path_table, share_on
from lunarsci.twin.rover import Rover, build_rover, check_turning

if TYPE_CHECKING:
    from matplotlib.figure import Figure


SOURCES = [
    "Goldberg, Maimone & Matthies (2002), IEEE Aerospace Conf., 10.1109/AERO.2002.1035370",
    "Ding et al. (2024), Nat. Commun. 15, 2098, 10.1038/s41467-024-46233-8",
]
ROCK_SOURCES = [
    "Golombek & Rapp (1997), J. Geophys. Res. 102, 4117, 10.1029/96JE03319",
    "Di et al. (2016), Planet. Space Sci. 120, 103, 10.1016/j.pss.2015.11.012",
    "Wu et al. (2021), Earth Planet. Sci. Lett. 553, 116666",
]
LIMITS = ("max_slope_deg", "max_step_m", "max_roughness_m", "min_turning_radius_m", "hazard_distance_m")
UNSEEN = "the terrain lacks rocks and edges smaller than two spacings of its grid"


def light_of(request: GroundRequest) -> tuple[tuple[float, float] | None, float | None]:
    """Direction of the Sun [deg, deg] and the factor on the cost of a metre in shadow. Raises RequestError."""
    if request.sun is None:
        if request.shadow_cost is not None:
            raise RequestError("`shadow_cost` needs the Sun; give `sun` AZIMUTH,ELEVATION, too")
        return None, None
    try:
        azimuth, elevation = (float(part) for part in request.sun.split(","))
    except ValueError as error:
        raise RequestError(f"`sun` '{request.sun}' is not AZIMUTH,ELEVATION in deg") from error
    with within_option("shadow_cost"):
        return (azimuth, elevation), None if request.shadow_cost is None else parse_cost(request.shadow_cost)


def costs_of(request: GroundRequest) -> dict[float, float]:
    """Costs by class of ground. Raises RequestError."""
    if request.classes and not request.layer:
        raise RequestError("classes are those of a layer; give `layer`, too")
    try:
        return parse_classes(request.classes)
    except ParameterError as error:
        raise RequestError(f"classes of a `layer`: {error}") from error


PLANS = ("plan", "plans", "before", "limits")
"""Inputs of jobs that are plans, by their names."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class SurveyedSite:
    """A terrain, and the rover in mind.

    Attributes
    ----------
    terrain : heights as the wheels are taken to meet them, with the soil that is driven on.
    rover, description, mobility : the rover, its file as it was read, and the limits of where it may drive.
    inputs, tables : SHA-256 of the files that were read, and of the project's own tables, by name.
    made : how the ground was made, where it is synthetic; else empty.
    driven : where the soil comes from.
    check : what was noted of files that were made for another rover.
    file : the terrain as its file has it.
    origin : how to ask for the terrain.
    keep_outs : circles to keep out of.
    layers : factors on the cost of a metre, by place.
    sun_deg : azimuth and elevation of the Sun; None without light. [deg]
    shadow_cost : factor on the cost of a metre in shadow, infinite where it is forbidden; None where it does not count.
    """

    terrain: Terrain
    rover: Rover
    description: RoverDescription
    mobility: Mobility
    inputs: dict[str, str]
    tables: dict[str, str]
    made: Mapping[str, Any]
    driven: DrivenSoil
    check: MadeForCheck
    file: TerrainFile
    origin: str
    keep_outs: Zones = ()
    layers: tuple[CostLayer, ...] = ()
    sun_deg: tuple[float, float] | None = None
    shadow_cost: float | None = None

    @property
    def made_for(self) -> MadeFor:
        """The rover and the limits, for what is written."""
        return made_for(self.description, {name: getattr(self.mobility, name) for name in LIMITS})

    def surface(self, baseline_m: float | None, progress: Progress | None) -> Traversability:
        """The maps, compared with the limits."""
        baseline, wheel = map_scales(self.rover)
        maps = ground_maps(self.terrain, baseline if baseline_m is None else baseline_m, wheel, progress)
        if self.sun_deg is None:
            return assess(self.terrain, maps, self.mobility, self.keep_outs, self.layers)

        lit = sunlit(self.terrain, *self.sun_deg)
        shadow = () if self.shadow_cost is None else (shadow_layer(lit, self.shadow_cost),)
        return replace(assess(self.terrain, maps, self.mobility, self.keep_outs, (*self.layers, *shadow)), sunlit=lit)

    def content(self) -> bytes:
        """The terrain with the heights and errors of its file, and the soil and the rover that it was looked at for."""
        as_read = replace(self.terrain, height_m=self.file.terrain.height_m)
        return terrain_bytes(as_read, made_for=self.made_for, errors=self.file.errors)

    def about(self) -> dict[str, Any]:
        """Terrain, rover, soil and limits, for a result."""
        return {
            "terrain": self.terrain.summary(),
            **self.check.how_read,
            "rover": self.description.name,
            "made_for": self.check.made_for,
            "soil": soil_record(self.driven, self.terrain),
            "limits": {n: {"value": getattr(self.mobility, n), "assumed": n in self.mobility.assumed} for n in LIMITS},
        }


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class TerrainSurvey(Result):
    """A terrain with its maps, and a path on it where one was planned."""

    schema: ClassVar[str] = "twin-terrain/1"
    site: SurveyedSite
    surface: Traversability
    path: PlannedPath | None = None
    checked: Sequence[Mapping[str, Any]] = ()

    @property
    def made_from(self) -> MadeFrom:
        return self._made_from()

    def _made_from(self) -> MadeFrom:
        site = self.site
        sources = [*SOURCES, *(ROCK_SOURCES if site.made.get("rock_share") else [])]
        soil = {"soil": site.driven.name} if site.driven.of == "default" else {}
        options, seed = {"rover": site.description.origin, "terrain": site.origin} | soil, site.made.get("seed")
        return MadeFrom(inputs=site.inputs, tables=site.tables, sources=sources, seed=seed, options=options)

    def to_dict(self) -> dict[str, Any]:
        surface = self.surface
        hazard, unknown = float(surface.hazard.mean()), float(surface.unknown.mean())
        return {
            **self.site.about(),
            "baseline_m": surface.maps.baseline_m,
            "wheel_window_m": surface.maps.wheel_window_m,
            "maps": surface.maps.spreads(),
            "traversable_share": 1.0 - hazard - unknown,
            "hazard_share": hazard,
            "unknown_share": unknown,
            "path": None if self.path is None else self._path_record(self.path),
            **self.light(),
            "notes": self.notes(),
        }

    def _path_record(self, path: PlannedPath) -> dict[str, Any]:
        """The path, its ends also by longitude and latitude where the terrain has a coordinate system."""
        record = path.to_dict() | ({"checked": list(self.checked)} if self.checked else {})
        for end in ("start", "target", "end"):
            record[end] |= lonlat_of(self.site.terrain.crs, (record[end]["x_m"], record[end]["y_m"]))
        return record

    def light(self) -> dict[str, Any]:
        """Shares of the ground and of the path that the Sun reaches, where its direction is given."""
        lit, sun = self.surface.sunlit, self.site.sun_deg
        if lit is None or sun is None:
            return {}

        return {
            "sun": {
                "azimuth_deg": sun[0],
                "elevation_deg": sun[1],
                "shadow_share": float(1.0 - lit.mean()),
                "path_shadow_share": None if self.path is None else 1.0 - share_on(lit, self.path, self.surface),
            }
        }

    def rows(self) -> Sequence[Mapping[str, Any]]:
        return [{"quantity": name, **values} for name, values in self.surface.maps.spreads().items()]

    def as_input(self, role: str) -> dict[str, Callable[[], bytes]]:
        """Of a plan the plan, else the terrain. Raises RequestError where no plan was made, or several."""
        files, name = self.files(), "plan.toml" if role in PLANS else "terrain.npz" if role in TERRAINS else ""
        if name and name not in files:
            raise RequestError(
                f"`{role}`: the result has not one plan; plan with a `target`, or give one of its files()"
            )
        return {name: files[name]} if name else {}

    def layers(self) -> dict[str, Any]:
        ground = self.surface.terrain
        return layers_on(ground.x_m, ground.y_m, {"height_m": ground.height_m, **map_layers(self.surface)})

    def figures(self) -> "Iterator[Figure]":
        from lunarsci.twin.figures.maps import terrain_maps

        yield terrain_maps(self.surface, self.path)

    def files(self, *, geotiff: bool = False) -> dict[str, Callable[[], bytes]]:
        """Terrain, maps, and a path as plan and table: name to what makes the content."""
        site, path = self.site, self.path
        contents: dict[str, Callable[[], bytes]] = {
            "terrain.npz": site.content,
            "maps.npz": lambda: maps_bytes(self.surface),
        }
        if geotiff:
            contents["maps.tif"] = lambda: maps_geotiff(self.surface)
        if path is not None:
            contents["plan.toml"] = lambda: plan_text(path.plan).encode()
            contents["path.geojson"] = lambda: path_geojson(path, self.surface)
            contents["path.csv"] = lambda: csv_bytes(path_table(path, self.surface))
        return contents

    def notes(self) -> list[str]:
        """What there is to say about terrain, limits and grid."""
        site, maps = self.site, self.surface.maps
        notes = [UNSEEN, *site.check.read_as, *site.check.remarks]
        if site.terrain.synthetic:
            notes.append("the terrain is synthetic; this says nothing about a real site")
        notes += projection_notes(site.terrain.crs, site.terrain.x_m, site.terrain.y_m)
        if site.file.states_errors:
            notes.append("heights have errors: looked at is the likely ground, without the roughness of errors")
        if site.keep_outs:
            notes.append(f"ground to keep out of counts as hazards: {len(site.keep_outs)} circles")
        notes += [
            f"layer {layer.name}: {layer.covered_share:.1%} of the terrain, {layer.forbidden.mean():.1%} forbidden"
            for layer in site.layers
        ]
        if site.mobility.assumed:
            notes.append(f"assumed limits: {', '.join(site.mobility.assumed)}")
        if maps.baseline_m > 1.5 * map_scales(site.rover)[0]:
            notes.append(f"the grid is coarse for this rover: slope is that of squares of {maps.baseline_m:g} m")
        if not maps.shows_steps:
            notes.append("steps are not determined: the grid is too coarse to show what a wheel climbs")
        return notes


def terrain(
    terrain: str = "synthetic-longji",
    request: TerrainRequest | None = None,
    *,
    progress: Progress | None = None,
    **options: Any,
) -> TerrainSurvey:
    """Maps of slope, roughness and step height of a terrain, and where a rover may drive.

    `terrain` is a file, or `synthetic-longji` or `synthetic`. Raises DataError and RequestError.
    """
    asked = request_of(TerrainRequest, request, options)
    site = read_site(terrain, asked, asked.soil, asked.limits_of_ground())
    return TerrainSurvey(site=site, surface=site.surface(asked.baseline, progress))


def read_site(
    named: str | None, asked: GroundRequest, soil: str | None, limits: Mapping[str, float | None], onto: str = ""
) -> SurveyedSite:
    """Read or make the terrain (`synthetic-longji` if None), a raster in the system `onto`, with soil and limits."""
    terrain, name = named or SYNTHETIC, soil or DEFAULT_SOIL
    description, made = read_rover(asked.rover or DEFAULT_ROVER), asked.made(terrain)
    built, named_soil = on_gravity(build_rover(description), asked.gravity), read_soil(name)
    check_turning(built, limits.get("min_turning_radius_m"))
    if terrain in MAKERS:
        make = synthetic.synthetic_longji if terrain == SYNTHETIC else synthetic.synthetic_terrain
        file, inputs = TerrainFile(make(named_soil, **made)), {}
    else:
        inputs = {terrain: read_input(terrain).sha256}
        file = read_terrain_file(terrain, named_soil, asked.height_unit, onto=onto)
    laid, driven = lay_soil_on(file, terrain, named_soil, name, asked=soil is not None)
    (sun, shadow_cost), costs = light_of(asked), costs_of(asked)
    layers = tuple(read_cost_layer(path, laid, costs) for path in asked.layer)
    inputs |= {path: read_input(path).sha256 for path in (*asked.keep_out, *asked.input_files())}
    used, tables = ({}, {}) if driven.of == "terrain" and not driven.rest else soil_hash(name)
    check = MadeForCheck(description, built, asked.rover is not None, laid, named is not None, file.read_as)
    check.note("terrain", file.made_for, terrain)
    check.soil(driven, terrain)
    mobility = read_mobility(description, built).with_limits(**limits)
    return SurveyedSite(
        terrain=file.likely(laid),
        rover=built,
        description=description,
        mobility=mobility,
        inputs=inputs | file.hashes_beside | used,
        tables=tables | {f"{description.origin} (rover)": sha256(description.text.encode())},
        made=made,
        driven=driven,
        check=check,
        file=file,
        origin=terrain,
        keep_outs=tuple(
            zone for path in asked.keep_out for zone in read_keep_outs(read_input(path), laid.crs, mobility.max_step_m)
        ),
        layers=layers,
        sun_deg=sun,
        shadow_cost=shadow_cost,
    )
