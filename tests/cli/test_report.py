"""`lunarsci report`."""

import csv
import io
import json
import re
from pathlib import Path


def test_a_page_of_two_results(run, rock: Path, tmp_path: Path) -> None:
    bands, picture, forces, page = (tmp_path / name for name in ("bands.json", "bands.png", "forces.json", "page.html"))
    assert run("spectra", "bands", rock, "-o", bands, "--plot", picture).code == 0
    assert run("regolith", "forces", "--load", 36.5, "-o", forces).code == 0
    made = run("report", bands, forces, picture, "-o", page)
    assert (made.code, made.out) == (0, "")
    assert made.err == [f"written: {page}"]
    html = page.read_text("utf-8")
    assert html.count('<section id="s') == 2
    assert "Absorption bands" in html
    assert "a wheel carries 36.5 N" in html
    assert html.count("data:image/png;base64,") == 1
    assert "http" not in html.replace("http-equiv", "")


def test_a_picture_of_several_pages_names_those_that_are_left_out(run, rock: Path, tmp_path: Path) -> None:
    made = {suffix: tmp_path / f"match.{suffix}" for suffix in ("json", "png", "pdf", "html")}
    rocks = tmp_path / "rocks"
    rocks.mkdir()
    for number in range(3):
        (rocks / f"stone-{number}.csv").write_text(rock.read_text().replace("synthetic_rock", f"stone {number}"))
    bands = tmp_path / "bands.json"
    assert run("spectra", "bands", rocks, "-o", bands).code == 0
    done = run("spectra", "match", bands, "-o", made["json"], "--plot", made["png"])
    [said] = [line for line in done.err if "several pages" in line]
    assert (
        "left out: page 2 (" in said and "page 3 (" in said and "match.pdf draws all" in said and " more;" not in said
    )
    assert run("report", made["json"], made["png"], "-o", made["html"]).code == 0
    assert "match.png, the first page of several; --plot FILE.pdf has all" in made["html"].read_text("utf-8")
    assert run("spectra", "match", bands, "-o", made["json"], "--plot", made["pdf"], "--force").code == 3
    pages = re.search(rb"/Type /Pages.*?/Count (\d+)|/Count (\d+).*?/Type /Pages", made["pdf"].read_bytes(), re.DOTALL)
    assert pages is not None and int(pages[1] or pages[2]) == 3
    assert run("report", made["json"], "-o", made["html"], "--force").code == 0
    assert "first page" not in made["html"].read_text("utf-8")


def test_without_a_file_the_answers_are_printed(run, rock: Path, tmp_path: Path) -> None:
    bands = tmp_path / "bands.json"
    run("spectra", "bands", rock, "-o", bands)
    assert "absorbs at" in run("report", bands).out
    document = json.loads(run("report", bands, "--json").out)
    assert document["schema"] == "lunarsci/report/1"
    [section] = document["result"]["sections"]
    assert section["tone"] == "plain"
    [row] = csv.DictReader(io.StringIO(run("report", bands, "--csv").out))
    assert row["answer"] == section["answer"]


def test_what_is_no_result_is_refused(run, rock: Path, tmp_path: Path) -> None:
    (tmp_path / "thing.json").write_text('{"a": 1}')
    for what in (tmp_path / "thing.json", rock, tmp_path / "nowhere.json"):
        refused = run("report", what, "-o", tmp_path / "page.html")
        assert refused.code == 1
        assert refused.out == ""
        assert len(refused.err) == 1
        assert what.name in refused.err[0]
    assert not (tmp_path / "page.html").exists()
    assert run("report").code == 2
