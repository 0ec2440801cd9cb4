"""Fits of many spectra to one model, each of which is made when it is asked for."""

from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np

from lunarsci.arrays import BoolArray, FloatArray, IndexArray
from lunarsci.spectra.mgm.batch import FitBatch
from lunarsci.spectra.mgm.data import SpectraRows
from lunarsci.spectra.mgm.model import MgmModel
from lunarsci.spectra.mgm.result import MgmFailure, MgmFit


class SpectraFits(Sequence[MgmFit | MgmFailure]):
    """A fit, or a stated reason, for each of n spectra, in their order.

    Attributes
    ----------
    names : of the spectra.
    model : that all were fitted to.
    parts : positions, what was fitted, and the fits, of spectra on the same channels; a fit is made of its row when it
        is asked for.
    failures : by position.
    """

    def __init__(
        self,
        names: Sequence[str],
        model: MgmModel,
        parts: Sequence[tuple[IndexArray, SpectraRows, FitBatch]],
        failures: Mapping[int, MgmFailure],
    ) -> None:
        self.names, self.model, self.parts, self.failures = names, model, parts, failures
        self._seen: dict[int, MgmFit | MgmFailure] = dict(failures)
        self._place = np.full((len(names), 2), -1)
        for number, (positions, _, _) in enumerate(parts):
            self._place[positions, 0], self._place[positions, 1] = number, np.arange(len(positions))

    def __len__(self) -> int:
        return len(self.names)

    def __getitem__(self, index: Any) -> Any:
        if isinstance(index, slice):
            return [self[k] for k in range(*index.indices(len(self)))]
        position = range(len(self))[index]
        if position not in self._seen:
            number, row = self._place[position].tolist()
            _, rows, batch = self.parts[number]
            self._seen[position] = batch.fit(row, rows.at(row, self.names[position]))
        return self._seen[position]

    def part(self, block: range) -> "SpectraFits":
        """Those of some spectra, next to each other."""
        parts = []
        for positions, rows, batch in self.parts:
            own = slice(*np.searchsorted(positions, (block.start, block.stop)).tolist())
            if own.stop > own.start:
                parts.append((positions[own] - block.start, rows.part(own), batch.part(own)))
        failures = {k - block.start: found for k, found in self.failures.items() if k in block}
        return SpectraFits(self.names[block.start : block.stop], self.model, parts, failures)

    @property
    def there(self) -> BoolArray:
        """(n,) whether there is a fit."""
        return np.asarray(self._place[:, 0] >= 0)

    @property
    def statuses(self) -> list[str]:
        """A sentence about each."""
        found = [self.failures[k].status if k in self.failures else "" for k in range(len(self))]
        for positions, _, batch in self.parts:
            for position, text in zip(positions.tolist(), batch.statuses(), strict=True):
                found[position] = text
        return found

    def gathered(self, column: Callable[[FitBatch], Any]) -> FloatArray:
        """What `column` makes of each batch, (n, ...), in the order of the spectra; NaN without a fit."""
        parts = [(positions, np.asarray(column(batch))) for positions, _, batch in self.parts]
        found = np.full((len(self), *(parts[0][1].shape[1:] if parts else ())), np.nan)
        for positions, values in parts:
            found[positions] = values
        return found
