"""What a progress bar says of the pace, by a clock of its own."""

from lunarsci.cli.shared.progress import Pace


def test_the_pace_is_of_this_run_alone() -> None:
    times = iter([0.0, 10.0, 20.0])
    pace = Pace(lambda: next(times))
    assert pace.said(5000, 100_000) == "5,000 of 100,000"
    assert pace.said(6000, 100_000) == "6,000 of 100,000 · 100 a second · 16 min left"
    assert pace.said(10_000, 100_000) == "10,000 of 100,000 · 250 a second · 6 min left"


def test_another_stage_begins_anew() -> None:
    times = iter([0.0, 100.0, 101.0, 103.0])
    pace = Pace(lambda: next(times))
    pace.said(0, 64)
    pace.said(64, 64)
    assert pace.said(0, 8) == "0 of 8"
    assert pace.said(4, 8) == "4 of 8 · 2 a second · 2 s left"
