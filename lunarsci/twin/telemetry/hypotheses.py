"""What telemetry may mean and what may be wrong with it: tables of hypotheses, weighed by one rule.

A hypothesis is a transform of readings, or a constant of the motion that may be far from 0, with odds beforehand and a
remedy. Its likelihood is that of what wheels, headings and positions tell of one motion, up to slips and errors; errors
follow Student's law. What it leaves open is profiled (the slip that all ways share) or integrated (constants). It is
reported where it is more probable than not. Columns are only converted where that is `DECISIVE`; else they are refused.

* Units of wheels, their steering and the clock follow from each column beside the others. Angles, rates and commands
  tell of the same turn, measured and commanded steering of the same angle, and no rim is much faster than its rover.
* `FRAMES` are what writers of positions and headings do: another unit, another axis, another sense of turning. Where
  wheels turn the rover little, headings mirrored and axes exchanged look alike.
* `MOTION` are constants of a whole drive. As the state is linear in them (see `filter`), the marginal likelihood of any
  set of hypotheses is a quadratic form (MacKay 2003, ch. 28). None is chosen: constants are averaged over the sets,
  each as probable as it is.
* A channel may only repeat itself: `repeated`.
"""

import itertools
import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from lunarsci.arrays import BoolArray, FloatArray, IndexArray
from lunarsci.errors import DataError
from lunarsci.twin.rover import Rover
from lunarsci.twin.telemetry.filter import DRIFT, LAG, LEVER, OFFSET, SCALE, SLIDES, FilterRun, Nodes, onto_map
from lunarsci.twin.telemetry.reading import (
    LEAST_ROW_M,
    OBEYED,
    SIGMA_DEG,
    STILL,
    SURE,
    UNDER_WAY,
    Findings,
    Telemetry,
    between,
)
from lunarsci.units import DEG, SIZES

LN_ODDS = {
    name: math.log(odds)
    for name, odds in {
        "motion": 0.1, "encoders": 3.0, "units": 1e-6, "anything": 1e-9, "failure": 1e-4, "reading": 0.01,
        "clock step": 1e-4, "clock offset": 1e-3, "commands": 1e-7,
    }.items()
}  # fmt: skip
"""ln of the odds of each kind of hypothesis beforehand; assumed. A constant of the motion is far from 0; encoders have
another scale where they differ from commands, as a motor that is controlled turns as told; columns are in another unit
or axis, or in one that fits whatever is there; a channel is only sent again, or a position or heading is wrong
altogether. Of a step: a reading says nothing of it, the clock jumps. Of the plan: the clock is another one, and of each
metre commands are others."""
DECISIVE = math.log(20.0)
"""ln of the odds of a hypothesis against any other from which columns are converted: strong evidence (Kass & Raftery
1995, 10.1080/01621459.1995.10476572)."""
REPORTED = 0.5
"""Probability from which on a hypothesis is reported: it is more probable than not."""
FREEDOM = 4.0
"""Of Student's law of errors (Gelman et al. 2013, ch. 17: few degrees, as 4)."""
MEAN_SIGMA = (0.3, 0.1, 0.05)
"""Of the constant deviations, ahead and left as shares, turn in 1/m, where nothing is known: wide; assumed."""
LEVEL, LEVEL_SIGMA = -0.03, (0.15, 0.02)
"""Deviation ahead on level ground, as measured on soils drawn from the default priors: they slip by 0.03 in the median,
and 16 to 84 % by -0.04 to 0.11. Its standard deviation is twice as wide, lest it draw the radius along, and that to
the left."""
EFFECT_MEAN, EFFECT_SIGMA = (0.8, 2.0, 0.0, 0.0, 0.0), (0.6, 2.0, 0.1, 0.02, 0.02)
"""Of the coefficients: slip grows about as the slope is steep, side slip about twice so, and a rover that steers turns
about as its wheels say. As wide as measured on soils drawn from the default priors: 0.4 to 2.2, 0.8 to 5, -0.1 to 0,
and -0.01 to 0 in drives by the twin."""
SKID_SIGMA = (0.4, 0.2, 0.1)
"""Of the last three for a rover that steers by its sides' speeds: its tracks are up to twice as far apart as its
wheels, and turn about places that lie off its axles (Mandow et al. 2007, 10.1109/IROS.2007.4399139). [-, m, m]"""
RIM_SIGMA = 0.03
"""Of ln of a wheel's rolling radius on soil, between shell and grousers, over that of its file; assumed."""
POINT_M, CLOCK_S, STANDS_M = 0.01, 0.1, 2e-4
"""How well the localised point [m] and the clock [s] are usually known, and a rover stands at a halt [m]; assumed."""
SLIPS = np.array(MEAN_SIGMA[:2])
"""Standard deviation of what slip makes of ways ahead and to the left throughout; that of its changes is `SLIPS[1]`."""
USUAL = np.array([LEVEL_SIGMA[0], MEAN_SIGMA[1]])
"""The first ones for a frame that is not as the names say: it has to explain a drive by usual slips."""
SLOWER = 1.0
"""Standard deviation, in ln, of the fastest rim over the rover's highest speed where it is slower; assumed. Where it is
faster, and of one column over another, it is `OBEYED`."""
FEWEST_ROWS = 3
"""Rows with both columns below which one tells nothing of the other, and positions that are compared; assumed."""
STEERING = ("steered_deg", "steering_deg")
COMMANDED = ("speed_m_s", "steering_deg")
NAMED = dict.fromkeys(("angle_deg", *STEERING), "deg") | {"rate_deg_s": "deg_s", "speed_m_s": "m_s", "time_s": "s"}
"""The unit that each column is named by."""
ROLLED, FINEST_M = 0.003, 0.001
"""How well positions that were computed from the wheels repeat their way, as a share of it, and to which digit they are
written; assumed. [-, m]"""
MIRRORED = ((1.0, 0.0), (0.0, -1.0))


