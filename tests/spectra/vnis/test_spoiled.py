"""Every way to spoil a product that we could think of: an error of its own in one line, or a mask that is stated.

The products are synthetic and sound; each case changes one thing, as a broken download or malice would.
"""

import codecs
import re
import warnings
from collections.abc import Callable, Mapping
from pathlib import Path

import numpy as np
import pytest

from lunarsci.errors import DataError, LunarSciWarning
from lunarsci.spectra.vnis.calibrate import calibrate
from lunarsci.spectra.vnis.calibration import Calibration
from lunarsci.spectra.vnis.channels import CUBE_SHAPE, footprint_mask
from lunarsci.spectra.vnis.observation import read_observation

Files = dict[str, bytes]
Write = Callable[[Mapping[str, bytes]], Path]


def key(files: Files, kind: str, label: bool) -> str:
    """Name of the cube (VD), the table (SD) or a label of them."""
    return next(n for n in files if f"-{kind}_SCI" in n and n.endswith(".2BL" if label else ".2B"))


def run(write: Write, files: Files, named: str | None = None) -> Calibration:
    folder = write(files)
    return calibrate(read_observation(str(folder / (named or key(files, "SD", True)))))


def in_label(kind: str, pattern: str, new: str, count: int = 1) -> Callable[[Files], None]:
    def change(files: Files) -> None:
        name = key(files, kind, True)
        text, done = re.subn(pattern, new, files[name].decode(), count=count, flags=re.DOTALL)
        assert done, f"{pattern} is not in the label"
        files[name] = text.encode()

    return change


def in_table(change_rows: Callable[[list[str]], list[str]]) -> Callable[[Files], None]:
    """Change rows of the SWIR table and keep the size its label states right."""

    def change(files: Files) -> None:
        name, label = key(files, "SD", False), key(files, "SD", True)
        size = len(files[name])
        files[name] = ("\n".join(change_rows(files[name].decode().splitlines())) + "\n").encode()
        files[label] = files[label].replace(f">{size}<".encode(), f">{len(files[name])}<".encode())

    return change


def in_cube(change_values: Callable[[np.ndarray], np.ndarray | None]) -> Callable[[Files], None]:
    def change(files: Files) -> None:
        name = key(files, "VD", False)
        cube = np.frombuffer(files[name], "<f4").reshape(CUBE_SHAPE).copy()
        changed = change_values(cube)
        files[name] = (cube if changed is None else changed).tobytes()

    return change


def column(number: int, row: int, value: str) -> Callable[[list[str]], list[str]]:
    def change(rows: list[str]) -> list[str]:
        fields = rows[row].split()
        fields[number] = value
        rows[row] = " ".join(fields)
        return rows

    return change


def hole(cube: np.ndarray) -> np.ndarray:
    """Half of every frame from 900 nm on was never downloaded."""
    cube[90:] = 0
    return cube


def scaled(cube: np.ndarray, bands: slice, factor: float) -> np.ndarray:
    cube[bands] *= np.float32(factor)
    return cube


def reversed_radiance(rows: list[str]) -> list[str]:
    fields = [row.split() for row in rows]
    values = [row[4] for row in fields][::-1]
    return [" ".join([*row[:4], value, row[5]]) for row, value in zip(fields, values, strict=True)]


def swap_labels(files: Files) -> None:
    cube, table = key(files, "VD", True), key(files, "SD", True)
    files[cube], files[table] = files[table], files[cube]


def swap_data(files: Files) -> None:
    cube, table = key(files, "VD", False), key(files, "SD", False)
    files[cube], files[table] = files[table], files[cube]


def truncate(kind: str, label: bool, keep: float) -> Callable[[Files], None]:
    def change(files: Files) -> None:
        name = key(files, kind, label)
        files[name] = files[name][: int(keep * len(files[name]))]

    return change


def drop(kind: str, label: bool) -> Callable[[Files], None]:
    return lambda files: files.pop(key(files, kind, label)) and None


def twice(files: Files) -> None:
    name = key(files, "VD", False)
    files[re.sub(r"_(\d{14})_", "_20990101000000_", name, count=1)] = files[name]


def prefix(kind: str, text: bytes) -> Callable[[Files], None]:
    def change(files: Files) -> None:
        name = key(files, kind, True)
        head, _, body = files[name].partition(b"?>")
        files[name] = head + b"?>" + text + body

    return change


