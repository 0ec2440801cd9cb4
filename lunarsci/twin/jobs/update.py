"""What a drive says of the soil: a belief, or a map of beliefs by place, for the next prediction."""

import warnings
from collections.abc import Callable, Iterator, Mapping
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from lunarsci.errors import DataError, LunarSciWarning, RequestError
from lunarsci.figure import as_label
from lunarsci.io.inputs import InputFile, Source, read_input
from lunarsci.options import refuse_where, request_of
from lunarsci.regolith.belief import SoilBelief, contact_rows, parameter_rows, with_drive
from lunarsci.regolith.prior import PARAMETERS, asked_in, prior_hash
from lunarsci.regolith.soil import soil_tables
from lunarsci.result import Doubt, MadeFrom, Result, job
from lunarsci.twin.assimilation.residuals import DriveRecord, pace_of, read_drive_states, read_record
from lunarsci.twin.assimilation.segments import Segment, SoilChange, drive_segments, find_change, planned_places
from lunarsci.twin.assimilation.update import SlipLean, SoilUpdate, assimilate
from lunarsci.twin.ground.driven_soil import PRIORS, DrivenSoil, GivenSoil, doubt_of, soil_record
from lunarsci.twin.ground.soil_map import SoilMap, Zone, soil_layers, soil_map_bytes
from lunarsci.twin.ground.terrain import terrain_bytes
from lunarsci.twin.jobs.drive_inputs import SOURCES, DriveInputs, read_drive_inputs
from lunarsci.twin.jobs.requests import UpdateRequest
from lunarsci.twin.judgement.tables import mean_loads_n
from lunarsci.twin.telemetry.checks import WheelPace

if TYPE_CHECKING:
    from matplotlib.figure import Figure