def ln_student(off: FloatArray, sigma: FloatArray | float) -> FloatArray:
    """ln of Student's density of errors, up to a constant."""
    return np.asarray(-np.log(sigma) - 0.5 * (FREEDOM + 1.0) * np.log1p((off / sigma) ** 2 / FREEDOM))


def decided(ln_probable: Sequence[float], meanings: Sequence[str], file: str, remedy: str) -> int:
    """Which hypothesis is the most probable; the first one where none is decisively so beside those without a meaning.

    Raises DataError where several others are alike.
    """
    best = max(ln_probable)
    near = [number for number, ln in enumerate(ln_probable) if ln > best - DECISIVE]
    if any(not meanings[number] for number in near):
        return 0
    if len(near) > 1:
        raise DataError(f"{file}: {', or '.join(meanings[number] for number in near)}{remedy}")
    return near[0]


class Unit(NamedTuple):
    """What a column may be in.

    Attributes
    ----------
    name : a word for it.
    factor : by which the column's numbers are multiplied; NaN leaves the column out. [-]
    ln_odds : ln of its odds beforehand.
    """

    name: str
    factor: float
    ln_odds: float


def _words(name: str, unit: Unit) -> str:
    column = name if name == "time_s" else name.replace("_", "_W_", 1)
    return f"{column} goes with no other column" if math.isnan(unit.factor) else f"{column} looks like {unit.name}"


def units_of(rover: Rover) -> dict[str, list[Unit]]:
    """The units in which each column may be, the first as it is named."""
    rim, odds, units = rover.wheel.shearing_radius_m, LN_ODDS["units"], dict[str, list[Unit]]()
    for name, unit in NAMED.items():
        others = SIZES[unit] | ({"deg_s": rim / DEG, "rad_s": rim} if unit == "m_s" else {})
        units[name] = [Unit(unit.replace("_", "/"), 1.0, 0.0)]
        units[name] += [Unit(text.replace("_", "/"), factor, odds) for text, factor in others.items()]
        if name != "time_s":
            turned = "to the right" if name.startswith("steer") else "backwards"
            # What a sensor measures is told by the rover's motion, too.
            rare = odds if name in COMMANDED else odds - 2.0 * DECISIVE
            units[name] += [Unit(f"{u.name}, positive {turned}", -u.factor, u.ln_odds + rare) for u in units[name]]
            units[name].append(Unit("no unit at all", math.nan, LN_ODDS["anything"]))
    return units


