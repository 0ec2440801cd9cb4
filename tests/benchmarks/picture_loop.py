"""The loop from pictures: `python tests/benchmarks/picture_loop.py FOLDER [--soils N] [--first K] [--small]`.

On hidden soils, drawn from the default priors, a rover sees the ground ahead, drives over it, looks ahead and back from
its new place, and drives back. The twin predicts the return twice: once with terrain, positions every half metre and
ruts as given (`given`), once from SYNTHETIC pictures alone (`pictures`): the terrain is `images dem` of those from the
first station, the places on the drive are those of `images locate`, the depth of the ruts that of `images track` in the
pictures that look back. Telemetry of wheels and headings is the same in both. What is compared is how far the true
return ends from where it was predicted to, beside where soil and terrain as before the drive say.

Pictures are rendered with a draw from the covariance of the rig, of ground with roughness and rocks that the true drive
does not know; a wheel takes the mean of them. The map that the return is predicted on is that of all stations
(`images merge`). `--small` takes half of the pixels each way, with the same view.
"""

import argparse
import json
import warnings
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

import lunarsci
from lunarsci.images.elevation import ElevationModel, elevation_bytes
from lunarsci.images.jobs.dem import dem
from lunarsci.images.jobs.locate import locate
from lunarsci.images.jobs.merge import merge
from lunarsci.images.jobs.render import render
from lunarsci.images.jobs.track import track
from lunarsci.images.rig_files import read_rig, rig_text
from lunarsci.io.tables import csv_bytes
from lunarsci.regolith.belief import first_belief
from lunarsci.result import Result
from lunarsci.twin.ground.synthetic import synthetic_terrain
from lunarsci.twin.ground.terrain import terrain_bytes
from lunarsci.twin.judgement.tables import state_table
from lunarsci.twin.plans.plan import Leg, Plan
from lunarsci.twin.rover import build_rover
from lunarsci.twin.simulation.ensemble import STATE_COLUMNS, Prediction, predict
from lunarsci.twin.telemetry.simulated import SensorErrors, deepest_at, simulate_telemetry

SPACING_M, SIDE_M = 0.01, 18.0
BEHIND_M, MAST_M, DOWN_DEG, BACK_DOWN_DEG = 3.2, 1.5, 25.0, 35.0
OUT = Plan(name="out", legs=(Leg(2.5, 0.05), Leg(2.5, -0.08)), speed_m_s=0.05)
WHEEL_ASIDE_M = 0.45
STATIONS = 5
"""Places along the drive, its start and its end among them, where pictures are taken."""
MEMBERS = 64


def kept(result: Result, folder: Path) -> Path:
    """The files of a result in a folder."""
    folder.mkdir(parents=True, exist_ok=True)
    for name, make in result.files().items():
        if name != "truth.npz":
            (folder / name).write_bytes(make())
    return folder


def pose_text(place: tuple[float, float, float], heading: float, down: float) -> str:
    """A pose.toml."""
    where = [float(value) for value in place]
    return f"position_m = {where}\nheading_deg = {heading}\ndown_deg = {down}\nroll_deg = 0.0\n"


def way_back(end: np.ndarray) -> Plan:
    """The arcs of the drive backwards, from where the rover is taken to stand (x, y [m], heading [deg])."""
    legs = tuple(Leg(leg.length_m, -leg.curvature_per_m, crab_deg=180.0) for leg in reversed(OUT.legs))
    return Plan(name="back", legs=legs, speed_m_s=0.05, x_m=end[0], y_m=end[1], heading_deg=end[2])


def learned(folder: Path, name: str, terrain: str, **seen: Any) -> tuple[Any, np.ndarray]:
    """The belief after the drive, and where the rover is taken to stand; `seen` are positions and track."""
    found = lunarsci.states(str(folder / "telemetry.csv"), OUT, terrain=terrain, **seen)
    here = kept(found, folder / f"states-{name}")
    motion = found.tables["motion.csv"].iloc[-1]
    update = lunarsci.update(
        str(here / "states.csv"), plan=OUT, positions=str(here / "positions.csv"), terrain=terrain, seed=1
    )
    return update.belief, motion[["x_m", "y_m", "yaw_deg"]].to_numpy(float)


def ends(back: Plan, terrain: str, folder: Path, belief: Any) -> np.ndarray:
    """Predicted ends of the return on soils of a belief; the middle of them. (2,) [m]"""
    path = folder / "belief.json"
    path.write_text(belief.to_json())
    found = lunarsci.predict(back, terrain=terrain, soil=(str(path),), members=MEMBERS, seed=1)
    done = found.prediction.finished
    return np.asarray(np.median(found.prediction.endpoints_m[done], axis=0))


