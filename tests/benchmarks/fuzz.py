"""Spoilt files for every reader: each gives a result or one line that says what is wrong, soon and in little memory.

`python tests/benchmarks/fuzz.py --inputs 100000 --keep FOLDER [READER...]`, or `make fuzz`. Mutations know of numbers,
words, lines, columns and brackets; what makes a reader give a refusal that it had not given before is mutated further.
All files are made up (SYNTHETIC). Prints a line a reader; what breaks the promise is kept in a folder.
"""

import argparse
import contextlib
import io
import itertools
import random
import re
import resource
import signal
import sys
import tempfile
import time
import warnings
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from lunarsci.errors import LunarSciError
from lunarsci.inputs import InputFile

SLOWEST_S, MOST_BYTES = 5.0, 2 << 30
NUMBERS = [b"", b"9" * 30, b"9" * 5000, b"\xef\xbc\x91"]
NUMBERS += b"nan inf -inf 1e999 -1e308 1e-320 0 -0 -1 1e 0x10 --1 1,5 1.5.2 1_000 99999 -9999 1e6 true [] null".split()
NUMBERS += b"2**64 0.0000001 3.4028235e38 2147483648 -32768".split()
WORDS = rb"""\x1b[31m =cmd|x ' " ../../etc/passwd %s%n {} # NaN None -- wavelength_nm x_m source""".split()
WORDS += [b"", b" ", b"\x1b[31m", b"\x00", b"\r", b"a" * 10_000, b"\xff\xfe", b"\xe2\x80\xae", b"\xef\xbb\xbf"]
NUMBER = re.compile(rb"-?\d+\.?\d*(?:[eE][+-]?\d+)?")
WORD = re.compile(rb"[A-Za-z_]{2,}")


@dataclass
class Reader:
    """What is tried: a reader, the suffix of its files, and files that it reads."""

    read: Callable[[Path], Any]
    suffix: str
    seeds: list[bytes]


@dataclass
class Found:
    """Of a reader: inputs, how many were read and refused, and what broke the promise, by kind."""

    inputs: int = 0
    read: int = 0
    refusals: dict[str, int] = field(default_factory=dict)
    broken: dict[str, bytes] = field(default_factory=dict)
    slowest_s: float = 0.0


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
    def ring(*_: object) -> None:
        raise TimeoutError

    signal.signal(signal.SIGALRM, ring)
    signal.setitimer(signal.ITIMER_REAL, seconds)
    try:
        yield
    finally:
        signal.setitimer(signal.ITIMER_REAL, 0.0)


def tried(reader: Reader, path: Path, data: bytes) -> tuple[str, str]:
    """`read`, `refused` or `broken`, and what was said."""
    path.write_bytes(data)
    try:
        with warnings.catch_warnings(), alarm(SLOWEST_S):
            warnings.simplefilter("ignore")
            reader.read(path)
    except LunarSciError as error:
        said = str(error)
        return "refused", re.sub(r"[-\d.'\"]+|\S*/\S*", "", said)[:60]
    except TimeoutError:
        return "broken", f"slower than {SLOWEST_S:g} s"
    except BaseException as error:
        trace, where = error.__traceback__, ""
        while trace:
            name = trace.tb_frame.f_code.co_filename
            where = (
                f"{Path(name).name}:{trace.tb_lineno}"
                if "/lunarsci/" in name and "site-packages" not in name
                else where
            )
            trace = trace.tb_next
        return "broken", f"{type(error).__name__} at {where}: {str(error)[:80]}"
    return "read", ""


def tries(reader: Reader, inputs: int, seed: int, folder: Path) -> Found:
    """Spoil files of one reader."""
    draw, found = random.Random(seed), Found()
    others: list[bytes] = []
    path = folder / f"spoilt{reader.suffix}"
    for _ in range(inputs):
        data = mutated(draw.choice(others if others and draw.random() < 0.4 else reader.seeds), draw)[:2_000_000]
        begun = time.perf_counter()
        end, said = tried(reader, path, data)
        found.slowest_s = max(found.slowest_s, time.perf_counter() - begun)
        found.inputs += 1
        if end == "broken":
            found.broken.setdefault(said, data)
        elif end == "read":
            found.read += 1
        elif said not in found.refusals and len(others) < 200 and len(data) < 100_000:
            others.append(data)
        if end == "refused":
            found.refusals[said] = found.refusals.get(said, 0) + 1
    return found


