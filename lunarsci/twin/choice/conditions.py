"""What all candidates meet alike: the same soils, grounds and errors for each of them."""

import dataclasses
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from lunarsci.arrays import FloatArray, spans
from lunarsci.parallel.blocks import run_blocks, shared_out
from lunarsci.regolith.physics_discrepancy import PhysicsDiscrepancy
from lunarsci.twin.ground.terrain import Terrain
from lunarsci.twin.plans.plan import Plan
from lunarsci.twin.rover import Rover
from lunarsci.twin.simulation.discrepancy import with_discrepancy
from lunarsci.twin.simulation.ensemble import DrawnDiscrepancy, PowerState, Prediction, predict
from lunarsci.twin.simulation.members import Grounds

Progress = Callable[[int, int], None]


@dataclass(frozen=True, slots=True, eq=False)
class _SomeGrounds:
    """Some members of other grounds."""

    whole: Grounds
    first: int
    parameters: Mapping[str, FloatArray]

    def __len__(self) -> int:
        return len(next(iter(self.parameters.values())))

    def terrain(self, member: int) -> Terrain:
        return self.whole.terrain(self.first + member)

    def only(self, member: int) -> "_SomeGrounds":
        own = slice(member, member + 1)
        return _SomeGrounds(self.whole, self.first + member, {n: v[own] for n, v in self.parameters.items()})


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Conditions:
    """What the drives of an ensemble meet, whichever plan they follow.

    Attributes
    ----------
    rover, terrain : what drives where.
    samples : soil of each member, by parameter; that of `grounds` where each has a ground of its own. (members,)
    grounds : a terrain for each member; None where samples lie everywhere.
    draws : what the ground of each member is drawn by, where heights have errors.
    discrepancy : what the twin's physics is off by; None leaves it out.
    ruts, before, time_step_s, sample_m : as for `predict`.
    power : battery and light, where these count.
    seed : of errors of position fixes and of the discrepancy.
    """

    rover: Rover
    terrain: Terrain
    samples: Mapping[str, FloatArray]
    grounds: Grounds | None = None
    draws: FloatArray | None = None
    discrepancy: PhysicsDiscrepancy | None = None
    ruts: bool = False
    before: Plan | None = None
    seed: int = 0
    time_step_s: float = 0.1
    sample_m: float = 0.1
    power: PowerState | None = None

    @property
    def members(self) -> int:
        """How many soils there are."""
        return len(next(iter(self.samples.values())))

    def drive(self, plan: Plan, members: range) -> Prediction:
        """Some members along a plan. Each such part draws its own errors of fixes and discrepancy."""
        own = slice(members.start, members.stop)
        samples = {name: values[own] for name, values in self.samples.items()}
        seed = int(np.random.SeedSequence([self.seed, members.start]).generate_state(1)[0])
        soils: dict[str, Any] = {"samples": samples}
        if self.grounds is not None:
            soils = {"grounds": _SomeGrounds(self.grounds, members.start, samples)}
        driven = predict(
            self.rover,
            self.terrain,
            plan,
            **soils,
            seed=seed,
            time_step_s=self.time_step_s,
            sample_m=self.sample_m,
            ruts=self.ruts,
            before=self.before,
            draws=None if self.draws is None else self.draws[own],
        )
        driven = driven if self.discrepancy is None else with_discrepancy(driven, self.discrepancy, seed)
        return dataclasses.replace(driven, power=self.power)


SHARED = ("rover", "terrain", "plan", "grounds", "before", "power")
"""Fields of a prediction that need not come back from where it was computed."""


@dataclass(frozen=True, slots=True, eq=False)
class CandidateDrives:
    """Drives of some members along each of some plans: what `run_blocks` shares out, a row for each plan."""

    conditions: Conditions
    plans: Sequence[Plan]
    members: range

    def __call__(self, block: range) -> list[dict[str, Any]]:
        """What the predictions of a block of plans do not share."""
        names = [field.name for field in dataclasses.fields(Prediction) if field.name not in SHARED]
        driven = [self.conditions.drive(self.plans[number], self.members) for number in block]
        return [{name: getattr(one, name) for name in names} for one in driven]


def drive_candidates(
    conditions: Conditions, plans: Sequence[Plan], members: range, progress: Progress | None = None
) -> list[Prediction]:
    """Some members along every plan, in threads or on a cluster; they depend on nothing else. In the order of plans."""
    work = CandidateDrives(conditions, plans, members)
    found: dict[int, Prediction] = {}
    own, grounds = slice(members.start, members.stop), conditions.grounds
    for block, parts in run_blocks(work, spans(len(plans), shared_out(len(plans), 1)), progress=progress):
        for number, part in zip(block, parts, strict=True):
            samples = {name: values[own] for name, values in conditions.samples.items()}
            found[number] = Prediction(
                rover=conditions.rover,
                terrain=conditions.terrain,
                plan=plans[number],
                grounds=None if grounds is None else _SomeGrounds(grounds, members.start, samples),
                before=conditions.before,
                power=conditions.power,
                **part,
            )
    return [found[number] for number in range(len(plans))]


def joined(parts: Sequence[Prediction]) -> Prediction:
    """Predictions of successive members along one plan as one."""
    if len(parts) == 1:
        return parts[0]

    def whole(name: str) -> Any:
        return np.concatenate([getattr(part, name) for part in parts])

    first = parts[0]
    soils = {name: np.concatenate([part.parameters[name] for part in parts]) for name in first.parameters}
    arrays = {name: whole(name) for name in ("paths", "states", "recorded", "outcome", "finer")}
    draws, steered = (None if getattr(first, name) is None else whole(name) for name in ("draws", "steered"))
    grounds = first.grounds
    if isinstance(grounds, _SomeGrounds):
        grounds = _SomeGrounds(grounds.whole, grounds.first, soils)
    return dataclasses.replace(
        first,
        **arrays,
        parameters=soils,
        draws=draws,
        steered=steered,
        grounds=grounds,
        discrepancy=_joined_discrepancy(parts),
    )


def _joined_discrepancy(parts: Sequence[Prediction]) -> DrawnDiscrepancy | None:
    drawn = [part.discrepancy for part in parts if part.discrepancy is not None]
    if not drawn:
        return None
    shares = {name: np.concatenate([one.shares[name] for one in drawn]) for name in drawn[0].shares}
    return DrawnDiscrepancy(law=drawn[0].law, offsets_m=np.concatenate([one.offsets_m for one in drawn]), shares=shares)
