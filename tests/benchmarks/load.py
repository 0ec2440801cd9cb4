"""What commands take of large inputs: `python tests/benchmarks/load.py [--scale 1] [NAME ...]`.

SYNTHETIC inputs, each command in a process of its own: its processor and wall time, most memory, and how many of
something it does a second. `telemetry`: a week at 10 Hz and a day at 1 Hz, with five drives in it, and half a day of
driving. `history`: a belief of 1,000 drives shown, gone back in, and taught by one more. `terrain`: 16 million nodes
looked at and planned on. `spectra`: 30,000 and 100,000 of 60 channels as one CSV, and what each adds, beside its own
numbers of 8 bytes a channel. `commands`: 10,000 short ones, and what they leave behind in folders of caches and
temporary files. With `--scale` 0.1 everything is a tenth: what grows faster than its input
shows.
"""

import argparse
import itertools
import json
import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from faults import made_up, write_table

WHEELS = ("FL", "FR", "ML", "MR", "RL", "RR")
HEADER = "time_s,x_m,y_m,sigma_m,yaw_deg,yaw_deg_sigma," + ",".join(
    f"speed_{wheel}_m_s,steering_{wheel}_deg,angle_{wheel}_deg" for wheel in WHEELS
)
DAY_S, DRIVE_S, FIX_S = 86_400, 200.0, 10.0
SPEED_M_S, SLIP = 0.05, 0.1
PLAN = f"[drive]\nspeed_m_s = {SPEED_M_S}\n[[leg]]\nlength_m = 1.8\n"


@dataclass(frozen=True)
class Spent:
    """What a command took: exit code, what it said on stderr, processor and wall time [s], most memory [MB]."""

    code: int
    said: str
    cpu_s: float
    wall_s: float
    peak_mb: float


def measured(*arguments: str | Path, environment: Mapping[str, str] | None = None) -> Spent:
    """Run a command of lunarsci in a process of its own."""
    begin = time.perf_counter()
    with tempfile.TemporaryFile() as heard:
        process = subprocess.Popen(
            [sys.executable, "-m", "lunarsci.cli", *map(str, arguments)],
            stdout=subprocess.DEVNULL,
            stderr=heard,
            env=None if environment is None else dict(environment),
        )
        _, status, used = os.wait4(process.pid, 0)
        process.returncode = os.waitstatus_to_exitcode(status)
        heard.seek(0)
        said = heard.read().decode()
    wall = time.perf_counter() - begin
    return Spent(process.returncode, said, used.ru_utime + used.ru_stime, wall, used.ru_maxrss * 1024 / 1e6)


def told(name: str, spent: Spent, count: float = 0, unit: str = "") -> str:
    """A line of what a command took, and the rate at which it did `count` of something."""
    rate = f", {count / spent.cpu_s:10,.0f} {unit}/CPU-s" if count else ""
    text = f"{name:34s} exit {spent.code}, {spent.cpu_s:7.1f} CPU-s, {spent.wall_s:7.1f} s, {spent.peak_mb:6.0f} MB"
    line = (
        next((line for line in spent.said.splitlines()[::-1] if line.strip()), "") if spent.code not in (0, 3) else ""
    )
    return f"{text}{rate}" + (f"\n    {line}" if line else "")


def write_telemetry(path: Path, seconds: float, rate_hz: float, drives: int, drive_s: float = DRIVE_S) -> int:
    """SYNTHETIC telemetry of a rover that drives straight ahead so many times, and else stands; its number of rows."""
    from lunarsci.twin.rover import build_rover

    count, every = int(seconds * rate_hz), max(1, int(FIX_S * rate_hz))
    # A rover that starts and stops amid two rows is told half its speed over that step, and turns for half of it.
    begins = np.linspace(0.0, seconds, drives, endpoint=False) + 50.0 + 0.5 / rate_hz
    rng, radius = np.random.default_rng(0), build_rover("yutu2").wheel.shearing_radius_m
    with path.open("w") as file:
        file.write(f"# synthetic: made up by tests/benchmarks/load.py\n{HEADER},synthetic\n")
        for first in range(0, count, 100_000):
            times = np.arange(first, min(count, first + 100_000)) / rate_hz
            spent = np.clip(times[:, None] - begins, 0.0, drive_s)
            way = spent.sum(axis=1) * SPEED_M_S
            moves = ((spent > 0) & (spent < drive_s)).any(axis=1)
            yaw, off = 0.05 * rng.standard_normal(times.size), 0.01 * rng.standard_normal((times.size, 2))
            angle = np.degrees(way / radius)
            for k, moment in enumerate(times):
                fixed = moves[k] and (first + k) % every == 0
                place = f"{(1.0 - SLIP) * way[k] + off[k, 0]:.4f},{off[k, 1]:.4f},0.01" if fixed else ",,"
                columns = (f"{SPEED_M_S if moves[k] else 0},0,{angle[k]:.4f}," * len(WHEELS))[:-1]
                file.write(f"{moment:.1f},{place},{yaw[k]:.4f},0.1,{columns},true\n")
    return count


