"""Drives beside files whose heights or loads are in another unit than their names say: asked, and the answer taken.

`twin update`, `twin compare` and `twin loads` ask as `twin predict` does. All of it is SYNTHETIC.
"""

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest
from lunarsci.cli import main

from lunarsci.twin.ground.synthetic import synthetic_longji

PLAN = "[drive]\nspeed_m_s = 0.05\n[[leg]]\nlength_m = 0.6\n"


@pytest.fixture(scope="module")
def drive(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with a plan, its prediction, states of the wheels, once with forces in kN, and the ground in km."""
    folder = tmp_path_factory.mktemp("asked")
    plan = str(folder / "plan.toml")
    (folder / "plan.toml").write_text(PLAN)
    assert main(
        ["twin", "predict", plan, "-q", "--sweep", "friction_angle_deg=28:44:4", "-o", str(folder / "predicted")]
    ) in (0, 3)
    assert main(["twin", "forces", plan, "-q", "-o", str(folder / "states.csv")]) == 0
    states = pd.read_csv(folder / "states.csv")
    states["sinkage_m"] += 3e-4 * np.sin(np.arange(len(states)))
    states.to_csv(folder / "states.csv", index=False)
    columns = {"normal_force_n": 1e-3, "drawbar_pull_n": 1e-3, "lateral_force_n": 1e-3}
    small = states.assign(**{name: size * states[name] for name, size in columns.items() if name in states})
    small.to_csv(folder / "small.csv", index=False)
    small.rename(columns={name: name.replace("_n", "_kN") for name in columns}).to_csv(
        folder / "named.csv", index=False
    )
    moved = pd.read_csv(folder / "predicted" / "paths.csv")
    moved[moved["member"] == 0][["time_s", "x_m", "y_m", "yaw_deg"]].to_csv(folder / "motion.csv", index=False)
    ground = synthetic_longji()
    rows = "\n".join(" ".join(f"{1e-3 * value:.8f}" for value in row) for row in ground.height_m[::-1])
    head = f"ncols {ground.height_m.shape[1]}\nnrows {ground.height_m.shape[0]}\nxllcenter {ground.x0_m}\n"
    (folder / "km.asc").write_text(f"{head}yllcenter {ground.y0_m}\ncellsize {ground.spacing_m}\n{rows}\n")
    return folder


@pytest.fixture
def asked(capfd: pytest.CaptureFixture[str]) -> Callable[..., tuple[int, list[dict[str, Any]], str]]:
    """Exit code, questions, and what stands on stderr, of a command."""

    def call(*arguments: object) -> tuple[int, list[dict[str, Any]], str]:
        capfd.readouterr()
        code = main(["twin", *map(str, arguments), "--json"])
        out, err = capfd.readouterr()
        return code, json.loads(out)["result"].get("questions", []), err

    return call


Asked = Callable[..., tuple[int, list[dict[str, Any]], str]]


def test_loads_in_kilonewtons_are_asked_about_by_update_and_compare(asked: Asked, drive: Path) -> None:
    update = ("update", "--plan", drive / "plan.toml", "--particles", 32)
    compare = ("compare", drive / "predicted")
    for command in (update, compare):
        code, questions, err = asked(*command, drive / "small.csv")
        assert code == 3 and "is it in kN?" in err
        (question,) = questions
        assert question["likely_unit"] == "kN"
        assert question["option"].startswith("name columns normal_force_kN")
    assert asked(*compare, drive / "small.csv", "--as-written")[1] == []
    assert asked(*compare, drive / "named.csv")[1] == [] == asked(*compare, drive / "states.csv")[1]


def test_heights_in_kilometres_are_asked_about_by_update_and_loads(asked: Asked, drive: Path) -> None:
    plan, states = drive / "plan.toml", drive / "free.csv"
    pd.read_csv(drive / "states.csv").drop(columns="ground", errors="ignore").to_csv(states, index=False)
    loads = ("loads", plan, "--motion", drive / "motion.csv", "--terrain", drive / "km.asc")
    update = ("update", states, "--plan", plan, "--particles", 32, "--terrain", drive / "km.asc")
    for command in (update, loads):
        code, questions, err = asked(*command)
        assert code == 3 and "is it in km?" in err
        (question,) = questions
        assert question["option"] == "--height-unit km, or m if it is m" and question["likely_unit"] == "km"
    assert asked(*loads, "--height-unit", "km")[1] == [] == asked(*loads, "--as-written")[1]
