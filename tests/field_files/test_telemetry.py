"""Telemetry as tools of ROS and loggers write it, each after a public description that its kind names.

A SYNTHETIC drive of `twin simulate` stands in all of them; its slips must come out as of its own telemetry.
"""

import json
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from lunarsci.cli import main
from scipy.spatial.transform import Rotation

import lunarsci
from lunarsci.guide.info import info
from lunarsci.io.inputs import read_input
from lunarsci.twin.rover import build_rover
from lunarsci.twin.telemetry.reading import Findings, read_positions, read_telemetry

WHEELS = ("FL", "FR", "ML", "MR", "RL", "RR")
LONG = {"F": "front", "M": "middle", "R": "rear"}
SIDE = {"L": "left", "R": "right"}
PLAN = "[drive]\nspeed_m_s = 0.05\n[[leg]]\nlength_m = 2.5\ncurvature_per_m = 0.15\n"


@pytest.fixture(scope="module")
def drive(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with a plan and the telemetry of a made-up drive along it."""
    folder = tmp_path_factory.mktemp("drive")
    (folder / "plan.toml").write_text(PLAN)
    assert main(["twin", "simulate", str(folder / "plan.toml"), "-q", "-o", str(folder / "made")]) == 0
    return folder


@pytest.fixture(scope="module")
def expected(drive: Path) -> dict[str, object]:
    """What `twin states` finds from the telemetry as it was made."""
    return dict(lunarsci.states(str(drive / "made" / "telemetry.csv"), str(drive / "plan.toml")).to_dict())


def quaternions(table: pd.DataFrame) -> dict[str, np.ndarray]:
    turns = Rotation.from_euler("ZYX", table[["yaw_deg", "pitch_deg", "roll_deg"]].to_numpy(), degrees=True).as_quat()
    return dict(zip("xyzw", turns.T, strict=True))


def pose(table: pd.DataFrame, name: Callable[[str], str]) -> dict[str, object]:
    """Position, quaternion and covariance of poses, by `name` of the path of a field."""
    cells: dict[str, object] = {name(f"position.{axis}"): table[f"{axis}_m"] for axis in "xy"}
    cells |= {name(f"orientation.{axis}"): one for axis, one in quaternions(table).items()}
    return cells


def joints(table: pd.DataFrame, form: str = "wheel_{}", topic: str = "/joint_states/{}/{}") -> dict[str, object]:
    found: dict[str, object] = {}
    for wheel in WHEELS:
        named = form.format(wheel) if "{}" in form else f"{LONG[wheel[0]]}_{SIDE[wheel[1]]}_wheel"
        found[topic.format(f"{named}_joint", "position")] = np.radians(table[f"angle_{wheel}_deg"])
        found[topic.format(f"{named}_joint", "velocity")] = np.radians(table[f"rate_{wheel}_deg_s"])
        found[topic.format(f"steer_{wheel}", "position")] = np.radians(table[f"steered_{wheel}_deg"])
    return found


def errors(table: pd.DataFrame, name: str) -> dict[str, object]:
    found = {name.format(k): 0.0 * table["time_s"] for k in range(36)}
    found |= {name.format(k): table[key] for k, key in ((0, "xx_m2"), (1, "xy_m2"), (7, "yy_m2"))}
    return found | {name.format(35): np.radians(table["yaw_deg_sigma"]) ** 2}


def plotjuggler(table: pd.DataFrame) -> pd.DataFrame:
    base = "/localization/pose/pose/"
    own = pose(table, lambda field: base + field.replace(".", "/"))
    return pd.DataFrame(
        {"__time": table["time_s"]} | own | errors(table, "/localization/pose/covariance[{}]") | joints(table)
    )


def bagpy(table: pd.DataFrame) -> pd.DataFrame:
    own = pose(table, lambda field: f"pose.pose.{field}")
    whole = np.floor(table["time_s"])
    stamps = {"header.seq": range(len(table)), "header.stamp.secs": whole.astype(int)}
    stamps |= {"header.stamp.nsecs": np.round(1e9 * (table["time_s"] - whole)).astype(int), "child_frame_id": "base"}
    return pd.DataFrame(
        {**stamps, **own, **errors(table, "pose.covariance_{}"), **joints(table, "long", "joint_states.{}.{}")}
    )


def ros2(table: pd.DataFrame) -> pd.DataFrame:
    other = bagpy(table)
    return other.rename(columns={"header.stamp.secs": "header.stamp.sec", "header.stamp.nsecs": "header.stamp.nanosec"})


def radians(table: pd.DataFrame) -> pd.DataFrame:
    other = table.copy()
    for name in [name for name in table if str(name).endswith(("_deg", "_deg_sigma", "_deg_s"))]:
        other[name] = np.radians(table[name])
    return other.rename(columns=lambda name: str(name).replace("_deg", "_rad"))


def small_units(table: pd.DataFrame) -> pd.DataFrame:
    other = table.assign(time_s=1e3 * table["time_s"], x_m=1e3 * table["x_m"], y_m=1e3 * table["y_m"])
    return other.rename(columns={"time_s": "time_ms", "x_m": "x_mm", "y_m": "y_mm"})


KINDS: dict[str, tuple[str, Callable[[pd.DataFrame], pd.DataFrame], str]] = {
    "plotjuggler": ("PlotJuggler, CSV export of several topics", plotjuggler, ","),
    "bagpy": ("https://jmscslgroup.github.io/bagpy, message_by_topic", bagpy, ","),
    "ros 2": ("builtin_interfaces/Time of ROS 2, sec and nanosec", ros2, ","),
    "radians": ("REP 103, units", radians, ","),
    "small units": ("loggers with ms and mm", small_units, ","),
    "decimal comma": ("locale de_DE", lambda table: table, ";"),
}


def written(drive: Path, folder: Path, kind: str) -> Path:
    _, make, separator = KINDS[kind]
    table = make(pd.read_csv(drive / "made" / "telemetry.csv", comment="#"))
    table.to_csv(folder / "t.csv", index=False, sep=separator, decimal="," if separator == ";" else ".")
    return folder / "t.csv"


def slips(result: dict[str, object]) -> list[float]:
    wheels = result["wheels"]
    assert isinstance(wheels, dict)
    return [wheels[wheel]["slip_ratio"]["median"] for wheel in WHEELS]


@pytest.mark.parametrize("kind", KINDS)
def test_the_slips_come_out(
    kind: str, drive: Path, expected: dict[str, object], tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    path, plan = written(drive, tmp_path, kind), str(drive / "plan.toml")
    rover, own = build_rover("yutu2"), drive / "made" / "telemetry.csv"
    read, truth = (read_telemetry(read_input(one), rover, Findings(str(one))) for one in (path, own))
    for name in (
        "time_s",
        "fix_m",
        "fix_covariance_m2",
        "yaw_deg",
        "roll_deg",
        "pitch_deg",
        "angle_deg",
        "steered_deg",
    ):
        np.testing.assert_allclose(getattr(read, name), getattr(truth, name), rtol=1e-6, atol=1e-6)
    capfd.readouterr()
    assert main(["twin", "states", str(path), plan, "--json"]) == 0
    assert slips(json.loads(capfd.readouterr().out)["result"]) == pytest.approx(slips(expected), abs=2e-4)
    assert (info(path).kind, info(path).trouble) == ("telemetry", "")


def test_positions_of_rostopic_are_read(drive: Path, tmp_path: Path) -> None:
    """`rostopic echo -b a.bag -p /localization`: stamps in ns, `field.` before all others."""
    table = pd.read_csv(drive / "made" / "telemetry.csv", comment="#").dropna(subset=["x_m"])
    stamps = np.round(1e9 * table["time_s"]).astype("int64")
    own = {"%time": stamps, "field.header.seq": range(len(table)), "field.header.stamp": stamps}
    own |= pose(table, lambda field: f"field.pose.pose.{field}") | errors(table, "field.pose.covariance{}")
    path = tmp_path / "localization.csv"
    pd.DataFrame(own).to_csv(path, index=False)
    found = read_positions(read_input(path))
    np.testing.assert_allclose(found.time_s, table["time_s"], atol=1e-6)
    np.testing.assert_allclose(found.place_m, table[["x_m", "y_m"]])
    np.testing.assert_allclose(found.covariance_m2[:, 0, 0], table["xx_m2"])
    told = info(path)
    assert (told.kind, told.trouble) == ("positions", "")
