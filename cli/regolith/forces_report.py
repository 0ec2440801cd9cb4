"""From the options of `lunarsci regolith forces` to its result, and from this to a `Report`."""

from collections.abc import Mapping
from dataclasses import asdict, dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from lunarsci.provenance import sha256
from lunarsci.regolith.bearing import SlipSinkageLaw, reece_stiffness, slip_sinkage
from lunarsci.regolith.forces import MOST_COHESION, Reading, cohesion_share
from lunarsci.regolith.integrals import forces_by
from lunarsci.regolith.load import sinkage_under_load, stiffness_under_load
from lunarsci.regolith.soil import Soil, read_soil, soil_hash
from lunarsci.regolith.states import MAX_VALID_SLIP
from lunarsci.regolith.wheel import Wheel, read_wheel
from lunarsci.rovers.description import read_rover

from ..shared.report import Report
from ..shared.table import TextTable

if TYPE_CHECKING:
    from lunarsci.regolith.contact import ContactModel

__all__ = ["ForcesRequest", "forces_report", "soil_of"]

PAPER = "Ding et al. (2024), Nat. Commun. 15, 2098, 10.1038/s41467-024-46233-8"


@dataclass(frozen=True, slots=True)
class ForcesRequest:
    """The state of the wheel: sinkage [m] or load [N], slip ratio, side slip [deg], and how slip deepens sinkage."""

    sinkage_m: float | None
    load_n: float | None
    slip: float
    side_slip_deg: float
    slip_sinkage: SlipSinkageLaw | None = None


def soil_of(
    name: str,
    changes: Mapping[str, float | None],
    width_m: float,
    reece: tuple[float, float] | None,
    density_kg_m3: float,
    gravity_m_s2: float,
) -> Soil:
    """The named soil with what was changed; with Reece's moduli (k_c', k_phi') its stiffness under this gravity."""
    soil = read_soil(name).replace(**{key: value for key, value in changes.items() if value is not None})
    if reece is None:
        return soil
    stiffness = reece_stiffness(
        *reece,
        soil.sinkage_exponent,
        width_m,
        cohesion_pa=soil.cohesion_pa,
        density_kg_m3=density_kg_m3,
        gravity_m_s2=gravity_m_s2,
    )
    return soil.replace(stiffness_kpa_m_n=stiffness)


def _settled(
    wheel: Wheel, soil: Soil, asked: ForcesRequest, reading: Reading, model: "ContactModel | None"
) -> tuple[float, Soil]:
    """Sinkage, and the soil: where slip deepens the one, it softens the other, which carries no more than the load."""
    if asked.sinkage_m is not None:
        return asked.sinkage_m, soil
    load, side = asked.load_n or 0.0, asked.side_slip_deg
    slip = 0.0 if asked.slip_sinkage else asked.slip
    found = sinkage_under_load(wheel, soil, load, slip, side, reading=reading, model=model)
    if asked.slip_sinkage is None:
        return found, soil
    deep = float(slip_sinkage(found, asked.slip, asked.slip_sinkage))
    soft = stiffness_under_load(wheel, soil, load, deep, asked.slip, side, reading=reading, model=model)
    return deep, soil.replace(stiffness_kpa_m_n=soft)


def forces_report(
    rover: str,
    soil_name: str,
    soil: "Soil",
    asked: ForcesRequest,
    reading: Reading,
    model: "ContactModel | None" = None,
) -> Report:
    """The report of `regolith forces`; with a model, by integration."""
    import warnings

    from lunarsci.errors import LunarSciWarning
    from lunarsci.regolith.identify import REPRODUCTION_ONLY

    description = read_rover(rover)
    wheel = read_wheel(description)
    slip, side_slip_deg = asked.slip, asked.side_slip_deg
    if reading != "signed":
        warnings.warn(REPRODUCTION_ONLY.format(reading), LunarSciWarning, stacklevel=2)
    if abs(slip) > MAX_VALID_SLIP:
        text = f"slip ratio {slip:g} is beyond {MAX_VALID_SLIP:g}, up to which the model was compared with wheels"
        warnings.warn(text, LunarSciWarning, stacklevel=2)
    sinkage_m, soil = _settled(wheel, soil, asked, reading, model)
    found = forces_by(model, wheel, soil, sinkage_m, slip, side_slip_deg, reading)
    state = {"sinkage_m": sinkage_m, "slip_ratio": slip, "side_slip_deg": side_slip_deg}
    share = float(cohesion_share(wheel, soil, np.array(sinkage_m), np.asarray(found.normal_force_n)))
    result = state | {name: float(getattr(found, name)) for name in found.__slots__} | {"soil": asdict(soil)}

    def figures() -> Any:
        from lunarsci.regolith.figure import forces_over_slip

        return [forces_over_slip(wheel, soil, sinkage_m, slip, side_slip_deg, reading, model)]

    row = {key: value for key, value in result.items() if key != "soil"}
    return Report(
        schema="regolith-forces/1",
        result=result
        | {"reading": reading, "assumed_of_rover": list(description.assumed)}
        | {"model": asdict(model) if model else None, "cohesion_share": share},
        tables=[_forces_table(row)],
        rows=[row],
        figures=figures,
        inputs=soil_hash(soil_name)[0],
        data_tables={f"{rover} (rover)": sha256(description.text.encode())} | soil_hash(soil_name)[1],
        sources=[PAPER],
        untrusted=_hardly_in_touch(share),
    )


def _hardly_in_touch(share: float) -> str:
    if 0 <= share <= MOST_COHESION:
        return ""
    return (
        f"not to be trusted: cohesion alone would pull {share:.3g} times what presses the wheel, as the contact is "
        "nearly without load; give a deeper sinkage, or less cohesion"
    )


def _forces_table(row: Mapping[str, Any]) -> TextTable:
    cells = [
        ["sinkage", f"{1e3 * row['sinkage_m']:.2f}", "mm"],
        ["slip ratio", f"{row['slip_ratio']:.4f}", "-"],
        ["side slip", f"{row['side_slip_deg']:.2f}", "deg"],
        ["normal force", f"{row['normal_force_n']:.2f}", "N"],
        ["drawbar pull", f"{row['drawbar_pull_n']:.2f}", "N"],
        ["lateral force", f"{row['lateral_force_n']:.2f}", "N"],
        ["resistance torque", f"{row['resistance_torque_nm']:.3f}", "N m"],
    ]
    for name in ("steering_moment_nm", "overturning_moment_nm"):
        if name in row:
            cells.append([name.removesuffix("_nm").replace("_", " "), f"{row[name]:.3f}", "N m"])
    return TextTable(["quantity", "value", "unit"], cells)
