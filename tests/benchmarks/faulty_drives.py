"""What `twin states` makes of drives whose telemetry has one fault, and of healthy ones.

`python tests/benchmarks/faulty_drives.py [--kind KIND ...] [--count N] [--first K] [--cache DIR] [--jobs 1]
[--plan none] [--out FILE.jsonl]` drives and prints a table; `--report FILE.jsonl ...` prints the table of earlier runs.
With `--spoiled` healthy drives are sent by sensors, clocks or rows that fail in parts, see `spoiled_drives.py`.

The truth is a rover in equilibrium with a wheel-soil law of its own (`quasi_static.py`), which shares no code with the
twin; as it is in equilibrium it may be driven at any pace, and takes that of the plan's schedule. A number is a hidden
soil drawn from the priors, with its choices of physics, its terrain and its plan, the same for every kind. Telemetry is
written here, also without code of the twin; where a fault has a magnitude, that is drawn from a range. `--cache` keeps
the true drives: empty it when the code that drives changes.

States are compared with what the wheels do at that moment. A drive is in doubt where the command would exit with 3;
shares of states in their intervals and ends are of drives that are not. Errors of shares count soils. The end is that
of the rover's origin; its 90 % region is that of x and y at the last node.
"""

import argparse
import dataclasses
import math
import pickle
import time
from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
import pandas as pd
from other_physics import widths
from quasi_static import draw_physics, drive, motion, wheel_turns
from result_lines import computed, rows_of
from spoiled_drives import SPOILS, stood

from lunarsci.errors import DataError
from lunarsci.io.inputs import InputFile
from lunarsci.regolith.belief import first_belief
from lunarsci.regolith.prior import PARAMETERS, values_of
from lunarsci.regolith.soil import read_soil
from lunarsci.twin.ground.synthetic import roughness
from lunarsci.twin.ground.terrain import Terrain, build_terrain
from lunarsci.twin.plans.path import commands_at, make_schedule
from lunarsci.twin.plans.plan import Leg, Plan
from lunarsci.twin.rover import Rover, build_rover
from lunarsci.twin.telemetry.reading import Findings, read_telemetry
from lunarsci.twin.telemetry.states import DriveStates, states_of

FloatArray = npt.NDArray[np.float64]

KINDS = ("healthy", "heading_drift", "lever_arm", "one_encoder", "all_encoders", "radius", "lag", "walking", "slide",
         "soft_stripe")  # fmt: skip
