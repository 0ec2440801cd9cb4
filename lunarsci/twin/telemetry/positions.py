"""Localised positions and headings: what of them can be used, and whether they share a frame with the wheels.

Roll and pitch of the rover: those of the ground it stands on, and how they move its origin.
"""

import dataclasses
import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np

from lunarsci.arrays import BoolArray, FloatArray, IndexArray, samples_about
from lunarsci.errors import DataError
from lunarsci.twin.loads.prescribed_motion import PrescribedLoads
from lunarsci.twin.rover import Rover
from lunarsci.twin.telemetry.checks import check_far, ordered, taken
from lunarsci.twin.telemetry.reading import WHEEL_COLUMNS, Findings, Positions, Telemetry
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


def without_lag(telemetry: Telemetry, lag_s: float, findings: Findings) -> Telemetry:
    """Rows with positions, headings and attitude put back to the time of the wheels that made them: a lag earlier.

    Columns of the wheels are taken to change evenly between rows. Rows before the first time or after the last one are
    left out.
    """
    if lag_s == 0.0:
        return telemetry
    telemetry = ordered(telemetry, findings)
    times = telemetry.time_s
    at = times - lag_s
    rows = np.flatnonzero((at >= times[0]) & (at <= times[-1]))
    found = taken(telemetry, rows)
    low, share = samples_about(times, at[rows])
    columns: dict[str, Any] = {"time_s": at[rows]}
    for name in WHEEL_COLUMNS:
        before, after = (getattr(telemetry, name)[row] for row in (low, low + 1))
        columns[name] = before + share[:, None] * (after - before)
    rests = tuple((begin - lag_s, end - lag_s) for begin, end in telemetry.rests_s)
    return dataclasses.replace(found, rests_s=rests, **columns)


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


ASTRAY_DEG = 15.0
"""Median angle between displacement and heading which no side slip makes; assumed. [deg]"""
CLEAR_DEG = 5.0
"""Turn that wheels must say before heading is compared with it; assumed. [deg]"""
LONGER, SHORTER = 2.5, 0.02
"""Displacement over way of the rims beyond which the unit is wrong; assumed: no rover glides so far, and one whose
wheels only spin is met by `SHORTER`."""
SHIFT = 0.5
"""Share of the way between two positions by which they must be off to have shifted, the next ones fitting; assumed."""
LEAST_M = 1e-6
"""Way between two positions of a rover that stands, which is divided by. [m]"""
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


ALIKE_DEG = 0.3
"""Readings that differ by less are told apart by their order; assumed."""


@dataclass(frozen=True, slots=True)
class _Reading:
    """Another way to read headings and positions, and what it would mean."""

    meaning: str
    heading: Callable[[FloatArray], FloatArray]
    place: Callable[[FloatArray], FloatArray]


READINGS = (
    _Reading("x_m and y_m are exchanged", lambda yaw: yaw, lambda p: p[:, ::-1]),
    _Reading("y_m points to the right of x_m", lambda yaw: yaw, lambda p: p * [1.0, -1.0]),
    _Reading("yaw_deg grows to the right, as in a frame with z down", lambda yaw: -yaw, lambda p: p),
    _Reading("yaw_deg is measured from y (north) clockwise", lambda yaw: 90.0 - yaw, lambda p: p),
    _Reading("yaw_deg is measured from y", lambda yaw: 90.0 + yaw, lambda p: p),
    _Reading("yaw_deg is in rad", np.degrees, lambda p: p),
    _Reading("yaw_deg points backwards", lambda yaw: yaw + 180.0, lambda p: p),
)


