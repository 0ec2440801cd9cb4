"""`lunarsci spectra match` from the shell: inputs, every option, outputs, and what goes wrong."""

import csv
import hashlib
import io
import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

MODES = ("--modes", "ol=0.25:0.05,opx=0.345:0.05,cpx=0.405:0.05")
"""The rock of Ding et al. (2024): OPX : CPX 46 : 54, olivine 20-30 %."""
HEADER = "name,latitude_deg,longitude_deg,diameter_km\n"


def result(run, *arguments: object) -> dict[str, Any]:
    done = run("spectra", "match", *arguments, "--json")
    found: dict[str, Any] = json.loads(done.out)["result"]
    assert done.code == (0 if all(rock["best"] for rock in found["rocks"]) else 3), done.err
    return found


def craters(run, *arguments: object) -> dict[str, dict[str, Any]]:
    return {item["name"]: item for item in result(run, *arguments)["rocks"][0]["craters"]}


@pytest.fixture
def fitted(run, rock: Path, tmp_path: Path) -> tuple[Path, Path]:
    """Results of `spectra fit` and `spectra bands` for one rock."""
    fit, bands = tmp_path / "fit.json", tmp_path / "bands.json"
    assert run("spectra", "fit", rock, "-o", fit).code == 0
    assert run("spectra", "bands", rock, "-o", bands).code == 0
    return fit, bands


def test_the_keys_that_scripts_rely_on(run) -> None:
    document = json.loads(run("spectra", "match", *MODES, "--name", "fin", "--json").out)
    assert document["schema"] == "lunarsci/spectra-match/1"
    [rock] = document["result"]["rocks"]
    assert rock["id"] == "fin"
    for crater in rock["craters"]:
        assert {"name", "distance_km", "ejecta_m", "log_bayes_factor", "prior", "posterior", "terms"} <= crater.keys()
    total = sum(crater["posterior"] for crater in rock["craters"]) + rock["other"]["posterior"]
    assert total == pytest.approx(1)
    tables = document["provenance"]["tables"]
    assert [table["name"] for table in tables] == ["source_craters.csv"]
    assert any("Basilevsky" in source for source in document["provenance"]["sources"])
    best = run("spectra", "match", *MODES, "--field", "rocks.0.best")
    assert (best.code, best.out) == (3, "null\n")
    assert "the crater is not decided for rock" in best.err[0]
    assert rock["remaining"][0] == max(rock["craters"], key=lambda crater: crater["posterior"])["name"]
    assert document["provenance"]["untrusted"] == "not to be trusted: the crater is not decided for fin"


def test_a_decided_crater_leaves_with_0_and_an_undecided_rock_beside_it_with_3(
    run, fitted: tuple[Path, Path], tmp_path: Path
) -> None:
    """Composition of one crater is that of the rock, of the other far from it; of the fitted rock it knows nothing."""
    file = tmp_path / "craters.csv"
    columns = ",olivine,olivine_sigma,orthopyroxene,orthopyroxene_sigma,clinopyroxene,clinopyroxene_sigma\n"
    own = "Big,-44,178,40,0.1,0.02,0.2,0.02,0.7,0.02\nSmall,-45.2,177.3,15,0.6,0.02,0.2,0.02,0.2,0.02\n"
    file.write_text(HEADER.strip() + columns + own)
    where = ("--craters", file, "--site=-45.44,177.56")
    rock = ("--modes", "ol=0.6:0.02,opx=0.2:0.02,cpx=0.2:0.02", "--systematic", "0.02")
    done = run("spectra", "match", *rock, *where, "--field", "rocks.0.best")
    assert (done.code, done.out) == (0, "Small\n"), done
    unknown = run("spectra", "match", fitted[0], *where)
    assert unknown.code == 3
    assert "not decided: " in unknown.out
    assert "the crater is not decided for synthetic_rock" in unknown.err[-1]


def test_the_table_says_what_is_assumed_and_the_csv_has_one_row_each(run) -> None:
    table = run("spectra", "match", *MODES).out
    for words in ("composition unknown", "assumed", "contain the site", "Basilevsky", "other source", "Oberbeck"):
        assert words in table, words
    rows = list(csv.DictReader(io.StringIO(run("spectra", "match", *MODES, "--csv").out)))
    assert len(rows) == len(craters(run, *MODES)) + 1
    assert rows[-1]["name"] == "other source"
    assert sum(float(row["posterior"]) for row in rows) == pytest.approx(1)
    assert {row["best"] for row in rows} == {"false"}