def in_units(telemetry: Telemetry, rover: Rover, findings: Findings) -> Telemetry:
    """Telemetry in the units that its columns are named by; said where they were others.

    Raises DataError where several units are alike.
    """
    units, per_deg = units_of(rover), math.radians(rover.wheel.shearing_radius_m)
    steps = np.diff(telemetry.time_s)[:, None]
    angle = np.diff(telemetry.angle_deg, axis=0)
    low, high = (f(telemetry.angle_deg, axis=0, initial=-s * np.inf) for f, s in ((np.nanmin, -1), (np.nanmax, 1)))
    # Of angles within a turn the smaller way round.
    angle -= np.where(high - low <= 360.0, 360.0 * np.rint(np.nan_to_num(angle) / 360.0), 0.0)
    turns = {
        "angle_deg": angle / steps,
        "rate_deg_s": between(telemetry.rate_deg_s),
        "speed_m_s": between(telemetry.speed_m_s) / per_deg,
    }
    ratios = {(a, b): _ratio(turns[a], turns[b]) for a, b in itertools.combinations(turns, 2)}
    fastest = {
        name: _typical_size(per_deg * rate[np.isfinite(rate)]) / rover.max_speed_m_s for name, rate in turns.items()
    }
    telemetry = _in_likeliest(telemetry, units, ratios, fastest, findings)
    ratios = {STEERING: _ratio(telemetry.steered_deg, telemetry.steering_deg, SIGMA_DEG)}
    return _in_likeliest(telemetry, units, ratios, {}, findings)


def _ratio(values: FloatArray, wanted: FloatArray, least: float = 0.0) -> float:
    """Median of one column over another, where that one is large; NaN where there are too few rows."""
    given = np.isfinite(values) & np.isfinite(wanted)
    given &= np.maximum(np.abs(wanted), np.abs(values) * (least > 0)) > least
    given &= np.abs(wanted) > UNDER_WAY * _typical_size(wanted[given])
    return float(np.median(values[given] / wanted[given])) if given.sum() >= FEWEST_ROWS else math.nan


def _typical_size(values: FloatArray) -> float:
    """Median size of what is no noise at rest; the very largest ones may be wild. NaN of none."""
    size = np.abs(values)
    return float(np.median(size[size >= STILL * np.percentile(size, 98)])) if size.size else math.nan


def _in_likeliest(
    telemetry: Telemetry,
    units: dict[str, list[Unit]],
    ratios: dict[tuple[str, str], float],
    fastest: dict[str, float],
    findings: Findings,
) -> Telemetry:
    """Telemetry with those columns converted that some ratio or speed tells of, said."""
    compared = {name for pair, ratio in ratios.items() if math.isfinite(ratio) for name in pair}
    compared |= {name for name, share in fastest.items() if math.isfinite(share)}
    names = [name for name in units if name in compared or (name == "time_s" and "angle_deg" in compared)]
    # Any other reading than that of the names is less probable beforehand.
    named = {name: units[name][0] for name in names}
    if not names or _ln_of_units(named, ratios, fastest) > LN_ODDS["units"] + DECISIVE:
        return telemetry
    tried = [dict(zip(names, one, strict=True)) for one in itertools.product(*(units[name] for name in names))]
    ln_probable = [_ln_of_units(one, ratios, fastest) for one in tried]
    meanings = [", ".join(_words(name, unit) for name, unit in one.items() if unit.factor != 1.0) for one in tried]
    best = tried[decided(ln_probable, meanings, telemetry.file, ": convert what is wrong")]
    changed = {name: unit for name, unit in best.items() if unit.factor != 1.0}
    for name, unit in changed.items():
        lost = math.isnan(unit.factor)
        done = "it is left out" if lost else "taken so; name the unit in the column's name, or convert it"
        findings.add("read as", _words(name, unit), done, doubt=lost)
    clock = best["time_s"].factor if "time_s" in best else 1.0
    return replace(
        telemetry,
        rests_s=tuple((clock * begin, clock * end) for begin, end in telemetry.rests_s),
        start_s=clock * telemetry.start_s,
        **{name: unit.factor * getattr(telemetry, name) for name, unit in changed.items()},
    )


