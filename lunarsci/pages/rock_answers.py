"""Sentences for spectra, and for where a rock came from: verdicts are those of the results, word by word."""

from collections.abc import Mapping, Sequence
from typing import Any

from lunarsci.minerals import WEIGHED
from lunarsci.names import counted, some_of
from lunarsci.pages.words import Result, ResultAnswer, answers, each, measured, number, percent, sentence
from lunarsci.provenance import plain
from lunarsci.result import FINE
from lunarsci.spectra.band_status import DEPENDS
from lunarsci.spectra.jobs.verdicts import bands_meaning, centre_texts, fit_verdict, shares_verdict

ERRORS = ("sigma", "systematic", "gaussian", "method", "calibration", "rms", "chi")
"""Parts of names of layers that are errors of others."""
UNIFORM = 12**-0.5
"""Standard deviation of a uniform distribution between 0 and 1: a share with this error is not determined."""
MOST_LAYERS = 3
"""Layers of a map that a sentence names, centres of bands first."""
MOST_NAMED = 4
"""Quantities that a sentence names."""


@answers("Calibrated spectra", "spectra-calibrate")
def calibrated(result: Result) -> ResultAnswer:
    spectra = result["spectra"]
    made_up = "Synthetic. " if any(one.get("synthetic") for one in spectra) else ""
    return ResultAnswer(made_up + each(spectra, _one_calibrated, "spectrum", _calibrated_in_short))


def _one_calibrated(one: Result) -> str:
    if one.get("channels") is None:
        return f"{one['id']}: {one.get('status')}."
    masked = f", {one['channels_masked']} of them masked" if one.get("channels_masked") else ""
    status = "" if one.get("status") in FINE else f" Its status is: {one.get('status')}."
    return f"{one['id']} is calibrated to reflectance in {counted(one['channels'], 'channel')}{masked}.{status}"


def _calibrated_in_short(one: Result) -> str:
    return "calibrated to reflectance" if one.get("status") in FINE else str(one.get("status"))


@answers("Absorption bands", "spectra-bands")
def bands(result: Result) -> ResultAnswer:
    spectra = result["spectra"]
    if len(spectra) <= MOST_NAMED:
        return ResultAnswer(each(spectra, _one_bands, "spectrum"), trust=_depending(spectra))
    of_band = []
    for key, name in (("1000", "1 µm"), ("2000", "2 µm")):
        centres = [one[f"bc{key}_nm"] for one in spectra if one.get(f"bc{key}_nm") is not None]
        span = f", centred from {min(centres):.0f} to {max(centres):.0f} nm" if centres else ""
        of_band.append(f"{len(centres)} have a band near {name} that could be measured{span}")
    return ResultAnswer(f"Of {counted(len(spectra), 'spectrum')} {'; '.join(of_band)}.", trust=_depending(spectra))


def _depending(spectra: Sequence[Result]) -> str:
    """Of which bands the centre depends on the method more than on the noise."""
    named = [
        f"{one['id']} at {name}"
        for one in spectra
        for key, name in (("1000", "1 µm"), ("2000", "2 µm"))
        if str(one.get(f"band{key}_status")).startswith(DEPENDS)
    ]
    return f"{sentence(DEPENDS)[:-1]} more than on the noise: {some_of(named, MOST_NAMED)}." if named else ""


def _one_bands(one: Result) -> str:
    centres = [
        f"at {centre}, {measured(_times(one.get(f'bd{key}'), 100), _times(one.get(f'bd{key}_sigma'), 100), '%')} deep"
        for key, centre in centre_texts(one).items()
    ]
    if not centres:
        return f"{one['id']} has no absorption band near 1 or 2 µm that could be measured."
    return f"{one['id']} absorbs {' and '.join(centres)}. {sentence(bands_meaning(one))}"


def _times(value: Any, factor: float) -> Any:
    return None if value is None else factor * value


@answers("Minerals", "spectra-fit")
def fit(result: Result) -> ResultAnswer:
    return ResultAnswer(each(result["spectra"], _one_fit, "spectrum", _fit_in_short))


@answers("Shares of minerals", "spectra-unmix")
def unmixed(result: Result) -> ResultAnswer:
    without = [str(one["id"]) for one in result["spectra"] if not one["abundance"]["in_domain"]]
    caution = [f"Shares of {some_of(without, MOST_NAMED)} are to be quoted with their 95 % intervals alone."]
    answer = each(result["spectra"], _one_unmixed, "spectrum", _unmixed_in_short)
    return ResultAnswer(answer, trust=caution[0] if without else "")


