"""Observations and their labels: which files, what they say, and whether the Sun, session and tables agree."""

import hashlib
import math
import random
import re
from collections.abc import Callable, Mapping
from dataclasses import replace
from datetime import UTC, datetime, timedelta
from pathlib import Path

import numpy as np
import pytest

from lunarsci.errors import DataError
from lunarsci.spectra.photometry import Geometry
from lunarsci.spectra.vnis.label import SUN_DEG, Label, product_name
from lunarsci.spectra.vnis.observation import (
    LANDING_SITE,
    doubts_of,
    find_parts,
    one_per_observation,
    read_observation,
)
from lunarsci.spectra.vnis.splice import usual_gains
from lunarsci.sun import sun_in_moon_frame, sun_incidence_deg

Files = dict[str, bytes]
Write = Callable[[Mapping[str, bytes]], Path]
KINDS = ("VD_SCI_N", "SD_SCI_N", "VD_AUX_N")


def names(sequence: int = 136, version: str = "B", stamp: str = "20200716031001_20200716100000") -> list[str]:
    """Labels, data and the auxiliary table of one observation."""
    stems = [f"CE4_GRAS_VNIS-{kind}_{stamp}_{sequence:04d}_{version}.2B" for kind in KINDS]
    return [f"{stems[0]}L", stems[0], f"{stems[1]}L", stems[1], stems[2]]


def touch(folder: Path, listed: list[str]) -> list[str]:
    folder.mkdir(exist_ok=True)
    for name in listed:
        (folder / name).write_bytes(b"x")
    return [str(folder / name) for name in listed]


def test_a_name_is_taken_apart() -> None:
    name = product_name("some/where/CE4_GRAS_VNIS-VD_SCI_N_20200716031001_20200716100000_0136_B.2BL")
    assert name is not None
    assert (name.mission, name.instrument, name.kind, name.role) == ("CE4", "VNIS", "VD", "SCI")
    assert (name.start, name.stop, name.sequence) == ("20200716031001", "20200716100000", "0136")
    assert (name.version, name.level, name.is_label, name.synthetic) == ("B", "2B", True, False)
    for file, *wanted in (
        ("ce4_gras_vnis-sd_sci_n_20250729024000_20250729042000_0357_b.2bl", "CE4-0357", "SD", True),
        ("SYNTHETIC_CE4_GRAS_VNIS-SD_SCI_N_20200716081709_20200716082500_0001_B.2B", "SYNTHETIC-CE4-0001", "SD", False),
        ("CE5-L_GRAS_LMS-C-C000_SCI_N_20201202000000_20201202001000_0019_A.2B", "CE5-0019", "C", False),
        ("CE3_BMYK_VNIS-CD_SCI_N_20131223021320_20131223021320_0005_A.2A", "CE3-0005", "CD", False),
    ):
        other = product_name(file)
        assert other is not None and [other.observation, other.kind, other.is_label] == wanted
    for file in (
        "",
        "notes.txt",
        "CE4_GRAS_VNIS-VD_SCI_N_20200716031001_20200716100000_0136_B.2BL.txt",
        "CE4_GRAS_VNIS-VD_SCI_N_20200716031001_20200716100000_136_B.2B",
        "CE4_GRAS_PCAML-C-012_SCI_N_20190111072202_20190111072202_0009_B.2B",
        "SYNTHETIC_CE4_GRAS_VNIS_20200716081709_20200716082500_0001_truth.json",
        "CE4_GRAS_VNIS-VD_SCI_N_20200716031001_20200716100000_0136_B.2B\nx",
    ):
        assert product_name(file) is None


@pytest.mark.parametrize("seed", range(2))
def test_the_parts_of_an_observation_become_one_path(seed: int) -> None:
    listed = [f"d/{name}" for name in names(136) + names(137)]
    random.Random(seed).shuffle(listed)
    chosen = one_per_observation(listed)
    assert sorted(product_name(path).sequence for path in chosen) == ["0136", "0137"]  # type: ignore[union-attr]
    assert not any("AUX" in path for path in chosen)
    assert set(chosen) <= set(listed)
    assert one_per_observation([]) == []


def test_folders_and_missions_are_kept_apart() -> None:
    synthetic = [f"a/SYNTHETIC_{name}" for name in names(136)]
    chosen = one_per_observation([f"{folder}/{name}" for folder in ("a", "b") for name in names(136)] + synthetic)
    assert len(chosen) == 3
    assert {Path(path).parent.name for path in chosen} == {"a", "b"}


@pytest.mark.parametrize("order", [("A", "B"), ("B", "A"), ("A", "C", "B")])
def test_the_latest_version_counts(order: tuple[str, ...]) -> None:
    listed = [name for version in order for name in names(136, version)]
    [chosen] = one_per_observation(listed)
    assert product_name(chosen).version == max(order)  # type: ignore[union-attr]


def test_other_files_stay_in_their_place() -> None:
    listed = ["z.csv", *names(5), "a.csv", "-", "z.csv", *names(2)]
    chosen = one_per_observation(listed)
    assert [path for path in chosen if product_name(path) is None] == ["z.csv", "a.csv", "-"]
    assert [path if product_name(path) is None else product_name(path).sequence for path in chosen] == [  # type: ignore[union-attr]
        "z.csv", "0005", "a.csv", "-", "0002",
    ]  # fmt: skip