def test_prior_posterior_and_composition_are_apart(run) -> None:
    default, uniform = craters(run, *MODES), craters(run, *MODES, "--crater-prior", "uniform")
    for name, crater in default.items():
        assert uniform[name]["log_bayes_factor"] == crater["log_bayes_factor"]
    assert default["Finsen"]["prior"] != uniform["Finsen"]["prior"]
    assert uniform["Zhinyu"]["prior"] == pytest.approx(0.9 / 8)


@pytest.mark.parametrize(
    "options",
    [
        ("--ejecta-law", "xie"),
        ("--thickness-factor", "1"),
        ("--no-exposure",),
        ("--no-re-excavation",),
        ("--rock-life", "200:400"),
        ("--rock-size", "0.3"),
        ("--stirring", "10"),
        ("--gardening", "0.0001"),
        ("--surface-age", "2000"),
        ("--other", "0.5"),
        ("--site", "-45.0,178"),
        ("--seed", "5"),
    ],
)
def test_every_term_of_the_prior_can_be_changed(run, options: tuple[str, ...]) -> None:
    default, changed = craters(run, *MODES), craters(run, *MODES, *options)
    assert changed["Finsen"]["prior"] != default["Finsen"]["prior"]
    assert changed["Finsen"]["log_bayes_factor"] == default["Finsen"]["log_bayes_factor"]


def test_results_of_fit_and_bands_are_one_rock(run, fitted: tuple[Path, Path]) -> None:
    fit, bands = fitted
    [rock] = result(run, fit, bands)["rocks"]
    assert rock["id"] == "synthetic_rock"
    shares = json.loads(fit.read_text())["result"]["spectra"][0]["abundance"]
    assert shares["status"].startswith("out of domain")
    assert rock["modes"]["orthopyroxene"]["fraction"] == pytest.approx(shares["orthopyroxene"]["fraction"], abs=1e-6)
    assert rock["modes"]["orthopyroxene"]["sigma"] > 0.1
    centre = json.loads(bands.read_text())["result"]["spectra"][0]["bc1000_nm"]
    assert rock["bands"]["bc1000_nm"]["center_nm"] == pytest.approx(centre)
    assert any("out of domain" in remark for remark in rock["remarks"])


def test_several_rocks_and_a_bad_input_among_them(run, fitted: tuple[Path, Path], tmp_path: Path) -> None:
    document = json.loads(fitted[0].read_text())
    second = document["result"]["spectra"][0] | {"id": "second"}
    document["result"]["spectra"].append(second)
    both, bad = tmp_path / "both.json", tmp_path / "bad.json"
    both.write_text(json.dumps(document))
    bad.write_text("{")
    done = run("spectra", "match", both, bad)
    assert done.code == 1
    assert "second" in done.out
    assert "bad.json: is no JSON" in done.err[-3]
    assert done.err[-2].startswith("2 rocks with a result, 1 input without: ")
    assert done.err[-1] == "not to be trusted: the crater is not decided for synthetic_rock, second"
    alone = run("spectra", "match", bad)
    assert (alone.code, alone.out) == (1, "")


def test_of_spectra_the_shares_of_unmix_are_matched(run, rock: Path, tmp_path: Path) -> None:
    shares = tmp_path / "shares.json"
    assert run("spectra", "unmix", rock, "-q", "-o", shares).code in (0, 3)
    by_shares, at_once = (run("spectra", "match", one, "--csv") for one in (shares, rock))
    assert at_once.out == by_shares.out and at_once.out.count("\n") > 5
    assert "shares were made by `spectra unmix` of these spectra, whose kind" in at_once.err[0]
    name = json.loads(shares.read_text())["result"]["spectra"][0]["id"]
    stated = run("spectra", "match", rock, "--kind", "solid-rock", "--id", name, "--csv")
    assert stated.out != at_once.out and "of the kind solid-rock" in stated.err[0]
    assert "no spectrum is called 'nobody'" in run("spectra", "match", rock, "--id", "nobody").err[-1]
    assert "`kind` is of spectra" in run("spectra", "match", shares, "--kind", "solid-rock").err[-1].replace(
        "--kind", "`kind`"
    )


