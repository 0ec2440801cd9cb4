"""How `twin states` places real skid-steered vehicles.

`python tests/benchmarks/real_drives.py [--seconds 28] [--husky N] [--sigma-m 0.05] [--attitude] [--out FILE.jsonl]`

Pieces of the real drives in `drives/` of LUNARSCI_REFERENCE_DATA (its README says where they are from) become
telemetry: wheels of a side turn alike, nothing is steered, lidar poses are positions and headings where they change.
Every fifth pose is left out and then compared with the smoothed motion between nodes. The ground is taken to be flat,
so that roll and pitch are not sent (`--attitude` sends them). Masses and sizes are from makers' data sheets, to some
percent.

Windows of the Husky last 2 s; each has an origin of its own and the way from one to the next is not known, so that they
are not joined. The lidar poses are stamped with some hundredths of a second of error, which at 1 to 4 m/s decides what
positions are worth: the errors stated here are assumed.

A left-out pose is a measurement: the interval is that of the motion and of the lidar's stated error. Beside it stands a
smoother which knows no wheels: constant velocity with white acceleration (Bar-Shalom, Li & Kirubarajan 2001, ch. 6),
whose intensity is the one of maximum likelihood for the same kept poses. Shares and widths count x and y each.
"""

import argparse
import io
import json
import math
import os
import re
import tempfile
import time
import warnings
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
import pandas as pd
from scipy.optimize import minimize_scalar

from lunarsci.compiled import set_threads
from lunarsci.errors import DataError
from lunarsci.io.inputs import InputFile
from lunarsci.regolith.soil import read_soil
from lunarsci.twin.ground.terrain import Terrain, build_terrain
from lunarsci.twin.rover import Rover, build_rover, with_gravity
from lunarsci.twin.telemetry.reading import Findings, read_telemetry
from lunarsci.twin.telemetry.states import DriveStates, states_of

FloatArray = npt.NDArray[np.float64]
Z95 = 1.959964
LEFT_OUT, PHASE = 5, 2
"""Every so manieth pose is left out, from this one on."""
LEAST_WAY_M = 0.5
"""Way of the wheels below which a piece is no drive."""
POSE = ("x_m", "y_m", "z_m", "roll_deg", "pitch_deg", "yaw_deg")
HUSKY_STEP_S, HUSKY_ROWS = 0.05, 40
LEVER = re.compile(r"a point (\S+) \S+ \S+ m ahead and (\S+) \S+ \S+ m to the left")


@dataclass(frozen=True, kw_only=True)
class Vehicle:
    """Numbers of a vehicle: wheel radius, half the track and the wheelbase [m], mass [kg], top speed [m/s]."""

    name: str
    radius_m: float
    width_m: float
    half_track_m: float
    half_base_m: float
    mass_kg: float
    speed_m_s: float

    def rover(self) -> Rover:
        """As a rover with four wheels, none steered, on the Earth."""
        wheel_kg, y, x = 0.04 * self.mass_kg, self.half_track_m, self.half_base_m
        body_kg = self.mass_kg - 4.0 * wheel_kg
        inertia = [body_kg / 3.0 * a for a in (y * y + 0.04, x * x + 0.04, x * x + y * y)]
        tables: dict[str, dict[str, Any]] = {
            "wheel": {"radius_m": self.radius_m, "width_m": self.width_m},
            "mass": {
                "body_kg": body_kg,
                "wheel_kg": wheel_kg,
                "body_inertia_kg_m2": inertia,
                "body_center_m": [0.0, 0.0, 0.5 * self.radius_m],
            },
            "suspension": {
                "bogie": "none",
                "rocker_pivot_y_m": y,
                "front_wheel_m": [x, 0.0, 0.0],
                "rear_wheel_m": [-x, 0.0, 0.0],
                "joint_damping_n_m_s": 0.4 * self.mass_kg,
            },
            "steering": {"steered_wheels": []},
            "drive": {"max_speed_m_s": self.speed_m_s},
        }
        lines = [f'name = "{self.name}, to some percent"']
        for table, entries in tables.items():
            lines.append(f"[{table}]")
            for key, value in entries.items():
                lines.append(
                    f'{key} = {{ value = {json.dumps(value)}, assumed = true, source = "data sheet, rounded" }}'
                )
        with tempfile.TemporaryDirectory() as folder:
            file = Path(folder) / "rover.toml"
            file.write_text("\n".join(lines) + "\n", encoding="utf-8")
            return with_gravity(build_rover(str(file)), "earth")


