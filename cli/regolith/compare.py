"""`lunarsci regolith compare`: the site beside other soils."""

from __future__ import annotations

from typing import TYPE_CHECKING, Annotated

import typer

from lunarsci.regolith.jobs.requests import CompareSoilsRequest
from lunarsci.rovers import called as name_for_people

from ..shared.command import command
from ..shared.emit import Report
from ..shared.options import option
from ..shared.table import TextTable

if TYPE_CHECKING:
    from lunarsci.regolith.compare import SoilComparison
    from lunarsci.regolith.jobs.compare_soils import ComparedSoils

SHOWN = 8
"""Soils in each table for people."""
GIVEN = "The site, instead of a result"
OPTIONS = {
    "rover": option(),
    "stiffness": option(panel=GIVEN),
    "exponent": option(panel=GIVEN),
    "cohesion": option(panel=GIVEN),
    "friction_angle": option(panel=GIVEN),
}
SiteResult = Annotated[
    str | None,
    typer.Argument(
        metavar="[RESULT.json]",
        help="A result of `regolith infer` or `identify`, by --json, or a belief of `twin update`; - is stdin.",
    ),
]
EXAMPLES = (
    "lunarsci regolith compare soil.json",
    "lunarsci regolith compare --stiffness 1443 --exponent 1 \\\n  --cohesion 520 --friction-angle 42",
)


@command("compare", EXAMPLES, OPTIONS)
def compare(request: CompareSoilsRequest, result: SiteResult = None) -> Report:
    """The site beside terrestrial soils, simulants and lunar sites: which is most alike under a wheel.

    Distances are the root mean square of the logarithm of bearing pressure over 5-20 mm of sinkage and of shear
    strength over 2-10 kPa: 0.1 is about 10 %. Parameters that a result does not determine are named, and distances then
    have a 68 % interval. The picture also shows the curves of a result, and lateral shear.
    """
    from lunarsci.regolith.jobs.compare_soils import compare_soils

    compared = compare_soils(result, request)
    return Report(compared, result_tables(compared))


def result_tables(result: ComparedSoils) -> list[TextTable]:
    """The nearest soils in both aspects."""
    from lunarsci.regolith.compare import WORDS, nearest

    soils, tables = result.soils, []
    for aspect, title in (("bearing", "Alike in bearing"), ("strength", "Alike in shear strength")):
        ordered = nearest(soils, aspect)
        rows = [
            [
                item.soil.name,
                item.soil.kind,
                f"{getattr(item, aspect):.2f}",
                *_range(item, aspect),
                *_fitted(item, aspect),
            ]
            for item in ordered[:SHOWN]
        ]
        ranged = ["68 %"] if any(_range(item, aspect) for item in ordered) else []
        fitted = ["N", "k_c", "k_φ"] if aspect == "bearing" else ["c [Pa]", "φ [deg]"]
        wheel = (
            f"wheel of {name_for_people(result.rover, result.called)}, {1e3 * result.width_m:.0f} mm wide; "
            if aspect == "bearing"
            else ""
        )
        notes = [
            f"{wheel}of {len(ordered)} soils; distance: root mean square of the logarithm of the ratio of predictions"
        ]
        notes += ["68 %: of the distance, over what the result leaves open of the site"] if ranged else []
        notes += [text for text in result.remarks if text.startswith(f"{WORDS[aspect]}:")]
        tables += (
            [TextTable(["soil", "kind", "distance", *ranged, *fitted], rows, title=title, notes=notes)] if rows else []
        )
    return tables


def _range(item: SoilComparison, aspect: str) -> list[str]:
    ends = item.bearing_range if aspect == "bearing" else item.strength_range
    return [f"{ends[0]:.2f} to {ends[1]:.2f}"] if ends else []


def _fitted(item: SoilComparison, aspect: str) -> list[str]:
    soil = item.soil
    if aspect == "bearing":
        return ["-" if value is None else f"{value:g}" for value in (soil.sinkage_exponent, soil.k_c, soil.k_phi)]
    return [_span(soil.cohesion_pa), _span(soil.friction_angle_deg)]


def _span(ends: tuple[float, float]) -> str:
    low, high = (f"{value:g}" for value in ends)
    return low if low == high else f"{low} to {high}"
