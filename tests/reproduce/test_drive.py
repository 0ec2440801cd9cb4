"""The numbers of the drive: geometry, steady rolling, and what stays open without the ground."""

import math

import numpy as np
import pytest

from lunarsci.errors import ParameterError
from lunarsci.regolith.forces import closed_form_forces
from lunarsci.regolith.soil import read_soil
from lunarsci.regolith.traction import sinkage_under_load
from lunarsci.reproduce.drive import STAND_IN, Drives, Rolling, drive_numbers, medians
from lunarsci.reproduce.numbers import Number, published_numbers
from lunarsci.twin.rover import build_rover

ARCS = ((3.673, 0.154), (4.282, -0.132), (1.852, -0.138))
"""Length [m] and curvature [1/m], Ding et al. (2024), Fig. 1d."""
VERDICTS = {
    "path-length": "reproduced",
    "rock-distance": "reproduced under a named reading",
    "slip-55deg": "differs",
}
SOIL = read_soil("longji")


@pytest.fixture(scope="module")
def numbers(drives: Drives) -> dict[str, Number]:
    return {number.id: number for number in drive_numbers(drives)}


@pytest.fixture(scope="module")
def rolling() -> Rolling:
    return Rolling.of(build_rover("yutu2"))


def test_every_number_of_the_table_has_a_verdict_with_evidence(numbers: dict[str, Number]) -> None:
    assert list(numbers) == [row["id"] for row in published_numbers("drive")]
    assert all(number.reason for number in numbers.values())


def test_verdicts(numbers: dict[str, Number]) -> None:
    expected = dict.fromkeys(numbers, "not determined by what is published") | VERDICTS
    assert {name: number.verdict for name, number in numbers.items()} == expected


def test_the_rock_is_where_the_arcs_and_the_view_end(numbers: dict[str, Number]) -> None:
    """The heading integrated in small steps, then 0.75 + 0.69 m straight on."""
    steps, heading, x, y = 20_000, 0.0, 0.0, 0.0
    for length, curvature in ARCS:
        for angle in heading + curvature * length * (np.arange(steps) + 0.5) / steps:
            x, y = x + math.cos(angle) * length / steps, y + math.sin(angle) * length / steps
        heading += curvature * length
    x, y = x + 1.44 * math.cos(heading), y + 1.44 * math.sin(heading)
    assert numbers["rock-distance"].ours == pytest.approx(math.hypot(x, y), abs=1e-6)
    assert numbers["path-length"].ours == pytest.approx(sum(length for length, _ in ARCS))


@pytest.mark.parametrize("slope", [0.0, 5.38, 8.86])
def test_steady_rolling_balances_the_weight(rolling: Rolling, slope: float) -> None:
    """A force on each of six wheels equal to a sixth of the weight's part along the slope, and against it."""
    slip = rolling.slip_ratio(SOIL, slope)
    weight = 135.0 * 1.62 / 6
    sinkage = sinkage_under_load(rolling.wheel, SOIL, weight * math.cos(math.radians(slope)), slip)
    pull = float(closed_form_forces(rolling.wheel, SOIL, sinkage, slip).drawbar_pull_n)
    assert pull == pytest.approx(-weight * math.sin(math.radians(slope)), abs=0.02)
    assert rolling.slope_deg(SOIL, slip) == pytest.approx(slope, abs=1e-5)


def test_what_cannot_roll_says_so(rolling: Rolling) -> None:
    with pytest.raises(ParameterError, match="roll steadily down 60 deg"):
        rolling.slip_ratio(SOIL, 60.0)
    with pytest.raises(ParameterError, match="on no slope within 45 deg"):
        rolling.slope_deg(SOIL.replace(friction_angle_deg=60.0, cohesion_pa=5000.0), -0.59)


@pytest.mark.parametrize(("name", "slope"), [("5.38° down", 5.38), ("8.86° down", 8.86)])
def test_the_rover_on_a_plane_slips_as_six_equal_wheels_do(
    drives: Drives, rolling: Rolling, name: str, slope: float
) -> None:
    found = medians(drives.on[name], "slip_ratio", "friction_angle_deg")
    for phi in (25.0, 40.0, 55.0):
        expected = rolling.slip_ratio(SOIL.replace(friction_angle_deg=phi), slope)
        assert found[phi] == pytest.approx(expected, abs=0.01)


def test_the_published_rise_of_the_slip_needs_steeper_ground(numbers: dict[str, Number], rolling: Rolling) -> None:
    number = numbers["slip-55deg"]
    assert number.high is not None and number.low is not None and number.ours is not None
    assert number.low <= number.ours <= number.high < number.published
    weak, strong = (SOIL.replace(friction_angle_deg=phi) for phi in (25.0, 55.0))
    for slope in np.linspace(-10.0, 8.86, 20):
        assert rolling.slip_ratio(strong, slope) < rolling.slip_ratio(weak, slope)
    assert rolling.slip_ratio(strong, 12.0) > rolling.slip_ratio(weak, 12.0)


def test_side_slip_grows_with_the_modulus_as_published(drives: Drives) -> None:
    for found in drives.on.values():
        values = list(medians(found, "side_slip_deg", "lateral_modulus_mm").values())
        assert values == sorted(values)


def test_examples_lie_within_the_range_over_all_grounds(numbers: dict[str, Number]) -> None:
    for name in ("slip-25deg", "slip-least", "side-slip-15mm", "side-slip-45mm", "ends-within", "arrival"):
        number = numbers[name]
        assert number.ours is not None and number.low is not None and number.high is not None
        assert number.low <= number.ours <= number.high
        assert number.low < number.high


def test_examples_are_medians_and_extremes_of_what_was_driven(drives: Drives, numbers: dict[str, Number]) -> None:
    found = drives.on[STAND_IN]
    weak = found.states[found.parameters["friction_angle_deg"] == 25.0][..., 3]
    assert numbers["slip-25deg"].ours == pytest.approx(np.median(weak))
    assert numbers["slip-least"].ours == pytest.approx(found.states[..., 3].min())
    ends = found.paths[:, -1, :2] - found.planned[-1, :2]
    assert numbers["ends-within"].ours == pytest.approx(np.hypot(*ends.T).max())


def test_progress_counts_the_grounds(drives: Drives, told: list[tuple[int, int]]) -> None:
    assert told == [(k, 4) for k in range(1, 5)]
