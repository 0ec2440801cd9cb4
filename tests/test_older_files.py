"""Files that copies called 0.1.0 wrote are read, and mean what they meant to the program that wrote them.

`older_files.zip` has SYNTHETIC ones by the day of their program. Beside beliefs, predictions and results lies what that
program said of them (`history.json`, `update.json`, `compare.json`, `compared.json`): the truth here.
"""

import json
import zipfile
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from former import differences, said

import lunarsci
from lunarsci.errors import DataError
from lunarsci.guide.info import info
from lunarsci.io.inputs import read_input
from lunarsci.pages.job import report
from lunarsci.regolith.belief import read_belief
from lunarsci.twin.ground.soil_map import read_soil_map

FILES = Path(__file__).with_suffix(".zip").with_name("older_files.zip")
ERAS = sorted({name.partition("/")[0] for name in zipfile.ZipFile(FILES).namelist()})
LATEST = pytest.mark.parametrize("older", ERAS[-1:], indirect=True)
"""For large files, of the last of these days alone."""
KINDS = {
    "belief.json": "belief",
    "map.json": "soil map",
    "rock.ecsv": "spectra",
    "library.ecsv": "library",
    "rock.fit": "mgm",
    "craters.csv": "craters",
    "rover.toml": "rover",
    "prior.toml": "prior",
    "soil.toml": "soil",
    "plan.toml": "plan",
    "site/plan.toml": "plan",
    "mission.toml": "mission",
    "ground/terrain.npz": "terrain",
    "drive/telemetry.csv": "telemetry",
    "states/motion.csv": "motion",
    "states/positions.csv": "positions",
    "wheel_states.csv": "states",
}


@pytest.fixture(scope="module", params=ERAS)
def older(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The folder of a day."""
    folder = tmp_path_factory.mktemp("older")
    with zipfile.ZipFile(FILES) as archive:
        archive.extractall(folder)
    return folder / str(request.param)


@pytest.fixture(autouse=True)
def inside(older: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    monkeypatch.chdir(older)
    yield


def then(file: str) -> dict[str, Any]:
    """The result that the older program wrote."""
    found: dict[str, Any] = json.loads(Path(file).read_text("utf-8"))["result"]
    return found


def now(line: str) -> dict[str, Any]:
    """The result of a command of today."""
    code, text = said([*line.split(), "--json", "--no-time", "-q"])
    assert code in (0, 3), line
    found: dict[str, Any] = json.loads(text)["result"]
    return found


def test_every_file_is_what_it_was() -> None:
    there = {file: kind for file, kind in KINDS.items() if Path(file).exists()}
    assert len(there) > 10
    assert {file: (info(file).kind, info(file).trouble) for file in there} == {f: (k, "") for f, k in there.items()}


def test_a_belief_is_the_same() -> None:
    """Medians, 68 % intervals and what they rest on."""
    before = then("history.json")
    believed = read_belief(read_input("belief.json")).intervals()
    for name, values in before["parameters"].items():
        assert believed[name] == pytest.approx([values[key] for key in ("median", "low", "high")], rel=1e-9), name
    again = now("twin history belief.json")
    assert len(again["drives"]) == len(before["drives"])
    for drive, other in zip(again["drives"], before["drives"], strict=True):
        assert drive["moved_sd"] == pytest.approx(other["moved_sd"], rel=1e-9)


def test_a_map_of_soils_is_the_same() -> None:
    before = then("update.json")["zones"]
    zones = read_soil_map(read_input("map.json")).zones
    assert len(zones) == len([one for one in before if one["learned"]])
    for zone, other in zip(zones, before, strict=False):
        for name, (median, low, high) in zone.belief.intervals().items():
            values = other["parameters"][name]
            assert (median, low, high) == pytest.approx((values["median"], values["low"], values["high"]), rel=1e-9)


def test_a_prediction_misses_by_the_same() -> None:
    """Beside older states and positions."""
    before = then("compare.json")
    again = now("twin compare predicted states/states.csv --positions states/positions.csv")
    for key in ("x_m", "y_m", "predicted_x_m", "predicted_y_m", "planned_x_m", "error_m", "time_s"):
        assert again["end"][key] == pytest.approx(before["end"][key], rel=1e-9), key
    assert again["path"]["rms_m"] == pytest.approx(before["path"]["rms_m"], rel=1e-9)


@LATEST
def test_a_soil_of_wheels_is_as_far_from_published_ones() -> None:
    before, again = then("compared.json")["soils"], now("regolith compare soil.json")["soils"]
    assert len(again) == len(before) > 40
    other = [text for text in differences(before, again, "soils") if not text.endswith(": new")]
    assert [text for text in other if ".source: " not in text] == []


@LATEST
def test_bands_of_a_spectrum_are_within_their_errors() -> None:
    [before], [again] = then("bands.json")["spectra"], now("spectra bands rock.ecsv")["spectra"]
    assert again["id"] == before["id"]
    for key in ("bc1000", "bc2000"):
        assert abs(again[f"{key}_nm"] - before[f"{key}_nm"]) < before[f"{key}_sigma_nm"]
    np.testing.assert_allclose(again["bd1000"], before["bd1000"], atol=before["bd1000_sigma"])


@LATEST
def test_results_of_a_rock_are_compared_with_craters() -> None:
    """The band centres that are compared are those of the result."""
    [bands] = then("bands.json")["spectra"]
    [rock] = now("spectra match bands.json")["rocks"]
    assert rock["bands"]["bc1000_nm"]["center_nm"] == pytest.approx(bands["bc1000_nm"], rel=1e-12)
    for file in ("fit.json", "unmix.json"):
        assert now(f"spectra match {file}")["rocks"]


def test_a_page_shows_every_result() -> None:
    results = [str(path) for path in sorted(Path().glob("*.json"))]
    rows = report(results).rows()
    assert len(rows) >= len(results) and all(row["answer"] for row in rows)


@pytest.mark.slow
@pytest.mark.parametrize("soil", ["belief.json", "map.json", "soil.toml"])
def test_a_drive_is_predicted_on_an_older_soil(soil: str) -> None:
    members = "" if soil == "soil.toml" else "--members 2"
    assert now(f"twin predict short.toml --rover rover.toml --soil {soil} {members}")["verdict"]


def test_a_belief_knows_the_drive_that_it_has_learned_from() -> None:
    with pytest.raises(DataError, match=r"has learned from states/states\.csv already"):
        lunarsci.update("states/states.csv", plan="short.toml", soil="belief.json")
