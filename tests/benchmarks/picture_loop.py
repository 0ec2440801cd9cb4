"""The loop from pictures: `python tests/benchmarks/picture_loop.py FOLDER [--soils N] [--first K] [--small]`.

On hidden soils, drawn from the default priors, a rover sees the ground ahead, drives over it, looks ahead and back from
its new place, and drives back. The twin predicts the return twice: once with terrain, positions every half metre and
ruts as given (`given`), once from SYNTHETIC pictures alone (`pictures`): the terrain is `images dem` of those from the
first station, the places on the drive are those of `images locate`, the depth of the ruts that of `images track` in the
pictures that look back. Telemetry of wheels and headings is the same in both. What is compared is how far the true
return ends from where it was predicted to, beside where soil and terrain as before the drive say.

Pictures are rendered with a draw from the covariance of the rig, of ground with roughness and rocks that the true drive
does not know; a wheel takes the mean of them. `--small` takes half of the pixels each way, with the same view.
"""

import argparse
import json
import warnings
from pathlib import Path
from typing import Any

import numpy as np

import lunarsci
from lunarsci.images.elevation import elevation_bytes
from lunarsci.images.jobs.dem import dem
from lunarsci.images.jobs.locate import locate
from lunarsci.images.jobs.render import render
from lunarsci.images.jobs.track import track
from lunarsci.images.rig_files import read_rig, rig_text
from lunarsci.regolith.belief import first_belief
from lunarsci.regolith.soil import read_soil
from lunarsci.result import Result
from lunarsci.tables import csv_bytes
from lunarsci.twin.ground.synthetic import synthetic_terrain
from lunarsci.twin.ground.terrain import Terrain, build_terrain
from lunarsci.twin.ground.terrain_files import write_terrain
from lunarsci.twin.plans.plan import Leg, Plan
from lunarsci.twin.rover import build_rover
from lunarsci.twin.simulation.ensemble import STATE_COLUMNS, Prediction, predict
from lunarsci.twin.telemetry.simulated import SensorErrors, deepest_at, simulate_telemetry

SPACING_M, SIDE_M = 0.02, 20.0
BEHIND_M, MAST_M, DOWN_DEG, BACK_DOWN_DEG = 2.4, 1.5, 25.0, 35.0
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


def fine(terrain: Terrain) -> Terrain:
    """The same ground on the nodes that pictures are made of."""
    x = np.arange(-0.5 * SIDE_M, 0.5 * SIDE_M + 1e-9, SPACING_M)
    heights = terrain.height_at(*np.meshgrid(x[1:-1], x[1:-1]))
    return build_terrain(terrain.name, x[1], x[1], SPACING_M, heights, read_soil("longji"), synthetic=True)


def with_ruts(ground: Terrain, drive: Prediction) -> Terrain:
    """The ground after a drive: lower by what the deepest wheel pressed, with walls that a wheel's width has."""
    count = int(drive.recorded[0])
    x, y, z = (drive.states[0, :count, :, STATE_COLUMNS.index(name)] for name in ("x_m", "y_m", "sinkage_m"))
    heights, reach = ground.height_m.copy(), 0.5 * drive.rover.wheel.width_m
    rows, columns = (
        slice(*np.searchsorted(axis, (v.min() - 2 * reach, v.max() + 2 * reach)))
        for axis, v in ((ground.y_m, y), (ground.x_m, x))
    )
    nodes = np.stack(np.meshgrid(ground.x_m[columns], ground.y_m[rows]), axis=-1)
    deep = np.maximum(deepest_at(nodes.reshape(-1, 2), (x, y, z), reach), 0.0).max(axis=1)
    heights[rows, columns] -= deep.reshape(nodes.shape[:2])
    return build_terrain(ground.name, ground.x0_m, ground.y0_m, SPACING_M, heights, read_soil("longji"), synthetic=True)


def pose_text(place: tuple[float, float, float], heading: float, down: float, time_s: float) -> str:
    """A pose.toml."""
    where = [float(value) for value in place]
    return f"position_m = {where}\nheading_deg = {heading}\ndown_deg = {down}\nroll_deg = 0.0\ntime_s = {time_s}\n"


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


