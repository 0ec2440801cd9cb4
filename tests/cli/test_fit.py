"""`lunarsci spectra fit` with everything that can be asked of it."""

import csv
import io
import json
import math
from pathlib import Path
from typing import Any

import pytest

from lunarsci.io.inputs import read_input
from lunarsci.spectra.mgm.fit_file import read_fit_file

START = """folder
rock.asc
-170,25,10
600,2300,1
2.000E-03,1.000E-06
Q
0.2\t-1e-6\t0\t0
1\t1e-4\t1e-8\t0
3
333\t400\t-0.5
40\t60\t1
950\t250\t-0.3
60\t100\t1
2000\t500\t-0.3
120\t150\t1
"""


@pytest.fixture
def rock(one_rock: Path, once: None) -> Path:
    """One rock, fitted once for every set of options."""
    return one_rock


@pytest.fixture
def start(tmp_path: Path) -> Path:
    """A start file of three bands over a polynomial in wavenumber."""
    path = tmp_path / "start.fit"
    path.write_text(START)
    return path


def fitted(run, *arguments: object, command: str = "fit", code: int = 0) -> dict[str, Any]:
    done = run("spectra", command, *arguments, "--json")
    assert done.code == code, done.err
    record: dict[str, Any] = json.loads(done.out)["result"]["spectra"][0]
    return record


def unmixed(run, *arguments: object) -> dict[str, Any]:
    return fitted(run, *arguments, command="unmix")


def bands(record: dict[str, Any]) -> dict[str, dict[str, Any]]:
    return {band["name"]: band for band in record["bands"]}


def test_a_quick_look_is_one_descent(run, rock: Path) -> None:
    quick, found = (json.loads(run("spectra", "fit", rock, "--starts", n, "--json").out) for n in (0, 4))
    assert '"starts": 0' in json.dumps(quick["provenance"])
    assert quick["result"]["spectra"][0]["bic"] > found["result"]["spectra"][0]["bic"] - 0.1


def test_constraints_hold_and_are_in_the_provenance(run, rock: Path) -> None:
    done = run(
        "spectra", "fit", rock, "--assemblage", "OPX-CPX", "--fix", "opx_1_center_nm=920", "--bound",
        "cpx_1_fwhm_nm=150:210", "--tie", "visible_2_fwhm_nm=visible_1_fwhm_nm+10", "--json",
    )  # fmt: skip
    document = json.loads(done.out)
    found = bands(document["result"]["spectra"][0])
    assert found["OPX 1"]["center_nm"] == pytest.approx(920, abs=1e-6)
    assert found["OPX 1"]["center_sigma_nm"] == 0
    assert 150 <= found["CPX 1"]["fwhm_nm"] <= 210 + 1e-6
    assert found["visible 2"]["fwhm_nm"] == pytest.approx(found["visible 1"]["fwhm_nm"] + 10, abs=0.01)
    assert document["provenance"]["options"]["fix"] == ["opx_1_center_nm=920"]


def test_a_stated_composition_moves_what_the_data_leave_open(run, rock: Path) -> None:
    low = fitted(run, rock, "--composition", "fo=10:2")["compositions"]
    high = fitted(run, rock, "--composition", "fo=90:2")["compositions"]
    known = [item["fo"]["mean"] for item in (low, high) if item["fo"]["mean"] is not None]
    assert known == sorted(known)
    centres = [bands(fitted(run, rock, "--composition", f"fo={fo}:2"))["OL M1-2"]["center_nm"] for fo in (10, 90)]
    assert centres[0] > centres[1] + 30


def test_the_spread_over_continua_is_a_column_of_its_own(run, rock: Path) -> None:
    options = (rock, "--assemblage", "OPX-CPX", "--continuum-spread", "--starts", 1)
    record = fitted(run, *options)
    assert record["nbsr"]["um2"]["continuum"] > 0
    assert bands(record)["OPX 2"]["center_continuum_nm"] > 0
    table = run("spectra", "fit", *options)
    assert "continua: centre [nm]" in table.out
    assert "other continua give ratios of OPX from" in table.out


