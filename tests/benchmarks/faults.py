"""Commands that are stopped, and go on: `python tests/benchmarks/faults.py [--kills 10] [--seed 0] [COMMAND ...]`.

`python tests/benchmarks/faults.py writes` kills commands of all parts at each of their calls that write instead.

`spectra fit`, `bands`, `match` and `map` of SYNTHETIC spectra are run whole; then each is killed (SIGKILL) at random
moments of the processor time that it took, given again each time, and at last let end; then given a disk that is full
half-way, that cannot be written, and that has room again. What ends must have the bytes of what was never stopped.
"""

import argparse
import contextlib
import ctypes
import gc
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
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any
from unittest import mock

import numpy as np

from lunarsci.io import atomic

CHANNELS_NM = np.linspace(460.0, 2400.0, 60)
NEW_USER, NEW_MOUNTS, READ_ONLY, REMOUNT = 0x10000000, 0x00020000, 1, 32
CONTEXT = multiprocessing.get_context("forkserver")
CONTEXT.set_forkserver_preload(["lunarsci.cli", "lunarsci.spectra.jobs.fit", "lunarsci.spectra.mgm.fit", "scipy.stats",
                                "lunarsci.spectra.bands", "pandas", "faults"])  # fmt: skip


@dataclass(frozen=True)
class Case:
    """A command without `-o`, the suffix of what it writes, and bytes of a disk that holds some of its blocks.

    `ends` is its exit code: of many made-up spectra some are fitted by strained bands.
    """

    arguments: tuple[str, ...]
    suffix: str
    disk: int
    ends: int = 0


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
        return Case(("fit", table, "--assemblage", "OPX-CPX", "--starts", "1"), ".csv", int(1.5e6 * scale), 3)
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
        if process.exitcode != case.ends:
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
    return Killed(kept, same and process.exitcode == case.ends and target.read_bytes() == wanted, left)


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


# --- killed at each call that writes ---

CHANGES = {"open", "os.rename", "os.link", "os.symlink", "os.remove", "os.rmdir", "os.mkdir", "os.chmod", "os.truncate",
           "shutil.rmtree", "tempfile.mkstemp", "tempfile.mkdtemp", "ctypes.dlsym"}  # fmt: skip
"""Events of Python that change names, or make files; the last is before two folders swap their names."""
METHODS = {"write", "writelines", "flush", "truncate", "fsync", "sendfile", "copy_file_range"}
"""Functions in C that change what is in files, or that bring it to the disk."""
FILES = (io.FileIO, io.BufferedWriter, io.BufferedRandom, io.TextIOWrapper)
Files = dict[str, bytes]


class Calls:
    """Calls of this process that change something in a folder; `met` is called just before each of them."""

    met: Callable[[], None] | None = None
    _folder = ""

    def __init__(self) -> None:
        sys.addaudithook(self._event)

    def watch(self, folder: Path, met: Callable[[], None], *, names_alone: bool = False) -> None:
        self._folder, self.met = str(folder), met
        sys.setprofile(None if names_alone else self._call)

    def rest(self) -> None:
        self.met = None
        sys.setprofile(None)

    def _within(self, path: Any, folder: int = -1) -> bool:
        """Whether a path, or the number of an open file, is in the folder that is watched."""
        if isinstance(path, int):
            path = _open_as(path)
        base = _open_as(folder) if folder >= 0 else ""
        return os.path.abspath(os.path.join(base, os.fsdecode(path))).startswith(self._folder)  # noqa: PTH100, PTH118

    def _event(self, event: str, given: tuple[Any, ...]) -> None:
        if self.met is None or event not in CHANGES:
            return
        if event == "open":
            mine = bool(given[2] & (os.O_WRONLY | os.O_RDWR | os.O_CREAT)) and self._within(given[0])
        elif event == "ctypes.dlsym":
            mine = given[1] == "renameat2"
        else:
            folder = given[-1] if event in ("os.remove", "os.rmdir", "os.mkdir", "shutil.rmtree") else None
            paths = given[:2] if event in ("os.rename", "os.link", "os.symlink") else given[:1]
            mine = any(self._within(path, -1 if folder is None else folder) for path in paths)
        if mine:
            self.met()

    def _call(self, frame: Any, event: str, called: Any) -> None:
        if self.met is None or event != "c_call" or called.__name__ not in METHODS:
            return
        file = called.__self__
        opened = isinstance(file, FILES) and not file.closed
        if file is sys.modules["posix"] or (opened and self._within(file.fileno())):
            self.met()


def _open_as(number: int) -> str:
    return os.readlink(f"/proc/self/fd/{number}")  # noqa: PTH115


def all_files(folder: Path) -> Files:
    """Names in a folder, hidden ones and those in other folders too, and what is in them."""
    return {str(file.relative_to(folder)): file.read_bytes() for file in sorted(folder.rglob("*")) if file.is_file()}


