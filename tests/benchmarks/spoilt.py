"""Wrong but plausible inputs: is each refused, told, or taken in silence, and how wrong would silence be?

`python tests/benchmarks/spoilt.py [WORD...]` prints a line a case: what was done to the files, what happened, and by
how much the result would differ. Files are made up (SYNTHETIC); cases were written down before the readers were read.
`tests/test_spoilt.py` runs them. Cases of VNIS products are here, all others in `spoilt_tables.py`.
"""

import argparse
import os
import re
import tempfile
from collections.abc import Callable, Iterator, Mapping
from datetime import datetime, timedelta
from pathlib import Path

import numpy as np
import spoilt_tables
from spoilt_tables import Outcome, happened

from lunarsci.arrays import FloatArray
from lunarsci.errors import LunarSciError
from lunarsci.spectra.jobs.calibrate import calibrate
from lunarsci.spectra.solar import in_band_irradiance, solar_spectrum, sun_moon_distance_au
from lunarsci.spectra.vnis.channels import CUBE_SHAPE, SWIR_NM, VNIR_NM, footprint_mask, fwhm_nm
from lunarsci.spectra.vnis.simulation.instrument import simulate
from lunarsci.spectra.vnis.simulation.scene import Material, Scene, SceneComposition
from lunarsci.spectra.vnis.simulation.template import product_files

Files = dict[str, bytes]
Spoiler = Callable[[Files], None]


# -- VNIS products ----------------------------------------------------------------------------------------------------


def key(files: Files, kind: str, label: bool = False) -> str:
    """Name of the cube (VD), its auxiliary table (AUX), the short-wave table (SD), or a label."""
    role = "VD_AUX" if kind == "AUX" else f"{kind}_SCI"
    return next(name for name in files if f"-{role}" in name and name.endswith(".2BL" if label else ".2B"))


def in_label(kinds: str, pattern: str, new: str | Callable[[re.Match[str]], str], count: int = 0) -> Spoiler:
    def spoil(files: Files) -> None:
        for kind in kinds.split():
            name = key(files, kind, True)
            text, done = re.subn(pattern, new, files[name].decode(), count=count, flags=re.DOTALL)
            assert done, pattern
            files[name] = text.encode()

    return spoil


def angle(kinds: str, where: str, tag: str, change: Callable[[float], float]) -> Spoiler:
    """Change an angle of the element `solar` or `center_point`."""
    pattern = rf"(<{where}>(?:(?!</{where}>).)*?<{tag}[^>]*>)([^<]*)"
    return in_label(kinds, pattern, lambda m: f"{m[1]}{change(float(m[2])):.6f}")


def swapped_angles(kinds: str) -> Spoiler:
    def spoil(files: Files) -> None:
        for kind in kinds.split():
            text = files[key(files, kind, True)].decode()
            sun, view = (
                float(re.search(rf"<{where}>.*?<incidence_angle[^>]*>([^<]*)", text, re.DOTALL)[1])
                for where in ("solar", "center_point")
            )
            angle(kind, "solar", "incidence_angle", lambda _, new=view: new)(files)
            angle(kind, "center_point", "incidence_angle", lambda _, new=sun: new)(files)

    return spoil


def rows(kind: str, change: Callable[[list[list[str]]], list[list[str]]]) -> Spoiler:
    """Change the cells of a table, and the size that its label states."""

    def spoil(files: Files) -> None:
        name, label = key(files, kind), key(files, "VD" if kind == "AUX" else kind, True)
        size = len(files[name])
        cells = change([line.split() for line in files[name].decode().splitlines()])
        files[name] = ("\n".join(" ".join(row) for row in cells) + "\n").encode()
        files[label] = files[label].replace(f">{size}<".encode(), f">{len(files[name])}<".encode())

    return spoil


def radiance(change: Callable[[FloatArray], FloatArray]) -> Spoiler:
    def new(cells: list[list[str]]) -> list[list[str]]:
        values = change(np.array([float(row[4]) for row in cells]))
        return [[*row[:4], f"{value:.5E}", row[5]] for row, value in zip(cells, values, strict=True)]

    return rows("SD", new)


def column(kind: str, place: int, change: Callable[[str, int], str], where: slice = slice(None)) -> Spoiler:
    def new(cells: list[list[str]]) -> list[list[str]]:
        for k in range(len(cells))[where]:
            cells[k][place] = change(cells[k][place], k)
        return cells

    return rows(kind, new)