GROUNDS = ("flat", "undulating", "slope", "sloping waves")
SPEED_M_S, SAMPLE_M, MOST_DRAWS = 0.05, 0.025, 30
EXTENT_M, SPACING_M = 11.0, 0.05
Z95, CHI2_90 = 1.959964, 4.605170
"""Of the normal law, and of chi-square with two degrees of freedom."""
SLIP, SIDE = 3, 4
"""Columns of the simulator's states."""
SLIDE_S, SAMPLE_S, RATE_S = 4.0, 0.25, 0.05
LONGEST_LAG_S = 3.0
EDGE_M = 0.1
"""Way over which the edge of a soft stripe goes over; assumed."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Truth:
    """A true drive.

    Attributes
    ----------
    plan : what the rover does.
    time_s, poses, states : samples; pose x, y, z [m], roll, pitch, yaw [deg]; wheel states as `quasi_static` has them.
    magnitude : of a fault that is in the drive itself.
    """

    plan: Plan
    time_s: FloatArray
    poses: FloatArray
    states: FloatArray
    magnitude: float = 0.0

    def pose_at(self, times: FloatArray) -> FloatArray:
        """Poses at times; the rover stands before and after the drive. (n, 6)"""
        return np.column_stack([np.interp(times, self.time_s, one) for one in self.poses.T])

    def state_at(self, times: FloatArray, column: int) -> FloatArray:
        """(n, wheels)"""
        return np.column_stack([np.interp(times, self.time_s, one) for one in self.states[:, :, column].T])


@cache
def terrain_of(number: int) -> Terrain:
    """The ground of a number: flat, undulating, on a slope up to 12 degrees, or both."""
    random, name = np.random.default_rng([number, 1]), GROUNDS[number % len(GROUNDS)]
    axis = np.arange(-EXTENT_M, EXTENT_M + 0.5 * SPACING_M, SPACING_M)
    x, y = axis[None, :], axis[:, None]
    steep, aspect = math.tan(math.radians(random.uniform(3.0, 12.0))), random.uniform(-np.pi, np.pi)
    height = roughness(x, y, random.uniform(0.0005, 0.004), number)
    if name in ("slope", "sloping waves"):
        height = height + steep * (1.0 if name == "slope" else 0.6) * (np.cos(aspect) * x + np.sin(aspect) * y)
    if name in ("undulating", "sloping waves"):
        for length in random.uniform(1.5, 6.0, size=3):
            k, way, phase = 2.0 * np.pi / length, random.uniform(-np.pi, np.pi), random.uniform(0.0, 2.0 * np.pi)
            slope = random.uniform(0.02, 0.07)
            height = height + slope / k * np.cos(k * (np.cos(way) * x + np.sin(way) * y) + phase)
    return build_terrain(name, -EXTENT_M, -EXTENT_M, SPACING_M, height, read_soil("longji"), synthetic=True)


def plan_of(number: int, *, halts: bool = False) -> Plan:
    """Two to five legs and 4 to 8 m: arcs, arcs with a halt, or arcs about a spot turn between two halts."""
    random = np.random.default_rng([number, 2])
    shape = ("arcs", "halt", "turn")[int(random.integers(3))]
    if halts and shape == "arcs":
        shape = "halt"
    way, arcs = random.uniform(4.0, 8.0), 2 if shape == "turn" else int(random.integers(2, 5))
    lengths = way * random.dirichlet(np.full(arcs, 8.0))
    bends = np.where(random.random(arcs) < 0.25, 0.0, random.uniform(-0.25, 0.25, size=arcs))
    legs = [Leg(round(float(a), 3), round(float(c), 4)) for a, c in zip(lengths, bends, strict=True)]
    stop = Leg(stop_s=round(float(random.uniform(20.0, 60.0)), 1))
    if shape == "halt":
        legs.insert(int(random.integers(1, arcs)), stop)
    elif shape == "turn":
        turn = Leg(turn_deg=round(float(random.choice([-1.0, 1.0]) * random.uniform(15.0, 70.0)), 1))
        legs[1:1] = [stop, turn, Leg(stop_s=8.0)]
    heading = round(float(random.uniform(-180.0, 180.0)), 1)
    return Plan(name=f"{shape} {number}", legs=tuple(legs), speed_m_s=SPEED_M_S, heading_deg=heading)


def truth_of(number: int, kind: str, rover: Rover, kept: Path | None) -> Truth:
    """The true drive of a number, from the folder `kept` where it lies there."""
    variant = kind if kind in ("slide", "soft_stripe") else "plain"
    file = None if kept is None else kept / f"{variant}_{number}.pickle"
    if file is not None and file.exists():
        found = pickle.loads(file.read_bytes())
        if isinstance(found, Truth):
            return found
    truth = _driven(number, variant, rover)
    if file is not None:
        file.parent.mkdir(parents=True, exist_ok=True)
        part = file.with_suffix(".part")
        part.write_bytes(pickle.dumps(truth))
        part.replace(file)
    return truth


def _driven(number: int, variant: str, rover: Rover) -> Truth:
    """A drive that arrives; soils on which the rover does not are replaced by another draw."""
    physics = draw_physics(number)
    for draw in range(MOST_DRAWS):
        random = np.random.default_rng([number, 3, draw])
        theta = first_belief().mean + widths() * random.normal(size=len(PARAMETERS))
        soil = dict(zip(PARAMETERS, map(float, values_of(first_belief().laws, theta)), strict=True))

        def whole(plan: Plan, soil_at: Any = None, soil: dict[str, float] = soil) -> Truth | None:
            found = drive(rover, terrain_of(number), plan, soil, physics, sample_m=SAMPLE_M, soil_at=soil_at)
            moving = np.abs(found.states[:, :, SLIP])
            if not found.finished or np.median(moving) > 0.5:
                return None
            return Truth(plan=plan, time_s=found.time_s, poses=found.poses, states=found.states)

        fault = np.random.default_rng([number, KINDS.index(variant) if variant in KINDS else 0, 4])
        if variant == "slide":
            truth = _slid(plan_of(number, halts=True), whole, fault)
        elif variant == "soft_stripe":
            truth = _through_stripe(plan_of(number), whole, soil, rover, fault)
        else:
            truth = whole(plan_of(number))
        if truth is not None:
            return _paced(truth, rover)
    raise SystemExit(f"{number}, {variant}: no soil of {MOST_DRAWS} carries the rover")


def clock_of(plan: Plan, rover: Rover) -> Callable[[FloatArray], FloatArray]:
    """From times of the schedule, which starts, stops and steers in some time, to those of the simulator. [s]"""
    runs = make_schedule(plan, rover).runs
    bounds, moves = [0.0], [motion(leg, rover, plan.speed_m_s) for leg in plan.legs]
    legs = iter(zip(plan.legs, moves, strict=True))
    for run in runs:
        took = 0.0
        for leg, moved in (next(legs) for _ in run.legs):
            took += leg.stop_s or (
                math.radians(leg.turn_deg) / moved[2] if leg.turn_deg else leg.length_m / plan.speed_m_s
            )
        bounds.append(bounds[-1] + took)

    def shares(times: FloatArray) -> list[FloatArray]:
        return [run.share_at(times) if run.moves else (times - run.begin_s) / (run.end_s - run.begin_s) for run in runs]

    def clock(times: FloatArray) -> FloatArray:
        number = np.clip(np.searchsorted([run.begin_s for run in runs], times, side="right") - 1, 0, len(runs) - 1)
        share = np.choose(number, [np.clip(one, 0.0, 1.0) for one in shares(times)])
        begin, end = np.array(bounds)[number], np.array(bounds)[number + 1]
        return np.asarray(begin + share * (end - begin))

    return clock


def _paced(truth: Truth, rover: Rover) -> Truth:
    """The same drive at the pace of the plan's schedule."""
    end_s = make_schedule(truth.plan, rover).duration_s
    times = np.linspace(0.0, end_s, math.ceil(end_s / SAMPLE_S) + 1)
    own = clock_of(truth.plan, rover)(times)
    states = [truth.state_at(own, column) for column in range(truth.states.shape[2])]
    return dataclasses.replace(truth, time_s=times, poses=truth.pose_at(own), states=np.stack(states, axis=2))


