"""Records of drives from tables.

Telemetry that cannot be one drive, or not this one, is refused or said before it teaches anything.

One reader of wheel states: identify, update and forces refuse the same tables.
"""

import dataclasses
import warnings
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from lunarsci.errors import DataError, LunarSciWarning, ParameterError
from lunarsci.io.inputs import InputFile, read_input
from lunarsci.regolith.belief import first_belief
from lunarsci.regolith.states import COLUMNS, MeasurementErrors, read_state_table, read_states
from lunarsci.twin.assimilation.residuals import DriveRecord, read_record
from lunarsci.twin.assimilation.update import assimilate
from lunarsci.twin.ground.terrain import Terrain
from lunarsci.twin.plans.plan import Leg, Plan
from lunarsci.twin.rover import Rover
from lunarsci.twin.simulation.prescribed_motion import read_pose_states

STATES = "time_s,wheel,sinkage_m,sinkage_m_sigma,slip_ratio,valid\n2,FL,0.009,0.001,0.05,true\n3,FR,0.008,,,true\n"


def read(tmp_path: Path, rover: Rover, states: str, positions: str = "") -> DriveRecord:
    files = []
    for name, text in (("states.csv", states), ("positions.csv", positions)):
        (tmp_path / name).write_text(text)
        files.append(read_input(str(tmp_path / name)) if text else None)
    assert files[0] is not None
    return read_record(files[0], rover, positions=files[1])


def test_states_keep_their_errors_and_get_the_stated_ones(tmp_path: Path, yutu2: Rover) -> None:
    """Ding et al. (2024): 1 mm of sinkage and 4 % of the way as three standard deviations."""
    record = read(tmp_path, yutu2, STATES)
    assert record.wheel == ("FL", "FR") and record.time_s.tolist() == [2.0, 3.0]
    assert record.values[:, 0].tolist() == [0.009, 0.008]
    assert record.sigmas[:, 0] == pytest.approx([0.001, 0.001 / 3], rel=0.02)
    assert record.sigmas[0, 1] == pytest.approx(0.95 * 0.04 / 3)
    assert np.isnan(record.values[1, 1]) and np.isnan(record.values[:, 2:]).all()
    assert len(record.fix_m) == 0


def test_states_that_are_not_valid_are_left_out(tmp_path: Path, yutu2: Rover) -> None:
    with pytest.warns(LunarSciWarning, match="1 of 3 states left out"):
        record = read(tmp_path, yutu2, STATES + "4,FL,0.2,,,false\n")
    assert record.time_s.tolist() == [2.0, 3.0]


def test_positions_have_circles_or_ellipses_of_error(tmp_path: Path, yutu2: Rover) -> None:
    circle = read(tmp_path, yutu2, STATES, "time_s,x_m,y_m,sigma_m\n5,1,2,0.1\n")
    assert circle.fix_m.tolist() == [[1.0, 2.0]] and circle.fix_time_s.tolist() == [5.0]
    assert circle.fix_covariance_m2 == pytest.approx(np.array([[[0.01, 0.0], [0.0, 0.01]]]))
    ellipse = read(tmp_path, yutu2, STATES, "time_s,x_m,y_m,xx_m2,xy_m2,yy_m2\n5,1,2,0.04,0.01,0.09\n")
    covariance = np.array([[0.04, 0.01], [0.01, 0.09]])
    assert ellipse.fix_covariance_m2[0] == pytest.approx(covariance)
    assert ellipse.fix_joint_m2 == pytest.approx(covariance)


def test_positions_may_share_errors_with_the_one_before(tmp_path: Path, yutu2: Rover) -> None:
    """Errors that follow each other as e = 0.8 e + noise in x, and are the same in y: covariances fall as powers."""
    head = "time_s,x_m,y_m,xx_m2,xy_m2,yy_m2,xx_before_m2,xy_before_m2,yx_before_m2,yy_before_m2\n"
    rows = [",-1,0,1e-6,0,1e-6,0,0,0,0", "5,1,0,0.01,0,0.04,0,0,0,0"]
    rows += ["10,2,0,0.01,0,0.042,0.008,0,0,0.04", "15,3,0,0.01,0,0.043,0.008,0,0,0.042"]
    record = read(tmp_path, yutu2, STATES, head + "\n".join(rows) + "\n")
    assert record.fix_time_s.tolist() == [5.0, 10.0, 15.0]
    joint = record.fix_joint_m2
    assert joint[::2, ::2] == pytest.approx(0.01 * 0.8 ** np.abs(np.subtract.outer(range(3), range(3))))
    assert joint[1::2, 1::2] == pytest.approx(np.minimum.outer(*2 * [np.array([0.04, 0.042, 0.043])]))
    assert not joint[::2, 1::2].any()
    wrong = head + "5,1,0,0.01,0,0.04,0,0,0,0\n10,2,0,0.01,0,0.042,0.02,0,0,0.04\n"
    with pytest.raises(DataError, match="are no covariance of all positions"):
        read(tmp_path, yutu2, STATES, wrong)
    nothing = head + "5,1,0,0,0,0,0,0,0,0\n10,2,0,0.01,0,0.042,0.02,0,0,0.04\n"
    with pytest.raises(DataError, match="are no covariance of all positions"):
        read(tmp_path, yutu2, STATES, nothing)
    with pytest.raises(DataError, match="no column xy_before_m2"):
        read(tmp_path, yutu2, STATES, "time_s,x_m,y_m,xx_m2,xy_m2,yy_m2,xx_before_m2\n5,1,2,1,0,1,0\n")
    with pytest.raises(DataError, match="no position has a time"):
        read(tmp_path, yutu2, STATES, "time_s,x_m,y_m,sigma_m\n,1,2,0.1\n")


