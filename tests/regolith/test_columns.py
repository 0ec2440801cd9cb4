"""Wheel tests as laboratories write them: units, pulls over the load, the two slips, and a zero that is off.

The truth is SYNTHETIC: one table of the closed form, in other units and definitions. Slips are those of Wong (2008),
Theory of Ground Vehicles, ISBN 978-0-470-17038-0, and of SAE J670; newtons of a pound and of a kilogram of force those
of NIST Special Publication 811.
"""

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from lunarsci.cli import main

from lunarsci.errors import DataError, LunarSciWarning, RequestError
from lunarsci.guide.info import info
from lunarsci.io.inputs import InputFile
from lunarsci.regolith.forces import closed_form_forces
from lunarsci.regolith.inference.posterior import infer_soil
from lunarsci.regolith.soil import read_soil
from lunarsci.regolith.states import WheelStates, read_state_table, read_states
from lunarsci.regolith.wheel import read_wheel

WHEEL = read_wheel("yutu2")
POUND, KILOGRAM = 4.4482216152605, 9.80665


def table() -> pd.DataFrame:
    slip, sinkage = (axis.ravel() for axis in np.meshgrid([0.1, 0.2, 0.3, 0.45, 0.6], [0.008, 0.012]))
    found = closed_form_forces(WHEEL, read_soil("lunar-typical"), sinkage, slip, np.zeros(10))
    return pd.DataFrame({
        "sinkage_m": sinkage, "slip_ratio": slip, "normal_force_n": found.normal_force_n,
        "drawbar_pull_n": found.drawbar_pull_n,
    })  # fmt: skip


TRUE = table()


def states(found: pd.DataFrame, units: str = "") -> WheelStates:
    return read_states(InputFile("test.csv", found.to_csv(index=False).encode()), WHEEL, units=units)


def written(**columns: object) -> pd.DataFrame:
    """The table with columns under other names, by `OLD=(NEW, FACTOR)`."""
    found = TRUE.copy()
    for name, (other, factor) in columns.items():
        found[name] *= factor
        found = found.rename(columns={name: other})
    return found


def check(found: WheelStates) -> None:
    assert found.values[:, [0, 1, 3, 4]] == pytest.approx(TRUE.to_numpy(), rel=1e-9)


@pytest.mark.parametrize(
    ("load", "pull", "size"),
    [
        ("load_kN", "drawbar_pull_kN", 1e-3),
        ("Normal load [kgf]", "DP (kgf)", 1 / KILOGRAM),
        ("vertical_load_lbf", "pull_lbf", 1 / POUND),
        ("Fz [N]", "Fx [N]", 1.0),
        ("vertical_load_n", "meas_drawbar_pull_n", 1.0),
    ],
)
def test_named_units_are_converted_and_nothing_is_asked(load: str, pull: str, size: float) -> None:
    found = states(written(normal_force_n=(load, size), drawbar_pull_n=(pull, size), sinkage_m=("sinkage_mm", 1e3)))
    check(found)
    assert not found.questions
    assert any(f"column '{load}' as normal_force_n" in one for one in found.read_as)


@pytest.mark.parametrize("name", ["DP/W", "dp_over_w", "Drawbar pull coefficient", "pull_over_load"])
def test_a_pull_over_the_load_is_multiplied_by_it(name: str) -> None:
    other = TRUE.assign(drawbar_pull_n=TRUE["drawbar_pull_n"] / TRUE["normal_force_n"])
    found = states(other.rename(columns={"drawbar_pull_n": name, "normal_force_n": "W_N"}))
    check(found)
    assert not found.questions


def test_both_slips_and_per_cent_are_read_by_their_names() -> None:
    travel = TRUE["slip_ratio"] / (1 - TRUE["slip_ratio"])
    named = TRUE.drop(columns="slip_ratio")
    for found in (named.assign(slip_travel=travel), named.assign(**{"slip [%]": 100 * TRUE["slip_ratio"]})):
        check(states(found))
        assert not states(found).questions
    skid = TRUE.assign(slip_ratio=-1.5)
    read = states(skid, "slip_ratio=rim")
    assert read.values[:, 1] == pytest.approx(-0.6)
    assert not read.questions


def test_errors_are_converted_with_their_quantity() -> None:
    other = TRUE.assign(load_kN=TRUE["normal_force_n"] / 1e3, load_kN_sigma=0.002).drop(columns="normal_force_n")
    assert states(other).sigmas[:, 3] == pytest.approx(2.0)
    assert states(TRUE.assign(normal_force_n_sigma=0.1), "normal_force_n=kgf").sigmas[:, 3] == pytest.approx(0.980665)


