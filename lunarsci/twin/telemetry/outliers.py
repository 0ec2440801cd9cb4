"""Positions and headings that fit no motion of the wheels: left out, or held by a slide while the wheels stand.

One that is wrong alone is left out. Where all from some halt on are off by the same way, the rover slid there, or
positions are of another frame from then on: the motion may move at that halt as positions say, and slips are found on
either side of it.
"""

import dataclasses
from typing import NamedTuple

import numpy as np

from lunarsci.arrays import FloatArray, IndexArray
from lunarsci.twin.telemetry.filter import Nodes
from lunarsci.twin.telemetry.reading import Findings
from lunarsci.twin.telemetry.smoother import SlipProcess, Smoothed, smooth

OUTLIER = 20.0
"""Mahalanobis distance squared from which a position is left out: once in 22 000 by chance (chi-square, 2 degrees).
Assumed."""
MOST_OUTLIERS = 0.2
"""Share of the positions left out beyond which the result is in doubt; assumed."""
COARSE, FINE, UNKNOWN_LENGTHS_M = np.array([0.1, 0.1, 0.05]), np.array([0.03, 0.03, 0.05]), np.full(3, 0.7)
"""How slip changes on ground that is not known yet, first widely, then as on ground of some degrees; assumed."""
SLIDE_M = 1.0
"""What a rover may move by while its wheels stand, where positions say that it does; assumed wide. [m]"""


class Kept(NamedTuple):
    """Nodes without what fits no motion, their motion, and which positions (by node) and headings are left out."""

    nodes: Nodes
    smoothed: Smoothed
    left: tuple[int, ...]
    odd: tuple[int, ...]


def without_outliers(nodes: Nodes, findings: Findings) -> tuple[Smoothed, Nodes, FloatArray]:
    """The motion, its nodes without positions and headings that fit none, and those positions: time, x, y. (o, 3)

    A halt is left free to slide while fewer positions are left out for it; `Nodes.loose` has it then.
    """
    every = nodes
    fixes = np.flatnonzero(np.isfinite(nodes.fix_m).all(axis=1))
    kept, slides = _kept(nodes), list[tuple[int, int]]()
    while kept.left:
        halts = _halts_beside(kept.left, fixes, kept.nodes)
        tried = [(halt, _kept(_free(nodes, halt))) for halt in halts]
        if not tried or len((best := min(tried, key=lambda one: len(one[1].left)))[1].left) >= len(kept.left):
            break
        nodes, kept = _free(nodes, best[0]), best[1]
        slides.append(best[0])
    for first, last in slides:
        _say_slide(kept, first, last, findings)
    slipped = any(_fit_on_another_way(nodes, kept, run, fixes) for run in _runs(kept.left, fixes))
    _say_left(kept, every, fixes, slipped, findings)
    left = np.array(sorted(kept.left), dtype=np.intp)
    return kept.smoothed, kept.nodes, np.column_stack([every.time_s[left], every.fix_m[left]])


def _kept(nodes: Nodes) -> Kept:
    """Smooth, leave out the worst position while it fits no motion, smooth again."""
    count = int(np.isfinite(nodes.fix_m).all(axis=1).sum())
    left: list[int] = []
    odd: list[int] = []
    wide, narrow = (SlipProcess.fixed(amplitude, UNKNOWN_LENGTHS_M) for amplitude in (COARSE, FINE))
    for change in (wide, narrow):
        smoothed = smooth(nodes, change)
        nodes, smoothed, lost = _without_odd_headings(nodes, smoothed)
        odd += lost
        while count - len(left) > 3 and np.nanmax(far := _judged(smoothed, ends=change is wide)) > OUTLIER:
            worst = int(np.nanargmax(far))
            left.append(worst)
            fix = nodes.fix_m.copy()
            fix[worst] = np.nan
            nodes = dataclasses.replace(nodes, fix_m=fix)
            smoothed = smooth(nodes, smoothed.change)
            if len(left) > max(3, MOST_OUTLIERS * count):
                break
    return Kept(nodes, smoothed, tuple(left), tuple(odd))


def _judged(smoothed: Smoothed, *, ends: bool) -> FloatArray:
    """Squared distances of positions, those of the first and the last one only where `ends` are to be judged.

    Slip may change most there: no position behind says how it went on.
    """
    distance = smoothed.squared_distance.copy()
    known = np.flatnonzero(np.isfinite(distance))
    if not ends:
        distance[known[[0, -1]]] = np.nan
    return distance