def soil_of(number: int) -> dict[str, float]:
    return {name: float(values[number]) for name, values in first_belief().draws(64, seed=77).items()}


def modelled(folder: Path, rig: str, pose: Path, **options: Any) -> ElevationModel:
    """Heights from the pictures in a folder, also in its `dem.npz`."""
    found = dem(str(folder / "left.png"), str(folder / "right.png"), rig=rig, pose=str(pose), **options).model
    (folder / "dem.npz").write_bytes(elevation_bytes(found))
    return found


def taken(folder: Path, ground: str, drive: Prediction, telemetry: pd.DataFrame, asked: dict[str, Any]) -> list[Path]:
    """Pictures before the drive, and ahead from places along it; poses but the first are those of dead reckoning.

    That is the plan, the heading of telemetry, and the height of the first model.
    """
    folders = [kept(render(ground, x=-BEHIND_M, down=DOWN_DEG, **asked), folder / "A")]
    seen = modelled(folders[0], asked["rig"], folders[0] / "pose.toml")
    for number, sample in enumerate(np.linspace(0, int(drive.recorded[0]) - 1, STATIONS).astype(int)):
        place, sent, planned = drive.paths[0, sample], telemetry.iloc[sample], drive.planned[sample]
        view = {"x": float(place[0]), "y": float(place[1]), "heading": float(place[5]), "down": DOWN_DEG}
        folders.append(kept(render(ground, **view, **asked), folder / f"S{number}"))
        height = float(np.nan_to_num(seen.at("height_m", *planned[:2][:, None])[0]))
        dead = (planned[0], planned[1], height + MAST_M)
        text = pose_text(dead, float(sent["yaw_deg"]), DOWN_DEG) + f"time_s = {float(sent['time_s'])}\n"
        (folders[-1] / "pose.toml").write_text(text)
    return folders


def depths(folder: Path, lines: np.ndarray, rig: str) -> list[dict[str, Any]]:
    """Depths of the ruts in the pictures of a folder along lines. (lines, points, 2) [m]"""
    modelled(folder, rig, folder / "pose.toml", spacing=0.01)
    rows: list[dict[str, Any]] = []
    for line in lines:
        text = ",".join(f"{value:.4f}" for value in line.ravel())
        rows += track(str(folder / "dem.npz"), line=text, search=0.1).rows()
    return [row for row in rows if row["status"] == "ok"]


def from_pictures(
    folder: Path, ground: str, drive: Prediction, telemetry: pd.DataFrame, asked: dict[str, Any]
) -> dict[str, Any]:
    """Map, positions and ruts as pictures say, as files, and how far they are off."""
    x, y, yaw = drive.paths[0, -1, [0, 1, 5]]
    folders = taken(folder, ground, drive, telemetry, asked)
    located = locate([str(one) for one in folders], rig=asked["rig"], heading_error=0.5)
    here, last = kept(located, folder / "located"), located.rows()[-1]
    for one in folders[1:]:
        modelled(one, asked["rig"], here / f"{one.name}.toml")
    whole = merge([str(one / "dem.npz") for one in folders], positions=str(here / "shifts.csv")).merged.model
    (folder / "map.npz").write_bytes(elevation_bytes(whole))
    behind = {"track": str(folder / "truth.csv"), "track_width": drive.rover.wheel.width_m, "down": BACK_DOWN_DEG}
    back = kept(render(ground, x=float(x), y=float(y), heading=float(yaw) + 180, **behind, **asked), folder / "back")
    place = (last["x_m"], last["y_m"], last["z_m"])
    (back / "pose.toml").write_text(pose_text(place, float(last["camera_heading_deg"]) + 180, BACK_DOWN_DEG))
    seen = {"positions": str(here / "positions.csv")}
    motion = lunarsci.states(str(folder / "telemetry.csv"), OUT, terrain=str(folder / "map.npz"), **seen).tables[
        "motion.csv"
    ][::10]
    turn, middle = np.radians(motion["yaw_deg"].to_numpy()), motion[["x_m", "y_m"]].to_numpy()
    aside = WHEEL_ASIDE_M * np.column_stack([-np.sin(turn), np.cos(turn)])
    found = depths(back, np.stack([middle + aside, middle - aside]), asked["rig"])
    if found:
        columns = ("x_m", "y_m", "rut_m", "rut_m_sigma")
        pd.DataFrame(found)[list(columns)].to_csv(folder / "depths.csv", index=False)
        seen["track"] = str(folder / "depths.csv")
    off = float(np.hypot(last["x_m"] - x, last["y_m"] - y))
    tied = sum(row["tied"] for row in located.rows()[1:])
    return {"seen": seen, "tied": tied, "place_off_m": off} | depth_errors(drive, found)


