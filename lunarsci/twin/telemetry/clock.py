"""The clock of telemetry: rows in their order, each time once, and gaps between them."""

import dataclasses

import numpy as np
import numpy.typing as npt

from lunarsci.errors import DataError
from lunarsci.twin.telemetry.findings import Findings
from lunarsci.twin.telemetry.reading import Telemetry

__all__ = ["ordered", "taken", "time_gaps"]

BoolArray = npt.NDArray[np.bool_]
GAP = 5.0
"""Times the median step between rows from which on a step is a gap; assumed, as of a motion."""
LEAST_ROWS = 5


def taken(telemetry: Telemetry, rows: npt.NDArray[np.intp] | BoolArray) -> Telemetry:
    """Some rows of telemetry, as a mask or by number."""
    arrays = {
        field.name: getattr(telemetry, field.name)[rows]
        for field in dataclasses.fields(telemetry)
        if isinstance(getattr(telemetry, field.name), np.ndarray)
    }
    return dataclasses.replace(telemetry, **arrays)


def ordered(telemetry: Telemetry, findings: Findings) -> Telemetry:
    """Rows that have a time, each time once, ascending.

    Rows without a time, and rows that repeat one to the last digit, are left out and said. Raises DataError where one
    time has two contents, where time runs backwards, and where fewer than five rows are left.
    """
    timed = np.isfinite(telemetry.time_s)
    if not timed.all():
        lost = int((~timed).sum())
        findings.add("no time", f"{lost} rows without a time_s", "left out", count=lost)
        telemetry = taken(telemetry, timed)
    telemetry = _without_repeats(telemetry, findings)
    steps = np.diff(telemetry.time_s)
    if (back := np.flatnonzero(steps <= 0)).size:
        row = int(back[0])
        raise DataError(
            f"{telemetry.file}: time runs backwards {back.size} times, first from {telemetry.time_s[row]:.6g} to "
            f"{telemetry.time_s[row + 1]:.6g} s: the clock was reset, or rows are out of order; split the file there, "
            "or sort it if the times are right"
        )
    if len(telemetry.time_s) < LEAST_ROWS:
        raise DataError(f"{telemetry.file}: {len(telemetry.time_s)} rows with a time; give {LEAST_ROWS} or more")
    if telemetry.time_s[0] < 0:
        raise DataError(
            f"{telemetry.file}: time_s begins at {telemetry.time_s[0]:.6g}; it counts from the start of the plan, so "
            "leave out what was before"
        )
    return telemetry


def _without_repeats(telemetry: Telemetry, findings: Findings) -> Telemetry:
    content = np.column_stack(
        [
            getattr(telemetry, field.name).reshape(len(telemetry.time_s), -1)
            for field in dataclasses.fields(telemetry)
            if isinstance(getattr(telemetry, field.name), np.ndarray)
        ]
    )
    order = np.argsort(telemetry.time_s, kind="stable")
    later = order[1:][np.diff(telemetry.time_s[order]) == 0]
    earlier = order[:-1][np.diff(telemetry.time_s[order]) == 0]
    if not later.size:
        return telemetry
    alike = np.all((content[later] == content[earlier]) | (np.isnan(content[later]) & np.isnan(content[earlier])), 1)
    differ = ~alike & (later == earlier + 1)
    if differ.any():
        row = int(later[np.argmax(differ)])
        raise DataError(
            f"{telemetry.file}, row {row + 1}: time_s {telemetry.time_s[row]:.6g} has two rows that differ; keep the "
            "right one"
        )
    later = later[alike]
    if not later.size:
        return telemetry
    first = float(telemetry.time_s[later[0]])
    findings.add("repeated rows", f"{later.size} rows repeat another one", "left out", count=later.size, time_s=first)
    kept = np.ones(len(telemetry.time_s), dtype=bool)
    kept[later] = False
    return taken(telemetry, kept)


def time_gaps(telemetry: Telemetry, findings: Findings) -> BoolArray:
    """Steps between rows that are gaps: longer than `GAP` times the median. (n - 1,)"""
    steps = np.diff(telemetry.time_s)
    usual = float(np.median(steps))
    gaps = np.asarray(steps > GAP * usual)
    if gaps.any():
        first = int(np.argmax(gaps))
        findings.add(
            "gap",
            f"nothing was sent for {steps[gaps].sum():.4g} s in all, {usual:.3g} s between rows being usual",
            "there are no states within gaps",
            count=int(gaps.sum()),
            time_s=float(telemetry.time_s[first]),
        )
    return gaps
