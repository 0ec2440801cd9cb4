"""Measured single wheels against the models: `python tests/benchmarks/wheels.py`.

Pavlov & Johnson's grouser wheel (CMU, 189 runs in skid and slip at slip angles of 0-90 deg, every state three times).
Soil and contact angles are fitted to one repetition of each state, the other two predicted at their measured sinkage,
each of the three in turn. Left out are runs deeper than the wheel's radius, most of those at 90 deg, and locked wheels,
for which Eq. 13 has no shear; `--locked` takes them in.

The joint inference (`lunarsci.regolith.inference`) is left to predict what it has not seen: one repetition, one
slip, one slip angle in turn, locked wheels included, at measured sinkage; then sets of states with the sign of one
column wrong.

Points read off published curves (Ding 2011, Wang & Han 2016, Hurrell 2025) are predicted with the soils of the tables
and nothing fitted: drawbar pull at measured sinkage and load, and sinkage under the load.

Needs the reference data, found through LUNARSCI_REFERENCE_DATA.
"""

import math
import os
import sys
from dataclasses import dataclass
from functools import cache
from pathlib import Path

import numpy as np
import pandas as pd
from scipy.optimize import least_squares

from lunarsci.errors import ParameterError
from lunarsci.regolith.belief import FitVerdict
from lunarsci.regolith.inference.posterior import infer_soil
from lunarsci.regolith.inference.prediction import WheelLaw, candidates, compare_laws, predict_forces
from lunarsci.regolith.integrals import integrated_forces, integrated_forces_in_motion
from lunarsci.regolith.soil import Soil
from lunarsci.regolith.states import COLUMNS, MeasurementErrors, WheelStates
from lunarsci.regolith.traction import sinkage_under_load, stiffness_under_load
from lunarsci.regolith.wheel import ContactModel, Wheel, read_wheel

__all__ = [
    "JOINT",
    "MODELS",
    "PointErrors",
    "Runs",
    "errors",
    "grouser_runs",
    "left_out",
    "published_curves",
    "published_points",
    "published_verdicts",
    "stated",
    "states_of",
    "with_sign_turned",
]

RADIUS_M, WIDTH_M, GROUSER_M = 0.058, 0.05, 0.005
EARTH = {"density_kg_m3": 1330.0, "gravity_m_s2": 9.81}
"""Density as its authors give it."""
MODELS = {
    "signed, separate": ContactModel(**EARTH),
    "signed, combined": ContactModel(shear="combined", **EARTH),
    "signed, ellipse": ContactModel(shear="ellipse", **EARTH),
    "combined, bulldozing by Hegedus": ContactModel(shear="combined", bulldozing="hegedus", **EARTH),
    "ellipse, bulldozing by Hegedus": ContactModel(shear="ellipse", bulldozing="hegedus", **EARTH),
    "ellipse, bulldozing by Wong": ContactModel(shear="ellipse", bulldozing="wong", **EARTH),
    "printed": ContactModel(reading="printed", **EARTH),
}
JOINT = WheelLaw(MODELS["combined, bulldozing by Hegedus"], True)
"""The law that the comparison of laws takes for all runs."""
RIMS = (1.0, 4.0, 6.5, 9.0, 11.0, 16.0, 30.0, 70.0)
"""Between the nine rim speeds, of slip -1, -0.7, -0.5, -0.2, 0, 0.2, 0.5, 0.75 and 0.9 without side slip. [mm/s]"""
DEEPEST = 0.95
START = np.array([math.log(1e3), 1.0, 0.2, 0.2, math.log(800), 31.0, math.log(12), 31.0, math.log(12), 0.4, 0.15, -0.1])
WIDTH = np.array([1.5, 0.4, 0.3, 0.4, 1.0, 6.0, 0.7, 8.0, 0.7, 0.1, 0.15, 0.15])
"""ln K_s, n0, n1, n2, ln c, phi, ln K_x, phi_y, ln K_y, c1, c2, c3: start and width of the fit; assumed."""
SOILS = {
    "ding2011": "HIT-LSS1 planetary soil simulant",
    "wang_han_2016_kls1": "KLS-1",
    "hurrell2025_rashid1": "FJS-1 lunar regolith simulant (Ishigami)",
}
"""Of the table of soils; the last is not its authors', and its K is kx at no side slip."""
SCALE_N = np.array([2.0, 0.7, 0.7])
"""Weights of F_N, F_DP and F_L; about their scatter between repetitions."""


