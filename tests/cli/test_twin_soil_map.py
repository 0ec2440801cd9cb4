"""`lunarsci twin update --save-map` and `twin predict --soil`: soil by place, from drive to drive."""

import json
from pathlib import Path

import numpy as np
import pytest

from lunarsci.regolith.belief import first_belief


@pytest.mark.slow
def test_a_map_goes_from_drive_to_drive(run, short_plan: Path, short_states: Path, tmp_path: Path) -> None:
    soil_map, again, layers = tmp_path / "map.json", tmp_path / "again.json", tmp_path / "layers.npz"
    update = ("twin", "update", short_states, "--plan", short_plan, "--particles", "32", "-q")
    files = ("--save-map", soil_map, "--save-terrain", layers, "--correlation", "3", "--plot", tmp_path / "u.png")
    done = run(*update, *files, "--json")
    assert done.code == 0, done.err
    result = json.loads(done.out)["result"]
    assert result["map"] == {"zones": 1, "correlation_m": 3.0} and result["changes"] == []
    assert result["zones"][0]["learned"] and (tmp_path / "u.png").stat().st_size > 10_000
    known = result["zones"][0]["parameters"]["stiffness_kpa_m_n"]["left_of_prior"]
    with np.load(layers) as archive:
        left = archive["stiffness_kpa_m_n_left_of_prior"]
    assert left.min() == pytest.approx(known, rel=1e-4) and left.max() > 0.95
    # The next drive on the same ground begins with what this one left.
    second = run(*update, "--soil", soil_map, "--save-map", again, "--json")
    assert second.code == 0, second.err
    after = json.loads(second.out)["result"]["zones"][0]["parameters"]["stiffness_kpa_m_n"]["left_of_prior"]
    assert after < 1.1 * known
    kept = json.loads(again.read_text())
    assert kept["correlation_m"] == 3.0 and len(kept["zones"]) == 1 and len(kept["zones"][0]["belief"]["history"]) == 2
    ahead = ("twin", "predict", short_plan, "-q", "--members", "4", "--time-step", "0.2", "--field", "members")
    predicted = run(*ahead, "--soil", soil_map)
    assert predicted.code == 0 and predicted.out == "4\n"
    both = run("twin", "predict", short_plan, "--soil", soil_map, "--sweep", "cohesion_pa=100:500:3")
    assert both.code == 2 and "give one" in " ".join(both.err)


def test_options_of_a_map_are_checked_before_anything_is_driven(run, short_plan: Path, tmp_path: Path) -> None:
    text = tmp_path / "states.csv"
    text.write_text("time_s,wheel,sinkage_m\n1,FL,0.01\n")
    (tmp_path / "b.json").write_text(first_belief().to_json())
    update = ("twin", "update", text, "--plan", short_plan)
    done = run(*update, "--soil", tmp_path / "b.json", "--save-map", tmp_path / "m.json")
    assert done.code == 2 and "--soil is of one soil everywhere" in " ".join(done.err)
    done = run(*update, "--correlation", 3)
    assert done.code == 2 and "--correlation is of a soil map" in " ".join(done.err)
    (tmp_path / "soil.toml").write_text(run("template", "soil").out)
    for more in ((), ("--save-map", tmp_path / "m.json")):
        for soil in (short_plan, "longji", tmp_path / "soil.toml"):
            done = run(*update, "--soil", soil, *more)
            assert done.code == 1 and "no belief; give one of" in done.err[0]
        done = run(*update, "--soil", "nosuchmap", *more)
        assert done.code == 1 and "nosuchmap: no such file" in done.err[0]
    assert not (tmp_path / "m.json").exists()
    done = run("twin", "update", text, "--plan", short_plan, "--save-map", tmp_path / "m.txt")
    assert done.code == 2
    done = run("twin", "predict", short_plan, "--soil", short_plan)
    assert done.code == 1 and "plan.toml: " in done.err[0]
