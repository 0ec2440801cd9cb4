"""`lunarsci regolith compare`: the site beside other soils."""

import json
from dataclasses import asdict
from typing import TYPE_CHECKING, Annotated, Any

import typer

from ..shared.command import command
from ..shared.report import Report
from ..shared.table import TextTable

if TYPE_CHECKING:
    from lunarsci.regolith.compare import Site, SoilComparison

__all__ = ["add_to"]

SHOWN = 8
ASPECTS = ("bearing", "shear", "lateral")
PAIRS = (
    ("stiffness_kpa_m_n", "sinkage_exponent"),
    ("cohesion_pa", "friction_angle_deg"),
    ("lateral_modulus_mm", "external_friction_angle_deg"),
)
GIVEN = "The site, instead of a result"
PAPER = "Ding et al. (2024), Nat. Commun. 15, 2098, 10.1038/s41467-024-46233-8"
_NAMES = {
    "stiffness_kpa_m_n": ("stiffness_kpa_m_n", "stiffness_kpa_m_n"),
    "sinkage_exponent": ("exponent", "sinkage_exponent"),
    "cohesion_pa": ("cohesion_pa", "cohesion_pa"),
    "friction_angle_deg": ("friction_angle_deg", "friction_angle_deg"),
    "lateral_modulus_mm": ("lateral_modulus_mm", "lateral_modulus_mm"),
    "external_friction_angle_deg": ("external_friction_angle_deg", "external_friction_angle_deg"),
}
"""Name of a parameter of the site in the site value of `identify`, and in its joint posterior."""


def add_to(app: typer.Typer) -> None:
    """Register the command."""
    command(app, "compare")(compare)


def compare(
    result: Annotated[
        str | None, typer.Argument(metavar="[RESULT.json]", help="A result of `regolith identify --json`; - is stdin.")
    ] = None,
    rover: Annotated[str, typer.Option(help="Rover whose wheel sets the width: a name or a TOML file.")] = "yutu2",
    stiffness: Annotated[float | None, typer.Option(help="K_s in kPa m^-N.", rich_help_panel=GIVEN)] = None,
    exponent: Annotated[float | None, typer.Option(help="Sinkage exponent N.", rich_help_panel=GIVEN)] = None,
    cohesion: Annotated[float | None, typer.Option(help="Cohesion c in Pa.", rich_help_panel=GIVEN)] = None,
    friction_angle: Annotated[float | None, typer.Option(help="φ in deg.", rich_help_panel=GIVEN)] = None,
) -> Report:
    """The site beside terrestrial soils, simulants and lunar sites: who is most alike under a wheel.

    Distances are those of bearing pressure over 5-20 mm of sinkage and of shear strength over 2-10 kPa, as root mean
    square of the logarithm: 0.1 is about 10 %. The picture also shows the curves of a result, and lateral shear.
    """
    from lunarsci.inputs import read_input
    from lunarsci.provenance import sha256
    from lunarsci.regolith.compare import Site, compare_site, reference_hash
    from lunarsci.regolith.wheel import read_wheel
    from lunarsci.rovers.description import read_rover

    stated = (stiffness, exponent, cohesion, friction_angle)
    if (result is None) == all(value is None for value in stated):
        raise typer.BadParameter("give either a result of `regolith identify --json`, or --stiffness and its like")
    description = read_rover(rover)
    width = read_wheel(description).width_m
    inputs, curves = {}, None
    if result is not None:
        source = read_input(result)
        inputs = {source.name: source.sha256}
        site, curves = _site_of(source.data, source.name)
    else:
        site = Site(
            stiffness_kpa_m_n=stiffness,
            sinkage_exponent=exponent,
            cohesion_pa=cohesion,
            friction_angle_deg=friction_angle,
        )
    found = compare_site(site, width)
    records = [_record(item, width) for item in found]

    def figures() -> Any:
        from lunarsci.regolith.figure import comparison_figure

        return [comparison_figure(site, found, width, curves)]

    return Report(
        schema="regolith-compare/1",
        result={"site": asdict(site), "width_m": width, "soils": records},
        tables=_tables(found),
        rows=records,
        figures=figures,
        inputs=inputs,
        data_tables={f"{rover} (rover)": sha256(description.text.encode())} | reference_hash(),
        sources=[PAPER],
    )


def _site_of(data: bytes, name: str) -> "tuple[Site, dict[str, Any]]":
    """The joint posterior's medians where there is one, else the site values; and the curves by aspect."""
    from lunarsci.errors import DataError
    from lunarsci.regolith.compare import Site

    try:
        found = json.loads(data)["result"]
        curves = {aspect: found[aspect]["curve"] for aspect in ASPECTS}
        if "joint" in found:
            values = {own: found["joint"]["parameters"][_NAMES[own][1]]["median"] for own in _NAMES}
        else:
            pairs = found["bearing"] | found["shear"] | found["lateral"]
            values = {own: pairs[_NAMES[own][0]]["value"] for own in _NAMES}
    except (ValueError, KeyError, TypeError) as error:
        raise DataError(f"{name}: is no result of `regolith identify --json`; make one, or give --stiffness") from error
    for pair in PAIRS:
        if any(values[key] is None for key in pair):
            values |= dict.fromkeys(pair)
    return Site(**values), curves


def _record(item: "SoilComparison", width: float) -> dict[str, Any]:
    soil = item.soil
    return {
        "name": soil.name,
        "kind": soil.kind,
        "bearing_distance": item.bearing,
        "strength_distance": item.strength,
        "stiffness_kpa_m_n": soil.stiffness(width),
        "sinkage_exponent": soil.sinkage_exponent,
        "cohesion_low_pa": soil.cohesion_pa[0],
        "cohesion_high_pa": soil.cohesion_pa[1],
        "friction_angle_low_deg": soil.friction_angle_deg[0],
        "friction_angle_high_deg": soil.friction_angle_deg[1],
        "source": soil.source,
    }


def _tables(found: "list[SoilComparison]") -> list[TextTable]:
    from lunarsci.regolith.compare import nearest

    tables = []
    for aspect, title in (("bearing", "Alike in bearing"), ("strength", "Alike in shear strength")):
        ordered = nearest(found, aspect)
        rows = [
            [item.soil.name, item.soil.kind, f"{getattr(item, aspect):.2f}", *_own(item, aspect)]
            for item in ordered[:SHOWN]
        ]
        own = ["N", "k_c", "k_φ"] if aspect == "bearing" else ["c [Pa]", "φ [deg]"]
        notes = [f"of {len(ordered)} soils; distance: root mean square of the logarithm of the ratio of predictions"]
        tables += [TextTable(["soil", "kind", "distance", *own], rows, title=title, notes=notes)] if rows else []
    return tables


def _own(item: "SoilComparison", aspect: str) -> list[str]:
    soil = item.soil
    if aspect == "bearing":
        return ["-" if value is None else f"{value:g}" for value in (soil.sinkage_exponent, soil.k_c, soil.k_phi)]
    return [_span(soil.cohesion_pa), _span(soil.friction_angle_deg)]


def _span(ends: tuple[float, float]) -> str:
    low, high = (f"{value:g}" for value in ends)
    return low if low == high else f"{low} to {high}"
