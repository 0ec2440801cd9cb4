"""From beliefs and their histories to a `Report`."""

from collections.abc import Mapping
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from lunarsci.errors import DataError, ParameterError
from lunarsci.inputs import InputFile, read_input
from lunarsci.regolith.belief import (
    BeliefDistance,
    SoilBelief,
    compare_beliefs,
    moved_sd,
    past_beliefs,
    read_belief,
    rolled_back,
)
from lunarsci.regolith.ground_law import ground_intervals
from lunarsci.regolith.prior import PARAMETERS

from ..shared.report import Report
from ..shared.table import TextTable
from .discrepancy import discrepancy_table

__all__ = ["Beliefs", "history_report", "read_beliefs"]

SOURCES = [
    "Bhattacharyya (1946), Sankhya 7, 401",
    "Kullback & Leibler (1951), Ann. Math. Stat. 22, 79, 10.1214/aoms/1177729694",
]
SHORT = {
    "stiffness_kpa_m_n": "K_s",
    "sinkage_exponent": "N",
    "sinkage_exponent_slip": "n_1",
    "cohesion_pa": "c",
    "friction_angle_deg": "φ",
    "shear_modulus_mm": "K_x",
    "external_friction_angle_deg": "φ_y",
    "lateral_modulus_mm": "K_y",
}


@dataclass(frozen=True, slots=True)
class Beliefs:
    """A belief, and perhaps another, with the files they come from."""

    source: InputFile
    belief: SoilBelief
    other_source: InputFile | None = None
    other: SoilBelief | None = None


def read_beliefs(belief: str, against: str | None) -> Beliefs:
    """Read them. Raises DataError."""
    source = read_input(belief)
    if against is None:
        return Beliefs(source, read_belief(source))
    other = read_input(against)
    return Beliefs(source, read_belief(source), other, read_belief(other))


def history_report(beliefs: Beliefs, rollback: int | None, save: Path | None) -> Report:
    """The report of `twin history`; `save` takes the belief after `rollback` drives."""
    belief, name = beliefs.belief, beliefs.source.name
    try:
        drives = _drives(belief)
        distance = None if beliefs.other is None else compare_beliefs(belief, beliefs.other)
        back = None if rollback is None else rolled_back(belief, rollback)
    except ParameterError as error:
        raise DataError(f"{name}: {error}") from error
    now = [_now_table(belief, "What is believed now"), _physics_table(belief)]
    tables = [_drive_table(name, drives), _moved_table(drives), *now]
    if distance is not None:
        tables.append(_distance_table(beliefs, distance))
    if back is not None:
        tables.append(_now_table(back, f"What was believed after {rollback} drive(s), written to {save}"))

    def figures() -> Any:
        from lunarsci.regolith.figure import belief_history_figure

        names = (name, beliefs.other_source.name if beliefs.other_source else "")
        return [belief_history_figure(belief, f"{name}: belief of the soil by drive", beliefs.other, names)]

    return Report(
        schema="twin-history/1",
        result={
            "drives": drives,
            "parameters": _parameters(belief),
            "discrepancy": belief.discrepancy.to_dict(),
            "against": None if distance is None else asdict(distance),
            "rolled_back": None if back is None else {"drives": rollback, "parameters": _parameters(back)},
        },
        tables=[table for table in tables if table.rows or table.notes],
        rows=_rows(belief, drives),
        figures=figures,
        inputs={file.name: file.sha256 for file in (beliefs.source, beliefs.other_source) if file},
        sources=SOURCES,
        extras={} if save is None or back is None else {save: lambda: back.to_json().encode()},
    )


def _drives(belief: SoilBelief) -> list[dict[str, Any]]:
    past = past_beliefs(belief)
    return [
        {
            "drive": number,
            "states": entry.get("states"),
            "sha256": entry.get("sha256"),
            "parent_sha256": entry.get("parent_sha256"),
            "forgotten": entry.get("forgotten"),
            "plan": entry.get("plan"),
            "values": entry.get("values"),
            "outliers": entry.get("outliers"),
            "reduced_chi_square": _reduced(entry),
            "surprise": entry.get("surprise"),
            "refused": entry.get("refused") or None,
            "moved_sd": moved,
            "parameters": None if state is None else _parameters(state),
        }
        for number, (entry, moved, state) in enumerate(zip(belief.history, moved_sd(belief), past[1:], strict=True), 1)
    ]


def _reduced(entry: Mapping[str, Any]) -> float | None:
    chi_square, values = entry.get("chi_square"), entry.get("values")
    known = isinstance(chi_square, int | float) and isinstance(values, int) and values > 0
    return float(chi_square) / values if known else None  # type: ignore[arg-type, operator]


