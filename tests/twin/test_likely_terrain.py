"""Heights that are likely of another unit, or without data and not named so."""

import warnings
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from lunarsci.errors import LunarSciWarning
from lunarsci.images.elevation import read_elevation
from lunarsci.regolith.soil import read_soil
from lunarsci.twin.ground.terrain import read_terrain

SPACING = 0.5
READERS: dict[str, Callable[[Path], Any]] = {
    "the twin": lambda path: read_terrain(path, read_soil("longji")),
    "pictures": read_elevation,
}
every_reader = pytest.mark.parametrize("read", READERS.values(), ids=list(READERS))


def asc(folder: Path, height: np.ndarray) -> Path:
    path = folder / "ground.asc"
    rows = "\n".join(" ".join(f"{value:.4f}" for value in row) for row in height)
    ny, nx = height.shape
    path.write_text(f"ncols {nx}\nnrows {ny}\nxllcorner 0\nyllcorner 0\ncellsize {SPACING}\n{rows}\n")
    return path


@every_reader
@pytest.mark.parametrize(("slope_deg", "warned"), [(44.0, False), (46.0, True)])
def test_ground_steeper_than_any_soil_is_warned_of(
    read: Callable[[Path], Any], tmp_path: Path, slope_deg: float, warned: bool
) -> None:
    plane = np.tan(np.radians(slope_deg)) * SPACING * np.add.outer(0.6 * np.arange(12), 0.8 * np.arange(9))
    path = asc(tmp_path, plane)
    if not warned:
        read(path)
        return
    with pytest.warns(LunarSciWarning, match=r"median slope of 46 deg .* heights in another unit"):
        read(path)


@every_reader
@pytest.mark.parametrize(("spacings", "nodes"), [(9.9, 0), (10.1, 1), (100.1, 5)])
def test_steps_are_counted_by_their_nodes(
    read: Callable[[Path], Any], tmp_path: Path, spacings: float, nodes: int
) -> None:
    height = np.zeros((8, 9))
    height[3, 4] = spacings * SPACING
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        read(asc(tmp_path, height))
    assert [f"off one: {nodes};" in str(item.message) for item in caught] == [True] * bool(nodes)


@every_reader
@pytest.mark.filterwarnings("error")
def test_a_wall_is_not_told(read: Callable[[Path], Any], tmp_path: Path) -> None:
    wall = np.where(np.arange(40) < 20, 0.0, 20.0 * SPACING) * np.ones((8, 1))
    assert read(asc(tmp_path, wall)).height_m.max() == 20.0 * SPACING
