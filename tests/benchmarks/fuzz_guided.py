"""Spoilt files of one reader, guided by the branches of lunarsci that they reach: libFuzzer, by atheris.

`fuzz.py` runs it where atheris is installed. Modules with compiled functions are not watched, for numba reads bytecode.
"""

import argparse
import importlib.util
import os
import random
import resource
import shutil
import sys
import tempfile
import time
from pathlib import Path

import atheris

COMPILED = ("lunarsci.compiled", "lunarsci.compiled.formulas", "lunarsci.compiled.lanes")
OWN_SHARE = 0.7
"""Of the mutations that know of numbers, words and lines; the others are libFuzzer's."""
LARGEST_INPUT = 200_000


def compiled_modules() -> list[str]:
    """Names of modules that import what compiles."""
    spec = importlib.util.find_spec("lunarsci")
    assert spec is not None
    [package] = spec.submodule_search_locations or []
    return [
        ".".join(("lunarsci", *file.relative_to(package).with_suffix("").parts))
        for file in Path(package).rglob("*.py")
        if any(name in file.read_text("utf-8") for name in COMPILED)
    ]


def main() -> None:
    """Try inputs until their number is reached; what was found is in the file of `--child`."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("reader")
    parser.add_argument("--inputs", type=int)
    parser.add_argument("--seconds", type=float)
    parser.add_argument("--seed", type=int)
    parser.add_argument("--child", type=Path)
    asked = parser.parse_args()
    with tempfile.TemporaryDirectory() as place, atheris.instrument_imports(["lunarsci"], compiled_modules()):
        import fuzz
        import fuzz_readers

        reader = fuzz_readers.reader_of(asked.reader)
        folder = fuzz.prepare(reader, Path(place) / "files")
        resource.setrlimit(resource.RLIMIT_AS, (2 * fuzz.MOST_BYTES, 2 * fuzz.MOST_BYTES))
        account, end_s = fuzz.Account(asked.child), time.process_time() + asked.seconds
        corpus = asked.child.parent / f"{fuzz.slug(asked.reader)}.corpus"
        corpus.mkdir(exist_ok=True)
        for number, seed in enumerate(reader.seeds):
            (corpus / f"seed-{number}").write_bytes(seed)

        def one(data: bytes) -> None:
            account.at(data)
            begun = time.process_time()
            end, said = fuzz.tried(reader, folder, data)
            account.found.add(end, said, data, time.process_time() - begun)
            done = account.found.inputs >= asked.inputs or time.process_time() > end_s
            account.keep(done=done)
            if done:
                shutil.rmtree(place)
                os._exit(0)

        def change(data: bytes, most: int, seed: int) -> bytes:
            draw = random.Random(seed)
            if draw.random() < OWN_SHARE:
                return bytes(fuzz.mutated(data, draw)[:most])
            return bytes(atheris.Mutate(data, most))

        flags = [
            f"-artifact_prefix={place}/",
            "-timeout=86400",
            "-verbosity=0",
            f"-max_len={LARGEST_INPUT}",
            f"-seed={asked.seed}",
        ]
        flags += ["-rss_limit_mb=0", "-len_control=0", "-detect_leaks=0"]
        atheris.Setup([sys.argv[0], *flags, str(corpus)], one, custom_mutator=change)
        atheris.Fuzz()


if __name__ == "__main__":
    main()