def test_what_is_not_read_stands_for_an_observation_only_alone() -> None:
    """So that naming it still tells why it is not read, and a folder that has it too is not disturbed."""
    raw = names(136)[0].replace(".2BL", ".2AL")
    for alone in (names(136)[4], raw):
        assert one_per_observation([alone]) == [alone]
        for listed in ([alone, *names(136)[:4]], [*names(136)[:4], alone]):
            [chosen] = one_per_observation(listed)
            assert chosen in names(136)[:4]


@pytest.mark.parametrize("part", range(4))
def test_the_parts_are_found_from_any_of_them(tmp_path: Path, part: int) -> None:
    paths = touch(tmp_path / "a", names(136))
    touch(tmp_path / "a", names(137))
    touch(tmp_path / "b", names(136))
    found = find_parts(paths[part])
    assert found.id == "CE4-0136"
    assert [found.cube_label, found.cube, found.table_label, found.table, found.flags] == paths


def test_the_parts_are_of_one_version_and_the_auxiliary_table_may_be_missing(tmp_path: Path) -> None:
    paths = touch(tmp_path, names(136)[:4])
    assert find_parts(paths[0]).flags is None
    touch(tmp_path, names(136, "A"))
    assert find_parts(paths[0]).flags is None
    touch(tmp_path, names(136))
    for version in "AB":
        found = find_parts(str(tmp_path / names(136, version)[2]))
        for path in (found.cube_label, found.cube, found.table_label, found.table, found.flags):
            assert product_name(path).version == version  # type: ignore[union-attr,arg-type]


def test_a_partner_of_another_session_is_taken_by_its_sequence_number(tmp_path: Path) -> None:
    other = names(136, stamp="20200716031000_20200716100059")
    touch(tmp_path, names(136)[:2] + other[2:4])
    assert find_parts(str(tmp_path / names(136)[0])).table == str(tmp_path / other[3])


def test_a_product_in_the_working_folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    touch(tmp_path, names(136))
    monkeypatch.chdir(tmp_path)
    found = find_parts(names(136)[0])
    assert [found.cube_label, found.table] == [names(136)[0], names(136)[3]]


OTHER = names(136, stamp="20200716031000_20200716100059")


@pytest.mark.parametrize(
    ("there", "message"),
    [
        (names(136)[1:], "^CE4-0136: no label of its VD product, version B, in .*; put it there$"),
        ([*names(136)[:1], *names(136)[2:]], "no data file of its VD product"),
        ([*names(136)[:2], *names(136)[3:]], "no label of its SD product"),
        ([*names(136)[:3], *names(136)[4:]], "no data file of its SD product"),
        (names(136)[:2] + names(136, "A"), r"no label of its SD product, version B, .*there is only CE4.*_A\.2BL"),
        ([*names(136), OTHER[3]], "are both the data file of its SD product; keep one of them"),
        ([*names(136), OTHER[4]], "are both the auxiliary table of its VD product; keep one of them"),
    ],
)
def test_missing_and_double_parts_are_named(tmp_path: Path, there: list[str], message: str) -> None:
    touch(tmp_path, there)
    with pytest.raises(DataError, match=message):
        find_parts(str(tmp_path / names(136)[0]))
    with pytest.raises(DataError, match="no label of its VD product, version B, in /nowhere/at/all"):
        find_parts(f"/nowhere/at/all/{names(136)[0]}")


def test_an_observation_has_what_its_files_have(products: Files, write: Write) -> None:
    folder = write(products)
    label = next(name for name in products if "SD_SCI" in name and name.endswith("L"))
    found = read_observation(str(folder / label))
    table = next(content for name, content in products.items() if "SD_SCI" in name and name.endswith("B"))
    assert found.table.radiance == pytest.approx([float(row.split()[4]) for row in table.splitlines()], abs=0)
    assert not found.table.flagged.any()
    cube = next(content for content in products.values() if len(content) == 26_214_400)
    # Band by band, each line by line.
    assert found.cube[7, 3, 200] == np.frombuffer(cube[4 * (7 * 65536 + 3 * 256 + 200) :][:4], "<f4")[0]
    assert found.cube_flags is not None
    assert found.cube_flags.shape == (100,)
    assert found.inputs == {
        str(folder / name): hashlib.sha256(content).hexdigest()
        for name, content in products.items()
        if not name.endswith(".json")
    }


def test_big_endian_numbers_are_read_where_the_label_says_so(products: Files, write: Write) -> None:
    changed = dict(products)
    for name, content in products.items():
        if "VD_SCI" in name and name.endswith("L"):
            changed[name] = content.replace(b"IEEE754LSBSingle", b"IEEE754MSBSingle")
            label = name
        elif "VD_SCI" in name:
            changed[name] = np.frombuffer(content, "<f4").astype(">f4").tobytes()
            wanted = np.frombuffer(content, "<f4").reshape(100, 256, 256)
    found = read_observation(str(write(changed) / label))
    assert found.cube.dtype == np.float32
    assert np.array_equal(found.cube, wanted)


