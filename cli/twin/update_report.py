"""From measured states and a belief to a new belief, and from this to a `Report`."""

import dataclasses
from collections.abc import Callable, Iterator, Mapping
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from lunarsci.errors import DataError
from lunarsci.inputs import read_input
from lunarsci.regolith.belief import SoilBelief, first_belief, read_belief, with_drive
from lunarsci.regolith.ground_law import ground_intervals
from lunarsci.regolith.prior import PARAMETERS, prior_hash
from lunarsci.twin.assimilation.change_point import planned_places
from lunarsci.twin.assimilation.drive_record import DriveRecord, read_record
from lunarsci.twin.assimilation.segments import SoilChange
from lunarsci.twin.assimilation.update import SoilUpdate, assimilate
from lunarsci.twin.ground.driven_soil import DrivenSoil, soil_record
from lunarsci.twin.ground.soil_map import SoilMap
from lunarsci.twin.jobs.drive_inputs import SOURCES, DriveInputs, read_drive_inputs

from ..shared.report import Report
from ..shared.table import TextTable
from .belief_tables import discrepancy_table
from .update_map import (
    MapFiles,
    MapUpdate,
    change_rows,
    found_changes,
    map_extras,
    map_pages,
    map_result,
    read_map_before,
    zone_tables,
    zoned,
)

if TYPE_CHECKING:
    from matplotlib.figure import Figure

__all__ = ["Learned", "UpdateInputs", "update_report"]

EFFECTIVE = (
    "medians and 68 % are effective values, with which the twin's law drives as the rover did; the ground's own, which "
    "another law or instrument would find, are known less well"
)
SETTLED, SURPRISING = 0.3, 2.0
"""Persistence of a population above which it has not spread out; surprise above which the ground differs; assumed."""


@dataclass(frozen=True, slots=True)
class UpdateInputs:
    """What was driven and measured, and what was believed before.

    `along` is the record without positions, for stretches of the drive; `soil_map` the map before, None where the soil
    is not kept by place.
    """

    scene: DriveInputs
    record: DriveRecord
    along: DriveRecord
    belief: SoilBelief
    soil_map: SoilMap | None
    forget: float
    states: str
    parent_sha256: str | None = None
    belief_file: str | None = None

    @classmethod
    def read(
        cls,
        states: str,
        positions: str | None,
        belief: str | None,
        forget: float,
        plan: str | None,
        rover: str | None,
        terrain: str,
        interpolation: str,
        files_of_map: MapFiles,
    ) -> "UpdateInputs":
        """Read the files."""
        scene = read_drive_inputs(plan, rover, terrain, interpolation, soil_counts=False)
        files = {path: read_input(path) for path in (states, positions) if path is not None}
        record = read_record(files[states], scene.rover, positions=files[positions] if positions else None)
        soil_map = read_map_before(files_of_map, scene)
        before, parent = first_belief(), None
        if soil_map is not None:
            before = soil_map.belief_along(planned_places(scene.plan, scene.rover))
        if belief is not None:
            source = read_input(belief)
            before = read_belief(source)
            scene.inputs[belief] = parent = source.sha256
            _refuse_known(before, files[states].sha256, states, belief)
        scene.inputs.update({path: file.sha256 for path, file in files.items()})
        along = record if positions is None else read_record(files[states], scene.rover)
        before = before.forgotten(forget) if forget else before
        return cls(scene, record, along, before, soil_map, forget, states, parent, belief)

    def rectified(
        self, particles: int, seed: int, ruts: bool | None, progress: Callable[[int, int], None]
    ) -> SoilUpdate:
        """The belief after the drive, with the drive in its history."""
        scene = self.scene
        found = assimilate(
            scene.rover,
            scene.terrain,
            scene.plan,
            self.record,
            self.belief,
            particles=particles,
            seed=seed,
            ruts=ruts,
            teach=not self.belief.discrepancy.has_scored(self.scene.inputs[self.states]),
            progress=progress,
        )
        entry, parent = self.entry(found), self.parent_sha256
        belief = with_drive(self.scored(found), self.belief, entry, parent_sha256=parent, forgotten=self.forget)
        return dataclasses.replace(found, belief=belief)

    def scored(self, found: SoilUpdate) -> SoilBelief:
        """The belief found, whose discrepancy says that it rests on this drive's end, if it does."""
        belief, digest = found.belief, self.scene.inputs[self.states]
        law = belief.discrepancy
        if found.refused or law.has_scored(digest) or not len(self.record.fix_time_s):
            return belief
        line = {"states": Path(self.states).name, "sha256": digest, "plan": self.scene.plan.name, "how": "own end"}
        return dataclasses.replace(belief, discrepancy=law.with_score(**line))

    def entry(self, found: SoilUpdate) -> Mapping[str, Any]:
        """The line of history of this drive."""
        return {
            "states": Path(self.states).name,
            "sha256": self.scene.inputs[self.states],
            "plan": self.scene.plan.name,
            "values": found.values,
            "outliers": int(found.outliers.sum()),
            "chi_square": found.chi_square,
            "inflation": dict(found.inflation),
            "ruts": found.prediction.ruts,
            "surprise": found.prior_shift,
            "refused": found.refused,
        }

    def learned(self, particles: int, seed: int, ruts: bool | None, progress: Callable[[int, int], None]) -> "Learned":
        """What the drive says of one soil, where the soil changes, and, with a map, of the soil of each stretch."""
        found = self.rectified(particles, seed, ruts, progress)
        if self.soil_map is None:
            return Learned(found, found_changes(self.along, found, seed), None)
        settings = (self.forget, self.entry, particles, seed, progress)
        update = zoned(self.scene, self.along, found, self.soil_map, *settings)
        return Learned(found, update.changes, update)


