"""Wheel tests as laboratories write them, each after a public description that its kind names.

The truth is SYNTHETIC: ten states of the closed form, under other names, in other units and definitions.
"""

import json
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from lunarsci.cli import main

from lunarsci.guide.info import info
from lunarsci.io.inputs import read_input
from lunarsci.regolith.forces import closed_form_forces
from lunarsci.regolith.soil import read_soil
from lunarsci.regolith.states import read_states
from lunarsci.regolith.wheel import read_wheel

WHEEL = read_wheel("yutu2")
SLIP, SINKAGE = (axis.ravel() for axis in np.meshgrid([0.1, 0.2, 0.3, 0.4, 0.45], [0.008, 0.012]))
FORCES = closed_form_forces(WHEEL, read_soil("lunar-typical"), SINKAGE, SLIP, np.zeros(10))
LOAD, PULL, TORQUE = FORCES.normal_force_n, FORCES.drawbar_pull_n, FORCES.resistance_torque_nm
TRUE = {
    "sinkage_m": SINKAGE,
    "slip_ratio": SLIP,
    "normal_force_n": LOAD,
    "drawbar_pull_n": PULL,
    "resistance_torque_nm": TORQUE,
}


def csv(columns: dict[str, object], units: str = "", *, separator: str = ",", decimal: str = ".") -> bytes:
    text = pd.DataFrame(columns).to_csv(index=False, sep=separator, decimal=decimal, float_format="%.10g")
    names, _, body = text.partition("\n")
    return f"{names}\n{units}\n{body}".encode() if units else text.encode()


def columns(**others: tuple[str, object]) -> dict[str, object]:
    """The true columns, some under another name and in other numbers; None leaves one out."""
    found: dict[str, object] = {}
    for name, values in TRUE.items():
        key, own = others.get(name, (name, values))
        found[key] = own
    return found


BY_TRAVEL = SLIP / (1 - SLIP)
RUNS = ["A", "A", "B", "B", "C", "C", "D", "D", "E", "E"]
KINDS: dict[str, tuple[str, bytes]] = {
    "kilograms of force and centimetres": (
        "Wong 2008, ISBN 978-0-470-17038-0, single-wheel test rigs",
        csv(columns(normal_force_n=("Load (kgf)", LOAD / 9.80665), drawbar_pull_n=("DP (kgf)", PULL / 9.80665),
                    sinkage_m=("Sinkage (cm)", 100 * SINKAGE), slip_ratio=("Slip (%)", 100 * SLIP))),
    ),
    "pounds and inches": (
        "Freitag 1965, WES Technical Report 3-688, pull and sinkage of wheels in sand",
        csv(columns(normal_force_n=("Wheel load, lbf", LOAD / 4.4482216152605),
                    drawbar_pull_n=("Pull, lbf", PULL / 4.4482216152605), sinkage_m=("Sinkage, in", SINKAGE / 0.0254))),
    ),
    "kilonewtons": (
        "SI units in names",
        csv(columns(normal_force_n=("Fz_kN", LOAD / 1e3), drawbar_pull_n=("Fx_kN", PULL / 1e3))),
    ),
    "net traction ratio": (
        "ANSI/ASAE S296.5, General terminology for traction",
        csv(columns(drawbar_pull_n=("Net traction ratio", PULL / LOAD),
                    slip_ratio=("Travel reduction [%]", 100 * SLIP), normal_force_n=("Dynamic load [N]", LOAD))),
    ),
    "travel reduction ratio": (
        "ANSI/ASAE S296.5", csv(columns(slip_ratio=("travel_reduction_ratio", SLIP)))),
    "torque in N mm": (
        "Ding et al. 2011, 10.1016/j.jterra.2010.08.001, wheel tests",
        csv(columns(resistance_torque_nm=("Torque [N mm]", 1e3 * TORQUE))),
    ),
    "torque in N·m": ("SI brochure, products of units", csv(columns(resistance_torque_nm=("T (N·m)", TORQUE)))),
    "torque in N cm, named": ("SI brochure", csv(columns(resistance_torque_nm=("wheel_torque_Ncm", 1e2 * TORQUE)))),
    "units in the second row": (
        "Excel tables with a row of units",
        csv({"Sinkage": 1e3 * SINKAGE, "Slip": 100 * SLIP, "Normal load": LOAD, "Drawbar pull": PULL,
             "Torque": TORQUE}, "mm,%,N,N,Nm"),
    ),
    "decimal comma": (
        "locale de_DE, CSV of Excel",
        csv(columns(normal_force_n=("Fz [N]", LOAD), drawbar_pull_n=("Fx [N]", PULL)), separator=";", decimal=","),
    ),
    "sheets put together": (
        "several sheets of one test, with the name of each",
        csv({"Test": RUNS, "Run no": np.arange(1, 11), **columns(sinkage_m=("Sinkage [mm]", 1e3 * SINKAGE))}),
    ),
    "symbols": (
        "Ishigami et al. 2007, 10.1002/rob.20180, symbols of wheel forces",
        csv(columns(sinkage_m=("h [mm]", 1e3 * SINKAGE), slip_ratio=("s [-]", SLIP),
                    normal_force_n=("F_z [N]", LOAD), drawbar_pull_n=("F_x [N]", PULL),
                    resistance_torque_nm=("T [Nm]", TORQUE))),
    ),
    "slip over the way": (
        "SAE J670, slip ratio of tyres",
        csv(columns(slip_ratio=("slip_travel [%]", 100 * BY_TRAVEL)))),
    "velocities": (
        "Senatore & Iagnemma 2014, 10.1016/j.jterra.2014.01.001, rigs that set both speeds",
        csv(columns(slip_ratio=("slip_rim", SLIP))),
    ),
    "symbols beside names": (
        "tables of journals: name, symbol, unit",
        csv({"Sinkage z [mm]": 1e3 * SINKAGE, "Slip ratio s [%]": 100 * SLIP, "Normal load W [N]": LOAD,
             "Drawbar pull DP [N]": PULL}),
    ),
    "capitals": (
        "load cells, KN",
        csv(columns(normal_force_n=("LOAD (KN)", LOAD / 1e3), drawbar_pull_n=("DBP (KN)", PULL / 1e3)))),
    "unit in words": ("snake case with in", csv(columns(sinkage_m=("sinkage_in_mm", 1e3 * SINKAGE)))),
    "net traction in per cent": (
        "ANSI/ASAE S296.5", csv(columns(drawbar_pull_n=("Net traction ratio [%]", 100 * PULL / LOAD)))),
}  # fmt: skip