def telemetry(folder: Path, scale: float) -> Iterator[str]:
    """A week at 10 Hz, a day at 1 Hz, and half a day of driving without a rest, on a strip of waves."""
    x, y = np.arange(-5.0, 2200.0, 0.25), np.arange(-5.0, 5.1, 0.25)
    height = 0.05 * np.sin(x / 3.0)[None, :] * np.cos(y / 4.0)[:, None]
    ground = folder / "strip.npz"
    np.savez(ground, x_m=x, y_m=y, height_m=height, name="SYNTHETIC", synthetic=True)
    for name, days, rate_hz, drives in (
        ("a week at 10 Hz", 7.0, 10.0, 5),
        ("a day at 1 Hz", 1.0, 1.0, 5),
        ("half a day of driving", 0.5, 10.0, 1),
    ):
        path, seconds = folder / "telemetry.csv", days * DAY_S * scale
        rows = write_telemetry(path, seconds, rate_hz, drives, DRIVE_S if drives > 1 else seconds - 100.0)
        spent = measured("twin", "states", path, "--terrain", ground, "-q", "-o", folder / "states", "--force")
        yield told(f"states: {name}, {rows:,} rows", spent, rows, "rows") + f", {path.stat().st_size / 1e6:.0f} MB in"
        path.unlink()


def made_belief(drives: int) -> Any:
    """A belief after so many SYNTHETIC drives, each of which says a little and is kept."""
    from dataclasses import replace

    from lunarsci.regolith.belief import first_belief, with_drive

    rng, belief = np.random.default_rng(0), first_belief()
    for number in range(drives):
        name = {"states": f"states{number}.csv", "sha256": f"{number:064x}"}
        law = belief.discrepancy.with_source(**name, plan="SYNTHETIC", how="own end")
        off = 0.05 * rng.standard_normal(belief.mean.size) * np.sqrt(np.diag(belief.covariance))
        after = replace(belief, mean=belief.mean + off, covariance=0.999 * belief.covariance, discrepancy=law)
        drive = {**name, "plan": "SYNTHETIC", "values": 60, "outliers": 0, "chi_square": 55.0, "refused": ""}
        belief = with_drive(after, belief, drive, parent_sha256=f"{number:064x}")
    return belief


