"""Pictures that are drawn from a result's JSON and tables, with words for those who do not see them."""

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeAlias

import numpy as np

from lunarsci.arrays import FloatArray
from lunarsci.figure import (
    BLUE,
    DOT_STYLES,
    INK,
    LINE_STYLES,
    SKY,
    VERMILION,
    as_label,
    legend_below,
    page,
    picture_bytes,
    styled,
)
from lunarsci.pages.documents import Document
from lunarsci.pages.drive_answers import interval_of
from lunarsci.pages.words import NAMES, number, words

if TYPE_CHECKING:
    from matplotlib.figure import Figure

MOST_SPECTRA, MOST_BARS, MOST_USED = 6, 18, 5.0
"""Spectra and bars that a chart has at most, and the largest share of a limit that is drawn, in limits; assumed."""


@dataclass(frozen=True, slots=True)
class Chart:
    """A picture of the page.

    Attributes
    ----------
    title : what it is called.
    words : what it shows, for those who do not see it.
    content : of its file.
    suffix : of its file.
    """

    title: str
    words: str
    content: bytes
    suffix: str = ".svg"


def charts(document: Document) -> Iterator[Chart]:
    """Pictures of a result; none of kinds that are best read as tables."""
    for draw in CHARTS.get(document.kind, ()):
        with styled():
            made = draw(document)
            if made is not None:
                title, text, figure = made
                yield Chart(title, text, picture_bytes([figure], Path("page.svg")))


Drawn: TypeAlias = "tuple[str, str, Figure] | None"


WIDTH_IN = 4.6
"""Width of charts. [in]"""


def _axes(height: float = 3.3) -> "tuple[Figure, Any]":
    figure = page(height, WIDTH_IN)
    return figure, figure.subplots()


def _spectra(document: Document) -> Drawn:
    figure, axes = _axes()
    spectra = [one for one in document.result["spectra"] if one.get("wavelength_nm")][:MOST_SPECTRA]
    for number_, one in enumerate(spectra):
        x, y, error = (np.array(one[key], float) for key in ("wavelength_nm", "reflectance", "reflectance_sigma"))
        look: Any = LINE_STYLES[number_ % len(LINE_STYLES)]
        axes.fill_between(x, y - error, y + error, color=look["color"], alpha=0.25, linewidth=0)
        axes.plot(x, y, label=as_label(one["id"]), **look)
    if not spectra:
        return None
    axes.set(xlabel="wavelength [nm]", ylabel="reflectance factor [-]")
    legend_below(figure, axes, 2)
    names = ", ".join(str(one["id"]) for one in spectra)
    text = f"Reflectance over wavelength of {names}; the bands are one standard error of the noise."
    return "Calibrated spectra", text, figure


def _centres(document: Document) -> Drawn:
    """Depth over centre of the bands of each spectrum, with errors."""
    spectra = document.result["spectra"]
    figure, axes = _axes()
    centres = []
    for key, name, look in (("1000", "1 µm", DOT_STYLES[0]), ("2000", "2 µm", DOT_STYLES[1])):
        measured = [one for one in spectra if None not in (one.get(f"bc{key}_nm"), one.get(f"bd{key}"))]
        if measured:
            at, depth, error, of_depth = _columns(
                measured, f"bc{key}_nm", f"bd{key}", f"bc{key}_sigma_nm", f"bd{key}_sigma"
            )
            axes.errorbar(at, depth, of_depth, error, linestyle="", capsize=2, label=f"{name} band", **look)
            centres.append(f"{name}: " + ", ".join(f"{number(one[f'bc{key}_nm'])} nm" for one in measured[:MOST_BARS]))
    if not centres:
        return None
    axes.set(xlabel="centre of the band [nm]", ylabel="depth [-]", ylim=(0, None))
    axes.legend()
    return (
        "Absorption bands",
        f"Depth over centre of the bands, with standard errors. Centres: {'; '.join(centres)}.",
        figure,
    )


