"""Rows of telemetry that tell nothing new: readings that repeat to the last digit, and rovers that stand for long.

A sound sensor repeats by chance, which its noise and its last digit tell, and where
nothing changes; a run of repeats is held where that is much less probable.

A week at 10 Hz is 6 million rows, of which a rover drives through some ten thousand. Rows are taken in blocks. A block
rests where no wheel is told to turn, reads a rate or gets any further, and time goes on evenly; of a block that rests
between two others that rest only rows with a new position are kept. What is left out says nothing of the motion: the
wheels stand, and headings are used at positions and beside drives alone.
"""

import math

import numpy as np

from lunarsci.arrays import BoolArray, FloatArray
from lunarsci.errors import DataError
from lunarsci.twin.rover import Rover

LEAST_HELD, SURELY = 1e-4, 3.0
"""Least odds beforehand that a run is held; they are the share of repeats beyond so many times that by chance;
assumed."""
FOLLOWS = 0.2
"""Share by which a change may differ from the one that is expected; assumed."""


def held(values: FloatArray, chance: float, expected: FloatArray, sigma: float) -> BoolArray:
    """Which readings only repeat the one before. (n,)

    Parameters
    ----------
    values : readings, of one or more numbers each. (n,) or (n, m)
    chance : probability that a sound reading repeats the one before while nothing changes.
    expected : what the reading should have changed by since the start. (n,)
    sigma : standard error of that change beside the share `FOLLOWS`, in its unit.
    """
    flat = values.reshape(len(values), -1)
    begins = np.flatnonzero(np.append(True, (np.diff(flat, axis=0) != 0).any(axis=1)))
    repeats = np.diff(np.append(begins, len(values))) - 1
    change = np.maximum.reduceat(expected, begins) - np.minimum.reduceat(expected, begins)
    # A channel that is sent more often than it is read repeats throughout.
    ln_held = math.log(max(LEAST_HELD, repeats.sum() / len(values) - SURELY * chance))
    ln_odds = ln_held - repeats * math.log(chance) + 0.5 * change**2 / (sigma**2 + (FOLLOWS * change) ** 2)
    result = np.repeat((ln_odds > 0) & (repeats > 0), repeats + 1)
    result[begins] = False
    return np.asarray(result)


def digit_of(values: FloatArray) -> float:
    """The last digit: the finest change of which all changes are multiples; a thousandth of it where they are none.

    Infinite where nothing changes.
    """
    changes = np.abs(np.diff(values, axis=0))
    known = changes[np.isfinite(changes)]
    known = known[known > 1e-6 * np.max(known, initial=0.0)]
    finest = float(np.min(known, initial=np.inf))
    return finest if (np.abs(known / finest - np.rint(known / finest)) < 0.01).all() else 1e-3 * finest


def chance_by_noise(values: FloatArray, sigma: float) -> float:
    """Probability that a reading with an error of `sigma` repeats the one before, by its last digit.

    The difference of two is normal, of standard deviation sqrt 2 sigma, and rounded to the finest change there is.
    """
    return min(1.0, digit_of(values) / (2.0 * math.sqrt(math.pi) * sigma))


BLOCK = 256
"""Rows of a block: half a minute at 10 Hz; assumed."""
STILL = 0.05
"""Share of the rover's highest speed up to which a rate is that of a wheel that stands; assumed."""
TURNED_DEG = 3.0
"""Turn of a wheel up to which it stands: 8 mm of way; assumed. [deg]"""
GAP = 5.0
"""Times the median step between rows from which on a step is a gap; assumed, as of a motion."""
MOST_ROWS = 500_000
"""That are kept: 14 hours at 10 Hz of a rover that does not rest. `tests/benchmarks/load.py` tells their memory."""
PLACES = ("x_m", "y_m", "xx_m2", "xy_m2", "yy_m2", "sigma_m")


Columns = dict[str, FloatArray]


