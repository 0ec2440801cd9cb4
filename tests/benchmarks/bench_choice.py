"""Time of one choice among drives, file to file: `python tests/benchmarks/bench_choice.py`.

`lunarsci twin plan` from a terrain's file and a belief's to a folder: a target 10 m away, 50 candidates, 64 soils and
128 fresh ones, as processes of their own; the first one, which may have to compile, does not count. On a machine that
does other things, too, seconds of its processors tell more than those of the clock: the aim of 10 s on two cores is 20
of them.
"""

import argparse
import json
import os
import resource
import subprocess
import sys
import tempfile
import time
from pathlib import Path

from lunarsci.regolith.belief import first_belief

TARGET = "9.8,2"
PROGRAM = Path(sys.executable).parent / "lunarsci"


def spent() -> float:
    """Seconds of processors of all processes that have ended. [s]"""
    used = resource.getrusage(resource.RUSAGE_CHILDREN)
    return used.ru_utime + used.ru_stime


def run(*line: object) -> tuple[float, float]:
    """Seconds of processors and of the clock that a command takes. [s]"""
    before, begin = spent(), time.perf_counter()
    done = subprocess.run([str(PROGRAM), *map(str, line), "--quiet"], stdout=subprocess.DEVNULL, check=False)
    if done.returncode not in (0, 3):
        raise SystemExit(f"{' '.join(map(str, line))}: exit code {done.returncode}")
    return spent() - before, time.perf_counter() - begin


def main() -> None:
    """Print times."""
    parser = argparse.ArgumentParser(description="How long does one choice take?")
    parser.add_argument("--repeats", type=int, default=3)
    parser.add_argument("options", nargs="*", help="further options of `twin plan`, after --")
    given = parser.parse_args()
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        (folder / "belief.json").write_text(first_belief().to_json())
        run("twin", "terrain", "synthetic-longji", "-o", folder / "ground")
        files = (folder / "ground" / "terrain.npz", "--soil", folder / "belief.json")
        choice = ("--risk", "0.1", "--candidates", "50", "--members", "64", *given.options)
        times = []
        for number in range(given.repeats + 1):
            out = folder / f"chosen-{number}"
            times.append(run("twin", "plan", *files, "--target", TARGET, *choice, "--json", "-o", out))
            if not number:
                said = json.loads(subprocess.run(
                    [str(PROGRAM), "twin", "plan", *map(str, files), "--target", TARGET, *choice, "--json", "--quiet"],
                    capture_output=True, text=True, check=False,
                ).stdout)["result"]["choice"]  # fmt: skip
                again = [one["promised"]["drives"] for one in said["candidates"] if one["promised"]]
                drives = said["drives"] + sum(again)
                print(f"{len(said['candidates'])} candidates, {drives} drives, {os.cpu_count()} processors")
        for cpu, wall in times[1:]:
            print(f"{cpu:6.1f} s of processors, {wall:6.1f} s of the clock")


if __name__ == "__main__":
    main()