def _columns(records: Sequence[Mapping[str, Any]], *names: str) -> Iterator[FloatArray]:
    """Numbers of records, (n,) each, NaN where there is none."""
    return (np.array([one.get(name) for one in records], float) for name in names)


def _absorptions(document: Document) -> Drawn:
    figure, axes = _axes()
    spectra = [one for one in document.result["spectra"] if one.get("bands")][:1]
    if not spectra:
        return None
    minerals: dict[str, list[Mapping[str, Any]]] = {}
    for band in spectra[0]["bands"]:
        minerals.setdefault(band["mineral"], []).append(band)
    for place, (mineral, bands) in enumerate(minerals.items()):
        look = DOT_STYLES[place % len(DOT_STYLES)]
        at, strength, width, error = _columns(bands, "center_nm", "strength", "fwhm_nm", "strength_sigma")
        error[error >= 3 * np.abs(strength)] = np.nan  # of what is not determined none
        axes.errorbar(at, -strength, xerr=width / 2, fmt="none", ecolor=look["color"], alpha=0.35, linewidth=3)
        label = "visible and UV" if mineral == "any" else as_label(mineral)
        axes.errorbar(at, -strength, error, linestyle="", capsize=2, label=label, **look)
    axes.set(xlabel="centre of the band [nm]", ylabel="strength, ln R [-]", ylim=(0, None))
    legend_below(figure, axes, 4)
    text = "; ".join(
        f"{band['name']} at {number(band['center_nm'])} nm" for bands in minerals.values() for band in bands
    )
    return (
        f"Bands of {spectra[0]['id']}",
        f"Centre and strength of each band; wide bars: full width at half maximum, thin ones: errors. {text}.",
        figure,
    )


def _shares(document: Document) -> Drawn:
    rows = [
        (f"{one['id']}, {mineral}", item)
        for one in document.result["spectra"]
        for mineral, item in (one.get("abundance") or {}).items()
        if isinstance(item, Mapping) and item.get("fraction") is not None
    ][:MOST_BARS]
    if not rows:
        return None
    outside = any((one.get("abundance") or {}).get("in_domain") is False for one in document.result["spectra"])
    title = "Shares of minerals, out of the domain of the method" if outside else "Shares of minerals"
    intervals = [(name, item["fraction"], item["low"], item["high"]) for name, item in rows]
    return title, _intervals_text(title, intervals), _interval_figure(intervals, "share [-]", (0.0, 1.0))


def _intervals_text(title: str, intervals: Any) -> str:
    each = [f"{name} {number(mid, 3)} ({number(low, 3)} to {number(high, 3)})" for name, mid, low, high in intervals]
    return f"{title}: {'; '.join(each)}."


def _interval_figure(rows: Any, label: str, limits: tuple[float, float] | None = None) -> "Figure":
    figure, axes = _axes(height=0.9 + 0.32 * len(rows))
    for place, (_, middle, low, high) in enumerate(rows):
        axes.plot(
            [low, high], [-place, -place], color=DOT_STYLES[0]["color"], linewidth=3, alpha=0.5, solid_capstyle="butt"
        )
        axes.plot(middle, -place, "o", color=INK, markersize=5)
    axes.set_yticks([-place for place in range(len(rows))], [as_label(row[0]) for row in rows])
    axes.set(xlabel=label, ylim=(-len(rows) + 0.5, 0.5))
    if limits:
        axes.set_xlim(*limits)
    return figure


def _craters(document: Document) -> Drawn:
    rocks = document.result["rocks"]
    if not rocks or not rocks[0]["craters"]:
        return None
    rock = rocks[0]
    items = sorted((one for one in rock["craters"] if not one["contains_site"]), key=lambda one: -one["posterior"])[
        :MOST_BARS
    ]
    figure, axes = _axes(height=1.0 + 0.36 * len(items))
    place = [-float(k) for k in range(len(items))]
    bars = (
        ("prior", 0.2, "#c9ced2", "before: position, age and ejecta"),
        ("posterior", -0.2, BLUE, "after: with composition"),
    )
    for key, up, color, label in bars:
        at, sizes = [y + up for y in place], [one[key] for one in items]
        axes.barh(at, sizes, 0.36, color=color, edgecolor=INK, linewidth=0.5, label=label)
    axes.set_yticks(place, [as_label(one["name"]) for one in items])
    axes.set_xlabel("probability [-]")
    legend_below(figure, axes, 2)
    text = "; ".join(f"{one['name']} {number(one['posterior'], 2)}" for one in items)
    return (
        f"Where {rock['id']} came from",
        f"Probability of each crater before and after its composition was looked at. After: {text}.",
        figure,
    )


