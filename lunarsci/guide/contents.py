"""What is in a file of each kind, by the readers that the commands use."""

import re
import warnings
from collections.abc import Callable, Mapping
from typing import TYPE_CHECKING, Any

from lunarsci.errors import DataError, LunarSciWarning
from lunarsci.guide.rover_files import camera_contents
from lunarsci.io.documents import toml_document
from lunarsci.io.inputs import InputFile, InputStream, read_json, text
from lunarsci.names import some_of

if TYPE_CHECKING:
    from lunarsci.rovers import RoverDescription

LARGEST_WHEEL = "lrv"
"""Whose radius no sinkage passes, where the rover is not known."""
WHEEL_ALONE = "a wheel alone"
M3_HOLDS = {"LOC": "longitude, latitude and radius of each pixel", "OBS": "angles and distances of each pixel"}
"""Images of M3 that lie beside its spectra."""
MOST = 6
"""Names that are listed."""
LIKE = {
    r"rpm|heading|yaw|odomet|encoder|^[fmr][lr]_": "could be telemetry; `twin states` wants the columns of "
    "`lunarsci template telemetry`",
    r"slip|sink|drawbar|pull|torque|load|force|(^|_)f[xyz]($|_)": "could be wheel states; `regolith infer` wants "
    "sinkage_m, normal_force_n, drawbar_pull_n, and slip_ratio, see `lunarsci template states`",
}
"""Columns, two or more, that tell what a table of another kind could be."""


def _listed(names: Any) -> str:
    return some_of([str(name) for name in names], MOST)


def _spectra(file: InputFile) -> Mapping[str, Any]:
    from lunarsci.spectra.readers.dispatch import read_spectra

    rows = read_spectra(file)
    first = rows[0]
    return {
        "spectra": len(rows),
        "names": _listed(one.id for one in rows[:100]),
        "channels": len(first.wavelength_nm),
        "from_nm": float(first.wavelength_nm[0]),
        "to_nm": float(first.wavelength_nm[-1]),
        "errors": first.uncertainty is not None,
    }


def _cube(file: InputFile) -> Mapping[str, Any]:
    from lunarsci.spectra.cubes.flat import M3_NAME
    from lunarsci.spectra.cubes.pds import open_pds
    from lunarsci.spectra.readers.pds_label import is_pds_label, read_pds_label

    if not is_pds_label(file):
        m3 = M3_NAME.search(file.name)
        if m3 and m3[2].upper() in ("RDN", "L1B"):
            raise DataError(f"{file.name}: radiance of M3, no reflectance; the _RFL.IMG of Level 2 has that")
        holds = M3_HOLDS.get(m3[2].upper(), "") if m3 else ""
        return {"bytes": len(file.data)} | ({"holds": holds} if holds else {})
    images = read_pds_label(file).images
    open_pds(file.name)
    return {one.file: f"{one.lines} lines, {one.samples} samples, {one.bands} bands"
            f"{f' in {one.unit}' if one.unit else ''}" for one in images}  # fmt: skip


def _craters(file: InputFile) -> Mapping[str, Any]:
    from lunarsci.spectra.origin.catalogue import read_catalogue

    craters = read_catalogue(file)
    return {"craters": len(craters), "names": _listed(crater.name for crater in craters)}


def _plan(file: InputFile) -> Mapping[str, Any]:
    from lunarsci.twin.plans.made_for_check import LIMITS_RULE
    from lunarsci.twin.plans.plan import read_plan

    plan = read_plan(file)
    return {
        "name": plan.name,
        "legs": len(plan.legs),
        "length_m": plan.length_m,
        "speed_m_s": plan.speed_m_s,
        "limits": "its own" if plan.own_limits else f"those of the rover that drives it: {LIMITS_RULE}",
        "sweeps": _listed(sweep.name for sweep in plan.sweep) or "none",
        "made for": "any rover" if plan.made_for is None else plan.made_for.name,
    }


def _mission(file: InputFile) -> Mapping[str, Any]:
    from lunarsci.twin.mission.mission import read_mission

    mission = read_mission(file)
    return {
        "name": mission.name,
        "targets": _listed(target.name for target in mission.targets),
        "keep-out circles": len(mission.keep_outs),
        "hours of communication": len(mission.windows),
    }