def _restore(folder: Path, files: Files) -> None:
    for name in sorted(path for path in folder.iterdir()):
        shutil.rmtree(name) if name.is_dir() else name.unlink()
    for path, content in files.items():
        (folder / path).parent.mkdir(parents=True, exist_ok=True)
        (folder / path).write_bytes(content)


def by_target(files: Files) -> dict[str, Files]:
    """The same by the first part of the name, so that a folder is one thing; without temporary files."""
    found: dict[str, Files] = {}
    for path, content in files.items():
        first = Path(path).parts[0]
        if not first.startswith(".") and not first.endswith(".partial"):
            found.setdefault(first, {})[path] = content
    return found


@dataclass
class Writes:
    """Of a command killed at each of its calls that write: how often, what it wrote, what was wrong at which call, and
    what all of it took of the processor."""

    kills: int
    targets: list[str]
    wrong: list[str]
    seconds: float = 0.0


class _Known(BaseException):
    """All is known of this command: the process that computed it need not write."""


def killed_at_each_write(
    act: Callable[[], Any], folder: Path, calls: Calls, *, points: range = range(1, 1000), from_the_start: bool = False
) -> Writes:
    """Kill what `act` does in the folder at each call that changes it, or at some `points`; after each let it end.

    What is computed, and what the files will hold, is made once: where `act` begins to write the process forks, once
    for every call and once more for the run that ends. `from_the_start`: it forks before, as what is written on the
    way decides what is computed.
    """
    parent, found, begun = os.getpid(), Writes(0, [], []), False

    def forked(kill_at: int) -> int | None:
        """Go on in a fork, which dies at that call (0: never). The exit code, or - signal; None is the fork."""
        if child := os.fork():
            return os.waitstatus_to_exitcode(os.waitpid(child, 0)[1])
        passed = 0

        def count() -> None:
            nonlocal passed
            passed += 1
            if passed == kill_at:
                os.kill(os.getpid(), signal.SIGKILL)

        calls.watch(folder, count)
        return None

    def begin() -> None:
        nonlocal begun
        if begun:
            return
        begun = True
        calls.rest()
        gc.freeze()  # or every fork would copy what the collector looks at
        before = all_files(folder)
        if (code := forked(0)) is None:
            return
        after = all_files(folder)
        old, new = by_target(before), by_target(after)
        found.targets = [name for name in new if new[name] != old.get(name)]
        left = [name for name in after if name not in before and Path(name).parts[0] not in new]
        found.wrong += [f"exit code {code}"] * (code not in (0, 3)) + [f"left behind: {name}" for name in left]
        for point in points:
            _restore(folder, before)
            if (code := forked(point)) is None:
                return
            if code != -signal.SIGKILL:
                break
            found.kills += 1
            now = by_target(all_files(folder))
            mixed = [name for name in old | new | now if now.get(name) not in (old.get(name), new.get(name))]
            found.wrong += [f"call {point}: {name} is neither old nor new" for name in mixed]
            if forked(0) is None:
                return
            ended = all_files(folder)
            other = [name for name in ended | after if ended.get(name) != after.get(name)]
            found.wrong += [f"call {point}, then let end: {name}" for name in other]
        raise _Known

    def write(contents: dict[Path, Any], **named: Any) -> None:
        made = {path: data if begun or isinstance(data, bytes) else list(data) for path, data in contents.items()}
        begin()
        atomic.write_files(made, **named)

    code = 99
    try:
        with mock.patch("lunarsci.cli.shared.emit.write_files", write):
            calls.watch(folder, begin, names_alone=True)
            if from_the_start:
                begin()
            code = int(act() or 0)
    except _Known:
        return found
    finally:
        calls.rest()
        if os.getpid() != parent:
            os._exit(code)
    found.wrong.append(f"exit code {code}, nothing was written")
    return found


