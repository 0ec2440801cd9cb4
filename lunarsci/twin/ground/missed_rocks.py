"""Rocks that a search may have missed along a way.

A search states which share of rocks it finds, by size and range. With how many it found follows how many there are, and
so how probable it is that one that stops a wheel lies on a way and was not found.
"""

import math
from collections.abc import Mapping
from typing import Any

import numpy as np

from lunarsci.arrays import FloatArray
from lunarsci.errors import DataError
from lunarsci.io.inputs import InputFile, read_json
from lunarsci.twin.ground.hazards import highest_m

FLATNESS = 0.45
"""Height over diameter of a rock whose diameter is known: the middle of those of `images rocks` (Golombek & Rapp 1997,
10.1029/96JE03319)."""


def missed_rocks(source: InputFile, places_m: FloatArray, width_m: float, stops_m: float) -> str | None:
    """What a search for rocks may have missed along a way (n, 2) [m]; None for a file that says nothing of a search.

    Rocks as high as `stops_m` stop a wheel. Their number on a square metre is that of those found, over the share that
    is found (at least 0.05: assumed), and half a one (Jeffreys); those missed on the way, as wide as `width_m`, follow
    Poisson's law. Beyond the ranges that were searched nothing was found. Raises DataError.
    """
    document = read_json(source, "a GeoJSON file of ground to keep out of", dict)
    search = document.get("searched")
    if not isinstance(search, Mapping) or not search.get("completeness"):
        return None
    try:
        return f"{_missed(document, search, places_m, width_m, stops_m)} ({source.name})"
    except (LookupError, TypeError, ValueError, AttributeError, ArithmeticError) as error:
        raise DataError(f"{source.name}: `searched` is not that of `images rocks` ({error}); leave it out") from error


def _missed(document: Any, search: Any, places_m: FloatArray, width_m: float, stops_m: float) -> str:
    """`missed_rocks` of a record of a search."""
    diameter, keys = stops_m / FLATNESS, ("diameter_m", "range_from_m", "range_to_m", "share")
    rows = [[row[key] for key in keys] for row in search["completeness"]]
    size = max((row[0] for row in rows if row[0] <= diameter), default=min(rows)[0])
    shares = [row[1:] for row in rows if row[0] == size]
    camera = np.array(search["camera_m"], dtype=float)
    steps = np.hypot(*np.diff(places_m, axis=0).T)
    away = np.hypot(np.hypot(*(0.5 * (places_m[1:] + places_m[:-1]) - camera[:2]).T), camera[2])
    share = np.zeros(len(steps))
    for low, high, value in shares:
        share[(away >= low) & (away < high)] = value
    listed = [feature.get("properties") or {} for feature in document["features"]]
    large = sum(float(one.get("diameter_m", 0.0)) >= diameter for one in listed)
    high = sum(not highest_m(one) <= stops_m for one in listed)
    density = (large + 0.5) / float(search["area_m2"]) / max(float(np.mean([v for *_, v in shares])), 0.05)
    chance = 1.0 - math.exp(-density * width_m * float((steps * (1.0 - share)).sum()))
    ends = " to ".join(dict.fromkeys(f"{100 * v:.0f} %" for v in (share.min(initial=1.0), share.max(initial=0.0))))
    farthest = max(row[1] for row in shares)
    return (
        f"{high} of {len(listed)} rocks may be higher than the {100 * stops_m:.0f} cm that wheels climb, and are kept "
        f"out of; of rocks of that height the search finds {ends} along the way (0 % beyond {farthest:g} m of the "
        f"camera); the chance that one was missed there is {100 * chance:.0f} %"
    )
