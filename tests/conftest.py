"""Shared fixtures: the measured reference data, where they are present."""

import os
from pathlib import Path

import pytest


@pytest.fixture(scope="session")
def reference_data() -> Path:
    """Folder of real measurements, named by LUNARSCI_REFERENCE_DATA."""
    folder = os.environ.get("LUNARSCI_REFERENCE_DATA")
    if not folder:
        pytest.skip("LUNARSCI_REFERENCE_DATA is not set: no measured data to check against")
    path = Path(folder).resolve()
    if not path.is_dir():
        pytest.fail(f"LUNARSCI_REFERENCE_DATA names {path}, which is no folder")
    return path