def test_a_catalogue_of_the_user_anywhere_on_the_moon(run, tmp_path: Path) -> None:
    file = tmp_path / "craters.csv"
    file.write_text(
        HEADER.strip() + ",age_low_ma,age_high_ma,bc1000_nm,bc1000_sigma_nm,source\n"
        "Near,20.5,-29.5,8,20,60,915,5,me\nFar,24,330,40,3000,3500,985,5,me\n"
    )
    found = craters(run, "--bands", "bc1000=917:4", "--site", "20,-30", "--craters", file, "--rock-size", "2")
    assert found["Near"]["log_bayes_factor"] > 1 > -3 > found["Far"]["log_bayes_factor"]
    assert found["Near"]["posterior"] > 0.8
    assert found["Near"]["terms"]["above_surface"] == 1
    document = json.loads(run("spectra", "match", *MODES, "--craters", file, "--site", "20,330", "--json").out)
    assert [item["path"] for item in document["provenance"]["inputs"]] == [str(file)]


def test_maps_give_the_modes_and_a_hole_is_said(run, tmp_path: Path) -> None:
    rasterio = pytest.importorskip("rasterio")
    options: list[str] = []
    for mineral, value in (("ol", 25.0), ("opx", 35.0), ("cpx", 40.0)):
        path = tmp_path / f"{mineral}.tif"
        transform = rasterio.transform.from_bounds(170, -50, 185, -40, 300, 200)
        with rasterio.open(
            path, "w", driver="GTiff", width=300, height=200, count=1, dtype="float32", transform=transform,
            crs="+proj=longlat +R=1737400 +no_defs",
        ) as file:  # fmt: skip
            file.write(np.full((200, 300), value, "float32"), 1)
        options += ["--mineral-map", f"{mineral}={path}"]
    document = json.loads(run("spectra", "match", *MODES, *options, "--json").out)
    hashes = {item["path"]: item["sha256"] for item in document["provenance"]["inputs"]}
    assert hashes == {str(path): hashlib.sha256(path.read_bytes()).hexdigest() for path in tmp_path.glob("*.tif")}
    found = document["result"]
    by_name = {item["name"]: item for item in found["rocks"][0]["craters"]}
    assert by_name["Zhinyu"]["log_bayes_factor"] > 1
    assert "maps" in by_name["Zhinyu"]["sources"]["composition"]
    assert by_name["Maksutov"]["log_bayes_factor"] == 0
    assert any("no values in its ring" in item["status"] for item in found["maps"])
    assert "no values in its ring" in run("spectra", "match", *MODES, *options).out


def test_the_map_of_a_polar_site_with_its_antipode(run, tmp_path: Path) -> None:
    file = tmp_path / "craters.csv"
    file.write_text(HEADER + "Antipode,90,0,300\nOver the pole,-88,10,40\nHost,-89,0,500\n")
    done = run("spectra", "match", *MODES, "--site", "-90,0", "--craters", file, "--plot", tmp_path / "a.png", "--json")
    assert done.code == 3, done.err
    found = {item["name"]: item for item in json.loads(done.out)["result"]["rocks"][0]["craters"]}
    assert found["Antipode"]["azimuth_deg"] is None
    assert found["Antipode"]["distance_km"] == pytest.approx(5458.2, abs=0.1)
    assert (found["Host"]["contains_site"], found["Host"]["posterior"]) == (True, 0)
    assert "ejecta converge" in " ".join(json.loads(done.out)["result"]["assumptions"])
    assert (tmp_path / "a.png").stat().st_size > 10_000


def test_a_rock_that_goes_with_nothing_comes_from_elsewhere(run, tmp_path: Path) -> None:
    file = tmp_path / "craters.csv"
    columns = "olivine,olivine_sigma,plagioclase,plagioclase_sigma\n"
    file.write_text(HEADER.strip() + f",{columns}A,-45,178,10,0.05,0.02,0.95,0.02\nB,-44,178,10,0.1,0.02,0.9,0.02\n")
    site = ("--site", "-45.44,177.56")
    asked = ("--modes", "ol=0.95:0.01,plg=0.05:0.01", "--craters", file, *site)
    [rock] = result(run, *asked)["rocks"]
    assert rock["best"] == "other source"
    assert rock["other"]["posterior"] > 0.99
    rows = list(csv.DictReader(io.StringIO(run("spectra", "match", *asked, "--csv").out)))
    assert [row["name"] for row in rows if row["best"] == "true"] == ["other source"]


