"""`lunarsci spectra map` as it is typed: the page of docs, exit codes, one line for what is wrong."""

import base64
import json
import re
import shlex
from pathlib import Path
from typing import Any

import pytest
from lunarsci.cli import main

import lunarsci

from .test_envi_cubes import CUBE, m3

pytest.importorskip("rasterio")
pytest.importorskip("h5netcdf")
DOCS = Path(__file__).parents[3] / "docs/howto/cubes.md"


def test_the_script_of_the_documents_runs(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capfd: Any) -> None:
    """On a made-up cube of M3's name and layout, six lines long."""
    m3(tmp_path)
    monkeypatch.chdir(tmp_path)
    (script,) = re.findall(r"```sh\n(.*?)```", DOCS.read_text("utf-8"), re.DOTALL)
    smaller = {"0:304,5000:6000": "0:3,1:4", "120,5400": "1,2"}
    for shown, used in smaller.items():
        assert shown in script
        script = script.replace(shown, used)
    for line in script.splitlines():
        assert main([*shlex.split(line)[1:], "-q"]) == 0, capfd.readouterr().err
    assert {"map.nc", "map.png", "pixel.csv"} <= {path.name for path in tmp_path.iterdir()}
    assert not list(tmp_path.glob("*.partial*"))


def test_json_says_what_was_mapped_and_the_file_is_named(tmp_path: Path, capfd: Any) -> None:
    path, out = m3(tmp_path), tmp_path / "map.tif"
    assert main(["spectra", "map", str(path), "-o", str(out), "--products", "bands", "--every", "2", "--json"]) == 0
    told = capfd.readouterr()
    assert f"written: {out}" in told.err
    document = json.loads(told.out)
    assert document["schema"] == "lunarsci/spectra-map/1"
    found = document["result"]
    assert (found["cube"]["format"], found["cube"]["bad_channels"]) == ("m3", 2)
    assert (found["map"]["lines"], found["map"]["samples"], found["pixels"]["pixels"]) == (3, 3, 9)
    assert {"bc1000_nm", "bc1000_sigma_nm", "pixel_flags"} <= {layer["name"] for layer in found["layers"]}
    (tmp_path / "map.json").write_text(told.out)
    assert main(["report", str(tmp_path / "map.json")]) == 0
    said = capfd.readouterr().out
    assert re.search(r"Of 9 pixels \d could be used\. Centre of the 1000 nm band: 9\d\d nm is the median", said), said
    assert "standard error" not in said
    assert main(["spectra", "map", str(path), "--spectrum", "1,2", "--json", "-q"]) == 0
    (tmp_path / "pixel.json").write_text(capfd.readouterr().out)
    assert main(["report", str(tmp_path / "pixel.json")]) == 0
    assert re.search(r"The spectrum of .*, \d+ of \d+ channels", capfd.readouterr().out)


@pytest.mark.parametrize(
    ("options", "code", "said"),
    [
        (["--products", "gold", "-o", "map.nc"], 2, "--products gold"),
        (["-o", "map.png"], 2, "ends in .nc"),
        ([], 2, "ends in .nc"),
        (["--roi", "0:99,0:2", "-o", "map.nc"], 2, "--roi"),
        (["--spectrum", "9,9"], 2, "--spectrum 9,9"),
        (["--mask", "none.tif", "-o", "map.nc"], 1, "no such file"),
        (["-o", "no/folder/map.nc"], 1, "no folder"),
    ],
)
def test_what_is_wrong_is_one_line_and_nothing_is_written(
    options: list[str], code: int, said: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capfd: Any
) -> None:
    path = m3(tmp_path, CUBE)
    monkeypatch.chdir(tmp_path)
    before = sorted(tmp_path.iterdir())
    assert main(["spectra", "map", path.name, *options]) == code
    told = capfd.readouterr()
    assert told.out == ""
    assert said in told.err
    assert len(told.err.strip().splitlines()) == 1
    assert sorted(tmp_path.iterdir()) == before


@pytest.mark.parametrize("suffix", [".nc", ".tif"])
def test_a_page_has_the_picture_of_a_map_that_is_still_there(
    suffix: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capfd: Any
) -> None:
    """From the map file, as --plot draws it; none of a file that is another map, or is none any more."""
    monkeypatch.chdir(tmp_path)
    cube, name = m3(tmp_path), f"map{suffix}"

    def mapped(*options: str) -> str:
        assert main(["spectra", "map", str(cube), "-o", name, "--products", "bands", "--json", *options]) == 0
        return str(capfd.readouterr().out)

    def pictures(place: Path) -> list[str]:
        html = lunarsci.report(place / "map.json").html().decode()
        return re.findall(r"data:image/png;base64,([\w+/=]+)", html)

    (tmp_path / "map.json").write_text(mapped("--plot", "map.png"))
    plotted = [base64.b64encode((tmp_path / "map.png").read_bytes()).decode()]
    assert pictures(tmp_path) == plotted
    moved = tmp_path / "moved"
    moved.mkdir()
    for file in (name, "map.json"):
        (tmp_path / file).rename(moved / file)
    assert pictures(moved) == plotted
    mapped("--force", "--roi", "0:3,0:4")
    (moved / name).write_bytes(b"no map")
    assert pictures(moved) == []
    (moved / name).unlink()
    assert pictures(moved) == []
