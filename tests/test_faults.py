"""Commands that are killed, and whose disk is full or read-only: what is done is kept, and the end has the same bytes.

At ten moments, and of all commands that keep blocks: `tests/benchmarks/faults.py`.
"""

import random
import re
import sys
from pathlib import Path

import pytest

pytestmark = pytest.mark.skipif(sys.platform != "linux", reason="forks, and mounts disks")


def test_a_fit_that_is_killed_goes_on(load_benchmark, tmp_path: Path) -> None:
    faults = load_benchmark("faults")
    case = faults.case_of("fit", tmp_path, 0.25)
    wanted, seconds = faults.whole(case, tmp_path)
    found = faults.killed(case, tmp_path, wanted, seconds, 1, random.Random(3))
    assert len(found.kept) == 1
    assert found.same
    assert found.left == []


def test_what_a_full_disk_has_is_kept_and_gone_on_with(load_benchmark, tmp_path: Path) -> None:
    """A real disk of a megabyte, then the same one read-only, then with room."""
    faults = load_benchmark("faults")
    case = faults.case_of("map", tmp_path, 0.5)
    wanted, _ = faults.whole(case, tmp_path)
    told, same = faults.full_disk(case, tmp_path, wanted)
    if not told:
        pytest.skip("disks may not be mounted here")
    full, closed, roomy = told
    assert (full["code"], closed["code"], roomy["code"]) == (1, 1, 0)
    assert "No space left on device" in full["said"]
    kept = re.search(r"(\d+) of (\d+) blocks are kept", full["said"])
    assert kept is not None and int(kept[1]) == full["kept"] and 0 < full["kept"] < int(kept[2]), full["said"]
    assert closed["kept"] == full["kept"]
    assert "no permission to write" in closed["said"]
    assert same
