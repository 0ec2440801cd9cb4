"""How deep a track is, and the sinkage that follows."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np

from lunarsci.arrays import FloatArray
from lunarsci.images.elevation import Change, ElevationModel, read_elevation
from lunarsci.images.jobs.requests import TrackRequest
from lunarsci.images.tracks import TrackDepths, change_along, read_line, track_depths
from lunarsci.io.inputs import Ground, read_input
from lunarsci.io.tables import csv_bytes
from lunarsci.options import request_of
from lunarsci.provenance import sha256
from lunarsci.result import Doubt, Figures, Result, job
from lunarsci.rovers import read_rover

SOURCES = [
    "Ding et al. (2024), Nat. Commun. 15, 2098, 10.1038/s41467-024-46233-8: sinkage from the depth of tracks",
    "Cressie (1993), Statistics for Spatial Data, 10.1002/9781119115151: universal kriging",
    "Holland & Welsch (1977), Commun. Stat. A 6, 813, 10.1080/03610927708827533: biweight",
]
STATEMENTS = (
    "the depth is that of all wheels that passed: the deepest of them left it, often the last",
    "it is the mean of the floor; prints of lugs go deeper, ridges between them are higher",
)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class TrackSinkage(Result):
    """Depths along a track, and the sinkage of the wheel that left it.

    Attributes
    ----------
    model : the heights that the track was measured in.
    change : these less those before the drive, where they were given.
    line : corners of the line along the track. (n, 2) [m]
    width_m : of the wheel. [m]
    depths : at places along the line.
    rebound : share of the sinkage by which the ground rose again behind the wheel, 0 to below 1; assumed. [-]
    inputs : SHA-256 of the file of heights by its name.
    tables : SHA-256 of the rover's file by its name; empty where the width was given.
    assumed : what of the rover is a guess, in words.
    """

    schema: ClassVar[str] = "images-track/1"
    sources = SOURCES
    model: ElevationModel
    change: Change | None = None
    line: FloatArray
    width_m: float
    depths: TrackDepths
    rebound: float
    inputs: Mapping[str, str]
    tables: Mapping[str, str]
    assumed: tuple[str, ...]

    @property
    def doubt(self) -> Doubt:
        depths = self.depths
        if not depths.determined.any():
            return Doubt.of(f"no depth is determined: {depths.reason[0]}")
        if not np.isfinite(depths.rut_m_random[depths.determined]).all() or not self._errors_stated:
            return Doubt.of(
                "the random errors are lower bounds: the elevation model states none and there is no ground to try on"
            )
        return Doubt()

    @property
    def _errors_stated(self) -> bool:
        return self.model.height_m_sigma is not None or self.depths.ground_scatter_m is not None

    def to_dict(self) -> dict[str, Any]:
        depths = self.depths
        systematic = depths.rut_m_systematic[depths.determined]
        shared = float(np.sqrt(np.mean(systematic**2))) if len(systematic) else None
        remaining_share = 1.0 - self.rebound
        mean = depths.mean_m if depths.determined.any() else None
        total = None if mean is None or shared is None else float(np.hypot(depths.mean_random_m, shared))
        return {
            "terrain": self.model.summary(),
            "wheel_width_m": self.width_m,
            "places": len(depths.distance_m),
            "determined": int(depths.determined.sum()),
            "rut_m": {"mean": mean, "random": depths.mean_random_m, "systematic": shared, "sigma": total},
            "sinkage_m": {
                "mean": mean and mean / remaining_share,
                "sigma": total and total / remaining_share,
                "rebound": self.rebound,
            },
            "systematic_m": {
                name: None if values is None else float(np.nanmean(values))
                for name, values in depths.systematic_m.items()
            },
            "ground_scatter_m": depths.ground_scatter_m,
            "track": self.rows(),
            **({} if self.change is None else {"change": self.change.to_dict()}),
            "notes": self.notes(),
        }

    def rows(self) -> Sequence[Mapping[str, Any]]:
        """One a place; `x_m`, `y_m`, `rut_m` and `rut_m_sigma` are what `twin states --track` reads."""
        depths, remaining_share = self.depths, 1.0 - self.rebound
        blank = np.where(depths.determined, 1.0, np.nan)
        sigma = np.hypot(depths.rut_m_random, depths.rut_m_systematic) * blank
        columns = {key: getattr(depths, key) for key in ("distance_m", "x_m", "y_m", "rut_m")} | {
            "rut_m_sigma": sigma,
            "rut_m_random": depths.rut_m_random * blank,
            "rut_m_systematic": depths.rut_m_systematic * blank,
            "sinkage_m": depths.rut_m / remaining_share,
            "sinkage_m_sigma": sigma / remaining_share,
        }
        rows = [dict(zip(columns, map(float, row), strict=True)) for row in zip(*columns.values(), strict=True)]
        return [row | {"status": reason or "ok"} for row, reason in zip(rows, depths.reason, strict=True)]

    def as_input(self, role: str) -> dict[str, Callable[[], bytes]]:
        return {"track.csv": lambda: csv_bytes(self.to_pandas())} if role == "track" else {}

    def figures(self) -> Figures:
        from lunarsci.images.figures import track_page

        yield track_page(self.change.model if self.change else self.model, self.line, self.width_m, self.depths)

    def notes(self) -> list[str]:
        """What the depths mean, and what is assumed or missing."""
        depths, notes = self.depths, list(STATEMENTS)
        rebound = f"the ground rose again by {self.rebound:.0%} of the sinkage" if self.rebound else "no rebound"
        notes.append(f"{rebound} (assumed)")
        notes += [f"{name} is assumed" for name in self.assumed]
        if depths.ground_scatter_m is None:
            notes.append("too little ground without a track beside it to try the errors on")
        if depths.systematic_m.get("disparity") is None:
            notes.append("the bias of disparities is not in the errors: the model has no height_by_disparity_m_px")
        if self.change is not None:
            x, y, z = (1e3 * v for v in self.change.moved[[0, 1, 3]])
            notes.append(
                "depths are the ground before the drive less that after it; the model before was moved by "
                f"{x:.1f}, {y:.1f}, {z:.1f} mm to lie on the ground beside the track, where they differ by "
                f"{self.change.rms_z:.2f} of their errors"
            )
        if self.model.synthetic:
            notes.append("the terrain is synthetic")
        return notes


@job
def track(
    terrain: "Ground",
    request: TrackRequest | None = None,
    *,
    progress: Callable[[int, int], None] | None = None,
    **options: Any,
) -> TrackSinkage:
    """Depth of a track along a line on an elevation model, random and systematic errors apart.

    `terrain` is a file of heights with errors as layers. Raises DataError and RequestError, and ParameterError for a
    line that is none.

    Examples
    --------
    >>> depths = lunarsci.track("ground/terrain.npz", line="0,1,2.5,1.2", step=0.5).to_table()
    """
    request = request_of(TrackRequest, request, options)
    line = read_line(request.line)
    path = str(terrain)
    inputs, model = {path: read_input(path).sha256}, read_elevation(path)
    tables: dict[str, str] = {}
    assumed: tuple[str, ...] = ()
    width = request.width
    if width is None:
        rover = read_rover(request.rover)
        width = float(rover.table("wheel")["width_m"])
        tables = {f"{request.rover} (rover)": sha256(rover.text.encode())}
        assumed = ("the wheel's width",) if "wheel.width_m" in rover.assumed else ()
    change = None
    if request.before is not None:
        inputs[request.before] = read_input(request.before).sha256
        change = change_along(model, read_elevation(request.before), line, width, request.search)
    depths = track_depths(
        change.model if change else model,
        line,
        width,
        window_m=request.window,
        step_m=request.step,
        search_m=request.search,
        disparity_bias_px=request.disparity_bias,
        progress=progress,
    )
    return TrackSinkage(
        model=model,
        change=change,
        line=line,
        width_m=width,
        depths=depths,
        rebound=request.rebound,
        inputs=inputs,
        tables=tables,
        assumed=assumed,
    )