def _without_odd_headings(nodes: Nodes, smoothed: Smoothed) -> tuple[Nodes, Smoothed, list[int]]:
    """Leave out the worst heading while it fits no motion; with the nodes of those left out."""
    odd: list[int] = []
    while np.nanmax(smoothed.yaw_squared_distance) > OUTLIER and len(odd) <= MOST_OUTLIERS * len(nodes.time_s):
        worst = int(np.nanargmax(smoothed.yaw_squared_distance))
        odd.append(worst)
        yaw = nodes.yaw_rad.copy()
        yaw[worst] = np.nan
        nodes = dataclasses.replace(nodes, yaw_rad=yaw)
        smoothed = smooth(nodes, smoothed.change)
    return nodes, smoothed, odd


def _halts_beside(left: tuple[int, ...], fixes: IndexArray, nodes: Nodes) -> list[tuple[int, int]]:
    """First and last node of each halt between positions that are left out and the next ones that are kept."""
    still = np.append(np.append(False, (nodes.way_m == 0.0) & (nodes.loose == 0.0)), False)
    firsts, lasts = np.flatnonzero(still[1:] & ~still[:-1]), np.flatnonzero(still[:-1] & ~still[1:])
    kept = np.setdiff1d(fixes, left)
    spans = set()
    for one in left:
        at = int(np.searchsorted(kept, one))
        spans.add((kept[at - 1] if at else 0, kept[at] if at < len(kept) else len(nodes.time_s) - 1))
    halts = [(int(a), int(b)) for a, b in zip(firsts, lasts, strict=True)]
    return [halt for halt in halts if any(low < halt[1] and halt[0] < high for low, high in spans)]


def _runs(left: tuple[int, ...], fixes: IndexArray) -> list[IndexArray]:
    """Positions that are left out one after the other, as places in `fixes`."""
    out = np.flatnonzero(np.isin(fixes, left))
    return np.split(out, np.flatnonzero(np.diff(out) > 1) + 1) if out.size else []


def _fit_on_another_way(nodes: Nodes, kept: Kept, run: IndexArray, fixes: IndexArray) -> bool:
    """Whether they fit with all that are kept if the rover moves as it likes just before them, or just behind."""
    fix = kept.nodes.fix_m.copy()
    fix[fixes[run]] = nodes.fix_m[fixes[run]]
    whole = dataclasses.replace(kept.nodes, fix_m=fix)
    ways = [(fixes[k], fixes[k + 1]) for k in (run[0] - 1, run[-1]) if 0 <= k < len(fixes) - 1]
    tried = (smooth(_free(whole, way), SlipProcess.fixed(COARSE, UNKNOWN_LENGTHS_M)) for way in ways)
    return any(np.nanmax(one.squared_distance) <= OUTLIER for one in tried)


def _free(nodes: Nodes, halt: tuple[int, int]) -> Nodes:
    """With a halt, or a way, on which the rover may slide."""
    loose = nodes.loose.copy()
    loose[halt[0] : halt[1]] = SLIDE_M
    return dataclasses.replace(nodes, loose=loose)


def _say_slide(kept: Kept, first: int, last: int, findings: Findings) -> None:
    place, times = kept.smoothed.state[[first, last], :2], kept.nodes.time_s[[first, last]]
    way = float(np.hypot(*(place[1] - place[0])))
    findings.add(
        "slide at a halt",
        f"the rover moves {way:.2g} m between {times[0]:.6g} and {times[1]:.6g} s by its positions while its wheels "
        "stand: it slid, or positions are of another frame from then on",
        "the motion holds it, and slips are found on either side of it; find out which it was",
        time_s=float(times[0]),
        doubt=True,
    )


def _say_left(kept: Kept, every: Nodes, fixes: IndexArray, slipped: bool, findings: Findings) -> None:
    """`slipped` is whether one piece of the way on which slip is another would hold positions that are left out."""
    if kept.odd:
        many = len(kept.odd) > MOST_OUTLIERS * len(every.time_s)
        what = f"{len(kept.odd)} headings fit no motion of the wheels"
        first = float(every.time_s[min(kept.odd)])
        findings.add("odd heading", what, "left out", count=len(kept.odd), time_s=first, doubt=many)
    if kept.left:
        what, done = f"{len(kept.left)} of {len(fixes)} positions fit no motion of the wheels", "left out"
        end = bool({int(fixes[0]), int(fixes[-1])} & set(kept.left))
        if end:
            which = "last" if int(fixes[-1]) in kept.left else "first"
            what += f", the {which} one too"
            done += ": none beyond it tells whether it is wrong, or the rover went there and the motion is wrong"
        if slipped:
            done += "; they would if the rover slipped suddenly beside one of them, and slips there are wrong then"
        many = len(kept.left) > MOST_OUTLIERS * len(fixes)
        doubt, first = many or end or slipped, float(every.time_s[min(kept.left)])
        findings.add("position jump", what, done, count=len(kept.left), time_s=first, doubt=doubt)
