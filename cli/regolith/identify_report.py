"""From files and options of `lunarsci regolith identify` to its result, and from this to a `Report`."""

from collections.abc import Mapping, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Any

import typer

from lunarsci.regolith.identify import Assumptions, Identification
from lunarsci.regolith.prior import prior_hash
from lunarsci.regolith.uncertainty import UNITS, Estimate

from ..shared.report import Report
from ..shared.table import TextTable

if TYPE_CHECKING:
    from lunarsci.regolith.sensitivity import Sensitivity

    from .joint import IdentifyInputs, Together

__all__ = ["assumptions", "identify_report"]

PAPER = "Ding et al. (2024), Nat. Commun. 15, 2098, 10.1038/s41467-024-46233-8"
LABELS = {
    "stiffness_kpa_m_n": "stiffness K_s",
    "exponent": "sinkage exponent N",
    "friction_angle_deg": "internal friction angle φ",
    "cohesion_pa": "cohesion c",
    "external_friction_angle_deg": "external friction angle φ_y",
    "lateral_modulus_mm": "lateral shear modulus K_y",
}
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
INPUTS = {
    "sinkage_m": "sinkage",
    "slip_ratio": "slip ratio",
    "side_slip_deg": "side slip",
    "normal_force_n": "normal force",
    "drawbar_pull_n": "drawbar pull",
    "lateral_force_n": "lateral force",
}
MANY_STATES, LEAST_SHARE = 30, 0.005


def assumptions(pairs: tuple[float | None, ...], lateral_modulus: str | None) -> Assumptions:
    """What is assumed of the soil: N, K_s, c, phi, K_x and phi_y as given, and K_y, one or several by commas."""
    exponent, stiffness, cohesion, friction_angle, shear_modulus, external_friction_angle = pairs
    return Assumptions(
        exponent=exponent,
        stiffness_kpa_m_n=stiffness,
        cohesion_pa=cohesion,
        friction_angle_deg=friction_angle,
        shear_modulus_mm=shear_modulus or 0.0,
        lateral_modulus_mm=_numbers(lateral_modulus, "--lateral-modulus"),
        external_friction_angle_deg=external_friction_angle,
    )


def _numbers(text: str | None, option: str) -> tuple[float, ...]:
    """Numbers separated by commas. Raises a usage error for anything else."""
    try:
        return tuple(float(part) for part in text.split(",")) if text else ()
    except ValueError:
        raise typer.BadParameter(f"{option} {text}: give one number, or several separated by commas") from None


def identify_report(
    given: "IdentifyInputs",
    found: Identification,
    seed: int,
    together: "Together | None" = None,
    shares: "Sequence[Sensitivity] | None" = None,
    draws: Path | None = None,
) -> Report:
    """The report of `regolith identify`; `draws` names a file that takes draws from the joint posterior."""
    from .joint import joint_record, joint_tables, soil_file

    own = joint_tables(together) if together else []
    joint: dict[str, Any] = {"joint": joint_record(together)} if together else {}
    if shares is not None:
        joint["sensitivity"] = [asdict(share) for share in shares]
        own = [_sensitivity_table(shares), *own]

    def figures() -> Any:
        from lunarsci.regolith.figure import characteristic_curves

        return [characteristic_curves(found)]

    return Report(
        schema="regolith-identify/1",
        result=found.to_dict() | {"assumed_of_rover": list(given.assumed)} | joint,
        tables=[*_observation_tables(found), _site_table(found), *own],
        rows=[_observation_row(row) for row in found.observations],
        figures=figures,
        inputs=given.inputs | (together.inputs if together else {}),
        data_tables=given.tables | (prior_hash() if together else {}),
        sources=[PAPER],
        seed=seed,
        untrusted=_untrusted(found, together),
        extras={draws: lambda: soil_file(together.posterior, draws)} if draws and together else {},
    )


