"""Sentences on a spectrum: what its bands, its fit or its choice of minerals say, and what else may make the bands.

They are made of the records that `spectra bands --json` and `spectra fit --json` write, for tables and pages.
"""

import math
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

from lunarsci.minerals import WEIGHED
from lunarsci.names import some_of
from lunarsci.result import from_prior
from lunarsci.spectra.abundance.shares import OPEN, SOME
from lunarsci.spectra.band_status import NARROW_TEXT, centre_text
from lunarsci.spectra.bands import measure_batch
from lunarsci.spectra.chemistry.plane import OLIVINE_NM, OPX_MOST_NM, one_pyroxene
from lunarsci.spectra.mgm import PERCENT_OF, with_trend
from lunarsci.spectra.mgm.assemblages import SURE, chances, others_of
from lunarsci.spectra.mgm.result import UNLIKE_RMS, in_doubt
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
    if narrow := bands_doubt(record):
        return narrow
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


def bands_doubt(record: Mapping[str, Any]) -> str:
    """The narrow absorption that is all there is at 2 um, of the keys of `spectra bands --json`; '' where there is
    none."""
    status = str(record["band2000_status"])
    return status.removeprefix("no band: ") if status.startswith(f"no band: {NARROW_TEXT}") else ""


def with_causes(spectra: Sequence[Spectrum], choices: Mapping[int, Choice]) -> dict[int, Choice]:
    """Choices, by position, with what else the 2 um bands may be of; not strong where the fit has a pyroxene then."""
    measured = measure_batch([spectra[index] for index in choices])
    result = dict(choices)
    for (index, choice), bands in zip(choices.items(), measured, strict=True):
        record = bands.to_dict()
        cause, (_, inside, beside) = other_cause(record), str(record["band2000_status"]).partition("in it ")
        decided = choice.strong and not (cause and chances(choice.probabilities)["pyroxene"] >= SURE)
        result[index] = replace(choice, cause=cause, beside=beside if inside else "", strong=decided)
    return result


MOST_NAMED = 4
SEEN = 2.0
"""A band is seen where its strength is this many standard errors off 0; assumed."""
WEAK = ("OL M1-1", "OPX M1", "CPX M1")
"""Bands that a mineral may lack: its weakest beside others of its own."""


def centre_texts(record: Mapping[str, Any]) -> dict[str, str]:
    """By key of each band that is there, its centre with the errors of noise and of method."""
    return {
        key: centre_text(record[f"bc{key}_nm"], record[f"bc{key}_sigma_nm"], record[f"bc{key}_method_nm"])
        for key in ("1000", "2000")
        if record[f"bc{key}_nm"] is not None
    }


def bands_verdict(record: Mapping[str, Any]) -> str:
    """The centres of `spectra bands`, and what they say."""
    centres = " and ".join(centre_texts(record).values())
    return f"centred at {centres}: {bands_meaning(record)}" if centres else bands_meaning(record)


def bands_meaning(record: Mapping[str, Any]) -> str:
    """What the centres of `spectra bands` say."""
    one, two = record["bc1000_nm"] is not None, record["bc2000_nm"] is not None
    if cause := other_cause(record):
        return f"pyroxene is open: {cause}"
    if not (one or two):
        return "no band, so nothing is said of its minerals"
    if one and not two and not str(record["band2000_status"]).startswith("no band"):
        return "a 1 µm band; whether there is one at 2 µm could not be measured, so pyroxene and olivine are both open"
    if one and not two:
        return (
            "a 1 µm band and none at 2 µm: olivine, or a pyroxene whose 2 µm band is hidden; `spectra fit` looks closer"
        )
    if two and not one:
        return "a 2 µm band; whether there is one at 1 µm could not be measured, so pyroxene and spinel are both open"
    if one_pyroxene(*zip(*(_centre_and_error(record, key) for key in ("1000", "2000")), strict=True)):
        return (
            "pyroxene; its centres are those of pyroxenes without olivine, but olivine, even much, is not ruled out; "
            "quote only regressions whose condition you know to hold"
        )
    return "pyroxene; the centres are not those of one pyroxene alone: olivine or several pyroxenes; `spectra fit` next"


