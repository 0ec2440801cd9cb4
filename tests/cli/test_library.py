"""`spectra library`: from laboratory files to a library that is listed, drawn and checked."""

import csv
import io
import json
import struct
from pathlib import Path

import numpy as np
import pytest

from lunarsci.io.inputs import read_input
from lunarsci.spectra.readers.library import read_library

LIBRARY = ("spectra", "library")


@pytest.fixture
def laboratory(tmp_path: Path) -> Path:
    """The same two spectra in four formats: RELAB, CSV, USGS splib07, ENVI."""
    um = np.linspace(0.45, 2.45, 80)
    olivine, pyroxene = 0.3 + 0.1 * um, 0.5 - 0.1 * um
    rows = "\n".join(f"{1000 * w:.2f} {r:.6f} 0.0" for w, r in zip(um, olivine, strict=True))
    (tmp_path / "c1po01.tab").write_text(f"{um.size}\n{rows}\n")
    rows = "\n".join(f"{1000 * w:.2f},{o:.6f},{p:.6f}" for w, o, p in zip(um, olivine, pyroxene, strict=True))
    (tmp_path / "table.csv").write_text(f"wavelength_nm,ol-csv,px-csv\n{rows}\n")
    values = "\n".join(f"{value:.6e}" for value in pyroxene)
    (tmp_path / "splib07a_px.txt").write_text(f" splib07a Record=7: Pyroxene X1  BECKb AREF\n{values}\n")
    values = "\n".join(f"{value:.8f}" for value in um)
    (tmp_path / "splib07a_Wavelengths_BECK.txt").write_text(f" splib07a Record=1: Wavelengths BECK\n{values}\n")
    names, grid = "ol-envi, px-envi", ", ".join(f"{value:.8f}" for value in um)
    (tmp_path / "envi.hdr").write_text(
        f"ENVI\nsamples = {um.size}\nlines = 2\nbands = 1\nfile type = ENVI Spectral Library\ndata type = 4\n"
        f"byte order = 0\nwavelength units = Micrometers\nspectra names = {{{names}}}\nwavelength = {{{grid}}}\n"
    )
    (tmp_path / "envi.sli").write_bytes(struct.pack(f"<{2 * um.size}f", *olivine, *pyroxene))
    return tmp_path


@pytest.fixture
def samples(tmp_path: Path) -> Path:
    path = tmp_path / "samples" / "samples.csv"
    path.parent.mkdir()
    ids = {"c1po01": "ol", "ol-csv": "ol", "ol-envi": "ol"}
    rows = [f"{id},{mineral},0.9,,,,45" for id, mineral in ids.items()]
    rows += [f"{id},opx,,0.2,0.78,0.02,45" for id in ("px-csv", "splib07a_px", "px-envi")]
    path.write_text("id,mineral,fo,fs,en,wo,max_um\n" + "\n".join(rows) + "\n")
    return path


@pytest.fixture
def library(run, laboratory: Path, samples: Path) -> Path:
    path = samples.parent / "lib.ecsv"
    done = run(*LIBRARY, "import", laboratory, "--metadata", samples, "--source", "mine", "-o", path, "-q")
    assert (done.code, done.out, done.err) == (0, "", [])
    return path


def test_a_folder_of_all_formats_becomes_one_library(library: Path) -> None:
    members = {member.id: member for member in read_library(read_input(str(library)))}
    assert members.keys() == {"c1po01", "ol-csv", "px-csv", "splib07a_px", "ol-envi", "px-envi"}
    for name, like in (("c1po01", "ol-csv"), ("ol-envi", "ol-csv"), ("splib07a_px", "px-csv"), ("px-envi", "px-csv")):
        np.testing.assert_allclose(members[name].reflectance, members[like].reflectance, atol=1e-6)
        np.testing.assert_allclose(members[name].wavelength_nm, members[like].wavelength_nm, atol=0.01)
        assert members[name].sample() == members[like].sample()
    assert (members["c1po01"].mineral, members["c1po01"].fo, members["c1po01"].source) == ("olivine", 0.9, "mine")
    assert (members["px-envi"].fs, members["px-envi"].wo) == (0.2, 0.02)


def test_list_is_a_table_json_and_csv(run, library: Path) -> None:
    assert "orthopyroxene" in run(*LIBRARY, "list", library).out
    document = json.loads(run(*LIBRARY, "list", library, "--json").out)
    assert document["schema"] == "lunarsci/spectra-library/1"
    first = document["result"]["end_members"][0]
    assert (first["id"], first["fo"], first["channels"]) == ("c1po01", 0.9, 80)
    rows = list(csv.DictReader(io.StringIO(run(*LIBRARY, "list", library, "--csv").out)))
    assert [row["mineral"] for row in rows].count("olivine") == 3


def test_the_library_remembers_how_it_was_made_and_is_repeatable(run, laboratory: Path, samples: Path) -> None:
    arguments = (*LIBRARY, "import", laboratory / "table.csv", "--mineral", "other", "--no-time", "-q", "-o")
    first, second = samples.parent / "a.ecsv", samples.parent / "b.ecsv"
    assert (run(*arguments, first).code, run(*arguments, second).code) == (0, 0)
    assert first.read_bytes() == second.read_bytes()
    assert "table.csv" in first.read_text().split("provenance")[1]
    assert {member.mineral for member in read_library(read_input(str(first)))} == {"other"}


def test_libraries_are_merged_and_described_again(run, library: Path, laboratory: Path) -> None:
    merged, more = library.parent / "merged.ecsv", laboratory / "more.csv"
    more.write_text((laboratory / "table.csv").read_text().replace("-csv", "-new"))
    done = run(*LIBRARY, "import", library, more, "--mineral", "glass", "-o", merged, "-q")
    assert done.code == 0
    minerals = {member.id: member.mineral for member in read_library(read_input(str(merged)))}
    assert (minerals["ol-csv"], minerals["ol-new"], len(minerals)) == ("olivine", "glass", 8)