def loop(folder: Path, number: int, rig: str) -> dict[str, Any]:
    """One hidden soil on one ground."""
    warnings.simplefilter("ignore")
    folder.mkdir(parents=True, exist_ok=True)
    rover, soil = build_rover("yutu2"), soil_of(number)
    truth = synthetic_terrain(seed=number, spacing_m=0.1, extent_m=SIDE_M, craters=6, rms_m=0.004)
    hidden = truth.with_soil(**soil)
    write_terrain(truth, folder / "given.npz")
    ground = fine(truth)
    write_terrain(ground, folder / "ground.npz")
    drive = predict(rover, hidden, OUT, sweep=(), time_step_s=0.05, sample_m=0.05)
    x, y, yaw = drive.paths[0, -1, [0, 1, 5]]
    write_terrain(with_ruts(ground, drive), folder / "after.npz")
    telemetry = simulate_telemetry(drive, SensorErrors(), seed=number)
    (folder / "telemetry.csv").write_bytes(csv_bytes(telemetry.telemetry))
    (folder / "track.csv").write_bytes(csv_bytes(telemetry.track))
    back = predict(rover, hidden, way_back(np.array([x, y, yaw])), sweep=(), ruts=True, before=OUT)
    true_end = back.endpoints_m[0]
    row: dict[str, Any] = {"soil": number, "finished": bool(drive.finished[0] and back.finished[0])}
    if not row["finished"]:
        return row
    # Given terrain, positions and ruts.
    belief, place = learned(folder, "given", str(folder / "given.npz"), track=str(folder / "track.csv"))
    row["given_m"] = float(np.hypot(*(ends(way_back(place), str(folder / "given.npz"), folder, belief) - true_end)))
    unlearned = ends(way_back(place), str(folder / "given.npz"), folder, first_belief())
    row["unlearned_m"] = float(np.hypot(*(unlearned - true_end)))
    # Pictures.
    asked = {"rig": rig, "spacing": float(np.diff(ground.x_m[:2])[0]), "rocks": 0.3, "seed": number + 1, "samples": 1}
    first = render(str(folder / "ground.npz"), x=-BEHIND_M, heading=0.0, down=DOWN_DEG, **asked)
    one, after = kept(first, folder / "A"), str(folder / "after.npz")
    seen = dem(str(one / "left.png"), str(one / "right.png"), rig=rig, pose=str(one / "pose.toml"))
    model = folder / "dem.npz"
    model.write_bytes(elevation_bytes(seen.model))
    (one / "pose.toml").write_text((one / "pose.toml").read_text() + "time_s = 0.0\n")
    samples = np.linspace(0, int(drive.recorded[0]) - 1, STATIONS).astype(int)
    names = [f"S{k}" for k in range(STATIONS)]
    for name, sample in zip(names, samples, strict=True):
        place, sent = drive.paths[0, sample], telemetry.telemetry.iloc[sample]
        view = {"x": float(place[0]), "y": float(place[1]), "heading": float(place[5]), "down": DOWN_DEG}
        kept(render(after, **view, **asked), folder / name)
        # Dead reckoning: the plan, the heading of telemetry, the height of the model.
        planned = drive.planned[sample]
        height = float(np.nan_to_num(seen.model.at("height_m", *planned[:2][:, None])[0]))
        dead = (planned[0], planned[1], height + MAST_M)
        (folder / name / "pose.toml").write_text(
            pose_text(dead, float(sent["yaw_deg"]), DOWN_DEG, float(sent["time_s"]))
        )
    kept(render(after, x=float(x), y=float(y), heading=float(yaw) + 180, down=BACK_DOWN_DEG, **asked), folder / "back")
    located = locate([str(one), *(str(folder / name) for name in names)], rig=rig, heading_error=0.5)
    table = list(located.to_dict()["stations"])[1:]
    last = table[-1]
    row["tied"], row["place_off_m"] = sum(r["tied"] for r in table), float(np.hypot(last["x_m"] - x, last["y_m"] - y))
    positions = folder / "positions.csv"
    fixes = [(r["time_s"], r["x_m"], r["y_m"], float(np.sqrt(0.5 * (r["xx_m2"] + r["yy_m2"])))) for r in table]
    lines = [",".join(map(str, fix)) for fix in fixes]
    positions.write_text("\n".join(["time_s,x_m,y_m,sigma_m", *lines]) + "\n")
    heading = float(last["camera_heading_deg"]) + 180
    pose = pose_text((last["x_m"], last["y_m"], last["z_m"]), heading, BACK_DOWN_DEG, 0.0)
    (folder / "back" / "pose.toml").write_text(pose)
    behind = dem(*(str(folder / "back" / f"{side}.png") for side in ("left", "right")), rig=rig,
                 pose=str(folder / "back" / "pose.toml"), spacing=0.01)  # fmt: skip
    (folder / "behind.npz").write_bytes(elevation_bytes(behind.model))
    motion = lunarsci.states(str(folder / "telemetry.csv"), OUT, terrain=str(model), positions=str(positions)).tables[
        "motion.csv"
    ]
    tracks, errors = [], []
    for aside in (WHEEL_ASIDE_M, -WHEEL_ASIDE_M):
        turn = np.radians(motion["yaw_deg"].to_numpy())
        line = np.column_stack([motion["x_m"] - aside * np.sin(turn), motion["y_m"] + aside * np.cos(turn)])[::10]
        text = ",".join(f"{value:.4f}" for value in line.ravel())
        found = track(str(folder / "behind.npz"), line=text, search=0.1)
        tracks += [r for r in found.rows() if r["status"] == "ok"]
    path = folder / "depths.csv"
    path.write_text("x_m,y_m,rut_m,rut_m_sigma\n" + "".join(
        f"{r['x_m']},{r['y_m']},{r['rut_m']},{r['rut_m_sigma']}\n" for r in tracks))  # fmt: skip
    count = int(drive.recorded[0])
    paths = tuple(drive.states[0, :count, :, STATE_COLUMNS.index(name)] for name in ("x_m", "y_m", "sinkage_m"))
    if tracks:
        places = np.array([[r["x_m"], r["y_m"]] for r in tracks])
        true = deepest_at(places, paths, 0.2).max(axis=1)
        errors = [r["rut_m"] - t for r, t in zip(tracks, true, strict=True) if np.isfinite(t)]
    row |= {"depths": len(tracks), "depth_rms_mm": 1e3 * float(np.sqrt(np.mean(np.square(errors)))) if errors else None}
    given = {"positions": str(positions)} | ({"track": str(path)} if tracks else {})
    belief, place = learned(folder, "pictures", str(model), **given)
    row["pictures_m"] = float(np.hypot(*(ends(way_back(place), str(model), folder, belief) - true_end)))
    return row


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
