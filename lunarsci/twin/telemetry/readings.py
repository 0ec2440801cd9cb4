"""How the columns of telemetry may be meant: each reading with its odds beforehand, and how probable it makes the file.

A reading is what a writer of such files may have done: another unit, another axis, another sense of turning. Wheels,
headings and positions tell of one motion, up to slips and errors, in the right one alone. The likelihood is coarse: the
displacement between positions and the turn between headings beside those of wheels without slip, with errors by
Student's law. One reading that is much more probable than all others is taken and said; readings that are alike are
refused, with both named. Where wheels turn the rover little, headings mirrored and axes exchanged look alike.

Units of wheels, their steering and the clock follow from each column beside the others. Angles, rates and commands tell
of the same turn, measured and commanded steering of the same angle, and no rim is much faster than its rover. A column
that goes with no other in any unit is left out.

Localised positions and headings: what of them can be used, and whether they share a frame with the wheels.

Roll and pitch of the rover: those of the ground it stands on, and how they move its origin.
"""

import dataclasses
import itertools
import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from lunarsci.arrays import BoolArray, FloatArray, IndexArray
from lunarsci.errors import DataError
from lunarsci.twin.plans.motion import GAP
from lunarsci.twin.rover import Rover
from lunarsci.twin.simulation.prescribed_motion import PrescribedLoads
from lunarsci.twin.telemetry.checks import check_far, ordered
from lunarsci.twin.telemetry.reading import (
    DEG,
    OBEYED,
    STILL,
    UNITS,
    Findings,
    Positions,
    Telemetry,
    chance_by_noise,
    held,
)
from lunarsci.twin.telemetry.smoother import FREEDOM, MEAN_SIGMA
from lunarsci.twin.telemetry.wheel_motion import SIGMA_DEG, UNDER_WAY, between

SLIPS = np.array(MEAN_SIGMA[:2])
"""Standard deviation of what slip makes of ways ahead and to the left throughout, as in `smoother`."""
CHANGES, TURNS, TURNS_PER_M = 0.1, 0.1, math.radians(0.5)
"""The same of how it changes between positions, of a turn, and of a turn on a straight way; assumed. [-, -, rad/m]"""
APART_M, FEWEST = 0.4, 4
"""Way between positions that are compared, and how many there are at least; assumed. [m]"""
USUAL = np.array([0.15, 0.1])
"""The first ones for a reading that is not as the names say: it has to explain a drive by usual slips; assumed."""
SKID_TURNS = 0.5
"""The same of a turn for a rover that steers by its sides' speeds; see `smoother.SKID_SIGMA`."""
ALIKE = math.log(20.0)
"""ln of the odds of the best reading against another up to which the two are alike; assumed."""
STRANGE, RARE = math.log(1e-6), math.log(1e-9)
"""ln of the odds of a reading that is not as the names say, and of one that fits whatever is there; assumed."""
ROLLED, FINEST_M = 0.003, 0.001
"""How well positions that were computed from the wheels repeat their way, as a share of it, and to which digit they are
written; assumed. [-, m]"""


def _same(values: FloatArray) -> FloatArray:
    return values.copy()


def _scaled(factor: float) -> Callable[[FloatArray], FloatArray]:
    return lambda values: factor * values


@dataclass(frozen=True, slots=True, kw_only=True)
class Reading:
    """A way to read positions, headings and steering.

    Attributes
    ----------
    meaning : what it means, as a sentence; empty for as the names say.
    heading, place : from a column as written to what is meant. (n,) [deg], (n, 2) [m]
    metres : of a position's unit. Positions that are many times smaller than they seem fit any motion the better; so
        their density counts, and not that of headings, whose scatter tells nothing of a unit where a drive is straight.
    turn, rims : what it makes of the turn that the wheels say, as their steering is, and of how far they roll.
    errors : what is meant over what is written of the errors of positions.
    ln_odds : beforehand.
    way_sigma, least_m : share of the way, and length, by which positions scatter; None takes slips and stated errors.
    """

    meaning: str
    heading: Callable[[FloatArray], FloatArray] = _same
    place: Callable[[FloatArray], FloatArray] = _same
    metres: float = 1.0
    turn: float = 1.0
    rims: float = 1.0
    errors: float = 1.0
    ln_odds: float = STRANGE
    way_sigma: float | None = None
    least_m: float = 0.0