@dataclass(frozen=True, slots=True, eq=False)
class Runs:
    """Sinkage [m], velocities [m/s], forces F_N, F_DP, F_L [N], slip angle [deg] and repetition of each run."""

    sinkage: np.ndarray
    velocity: np.ndarray
    forces: np.ndarray
    angle: np.ndarray
    repetition: np.ndarray

    def part(self, chosen: np.ndarray) -> "Runs":
        """Some of the runs."""
        return Runs(*(getattr(self, name)[chosen] for name in self.__slots__))


@cache
def grouser_runs(data: Path) -> Runs:
    """The runs that a model of a wheel above its axle can describe."""
    rows = pd.read_csv(data / "wheel/cmu_pavlov_single_wheel_grouser.csv")
    angle = np.radians(rows["beta"].to_numpy(float))
    speed, rim = (rows[name].to_numpy(float) * 1e-3 for name in ("avg_Vx", "avg_Vry"))
    velocity = np.column_stack([np.abs(speed * np.cos(angle)), speed * np.sin(angle), np.maximum(rim, 0.0)])
    velocity[np.abs(velocity) < 1e-9] = 0.0
    forces = np.column_stack([-rows["avg_Fz"], -rows["avg_Fy"], rows["avg_Fx"]])
    # Column trial_num counts attempts, not repetitions: nearly all of them are 1.
    repetition = rows.groupby(["beta", "Vry"]).cumcount().to_numpy() + 1
    runs = Runs(-rows["avg_Z"].to_numpy() * 1e-3, velocity, forces, rows["beta"].to_numpy(), repetition)
    return runs.part(runs.sinkage < DEEPEST * RADIUS_M)


def contact(point: np.ndarray, model: ContactModel) -> tuple[Wheel, Soil, ContactModel]:
    """Wheel, soil and model at a point of the fit."""
    c1 = float(np.clip(point[9], 0.05, 0.9))
    wheel = Wheel(
        radius_m=RADIUS_M,
        width_m=WIDTH_M,
        grouser_height_m=GROUSER_M,
        max_stress_c1=c1,
        max_stress_c2=float(point[10]),
        exit_c3=float(min(point[11], c1 - 0.05)),
    )
    soil = Soil(
        stiffness_kpa_m_n=math.exp(point[0]),
        sinkage_exponent=float(max(point[1], 0.05)),
        sinkage_exponent_slip=float(point[2]),
        cohesion_pa=math.exp(point[4]),
        friction_angle_deg=float(np.clip(point[5], 1, 60)),
        shear_modulus_mm=math.exp(point[6]),
        external_friction_angle_deg=float(np.clip(point[7], 1, 60)),
        lateral_modulus_mm=math.exp(point[8]),
    )
    own = {name: getattr(model, name) for name in ("reading", "shear", "bulldozing", "density_kg_m3", "gravity_m_s2")}
    return wheel, soil, ContactModel(**own, skid_exponent_slip=float(point[3]))


def predicted(point: np.ndarray, runs: Runs, model: ContactModel) -> np.ndarray:
    """F_N, F_DP, F_L. [N]"""
    wheel, soil, own = contact(point, model)
    try:
        found = integrated_forces_in_motion(wheel, soil, runs.sinkage, runs.velocity, own)
    except ParameterError:  # beyond any number
        return np.full_like(runs.forces, np.inf)
    return np.column_stack([found.normal_force_n, found.drawbar_pull_n, found.lateral_force_n])


def fitted(runs: Runs, model: ContactModel) -> np.ndarray:
    """The point of least squares, held near the start by its width."""

    def rows(point: np.ndarray) -> np.ndarray:
        misfit = np.clip((predicted(point, runs, model) - runs.forces) / SCALE_N, -1e3, 1e3)
        return np.concatenate([misfit.ravel(), (point - START) / WIDTH])

    return np.asarray(least_squares(rows, START, x_scale=WIDTH).x)


@cache
def errors(runs: Runs, name: str, straight: bool, locked: bool = False) -> tuple[float, float, float]:
    """Root mean square of predicted less measured F_N, F_DP, F_L of runs that were not fitted. [N]

    `straight` takes runs without side slip only, for fit and prediction.
    """
    chosen = runs.part(runs.angle == 0) if straight else runs
    if not locked or name == "printed":
        chosen = chosen.part(chosen.velocity[:, 2] > 0)
    squares = []
    for repetition in (1, 2, 3):
        point = fitted(chosen.part(chosen.repetition == repetition), MODELS[name])
        rest = chosen.part(chosen.repetition != repetition)
        squares.append((predicted(point, rest, MODELS[name]) - rest.forces) ** 2)
    return tuple(map(float, np.sqrt(np.mean(np.concatenate(squares), axis=0))))


