"""The picture of a match: candidate craters around the site, and what prior and composition say of each."""

from collections.abc import Iterator, Sequence
from typing import Any

import numpy as np
from matplotlib import colormaps
from matplotlib.colors import Normalize
from matplotlib.figure import Figure

from lunarsci.arrays import FloatArray
from lunarsci.figure import INK, LETTER_PT, PAGE_IN, as_label, headline, legend_below, name_points, page
from lunarsci.spectra.origin.catalogue import Point, azimuth_deg, destination, distance_km
from lunarsci.spectra.origin.match import OTHER, CraterMatch, RockMatch

HOST, PRIOR = "0.45", "#bfc7cd"
COLORS = "YlGnBu"
PALEST = 0.25
NEAREST = 4
MOST_SHOWN = 14
WIDEST_RAY = 5.0
ALIKE = 1.5
"""A map that reaches less than so many times as far as the one near the site would show the same; it is left out."""


def match_pages(matches: Sequence[RockMatch], site: Point) -> Iterator[Figure]:
    """One page per rock: all craters, those near the site, and below bars of prior, posterior and ln Bayes factor.

    Maps are azimuthal equidistant about the site: distances and directions from it are true, circles are rims.
    """
    for match in matches:
        scale = Normalize(0, max(0.05, *(item.posterior for item in match.craters)))
        distances = sorted(item.prior.distance_km + item.crater.diameter_km / 2 for item in match.craters)
        outside = sorted(item.prior.distance_km + item.crater.diameter_km / 2 for item in _delivering(match))
        farthest, reach = 1.12 * distances[-1], 1.12 * outside[:NEAREST][-1]
        maps = [("all candidates", farthest, reach)] if farthest > ALIKE * reach else []
        maps.append(("near the site", reach, 0.0) if maps else ("all candidates", farthest, 0.0))
        rows = min(len(outside), MOST_SHOWN) + 1
        figure = page(3.9 + 1.2 + 0.26 * rows)
        parts: Any = figure.subfigures(2, 1, height_ratios=(3.7, 1.2 + 0.26 * rows))
        above, below = parts
        panels, named = above.subplots(1, len(maps), squeeze=False)[0], {}
        for axes, (title, far, unnamed) in zip(panels, maps, strict=True):
            named[axes] = _draw_map(axes, match, site, scale, far, title, unnamed)
        legend_below(above, panels)
        _draw_bars(below, match, scale)
        headline(figure, f"{as_label(match.rock.id, 60)}: {match.status}")
        name_points(figure, named)
        yield figure


def _delivering(match: RockMatch) -> list[CraterMatch]:
    return [item for item in match.craters if not item.contains_site]


def _color(scale: Normalize, posterior: float) -> Any:
    return colormaps[COLORS](PALEST + (1 - PALEST) * float(scale(posterior)))


def _draw_map(
    axes: Any, match: RockMatch, site: Point, scale: Normalize, reach_km: float, title: str, unnamed_km: float = 0.0
) -> list[tuple[str, float, float]]:
    """Rims and rays; the names to be written, the likeliest first, with the northern ends of the rims."""
    named = []
    for item in sorted(match.craters, key=lambda one: one.posterior):
        x, y = _on_map(site, *_rim(item))
        if item.contains_site:
            axes.plot(x, y, "--", color=HOST, linewidth=0.9)
        else:
            color = _color(scale, item.posterior)
            axes.fill(x, y, facecolor=color, alpha=0.35, linewidth=0)
            axes.plot(x, y, color=INK, linewidth=0.6)
            _draw_ray(axes, item, color)
        if max(abs(x).max(), abs(y).max()) > unnamed_km:
            top = int(np.argmax(y))
            if max(abs(x[top]), abs(y[top])) <= 0.97 * reach_km:
                named.append((_named(item), float(x[top]), float(y[top])))
    axes.plot(0, 0, "*", color="#c0392b", markersize=13, markeredgecolor="white", zorder=5, label="rock's site")
    axes.set_xlim(-reach_km, reach_km)
    axes.set_ylim(-reach_km, reach_km)
    axes.set_aspect("equal")
    axes.set_xlabel("east of the site [km]")
    axes.set_ylabel("north of the site [km]")
    axes.set_title(f"{title}; site at {site[0]:g}° N, {site[1]:g}° E")
    axes.plot([], [], "--", color=HOST, linewidth=0.9, label="rim that holds the site")
    return named[::-1]


def _draw_ray(axes: Any, item: CraterMatch, color: Any) -> None:
    if item.azimuth_deg is None:
        return
    heading = np.radians(item.azimuth_deg)
    x, y = item.prior.distance_km * np.sin(heading), item.prior.distance_km * np.cos(heading)
    axes.plot([x, 0], [y, 0], color=color, linewidth=0.4 + WIDEST_RAY * item.posterior, zorder=3)


def _named(item: CraterMatch) -> str:
    name = as_label(item.crater.name, 24)
    return name if item.contains_site else f"{name}\n{item.posterior:.2f}"


def _rim(item: CraterMatch) -> tuple[FloatArray, FloatArray]:
    azimuth = np.linspace(0, 360, 181)
    return destination(item.crater.center, azimuth, np.full(azimuth.shape, item.crater.diameter_km / 2))


def _on_map(site: Point, latitude: FloatArray, longitude: FloatArray) -> tuple[FloatArray, FloatArray]:
    points = list(zip(latitude, longitude, strict=True))
    distance = np.array([distance_km(site, point) for point in points])
    heading = np.radians([azimuth_deg(site, point) or 0.0 for point in points])
    return distance * np.sin(heading), distance * np.cos(heading)


def _draw_bars(part: Any, match: RockMatch, scale: Normalize) -> None:
    """Prior (grey) and posterior, the likeliest above, with the ln Bayes factor as text."""
    axes = part.subplots()
    items = sorted(_delivering(match), key=lambda one: one.posterior, reverse=True)[:MOST_SHOWN]
    rows = [(i.crater.name, i.prior.probability, i.posterior, _factor(i)) for i in items]
    rows.append((OTHER, match.other_prior, match.other_posterior, "0.0"))
    place = -np.arange(len(rows), dtype=float)
    colors = [_color(scale, row[2]) for row in rows]
    axes.barh(place + 0.2, [row[1] for row in rows], 0.36, color=PRIOR, label="prior", edgecolor=INK, linewidth=0.4)
    axes.barh(
        place - 0.2, [row[2] for row in rows], 0.36, color=colors, label="posterior", edgecolor=INK, linewidth=0.4
    )
    largest = max(max(row[1], row[2]) for row in rows)
    texts = [f"ln BF {row[3]}" for row in rows]
    for y, row, text in zip(place, rows, texts, strict=True):
        axes.text(max(row[1], row[2]) + 0.02 * largest, y, text, va="center", color=INK)
    axes.set_yticks(place, [as_label(row[0]) for row in rows])
    letters = LETTER_PT * np.array([7.0 * max(len(as_label(row[0])) for row in rows), 8.0 * max(map(len, texts))])
    share = letters[1] / (72 * PAGE_IN - 30 - letters[0]) + 0.04
    axes.set_xlim(0, largest / (1 - min(share, 0.7)))
    axes.set_xlabel("probability [-]")
    axes.set_title("before and after the composition; ln BF: Bayes factor of the composition alone")
    legend_below(part, axes)


def _factor(item: CraterMatch) -> str:
    unknown = not (item.evidence.minerals or item.evidence.bands)
    return "0 (composition unknown)" if unknown else f"{item.ln_bayes_factor:.1f}"