def times(kinds: str, change: Callable[[datetime], datetime]) -> Spoiler:
    """Change times in labels (VD, SD), their tables (VD: the auxiliary one), or in names (NAME)."""

    def one(match: re.Match[str]) -> str:
        return change(datetime.fromisoformat(match[0][:-1])).isoformat(timespec="milliseconds") + "Z"

    def stamp(match: re.Match[str]) -> str:
        return f"{change(datetime.strptime(match[0], '%Y%m%d%H%M%S')):%Y%m%d%H%M%S}"

    def spoil(files: Files) -> None:
        for kind in kinds.split():
            if kind == "NAME":
                for name in list(files):
                    content = files.pop(name)
                    if name.endswith(".2BL"):
                        content = re.sub(r"(?<=_)\d{14}(?=_)", stamp, content.decode()).encode()
                    files[re.sub(r"\d{14}", stamp, name)] = content
                continue
            label, table = key(files, kind, True), key(files, "AUX" if kind == "VD" else kind)
            coordinates = r"(?<=_date_time>)[^<]*(?=</st)"
            files[label] = re.sub(coordinates, one, files[label].decode()).encode()
            files[table] = re.sub(r"(?m)^\S+Z", one, files[table].decode()).encode()

    return spoil


def cube(change: Callable[[np.ndarray], np.ndarray | None]) -> Spoiler:
    def spoil(files: Files) -> None:
        name = key(files, "VD")
        values = np.frombuffer(files[name], "<f4").reshape(CUBE_SHAPE).copy()
        changed = change(values)
        files[name] = np.asarray(values if changed is None else changed, "<f4").tobytes()

    return spoil


def planes(where: slice | int, factor: float) -> Spoiler:
    def change(values: np.ndarray) -> None:
        values[where] *= np.float32(factor)

    return cube(change)


def both(*spoilers: Spoiler) -> Spoiler:
    def spoil(files: Files) -> None:
        for each in spoilers:
            each(files)

    return spoil


def scaled(where: slice, factor: float) -> Callable[[FloatArray], FloatArray]:
    def change(values: FloatArray) -> FloatArray:
        values[where] *= factor
        return values

    return change


def moved(values: np.ndarray, by: int) -> np.ndarray:
    """Shifted along the first axis: what falls off is lost, the last one stays twice."""
    return values[np.clip(np.arange(len(values)) - by, 0, len(values) - 1)]


def exchanged(values: np.ndarray, a: int, b: int) -> np.ndarray:
    values[[a, b]] = values[[b, a]]
    return values


def set_to(values: np.ndarray, where: object, new: object) -> None:
    values[where] = new


def other_table(files: Files) -> None:
    """The radiances of a darker, olivine-rich rock seen elsewhere, at this observation's times."""
    material = Material(SceneComposition(olivine=0.7, plagioclase=0.3), albedo=0.07, red_slope=0.3)
    others = product_files(simulate(Scene(soil=material), seed=9))
    files[key(files, "SD")] = others[key(others, "SD")]


def other_times(files: Files) -> None:
    """The table of an observation half an hour later, under this one's name."""
    late = Scene(time=datetime.fromisoformat("2020-07-16T08:50:00+00:00"))
    others = product_files(simulate(late, seed=9))
    files[key(files, "SD")] = others[key(others, "SD")]


def exchanged_labels(files: Files) -> None:
    one, other = key(files, "VD", True), key(files, "SD", True)
    files[one], files[other] = files[other], files[one]