WARTHOG = Vehicle(
    name="Warthog", radius_m=0.3, width_m=0.25, half_track_m=0.55, half_base_m=0.45, mass_kg=500.0, speed_m_s=5.0
)
HUSKY = Vehicle(
    name="Husky", radius_m=0.165, width_m=0.12, half_track_m=0.275, half_base_m=0.26, mass_kg=50.0, speed_m_s=1.5
)


@dataclass(frozen=True, kw_only=True, eq=False)
class Piece:
    """A piece of a drive.

    Attributes
    ----------
    name, vehicle : whose.
    table : telemetry, with a pose left out of `LEFT_OUT`.
    out : time, x, y of the poses left out. (o, 3) [s, m, m]
    sigma_m : stated error of a pose.
    """

    name: str
    vehicle: Vehicle
    table: pd.DataFrame
    out: FloatArray
    sigma_m: float

    @property
    def kept(self) -> FloatArray:
        """Time, x, y of the poses sent. (k, 3)"""
        return self.table[["time_s", "x_m", "y_m"]].dropna().to_numpy(dtype=float)


def piece_of(name: str, vehicle: Vehicle, table: pd.DataFrame, given: argparse.Namespace) -> Piece:
    """From a table with time, poses (blank where none is new) and columns of the wheels."""
    table = table.reset_index(drop=True)
    posed = np.flatnonzero(table["x_m"].notna())
    out = posed[PHASE::LEFT_OUT]
    left = table.loc[out, ["time_s", "x_m", "y_m"]].to_numpy(dtype=float)
    table.loc[out, list(POSE)] = np.nan
    table["sigma_m"] = np.where(table["x_m"].notna(), given.sigma_m, np.nan)
    table["yaw_deg_sigma"] = given.yaw_sigma_deg
    for wheel in ("FL", "FR", "RL", "RR"):
        table[f"steered_{wheel}_deg"] = 0.0
    dropped = ["z_m"] if given.attitude else ["z_m", "roll_deg", "pitch_deg"]
    return Piece(name=name, vehicle=vehicle, table=table.drop(columns=dropped), out=left, sigma_m=given.sigma_m)


def warthog_pieces(folder: Path, given: argparse.Namespace) -> list[Piece]:
    """One after the other, where the vehicle drives; poses come with angles interpolated between readings."""
    data = pd.read_csv(folder / "warthog_doughnut.csv")
    new = (data[list(POSE)].diff() != 0).any(axis=1)
    told = data["wheel_left_rad"].notna() | data["wheel_right_rad"].notna()
    data.loc[~new, list(POSE)] = np.nan
    data = data[new | told]
    for column in ("wheel_left_rad", "wheel_right_rad"):
        known = np.flatnonzero(data[column].notna())
        times = data["time_s"].to_numpy(dtype=float)
        after = np.clip(np.searchsorted(known, np.arange(len(data))), 1, len(known) - 1)
        near = times[known[after]] - times[known[after - 1]] <= given.within_s
        between = np.interp(times, times[known], data[column].to_numpy(dtype=float)[known])
        data[column] = data[column].where(data[column].notna() | ~near, between)
    data = thinned(data.dropna(subset=["wheel_left_rad", "wheel_right_rad"]), given.rows_s)
    pieces = []
    for begin in np.arange(data["time_s"].iloc[0], data["time_s"].iloc[-1] - given.seconds, given.seconds):
        own = data[(data["time_s"] >= begin) & (data["time_s"] < begin + given.seconds)]
        angles = own[["wheel_left_rad", "wheel_right_rad"]]
        if WARTHOG.radius_m * float(angles.diff().abs().sum().mean()) < given.seconds * 0.1:
            continue
        table = own[["time_s", *POSE]].copy()
        table["time_s"] -= float(begin)
        for side, column in (("L", "wheel_left_rad"), ("R", "wheel_right_rad")):
            for end in "FR":
                table[f"angle_{end}{side}_deg"] = np.degrees(own[column] - angles[column].dropna().iloc[0])
        pieces.append(piece_of(f"warthog {begin:.0f} s", WARTHOG, table, given))
    return pieces


