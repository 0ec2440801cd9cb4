"""From the options of `spectra simulate` to synthetic products, and their `Report`."""

from collections.abc import Mapping
from datetime import UTC, datetime
from typing import Any

from lunarsci.errors import ParameterError
from lunarsci.spectra.mgm.assemblages import MINERALS
from lunarsci.spectra.mgm.assemblages import TABLES as BANDS_TABLES
from lunarsci.spectra.photometry import phase_function
from lunarsci.spectra.photometry.phase import TABLE as PHASE_TABLE
from lunarsci.spectra.solar import SOLAR_SPECTRA, table_name
from lunarsci.spectra.vnis.channels import TABLES
from lunarsci.spectra.vnis.simulation.instrument import Simulation
from lunarsci.spectra.vnis.simulation.products import product_files
from lunarsci.spectra.vnis.simulation.scene import SceneComposition
from lunarsci.tables import table_hashes

from ..shared.report import Report
from ..shared.table import TextTable

__all__ = ["composition", "moment", "simulate_report"]

_KEYS = {**{key.lower(): name for key, name in MINERALS.items()}, "plg": "plagioclase"}
_NAMES = {**_KEYS, **{name: name for name in _KEYS.values()}}


def composition(text: str) -> SceneComposition:
    """A composition from `ol=0.1,opx=0.3,cpx=0.2,plg=0.4`. Raises ParameterError for anything else."""
    fractions: dict[str, float] = {}
    for part in text.split(","):
        key, _, value = part.partition("=")
        name = _NAMES.get(key.strip().lower())
        if name is None or name in fractions:
            raise ParameterError(
                f"composition '{text[:60]}': '{part}' is none of {', '.join(_KEYS)} = fraction, each once"
            )
        try:
            fractions[name] = float(value)
        except ValueError as error:
            raise ParameterError(f"composition '{text[:60]}': '{value}' is no number; write ol=0.1,opx=0.9") from error
    return SceneComposition(**fractions)


def moment(text: str) -> datetime:
    """A UTC time from ISO 8601. Raises ParameterError."""
    try:
        time = datetime.fromisoformat(text)
    except ValueError as error:
        raise ParameterError(f"'{text[:40]}' is no time; write it as 2020-07-16T08:20:00") from error
    if not 1960 <= time.year < 2100:
        raise ParameterError(f"the year {time.year} is out of range; give a time from 1960 to 2099")
    return time.replace(tzinfo=UTC) if time.tzinfo is None else time.astimezone(UTC)


def simulate_report(simulation: Simulation) -> Report:
    """The report of `spectra simulate`; its files are the products."""
    files = product_files(simulation)
    truth, scene = simulation.truth, simulation.scene
    result: dict[str, Any] = {
        "synthetic": True,
        "observation": f"SYNTHETIC-CE4-{scene.sequence:04d}",
        "files": [{"name": name, "bytes": len(content)} for name, content in files.items()],
        "composition": truth.composition.fractions,
        "rock_fraction": truth.rock_fraction,
        "shadow_fraction": truth.shadow_fraction,
        "wavelength_nm": truth.wavelength_nm,
        "reflectance": truth.reflectance,
    }

    def figures() -> Any:
        from lunarsci.spectra.vnis.simulation.products import simulation_page

        return [simulation_page(simulation)]

    return Report(
        schema="spectra-simulate/1",
        result=result,
        tables=[_table(result)],
        rows=[
            {"wavelength_nm": w, "reflectance": r} for w, r in zip(truth.wavelength_nm, truth.reflectance, strict=True)
        ],
        figures=figures,
        data_tables=table_hashes(*TABLES, table_name(scene.solar), PHASE_TABLE, *BANDS_TABLES),
        sources=[SOLAR_SPECTRA[scene.solar], phase_function(scene.phase).source],
        seed=simulation.seed,
        files={name: _made(content) for name, content in files.items()},
    )


def _made(content: bytes) -> Any:
    return lambda: content


def _table(result: Mapping[str, Any]) -> TextTable:
    shares = ", ".join(f"{name} {100 * share:.0f} %" for name, share in result["composition"].items() if share)
    notes = [
        f"lit ground in the SWIR field of view: {shares}; rock covers {100 * result['rock_fraction']:.0f} % of it, "
        f"{100 * result['shadow_fraction']:.0f} % of the field lies in shadow",
        "Synthetic: made up, not a measurement. Strengths of bands, albedo and texture are assumed.",
    ]
    rows = [[item["name"], str(item["bytes"])] for item in result["files"]]
    return TextTable(["file", "bytes"], rows, title=f"{result['observation']}", notes=notes)