@pytest.mark.parametrize(
    ("column", "values", "unit"),
    [
        ("normal_force_n", TRUE["normal_force_n"] / 1e3, "kN"),
        ("drawbar_pull_n", TRUE["drawbar_pull_n"] / TRUE["normal_force_n"], "a share of the load"),
        ("slip_ratio", TRUE["slip_ratio"] / (1 - TRUE["slip_ratio"]), "r w / v - 1"),
        ("slip_ratio", 100 * TRUE["slip_ratio"], "%"),
        ("sinkage_m", 1e3 * TRUE["sinkage_m"], "mm"),
        ("normal_force_n", TRUE["normal_force_n"] / KILOGRAM, "kgf (the load)"),
    ],
)
def test_what_weight_and_balance_tell_is_asked_and_the_option_answers(
    column: str, values: pd.Series, unit: str
) -> None:
    other = TRUE.assign(**{column: values})
    if unit == "kN":
        other["drawbar_pull_n"] /= 1e3
    (question,) = states(other).questions
    assert (column in question.option, question.likely_unit) == (True, unit)
    answer = question.option.removeprefix("--units ")
    answered = states(other, answer)
    assert not answered.questions
    check(answered)


def test_a_load_without_a_unit_is_asked_and_a_sinkage_is_read() -> None:
    other = TRUE.rename(columns={"normal_force_n": "load", "sinkage_m": "sinkage"})
    other["sinkage"] *= 1e3
    found = states(other)
    check(found)
    assert [one.likely_unit for one in found.questions] == ["mm", "N"]
    assert any("sinkage_m, from mm (--units)" in one for one in found.read_as)
    check(states(other, "normal_force_n=N,sinkage_m=mm"))
    assert not states(other, "normal_force_n=N,sinkage_m=mm").questions
    assert found.questions[0].option == "--units sinkage_m=mm"


def test_answers_of_one_column_count_together_and_leave_its_unit() -> None:
    other = TRUE.assign(sinkage_mm=-1e3 * (TRUE["sinkage_m"] - 0.004)).drop(columns="sinkage_m")
    check(states(other, "sinkage_m=-1,sinkage_m=+0.004"))
    plain = other.rename(columns={"sinkage_mm": "sinkage_m"})
    check(states(plain, "sinkage_m=mm,sinkage_m=+0.004,sinkage_m=-"))
    check(states(TRUE.assign(drawbar_pull_n=-TRUE["drawbar_pull_n"] / 1e3), "drawbar_pull_n=-kN"))
    by_way = TRUE.assign(**{"slip [%]": 100 * TRUE["slip_ratio"] / (1 - TRUE["slip_ratio"])})
    check(states(by_way.drop(columns="slip_ratio"), "slip_ratio=travel"))
    with pytest.raises(DataError, match=r"is its sign turned \(--units sinkage_m=-1\)"):
        states(TRUE.assign(sinkage_m=-TRUE["sinkage_m"]))


@pytest.mark.parametrize("columns", [("normal_force_n",), ("normal_force_n", "drawbar_pull_n"), ("drawbar_pull_n",)])
def test_a_unit_is_asked_of_the_numbers_as_they_are_written(columns: tuple[str, ...]) -> None:
    """Newtons in columns of kilonewtons."""
    other = states(TRUE.rename(columns={name: name.removesuffix("_n") + "_kN" for name in columns}))
    (question,) = other.questions
    assert question.likely_unit.removesuffix(" (the load)") == "N"
    answer = question.option.removeprefix("--units ")
    check(states(TRUE.rename(columns={name: name.removesuffix("_n") + "_kN" for name in columns}), answer))


def test_a_unit_of_sinkage_is_asked_of_the_numbers_as_they_are_written() -> None:
    """Millimetres in a column of centimetres."""
    other = states(TRUE.assign(sinkage_cm=3e3 * TRUE["sinkage_m"]).drop(columns="sinkage_m"))
    assert other.questions[0].option == "--units sinkage_m=mm"
    assert other.values[:, 0] == pytest.approx(3 * TRUE["sinkage_m"])


def test_the_right_table_is_not_asked_about() -> None:
    check(states(TRUE))
    assert (states(TRUE).questions, states(TRUE).read_as) == ((), ())


