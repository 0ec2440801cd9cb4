"""Run the command line in this process, and small input files."""

import importlib
import os
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest
from lunarsci.cli import main

from lunarsci.regolith.belief import SoilBelief, first_belief
from lunarsci.spectra.vnis.channels import SPLICED_NM
from lunarsci.spectra.vnis.simulation.scene import Material, SceneComposition, surface_reflectance

SHORT_PLAN = "[drive]\nspeed_m_s = 0.05\n[[leg]]\nlength_m = 0.6\n"


@dataclass(frozen=True)
class Ran:
    """What a command left: exit code, stdout, lines of stderr."""

    code: int
    out: str
    err: list[str]


@pytest.fixture
def run(capfd: pytest.CaptureFixture[str]) -> Callable[..., Ran]:
    """`run("spectra", "fit", ...)` as a shell would."""

    def call(*arguments: object) -> Ran:
        capfd.readouterr()
        code = main([str(a) for a in arguments])
        out, err = capfd.readouterr()
        return Ran(code, out, err.splitlines())

    return call


@pytest.fixture
def drawn_on() -> Callable[[int], str]:
    """`drawn_on(terminal)`: what is drawn on the other end of a pseudo-terminal until that end is closed."""

    def read(terminal: int) -> str:
        drawn = b""
        while True:
            try:
                drawn += os.read(terminal, 10_000)
            except OSError:  # the other end is closed: the command has ended
                break
        os.close(terminal)
        return drawn.decode(errors="replace")

    return read


@pytest.fixture
def rock(tmp_path: Path) -> Path:
    """A synthetic rock as CSV, with deep bands and noise of 0.5 %."""
    return write_rock(tmp_path)


def write_rock(folder: Path) -> Path:
    material = Material(SceneComposition(0.15, 0.35, 0.40, 0.10), albedo=0.12, red_slope=0.25, contrast=1.5)
    clean = surface_reflectance(SPLICED_NM, material)
    noisy = clean * np.exp(0.005 * np.random.default_rng(0).standard_normal(clean.size))
    rows = (f"{w:g},{r:.6f},{0.005 * r:.6f}" for w, r in zip(SPLICED_NM, noisy, strict=True))
    path = folder / "rock.csv"
    path.write_text("wavelength_nm,synthetic_rock,synthetic_rock_sigma\n" + "\n".join(rows) + "\n")
    return path


@pytest.fixture(scope="module")
def one_rock(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The same for all tests of a file, so that a fit of it need not be repeated."""
    return write_rock(tmp_path_factory.mktemp("rock"))


@pytest.fixture(scope="module")
def once() -> Iterator[None]:
    """Fits and mixtures that are asked for again in a file are those found before: JSON, CSV and text of one result.

    Asked for with equal options of equally named files.
    """
    with pytest.MonkeyPatch.context() as patch:
        for name in ("fit", "unmix"):
            module = importlib.import_module(f"lunarsci.spectra.jobs.{name}")
            patch.setattr(module, name, remembered(getattr(module, name)))
        yield


def remembered(job: Callable[..., Any]) -> Callable[..., Any]:
    found: dict[Any, Any] = {}

    def call(files: list[str], request: Any, **more: Any) -> Any:
        key = (tuple(files), request)
        if key not in found:
            found[key] = job(files, request, **more)
        return found[key]

    return call


@pytest.fixture
def states(tmp_path: Path) -> Path:
    """The published wheel state as CSV, with a slip that has a solution."""
    path = tmp_path / "states.csv"
    path.write_text("sinkage_m,slip_ratio,normal_force_n,drawbar_pull_n\n0.008,0.05,32.03,-1.30\n")
    return path


@pytest.fixture
def short_plan(tmp_path: Path) -> Path:
    """Sixty centimetres straight ahead."""
    path = tmp_path / "plan.toml"
    path.write_text(SHORT_PLAN)
    return path


@pytest.fixture(scope="session")
def driven_states(tmp_path_factory: pytest.TempPathFactory) -> bytes:
    """States of that drive on the terrain's soil, 10 of each wheel, with errors of sinkage and slip."""
    folder = tmp_path_factory.mktemp("short")
    (folder / "plan.toml").write_text(SHORT_PLAN)
    assert main(["twin", "forces", str(folder / "plan.toml"), "-q", "-o", str(folder / "states.csv")]) == 0
    table = pd.read_csv(folder / "states.csv")
    random = np.random.default_rng(1)
    table["sinkage_m"] += 0.00033 * random.normal(size=len(table))
    table["slip_ratio"] += 0.01 * random.normal(size=len(table))
    return table.to_csv(index=False).encode()


@pytest.fixture
def short_states(driven_states: bytes, tmp_path: Path) -> Path:
    """A file of these states."""
    path = tmp_path / "states.csv"
    path.write_bytes(driven_states)
    return path


@pytest.fixture(scope="session")
def belief(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Of a soil that is known well: the first one with a twentieth of its variances."""
    path, first = tmp_path_factory.mktemp("belief") / "belief.json", first_belief()
    path.write_text(SoilBelief(first.laws, first.mean, 0.05 * first.covariance).to_json())
    return path
