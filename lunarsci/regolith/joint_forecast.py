"""A soil that was learned, carried on: as a belief for drives, and to wheel states whose forces are to be told."""

from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from lunarsci.csv_table import numbers_of, read_csv_table
from lunarsci.errors import DataError
from lunarsci.inputs import InputFile
from lunarsci.regolith.belief import SoilBelief
from lunarsci.regolith.joint import SoilPosterior
from lunarsci.regolith.joint_model import FORCES
from lunarsci.regolith.joint_predict import predict_forces
from lunarsci.regolith.prior import PARAMETERS
from lunarsci.regolith.wheel import Wheel

__all__ = ["PredictedStates", "belief_after", "predict_states"]

FloatArray = npt.NDArray[np.float64]
NAMES = ("value", "low90", "high90", "low68", "high68")


@dataclass(frozen=True, slots=True, eq=False)
class PredictedStates:
    """Forces predicted for the states of a file.

    Attributes
    ----------
    ids : n names.
    quantiles : (5, n, 3) in the order of `NAMES`, of F_N, F_DP, F_L. [N]
    sinkage_m : (n,) median. [m]
    load_n : (n,) [N]
    measured : (n, 3) NaN where the file has none. [N]
    """

    ids: tuple[str, ...]
    quantiles: FloatArray
    sinkage_m: FloatArray
    load_n: FloatArray
    measured: FloatArray

    @property
    def records(self) -> list[dict[str, Any]]:
        """One for each state."""
        return [
            {"id": name, "sinkage_m": float(self.sinkage_m[i])}
            | {
                force: dict(zip(NAMES, map(float, self.quantiles[:, i, k]), strict=True))
                for k, force in enumerate(FORCES)
            }
            for i, name in enumerate(self.ids)
        ]

    def compared(self) -> dict[str, dict[str, float] | None]:
        """By force: root mean square of predicted less measured as a share of the load, and the share of 90 % intervals
        that hold what was measured; None where nothing was."""
        found: dict[str, dict[str, float] | None] = {}
        for k, force in enumerate(FORCES):
            known = np.isfinite(self.measured[:, k])
            if not known.any():
                found[force] = None
                continue
            value, low, high = (self.quantiles[row, known, k] for row in range(3))
            seen = self.measured[known, k]
            found[force] = {
                "rms_of_load": float(np.sqrt(np.mean(((value - seen) / self.load_n[known]) ** 2))),
                "held90": float(np.mean((low <= seen) & (seen <= high))),
            }
        return found

    def to_dict(self) -> dict[str, Any]:
        """For the result."""
        return {"states": self.records, "compared": self.compared()}

    def notes(self) -> list[str]:
        """How the prediction compares with what was measured, in words."""
        return [
            f"{force}: rms {found['rms_of_load']:.3f} of the load, 90 % intervals hold {100 * found['held90']:.0f} %"
            for force, found in self.compared().items()
            if found is not None
        ]


def predict_states(posterior: SoilPosterior, wheel: Wheel, source: InputFile, *, seed: int = 0) -> PredictedStates:
    """The forces on a wheel at the states of a CSV.

    Columns: `slip_ratio` and `normal_force_n` (the load) are required; `side_slip_deg` is 0 where it is missing; where
    there is no `sinkage_m` it is found under the load; `drawbar_pull_n` and `lateral_force_n` are compared. Rows whose
    sinkage no wheel above its axle can have are refused. Raises DataError.
    """
    frame = read_csv_table(source)
    for name in ("slip_ratio", "normal_force_n"):
        if name not in frame:
            raise DataError(f"{source.name}: no column '{name}'; forces are predicted for a slip and a load")
    columns = {name: numbers_of(source.name, name, frame[name]) for name in _COLUMNS if name in frame}
    count = len(frame)
    load, slip = columns["normal_force_n"], columns["slip_ratio"]
    side = np.nan_to_num(columns.get("side_slip_deg", np.zeros(count)))
    depth = columns.get("sinkage_m")
    _check(source.name, "normal_force_n", load > 0, "above 0 N")
    _check(source.name, "slip_ratio", np.abs(slip) <= 1, "within -1 to 1")
    _check(source.name, "side_slip_deg", np.abs(side) <= 90, "within -90 to 90 deg")
    if depth is not None:
        _check(source.name, "sinkage_m", (depth > 0) & (depth < wheel.radius_m), "above 0 and below the wheel radius")
    found = predict_forces(posterior, wheel, slip, side, load, depth, seed=seed)
    measured = np.column_stack([columns.get(name, np.full(count, np.nan)) for name in FORCES])
    if depth is None:
        measured[:, 0] = np.nan
    ids = tuple(frame["id"].astype(str)) if "id" in frame else tuple(str(n) for n in range(1, count + 1))
    rows = np.stack([found.value, *found.interval(0.9), *found.interval(0.68)])
    return PredictedStates(ids, rows, np.median(found.sinkage_m, axis=0), load, measured)


_COLUMNS = ("sinkage_m", "slip_ratio", "side_slip_deg", *FORCES)


def _check(file: str, column: str, good: npt.NDArray[np.bool_], rule: str) -> None:
    if not good.all():
        raise DataError(f"{file}, row {int(np.argmin(good)) + 1}, {column}: it must lie {rule}")


def belief_after(posterior: SoilPosterior) -> SoilBelief:
    """What is believed of the soil after its states, with the verdict; of an unknown contact nothing is kept."""
    size = len(PARAMETERS)
    covariance = posterior.covariance[:size, :size]
    return SoilBelief(
        {name: posterior.prior[name] for name in PARAMETERS},
        posterior.mode[:size],
        0.5 * (covariance + covariance.T),
        verdict=posterior.verdict,
    )
