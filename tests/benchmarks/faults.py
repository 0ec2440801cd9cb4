"""Commands that are stopped, and go on: `python tests/benchmarks/faults.py [--kills 10] [--seed 0] [COMMAND ...]`.

`spectra fit`, `bands`, `match` and `map` of SYNTHETIC spectra are run whole; then each is killed (SIGKILL) at random
moments of the processor time that it took, given again each time, and at last let end; then given a disk that is full
half-way, that cannot be written, and that has room again. What ends must have the bytes of what was never stopped.
"""

import argparse
import ctypes
import io
import json
import multiprocessing
import os
import random
import shutil
import signal
import sys
import tempfile
import time
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

CHANNELS_NM = np.linspace(460.0, 2400.0, 60)
NEW_USER, NEW_MOUNTS, READ_ONLY, REMOUNT = 0x10000000, 0x00020000, 1, 32
CONTEXT = multiprocessing.get_context("forkserver")
CONTEXT.set_forkserver_preload(["lunarsci.cli", "lunarsci.spectra.jobs.fit", "lunarsci.spectra.mgm.fit", "scipy.stats",
                                "lunarsci.spectra.bands", "pandas", "faults"])  # fmt: skip


@dataclass(frozen=True)
class Case:
    """A command without `-o`, the suffix of what it writes, and bytes of a disk that holds some of its blocks."""

    arguments: tuple[str, ...]
    suffix: str
    disk: int


def made_up(count: int, seed: int = 0) -> np.ndarray:
    """SYNTHETIC reflectances, (count, channels): two bands of pyroxene under a red slope, and noise."""
    rng = np.random.default_rng(seed)
    depth = rng.uniform(0.05, 0.3, (2, count, 1))
    bands = sum(
        d * np.exp(-0.5 * ((CHANNELS_NM - c) / w) ** 2) for d, c, w in zip(depth, (950, 1950), (90, 200), strict=True)
    )
    noise = 1 + 0.002 * rng.standard_normal((count, CHANNELS_NM.size))
    return np.asarray((0.08 + 3e-5 * CHANNELS_NM) * np.exp(-bands) * noise)


def write_table(path: Path, spectra: np.ndarray) -> str:
    names = ",".join(f"s{k}" for k in range(len(spectra)))
    values = np.column_stack([CHANNELS_NM, spectra.T])
    np.savetxt(path, values, fmt="%.7g", delimiter=",", header=f"wavelength_nm,{names}", comments="")
    return str(path)


def write_rocks(path: Path, count: int) -> str:
    """What `spectra bands --json` writes of so many rocks."""
    centres = np.random.default_rng(1).uniform(920, 1020, count)
    rocks = [{"id": f"r{k}", "bc1000_nm": float(v), "bc1000_sigma_nm": 4.0} for k, v in enumerate(centres)]
    path.write_text(json.dumps({"schema": "lunarsci/spectra-bands/1", "result": {"spectra": rocks}}))
    return str(path)


COMMANDS = ("fit", "bands", "match", "map")


def case_of(command: str, folder: Path, scale: float = 1.0) -> Case:
    """A command with its input in a folder; it computes some ten blocks where `scale` is 1."""
    from cost_of_m3 import write_envi

    if command == "fit":
        table = write_table(folder / "few.csv", made_up(int(5_000 * scale)))
        return Case(("fit", table, "--assemblage", "OPX-CPX", "--starts", "1"), ".csv", int(1.5e6 * scale))
    if command == "bands":
        return Case(("bands", write_table(folder / "many.csv", made_up(int(20_000 * scale)))), ".csv", int(2e6 * scale))
    if command == "match":
        return Case(("match", write_rocks(folder / "rocks.json", int(2_500 * scale))), ".csv", int(2e5 * scale))
    lines = int(640 * scale)
    write_envi(folder / "cube.img", CHANNELS_NM, made_up(lines * 32).reshape(lines, 32, -1))
    return Case(("map", str(folder / "cube.img"), "--products", "bands"), ".nc", int(1.5e6 * scale))


def run(arguments: list[str], said: str) -> None:
    """A command in this process, its words into a file."""
    from lunarsci.cli import main

    with Path(said).open("w") as file:
        sys.stdout = sys.stderr = file
        code = main(arguments)
    Path(said).with_suffix(".spent").write_text(str(time.process_time()))
    os._exit(code)


def begun(case: Case, target: Path) -> Any:
    process = CONTEXT.Process(target=run, args=(typed(case, target), str(target.with_suffix(".said"))))
    process.start()
    return process


def typed(case: Case, target: Path) -> list[str]:
    return ["spectra", *case.arguments, "-o", str(target), "--no-time", "-q"]