def _one_unmixed(one: Result) -> str:
    return f"{one['id']}: {shares_verdict(one)}."


def _unmixed_in_short(one: Result) -> str:
    if one["kind"]["name"] == "weathered-soil":
        return "a weathered soil, whose minerals are not unmixed"
    if one["abundance"]["in_domain"]:
        return "in domain"
    return "out of domain, quote 95 % intervals alone" if _mineral_shares(one) else str(one["abundance"]["status"])


def _fit_in_short(one: Result) -> str:
    if (one.get("status") or "converged") not in FINE:
        return str(one["status"])
    chosen = one.get("choice") or {}
    minerals = standing_of(chosen) or one.get("assemblage", "bands")
    return f"{minerals}; shares of the minerals: {'determined' if _mineral_shares(one) else 'not determined'}"


def standing_of(choice: Mapping[str, Any]) -> str:
    """Which minerals are sure and which are open, as columns of the CSV have them; '' where nothing was chosen.

    >>> standing_of({"sure": ["olivine", "pyroxene"], "open": ["plagioclase"]})
    'sure: olivine, pyroxene; open: plagioclase'
    """
    if "sure" not in choice:
        return str(choice.get("status", ""))
    sure, left = ", ".join(choice["sure"]), ", ".join(choice["open"])
    return f"{f'sure: {sure}' if sure else 'no mineral is sure'}{f'; open: {left}' if left else ''}"


def _one_fit(one: Result) -> str:
    """What its command says below its tables, then which assemblages it does not distinguish, and the pyroxenes."""
    verdict = fit_verdict(one)
    family = (one.get("choice") or {}).get("family")
    first = "The" if (one.get("choice") or {}).get("strong", True) else "This is weak evidence: the"
    apart = f"{first} spectrum does not distinguish the assemblages"
    chosen = f" {apart} {', '.join(family)}." if family and len(family) > 1 else ""
    ratio = (one.get("nbsr") or {}).get("um2")
    strength = (
        f" Of the pyroxene bands at 2 µm, orthopyroxene makes {measured(ratio['opx'], ratio.get('sigma'))}."
        if ratio and (ratio.get("sigma") or 0) < UNIFORM
        else ""
    )
    return f"{one.get('id', 'the spectrum')}: {verdict}.{chosen}{strength}"


def _mineral_shares(one: Result) -> list[str]:
    return [
        f"{mineral} {percent(item['fraction'])} ({percent(item['low'])} to {percent(item['high'])})"
        for mineral, item in (one.get("abundance") or {}).items()
        if isinstance(item, Mapping) and plain(item.get("fraction")) is not None
    ]


@answers("Where the rock came from", "spectra-match")
def match(result: Result) -> ResultAnswer:
    rocks = result["rocks"]
    open_ones = [rock for rock in rocks if rock.get("best") is None]
    of = "" if len(open_ones) == len(rocks) else f" for {len(open_ones)} of {counted(len(rocks), 'rock')}"
    worth = f"The source is not decided{of}." if open_ones else ""
    where = " The site is taken to be Chang'E-4's; none was given." if result["site"].get("assumed") else ""
    return ResultAnswer(f"{each(rocks, _one_match, 'rock', _match_in_short)}{where}", trust=worth)


def _one_match(rock: Result) -> str:
    return f"{rock['id']}: {rock.get('status') or 'no crater stands out'}."


def _match_in_short(rock: Result) -> str:
    return str(rock.get("status") or "no crater stands out").partition(" (")[0].partition(":")[0]


@answers("Spectral indices", "spectra-indices")
def indices(result: Result) -> ResultAnswer:
    spectra, about_each = result.get("spectra", ()), result["indices"]
    if len(spectra) != 1:
        count = len(about_each)
        return ResultAnswer(f"{count} spectral indices of {counted(len(spectra), 'spectrum')}; the table has them.")
    usable = []
    for key, about in about_each.items():
        index = spectra[0].get(key) or {}
        if index.get("status") == "ok" and index.get("value") is not None:
            missed = about.get("soils_missed_by_median")
            off = f", off by {number(missed, 2)} in soils of known content" if missed else ""
            symbol = "" if about.get("unit") in (None, "-") else about["unit"]
            usable.append(
                ((missed or 0) > 0, f"{about['title']} {measured(index['value'], index.get('sigma'), symbol)}{off}")
            )
    usable.sort(key=lambda one: not one[0])
    first = "; ".join(text for _, text in usable[:MOST_NAMED])
    left = len(about_each) - len(usable)
    lost = f" {left} of {len(about_each)} could not be measured." if left else ""
    return ResultAnswer(f"{spectra[0]['id']}: {first or 'no index could be measured'}.{lost}")


