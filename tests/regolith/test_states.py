"""Files of wheel states of all kinds."""

import warnings
from pathlib import Path

import numpy as np
import pytest

from lunarsci.errors import DataError, LunarSciWarning
from lunarsci.io.inputs import InputFile
from lunarsci.regolith.states import MeasurementErrors, WheelStates, read_states
from lunarsci.regolith.wheel import read_wheel


def test_the_slip_error_is_that_of_the_travelled_distance() -> None:
    """4 % / 3 of the distance is 0.0133 of slip at s = 0 and nothing at s = -1 or 1."""
    errors = MeasurementErrors().of("slip_ratio", np.array([0.0, -0.075, 0.5]))
    assert errors == pytest.approx([0.04 / 3, 0.04 / 3 * 0.925, 0.04 / 3 * 0.5])


WHEEL = read_wheel("yutu2")
HEAD = "sinkage_m,slip_ratio,normal_force_n,drawbar_pull_n"


def read(text: str) -> WheelStates:
    return read_states(InputFile("states.csv", text.encode()), WHEEL)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("", "blank"),
        (HEAD + "\n", "no row has all"),
        ("sinkage_m,slip_ratio,normal_forse_n,drawbar_pull_n\n.008,0,32,-1\n", "is it 'normal_forse_n'"),
        ("a,b\n1,2\n", "there are: a, b"),
        (HEAD + "\n.008,0,-5,-1\n", "row 1, normal_force_n: -5 is impossible"),
        (HEAD + "\n.008,0,0,-1\n", "normal_force_n"),
        (HEAD + "\n.2,0,32,-1\n", "sinkage_m: 0.2 is impossible"),
        (HEAD + "\n800,0,32,-1\n", "sinkage_m: 800 is impossible"),
        (HEAD.replace("slip_ratio", "side_slip_deg") + "\n.008,95,32,-1\n", "side_slip_deg"),
        (HEAD + "\n.008,0,32,-1\n.008,x,32,-1\n", "row 2, slip_ratio: 'x' is no number"),
        (HEAD + "\nnan,nan,nan,nan\n", "no row has all"),
        (HEAD + ",lateral_forc_n\n.008,0,32,-1,1\n", "if it is 'lateral_force_n'"),
        (HEAD + ",sinkage_m_sigma\n.008,0,32,-1,-0.1\n", "give 0 or more"),
        (HEAD + "\n.008,0,32\n.008,0,32,-1,5,6\n", "line 2: 3 fields, the header has 4"),
        (HEAD + "\n.008,0,32,-1,\n", "line 2: 5 fields"),
        (HEAD + "\n1e-17,0,32,-1\n", "sinkage_m: 1e-17 is impossible"),
        (HEAD + ",sinkage_m_sigma\n.008,0,32,-1,inf\n", "give 0 or more"),
        (HEAD + ",valid\n.008,0,32,-1,perhaps\n", "neither true nor false"),
    ],
)
def test_bad_state_files_say_what_is_wrong(text: str, message: str) -> None:
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", LunarSciWarning)
        with pytest.raises(DataError, match=message) as caught:
            read(text)
    assert "\n" not in str(caught.value)


def test_a_few_rows_that_no_wheel_can_have_are_left_out_and_said() -> None:
    """A wheel that sank to its axle among two that did not; where it is most of the rows, the column is wrong."""
    rows = [".008,0,32,-1", ".009,0.1,32,3", ".2,0.9,32,-1"]
    with pytest.warns(LunarSciWarning, match=r"1 of 3 rows left out, the first: states.csv, row 3, sinkage_m: 0.2"):
        assert read("\n".join([HEAD, *rows])).id == ("1", "2")
    with pytest.raises(DataError, match=r"row 3, sinkage_m: 0.2 is impossible; .* in another unit"):
        read("\n".join([HEAD, rows[0], rows[1], *rows[2:] * 3]))


def test_rows_without_a_required_value_are_left_out_and_said() -> None:
    with pytest.warns(LunarSciWarning, match="1 of 2 rows left out"):
        states = read(HEAD + "\n.008,0,32,-1\n.008,0,,-1\n")
    assert len(states) == 1


@pytest.mark.parametrize("word", ["False", " false", "0", "0.0", "no"])
def test_rows_marked_not_valid_are_left_out(word: str) -> None:
    with pytest.warns(LunarSciWarning, match="1 of 2 rows left out"):
        states = read(f"{HEAD},valid\n.008,0,32,-1,True\n.008,0,320,-1,{word}\n")
    assert states.values[:, 3].tolist() == [32]


def test_columns_of_no_use_are_said() -> None:
    with pytest.warns(LunarSciWarning, match="not used: colour"):
        read(HEAD + ",colour\n.008,0,32,-1,red\n")


def test_fast_slip_is_said() -> None:
    with pytest.warns(LunarSciWarning, match="no longer accurate"):
        read(HEAD + "\n.008,0.7,32,-1\n")


def test_given_errors_go_before_the_defaults() -> None:
    states = read(HEAD + ",sinkage_m_sigma\n.008,0.1,32,-1,0.001\n.009,0.1,32,-1,\n")
    assert states.sigmas[:, 0].tolist() == [0.001, 0.00033]
    assert states.sigmas[0, 3] == pytest.approx(32 * 0.1 / 3)


def test_read_states_from_a_windows_file(tmp_path: Path) -> None:
    states = read("\ufeff" + HEAD.replace(",", " , ") + "\r\n.008, 0 ,32,-1\r\n")
    assert states.values[0, 3] == 32


def test_errors_are_alike_only_where_all_forces_were_computed_of_a_motion() -> None:
    head = "sinkage_m,normal_force_n,drawbar_pull_n,drawbar_pull_n_sigma,forces_from\n"
    rows = ["0.01,38,2,0.1,motion\n", "0.02,38,2,0.1,motion\n", "0.03,38,2,0.1,\n"]
    wheel = read_wheel("yutu2")
    found = [read_states(InputFile("a.csv", (head + "".join(some)).encode()), wheel) for some in (rows[:2], rows)]
    assert [states.alike for states in found] == [True, False]
    assert all(states.stated for states in found)