def _slid(plan: Plan, whole: Callable[[Plan], Truth | None], random: np.random.Generator) -> Truth | None:
    """It slips aside within a halt, and goes on from there."""
    last = next(k for k, leg in enumerate(plan.legs) if leg.stop_s)
    before = whole(dataclasses.replace(plan, legs=plan.legs[: last + 1]))
    size, turned = random.uniform(0.1, 0.5), random.choice([-1.0, 1.0]) * math.radians(random.uniform(45.0, 135.0))
    if before is None:
        return None
    x, y, _, _, _, yaw = before.poses[-1]
    way = math.radians(yaw) + turned
    x, y = x + size * math.cos(way), y + size * math.sin(way)
    rest = dataclasses.replace(plan, legs=plan.legs[last + 1 :], x_m=float(x), y_m=float(y), heading_deg=float(yaw))
    after = whole(rest)
    if after is None:
        return None
    end_s = before.time_s[-1]
    share = np.clip((before.time_s - (end_s - 0.5 * plan.legs[last].stop_s)) / SLIDE_S, 0.0, 1.0)
    poses = before.poses + share[:, None] * (after.poses[0] - before.poses[-1])
    return Truth(
        plan=plan,
        time_s=np.concatenate([before.time_s, end_s + after.time_s[1:]]),
        poses=np.vstack([poses, after.poses[1:]]),
        states=np.concatenate([before.states, after.states[1:]]),
        magnitude=float(size),
    )


