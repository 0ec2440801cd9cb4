"""A browser without a screen, and results as commands answered them."""

import shutil
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from former import documents

CHROMIUM = ("chromium", "chromium-browser", "google-chrome", "google-chrome-stable")


@pytest.fixture(scope="session")
def browser() -> Iterator[Any]:
    """A real browser."""
    program = next(filter(None, map(shutil.which, CHROMIUM)), None)
    if program is None:
        pytest.skip(f"no browser: none of {', '.join(CHROMIUM)} is installed; apt-get install chromium")
    sync_api = pytest.importorskip("playwright.sync_api", reason="playwright is not installed: pip install '.[test]'")
    with sync_api.sync_playwright() as started:
        # A container's root may not use Chromium's own sandbox.
        opened = started.chromium.launch(executable_path=program, args=["--no-sandbox"])
        yield opened
        opened.close()


@pytest.fixture(scope="session")
def printed(shared: Path) -> dict[str, dict[str, Any]]:
    """What every command printed with --json, by its name in the table of former answers; to read."""
    return documents(shared)