HOUR, YEAR, MONTH = timedelta(hours=1), timedelta(days=366), timedelta(days=29.53)
VNIS: dict[str, Spoiler] = {
    "incidence and emission swapped in both labels": swapped_angles("VD SD"),
    "incidence and emission swapped in the image's label": swapped_angles("VD"),
    "incidence and emission swapped in the table's label": swapped_angles("SD"),
    "incidence in radians in both": angle("VD SD", "solar", "incidence_angle", np.radians),
    "elevation of the Sun for its incidence": angle("VD SD", "solar", "incidence_angle", lambda a: 90 - a),
    "incidence 10 deg more in both, phase to match": both(
        angle("VD SD", "solar", "incidence_angle", lambda a: a + 10),
        angle("VD SD", "center_point", "phase_angle", lambda a: a + 6.3),
    ),
    "incidence 1 deg more in both": angle("VD SD", "solar", "incidence_angle", lambda a: a + 1),
    "incidence 5 deg more in the table's label": angle("SD", "solar", "incidence_angle", lambda a: a + 5),
    "phase angle 10 deg more": angle("VD SD", "center_point", "phase_angle", lambda a: a + 10),
    "phase angle less than |i - e|": angle("VD SD", "center_point", "phase_angle", lambda a: 10.0),
    "phase angle more than i + e": angle("VD SD", "center_point", "phase_angle", lambda a: 120.0),
    "the Sun's azimuth turned by 180 deg": angle("VD SD", "solar", "azimuth_angle", lambda a: a + 180),
    "the Sun's azimuth in radians": angle("VD SD", "solar", "azimuth_angle", np.radians),
    "emission 20 deg more": angle("VD SD", "center_point", "incidence_angle", lambda a: a + 20),
    "unit of the incidence says rad": in_label("VD SD", r'(<solar>\s*<incidence_angle) unit="deg"', r'\1 unit="rad"'),
    "year changed in labels and tables, not in names": times("VD SD", lambda t: t.replace(year=2019)),
    "year changed everywhere": times("VD SD NAME", lambda t: t.replace(year=2019)),
    "year changed in names alone": times("NAME", lambda t: t.replace(year=2019)),
    "month changed in labels and tables": times("VD SD", lambda t: t.replace(month=6)),
    "a fortnight later everywhere": times("VD SD NAME", lambda t: t + timedelta(days=14)),
    "Beijing time in labels, UTC in tables": in_label("VD SD", r"(?<=_date_time>2020-07-16T)08", "16"),
    "Beijing time everywhere": times("VD SD NAME", lambda t: t + 8 * HOUR),
    "Beijing time in labels and tables": times("VD SD", lambda t: t + 8 * HOUR),
    "a synodic month later everywhere": times("VD SD NAME", lambda t: t + MONTH),
    "stop before start": in_label("SD", r"(<stop_date_time>)2020", r"\g<1>2019"),
    "longitude and latitude swapped": in_label(
        "VD SD", r"(<Rover_Location>.*?<longitude[^>]*>)([^<]*)(.*?<latitude[^>]*>)([^<]*)", r"\1\4\3\2"
    ),
    "northern hemisphere": in_label("VD SD", r"(<latitude[^>]*>)-", r"\1"),
    "west longitude": in_label("VD SD", r"(<longitude[^>]*>)", r"\1-"),
    "rover's longitude 10 deg less": in_label("VD SD", r"(<Rover_Location>.*?<longitude[^>]*>)177", r"\g<1>167"),
    "another sequence in the label": in_label("SD", r"<sequence_id>\d+", "<sequence_id>0137"),
    "labels exchanged": exchanged_labels,
    "planes shifted by one up": cube(lambda c: moved(c, 1)),
    "planes shifted by one down": cube(lambda c: moved(c, -1)),
    "planes rolled by one": cube(lambda c: np.roll(c, 1, axis=0)),
    "planes shifted by two": cube(lambda c: np.roll(c, 2, axis=0)),
    "a plane twice": cube(lambda c: set_to(c, 40, c[39])),
    "a plane twice, far apart": cube(lambda c: set_to(c, 42, c[39])),
    "15 planes x 1.15": planes(slice(30, 45), 1.15),
    "15 planes x 1.3": planes(slice(60, 75), 1.3),
    "a plane x 1.1": planes(50, 1.1),
    "a plane x 1.5": planes(50, 1.5),
    "planes in reverse": cube(lambda c: c[::-1]),
    "bytes of the other order": cube(lambda c: c.byteswap()),
    "image radiance per um": planes(slice(None), 1000.0),
    "counts instead of radiance": cube(lambda c: np.round(c * 20000 / c.max())),
    "image of another observation": planes(slice(None), 0.6),
    "image x 0.9": planes(slice(None), 0.9),
    "image by lines instead of planes": cube(lambda c: c.transpose(1, 0, 2).copy().reshape(CUBE_SHAPE)),
    "a plane of zeros": cube(lambda c: set_to(c, 50, 0)),
    "a plane without numbers": cube(lambda c: set_to(c, 50, np.nan)),
    "a plane of -9999": cube(lambda c: set_to(c, 50, -9999)),
    "upside down": cube(lambda c: c[:, ::-1]),
    "wrapped by 20 lines": cube(lambda c: np.roll(c, 20, axis=1)),
    "a constant quarter": cube(lambda c: set_to(c, np.s_[:, :128, :128], c[:, :1, :1])),
    "two neighbouring planes exchanged": cube(lambda c: exchanged(c, 40, 41)),
    "two planes far apart exchanged": cube(lambda c: exchanged(c, 20, 70)),
    "lines of zeros": cube(lambda c: set_to(c, np.s_[50, 100:140], 0)),
    "an offset of a tenth": cube(lambda c: c + np.float32(0.1 * np.median(c))),
    "the end filled with zeros": cube(lambda c: set_to(c, np.s_[80:], 0)),
    "SWIR x 0.9": radiance(scaled(slice(None), 0.9)),
    "SWIR x 1.1": radiance(scaled(slice(None), 1.1)),
    "SWIR x 1.25": radiance(scaled(slice(None), 1.25)),
    "SWIR x 0.9 from 1380 nm on": radiance(scaled(slice(96, None), 0.9)),
    "15 rows x 1.15": radiance(scaled(slice(150, 165), 1.15)),
    "15 rows x 1.1": radiance(scaled(slice(150, 165), 1.1)),
    "a row x 1.15": radiance(scaled(slice(150, 151), 1.15)),
    "rows shifted by one up": radiance(lambda r: moved(r, 1)),
    "rows shifted by one down": radiance(lambda r: moved(r, -1)),
    "10 rows repeated": radiance(lambda r: np.concatenate([r[:110], r[100:110], r[120:]])),
    "rows in reverse": radiance(lambda r: r[::-1]),
    "identifiers one more": column("SD", 1, lambda _, k: str(k + 1)),
    "identifiers five more": column("SD", 1, lambda _, k: str(k + 5)),
    "an identifier twice": column("SD", 1, lambda _, k: str(min(k, 298))),
    "another observation's radiances": other_table,
    "another observation's table": other_times,
    "table of the next day": column("SD", 0, lambda t, _: t.replace("07-16", "07-17")),
    "table radiance per um": radiance(scaled(slice(None), 1000.0)),
    "ten rows of bad quality": column("SD", 5, lambda *_: "0x01", slice(20, 30)),
    "every row of bad quality": column("SD", 5, lambda *_: "0x01"),
    "integration time 0": column("SD", 2, lambda *_: "0.0"),
    "integration time negative in the image": column("AUX", 2, lambda *_: "-54.2"),
    "last number cut": lambda files: files.update({key(files, "SD"): files[key(files, "SD")][:-12]}),
    "last number cut, label to match": rows("SD", lambda c: [*c[:-1], [*c[-1][:4], c[-1][4][:4]]]),
    "commas for points": column("SD", 4, lambda t, _: t.replace(".", ",")),
    "integration time and radiance exchanged": rows("SD", lambda c: [[*r[:2], r[4], r[3], r[2], r[5]] for r in c]),
    "negative rows": radiance(lambda r: np.where(np.arange(300) % 50 == 7, -r, r)),
    "rows of -9999": radiance(lambda r: np.where(np.arange(300) % 50 == 7, -9999.0, r)),
    "times backwards": rows("SD", lambda c: [[o[0], *r[1:]] for r, o in zip(c, c[::-1], strict=True)]),
    "one time out of order": column("SD", 0, lambda t, _: t.replace(":17:", ":24:").replace(":18:", ":24:"),
                                    slice(20, 21)),
    "reflectance instead of radiance": radiance(lambda r: 0.1 + 0 * r + 1e-4 * np.arange(300)),
    "a row missing": rows("SD", lambda c: c[:150] + c[151:]),
    "auxiliary table of another day": column("AUX", 0, lambda t, _: t.replace("07-16", "07-18")),
    "auxiliary rows missing": rows("AUX", lambda c: c[:90]),
    "auxiliary times backwards": rows("AUX", lambda c: [[o[0], *r[1:]] for r, o in zip(c, c[::-1], strict=True)]),
}  # fmt: skip