@dataclass(frozen=True, slots=True)
class Learned:
    """What a drive says of one soil, changes of the soil on its way, and the map after it."""

    found: SoilUpdate
    changes: list[SoilChange]
    update: MapUpdate | None


def update_report(
    known: UpdateInputs, learned: Learned, seed: int, save: Path | None, files_of_map: MapFiles
) -> Report:
    """The report of `twin update`; `save` names a file that takes the new belief."""
    found, update = learned.found, learned.update
    extras: dict[Path, Callable[[], bytes]] = {save: lambda: found.belief.to_json().encode()} if save else {}
    if update is not None:
        extras |= map_extras(files_of_map, update, known.scene)
    return Report(
        schema="twin-update/1",
        result=_result(found)
        | {"changes": change_rows(learned.changes), "made_for": known.scene.made_for}
        | {"rover": known.scene.rover.name, "soil": _soil(known, files_of_map)}
        | (map_result(update) if update else {"zones": None, "map": None}),
        tables=[
            _table(known, learned),
            discrepancy_table(found.belief.discrepancy),
            *(zone_tables(update) if update else []),
        ],
        rows=_rows(found),
        figures=lambda: _pages(known, learned),
        inputs=known.scene.inputs,
        data_tables=known.scene.tables | prior_hash(),
        sources=[*SOURCES, "Christen & Fox (2005), J. Comput. Graph. Stat. 14, 795"],
        seed=seed,
        extras=extras,
        untrusted=_doubt(learned),
        options=known.scene.options,
    )


def _soil(known: UpdateInputs, files_of_map: MapFiles) -> dict[str, Any]:
    """Where the soils come from that the drive was tried on."""
    if known.soil_map is not None:
        driven = DrivenSoil(files_of_map.before or "priors", "map" if files_of_map.before else "priors")
    else:
        driven = DrivenSoil(known.belief_file or "priors", "belief" if known.belief_file else "priors")
    return soil_record(driven, known.scene.terrain, PARAMETERS)


def _pages(known: UpdateInputs, learned: Learned) -> "Iterator[Figure]":
    from lunarsci.twin.figures.soil_layers import residual_page

    yield residual_page(known.along, learned.found, learned.changes)
    if learned.update is not None:
        yield from map_pages(learned.update, known.scene)


def _refuse_known(before: SoilBelief, sha256: str, states: str, belief: str) -> None:
    if any(entry.get("sha256") == sha256 and not entry.get("refused") for entry in before.history):
        raise DataError(f"{belief} has learned from {states} already; the same drive does not count twice")


def _rows(found: SoilUpdate) -> list[dict[str, Any]]:
    left, ground = found.belief.left_of_prior, ground_intervals(found.belief)
    return [
        {"parameter": name, "median": median, "low": low, "high": high, "left_of_prior": left[name]}
        | {f"ground_{key}": value for key, value in asdict(ground[name]).items()}
        for name, (median, low, high) in found.belief.intervals().items()
    ]


def _result(found: SoilUpdate) -> dict[str, Any]:
    return {
        "parameters": {row.pop("parameter"): row for row in _rows(found)},
        "values": found.values,
        "outliers": int(found.outliers.sum()),
        "chi_square": found.chi_square,
        "reduced_chi_square": found.reduced,
        "inflation": dict(found.inflation),
        "wheel_errors": dict(found.wheel_errors),
        "ruts": found.prediction.ruts,
        "surprise": found.prior_shift,
        "persistence": found.autocorrelation,
        "refused": found.refused or None,
        "drives": len(found.belief.history),
        "discrepancy": found.belief.discrepancy.to_dict(),
    }


def _table(known: UpdateInputs, learned: Learned) -> TextTable:
    found = learned.found
    rows = [
        [
            row["parameter"],
            *(f"{row[key]:.4g}" for key in ("median", "low", "high", "ground_low_68", "ground_high_68")),
            f"{100 * row['left_of_prior']:.0f} %",
        ]
        for row in _rows(found)
    ]
    notes = [
        f"{found.values} values, {int(found.outliers.sum())} outliers, reduced chi-square {found.reduced:.2f}; "
        f"surprise {found.prior_shift:.2f}",
    ]
    if found.prediction.ruts:
        notes.append("wheels that follow met the ruts of those before them; so they will where this soil is driven on")
    for name, factor in found.inflation.items():
        notes.append(f"errors of {name} are taken {factor:.1f} times as large: no soil explains it better")
    for name, size in found.wheel_errors.items():
        notes.append(f"single wheels are off in {name} by {size:.2g} throughout, which was allowed for")
    if found.prior_shift > SURPRISING and not found.refused:
        notes.append("the ground is hardly the one that was believed; forget more, or begin anew")
    notes.extend(change.text for change in learned.changes)
    if learned.changes and learned.update is None:
        notes.append("--save-map learns the soil of each stretch on its own")
    if found.autocorrelation > SETTLED:
        notes.append("the soils have not spread out; take more particles, or intervals are too narrow")
    notes.append(EFFECTIVE)
    title = f"Soil after {known.states}: {known.scene.plan.name}"
    headers = ["effective value", "median", "68 % from", "to", "ground's own from", "to", "left of the prior"]
    return TextTable(headers, rows, title=title, notes=notes)


def _doubt(learned: Learned) -> str:
    found, update = learned.found, learned.update
    if update is not None:
        return "" if update.learned else f"nothing was learned: {update.zones[0].why_not}"
    if not found.refused:
        return found.doubt
    return "; ".join([f"nothing was learned: {found.refused}", *(change.text for change in learned.changes)])