def _centre_and_error(record: Mapping[str, Any], key: str) -> tuple[float, float]:
    """The centre of a band with what noise, methods and the calibration leave of it open. [nm]"""
    errors = [record[f"bc{key}_{name}_nm"] or 0.0 for name in ("sigma", "method", "calibration")]
    return float(record[f"bc{key}_nm"]), math.hypot(*errors)


def fit_verdict(record: Mapping[str, Any]) -> str:
    """What a fit, or a choice between assemblages, says."""
    if not record["bands"]:
        return f"no fit: {record['status']}"
    parts = [str(record["choice"]["status"]) if record["choice"] else _assumed(record), *_strained(record)]
    determined = _determined(record)
    compositions = [f"{PERCENT_OF[key]} {_composition(item)} mol %{_condition(item)}" for key, item in determined]
    sure = record["status"] == "converged" and bool(record["choice"] and record["choice"]["strong"])
    if_so = "" if sure else "if the fit is right, "
    parts += [f"{if_so}{', '.join(compositions)}"] if compositions else ["no composition is determined"]
    return "; ".join(parts)


def fits_counted(records: Sequence[Mapping[str, Any]]) -> list[str]:
    """Of many fits, in how many each mineral is sure, open or not needed, and how many are in doubt."""
    total, none, unsure, doubtful = len(records), 0, 0, list[str]()
    minerals: dict[str, Counter[str]] = {"sure": Counter(), "open": Counter(), "not_needed": Counter()}
    compared = 0
    for record in records:
        none += not record["bands"]
        doubtful += [record["id"]] if record["bands"] and _strained(record) else []
        if choice := record["choice"]:
            compared, unsure = compared + 1, unsure + (not choice["sure"])
            for key, counts in minerals.items():
                counts.update(choice[key])
    words = {"sure": "sure", "open": "open", "not_needed": "probably absent, or not needed to fit"}
    parts = [
        f"{words[key]}, of {compared} spectra: {', '.join(f'{name} in {n}' for name, n in counts.most_common())}"
        for key, counts in minerals.items()
        if counts
    ]
    parts += [f"no mineral is sure: {unsure} of {compared} spectra"] if unsure else []
    if total - none > compared:
        parts.append(f"the assemblage was assumed: {total - none - compared} of {total} spectra")
    parts += [f"no fit: {none} of {total} spectra"] if none else []
    named = some_of(doubtful, MOST_NAMED)
    return parts + ([f"in doubt: {len(doubtful)} of {total} spectra ({named}), see `status`"] if doubtful else [])


def _condition(item: Mapping[str, Any]) -> str:
    return f" (if {item['domain']})" if item.get("domain") else ""


def _composition(item: Mapping[str, Any]) -> str:
    shown = f"{item['mean']:.0f} ± {item['sigma']:.0f}"
    return with_trend(shown, item["trend_sigma"]) if "trend_sigma" in item else shown


def fit_doubt(record: Mapping[str, Any]) -> str:
    """Why the fit of one spectrum is not to be trusted, as `doubts_about` has it of many; '' if it may be."""
    parts = [] if record["status"] == "converged" else [str(record["status"])]
    parts += ["the model does not describe it"] if (record.get("rms_ln") or 0.0) > UNLIKE_RMS else []
    choice = record.get("choice")
    parts += ["the assemblage is not decided"] if choice and not choice["strong"] else []
    return f"{record['id']} is not to be trusted: {'; '.join(parts)}" if parts else ""


def _strained(record: Mapping[str, Any]) -> list[str]:
    """That the fit is in doubt, where it is."""
    return list(filter(None, [in_doubt(str(record["status"]))]))


def _determined(record: Mapping[str, Any]) -> list[tuple[str, Mapping[str, Any]]]:
    """Compositions in range that the spectrum, and not the prior alone, tells, of minerals that are not in doubt.

    A pyroxene that was fitted alone has none where the other one is sure.
    """
    choice = record["choice"] or {}
    doubtful = [] if choice else [mineral for result in _by_bands(record)[1:] for mineral in result]
    besides = [mineral for name in choice.get("sure", ()) for mineral in others_of(name)]
    return [
        (key, item)
        for key, item in record["compositions"].items()
        if item["mean"] is not None and item["in_range"] and not from_prior(item["sigma"], item["prior_sigma"])
        if not any(PERCENT_OF[key].endswith(mineral) for mineral in (*doubtful, *(besides if item["domain"] else ())))
    ]


