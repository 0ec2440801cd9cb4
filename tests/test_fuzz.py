"""A few spoilt files for every reader; many, by `make fuzz`."""

import random
from collections.abc import Callable
from pathlib import Path
from types import ModuleType

import pytest

INPUTS, SECONDS = 60, 1.0
PICTURE = (
    b"<a><offset>0</offset><data_type>UnsignedByte</data_type><axis_array><axis_name>Line</axis_name><elements>24"
    b"</elements></axis_array><axis_array><axis_name>Sample</axis_name><elements>32</elements></axis_array></a>"
    b"\n--- next file ---\n" + bytes(range(256)) * 3
)
CRASHERS = {
    "modes": [b"# SYNTHETIC: comments alone\n"],
    "fitted rocks": [
        b'{"schema": "lunarsci/spectra-fit/1", "result": {"spectra": [{"id": "rock", "nbsr": {"um2": {"opx": 0.46, '
        b'"cpx": 0.54, "sigma": 0.03, "calibration": -1e308}}}]}}'
    ],
    "wavelengths": [b"s%n((((((((((" + b"a" * 5000],
    "stations": [b"x_m,y_m,z_m,sigma_m\n0,0,0,0.01\n1,0," + b"9" * 140_000 + b",0.01\n"],
    "craters": [b"name,latitude_deg,longitude_deg,diameter_km\n" + b"a" * 140_000 + b",1,2,3\n"],
    "TOML": [b"a = " + b"9" * 5000],
    "keep-outs": [
        b'{"type": "FeatureCollection", "features": [{"type": "Feature", "properties": {"name": "rock"}, '
        b'"geometry": {"type": "Polygon", "coordinates": [[[0, 0], [1e308, 0], [2, 1], [0, 0]]]}}]}'
    ],
    "track": [b"x_m,y m,rut_m " + b"9" * 80_000],
    "mask .npy": [
        b"\x93NUMPY\x01\x00\x16\x00{'descr': '<f8', 'shape'",
        b"\x93NUMPY\x01\x00\x3e\x00{'descr': '<f8', 'fortran_order': False, 'shape': (3, 4), }  \n",
    ],
    "cube NetCDF 3": [b"CDF\x01" + b"\x00" * 40],
    "picture PDS4": [
        PICTURE.replace(b"32", b"0x10"),
        PICTURE.replace(b"<offset>0", b"<offset>9"),
        PICTURE.replace(b"24", b"9" * 12),
    ],
    "camera CAHVOR": [
        b"NS = 4\nNL = 4\nC = 1 0 0\nA = 0 0 1\nH = 9 0 2\nV = 0 0 2\n",
        b"NS = 4\nNL = 4\nC = 1 0 0\nA = 0 0 1\nH = 9 0 2\nV = 0 1e999 2\n",
    ],
    "mission": [b"leg_m = " + b"9" * 5000],
    "results": [
        b'{"schema": "lunarsci/spectra-fit/1", "provenance": {}, '
        b'"result": {"spectra": [{"id": "rock", "bands": [{}]}]}}'
    ],
}
"""What once broke the promise. SYNTHETIC."""


@pytest.fixture(scope="module")
def fuzz(load_benchmark: Callable[[str], ModuleType]) -> ModuleType:
    return load_benchmark("fuzz")


def test_every_reader_gives_a_result_or_a_line(fuzz: ModuleType, tmp_path: Path) -> None:
    broken = {}
    for name, reader in fuzz.readers().items():
        folder = fuzz.prepare(reader, tmp_path / fuzz.slug(name))
        for seed in reader.seeds[:1]:
            assert fuzz.tried(reader, folder, seed) == ("read", ""), name
        found = fuzz.tries(reader, INPUTS, 7, folder, seconds=SECONDS)
        assert found.refusals, name
        broken |= {f"{name}: {what}": data[:200] for what, data in found.broken.items()}
    assert broken == {}


def test_what_once_broke_it(fuzz: ModuleType, tmp_path: Path) -> None:
    readers = fuzz.readers()
    for name, files in CRASHERS.items():
        folder = fuzz.prepare(readers[name], tmp_path / fuzz.slug(name))
        for data in files:
            assert fuzz.tried(readers[name], folder, data)[0] == "refused", (name, data[:80])


def test_what_breaks_the_promise_is_seen(fuzz: ModuleType, tmp_path: Path) -> None:
    """Readers that fail on purpose, each in a way of its own."""

    def foreign(path: Path) -> None:
        raise KeyError(path.name)

    def endless(path: Path) -> None:
        while path:
            pass

    fuzz.SLOWEST_S = 0.2
    for read, said in ((foreign, "KeyError"), (endless, "slower")):
        found = fuzz.tries(fuzz.Reader(read, ["spoilt.txt"], [b"1 2 3"]), 1, 1, tmp_path)
        assert [what for what in found.broken if said in what], said


def test_a_process_that_dies_is_a_promise_broken(fuzz: ModuleType, tmp_path: Path) -> None:
    """The last input is kept, and what was found before."""
    fuzz.run("no such reader", 1, 1.0, 1, tmp_path, guided=False)
    [what] = fuzz.summed("no such reader", tmp_path).broken
    assert what.startswith("the process ended with 1")


def test_an_input_of_several_files_may_lack_one(fuzz: ModuleType, tmp_path: Path) -> None:
    reader = fuzz.Reader(lambda path: None, ["a.hdr", "a.img"], [])
    fuzz.write(reader, tmp_path, b"head" + fuzz.BETWEEN + b"data")
    assert [(tmp_path / name).read_bytes() for name in reader.names] == [b"head", b"data"]
    fuzz.write(reader, tmp_path, b"head alone")
    assert [file.name for file in tmp_path.iterdir()] == ["a.hdr"]


def test_mutations_change_files(fuzz: ModuleType) -> None:
    draw = random.Random(1)
    sound = b"wavelength_nm,reflectance\n500,0.1\n510,0.2\n"
    made = {fuzz.mutated(sound, draw) for _ in range(500)}
    assert len(made) > 350
    assert any(len(data) > 2000 for data in made)