def _through_stripe(
    plan: Plan, whole: Callable[..., Truth | None], soil: dict[str, float], rover: Rover, random: np.random.Generator
) -> Truth | None:
    """Across the way lies a stripe of softer ground; all wheels share the mean of the soils below them.

    The magnitude is the largest change of the wheels' mean slip.
    """
    firm = whole(plan)
    if firm is None:
        return None
    place, width = random.uniform(0.25, 0.6), random.uniform(0.5, 1.5)
    way = np.append(0.0, np.cumsum(np.hypot(*np.diff(firm.poses[:, :2], axis=0).T)))
    begin = firm.poses[int(np.searchsorted(way, place * way[-1]))]
    ahead = np.array([math.cos(math.radians(begin[5])), math.sin(math.radians(begin[5]))])
    stiffness, friction, modulus = random.uniform(0.2, 0.6), random.uniform(6.0, 14.0), random.uniform(2.0, 4.0)
    wheels = rover.wheel_positions_m[:, :2]

    def soil_at(now: FloatArray, share_of: float = 1.0) -> dict[str, float]:
        c, s = math.cos(now[2]), math.sin(now[2])
        far = (wheels @ np.array([[c, s], [-s, c]]) + now[:2] - begin[:2]) @ ahead
        inside = np.clip(far / EDGE_M, 0.0, 1.0) * np.clip((width - far) / EDGE_M, 0.0, 1.0)
        share = share_of * float(inside.mean())
        return soil | {
            "stiffness_kpa_m_n": soil["stiffness_kpa_m_n"] * stiffness**share,
            "shear_modulus_mm": soil["shear_modulus_mm"] * modulus**share,
            "cohesion_pa": soil["cohesion_pa"] * stiffness**share,
            "friction_angle_deg": max(soil["friction_angle_deg"] - friction * share, 5.0),
        }

    for softer in (1.0, 0.8, 0.6, 0.4):
        found = whole(plan, lambda now, softer=softer: soil_at(now, softer))
        if found is not None:
            extra = found.states[:, :, SLIP].mean(axis=1) - firm.states[:, :, SLIP].mean(axis=1)
            return dataclasses.replace(found, magnitude=float(extra[np.abs(extra).argmax()]))
    return None


@dataclass(frozen=True, kw_only=True)
class Sent:
    """How a rover measures itself on a drive: seconds between rows, way between positions, standard errors."""

    every_s: float
    fix_m: float
    fix_sigma_m: float
    yaw_deg: float
    wheel_deg: float
    at_halts: bool

    @classmethod
    def draw(cls, random: np.random.Generator) -> "Sent":
        """Drawn anew for each drive."""
        return cls(
            every_s=float(random.choice([1.0, 1.0, 1.0, 0.5, 2.0])),
            fix_m=float(random.uniform(0.5, 1.0)),
            fix_sigma_m=float(random.uniform(0.01, 0.05)),
            yaw_deg=float(random.uniform(0.1, 0.3)),
            wheel_deg=float(random.uniform(0.05, 0.3)),
            at_halts=bool(random.random() < 0.5),
        )