BOMB = b'<!DOCTYPE l [<!ENTITY a "ha"><!ENTITY b "&a;&a;&a;&a;&a;&a;&a;&a;&a;"><!ENTITY c "&b;&b;&b;&b;&b;&b;">]>'
EXTERNAL = b'<!DOCTYPE l SYSTEM "file:///etc/passwd">'
ANGLE = r"(<solar>.*?<incidence_angle[^>]*>)[^<]*"

REFUSED: dict[str, tuple[Callable[[Files], None], str]] = {
    "cube truncated": (truncate("VD", False, 0.7), r"of 26214400 bytes.*, not .* of 18350080 bytes: truncated"),
    "cube too long": (
        in_cube(lambda c: np.concatenate([c.ravel(), c.ravel()[:7]])),
        ", not .* of 26214428 bytes: truncated, or another file",
    ),
    "cube empty": (truncate("VD", False, 0), ", not .* of 0 bytes: truncated"),
    "cube and table swapped": (swap_data, ", not .* of 17400 bytes: truncated"),
    "cube of the other byte order": (in_cube(lambda c: c.astype(">f4")), "its byte order is not what the label says"),
    "cube of noise": (
        in_cube(lambda c: np.random.default_rng(0).integers(0, 2**32, c.size, dtype=np.uint32)),
        "no radiances",
    ),
    "cube of missing values": (in_cube(lambda c: np.full_like(c, np.nan)), "0 of 9085 pixels .* are lit and valid"),
    "cube of zeros": (in_cube(np.zeros_like), "0 of 9085 pixels of the footprint are lit"),
    "cube in shadow": (in_cube(lambda c: c * np.float32(0.01)), r"pixels of the footprint are lit and valid \(reflect"),
    "cube without its last channels": (in_cube(lambda c: c[90:].fill(np.nan)), "no usable image from 900 nm on"),
    "cube per um": (
        in_cube(lambda c: c * np.float32(1000)),
        r"VNIR is brighter than any rock .* not in W m-2 sr-1 nm-1",
    ),
    "table dark": (in_table(lambda rows: [re.sub("E-00", "E-05", r) for r in rows]), "SWIR is dark"),
    "table all flagged": (in_table(lambda rows: [r.replace("0x00", "0x01") for r in rows]), "no SWIR channel has a us"),
    "table empty": (in_table(lambda rows: []), "holds only blanks"),
    "table truncated in a row": (
        in_table(lambda rows: [*rows[:199], rows[199][:40]]),
        r"line 200 has 4 columns, a table has 300 rows of 6.*truncated",
    ),
    "table without its last rows": (in_table(lambda rows: rows[:250]), "250 rows, a table has 300 rows of 6"),
    "table with an extra column": (
        in_table(lambda rows: [f"{r} 1" for r in rows]),
        "line 1 has 7 columns",
    ),
    "table with a channel twice": (in_table(column(1, 150, "149")), "line 151, column 'band': '149'; channels count"),
    "table with a word for a channel": (in_table(column(1, 9, "ten")), "line 10, column 'band': 'ten' is not a number"),
    "table with a word for a radiance": (
        in_table(column(4, 9, "dark")),
        "line 10, column 'radiance': 'dark' is",
    ),
    "table with a word for a quality": (
        in_table(column(5, 9, "good")),
        "line 10, column 'quality': 'good'; q",
    ),
    "table of another time": (in_table(column(0, 0, "2021-01-01T00:00:00.000Z")), "line 1, column 'time': '2021-01-01"),
    "table without times": (in_table(column(0, 0, "yesterday")), "column 'time': 'yesterday'; rows have a time"),
    "table binary": (
        lambda files: files.__setitem__(key(files, "SD", False), bytes(range(256)) * 67 + bytes(248)),
        "binary file",
    ),
    "label cut off": (truncate("SD", True, 0.6), "broken XML at line .*truncated"),
    "label an error page": (
        lambda files: files.__setitem__(key(files, "SD", True), b"<html><body>404</body></html>"),
        "no PDS4 product",
    ),
    "label with an entity bomb": (prefix("SD", BOMB), "document type declaration"),
    "label with an external document": (prefix("VD", EXTERNAL), "document type declaration, which a label never has"),
    "label with an unknown entity": (in_label("SD", r"<title>[^<]*", "<title>&secret;"), r"undefined entity"),
    "label too deep": (in_label("SD", "<Reference_List>", "<a>" * 300 + "<Reference_List>"), "more than 256 deep"),
    "label too large": (prefix("SD", b"<!--" + b"x" * 27_000_000 + b"-->"), "no regular file of 26214400 bytes at"),
    "label names a file elsewhere": (
        in_label("SD", r"<file_name>[^<]*", "<file_name>../../etc/passwd"),
        r"describes \.\./\.\./etc/passwd of .*, not",
    ),
    "label names another file": (in_label("VD", r"<file_name>[^<]*", "<file_name>x.2B"), r"describes x\.2B.*, not"),
    "labels swapped": (swap_labels, "VD_.*describes '.*VNIS-SD_.*swapped"),
    "label of another observation": (
        in_label("SD", r"_(\d{4})_B\.2B</product_id>", "_0999_B.2B</product_id>"),
        "describes '.*_0999_.*another version",
    ),
    "label with another sequence": (
        in_label("SD", r"<sequence_id>\d+", "<sequence_id>0007"),
        "in sequence 0007: ",
    ),
    "label without a product id": (
        in_label("SD", r"<(product_id|logical_identifier)>[^<]*", r"<\1>rock", 2),
        "product id 'rock' is no VNIS",
    ),
    "label of a smaller cube": (
        in_label("VD", r"<elements>256", "<elements>128"),
        r"states 100 band x 128 line x 256 sample",
    ),
    "label of another layout": (in_label("VD", "<axis_name>Band", "<axis_name>Line"), "states 100 line x"),
    "label of another index order": (
        in_label("VD", "Last Index Fastest", "First Index Fastest"),
        "axis_index_order 'first index fastest', where only 'last index fastest' is read",
    ),
    "label of other numbers": (in_label("VD", "IEEE754LSBSingle", "IEEE754LSBDouble"), "type 'IEEE754LSBDouble'"),
    "label with a wrong size": (in_label("VD", "26214400", "26214401"), "of 26214401 bytes.*, not"),
    "label with a word for a size": (in_label("VD", ">26214400<", ">large<"), "file_size is 'large', not a count"),
    "sun below the horizon": (in_label("SD", ANGLE, r"\g<1>95.0"), "incidence angle 95 deg: .* not lit"),
    "sun without a number": (in_label("SD", ANGLE, r"\g<1>nan"), "solar/incidence_angle is 'nan', not a number"),
    "sun left out": (in_label("SD", r"<solar>.*?</solar>", ""), "solar/incidence_angle is missing"),
    "sun in radians": (
        in_label("SD", r'(<solar>\s*<incidence_angle) unit="deg"', r'\1 unit="rad"'),
        "is in 'rad', expected degrees",
    ),
    "phase angle that the directions contradict": (
        in_label("SD", r"(<center_point>.*?<phase_angle[^>]*>)[^<]*", r"\g<1>80.0"),
        "states a phase angle of 80 deg",
    ),
    "phase angle of no triangle": (
        in_label("SD", r"(<center_point>.*?<phase_angle[^>]*>)[^<]*", r"\g<1>170.0"),
        "phase",
    ),
    "stop before start": (
        in_label("SD", r"(<stop_date_time>)[^<]*", r"\g<1>2019-01-01T00:00:00Z"),
        "was measured from .* to 2019-01",
    ),
    "start no time": (in_label("SD", r"(<start_date_time>)[^<]*", r"\g<1>noon"), "'noon', not a time such as"),
    "image of another day": (
        in_label("VD", r"(<st(?:art|op)_date_time>)2020-07-16", r"\g<1>2020-07-26", 2),
        "10.0 days from .* no pair",
    ),
    "calibration version left out": (
        in_label("SD", r"<version_id>[^<]*</version_id>", ""),
        "identification_area/version_id is missing",
    ),
    "rover off the Moon": (in_label("VD", r"(<latitude[^>]*>)[^<]*", r"\g<1>-145.0"), "VD_SCI.*angle, time or p"),
    "cube with a hole of zeros": (in_cube(lambda c: hole(c)), "no usable image from 900 nm on|VNIR .* no usable"),
    "cube with axes swapped": (in_cube(lambda c: c.transpose(1, 2, 0).copy()), "all images are equally bright"),
    "table with digits of another script": (
        in_table(column(4, 9, "٤.٤")),
        "column 'radiance': '٤.٤' is not a number",
    ),
    "table with an underscore": (
        in_table(column(4, 9, "1_0.0")),
        "column 'radiance': '1_0.0' is not a number",
    ),
    "sun at another place than for the image": (
        in_label("SD", r"(<solar>.*?<incidence_angle[^>]*>)[^<]*", r"\g<1>60.0"),
        "phase|SD_SCI.*angle, time or place is wrong",
    ),
    "scan of half a year": (in_label("SD", r"(<stop_date_time>)2020", r"\g<1>2021"), "was measured from .* to 2021-07"),
    "year 1": (in_label("SD", r"(<start_date_time>)2020", r"\g<1>0001"), "is '0001.*not a time"),
    "an angle twice": (
        in_label("SD", r"(<solar>)", r'\1<incidence_angle unit="deg">10.0</incidence_angle>'),
        "appears 2 times",
    ),
    "an angle with an element in it": (in_label("SD", ANGLE, r"\g<1>64<b/>.445"), "holds other elements"),
    "radiance to be scaled": (
        in_label("VD", "</Element_Array>", "<scaling_factor>0.001</scaling_factor></Element_Array>"),
        "scaling_factor",
    ),
    "label of another version": (
        in_label("SD", r"_B\.2B</product_id>", "_A.2B</product_id>"),
        "describes '.*_A.2B': swapped",
    ),
    "quality codes of another day": (
        lambda files: files.update({n: c.replace(b"2020-07", b"2021-07") for n, c in files.items() if "_AUX_" in n}),
        "line 1, column 'time': '2021-07",
    ),
    "image that tells shadows flagged": (
        lambda files: files.update(
            {n: re.sub(rb"(?m)^(.*  3  54.2 .*)0x00$", rb"\g<1>0x01", c) for n, c in files.items() if "_AUX_" in n}
        ),
        "which tells shadows, is flagged",
    ),
    "no cube": (drop("VD", False), "no data file of its VD product"),
    "no label of the cube": (drop("VD", True), "no label of its VD product"),
    "no table": (drop("SD", False), "no data file of its SD product"),
    "two cubes": (twice, "are both the data file of its VD product"),
}