def _spectra(path: Path) -> Any:
    from lunarsci.spectra.readers import read_spectra

    return read_spectra(InputFile(str(path), path.read_bytes()))


def of_file(name: str, *more: Any) -> Callable[[Path], Any]:
    """The reader of that name, `module:function`, called with an InputFile."""
    return _called(name, lambda path: InputFile(str(path), path.read_bytes()), *more)


def of_path(name: str, *more: Any) -> Callable[[Path], Any]:
    return _called(name, str, *more)


def _called(name: str, given: Callable[[Path], Any], *more: Any) -> Callable[[Path], Any]:
    from importlib import import_module

    module, function = name.split(":")

    def read(path: Path) -> Any:
        return getattr(import_module(f"lunarsci.{module}"), function)(given(path), *more)

    return read


def table_text(names: str, rows: int = 12) -> bytes:
    """A table of made-up numbers under these names."""
    numbers = np.random.default_rng(1).uniform(0.01, 0.1, (rows, len(names.split(","))))
    numbers[:, 0] = 0.005 + 0.5 * np.arange(rows) if names.startswith("time") else numbers[:, 0]
    return (
        f"{names}\n".encode()
        + b"\n".join(",".join(f"{value:.5f}" for value in row).encode() for row in numbers)
        + b"\n"
    )


def _curve() -> tuple[np.ndarray, np.ndarray]:
    nm = np.arange(500.0, 2500.0, 25.0)
    return nm, 0.1 + 2e-5 * nm - 0.03 * np.exp(-(((nm - 980) / 120) ** 2))


def spectra_seeds() -> dict[str, bytes]:
    """The same made-up spectrum in several formats."""
    from astropy.table import Table

    nm, reflectance = _curve()
    plain = Table({"wavelength_nm": nm, "reflectance": reflectance})
    ecsv, fits = io.StringIO(), io.BytesIO()
    plain.write(ecsv, format="ascii.ecsv")
    plain.write(fits, format="fits")
    rows = list(zip(nm, reflectance, strict=True))
    return {
        "csv": b"wavelength_nm,rock,rock_sigma\n" + b"".join(b"%.1f,%.5f,0.001\n" % row for row in rows),
        "txt": b"# SYNTHETIC\n" + b"".join(b"%.4f %.5f\n" % (w / 1000, r) for w, r in rows),
        "ecsv": ecsv.getvalue().encode(),
        "fits": fits.getvalue(),
        "tab": b"%d\n" % len(rows) + b"".join(b"  %9.4f %9.5f %9.5f\n" % (w, r, 0.001) for w, r in rows),
        "splib": b" splib07a Record=1: SYNTHETIC\n" + b"".join(b" %.6E\n" % r for _, r in rows),
    }


def envi_header() -> bytes:
    nm, _ = _curve()
    return (
        f"ENVI\ndescription = {{SYNTHETIC}}\nsamples = 4\nlines = 3\nbands = {nm.size}\nheader offset = 0\n"
        "file type = ENVI Standard\ndata type = 4\ninterleave = bil\nbyte order = 0\n"
        "wavelength units = Nanometers\nbbl = {"
        f"{', '.join('1' for _ in nm)}}}\nwavelength = {{{', '.join(f'{w:.1f}' for w in nm)}}}\n"
    ).encode()


def _envi(path: Path) -> Any:
    from lunarsci.spectra.cubes.rasters import open_cube

    nm, reflectance = _curve()
    image = path.with_suffix(".img")
    if not image.exists():
        np.broadcast_to(reflectance[:, None], (3, nm.size, 4)).astype("<f4").tofile(image)
    return open_cube(str(path)).rows(range(1)) if hasattr(open_cube(str(path)), "rows") else None


