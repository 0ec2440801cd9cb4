"""Synthetic products to read, spoil and calibrate."""

from collections.abc import Callable, Mapping
from pathlib import Path

import pytest

from lunarsci.spectra.vnis.simulation.instrument import simulate
from lunarsci.spectra.vnis.simulation.scene import Scene
from lunarsci.spectra.vnis.simulation.template import product_files


@pytest.fixture(scope="session")
def products() -> dict[str, bytes]:
    """File name to content of one noisy observation; copy before changing."""
    return product_files(simulate(Scene(), seed=3))


@pytest.fixture
def write(tmp_path: Path) -> Callable[[Mapping[str, bytes]], Path]:
    """Write files into a folder of their own and return it."""

    def into(files: Mapping[str, bytes]) -> Path:
        folder = tmp_path / "products"
        folder.mkdir(exist_ok=True)
        for name, content in files.items():
            (folder / name).write_bytes(content)
        return folder

    return into
