"""Wo and Fs of pyroxene by turns (Gaffey et al. 2002, Asteroids III, 183).

Which of three lines gives Wo from the 1 um centre depends on Fs, and which of four gives Fs from the 2 um centre on Wo.
One starts with the line for Fs 25-50 and goes to and fro until the lines no longer change.
"""

from dataclasses import dataclass

from lunarsci.spectra.chemistry.regressions import Regression, regressions

__all__ = ["GaffeyPair", "gaffey_pair"]

_START = "wo_gaffey_c"
_TURNS = 12
"""There are twelve pairs of lines: whoever has not arrived by then never will."""


@dataclass(frozen=True, slots=True)
class GaffeyPair:
    """The two lines arrived at; `settled` is False where they alternate, or where Fs exceeds all of them."""

    wo: Regression
    fs: Regression
    settled: bool


def gaffey_pair(bc1000_nm: float, bc2000_nm: float) -> GaffeyPair:
    """The lines for Wo and Fs that agree with each other at these centres. [nm]"""
    wo_lines, fs_lines = _lines("wo"), _lines("fs")
    wo_line = regressions()[_START]
    fs_line = fs_lines[0]
    for _ in range(_TURNS):
        wo = wo_line.value(bc1000_nm)
        fs_line = next(line for line in fs_lines if line.when[0] <= wo < line.when[1])
        fs = fs_line.value(bc2000_nm)
        following = next((line for line in wo_lines if line.when[0] <= fs < line.when[1]), None)
        if following is None or following is wo_line:
            return GaffeyPair(wo_line, fs_line, settled=following is not None)
        wo_line = following
    return GaffeyPair(wo_line, fs_line, settled=False)


def _lines(quantity: str) -> list[Regression]:
    return [line for key, line in regressions().items() if key.startswith(f"{quantity}_gaffey")]
