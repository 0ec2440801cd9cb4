"""Spoilt files for every reader: each gives a result or one line that says what is wrong, soon and in little memory.

`python tests/benchmarks/fuzz.py --inputs 100000 --keep FOLDER [READER...]`, or `make fuzz`. Mutations know of numbers,
words, lines, columns and brackets; what gets a refusal that had not been given before is mutated further.

Each reader is tried in a process of its own, some thousand inputs at a time, in turns: what is in the folder is not
tried again, and a process that dies is a promise broken. Prints a line a reader; what breaks the promise is kept.
"""

import argparse
import contextlib
import itertools
import json
import os
import random
import re
import resource
import signal
import subprocess
import sys
import tempfile
import time
import warnings
from collections.abc import Callable, Iterable, Iterator
from dataclasses import asdict, dataclass, field
from pathlib import Path

from fuzz_readers import BETWEEN, Reader, reader_of, readers
from lunarsci.cli.shared.talk import failure_line

from lunarsci.errors import LunarSciError
from lunarsci.printable import LONGEST, printable

SLOWEST_S, MOST_BYTES = 5.0, 2 << 30
STUCK_S = 60.0
"""What runs so long without an answer even to the alarm is killed."""
LARGEST_INPUT = 2_000_000
NUMBERS = [b"", b"9" * 30, b"9" * 5000, b"\xef\xbc\x91"]
NUMBERS += b"nan inf -inf 1e999 -1e308 1e-320 0 -0 -1 1e 0x10 --1 1,5 1.5.2 1_000 99999 -9999 1e6 true [] null".split()
NUMBERS += b"2**64 0.0000001 3.4028235e38 2147483648 -32768".split()
WORDS = rb"""\x1b[31m =cmd|x ' " ../../etc/passwd %s%n {} # NaN None -- wavelength_nm x_m source""".split()
WORDS += [b"", b" ", b"\x1b[31m", b"\x00", b"\r", b"a" * 10_000, b"\xff\xfe", b"\xe2\x80\xae", b"\xef\xbb\xbf"]
NUMBER = re.compile(rb"-?\d+\.?\d*(?:[eE][+-]?\d+)?")
WORD = re.compile(rb"[A-Za-z_]{2,}")


@dataclass
class Found:
    """Of a reader: inputs, how many were read and refused, what broke the promise and by which input, and the most
    time and memory."""

    inputs: int = 0
    read: int = 0
    refusals: dict[str, int] = field(default_factory=dict)
    broken: dict[str, bytes] = field(default_factory=dict)
    slowest_s: float = 0.0
    peak_mb: float = 0.0

    def add(self, end: str, said: str, data: bytes, seconds: float) -> None:
        self.inputs += 1
        self.slowest_s = max(self.slowest_s, seconds)
        self.peak_mb = max(self.peak_mb, resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024)
        if end == "broken":
            self.broken.setdefault(said, data)
        elif end == "read":
            self.read += 1
        else:
            self.refusals[said] = self.refusals.get(said, 0) + 1


def mutated(data: bytes, draw: random.Random) -> bytes:
    """The data with one to four things changed."""
    for _ in range(draw.choice((1, 1, 1, 2, 4))):
        data = draw.choice(CHANGES)(data, draw)
    return data


def _token(pattern: re.Pattern[bytes], others: list[bytes]) -> Callable[[bytes, random.Random], bytes]:
    def change(data: bytes, draw: random.Random) -> bytes:
        places = list(itertools.islice(pattern.finditer(data), 3000))
        if not places:
            return data
        # Headers decide most: half of the time something near the beginning.
        place = draw.choice(places[:40] if draw.random() < 0.5 else places)
        new = draw.choice(others) if draw.random() < 0.8 else draw.choice(places)[0]
        return data[: place.start()] + new + data[place.end() :]

    return change


def _bytes(data: bytes, draw: random.Random) -> bytes:
    at = draw.randrange(len(data) + 1)
    return data[:at] + draw.randbytes(draw.choice((1, 1, 2, 8))) + data[at + draw.choice((0, 1, 1, 4)) :]


def _cut(data: bytes, draw: random.Random) -> bytes:
    return data[: draw.randrange(len(data) + 1)]


def _hole(data: bytes, draw: random.Random) -> bytes:
    at, size = draw.randrange(len(data) + 1), int(draw.paretovariate(0.5))
    return data[:at] + data[at + size :]


def _repeat(data: bytes, draw: random.Random) -> bytes:
    at, size = draw.randrange(len(data) + 1), min(int(draw.paretovariate(0.4)), 2000)
    return data[:at] + data[at : at + size] * draw.choice((2, 3, 50)) + data[at + size :]