@pytest.mark.parametrize("case", REFUSED)
def test_refused_in_one_line(products: Files, write: Write, case: str) -> None:
    spoil, message = REFUSED[case]
    files = dict(products)
    spoil(files)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", LunarSciWarning)
        with pytest.raises(DataError, match=message) as caught:
            run(write, files)
    text = str(caught.value)
    assert "\n" not in text
    assert len(text) < 500
    assert "CE4" in text, "which product is it?"


def test_each_refusal_is_its_own() -> None:
    patterns = [message for _, message in REFUSED.values()]
    assert len(set(patterns)) == len(patterns) >= 25


@pytest.mark.parametrize(
    ("name", "message"),
    [
        ("CE5-L_GRAS_LMS-N-C000_SCI_N_20201202000000_20201202001000_0019_A.2BL", "lunar mineralogical spectrometer"),
        ("CE3_BMYK_VNIS-SD_SCI_N_20131223021320_20131223021320_0005_A.2A", "VNIS of CE3, .* only Chang'E-4 is read"),
        ("CE4_GRAS_VNIS-SD_SCI_N_20200716031001_20200716100000_0136_B.2A", "is level 2A, radiance is in level 2B"),
        ("CE4_GRAS_VNIS-CC_SCI_N_20200716031001_20200716100000_0136_B.2B", "is the product CC"),
        ("notes.txt", "is no VNIS product name"),
        ("CE4_GRAS_VNIS-SD_SCI_N_20200716031001_20200716100000_0136_B.2B", "no label of its VD product"),
    ],
)
def test_products_that_are_not_read(tmp_path: Path, name: str, message: str) -> None:
    (tmp_path / name).write_bytes(b"x")
    with pytest.raises(DataError, match=message):
        read_observation(str(tmp_path / name))


