"""The benchmark of images measures what it says."""

from collections.abc import Callable
from types import ModuleType
from typing import Any

from lunarsci.spectra.mgm.model import mgm_model

Load = Callable[[str], ModuleType]


def test_an_image_with_a_contest_at_every_pixel_is_nowhere_higher(load_benchmark: Load, capsys: Any) -> None:
    """As its line says it."""
    bench = load_benchmark("bench_map")
    strip = bench.mixtures(bench.EIGHTY_FIVE_NM, (6, 6), seed=2)
    bench.compare(strip, mgm_model("OPX-CPX"), 1)
    name, alone, found, higher, by_one, *_ = capsys.readouterr().out.split()
    assert name == strip.name
    assert float(alone) > 0 and float(found) > 0
    assert (float(higher), float(by_one)) == (0.0, 0.0)