class RowsKept:
    """Rows of telemetry by column, without most of those of a rover that rests, put together from pieces.

    Attributes
    ----------
    read : rows that were added.
    rests_s : begin and end of the rests within which rows are left out. [s]
    """

    def __init__(self, file: str, rover: Rover) -> None:
        self.file, self.read = file, 0
        self.rests_s: list[tuple[float, float]] = []
        self._rover, self._count = rover, 0
        self._kept: list[Columns] = []
        self._left: Columns = {}
        self._before: tuple[Columns, bool] | None = None
        self._held: tuple[Columns, bool] | None = None
        self._anchor = np.full((0, 0), np.nan)
        self._place = np.full(len(PLACES), np.nan)

    def add(self, columns: Columns) -> None:
        """The next rows, of the same columns each time. Raises DataError for more than there is to be memory for."""
        self.read += len(columns["time_s"])
        rows = {name: np.append(self._left.get(name, ()), column) for name, column in columns.items()}
        whole = len(rows["time_s"]) // BLOCK * BLOCK
        for first in range(0, whole, BLOCK):
            self._take({name: column[first : first + BLOCK] for name, column in rows.items()})
        self._left = {name: column[whole:] for name, column in rows.items()}

    def joined(self) -> Columns:
        """The columns of the rows that are kept, in their order, when all have been added."""
        if self._held is not None:
            self._keep(self._held[0])
        self._keep(self._left)
        return {name: np.concatenate([part[name] for part in self._kept]) for name in self._left}

    def _take(self, block: Columns) -> None:
        """Keep the block before this one, or leave it out, now that both its neighbours are known."""
        rests = self._rests(block)
        if self._held is not None:
            before, (middle, still) = self._before, self._held
            if still and rests and before is not None and before[1]:
                self._leave_out(before[0], middle, block)
            else:
                self._keep(middle)
        self._before, self._held = self._held, (block, rests)

    def _keep(self, rows: Columns) -> None:
        self._kept.append(rows)
        self._count += len(rows["time_s"])
        if self._count > MOST_ROWS:
            raise DataError(
                f"{self.file}: more than {MOST_ROWS:,} rows of a rover that does not stand for long, to "
                f"time_s {rows['time_s'][-1]:.6g}; take a part of it with `since` and `until`, or fewer rows a second"
            )
        if len(placed := np.flatnonzero(_placed(rows))):
            self._place = _places(rows)[placed[-1]]

    def _leave_out(self, before: Columns, rows: Columns, after: Columns) -> None:
        """Keep only positions that do not repeat the one before to the last digit."""
        begin, end = float(before["time_s"][0]), float(after["time_s"][-1])
        if self.rests_s and self.rests_s[-1][1] == rows["time_s"][-1]:
            begin = self.rests_s.pop()[0]
        self.rests_s.append((begin, end))
        placed = np.flatnonzero(_placed(rows))
        if len(placed):
            places = np.vstack([self._place, _places(rows)[placed]])
            new = placed[(np.nan_to_num(places[1:], nan=np.inf) != np.nan_to_num(places[:-1], nan=np.inf)).any(axis=1)]
            self._keep({name: column[new] for name, column in rows.items()})

    def _rests(self, rows: Columns) -> bool:
        """Whether no wheel turns, and time goes on evenly, also from the block before."""
        first = self._held is None
        times = rows["time_s"] if self._held is None else np.append(self._held[0]["time_s"][-1], rows["time_s"])
        steps = np.diff(times)
        even = bool((steps > 0).all()) and bool(steps.max() <= GAP * np.median(steps))
        angles = _of_wheels(rows, self._rover, "angle_{}_deg")
        still = even and not first and self._stand(rows, angles)
        if not still:
            self._anchor = angles
        return still

    def _stand(self, rows: Columns, angles: FloatArray) -> bool:
        told = np.abs(_of_wheels(rows, self._rover, "speed_{}_m_s"))
        rim = np.radians(np.abs(_of_wheels(rows, self._rover, "rate_{}_deg_s"))) * self._rover.wheel.shearing_radius_m
        both = np.concatenate([self._anchor[-1:], angles])
        off = np.abs(both[1:] - np.where(np.isfinite(both[0]), both[0], angles[0]))
        turns = (told > 0).any() or (rim > STILL * self._rover.max_speed_m_s).any() or (off > TURNED_DEG).any()
        known = np.isfinite(told) | np.isfinite(rim) | np.isfinite(angles)
        return bool(known.any(axis=0).all()) and not turns


def _of_wheels(rows: Columns, rover: Rover, form: str) -> FloatArray:
    """A column of each wheel, NaN where there is none. (n, wheels)"""
    blank = np.full(len(rows["time_s"]), np.nan)
    return np.column_stack([rows.get(form.format(wheel), blank) for wheel in rover.wheels])


def _placed(rows: Columns) -> BoolArray:
    return np.isfinite(rows["x_m"]) | np.isfinite(rows["y_m"]) if "x_m" in rows else np.zeros(len(rows["time_s"]), bool)


def _places(rows: Columns) -> FloatArray:
    blank = np.full(len(rows["time_s"]), np.nan)
    return np.column_stack([rows.get(name, blank) for name in PLACES])