def shifted(values: np.ndarray, bands: slice, change: Callable[[np.ndarray], np.ndarray]) -> np.ndarray:
    inside = np.flatnonzero(footprint_mask().ravel())[:300]
    flat = values.reshape(CUBE_SHAPE[0], -1)
    flat[bands, inside] = change(flat[bands][:, inside])
    return values


def clipped(row: str) -> str:
    return re.sub(r"\d\.\d+E-\d+", "9.99999E-001", row)


MASKED: dict[str, tuple[Callable[[Files], None], str, int]] = {
    "pixels missing everywhere": (
        in_cube(lambda c: shifted(c, slice(None), lambda v: v * np.nan)),
        "300 pixels of the footprint are left out: no value at 465 nm",
        0,
    ),
    "pixels negative in a channel": (
        in_cube(lambda c: shifted(c, slice(50, 51), lambda v: -v)),
        "1 VNIR channels have lit pixels with a radiance of 0 or below",
        0,
    ),
    "an image clipped": (
        in_cube(lambda c: np.minimum(c, np.quantile(c[50], 0.9))),
        "VNIR channels have saturated pixels",
        -1,
    ),
    "an image missing": (in_cube(lambda c: c[50].fill(np.nan)), "", 1),
    "half of some images zero": (
        in_cube(lambda c: shifted(c, slice(40, 60), lambda v: v * 0)),
        "20 VNIR channels have lit pixels with a rad",
        0,
    ),
    "an image of one value": (in_cube(lambda c: c[50].fill(1.0)), "1 VNIR channels have one value in all pixels", 1),
    "an image much too bright": (in_cube(lambda c: scaled(c, slice(50, 51), 1.5)), "1 VNIR channels are no radi", 1),
    "a radiance of another exponent": (
        in_table(column(4, 120, "4.4E-001")),
        "1 SWIR channels are no radiance of lit",
        1,
    ),
    "a radiance almost 0": (in_table(column(4, 2, "1E-30")), "1 SWIR channels are no radiance of lit", 1),
    "a row flagged": (in_table(column(5, 120, "0x03")), "1 SWIR channels are flagged", 1),
    "a radiance negative": (in_table(column(4, 120, "-1.0E-003")), "1 SWIR channels have a radiance of 0 or below", 1),
    "a radiance missing": (in_table(column(4, 120, "NaN")), "1 SWIR channels have no number", 1),
    "a radiance infinite": (in_table(column(4, 120, "1E999")), "1 SWIR channels have no number", 1),
    "a radiance of Fortran": (in_table(lambda rows: [r.replace("E-", "D-") for r in rows]), "", 0),
    "channels clipped": (
        in_table(
            lambda rows: [re.sub(r"\d\.\d+E", "9.99999E", r) if k in (0, 5, 9) else r for k, r in enumerate(rows)]
        ),
        "3 SWIR channels are saturated",
        3,
    ),
    "cube of other channels' brightness": (in_cube(lambda c: scaled(c, slice(20, 41), 10)), "VNIR changes by", -1),
    "table with rows of another scale": (
        in_table(lambda rows: [r.replace("E-003", "E-002") if 100 <= k < 155 else r for k, r in enumerate(rows)]),
        "SWIR changes by",
        -1,
    ),
    "table upside down": (in_table(reversed_radiance), "VNIR to SWIR differs by", -1),
    "an image flagged": (
        lambda files: files.update({n: c.replace(b"0x00", b"0x02", 1) for n, c in files.items() if "_AUX_" in n}),
        "1 VNIR channels are flagged",
        1,
    ),
}