def kept_in(target: Path) -> int:
    return len(list(target.with_name(f"{target.name}.partial").glob("*/*.npz")))


@dataclass(frozen=True)
class Killed:
    """Blocks kept at each kill, whether the end has the bytes of what was never stopped, what was left beside it."""

    kept: list[int]
    same: bool
    left: list[str]


def whole(case: Case, folder: Path) -> tuple[bytes, float]:
    """What a run that is not stopped writes, and the processor seconds of the second one, which need not compile."""
    for name in ("first", "whole"):
        process = begun(case, target := folder / f"{name}{case.suffix}")
        process.join()
        if process.exitcode:
            raise SystemExit(target.with_suffix(".said").read_text())
    return target.read_bytes(), float(target.with_suffix(".spent").read_text())


def spent_s(process: Any) -> float:
    """Processor seconds of a process so far; those of one that has ended are infinite."""
    try:
        fields = Path(f"/proc/{process.pid}/stat").read_text().rpartition(")")[2].split()
    except OSError:
        return float("inf")
    return (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")


def killed(case: Case, folder: Path, wanted: bytes, seconds: float, kills: int, moments: random.Random) -> Killed:
    """Kill it so many times, each at a random moment of those processor seconds; one that ends before begins anew."""
    target, kept, same = folder / f"out{case.suffix}", list[int](), True
    while len(kept) < kills:
        process, moment = begun(case, target), moments.uniform(0.0, seconds)
        while process.is_alive() and spent_s(process) < moment:
            time.sleep(0.005)
        process.kill()
        process.join()
        if process.exitcode == -signal.SIGKILL:
            kept.append(kept_in(target))
        else:
            same = same and target.read_bytes() == wanted
            target.unlink()
    process = begun(case, target)
    process.join()
    left = [path.name for path in folder.iterdir() if path.name.startswith((f".{target.stem}", f"{target.name}."))]
    return Killed(kept, same and process.exitcode == 0 and target.read_bytes() == wanted, left)


def on_small_disk(case: Case, folder: Path, size: int) -> None:
    """In a process of its own: a disk of that size, the same one read-only, the same one with room. Words to a file."""
    from lunarsci.cli import main

    system, disk = ctypes.CDLL(None, use_errno=True), folder / "disk"
    disk.mkdir()

    def mounted(flags: int, room: int) -> None:
        options = f"size={room}".encode()
        if system.mount(b"none", str(disk).encode(), b"tmpfs", flags, options):
            os._exit(77)

    if system.unshare(NEW_MOUNTS | (NEW_USER if os.geteuid() else 0)):
        os._exit(77)
    told = []
    for flags, room in ((0, size), (REMOUNT | READ_ONLY, size), (REMOUNT, 10**9)):
        mounted(flags, room)
        sys.stdout = sys.stderr = io.StringIO()
        code = main(typed(case, target := disk / f"out{case.suffix}"))
        told.append({"code": code, "said": sys.stderr.getvalue().strip(), "kept": kept_in(target)})
    shutil.copy(target, folder / f"disk-out{case.suffix}")
    (folder / "disk.json").write_text(json.dumps(told))


def full_disk(case: Case, folder: Path, wanted: bytes) -> tuple[list[dict[str, Any]], bool]:
    """What is said of each disk, and whether the last run ends as it should; nothing where mounts are not allowed."""
    process = CONTEXT.Process(target=on_small_disk, args=(case, folder, case.disk))
    process.start()
    process.join()
    if process.exitcode == 77:
        return [], False
    told = json.loads((folder / "disk.json").read_text())
    return told, (folder / f"disk-out{case.suffix}").read_bytes() == wanted


def main() -> None:
    """Print what became of each."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("commands", nargs="*", default=COMMANDS)
    parser.add_argument("--kills", type=int, default=10)
    parser.add_argument("--seed", type=int, default=0)
    options = parser.parse_args()
    moments = random.Random(options.seed)
    with tempfile.TemporaryDirectory() as name:
        for command in options.commands:
            folder = Path(name) / command
            folder.mkdir()
            case = case_of(command, folder)
            wanted, seconds = whole(case, folder)
            found = killed(case, folder, wanted, seconds, options.kills, moments)
            print(f"spectra {command}: {seconds:.1f} CPU-s; blocks kept at {len(found.kept)} kills: {found.kept}")
            print(f"  the same bytes: {found.same}; left beside it: {found.left or 'nothing'}", flush=True)
            told, same = full_disk(case, folder, wanted)
            for one in told:
                print(f"  exit {one['code']}, {one['kept']} blocks kept: {one['said'] or 'done'}")
            print(f"  after a full and a read-only disk the same bytes: {same if told else 'not tried here'}")


if __name__ == "__main__":
    main()