HEADER = "time_s,wheel,sinkage_m,slip_ratio\n"
TIMED_ROWS = "10,FL,0.010,0.05\n10,FR,0.011,0.04\n20,FL,0.010,0.05\n"
PLAN = Plan(name="straight", legs=(Leg(2.0),), speed_m_s=0.05)


@pytest.fixture
def read_rows(tmp_path: Path, yutu2: Rover) -> Callable[..., DriveRecord]:
    def record(text: str, positions: str | None = None) -> DriveRecord:
        paths = [tmp_path / "states.csv", tmp_path / "positions.csv"]
        for path, content in zip(paths, (text, positions or ""), strict=True):
            path.write_text(content)
        places = read_input(str(paths[1])) if positions else None
        return read_record(read_input(str(paths[0])), yutu2, positions=places)

    return record


@pytest.mark.parametrize(
    ("text", "says"),
    [
        (HEADER + TIMED_ROWS.replace("0.01", "-0.01"), "down is positive"),
        (HEADER + TIMED_ROWS.replace("0.01", "10.1"), "it is in metres"),
        (HEADER + TIMED_ROWS + "20,FL,0.030,0.05\n", "time_s 20, wheel FL contradict each other"),
        ("member," + HEADER + "".join(f"{k},{row}\n" for k, row in enumerate(TIMED_ROWS.split())), "3 drives"),
    ],
)
def test_tables_that_are_not_one_drive_are_refused(read_rows: Callable[..., DriveRecord], text: str, says: str) -> None:
    with pytest.raises(DataError, match=says):
        read_rows(text)


@pytest.mark.parametrize(("name", "size"), [("sinkage_mm", 1e-3), ("Sinkage_m", 1.0)])
def test_a_sinkage_by_another_name_is_read_and_said(
    read_rows: Callable[..., DriveRecord], name: str, size: float
) -> None:
    with pytest.warns(LunarSciWarning, match=f"read as: column '{name}' as sinkage_m"):
        found = read_rows(HEADER.replace("sinkage_m", name) + TIMED_ROWS)
    assert found.values[:, 0] == pytest.approx(size * read_rows(HEADER + TIMED_ROWS).values[:, 0])


def test_states_that_are_there_twice_count_once(read_rows: Callable[..., DriveRecord]) -> None:
    with pytest.warns(LunarSciWarning, match="3 of 6 rows are there twice"):
        assert len(read_rows(HEADER + TIMED_ROWS + TIMED_ROWS).time_s) == 3
    places = "time_s,x_m,y_m,sigma_m\n10,0.5,0.0,0.01\n"
    with pytest.warns(LunarSciWarning, match=r"positions\.csv: 1 of 2 rows"):
        assert len(read_rows(HEADER + TIMED_ROWS, places + places.splitlines()[1] + "\n").fix_m) == 1
    with pytest.raises(DataError, match=r"positions\.csv: two rows of time_s 10 contradict"):
        read_rows(HEADER + TIMED_ROWS, places + "10,0.9,0.0,0.01\n")


@pytest.fixture(scope="module")
def flat(slope) -> Terrain:  # type: ignore[no-untyped-def]
    return slope(0.0, 0.0)  # type: ignore[no-any-return]


def straight(x_m: np.ndarray, y_m: np.ndarray, time_s: np.ndarray) -> DriveRecord:
    """Positions alone, known to 1 cm."""
    return DriveRecord(
        time_s=np.zeros(0), wheel=(), values=np.zeros((0, 6)), sigmas=np.zeros((0, 6)), fix_time_s=time_s,
        fix_m=np.column_stack([x_m, y_m]), fix_covariance_m2=np.tile(1e-4 * np.eye(2), (len(time_s), 1, 1)),
    )  # fmt: skip


@pytest.mark.slow
def test_positions_that_no_soil_explains_teach_nothing(yutu2: Rover, flat: Terrain) -> None:
    """A flat ground, a straight plan, and a frame that is turned by 90 degrees, or a clock in milliseconds."""
    time = np.linspace(8.0, 40.0, 5)
    right = straight(0.049 * time, np.zeros(5), time)
    learned = assimilate(yutu2, flat, PLAN, right, first_belief(), particles=32)
    assert not learned.refused and learned.inflation == {}
    turned = dataclasses.replace(right, fix_m=right.fix_m[:, ::-1])
    refused = assimilate(yutu2, flat, PLAN, turned, first_belief(), particles=32)
    assert "misses position" in refused.refused
    assert np.array_equal(refused.belief.mean, first_belief().mean)
    late = dataclasses.replace(right, fix_time_s=1e3 * right.fix_time_s)
    with pytest.raises(ParameterError, match="5 of 5 positions are later than the end of the drive at 40 s"):
        assimilate(yutu2, flat, PLAN, late, first_belief())


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
