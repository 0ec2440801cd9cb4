"""`lunarsci regolith identify`: the soil that wheel states reveal, each by itself."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Annotated

import typer

from lunarsci.regolith.jobs.requests import IdentifyRequest

from ..shared.command import command
from ..shared.emit import Report
from ..shared.options import Output, option
from ..shared.table import UNKNOWN, TextTable, plus_minus

if TYPE_CHECKING:
    from lunarsci.regolith.identify import Estimate, Identification, Sensitivity
    from lunarsci.regolith.jobs.identify import IdentifiedSoil


ERRORS = "Errors (where the file gives none)"
SYMBOLS = {
    "sigma_m_pa": "σ_m",
    "tau_xm_pa": "τ_xm",
    "tau_ym_pa": "τ_ym",
    "stiffness_kpa_m_n": "K_s",
    "exponent": "N",
    "friction_angle_deg": "φ",
    "cohesion_pa": "c",
    "external_friction_angle_deg": "φ_y",
    "lateral_modulus_mm": "K_y",
}
"""Symbols of solved parameters in tables."""
QUANTITIES = {
    "sinkage_m": "sinkage",
    "slip_ratio": "slip ratio",
    "side_slip_deg": "side slip",
    "normal_force_n": "normal force",
    "drawbar_pull_n": "drawbar pull",
    "lateral_force_n": "lateral force",
}
"""Words for measured quantities in tables."""
NOTE = "errors are those of one state; `lunarsci regolith infer` says how well all states determine one soil"
MANY_STATES, LEAST_SHARE = 30, 0.005
"""States beyond which the table of single ones is left out, and share of an error from which on it has a row."""
States = Annotated[
    str,
    typer.Argument(
        help="CSV of wheel states: sinkage_m, normal_force_n, drawbar_pull_n, and where known slip_ratio, "
        "side_slip_deg, lateral_force_n; NAME_sigma is the error of NAME; - is stdin."
    ),
]
ASSUMED = "What is assumed, and so what is solved for"
OPTIONS = {
    "rover": option(),
    "exponent": option(panel=ASSUMED),
    "stiffness": option(panel=ASSUMED),
    "cohesion": option(panel=ASSUMED),
    "friction_angle": option(panel=ASSUMED),
    "shear_modulus": option(panel=ASSUMED),
    "lateral_modulus": option(kind=str | None, panel=ASSUMED),
    "external_friction_angle": option(panel=ASSUMED),
    "reading": option(),
    "units": option(metavar="COLUMN=UNIT,…"),
    "draws": option(min=2, max=1_000_000),
    "seed": option(min=0),
    "sinkage_error": option(panel=ERRORS),
    "force_error": option(panel=ERRORS, show_default="1/30"),
    "travel_error": option(panel=ERRORS, show_default="4/300"),
    "side_slip_error": option(panel=ERRORS, show_default="4/300"),
    "sensitivity": option(panel=ERRORS),
}
EXAMPLES = (
    "lunarsci regolith identify lunarsci-demo/wheel_states.csv --exponent 1",
    "lunarsci regolith identify lunarsci-demo/wheel_states.csv \\\n  --lateral-modulus 13,40 --csv",
)


@command("identify", EXAMPLES, OPTIONS)
def identify(states: States, request: IdentifyRequest, output: Output) -> Report:
    """Soil parameters in three aspects (bearing, longitudinal and lateral shear) from wheel states, with errors.

    Each pair (K_s, N), (c, φ), (K_y, φ_y) has one parameter that is assumed and one that is solved for. If both are
    given, each is solved for at the other's value. `regolith infer` takes all states together.
    """
    from lunarsci.regolith.jobs.identify import identify as identify_soil

    soil = identify_soil(states, request, progress=output.progress("identifying"))
    return Report(soil, result_tables(soil))


def result_tables(soil: IdentifiedSoil) -> list[TextTable]:
    """Each state, where there are few; the site; where the errors come from."""
    return [
        *_observation_tables(soil.identification, "Each state"),
        _site_table(soil, _site_title(soil), NOTE, *read_as(soil)),
        *_shares(soil),
    ]


def single_tables(soil: IdentifiedSoil, title: str) -> list[TextTable]:
    """The same below the answer of all states together; `title` says what they assume."""
    against = "; ".join(item.text for item in soil.agreements if not item.agree)
    test = f"solved so, the states differ by more than their errors ({against})" if against else ""
    notes = [f"{test}: this tests what single states assume, not the soil above"] if test else []
    states = _observation_tables(soil.identification, title)
    middle = f"The middle of these states, {soil.identification.draws} draws each" if states else title
    return [
        *states,
        _site_table(soil, middle, "errors are those of one state", *notes),
        *_shares(soil),
    ]


def read_as(soil: IdentifiedSoil) -> list[str]:
    """How columns of the table were read."""
    return [f"read as: {'; '.join(soil.read_as)}"] if soil.read_as else []


def _shares(soil: IdentifiedSoil) -> list[TextTable]:
    return [] if soil.shares is None else [_sensitivity_table(soil.shares)]


def _sensitivity_table(shares: Sequence[Sensitivity]) -> TextTable:
    rows = [
        [SYMBOLS[share.parameter], QUANTITIES[share.quantity], _share(share.alone), _share(share.saved)]
        for share in shares
        if max(abs(share.alone or 0), abs(share.saved or 0)) >= LEAST_SHARE
    ]
    notes = ["alone: share of the variance that its error makes by itself; saved: share that would go if it were exact"]
    return TextTable(["parameter", "error of", "alone", "saved"], rows, title="Where the errors come from", notes=notes)


def _share(value: float | None) -> str:
    return "-" if value is None else f"{100 * value:.0f} %"


def _observation_tables(made: Identification, title: str) -> list[TextTable]:
    from lunarsci.regolith.identify import UNITS, Estimate

    if len(made.observations) > MANY_STATES:
        return []
    names = [name for name, value in made.observations[0].items() if isinstance(value, Estimate)]
    headers = ["state", *(f"{SYMBOLS[name]} [{UNITS[name]}]" for name in names)]
    rows = [[row["id"], *(_text(row[name], name) for name in names)] for row in made.observations]
    return [TextTable(headers, rows, title=title)]


def _site_table(result: IdentifiedSoil, title: str, *notes: str) -> TextTable:
    from lunarsci.regolith.identify import LABELS

    made = result.identification
    several = len(made.corners) > 1
    names = [name for name in LABELS if not (several and name == "lateral_modulus_mm")]
    rows = [_site_row(LABELS[name], made.site[name], name) for name in names]
    for corner in made.corners if several else ():
        label = f"  φ_y at K_y = {corner['lateral_modulus_mm']:g} mm"
        rows.append(_site_row(label, corner["external_friction_angle_deg"], "external_friction_angle_deg"))
    return TextTable(["parameter", "value", "95 % interval", "unit", ""], rows, title=title, notes=notes)


def wheel_text(result: IdentifiedSoil) -> str:
    """How many states, and with which wheel: its name, and the file where it is another."""
    count = len(result.identification.observations)
    default = {"default": " (the default)", "table": " (named in the table)"}.get(result.named_by, "")
    return f"{count} state{'s' if count > 1 else ''} with the wheel of {result.wheel_of}{default}"


def _site_title(result: IdentifiedSoil) -> str:
    made = result.identification
    return f"The site from {wheel_text(result)}, {made.draws} draws each, sign convention '{made.reading}'"


def _site_row(label: str, estimate: Estimate, name: str) -> list[str]:
    from lunarsci.regolith.identify import UNITS

    interval = "-" if estimate.low is None else f"{_digits(estimate.low, name)} to {_digits(estimate.high, name)}"
    remark = "assumed" if estimate.assumed else estimate.reason
    return [label, _text(estimate, name), interval, UNITS[name], remark]


def _text(estimate: Estimate, name: str) -> str:
    if estimate.value is None:
        return UNKNOWN if estimate.reason else "-"
    if not estimate.sigma:
        return _digits(estimate.value, name)
    return plus_minus(estimate.value, estimate.sigma)


def _digits(value: float | None, name: str) -> str:
    places = {"exponent": 4, "stiffness_kpa_m_n": 1, "friction_angle_deg": 2, "external_friction_angle_deg": 2}
    return "-" if value is None else f"{value:.{places.get(name, 0)}f}"