def check_frame(telemetry: Telemetry, twist: FloatArray, findings: Findings) -> None:
    """Whether positions, headings and wheels tell of the same motion in the same frame.

    `twist` is the velocity that the wheels say between rows. (n - 1, 3) Raises DataError for a wrong unit or frame
    where one reading explains what is seen; what no reading explains is a finding that puts the result in doubt.
    """
    rows = np.flatnonzero(telemetry.fixed)
    moved = np.diff(telemetry.fix_m[rows], axis=0)
    wanted = _displacements(telemetry, twist, rows, telemetry.yaw_deg)
    sigma = np.sqrt(np.trace(telemetry.fix_covariance_m2[rows], axis1=1, axis2=2) / 2.0)
    long = np.hypot(*wanted.T) > 4.0 * np.hypot(sigma[1:], sigma[:-1])
    _check_lengths(telemetry.file, np.hypot(*moved.T), np.hypot(*wanted.T))
    _check_turn(telemetry, twist, moved, wanted, long, findings)
    if not long.any():
        return
    still = np.append(0, np.cumsum((twist == 0.0).all(axis=1)))[rows]
    least = np.where(np.diff(still) > 0, np.inf, 6.0 * np.hypot(sigma[1:], sigma[:-1]))
    _check_shift(telemetry, rows, moved, wanted, least, findings)
    astray = _astray_deg(moved[long], wanted[long])
    if astray <= ASTRAY_DEG:
        return
    others = []
    for reading in READINGS:
        read = _displacements(telemetry, twist, rows, reading.heading(telemetry.yaw_deg))
        others.append(_astray_deg(reading.place(moved)[long], read[long]))
    # A mirrored heading and mirrored positions fit alike; a heading that turns against the wheels is found before.
    best = int(np.argmax(np.array(others) <= min(others) + ALIKE_DEG))
    text = f"displacements point {astray:.0f} deg off the heading in the median"
    if others[best] < min(ASTRAY_DEG, 0.5 * astray):
        raise DataError(
            f"{telemetry.file}: {text}, but {others[best]:.1f} deg if {READINGS[best].meaning}; x is to the right of "
            "the map, y up, yaw_deg from x towards y in degrees: convert it"
        )
    findings.add("heading against motion", text, "kept as they are", count=int(long.sum()), doubt=True)


def _check_shift(
    telemetry: Telemetry,
    rows: IndexArray,
    moved: FloatArray,
    wanted: FloatArray,
    least_m: FloatArray,
    findings: Findings,
) -> None:
    """Positions that jump once and stay: another frame from then on. A single bad one jumps back.

    `least_m` is how far each displacement must be off at least, infinite over a halt: `outliers` judges that.
    """
    off, way = moved - wanted, np.maximum(np.hypot(*wanted.T), LEAST_M)
    size = np.hypot(*off.T)
    calm = np.append(np.append(np.inf, size[:-1] / way[:-1]), np.inf), np.append(size[1:] / way[1:], np.inf)
    for k in np.flatnonzero(size > np.maximum(SHIFT * way, least_m)):
        before = k == 0 or calm[0][k] < 0.5 * SHIFT
        after = k + 1 == len(size) or calm[1][k] < 0.5 * SHIFT
        if before and after and 0 < k < len(size) - 1:
            what = f"positions shift by {size[k]:.3g} m against the wheels and stay there: another frame from then on"
            first = float(telemetry.time_s[rows[k + 1]])
            findings.add("position shift", what, "kept; states beside it are wrong", time_s=first, doubt=True)


def _displacements(telemetry: Telemetry, twist: FloatArray, rows: IndexArray, yaw_deg: FloatArray) -> FloatArray:
    """Displacement between successive positions that wheels and headings say. (rows - 1, 2) [m]"""
    known = np.isfinite(yaw_deg)
    yaw = np.radians(np.interp(telemetry.time_s, telemetry.time_s[known], yaw_deg[known]))
    middle, steps = 0.5 * (yaw[1:] + yaw[:-1]), np.diff(telemetry.time_s)
    ahead, left = twist[:, 0] * steps, twist[:, 1] * steps
    x = np.append(0.0, np.cumsum(np.cos(middle) * ahead - np.sin(middle) * left))
    y = np.append(0.0, np.cumsum(np.sin(middle) * ahead + np.cos(middle) * left))
    return np.diff(np.column_stack([x, y])[rows], axis=0)


