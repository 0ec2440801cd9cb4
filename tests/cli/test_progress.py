"""What a progress bar says of the pace, by a clock of its own."""

import pytest
from lunarsci.cli.shared.talk import Pace, minutely


def test_the_pace_is_of_this_run_alone() -> None:
    times = iter([0.0, 10.0, 20.0])
    pace = Pace(lambda: next(times))
    assert pace.text(5000, 100_000) == "5,000 of 100,000"
    assert pace.text(6000, 100_000) == "6,000 of 100,000 · 100 a second · 16 min left"
    assert pace.text(10_000, 100_000) == "10,000 of 100,000 · 250 a second · 6 min left"


def test_another_stage_begins_anew() -> None:
    times = iter([0.0, 100.0, 101.0, 103.0])
    pace = Pace(lambda: next(times))
    pace.text(0, 64)
    pace.text(64, 64)
    assert pace.text(0, 8) == "0 of 8"
    assert pace.text(4, 8) == "4 of 8 · 2 a second · 2 s left"


def test_a_log_has_a_line_a_minute_and_none_for_what_is_short(capsys: pytest.CaptureFixture[str]) -> None:
    now = 0.0
    update = minutely("fitting", lambda: now)
    for second in range(0, 151, 10):
        now = float(second)
        update(second, 300)
    assert capsys.readouterr().err.splitlines() == [
        "fitting: 60 of 300 · 1 a second · 4 min left",
        "fitting: 120 of 300 · 1 a second · 3 min left",
    ]
    quick = minutely("fitting", lambda: now)
    quick(0, 3)
    quick(3, 3)
    assert capsys.readouterr().err == ""
