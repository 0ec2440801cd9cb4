"""The page of profiles: attitude, clearance, miss and wheel loads against distance."""

from typing import TYPE_CHECKING, Any

from lunarsci.twin.ensemble import Prediction
from lunarsci.twin.figures.bands import draw_band, draw_loads
from lunarsci.twin.judgement.profiles import available
from lunarsci.twin.judgement.quantities import abscissa
from lunarsci.twin.judgement.safety import Verdict

if TYPE_CHECKING:
    from matplotlib.figure import Figure

__all__ = ["profile_page"]

LEFT = ("tilt_deg", "roll_deg", "pitch_deg", "miss_m")
RIGHT = ("clearance_m", "keep_out_m")


def profile_page(prediction: Prediction, verdict: Verdict) -> "Figure":
    """Tilt, roll, pitch and miss on the left; clearance, distance to keep-out circles and wheel loads on the right.

    Bands span p05 to p95 over the members, the line is the median, dots are the extremes.
    """
    from matplotlib.figure import Figure

    figure = Figure(figsize=(13.0, 8.2), dpi=130, layout="constrained", facecolor="white")
    columns: Any = figure.subfigures(1, 2)
    left, right = columns
    shown = [name for name in RIGHT if name in available(prediction)]
    panels = list(left.subplots(len(LEFT), 1, sharex=True))
    ratios = [1.0] * len(shown) + [float(len(LEFT) - len(shown))]
    others = list(right.subplots(len(shown) + 1, 1, sharex=True, height_ratios=ratios, squeeze=False)[:, 0])
    for panel, name in zip([*panels, *others], [*LEFT, *shown], strict=False):
        draw_band(panel, prediction, verdict, name, legend=panel is panels[0])
    draw_loads(others[-1], prediction)
    others[-1].set_title("load of each wheel", fontsize=9)
    for lowest in (panels[-1], others[-1]):
        lowest.set_xlabel(abscissa(prediction)[1])
    members = "1 member" if prediction.members == 1 else f"all {prediction.members} members"
    figure.suptitle(f"Profiles of {members}; upright lines: joints of the plan", fontsize=12)
    return figure