def test_a_zero_that_is_off_is_refused_where_wheels_float_and_the_advice_is_read() -> None:
    with pytest.raises(DataError, match=r"is its zero off \(--units sinkage_m=\+0.003\)") as refused:
        states(TRUE.assign(sinkage_m=TRUE["sinkage_m"] - 0.010))
    answer = str(refused.value).partition("--units ")[2].partition(")")[0]
    found = states(TRUE.assign(sinkage_m=TRUE["sinkage_m"] - 0.010), answer)
    assert found.values[:, 0] == pytest.approx(TRUE["sinkage_m"] - 0.007)


def told(of: WheelStates) -> str:
    """What a verdict says, and what it assumes."""
    verdict = infer_soil(of, WHEEL).verdict
    return "; ".join([verdict.reason, *verdict.assumed])


def noisy(random: np.random.Generator) -> WheelStates:
    right = states(TRUE)
    return replace(right, values=right.values + right.sigmas * random.standard_normal(right.values.shape))


def test_no_zero_is_asked_about_on_the_right_table() -> None:
    """Over 20 draws of the errors of the paper."""
    random = np.random.default_rng(1)
    assert not [draw for draw in range(20) if "its zero" in told(noisy(random))]


@pytest.mark.parametrize("off", [-0.004, 0.010])
def test_a_zero_that_is_off_is_found_by_the_forces_and_the_option_mends_it(off: float) -> None:
    right = noisy(np.random.default_rng(1))
    reason = told(replace(right, values=right.values + off * np.eye(6)[0]))
    assert "its zero" in reason and ("lower" in reason, "higher" in reason) == (off > 0, off < 0)
    by = float(reason.partition("--units sinkage_m=")[2].partition(")")[0])
    sigma = 1e-3 * float(reason.partition(" ± ")[2].partition(" mm")[0])
    assert by == pytest.approx(-off, abs=3.0 * sigma)
    assert sigma < 0.004


def test_other_tables_say_how_they_were_read() -> None:
    file = InputFile("test.csv", written(normal_force_n=("load_kN", 1e-3)).to_csv(index=False).encode())
    with pytest.warns(LunarSciWarning, match="read as: column 'load_kN' as normal_force_n, from kN"):
        assert read_state_table(file, WHEEL).values[:, 3] == pytest.approx(TRUE["normal_force_n"])


@pytest.mark.parametrize("units", ["load=kN", "normal_force_n=stone", "slip_ratio", "sinkage_m=+x"])
def test_units_that_are_none_are_refused(units: str) -> None:
    with pytest.raises(RequestError, match="`units`"):
        states(TRUE, units)


def test_two_columns_of_one_quantity_are_refused() -> None:
    with pytest.raises(DataError, match="columns 'load_N' and 'Fz_N' are both normal_force_n"):
        states(TRUE.assign(load_N=1.0, Fz_N=2.0).drop(columns="normal_force_n"))


@pytest.mark.parametrize("command", ["infer", "identify"])
def test_commands_ask_and_take_the_answer(tmp_path: Path, capsys: pytest.CaptureFixture[str], command: str) -> None:
    other = written(normal_force_n=("normal_force_n", 1e-3), drawbar_pull_n=("drawbar_pull_n", 1e-3))
    other.to_csv(tmp_path / "kn.csv", index=False)
    run = ["regolith", command, str(tmp_path / "kn.csv"), "--rover", "yutu2", "--json", "--no-time"]
    assert main(run) == 3
    told = capsys.readouterr()
    (question,) = json.loads(told.out)["result"]["questions"]
    assert question["likely_unit"] == "kN"
    assert question["option"] in told.err
    main([*run, *question["option"].split()])
    answered = json.loads(capsys.readouterr().out)["result"]
    assert not answered["questions"]
    assert answered["read_as"]


def test_info_tells_a_wheel_test_by_other_names(tmp_path: Path) -> None:
    other = written(normal_force_n=("load_kN", 1e-3), drawbar_pull_n=("dp_kN", 1e-3), sinkage_m=("sinkage_mm", 1e3))
    other.to_csv(tmp_path / "test.csv", index=False)
    told = info(tmp_path / "test.csv")
    assert (told.kind, told.trouble, told.remarks) == ("states", "", [])
    assert "column 'load_kN' as normal_force_n, from kN" in told.contents["read as"]
    TRUE.assign(sinkage_m=1e3 * TRUE["sinkage_m"]).to_csv(tmp_path / "mm.csv", index=False)
    assert "it is in metres" in info(tmp_path / "mm.csv").trouble
