"""Records of drives from tables."""

from pathlib import Path

import numpy as np
import pytest

from lunarsci.errors import DataError, LunarSciWarning
from lunarsci.io.inputs import read_input
from lunarsci.twin.assimilation.residuals import DriveRecord, read_record
from lunarsci.twin.rover import Rover

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
