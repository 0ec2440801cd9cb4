"""How far every answer moves from one processor to another: `python tests/benchmarks/processors.py [NAME ...]`.

The commands of `tests/benchmarks/former.py`, SYNTHETIC throughout, in one process a setting: numpy without its vector
instructions, OpenBLAS with the kernels of an older processor, numba with the instructions that every x86-64 has. What a
processor computes otherwise is chosen by these; the rest of it is IEEE 754. For each setting and command, the number
that moves most as a share of its size, and whatever else is not the same. Compiles everything anew for each setting.
"""

import argparse
import itertools
import json
import math
import os
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from pathlib import Path
from typing import Any

sys.path.insert(0, str(Path(__file__).parents[1]))

VECTORS = "AVX2 FMA3 X86_V3 AVX512F AVX512CD AVX512_SKX AVX512_CLX AVX512_CNL AVX512_ICL AVX512_SPR X86_V4"
SETTINGS: dict[str, dict[str, str]] = {
    "here": {},
    "numpy": {"NPY_DISABLE_CPU_FEATURES": VECTORS},
    "blas": {"OPENBLAS_CORETYPE": "Haswell"},
    "old-blas": {"OPENBLAS_CORETYPE": "Nehalem"},
    "both": {"NPY_DISABLE_CPU_FEATURES": VECTORS, "OPENBLAS_CORETYPE": "Nehalem"},
    "numba": {"NUMBA_CPU_NAME": "generic", "NUMBA_CPU_FEATURES": ""},
    "all": {
        "NPY_DISABLE_CPU_FEATURES": VECTORS,
        "OPENBLAS_CORETYPE": "Nehalem",
        "NUMBA_CPU_NAME": "generic",
        "NUMBA_CPU_FEATURES": "",
    },
}
"""Environment of each setting; the first is what the others are held against."""


def moves(one: Any, other: Any, place: str = "") -> Iterator[tuple[float, str]]:
    """Of every value that is not the same: how far apart as a share of its size (infinite where it is no number)."""
    if isinstance(one, dict) and isinstance(other, dict) and one.keys() == other.keys():
        for key in one:
            yield from moves(one[key], other[key], f"{place}.{key}")
    elif isinstance(one, list) and isinstance(other, list) and len(one) == len(other):
        for number, pair in enumerate(zip(one, other, strict=True)):
            yield from moves(*pair, f"{place}.{number}")
    elif one != other:
        numbers = all(isinstance(value, int | float) and not isinstance(value, bool) for value in (one, other))
        share = abs(one - other) / max(abs(one), abs(other)) if numbers else math.inf
        yield share, f"{place}: {one!r}, {other!r}"


def answers_in(setting: str, commands: list[str], folder: Path, compiled: Path | None = None) -> dict[str, Any]:
    """Answers of a process of its own with that environment; numba knows apart what it compiled for which processor.

    `compiled` : folder of what was compiled; one in `folder` if left out.
    """
    target = folder / f"{setting}.json"
    environment = os.environ | {f"{library}_NUM_THREADS": "1" for library in ("OPENBLAS", "OMP", "MKL")}
    environment |= {"NUMBA_CACHE_DIR": str(compiled or folder / "compiled"), **SETTINGS[setting]}
    subprocess.run(
        [sys.executable, __file__, "--write", str(target), "--commands", *commands], env=environment, check=True
    )
    found: dict[str, Any] = json.loads(target.read_text("utf-8"))
    return found


def needed(commands: list[str]) -> list[str]:
    """These entries of `COMMANDS`, and those before them that write what they read."""
    import former

    lines = former.COMMANDS
    files = {**former.FILES, **former.CSV_FILES}
    chosen = set(commands or lines)
    for name, line in reversed(lines.items()):
        words = line.split()
        makes = [new for option, new in itertools.pairwise(words) if option in ("-o", "--save", "--save-map")]
        makes += [file for file, of in files.items() if of == name]
        read = {word.partition("/")[0] for other in chosen - {name} for word in lines[other].split()}
        if read & set(makes):
            chosen.add(name)
    return [name for name in lines if name in chosen]


def write(commands: list[str], target: Path) -> None:
    """Run the commands in this process, and before them those that write what they read."""
    import former

    chosen = {name: former.COMMANDS[name] for name in needed(commands)}
    with tempfile.TemporaryDirectory() as folder:
        target.write_text(json.dumps(former.answers(Path(folder), chosen)), "utf-8")


def main() -> None:
    """Print a line for each setting and command whose answer is not to the bit that of the first."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("settings", nargs="*", default=list(SETTINGS)[1:])
    parser.add_argument("--commands", nargs="*", default=[], help="entries of COMMANDS there; by default all")
    parser.add_argument("--write", type=Path, help=argparse.SUPPRESS)
    parser.add_argument("--keep", type=Path, help="folder of the answers and of what was compiled")
    parser.add_argument("--least", type=float, default=0.0, help="moves below this share are not printed")
    options = parser.parse_args()
    if options.write:
        return write(options.commands, options.write)
    with tempfile.TemporaryDirectory() as name:
        folder = options.keep or Path(name)
        folder.mkdir(exist_ok=True)
        first = answers_in("here", options.commands, folder)
        for setting in options.settings:
            found = answers_in(setting, options.commands, folder)
            for command in first:
                moved = sorted(moves(first[command], found[command]), reverse=True)
                if moved and moved[0][0] >= options.least:
                    told = f"{len(moved):5d} moved, most {moved[0][0]:.1e}{moved[0][1]}"
                    print(f"{setting:9s} {command:18s} {told}", flush=True)


if __name__ == "__main__":
    main()