def _rover(file: InputFile) -> Mapping[str, Any]:
    from lunarsci.regolith.wheel import left_to_defaults, read_wheel
    from lunarsci.rovers import read_rover
    from lunarsci.twin.rover import build_rover

    description = read_rover(file.name)
    wheel = read_wheel(description)
    told = {"name": description.name, "wheel radius_m": wheel.radius_m, "wheel width_m": wheel.width_m}
    left = left_to_defaults(description)
    keys = [*description.assumed, *left]
    parts = dict.fromkeys(key.partition(".")[0] for key in keys)
    named = _listed(keys) if len(keys) <= MOST else f"of {', '.join(parts)}"
    told |= {"assumed numbers": f"{len(keys)}: {named}" if keys else 0}
    if left:
        told["taken as usual, for want of a number"] = ", ".join(f"{key} {getattr(wheel, key):g}" for key in left)
    if "suspension" not in description.tables:
        return told | {"parts": WHEEL_ALONE}
    rover = build_rover(description)
    told |= {"mass_kg": rover.mass_kg, "wheels": _listed(rover.wheels), "max_speed_m_s": rover.max_speed_m_s}
    return told | _as_in_template(description)


def _as_in_template(rover: "RoverDescription") -> dict[str, str]:
    """Numbers that a template had and that nobody replaced, by their table; none where all are."""
    from lunarsci.rovers import known_rovers, read_rover

    numbers = {f"{name}.{key}": value for name, table in rover.tables.items() for key, value in table.items()}
    numbers = {key: value for key, value in numbers.items() if _is_numeric(value)}
    asked = dict[str, list[str]]()
    for key, of in rover.left.items():
        table, _, name = key.partition(".")
        known = read_rover(of).tables.get(table, {}) if of in known_rovers() else {}
        if key in numbers and numbers[key] == known.get(name):
            asked.setdefault(f"[{table}] as of {of}", []).append(name)
    if sum(map(len, asked.values())) == len(numbers):
        return {}
    whole = {title: len(keys) == sum(key.startswith(f"{title[1:].partition(']')[0]}.") for key in numbers)
             for title, keys in asked.items()}  # fmt: skip
    return {
        title: f"{'all' if whole[title] and len(keys) > 1 else ', '.join(keys)}: this rover's?"
        for title, keys in asked.items()
    }


def _is_numeric(value: Any) -> bool:
    parts = value if isinstance(value, list) else [value]
    return all(isinstance(part, int | float) and not isinstance(part, bool) for part in parts)


def _soil(file: InputFile) -> Mapping[str, Any]:
    import dataclasses

    from lunarsci.regolith.soil import read_soil

    return dataclasses.asdict(read_soil(file.name))


def _prior(file: InputFile) -> Mapping[str, Any]:
    from lunarsci.regolith.prior import UNITS, read_prior

    laws, given = read_prior(file, contact=True), toml_document(text(file))
    return {name: f"{laws[name].median:g} {UNITS[name]}, {laws[name].of} ± {laws[name].sd:g}" for name in given}


def _pose(file: InputFile) -> Mapping[str, Any]:
    from lunarsci.images.rig_files import read_pose

    pose = read_pose(file)
    return {"position_m": _listed(f"{value:g}" for value in pose.center_m), "heading_deg": pose.angles_deg()[0]}


def _rig(file: InputFile) -> Mapping[str, Any]:
    from lunarsci.images.rig_files import read_rig

    rig = read_rig(file)
    said = {"read as": "; ".join(rig.read_as)} if rig.read_as else {}
    return {"name": rig.name, "baseline_m": float(rig.baseline_m)} | said


def _terrain(file: InputFile) -> Mapping[str, Any]:
    import numpy as np

    from lunarsci.heights.grid import ERROR_LAYERS
    from lunarsci.heights.grids import read_grid
    from lunarsci.twin.ground.terrain import SOIL_COLUMNS

    soil = (*SOIL_COLUMNS, *(f"{one}_left_of_prior" for one in SOIL_COLUMNS))
    grid = read_grid(file.name, (), (*soil, *ERROR_LAYERS))
    known = grid.height_m[np.isfinite(grid.height_m)]
    ny, nx = grid.height_m.shape
    return {
        "name": grid.name,
        "nodes": f"{nx} x {ny}",
        "spacing_m": grid.spacing_m,
        "x_m": f"{grid.x0_m:g} to {grid.x0_m + (nx - 1) * grid.spacing_m:g}",
        "y_m": f"{grid.y0_m:g} to {grid.y0_m + (ny - 1) * grid.spacing_m:g}",
        "height_m": f"{known.min():.3f} to {known.max():.3f}",
        "holes": f"{1 - known.size / grid.height_m.size:.1%}",
        "coordinate system": "local" if not grid.crs else "projected",
        "read as": "; ".join(grid.read_as) or "as written",
    }