def _assumed(record: Mapping[str, Any]) -> str:
    """Of the minerals that were assumed, which have all their bands, which some of them, and which none."""
    full, some, none = _by_bands(record)
    parts = [f"all bands of {', '.join(full)}"] if full else []
    parts += [f"some bands, not all, of {', '.join(some)}: may be absent"] if some else []
    parts += [f"none of {', '.join(none)}"] if none and parts else []
    which = f"{record['assemblage']} was assumed, others may fit as well (`--assemblage auto` compares them)"
    return f"{which}: {'; '.join(parts) or 'no band of any mineral'}"


def _by_bands(record: Mapping[str, Any]) -> tuple[list[str], list[str], list[str]]:
    """Minerals of which all bands are there, some, and none.

    Of 389 laboratory spectra of known modes, in 56, 39 and 16 % of those without olivine, orthopyroxene and
    clinopyroxene some band of it was there, in 6, 16 and 4 % all; of those with more than 10 % of it, all were there in
    56, 82 and 35 %.
    """
    depths: dict[str, list[float]] = {}
    for band in record["bands"]:
        if band["mineral"] not in ("", "any") and band["strength_sigma"] > 0 and band["name"] not in WEAK:
            depths.setdefault(band["mineral"], []).append(-band["strength"] / band["strength_sigma"])
    full = [mineral for mineral, result in depths.items() if min(result) >= SEEN]
    some = [mineral for mineral, result in depths.items() if min(result) < SEEN <= max(result)]
    return full, some, [mineral for mineral, result in depths.items() if max(result) < SEEN]


def shares_verdict(record: Mapping[str, Any]) -> str:
    """What the shares of `spectra unmix` say, and what of them may be quoted."""
    if record["kind"]["name"] == "weathered-soil":
        return "no shares of minerals: a weathered soil has a composition by regression instead"
    shares = record["abundance"]
    values = ", ".join(f"{name} {_percent(shares[name])}" for name in WEIGHED if name in shares)
    if not any(shares[name]["fraction"] is not None for name in WEIGHED if name in shares):
        return f"no share to be quoted: {shares['status']}"
    likely = _likely(shares)
    parts = [f"{'' if shares['in_domain'] else 'uncertain; quote the 95 % intervals alone: '}{values}"]
    parts += [f"likely there: {', '.join(likely)}"] if likely else []
    reached = [name for name in WEIGHED if name in shares and name not in likely and shares[name]["high95"] > SOME]
    parts += [f"not excluded: {', '.join(reached)}"] if reached else []
    ratios = [f"{name.replace('_', ' ')} {_percent(item)}" for name, item in shares["ratios"].items()]
    return "; ".join(parts + ([f"ratios: {', '.join(ratios)}"] if ratios else []))


def shares_doubt(record: Mapping[str, Any]) -> str:
    """Why the shares of one spectrum are not to be trusted; '' if they may be."""
    status = str(record["abundance"]["status"])
    return f"{record['id']} is not to be trusted: {status}" if status.startswith("not determined") else ""


def shares_counted(records: Sequence[Mapping[str, Any]]) -> list[str]:
    """Of many spectra, how many have shares in domain, and in how many each mineral is likely there."""
    total = len(records)
    soils = sum(record["kind"]["name"] == "weathered-soil" for record in records)
    inside = sum(record["abundance"]["in_domain"] for record in records)
    there = Counter(name for record in records for name in _likely(record["abundance"]))
    parts = [f"in domain: {inside} of {total} spectra; of the others quote the 95 % intervals alone"]
    parts += [f"likely there: {', '.join(f'{name} in {n}' for name, n in there.most_common())}"] if there else []
    return parts + ([f"weathered soils, not unmixed: {soils} of {total} spectra"] if soils else [])


def _likely(shares: Mapping[str, Any]) -> list[str]:
    """Minerals of which there is probably more than 5 %, and whose 95 % interval does not begin at 0."""
    named = [name for name in WEIGHED if name in shares]
    return [name for name in named if (shares[name]["present"] or 0.0) > OPEN[1] and shares[name]["low95"] > 0.0]


def _percent(share: Mapping[str, Any]) -> str:
    determined = share["fraction"] is not None and math.isfinite(share["fraction"])
    value = f"{100 * share['fraction']:.0f} %" if determined else "not determined"
    return f"{value} (95 %: {100 * share['low95']:.0f} to {100 * share['high95']:.0f})"
