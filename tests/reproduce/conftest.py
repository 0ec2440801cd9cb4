"""What the plan's drives are on the four grounds, driven once."""

import pytest

from lunarsci.reproduce.drive import Drives, predicted_drives


@pytest.fixture(scope="session")
def told() -> list[tuple[int, int]]:
    """How far they were, each time that was told."""
    return []


@pytest.fixture(scope="session")
def drives(told: list[tuple[int, int]]) -> Drives:
    return predicted_drives(progress=lambda done, total: told.append((done, total)))