def _lines(data: bytes, draw: random.Random) -> bytes:
    lines = data.split(b"\n")
    one, other = draw.randrange(len(lines)), draw.randrange(len(lines))
    kind = draw.randrange(4)
    if kind == 0:
        lines[one], lines[other] = lines[other], lines[one]
    elif kind == 1:
        lines.insert(one, lines[other])
    elif kind == 2:
        del lines[one]
    else:
        lines[one] = lines[one].replace(b",", draw.choice((b";", b"\t", b",,", b"")), 1)
    return b"\n".join(lines)


def _deep(data: bytes, draw: random.Random) -> bytes:
    at = draw.randrange(len(data) + 1)
    return data[:at] + draw.choice((b"[", b'{"a":', b"(", b"[[", b"<a>")) * draw.choice((10, 3000)) + data[at:]


CHANGES = [
    _token(NUMBER, NUMBERS),
    _token(NUMBER, NUMBERS),
    _token(WORD, WORDS),
    _bytes,
    _cut,
    _hole,
    _repeat,
    _lines,
    _deep,
]


@contextlib.contextmanager
def alarm(seconds: float) -> Iterator[None]:
    """TimeoutError after so many seconds of the processor, which others that compute do not change."""

    def ring(*_: object) -> None:
        raise TimeoutError

    signal.signal(signal.SIGPROF, ring)
    signal.setitimer(signal.ITIMER_PROF, seconds)
    try:
        yield
    finally:
        signal.setitimer(signal.ITIMER_PROF, 0.0)


def write(reader: Reader, folder: Path, data: bytes) -> Path:
    """The files of an input; the path of the first one."""
    parts = data.split(BETWEEN, len(reader.names) - 1)
    for name, part in itertools.zip_longest(reader.names, parts):
        if part is None:
            (folder / name).unlink(missing_ok=True)
        else:
            (folder / name).write_bytes(part)
    return folder / reader.names[0]


def tried(reader: Reader, folder: Path, data: bytes) -> tuple[str, str]:
    """`read`, `refused` or `broken`, and what was said."""
    before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss << 10
    try:
        path = write(reader, folder, data)
        with warnings.catch_warnings(), alarm(SLOWEST_S):
            warnings.simplefilter("ignore")
            reader.read(path)
    except LunarSciError as error:
        said = failure_line(error)
        if len(said) > LONGEST:
            return "broken", f"a line of {len(said)} characters: {said[:40]}"
        return "refused", re.sub(r"[-\d.'\"]+|\S*/\S*", "", printable(said))[:60]
    except TimeoutError:
        return "broken", f"slower than {SLOWEST_S:g} s"
    except BaseException as error:
        return "broken", f"{type(error).__name__} at {_place(error)}: {printable(str(error)[:80])}"
    if before < MOST_BYTES < resource.getrusage(resource.RUSAGE_SELF).ru_maxrss << 10:
        return "broken", "more than 2 GB of memory"
    return "read", ""


def _place(error: BaseException) -> str:
    """The innermost line of lunarsci."""
    trace, where = error.__traceback__, ""
    while trace:
        name = trace.tb_frame.f_code.co_filename
        if "/lunarsci/" in name and "site-packages" not in name:
            where = f"{Path(name).name}:{trace.tb_lineno}"
        trace = trace.tb_next
    return where


def tries(
    reader: Reader,
    inputs: int,
    seed: int,
    folder: Path,
    told: Callable[[bytes], None] | None = None,
    seconds: float = float("inf"),
) -> Found:
    """Spoil files of one reader in a folder, for so long at most; `told` gets each before it is tried."""
    draw, found = random.Random(seed), Found()
    others: list[bytes] = []
    end_s = time.process_time() + seconds
    for _ in range(inputs):
        if time.process_time() > end_s:
            break
        data = mutated(draw.choice(others if others and draw.random() < 0.4 else reader.seeds), draw)[:LARGEST_INPUT]
        if told is not None:
            told(data)
        begun = time.process_time()
        end, said = tried(reader, folder, data)
        if end == "refused" and said not in found.refusals and len(others) < 200 and len(data) < 100_000:
            others.append(data)
        found.add(end, said, data, time.process_time() - begun)
    return found


def prepare(reader: Reader, folder: Path) -> Path:
    """A folder with what lies beside the files of a reader, which has read its seeds: what is compiled is then."""
    folder.mkdir(parents=True, exist_ok=True)
    for name, data in reader.beside.items():
        (folder / name).write_bytes(data)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        for seed in reader.seeds:
            reader.read(write(reader, folder, seed))
    return folder


# --- many, in processes of their own ---


def slug(name: str) -> str:
    return re.sub(r"\W+", "-", name)


