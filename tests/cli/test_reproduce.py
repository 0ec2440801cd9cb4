"""`lunarsci reproduce`."""

import json
from collections.abc import Callable
from typing import Any


def test_the_table_and_its_json_say_the_same(run: Callable[..., Any]) -> None:
    table = run("reproduce")
    assert table.code == 0
    assert "stiffness-15mm" in table.out
    assert "not determined by what is published" in table.out
    found = json.loads(run("reproduce", "--json", "--no-time").out)
    assert found["schema"] == "lunarsci/reproduce/1"
    assert sum(found["result"]["verdicts"].values()) == len(found["result"]["numbers"])
    assert {"id", "published", "ours", "low", "high", "reading", "verdict", "reason"} <= set(
        found["result"]["numbers"][0]
    )
