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
from lunarsci.twin.telemetry.rests import GAP

ATTITUDE_DEG, FOLLOWS = 1.5, 0.6
"""Median difference of roll or pitch from the terrain's beyond which the terrain is not the ground [deg]; and, where it
slopes by more than 1 degree, as a share of the slope; assumed."""


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
    """Roll and pitch must be those of a rover that stands on this terrain."""
    for column, name in ((3, "roll_deg"), (4, "pitch_deg")):
        measured, stood = getattr(telemetry, name)[rows], held.paths[:, column]
        known = np.isfinite(measured) & np.isfinite(stood)
        if known.sum() < 5:
            continue
        a, b = measured[known], stood[known]

        def off(values: FloatArray, wanted: FloatArray = b) -> float:
            return float(np.median(np.abs(values - wanted)))

        size = float(np.median(np.abs(b)))
        if off(a) <= max(ATTITUDE_DEG, FOLLOWS * size) and not (size > 1.0 and off(a) > FOLLOWS * size):
            continue
        hint = "; it has the other sign" if off(-a) < 0.4 * off(a) else ""
        hint = "; it looks like rad" if off(np.degrees(a)) < 0.4 * off(a) else hint
        what = f"{name} is {off(a):.3g} deg off the terrain's in the median{hint}: another terrain, frame or sign"
        findings.add("attitude against terrain", what, "the terrain's is taken", count=int(known.sum()), doubt=True)


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


HANG_ROWS, HANG_DEG = 10, 1.0
"""Rows, or turn of the wheels [deg], over which a heading that stays the same hangs; assumed."""


def usable_positions(telemetry: Telemetry, way_m: FloatArray, findings: Findings) -> Telemetry:
    """Positions without those that have no proper covariance or repeat the one before though the rims moved on.

    `way_m` is the way of the rims until each row. (n,) Raises DataError where fewer than two are left.
    """
    given = telemetry.fixed
    half = np.asarray(np.isfinite(telemetry.fix_m).any(axis=1)) & ~given
    _leave(findings, "half a position", "only one of x_m and y_m", half, telemetry)
    value = telemetry.fix_covariance_m2
    complete: BoolArray = np.asarray(np.isfinite(value).all(axis=(1, 2)))
    bad = given & ~complete
    least: FloatArray = np.linalg.eigvalsh(np.where(complete[:, None, None], value, np.eye(2)))[:, 0]
    bad = np.asarray(bad | (given & complete & (least <= 0)))
    _leave(findings, "bad covariance", "errors that are missing, 0, negative, or no covariance", bad, telemetry)
    used = given & ~bad
    rows = np.flatnonzero(used)
    same, again = np.zeros(len(used), dtype=bool), np.zeros(len(used), dtype=bool)
    if rows.size > 1:
        sigma = np.sqrt(np.trace(value[rows[1:]], axis1=1, axis2=2))
        repeated = (np.diff(telemetry.fix_m[rows], axis=0) == 0).all(axis=1)
        moved = np.diff(way_m[rows]) > np.minimum(0.5 * sigma, 0.05)
        same[rows[1:]] = repeated & moved
        again[rows[1:]] = repeated & ~moved
    _leave(findings, "stuck position", "it repeats the one before though the wheels turned", same, telemetry)
    _leave(findings, "repeated position", "sent again while the rover stands: one measurement", again, telemetry)
    used &= ~same & ~again
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
        first = float(telemetry.time_s[int(np.argmax(rows))])
        findings.add(kind, what, "these positions are left out", count=int(rows.sum()), time_s=first)


def usable_headings(telemetry: Telemetry, turned_deg: FloatArray, findings: Findings) -> Telemetry:
    """Headings without full turns between rows, and without those that hang.

    `turned_deg` is the turn that the wheels say until each row. (n,) Raises DataError where none is left.
    """
    yaw, sigma = telemetry.yaw_deg.copy(), telemetry.yaw_deg_sigma.copy()
    blank = np.isfinite(yaw) & ~(np.isfinite(sigma) & (sigma > 0))
    if blank.any():
        first = float(telemetry.time_s[int(np.argmax(blank))])
        findings.add(
            "bad heading error",
            "yaw_deg_sigma is missing, 0 or negative",
            "these headings are left out",
            count=int(blank.sum()),
            time_s=first,
        )
        yaw[blank] = np.nan
    known = np.flatnonzero(np.isfinite(yaw))
    if known.size < 2:
        raise DataError(f"{telemetry.file}: {known.size} headings of use; side slip needs yaw_deg")
    hanging = _hanging(yaw, sigma, turned_deg, known)
    if hanging.any():
        first = float(telemetry.time_s[int(np.argmax(hanging))])
        what = "yaw_deg stays the same to the last digit while the rover drives"
        findings.add("stuck heading", what, "these headings are left out", count=int(hanging.sum()), time_s=first)
        yaw[hanging] = np.nan
        known = np.flatnonzero(np.isfinite(yaw))
        if known.size < 2:
            raise DataError(f"{telemetry.file}: yaw_deg is the same throughout while the wheels turn the rover")
    lost = ~np.isfinite(yaw) & ~hanging & ~blank
    if lost.any():
        first = float(telemetry.time_s[int(np.argmax(lost))])
        findings.add("missing headings", "rows without yaw_deg", "found from the others", count=int(lost.sum()),
                     time_s=first)  # fmt: skip
    yaw[known] = np.degrees(np.unwrap(np.radians(yaw[known])))
    return dataclasses.replace(telemetry, yaw_deg=yaw)


def _hanging(yaw: FloatArray, sigma: FloatArray, turned_deg: FloatArray, known: IndexArray) -> BoolArray:
    result = np.zeros(len(yaw), dtype=bool)
    values = yaw[known]
    changes = np.abs(np.diff(values))
    finest = float(np.min(changes[changes > 0], initial=np.inf))
    begins = np.flatnonzero(np.append(True, changes > 0))
    for begin, end in zip(begins, [*begins[1:], len(values)], strict=True):
        rows = known[begin:end]
        turn = float(np.ptp(turned_deg[rows]))
        error = float(np.median(sigma[rows]))
        long = len(rows) >= HANG_ROWS and finest < 0.5 * error and turn > 0
        if len(rows) >= 3 and (turn > max(HANG_DEG, 5.0 * error) or long):
            result[rows[1:]] = True
    return result
