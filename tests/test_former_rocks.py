"""Commands on rocks: former answers, pages, tables, the same from Python: `tests/benchmarks/former.py`."""

import former
import pytest


@pytest.mark.slow
class TestRocks(former.Answers):
    half = "rocks"
