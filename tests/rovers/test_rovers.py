"""Wheels by name."""

import pytest

from lunarsci.errors import DataError
from lunarsci.regolith.soil import read_soil
from lunarsci.regolith.traction import sinkage_under_load
from lunarsci.regolith.wheel import read_wheel
from lunarsci.rovers import read_rover, rover_names, wheel_names

SIZES = {"cmu-grouser": (0.058, 0.05, 0.005), "hit-grouser": (0.15735, 0.165, 0.01), "rashid-1": (0.1, 0.08, 0.02)}


@pytest.mark.parametrize("name", wheel_names())
def test_every_wheel_has_sizes_with_their_sources_and_carries_a_load(name: str) -> None:
    wheel, soil = read_wheel(name), read_soil("lunar-typical")
    assert 0 < sinkage_under_load(wheel, soil, 20.0) < wheel.radius_m / 2
    assert f"[{name}]" in read_rover(name).text
    table = read_rover(name).text.split(f"[{name}]")[1].split("\n[")[0]
    assert all("source = " in line for line in table.strip().splitlines())


def test_sizes_are_those_of_the_experiments() -> None:
    for name, sizes in SIZES.items():
        wheel = read_wheel(name)
        assert (wheel.radius_m, wheel.width_m, wheel.grouser_height_m) == sizes


def test_wheels_are_no_rovers() -> None:
    assert not set(wheel_names()) & set(rover_names())
    assert "wheels" not in rover_names()
    with pytest.raises(DataError, match="no \\[mass\\] table"):
        read_rover("lrv").table("mass")
    with pytest.raises(DataError, match="cmu-grouser"):
        read_rover("nothing")
