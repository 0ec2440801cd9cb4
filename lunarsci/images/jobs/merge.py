"""Elevation models of several stations as one map, and where they disagree."""

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass
from typing import TYPE_CHECKING, Any, ClassVar

import numpy as np

from lunarsci.errors import DataError
from lunarsci.images.elevation import (
    ElevationModel,
    MergedMap,
    StationPosition,
    elevation_bytes,
    elevation_geotiff,
    read_elevation,
)
from lunarsci.images.elevation import merge as merged_map
from lunarsci.images.jobs.requests import MergeRequest
from lunarsci.io.inputs import InputFile, read_input
from lunarsci.io.tables import numbers_of, read_csv_table
from lunarsci.options import request_of
from lunarsci.ranges import refuse
from lunarsci.result import Doubt, Result, job

if TYPE_CHECKING:
    from matplotlib.figure import Figure


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
    """

    schema: ClassVar[str] = "images-merge/1"
    sources = SOURCES
    names: tuple[str, ...]
    models: tuple[ElevationModel, ...]
    merged: MergedMap
    inputs: Mapping[str, str]

    @property
    def doubt(self) -> Doubt:
        bad = [pair for pair in self.merged.overlaps if pair.rms_z > ODD or pair.odd_share > SHARE]
        if not bad:
            return Doubt()
        worst = max(bad, key=lambda pair: pair.rms_z)
        names = f"{self.names[worst.first]} and {self.names[worst.second]}"
        return Doubt.of(
            f"{names} disagree by {worst.rms_z:.2g} times their errors (rms), {worst.odd_share:.0%} beyond three"
        )

    def to_dict(self) -> dict[str, Any]:
        return {
            "terrain": self.merged.model.summary(),
            "stations": self.rows(),
            "overlaps": [asdict(pair) for pair in self.merged.overlaps],
        }

    def rows(self) -> Sequence[Mapping[str, Any]]:
        """One a station: what it was found to be off by, with errors; the offset in units of its common error."""
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

    def figures(self) -> "Iterator[Figure]":
        from lunarsci.images.figures import merge_page

        yield merge_page(self.merged)

    def files(self) -> dict[str, Callable[[], bytes]]:
        """The map as the formats that have errors: ending to what makes the content."""
        model = self.merged.model
        return {
            ".npz": lambda: elevation_bytes(model),
            ".tif": lambda: elevation_geotiff(model),
        }


@job
def merge(
    terrains: Sequence[str],
    request: MergeRequest | None = None,
    *,
    progress: Callable[[int, int], None] | None = None,
    **options: Any,
) -> MergedStations:
    """One map of the elevation models in two or more files, by inverse variances, common errors kept.

    Raises DataError, RequestError, and ParameterError where nothing overlaps.

    Examples
    --------
    >>> ground = lunarsci.merge(["dem.npz", "coarse.npz"], spacing=0.1)
    """
    request = request_of(MergeRequest, request, options)
    names = [terrains] if isinstance(terrains, str) else list(terrains)
    inputs = {name: read_input(name).sha256 for name in names}
    models = tuple(read_elevation(name) for name in names)
    places = None
    if request.positions is not None:
        source = read_input(request.positions)
        inputs[source.name] = source.sha256
        places = read_positions(source, len(models))
    merged = merged_map(models, places, spacing_m=request.spacing, progress=progress)
    return MergedStations(names=tuple(names), models=models, merged=merged, inputs=inputs)


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
