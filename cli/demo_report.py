"""The steps of the demonstration, and its `Report`."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from lunarsci.figure import picture_bytes
from lunarsci.inputs import InputFile
from lunarsci.regolith.identify import Assumptions, Identification, identify
from lunarsci.regolith.soil import Soil, read_soil
from lunarsci.regolith.states import read_states
from lunarsci.regolith.wheel import read_wheel
from lunarsci.spectra.bands import SpectrumBands, measure_bands
from lunarsci.spectra.mgm.assemblages import assemblage
from lunarsci.spectra.mgm.assemblages import table_hash as bands_hash
from lunarsci.spectra.mgm.fit import fit_spectra
from lunarsci.spectra.mgm.result import MgmFit
from lunarsci.spectra.readers import read_spectra
from lunarsci.spectra.synthetic import rock_strengths, synthetic_rock, to_csv
from lunarsci.spectra.synthetic import table_hash as rock_hash
from lunarsci.twin.ensemble import Prediction, predict
from lunarsci.twin.safety import Verdict, judge
from lunarsci.twin.tables import state_table

from .regolith_report import PAPER
from .report import Report
from .spectra_report import MGM, NBSR
from .table import TextTable, plus_minus
from .twin_report import Scene, csv_bytes, read_scene

if TYPE_CHECKING:
    from matplotlib.figure import Figure

__all__ = ["demo_report", "drive", "ground", "rock"]

SOIL = "longji"


@dataclass(frozen=True, slots=True)
class Rock:
    """The synthetic rock as a file, and what the two spectral methods find in it."""

    file: bytes
    bands: SpectrumBands
    fit: MgmFit


@dataclass(frozen=True, slots=True)
class Drive:
    """The swept prediction, its verdict, and the wheel states of one drive on a known soil."""

    scene: Scene
    prediction: Prediction
    verdict: Verdict
    states: bytes


def rock(seed: int) -> Rock:
    """Make the rock, write and read it as a file would be, measure and fit it."""
    file = to_csv(synthetic_rock(seed=seed))
    [spectrum] = read_spectra(InputFile("synthetic_rock.csv", file))
    [fit] = fit_spectra([spectrum], assemblage("OL-OPX-CPX"))
    if not isinstance(fit, MgmFit):
        raise RuntimeError(fit.status)
    return Rock(file, measure_bands(spectrum), fit)


def drive(seed: int) -> Drive:
    """Predict the embedded drive over its sweep, and once on the known soil."""
    scene = read_scene(None, "yutu2", "synthetic-longji", SOIL)
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


def demo_report(the_rock: Rock, the_drive: Drive, soil: Identification, seed: int, folder: Path | None) -> Report:
    """The report of `demo`."""
    findings = [*_rock_findings(the_rock), *_drive_findings(the_drive), *_soil_findings(soil, read_soil(SOIL))]
    return Report(
        schema="demo/1",
        result={"findings": findings, "synthetic": True, "pictures": sorted(_pictures(the_rock, the_drive, soil))},
        tables=[_table(findings, folder)],
        rows=findings,
        data_tables=bands_hash() | rock_hash() | the_drive.scene.tables,
        sources=[PAPER, MGM, NBSR],
        seed=seed,
        files={
            "synthetic_rock.csv": lambda: the_rock.file,
            "wheel_states.csv": lambda: the_drive.states,
            **_pictures(the_rock, the_drive, soil),
        },
    )


def _finding(what: str, value: float, sigma: float | None, truth: float | None, unit: str, file: str) -> dict[str, Any]:
    return {"quantity": what, "value": value, "sigma": sigma, "truth": truth, "unit": unit, "picture": file}


def _rock_findings(the_rock: Rock) -> list[dict[str, Any]]:
    strengths, found = rock_strengths(), []
    for key in ("1000", "2000"):
        band = the_rock.bands.bands[key]
        if band.center_nm is not None:
            found.append(
                _finding(
                    f"rock: centre of the {key} nm band", band.center_nm, band.center_sigma_nm, None, "nm", "bands.png"
                )
            )
    for region, number in (("um1", "1"), ("um2", "2")):
        ratio = the_rock.fit.nbsr[region]
        if ratio is not None:
            opx, cpx = strengths[f"OPX {number}"], strengths[f"CPX {number}"]
            name = f"rock: OPX / (OPX + CPX) band strength at {number} µm"
            found.append(_finding(name, ratio.opx, ratio.sigma, opx / (opx + cpx), "-", "fit.png"))
    return found


def _drive_findings(the_drive: Drive) -> list[dict[str, Any]]:
    limits = {limit.quantity: limit for limit in the_drive.verdict.limits}
    slip, end = limits["slip_ratio"], the_drive.verdict.endpoint
    found = [_finding("drive: largest slip ratio, 95 % of drives below", slip.p95, None, None, "-", "drive.png")]
    if end is not None:
        found.append(
            _finding("drive: all ends within, of the destination", end.covering_radius_m, None, None, "m", "drive.png")
        )
    return found


def _soil_findings(soil: Identification, truth: Soil) -> list[dict[str, Any]]:
    names = {
        "stiffness_kpa_m_n": ("ground: stiffness K_s at N = 1", "kPa/m^N"),
        "friction_angle_deg": ("ground: internal friction angle", "deg"),
        "external_friction_angle_deg": ("ground: external friction angle", "deg"),
    }
    return [
        _finding(label, estimate.value, estimate.sigma, getattr(truth, name), unit, "soil.png")
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
        f"  lunarsci spectra fit {folder}/synthetic_rock.csv",
        f"  lunarsci regolith identify {folder}/wheel_states.csv --lateral-modulus 20",
    ]
    return TextTable(["what was found", "value", "truth", "unit", "picture"], rows, notes=notes)


def _digits(value: float) -> int:
    return 1 if abs(value) >= 10 else 3


def _pictures(the_rock: Rock, the_drive: Drive, soil: Identification) -> dict[str, Any]:
    def picture(name: str, figures: "Sequence[Figure]") -> bytes:
        return picture_bytes(figures, Path(name))

    def bands() -> bytes:
        from lunarsci.spectra.figure import band_pages

        return picture("bands.png", list(band_pages([the_rock.bands])))

    def fit() -> bytes:
        from lunarsci.spectra.figure import fit_pages

        return picture("fit.png", list(fit_pages([the_rock.fit])))

    def path() -> bytes:
        from lunarsci.twin.figure import path_fan

        return picture("drive.png", [path_fan(the_drive.prediction, the_drive.verdict)])

    def curves() -> bytes:
        from lunarsci.regolith.figure import characteristic_curves

        return picture("soil.png", [characteristic_curves(soil)])

    return {"bands.png": bands, "fit.png": fit, "drive.png": path, "soil.png": curves}