def depth_errors(drive: Prediction, found: list[dict[str, Any]]) -> dict[str, Any]:
    """How far depths are off those that the deepest wheel left, in mm."""
    count = int(drive.recorded[0])
    paths = tuple(drive.states[0, :count, :, STATE_COLUMNS.index(name)] for name in ("x_m", "y_m", "sinkage_m"))
    true = deepest_at(np.array([[row["x_m"], row["y_m"]] for row in found]).reshape(-1, 2), paths, 0.2).max(axis=1)
    off = np.array([row["rut_m"] for row in found]) - true
    z = off / np.array([row["rut_m_sigma"] for row in found])
    known = np.isfinite(off)
    if not known.any():
        return {"depths": 0}
    rms, over = (float(np.sqrt(np.mean(np.square(values[known])))) for values in (1e3 * off, z))
    return {"depths": len(found), "depth_rms_mm": rms, "depth_rms_sigmas": over}


def loop(folder: Path, number: int, rig: str) -> dict[str, Any]:
    """One hidden soil on one ground."""
    warnings.simplefilter("ignore")
    folder.mkdir(parents=True, exist_ok=True)
    rover, soil = build_rover("yutu2"), soil_of(number)
    truth = synthetic_terrain(seed=number, spacing_m=0.05, extent_m=SIDE_M, craters=6, rms_m=0.004)
    hidden, ground = truth.with_soil(**soil), str(folder / "given.npz")
    Path(ground).write_bytes(terrain_bytes(truth))
    drive = predict(rover, hidden, OUT, sweep=(), time_step_s=0.05, sample_m=0.05)
    telemetry = simulate_telemetry(drive, SensorErrors(), seed=number)
    for name, table in (("telemetry", telemetry.telemetry), ("track", telemetry.track), ("truth", state_table(drive))):
        (folder / f"{name}.csv").write_bytes(csv_bytes(table))
    back = predict(rover, hidden, way_back(drive.paths[0, -1, [0, 1, 5]]), sweep=(), ruts=True, before=OUT)
    row: dict[str, Any] = {"soil": number, "finished": bool(drive.finished[0] and back.finished[0])}
    if not row["finished"]:
        return row

    def miss(terrain: str, belief: Any, place: np.ndarray) -> float:
        return float(np.hypot(*(ends(way_back(place), terrain, folder, belief) - back.endpoints_m[0])))

    belief, place = learned(folder, "given", ground, track=str(folder / "track.csv"))
    row["given_m"], row["unlearned_m"] = (miss(ground, known, place) for known in (belief, first_belief()))
    asked = {"rig": rig, "spacing": SPACING_M, "rocks": 0.4, "seed": number + 1, "samples": 1}
    found = from_pictures(folder, ground, drive, telemetry.telemetry, asked)
    belief, place = learned(folder, "pictures", str(folder / "map.npz"), **found.pop("seen"))
    return row | found | {"pictures_m": miss(str(folder / "map.npz"), belief, place)}


def main() -> None:
    """Run, and print a line for each soil."""
    parser = argparse.ArgumentParser(description="The loop from pictures.")
    parser.add_argument("folder", type=Path)
    parser.add_argument("--soils", type=int, default=6)
    parser.add_argument("--first", type=int, default=0)
    parser.add_argument("--small", action="store_true")
    given = parser.parse_args()
    given.folder.mkdir(parents=True, exist_ok=True)
    rig = "yutu2-navcam"
    if given.small:
        rig = str(given.folder / "small.toml")
        Path(rig).write_text(rig_text(read_rig("yutu2-navcam").with_pixels(512)))
    rows = []
    for number in range(given.first, given.first + given.soils):
        row = loop(given.folder / f"soil-{number}", number, rig)
        rows.append(row)
        print(json.dumps(row), flush=True)
    done = [row for row in rows if "pictures_m" in row]
    if done:
        medians = {
            key: float(np.median([row[key] for row in done])) for key in ("unlearned_m", "given_m", "pictures_m")
        }
        print(json.dumps({"median": medians, "ratio": medians["pictures_m"] / medians["given_m"]}))


if __name__ == "__main__":
    main()
