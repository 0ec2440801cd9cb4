"""From measured states and a belief to a new belief, and from this to a `Report`."""

import dataclasses
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from lunarsci.inputs import read_input
from lunarsci.regolith.belief import SoilBelief, first_belief, read_belief
from lunarsci.regolith.belief_history import with_drive
from lunarsci.regolith.prior import prior_hash
from lunarsci.twin.drive_record import DriveRecord, read_record
from lunarsci.twin.rectify import Rectified, rectify

from .report import Report
from .table import TextTable
from .twin_report import SOURCES, Scene, read_scene

__all__ = ["Known", "update_report"]

SETTLED, SURPRISING = 0.3, 2.0
"""Persistence of a population above which it has not spread out; surprise above which the ground differs; assumed."""


@dataclass(frozen=True, slots=True)
class Known:
    """What was driven and measured, and what was believed before."""

    scene: Scene
    record: DriveRecord
    belief: SoilBelief
    states: str
    parent_sha256: str | None = None
    forgotten: float = 0.0

    @classmethod
    def read(
        cls,
        states: str,
        positions: str | None,
        belief: str | None,
        forget: float,
        plan: str | None,
        rover: str,
        terrain: str,
        interpolation: str,
    ) -> "Known":
        """Read the files."""
        scene = read_scene(plan, rover, terrain, "longji", interpolation)
        files = {path: read_input(path) for path in (states, positions) if path is not None}
        record = read_record(files[states], scene.rover, positions=files[positions] if positions else None)
        before, parent = first_belief(), None
        if belief is not None:
            source = read_input(belief)
            before = read_belief(source)
            scene.inputs[belief] = parent = source.sha256
        scene.inputs.update({path: file.sha256 for path, file in files.items()})
        return cls(scene, record, before.forgotten(forget) if forget else before, states, parent, forget)

    def rectified(self, particles: int, seed: int, progress: Callable[[int, int], None]) -> Rectified:
        """The belief after the drive, with the drive in its history."""
        scene = self.scene
        found = rectify(
            scene.rover,
            scene.terrain,
            scene.plan,
            self.record,
            self.belief,
            particles=particles,
            seed=seed,
            progress=progress,
        )
        entry = {
            "states": Path(self.states).name,
            "sha256": scene.inputs[self.states],
            "plan": scene.plan.name,
            "values": found.values,
            "outliers": int(found.outliers.sum()),
            "chi_square": found.chi_square,
            "inflation": dict(found.inflation),
            "surprise": found.surprise,
            "refused": found.refused,
        }
        parent, forgotten = self.parent_sha256, self.forgotten
        belief = with_drive(found.belief, self.belief, entry, parent_sha256=parent, forgotten=forgotten)
        return dataclasses.replace(found, belief=belief)


def update_report(known: Known, found: Rectified, seed: int, save: Path | None) -> Report:
    """The report of `twin update`; `save` names a file that takes the new belief."""
    return Report(
        schema="twin-update/1",
        result=_result(found),
        tables=[_table(known, found)],
        rows=_rows(found),
        inputs=known.scene.inputs,
        data_tables=known.scene.tables | prior_hash(),
        sources=[*SOURCES, "Christen & Fox (2005), J. Comput. Graph. Stat. 14, 795"],
        seed=seed,
        extras={save: lambda: found.belief.to_json().encode()} if save else {},
        untrusted=_doubt(found),
    )


def _rows(found: Rectified) -> list[dict[str, Any]]:
    left = found.belief.left_of_prior
    return [
        {"parameter": name, "median": median, "low": low, "high": high, "left_of_prior": left[name]}
        for name, (median, low, high) in found.belief.intervals().items()
    ]


def _result(found: Rectified) -> dict[str, Any]:
    return {
        "parameters": {row.pop("parameter"): row for row in _rows(found)},
        "values": found.values,
        "outliers": int(found.outliers.sum()),
        "chi_square": found.chi_square,
        "reduced_chi_square": found.reduced,
        "inflation": dict(found.inflation),
        "wheel_errors": dict(found.wheel_errors),
        "surprise": found.surprise,
        "persistence": found.persistence,
        "refused": found.refused or None,
        "drives": len(found.belief.history),
    }


def _table(known: Known, found: Rectified) -> TextTable:
    rows = [
        [
            row["parameter"],
            *(f"{row[key]:.4g}" for key in ("median", "low", "high")),
            f"{100 * row['left_of_prior']:.0f} %",
        ]
        for row in _rows(found)
    ]
    notes = [
        f"{found.values} values, {int(found.outliers.sum())} outliers, reduced chi-square {found.reduced:.2f}; "
        f"surprise {found.surprise:.2f}",
    ]
    for name, factor in found.inflation.items():
        notes.append(f"errors of {name} are taken {factor:.1f} times as large: no soil explains it better")
    for name, size in found.wheel_errors.items():
        notes.append(f"single wheels are off in {name} by {size:.2g} throughout, which was allowed for")
    if found.surprise > SURPRISING and not found.refused:
        notes.append("the ground is hardly the one that was believed; forget more, or begin anew")
    if found.persistence > SETTLED:
        notes.append("the soils have not spread out; take more particles, or intervals are too narrow")
    title = f"Soil after {known.states}: {known.scene.plan.name}"
    return TextTable(["parameter", "median", "68 % from", "to", "left of the prior"], rows, title=title, notes=notes)


def _doubt(found: Rectified) -> str:
    return f"nothing was learned: {found.refused}" if found.refused else ""
