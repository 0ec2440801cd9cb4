"""The loop of a drive in memory: results and arrays go where files go, with the same answers."""

import json
import math
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pandas as pd
import pytest

import lunarsci
from lunarsci.errors import DataError
from lunarsci.guide.template import template
from lunarsci.twin.jobs.chosen_drive import ChosenDrive


@pytest.fixture(scope="module")
def files(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("loop")
    for kind in ("telemetry.csv", "plan.toml"):
        (folder / kind).write_text(template(kind.partition(".")[0]).text, "utf-8")
    return folder


def test_results_go_where_their_files_go(files: Path) -> None:
    states = lunarsci.states(files / "telemetry.csv")
    (files / "states.csv").write_bytes(states.files()["states.csv"]())
    of_result = lunarsci.update(states, particles=32, seed=1)
    of_file = lunarsci.update(files / "states.csv", particles=32, seed=1)
    assert of_result.belief.mean.tolist() == of_file.belief.mean.tolist()
    assert "Soil after states.csv: " in str(of_result) and "<b>Soil after states.csv: " in of_result._repr_html_()
    predicted = lunarsci.predict(files / "plan.toml", soil=of_result, members=16)
    assert predicted.prediction.members == 16
    (files / "belief.json").write_bytes(of_result.files()["belief.json"]())
    (files / "soil.json").write_text(of_result.to_json(), "utf-8")
    record = json.loads(of_result.to_json())
    for soil in (files / "belief.json", of_result.belief, files / "soil.json", record, record["result"]["belief"]):
        assert lunarsci.predict(files / "plan.toml", soil=soil, members=16).verdict == predicted.verdict
    (files / "pred.json").write_text(predicted.to_json(), "utf-8")
    with pytest.raises(DataError, match=r"pred\.json: no folder; give .* in Python the result of `predict`"):
        lunarsci.compare(files / "pred.json", states)
    with pytest.raises(DataError, match=r"pred\.json: is JSON, no table; give the table itself, as files\(\)"):
        lunarsci.compare(predicted, files / "pred.json")
    assert "1 drive" in predicted.inputs.soil_notes(16, 0)[0]
    with pytest.raises(DataError, match=r"has learned from .*states\.csv already"):
        lunarsci.update(states, soil=of_result, particles=32)
    with pytest.raises(DataError, match=r"has learned from .*states\.csv already"):
        lunarsci.update(states, soil=record, particles=32)


def test_a_terrain_is_arrays_or_a_table_of_nodes(files: Path) -> None:
    x, y = np.arange(-2, 6, 0.1), np.arange(-4, 4, 0.1)
    heights = 0.05 * np.sin(x)[None, :] + 0 * y[:, None]
    nodes = pd.DataFrame({"x_m": np.tile(x, y.size), "y_m": np.repeat(y, x.size), "height_m": heights.ravel()})
    ends = [
        lunarsci.predict(files / "plan.toml", terrain=terrain, soil="priors", members=8).verdict.endpoint
        for terrain in ((x, y, heights), nodes)
    ]
    assert ends[0] is not None and ends[1] is not None
    assert ends[0].covering_radius_m == pytest.approx(ends[1].covering_radius_m, rel=1e-3)
    survey = lunarsci.plan((x, y, heights), target="3,0.5")
    maps = survey.to_xarray()
    np.testing.assert_allclose(maps["height_m"], heights, atol=1e-6)
    np.testing.assert_allclose(maps["x_m"], x, atol=1e-9)
    # tan of the slope is the derivative of 0.05 sin(x) along x, 0.05 at its most
    assert float(maps["slope_deg"].max()) == pytest.approx(math.degrees(math.atan(0.05)), abs=0.3)
    assert maps["slope_deg"].dims == ("y_m", "x_m") and maps["slope_deg"].attrs["units"] == "deg"
    again = lunarsci.predict(files / "plan.toml", terrain=survey, soil="priors", members=8).verdict.endpoint
    assert again is not None and again.covering_radius_m == pytest.approx(ends[0].covering_radius_m, rel=1e-3)


def test_a_result_shows_numbers_and_has_rows() -> None:
    forces = lunarsci.wheel_forces(sinkage=0.01, slip="0:0.2:3")
    assert len(forces) == 3 and forces[0] == forces.rows()[0]
    assert [row["slip_ratio"] for row in forces] == pytest.approx([0.0, 0.1, 0.2])
    assert "3 rows, the first: " in repr(forces) and "sinkage_m 0.01" in repr(forces)
    assert forces


@pytest.mark.parametrize(("broken", "advice"), [("slip_ratio", "a short drive"), ("battery_charge", "more charge")])
def test_what_may_help_goes_by_what_is_broken(broken: str, advice: str) -> None:
    limits = [SimpleNamespace(quantity="slip_ratio", assumed=True), SimpleNamespace(quantity=broken, assumed=False)]
    best = SimpleNamespace(broken=[SimpleNamespace(quantity=broken)], plan=SimpleNamespace(limits=limits))
    choice = SimpleNamespace(best=best, candidates=[], front=[])
    what_next: Any = ChosenDrive.what_next
    text = what_next.fget(SimpleNamespace(choice=choice, scouting="a short drive"))
    assert advice in text and ("`twin update` learns the soil" in text) == (broken == "slip_ratio")
    assert ("--limits FILE, as its limits are assumed" in text) == (broken == "slip_ratio")