AS_NAMED = Reading(meaning="", ln_odds=0.0)
ROLLED_ALONE = Reading(meaning="x_m and y_m are computed from the wheels", way_sigma=ROLLED, least_m=FINEST_M)
ANY = Reading(meaning="another frame", way_sigma=2.0, turn=0.0, ln_odds=RARE)
READINGS = (
    AS_NAMED,
    ROLLED_ALONE,
    ANY,
    Reading(meaning="x_m and y_m are exchanged", place=lambda p: p[:, ::-1]),
    Reading(meaning="y_m points to the right of x_m", place=lambda p: p * [1.0, -1.0]),
    Reading(meaning="yaw_deg grows to the right, as in a frame with z down", heading=_scaled(-1.0)),
    Reading(meaning="yaw_deg is measured from y (north) clockwise", heading=lambda yaw: 90.0 - yaw),
    Reading(meaning="yaw_deg is measured from y", heading=lambda yaw: 90.0 + yaw),
    Reading(meaning="yaw_deg points backwards", heading=lambda yaw: yaw + 180.0),
    Reading(meaning="yaw_deg looks like rad", heading=np.degrees),
    Reading(
        meaning="x, y and yaw_deg are those of a frame with z down (x north, y east)",
        heading=_scaled(-1.0),
        place=lambda p: p * [1.0, -1.0],
    ),
    Reading(meaning="steering is positive to the right", turn=-1.0),
    Reading(meaning="the steering angles look like rad", turn=math.degrees(1.0)),
    Reading(meaning="the turns of the wheels look like rad", rims=math.degrees(1.0)),
    Reading(meaning="errors of positions look like mm", errors=1e-3),
    Reading(meaning="errors of positions look like cm", errors=1e-2),
    *(
        Reading(meaning=f"x_m and y_m look like {unit}", place=_scaled(metres), metres=metres)
        for unit, metres in (("dm", 0.1), ("cm", 0.01), ("mm", 0.001), ("km", 1000.0))
    ),
)
"""What writers of telemetry do; another frame is one that no reading explains."""


def as_meant(
    telemetry: Telemetry, twist: FloatArray, findings: Findings, *, skids: bool = False, as_planned: bool = False
) -> Telemetry:
    """Telemetry as it is most probably meant; said where that is not as its columns are named.

    `twist` is the velocity that wheels without slip say between rows (n - 1, 3), `skids` whether none is steered,
    `as_planned` whether steering is that of a plan. Raises DataError where several readings are alike.
    """
    readings = [one for one in READINGS if not as_planned or one.turn in (0.0, 1.0)]
    ln_probable = np.array(
        [one.ln_odds + _ln_likelihood(one, telemetry, twist, SKID_TURNS if skids else TURNS) for one in readings]
    )
    best = readings[int(np.argmax(ln_probable))]
    near = [one for one, ln in zip(readings, ln_probable, strict=True) if ln > ln_probable.max() - ALIKE]
    if AS_NAMED in near:
        return telemetry
    if best is ROLLED_ALONE:
        what = "x_m and y_m repeat the way of the wheels: no slip can be learned from them"
        findings.add("positions are odometry", what, "kept; give positions by pictures, lidar or radio", doubt=True)
    elif best is ANY:
        what = "positions, headings and wheels tell of different motions, in any frame and unit"
        findings.add("heading against motion", what, "kept as they are", doubt=True)
    elif len(near) > 1:
        meanings = ", or ".join(one.meaning for one in near)
        raise DataError(
            f"{telemetry.file}: {meanings}; x is to the right of the map, y up, yaw_deg from x towards y in degrees, "
            "steering positive to the left: convert it"
        )
    else:
        findings.add("read as", best.meaning, "taken so; x is east, y north, yaw_deg from x towards y in degrees")
        yaw = best.heading(telemetry.yaw_deg)
        given = np.isfinite(yaw)
        yaw[given] = np.unwrap(yaw[given], period=360.0)
        return dataclasses.replace(
            telemetry,
            yaw_deg=yaw,
            fix_m=best.place(telemetry.fix_m),
            fix_covariance_m2=best.errors**2 * telemetry.fix_covariance_m2,
            steering_deg=best.turn * telemetry.steering_deg,
            steered_deg=best.turn * telemetry.steered_deg,
            angle_deg=best.rims * telemetry.angle_deg,
            rate_deg_s=best.rims * telemetry.rate_deg_s,
        )
    return telemetry


