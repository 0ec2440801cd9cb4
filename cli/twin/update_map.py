"""Soil by place in `twin update`: the map before a drive, its zones, the map after it, and how they are shown."""

import dataclasses
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from lunarsci.inputs import read_input
from lunarsci.regolith.prior import PARAMETERS
from lunarsci.twin.assimilation.drive_record import DriveRecord
from lunarsci.twin.assimilation.segments import Segment, SoilChange, drive_segments, find_change
from lunarsci.twin.assimilation.update import SoilUpdate
from lunarsci.twin.ground.soil_layers import soil_layers
from lunarsci.twin.ground.soil_map import SoilMap, Zone, read_soil_map, soil_map_bytes
from lunarsci.twin.ground.terrain_files import terrain_bytes
from lunarsci.twin.jobs.drive_inputs import DriveInputs

from ..shared.table import TextTable

if TYPE_CHECKING:
    from matplotlib.figure import Figure

__all__ = [
    "MapFiles",
    "MapUpdate",
    "change_rows",
    "found_changes",
    "map_extras",
    "map_pages",
    "map_result",
    "read_map_before",
    "zone_tables",
    "zoned",
]

Entry = Callable[[SoilUpdate], Mapping[str, Any]]


@dataclass(frozen=True, slots=True)
class MapFiles:
    """The options about soil by place: map before, map after, terrain with layers, correlation length."""

    before: str | None = None
    after: Path | None = None
    terrain: Path | None = None
    correlation_m: float | None = None

    @property
    def wanted(self) -> bool:
        """Whether the soil is to be kept by place."""
        return not (self.before is None and self.after is None and self.terrain is None)


@dataclass(frozen=True, slots=True, eq=False)
class MapUpdate:
    """Zones of a drive, changes between them, and the map with them."""

    zones: list[Segment]
    changes: list[SoilChange]
    after: SoilMap

    @property
    def learned(self) -> bool:
        """Whether any zone moved its belief."""
        return any(zone.learned for zone in self.zones)


def read_map_before(files: MapFiles, scene: DriveInputs) -> SoilMap | None:
    """The map before the drive, one of the first laws alone where none is named; None where no map is wanted."""
    if not files.wanted:
        return None
    soil_map = SoilMap(reach_m=_reach_m(scene))
    if files.before is not None:
        source = read_input(files.before)
        scene.inputs[files.before] = source.sha256
        soil_map = read_soil_map(source)
    if files.correlation_m is None:
        return soil_map
    return dataclasses.replace(soil_map, correlation_m=files.correlation_m)


def _reach_m(scene: DriveInputs) -> float:
    """From the middle of the track to the outer edge of its wheels."""
    across = abs(scene.rover.wheel_positions_m[:, 1]).max()
    return round(float(across + 0.5 * scene.rover.wheel.width_m), 3)


def found_changes(record: DriveRecord, found: SoilUpdate, seed: int) -> list[SoilChange]:
    """The clearest change of a drive, if there is one."""
    change = find_change(record, found, seed=seed)
    return [] if change is None else [change]


def zoned(
    scene: DriveInputs,
    record: DriveRecord,
    found: SoilUpdate,
    before: SoilMap,
    forget: float,
    entry: Entry,
    particles: int,
    seed: int,
    progress: Callable[[int, int], None],
) -> MapUpdate:
    """The map after the drive; `entry` makes the line of history of a zone."""
    zones, changes = drive_segments(
        scene.rover,
        scene.terrain,
        scene.plan,
        record,
        found,
        lambda places: before.belief_along(places).forgotten(forget),
        particles=particles,
        seed=seed,
        progress=progress,
    )
    kept = [_named(scene, zone, entry) for zone in zones if zone.learned]
    return MapUpdate(zones, changes, before.with_zones(kept))


def _named(scene: DriveInputs, zone: Segment, entry: Entry) -> Zone:
    line = dict(entry(zone.found)) if zone.found else {}
    line |= {"from_m": round(zone.from_m, 3), "to_m": round(zone.to_m, 3)}
    belief = dataclasses.replace(zone.belief, history=(*zone.before.history, line))
    name = f"{scene.plan.name}, {zone.from_m:.1f} to {zone.to_m:.1f} m"
    return Zone(name=name, place_m=zone.place_m, belief=belief)


def change_rows(changes: list[SoilChange]) -> list[dict[str, Any]]:
    """For the JSON result."""
    return [dataclasses.asdict(change) | {"text": change.text} for change in changes]


def map_result(update: MapUpdate) -> dict[str, Any]:
    """For the JSON result."""
    rows = [
        {
            "from_m": zone.from_m,
            "to_m": zone.to_m,
            "learned": zone.learned,
            "why_not": zone.why_not or None,
            "surprise": zone.found.prior_shift if zone.found else None,
            "parameters": {
                name: {"median": m, "low": low, "high": high, "left_of_prior": zone.belief.left_of_prior[name]}
                for name, (m, low, high) in zone.belief.intervals().items()
            },
        }
        for zone in update.zones
    ]
    return {"zones": rows, "map": {"zones": len(update.after.zones), "correlation_m": update.after.correlation_m}}


def zone_tables(update: MapUpdate) -> list[TextTable]:
    """Zones side by side, for people; nothing where the drive is one zone."""
    if len(update.zones) < 2:
        return []
    headers = ["parameter", *(f"{zone.from_m:.1f} to {zone.to_m:.1f} m" for zone in update.zones)]
    cells = [
        {name: f"{row[0]:.4g} ({100 * zone.belief.left_of_prior[name]:.0f} %)" for name, row in rows.items()}
        for zone in update.zones
        for rows in (zone.belief.intervals(),)
    ]
    rows = [[name, *(column[name] for column in cells)] for name in PARAMETERS]
    notes = [
        f"{zone.from_m:.1f} to {zone.to_m:.1f} m: stays at what was believed: {zone.why_not}"
        for zone in update.zones
        if not zone.learned
    ]
    title = "Soil of each stretch of the way: median, and in brackets what is left of the prior's spread"
    return [TextTable(headers, rows, title=title, notes=notes)]


def map_extras(files: MapFiles, update: MapUpdate, scene: DriveInputs) -> dict[Path, Callable[[], bytes]]:
    """The files that were asked for."""
    extras: dict[Path, Callable[[], bytes]] = {}
    if files.after is not None:
        extras[files.after] = lambda: soil_map_bytes(update.after)
    if files.terrain is not None:
        extras[files.terrain] = lambda: _layer_bytes(update.after, scene)
    return extras


def _layer_bytes(soil_map: SoilMap, scene: DriveInputs) -> bytes:
    layers = soil_layers(soil_map, scene.terrain)
    return terrain_bytes(layers.terrain, left_of_prior=layers.left_of_prior)


def map_pages(update: MapUpdate, scene: DriveInputs) -> "Iterator[Figure]":
    """Median soil at every node, and what is left of the prior."""
    from lunarsci.twin.figures.soil_layers import soil_pages

    yield from soil_pages(soil_layers(update.after, scene.terrain), update.after)