def test_mixtures_and_strangers_are_named(run, laboratory: Path, tmp_path: Path) -> None:
    table = tmp_path / "modes.txt"
    table.write_text("id,vol_ol,vol_opx\nol-csv,0.5,0.5\n")
    done = run(*LIBRARY, "import", laboratory / "table.csv", "--metadata", table, "--json")
    result = json.loads(done.out)["result"]
    assert (result["left_out"], result["not_in_metadata"]) == (["ol-csv"], ["px-csv"])
    assert any("1 mixtures, left out: ol-csv" in line for line in done.err)
    assert any("says nothing: px-csv" in line for line in done.err)


def test_check_is_content_with_a_good_library(run, library: Path) -> None:
    done = run(*LIBRARY, "check", library, "--json")
    assert (done.code, done.err) == (0, [])
    assert json.loads(done.out)["result"]["ok"] is True
    assert "all 6 end members are fit for use: 3 of olivine, 3" in run(*LIBRARY, "check", library).out


def test_check_names_what_must_be_mended_and_exits_3(run, library: Path) -> None:
    text = library.read_text()
    library.write_text(text.replace("mineral: olivine", "mineral: null", 1).replace("fs: 0.2", "fs: 0.9", 1))
    done = run(*LIBRARY, "check", library)
    assert done.code == 3
    assert "no mineral" in done.out
    assert "fs + en + wo = 1.700, not 1" in done.out
    assert done.err == ["not fit for use: mend 2 end members: c1po01, px-csv"]
    rows = list(csv.DictReader(io.StringIO(run(*LIBRARY, "check", library, "--csv").out)))
    assert [row["must_mend"] for row in rows].count("true") == 2


def test_two_libraries_with_one_id_do_not_go_together(run, library: Path) -> None:
    twin = library.with_name("twin.ecsv")
    twin.write_bytes(library.read_bytes())
    done = run(*LIBRARY, "check", library, twin)
    assert (done.code, done.out.count("2 end members have this id")) == (3, 12)
    both = run(*LIBRARY, "import", library, twin, "-q", "-o", library.with_name("both.ecsv"))
    assert (both.code, len(both.err)) == (1, 1)
    assert "two end members have this id" in both.err[0]
    assert not library.with_name("both.ecsv").exists()


def test_plot_draws(run, library: Path) -> None:
    picture, again = (library.with_name(f"{name}.svg") for name in "ab")
    done = run(*LIBRARY, "plot", library, "-o", picture)
    assert (done.code, done.out, done.err[0]) == (0, "", f"written: {picture}")
    assert run(*LIBRARY, "plot", library, "--plot", again, "-q").code == 0
    assert picture.read_bytes() == again.read_bytes()
    assert "orthopyroxene: 3" in picture.read_text()


@pytest.mark.parametrize(
    ("arguments", "code"),
    [
        (("plot", "lib.ecsv"), 2),
        (("plot", "lib.ecsv", "-o", "x.json"), 2),
        (("import", "x.csv", "--mineral", "chalk"), 2),
        (("import",), 2),
        (("list", "nowhere.ecsv"), 1),
        (("import", "nowhere.csv", "--mineral", "olivine"), 1),
    ],
)
def test_wrong_usage_and_missing_files(run, arguments: tuple[str, ...], code: int) -> None:
    wrong = run(*LIBRARY, *arguments)
    assert (wrong.code, wrong.out, len(wrong.err)) == (code, "", 1)


def test_a_library_is_not_written_as_a_list(run, laboratory: Path, tmp_path: Path) -> None:
    wrong = run(*LIBRARY, "import", laboratory / "table.csv", "-o", tmp_path / "lib.csv", "-q")
    assert (wrong.code, len(wrong.err), (tmp_path / "lib.csv").exists()) == (1, 1, False)
    assert ".ecsv" in wrong.err[0]


def test_the_table_may_lie_among_the_spectra(run, laboratory: Path, samples: Path) -> None:
    moved = samples.rename(laboratory / "samples.csv")
    done = run(*LIBRARY, "import", laboratory, "--metadata", moved, "--json", "-q")
    assert (done.code, done.err) == (0, [])
    only = run(*LIBRARY, "import", moved, "--metadata", moved)
    assert (only.code, only.out, len(only.err)) == (1, "", 1)


def test_a_bad_file_among_good_ones_is_named_and_the_rest_imported(run, laboratory: Path) -> None:
    (laboratory / "bad.csv").write_text("wavelength_nm,x\n400,bright\n")
    done = run(*LIBRARY, "import", laboratory, "--mineral", "olivine", "--json", "-q")
    assert done.code == 1
    assert len(json.loads(done.out)["result"]["end_members"]) == 6
    assert [line for line in done.err if "bad.csv" in line]


@pytest.mark.reference
def test_the_laboratory_collection_becomes_a_library(run, reference_data: Path, tmp_path: Path) -> None:
    """172 spectra with their modes: the pure ones in, the mixtures out, nothing to mend."""
    folder, path = reference_data / "spectra/relab", tmp_path / "relab.ecsv"
    spectra, table = folder / "reflectance.csv", folder / "manifest.csv"
    assert run(*LIBRARY, "import", spectra, "--metadata", table, "-o", path, "-q").code == 0
    minerals = [member.mineral for member in read_library(read_input(str(path)))]
    counts = {mineral: minerals.count(mineral) for mineral in set(minerals)}
    assert counts == {"olivine": 12, "orthopyroxene": 33, "clinopyroxene": 53, "plagioclase": 20}
    assert run(*LIBRARY, "check", path, "-q").code == 0
