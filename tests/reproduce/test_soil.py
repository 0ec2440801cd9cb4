"""Every published number of the soil: found, found under a named reading, different, or not determined."""

import re
from dataclasses import replace

import pytest

from lunarsci.regolith.wheel import read_wheel
from lunarsci.reproduce.numbers import Answer, Number, judge, published_numbers
from lunarsci.reproduce.soil import published_soil, soil_numbers

RANKS = ("mission", "terrestrial")
REPRODUCED = {
    "stiffness-15mm",
    "exponent-8mm",
    "exponent-5mm",
    "sinkage-typical",
    "exponent-sd-sinkage",
    "exponent-sd-forces",
    "exponent-sd",
    "stiffness-sd-15mm",
    "nearest-terrestrial",
}
NAMED = {"bearing-capacity"}
SET_BY_ITSELF = {"stiffness-8mm", "friction-angle"}
OPEN = {"cohesion", "external-friction-low", "external-friction-high", "nearest-mission"}


@pytest.fixture(scope="module")
def numbers() -> dict[str, Number]:
    return {number.id: number for number in soil_numbers()}


def test_every_number_of_the_table_has_a_verdict_with_evidence(numbers: dict[str, Number]) -> None:
    assert list(numbers) == [row["id"] for row in published_numbers("soil")]
    assert all(number.reason for number in numbers.values())


def test_verdicts(numbers: dict[str, Number]) -> None:
    verdicts = {name: number.verdict for name, number in numbers.items()}
    assert {name for name, verdict in verdicts.items() if verdict == "reproduced"} == REPRODUCED
    assert {name for name, verdict in verdicts.items() if verdict == "reproduced under a named reading"} == NAMED
    assert {name for name, verdict in verdicts.items() if verdict.startswith("not determined")} == OPEN
    assert {name for name, verdict in verdicts.items() if verdict == "consistent with one free force"} == SET_BY_ITSELF
    assert verdicts["friction-angle-sd"] == "differs"


def test_what_a_number_was_set_by_comes_out_whatever_it_is(monkeypatch: pytest.MonkeyPatch) -> None:
    """Another published stiffness and angle come out just as well: that shows a force, and nothing of the method."""
    from lunarsci.reproduce import soil

    monkeypatch.setattr(soil, "published_soil", lambda *_, **__: published_soil(stiffness=1000.0, phi=25.0))
    soil.stand_in_forces.cache_clear()
    other = {number.id: number.ours for number in soil.soil_numbers()}
    soil.stand_in_forces.cache_clear()
    assert [other[name] for name in sorted(SET_BY_ITSELF)] == pytest.approx([25.0, 1000.0], rel=1e-4)


def test_a_rank_that_any_soil_has_is_no_evidence(numbers: dict[str, Number]) -> None:
    """Apollo 12's ranges hold nearly all soils of the priors; Michigan's sandy loam is the nearest to few."""
    share = {name: int(re.findall(r"(\d+) %", numbers[f"nearest-{name}"].reason)[-1]) for name in RANKS}
    assert share["mission"] > 80 and share["terrestrial"] < 25


def test_numbers_that_differ_are_near_and_say_what_would_bring_them_together(numbers: dict[str, Number]) -> None:
    number = numbers["friction-angle-sd"]
    assert number.ours == pytest.approx(2.29, rel=0.2)
    short = replace(read_wheel("yutu2"), grouser_height_m=0.005)
    assert {n.id: n for n in soil_numbers(short)}["friction-angle-sd"].verdict == "reproduced under a named reading"


def test_a_wheel_of_another_size_shows_that_only_load_by_width_is_known() -> None:
    narrow = replace(read_wheel("yutu2"), width_m=0.12)
    found = {number.id: number for number in soil_numbers(narrow)}
    assert found["stiffness-15mm"].verdict == "reproduced"
    assert found["exponent-sd"].verdict == "reproduced"


@pytest.mark.parametrize(
    ("answer", "verdict"),
    [
        (Answer(value=None), "not determined by what is published"),
        (Answer(value=1.0, determined=False), "not determined by what is published"),
        (Answer(value=2.0), "differs"),
        (Answer(value=1.05), "reproduced"),
        (Answer(value=0.95, reading="a reading"), "reproduced under a named reading"),
        (Answer(value=0.95, reading="a reading", set_by_itself=True), "consistent with one free force"),
        (Answer(value=2.0, set_by_itself=True), "differs"),
        (Answer(value=1.05, low=1.01, high=1.2), "differs"),
        (Answer(value=1.05, low=0.99, high=1.2), "reproduced"),
    ],
)
def test_verdicts_follow_from_the_difference(answer: Answer, verdict: str) -> None:
    row = dict.fromkeys(("id", "part", "quantity", "unit", "passage"), "") | {"published": "1", "within": "0.1"}
    assert judge(row, answer).verdict == verdict