def _terrain_seeds(folder: Path) -> dict[str, bytes]:
    from lunarsci.grids import geotiff_bytes

    axis = 0.5 * np.arange(8)
    height = 0.05 * np.sin(axis[:, None] + axis)
    np.savez(folder / "seed.npz", x_m=axis, y_m=axis, height_m=height, friction_angle_deg=30.0)
    rows = "\n".join(" ".join(f"{value:.3f}" for value in row) for row in height)
    nodes = "".join(f"{x},{y},{height[j, i]:.4f}\n" for j, y in enumerate(axis) for i, x in enumerate(axis))
    return {
        "npz": (folder / "seed.npz").read_bytes(),
        "asc": f"ncols 8\nnrows 8\nxllcorner 0\nyllcorner 0\ncellsize 0.5\nNODATA_value -9999\n{rows}\n".encode(),
        "csv": f"x_m,y_m,height_m\n{nodes}".encode(),
        "tif": geotiff_bytes({"height_m": height}, (0.0, 0.0, 0.5), synthetic=True),
    }


def _texts() -> dict[str, bytes]:
    """Files that come with lunarsci, and short ones of other kinds."""
    from importlib.resources import files

    from lunarsci.images.rig_files import read_rig, rig_text

    own = files("lunarsci")
    zone = '{"type": "Polygon", "coordinates": [[[0, 0], [2, 0], [2, 1], [0, 0]]]}'
    feature = f'{{"type": "Feature", "properties": {{"name": "rock"}}, "geometry": {zone}}}'
    return {
        "plan": (own / "twin/plans/plan.toml").read_bytes(),
        "rover": (own / "rovers/yutu2.toml").read_bytes(),
        "rig": rig_text(read_rig("yutu2-navcam")).encode(),
        "soil": b"stiffness_kpa_m_n = 1379\nsinkage_exponent = 1.0\ncohesion_pa = 520\nfriction_angle_deg = 42\n"
        b"shear_modulus_mm = 17.8\nexternal_friction_angle_deg = 25\nlateral_modulus_mm = 20\n",
        "pose": b"position_m = [0.0, 0.0, 1.5]\nheading_deg = 10.0\ndown_deg = 15.0\n",
        "prior": b'[cohesion_pa]\nof = "ln"\nmedian = 500.0\nsd = 0.5\n',
        "keep-outs": f'{{"type": "FeatureCollection", "features": [{feature}]}}'.encode(),
        "catalogue": b"name,latitude_deg,longitude_deg,diameter_km\nA,17.2,144.7,28\nB,-42.0,-177.9,72\n",
        "fit": b'{"schema": "lunarsci/spectra-fit/1", "result": {"spectra": [{"id": "rock", "nbsr": {"um2": '
        b'{"opx": 0.46, "cpx": 0.54, "sigma": 0.03, "calibration": 0.04, "continuum": null}}}]}}',
        "modes": b"id,olivine,orthopyroxene,clinopyroxene\nrock,0.3,0.4,0.3\n",
        "telemetry": table_text("time_s,x_m,y_m,sigma_m,z_m,roll_deg,pitch_deg,yaw_deg," + ",".join(
            f"speed_{wheel}_m_s,steered_{wheel}_deg" for wheel in ("FL", "FR", "ML", "MR", "RL", "RR"))),
        "track": table_text("x_m,y_m,rut_m"),
        "positions": table_text("time_s,x_m,y_m,sigma_m"),
        "states": table_text("sinkage_m,slip_ratio,side_slip_deg,normal_force_n,drawbar_pull_n,lateral_force_n,"
                             "resistance_torque_nm"),
    }  # fmt: skip