SAMPLER = "Christen & Fox (2005), J. Comput. Graph. Stat. 14, 795"


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Before:
    """What was believed before a drive.

    Attributes
    ----------
    belief : of the whole drive, forgotten as far as asked.
    soil_map : the map; None where the soil is not kept by place.
    file : what they come from; None for the priors.
    doubt : why it is doubtful; empty where it is not.
    believed : whether it is a belief that was not all forgotten.
    """

    belief: SoilBelief
    soil_map: SoilMap | None
    file: InputFile | None
    doubt: str = ""
    believed: bool = False

    @classmethod
    def read(cls, asked: UpdateRequest, inputs: DriveInputs) -> "Before":
        """Read a belief or a map. Raises DataError, RequestError for options that do not fit what it is."""
        given = GivenSoil.of_source(PRIORS if asked.soil is None else asked.soil)
        file, belief, soil_map = None if given.name == PRIORS else given.file, given.belief, given.soil_map
        refuse_where({
            "`soil` is of one soil everywhere; give a map, or leave the map's options out":
                file is not None and soil_map is None and asked.by_place,
            "`correlation` is of a soil map; give one as `soil`, or save one":
                asked.correlation is not None and soil_map is None and not asked.by_place,
        })  # fmt: skip
        if belief is not None and asked.by_place:
            across = abs(inputs.rover.wheel_positions_m[:, 1]).max() + 0.5 * inputs.rover.wheel.width_m
            soil_map = SoilMap(reach_m=round(float(across), 3))
        if soil_map is not None and asked.correlation is not None:
            soil_map = replace(soil_map, correlation_m=asked.correlation)
        if soil_map is not None:
            belief = soil_map.belief_along(planned_places(inputs.plan, inputs.rover))
        if belief is None:
            if given.named is not None and given.named == asked.soil and given.named not in soil_tables():
                read_input(given.named)  # a path that is none is refused as such
            raise DataError(f"{given.named or given.name}: no belief; give one of `twin update`, its map, or priors")
        doubt = "" if file is None or asked.forget == 1.0 else doubt_of(file.name, belief)
        belief = belief.forgotten(asked.forget) if asked.forget else belief
        believed = file is not None and soil_map is None and asked.forget < 1.0
        return cls(belief=belief, soil_map=soil_map, file=file, doubt=doubt, believed=believed)

    def cautions(self, learned: SoilUpdate) -> list[str]:
        """What to know of a drive's soil and is no doubt; a map keeps other ground apart by itself."""
        return [text for text in (learned.caution, learned.other_ground if self.believed else "") if text]

    def refuse_repeated(self, states: InputFile) -> None:
        """Raises DataError where the belief has learned from these states: the same drive does not count twice."""
        if self.file is None or self.soil_map is not None:
            return
        if any(entry.get("sha256") == states.sha256 and not entry.get("refused") for entry in self.belief.history):
            raise DataError(
                f"{self.file.name} has learned from {states.name} already; the same drive does not count twice"
            )


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class LearnedSoil(Result):
    """What a drive says of one soil, where the soil changes on its way, and the map after it.

    Attributes
    ----------
    inputs, record, states : what drove where, what was measured of it without positions, and its file.
    before, update : what was believed before, and what the drive says of one soil.
    changes : of the soil along the way.
    segments, soil_map : stretches with a soil each, and the map with them; None where the soil is not kept by place.
    pace : how fast the wheels turned beside the plan; None where the states do not say.
    slip : median slip as measured, and on the soil found; None where it was not measured, or nothing was learned.
    seed : of everything random.
    """

    schema = "twin-update/1"
    inputs: DriveInputs
    record: DriveRecord
    states: InputFile
    before: Before
    update: SoilUpdate
    changes: list[SoilChange]
    segments: list[Segment] | None
    soil_map: SoilMap | None
    seed: int
    pace: WheelPace | None = None
    slip: SlipLean | None = None

    @property
    def belief(self) -> SoilBelief:
        """After the drive."""
        return self.update.belief

    @property
    def made_from(self) -> MadeFrom:
        inputs = self.inputs
        tables, sources = inputs.tables | prior_hash(), [*SOURCES, SAMPLER]
        return MadeFrom(inputs=inputs.inputs, tables=tables, sources=sources, seed=self.seed, options=inputs.options)

    @property
    def doubt(self) -> Doubt:
        questions = self.inputs.questions
        if self.segments is not None:
            if not any(segment.learned for segment in self.segments):
                return Doubt.of(f"nothing was learned: {self.segments[0].why_not}")
        elif self.update.refused:
            nothing = f"nothing was learned: {self.update.refused}"
            return Doubt.of(*questions, nothing, *(change.text for change in self.changes))
        return Doubt.of(*questions, *self.doubts.reasons, self.before.doubt)

    @property
    def forces_measured(self) -> bool:
        """Whether forces were measured: without, the soil is that of the mass in the rover file."""
        return bool((self.record.values[:, 3:] == self.record.values[:, 3:]).any())

    @property
    def doubts(self) -> Doubt:
        """Why what was learned is doubtful, each reason once."""
        parts = [self.update] if self.segments is None else [one.update for one in self.segments if one.learned]
        texts = [self.record.doubt, self.pace.doubt if self.pace else "", *(part.doubt for part in parts if part)]
        leans = [self.slip] if self.segments is None else [one.slip for one in self.segments]
        texts += [lean.doubt for lean in leans if lean]
        return Doubt.of(*dict.fromkeys(texts))

    def to_dict(self) -> dict[str, Any]:
        learned, soil_map = self.update, self.soil_map
        return {
            "belief": learned.belief.to_dict(),
            "parameters": parameter_rows(learned.belief),
            "contact": contact_rows(learned.belief) or None,
            "values": learned.values,
            "outliers": int(learned.outliers.sum()),
            "chi_square": learned.chi_square,
            "reduced_chi_square": learned.reduced,
            "inflation": dict(learned.inflation),
            "wheel_errors": dict(learned.wheel_errors),
            "ruts": bool(learned.prediction.ruts.all()),
            "ruts_probability": learned.ruts_probability,
            "surprise": learned.prior_shift,
            "persistence": learned.autocorrelation,
            "refused": learned.refused or None,
            "doubt": str(self.doubts) or None,
            "caution": "; ".join(self.before.cautions(learned)) or None,
            "pace": None if self.pace is None else self.pace.to_dict(),
            "slip_ratio": None if self.slip is None else self.slip.to_dict(),
            "drives": len(learned.belief.history),
            "discrepancy": learned.belief.discrepancy.to_dict(),
            "changes": [asdict(change) | {"text": change.text} for change in self.changes],
            "made_for": self.inputs.made_for,
            "rover": self.inputs.rover.name,
            "mass_kg": self.inputs.rover.mass_kg,
            "soil": self._soil_record(),
            "zones": None if self.segments is None else [segment.to_dict() for segment in self.segments],
            "map": None
            if soil_map is None
            else {"zones": len(soil_map.zones), "correlation_m": soil_map.correlation_m},
        } | asked_in(self.inputs.questions)

    def _soil_record(self) -> dict[str, Any]:
        """Where the soils come from that the drive was tried on."""
        driven, before = DrivenSoil("priors", "priors"), self.before
        if before.file is not None:
            driven = DrivenSoil(before.file.name, "belief" if before.soil_map is None else "map")
        return soil_record(driven, self.inputs.terrain, PARAMETERS)

    def rows(self) -> list[dict[str, Any]]:
        """One a parameter."""
        return [{"parameter": name} | row for name, row in parameter_rows(self.belief).items()]

    def files(self) -> dict[str, Callable[[], bytes]]:
        """The belief after the drive, which `predict` takes as its `soil`: name to what makes the content."""
        return {"belief.json": lambda: self.belief.to_json().encode()}

    def as_input(self, role: str) -> dict[str, Callable[[], bytes]]:
        return self.files() if role in ("soil", "belief", "result") else {}

    def figures(self) -> "Iterator[Figure]":
        from lunarsci.regolith.figure import belief_figure
        from lunarsci.twin.figures.maps import residual_page, soil_pages

        title, synthetic = f"soil after {as_label(self.inputs.plan.name)}", self.inputs.terrain.synthetic
        yield belief_figure(self.belief, title, synthetic=synthetic)
        yield residual_page(self.record, self.update, self.changes)
        if self.soil_map is not None:
            yield from soil_pages(soil_layers(self.soil_map, self.inputs.terrain), self.soil_map)

    def map_bytes(self) -> bytes:
        """The soil map after the drive, as JSON. Raises RequestError where the soil is not kept by place."""
        return soil_map_bytes(self._map())

    def terrain_bytes(self) -> bytes:
        """The terrain with the map's median soil at every node, as .npz. Raises RequestError as `map_bytes`."""
        layers = soil_layers(self._map(), self.inputs.terrain)
        return terrain_bytes(layers.terrain, sd_ratio=layers.sd_ratio)

    def _map(self) -> SoilMap:
        if self.soil_map is None:
            raise RequestError("the soil is not kept by place; give a map as `soil`, or `by_place`")
        return self.soil_map


