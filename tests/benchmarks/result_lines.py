"""Results as lines of JSON in a file: what is there is not computed again, so that a run can be cut and go on."""

import json
import warnings
from collections.abc import Callable, Iterable, Mapping
from concurrent.futures import ProcessPoolExecutor
from pathlib import Path
from typing import Any

from lunarsci.compiled import set_threads

Row = dict[str, Any]


def rows_of(*files: Path | None) -> list[Row]:
    """Whole lines of those that exist; one that was cut off is left out."""
    rows = []
    for line in (line for file in files if file and file.exists() for line in file.read_text("utf-8").splitlines()):
        try:
            rows.append(json.loads(line))
        except json.JSONDecodeError:
            continue
    return rows


def alone() -> None:
    """Settings of a process that computes beside others."""
    set_threads(1)
    warnings.simplefilter("ignore")


def computed(
    case: Callable[[Any], Row],
    tasks: Mapping[tuple[Any, ...], Any],
    names: Iterable[str],
    out: Path | None = None,
    jobs: int = 1,
    said: Callable[[Row], str] = json.dumps,
) -> list[Row]:
    """Rows of the file, and of the tasks that it lacks by the values of `names`, which are added to it as they come."""
    rows = rows_of(out)
    there = {tuple(row[name] for name in names) for row in rows}
    missing = [task for key, task in tasks.items() if key not in there]
    with ProcessPoolExecutor(jobs, initializer=alone) as pool:
        alone()
        for row in pool.map(case, missing) if jobs > 1 else map(case, missing):
            rows.append(row)
            print(said(row), flush=True)
            if out:
                with out.open("a", encoding="utf-8") as file:
                    file.write(json.dumps(row) + "\n")
    return rows