def child(name: str, inputs: int, seconds: float, seed: int, file: Path) -> None:
    """Try some inputs of a reader, and write what was found; the input that it is at lies beside that."""
    resource.setrlimit(resource.RLIMIT_AS, (2 * MOST_BYTES, 2 * MOST_BYTES))
    with tempfile.TemporaryDirectory() as place:
        reader = reader_of(name)
        folder = prepare(reader, Path(place))
        write_found(tries(reader, inputs, seed, folder, file.with_suffix(".now").write_bytes, seconds), file)


def write_found(found: Found, file: Path) -> None:
    file.write_text(json.dumps(asdict(found) | {"broken": {what: data.hex() for what, data in found.broken.items()}}))


def run(name: str, inputs: int, seconds: float, seed: int, folder: Path) -> None:
    """Try some inputs of a reader in a process; one that dies or hangs is what its last input did."""
    file = folder / f"{slug(name)}.{seed}.json"
    now, said = file.with_suffix(".now"), file.with_suffix(".said")
    command = [sys.executable, __file__, name, "--child", str(file), "--inputs", str(inputs)]
    command += ["--seconds", str(seconds), "--seed", str(seed)]
    with said.open("w") as heard:
        process = subprocess.Popen(command, stdout=heard, stderr=heard, env=os.environ | {"OMP_NUM_THREADS": "1"})
    begun = time.time()
    while process.poll() is None:
        with contextlib.suppress(subprocess.TimeoutExpired):
            process.wait(1.0)
        if time.time() - max(begun, now.stat().st_mtime if now.exists() else 0.0) > STUCK_S:
            process.kill()
    if not file.exists():
        what = f"the process ended with {process.returncode}: {said.read_text(errors='replace')[-300:]}"
        write_found(Found(inputs=1, broken={what: now.read_bytes() if now.exists() else b""}), file)
    for left in (now, said):
        left.unlink(missing_ok=True)


def summed(name: str, folder: Path) -> Found:
    """All that is known of a reader."""
    whole = Found()
    for file in folder.glob(f"{slug(name)}.*.json"):
        one = json.loads(file.read_text())
        whole.inputs += one["inputs"]
        whole.read += one["read"]
        whole.slowest_s = max(whole.slowest_s, one["slowest_s"])
        whole.peak_mb = max(whole.peak_mb, one["peak_mb"])
        whole.refusals |= one["refusals"]
        whole.broken |= {what: bytes.fromhex(data) for what, data in one["broken"].items()}
    return whole


def show(names: Iterable[str], folder: Path) -> int:
    """Print a line a reader, and what broke the promise, whose inputs are kept; how many there are."""
    bad = 0
    for name in names:
        found = summed(name, folder)
        print(f"{name:20s} {found.inputs:8,} inputs, {found.read:7,} read, {len(found.refusals):4d} kinds of refusal, "
              f"slowest {found.slowest_s:.2f} s, {found.peak_mb:.0f} MB at most, {len(found.broken)} broken promises",
              flush=True)  # fmt: skip
        for number, (what, data) in enumerate(found.broken.items()):
            file = folder / f"{slug(name)}-{number}.broken"
            file.write_bytes(data)
            print(f"    {what}   [{file}]")
        bad += len(found.broken)
    return bad


def main() -> int:
    """Print a line a reader; 1 where any broke the promise."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("reader", nargs="*")
    parser.add_argument("--inputs", type=int, default=100_000)
    parser.add_argument("--at-once", type=int, default=5000, help="inputs of a reader before the next one's turn")
    parser.add_argument("--seconds", type=float, default=60.0, help="of the processor, likewise")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--minutes", type=float, default=float("inf"))
    parser.add_argument("--show", action="store_true", help="what is known already")
    parser.add_argument("--keep", type=Path, default=Path(tempfile.gettempdir()) / "lunarsci-fuzz")
    parser.add_argument("--child", type=Path, help=argparse.SUPPRESS)
    asked = parser.parse_args()
    if asked.child:
        child(asked.reader[0], asked.inputs, asked.seconds, asked.seed, asked.child)
        return 0
    names = asked.reader or list(readers())
    asked.keep.mkdir(parents=True, exist_ok=True)
    end = 0.0 if asked.show else time.monotonic() + 60 * asked.minutes
    for turn in itertools.count(asked.seed):
        lacking = {name: asked.inputs - summed(name, asked.keep).inputs for name in names}
        if time.monotonic() >= end or max(lacking.values()) <= 0:
            break
        for name, inputs in lacking.items():
            if inputs > 0 and time.monotonic() < end and not (asked.keep / f"{slug(name)}.{turn}.json").exists():
                run(name, min(inputs, asked.at_once), asked.seconds, turn, asked.keep)
    return min(show(names, asked.keep), 1)


if __name__ == "__main__":
    sys.exit(main())
