"""CPU seconds to read a table of spectra and to write what is found: `python tests/benchmarks/bench_tables.py`.

Reading beside splitting and `float`, writing as JSON and CSV beside Python's own `json` and `csv`; `-n` says how many.
"""

import argparse
import csv
import io
import json
import time
from collections.abc import Callable
from typing import Any

import numpy as np

from lunarsci.io.inputs import InputFile
from lunarsci.io.records import Listed, Records
from lunarsci.provenance import to_json
from lunarsci.spectra.readers import read_spectra

CHANNELS, BANDS = 390, 9


def seconds(task: Callable[[], Any]) -> tuple[float, Any]:
    start = time.process_time()
    made = task()
    return time.process_time() - start, made


def table(count: int) -> bytes:
    """A made-up table of spectra, digits as Python writes them."""
    rng = np.random.default_rng(1)
    values = 0.1 + 0.05 * rng.random((CHANNELS, count))
    lines = [f"wavelength_nm,{','.join(f's{k}' for k in range(count))}"]
    lines += [",".join(map(repr, [450.0 + 5 * row, *own])) for row, own in enumerate(values.tolist())]
    return "\n".join(lines).encode()


def found(count: int) -> Records:
    """As much as a fit says of each spectrum: nine bands of twelve numbers."""
    rng = np.random.default_rng(2)
    bands = [{f"key_{k:02d}": rng.normal(size=count) for k in range(12)} for _ in range(BANDS)]
    return Records({"id": [f"s{k}" for k in range(count)], "rms_ln": rng.random(count), "bands": Listed(bands)})


def by_python(records: list[dict[str, Any]]) -> str:
    return json.dumps({"spectra": records}, sort_keys=True, indent=2, ensure_ascii=False) + "\n"


def csv_by_python(cells: list[list[Any]]) -> bytes:
    text = io.StringIO()
    csv.writer(text, lineterminator="\n").writerows(cells)
    return text.getvalue().encode()


def measure(count: int) -> dict[str, float]:
    """CPU seconds by task. Raises ValueError where the bytes or numbers of both ways differ."""
    source, records = InputFile("table.csv", table(count)), found(count)
    flat = Records(
        {"id": records.columns["id"], **{f"c{k}": np.random.default_rng(k).random(count) for k in range(99)}}
    )
    plain, cells = records.tolist(), [list(item.values()) for item in flat]
    lines = source.data.decode().split("\n")[1:]
    times, made = {}, {}
    tasks: dict[str, Callable[[], Any]] = {
        "read": lambda: np.array([item.reflectance for item in read_spectra(source)]).T,
        "read by float": lambda: np.array([[float(cell) for cell in line.split(",")][1:] for line in lines]),
        "JSON": lambda: to_json({"spectra": records}),
        "JSON by Python": lambda: by_python(plain),
        "CSV": lambda: b"".join(flat.csv_chunks()),
        "CSV by Python": lambda: csv_by_python(cells),
    }
    for name, task in tasks.items():
        times[name], made[name] = seconds(task)
    same = np.array_equal(made["read"], made["read by float"])
    if not same or made["JSON"] != made["JSON by Python"] or made["CSV"] != made["CSV by Python"]:
        raise ValueError("both ways must give the same")
    return times


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("-n", type=int, default=2000, help="spectra")
    wanted = parser.parse_args().n
    measure(200)
    for name, time_s in measure(wanted).items():
        print(f"{name:16s} {time_s:8.2f} s  {1e6 * time_s / wanted:8.0f} us a spectrum")