def _ln_of_units(tried: dict[str, Unit], ratios: dict[tuple[str, str], float], fastest: dict[str, float]) -> float:
    """ln of how probable some units are, up to a constant."""
    ln = sum(unit.ln_odds for unit in tried.values())
    factor = {name: unit.factor for name, unit in tried.items()}
    # Of an angle it is the change in a time that counts.
    factor["angle_deg"] = factor.get("angle_deg", math.nan) / factor.get("time_s", 1.0)
    for (a, b), ratio in ratios.items():
        ratio *= factor.get(a, math.nan) / factor.get(b, math.nan)
        if math.isfinite(ratio):
            ln -= 0.5 * (math.log(max(abs(ratio), 1e-9)) / OBEYED) ** 2
            ln += 2.0 * LN_ODDS["anything"] * (ratio < 0.0)
    for name, share in fastest.items():
        share *= abs(factor.get(name, math.nan))
        if share > 0.0:
            ln -= 0.5 * (math.log(share) / (OBEYED if share > 1.0 else SLOWER)) ** 2
    return ln


@dataclass(frozen=True, slots=True)
class AxesHypothesis:
    """A way to read positions, headings and steering.

    Attributes
    ----------
    meaning : what it means, as a sentence; empty for as the names say.
    yaw : by what a heading is multiplied, and what is then added. [-, deg]
    place : what positions are multiplied by. (2, 2) Positions that are many times smaller than they seem fit any motion
        the better; so their density counts, and not that of headings, whose scatter tells nothing of a unit where a
        drive is straight.
    turn, rims : what it makes of the turn that the wheels say, as their steering is, and of how far they roll.
    errors : what is meant over what is written of the errors of positions.
    ln_odds : beforehand.
    way_sigma, least_m : share of the way, and length, by which positions scatter; None takes slips and stated errors.
    doubt : what is found and done where nothing can be converted.
    """

    meaning: str
    yaw: tuple[float, float] = (1.0, 0.0)
    place: tuple[tuple[float, float], tuple[float, float]] = ((1.0, 0.0), (0.0, 1.0))
    turn: float = 1.0
    rims: float = 1.0
    errors: float = 1.0
    ln_odds: float = LN_ODDS["units"]
    way_sigma: float | None = None
    least_m: float = 0.0
    doubt: tuple[str, str, str] | None = None

    def heading(self, yaw_deg: FloatArray) -> FloatArray:
        """What is meant by headings. (n,) [deg]"""
        return self.yaw[0] * yaw_deg + self.yaw[1]

    def read(self, telemetry: Telemetry) -> Telemetry:
        """Telemetry as it is meant."""
        yaw = self.heading(telemetry.yaw_deg)
        if abs(self.yaw[0]) != 1.0:
            given = np.isfinite(yaw)
            yaw[given] = np.unwrap(yaw[given], period=360.0)
        return replace(
            telemetry,
            yaw_deg=yaw,
            fix_m=telemetry.fix_m @ np.array(self.place),
            fix_covariance_m2=self.errors**2 * telemetry.fix_covariance_m2,
            steering_deg=self.turn * telemetry.steering_deg,
            steered_deg=self.turn * telemetry.steered_deg,
            angle_deg=self.rims * telemetry.angle_deg,
            rate_deg_s=self.rims * telemetry.rate_deg_s,
        )


FRAMES = (
    AxesHypothesis("", ln_odds=0.0),
    AxesHypothesis("", errors=0.3, ln_odds=LN_ODDS["motion"]),
    AxesHypothesis("x_m and y_m are computed from the wheels", way_sigma=ROLLED, least_m=FINEST_M, doubt=(
        "positions are odometry", "x_m and y_m repeat the way of the wheels: no slip can be learned from them",
        "kept; give positions by pictures, lidar or radio")),
    AxesHypothesis("another frame", way_sigma=2.0, turn=0.0, ln_odds=LN_ODDS["anything"], doubt=(
        "heading against motion", "positions, headings and wheels tell of different motions, in any frame and unit",
        "kept as they are")),
    AxesHypothesis("x_m and y_m are exchanged", place=((0.0, 1.0), (1.0, 0.0))),
    AxesHypothesis("y_m points to the right of x_m", place=MIRRORED),
    AxesHypothesis("yaw_deg grows to the right, as in a frame with z down", yaw=(-1.0, 0.0)),
    AxesHypothesis("yaw_deg is measured from y (north) clockwise", yaw=(-1.0, 90.0)),
    AxesHypothesis("yaw_deg is measured from y", yaw=(1.0, 90.0)),
    AxesHypothesis("yaw_deg points backwards", yaw=(1.0, 180.0)),
    AxesHypothesis("yaw_deg looks like rad", yaw=(DEG, 0.0)),
    AxesHypothesis("x, y and yaw_deg are those of a frame with z down (x north, y east)", (-1.0, 0.0), MIRRORED),
    AxesHypothesis("steering is positive to the right", turn=-1.0),
    AxesHypothesis("the steering angles look like rad", turn=DEG),
    AxesHypothesis("the turns of the wheels look like rad", rims=DEG),
    *(AxesHypothesis(f"errors of positions look like {unit}", errors=SIZES["m"][unit]) for unit in ("mm", "cm")),
    *(AxesHypothesis(f"x_m and y_m look like {unit}", place=((size, 0.0), (0.0, size)))
      for unit, size in SIZES["m"].items()),
)  # fmt: skip
"""What writers of telemetry do, with odds as `LN_ODDS` has them; stated errors may be far too large, and another frame
is one that nothing explains."""