def states_of(runs: Runs) -> WheelStates:
    """The runs as wheel states: slip by the speed along the heading, errors as the paper states them."""
    travel, rim = runs.velocity[:, 0], runs.velocity[:, 2]
    faster = travel <= rim
    slip = np.where(faster, 1 - travel / np.maximum(rim, 1e-12), rim / np.maximum(travel, 1e-12) - 1)
    slip = np.where(rim > 0, slip, -1.0)
    return stated(np.column_stack([runs.sinkage, slip, runs.angle, runs.forces]))


def stated(values: np.ndarray) -> WheelStates:
    sigmas = np.column_stack([MeasurementErrors().of(name, values[:, k]) for k, name in enumerate(COLUMNS)])
    return WheelStates(tuple(str(n) for n in range(len(values))), values, np.nan_to_num(sigmas))


def part_of(states: WheelStates, chosen: np.ndarray) -> WheelStates:
    """Some of the states."""
    ids = tuple(name for name, good in zip(states.id, chosen, strict=True) if good)
    return WheelStates(ids, states.values[chosen], states.sigmas[chosen])


def with_sign_turned(states: WheelStates, column: str) -> WheelStates:
    """The states with the sign of one column turned."""
    values = states.values.copy()
    values[:, COLUMNS.index(column)] *= -1
    return WheelStates(states.id, values, states.sigmas)