def _sensitivity_table(shares: "Sequence[Sensitivity]") -> TextTable:
    rows = [
        [SYMBOLS[share.parameter], INPUTS[share.quantity], _share(share.alone), _share(share.saved)]
        for share in shares
        if max(abs(share.alone or 0), abs(share.saved or 0)) >= LEAST_SHARE
    ]
    notes = ["alone: share of the variance that its error makes by itself; saved: share that would go if it were exact"]
    return TextTable(["parameter", "error of", "alone", "saved"], rows, title="Where the errors come from", notes=notes)


def _share(value: float | None) -> str:
    return "-" if value is None else f"{100 * value:.0f} %"


def _untrusted(found: Identification, together: "Together | None") -> str:
    """Why not to trust it: the joint fit's own verdict where there is one, else what single states leave open."""
    reasons = [f"no {LABELS[name]}: {found.site[name].reason}" for name in found.unsolved]
    if together is not None:
        reasons = [together.posterior.verdict.reason] if not together.posterior.verdict.trusted else []
    return f"not to be trusted: {'; '.join(reasons)}" if reasons else ""


def _observation_tables(found: Identification) -> list[TextTable]:
    if len(found.observations) > MANY_STATES:
        return []
    names = [name for name, value in found.observations[0].items() if isinstance(value, Estimate)]
    headers = ["state", *(f"{SYMBOLS[name]} [{UNITS[name]}]" for name in names)]
    rows = [[row["id"], *(_text(row[name], name) for name in names)] for row in found.observations]
    return [TextTable(headers, rows, title="Each state")]


def _site_table(found: Identification) -> TextTable:
    rows = [_site_row(LABELS[name], found.site[name], name) for name in LABELS if not _is_corner_mean(name, found)]
    for corner in found.corners if len(found.corners) > 1 else ():
        label = f"  φ_y at K_y = {corner['lateral_modulus_mm']:g} mm"
        rows.append(_site_row(label, corner["external_friction_angle_deg"], "external_friction_angle_deg"))
    count = len(found.observations)
    title = (
        f"The site from {count} state{'s' if count > 1 else ''}, {found.draws} draws each, reading '{found.reading}'"
    )
    return TextTable(["parameter", "value", "95 % interval", "unit", ""], rows, title=title)


def _is_corner_mean(name: str, found: Identification) -> bool:
    return name == "lateral_modulus_mm" and len(found.corners) > 1


def _site_row(label: str, estimate: Estimate, name: str) -> list[str]:
    interval = "-" if estimate.low is None else f"{_digits(estimate.low, name)} to {_digits(estimate.high, name)}"
    remark = "assumed" if estimate.assumed else estimate.reason
    return [label, _text(estimate, name), interval, UNITS[name], remark]


def _text(estimate: Estimate, name: str) -> str:
    if estimate.value is None:
        return "-"
    sigma = "" if estimate.sigma is None else f" ± {_digits(estimate.sigma, name)}"
    return _digits(estimate.value, name) + sigma


def _digits(value: float | None, name: str) -> str:
    places = {"exponent": 4, "stiffness_kpa_m_n": 1, "friction_angle_deg": 2, "external_friction_angle_deg": 2}
    return "-" if value is None else f"{value:.{places.get(name, 0)}f}"


def _observation_row(row: Mapping[str, Any]) -> dict[str, Any]:
    flat: dict[str, Any] = {}
    for name, value in row.items():
        if isinstance(value, Estimate):
            flat |= _columns(name, value)
        elif name == "corners":
            for corner in value:
                label = f"external_friction_angle_deg_at_{corner['lateral_modulus_mm']:g}_mm"
                flat |= _columns(label, corner["external_friction_angle_deg"])
        else:
            flat[name] = value
    return flat


def _columns(name: str, estimate: Estimate) -> dict[str, float | None]:
    suffixes: Sequence[str] = ("sigma", "low", "high")
    return {name: estimate.value} | {f"{name}_{suffix}": getattr(estimate, suffix) for suffix in suffixes}
