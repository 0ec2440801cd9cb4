"""How far slips of `twin states` move with constants of telemetry: `python tests/benchmarks/telemetry_constants.py`.

Each constant of `TRIED` is made so many times as large, or a grid so many times as fine, in some drives of
`faulty_drives.py`; printed is the farthest that a slip or side slip moves, in its standard errors.
"""

import warnings
from functools import cache

import numpy as np
from faulty_drives import KINDS, SPOILS, telemetry_of, terrain_of, truth_of

from lunarsci.arrays import FloatArray
from lunarsci.io.inputs import InputFile
from lunarsci.twin.plans.plan import Plan
from lunarsci.twin.rover import build_rover
from lunarsci.twin.telemetry import filter as motion_filter
from lunarsci.twin.telemetry import hypotheses, nodes, reading, smoother, states, wheel_motion

DRIVES = ((1, "healthy"), (6, "walking"), (5, "lag"), (0, "gaps"), (2, "gaps"), (1, "coarse"))
MODULES = (reading, hypotheses, wheel_motion, motion_filter, smoother, nodes, states)
HALVES = (
    "POSITION_M_PER_STEP", "TURN_PER_STEP", "AGREEMENT", "LEAST_EFFECT", "BLOCK_M", "LOOSE_M", "BEND_M", "LINEAR_S",
    "WIDTH", "SHARES", "LEAST_LOAD", "STILL", "UNDER_WAY", "SIGMA_DEG", "RATE_SHARE", "OBEYED", "SAME_S",
)  # fmt: skip
TRIED: dict[str, tuple[float, ...]] = dict.fromkeys(HALVES, (0.5, 2.0))
TRIED |= {"START_M": (10.0,), "START_RAD": (10.0,), "STIFFNESSES": (2.0,), "AMPLITUDES": (2.0,), "LENGTHS_M": (2.0,)}


def finer(grid: tuple[float, ...], times: float) -> tuple[float, ...]:
    """Points of a grid and others between, at even ratios."""
    steps = np.arange(0.0, len(grid) - 1 + 1e-9, 1.0 / times)
    return tuple(np.exp(np.interp(steps, np.arange(len(grid)), np.log(grid))))


@cache
def sent(number: int, kind: str) -> tuple[InputFile, Plan]:
    """Telemetry of a drive, and its plan."""
    rover, spoil = build_rover("yutu2"), SPOILS.get(kind)
    random = np.random.default_rng(
        [number, KINDS.index(kind), 5] if spoil is None else [number, [*SPOILS].index(kind), 9]
    )
    sound = kind if spoil is None else "healthy"
    table, _, plan, _ = telemetry_of(truth_of(number, sound, rover, None), sound, rover, random)
    table = table if spoil is None else spoil(table, rover, random)
    return InputFile("drive.csv", table.to_csv(index=False).encode()), plan


def slips(number: int, kind: str) -> tuple[FloatArray, FloatArray]:
    """Slips and side slips of the valid states of a drive, and their errors."""
    (file, plan), rover, findings = sent(number, kind), build_rover("yutu2"), reading.Findings("drive.csv")
    telemetry = reading.read_telemetry(file, rover, findings)
    rows = states.states_of(telemetry, rover, terrain_of(number), findings, plan).rows
    pairs = ((rows.slip_ratio, rows.slip_ratio_sigma), (rows.side_slip_deg, rows.side_slip_deg_sigma))
    values, sigmas = (
        np.concatenate(part) for part in zip(*((v[rows.valid], s[rows.valid]) for v, s in pairs), strict=True)
    )
    return values, sigmas


def main() -> None:
    """Try, and print."""
    warnings.simplefilter("ignore")
    plain = [slips(*one) for one in DRIVES]
    for name, factors in TRIED.items():
        for factor in factors:
            held = [(module, getattr(module, name)) for module in MODULES if hasattr(module, name)]
            for module, before in held:
                setattr(module, name, finer(before, factor) if isinstance(before, tuple) else factor * before)
            moved = 0.0
            for one, (value, sigma) in zip(DRIVES, plain, strict=True):
                moved = max(moved, float(np.abs((slips(*one)[0] - value) / sigma).max()))
            for module, before in held:
                setattr(module, name, before)
            print(f"{name} x {factor:g}: {moved:.3f} of an error")


if __name__ == "__main__":
    main()
