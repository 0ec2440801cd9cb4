"""How far off are spot turns, by other physics? `python tests/benchmarks/spot_turns.py [--soils N] [--first K]`

Soils drawn from the first laws, on the SYNTHETIC ground of `errands.py` with the seed of the training grounds of
`loop.py`: the rover turns on the spot by the twin and by `quasi_static.py`, with choices of its own for each soil. Each
line is a soil: by which share of the angle the other rover turned farther, and that over what the twin says a turn is
exposed to (`lunarsci.twin.simulation.discrepancy`), whose law was set by these.
"""

import argparse
import warnings

import numpy as np
import quasi_static
from errands import Errand, errand

from lunarsci.regolith.belief import first_belief
from lunarsci.twin.plans.plan import Leg, Plan
from lunarsci.twin.simulation.discrepancy import TURNS, exposed_turns
from lunarsci.twin.simulation.ensemble import predict

TURNS_DEG = (30.0, 90.0, -120.0, 180.0)
SEED, SOILS_FROM = 1701, 9_100_000


def shares(one: Errand, number: int, turn_deg: float) -> tuple[float, float]:
    """How much farther the other rover turns, as a share of the angle, and of what that is exposed to. [-]

    NaN where one of them does not finish.
    """
    x, y, heading = one.start
    plan = Plan(name="turn", legs=(Leg(turn_deg=turn_deg),), speed_m_s=0.05, x_m=x, y_m=y, heading_deg=heading)
    soil = {name: float(values[0]) for name, values in first_belief().draws(1, SOILS_FROM + number).items()}
    twin = predict(one.rover, one.surface.terrain, plan, samples={name: [value] for name, value in soil.items()})
    physics = quasi_static.draw_physics(SOILS_FROM + number)
    other = quasi_static.drive(one.rover, one.surface.terrain, plan, soil, physics)
    if not (twin.finished.all() and other.finished):
        return np.nan, np.nan
    own, his = (np.unwrap(yaw, period=360.0) for yaw in (twin.paths[0, :, 5], other.poses[:, 5]))
    share = float((his[-1] - his[0]) - (own[-1] - own[0])) / turn_deg
    return share, share / float(exposed_turns(twin.planned, twin.paths[0, :, 5]))


def main() -> None:
    """Print them, and their sizes beside the law."""
    parser = argparse.ArgumentParser(description="How far off are spot turns, by other physics?")
    parser.add_argument("--soils", type=int, default=20)
    parser.add_argument("--first", type=int, default=0)
    given = parser.parse_args()
    warnings.simplefilter("ignore")
    found = []
    for number in range(given.first, given.first + given.soils):
        one = errand(number, SEED)
        found.append([shares(one, number, turn) for turn in TURNS_DEG])
        print(number, " ".join(f"{turn:+.0f}°: {a:+.3f} ({b:+.2f})" for turn, (a, b) in
                               zip(TURNS_DEG, found[-1], strict=True)), flush=True)  # fmt: skip
    rows = np.array(found)
    off, exposed = rows[..., 0], np.nanmean(rows[..., 1], axis=1)
    spread = np.nanstd(off, axis=1) / np.abs(np.nanmean(off, axis=1))
    print(f"share of the angle: median {np.nanmedian(np.abs(off)):.3f}, root mean square "
          f"{np.sqrt(np.nanmean(off**2)):.3f}; alike within {np.nanmedian(spread):.0%} on the same soil")  # fmt: skip
    print(f"of what it is exposed to: median {np.nanmedian(np.abs(exposed)):.2f} (law {TURNS.half_width(0.5):.2f}), "
          f"root mean square {np.sqrt(np.nanmean(exposed**2)):.2f} (law {np.sqrt(TURNS.variance):.2f})")  # fmt: skip


if __name__ == "__main__":
    main()