def _astray_deg(moved: FloatArray, wanted: FloatArray) -> float:
    cross = wanted[:, 0] * moved[:, 1] - wanted[:, 1] * moved[:, 0]
    return float(np.median(np.abs(np.degrees(np.arctan2(cross, (wanted * moved).sum(axis=1))))))


def _check_lengths(file: str, moved_m: FloatArray, wanted_m: FloatArray) -> None:
    ahead = wanted_m > 0.05
    if not ahead.any():
        return
    ratio = float(np.median(moved_m[ahead] / wanted_m[ahead]))
    units = {10.0: "dm", 100.0: "cm", 1000.0: "mm", 0.001: "km"}
    unit = next((name for factor, name in units.items() if abs(math.log(max(ratio, 1e-12) / factor)) < 0.4), "")
    hint = f": x_m and y_m look like {unit}" if unit else ": are x_m and y_m in m, and the wheels those of this rover?"
    if ratio > LONGER or (ratio < SHORTER and unit):
        raise DataError(f"{file}: positions move {ratio:.3g} times as far as the rims turn{hint}; convert them")


def _check_turn(
    telemetry: Telemetry, twist: FloatArray, moved: FloatArray, wanted: FloatArray, long: BoolArray, findings: Findings
) -> None:
    """Heading must turn as the wheels say, in sense and in size."""
    turned = np.degrees(np.append(0.0, np.cumsum(twist[:, 2] * np.diff(telemetry.time_s))))
    known = np.isfinite(telemetry.yaw_deg)
    turn = turned[known] - turned[known].mean()
    yaw = telemetry.yaw_deg[known] - telemetry.yaw_deg[known].mean()
    if np.ptp(turn) < max(CLEAR_DEG, 20.0 * float(np.median(telemetry.yaw_deg_sigma[known]))):
        return
    slope = float((turn * yaw).sum() / (turn * turn).sum())
    text = f"{telemetry.file}: the heading turns {slope:.3g} times as far as the wheels make it"
    if 0.005 < slope < 0.06:
        raise DataError(f"{text}: yaw_deg looks like rad; convert it to degrees")
    if 20 < abs(slope) < 120:
        raise DataError(f"{text}: the steering angles look like rad; convert them to degrees")
    if slope < -0.5:
        which = _sense(telemetry, twist, moved, wanted, long)
        raise DataError(
            f"{text}: {which}, or steering is positive to the right; x, y, z of this program are east, north, up, "
            "yaw_deg and steering positive to the left: convert them"
        )
    if not 0.5 < slope < 1.5:
        what = f"the heading turns {slope:.3g} times as far as the wheels make it"
        findings.add("heading against wheels", what, "kept as it is", doubt=True)


def _sense(telemetry: Telemetry, twist: FloatArray, moved: FloatArray, wanted: FloatArray, long: BoolArray) -> str:
    """What a heading that turns against the wheels means."""
    if not long.any():
        return "yaw_deg grows to the right"
    if _astray_deg(moved[long], wanted[long]) < ASTRAY_DEG and _mirrored(moved[long]):
        return "x, y and yaw_deg are those of a frame with z down (x north, y east)"
    rows = np.flatnonzero(telemetry.fixed)
    others = [
        reading for reading in READINGS if "to the right, as" in reading.meaning or "clockwise" in reading.meaning
    ]
    off = [
        _astray_deg(moved[long], _displacements(telemetry, twist, rows, reading.heading(telemetry.yaw_deg))[long])
        for reading in others
    ]
    return others[int(np.argmin(off))].meaning


def _mirrored(moved: FloatArray) -> bool:
    """Whether the way bends enough for its sense to be seen."""
    course = np.unwrap(np.arctan2(moved[:, 1], moved[:, 0]))
    return bool(np.ptp(course) > math.radians(CLEAR_DEG))