def _ln_likelihood(reading: Reading, telemetry: Telemetry, twist: FloatArray, turns: float) -> float:
    """ln of how probable a reading makes positions and headings, up to a constant that all readings share."""
    rows, times, twist = _apart(telemetry, twist), telemetry.time_s, reading.rims * twist
    given = np.isfinite(telemetry.yaw_deg)
    yaw = np.radians(np.interp(times, times[given], reading.heading(telemetry.yaw_deg)[given]))
    steps, middle = np.diff(times), 0.5 * (yaw[1:] + yaw[:-1])
    ahead, left = twist[:, 0] * steps, twist[:, 1] * steps
    moved = np.column_stack(
        [np.cos(middle) * ahead - np.sin(middle) * left, np.sin(middle) * ahead + np.cos(middle) * left]
    )
    way = np.add.reduceat(np.hypot(ahead, left), rows[:-1])
    turned = np.add.reduceat(np.abs(twist[:, 2]) * steps, rows[:-1])
    turn = reading.turn * np.add.reduceat(twist[:, 2] * steps, rows[:-1])
    wanted = np.add.reduceat(moved, rows[:-1], axis=0)
    off = np.diff(reading.place(telemetry.fix_m[rows]), axis=0) - wanted
    course = np.arctan2(wanted[:, 1], wanted[:, 0])
    share = np.column_stack(
        [
            np.cos(course) * off[:, 0] + np.sin(course) * off[:, 1],
            np.cos(course) * off[:, 1] - np.sin(course) * off[:, 0],
        ]
    )
    variance = np.trace(telemetry.fix_covariance_m2[rows], axis1=1, axis2=2) / 2.0
    stated, rolled = reading.errors * np.sqrt(variance[1:] + variance[:-1]), way > 0.0
    if reading.way_sigma is not None:
        sigma, mean = np.hypot(reading.way_sigma * way, reading.least_m or stated), np.zeros(2)
    else:
        sigma = np.hypot(CHANGES * way, stated)
        # The slip that all ways have in common, as far as it is likely at all.
        mean = np.median(share[rolled] / way[rolled, None], axis=0) if rolled.any() else np.zeros(2)
        mean = np.clip(mean, -3.0 * SLIPS, 3.0 * SLIPS)
    ln_mean = float(-0.5 * ((mean / (USUAL if reading.meaning else SLIPS)) ** 2).sum())
    share = share - mean * way[:, None]
    yaw_sigma = math.sqrt(2.0) * math.radians(float(np.nanmedian(telemetry.yaw_deg_sigma)))
    turn_sigma = np.sqrt((turns * np.maximum(turned, np.abs(turn))) ** 2 + (TURNS_PER_M * way) ** 2 + yaw_sigma**2)
    parts = ((share[:, 0], sigma), (share[:, 1], sigma), (np.diff(yaw[rows]) - turn, turn_sigma))
    # Student's density, up to a constant.
    student = [-np.log(s) - 0.5 * (FREEDOM + 1.0) * np.log1p((value / s) ** 2 / FREEDOM) for value, s in parts]
    return ln_mean + 2.0 * len(off) * math.log(reading.metres) + float(np.sum(student))