@pytest.mark.parametrize("case", MASKED)
def test_masked_and_stated(products: Files, write: Write, case: str) -> None:
    spoil, note, masked = MASKED[case]
    files = dict(products)
    spoil(files)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", LunarSciWarning)
        found = run(write, files)
        sound = run(write, dict(products))
    assert note in " | ".join(found.notes)
    if masked >= 0:
        assert np.isnan(found.reflectance).sum() == masked
        good = np.isfinite(found.reflectance)
        assert found.reflectance[good] == pytest.approx(sound.reflectance[good], rel=0.03)


def test_labels_in_other_encodings_and_cases_are_read(products: Files, write: Write) -> None:
    files = dict(products)
    table, cube = key(files, "SD", True), key(files, "VD", True)
    files[table] = files[table].decode().encode("gb18030")
    files[cube] = (
        files[cube].replace(b"<incidence_angle", b"<Incidence_Angle").replace(b"/incidence_angle", b"/Incidence_Angle")
    )
    expected = run(write, dict(products)).reflectance
    assert run(write, files).reflectance == pytest.approx(expected, abs=0)
    text = files[table].decode("gb18030")
    files[table] = codecs.BOM_UTF16_LE + text.encode("utf-16-le")
    assert run(write, files).reflectance == pytest.approx(expected, abs=0)
    files[table] = text.encode().replace("时".encode(), b"\xff\xfe\xfd")
    assert run(write, files).reflectance == pytest.approx(expected, abs=0)


def test_names_in_lower_case_and_without_the_auxiliary_table(products: Files, write: Write) -> None:
    files = {name.lower(): content for name, content in products.items() if "_AUX_" not in name}
    folder = write(files)
    label = next(name for name in files if name.endswith("sd_sci_n") or name.endswith(".2bl"))
    assert np.isfinite(calibrate(read_observation(str(folder / label))).reflectance).all()


@pytest.mark.parametrize("kind", ["VD", "SD"])
@pytest.mark.parametrize("label", [True, False])
def test_any_file_names_the_observation(products: Files, write: Write, kind: str, label: bool) -> None:
    files = dict(products)
    assert run(write, files, key(files, kind, label)).id == "SYNTHETIC-CE4-0001"
