"""Wheel states: what a rover measures or simulates of one wheel at one moment, and how well it is known."""

from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from lunarsci.csv_table import numbers_of, read_csv_table
from lunarsci.errors import DataError, LunarSciWarning, ParameterError
from lunarsci.inputs import InputFile
from lunarsci.regolith.wheel import Wheel

__all__ = ["COLUMNS", "FROM_MOTION", "IDENTIFIERS", "MeasurementErrors", "WheelStates", "marked_valid", "read_states"]

FloatArray = npt.NDArray[np.float64]

REQUIRED = ("sinkage_m", "normal_force_n", "drawbar_pull_n")
COLUMNS = ("sinkage_m", "slip_ratio", "side_slip_deg", "normal_force_n", "drawbar_pull_n", "lateral_force_n")
IDENTIFIERS = (
    *("id", "member", "wheel", "distance_m", "time_s", "x_m", "y_m", "resistance_torque_nm", "valid", "slip_basis"),
    *("x_m_sigma", "y_m_sigma", "resistance_torque_nm_sigma", "synthetic", "forces_from"),
)
FROM_MOTION = "motion"
"""In the column `forces_from`: forces that were computed of a motion with drawn soils, not measured."""
MAX_VALID_SLIP = 0.6
LEAST_SINKAGE_M = 1e-6
YES, NO = ("true", "1", "1.0", "yes"), ("false", "0", "0.0", "no")


@dataclass(frozen=True, slots=True, kw_only=True)
class MeasurementErrors:
    """Standard deviations used where a file gives none; 0 means exact.

    Defaults are the errors of Ding et al. (2024), 10.1038/s41467-024-46233-8, read as three standard deviations: 1 mm
    of sinkage, 10 % of the forces, 4 % of the travelled distance, from which the slip ratio s follows with an error of
    that share of 1 - |s|, and 4 % of the side slip.
    """

    sinkage_m: float = 0.00033
    force_relative: float = 0.10 / 3
    travel_relative: float = 0.04 / 3
    side_slip_relative: float = 0.04 / 3

    def __post_init__(self) -> None:
        for name in self.__slots__:
            if not 0 <= getattr(self, name) < np.inf:
                raise ParameterError(f"error of {name} is {getattr(self, name)}; give 0 or more")

    def of(self, column: str, values: FloatArray) -> FloatArray:
        """Standard deviation of a column, in the column's unit; shape of `values`."""
        if column == "sinkage_m":
            return np.full(values.shape, self.sinkage_m)
        if column == "slip_ratio":
            return (1 - np.abs(values)) * self.travel_relative
        return np.abs(values) * (self.side_slip_relative if column == "side_slip_deg" else self.force_relative)


@dataclass(frozen=True, slots=True, eq=False)
class WheelStates:
    """n wheel states.

    Attributes
    ----------
    id : n names.
    values, sigmas : shape (n, 6), columns in the order of `COLUMNS` [m, -, deg, N, N, N]; NaN in `values` where a
        slip, side slip or lateral force was not measured.
    stated : whether the errors of the forces come from the file, not from `MeasurementErrors`.
    alike : whether they are alike in all states, as those of forces that were computed of a motion with drawn soils.
    """

    id: tuple[str, ...]
    values: FloatArray
    sigmas: FloatArray
    stated: bool = False
    alike: bool = False

    def __len__(self) -> int:
        return len(self.id)


def read_states(source: InputFile, wheel: Wheel, errors: MeasurementErrors | None = None) -> WheelStates:
    """Read wheel states from CSV.

    Lateral forces have the sign of the side slip they act against.

    Columns: `sinkage_m`, `normal_force_n`, `drawbar_pull_n` (required), `slip_ratio`, `side_slip_deg`,
    `lateral_force_n`, and `NAME_sigma` for the standard deviation of NAME; `forces_from` is `motion` where forces were
    computed of a motion. Rows marked `valid = false` and rows without
    a required value are left out with a warning.

    Raises
    ------
    DataError for a missing or misspelt column, text among numbers, a value no wheel can have, or nothing to use.
    """
    import pandas as pd

    frame = read_csv_table(source)
    _check_columns(source.name, list(frame.columns))
    used = [name for name in frame.columns if name in COLUMNS or name.removesuffix("_sigma") in COLUMNS]
    numbers = {name: numbers_of(source.name, name, frame[name]) for name in used}
    keep = _kept_rows(source.name, frame.get("valid"), numbers)
    numbered = pd.Series([str(n) for n in range(1, len(frame) + 1)])
    ids = frame["id"].fillna(numbered) if "id" in frame else numbered
    values = np.column_stack([numbers.get(name, np.full(len(frame), np.nan)) for name in COLUMNS])
    _check_values(source.name, values[keep], np.flatnonzero(keep), wheel)
    sigmas = _sigmas(source.name, numbers, values, errors or MeasurementErrors())
    stated = any(f"{name}_sigma" in numbers for name in COLUMNS[3:])
    alike = "forces_from" in frame and bool((frame["forces_from"][keep] == FROM_MOTION).all())
    return WheelStates(tuple(ids[keep].astype(str)), values[keep], sigmas[keep], stated, alike)


