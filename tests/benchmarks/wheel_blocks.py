"""A measured wheel in blocks, each predicted from the others: `python tests/benchmarks/wheel_blocks.py [--law auto]`.

Pavlov & Johnson's grouser wheel (see `wheels.py`): its slips, its slip angles, and blocks of both are left out in turn.
Drawbar pull and lateral force are predicted at the measured sinkage, and at the measured load alone, by the joint
inference of soil and contact. Beside it stand two baselines on the same columns, taught by the same runs: the nearest
run, in slip, angle and sinkage or load as shares of their scatter, and a random forest. `--straight` teaches with runs
without side slip alone, and predicts those with.

Points read off published curves (Ding 2011, Wang & Han 2016, Hurrell 2025) come beside it: each slip of one wheel is
left out in turn.

The table has root mean squares as shares of the load, and shares of forces that 90 % intervals hold, with twice their
standard error over blocks. Needs the reference data, found through LUNARSCI_REFERENCE_DATA, and scikit-learn.
"""

import argparse
import os
import sys
import warnings
from collections.abc import Callable
from pathlib import Path

import numpy as np
from sklearn.ensemble import RandomForestRegressor
from wheels import EARTH, JOINT, RIMS, grouser_runs, part_of, published_curves, states_of

from lunarsci.regolith.inference.posterior import infer_soil
from lunarsci.regolith.inference.prediction import candidates, compare_laws, predict_forces
from lunarsci.regolith.states import WheelStates
from lunarsci.regolith.wheel import Wheel, read_wheel

KNOWN = {"sinkage": 0, "load": 3}
"""What is known of a run beside its slip and angle, and its column of the states."""
TREES, SEED = 500, 0
Baseline = Callable[[np.ndarray, np.ndarray, np.ndarray], np.ndarray]


def nearest(taught: np.ndarray, forces: np.ndarray, asked: np.ndarray) -> np.ndarray:
    """Forces of the nearest run."""
    scale = taught.std(axis=0) + 1e-9
    apart = (((asked[:, None] - taught) / scale) ** 2).sum(axis=2)
    return np.asarray(forces[apart.argmin(axis=1)])


def forest(taught: np.ndarray, forces: np.ndarray, asked: np.ndarray) -> np.ndarray:
    """Forces by a random forest."""
    model = RandomForestRegressor(TREES, random_state=SEED, n_jobs=1).fit(taught, forces)
    return np.asarray(model.predict(asked))


BASELINES: dict[str, Baseline] = {"nearest run": nearest, "random forest": forest}


def by_infer(
    states: WheelStates, out: np.ndarray, wheel: Wheel, known: str, *, auto: bool
) -> tuple[np.ndarray, np.ndarray]:
    """Predicted forces as shares of the load, and whether 90 % intervals hold them, of the runs that are left out."""
    taught = part_of(states, ~out)
    law = compare_laws(taught, wheel, candidates(taught, *EARTH.values()))[0] if auto else JOINT
    found = infer_soil(taught, wheel, model=law.model, contact=law.contact)
    depth, slip, side, load = np.nan_to_num(states.values[out, :4]).T
    told = predict_forces(found, wheel, slip, side, load, depth if known == "sinkage" else None)
    unknown = np.isnan(states.values[out, 4:])
    value = np.where(unknown, 0.0, told.value[:, 1:] / load[:, None])
    return value, told.holds(states.values[out, 3:])[:, 1:] | unknown


def table(states: WheelStates, blocks: np.ndarray, asked: np.ndarray, wheel: Wheel, *, auto: bool) -> None:
    """Print one line for each way of predicting the blocks, of the runs that are `asked`."""
    load = states.values[:, 3]
    shares = np.nan_to_num(states.values[:, 4:] / load[:, None])
    for known, column in KNOWN.items():
        columns = np.nan_to_num(states.values[:, [1, 2, column]])
        lines: dict[str, list[tuple[np.ndarray, np.ndarray | None]]] = {"infer": [], **{name: [] for name in BASELINES}}
        for block in np.unique(blocks[asked]):
            out = asked & (blocks == block)
            hidden = blocks == block
            value, held = by_infer(states, hidden, wheel, known, auto=auto)
            lines["infer"].append((value[out[hidden]] - shares[out], held[out[hidden]]))
            for name, baseline in BASELINES.items():
                told = baseline(columns[~hidden], shares[~hidden], columns[out])
                lines[name].append((told - shares[out], None))
        for name, parts in lines.items():
            off = np.sqrt(np.mean(np.concatenate([part for part, _ in parts]) ** 2, axis=0))
            text = f"  given {known:8s} {name:14s} pull {off[0]:.3f}  lateral {off[1]:.3f}"
            if parts[0][1] is not None:
                each = [np.asarray(held, dtype=float) for _, held in parts]
                mean = np.concatenate(each).mean(axis=0)
                sums = np.array([(part - mean).sum(axis=0) for part in each])
                error = 2.0 * np.sqrt((sums**2).sum(axis=0)) / sum(map(len, each))
                text += "  90 % hold " + ", ".join(f"{a:.2f}±{b:.2f}" for a, b in zip(mean, error, strict=True))
            print(text, flush=True)


def published(data: Path) -> None:
    """Print the same of points of published curves, by source and grouser height: the pull at slips left out."""
    for name, (wheel, states) in published_curves(data).items():
        blocks = np.unique(states.values[:, 1], return_inverse=True)[1]
        print(f"{name}: {len(states)} points")
        table(states, blocks, np.ones(len(states), dtype=bool), wheel, auto=True)


def main() -> None:
    """Print the tables."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--law", choices=("joint", "auto"), default="joint", help="the law, or the one that fits best")
    parser.add_argument("--straight", action="store_true", help="teach with straight runs alone")
    given = parser.parse_args()
    if "LUNARSCI_REFERENCE_DATA" not in os.environ:
        sys.exit("the measured wheel is not here; LUNARSCI_REFERENCE_DATA must name the folder that has it")
    warnings.simplefilter("ignore")
    data = Path(os.environ["LUNARSCI_REFERENCE_DATA"])
    runs = grouser_runs(data)
    states, wheel = states_of(runs), read_wheel("cmu-grouser")
    rim = np.digitize(1e3 * runs.velocity[:, 2], RIMS)
    angle = np.unique(runs.angle, return_inverse=True)[1]
    every = np.ones(len(rim), dtype=bool)
    kinds = {"slips": (rim, every), "angles": (angle, every), "blocks of both": (10 * (rim // 3) + angle // 2, every)}
    if given.straight:
        kinds = {"straight runs teach": ((runs.angle != 0).astype(int), runs.angle != 0)}
    for name, (blocks, asked) in kinds.items():
        print(f"{name}: {len(np.unique(blocks))} blocks, {int(asked.sum())} runs")
        table(states, blocks, asked, wheel, auto=given.law == "auto")
    if not given.straight:
        published(data)


if __name__ == "__main__":
    main()
