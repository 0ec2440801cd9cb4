"""`python -m lunarsci`, the same as `lunarsci`."""

import runpy

runpy.run_module("lunarsci.cli", run_name="__main__")
