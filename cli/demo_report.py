"""The steps of the demonstration, and its `Report`."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from lunarsci.csv_table import csv_bytes
from lunarsci.figure import picture_bytes
from lunarsci.inputs import InputFile
from lunarsci.regolith.contact import PAPER
from lunarsci.regolith.identify import Assumptions, Identification, identify
from lunarsci.regolith.soil import Soil, read_soil
from lunarsci.regolith.states import read_states
from lunarsci.regolith.wheel import read_wheel
from lunarsci.spectra.citations import MGM, NBSR
from lunarsci.spectra.mgm.assemblages import TABLES
from lunarsci.spectra.vnis.calibration import to_ecsv
from lunarsci.spectra.vnis.detector import default_settings
from lunarsci.tables import table_hashes
from lunarsci.twin.jobs.drive_inputs import DriveInputs, read_drive_inputs
from lunarsci.twin.judgement.safety import Verdict, judge
from lunarsci.twin.judgement.tables import state_table
from lunarsci.twin.simulation.ensemble import Prediction, predict

from .demo_rock import Studied, finding, rock_findings, rock_pictures
from .shared.report import Report
from .shared.table import TextTable, plus_minus

if TYPE_CHECKING:
    from matplotlib.figure import Figure

__all__ = ["demo_report", "drive", "ground"]

SOIL = "longji"


@dataclass(frozen=True, slots=True)
class Drive:
    """The swept prediction, its verdict, and the wheel states of one drive on a known soil."""

    scene: DriveInputs
    prediction: Prediction
    verdict: Verdict
    states: bytes


def drive(seed: int) -> Drive:
    """Predict the embedded drive over its sweep, and once on the known soil."""
    scene = read_drive_inputs(None, "yutu2", "synthetic-longji", soil=SOIL)
    swept = predict(scene.rover, scene.terrain, scene.plan, seed=seed)
    once = predict(scene.rover, scene.terrain, scene.plan, sweep=(), seed=seed)
    return Drive(scene, swept, judge(swept, scene.plan), csv_bytes(state_table(once)))


def ground(driven: Drive, seed: int) -> Identification:
    """Identify the soil from the wheel states of the drive; cohesion and lateral modulus are taken as known."""
    wheel, truth = read_wheel("yutu2"), read_soil(SOIL)
    states = read_states(InputFile("wheel_states.csv", driven.states), wheel)
    known = Assumptions(
        exponent=truth.sinkage_exponent,
        cohesion_pa=truth.cohesion_pa,
        lateral_modulus_mm=(truth.lateral_modulus_mm,),
    )
    return identify(states, wheel, known, draws=256, seed=seed)


def demo_report(the_rock: Studied, the_drive: Drive, soil: Identification, seed: int, folder: Path | None) -> Report:
    """The report of `demo`."""
    findings = [*rock_findings(the_rock), *_drive_findings(the_drive), *_soil_findings(soil, read_soil(SOIL))]
    return Report(
        schema="demo/1",
        result={"findings": findings, "synthetic": True, "pictures": sorted(_pictures(the_rock, the_drive, soil))},
        tables=[_table(findings, folder)],
        rows=findings,
        data_tables=table_hashes(*default_settings().tables, *TABLES) | the_drive.scene.tables,
        sources=[PAPER, MGM, NBSR],
        seed=seed,
        files={
            **{name: _made(content) for name, content in the_rock.products.items()},
            "rock.ecsv": lambda: to_ecsv([the_rock.calibration], {"command": "lunarsci demo", "seed": seed}),
            "wheel_states.csv": lambda: the_drive.states,
            **_pictures(the_rock, the_drive, soil),
        },
    )


def _made(content: bytes) -> Any:
    return lambda: content


def _drive_findings(the_drive: Drive) -> list[dict[str, Any]]:
    limits = {limit.quantity: limit for limit in the_drive.verdict.limits}
    slip, end = limits["slip_ratio"], the_drive.verdict.endpoint
    found = [finding("drive: largest slip ratio, 95 % of drives below", slip.p95, None, None, "-", "drive.png")]
    if end is not None:
        found.append(
            finding("drive: all ends within, of the destination", end.covering_radius_m, None, None, "m", "drive.png")
        )
    return found


def _soil_findings(soil: Identification, truth: Soil) -> list[dict[str, Any]]:
    names = {
        "stiffness_kpa_m_n": ("ground: stiffness K_s at N = 1", "kPa/m^N"),
        "friction_angle_deg": ("ground: internal friction angle", "deg"),
        "external_friction_angle_deg": ("ground: external friction angle", "deg"),
    }
    return [
        finding(label, estimate.value, estimate.sigma, getattr(truth, name), unit, "soil.png")
        for name, (label, unit) in names.items()
        if (estimate := soil.site[name]).value is not None
    ]


def _table(findings: Sequence[dict[str, Any]], folder: Path | None) -> TextTable:
    rows = [
        [
            f["quantity"],
            plus_minus(f["value"], f["sigma"], digits=_digits(f["value"])),
            plus_minus(f["truth"], digits=_digits(f["value"])),
            f["unit"],
            f["picture"],
        ]
        for f in findings
    ]
    notes = [
        "Everything here is synthetic: a rock that exists nowhere on ground that was made up.",
        f"Pictures and tables are in {folder}. Try the commands on them, for example:",
        f"  lunarsci spectra fit {folder}/rock.ecsv",
        f"  lunarsci regolith identify {folder}/wheel_states.csv --lateral-modulus 20",
    ]
    return TextTable(["what was found", "value", "truth", "unit", "picture"], rows, notes=notes)


def _digits(value: float) -> int:
    return 1 if abs(value) >= 10 else 3


def _pictures(the_rock: Studied, the_drive: Drive, soil: Identification) -> dict[str, Any]:
    def picture(name: str, figures: "Sequence[Figure]") -> bytes:
        return picture_bytes(figures, Path(name))

    def path() -> bytes:
        from lunarsci.twin.figures.fan import path_fan

        return picture("drive.png", [path_fan(the_drive.prediction, the_drive.verdict)])

    def curves() -> bytes:
        from lunarsci.regolith.figure import characteristic_curves

        return picture("soil.png", [characteristic_curves(soil)])

    return {**rock_pictures(the_rock), "drive.png": path, "soil.png": curves}
