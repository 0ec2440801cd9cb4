"""Drives by other physics than the twin's model, for whoever wants to know what the twin makes of them.

| name | rover | wheel and soil |
|---|---|---|
| same | the twin | the twin's closed form |
| closed | MuJoCo | the twin's closed form: what the bodies alone are off by |
| exact | MuJoCo | the stress integrals |
| ellipse | MuJoCo | the integrals, one strength shared by shear along and across the wheel |
| bulldozing | MuJoCo | the integrals, and the soil's push on the side faces (Hegedus 1960) |
| multipass | MuJoCo | the integrals, and ruts that stay and are loaded again (Wong 2008), on the way back too |
| changing | MuJoCo | the integrals, and a soil that changes from place to place |
| all | MuJoCo | the integrals with bulldozing, ruts and a soil that changes |

The exponent of sinkage depends on slip in all of them, as far as the hidden soil's n1 says. Sinkage counts from the
undisturbed ground, also in a rut, as one who knows the terrain of before measures it. A rut changes the bearing alone,
not the shear strength, and its walls do not guide a wheel.

`python tests/benchmarks/other_physics.py` prints how far MuJoCo with the closed form ends from the twin after the
embedded plan, and how long the drives take.
"""

import dataclasses
import time
import warnings
from dataclasses import dataclass, field

import numpy as np
from mujoco_rover import Driven, Law, Ruts, drive, fresh_ruts, joint_angles

from lunarsci.regolith.belief import first_belief
from lunarsci.regolith.prior import PARAMETERS, values_of
from lunarsci.regolith.wheel import ContactModel
from lunarsci.twin.ground.synthetic import synthetic_longji
from lunarsci.twin.ground.terrain import Terrain
from lunarsci.twin.plans.path import wheel_commands
from lunarsci.twin.plans.plan import Leg, Plan, read_plan
from lunarsci.twin.rover import Rover, build_rover
from lunarsci.twin.simulation.ensemble import predict

STEP_S = 0.004
"""Of MuJoCo; half of it moves the end of the embedded plan by 0.3 mm."""
RISE_N_M4 = 503e6
"""A_u of a dry sand (LETE sand, Wong 2008, table 2.4, from memory); k_0 is taken as the secant of the first loading."""
SPREAD = 0.3
"""Standard deviation of a changing soil about its mean, as a share of the first laws' widths; assumed."""
CORRELATION_M = 2.0
"""Distance over which a changing soil forgets itself; assumed."""


@dataclass(frozen=True, kw_only=True)
class Physics:
    """What drives, by which law, whether ruts stay, and how much the soil changes."""

    mujoco: bool = True
    exact: bool = True
    model: ContactModel = field(default_factory=ContactModel)
    rise_n_m4: float = 0.0
    spread: float = 0.0

    @property
    def law(self) -> Law:
        """As the compiled formulas take it."""
        return Law(self.exact, tuple(map(float, self.model.vector()[:6])), self.rise_n_m4)


SIDES = ContactModel(bulldozing="hegedus")
PHYSICS = {
    "same": Physics(mujoco=False, exact=False),
    "closed": Physics(exact=False),
    "exact": Physics(),
    "ellipse": Physics(model=ContactModel(shear="ellipse")),
    "bulldozing": Physics(model=SIDES),
    "multipass": Physics(rise_n_m4=RISE_N_M4),
    "changing": Physics(spread=SPREAD),
    "all": Physics(model=SIDES, rise_n_m4=RISE_N_M4, spread=SPREAD),
}


@dataclass(frozen=True, kw_only=True, eq=False)
class World:
    """A hidden soil on a terrain, by some physics, and the ruts that drives leave in it.

    `middle` are the transforms of the soil, or of its mean where it changes; `fields` how far from them it is at every
    node, in transforms. (ny, nx, 8)
    """

    rover: Rover
    terrain: Terrain
    physics: Physics
    middle: np.ndarray
    fields: np.ndarray | None
    ruts: Ruts

    def soil_along(self, driven: Driven) -> np.ndarray:
        """Transforms of the soil, on average over where the wheels went. (8,)"""
        if self.fields is None:
            return self.middle
        x, y = driven.states[..., 0].ravel(), driven.states[..., 1].ravel()
        j = np.round((x - self.terrain.x0_m) / self.terrain.spacing_m).astype(int)
        i = np.round((y - self.terrain.y0_m) / self.terrain.spacing_m).astype(int)
        return self.middle + self.fields[i, j].mean(axis=0)