def _apart(telemetry: Telemetry, twist: FloatArray) -> IndexArray:
    """Rows with a position, so far apart that slip shows between them; all where they are few."""
    rows = np.flatnonzero(telemetry.fixed)
    rolled = np.append(0.0, np.cumsum(np.hypot(twist[:, 0], twist[:, 1]) * np.diff(telemetry.time_s)))
    some = rows[np.unique(np.floor(rolled[rows] / APART_M), return_index=True)[1]]
    return some if len(some) >= FEWEST else rows


FASTER, SLOWER = 0.25, 1.0
"""Standard deviation, in ln, of the fastest rim over the rover's highest speed, if it is faster and if it is slower;
assumed. Of one column over another it is `OBEYED`: a motor may be slower than told."""
FEWEST_ROWS = 3
"""Rows with both columns below which one tells nothing of the other."""
STEERING = ("steered_deg", "steering_deg")
COMMANDED = ("speed_m_s", "steering_deg")
NAMED = dict.fromkeys(("angle_deg", *STEERING), "deg") | {"rate_deg_s": "deg_s", "speed_m_s": "m_s", "time_s": "s"}
"""The unit that each column is named by."""


@dataclass(frozen=True, slots=True)
class Unit:
    """What a column may be in: a word for it, by what its numbers are multiplied, and ln of its odds beforehand.

    A factor of NaN leaves the column out.
    """

    name: str
    factor: float
    ln_odds: float = STRANGE


def units_of(rover: Rover) -> dict[str, tuple[Unit, ...]]:
    """The units in which each column may be, the first as it is named."""
    rim, units = rover.wheel.shearing_radius_m, {}
    for name, unit in NAMED.items():
        others = UNITS[unit] | ({"deg_s": rim / DEG, "rad_s": rim} if unit == "m_s" else {})
        plain = [Unit(unit.replace("_", "/"), 1.0, 0.0)]
        plain += [Unit(text.replace("_", "/"), factor) for text, factor in others.items()]
        if name != "time_s":
            turned = "to the right" if name.startswith("steer") else "backwards"
            # What a sensor measures is told by the rover's motion, too.
            odds = STRANGE if name in COMMANDED else STRANGE - 2.0 * ALIKE
            plain += [Unit(f"{u.name}, positive {turned}", -u.factor, u.ln_odds + odds) for u in plain]
            plain += [Unit("no unit at all", math.nan, RARE)]
        units[name] = tuple(plain)
    return units


def in_units(telemetry: Telemetry, rover: Rover, findings: Findings) -> Telemetry:
    """Telemetry in the units that its columns are named by; said where they were others.

    Raises DataError where several units are alike.
    """
    units, per_deg = units_of(rover), math.radians(rover.wheel.shearing_radius_m)
    steps = np.diff(telemetry.time_s)[:, None]
    angle = np.diff(telemetry.angle_deg, axis=0)
    within = np.nanmax(telemetry.angle_deg, axis=0, initial=-np.inf) - np.nanmin(
        telemetry.angle_deg, axis=0, initial=np.inf
    )
    # Of angles within a turn the smaller way round.
    angle -= np.where(within <= 360.0, 360.0 * np.rint(np.nan_to_num(angle) / 360.0), 0.0)
    turns = {
        "angle_deg": angle / steps,
        "rate_deg_s": between(telemetry.rate_deg_s),
        "speed_m_s": between(telemetry.speed_m_s) / per_deg,
    }
    ratios = {(a, b): _ratio(turns[a], turns[b]) for a, b in itertools.combinations(turns, 2)}
    fastest = {
        name: _usual(per_deg * rate[np.isfinite(rate)]) / rover.max_speed_m_s
        for name, rate in turns.items()
        if np.isfinite(rate).any()
    }
    telemetry = _taken(telemetry, _likeliest(units, ratios, fastest, telemetry.file), findings)
    ratio = {STEERING: _ratio(telemetry.steered_deg, telemetry.steering_deg, SIGMA_DEG)}
    return _taken(telemetry, _likeliest({name: units[name] for name in STEERING}, ratio, {}, telemetry.file), findings)


