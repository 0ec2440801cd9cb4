"""Commands on ground and drives: former answers, pages, tables, the same from Python: `tests/benchmarks/former.py`."""

from pathlib import Path
from typing import Any

import former
import pytest

MINE = former.DRIVES


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("former")


@pytest.fixture(scope="module")
def now(folder: Path) -> dict[str, dict[str, Any]]:
    return former.answers(folder, MINE)


@pytest.mark.slow
def test_answers_are_the_former_ones(now: dict[str, dict[str, Any]]) -> None:
    known = former.former_answers()
    bounds = {name: former.DRAWN.get(name, former.BOUND) for name in now}
    assert [text for name in now for text in former.differences(known[name], now[name], bounds[name], name)] == []


@pytest.mark.slow
@pytest.mark.parametrize("name", [name for name in MINE if not name.startswith("write")])
def test_a_page_says_what_the_command_says(name: str, now: dict[str, Any], folder: Path) -> None:
    former.page_says_what_the_command_says(name, now, folder)


@pytest.mark.slow
def test_tables_fit_the_terminal(now: dict[str, Any]) -> None:
    for name in MINE:
        former.tables_fit_the_terminal(name)


@pytest.mark.slow
@pytest.mark.parametrize("name", [name for name in former.NOTEBOOK if name in MINE])
def test_a_notebook_gets_what_the_command_prints(
    name: str, now: dict[str, Any], folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    former.notebook_gets_what_the_command_prints(name, folder, monkeypatch)
