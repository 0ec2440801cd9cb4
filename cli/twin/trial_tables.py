"""Tables of trials beside their predictions, for people."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from ..shared.table import TextTable

if TYPE_CHECKING:
    from lunarsci.twin.jobs.compare_trials import ScoredTrials

UNITS = {"slip_ratio": ("slip", "-"), "side_slip_deg": ("side slip", "deg"), "end_m": ("end", "m")}


def trial_tables(scored: ScoredTrials) -> list[TextTable]:
    """One row a trial, then one for each quantity over all trials."""
    record = scored.to_dict()
    notes = [
        "error: root mean square of predicted less measured over the states, and the distance of the ends; wheels: the "
        "same of the way that the wheels go without slip",
        f"predicted on soils of {record['soil']['name']} ({record['soil']['of']})",
        *([f"{made} of the trials are synthetic"] if (made := sum(trial.synthetic for trial in scored.trials)) else []),
        *(f"{trial.trial} is doubtful: {trial.doubt}" for trial in scored.trials if trial.doubt),
    ]
    headers = ["trial", "way [m]", "drives", "slip", "predicted", "error", "wheels", "side slip error [deg]", "wheels"]
    headers += ["end error [m]", "wheels", "90 % radius [m]", "inside"]
    rows = [_row(row) for row in record["trials"]]
    heads = ["over all trials", "unit", "trials", "values", "median error", "rms", "in 90 % regions", "wheels: median"]
    summary = [_summary_row(row) for row in record["summary"]]
    trials = "1 trial" if len(rows) == 1 else f"{len(rows)} trials"
    title = f"{trials} beside what the twin predicts from the wheels"
    return [
        TextTable(headers, rows, title=title, notes=notes),
        TextTable([*heads, "wheels: rms"], summary, title="Errors over all trials"),
    ]


def _row(row: dict[str, Any]) -> list[str]:
    inside = row.get("end_m_in_90")
    return [
        row["trial"],
        f"{row['way_m']:.2f}",
        f"{row['finished']} of {row['members']}",
        *(_cell(row.get(f"slip_ratio_{part}")) for part in ("measured", "predicted", "error", "error_wheels_alone")),
        *(_cell(row.get(f"side_slip_deg_{part}"), ".2f") for part in ("error", "error_wheels_alone")),
        *(_cell(row.get(f"end_m_{part}")) for part in ("error", "error_wheels_alone")),
        _cell(row["end_radius_90_m"]),
        "-" if inside is None else "yes" if inside else "no",
    ]


def _summary_row(row: dict[str, Any]) -> list[str]:
    name, unit = UNITS[row["quantity"]]
    held = row["in_90"]
    return [
        name,
        unit,
        str(row["trials"]),
        str(row["values"]),
        *(f"{row[part]:.3g}" for part in ("median_error", "rms")),
        "-" if held is None else f"{100 * held:.0f} %",
        *(f"{row[part]:.3g}" for part in ("median_error_wheels_alone", "rms_wheels_alone")),
    ]


def _cell(value: float | None, form: str = ".3f") -> str:
    return "-" if value is None else format(value, form)
