"""One reader of wheel states: identify, update and forces refuse the same tables."""

import warnings
from collections.abc import Callable

import numpy as np
import pytest

from lunarsci.errors import DataError, LunarSciWarning
from lunarsci.io.inputs import InputFile
from lunarsci.regolith.states import COLUMNS, MeasurementErrors, read_state_table, read_states
from lunarsci.twin.assimilation.residuals import read_record
from lunarsci.twin.rover import Rover
from lunarsci.twin.simulation.prescribed_motion import read_pose_states

HEAD = "time_s,wheel,sinkage_m,slip_ratio,normal_force_n,drawbar_pull_n"
ROWS = ("10,FL,0.010,0.05,38,2", "10,FR,0.011,0.04,36,2", "20,FL,0.012,0.05,37,2")
BAD = {
    "misspelt": (HEAD.replace("slip_ratio", "slip_ration"), ROWS, "'slip_ration' is unknown; if it is 'slip_ratio'"),
    "misspelt error": (HEAD.replace("slip_ratio", "sinkage_m_sgima"), ROWS, "if it is 'sinkage_m_sigma'"),
    "upwards": (HEAD, [row.replace(",0.01", ",-0.01") for row in ROWS], "sinkage_m"),
    "contradiction": (HEAD, (*ROWS, "20,FL,0.013,0.05,37,2"), "time_s 20, wheel FL contradict each other"),
    "text": (HEAD, (*ROWS, "30,FL,deep,0.05,37,2"), "row 4, sinkage_m: 'deep' is no number"),
    "error below 0": (HEAD + ",slip_ratio_sigma", [row + ",-0.1" for row in ROWS], "row 1, slip_ratio_sigma: give 0"),
    "valid": (HEAD + ",valid", [row + ",perhaps" for row in ROWS], "neither true nor false"),
}


@pytest.fixture
def readers(yutu2: Rover) -> list[Callable[[InputFile], object]]:
    return [
        lambda file: read_states(file, yutu2.wheel),
        lambda file: read_record(file, yutu2),
        lambda file: read_pose_states(file, yutu2),
    ]


def table(head: str, rows: object) -> InputFile:
    return InputFile("states.csv", "\n".join([head, *rows, ""]).encode())  # type: ignore[misc]


@pytest.mark.parametrize("case", BAD)
def test_bad_tables_are_refused_alike(readers: list[Callable[[InputFile], object]], case: str) -> None:
    head, rows, says = BAD[case]
    for read in readers:
        with pytest.raises(DataError, match=f"^states.csv.*({says})"):
            read(table(head, rows))


def test_other_names_and_units_are_read_alike(readers: list[Callable[[InputFile], object]]) -> None:
    named = HEAD.replace("sinkage_m", "sinkage_mm").replace("slip_ratio", "Slip_ratio")
    file = table(named, [row.replace(",0.0", ",", 1) for row in ROWS])
    assert readers[0](file).values[:, 0] == pytest.approx([0.010, 0.011, 0.012])  # type: ignore[attr-defined]
    for read in readers[1:]:
        with pytest.warns(LunarSciWarning, match="read as: column 'sinkage_mm' as sinkage_m, from mm"):
            read(file)


@pytest.mark.parametrize(("old", "new", "column"), [(",0.01", ",9.81", "sinkage_m"), (",0.0", ",55.0", "slip_ratio")])
def test_numbers_in_another_unit_than_their_name_are_asked_about_or_refused(
    readers: list[Callable[[InputFile], object]], old: str, new: str, column: str
) -> None:
    """`read_states`, whose result can ask, reads them; no drive is learned from."""
    rows = [row.replace(old, new, 1) if column == "sinkage_m" else new.join(row.rsplit(old, 1)) for row in ROWS]
    (question,) = readers[0](table(HEAD, rows)).questions  # type: ignore[attr-defined]
    assert column in question.quantity
    for read in readers[1:]:
        with pytest.raises(DataError, match=column):
            read(table(HEAD, rows))


def test_rows_that_are_there_twice_count_once(readers: list[Callable[[InputFile], object]]) -> None:
    for read in readers:
        with pytest.warns(LunarSciWarning, match="1 of 4 rows are there twice"):
            read(table(HEAD, (*ROWS, ROWS[0])))


def test_tables_of_another_rover_are_refused_and_another_name_is_said(
    readers: list[Callable[[InputFile], object]], yutu2: Rover
) -> None:
    def named(rover: str) -> InputFile:
        return table(f"{HEAD},rover", [f"{row},{rover}" for row in ROWS])

    for read in readers:
        with pytest.raises(DataError, match="'Six; wheels 120 x 150 mm', and is read for wheels 150 x 150 mm"):
            read(named("Six; wheels 120 x 150 mm"))
        with warnings.catch_warnings():
            warnings.simplefilter("error", LunarSciWarning)
            read(named(yutu2.written))
    for read in readers[1:]:
        with pytest.warns(LunarSciWarning, match="was written for 'Six', and is read for yutu2"):
            read(named("Six; wheels 150 x 150 mm"))


def test_good_tables_are_read_alike(yutu2: Rover) -> None:
    """Errors of the file go before those of `MeasurementErrors`: a slip's is that of the way, times 1 - |s|."""
    file = table(HEAD + ",sinkage_m_sigma,remark", (ROWS[0] + ",0.001,a", ROWS[1] + ",,b"))
    with warnings.catch_warnings():
        warnings.simplefilter("error", LunarSciWarning)
        record, poses = read_record(file, yutu2), read_pose_states(file, yutu2)
    with pytest.warns(LunarSciWarning, match="not used: remark"):
        states = read_states(file, yutu2.wheel)
    expected = [0.001, 0.95 * MeasurementErrors().travel_relative]
    for values, sigmas in (
        (record.values, record.sigmas),
        (poses.values, poses.sigmas),
        (states.values, states.sigmas),
    ):
        assert values[0, :2].tolist() == [0.010, 0.05]
        assert sigmas[0, :2] == pytest.approx(expected)
        assert sigmas[1, 0] == MeasurementErrors().sinkage_m
    assert poses.table["remark"].tolist() == ["a", "b"]


def test_members_of_an_ensemble_are_several_states_but_not_one_drive(yutu2: Rover) -> None:
    file = table("member," + HEAD, [f"{k},{row}" for k in (0, 1) for row in ROWS])
    assert len(read_states(file, yutu2.wheel)) == 6
    for read in (read_record, read_pose_states):
        with pytest.raises(DataError, match="2 drives"):
            read(file, yutu2)


def test_what_is_missing_is_blank(yutu2: Rover) -> None:
    found = read_state_table(table("sinkage_m", ["0.01", "nan"]), yutu2.wheel)
    assert found.values.shape == (2, len(COLUMNS)) and np.isfinite(found.values).sum() == 1
    assert found.valid.all() and found.unused == ()
