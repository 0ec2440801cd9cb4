"""The published trends of a drive beside ours on three terrains: `python tests/benchmarks/trends.py`.

Ding et al. (2024), 10.1038/s41467-024-46233-8, drove the plan for soils of phi 25-55 deg and K_y 15-45 mm over the
elevation model of Longji: the median slip ratio went from -0.035 to -0.002 as phi grew, the side slip from 0.742 to
1.635 deg as K_y grew, all ends lay within 0.762 m of the destination; the rover itself arrived 0.367 m off it.

None of our terrains is theirs, so that only signs and orders of magnitude can agree:

* The elevation model is not public. Slip follows the slope along the path and side slip the slope across it, node by
  node; `longji` is a stand-in with the published craters and steepest slopes, and no more.
* The law of the shear. Ours is the reading `signed`. On the level a soil of phi = 25 deg needs a slip of +0.10 to roll,
  one of 55 deg rolls by itself at -0.01; 5.4 deg downhill these are +0.01 and -0.03. So slip falls as phi grows, and
  rises only on slopes above some 10 deg down, where weak soil skids more: the published rise needs steeper ground, or
  another reading. As printed, Eq 12 jumps by 6 to 24 N at s = 0 and cannot be driven with.
* Dimensions of the rover are partly assumed, above all its centre of mass and the offset of its steering axes.

The second table is the slip at which a wheel under the rover's mean load has the drawbar pull that a slope asks for, by
the three readings of the shear, without any terrain between them. `slip-branch` is even in s: both signs balance, and
none does where the wheel pulls even at s = 0.
"""

import dataclasses
import math

import numpy as np
from scipy.optimize import brentq

from lunarsci.errors import ParameterError
from lunarsci.regolith.forces import closed_form_forces
from lunarsci.regolith.soil import read_soil
from lunarsci.regolith.wheel import SHEAR_SIGNS
from lunarsci.twin.ground.synthetic import synthetic_longji
from lunarsci.twin.ground.terrain import Terrain, build_terrain
from lunarsci.twin.plans.plan import read_plan
from lunarsci.twin.rover import build_rover
from lunarsci.twin.simulation.ensemble import Prediction, predict

ROVER, PLAN, SOIL = build_rover("yutu2"), read_plan(), read_soil("longji")
PHI_DEG, K_Y_MM = (25.0, 40.0, 55.0), (15.0, 30.0, 45.0)


def plane(along_deg: float, across_deg: float) -> Terrain:
    """A plane that falls along x and rises to the left."""
    x, y = np.arange(-4.0, 14.01, 0.5), np.arange(-8.0, 8.01, 0.5)
    height = -math.tan(math.radians(along_deg)) * x[None, :] + math.tan(math.radians(across_deg)) * y[:, None]
    return build_terrain("plane", -4.0, -8.0, 0.5, height, SOIL, synthetic=True)


TERRAINS = {"5.4 deg down": plane(5.38, 0.0), "2 deg across": plane(0.0, 2.0), "longji": synthetic_longji()}


def row(name: str, result: Prediction) -> str:
    """Medians over samples, wheels and the other parameter, at both ends of each range; misses of the ends."""
    phi, k_y = result.parameters["friction_angle_deg"], result.parameters["lateral_modulus_mm"]
    slip, side = result.states[..., 3], np.abs(result.states[..., 4])
    slips = [float(np.median(slip[phi == value])) for value in (PHI_DEG[0], PHI_DEG[-1])]
    sides = [float(np.median(side[k_y == value])) for value in (K_Y_MM[0], K_Y_MM[-1])]
    spread = result.endpoints_m - result.endpoints_m.mean(axis=0)
    return (
        f"{name:<14} {slips[0]:+.3f} -> {slips[1]:+.3f}   {sides[0]:.2f} -> {sides[1]:.2f} deg   "
        f"{np.median(result.miss_m):.3f} m   {result.miss_m.max():.3f} m   {np.hypot(*spread.T).max():.3f} m"
    )


def rolling_slip(reading: str, phi_deg: float, slope_deg: float) -> float | None:
    """Slip ratio nearest zero at which six equal wheels balance the weight on a slope, downhill positive."""
    soil, weight = SOIL.replace(friction_angle_deg=phi_deg), ROVER.mass_kg * ROVER.gravity_m_s2 / len(ROVER.wheels)
    load, pull = (weight * part(math.radians(slope_deg)) for part in (math.cos, math.sin))

    def surplus(slip: float) -> float:
        def overload(sinkage: float) -> float:
            return float(closed_form_forces(ROVER.wheel, soil, sinkage, slip, reading=reading).normal_force_n) - load  # type: ignore[arg-type]

        sinkage = float(brentq(overload, 1e-4, 0.05))
        return float(closed_form_forces(ROVER.wheel, soil, sinkage, slip, reading=reading).drawbar_pull_n) + pull  # type: ignore[arg-type]

    slips = np.linspace(-0.4, 0.4, 161) + 1e-5
    values = np.array([surplus(slip) for slip in slips])
    # A change of sign that is a jump, not a root, leaves more than 1 N on either side.
    roots = [
        float(brentq(surplus, slips[k], slips[k + 1]))
        for k in np.flatnonzero(np.sign(values[:-1]) != np.sign(values[1:]))
        if abs(values[k + 1] - values[k]) < 2.0
    ]
    return min(roots, key=abs) if roots else None


def main() -> None:
    """Print both tables."""
    print("                   slip for phi 25 -> 55   side slip for K_y 15 -> 45   miss: median   largest   spread")
    print("Ding et al.    -0.035 -> -0.002   0.74 -> 1.64 deg   0.367 m (measured)   0.762 m")
    for name, terrain in TERRAINS.items():
        sweep = tuple(
            dataclasses.replace(entry, count=len(PHI_DEG if entry.name == "friction_angle_deg" else K_Y_MM))
            for entry in PLAN.sweep
        )
        print(row(name, predict(ROVER, terrain, PLAN, sweep=sweep)))
    print("\nslip that balances the weight, six equal wheels, phi 25 -> 55 deg")
    for slope in (0.0, 2.0, 4.0, 5.38, 8.86, 12.0):
        for reading in SHEAR_SIGNS:
            try:
                ends = [rolling_slip(reading, phi, slope) for phi in (PHI_DEG[0], PHI_DEG[-1])]
            except (ParameterError, ValueError) as error:
                print(f"{slope:5.2f} deg down   {reading:<12} {error}")
                continue
            told = " -> ".join("none" if slip is None else f"{slip:+.3f}" for slip in ends)
            print(f"{slope:5.2f} deg down   {reading:<12} {told}")


if __name__ == "__main__":
    main()