def _parameters(belief: SoilBelief) -> dict[str, dict[str, float]]:
    left, ground = belief.left_of_prior, ground_intervals(belief)
    return {
        name: {"median": median, "low": low, "high": high, "left_of_prior": left[name]}
        | {f"ground_{key}": value for key, value in asdict(ground[name]).items()}
        for name, (median, low, high) in belief.intervals().items()
    }


def _rows(belief: SoilBelief, drives: list[dict[str, Any]]) -> list[dict[str, Any]]:
    """One for each number of drives and parameter, from the priors on."""
    first: dict[str, Any] = {"drive": 0, "states": None, "plan": None, "refused": None, "moved_sd": None}
    first["parameters"] = _parameters(rolled_back(belief, 0))
    rows = []
    for drive in (first, *drives):
        for name in PARAMETERS:
            values = (drive["parameters"] or {}).get(name, {})
            head = {key: drive[key] for key in ("drive", "states", "plan")}
            numbers = {key: values.get(key) for key in ("median", "low", "high", "left_of_prior")}
            rows.append(head | {"parameter": name, **numbers, "moved_sd": (drive["moved_sd"] or {}).get(name)})
    return rows


def _drive_table(name: str, drives: list[dict[str, Any]]) -> TextTable:
    headers = ["drive", "states", "plan", "values", "outliers", "reduced chi-square", "surprise", "forgotten before"]
    rows = [
        [
            str(drive["drive"]),
            *(str(drive[key] or "-") for key in ("states", "plan")),
            *("-" if drive[key] is None else str(drive[key]) for key in ("values", "outliers")),
            *("-" if drive[key] is None else f"{drive[key]:.2f}" for key in ("reduced_chi_square", "surprise")),
            "-" if not drive["forgotten"] else f"{100 * drive['forgotten']:.0f} %",
        ]
        for drive in drives
    ]
    if not drives:
        return TextTable([], [], title=f"{name} rests on no drive", notes=["it holds the priors"])
    learned = sum(drive["refused"] is None for drive in drives)
    notes = [f"drive {d['drive']} taught nothing: {d['refused']}" for d in drives if d["refused"]]
    return TextTable(headers, rows, title=f"{name} rests on {learned} drive(s)", notes=notes)


def _moved_table(drives: list[dict[str, Any]]) -> TextTable:
    rows = [[str(d["drive"]), *(f"{d['moved_sd'][name]:+.2f}" for name in PARAMETERS)] for d in drives if d["moved_sd"]]
    lost = [str(d["drive"]) for d in drives if d["moved_sd"] is None]
    older = "the file does not keep the states about drive(s)"
    notes = [f"{older} {', '.join(lost)}, of an older version; to there is no way back"] if lost else []
    title = "How far each drive moved the parameters, in standard deviations of what was believed before"
    return TextTable(["drive", *SHORT.values()] if rows else [], rows, title=title, notes=notes)


def _now_table(belief: SoilBelief, title: str) -> TextTable:
    rows = [
        [
            name,
            *(f"{row[key]:.4g}" for key in ("median", "low", "high", "ground_low_68", "ground_high_68")),
            f"{100 * row['left_of_prior']:.0f} %",
        ]
        for name, row in _parameters(belief).items()
    ]
    headers = ["effective value", "median", "68 % from", "to", "ground's own from", "to", "left of the prior"]
    return TextTable(headers, rows, title=title)


def _physics_table(belief: SoilBelief) -> TextTable:
    """What the twin's physics is off by, and the drives that taught it."""
    found = discrepancy_table(belief.discrepancy)
    lines = [f"taught by {one.get('states')} ({one.get('how')})" for one in belief.discrepancy.scored]
    return TextTable(found.headers, found.rows, title=found.title, notes=[*found.notes, *lines])


def _distance_table(beliefs: Beliefs, distance: BeliefDistance) -> TextTable:
    rows = [
        [
            name,
            *(f"{middle:.4g} ({low:.4g} to {high:.4g})" for middle, low, high in (row.one, row.other)),
            f"{row.difference_sd:+.2f}",
            f"{row.bhattacharyya:.3f}",
        ]
        for name, row in distance.parameters.items()
    ]
    one, other = distance.kullback_leibler
    shared = f"both rest on the same first {distance.shared_drives} drive(s), and are no independent witnesses of them"
    notes = [
        f"as a whole {distance.difference_sd:.2f} combined standard deviations apart; Bhattacharyya distance "
        f"{distance.bhattacharyya:.2f}; Kullback-Leibler {one:.2f} nat lost where the first stands for the second, "
        f"{other:.2f} the other way round",
        shared if distance.shared_drives else "they share no drive",
    ]
    other_name = beliefs.other_source.name if beliefs.other_source else ""
    title = f"{beliefs.source.name} beside {other_name}: median (68 %)"
    return TextTable(
        ["parameter", "first", "second", "difference [sd]", "Bhattacharyya"], rows, title=title, notes=notes
    )