def readers(folder: Path) -> dict[str, Reader]:
    """All that is tried, with seeds made in the folder."""
    seeds, grids, texts = spectra_seeds(), _terrain_seeds(folder), _texts()
    nm, _ = _curve()
    (folder / "splib07a_Wavelengths_SYNTHETIC.txt").write_text(
        " splib07a Record=2: SYNTHETIC\n" + "".join(f" {w / 1000:.6E}\n" for w in nm)
    )
    made = {
        f"spectra .{name}": Reader(_spectra, {"splib": ".txt"}.get(name, f".{name}"), [data])
        for name, data in seeds.items()
    }
    made |= {
        f"terrain .{name}": Reader(of_path("grids:read_grid", ("friction_angle_deg",)), f".{name}", [data])
        for name, data in grids.items()
    }
    for name, call, suffix in (
        ("plan", of_path("twin.plans.plan:read_plan"), ".toml"),
        ("rover", of_path("rovers:read_rover"), ".toml"),
        ("rig", of_path("images.rig_files:read_rig"), ".toml"),
        ("soil", of_path("regolith.soil:read_soil"), ".toml"),
        ("pose", of_path("images.rig_files:read_pose"), ".toml"),
        ("prior", of_file("regolith.prior:read_prior"), ".toml"),
        ("keep-outs", of_file("twin.ground.keep_out:read_keep_outs"), ".geojson"),
        ("catalogue", of_file("spectra.origin.catalogue:read_catalogue"), ".csv"),
        ("fit", of_file("spectra.origin.composition:read_rocks"), ".json"),
        ("modes", of_file("spectra.abundance.known_modes:read_modes"), ".csv"),
        ("telemetry", _telemetry, ".csv"),
        ("track", of_file("twin.telemetry.sinkage:read_track"), ".csv"),
        ("positions", of_file("twin.telemetry.reading:read_positions"), ".csv"),
        ("states", _states, ".csv"),
    ):
        if texts[name]:
            made[name] = Reader(call, suffix, [texts[name]])
    made["cube header"] = Reader(_envi, ".hdr", [envi_header()])
    made["configuration"] = Reader(of_text("documents:toml_document"), ".toml", [texts["plan"], texts["rover"]])
    return made


def of_text(name: str) -> Callable[[Path], Any]:
    def read(path: Path) -> Any:
        import tomllib

        try:
            return _called(name, lambda file: file.read_text("utf-8", errors="replace"))(path)
        except tomllib.TOMLDecodeError as error:
            raise LunarSciError(str(error)) from error

    return read


def _telemetry(path: Path) -> Any:
    from lunarsci.rovers import read_rover
    from lunarsci.twin.rover import build_rover
    from lunarsci.twin.telemetry.checks import Findings
    from lunarsci.twin.telemetry.reading import read_telemetry

    return read_telemetry(
        InputFile(str(path), path.read_bytes()), build_rover(read_rover("yutu2")), Findings(str(path))
    )


def _states(path: Path) -> Any:
    from lunarsci.regolith.states import read_states
    from lunarsci.regolith.wheel import read_wheel

    return read_states(InputFile(str(path), path.read_bytes()), read_wheel("yutu2"))


def main() -> int:
    """Print a line a reader; 1 where any broke the promise."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("reader", nargs="*")
    parser.add_argument("--inputs", type=int, default=100_000)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--keep", type=Path, default=Path(tempfile.gettempdir()) / "lunarsci-fuzz")
    asked = parser.parse_args()
    resource.setrlimit(resource.RLIMIT_AS, (2 * MOST_BYTES, 2 * MOST_BYTES))
    bad = 0
    with tempfile.TemporaryDirectory() as place:
        every = readers(Path(place))
        for name in asked.reader or every:
            found = tries(every[name], asked.inputs, asked.seed, Path(place))
            peak_mb = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024
            print(f"{name:16s} {found.inputs:8,} inputs, {found.read:7,} read, {len(found.refusals):4d} kinds of "
                  f"refusal, slowest {found.slowest_s:.2f} s, {peak_mb:.0f} MB at most, {len(found.broken)} broken "
                  "promises", flush=True)  # fmt: skip
            for number, (what, data) in enumerate(found.broken.items()):
                asked.keep.mkdir(parents=True, exist_ok=True)
                file = asked.keep / f"{name.replace(' ', '_').replace('.', '')}-{number}{every[name].suffix}"
                file.write_bytes(data)
                print(f"    {what}   [{file}]")
            bad += len(found.broken)
    return min(bad, 1)


if __name__ == "__main__":
    sys.exit(main())
