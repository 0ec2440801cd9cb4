"""Peak memory of commands over their number of spectra: `python tests/benchmarks/memory.py [--counts N,N] [NAME ...]`.

SYNTHETIC spectra as one CSV, results as CSV and JSON, each command a process of its own. What a spectrum adds is the
difference of two counts; its numbers alone, as they are read, are 8 bytes a channel.
"""

import argparse
import os
import subprocess
import sys
import tempfile
from pathlib import Path

import numpy as np
from faults import CHANNELS_NM, made_up, write_table

COMMANDS = {
    "bands": ("bands",),
    "fit": ("fit", "--assemblage", "OPX-CPX", "--starts", "1"),
}


def peak_mb(arguments: list[str]) -> tuple[float, float]:
    """Most memory that a command takes [MB], and its processor time [s]."""
    process = subprocess.Popen([sys.executable, "-m", "lunarsci.cli", "spectra", *arguments, "-q"])
    _, status, used = os.wait4(process.pid, 0)
    if os.waitstatus_to_exitcode(status) not in (0, 3):
        raise SystemExit("failed")
    return used.ru_maxrss * 1024 / 1e6, used.ru_utime + used.ru_stime


def main() -> None:
    """Print a line for each command, count and form."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("commands", nargs="*", default=list(COMMANDS))
    parser.add_argument("--counts", default="10000,100000")
    parser.add_argument("--forms", default="csv,json")
    options = parser.parse_args()
    counts = [int(count) for count in options.counts.split(",")]
    with tempfile.TemporaryDirectory() as name:
        tables = [write_table(Path(name) / f"{count}.csv", made_up(count)) for count in counts]
        sizes = ", ".join(f"{Path(table).stat().st_size / 1e6:.0f}" for table in tables)
        print(f"SYNTHETIC spectra of {CHANNELS_NM.size} channels, inputs of {sizes} MB")
        for command in options.commands:
            for form in options.forms.split(","):
                found = []
                for count, table in zip(counts, tables, strict=True):
                    target = Path(name) / f"out.{form}"
                    peak, spent = peak_mb([*COMMANDS[command], table, "-o", str(target)])
                    found.append(peak)
                    size = target.stat().st_size / 1e6
                    target.unlink()
                    told = f"{peak:7.0f} MB at most, {spent:6.1f} CPU-s, {size:6.0f} MB out"
                    print(f"{command:6s} {form:5s} {count:8,d}: {told}", flush=True)
                if len(found) > 1:
                    print(f"  a spectrum adds {1e6 * np.diff(found)[-1] / np.diff(counts)[-1]:,.0f} bytes")


if __name__ == "__main__":
    main()
