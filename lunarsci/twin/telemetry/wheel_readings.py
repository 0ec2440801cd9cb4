"""In which units wheels, their steering and the clock are written: each column beside the others.

Angles, rates and commands tell of the same turn, measured and commanded steering of the same angle, and no rim is much
faster than its rover. As in `readings`, a reading is what a writer of such files may have done, with its odds
beforehand; the much likelier one is taken and said, readings that are alike are refused with both named. A column that
goes with no other in any unit is left out.
"""

import itertools
import math
from dataclasses import dataclass, replace

import numpy as np

from lunarsci.arrays import FloatArray
from lunarsci.errors import DataError
from lunarsci.twin.rover import Rover
from lunarsci.twin.telemetry.columns import DEG, UNITS
from lunarsci.twin.telemetry.reading import Findings, Telemetry
from lunarsci.twin.telemetry.readings import ALIKE, RARE, STRANGE

AGREE, FASTER, SLOWER = 0.2, 0.25, 1.0
"""Standard deviation, in ln, of one column over another (a motor may be slower than told), and of the fastest rim over
the rover's highest speed, if it is faster and if it is slower; assumed."""
TURNING, NOISE, FEWEST = 0.3, 0.05, 3
"""Share of the usual turn from which on a row counts, of the largest from which on one is no noise, and how many rows
there are at least; assumed."""
LEAST_DEG = 1.0
"""Angle of one of both from which on steering counts: it is noise below; assumed. [deg]"""
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
    rim, found = rover.wheel.shearing_radius_m, {}
    for name, own in NAMED.items():
        others = UNITS[own] | ({"deg_s": rim / DEG, "rad_s": rim} if own == "m_s" else {})
        plain = [Unit(own.replace("_", "/"), 1.0, 0.0)]
        plain += [Unit(text.replace("_", "/"), factor) for text, factor in others.items()]
        if name != "time_s":
            turned = "to the right" if name.startswith("steer") else "backwards"
            # What a sensor measures is told by the rover's motion, too.
            odds = STRANGE if name in COMMANDED else STRANGE - 2.0 * ALIKE
            plain += [Unit(f"{u.name}, positive {turned}", -u.factor, u.ln_odds + odds) for u in plain]
            plain += [Unit("no unit at all", math.nan, RARE)]
        found[name] = tuple(plain)
    return found


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
    fastest = {name: _fastest(per_deg * rate) / rover.max_speed_m_s for name, rate in turns.items()}
    telemetry = _taken(telemetry, _likeliest(units, ratios, fastest, telemetry.file), findings)
    ratio = {STEERING: _ratio(telemetry.steered_deg, telemetry.steering_deg, LEAST_DEG)}
    return _taken(telemetry, _likeliest({name: units[name] for name in STEERING}, ratio, {}, telemetry.file), findings)


def between(values: FloatArray) -> FloatArray:
    """Mean of successive rows, of one where only that one is known. (n - 1, wheels)"""
    before, after = values[:-1], values[1:]
    both = 0.5 * (before + after)
    return np.where(np.isfinite(both), both, np.where(np.isfinite(before), before, after))


def _ratio(values: FloatArray, wanted: FloatArray, least: float = 0.0) -> float:
    """Median of one column over another, where that one is large; NaN where there are too few rows."""
    known = np.isfinite(values) & np.isfinite(wanted)
    known &= np.maximum(np.abs(wanted), np.abs(values) * (least > 0)) > least
    known &= np.abs(wanted) > TURNING * _usual(wanted[known])
    return float(np.median(values[known] / wanted[known])) if known.sum() >= FEWEST else math.nan


def _fastest(rim_m_s: FloatArray) -> float:
    known = rim_m_s[np.isfinite(rim_m_s)]
    return _usual(known) if known.size else math.nan


def _usual(values: FloatArray) -> float:
    """Median size of what is no noise at rest; the very largest ones may be wild."""
    size = np.abs(values)
    return float(np.median(size[size >= NOISE * np.percentile(size, 98)])) if size.size else 0.0


def _likeliest(
    units: dict[str, tuple[Unit, ...]], ratios: dict[tuple[str, str], float], fastest: dict[str, float], file: str
) -> dict[str, Unit]:
    """The units of columns that some ratio or speed tells of. Raises DataError where some are alike."""
    told = {name for pair, ratio in ratios.items() if math.isfinite(ratio) for name in pair}
    told |= {name for name, share in fastest.items() if math.isfinite(share)}
    names = [name for name in units if name in told or (name == "time_s" and "angle_deg" in told)]
    named = {name: units[name][0] for name in names}
    # Any other reading is less probable beforehand by STRANGE at least.
    if not names or _ln_probable(named, ratios, fastest) > STRANGE + ALIKE:
        return named
    every = itertools.product(*(units[name] for name in names))
    tried: list[dict[str, Unit]] = [dict(zip(names, one, strict=True)) for one in every]
    ln_probable = [_ln_probable(one, ratios, fastest) for one in tried]
    near = [one for one, own in zip(tried, ln_probable, strict=True) if own > max(ln_probable) - ALIKE]
    if len(near) > 1:
        ways = [", ".join(_words(name, unit) for name, unit in one.items() if unit.factor != 1.0) for one in near]
        raise DataError(f"{file}: {', or '.join(way or 'all is as named' for way in ways)}: convert what is wrong")
    return near[0]


def _words(name: str, unit: Unit) -> str:
    column = name if name == "time_s" else name.replace("_", "_W_", 1)
    return f"{column} goes with no other column" if math.isnan(unit.factor) else f"{column} looks like {unit.name}"


def _ln_probable(tried: dict[str, Unit], ratios: dict[tuple[str, str], float], fastest: dict[str, float]) -> float:
    """ln of how probable some units are, up to a constant."""
    found = sum(unit.ln_odds for unit in tried.values())
    # Of an angle it is the change in a time that counts.
    factor = {name: unit.factor for name, unit in tried.items()}
    factor["angle_deg"] = factor.get("angle_deg", math.nan) / factor.get("time_s", 1.0)
    for (a, b), ratio in ratios.items():
        ratio *= factor.get(a, math.nan) / factor.get(b, math.nan)
        if math.isfinite(ratio):
            found -= 0.5 * (math.log(max(abs(ratio), 1e-9)) / AGREE) ** 2 - (2.0 * RARE if ratio < 0.0 else 0.0)
    for name, share in fastest.items():
        share *= abs(factor.get(name, math.nan))
        if share > 0.0:
            found -= 0.5 * (math.log(share) / (FASTER if share > 1.0 else SLOWER)) ** 2
    return found


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
