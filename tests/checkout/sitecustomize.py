"""The lunarsci of this checkout, also where another one is installed.

`tests/conftest.py` runs this file, and puts its folder on PYTHONPATH: Python runs a module of this name when it starts,
so that every process that a test starts has the same lunarsci.
"""

import sys
from importlib.abc import MetaPathFinder
from importlib.machinery import ModuleSpec
from importlib.util import spec_from_file_location
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
FOLDERS = {"lunarsci": "lunarsci", "lunarsci.cli": "cli", "lunarsci.spectra_data": "spectra_data"}
"""Where a package lies in the checkout, as `package-dir` of pyproject.toml has it."""


class Checkout(MetaPathFinder):
    """Finds the three packages; all that is below them Python finds by itself."""

    def find_spec(self, name: str, path: object = None, target: object = None) -> ModuleSpec | None:
        folder = ROOT / FOLDERS.get(name, "nowhere")
        if name not in FOLDERS:
            return None
        return spec_from_file_location(name, folder / "__init__.py", submodule_search_locations=[str(folder)])


sys.meta_path.insert(0, Checkout())
