"""A browser without a screen, and results as commands answered them."""

import json
import shutil
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

FORMER = Path(__file__).parents[1] / "former_results.json"
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


def whole(value: Any) -> Any:
    """Lists that the table of former answers has shortened, as short lists."""
    if isinstance(value, dict) and {"length", "first", "last"} <= value.keys():
        return [whole(value["first"]), whole(value["middle"]), whole(value["last"])]
    if isinstance(value, dict):
        return {key: whole(item) for key, item in value.items()}
    return [whole(item) for item in value] if isinstance(value, list) else value


def documents() -> dict[str, dict[str, Any]]:
    """What every command answered, by its name in the table of former answers."""
    record = {"command": "lunarsci", "options": {}, "sources": ["Somebody (2000), A Journal 1, 2"], "warnings": []}
    answers = json.loads(FORMER.read_text("utf-8"))["answers"]
    return {
        name: {
            "schema": one["schema"],
            "result": whole(one["result"]),
            "provenance": record | {"untrusted": "what the command says" if one["exit"] == 3 else "", "failures": []},
        }
        for name, one in answers.items()
        if "schema" in one
    }
