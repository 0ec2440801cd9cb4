"""The benchmarks of fits measure what they say: the kernel alone does the work of the command, images are compared."""

from collections.abc import Callable
from types import ModuleType
from typing import Any

import numpy as np
import pytest

from lunarsci.spectra.mgm.fit import fit_arrays
from lunarsci.spectra.mgm.model import mgm_model

Load = Callable[[str], ModuleType]


def test_the_kernel_alone_finds_what_the_command_finds(load_benchmark: Load) -> None:
    bench = load_benchmark("bench_fit")
    case = bench.problem(390, 12, seed=5)
    alone: Any = bench.kernel(case.data, case.wavelength_nm, 2)()
    command = fit_arrays(case.wavelength_nm, np.exp(case.data), mgm_model(), starts=2)
    assert alone.objective == pytest.approx(command.objective, rel=1e-9)


def test_every_way_of_a_fit_is_timed(load_benchmark: Load, monkeypatch: pytest.MonkeyPatch) -> None:
    bench = load_benchmark("bench_fit")
    monkeypatch.setattr(bench, "WARM", 8)
    found = bench.rates(16, 1)
    assert list(found) == ["kernel alone", "CSV to CSV", "CSV to JSON"]
    assert all(cpu_s > 0 and wall_s > 0 for cpu_s, wall_s in found.values())
    assert min(found["CSV to CSV"][0], found["CSV to JSON"][0]) > found["kernel alone"][0]


def test_an_image_with_a_contest_at_every_pixel_is_nowhere_higher(load_benchmark: Load, capsys: Any) -> None:
    """As its line says it."""
    bench = load_benchmark("bench_map")
    strip = bench.mixtures(bench.EIGHTY_FIVE_NM, (6, 6), seed=2)
    bench.compare(strip, mgm_model("OPX-CPX"), 1)
    name, alone, found, higher, by_one, *_ = capsys.readouterr().out.split()
    assert name == strip.name
    assert float(alone) > 0 and float(found) > 0
    assert (float(higher), float(by_one)) == (0.0, 0.0)