def world_of(rover: Rover, terrain: Terrain, physics: Physics, theta: np.ndarray, seed: int = 0) -> World:
    """A terrain with a hidden soil of these transforms; `seed` is of how it changes."""
    fields = smooth_fields(terrain, seed) * physics.spread * widths() if physics.spread else None
    values = values_of(first_belief().laws, theta if fields is None else theta + fields)
    own = {name: values[..., k] for k, name in enumerate(PARAMETERS)}
    return World(
        rover=rover,
        terrain=terrain.with_soil(**own),
        physics=physics,
        middle=theta,
        fields=fields,
        ruts=fresh_ruts(terrain),
    )


def widths() -> np.ndarray:
    """Of the first laws. (8,)"""
    return np.sqrt(np.diag(first_belief().covariance))


def smooth_fields(terrain: Terrain, seed: int) -> np.ndarray:
    """Smooth random numbers of mean 0 and variance 1 at every node, for each parameter its own. (ny, nx, 8)"""
    random, waves = np.random.default_rng(seed), 48
    layers = []
    for _ in PARAMETERS:
        along, across, phase = random.normal(size=(3, waves))
        x = np.exp(1j * np.outer(along / CORRELATION_M, terrain.x_m))
        y = np.exp(1j * (np.outer(across / CORRELATION_M, terrain.y_m) + 2.0 * np.pi * phase[:, None]))
        layers.append(np.real(np.einsum("wi,wj->ij", y, x)) * np.sqrt(2.0 / waves))
    return np.stack(layers, axis=-1)


def true_drive(world: World, plan: Plan, step_s: float = STEP_S, sample_s: float = 2.0) -> Driven:
    """Drive a plan by the world's physics, MuJoCo's recorded every `sample_s`; ruts stay in the world."""
    rover, terrain = world.rover, world.terrain
    if not world.physics.mujoco:
        out = predict(rover, terrain, plan, sweep=())
        return Driven(time_s=out.time_s, poses=out.paths[0], states=out.states[0], outcome=out.outcome_text(0))
    first = plan.legs[0]
    short = dataclasses.replace(plan, legs=(dataclasses.replace(first, length_m=0.1),), sweep=(), fixes=None)
    begun = predict(rover, terrain, short, sweep=())
    if not begun.recorded[0]:
        return Driven(time_s=begun.time_s, poses=begun.paths[0], states=begun.states[0], outcome=begun.outcome_text(0))
    joints = joint_angles(rover, terrain, begun.paths[0, :1], begun.states[0, :1], steering_of(rover, first))[0]
    start = (begun.paths[0, 0], joints)
    return drive(rover, terrain, plan, world.physics.law, start, world.ruts, step_s=step_s, sample_s=sample_s)


def steering_of(rover: Rover, leg: Leg) -> np.ndarray:
    """Steering angles along an arc. (wheels,) [rad]"""
    crab = np.radians(leg.crab_deg)
    return wheel_commands(rover, np.cos(crab), np.sin(crab), leg.curvature_per_m, 1.0).steering_rad


def main() -> None:
    """Print how far MuJoCo ends from the twin, and times."""
    warnings.simplefilter("ignore")
    rover, plan, terrain, middle = build_rover("yutu2"), read_plan(), synthetic_longji(), first_belief().mean
    twin = {
        step: predict(rover, terrain.with_soil(**medians()), plan, sweep=(), time_step_s=step).endpoints_m[0]
        for step in (0.1, 0.02)
    }
    for name in ("closed", "exact", "ellipse", "bulldozing", "multipass", "changing", "all"):
        begin = time.perf_counter()
        ends = [true_drive(world_of(rover, terrain, PHYSICS[name], middle), plan, STEP_S / k) for k in (1, 2)]
        took = (time.perf_counter() - begin) / 3
        off = [1e3 * float(np.hypot(*(ends[1].poses[-1, :2] - end))) for end in twin.values()]
        half = 1e3 * float(np.hypot(*(ends[1].poses[-1, :2] - ends[0].poses[-1, :2])))
        z = 1e3 * ends[1].states[5:, :, 2].mean(axis=0)
        print(f"{name:10s} {ends[0].outcome}; ends {off[0]:.1f} and {off[1]:.1f} mm from the twin at steps of 0.1 and "
              f"0.02 s, half the step moves it {half:.3f} mm; {took:.1f} s; sinkage {np.round(z, 1)} mm")  # fmt: skip


def medians() -> dict[str, float]:
    """The soil in the middle of the first laws, by parameter."""
    first = first_belief()
    return dict(zip(PARAMETERS, map(float, values_of(first.laws, first.mean)), strict=True))


if __name__ == "__main__":
    main()
