"""A few spoilt files for every reader; many, by `make fuzz`."""

import random
from collections.abc import Callable
from pathlib import Path
from types import ModuleType

import pytest

INPUTS = 60
CRASHERS = {
    "modes": [b"# SYNTHETIC: comments alone\n"],
    "configuration": [b"a = " + b"9" * 5000],
    "keep-outs": [
        b'{"type": "FeatureCollection", "features": [{"type": "Feature", "properties": {"name": "rock"}, '
        b'"geometry": {"type": "Polygon", "coordinates": [[[0, 0], [1e308, 0], [2, 1], [0, 0]]]}}]}'
    ],
    "track": [b"x_m,y m,rut_m " + b"9" * 80_000],
}
"""What once broke the promise."""


@pytest.fixture(scope="module")
def fuzz(load_benchmark: Callable[[str], ModuleType]) -> ModuleType:
    return load_benchmark("fuzz")


def test_every_reader_gives_a_result_or_a_line(fuzz: ModuleType, tmp_path: Path) -> None:
    broken = {}
    for name, reader in fuzz.readers(tmp_path).items():
        for seed in reader.seeds:
            assert fuzz.tried(reader, tmp_path / f"sound{reader.suffix}", seed) == ("read", ""), name
        found = fuzz.tries(reader, INPUTS, 7, tmp_path)
        assert found.refusals, name
        broken |= {f"{name}: {what}": data[:200] for what, data in found.broken.items()}
    assert broken == {}


def test_what_once_broke_it(fuzz: ModuleType, tmp_path: Path) -> None:
    readers = fuzz.readers(tmp_path)
    for name, files in CRASHERS.items():
        for data in files:
            assert fuzz.tried(readers[name], tmp_path / f"crasher{readers[name].suffix}", data)[0] == "refused", name


def test_what_breaks_the_promise_is_seen(fuzz: ModuleType, tmp_path: Path) -> None:
    """Readers that fail on purpose, each in a way of its own."""

    def foreign(path: Path) -> None:
        raise KeyError(path.name)

    def endless(path: Path) -> None:
        while path:
            pass

    fuzz.SLOWEST_S = 0.2
    for read, said in ((foreign, "KeyError"), (endless, "slower")):
        found = fuzz.tries(fuzz.Reader(read, ".txt", [b"1 2 3"]), 1, 1, tmp_path)
        assert [what for what in found.broken if said in what], said


def test_mutations_change_files(fuzz: ModuleType) -> None:
    draw = random.Random(1)
    sound = b"wavelength_nm,reflectance\n500,0.1\n510,0.2\n"
    made = {fuzz.mutated(sound, draw) for _ in range(500)}
    assert len(made) > 350
    assert any(len(data) > 2000 for data in made)
