"""Whether a table of measured states or positions can be one drive: members, repeated rows, misspelt columns, signs."""

import difflib
import warnings
from typing import TYPE_CHECKING

import numpy as np

from lunarsci.errors import DataError, LunarSciWarning

if TYPE_CHECKING:
    import pandas as pd

__all__ = ["check_columns", "check_sinkage", "one_member", "without_repeats"]

ALIKE = 0.72
"""Likeness of two names (difflib's ratio) from which one is taken for a slip of the pen of the other; assumed."""


def check_columns(file: str, table: "pd.DataFrame", known: tuple[str, ...]) -> None:
    """Refuse a column that is nearly a known one, such as `sinkage_mm`: it would be left out without a word."""
    for name in table.columns:
        near = difflib.get_close_matches(str(name).lower(), known, n=1, cutoff=ALIKE)
        if name in known or str(name).removesuffix("_sigma") in known or not near or near[0] in table:
            continue
        raise DataError(f"{file}: column '{name}' is unknown; if it is '{near[0]}', rename it and mind the unit")


def one_member(file: str, table: "pd.DataFrame") -> None:
    """Refuse a table of several drives, as `twin predict` writes."""
    if "member" in table and table["member"].nunique() > 1:
        raise DataError(f"{file}: {table['member'].nunique()} drives (column member); keep the rows of one")


def without_repeats(file: str, table: "pd.DataFrame", keys: list[str]) -> "pd.DataFrame":
    """Rows that are there twice count once, with a warning; DataError where rows of one key contradict each other."""
    kept = table.drop_duplicates()
    if len(kept) < len(table):
        text = f"{file}: {len(table) - len(kept)} of {len(table)} rows are there twice; each counts once"
        warnings.warn(text, LunarSciWarning, stacklevel=3)
    again = kept.duplicated(keys)
    if again.any():
        row = kept[again].iloc[0]
        said = ", ".join(f"{key} {row[key]}" for key in keys)
        raise DataError(f"{file}: two rows of {said} contradict each other; keep the right one")
    return kept.reset_index(drop=True)


def check_sinkage(file: str, sinkage_m: np.ndarray, radius_m: float) -> None:
    """Refuse sinkages that are mostly negative, or deeper than the wheel: a wrong sign or unit."""
    known = sinkage_m[np.isfinite(sinkage_m)]
    if known.size and not 0 < np.median(known) < radius_m:
        raise DataError(
            f"{file}: sinkage_m has a median of {np.median(known):.3g}; it is in metres, down is positive, and the "
            f"wheel's radius is {radius_m:g} m"
        )