def _soil_curves(document: Document) -> Drawn:
    panels = (
        ("bearing", "exponent", "stiffness_kpa_m_n"),
        ("shear", "cohesion_pa", "friction_angle_deg"),
        ("lateral", "lateral_modulus_mm", "external_friction_angle_deg"),
    )
    drawn = [
        (document.result[name]["curve"], x, y)
        for name, x, y in panels
        if (document.result.get(name) or {}).get("curve")
    ]
    if not drawn:
        return None
    figure = page(2.6 * len(drawn), WIDTH_IN)
    for axes, (curve, x, y) in zip(figure.subplots(len(drawn), 1, squeeze=False)[:, 0], drawn, strict=True):
        points = [point for point in curve if None not in (point[y], point["low"], point["high"])]
        at, middle, low, high = _columns(points, x, y, "low", "high")
        axes.fill_between(at, low, high, color=BLUE, alpha=0.25, linewidth=0)
        axes.plot(at, middle, color=BLUE)
        axes.set(xlabel=_label(x), ylabel=_label(y))
    alone = "joint" in document.result
    return (
        "What each state allows by itself" if alone else "What these states allow",
        f"{'Of each state by itself: p' if alone else 'P'}airs of parameters that explain the wheel states, "
        "with bands of 95 %: one of each pair must be known.",
        figure,
    )


def _label(key: str) -> str:
    return {"exponent": "sinkage exponent N [-]"}.get(
        key,
        NAMES.get(key, words(key))
        .replace("K_s", "K$_s$")
        .replace("K_x", "K$_x$")
        .replace("K_y", "K$_y$")
        .replace("m^N", "m$^N$")
        .replace("φ_y", "φ$_y$"),
    )


def _left_of_prior(document: Document) -> Drawn:
    parameters = (document.result.get("joint") or document.result).get("parameters") or (
        document.result.get("drives") or [{}]
    )[-1].get("parameters")
    left = {name: one.get("left_of_prior", _unshrunk(one)) for name, one in (parameters or {}).items()}
    rows = [(name, share) for name, share in left.items() if share is not None]
    if not rows:
        return None
    figure, axes = _axes(height=0.9 + 0.32 * len(rows))
    place = [-float(k) for k in range(len(rows))]
    axes.barh(place, [share for _, share in rows], 0.6, color=SKY, edgecolor=INK, linewidth=0.5)
    axes.axvline(1.0, color=INK, linestyle="--")
    axes.set_yticks(place, [_label(name).partition(" [")[0] for name, _ in rows])
    axes.set_xlabel("spread now / spread before any drive [-]\n1: nothing learned")
    text = "; ".join(f"{words(name).partition(' [')[0]} {number(share, 2)}" for name, share in rows)
    return "What was learned of the soil", f"Spread of each parameter as a part of what it was before: {text}.", figure


def _unshrunk(parameter: Mapping[str, Any]) -> float | None:
    """Width left of the prior's: the key `shrinkage` of soils is 1 less it, a ratio of standard deviations."""
    shrinkage = parameter.get("shrinkage")
    return None if shrinkage is None else 1.0 - float(shrinkage)