def left_out(
    states: WheelStates, wheel: Wheel, law: WheelLaw, groups: np.ndarray, folds: tuple[float, ...] = ()
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Predicted less measured F_N, F_DP, F_L as shares of the load, and whether 90 % intervals hold, of each group (or
    those in `folds`) from all others; and which states these are."""
    misses, held, which = [], [], []
    for group in folds or np.unique(groups):
        out = groups == group
        found = infer_soil(part_of(states, ~out), wheel, model=law.model, contact=law.contact)
        depth, slip, side, load = states.values[out, :4].T
        told = predict_forces(found, wheel, slip, side, load, depth)
        misses.append((told.value - states.values[out, 3:]) / load[:, None])
        held.append(told.holds(states.values[out, 3:]))
        which.append(np.flatnonzero(out))
    return np.concatenate(misses), np.concatenate(held), np.concatenate(which)


@dataclass(frozen=True, slots=True)
class PointErrors:
    """Points, rmse of the drawbar pull by the load and of the sinkage [m]."""

    points: int
    drawbar: float
    sinkage: float


def at_load(wheel: Wheel, soil: Soil, sinkage: np.ndarray, slip: np.ndarray, load: float) -> np.ndarray:
    """Drawbar pull [N] at the stiffness that carries the load at this sinkage."""
    model = ContactModel()
    pulls = []
    for z, s in zip(sinkage, slip, strict=True):
        stiffness = stiffness_under_load(wheel, soil, load, float(z), float(s), model=model)
        found = integrated_forces(wheel, soil.replace(stiffness_kpa_m_n=stiffness), z, s)
        pulls.append(float(found.drawbar_pull_n))
    return np.array(pulls)


def sinkages(wheel: Wheel, soil: Soil, slip: np.ndarray, load: float) -> np.ndarray:
    """Under the load. [m]"""
    return np.array([sinkage_under_load(wheel, soil, load, float(value), model=ContactModel()) for value in slip])


def published_points(data: Path) -> dict[str, PointErrors]:
    """Errors by source and grouser height, nothing fitted: contact angles of Eqs 10, 11 at c1 = 0.5, c2 = c3 = 0."""
    rows = pd.read_csv(data / "wheel/roverdevkit_single_wheel_experiments.csv")
    table = pd.read_csv(data / "soil/wheel_test_soils.csv", index_col="name")
    found = {}
    for (source, height), group in rows.groupby(["source", "grouser_height_m"]):
        first, tabled = group.iloc[0], table.loc[SOILS[source]]
        k_x = 36.0 if source.startswith("hurrell") else float(tabled["K_mm"])
        wheel = Wheel(radius_m=first.wheel_radius_m, width_m=first.wheel_width_m, grouser_height_m=height)
        soil = Soil(
            stiffness_kpa_m_n=tabled["k_c_kN_m^(n+1)"] / wheel.width_m + tabled["k_phi_kN_m^(n+2)"],
            sinkage_exponent=tabled["n0"],
            cohesion_pa=1e3 * tabled["c_kPa"],
            friction_angle_deg=tabled["phi_deg"],
            shear_modulus_mm=k_x,
            external_friction_angle_deg=tabled["phi_deg"],
            lateral_modulus_mm=k_x,
        )
        sinkage, slip, load = (group[name].to_numpy() for name in ("meas_sinkage_m", "slip", "vertical_load_n"))
        pull = at_load(wheel, soil, sinkage, slip, float(load[0])) - group["meas_drawbar_pull_n"].to_numpy()
        deep = sinkages(wheel, soil, slip, float(load[0])) - sinkage
        found[f"{source}, grousers of {1e3 * height:.0f} mm"] = PointErrors(
            len(group),
            float(np.sqrt(np.mean(pull**2)) / load[0]),
            float(np.sqrt(np.mean(deep**2))),
        )
    return found


def published_curves(data: Path) -> dict[str, tuple[Wheel, WheelStates]]:
    """Points of published curves, by source and grouser height."""
    rows = pd.read_csv(data / "wheel/roverdevkit_single_wheel_experiments.csv")
    found = {}
    for (source, height), group in rows.groupby(["source", "grouser_height_m"]):
        first = group.iloc[0]
        wheel = Wheel(radius_m=first.wheel_radius_m, width_m=first.wheel_width_m, grouser_height_m=height)
        names = ("meas_sinkage_m", "slip", "vertical_load_n", "meas_drawbar_pull_n")
        sinkage, slip, load, pull = (group[name].to_numpy(float) for name in names)
        blank = np.full(len(group), np.nan)
        states = stated(np.column_stack([sinkage, slip, blank, load, pull, blank]))
        found[f"{source}, grousers of {1e3 * height:.0f} mm"] = wheel, states
    return found


def published_verdicts(data: Path) -> dict[str, FitVerdict]:
    """Of joint fits to points of published curves, by source and grouser height, with the law that predicts best."""
    found = {}
    for name, (wheel, states) in published_curves(data).items():
        law, _ = compare_laws(states, wheel, candidates(states))
        found[name] = infer_soil(states, wheel, model=law.model, contact=law.contact).verdict
    return found


def joint_tables(data: Path) -> None:
    """Print what the joint inference predicts of runs that it has not seen, and its verdicts."""
    runs, wheel = grouser_runs(data), read_wheel("cmu-grouser")
    states = states_of(runs)
    rim = np.digitize(1e3 * runs.velocity[:, 2], RIMS)
    print("law | score | behind | +- | model error of F_N, F_DP, F_L")
    for score in compare_laws(states, wheel, candidates(states, *EARTH.values()))[1]:
        print(f"{score.law.name} | {score.score} | {score.behind} | {score.behind_sigma} | {score.model_error}")
    print("left out | F_DP without and with side slip, F_L: rms / load | F_N, F_DP, F_L: held by 90 % intervals")
    folds = {"repetition": runs.repetition, "slip": rim, "slip range": (rim + 1) // 2, "angle": runs.angle}
    for name, groups in folds.items():
        misses, held, which = left_out(states, wheel, JOINT, groups)
        straight = runs.angle[which] == 0
        parts = (misses[straight, 1], misses[~straight, 1], misses[:, 2])
        print(name, *(f"{np.sqrt(np.mean(part**2)):.3f}" for part in parts), *(f"{x:.2f}" for x in held.mean(axis=0)))
    for column in ("slip_ratio", "side_slip_deg", "drawbar_pull_n", "lateral_force_n"):
        turned = infer_soil(with_sign_turned(states, column), wheel, model=JOINT.model, contact=True).verdict
        print(f"sign of {column} turned: {'trusted' if turned.trusted else turned.reason}")
    for name, verdict in published_verdicts(data).items():
        print(name, verdict.model, verdict.reduced_chi_square, verdict.model_error, verdict.reason or "trusted")


def main() -> None:
    """Print the tables."""
    if "LUNARSCI_REFERENCE_DATA" not in os.environ:
        sys.exit("the measured wheels are not here; LUNARSCI_REFERENCE_DATA must name the folder that has them")
    data = Path(os.environ["LUNARSCI_REFERENCE_DATA"])
    runs = grouser_runs(data)
    locked = "--locked" in sys.argv
    print(f"{len(runs.sinkage)} runs; rmse [N] of F_N, F_DP without side slip, then of F_N, F_DP, F_L at all angles")
    for name in MODELS:
        straight, every = errors(runs, name, True, locked), errors(runs, name, False, locked)
        print(f"| {name} | " + " | ".join(f"{value:.2f}" for value in (*straight[:2], *every)) + " |")
    joint_tables(data)
    print("points of published curves: rmse of drawbar pull [% of load], of sinkage [mm], points")
    for name, point in published_points(data).items():
        print(f"| {name} | {100 * point.drawbar:.1f} | {1e3 * point.sinkage:.1f} | {point.points} |")


if __name__ == "__main__":
    main()
