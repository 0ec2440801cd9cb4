"""Fits of many spectra to one model, each of which is made when it is asked for."""

from collections.abc import Callable, Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from lunarsci.arrays import BoolArray, FloatArray, IndexArray
from lunarsci.names import some_of
from lunarsci.spectra.mgm.batch import FitBatch
from lunarsci.spectra.mgm.data import SpectraRows
from lunarsci.spectra.mgm.model import MgmModel
from lunarsci.spectra.mgm.result import UNLIKE_RMS, MgmFailure, MgmFit

if TYPE_CHECKING:
    from lunarsci.spectra.mgm.profile import Intervals
    from lunarsci.spectra.mgm.selection import Choice


NAMED = 5
"""Spectra without a decided assemblage that are named."""

ODD = {"strained": "bands are strained, see `status`, of", "ambiguous": "another minimum fits almost as well for"}
"""Words of a status beside `converged`, and what they are against a fit."""


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


def doubts_about(fits: Sequence[MgmFit | MgmFailure], choices: "Mapping[int, Choice] | None" = None) -> list[str]:
    """Why some fits should not be trusted, one sentence for each reason."""
    if isinstance(fits, SpectraFits):
        unsettled, rms = ~(fits.gathered(lambda batch: batch.converged) > 0), fits.gathered(lambda batch: batch.rms_ln)
        names = np.array(fits.names, dtype=object)
        lists = [names[unsettled & fits.there].tolist(), names[rms > UNLIKE_RMS].tolist()]
        said = list(zip(fits.names, fits.statuses, strict=True))
    else:
        good = [item for item in fits if isinstance(item, MgmFit)]
        lists = [[one.id for one in good if not one.converged], [one.id for one in good if one.rms_ln > UNLIKE_RMS]]
        said = [(item.id, item.status) for item in good]
    texts = ("no convergence for {}", "the model does not describe {}")
    doubts = [text.format(", ".join(found)) for text, found in zip(texts, lists, strict=True) if found]
    for word, text in ODD.items():
        odd = [name for name, status in said if f"; {word}: " in status]
        doubts += [f"{text} {some_of(odd, NAMED)}"] if odd else []
    weak = [choice.id for choice in (choices or {}).values() if not choice.strong]
    return doubts + ([f"the assemblage is not decided for {some_of(weak, NAMED)}"] if weak else [])


def intervals_of(
    results: Sequence[Any], errors: str, seed: int, progress: Callable[[int, int], None] | None
) -> dict[int, "Intervals"]:
    """Intervals by position of fits that converged, by profile or sample; none for laplace."""
    if errors == "laplace":
        return {}
    fits = {index: item for index, item in enumerate(results) if isinstance(item, MgmFit) and item.converged}
    if errors == "sample":
        from lunarsci.spectra.mgm.posterior import posterior_intervals, sample_batch

        posteriors = sample_batch(list(fits.values()), seed=seed, progress=progress)
        return {index: posterior_intervals(posterior) for index, posterior in zip(fits, posteriors, strict=True)}
    from lunarsci.spectra.mgm.profile import profile_intervals

    found = {}
    for done, (index, item) in enumerate(fits.items(), start=1):
        found[index] = profile_intervals(item)
        if progress:
            progress(done, len(fits))
    return found
