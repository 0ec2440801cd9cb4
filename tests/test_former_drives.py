"""Commands on ground and drives: former answers, pages, tables, the same from Python: `tests/benchmarks/former.py`."""

import former
import pytest


@pytest.mark.slow
class TestDrives(former.Answers):
    half = "drives"
