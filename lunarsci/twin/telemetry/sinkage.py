"""Sinkage of the wheels from the track they left."""

import dataclasses

import numpy as np
import numpy.typing as npt

from lunarsci.errors import DataError
from lunarsci.twin.ground.terrain import Terrain
from lunarsci.twin.simulation.ensemble import STATE_COLUMNS
from lunarsci.twin.telemetry.states import DriveStates
from lunarsci.twin.telemetry.track import RutPoints, deepest_wheel, rut_points

__all__ = ["with_sinkage"]

FloatArray = npt.NDArray[np.float64]
ALONG = 0.5
"""Share of the states that a track must meet; below it is not the track of this drive; assumed."""
MOST_ODD = 0.2
"""Share of the depths that may be odd without doubt; assumed."""
ABOVE = -3.0
"""Standard errors by which a rut may lie above the ground."""


def with_sinkage(drive: DriveStates, track: RutPoints | Terrain, before: Terrain) -> DriveStates:
    """The states with sinkages from depths along the track, or from the ground after the drive.

    A depth is given to the one wheel that left it so, the deepest that passed there (see `deepest_wheel`), as the mean
    over half a wheel's width about its centre; the others are left blank, and so are depths deeper than the wheel's
    radius or above the ground by more than three standard errors, with a finding. Raises DataError where the track is
    nowhere near the drive.
    """
    rows, rover = drive.rows, drive.rover
    reach = 0.5 * rover.wheel.width_m
    places = rows.place_m.reshape(-1, 2)
    known = np.asarray(np.isfinite(places).all(axis=1))
    wheel = np.tile(np.arange(len(rover.wheels)), len(rows.node))
    points = rut_points(before, track, places[known], reach) if isinstance(track, Terrain) else track
    depth, sigma = np.full(len(places), np.nan), np.full(len(places), np.nan)
    depth[known], sigma[known] = points.depth_at(places[known], reach)
    _check_along(drive, points, depth, known)
    states = drive.held.states
    x, y, z = (_without_holes(states[..., STATE_COLUMNS.index(name)]) for name in ("x_m", "y_m", "sinkage_m"))
    own, spread = np.zeros(len(places), dtype=bool), np.zeros(len(places))
    own[known], spread[known] = deepest_wheel(places[known], wheel[known], (x, y), z, drive.nodes.time_s, reach)
    sigma = np.hypot(sigma, spread)
    odd = own & ((depth < ABOVE * sigma) | (depth > rover.wheel.radius_m))
    if odd.any():
        first = float(drive.nodes.time_s[rows.node[int(np.flatnonzero(odd)[0]) // len(rover.wheels)]])
        what = f"depths from {depth[odd].min():.3g} to {depth[odd].max():.3g} m, which no wheel of this radius leaves"
        drive.findings.add(
            "odd depth", what, "left blank", count=int(odd.sum()), time_s=first, doubt=odd.sum() > 0.2 * own.sum()
        )
    kept = own & ~odd & (rows.valid | _at_halt(drive)).ravel()
    shape = rows.slip_ratio.shape
    return dataclasses.replace(
        drive,
        rows=dataclasses.replace(
            rows,
            sinkage_m=np.where(kept, depth, np.nan).reshape(shape),
            sinkage_m_sigma=np.where(kept, sigma, np.nan).reshape(shape),
        ),
    )


def _at_halt(drive: DriveStates) -> npt.NDArray[np.bool_]:
    """Rows whose states are not valid only for their slip: their sinkage counts all the same."""
    return np.isfinite(drive.rows.slip_ratio)


def _without_holes(values: FloatArray) -> FloatArray:
    """Values along the drive, found from those beside where the rover does not stand on the terrain. (n, wheels)"""
    result = values.copy()
    for k in range(values.shape[1]):
        known = np.isfinite(values[:, k])
        if known.any():
            result[:, k] = np.interp(np.arange(len(values)), np.flatnonzero(known), values[known, k])
    return np.nan_to_num(result)


def _check_along(drive: DriveStates, points: RutPoints, depth: FloatArray, known: npt.NDArray[np.bool_]) -> None:
    met = float(np.isfinite(depth[known]).mean()) if known.any() else 0.0
    if met == 0:
        raise DataError(
            "the track has no point within half a wheel's width of a wheel; it lies about x "
            f"{np.median(points.place_m[:, 0]):.4g} m, y {np.median(points.place_m[:, 1]):.4g} m: is it of this "
            "drive, in its frame, in m?"
        )
    if met < ALONG:
        what = f"the track meets {100 * met:.0f} % of the states: it is short, or not along this drive"
        drive.findings.add("track apart", what, "sinkage is blank elsewhere", doubt=met < 0.5 * ALONG)
