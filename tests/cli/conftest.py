"""Run the command line in this process, and small input files."""

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import pytest
from lunarsci.cli import main

from lunarsci.spectra.synthetic import synthetic_rock, to_csv


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
def rock(tmp_path: Path) -> Path:
    """A synthetic rock as CSV."""
    path = tmp_path / "rock.csv"
    path.write_bytes(to_csv(synthetic_rock()))
    return path


@pytest.fixture
def states(tmp_path: Path) -> Path:
    """The published wheel state as CSV, with a slip that has a solution."""
    path = tmp_path / "states.csv"
    path.write_text("sinkage_m,slip_ratio,normal_force_n,drawbar_pull_n\n0.008,0.05,32.03,-1.30\n")
    return path
