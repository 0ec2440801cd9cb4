"""Elevation models of several stations, or their pairs of pictures, as one map, and where they disagree."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any, ClassVar

import numpy as np

from lunarsci.arrays import SIGNIFICANCE
from lunarsci.errors import DataError, RequestError
from lunarsci.heights import TERRAINS
from lunarsci.images.camera import StereoRig
from lunarsci.images.elevation import (
    ElevationModel,
    MergedMap,
    StationPosition,
    elevation_bytes,
    elevation_geotiff,
    read_elevation,
)
from lunarsci.images.elevation import merge as merged_map
from lunarsci.images.gridding import Cloud, cloud_ply
from lunarsci.images.jobs.dem import farthest_ground_m
from lunarsci.images.jobs.locate import DeadReckoning, LocatedStations, read_stations
from lunarsci.images.jobs.requests import DemRequest, MergeRequest
from lunarsci.images.localisation import localise
from lunarsci.images.mosaic import Mosaic, Seam, mosaic
from lunarsci.images.rig_files import read_rig
from lunarsci.io.inputs import Ground, InputFile, read_input
from lunarsci.io.tables import numbers_of, read_csv_table
from lunarsci.options import request_of
from lunarsci.ranges import refuse
from lunarsci.result import Doubt, Figures, Result, job

SOURCES = [
    "Aitken (1936), Proc. R. Soc. Edinb. 55, 42, 10.1017/S0370164600014346: generalised least squares",
    "Huber (1964), Ann. Math. Stat. 35, 73, 10.1214/aoms/1177703732: robust weights",
]
NEEDED = ("x_m", "y_m", "z_m")
"""Columns of positions; a missing z_m is 0. [m]"""
ERRORS = ("xx_m2", "xy_m2", "yy_m2", "zz_m2")
"""Columns of their covariances, in the place of one `sigma_m`. [m2]"""
ODD, SHARE = 1.5, 0.05
"""Rms of z-scores, and share beyond three, from which models are said to disagree; assumed."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class MergedStations(Result):
    """One map of several stations.

    Attributes
    ----------
    names : files of the models, in the order given.
    models : of the stations, in that order, as they were read.
    merged : the map, with what each model is off by.
    inputs : SHA-256 of each file by its name.
    mosaic, located : of pairs, how they were adjusted and laid together; None of models.
    """

    schema: ClassVar[str] = "images-merge/1"
    sources = SOURCES
    names: tuple[str, ...]
    models: tuple[ElevationModel, ...]
    merged: MergedMap
    inputs: Mapping[str, str]
    mosaic: Mosaic | None = None
    located: LocatedStations | None = None

    @property
    def doubt(self) -> Doubt:
        if self.mosaic is not None and self.located is not None:
            steps = self.mosaic.steps
            uneven = [self._cause(s) for s in steps if s.chance * len(steps) < SIGNIFICANCE]
            return Doubt.of(*self.located.overruled(), *uneven)
        bad = [pair for pair in self.merged.overlaps if pair.rms_z > ODD or pair.odd_share > SHARE]
        if not bad:
            return Doubt()
        worst = max(bad, key=lambda pair: pair.rms_z)
        names = f"{self.names[worst.first]} and {self.names[worst.second]}"
        return Doubt.of(
            f"{names} disagree by {worst.rms_z:.2g} times their errors (rms), {worst.odd_share:.0%} beyond three"
        )

    def _cause(self, step: Seam) -> str:
        """What heights say that differ by more than poses and rigs allow."""
        return (
            f"{self.names[step.second]} lies {1e3 * step.height_m:.0f} mm (of {1e3 * step.height_m_sigma:.0f} mm) over "
            f"{self.names[step.first]} and leans by {step.tilt_deg:.2g}° (of {step.tilt_deg_sigma:.2g}°), chi-square "
            f"{step.chi_square:.0f} of 3: one of their poses or rigs is wrong, or the ground has changed"
        )

    def to_dict(self) -> dict[str, Any]:
        record: dict[str, Any] = {
            "terrain": self.merged.model.summary(),
            "stations": self.rows(),
            "overlaps": [asdict(pair) for pair in self.merged.overlaps],
        }
        if self.mosaic is None or self.located is None:
            return record
        end = 6 * len(self.names)
        return record | {
            "steps": [asdict(step) for step in self.mosaic.steps],
            "pairs": self.located.pairs(),
            "poses": [pose.to_dict() for pose in self.mosaic.localised.poses],
            "covariance": self.mosaic.localised.adjusted.joint[:end, :end].tolist(),
            "notes": self.notes(),
        }

    def notes(self) -> list[str]:
        """What there is to say about pairs."""
        if self.mosaic is None:
            return ["the terrain is synthetic"] * self.merged.model.synthetic
        localised = self.mosaic.localised
        alone = [s.name for s, tied in zip(localised.stations, localised.tied, strict=True) if not tied]
        untied = f"not tied to {localised.stations[0].name}, and where telemetry puts them: {', '.join(alone)}"
        return [
            *[untied] * bool(alone),
            "place and heading of the map are those of the first pose.toml; common errors are of the others",
            *["the pictures are SYNTHETIC"] * self.merged.model.synthetic,
        ]

    def cloud_bytes(self) -> bytes:
        """The points of all pairs as PLY, where the map has them. Raises RequestError for models."""
        if self.mosaic is None:
            raise RequestError("a cloud is made of pictures; give folders, not models")
        clouds = [self.mosaic.cloud(k) for k in range(len(self.names))]
        matches = [station.matches for station in self.mosaic.localised.stations]
        light = [m.left[c.pixels[:, 0], c.pixels[:, 1]] for m, c in zip(matches, clouds, strict=True)]
        return cloud_ply(Cloud(*map(np.concatenate, zip(*clouds, strict=True))), np.concatenate(light))

    def rows(self) -> Sequence[Mapping[str, Any]]:
        """One a station: what it was found to be off by, with errors; the offset in units of its common error. Of
        pairs their poses."""
        if self.mosaic is not None and self.located is not None:
            return self.located.rows()
        sigma = np.sqrt(np.diag(self.merged.covariance)).reshape(self.merged.corrections.shape)
        rows = []
        for k, (name, model) in enumerate(zip(self.names, self.models, strict=True)):
            row: dict[str, Any] = {"station": k, "file": name, "name": model.name}
            for column, key in enumerate(("offset_sigmas", "x_m", "y_m")):
                row[key] = float(self.merged.corrections[k, column])
                row[f"{key}_sigma"] = float(sigma[k, column])
            rows.append(row)
        return rows

    def layers(self) -> dict[str, Any]:
        return self.merged.model.layers()

    def figures(self) -> Figures:
        from lunarsci.images.figures import merge_page

        yield merge_page(self.merged)

    def as_input(self, role: str) -> dict[str, Callable[[], bytes]]:
        return {"merged.npz": self.files()[".npz"]} if role in TERRAINS else {}

    def files(self) -> dict[str, Callable[[], bytes]]:
        """The map as the formats that have errors: ending to what makes the content."""
        model = self.merged.model
        return {".npz": lambda: elevation_bytes(model), ".tif": lambda: elevation_geotiff(model)}


