"""`lunarsci regolith compare`."""

import csv
import io
import json
import math
from pathlib import Path

import pytest


def test_the_command_takes_a_result_or_numbers(run, states: Path, tmp_path: Path) -> None:
    result = tmp_path / "soil.json"
    assert run("regolith", "identify", states, "--json", "-o", result).code == 0
    by_result = run("regolith", "compare", result, "--json")
    assert by_result.code == 0, by_result.err
    site = json.loads(by_result.out)["result"]["site"]
    assert site["sinkage_exponent"] == 1.0
    numbers = ("--stiffness", site["stiffness_kpa_m_n"], "--exponent", 1)
    shown = run("regolith", "compare", *numbers)
    assert "Alike in bearing" in shown.out
    assert "Alike in shear strength" not in shown.out
    rows = list(csv.DictReader(io.StringIO(run("regolith", "compare", *numbers, "--csv").out)))
    assert len(rows) == 45


def test_the_joint_posterior_is_taken_where_there_is_one(run, states: Path, tmp_path: Path) -> None:
    result = tmp_path / "soil.json"
    assert run("regolith", "infer", states, "--json", "-o", result).code == 0
    joint = json.loads(result.read_text())["result"]["joint"]["parameters"]
    site = json.loads(run("regolith", "compare", result, "--json").out)["result"]["site"]
    assert site["friction_angle_deg"] == joint["friction_angle_deg"]["median"]


def test_a_belief_is_compared_by_its_medians(run, states: Path, tmp_path: Path) -> None:
    """ln K_s, ln N and ln tan φ are the first, second and fifth of its means."""
    belief = tmp_path / "belief.json"
    done = run("regolith", "infer", states, "--posterior", belief)
    assert done.code == 0 and "name yours with --rover" in done.err[0]
    text = json.loads(belief.read_text())
    site = json.loads(run("regolith", "compare", belief, "--json").out)["result"]["site"]
    found = [site[name] for name in ("stiffness_kpa_m_n", "sinkage_exponent")]
    assert found == pytest.approx([math.exp(one) for one in text["mean"][:2]])
    assert math.tan(math.radians(site["friction_angle_deg"])) == pytest.approx(math.exp(text["mean"][4]))
    text["history"] = [{"states": "drive 1", "doubt": "positions are not explained"}]
    belief.write_text(json.dumps(text))
    assert "a doubtful belief: drive 1: positions" in run("regolith", "compare", belief).err[0]


@pytest.mark.parametrize(
    ("arguments", "code", "message"),
    [
        ((), 2, "give either a result"),
        (("--cohesion", "500"), 1, "go together"),
        (("{file}", "--cohesion", "500"), 2, "give either a result"),
        (("{file}",), 1, "is no result of"),
    ],
)
def test_what_cannot_be_compared_is_refused(
    run, tmp_path: Path, arguments: tuple[str, ...], code: int, message: str
) -> None:
    path = tmp_path / "odd.json"
    path.write_text('{"result": {"odd": 1}}')
    done = run("regolith", "compare", *(part.format(file=path) for part in arguments))
    assert done.code == code
    assert message in done.err[-1]