def as_meant(
    telemetry: Telemetry, twist: FloatArray, findings: Findings, *, skids: bool = False, as_planned: bool = False
) -> Telemetry:
    """Telemetry as it is most probably meant; said where that is not as its columns are named.

    `twist` is the velocity that wheels without slip say between rows (n - 1, 3), `skids` whether none is steered,
    `as_planned` whether steering is that of a plan. Raises DataError where several readings are alike.
    """
    frames = [one for one in FRAMES if not as_planned or one.turn in (0.0, 1.0)]
    turns = SKID_SIGMA[0] if skids else EFFECT_SIGMA[2]
    ln_probable = [one.ln_odds + _ln_of_frame(one, telemetry, twist, turns) for one in frames]
    remedy = (
        "; x is to the right of the map, y up, yaw_deg from x towards y in degrees, steering positive to the left: "
        "convert it"
    )
    best = frames[int(np.argmax(ln_probable))]
    if best.doubt is None:
        best = frames[decided(ln_probable, [one.meaning for one in frames], telemetry.file, remedy)]
    elif max(ln_probable) - max(ln_probable[:2]) > DECISIVE:
        findings.add(*best.doubt, doubt=True)
    if best.doubt is not None or not best.meaning:
        return telemetry
    findings.add("read as", best.meaning, "taken so; x is east, y north, yaw_deg from x towards y in degrees")
    return best.read(telemetry)


def _ln_of_frame(frame: AxesHypothesis, telemetry: Telemetry, twist: FloatArray, turns: float) -> float:
    """ln of how probable a frame makes positions and headings, up to a constant that all share."""
    rows, times, twist = _spaced(telemetry, twist), telemetry.time_s, frame.rims * twist
    given = np.isfinite(telemetry.yaw_deg)
    yaw = np.radians(np.interp(times, times[given], frame.heading(telemetry.yaw_deg)[given]))
    steps, middle = np.diff(times), 0.5 * (yaw[1:] + yaw[:-1])
    ahead, left, turn = (twist * steps[:, None]).T

    def total(values: FloatArray) -> FloatArray:
        return np.asarray(np.add.reduceat(values, rows[:-1], axis=0))

    way, turned, wanted = total(np.hypot(ahead, left)), total(np.abs(turn)), total(onto_map(middle, ahead, left))
    turn = frame.turn * total(turn)
    off = np.diff(telemetry.fix_m[rows] @ np.array(frame.place), axis=0) - wanted
    share = onto_map(-np.arctan2(wanted[:, 1], wanted[:, 0]), *off.T)
    variance = np.trace(telemetry.fix_covariance_m2[rows], axis1=1, axis2=2) / 2.0
    stated, rolled = frame.errors * np.sqrt(variance[1:] + variance[:-1]), way > 0.0
    if frame.way_sigma is not None:
        sigma, mean = np.hypot(frame.way_sigma * way, frame.least_m or stated), np.zeros(2)
    else:
        sigma = np.hypot(SLIPS[1] * way, stated)
        # The slip that all ways have in common, as far as it is likely at all.
        mean = np.median(share[rolled] / way[rolled, None], axis=0) if rolled.any() else np.zeros(2)
        mean = np.clip(mean, -SURE * SLIPS, SURE * SLIPS)
    ln_mean = float(-0.5 * ((mean / (USUAL if frame.meaning else SLIPS)) ** 2).sum())
    share = share - mean * way[:, None]
    yaw_sigma = math.sqrt(2.0) * math.radians(float(np.nanmedian(telemetry.yaw_deg_sigma)))
    turn_sigma = np.sqrt((turns * np.maximum(turned, np.abs(turn))) ** 2 + (MEAN_SIGMA[2] * way) ** 2 + yaw_sigma**2)
    density = len(off) * math.log(abs(np.linalg.det(frame.place)))
    return (
        ln_mean
        + density
        + float(ln_student(share, sigma[:, None]).sum() + ln_student(np.diff(yaw[rows]) - turn, turn_sigma).sum())
    )


