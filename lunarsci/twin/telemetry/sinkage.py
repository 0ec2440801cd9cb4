"""Sinkage of the wheels from the track they left.

A rut is as deep as the deepest wheel that passed: the ground does not rise again. It says nothing of the sinkage of the
other wheels that ran in it, but that they sank no deeper.
"""

import dataclasses
import math
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from lunarsci.arrays import BoolArray, FloatArray, IndexArray
from lunarsci.errors import DataError
from lunarsci.io.inputs import InputFile
from lunarsci.io.tables import check_columns, in_units, numbers_of, read_csv_table
from lunarsci.twin.ground.terrain import Terrain
from lunarsci.twin.simulation.ensemble import STATE_COLUMNS
from lunarsci.twin.telemetry.hypotheses import REPORTED
from lunarsci.twin.telemetry.reading import LEAST_ROW_M, SURE, filled
from lunarsci.twin.telemetry.simulated import deepest_at
from lunarsci.twin.telemetry.states import MOST_LEFT_OUT, DriveStates, StateRows

SIGMA_M = 0.00033
"""Error of a depth whose error is not given: 1 mm as three standard deviations, Ding et al. (2024),
10.1038/s41467-024-46233-8. [m]"""
GRID = 5
"""Places across a footprint at which two terrains are compared, each way."""
TIE_M = math.sqrt(2.0) * SIGMA_M
"""Predicted sinkages that differ by less than two depths with errors as `SIGMA_M` do not say which wheel is the
deepest: it is the last then. [m]"""
EARLIER = 0.15
"""Share by which a wheel must be predicted deeper than those after it to be the deepest: ground that is loaded again
sinks further than the prediction, which knows no ruts, says: as measured, by up to 0.14 in drives by MuJoCo with such
ruts."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class RutPoints:
    """Depth of a track below the undisturbed ground.

    Attributes
    ----------
    place_m : (p, 2) [m]
    rut_m, sigma_m : depth and its error, which points within one footprint share. (p,) [m]
    """

    place_m: FloatArray
    rut_m: FloatArray
    sigma_m: FloatArray

    @property
    def apart_m(self) -> float:
        """Median distance of a point from the nearest other one, 0 where there is none. [m]"""
        from scipy.spatial import cKDTree

        if len(self.place_m) < 2:
            return 0.0
        distance: Any = cKDTree(self.place_m).query(self.place_m, k=2)[0]
        return float(np.median(distance[:, 1]))

    def depth_at(self, places_m: FloatArray, reach_m: float) -> tuple[FloatArray, FloatArray]:
        """Mean depth within a distance of places (m, 2), and its error: that of a point, and the scatter. (m,) [m]"""
        from scipy.spatial import cKDTree

        depth, sigma = np.full(len(places_m), np.nan), np.full(len(places_m), np.nan)
        near_places: Any = cKDTree(self.place_m).query_ball_point(places_m, reach_m)
        for row, near in enumerate(near_places):
            if near:
                values = self.rut_m[near]
                scatter = float(values.std(ddof=1)) / math.sqrt(len(near)) if len(near) > 1 else 0.0
                depth[row] = values.mean()
                sigma[row] = math.hypot(float(np.sqrt((self.sigma_m[near] ** 2).mean())), scatter)
        return depth, sigma


def read_track(source: InputFile) -> RutPoints:
    """Depths of a track from CSV: x_m, y_m, rut_m, and optionally rut_m_sigma, or in another unit. Raises DataError."""
    table = in_units(source.name, read_csv_table(source))
    check_columns(
        source.name, table.columns, ("x_m", "y_m", "rut_m", "rut_m_sigma", "synthetic"), ("x_m", "y_m", "rut_m")
    )
    x, y, rut = (numbers_of(source.name, name, table[name]) for name in ("x_m", "y_m", "rut_m"))
    sigma = np.full(len(rut), SIGMA_M)
    if "rut_m_sigma" in table:
        given = numbers_of(source.name, "rut_m_sigma", table["rut_m_sigma"])
        if (given < 0).any():
            row = int(np.argmax(given < 0))
            raise DataError(f"{source.name}, row {row + 1}, rut_m_sigma: {given[row]:g}; give 0 or more")
        sigma = np.where(np.isfinite(given), given, SIGMA_M)
    whole = np.isfinite(x) & np.isfinite(y) & np.isfinite(rut)
    if not whole.any():
        raise DataError(f"{source.name}: no row has x_m, y_m and rut_m")
    return RutPoints(place_m=np.column_stack([x, y])[whole], rut_m=rut[whole], sigma_m=sigma[whole])


def rut_points(before: Terrain, after: Terrain, places_m: FloatArray, reach_m: float) -> RutPoints:
    """Depths where wheels stood, from the ground before less that after the drive; NaN heights are left out.

    Places (m, 2) are each compared at a grid of points within the distance. The error of a point is `SIGMA_M`; where
    the two maps scatter more, `RutPoints.depth_at` adds it. Raises DataError where the maps have nothing in common.
    """
    steps = np.linspace(-0.7 * reach_m, 0.7 * reach_m, GRID)
    around = np.column_stack([part.ravel() for part in np.meshgrid(steps, steps)])
    points = (places_m[:, None] + around).reshape(-1, 2)
    rut = before.height_at(*points.T) - after.height_at(*points.T)
    given = np.isfinite(rut)
    if not given.any():
        raise DataError(f"{after.name}: no height below any wheel; is it the ground of this drive?")
    return RutPoints(place_m=points[given], rut_m=rut[given], sigma_m=np.full(int(given.sum()), SIGMA_M))


def deepest_wheel(
    places_m: FloatArray,
    wheel: IndexArray,
    paths: tuple[FloatArray, FloatArray],
    predicted_m: FloatArray,
    time_s: FloatArray,
    reach_m: float,
) -> tuple[BoolArray, FloatArray]:
    """Whether a wheel is the one whose depth the rut below it has, and what that may be off by.

    Of the wheels that passed within the distance it is the one that is predicted to stand deepest. Where the
    predictions do not tell, it is the last one, and their spread is an error. A wheel that others followed must be
    deeper than they are by `EARLIER`, or the depth is no one's.

    Parameters
    ----------
    places_m, wheel : where a wheel stood, and which. (m, 2) [m], (m,)
    paths : x and y of every wheel along the drive. (n, wheels) [m]
    predicted_m : sinkage that the twin gives each wheel on a soil that is assumed. (n, wheels) [m]
    time_s : (n,) [s]
    reach_m : half the wheel's width. [m]
    """
    depth = deepest_at(places_m, (*paths, predicted_m), reach_m)
    times = np.repeat(time_s[:, None], paths[0].shape[1], axis=1)
    passed = deepest_at(places_m, (*paths, times), reach_m)
    tied = depth >= depth.max(axis=1, keepdims=True) - TIE_M
    last = np.where(tied, passed, -np.inf).argmax(axis=1)
    spread = np.where(tied, depth, np.nan)
    alone = np.isfinite(depth).any(axis=1)
    off = np.zeros(len(places_m))
    off[alone] = np.nanmax(spread[alone], axis=1) - np.nanmin(spread[alone], axis=1)
    rows = np.arange(len(places_m))
    later = np.where(passed > passed[rows, last][:, None], depth, -np.inf).max(axis=1)
    certain = later <= (1.0 - EARLIER) * depth[rows, last]
    return alone & certain & (last == wheel), off


def is_table_of_ruts(source: InputFile) -> bool:
    """Whether a file is a CSV of depths; else it is a terrain."""
    if Path(source.name).suffix.lower() != ".csv":
        return False
    return "height_m" not in read_csv_table(source)


def with_sinkage(drive: DriveStates, track: RutPoints | Terrain, before: Terrain) -> DriveStates:
    """The states with sinkages from depths along the track, or from the ground after the drive.

    A depth is given to the one wheel that left it so, the deepest that passed there (see `deepest_wheel`), as the mean
    over half a wheel's width about its centre; the others are left blank, and so are depths deeper than the wheel's
    radius or above the ground by more than three standard errors, with a finding. Where positions lie far apart there
    are rows with a sinkage alone between those with a slip. Raises DataError where the track is nowhere near the drive.
    """
    slipping = drive.rows.node
    drive = dataclasses.replace(drive, rows=_with_rows_between(drive))
    rows, rover = drive.rows, drive.rover
    reach = 0.5 * rover.wheel.width_m
    places = rows.place_m.reshape(-1, 2)
    given = np.asarray(np.isfinite(places).all(axis=1))
    wheel = np.tile(np.arange(len(rover.wheels)), len(rows.node))
    points = rut_points(before, track, places[given], reach) if isinstance(track, Terrain) else track
    depth, sigma = np.full(len(places), np.nan), np.full(len(places), np.nan)
    depth[given], sigma[given] = points.depth_at(places[given], reach)
    _check_along(drive, points, depth, given)
    states = drive.held.states
    columns, at = [STATE_COLUMNS.index(name) for name in ("x_m", "y_m", "sinkage_m")], np.arange(float(len(states)))
    # Where the rover does not stand on the terrain, from beside.
    x, y, z = (np.column_stack([filled(at, wheel) for wheel in states[..., k].T]) for k in columns)
    deepest, spread = np.zeros(len(places), dtype=bool), np.zeros(len(places))
    deepest[given], spread[given] = deepest_wheel(places[given], wheel[given], (x, y), z, drive.nodes.time_s, reach)
    sigma = np.hypot(sigma, spread)
    odd = deepest & ((depth < -SURE * sigma) | (depth > rover.wheel.radius_m))
    if odd.any():
        what = f"depths from {depth[odd].min():.3g} to {depth[odd].max():.3g} m, which no wheel of this radius leaves"
        many, times = bool(odd.sum() > MOST_LEFT_OUT * deepest.sum()), drive.nodes.time_s[rows.node]
        drive.findings.of_rows("odd depth", what, "left blank", odd.reshape(len(times), -1), times, doubt=many)
    # At a halt states are not valid only for their slip.
    valid = deepest & ~odd & (rows.measured | np.isfinite(rows.slip_ratio)).ravel()
    shape = rows.slip_ratio.shape
    sinkage, error = (np.where(valid, value, np.nan).reshape(shape) for value in (depth, sigma))
    reported = np.isin(rows.node, slipping) | np.isfinite(sinkage).any(axis=1)
    rows = dataclasses.replace(rows, sinkage_m=sinkage, sinkage_m_sigma=error)
    return dataclasses.replace(drive, rows=_picked(rows, np.flatnonzero(reported)))


def _with_rows_between(drive: DriveStates) -> StateRows:
    """The rows, and between them others without a slip where the rover drives, no closer than rows may be."""
    rows, way_m = drive.rows, drive.nodes.way_m
    way = np.append(0.0, np.cumsum(way_m))
    distance = way + np.interp(way, way[rows.node], rows.distance_m - way[rows.node])
    drives = (np.append(0.0, way_m) > 0) & (np.append(way_m, 0.0) > 0) & (drive.held.outcome == 0)
    taken, added = list(rows.distance_m), []
    for node in np.flatnonzero(drives):
        if np.abs(distance[node] - np.array(taken)).min() >= LEAST_ROW_M:
            added.append(int(node))
            taken.append(float(distance[node]))
    if not added:
        return rows
    blank = np.full((len(added), len(drive.rover.wheels)), np.nan)
    values: dict[str, Any] = dict.fromkeys((field.name for field in dataclasses.fields(rows)), blank) | {
        "node": np.array(added, dtype=np.intp),
        "distance_m": distance[added],
        "place_m": drive.held.states[added][..., :2],
        "measured": np.ones(blank.shape, dtype=np.bool_),
    }
    both = {name: np.concatenate([getattr(rows, name), value]) for name, value in values.items()}
    return _picked(StateRows(**both), np.argsort(both["node"], kind="stable"))


def _picked(rows: StateRows, numbers: IndexArray) -> StateRows:
    return StateRows(**{field.name: getattr(rows, field.name)[numbers] for field in dataclasses.fields(rows)})


def _check_along(drive: DriveStates, points: RutPoints, depth: FloatArray, given: BoolArray) -> None:
    met = float(np.isfinite(depth[given]).mean()) if given.any() else 0.0
    if met == 0:
        x, y = np.median(points.place_m, axis=0)
        raise DataError(
            f"the track has no point within half a wheel's width of a wheel; it lies about x {x:.4g} m, y {y:.4g} m: "
            "is it of this drive, in its frame, in m?"
        )
    if met < REPORTED:
        reach, apart = 0.5 * drive.rover.wheel.width_m, points.apart_m
        why = "short, or not along this drive"
        if apart > 2.0 * reach:
            why = f"sparse, its points lie {apart:.2g} m apart; give them every {reach:.2g} m or closer"
        need = f"which need points within {reach:.2g} m of a wheel"
        what = f"the track meets {100 * met:.0f} % of the states, {need}: it is {why}"
        drive.findings.add("track apart", what, "sinkage is blank elsewhere", doubt=met < 0.5 * REPORTED)