def check(values: np.ndarray) -> None:
    for place, name in ((0, "sinkage_m"), (1, "slip_ratio"), (3, "normal_force_n"), (4, "drawbar_pull_n")):
        np.testing.assert_allclose(values[:, place], TRUE[name], rtol=1e-6)


@pytest.mark.filterwarnings("ignore::lunarsci.errors.LunarSciWarning")
def test_slips_over_the_way_are_asked_about_where_they_were_set_to_round_numbers(
    tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    """A column of the name `slip_ratio` with r w / v - 1 of SAE J670: 0.1 is 0.1111 there."""
    path = tmp_path / "test.csv"
    path.write_bytes(csv(columns(slip_ratio=("slip_ratio", np.round(BY_TRAVEL, 4)))))
    found = read_states(read_input(path), WHEEL)
    np.testing.assert_allclose(found.values[:, 1], SLIP, atol=1e-4)
    [question] = found.questions
    assert question.likely_unit == "r w / v - 1"
    assert main(["regolith", "identify", str(path), "--rover", "yutu2", "--json"]) == 3
    capfd.readouterr()
    answer = question.option.removeprefix("--units ")
    assert not read_states(read_input(path), WHEEL, units=answer).questions
    kept = read_states(read_input(path), WHEEL, units="slip_ratio=rim")
    np.testing.assert_allclose(kept.values[:, 1], BY_TRAVEL, atol=1e-4)
    assert not kept.questions


def test_a_column_named_std_has_errors(tmp_path: Path) -> None:
    path = tmp_path / "test.csv"
    path.write_bytes(csv(columns(drawbar_pull_n=("DP [N]", PULL)) | {"DP std [N]": 0 * PULL + 0.25}))
    found = read_states(read_input(path), WHEEL)
    assert found.sigmas[:, 4] == pytest.approx(0.25) and found.stated


@pytest.mark.filterwarnings("ignore::lunarsci.errors.LunarSciWarning")
@pytest.mark.parametrize("kind", KINDS)
def test_the_states_are_read(kind: str, tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    path, plain = tmp_path / "test.csv", tmp_path / "plain.csv"
    path.write_bytes(KINDS[kind][1])
    plain.write_bytes(csv(TRUE))
    found = read_states(read_input(path), WHEEL)
    check(found.values)
    assert not found.questions
    assert (info(path).kind, info(path).trouble) == ("states", "")
    truth, *read = (_stresses(file, capfd) for file in (plain, path))
    assert read == [pytest.approx(truth, rel=1e-6)]


def _stresses(file: Path, capfd: pytest.CaptureFixture[str]) -> list[float]:
    """Normal stresses of the states, which follow from sinkage and load, as the command finds them. [Pa]"""
    capfd.readouterr()
    assert main(["regolith", "identify", str(file), "--rover", "yutu2", "--draws", "64", "--json"]) in (0, 3)
    found = json.loads(capfd.readouterr().out)["result"]["observations"]
    return [one["sigma_m_pa"]["value"] for one in found]