@answers("A simulated observation", "spectra-simulate")
def simulated(result: Result) -> ResultAnswer:
    shares = ", ".join(f"{name} {percent(share)}" for name, share in result["composition"].items() if share)
    return ResultAnswer(
        f"Synthetic: {result['observation']} is made up of {shares}; rock covers {percent(result['rock_fraction'])} of "
        f"the view, {percent(result['shadow_fraction'])} lies in shadow."
    )


@answers("A spectral library, checked", "spectra-library-check")
def library_checked(result: Result) -> ResultAnswer:
    members = result["end_members"]
    bad = [one["id"] for one in members if one["must_mend"]]
    remarked = sum(bool(one["remarks"]) for one in members)
    noted = f" Remarks on {remarked} of them are below." if remarked else ""
    if bad:
        return ResultAnswer(f"{len(bad)} of {counted(len(members), 'end member')} must be mended before use.{noted}")
    return ResultAnswer(f"{counted(len(members), 'end member')}, fit for use.{noted}")


@answers("A spectral library", "spectra-library")
def library(result: Result) -> ResultAnswer:
    members = result["end_members"]
    minerals = dict.fromkeys(str(one.get("mineral") or "unknown") for one in members)
    return ResultAnswer(f"A library of {counted(len(members), 'spectrum')}: {', '.join(minerals)}.")


@answers("Maps of a cube", "spectra-map")
def mapped(result: Result) -> ResultAnswer:
    counts = result["pixels"]
    usable = counts["pixels"] - counts.get("no_data", 0)
    medians = {one["name"]: one for one in result["layers"] if one.get("median") is not None}
    layers = [one for name, one in medians.items() if not any(e in name for e in (*ERRORS, "share_"))]
    lines = _shares_mapped(medians)
    layers.sort(key=lambda one: not one["name"].startswith("bc"))
    for one in layers[:MOST_LAYERS]:
        symbol = "" if one.get("units") in (None, "1", "-") else f" {one['units']}"
        span = f"{number(float(one['p05']), 3)} to {number(float(one['p95']), 3)}"
        lines.append(
            f"{one['long_name']}: median {number(float(one['median']), 3)}{symbol}, {span}{symbol} in 90 % of the "
            f"pixels{_where_determined(one['determined'])}"
        )
    text = f" {sentence('; '.join(lines))}" if lines else " No pixel gave a value."
    return ResultAnswer(f"Of {counted(counts['pixels'], 'pixel')} {usable} could be used.{text}")


def _shares_mapped(medians: Mapping[str, Any]) -> list[str]:
    """The median share of each mineral, with the medians of the ends of its 95 % interval."""
    minerals = [mineral for mineral in WEIGHED if f"share_{mineral}" in medians]
    shares = [
        f"{mineral} {percent(medians[name]['median'])} "
        f"({' to '.join(percent(medians[f'{name}_{end}95']['median']) for end in ('low', 'high'))})"
        for mineral, name in ((one, f"share_{one}") for one in minerals)
    ]
    where = _where_determined(medians[f"share_{minerals[0]}"]["determined"]) if minerals else ""
    return [f"medians of shares, and of their 95 % intervals: {', '.join(shares)}{where}"] if shares else []


def _where_determined(share: float | None) -> str:
    return "" if share is None or percent(share) == percent(1.0) else f", of the {percent(share)} that have one"


@answers("A pixel of a cube", "spectra-pixel")
def pixel(result: Result) -> ResultAnswer:
    channels = [value for value in result["reflectance"] if value is not None]
    flags = f" It is marked: {', '.join(result['flags'])}." if result.get("flags") else ""
    return ResultAnswer(
        f"The spectrum of {result['id']}, {len(channels)} of {counted(len(result['reflectance']), 'channel')}.{flags}"
    )
