"""Localised positions and headings: what of them can be used, and whether they share a frame with the wheels.

Roll and pitch of the rover: those of the ground it stands on, and how they move its origin.
"""

import dataclasses
from typing import Any

import numpy as np

from lunarsci.arrays import BoolArray, FloatArray, IndexArray
from lunarsci.errors import DataError
from lunarsci.twin.loads.prescribed_motion import PrescribedLoads
from lunarsci.twin.rover import Rover
from lunarsci.twin.telemetry.checks import check_far, ordered
from lunarsci.twin.telemetry.reading import Findings, Positions, Telemetry
from lunarsci.twin.telemetry.rests import GAP, chance_by_noise, held

ATTITUDE_DEG, FOLLOWS, MOUNTED_DEG = 1.5, 0.6, 3.0
"""Median difference of roll or pitch from the terrain's beyond which it is said [deg], or as a share of its slope where
that is more; and by how much their sensor may be turned on the rover [deg]; assumed."""


def sway_m(rover: Rover, paths: FloatArray) -> FloatArray:
    """How far the rover's origin is from above the point that its wheels stand about, by roll and pitch. (n, 2) [m]

    The wheels carry that point; the origin sways above it, which is no slip. Where how the rover stands is not known,
    as beside a halt, it stands as about there: a tilt left out would be a jump, and read as a slip.
    """
    height = rover.wheel.radius_m - float(rover.wheel_positions_m[:, 2].mean())
    known = np.flatnonzero(np.isfinite(paths[:, 3:5]).all(axis=1))
    tilts = paths[known, 3:5] if known.size else np.zeros((1, 2))
    roll, pitch = np.radians([np.interp(np.arange(len(paths)), known if known.size else [0], c) for c in tilts.T])
    yaw = np.radians(np.nan_to_num(paths[:, 5]))
    ahead, left = np.sin(pitch) * np.cos(roll), -np.sin(roll)
    return height * np.column_stack(
        [np.cos(yaw) * ahead - np.sin(yaw) * left, np.sin(yaw) * ahead + np.cos(yaw) * left]
    )


def check_attitude(telemetry: Telemetry, held: PrescribedLoads, rows: IndexArray, findings: Findings) -> None:
    """Roll and pitch are those of a rover that stands on this terrain; all alike off is their sensor's mounting."""
    for column, name in ((3, "roll_deg"), (4, "pitch_deg")):
        measured, stood = getattr(telemetry, name)[rows], held.paths[:, column]
        known = np.isfinite(measured) & np.isfinite(stood)
        if known.sum() < 5:
            continue
        a, b = measured[known], stood[known]

        def off(values: FloatArray, wanted: FloatArray = b) -> float:
            return float(np.median(np.abs(values - wanted)))

        if off(a) <= max(ATTITUDE_DEG, FOLLOWS * off(b, np.zeros(1))):
            continue
        mounted = float(np.median(a - b))
        turned = abs(mounted) < MOUNTED_DEG and off(a - mounted) < 0.5 * ATTITUDE_DEG
        hint = "; it has the other sign" if off(-a) < 0.4 * off(a) else ""
        hint = "; it looks like rad" if off(np.degrees(a)) < 0.4 * off(a) else hint
        cause = f"its sensor is turned by {mounted:.2g} deg" if turned else "another terrain, frame or sign"
        what = f"{name} is {off(a):.3g} deg off the terrain's in the median{hint}: {cause}"
        done = "the terrain's is taken"
        findings.add("attitude against terrain", what, done, count=int(known.sum()), doubt=not turned)


def with_positions(telemetry: Telemetry, positions: Positions, file: str, findings: Findings) -> Telemetry:
    """Telemetry with positions from elsewhere in place of its own, in rows at their times.

    Between rows wheels, headings and attitude are taken to change evenly. Positions that are a gap or more before or
    after the telemetry are left out and said. `file` is where they come from.
    """
    telemetry = ordered(telemetry, findings)
    times = telemetry.time_s
    reach = GAP * float(np.median(np.diff(times)))
    good = (positions.time_s >= times[0] - reach) & (positions.time_s <= times[-1] + reach)
    if not good.all():
        what = f"{(~good).sum()} of {len(good)} positions of {file} are not within the times of the telemetry"
        findings.add("positions at other times", what, "they are left out", count=int((~good).sum()), doubt=True)
    at = np.clip(positions.time_s[good], times[0], times[-1])
    merged = np.union1d(times, at)
    columns: dict[str, Any] = {
        item.name: _between(merged, times, value)
        for item in dataclasses.fields(telemetry)
        if isinstance(value := getattr(telemetry, item.name), np.ndarray)
    }
    rows = np.searchsorted(merged, at)
    columns["fix_m"] = np.full((len(merged), 2), np.nan)
    columns["fix_covariance_m2"] = np.full((len(merged), 2, 2), np.nan)
    columns["fix_m"][rows], columns["fix_covariance_m2"][rows] = positions.place_m[good], positions.covariance_m2[good]
    if positions.shared_m2 is not None:
        shared = positions.shared_m2 * np.append(False, good[:-1])[:, None, None]
        columns["fix_shared_m2"] = np.zeros((len(merged), 2, 2))
        columns["fix_shared_m2"][rows] = shared[good]
    return dataclasses.replace(telemetry, **columns)


