"""What else than a pyroxene may make the 1 and 2 um bands of a spectrum."""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

from lunarsci.spectra.band_status import NARROW_SAID
from lunarsci.spectra.bands import measure_batch
from lunarsci.spectra.chemistry.plane import OLIVINE_NM, OPX_MOST_NM
from lunarsci.spectra.mgm.assemblages import SURE, chances
from lunarsci.spectra.mgm.selection import Choice
from lunarsci.spectra.spectrum import Spectrum

MOST_RATIO = 1.5
"""Depth of the 2 um band over that of the 1 um band above which it is no pyroxene's; assumed. In 290 laboratory spectra
(RELAB) with 10 vol % of pyroxene or more it is 0.97 at most, in one pigeonite of USGS 2.2; spinels absorb at 2 um
almost alone (Pieters et al. 2011, 10.1029/2010JE003727)."""
SIGMAS = 2.0
"""Standard errors of the depths that the ratio must exceed it by; assumed."""


def other_cause(record: Mapping[str, Any]) -> str:
    """Why the 2 um band need not be a pyroxene's, of the keys of `spectra bands --json`; '' where nothing says so.

    Iron-bearing glass has its centres at 1060-1200 and 1900-2050 nm (Horgan et al. 2014,
    10.1016/j.icarus.2014.02.031), where olivine with some orthopyroxene has them, too.
    """
    first, second = record["bc1000_nm"], record["bc2000_nm"]
    status = str(record["band2000_status"])
    if status.startswith(f"no band: {NARROW_SAID}"):
        return status.removeprefix("no band: ")
    if second is None:
        return ""
    if first is None:
        absent = str(record["band1000_status"]).startswith("no band")
        return "a 2 µm band without one at 1 µm is no pyroxene's: spinel, or something else" if absent else ""
    one, two = (record[f"bd{key}"] for key in ("1000", "2000"))
    least = two - SIGMAS * record["bd2000_sigma"]
    if least > MOST_RATIO * (one + SIGMAS * record["bd1000_sigma"]):
        return f"the 2 µm band is {two / one:.1f} times as deep as that at 1 µm, which pyroxenes have not: spinel?"
    if first > OLIVINE_NM[0] and second < OPX_MOST_NM:
        return "centres at 1 and 2 µm are those of glass, or of olivine with some orthopyroxene"
    return ""


def with_causes(spectra: Sequence[Spectrum], choices: Mapping[int, Choice]) -> dict[int, Choice]:
    """Choices, by position, with what else the 2 um bands may be of; not strong where the fit has a pyroxene then."""

    measured = measure_batch([spectra[index] for index in choices])
    found = dict(choices)
    for (index, choice), bands in zip(choices.items(), measured, strict=True):
        record = bands.to_dict()
        cause, (_, known, beside) = other_cause(record), str(record["band2000_status"]).partition("in it ")
        decided = choice.strong and not (cause and chances(choice.probabilities)["pyroxene"] >= SURE)
        found[index] = replace(choice, cause=cause, beside=beside if known else "", strong=decided)
    return found