def test_rows_counted_from_1_and_lines_of_windows_are_read(products: Files, write: Write) -> None:
    changed = dict(products)
    for name, content in products.items():
        if "SD_SCI" in name and name.endswith("B"):
            rows = [row.split() for row in content.decode().splitlines()]
            text = "\r\n".join("\t".join([r[0], str(int(r[1]) + 1), *r[2:]]) for r in rows)
            label, changed[name] = f"{name}L", text.encode()
    size = str(len(changed[label[:-1]])).encode()
    changed[label] = products[label].replace(b">17400<", b">" + size + b"<")
    folder, plain = write(changed), products[label[:-1]]
    found = read_observation(str(folder / label))
    assert found.table.radiance == pytest.approx([float(row.split()[4]) for row in plain.splitlines()], abs=0)


NAME = "CE4_GRAS_VNIS-SD_SCI_N_20200716031001_20200716100000_0136_B.2BL"


def label(incidence_deg: float = 64.445, start: datetime = datetime(2020, 7, 16, 8, 17, 4, tzinfo=UTC)) -> Label:
    name = product_name(NAME)
    assert name is not None
    geometry = Geometry(incidence_deg, 45.557, 54.505)
    return Label(NAME, name, 2.0, start, start + timedelta(minutes=6), geometry, -45.4446, 177.585, ())


def test_the_public_labels_of_observation_136_agree_with_the_sun() -> None:
    """64.445 deg in the label of the short-wave scan, 64.412 in that of the images, which follow it."""
    start = datetime(2020, 7, 16, 8, 17, 4, tzinfo=UTC)
    assert sun_incidence_deg(start, 177.585, -45.4446) == pytest.approx(64.445, abs=0.01)
    assert sun_incidence_deg(start + timedelta(minutes=7), 177.585, -45.4446) == pytest.approx(64.412, abs=0.01)
    assert doubts_of(label()) == []


def test_at_an_eclipse_the_sun_stands_over_the_near_or_the_far_side() -> None:
    assert sun_in_moon_frame(datetime(2019, 1, 21, 5, 16, tzinfo=UTC))[0] > 0.99  # a lunar one
    assert sun_in_moon_frame(datetime(2017, 8, 21, 18, 26, tzinfo=UTC))[0] < -0.99


@pytest.mark.parametrize("hours", [-2.0, 2.0, 8.0])
def test_hours_are_doubted(hours: float) -> None:
    moved = label(start=datetime(2020, 7, 16, 8, 17, 4, tzinfo=UTC) + timedelta(hours=hours))
    assert "from the vertical; then and there it stood" in doubts_of(moved)[0]


def test_what_is_far_off_is_refused() -> None:
    for spoilt in (label(45.557), label(start=datetime(2019, 7, 16, 8, 17, 4, tzinfo=UTC))):
        with pytest.raises(DataError, match="angle, time or place is wrong"):
            doubts_of(spoilt)


def test_a_label_without_a_place_is_looked_at_from_the_landing_site() -> None:
    unplaced = replace(label(), latitude_deg=math.nan, longitude_deg=math.nan)
    assert doubts_of(unplaced) == []
    assert abs(sun_incidence_deg(unplaced.start, *LANDING_SITE) - 64.445) < SUN_DEG / 10


def test_a_month_later_is_refused_by_the_session() -> None:
    later = label(66.2, datetime(2020, 8, 14, 21, 0, tzinfo=UTC))
    found = sun_incidence_deg(later.start, 177.585, -45.4446)
    with pytest.raises(DataError, match="outside the 2020-07-16T03:10 to 2020-07-16T10:00 of its name"):
        doubts_of(label(found, later.start))


def test_a_gain_unlike_the_others() -> None:
    assert usual_gains([0.98, 0.99, 0.97, 0.98, 0.88]) == [None, None, None, None, 0.98]
    assert usual_gains([0.98, 0.99, 0.97, 0.88]) == [None] * 4  # too few
    assert usual_gains([0.90, 0.95, 1.0, 1.05, 1.10]) == [None] * 5  # all differ


def test_an_emission_that_differs_from_that_of_the_image_is_doubted(products: Files, write: Write) -> None:
    """By 2.5 deg reflectances err by some 2 %; the phase angle alone would still fit."""
    changed = dict(products)
    label = next(name for name in products if "SD_SCI" in name and name.endswith("L"))
    pattern = rb"(<center_point>.*?<incidence_angle[^>]*>)([^<]*)"
    emission_deg = float(re.search(pattern, products[label], re.DOTALL)[2])  # type: ignore[index]
    assert read_observation(str(write(products) / label)).doubts == ()
    changed[label] = re.sub(pattern, rb"\g<1>%.3f" % (emission_deg + 2.5), products[label], flags=re.DOTALL)
    [doubt] = read_observation(str(write(changed) / label)).doubts
    assert f"states emission {emission_deg + 2.5:g} deg, the image's label {emission_deg:g}" in doubt