def plainly(files: Files) -> FloatArray:
    """The 390 channels as anyone would calculate them from these files, without looking twice. NaN where it fails."""
    try:
        halves = [_plain(files, kind) for kind in ("VD", "SD")]
    except (ValueError, LunarSciError, StopIteration, TypeError):
        return np.full(390, np.nan)
    ratio = np.nanmedian(halves[1][:10] / halves[0][90:])
    return np.concatenate([ratio * halves[0][:90], halves[1]])


def _plain(files: Files, kind: str) -> FloatArray:
    label = files[key(files, kind, True)].decode()
    incidence = float(re.search(r"<solar>.*?<incidence_angle[^>]*>([^<]*)", label, re.DOTALL)[1])
    start = re.search(r"<start_date_time>([^<]*)", label)[1]
    if kind == "VD":
        values = np.frombuffer(files[key(files, kind)], "<f4").reshape(CUBE_SHAPE)
        nm, seen = VNIR_NM, values[:, footprint_mask()].mean(axis=1, dtype=float)
    else:
        nm = SWIR_NM
        seen = np.array([float(line.split()[4]) for line in files[key(files, kind)].decode().splitlines()])
    sun = in_band_irradiance(solar_spectrum("e490"), nm, fwhm_nm(nm, "vnir" if kind == "VD" else "swir"))
    distance = sun_moon_distance_au(datetime.fromisoformat(start))
    with np.errstate(all="ignore"):
        result: FloatArray = np.pi * seen * distance**2 / (sun * np.cos(np.radians(incidence)))
    return result