def _ratio(values: FloatArray, wanted: FloatArray, least: float = 0.0) -> float:
    """Median of one column over another, where that one is large; NaN where there are too few rows."""
    given = np.isfinite(values) & np.isfinite(wanted)
    given &= np.maximum(np.abs(wanted), np.abs(values) * (least > 0)) > least
    given &= np.abs(wanted) > UNDER_WAY * _usual(wanted[given])
    return float(np.median(values[given] / wanted[given])) if given.sum() >= FEWEST_ROWS else math.nan


def _usual(values: FloatArray) -> float:
    """Median size of what is no noise at rest; the very largest ones may be wild."""
    size = np.abs(values)
    return float(np.median(size[size >= STILL * np.percentile(size, 98)])) if size.size else 0.0


def _likeliest(
    units: dict[str, tuple[Unit, ...]], ratios: dict[tuple[str, str], float], fastest: dict[str, float], file: str
) -> dict[str, Unit]:
    """The units of columns that some ratio or speed tells of. Raises DataError where some are alike."""
    compared = {name for pair, ratio in ratios.items() if math.isfinite(ratio) for name in pair}
    compared |= {name for name, share in fastest.items() if math.isfinite(share)}
    names = [name for name in units if name in compared or (name == "time_s" and "angle_deg" in compared)]
    named = {name: units[name][0] for name in names}
    # Any other reading is less probable beforehand by STRANGE at least.
    if not names or _ln_probable(named, ratios, fastest) > STRANGE + ALIKE:
        return named
    every = itertools.product(*(units[name] for name in names))
    tried: list[dict[str, Unit]] = [dict(zip(names, one, strict=True)) for one in every]
    ln_probable = [_ln_probable(one, ratios, fastest) for one in tried]
    near = [one for one, ln in zip(tried, ln_probable, strict=True) if ln > max(ln_probable) - ALIKE]
    if len(near) > 1:
        ways = [", ".join(_words(name, unit) for name, unit in one.items() if unit.factor != 1.0) for one in near]
        raise DataError(f"{file}: {', or '.join(way or 'all is as named' for way in ways)}: convert what is wrong")
    return near[0]


def _words(name: str, unit: Unit) -> str:
    column = name if name == "time_s" else name.replace("_", "_W_", 1)
    return f"{column} goes with no other column" if math.isnan(unit.factor) else f"{column} looks like {unit.name}"


def _ln_probable(tried: dict[str, Unit], ratios: dict[tuple[str, str], float], fastest: dict[str, float]) -> float:
    """ln of how probable some units are, up to a constant."""
    ln = sum(unit.ln_odds for unit in tried.values())
    # Of an angle it is the change in a time that counts.
    factor = {name: unit.factor for name, unit in tried.items()}
    factor["angle_deg"] = factor.get("angle_deg", math.nan) / factor.get("time_s", 1.0)
    for (a, b), ratio in ratios.items():
        ratio *= factor.get(a, math.nan) / factor.get(b, math.nan)
        if math.isfinite(ratio):
            ln -= 0.5 * (math.log(max(abs(ratio), 1e-9)) / OBEYED) ** 2 - (2.0 * RARE if ratio < 0.0 else 0.0)
    for name, share in fastest.items():
        share *= abs(factor.get(name, math.nan))
        if share > 0.0:
            ln -= 0.5 * (math.log(share) / (FASTER if share > 1.0 else SLOWER)) ** 2
    return ln