def _check_columns(name: str, columns: list[str]) -> None:
    import difflib
    import warnings

    missing = [column for column in REQUIRED if column not in columns]
    known = [*COLUMNS, *(f"{column}_sigma" for column in COLUMNS), *IDENTIFIERS]
    unused = [column for column in columns if column not in known]
    if missing:
        guess = difflib.get_close_matches(missing[0], unused, n=1)
        hint = f"; is it '{guess[0]}'? rename it" if guess else f"; there are: {', '.join(columns)}"
        raise DataError(f"{name}: no column '{missing[0]}'{hint}")
    misspelt = [(column, difflib.get_close_matches(column, known, n=1, cutoff=0.85)) for column in unused]
    for column, guess in misspelt:
        if guess:
            raise DataError(f"{name}: column '{column}' is unknown; if it is '{guess[0]}', rename it")
    if unused:
        warnings.warn(f"{name}: columns not used: {', '.join(unused)}", LunarSciWarning, stacklevel=3)


def _kept_rows(name: str, valid: "object", numbers: dict[str, FloatArray]) -> npt.NDArray[np.bool_]:
    import warnings

    import pandas as pd

    complete = np.all([np.isfinite(numbers[column]) for column in REQUIRED], axis=0)
    marked = np.ones(complete.shape, bool) if valid is None else marked_valid(name, pd.Series(valid))
    keep: npt.NDArray[np.bool_] = complete & np.asarray(marked)
    if not keep.any():
        raise DataError(f"{name}: no row has all of {', '.join(REQUIRED)}; fill them in")
    if not keep.all():
        warnings.warn(
            f"{name}: {(~keep).sum()} of {keep.size} rows left out (a required value missing, or marked not valid)",
            LunarSciWarning,
            stacklevel=3,
        )
    return keep


def marked_valid(name: str, cells: Any) -> npt.NDArray[np.bool_]:
    """Which cells of a column `valid`, as text, say yes; blank is no. Raises DataError for other words."""
    words = cells.fillna("").str.strip().str.lower()
    unknown = ~words.isin([*YES, *NO])
    if unknown.any():
        row = int(np.argmax(unknown))
        raise DataError(f"{name}, row {row + 1}, valid: '{cells.iloc[row]}' is neither true nor false")
    return np.asarray(words.isin(YES), dtype=bool)


def _check_values(name: str, values: FloatArray, rows: npt.NDArray[np.intp], wheel: Wheel) -> None:
    import warnings

    z, s, beta, load = values[:, 0], values[:, 1], values[:, 2], values[:, 3]
    for column, bad, rule in (
        (
            "sinkage_m",
            ~((z >= LEAST_SINKAGE_M) & (z < wheel.radius_m)),
            f"above 1e-6 and below the wheel radius of {wheel.radius_m:g} m",
        ),
        ("slip_ratio", np.abs(s) > 1, "within -1 to 1"),
        ("side_slip_deg", np.abs(beta) > 90, "within -90 to 90 deg"),
        ("normal_force_n", ~(load > 0), "above 0 N"),
    ):
        if bad.any():
            first = int(np.argmax(bad))
            value = values[first, COLUMNS.index(column)]
            raise DataError(f"{name}, row {rows[first] + 1}, {column}: {value:g} is impossible; it must lie {rule}")
    fast = int((np.abs(s) > MAX_VALID_SLIP).sum())
    if fast:
        warnings.warn(
            f"{name}: |slip_ratio| above {MAX_VALID_SLIP} in {fast} rows, where the model is no longer accurate",
            LunarSciWarning,
            stacklevel=3,
        )


def _sigmas(name: str, numbers: dict[str, FloatArray], values: FloatArray, errors: MeasurementErrors) -> FloatArray:
    columns = []
    for k, column in enumerate(COLUMNS):
        default = errors.of(column, values[:, k])
        given = numbers.get(f"{column}_sigma", default)
        wrong = (given < 0) | np.isinf(given)
        if wrong.any():
            raise DataError(
                f"{name}, row {int(np.argmax(wrong)) + 1}, {column}_sigma: give 0 or more, or leave it blank"
            )
        columns.append(np.where(np.isfinite(given), given, default))
    sigmas: FloatArray = np.nan_to_num(np.column_stack(columns))
    return sigmas