def _between(merged: FloatArray, times: FloatArray, values: FloatArray) -> FloatArray:
    """Values (n, ...) at more times: linear between two that are known and no half turn apart, else blank."""
    flat = values.reshape(len(times), -1)
    low = np.clip(np.searchsorted(times, merged, side="right") - 1, 0, len(times) - 1)
    high = np.minimum(low + (times[low] < merged), len(times) - 1)
    share = (merged - times[low]) / np.where(high > low, times[high] - times[low], 1.0)
    step = flat[high] - flat[low]
    step[np.abs(step) > 180.0] = np.nan
    found = np.where((high > low)[:, None], flat[low] + share[:, None] * step, flat[low])
    return np.asarray(found.reshape(len(merged), *values.shape[1:]))


def usable_positions(telemetry: Telemetry, way_m: FloatArray, findings: Findings) -> Telemetry:
    """Positions without those that have no proper covariance or only repeat the one before.

    `way_m` is the way of the rims until each row. (n,) Raises DataError where fewer than two are left.
    """
    given, value = telemetry.fixed, telemetry.fix_covariance_m2
    half = np.asarray(np.isfinite(telemetry.fix_m).any(axis=1)) & ~given
    _leave(findings, "half a position", "only one of x_m and y_m", half, telemetry)
    complete: BoolArray = np.asarray(np.isfinite(value).all(axis=(1, 2)))
    least: FloatArray = np.linalg.eigvalsh(np.where(complete[:, None, None], value, -np.eye(2)))[:, 0]
    bad = np.asarray(given & (least <= 0))
    _leave(findings, "bad covariance", "errors that are missing, 0, negative, or no covariance", bad, telemetry)
    rows, same = np.flatnonzero(given & ~bad), np.zeros(len(given), dtype=bool)
    if rows.size:
        place, sigma = telemetry.fix_m[rows], float(np.median(np.sqrt(np.trace(value[rows], axis1=1, axis2=2) / 2.0)))
        same[rows] = held(place, chance_by_noise(place, sigma) ** 2, way_m[rows], np.sqrt(2.0) * sigma)
    what = "it repeats the one before to the last digit: sent again, or the sensor hangs"
    _leave(findings, "repeated position", what, same, telemetry)
    used = given & ~bad & ~same
    if used.sum() < 2:
        raise DataError(
            f"{telemetry.file}: {int(used.sum())} positions of use among {int(given.sum())} ({int(bad.sum())} have "
            f"errors that are no covariance, {int(same.sum())} repeat another); slip needs two or more"
        )
    check_far(np.flatnonzero(used), telemetry, way_m, findings)
    shared = telemetry.fix_shared_m2
    if shared is not None:
        before = np.flatnonzero(given)
        shared = shared.copy()
        shared[before[1:][~used[before[:-1]]]] = 0.0
    return dataclasses.replace(telemetry, fix_m=np.where(used[:, None], telemetry.fix_m, np.nan), fix_shared_m2=shared)


def _leave(findings: Findings, kind: str, what: str, rows: BoolArray, telemetry: Telemetry) -> None:
    if rows.any():
        done, first = f"these {kind.split()[-1]}s are left out", float(telemetry.time_s[int(np.argmax(rows))])
        findings.add(kind, what, done, count=int(rows.sum()), time_s=first)


def usable_headings(telemetry: Telemetry, turned_deg: FloatArray, findings: Findings) -> Telemetry:
    """Headings without full turns between rows, and without those that only repeat the one before.

    `turned_deg` is the turn that the wheels say until each row. (n,) Raises DataError where fewer than two are left.
    """
    yaw, sigma = telemetry.yaw_deg.copy(), telemetry.yaw_deg_sigma
    given = np.isfinite(yaw)
    blank = given & ~(sigma > 0)
    rows, same = np.flatnonzero(given & ~blank), np.zeros(len(yaw), dtype=bool)
    if rows.size:
        error = float(np.median(sigma[rows]))
        same[rows] = held(yaw[rows], chance_by_noise(yaw[rows], error), turned_deg[rows], np.sqrt(2.0) * error)
    what = "yaw_deg repeats the one before to the last digit: sent again, or the sensor hangs"
    _leave(findings, "heading error", "yaw_deg_sigma is missing, 0 or negative", blank, telemetry)
    _leave(findings, "repeated heading", what, same, telemetry)
    yaw[blank | same] = np.nan
    known = np.flatnonzero(np.isfinite(yaw))
    if known.size < 2:
        raise DataError(f"{telemetry.file}: {known.size} headings of use; side slip needs yaw_deg")
    if not given.all():
        first = float(telemetry.time_s[int(np.argmin(given))])
        done = "found from the others"
        findings.add("missing headings", "rows without yaw_deg", done, count=int((~given).sum()), time_s=first)
    yaw[known] = np.degrees(np.unwrap(np.radians(yaw[known])))
    return dataclasses.replace(telemetry, yaw_deg=yaw)