ROCK = "ol=0.1,opx=0.4,cpx=0.2,plg=0.3"
DRIVE = """name = "short"
[drive]
speed_m_s = 0.05
[[leg]]
length_m = 1.0
"""
WRITERS: dict[str, tuple[str, str]] = {
    "spectra": ("spectra calibrate ../scene -o rock.ecsv", "rock.ecsv"),
    "bands and picture": ("spectra bands rock.ecsv -o bands.csv --plot bands.png", "bands.csv bands.png"),
    "fit": ("spectra fit rock.ecsv --assemblage OPX-CPX --starts 1 -o fit.json", "fit.json"),
    "map": ("spectra map cube.img --products bands -o map.nc", "map.nc"),
    "library": ("spectra library import rock.ecsv --mineral other -o library.ecsv", "library.ecsv"),
    "soil and picture": ("regolith identify wheels.csv --lateral-modulus 20 -o soil.json --plot soil.pdf",
                         "soil.json soil.pdf"),
    "ground": ("twin terrain synthetic --extent 4 --spacing 0.05 --seed 2 --rocks 0.03 -o ground", "ground/"),
    "way": ("twin plan --target 2,0.3 -o site", "site/"),
    "prediction": ("twin predict short.toml --sweep cohesion_pa=200:900:2 -o predicted --plot predicted.png",
                   "predicted/ predicted.png"),
    "drive": ("twin simulate short.toml --seed 5 -o drive", "drive/"),
    "states": ("twin states drive/telemetry.csv short.toml --track drive/track.csv -o states", "states/"),
    "belief": ("twin update states/states.csv --plan short.toml --positions states/positions.csv --seed 1 --no-ruts "
               "--particles 32 --save belief.json --save-map soils.json -o update.json",
               "belief.json soils.json update.json"),
    "comparison": ("twin compare predicted states/states.csv -o compared.csv", "compared.csv"),
    "track": ("images track ground/terrain.npz --line 0,1,2.5,1.2 --step 0.5 -o track.csv --plot track.svg",
              "track.csv track.svg"),
    "pictures": ("images render --rig small.toml --rays 1 -o pair", "pair/"),
    "report": ("report fit.json predicted -o report.html", "report.html"),
    "first file": ("template rover -o rover.toml", ""),
    "first folder": ("twin terrain synthetic --extent 4 --spacing 0.1 --seed 2 -o first", ""),
}  # fmt: skip
"""Commands of all kinds, and what of theirs is there already, to be replaced; folders with a / at the end. Later ones
read what earlier ones wrote."""


def killed_writers(place: str, told: str, names: Sequence[str], every: int) -> None:
    """In a process of its own: what became of each command at its calls that write, into a file.

    Of `every` calls one is taken, another one for each command.
    """
    from lunarsci.images.rig_files import read_rig, rig_text

    folder, calls, found = Path(place), Calls(), {}
    os.chdir(folder)
    _said(f"spectra simulate --rock {ROCK} --seed 3 -o ../scene")
    Path("short.toml").write_text(DRIVE)
    Path("small.toml").write_text(rig_text(read_rig("yutu2-hazcam").with_pixels(64)))
    Path("wheels.csv").write_text(_said("twin forces short.toml --csv")[1])
    case_of("map", folder, 4 / 640)
    _said("spectra map cube.img --products bands -o ../map.nc")  # forks of it then begin with all that it imports
    for number, (name, (line, targets)) in enumerate(WRITERS.items()):
        if name in names:
            for target in targets.split():
                _leave_old(target)
            before = sum(os.times()[:4])
            typed = f"{line} --force" if targets else line
            points = range(1 + number % every, 1000, every)
            one = killed_at_each_write(lambda typed=typed: _said(typed)[0], folder, calls, points=points,
                                       from_the_start=name == "map")  # fmt: skip
            found[name] = asdict(replace(one, seconds=sum(os.times()[:4]) - before))
            Path(told).write_text(json.dumps(found))
        else:
            _said(line)


def _said(line: str) -> tuple[int, str]:
    """Exit code and stdout of a command in this process."""
    from lunarsci.cli import main

    out = io.StringIO()
    with contextlib.redirect_stdout(out), contextlib.redirect_stderr(io.StringIO()):
        code = main([*line.split(), "--no-time", "-q"])
    return code, out.getvalue()


def killed_at_writes(folder: Path, names: Sequence[str] = tuple(WRITERS), every: int = 1) -> dict[str, Writes]:
    """What became of each command, killed at its calls that write: at one of `every`."""
    (folder / "work").mkdir()
    process = CONTEXT.Process(
        target=killed_writers, args=(str(folder / "work"), str(folder / "writes.json"), names, every)
    )
    process.start()
    process.join()
    found = json.loads((folder / "writes.json").read_text())
    return {name: Writes(**one) for name, one in found.items()}


def _leave_old(target: str) -> None:
    """What an earlier run left under a name; in a folder, of another run and of the user's too."""
    if target.endswith("/"):
        Path(target).mkdir()
        for name in ("result.json", "old.csv", "notes of the user.txt"):
            (Path(target) / name).write_text("old")
    else:
        Path(target).write_text("old")


def main() -> None:
    """Print what became of each."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("commands", nargs="*", default=COMMANDS)
    parser.add_argument("--kills", type=int, default=10)
    parser.add_argument("--seed", type=int, default=0)
    options = parser.parse_args()
    if options.commands == ["writes"]:
        with tempfile.TemporaryDirectory() as name:
            for command, writes in killed_at_writes(Path(name)).items():
                what = "; ".join(writes.wrong[:5]) or "each old or new, nothing left"
                told = f"{writes.kills:3d} kills of {', '.join(writes.targets)}, {writes.seconds:.1f} CPU-s"
                print(f"{command:18s} {told}: {what}")
        return
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