def telemetry_of(
    truth: Truth, kind: str, rover: Rover, random: np.random.Generator
) -> tuple[pd.DataFrame, Any, Plan, Sent]:
    """Telemetry with a fault of a kind, its magnitude, the plan that the rover thinks it drives, and its sensors."""
    sent = Sent.draw(random)
    times = np.arange(0.0, truth.time_s[-1] + 1e-6, sent.every_s)
    wheels, way = _wheels(truth, rover, times, sent, random)
    magnitude: Any = truth.magnitude
    late_s = 0.0
    if kind == "lag":
        magnitude = late_s = float(random.uniform(-LONGEST_LAG_S, LONGEST_LAG_S))
    pose = truth.pose_at(times - late_s)
    fixed = np.append(True, np.diff(np.floor(way / sent.fix_m + 1e-9)) > 0)
    fixed[-1] = True
    if kind == "lag":
        # The rover stands before and after its drive, which no wheel says: no position is of then.
        inside = (times >= LONGEST_LAG_S) & (times <= times[-1] - LONGEST_LAG_S)
        fixed &= inside
        fixed[np.flatnonzero(inside)[[0, -1]]] = True
    if sent.at_halts:
        still = np.diff(way) < 1e-9
        starts = np.flatnonzero(still[1:] & ~still[:-1]) + 1
        fixed[starts], fixed[np.flatnonzero(still[:-1] & ~still[1:]) + 1] = True, True
    error = sent.fix_sigma_m * random.normal(size=(len(times), 2))
    yaw = pose[:, 5] + sent.yaw_deg * random.normal(size=len(times))
    plan = truth.plan
    if kind == "heading_drift":
        magnitude = float(random.choice([-1.0, 1.0]) * random.uniform(1.0, 8.0))
        yaw += magnitude * times / times[-1]
    elif kind == "lever_arm":
        ahead, left = magnitude = random.uniform(-0.4, 0.4, size=2).tolist()
        c, s = np.cos(np.radians(pose[:, 5])), np.sin(np.radians(pose[:, 5]))
        error += np.column_stack([c * ahead - s * left, s * ahead + c * left])
    elif kind in ("one_encoder", "all_encoders"):
        magnitude = float(random.uniform(0.85, 1.1))
        chosen = rover.wheels if kind == "all_encoders" else [rover.wheels[int(random.integers(len(rover.wheels)))]]
        for wheel in chosen:
            wheels[f"angle_{wheel}_deg"] *= magnitude
            wheels[f"rate_{wheel}_deg_s"] *= magnitude
    elif kind == "radius":
        magnitude = float(random.uniform(0.95, 1.05))
        plan = _in_other_metres(plan, 1.0 / magnitude)
        for wheel in rover.wheels:
            for column in ("angle_{}_deg", "rate_{}_deg_s", "speed_{}_m_s"):
                wheels[column.format(wheel)] /= magnitude
    elif kind == "walking":
        magnitude = float(random.uniform(0.03, 0.08))
        steps = np.sqrt(np.diff(way, prepend=0.0))[:, None] * random.normal(size=(len(times), 2))
        error += magnitude * np.cumsum(steps, axis=0)
    columns: dict[str, Any] = {"time_s": times}
    for k, name in enumerate(("x_m", "y_m")):
        columns[name] = np.where(fixed, pose[:, k] + error[:, k], np.nan)
    for name, value in (("xx_m2", sent.fix_sigma_m**2), ("xy_m2", 0.0), ("yy_m2", sent.fix_sigma_m**2)):
        columns[name] = np.where(fixed, value, np.nan)
    columns["yaw_deg"], columns["yaw_deg_sigma"] = yaw, np.full(len(times), sent.yaw_deg)
    for k, name in ((3, "roll_deg"), (4, "pitch_deg")):
        columns[name] = pose[:, k] + 0.1 * random.normal(size=len(times))
    return pd.DataFrame(columns | wheels | {"synthetic": "true"}), magnitude, plan, sent


def _in_other_metres(plan: Plan, factor: float) -> Plan:
    """The plan as a rover has it whose file has another radius: rims and ways are so many times as long."""
    legs = tuple(
        dataclasses.replace(leg, length_m=factor * leg.length_m, turn_deg=factor * leg.turn_deg) for leg in plan.legs
    )
    return dataclasses.replace(plan, legs=legs, speed_m_s=factor * plan.speed_m_s)


