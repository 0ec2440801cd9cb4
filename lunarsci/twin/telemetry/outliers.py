"""Positions and headings that fit no motion of the wheels, and errors that nobody can believe."""

import dataclasses
import math

import numpy as np
import numpy.typing as npt

from lunarsci.twin.telemetry.findings import Findings
from lunarsci.twin.telemetry.smoother import MEANS, Nodes, SlipProcess, Smoothed, smooth

__all__ = ["check_change", "check_glide", "check_scatter", "without_outliers"]

FloatArray = npt.NDArray[np.float64]
OUTLIER = 20.0
"""Mahalanobis distance squared from which a position is left out: once in 22 000 by chance (chi-square, 2 degrees)."""
MOST_OUTLIERS = 0.2
WORST_CHI_SQUARE = 4.0
"""Share of positions left out, and reduced chi-square, beyond which the result is in doubt; assumed."""
LEAST_CHI_SQUARE, FINEST_M = 0.05, 5e-4
"""Reduced chi-square and standard error [m] below which errors of positions are not believed; assumed."""
COARSE, FINE, LENGTHS_M = np.array([0.1, 0.1, 0.05]), np.array([0.03, 0.03, 0.05]), np.full(3, 0.7)
"""How slip changes on ground that is not known yet, first widely, then as on ground of some degrees; assumed."""
SPARSE = 0.02
"""Information about how slip changes below which positions are said to tell nothing of it; assumed. [nat]"""
GLIDE_DEG = 3.0
"""Side slip all along from which on it is said: the largest that Ding et al. (2024) report. [deg]"""


def without_outliers(nodes: Nodes, findings: Findings) -> tuple[Smoothed, Nodes, FloatArray]:
    """Smooth, leave out the worst position while it fits no motion, smooth again."""
    count = int(np.isfinite(nodes.fix_m).all(axis=1).sum())
    left: list[list[float]] = []
    odd: list[float] = []
    for change in (SlipProcess.fixed(COARSE, LENGTHS_M), SlipProcess.fixed(FINE, LENGTHS_M)):
        smoothed = smooth(nodes, change)
        nodes, smoothed, lost = _without_odd_headings(nodes, smoothed)
        odd += lost
        while count - len(left) > 3 and np.nanmax(smoothed.misfit) > OUTLIER:
            worst = int(np.nanargmax(smoothed.misfit))
            left.append([float(nodes.time_s[worst]), *map(float, nodes.fix_m[worst])])
            fix = nodes.fix_m.copy()
            fix[worst] = np.nan
            nodes = dataclasses.replace(nodes, fix_m=fix)
            smoothed = smooth(nodes, smoothed.change)
            if len(left) > max(3, MOST_OUTLIERS * count):
                break
    if odd:
        many = len(odd) > MOST_OUTLIERS * len(nodes.time_s)
        what = f"{len(odd)} headings fit no motion of the wheels"
        findings.add("odd heading", what, "left out", count=len(odd), time_s=min(odd), doubt=many)
    if left:
        many = len(left) > MOST_OUTLIERS * count
        findings.add(
            "position jump",
            f"{len(left)} of {count} positions fit no motion of the wheels",
            "left out",
            count=len(left),
            time_s=min(left)[0],
            doubt=many,
        )
    return smoothed, nodes, np.array(sorted(left)).reshape(-1, 3)


def _without_odd_headings(nodes: Nodes, smoothed: Smoothed) -> tuple[Nodes, Smoothed, list[float]]:
    """Leave out the worst heading while it fits no motion; with the times of those left out."""
    odd: list[float] = []
    while np.nanmax(smoothed.yaw_misfit) > OUTLIER and len(odd) <= MOST_OUTLIERS * len(nodes.time_s):
        worst = int(np.nanargmax(smoothed.yaw_misfit))
        odd.append(float(nodes.time_s[worst]))
        yaw = nodes.yaw_rad.copy()
        yaw[worst] = np.nan
        nodes = dataclasses.replace(nodes, yaw_rad=yaw)
        smoothed = smooth(nodes, smoothed.change)
    return nodes, smoothed, odd


def check_scatter(smoothed: Smoothed, nodes: Nodes, findings: Findings) -> None:
    """Say errors of positions that nobody can believe, and a scatter that they do not explain."""
    fixed = np.isfinite(nodes.fix_m).all(axis=1)
    sigma = float(np.median(np.sqrt(np.trace(nodes.fix_covariance_m2[fixed], axis1=1, axis2=2) / 2.0)))
    if sigma < FINEST_M:
        what = f"positions claim errors of {1e3 * sigma:.2g} mm, which no localisation of a rover reaches"
        findings.add("errors too small", what, "kept; are they in another unit?", doubt=True)
    if smoothed.reduced_chi_square < LEAST_CHI_SQUARE and fixed.sum() > 5 and sigma >= FINEST_M:
        what = f"positions scatter {smoothed.reduced_chi_square:.2g} times as much as their errors of {sigma:.3g} m say"
        findings.add("errors too large", what, "kept; are they in another unit?")
    if smoothed.reduced_chi_square > WORST_CHI_SQUARE:
        what = f"positions scatter with a reduced chi-square of {smoothed.reduced_chi_square:.1f} about the motion"
        findings.add("positions scatter", what, "kept; their errors are too small, or they jump", doubt=True)


def check_glide(smoothed: Smoothed, findings: Findings) -> None:
    """Say a side slip that stays the same all along."""
    left, sigma = float(smoothed.state[-1, MEANS[1]]), float(np.sqrt(smoothed.covariance[-1, MEANS[1], MEANS[1]]))
    middle = math.degrees(math.atan(float(np.median(smoothed.deviation[:, 1]))))
    if abs(middle) > GLIDE_DEG and abs(left) > sigma:
        what = f"the rover glides by {middle:.2g} deg all the way, positive to the left"
        findings.add("constant side slip", what, "kept; a heading that is off throughout looks the same")


def check_change(smoothed: Smoothed, nodes: Nodes, findings: Findings) -> None:
    """Say positions that are too few or too coarse to tell how slip changes."""
    if smoothed.change.information[0] < SPARSE:
        count = int(np.isfinite(nodes.fix_m).all(axis=1).sum())
        what = f"{count} positions over {float(nodes.way_m.sum()):.3g} m do not tell how fast slip changes"
        findings.add("sparse positions", what, "errors of slip rest on what is assumed of it", count=count)
