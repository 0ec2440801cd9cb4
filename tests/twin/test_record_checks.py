"""Telemetry that cannot be one drive, or not this one, is refused or said before it teaches anything."""

import dataclasses
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from lunarsci.errors import DataError, LunarSciWarning, ParameterError
from lunarsci.io.inputs import read_input
from lunarsci.regolith.belief import first_belief
from lunarsci.twin.assimilation.residuals import DriveRecord, read_record
from lunarsci.twin.assimilation.update import assimilate
from lunarsci.twin.ground.terrain import Terrain
from lunarsci.twin.plans.plan import Leg, Plan
from lunarsci.twin.rover import Rover

HEAD = "time_s,wheel,sinkage_m,slip_ratio\n"
ROWS = "10,FL,0.010,0.05\n10,FR,0.011,0.04\n20,FL,0.010,0.05\n"
PLAN = Plan(name="straight", legs=(Leg(2.0),), speed_m_s=0.05)


@pytest.fixture
def read(tmp_path: Path, yutu2: Rover) -> Callable[..., DriveRecord]:
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
        (HEAD + ROWS.replace("0.01", "-0.01"), "down is positive"),
        (HEAD + ROWS.replace("0.01", "10.1"), "it is in metres"),
        (HEAD + ROWS + "20,FL,0.030,0.05\n", "time_s 20, wheel FL contradict each other"),
        ("member," + HEAD + "".join(f"{k},{row}\n" for k, row in enumerate(ROWS.split())), "3 drives"),
    ],
)
def test_tables_that_are_not_one_drive_are_refused(read: Callable[..., DriveRecord], text: str, says: str) -> None:
    with pytest.raises(DataError, match=says):
        read(text)


@pytest.mark.parametrize(("name", "size"), [("sinkage_mm", 1e-3), ("Sinkage_m", 1.0)])
def test_a_sinkage_by_another_name_is_read_and_said(read: Callable[..., DriveRecord], name: str, size: float) -> None:
    with pytest.warns(LunarSciWarning, match=f"read as: column '{name}' as sinkage_m"):
        found = read(HEAD.replace("sinkage_m", name) + ROWS)
    assert found.values[:, 0] == pytest.approx(size * read(HEAD + ROWS).values[:, 0])


def test_rows_that_are_there_twice_count_once(read: Callable[..., DriveRecord]) -> None:
    with pytest.warns(LunarSciWarning, match="3 of 6 rows are there twice"):
        assert len(read(HEAD + ROWS + ROWS).time_s) == 3
    places = "time_s,x_m,y_m,sigma_m\n10,0.5,0.0,0.01\n"
    with pytest.warns(LunarSciWarning, match=r"positions\.csv: 1 of 2 rows"):
        assert len(read(HEAD + ROWS, places + places.splitlines()[1] + "\n").fix_m) == 1
    with pytest.raises(DataError, match=r"positions\.csv: two rows of time_s 10 contradict"):
        read(HEAD + ROWS, places + "10,0.9,0.0,0.01\n")


@pytest.fixture(scope="module")
def flat(slope) -> Terrain:  # type: ignore[no-untyped-def]
    return slope(0.0, 0.0)  # type: ignore[no-any-return]


def straight(x_m: np.ndarray, y_m: np.ndarray, time_s: np.ndarray) -> DriveRecord:
    """Positions alone, known to 1 cm."""
    return DriveRecord(
        time_s=np.zeros(0), wheel=(), values=np.zeros((0, 6)), sigmas=np.zeros((0, 6)), fix_time_s=time_s,
        fix_m=np.column_stack([x_m, y_m]), fix_covariance_m2=np.tile(1e-4 * np.eye(2), (len(time_s), 1, 1)),
    )  # fmt: skip


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