@job
def update(
    states: Source,
    request: UpdateRequest | None = None,
    *,
    progress: Callable[[int, int], None] | None = None,
    **options: Any,
) -> LearnedSoil:
    """Update what is believed of the soil by measured wheel states of a drive.

    Raises DataError for files that cannot be used and a drive that counted before, RequestError for impossible options.

    Examples
    --------
    >>> soil = lunarsci.update("states/states.csv", plan="plan.toml", particles=32)
    >>> posterior = soil.to_table()
    """
    asked = request_of(UpdateRequest, request, options)
    inputs = read_drive_inputs(asked.plan, *asked.ground, soil_counts=False)
    source, fixes = read_input(states), None if asked.positions is None else read_input(asked.positions)
    table = read_drive_states(source, inputs.rover)
    inputs = inputs.asked(heights=asked.heights_without_unit, as_written=asked.as_written, states=table)
    record = read_record(table, inputs.rover, positions=fixes)
    before = Before.read(asked, inputs)
    inputs.check.belief(before.file.name if before.file else "", before.belief)
    inputs.check.law(before.file.name if before.file else "", before.belief.verdict if before.believed else None)
    before.refuse_repeated(source)
    inputs.check.states(source.name, table.table, named=inputs.made_for["plan"] is not None)
    inputs.inputs.update({file.name: file.sha256 for file in (before.file, source, fixes) if file})
    along = record if fixes is None else read_record(table, inputs.rover)
    drawing: dict[str, Any] = {"particles": asked.particles, "seed": asked.seed, "progress": progress}
    of_map, teach = before.soil_map is not None, not before.belief.discrepancy.has_scored(source.sha256)
    drive = (inputs.rover, inputs.terrain, inputs.plan)
    learned = assimilate(*drive, record, before.belief, ruts=asked.ruts, wheel=not of_map, teach=teach, **drawing)
    pace = pace_of(along, inputs.rover, inputs.plan)
    slip = SlipLean.of(along, learned)
    line = _DrivenLine(inputs=inputs, states=source, before=before, doubts=(along.doubt, pace.doubt if pace else ""))
    whole = replace(line, doubts=(*line.doubts, slip.doubt if slip else ""))
    learned = _with_history(learned, before, whole, asked.forget, scored=len(record.fix_time_s) > 0)
    for text in before.cautions(learned):
        warnings.warn(f"{source.name}: {text}", LunarSciWarning, stacklevel=2)
    segments = soil_map = None
    if before.soil_map is None:
        change = find_change(along, learned, seed=asked.seed)
        changes = [] if change is None else [change]
    else:
        segments, changes = drive_segments(*drive, along, learned, before.soil_map, forgotten=asked.forget, **drawing)
        zones = [_zone(segment, line) for segment in segments if segment.learned]
        soil_map = before.soil_map.with_zones(zones)
    return LearnedSoil(
        inputs=inputs, record=along, states=source, before=before, update=learned, changes=changes, segments=segments,
        soil_map=soil_map, seed=asked.seed, pace=pace, slip=slip,
    )  # fmt: skip


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class _DrivenLine:
    """What a line of history says of a drive, whatever it taught.

    Attributes
    ----------
    inputs, states : what was driven, and the file of its states.
    doubts : why these are doubtful, one sentence each; empty ones count for nothing.
    before : what was believed before it.
    """

    inputs: DriveInputs
    states: InputFile
    doubts: tuple[str, ...]
    before: Before

    def of(self, learned: SoilUpdate) -> Mapping[str, Any]:
        """The line of history of what was found."""
        doubts = () if learned.refused else (*self.doubts, learned.doubt)
        caution = "; ".join(self.before.cautions(learned))
        return (
            {
                "states": Path(self.states.name).name,
                "sha256": self.states.sha256,
                "plan": self.inputs.plan.name,
                "rover": self.inputs.rover.written,
                "gravity_m_s2": self.inputs.rover.gravity_m_s2,
                "ground": self.inputs.terrain.written,
                "values": learned.values,
                "outliers": int(learned.outliers.sum()),
                "chi_square": learned.chi_square,
                "inflation": dict(learned.inflation),
                "ruts": bool(learned.prediction.ruts.all()),
                "ruts_probability": learned.ruts_probability,
                "loads_n": mean_loads_n(learned.prediction),
                "surprise": learned.prior_shift,
                "refused": learned.refused,
                "doubt": str(Doubt.of(*doubts)),
            }
            | ({"caution": caution} if caution else {})
            | ({"synthetic": True} if self.inputs.terrain.synthetic else {})
        )