@job
def merge(
    terrains: "Sequence[Ground] | str",
    request: MergeRequest | None = None,
    *,
    progress: Callable[[int, int], None] | None = None,
    **options: Any,
) -> MergedStations:
    """One map of the elevation models in two or more files, by inverse variances, common errors kept; or of pairs of
    pictures in two or more folders, whose poses and rigs are adjusted together.

    Raises DataError, RequestError, and ParameterError where no models overlap.

    Examples
    --------
    >>> ground = lunarsci.merge(["dem.npz", "coarse.npz"], spacing=0.1)
    >>> ground = lunarsci.merge(["lunarsci-demo", "station-2"], rig="lunarsci-demo/rig.toml")
    """
    request = request_of(MergeRequest, request, options)
    names = [terrains] if isinstance(terrains, str) else [*map(str, terrains)]
    folders = [Path(name).is_dir() for name in names]
    if all(folders):
        return _of_pairs(names, request, progress)
    refuse({"folders with pictures, and models, together; give one or the other": any(folders)}, kind=RequestError)
    inputs = {name: read_input(name).sha256 for name in names}
    models = tuple(read_elevation(name) for name in names)
    places = None
    if request.positions is not None:
        source = read_input(request.positions)
        inputs[source.name] = source.sha256
        places = read_positions(source, len(models))
    merged = merged_map(models, places, spacing_m=request.spacing, progress=progress)
    return MergedStations(names=tuple(names), models=models, merged=merged, inputs=inputs)