@pytest.mark.parametrize("errors", ["profile", "sample"])
def test_intervals_hold_their_value_and_the_wider_one_the_narrower(run, rock: Path, errors: str) -> None:
    options = (rock, "--assemblage", "OPX-CPX" if errors == "profile" else "OPX", "--errors", errors, "--starts", 1)
    record = fitted(run, *options, code=0 if errors == "profile" else 3)
    intervals = record["intervals"]
    assert intervals["method"] == errors
    names = {item["name"] for item in intervals["intervals"]}
    assert "opx_1_center_nm" in names
    assert errors == "sample" or {"cpx_2_strength", "nbsr_um2_opx"} <= names
    for item in intervals["intervals"]:
        low95, low68, high68, high95 = (item[key] for key in ("low95", "low68", "high68", "high95"))
        if None not in (low95, low68, high68, high95):
            assert low95 <= low68 <= item["value"] <= high68 <= high95, item
    shown = run("spectra", "fit", *options).out
    assert f"intervals by {errors}" in shown
    if errors == "sample":
        assert fitted(run, *options, "--seed", 4, code=3)["intervals"] != intervals


def test_the_assemblage_can_be_chosen_by_the_spectrum(run, rock: Path) -> None:
    options = (rock, "--assemblage", "auto", "--composition", "fs=80:2")
    record = fitted(run, *options)
    assert record["assemblage"] == record["choice"]["assemblage"] == record["choice"]["candidates"][0]["assemblage"]
    assert len(record["choice"]["candidates"]) == 15
    table = run("spectra", "fit", *options).out
    assert "assemblages, the most probable first" in table and "each below half a per cent" in table
    assert record["choice"]["status"] in table


def test_a_start_file_brings_bands_and_continuum_and_a_result_file_comes_back(
    run, rock: Path, start: Path, tmp_path: Path
) -> None:
    result = tmp_path / "rock_fin.fit"
    for prior in ("map", "damping"):
        done = run("spectra", "fit", rock, "--start-file", start, "--prior", prior, "-o", result, "--force")
        assert done.code == 0, done.err
        file = read_fit_file(read_input(str(result)))
        assert len(file.bands) == 3
        assert file.continuum == "Q"
        assert file.wavelength_axis[:2] == (600, 2300)
        assert file.bands[1].center_nm == pytest.approx(960, abs=60)
    record = fitted(run, rock, "--start-file", start, "--prior", "damping")
    assert record["prior"] == "damping"
    assert record["assemblage"] == "fit file"
    document = json.loads(run("spectra", "fit", rock, "--start-file", start, "--json").out)
    assert any(item["path"].endswith("start.fit") for item in document["provenance"]["inputs"])


def test_minerals_of_a_start_file_s_bands_give_their_ratio(run, rock: Path, start: Path) -> None:
    two = start.read_text().replace("2000\t500\t-0.3\n", "1850\t500\t-0.3\n120\t150\t1\n2300\t500\t-0.2\n")
    start.write_text(two.replace("\n3\n", "\n4\n"))
    for prior in ("map", "damping"):
        done = run("spectra", "fit", rock, "--start-file", start, "--prior", prior, "--json")
        assert "c2 of 0 stay 0" in done.err[0]
        [record] = json.loads(done.out)["result"]["spectra"]
        assert record["nbsr"] == {"um1": None, "um2": None}
        assert (record["iterations"] is None) == (prior == "map")
        named = fitted(run, rock, "--start-file", start, "--prior", prior, "--band-minerals", "3=OPX,4=cpx")
        assert [band["mineral"] for band in named["bands"]][2:] == ["orthopyroxene", "clinopyroxene"]
        assert 0 < named["nbsr"]["um2"]["opx"] < 1
        assert named["abundance"] is None


def test_a_result_file_holds_one_spectrum(run, rock: Path, tmp_path: Path) -> None:
    other = tmp_path / "other.csv"
    other.write_text(rock.read_text().replace("synthetic_rock", "second"))
    done = run("spectra", "fit", rock, other, "--continuum", "wavelength", "-o", tmp_path / "two.fit")
    assert done.code == 1
    assert "a .fit file holds one spectrum, not 2" in done.err[-1]
    assert not (tmp_path / "two.fit").exists()