def _with_history(
    learned: SoilUpdate, before: Before, drive: _DrivenLine, forgotten: float, *, scored: bool
) -> SoilUpdate:
    """The belief with the drive in its history; its discrepancy says that it rests on the drive's end, if `scored`."""
    belief, law, states = learned.belief, learned.belief.discrepancy, drive.states
    if scored and not learned.refused and not law.has_scored(states.sha256):
        line = {
            "states": Path(states.name).name,
            "sha256": states.sha256,
            "plan": drive.inputs.plan.name,
            "how": "own end",
        }
        belief = replace(belief, discrepancy=law.with_source(**line))
    of_belief = before.file is not None and before.soil_map is None
    parent = before.file.sha256 if of_belief and before.file else None
    entry = drive.of(learned)
    return replace(learned, belief=with_drive(belief, before.belief, entry, parent_sha256=parent, forgotten=forgotten))


def _zone(segment: Segment, drive: _DrivenLine) -> Zone:
    lean = (segment.slip.doubt,) if segment.slip else ()
    line = dict(replace(drive, doubts=(*drive.doubts, *lean)).of(segment.update)) if segment.update else {}
    line |= {"from_m": round(segment.from_m, 3), "to_m": round(segment.to_m, 3)}
    belief = replace(segment.belief, history=(*segment.before.history, line))
    name = f"{drive.inputs.plan.name}, {segment.from_m:.1f} to {segment.to_m:.1f} m"
    return Zone(name=name, place_m=segment.place_m, belief=belief)