def _wheels(
    truth: Truth, rover: Rover, times: FloatArray, sent: Sent, random: np.random.Generator
) -> tuple[dict[str, FloatArray], FloatArray]:
    """Columns of the wheels, and the way of their rims on average [m]; they do as they are told."""
    edges, _, rims = wheel_turns(rover, truth.plan)
    rims = np.nan_to_num(rims)
    rolled = np.vstack([np.zeros(rims.shape[1]), np.cumsum(rims * np.diff(edges)[:, None], axis=0)])
    gone = np.append(0.0, np.cumsum(np.abs(rims).mean(axis=1) * np.diff(edges)))
    clock, told = clock_of(truth.plan, rover), commands_at(rover, make_schedule(truth.plan, rover), times)
    before, after = (clock(np.clip(times + step, 0.0, truth.time_s[-1])) for step in (-RATE_S, RATE_S))
    took = np.clip(times + RATE_S, 0.0, truth.time_s[-1]) - np.clip(times - RATE_S, 0.0, truth.time_s[-1])
    per_m, columns = math.degrees(1.0 / rover.wheel.shearing_radius_m), {}
    for k, wheel in enumerate(rover.wheels):
        blur = random.normal(size=(3, len(times)))
        way = np.interp(clock(times), edges, rolled[:, k])
        pace = (np.interp(after, edges, rolled[:, k]) - np.interp(before, edges, rolled[:, k])) / took
        columns[f"speed_{wheel}_m_s"] = told.speed_m_s[:, k]
        columns[f"steering_{wheel}_deg"] = np.degrees(told.steering_rad[:, k])
        columns[f"angle_{wheel}_deg"] = per_m * way + sent.wheel_deg * blur[0]
        columns[f"rate_{wheel}_deg_s"] = per_m * pace + sent.wheel_deg * blur[1]
        columns[f"steered_{wheel}_deg"] = np.degrees(told.steering_rad[:, k]) + 0.1 * blur[2]
    return columns, np.interp(clock(times), edges, gone)


def spoiled(
    kind: str, table: pd.DataFrame, truth: Truth, rover: Rover, random: np.random.Generator
) -> tuple[pd.DataFrame, Truth]:
    """Telemetry that fails in parts, and the true drive, with a halt where the telemetry has one."""
    table = SPOILS[kind](table.copy(), rover, random)
    return table, stood(truth, **table.attrs) if table.attrs else truth


def scores(states: DriveStates, truth: Truth) -> dict[str, Any]:
    """Shares of states in their 95 % intervals, median errors; the end, and its 90 % region."""
    times, valid, result = states.nodes.time_s[states.rows.node], states.rows.valid, {}
    for name, column in (("slip_ratio", SLIP), ("side_slip_deg", SIDE)):
        off = (getattr(states.rows, name) - truth.state_at(times, column))[valid]
        sigma = getattr(states.rows, f"{name}_sigma")[valid]
        result[name] = {
            "in_95": float(np.mean(np.abs(off) <= Z95 * sigma)) if off.size else math.nan,
            "sigma": float(np.median(sigma)) if off.size else math.nan,
            "rms": float(np.sqrt(np.mean(off**2))) if off.size else math.nan,
        }
    end = truth.pose_at(states.nodes.time_s[-1:])[0, :2]
    off, covariance = states.smoothed.state[-1, :2] - end, states.smoothed.covariance[-1, :2, :2]
    return result | {
        "states": int(valid.sum()),
        "end_m_error": float(np.hypot(*off)),
        "end_in_90": bool(off @ np.linalg.solve(covariance, off) <= CHI2_90),
        "end_radius_90_m": float(np.sqrt(CHI2_90 * np.sqrt(np.linalg.det(covariance)))),
    }


def case(task: tuple[int, str, str, bool]) -> dict[str, Any]:
    """One drive: what was sent, what was found."""
    number, kind, kept, told = task
    rover, folder = build_rover("yutu2"), Path(kept) if kept else None
    if kind in SPOILS:
        truth = truth_of(number, "healthy", rover, folder)
        random = np.random.default_rng([number, list(SPOILS).index(kind), 9])
        table, magnitude, plan, _ = telemetry_of(truth, "healthy", rover, random)
        table, truth = spoiled(kind, table, truth, rover, random)
    else:
        truth = truth_of(number, kind, rover, folder)
        random = np.random.default_rng([number, KINDS.index(kind), 5])
        table, magnitude, plan, _ = telemetry_of(truth, kind, rover, random)
    row = {"kind": kind, "number": number, "magnitude": magnitude, "doubt": "", "doubts": []}
    findings, content = Findings("drive.csv"), table.to_csv(index=False).encode()
    begin = time.process_time()
    try:
        telemetry = read_telemetry(InputFile("drive.csv", content), rover, findings)
        states = states_of(telemetry, rover, terrain_of(number), findings, plan if told else None)
    except DataError as refused:
        return row | {"refused": str(refused), "cpu_s": time.process_time() - begin}
    row |= {"refused": "", "doubt": findings.doubt, "cpu_s": time.process_time() - begin}
    kinds = {
        f"{name}s": [one.kind for one in findings.entries if one.doubt or name == "finding"]
        for name in ("doubt", "finding")
    }
    return row | kinds | scores(states, truth)