def _taken(telemetry: Telemetry, units: dict[str, Unit], findings: Findings) -> Telemetry:
    """Telemetry with its columns in other units, said."""
    changed = {name: unit.factor for name, unit in units.items() if unit.factor != 1.0}
    for name, factor in changed.items():
        lost = math.isnan(factor)
        done = "it is left out" if lost else "taken so; name the unit in the column's name, or convert it"
        findings.add("read as", _words(name, units[name]), done, doubt=lost)
    clock = changed.get("time_s", 1.0)
    return replace(
        telemetry,
        rests_s=tuple((clock * begin, clock * end) for begin, end in telemetry.rests_s),
        start_s=clock * telemetry.start_s,
        **{name: factor * getattr(telemetry, name) for name, factor in changed.items()},
    )


ATTITUDE_DEG, FOLLOWS, MOUNTED_DEG = 1.5, 0.6, 3.0
"""Median difference of roll or pitch from the terrain's beyond which it is said [deg], or as a share of its slope where
that is more; and by how much their sensor may be turned on the rover [deg]; assumed."""


def sway_m(rover: Rover, paths: FloatArray) -> FloatArray:
    """How far the rover's origin is from above the point that its wheels stand about, by roll and pitch. (n, 2) [m]

    The wheels carry that point; the origin sways above it, which is no slip. Where how the rover stands is not known,
    as beside a halt, it stands as about there: a tilt left out would be a jump, and read as a slip.
    """
    height = rover.wheel.radius_m - float(rover.wheel_positions_m[:, 2].mean())
    given = np.flatnonzero(np.isfinite(paths[:, 3:5]).all(axis=1))
    tilts = paths[given, 3:5] if given.size else np.zeros((1, 2))
    roll, pitch = np.radians([np.interp(np.arange(len(paths)), given if given.size else [0], c) for c in tilts.T])
    yaw = np.radians(np.nan_to_num(paths[:, 5]))
    ahead, left = np.sin(pitch) * np.cos(roll), -np.sin(roll)
    return height * np.column_stack(
        [np.cos(yaw) * ahead - np.sin(yaw) * left, np.sin(yaw) * ahead + np.cos(yaw) * left]
    )


def check_attitude(telemetry: Telemetry, held: PrescribedLoads, rows: IndexArray, findings: Findings) -> None:
    """Roll and pitch are those of a rover that stands on this terrain; all alike off is their sensor's mounting."""
    for column, name in ((3, "roll_deg"), (4, "pitch_deg")):
        measured, stood = getattr(telemetry, name)[rows], held.paths[:, column]
        given = np.isfinite(measured) & np.isfinite(stood)
        if given.sum() < 5:
            continue
        a, b = measured[given], stood[given]

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
        findings.add("attitude against terrain", what, done, count=int(given.sum()), doubt=not turned)


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
    result = np.where((high > low)[:, None], flat[low] + share[:, None] * step, flat[low])
    return np.asarray(result.reshape(len(merged), *values.shape[1:]))


def usable_positions(telemetry: Telemetry, way_m: FloatArray, findings: Findings) -> Telemetry:
    """Positions without those that have no proper covariance or only repeat the one before.

    `way_m` is the way of the rims until each row. (n,) Raises DataError where fewer than two are left.
    """
    given, value = telemetry.fixed, telemetry.fix_covariance_m2
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
    findings.of_rows(kind, what, f"these {kind.split()[-1]}s are left out", rows, telemetry.time_s)


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
    rows = np.flatnonzero(np.isfinite(yaw))
    if rows.size < 2:
        raise DataError(f"{telemetry.file}: {rows.size} headings of use; side slip needs yaw_deg")
    findings.of_rows("missing headings", "rows without yaw_deg", "found from the others", ~given, telemetry.time_s)
    yaw[rows] = np.degrees(np.unwrap(np.radians(yaw[rows])))
    return dataclasses.replace(telemetry, yaw_deg=yaw)