def _spaced(telemetry: Telemetry, twist: FloatArray) -> IndexArray:
    """Rows with a position, so far apart that slip shows between them; all where they are few."""
    rows = np.flatnonzero(telemetry.fixed)
    rolled = np.append(0.0, np.cumsum(np.hypot(twist[:, 0], twist[:, 1]) * np.diff(telemetry.time_s)))
    some = rows[np.unique(np.floor(rolled[rows] / LEAST_ROW_M), return_index=True)[1]]
    return some if len(some) > FEWEST_ROWS else rows


@dataclass(frozen=True, slots=True)
class Hypothesis:
    """Constants that may be far from 0.

    Attributes
    ----------
    name : a word for it.
    members : which constants.
    sigma, mean : their prior if it holds.
    what, done : what is reported where it holds, with the values of the constants, and what is done; nothing if empty.
    factor : of these values.
    ln_odds : beforehand.
    slide : which of `Nodes.slides` it concerns, -1 for none.
    """

    name: str
    members: tuple[int, ...]
    sigma: float
    what: str = ""
    done: str = ""
    factor: float = 1.0
    mean: float = 0.0
    ln_odds: float = LN_ODDS["motion"]
    slide: int = -1


MOTION = (
    Hypothesis("much slip", (0,), MEAN_SIGMA[0]),
    Hypothesis("constant side slip", (1,), MEAN_SIGMA[1],
               "the rover glides by {} deg all the way, positive to the left",
               "kept; a heading that is off throughout looks the same", factor=DEG),
    Hypothesis("lever arm", (9, 10), 0.3,
               "positions are those of a point {} m ahead and {} m to the left of the rover's origin",
               "the motion is that of the origin; give positions of the origin"),
    Hypothesis("heading drift", (DRIFT,), math.radians(5.0), "headings drift by {} deg until the end",
               "the motion is without the drift", factor=DEG),
    Hypothesis("lag", (LAG,), 3.0, "the rover moves {} than its wheels say",
               "positions and headings are put back, as --lag {} does"),
    Hypothesis("encoder scale", (SCALE,), RIM_SIGMA, "the rims turn {} times as far as their encoders say",
               "slip is of the rims", ln_odds=LN_ODDS["encoders"]),
)  # fmt: skip
"""What may be off throughout a drive, and how far where it is: half a metre of the localised point, some degrees of
drift, seconds of lag; assumed."""
SLIDE = Hypothesis(
    "slide at a halt", (SLIDES, SLIDES + 1), 0.3, "the rover moves {} m ahead and {} m to the left between {:.6g} and "
    "{:.6g} s {}, or later positions are in another frame",
    "the motion includes the shift, and slips on either side are right",
)  # fmt: skip
"""The same of each halt and jump, as `MOTION` has the localised point."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Priors:
    """What is believed of the constants beforehand.

    Attributes
    ----------
    mean, sigma : of a healthy drive. (k,), (k,)
    hypotheses : what else may be.
    """

    mean: FloatArray
    sigma: FloatArray
    hypotheses: tuple[Hypothesis, ...] = ()

    @classmethod
    def plain(cls, nodes: Nodes) -> "Priors":
        """Only slip, side slip and turn, and what slopes do to them, are unknown."""
        mean, sigma = np.zeros(nodes.constants), np.zeros(nodes.constants)
        mean[3:SCALE] = EFFECT_MEAN
        sigma[:SCALE] = (*MEAN_SIGMA, *EFFECT_SIGMA)
        return cls(mean=mean, sigma=sigma)

    @classmethod
    def of_drive(cls, nodes: Nodes, *, skids: bool, obedience: float = 1.0) -> "Priors":
        """All of them.

        Parameters
        ----------
        skids : whether no wheel of the rover is steered.
        obedience : rim speed measured over commanded, 1 where there is no command. What differs may be the encoders'.
        """
        plain, off = cls.plain(nodes), -math.log(obedience)
        mean, sigma = plain.mean, plain.sigma
        if skids:
            sigma[5:SCALE] = SKID_SIGMA
        mean[0], sigma[:2] = LEVEL, LEVEL_SIGMA
        heading = float(np.nanmedian(nodes.yaw_sigma_rad))
        sigma[SCALE], sigma[LEVER], sigma[[OFFSET, DRIFT]], sigma[LAG] = RIM_SIGMA, POINT_M, heading, CLOCK_S
        sigma[SLIDES:] = STANDS_M
        scale = replace(MOTION[-1], mean=off, what=MOTION[-1].what if abs(off) > RIM_SIGMA else "")
        slides = [
            replace(
                SLIDE,
                name=SLIDE.name if number < len(nodes.halts) else "position shift",
                members=(SLIDES + 2 * number, SLIDES + 2 * number + 1),
                slide=number,
            )
            for number in range(len(nodes.slides))
        ]
        return cls(mean=mean, sigma=sigma, hypotheses=(*MOTION[:-1], scale, *slides))

    def under(self, held: BoolArray) -> tuple[FloatArray, FloatArray, float]:
        """Mean, sigma, and ln of the odds beforehand, where some hypotheses hold."""
        mean, sigma, ln_odds = self.mean.copy(), self.sigma.copy(), 0.0
        for one in itertools.compress(self.hypotheses, held):
            members = list(one.members)
            mean[members], sigma[members] = one.mean, one.sigma
            ln_odds += one.ln_odds
        return mean, sigma, ln_odds


@dataclass(frozen=True, slots=True, eq=False)
class Posterior:
    """Constants after the measurements, averaged over the sets of hypotheses that were weighed.

    Attributes
    ----------
    mean, covariance : of the constants. (k,), (k, k)
    ln_likelihood : ln of the marginal likelihood, up to a constant.
    probable : probability of each hypothesis. (h,) [-]
    """

    mean: FloatArray
    covariance: FloatArray
    ln_likelihood: float
    probable: FloatArray


def _ln_factor(precision: FloatArray, shift: FloatArray, mean: FloatArray, sigma: FloatArray) -> float:
    """ln of the integral of a normal factor, of precision (k, k) and shift (k,), over a normal prior (k,), (k,)."""
    whole, towards = precision + np.diag(sigma**-2), shift + mean / sigma**2
    determinant = np.linalg.slogdet(whole)[1] + 2.0 * np.log(sigma).sum()
    return float(towards @ np.linalg.solve(whole, towards) - ((mean / sigma) ** 2).sum() - determinant) / 2.0


LAST_DIGIT = math.log(np.finfo(float).eps)
"""ln of the share below which something does not count in a sum of floating-point numbers."""


def ln_evidence(squares: FloatArray, mean: FloatArray, sigma: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
    """ln of the marginal likelihood (m,), means (m, k) and covariances (m, k, k) of normal constants.

    `squares` are those of a `FilterRun`, (m, 1 + k, 1 + k).
    """
    at_mean = squares[:, 1:, 0] + squares[:, 1:, 1:] @ mean
    chi_square = squares[:, 0, 0] + (squares[:, 0, 1:] + at_mean) @ mean
    precision = np.eye(len(mean)) + sigma[:, None] * squares[:, 1:, 1:] * sigma
    off = np.linalg.solve(precision, -(sigma * at_mean)[..., None])[..., 0]
    chi_square = chi_square + np.einsum("mi,mi->m", off, sigma * at_mean)
    covariance = sigma[:, None] * np.linalg.inv(precision) * sigma
    return -0.5 * chi_square - 0.5 * np.linalg.slogdet(precision)[1], mean + sigma * off, covariance


def probable_sets(priors: Priors, squares: FloatArray) -> list[BoolArray]:
    """Sets of hypotheses to average over: the most probable one that is reached hypothesis by hypothesis, and those
    that differ from it by one and count beside it. `squares` are those of one assumption. (1 + k, 1 + k)"""
    held = np.zeros(len(priors.hypotheses), dtype=bool)
    while True:
        near = [np.where(np.arange(len(held)) == k, ~held, held) for k in range(len(held))]
        gains = _gains(priors, squares, held, near)
        if not gains or not max(gains) > 0.0:
            return [held, *(one for one, gain in zip(near, gains, strict=True) if gain > LAST_DIGIT)]
        held = near[int(np.argmax(gains))]


def _gains(priors: Priors, squares: FloatArray, held: BoolArray, near: list[BoolArray]) -> list[float]:
    """ln of how much more probable than a set of hypotheses each is that differs from it by one.

    What the measurements say of the members of that one is the posterior divided by the prior, so that their normal
    factors alone are integrated anew.
    """
    mean, sigma, ln_odds = priors.under(held)
    _, (centre,), (covariance,) = ln_evidence(squares[None], mean, sigma)
    result = []
    for one, tried in zip(priors.hypotheses, near, strict=True):
        part, (other, other_sigma, other_odds) = list(one.members), priors.under(tried)
        precision, inverse = sigma[part] ** -2, np.linalg.inv(covariance[np.ix_(part, part)])
        measured = inverse - np.diag(precision), inverse @ centre[part] - precision * mean[part]
        gain = _ln_factor(*measured, other[part], other_sigma[part]) - _ln_factor(*measured, mean[part], sigma[part])
        result.append(gain + other_odds - ln_odds)
    return result


def averaged(priors: Priors, run: FilterRun, sets: list[BoolArray]) -> list[Posterior]:
    """The constants for each assumption of a run."""
    parts = []
    for held in sets:
        mean, sigma, ln_odds = priors.under(held)
        ln_likelihood, means, covariances = ln_evidence(run.squares, mean, sigma)
        parts.append((ln_odds + ln_likelihood + run.ln_likelihood, means, covariances))
    ln_all, means, covariances = (np.stack(part, axis=1) for part in zip(*parts, strict=True))
    highest = ln_all.max(axis=1, keepdims=True)
    whole = highest[:, 0] + np.log(np.exp(ln_all - highest).sum(axis=1))
    weights = np.exp(ln_all - whole[:, None])
    result = []
    for k, weight in enumerate(weights):
        mean = weight @ means[k]
        apart = means[k] - mean
        covariance = np.einsum("s,sij->ij", weight, covariances[k] + apart[:, :, None] * apart[:, None, :])
        result.append(Posterior(mean, covariance, float(whole[k]), weight @ np.array(sets)))
    return result


def repeated(values: FloatArray, chance: float, expected: FloatArray, sigma: float) -> BoolArray:
    """Which readings only repeat the one before. (n,)

    Parameters
    ----------
    values : readings, of one or more numbers each. (n,) or (n, m)
    chance : probability that a sound reading repeats the one before while nothing changes.
    expected : what the reading should have changed by since the start. (n,)
    sigma : standard error of that change beside the share `OBEYED`, in its unit.
    """
    flat = values.reshape(len(values), -1)
    begins = np.flatnonzero(np.append(True, (np.diff(flat, axis=0) != 0).any(axis=1)))
    repeats = np.diff(np.append(begins, len(values))) - 1
    change = np.maximum.reduceat(expected, begins) - np.minimum.reduceat(expected, begins)
    # A channel that is sent more often than it is read repeats throughout.
    ln_held = max(LN_ODDS["failure"], math.log(max(repeats.sum() / len(values) - SURE * chance, 1e-300)))
    ln_odds = ln_held - repeats * math.log(chance) + 0.5 * change**2 / (sigma**2 + (OBEYED * change) ** 2)
    result = np.repeat((ln_odds > 0) & (repeats > 0), repeats + 1)
    result[begins] = False
    return np.asarray(result)


def resolution_of(values: FloatArray) -> float:
    """The last digit: the finest change of which all changes are multiples; a thousandth of it where they are none.

    Infinite where nothing changes.
    """
    changes = np.abs(np.diff(values, axis=0))
    changes = changes[np.isfinite(changes)]
    changes = changes[changes > 1e-6 * np.max(changes, initial=0.0)]
    finest = float(np.min(changes, initial=np.inf))
    return finest if (np.abs(changes / finest - np.rint(changes / finest)) < 0.01).all() else 1e-3 * finest


def repeat_chance(values: FloatArray, sigma: float) -> float:
    """Probability that a reading with an error of `sigma` repeats the one before, by its last digit.

    The difference of two is normal, of standard deviation sqrt 2 sigma, and rounded to the finest change there is.
    """
    return min(1.0, resolution_of(values) / (2.0 * math.sqrt(math.pi) * sigma))