def _of_pairs(
    names: Sequence[str], request: MergeRequest, progress: Callable[[int, int], None] | None
) -> MergedStations:
    """One map of the pairs in folders."""
    why = "`positions` are those of models; where pairs were is in the pose.toml of their folders"
    refuse({why: request.positions is not None, "one folder; give two or more": len(names) < 2}, kind=RequestError)
    count, report = len(names), progress or (lambda done, total: None)
    inputs: dict[str, str] = {}
    rigs: dict[str, StereoRig] = {}

    def rig_of(folder: Path) -> StereoRig:
        written = folder / "rig.toml"
        name = request.rig or (str(written) if written.is_file() else DemRequest().rig)
        if Path(name).is_file():
            inputs[name] = read_input(name).sha256
        return rigs.setdefault(inputs.get(name, name), read_rig(name))

    errors = DeadReckoning(request.drift, request.heading_error, request.tilt_error, request.mast_error)
    read = read_stations(names, errors, rig_of, progress=lambda done: report(done, 3 * count))
    localised = localise(read.stations, progress=lambda done, total: report(count + done, 3 * count))
    spacing = request.spacing or DemRequest().spacing
    farthest = [request.farthest or farthest_ground_m(station.rig, spacing) for station in read.stations]
    made = mosaic(localised, spacing_m=spacing, farthest_m=farthest, synthetic=read.synthetic)
    return MergedStations(
        names=tuple(station.name for station in read.stations),
        models=made.models,
        merged=made.merged,
        inputs=read.inputs | inputs,
        mosaic=made,
        located=LocatedStations(
            localised=localised, rig=read.stations[0].rig, inputs=read.inputs, synthetic=read.synthetic
        ),
    )


def read_positions(source: InputFile, count: int) -> list[StationPosition]:
    """Positions of stations from CSV, a row for each of `count`, in the order of the models. Raises DataError."""
    table = read_csv_table(source)
    listed, present = {str(name) for name in table}, ", ".join(map(str, table.columns))
    reasons = {
        **{f"no column {name}; there are: {present}": name not in listed for name in ("x_m", "y_m")},
        f"{len(table)} rows for {count} elevation models; give one for each, in order": len(table) != count,
        "no errors of the positions; add sigma_m, or xx_m2, xy_m2, yy_m2 and zz_m2":
            not ("sigma_m" in listed or {*ERRORS[:3]} <= listed),
    }  # fmt: skip
    refuse(reasons, source.name, DataError)
    columns = {
        name: numbers_of(source.name, name, table[name]) for name in (*NEEDED, *ERRORS, "sigma_m") if name in table
    }
    flat = np.zeros(count)
    square = columns["sigma_m"] ** 2 if "sigma_m" in columns else flat
    xx, yy = columns.get("xx_m2", square), columns.get("yy_m2", square)
    xy, zz = columns.get("xy_m2", flat), columns.get("zz_m2", square)
    positions = []
    for k in range(count):
        covariance = np.array([[xx[k], xy[k], 0.0], [xy[k], yy[k], 0.0], [0.0, 0.0, zz[k]]])
        place = [float(columns.get(name, flat)[k]) for name in NEEDED]
        if not np.isfinite([*place, *covariance.ravel()]).all() or np.linalg.eigvalsh(covariance).min() < 0:
            raise DataError(f"{source.name}, row {k + 1}: a position or its errors are missing or no covariance")
        positions.append(StationPosition(x_m=place[0], y_m=place[1], z_m=place[2], covariance_m2=covariance))
    return positions