def share(values: pd.Series, soils: pd.Series) -> str:
    """Mean over drives and its standard error over soils, in per cent."""
    values = values.dropna().astype(float)
    sums = (values - values.mean()).groupby(soils).sum()
    error = np.sqrt((sums**2).sum() * len(sums) / (len(sums) - 1)) / len(values) if len(sums) > 1 else np.nan
    return f"{100 * values.mean():.0f}±{100 * error:.0f}" if len(values) else "-"


def report(rows: list[dict[str, Any]]) -> str:
    """Of each kind and of all, and what the doubts are of."""
    every, lines, said = pd.json_normalize(rows), {}, []
    for kind, own in (*every.groupby("kind", sort=False), ("all", every)):
        sure = own[(own.refused == "") & (own.doubt == "")]
        middle = sure.median(numeric_only=True)
        lines[kind] = {
            "drives": len(own),
            "refused": int((own.refused != "").sum()),
            "exit 0": f"{100 * len(sure) / len(own):.0f}",
            **{f"{name} in 95": share(sure[f"{name}.in_95"], sure.number) for name in ("slip_ratio", "side_slip_deg")},
            "in 90": share(sure.end_in_90, sure.number),
            **{name: f"{middle[name]:.4g}" for name in (
                "slip_ratio.sigma", "slip_ratio.rms", "side_slip_deg.sigma", "side_slip_deg.rms", "end_m_error",
                "end_radius_90_m", "cpu_s")},
        }  # fmt: skip
        for column in ("doubts", "findings"):
            count = Counter(name for names in own[column].dropna() for name in set(names))
            listed = ", ".join(f"{name} {times}" for name, times in count.most_common()) or "none"
            said.append(f"  {kind}, {column}: {listed}")
    head = "Shares in %; of states, ends and errors those of drives without doubt (exit 0). Medians of errors."
    told = [f"  refused, {row['kind']} {row['number']}: {row['refused']}" for row in rows if row["refused"]]
    return "\n".join(
        [head, pd.DataFrame(lines).T.to_string(), "Doubts and findings, by kind of fault (drives):", *said, *told]
    )


def main() -> None:
    """Drive, find the states, print the table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--kind", nargs="+", choices=(*KINDS, *SPOILS))
    parser.add_argument("--spoiled", action="store_true", help="all kinds of spoiled_drives.py")
    parser.add_argument("--count", type=int, default=40, help="drives of each kind, each on a soil of its own")
    parser.add_argument("--first", type=int, default=0, help="number of the first one")
    parser.add_argument("--cache", default="", help="folder that keeps the true drives")
    parser.add_argument("--jobs", type=int, default=1)
    parser.add_argument("--plan", default="given", choices=("given", "none"), help="whether the plan is told")
    parser.add_argument("--out", type=Path, help="a line of JSON for each drive")
    parser.add_argument("--report", type=Path, nargs="+", help="files of earlier runs")
    given = parser.parse_args()
    if given.report:
        print(report(rows_of(*given.report)))
        return
    kinds = given.kind or (SPOILS if given.spoiled else KINDS)
    numbers = range(given.first, given.first + given.count)
    tasks = {(n, kind): (n, kind, given.cache, given.plan == "given") for n in numbers for kind in kinds}
    case((0, "healthy", given.cache, True))  # compiled before anything is timed
    print(report(computed(case, tasks, ("number", "kind"), given.out, given.jobs)))


if __name__ == "__main__":
    main()
