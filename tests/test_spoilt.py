"""Wrong but plausible VNIS products: each is refused, doubted or told, but for what no check could notice."""

from collections.abc import Callable
from pathlib import Path
from types import ModuleType

import pytest

UNNOTICED = {
    "a synodic month later everywhere": 1.0,
    "15 planes x 1.15": 15.0,
    "a plane x 1.1": 10.0,
    "image x 0.9": 0.0,
    "upside down": 0.0,
    "wrapped by 20 lines": 0.0,
    "a constant quarter": 3.0,
    "two neighbouring planes exchanged": 5.0,
    "an offset of a tenth": 6.0,
    "SWIR x 0.9": 10.0,
    "SWIR x 1.1": 10.0,
    "identifiers one more": 0.0,
}
"""What stays silent, and by how much the result differs then at most. [%]"""


@pytest.fixture(scope="module")
def spoilt(load_benchmark: Callable[[str], ModuleType]) -> ModuleType:
    return load_benchmark("spoilt")


@pytest.mark.filterwarnings("ignore::RuntimeWarning")
def test_what_is_silent_is_known(spoilt: ModuleType, tmp_path: Path) -> None:
    """Also that a case is no longer silent: then it leaves the list, and the documentation."""
    found = dict(spoilt.vnis_outcomes(tmp_path))
    assert len(found) > 90
    silent = {name: outcome for name, outcome in found.items() if outcome.end == spoilt.SILENT}
    assert set(silent) == set(UNNOTICED)
    for name, outcome in silent.items():
        assert outcome.error_percent <= UNNOTICED[name] + 0.1, name
    assert found["incidence and emission swapped in both labels"].end == spoilt.REFUSED
    assert found["15 rows x 1.15"].end == spoilt.UNTRUSTED
    assert found["planes rolled by one"].end == spoilt.UNTRUSTED
