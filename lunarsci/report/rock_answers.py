"""Sentences for spectra, and for where a rock came from."""

from collections.abc import Mapping
from typing import Any

from lunarsci.report.sentences import DOUBT, PLAIN, Result, ResultAnswer, each
from lunarsci.report.words import counted, measured, number, percent

UNSHARED = "Shares of minerals are not determined."
HALF = 0.5
"""A share of one with a larger error than this is not determined; assumed."""


def calibrated(result: Result) -> ResultAnswer:
    spectra = result["spectra"]
    made_up = "Synthetic. " if any(one.get("synthetic") for one in spectra) else ""
    bad = any(one.get("status") != "ok" for one in spectra)
    return ResultAnswer(made_up + each(spectra, _one_calibrated, "spectrum"), DOUBT if bad else PLAIN)


def _one_calibrated(one: Result) -> str:
    masked = f", {one['channels_masked']} of them masked" if one.get("channels_masked") else ""
    status = "" if one.get("status") == "ok" else f" Its status is: {one.get('status')}."
    return f"{one['id']} is calibrated to reflectance in {counted(one['channels'], 'channel')}{masked}.{status}"


def bands(result: Result) -> ResultAnswer:
    return ResultAnswer(each(result["spectra"], _one_bands, "spectrum"))


def _one_bands(one: Result) -> str:
    found = [
        f"at {measured(one[f'bc{key}_nm'], one.get(f'bc{key}_sigma_nm'), 'nm')}, "
        f"{measured(_times(one.get(f'bd{key}'), 100), _times(one.get(f'bd{key}_sigma'), 100), '%')} deep"
        for key in ("1000", "2000")
        if one.get(f"bc{key}_nm") is not None
    ]
    if not found:
        return f"{one['id']} has no absorption band near 1 or 2 µm that could be measured."
    return f"{one['id']} absorbs {' and '.join(found)}."


def _times(value: Any, factor: float) -> Any:
    return None if value is None else factor * value


def fit(result: Result) -> ResultAnswer:
    spectra = result["spectra"]
    bad = [one for one in spectra if not one.get("converged", True)]
    bad += [one for one in spectra if _mineral_shares(one) and not one["abundance"].get("in_domain", True)]
    return ResultAnswer(each(spectra, _one_fit, "spectrum"), DOUBT if bad else PLAIN)


def _one_fit(one: Result) -> str:
    name, abundance = one.get("id", "the spectrum"), one.get("abundance") or {}
    shares = _mineral_shares(one)
    if shares:
        domain = "" if abundance.get("in_domain", True) else " But the method is not shown to hold for such a target."
        return f"Shares of minerals in {name}: {', '.join(shares)}.{domain}"
    ratio = (one.get("nbsr") or {}).get("um2")
    strength = (
        f" Of the pyroxene bands at 2 µm, orthopyroxene makes {measured(ratio['opx'], ratio.get('sigma'))}."
        if ratio and (ratio.get("sigma") or 0) < HALF
        else ""
    )
    state = "is fitted" if one.get("converged", True) else "is not fitted: the fit did not converge"
    why = f"; rms {100 * one['rms_ln']:.2f} % of reflectance" if one.get("rms_ln") is not None else ""
    return f"{name} {state} by {one.get('assemblage', 'bands')} and a continuum{why}.{strength} {UNSHARED}"


def _mineral_shares(one: Result) -> list[str]:
    return [
        f"{mineral} {percent(item['fraction'])} ({percent(item['low'])} to {percent(item['high'])})"
        for mineral, item in (one.get("abundance") or {}).items()
        if isinstance(item, Mapping) and item.get("fraction") is not None and mineral != "calibration"
    ]


def match(result: Result) -> ResultAnswer:
    return ResultAnswer(each(result["rocks"], _one_match, "rock"))


def _one_match(rock: Result) -> str:
    best = next((one for one in rock["craters"] if one["name"] == rock.get("best")), None)
    if best is None:
        return f"{rock['id']}: no crater stands out."
    known = " by position alone, as its composition decides nothing" if "nothing" in str(rock.get("status")) else ""
    return f"{rock['id']} most likely came from {best['name']}, {percent(best['posterior'])}{known}."


def indices(result: Result) -> ResultAnswer:
    count = len(result["indices"])
    return ResultAnswer(f"Indices: {count}, of {counted(len(result.get('spectra', ())), 'spectrum')}.")


def rocks(result: Result) -> ResultAnswer:
    rocks = result["rocks"]
    largest = max((one["diameter_m"] for one in rocks), default=None)
    tall = f", the largest {number(largest, 2)} m across" if largest is not None else ""
    return ResultAnswer(f"{counted(len(rocks), 'rock')} found{tall}.")
