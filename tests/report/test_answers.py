"""The sentence that stands for a result: it may not say more than the result does."""

import json
from pathlib import Path
from typing import Any

import pytest

from lunarsci.errors import DataError, ParameterError
from lunarsci.report.answers import ANSWERS, answer
from lunarsci.report.documents import Document, document_of, read_results
from lunarsci.report.sentences import DOUBT, GO, STOP
from lunarsci.report.words import counted, measured, percent, words

from .conftest import documents

KNOWN = documents()


def of(name: str, **changes: Any) -> Document:
    found = KNOWN[name]
    return document_of(found["schema"].removeprefix("lunarsci/"), found["result"] | changes, found["provenance"])


def test_every_kind_of_the_former_answers_is_answered() -> None:
    kinds = {one["schema"].split("/")[1] for one in KNOWN.values()}
    named = kinds - {"images-cameras", "spectra-library-check", "spectra-simulate"}
    assert named <= ANSWERS.keys()
    for name in KNOWN:
        assert answer(of(name)).text.endswith(".")


def test_a_drive_is_a_go_only_where_the_verdict_says_so() -> None:
    assert answer(of("predict")).tone == GO
    refused = answer(of("predict", verdict="no-go", reasons=["the slope is too steep"]))
    assert refused.tone == STOP
    assert refused.text.startswith("No-go ")
    assert "the slope is too steep" in refused.text


def test_a_limit_that_some_drives_break_is_not_called_kept() -> None:
    """The verdict allows one drive in twenty beyond a limit; the sentence may not hide it."""
    limits = [KNOWN["predict"]["result"]["limits"][0] | {"exceeding": 3}]
    said = answer(of("predict", limits=limits, members=100)).text
    assert "broken by 3 of 100 predicted drives" in said
    assert "all limits are kept" not in said


def test_what_is_out_of_its_domain_or_distrusted_is_marked() -> None:
    assert answer(of("unmix")).tone == DOUBT
    assert "not shown to hold" in answer(of("unmix")).text
    assert answer(of("compare drives")).tone == DOUBT


def test_a_share_of_no_determined_value_is_not_told() -> None:
    """Pyroxene's bands of the damped fit have an error of 300: no number is read aloud."""
    assert "orthopyroxene makes" not in answer(of("fit damping")).text
    assert "orthopyroxene makes 0.74 ± 0.11" in answer(of("fit")).text


def test_numbers_are_rounded_to_their_errors() -> None:
    assert measured(943.8386, 2.7208, "nm") == "943.8 ± 2.7 nm"
    assert measured(1443.0, 96.9, "N") == "1443 ± 97 N"
    assert measured(12345.0, 678.0) == "12340 ± 680"
    assert measured(None, 1.0) == "not determined"
    assert percent(0.0039) == "0.4 %"
    assert counted(1, "spectrum") == "1 spectrum"
    assert counted(2, "spectrum") == "2 spectra"
    assert words("center_nm") == "center [nm]"


@pytest.mark.parametrize(
    ("content", "said"),
    [
        ('{"a": 1}', "no result of a lunarsci command"),
        ('{"schema": "lunarsci/soil-belief/3", "mean": []}', "but lunarsci/soil-belief/3"),
        ('{"schema": "other/1", "result": {}, "provenance": {}}', "does not name a lunarsci result"),
        ('{"schema": "lunarsci/twin-predict/1", "result": {}, "provenance": {}}', "lacks 'verdict'"),
        ("[1, 2]", "no result of a lunarsci command"),
        ("{", "not valid JSON"),
    ],
)
def test_what_is_no_result_is_one_clear_error(tmp_path: Path, content: str, said: str) -> None:
    file = tmp_path / "thing.json"
    file.write_text(content)
    with pytest.raises(DataError, match=r"thing\.json") as error:
        [answer(one) for one in read_results([file])[0]]
    assert said in str(error.value)
    assert len(str(error.value)) <= 300


def test_folders_pictures_and_nothing(tmp_path: Path) -> None:
    with pytest.raises(DataError, match=r"without result\.json"):
        read_results([tmp_path])
    (tmp_path / "result.json").write_text(json.dumps(KNOWN["states"]))
    (tmp_path / "drawn.png").write_bytes(b"\x89PNG\r\n")
    [found], pictures = read_results([tmp_path, tmp_path / "drawn.png"])
    assert found.kind == "twin-states"
    assert list(found.pictures) == ["drawn.png"]
    assert [one.name for one in pictures] == ["drawn.png"]
    with pytest.raises(ParameterError, match="no result is given"):
        read_results([tmp_path / "drawn.png"])
    (tmp_path / "false.png").write_bytes(b"GIF89a")
    with pytest.raises(DataError, match="no PNG picture"):
        read_results([tmp_path, tmp_path / "false.png"])