def test_craters_of_ones_own_need_a_site_and_the_embedded_ones_say_that_theirs_is_assumed(run, tmp_path: Path) -> None:
    file = tmp_path / "craters.csv"
    file.write_text(HEADER + "Far,20,30,10\nNear,-44,178,10\n")
    done = run("spectra", "match", *MODES, "--craters", file)
    assert (done.code, done.out, len(done.err)) == (2, "", 1), done
    assert "give LAT,LON as --site" in done.err[0] and "nearest to it is Near, -44,178, 45 km" in done.err[0]
    told = run("spectra", "match", *MODES).out
    assert "site -45.44, 177.56 deg, that of Chang'E-4, since none was given (assumed)" in " ".join(told.split())
    assert "assumed)" not in run("spectra", "match", *MODES, "--site=-45.44,177.56").out.split("craters from")[0]
    assert result(run, *MODES)["site"] == {"latitude_deg": -45.44, "longitude_deg": 177.56, "assumed": True}


@pytest.mark.parametrize(
    ("options", "said"),
    [
        ((), "not both"),
        ((*MODES, "x.json"), "not both"),
        (("--modes", "ol=0.2"), "ol=VALUE:ERROR"),
        (("--modes", "ol=0.2:0.1,quartz=0.1:0.1"), "with a NAME of ol"),
        (("--modes", "ol=0.2:0.1,olivine=0.1:0.1"), "each once"),
        (("--modes", "ol=a:0.1,opx=0.1:0.1"), "in numbers"),
        (("--modes", "ol=nan:0.1,opx=0.1:0.1"), "in numbers"),
        ((*MODES, "--site", "95,0"), "latitude is 95"),
        ((*MODES, "--site", "1"), "give LAT,LON"),
        ((*MODES, "--site", "20.19,30.77"), "km from Chang'E-4, round which the embedded craters lie"),
        ((*MODES, "--rock-life", "80:40"), "; give 80 or more"),
        ((*MODES, "--rock-life", "1:2:3"), "LOW:HIGH"),
        ((*MODES, "--mineral-map", "olivine"), "MINERAL=FILE.tif"),
        ((*MODES, "--annulus", "1", "--mineral-map", "ol=a.tif", "--mineral-map", "opx=b.tif"), "IN:OUT"),
    ],
)
def test_wrong_usage_is_one_line_and_exit_2(run, options: tuple[str, ...], said: str, code: int = 2) -> None:
    done = run("spectra", "match", *options)
    assert (done.code, done.out, len(done.err)) == (code, "", 1), done
    assert said in done.err[0]


@pytest.mark.parametrize(
    ("options", "said"),
    [
        (("--modes", "ol=1.3:0.1,opx=0.1:0.1"), "olivine is 1.3; give 0 to 1"),
        (("--bands", "bc1000=0.93:0.01"), "700 to 1300"),
        ((*MODES, "--craters", "missing.csv"), "missing.csv: no such file"),
        ((*MODES, "--mineral-map", "ol=missing.tif", "--mineral-map", "opx=b.tif"), "missing.tif"),
        ((*MODES, "--mineral-map", "ol=missing.tif"), "give two or more"),
        ((*MODES, "--other", "1"), "other_weight is"),
        ((*MODES, "--thickness-factor", "0.1"), "give 1 to 100"),
        ((*MODES, "--systematic", "10"), "systematic is 10"),
        (("missing.json",), "missing.json: no such file"),
    ],
)
def test_what_cannot_be_done_is_one_line_and_exit_1(run, options: tuple[str, ...], said: str) -> None:
    test_wrong_usage_is_one_line_and_exit_2(run, options, said, code=1)


@pytest.mark.reference
def test_every_real_rock_spectrum_has_an_answer(run, reference_data: Path, tmp_path: Path) -> None:
    """The boulders of Chang'E-4: fitted, measured and matched; NBSR does not decide between craters."""
    source = reference_data / "spectra/ce4/reflectance_factor.csv"
    fit, bands = tmp_path / "fit.json", tmp_path / "bands.json"
    run("spectra", "fit", source, "--wavelength-unit", "nm", "-o", fit)
    run("spectra", "bands", source, "--wavelength-unit", "nm", "-o", bands)
    rocks = [rock for rock in result(run, fit, bands)["rocks"] if "rock" in rock["id"]]
    assert len(rocks) == 9
    for rock in rocks:
        assert sum(c["posterior"] for c in rock["craters"]) + rock["other"]["posterior"] == pytest.approx(1)
        factors = [c["log_bayes_factor"] for c in rock["craters"]]
        assert np.isfinite(factors).all()
        assert max(factors) < 3, "two pyroxenes cannot speak strongly with 10 % between methods"
