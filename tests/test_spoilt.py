"""Wrong but plausible files: each is refused, doubted or told, but for what is listed here."""

from pathlib import Path

import pytest
import spoilt
from spoilt_tables import REFUSED, SILENT, UNTRUSTED, outcomes

pytestmark = pytest.mark.filterwarnings("ignore::RuntimeWarning")
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
UNNOTICED_IN = {
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


def test_what_is_silent_of_vnis_products_is_known(tmp_path: Path) -> None:
    """Also that a case is no longer silent: then it leaves the list, and the documentation."""
    found = dict(spoilt.vnis_outcomes(tmp_path))
    assert len(found) > 90
    silent = {name: outcome for name, outcome in found.items() if outcome.end == SILENT}
    assert set(silent) == set(UNNOTICED)
    for name, outcome in silent.items():
        assert outcome.error_percent <= UNNOTICED[name] + 0.1, name
    assert found["incidence and emission swapped in both labels"].end == REFUSED
    assert {found[name].end for name in ("15 rows x 1.15", "planes rolled by one")} == {UNTRUSTED}


@pytest.mark.parametrize("part", UNNOTICED_IN)
def test_what_is_silent_of_other_files_is_known(tmp_path: Path, part: str) -> None:
    found = {case: outcome.end for _, case, outcome in outcomes(tmp_path, lambda name: name.startswith(f"{part} "))}
    assert len(found) > len(UNNOTICED_IN[part])
    assert {case for case, end in found.items() if end == SILENT} == UNNOTICED_IN[part]
