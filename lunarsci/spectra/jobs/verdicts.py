"""One sentence about a spectrum: what its bands, its fit or its shares say, what they do not, and what to do next.

Made of the keys of `--json`, so that it says no more than they do.
"""

from collections.abc import Mapping
from typing import Any

SEEN = 2.0
"""A band is seen where its strength is this many standard errors off 0; assumed."""
SURE = 0.93
"""Probability from which something is called sure, as of `Choice.family`; assumed."""
NAMES = {
    "fo": "Fo of olivine",
    "fs": "Fs of orthopyroxene",
    "wo": "Wo of clinopyroxene",
    "fs_cpx": "Fs of clinopyroxene",
}
MINERALS = ("olivine", "orthopyroxene", "clinopyroxene", "plagioclase")


def bands_verdict(record: Mapping[str, Any]) -> str:
    """What the centres of `spectra bands` say."""
    one, two = record["bc1000_nm"] is not None, record["bc2000_nm"] is not None
    chemistry = [item for item in (record["chemistry"] or {}).values() if item]
    alone = any("pyroxene without olivine" in item["domain"] and item["in_range"] for item in chemistry)
    if not (one or two):
        return "no band, so nothing is said of its minerals"
    if one and not two:
        return (
            "a 1 µm band and none at 2 µm: olivine, or a pyroxene whose 2 µm band is hidden; `spectra fit` looks closer"
        )
    if two and not one:
        return "a 2 µm band alone: pyroxene is there, no more is said"
    if alone:
        return (
            "pyroxene; its centres are those of pyroxenes without olivine, but some olivine is not ruled out; quote "
            "only lines above whose condition you know to hold"
        )
    return "pyroxene; the centres are not those of one pyroxene alone: olivine or several pyroxenes; `spectra fit` next"


def fit_verdict(record: Mapping[str, Any]) -> str:
    """What a fit, or a choice between assemblages, says."""
    if not record["bands"]:
        return f"no fit: {record['status']}"
    parts = [_chosen(record["choice"]) if record["choice"] else _assumed(record)]
    status = str(record["status"])
    if status != "converged":
        parts.append(f"in doubt, {status.partition('; ')[2] or status}")
    known = [f"{NAMES[key]} {item['mean']:.0f} ± {item['sigma']:.0f}" for key, item in _told(record)]
    sure = status == "converged" and bool(record["choice"] and record["choice"]["strong"])
    parts += [f"{'' if sure else 'if so, '}{', '.join(known)} mol %"] if known else ["no composition is told"]
    return "; ".join(parts)


def _told(record: Mapping[str, Any]) -> list[tuple[str, Mapping[str, Any]]]:
    """Compositions in range that the spectrum, and not the prior alone, tells."""
    from lunarsci.result import from_prior

    return [
        (key, item)
        for key, item in record["compositions"].items()
        if item["mean"] is not None and item["in_range"] and not from_prior(item["sigma"], item["prior_sigma"])
    ]


def _chosen(choice: Mapping[str, Any]) -> str:
    chances = choice["mineral_probability"]
    sure = [mineral for mineral, chance in chances.items() if chance >= SURE]
    absent = [mineral for mineral, chance in chances.items() if chance <= 1 - SURE]
    left = [f"{mineral} ({100 * chance:.0f} %)" for mineral, chance in chances.items() if 1 - SURE < chance < SURE]
    parts = [f"sure: {', '.join(sure)}" if sure else "no mineral is sure"]
    parts += [f"open: {', '.join(left)}"] if left else []
    return "; ".join([*parts, *([f"not needed: {', '.join(absent)}"] if absent else [])])


def _assumed(record: Mapping[str, Any]) -> str:
    """Of the minerals that were assumed, which have a band that is surely there."""
    found: dict[str, float] = {}
    for band in record["bands"]:
        if band["mineral"] in MINERALS and band["strength_sigma"] > 0:
            depth = -band["strength"] / band["strength_sigma"]
            found[band["mineral"]] = max(found.get(band["mineral"], 0.0), depth)
    seen = [mineral for mineral, depth in found.items() if depth >= SEEN]
    unseen = [mineral for mineral, depth in found.items() if depth < SEEN]
    parts = [f"bands of {', '.join(seen)}" if seen else "no band of any mineral"]
    parts += [f"none of {', '.join(unseen)}"] if unseen and seen else []
    which = f"{record['assemblage']} was assumed, others may fit as well (`--assemblage auto` compares them)"
    return f"{which}: {', '.join(parts)}"


def shares_verdict(record: Mapping[str, Any]) -> str:
    """What the shares of `spectra unmix` say, and which of them may be quoted."""
    kind, shares = record["kind"], record["abundance"]
    if not kind:
        return f"no shares: {record['status']}"
    weights = {name: chance for name, chance in kind["probabilities"].items() if chance > 1 - SURE}
    parts = []
    if not kind["stated"] and max(weights.values(), default=0.0) < SURE:
        shown = ", ".join(f"{name} {100 * chance:.0f} %" for name, chance in weights.items())
        parts.append(f"the kind is not decided ({shown}), state `--kind` if you know it")
    if record["normative"]:
        parts.append("no shares of minerals: as a weathered soil it has a composition by regression, above")
    elif not shares:
        parts.append("no shares")
    else:
        inside = [one for one in record["abundances"].values() if one["in_domain"]]
        for one in inside:
            values = [f"{name} {_percent(one[name])}" for name in MINERALS if name in one]
            parts.append(f"to be quoted, by `{one['method']}`, with its interval: {', '.join(values)}")
        parts += [] if inside else [f"no share to be quoted: {shares['status'].removeprefix('out of domain: ')}"]
    if kind["name"] == "solid-rock":
        parts.append("what is known of rocks: docs/validation/rock.md")
    return "; ".join(parts)


def _percent(share: Mapping[str, Any]) -> str:
    value = "not determined" if share["fraction"] is None else f"{100 * share['fraction']:.0f} %"
    return f"{value} (95 %: {100 * share['low95']:.0f} to {100 * share['high95']:.0f})"