def _belief(file: InputFile) -> Mapping[str, Any]:
    from lunarsci.regolith.belief import read_belief

    belief = read_belief(file)
    medians = {name: f"{ends[0]:.4g}" for name, ends in belief.intervals().items()}
    return {"drives": len(belief.history)} | {f"median {name}": value for name, value in medians.items()}


def _soil_map(file: InputFile) -> Mapping[str, Any]:
    from lunarsci.twin.ground.soil_map import read_soil_map

    found = read_soil_map(file)
    return {"zones": len(found.zones), "correlation_m": found.correlation_m}


def _rows(file: InputFile) -> Mapping[str, Any]:
    from lunarsci.io.tables import read_csv_table

    table = read_csv_table(file)
    told: dict[str, Any] = {"rows": len(table), "columns": _listed(table.columns)}
    if "wheel" in table:
        told["wheels"] = _listed(dict.fromkeys(table["wheel"]))
    return told


def _other_table(file: InputFile) -> Mapping[str, Any]:
    """What `_rows` says; a remark where two columns or more tell what it could be meant for."""
    from lunarsci.io.tables import read_csv_table

    columns = [str(name) for name in read_csv_table(file).columns]
    for words, meant in LIKE.items():
        if len(found := [name for name in columns if re.search(words, name, re.IGNORECASE)]) > 1:
            warnings.warn(f"columns {', '.join(found[:4])}: {meant}", LunarSciWarning, stacklevel=2)
            break
    return _rows(file)


def _states(file: InputFile) -> Mapping[str, Any]:
    from lunarsci.regolith.states import read_state_table
    from lunarsci.regolith.wheel import read_wheel

    table = read_state_table(file, largest := read_wheel(LARGEST_WHEEL), any_wheel=True)
    said = {"read as": "; ".join(table.named.read_as)} if table.named.read_as else {}
    return said | {
        **_rows(file),
        "columns of no use": _listed(table.unused) or "none",
        "range checked for": f"wheels of up to {largest.radius_m:g} m",
    }


def _telemetry(file: InputFile | InputStream) -> Mapping[str, Any]:
    from lunarsci.twin.rover import build_rover
    from lunarsci.twin.telemetry.reading import Findings, read_telemetry
    from lunarsci.twin.telemetry.ros_columns import own_names

    names = file.data if isinstance(file, InputFile) else _ends(file)
    ros = own_names(names.partition(b"\n")[0].decode("utf-8", "replace").split(","))
    four = b"FL" in names and b"_ML_" not in names if not ros else "angle_ML_deg" not in ros
    rover = build_rover("small-four" if four else "yutu2")
    found = read_telemetry(file, rover, Findings(file.name))
    time = found.time_s
    return {
        "rows": found.rows,
        "from_s": float(time.min()),
        "to_s": float(time.max()),
        "wheels": _listed(rover.wheels),
        "synthetic": found.synthetic,
    }


def _ends(stream: InputStream, size: int = 1 << 16) -> bytes:
    """Begin and end of a file, where formats have the names of their columns."""
    start = stream.file.read(size)
    stream.file.seek(max(0, stream.file.seek(0, 2) - size))
    end = stream.file.read()
    stream.file.seek(0)
    return start + end


def _result(file: InputFile) -> Mapping[str, Any]:
    found = read_json(file, "a result", lambda value: value)
    record = found.get("provenance") or {}
    return {
        "schema": str(found["schema"]).removeprefix("lunarsci/"),
        "command": record.get("command"),
        "version": record.get("version"),
        "time_utc": record.get("time_utc"),
        "keys": _listed(found.get("result") or ()),
        "inputs": _listed(one.get("path") for one in record.get("inputs") or ()) or "none",
    }


CONTENTS: Mapping[str, Callable[[InputFile], Mapping[str, Any]]] = {
    "spectra": _spectra, "library": _spectra, "vnis": _spectra, "cube": _cube, "craters": _craters, "plan": _plan,
    "mission": _mission, "rover": _rover, "soil": _soil, "pose": _pose, "camera": camera_contents, "rig": _rig,
    "terrain": _terrain,
    "belief": _belief, "soil map": _soil_map, "telemetry": _telemetry, "states": _states, "slips": _states,
    "prior": _prior, "motion": _rows, "positions": _rows, "track": _rows, "soils": _rows, "table": _other_table,
    "result": _result,
}  # fmt: skip
"""What a reader says of a file, by its kind."""