def thinned(data: pd.DataFrame, least_s: float) -> pd.DataFrame:
    """Rows no closer in time than this; of those too close the first one with a pose."""
    kept: list[int] = []
    times, posed = data["time_s"].to_numpy(dtype=float), data["x_m"].notna().to_numpy()
    for row in range(len(data)):
        if not kept or times[row] - times[kept[-1]] >= least_s:
            kept.append(row)
        elif posed[row] and not posed[kept[-1]] and (len(kept) < 2 or times[row] - times[kept[-2]] >= least_s):
            kept[-1] = row
    return data.iloc[kept]


def husky_pieces(folder: Path, given: argparse.Namespace) -> list[Piece]:
    """Windows spread evenly over those in which the vehicle drives; angles are in rad there."""
    data = pd.read_csv(folder / "husky_windows.csv.gz")

    def series(name: str) -> FloatArray:
        return data[[f"{name}_{k}" for k in range(HUSKY_ROWS)]].to_numpy(dtype=float)

    left, right = series("left_wheel_vel"), series("right_wheel_vel")
    way = HUSKY.radius_m * HUSKY_STEP_S * (np.abs(left) + np.abs(right)).sum(axis=1) / 2.0
    poses = {name: series(f"icp_{name.split('_')[0]}") for name in POSE}
    driven = np.flatnonzero((way > LEAST_WAY_M) & np.isfinite(left).all(axis=1))
    pieces = []
    for row in driven[np.linspace(0, len(driven) - 1, given.husky).astype(int)] if given.husky else ():
        table = pd.DataFrame({"time_s": HUSKY_STEP_S * np.arange(HUSKY_ROWS)})
        for name in POSE:
            table[name] = np.degrees(poses[name][row]) if name.endswith("deg") else poses[name][row]
        table.loc[~(table[list(POSE)].diff() != 0).any(axis=1), list(POSE)] = np.nan
        for side, speed in (("L", left[row]), ("R", right[row])):
            for end in "FR":
                table[f"rate_{end}{side}_deg_s"] = np.degrees(speed)
        pieces.append(piece_of(f"husky {row}", HUSKY, table, given))
    return pieces


def flat(around: FloatArray) -> Terrain:
    """Level ground about some places. (n, 2)"""
    low = np.floor(around.min(axis=0)) - 6.0
    nx, ny = (np.ceil(around.max(axis=0) + 6.0 - low) / 0.5).astype(int) + 1
    return build_terrain("flat", float(low[0]), float(low[1]), 0.5, np.zeros((ny, nx)), read_soil("longji"))


