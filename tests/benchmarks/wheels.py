"""Measured single wheels against the models: `python tests/benchmarks/wheels.py`.

Pavlov & Johnson's grouser wheel (CMU, 189 runs in skid and slip at slip angles of 0-90 deg). Soil and contact angles
are fitted to one trial of three, the other two predicted at their measured sinkage. Left out are runs deeper than the
wheel's radius, most of those at 90 deg; of the printed reading, whose stress grows beyond bounds, also locked wheels.
Needs the reference data, found through LUNARSCI_REFERENCE_DATA.
"""

import math
import os
from dataclasses import dataclass
from functools import cache
from pathlib import Path

import numpy as np
import pandas as pd
from scipy.optimize import least_squares

from lunarsci.errors import ParameterError
from lunarsci.regolith.contact import ContactModel
from lunarsci.regolith.integrals import moving_contact_forces
from lunarsci.regolith.soil import Soil
from lunarsci.regolith.wheel import Wheel

__all__ = ["MODELS", "Runs", "errors", "grouser_runs"]

RADIUS_M, WIDTH_M, GROUSER_M = 0.058, 0.05, 0.005
EARTH = {"density_kg_m3": 1330.0, "gravity_m_s2": 9.81}
"""Density as its authors give it."""
MODELS = {
    "signed, separate": ContactModel(**EARTH),
    "signed, combined": ContactModel(shear="combined", **EARTH),
    "combined, bulldozing by Hegedus": ContactModel(shear="combined", bulldozing="hegedus", **EARTH),
    "combined, bulldozing by Wong": ContactModel(shear="combined", bulldozing="wong", **EARTH),
    "printed": ContactModel(reading="printed", **EARTH),
}
DEEPEST = 0.95
START = np.array([math.log(1e3), 1.0, 0.2, 0.2, math.log(800), 31.0, math.log(12), 31.0, math.log(12), 0.4, 0.15, -0.1])
WIDTH = np.array([1.5, 0.4, 0.3, 0.4, 1.0, 6.0, 0.7, 8.0, 0.7, 0.1, 0.15, 0.15])
"""ln K_s, n0, n1, n2, ln c, phi, ln K_x, phi_y, ln K_y, c1, c2, c3: start and width of the fit; assumed."""
SCALE_N = np.array([2.0, 0.7, 0.7])
"""Weights of F_N, F_DP and F_L; about their scatter between trials."""


@dataclass(frozen=True, slots=True, eq=False)
class Runs:
    """Sinkage [m], velocities [m/s], forces F_N, F_DP, F_L [N], slip angle [deg] and trial of each run."""

    sinkage: np.ndarray
    velocity: np.ndarray
    forces: np.ndarray
    angle: np.ndarray
    trial: np.ndarray

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
    runs = Runs(
        -rows["avg_Z"].to_numpy() * 1e-3, velocity, forces, rows["beta"].to_numpy(), rows["trial_num"].to_numpy()
    )
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
        found = moving_contact_forces(wheel, soil, runs.sinkage, runs.velocity, own)
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
def errors(runs: Runs, name: str, straight: bool) -> tuple[float, float, float]:
    """Root mean square of predicted less measured F_N, F_DP, F_L of trials 2 and 3 after a fit to trial 1. [N]

    `straight` takes runs without side slip only, for fit and prediction.
    """
    chosen = runs.part(runs.angle == 0) if straight else runs
    model = MODELS[name]
    if name == "printed":
        chosen = chosen.part(chosen.velocity[:, 2] > 0)
    point = fitted(chosen.part(chosen.trial == 1), model)
    rest = chosen.part(chosen.trial != 1)
    return tuple(map(float, np.sqrt(np.mean((predicted(point, rest, model) - rest.forces) ** 2, axis=0))))  # type: ignore[return-value]


def main() -> None:
    """Print the table."""
    runs = grouser_runs(Path(os.environ["LUNARSCI_REFERENCE_DATA"]))
    print(f"{len(runs.sinkage)} runs; rmse [N] of F_N, F_DP without side slip, then of F_N, F_DP, F_L at all angles")
    for name in MODELS:
        straight, every = errors(runs, name, True), errors(runs, name, False)
        print(f"| {name} | " + " | ".join(f"{value:.2f}" for value in (*straight[:2], *every)) + " |")


if __name__ == "__main__":
    main()