def _limits(document: Document) -> Drawn:
    rows = [
        one
        for one in document.result["limits"]
        if one.get("limit") and None not in (one.get("p50"), one.get("min"), one.get("max"))
    ]
    if not rows:
        return None
    figure, axes = _axes(height=1.0 + 0.4 * len(rows))
    for place, one in enumerate(rows):
        low, middle, high = sorted(_used(one, one[key]) for key in ("min", "p50", "max"))
        axes.plot(
            [low, high],
            [-place, -place],
            color=BLUE if one["ok"] else VERMILION,
            linewidth=5,
            alpha=0.6,
            solid_capstyle="butt",
        )
        axes.plot(middle, -place, "o" if one["ok"] else "X", color=INK)
    axes.axvline(1.0, color=INK, linestyle="--")
    axes.set_yticks(
        [-k for k in range(len(rows))],
        [words(one["quantity"]).partition(" [")[0] + ("" if one["ok"] else " (broken)") for one in rows],
    )
    axes.set(xlabel="share of the limit used [-]; above 1: broken", ylim=(-len(rows) + 0.5, 0.5), xlim=(0, None))
    text = "; ".join(
        f"{words(one['quantity']).partition(' [')[0]} {number(max(_used(one, one['min']), _used(one, one['max'])), 2)}"
        for one in rows
    )
    return (
        "How near the drives come to the limits",
        f"Share of each limit that the predicted drives use, least, median and most: {text} at most.",
        figure,
    )


def _used(limit: Mapping[str, Any], value: float) -> float:
    bound = float(limit["limit"])
    if limit.get("sense") == "at least":
        return min(bound / value, MOST_USED) if value > 0 else MOST_USED
    return min(abs(value / bound), MOST_USED)


def _wheel_states(document: Document) -> Drawn:
    rows = document.table("states")
    wheels = list(dict.fromkeys(row["wheel"] for row in rows if row.get("wheel")))
    if not wheels or "slip_ratio" not in rows[0] or "distance_m" not in rows[0] or "member" in rows[0]:
        return None
    figure = page(5.2, WIDTH_IN)
    for axes, (name, label, factor) in zip(
        figure.subplots(2, 1, sharex=True),
        (("slip_ratio", "slip ratio [-]", 1.0), ("sinkage_m", "sinkage [mm]", 1e3)),
        strict=True,
    ):
        for place, wheel in enumerate(wheels[: len(DOT_STYLES)]):
            of_wheel = [row for row in rows if row["wheel"] == wheel and row.get(name)]
            axes.plot(
                [float(row["distance_m"]) for row in of_wheel],
                [factor * float(row[name]) for row in of_wheel],
                linewidth=0.8,
                markersize=4,
                label=as_label(wheel),
                **(LINE_STYLES[place] | DOT_STYLES[place]),
            )
        axes.set_ylabel(label)
    axes.set_xlabel("way of the wheel [m]")
    legend_below(figure, figure.axes[0], 6)
    return (
        "Wheel states along the drive",
        f"Slip and sinkage against the way of each of the wheels {', '.join(wheels)}.",
        figure,
    )


def _wheel_loads(document: Document) -> Drawn:
    rows = [
        (f"{one['wheel']}, {words(key).partition(' [')[0]}", *interval)
        for key in ("normal_force_n", "drawbar_pull_n", "lateral_force_n")
        for one in document.result["wheels"]
        if (interval := interval_of(one[key]))
    ]
    if not rows:
        return None
    text = _intervals_text("Middle of each force, and its 5 % to 95 % along the way, or its standard error", rows)
    return "Forces of the wheels", text, _interval_figure(rows, "force [N]")


CHARTS: dict[str, tuple[Callable[[Document], Any], ...]] = {
    "spectra-bands": (_centres,),
    "spectra-calibrate": (_spectra,),
    "spectra-simulate": (),
    "spectra-fit": (_absorptions, _shares),
    "spectra-unmix": (_shares,),
    "spectra-match": (_craters,),
    "regolith-identify": (_left_of_prior, _soil_curves),
    "twin-predict": (_limits,),
    "twin-states": (_wheel_states,),
    "twin-forces": (_wheel_loads,),
    "twin-update": (_left_of_prior,),
    "twin-history": (_left_of_prior,),
}