def placed(drive: DriveStates, times: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Places (n, 2) and variances of x and y (n, 2) that the motion gives for positions of such times.

    Positions may be later than wheels, and of another point than the origin, where the result says so.
    """
    lag = getattr(drive, "lag", None)
    at = times - (lag.lag_s if lag is not None else 0.0)
    state, covariance, known = drive.smoothed.state, drive.smoothed.covariance, drive.nodes.time_s
    place = np.column_stack([np.interp(at, known, state[:, k]) for k in (0, 1)])
    variance = np.column_stack([np.interp(at, known, covariance[:, k, k]) for k in (0, 1)])
    for one in drive.findings.entries:
        if match := LEVER.search(one.what):
            ahead, left = float(match[1]), float(match[2])
            yaw = np.interp(at, known, state[:, 2])
            place += np.column_stack(
                [np.cos(yaw) * ahead - np.sin(yaw) * left, np.sin(yaw) * ahead + np.cos(yaw) * left]
            )
    return place, variance


def _constant_velocity(
    times: FloatArray, measured: FloatArray, sigma_m: float, intensity: float
) -> tuple[float, FloatArray, FloatArray]:
    """ln likelihood, smoothed values (n, 2) and their variance (n,); `measured` (n, 2) is NaN where nothing is."""
    count, unit = len(times), np.eye(2)
    first = measured[np.isfinite(measured[:, 0])][0]
    state, p, ln_l = np.array([first, [0.0, 0.0]]), np.diag([100.0, 25.0]), 0.0
    states, ps, before, before_p, steps = [], [], [], [], []
    for k in range(count):
        dt = times[k] - times[k - 1] if k else 0.0
        f = np.array([[1.0, dt], [0.0, 1.0]])
        noise = intensity * np.array([[dt**3 / 3.0, dt**2 / 2.0], [dt**2 / 2.0, dt]])
        state, p = f @ state, f @ p @ f.T + noise
        before.append(state)
        before_p.append(p)
        steps.append(f)
        if np.isfinite(measured[k, 0]):
            off, s = measured[k] - state[0], p[0, 0] + sigma_m**2
            gain = p[:, :1] / s
            ln_l -= math.log(2.0 * math.pi * s) + 0.5 * float(off @ off) / s
            state = state + gain * off
            p = (unit - gain @ unit[:1]) @ p
        states.append(state)
        ps.append(p)
    for k in range(count - 2, -1, -1):
        back = ps[k] @ steps[k + 1].T @ np.linalg.inv(before_p[k + 1])
        states[k] = states[k] + back @ (states[k + 1] - before[k + 1])
        ps[k] = ps[k] + back @ (ps[k + 1] - before_p[k + 1]) @ back.T
    return ln_l, np.array(states)[:, 0], np.array(ps)[:, 0, 0]


def without_wheels(piece: Piece) -> tuple[FloatArray, FloatArray]:
    """Places (n, 2) and variances (n, 2) of the left-out poses by constant velocity with white acceleration."""
    kept, out = piece.kept, piece.out
    times = np.concatenate([kept[:, 0], out[:, 0]])
    order = np.argsort(times, kind="stable")
    measured = np.vstack([kept[:, 1:], np.full((len(out), 2), np.nan)])[order]

    def cost(ln_q: float) -> float:
        return -_constant_velocity(kept[:, 0], kept[:, 1:], piece.sigma_m, math.exp(ln_q))[0]

    best = float(minimize_scalar(cost, bounds=(-14.0, 8.0), method="bounded", options={"xatol": 0.05}).x)
    _, place, variance = _constant_velocity(times[order], measured, piece.sigma_m, math.exp(best))
    rows = np.flatnonzero(np.isnan(measured[:, 0]))
    return place[rows], np.repeat(variance[rows, None], 2, axis=1)


def _scores(name: str, place: FloatArray, variance: FloatArray, piece: Piece) -> dict[str, float]:
    sigma = np.sqrt(variance + piece.sigma_m**2)
    off = np.abs(place - piece.out[:, 1:])
    return {
        f"{name}_in_95": float(np.mean(off <= Z95 * sigma)),
        f"{name}_width_m": float(np.median(2.0 * Z95 * sigma)),
        f"{name}_place_width_m": float(np.median(2.0 * Z95 * np.sqrt(variance))),
        f"{name}_rms_m": float(np.sqrt(np.mean(off**2))),
    }


def case(piece: Piece) -> dict[str, Any]:
    """One piece."""
    row: dict[str, Any] = {"piece": piece.name, "vehicle": piece.vehicle.name, "poses": len(piece.kept)}
    row |= {"out": len(piece.out), "refused": "", "doubt": "", "found": []} | _scores(
        "plain", *without_wheels(piece), piece
    )
    rover, findings, buffer = piece.vehicle.rover(), Findings(piece.name), io.StringIO()
    piece.table.to_csv(buffer, index=False)
    begin = time.process_time()
    try:
        telemetry = read_telemetry(InputFile(f"{piece.name}.csv", buffer.getvalue().encode()), rover, findings)
        drive = states_of(telemetry, rover, flat(piece.kept[:, 1:]), findings)
    except DataError as refused:
        return row | {"refused": str(refused), "cpu_s": time.process_time() - begin}
    row["cpu_s"] = time.process_time() - begin
    row |= _scores("states", *placed(drive, piece.out[:, 0]), piece)
    return row | {
        "doubt": findings.doubt,
        "found": [f"{one.kind}: {one.what}" for one in findings.entries],
        "kept": 1.0 - len(drive.left_out) / len(piece.kept),
        "valid": float(drive.rows.valid.mean()),
    }


def report(rows: list[dict[str, Any]]) -> None:
    """Each piece, and each vehicle; shares over all poses that were left out, their errors over pieces."""
    every = pd.DataFrame(rows)
    every["exit"] = np.select([every.refused != "", every.doubt != ""], [2, 3], 0)
    print("in 95: share of left-out x and y in their interval; width of it (2 x 1.96 sd), with and without the lidar's")
    print(every.drop(columns=["found", "doubt", "refused"]).to_string(float_format="%.3f"))
    for row in rows:
        print(f"{row['piece']}: {row['refused'] or '; '.join(one[:110] for one in row['found'])}")
    for vehicle, own in every.groupby("vehicle", sort=False):
        print(f"{vehicle}: pieces by exit code {own.exit.value_counts().to_dict()}")
        for label, some in (("served", own[own.exit != 2]), ("exit 0", own[own.exit == 0])):
            for of in ("states", "plain"):
                share = some[f"{of}_in_95"]
                mean = np.average(share, weights=some.out)
                error = np.hypot.reduce((share - mean) * some.out) / some.out.sum()
                print(f"  {label}, {of}: in 95 {100 * mean:.1f}±{100 * error:.1f} %")
            print(some.median(numeric_only=True).to_string())


def main() -> None:
    """Cut, find the motion, print."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seconds", type=float, default=28.0, help="length of the Warthog's pieces")
    parser.add_argument("--rows-s", type=float, default=0.0, help="least time between its rows")
    parser.add_argument(
        "--within-s", type=float, default=0.5, help="time between readings of its wheels within which poses are sent"
    )
    parser.add_argument("--husky", type=int, default=8, help="windows of the Husky")
    parser.add_argument("--sigma-m", type=float, default=0.05, help="stated error of x and of y of a lidar pose")
    parser.add_argument("--yaw-sigma-deg", type=float, default=2.0, help="that of its heading")
    parser.add_argument("--attitude", action="store_true", help="send roll and pitch, though the ground is not flat")
    parser.add_argument("--count", type=int, default=1000, help="pieces at most")
    parser.add_argument("--out", type=Path, help="a line of JSON for each piece")
    given = parser.parse_args()
    root = os.environ.get("LUNARSCI_REFERENCE_DATA")
    if not root:
        raise SystemExit("set LUNARSCI_REFERENCE_DATA to the folder of measured data")
    warnings.simplefilter("ignore")
    set_threads(1)
    folder = Path(root) / "drives"
    pieces = (warthog_pieces(folder, given) + husky_pieces(folder, given))[: given.count]
    case(pieces[0])
    rows = []
    for piece in pieces:
        rows.append(case(piece))
        if given.out:
            given.out.write_text("".join(json.dumps(row) + "\n" for row in rows), encoding="utf-8")
    report(rows)


if __name__ == "__main__":
    main()