def history(folder: Path, scale: float) -> Iterator[str]:
    """A belief of many drives: shown, gone back in, and taught by one more."""
    count, belief, plan = int(1000 * scale), folder / "belief.json", folder / "plan.toml"
    belief.write_text(made_belief(count).to_json(), "utf-8")
    plan.write_text(PLAN)
    size = f", {belief.stat().st_size / 1e6:.2f} MB in"
    yield told(f"history: {count:,} drives", measured("twin", "history", belief, "-q"), count, "drives") + size
    back = measured("twin", "history", belief, "--rollback", count // 2, "--save", folder / "back.json", "-q", "--json")
    yield told(f"history: back to {count // 2:,}", back)
    measured("twin", "simulate", plan, "--seed", "1", "-o", folder / "drive", "-q")
    measured("twin", "states", folder / "drive" / "telemetry.csv", plan, "-o", folder / "states", "--force", "-q")
    taught = (
        "twin",
        "update",
        folder / "states" / "states.csv",
        "--plan",
        plan,
        "--particles",
        "32",
        "--no-ruts",
        "-q",
    )
    yield told("update: the first drive", measured(*taught))
    yield told(f"update: after {count:,} drives", measured(*taught, "--soil", belief, "--save", folder / "more.json"))
    yield f"    the belief has {(folder / 'more.json').stat().st_size / 1e6:.2f} MB after it"


def terrain(folder: Path, scale: float) -> Iterator[str]:
    """Ground of 4,000 x 4,000 nodes of 5 cm: waves and bowls."""
    side = int(4000 * scale**0.5)
    x = np.arange(side) * 0.05
    height = 0.1 * np.sin(x / 3.0)[None, :] * np.cos(x / 4.0)[:, None]
    rng = np.random.default_rng(0)
    for place in rng.uniform(0, x[-1], (40, 2)):
        height -= 0.3 * np.exp(-((x[None, :] - place[0]) ** 2 + (x[:, None] - place[1]) ** 2) / 2.0)
    path = folder / "terrain.npz"
    np.savez(path, x_m=x, y_m=x, height_m=height, name="SYNTHETIC", synthetic=True)
    nodes, end = side * side, 0.9 * x[-1]
    size = f", {nodes * 8 / 1e6:.0f} MB of heights"
    yield (
        told(f"terrain: {nodes / 1e6:.1f} million nodes", measured("twin", "terrain", path, "-q"), nodes, "nodes")
        + size
    )
    kept = measured("twin", "terrain", path, "-q", "-o", folder / "site")
    yield told("terrain: the same, kept", kept, nodes, "nodes")
    way = ("--start", f"{0.1 * x[-1]:.1f},{0.1 * x[-1]:.1f},45", "--target", f"{end:.1f},{end:.1f}")
    yield told(f"plan: {1.13 * x[-1]:.0f} m across it", measured("twin", "plan", path, *way, "-q"), nodes, "nodes")


def spectra(folder: Path, scale: float) -> Iterator[str]:
    """Bands and fits of a table, as CSV and as JSON."""
    counts = [int(30_000 * scale), int(100_000 * scale)]
    tables = [write_table(folder / f"{count}.csv", made_up(count)) for count in counts]
    for line in (("bands",), ("fit", "--assemblage", "OPX-CPX", "--starts", "1")):
        for form in ("csv", "json"):
            spent = [
                measured("spectra", *line, table, "-q", "--force", "-o", folder / f"out.{form}") for table in tables
            ]
            for count, one in zip(counts, spent, strict=True):
                yield told(f"{line[0]}, {form}: {count:,} spectra", one, count, "spectra")
            more = 1e6 * (spent[1].peak_mb - spent[0].peak_mb) / (counts[1] - counts[0])
            yield f"    a spectrum adds {more:,.0f} bytes"


def held_by(folder: Path) -> tuple[int, float]:
    """How many files there are in a folder, and their size [MB]."""
    files = [path for path in folder.rglob("*") if path.is_file()]
    return len(files), sum(path.stat().st_size for path in files) / 1e6


def commands(folder: Path, scale: float) -> Iterator[str]:
    """Many short commands, one after another, with folders of their own for whatever is left."""
    count = max(10, int(10_000 * scale))
    places = {"TMPDIR": folder / "tmp", "NUMBA_CACHE_DIR": folder / "numba", "XDG_CACHE_HOME": folder / "cache"}
    places |= {"HOME": folder / "home", "MPLCONFIGDIR": folder / "matplotlib"}
    for place in places.values():
        place.mkdir()
    environment = os.environ | {name: str(place) for name, place in places.items()}
    lines = (
        ("regolith", "forces", "--load", "20", "--slip", "0.1", "--field", "drawbar_pull_n"),
        ("info", folder / "forces.json", "-q"),
        ("twin", "history", folder / "belief.json", "-q"),
        ("cite", folder / "forces.json"),
    )
    measured(*lines[0][:6], "--no-time", "-q", "-o", folder / "forces.json", environment=environment)
    (folder / "belief.json").write_text(made_belief(2).to_json(), "utf-8")
    for line in lines:
        first = measured(*line, environment=environment)
        yield told(f"commands: the first {' '.join(map(str, line[:2]))[:24]}", first)
    before = {name: held_by(place) for name, place in places.items()}
    spent = [measured(*line, environment=environment) for line in itertools.islice(itertools.cycle(lines), count)]
    cpu, failed = np.array([one.cpu_s for one in spent]), sum(one.code != 0 for one in spent)
    first, last = (np.median(part) for part in (cpu[: len(cpu) // 10], cpu[-(len(cpu) // 10) :]))
    peak = max(one.peak_mb for one in spent)
    yield f"commands: {count:,} more, {failed} failed: {first:.2f} CPU-s at first, {last:.2f} at last, {peak:.0f} MB"
    for name, place in places.items():
        files, size = held_by(place)
        yield f"    {name:16s} {files - before[name][0]:+d} files, {size - before[name][1]:+.3f} MB, to {size:.1f} MB"


LOADS: dict[str, Callable[[Path, float], Iterator[str]]] = {
    "telemetry": telemetry,
    "history": history,
    "terrain": terrain,
    "spectra": spectra,
    "commands": commands,
}


def main() -> None:
    """Print a line for each command."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("names", nargs="*", default=list(LOADS))
    parser.add_argument("--scale", type=float, default=1.0)
    options = parser.parse_args()
    print(json.dumps({"scale": options.scale}), flush=True)
    for name in options.names:
        with tempfile.TemporaryDirectory() as folder:
            for line in LOADS[name](Path(folder), options.scale):
                print(line, flush=True)


if __name__ == "__main__":
    main()