@pytest.mark.parametrize(
    ("options", "said"),
    [
        (("--assemblage", "auto", "--fix", "c0"), "--fix, --bound and --tie name bands of one assemblage"),
        (("--assemblage", "auto", "--prior", "damping"), "compares evidence"),
        (("--prior", "damping", "--errors", "profile"), "has no posterior"),
        (("--prior", "damping", "--bound", "c0=0:1"), "knows no bounds"),
        (("--prior", "damping", "--continuum-spread"), "needs --prior map"),
        (("--start-file", "x.fit", "--assemblage", "auto"), "brings its own bands"),
        (("--start-file", "x.fit", "--composition", "fo=1:1"), "brings its own bands"),
        (("--start-file", "x.fit", "--continuum-spread"), "brings its own continuum"),
        (("--start-file", "x.fit", "--assemblage", "OL"), "leave --assemblage out"),
        (("--start-file", "x.fit", "--continuum", "none"), "leave --continuum out"),
        (("-o", "x.fit", "--continuum", "log-quadratic"), "no letter for log-quadratic"),
        (("--start-file", "missing.fit"), "missing.fit"),
        (("--band-minerals", "3=OPX"), "--band-minerals names bands of a file; give it as --start-file"),
        (("--fix", "opx_7_center_nm"), "there is no parameter 'opx_7_center_nm'"),
        (("--composition", "fo=70"), "KEY=MEAN:ERROR"),
        (("--composition", "an=70:5"), "composition an = "),
        (("--model-error", "1"), "above 0 and below 1"),
        (("--assemblage", "OPX-ICE"), "'OPX-ICE' is unknown"),
        (("--fix", "c0=0.1", "--tie", "c0=1*c1+0"), "tie 'c0=1*c1+0'"),
    ],
)
def test_options_that_exclude_each_other_say_what_to_do(run, rock: Path, options: tuple[str, ...], said: str) -> None:
    done = run("spectra", "fit", rock, *options)
    assert done.code == (1 if "missing.fit" in options else 2)
    assert said in done.err[-1]
    assert len(done.err) == 1


def test_the_csv_has_intervals_compositions_and_the_choice(run, rock: Path) -> None:
    options = (rock, "--assemblage", "OPX", "--errors", "profile")
    done = run("spectra", "fit", *options, "--csv")
    row = next(row for row in csv.DictReader(io.StringIO(done.out)) if row["name"] == "OPX 1")
    item = next(i for i in fitted(run, *options, code=3)["intervals"]["intervals"] if i["name"] == "opx_1_center_nm")
    assert [float(row[f"center_{end}_nm"]) for end in ("low95", "low68", "high68", "high95")] == pytest.approx(
        [item[end] for end in ("low95", "low68", "high68", "high95")]
    )
    assert row["fs_in_range"] in ("true", "false")
    assert {"center_sigma_nm", "shrinkage_center", "center_continuum_nm"} <= row.keys()
    auto = next(csv.DictReader(io.StringIO(run("spectra", "fit", rock, "--assemblage", "auto", "--csv").out)))
    assert auto["choice_strong"] in ("true", "false")
    assert 0 <= float(auto["probability_of_clinopyroxene"]) <= 1
    shares = unmixed(run, rock)["abundance"]
    present = fitted(run, rock, "--assemblage", "auto")["choice"]["present"]
    assert present == {name: shares[name]["present"] for name in present} and len(present) == 4


def test_a_stated_composition_takes_part_in_the_choice(run, rock: Path) -> None:
    plain = fitted(run, rock, "--assemblage", "auto")["choice"]["candidates"]
    stated = fitted(run, rock, "--assemblage", "auto", "--composition", "fs=80:2")["choice"]["candidates"]
    evidence = [{c["assemblage"]: c["ln_evidence"] for c in candidates} for candidates in (plain, stated)]
    assert evidence[0]["OPX"] != pytest.approx(evidence[1]["OPX"], abs=0.1)
    assert evidence[0]["OL"] == pytest.approx(evidence[1]["OL"])


def test_strengths_of_a_start_file_may_be_positive_and_have_profiles(run, rock: Path, start: Path) -> None:
    record = fitted(run, rock, "--start-file", start, "--bound", "band_1_strength=-1:1", "--errors", "profile")
    assert {"band_1_strength", "band_3_strength"} <= {item["name"] for item in record["intervals"]["intervals"]}


def test_a_composition_beyond_its_trend_is_not_sold_as_one(run, tmp_path: Path) -> None:
    """A band at 820 nm, where no orthopyroxene has it."""
    path = tmp_path / "odd.csv"
    rows = [f"{nm},{0.3 * math.exp(-0.5 * math.exp(-((nm - 840) ** 2) / 2e4)):.6f}" for nm in range(450, 2400, 5)]
    path.write_text("wavelength_nm,odd\n" + "\n".join(rows) + "\n")
    done = run("spectra", "fit", path, "--assemblage", "OPX")
    assert "where the trend was measured: do not use" in done.out