def error_percent(found: FloatArray, sound: FloatArray) -> float:
    """Largest over all channels of the change, NaN where nothing comes out. [%]"""
    with np.errstate(all="ignore"):
        change = np.abs(found / sound - 1)
    return 100 * float(np.nanmax(change)) if np.isfinite(change).any() else float("nan")


def vnis_outcomes(folder: Path, wanted: Callable[[str], bool] = lambda _: True) -> Iterator[tuple[str, Outcome]]:
    """Every case of VNIS products, one after the other."""
    products = product_files(simulate(Scene(), seed=3))
    sound = {name: content for name, content in products.items() if not name.endswith(".json")}
    expected, usual = plainly(sound), set(_calibrated(folder / "sound", sound)[1])
    for number, (name, spoil) in enumerate(VNIS.items()):
        if not wanted(name):
            continue
        files = dict(sound)
        spoil(files)
        place = folder / str(number)

        def run(place: Path = place, files: Files = files) -> tuple[str, list[str]]:
            doubt, notes = _calibrated(place, files, folder / "sound")
            return doubt, [note for note in notes if note not in usual]

        yield name, happened(run, error_percent(plainly(files), expected))
        for path in place.iterdir():
            path.unlink()


def _calibrated(place: Path, files: Mapping[str, bytes], sound: Path | None = None) -> tuple[str, list[str]]:
    place.mkdir()
    for name, content in files.items():
        if sound is not None and (sound / name).exists() and len(content) > 10**7 and _same(sound / name, content):
            os.link(sound / name, place / name)
        else:
            (place / name).write_bytes(content)
    result = calibrate(place)
    notes = [note for item in result.observations for note in item.notes]
    return result.untrusted, [*notes, *result.failures]


def _same(path: Path, content: bytes) -> bool:
    return path.read_bytes() == content


def outcomes(folder: Path, wanted: Callable[[str], bool] = lambda _: True) -> Iterator[tuple[str, str, Outcome]]:
    """Part, name and outcome of every case."""
    for name, outcome in vnis_outcomes(folder, lambda name: wanted(f"vnis {name}")):
        yield "vnis", name, outcome
    yield from spoilt_tables.outcomes(folder, wanted)


def main() -> None:
    """Print a line a case, and the counts."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("word", nargs="*")
    asked = parser.parse_args()
    counts: dict[str, int] = {}
    with tempfile.TemporaryDirectory() as place:
        for part, name, found in outcomes(
            Path(place), lambda name: not asked.word or any(name.startswith(word) for word in asked.word)
        ):
            counts[found.end] = counts.get(found.end, 0) + 1
            said = re.sub(r"\S*/", "", found.said)
            print(f"{part:10s} {name:52s} {found.error_percent:9.1f} %  {found.end:9s} {said[:110]}", flush=True)
    print(", ".join(f"{count} {end}" for end, count in sorted(counts.items())))


if __name__ == "__main__":
    main()
