"""The minerals of a mixture as powders: what each adds, and how its grains' size moves both look and weight."""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from lunarsci.spectra.abundance.mixing import MixingLaw
from lunarsci.spectra.abundance.population import MineralPopulation
from lunarsci.spectra.spectrum import FloatArray

__all__ = ["Powders"]

COMMON_LEVEL = 1.0
"""Standard deviation of the level that all minerals of a mixture share, their grain size; assumed."""


@dataclass(frozen=True, eq=False)
class Powders:
    """Powders of the minerals as functions of standard normal parameters: shapes of each in turn, then the level.

    A mineral whose own level is raised by d is taken as coarser by a factor e^d in `Albedo`: it then offers less
    cross-section per volume by the same factor (`section` of the law).
    """

    law: MixingLaw
    minerals: Sequence[MineralPopulation]

    @cached_property
    def size(self) -> int:
        """Number of parameters."""
        return sum(len(item.shapes) for item in self.minerals) + 1

    @cached_property
    def starts(self) -> list[int]:
        """Position of each mineral's first parameter."""
        counts = [len(item.shapes) for item in self.minerals]
        return [sum(counts[:i]) for i in range(len(counts))]

    @property
    def common(self) -> float:
        """Derivative of every t by the last parameter, the level of all."""
        return COMMON_LEVEL

    def at(self, shared: FloatArray) -> tuple[FloatArray, FloatArray]:
        """x of each mineral and dx / dt, both (m, n)."""
        level = shared[-1] * self.common
        pairs = [
            self.law.mixing(item.mean + shared[start : start + len(item.shapes)] @ item.shapes + level)
            for start, item in zip(self.starts, self.minerals, strict=True)
        ]
        x, slope = (np.array(part) for part in zip(*pairs, strict=True))
        return x, slope

    @cached_property
    def sections(self) -> FloatArray:
        """Derivative of the logarithm of each mineral's cross-section per volume by the parameters, (m, size)."""
        rows = np.zeros((len(self.minerals), self.size))
        for row, start, item in zip(rows, self.starts, self.minerals, strict=True):
            row[start + len(item.shapes) - 1] = -self.law.section * item.shapes[-1, 0]
        return rows

    def by_parameters(self, slope: FloatArray) -> list[tuple[slice, FloatArray]]:
        """Where each mineral's own parameters stand, and dx of that mineral by them, (k, n)."""
        return [
            (slice(start, start + len(item.shapes)), row * item.shapes)
            for start, item, row in zip(self.starts, self.minerals, slope, strict=True)
        ]