def test_spectra_without_a_fit_are_not_counted_among_those_with_one(run, rock: Path, tmp_path: Path) -> None:
    path = tmp_path / "three.csv"
    head, *rows = rock.read_text().splitlines()
    cells = [line.split(",")[:2] for line in rows]
    lines = [",".join([nm, value, value, value if k < 9 else ""]) for k, (nm, value) in enumerate(cells)]
    path.write_text("\n".join([f"{head.split(',')[0]},a,b,few", *lines]) + "\n")
    for command in ("fit", "bands"):
        done = run("spectra", command, path, "-o", tmp_path / f"{command}.json")
        assert any(line.startswith("2 spectra with a result, 1 single spectrum without: ") for line in done.err)


def test_shares_of_pyroxenes_are_the_ratio_with_a_wide_error_where_it_is_that_of_a_pair(run, rock: Path) -> None:
    record = fitted(run, rock)
    pyroxenes, ratio = record["abundance"], record["nbsr"]["um2"]
    assert pyroxenes["method"] == "nbsr" and "olivine" not in pyroxenes
    share = pyroxenes["orthopyroxene"]
    assert share["fraction"] == pytest.approx(ratio["opx"])
    assert share["high"] - share["low"] > 2 * ratio["sigma"]
    assert not pyroxenes["in_domain"] and "out of domain" in pyroxenes["status"]


def test_end_members_of_the_user_take_the_place_of_the_embedded_ones(run, rock: Path, tmp_path: Path) -> None:
    """Two invented minerals: a spectrum that is one of them must be called so."""
    nm = range(450, 2455, 5)
    bands = {"olivine": 1050, "orthopyroxene": 920}
    libraries = []
    for mineral, centre in bands.items():
        path = tmp_path / f"{mineral}.csv"
        values = [0.6 * math.exp(-0.6 * math.exp(-((w - centre) ** 2) / 1.5e4)) for w in nm]
        path.write_text(
            f"wavelength_nm,{mineral}\n" + "\n".join(f"{w},{v:.5f}" for w, v in zip(nm, values, strict=True)) + "\n"
        )
        made = run("spectra", "library", "import", path, "--mineral", mineral, "-o", tmp_path / f"{mineral}.ecsv")
        assert made.code == 0, made.err
        libraries.append(path)
    both = tmp_path / "both.csv"
    columns = [path.read_text().splitlines() for path in libraries]
    both.write_text("\n".join(f"{a},{b.partition(',')[2]}" for a, b in zip(*columns, strict=True)) + "\n")
    metadata = tmp_path / "metadata.csv"
    metadata.write_text("id,mineral\nolivine,olivine\northopyroxene,orthopyroxene\n")
    library = tmp_path / "library.ecsv"
    assert run("spectra", "library", "import", both, "--metadata", metadata, "-o", library).code == 0
    options = ("--assemblage", "OL-OPX", "--method", "hapke", "--library", library)
    record = unmixed(run, libraries[1], *options)
    assert record["abundance"]["orthopyroxene"]["fraction"] > 0.9 and record["abundance"]["learned"] == 0.0
    embedded = unmixed(run, libraries[1], *options[:4])
    assert embedded["abundance"]["orthopyroxene"] != record["abundance"]["orthopyroxene"]
    asked = ("spectra", "unmix", libraries[1], "--method", "hapke", "--library", library)
    served = run(*asked)
    assert served.code == 0 and "has no clinopyroxene, plagioclase: the shares are of olivine, orth" in served.err[0]
    lacking = run(*asked, "--assemblage", "OL-CPX")
    assert lacking.code == 1 and "no end member of clinopyroxene" in lacking.err[-1]


def test_columns_of_spectra_have_a_row_each(run, rock: Path, tmp_path: Path) -> None:
    """A column of a band gives rows of bands; equal names of two files stay two rows."""
    other = tmp_path / "again.csv"
    other.write_bytes(rock.read_bytes())
    fit = ("spectra", "fit", rock, other)
    for how in ((), ("--assemblage", "auto")):
        done = run(*fit, *how, "--csv", "--columns", "id,assemblage,nbsr_um2_opx,STATUS")
        assert len(done.out.splitlines()) == 3, done.out
        bands = run(*fit, *how, "--csv", "--columns", "id,name").out.splitlines()
        assert len(bands) == len(run(*fit, *how, "--csv").out.splitlines()) > 3
    assert len(run(*fit, "--columns", "id,nbsr_um1_opx", "--format", "tsv").out.splitlines()) == 3
    unmixed_rows = run("spectra", "unmix", *fit[2:], "--csv", "--columns", "id,kind").out.splitlines()
    assert len(unmixed_rows) == 3
    assert "did you mean 'assemblage'" in run(*fit, "--csv", "--columns", "id,assemblge").err[-1]
