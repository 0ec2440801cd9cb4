"""Wrong but plausible tables, grids and documents: each is refused, doubted or told, but for what is listed here."""

from collections.abc import Callable
from pathlib import Path
from types import ModuleType

import pytest

UNNOTICED = {
    "rover": {"slope limit in rad", "weight for mass"},
    "soil": set(),
    "belief": {"friction angle in radians"},
    "spectrum": {
        "descending",
        "decimal commas",
        "thousands separated",
        "a wavelength of another decade at the end",
        "absorbance, not named so",
        "continuum removed",
        "reflectance a row late",
    },
    "terrain": {
        "heights in ft",
        "heights in km",
        "depths for heights",
        "cells in mm",
        "decimal commas",
        "rows and columns not as announced",
    },
    "craters": {
        "northern hemisphere",
        "one in the northern hemisphere",
        "one of west longitude, same point",
        "one of west longitude without its sign",
        "last number cut",
    },
}
"""What stays silent of each part: decimal commas and separated thousands are read as meant; rovers that climb little or
are heavier might be, as may a soil of 61 deg."""


@pytest.mark.filterwarnings("ignore::RuntimeWarning")
@pytest.mark.parametrize("part", UNNOTICED)
def test_what_is_silent_is_known(load_benchmark: Callable[[str], ModuleType], tmp_path: Path, part: str) -> None:
    spoilt = load_benchmark("spoilt")
    found = spoilt.tables().outcomes(tmp_path, spoilt.happened, lambda name: name.startswith(f"{part} "))
    outcomes = {case: outcome.end for _, case, outcome in found}
    assert len(outcomes) > len(UNNOTICED[part])
    assert {case for case, end in outcomes.items() if end == spoilt.SILENT} == UNNOTICED[part]
