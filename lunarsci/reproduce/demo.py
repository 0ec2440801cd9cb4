"""The demonstration: the whole chain on synthetic data.

From pictures to the ground, from products to minerals, and from a drive to its soil.
"""

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from functools import cache, partial
from importlib.util import find_spec
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np
from matplotlib.figure import Figure

from lunarsci.constants import MGM, NBSR, PAPER
from lunarsci.figure import picture_bytes, styled
from lunarsci.images.jobs.dem import StereoTerrain, dem
from lunarsci.images.jobs.render import render
from lunarsci.images.rig_files import read_rig, rig_text
from lunarsci.io.inputs import InputFile
from lunarsci.io.tables import csv_bytes, table_hashes
from lunarsci.pages.documents import document_of
from lunarsci.pages.page import Page
from lunarsci.pages.relief import drives
from lunarsci.provenance import Provenance, plain
from lunarsci.regolith.figure import characteristic_curves
from lunarsci.regolith.identify import Assumptions, Identification, identify
from lunarsci.regolith.soil import Soil, read_soil
from lunarsci.regolith.states import read_states
from lunarsci.regolith.wheel import read_wheel
from lunarsci.result import MadeFrom, Result
from lunarsci.spectra.abundance.shares import PRIOR
from lunarsci.spectra.bands import SpectrumBands, measure_bands
from lunarsci.spectra.jobs.unmix import UnmixedSpectra, unmix
from lunarsci.spectra.mgm.assemblages import TABLES
from lunarsci.spectra.mgm.figure import band_pages, fit_pages
from lunarsci.spectra.mgm.fit import fit_spectra
from lunarsci.spectra.mgm.model import mgm_model
from lunarsci.spectra.mgm.result import MgmFit
from lunarsci.spectra.vnis.calibrate import calibrate
from lunarsci.spectra.vnis.calibration import Calibration, calibration_pages, to_ecsv
from lunarsci.spectra.vnis.channels import SPLICED_NM
from lunarsci.spectra.vnis.detector import default_settings
from lunarsci.spectra.vnis.observation import read_observation
from lunarsci.spectra.vnis.simulation.instrument import Truth, simulate
from lunarsci.spectra.vnis.simulation.scene import BANDS, Scene, SceneRock
from lunarsci.spectra.vnis.simulation.template import product_files
from lunarsci.twin.figures.prediction import path_fan
from lunarsci.twin.ground.synthetic import synthetic_longji
from lunarsci.twin.ground.terrain import terrain_bytes
from lunarsci.twin.jobs.drive_inputs import DriveInputs, read_drive_inputs
from lunarsci.twin.judgement.safety import Verdict, judge
from lunarsci.twin.judgement.tables import state_table
from lunarsci.twin.simulation.ensemble import Prediction, predict

SOIL = "longji"
"""Soil of all the demonstration."""
AHEAD_M, BEHIND_M, WIDTH_PX = (1.0, 0.0), 2.0, 400
"""Place whose height is looked up in the pictures, how far behind the start of the drive the cameras stand, as a mast
sees no ground nearer than some 1.3 m, and the width of the pictures, to be done in seconds; assumed."""


@dataclass(frozen=True, slots=True)
class SeenGround:
    """A SYNTHETIC stereo pair of the ground ahead, and the heights in it.

    Attributes
    ----------
    pictures : content of the files by name.
    heights : elevation model of the pair.
    height_m, sigma_m : height of the node nearest to `AHEAD_M`, and its standard error. [m]
    truth_m : mean height of what the pictures show of its cell. [m]
    """

    pictures: dict[str, bytes]
    heights: StereoTerrain
    height_m: float
    sigma_m: float
    truth_m: float


def _ground_ahead(seed: int) -> SeenGround | None:
    """Pictures of the terrain of the drive with a camera of few pixels, and heights from them; None without OpenCV."""
    if find_spec("cv2") is None:
        return None
    with TemporaryDirectory() as name:
        folder = Path(name)
        (folder / "terrain.npz").write_bytes(terrain_bytes(synthetic_longji(read_soil(SOIL))))
        (folder / "camera.toml").write_text(rig_text(read_rig("yutu2-navcam").with_pixels(WIDTH_PX)))
        pair = render(
            str(folder / "terrain.npz"),
            rig=str(folder / "camera.toml"),
            x=-BEHIND_M,
            spacing=0.025,
            rocks=0.4,
            samples=1,
            seed=seed,
        )
        made = {name: make() for name, make in pair.files().items() if name != "truth.npz"}
        for name, content in made.items():
            (folder / name).write_bytes(content)
        heights = dem(
            folder / "left.png", folder / "right.png", rig=str(folder / "rig.toml"), pose=str(folder / "pose.toml")
        )
    model, points = heights.model, pair.pair.truth.points_m
    covered = np.isfinite(model.height_m)
    away = np.hypot(*np.meshgrid(model.x_m - AHEAD_M[0], model.y_m - AHEAD_M[1]))
    row, column = np.unravel_index(np.where(covered, away, np.inf).argmin(), covered.shape)
    inside = np.abs(points[..., :2] - [model.x_m[column], model.y_m[row]]).max(axis=-1) <= 0.5 * model.spacing_m
    error = float(
        np.hypot(model.layer("height_m_sigma")[row, column], model.layer("height_m_common_sigma")[row, column])
    )
    return SeenGround(made, heights, float(model.height_m[row, column]), error, float(points[inside, 2].mean()))


@dataclass(frozen=True, slots=True)
class StudiedRock:
    """The synthetic rock as the spectrometer sees it, and what three methods find in it.

    Attributes
    ----------
    products : content of the spectrometer's files by name.
    truth : that the products were simulated from.
    calibration : reflectance from the products.
    bands, fit, shares : band parameters, Gaussians and shares of minerals of the calibrated spectrum.
    """

    products: dict[str, bytes]
    truth: Truth
    calibration: Calibration
    bands: SpectrumBands
    fit: MgmFit
    shares: UnmixedSpectra


def _rock(seed: int) -> StudiedRock:
    """Simulate what the spectrometer sees of a rock, write and calibrate the products, measure and fit the spectrum."""
    simulation = simulate(Scene(rock=SceneRock(), shadow_fraction=0.05), seed=seed)
    products = product_files(simulation)
    with TemporaryDirectory() as folder:
        for name, content in products.items():
            (Path(folder) / name).write_bytes(content)
        label = next(name for name in products if name.endswith(".2BL"))
        calibration = calibrate(read_observation(str(Path(folder) / label)))
    spectrum = calibration.to_spectrum()
    [fit] = fit_spectra([spectrum], mgm_model())
    if not isinstance(fit, MgmFit):
        raise RuntimeError(fit.status)
    shares = unmix(spectrum, kind="solid-rock", prior=PRIOR)
    return StudiedRock(products, simulation.truth, calibration, measure_bands(spectrum), fit, shares)


def _rock_findings(the_rock: StudiedRock) -> list[dict[str, Any]]:
    """What was found in the rock, beside what went into it."""
    at, item = int((SPLICED_NM == 750.0).argmax()), the_rock.calibration
    error = float(np.hypot(item.sigma[at], item.systematic_total[at]))
    name, truth = "rock: reflectance factor at 750 nm", float(the_rock.truth.reflectance[at])
    findings = [_finding(name, float(item.reflectance[at]), error, truth, "-", "calibration.png")]
    for key in ("1000", "2000"):
        band = the_rock.bands.bands[key]
        if band.center_nm is not None:
            findings.append(
                _finding(
                    f"rock: centre of the {key} nm band", band.center_nm, band.center_sigma_nm, None, "nm", "bands.png"
                )
            )
    for region, number in (("um1", "1"), ("um2", "2")):
        ratio = the_rock.fit.nbsr[region]
        if ratio is not None:
            opx, cpx = _strengths(the_rock.truth, number)
            name = f"rock: OPX / (OPX + CPX) band strength at {number} µm"
            findings.append(_finding(name, ratio.opx, ratio.sigma, opx / (opx + cpx), "-", "fit.png"))
    for share in the_rock.shares.shares[0].fractions:
        name, error = f"rock: share of {share.mineral} by volume", (share.high - share.low) / 2
        truth = float(getattr(the_rock.truth.composition, share.mineral))
        findings.append(_finding(name, share.fraction, error, truth, "-", "shares.png"))
    return findings


def _strengths(truth: Truth, number: str) -> tuple[float, float]:
    """True strengths of the pyroxene bands at 1 or 2 um, but for a common factor."""
    shares = truth.composition
    opx = shares.orthopyroxene * BANDS[f"OPX {number}"].strength
    return opx, shares.clinopyroxene * BANDS[f"CPX {number}"].strength


def _finding(what: str, value: float, sigma: float | None, truth: float | None, unit: str, file: str) -> dict[str, Any]:
    """One row of the demonstration's result; `truth` is None where there is none."""
    return {"quantity": what, "value": value, "sigma": sigma, "truth": truth, "unit": unit, "picture": file}


@dataclass(frozen=True, slots=True)
class PredictedDrive:
    """The swept prediction, and one drive on a soil that is given.

    scene : rover, terrain and plan.
    prediction : over the plan's sweep.
    verdict : on that.
    states : CSV of the wheel states of the one drive.
    """

    scene: DriveInputs
    prediction: Prediction
    verdict: Verdict
    states: bytes


def _drive(seed: int) -> PredictedDrive:
    """Predict the embedded drive over its sweep, and once on the known soil."""
    scene = read_drive_inputs(None, "yutu2", "synthetic-longji", soil=SOIL)
    swept = predict(scene.rover, scene.terrain, scene.plan, seed=seed)
    once = predict(scene.rover, scene.terrain, scene.plan, sweep=(), seed=seed)
    return PredictedDrive(scene, swept, judge(swept, scene.plan), csv_bytes(state_table(once)))


def _ground(driven: PredictedDrive, seed: int) -> Identification:
    """Identify the soil from the wheel states of the drive; cohesion and lateral modulus are taken as known."""
    wheel, truth = read_wheel("yutu2"), read_soil(SOIL)
    states = read_states(InputFile("wheel_states.csv", driven.states), wheel)
    given = Assumptions(
        exponent=truth.sinkage_exponent,
        cohesion_pa=truth.cohesion_pa,
        lateral_modulus_mm=(truth.lateral_modulus_mm,),
    )
    return identify(states, wheel, given, draws=256, seed=seed)


@dataclass(frozen=True, slots=True)
class Demonstration(Result):
    """The ground in pictures, a rock, a drive and the soil that it reveals, all made up from a seed.

    `seen` is None where OpenCV is not installed.
    """

    seed: int
    seen: SeenGround | None
    rock: StudiedRock
    drive: PredictedDrive
    soil: Identification
    schema = "demo/1"

    @property
    def made_from(self) -> MadeFrom:
        shares = self.rock.shares.made_from
        tables = table_hashes(*default_settings().tables, *TABLES) | dict(shares.tables) | self.drive.scene.tables
        return MadeFrom(tables=tables, sources=[PAPER, MGM, NBSR, *shares.sources], seed=self.seed)

    def to_dict(self) -> dict[str, Any]:
        return {"findings": self.rows(), "synthetic": True, "pictures": sorted(self.pictures)}

    def rows(self) -> list[dict[str, Any]]:
        """One a quantity that was found, beside the truth where there is one."""
        height, pictured = "pictures: height of the ground 3 m ahead", list[dict[str, Any]]()
        if self.seen is not None:
            heights = (self.seen.height_m, self.seen.sigma_m, self.seen.truth_m)
            pictured = [_finding(height, *heights, "m", "ground.png")]
        return [
            *pictured,
            *_rock_findings(self.rock),
            *_drive_findings(self.drive),
            *_soil_findings(self.soil, read_soil(SOIL)),
        ]

    @property
    def pictures(self) -> dict[str, Callable[[], bytes]]:
        """File name to what draws it."""
        return _pictures(self.seen, self.rock, self.drive, self.soil)

    @property
    def files(self) -> dict[str, Callable[[], bytes]]:
        """File name to what makes its content: products, spectrum, wheel states and pictures."""
        record = {"command": "lunarsci demo", "seed": self.seed}
        made = ({} if self.seen is None else self.seen.pictures) | self.rock.products
        drawn = {name: cache(draw) for name, draw in self.pictures.items()}
        page = {"report.html": lambda: self._page(drawn)} if find_spec("jinja2") else {}
        return {
            **{name: partial(bytes, content) for name, content in made.items() if name != "result.json"},
            "rock.ecsv": lambda: to_ecsv([self.rock.calibration], record),
            "wheel_states.csv": lambda: self.drive.states,
            **drawn,
            **page,
        }

    def _page(self, drawn: Mapping[str, Callable[[], bytes]]) -> bytes:
        """Findings and pictures as a page, with the ground of the drive; without time, as all its files."""
        made, prediction = self.made_from, self.drive.prediction
        record = Provenance(command="lunarsci demo", tables=made.tables, sources=made.sources, seed=self.seed)
        pictures = {name: draw() for name, draw in drawn.items()}
        document = document_of(self.schema, plain(self.to_dict()), record.to_dict(time=False), pictures=pictures)
        ends = prediction.recorded
        ways = [prediction.places_m[k, : max(int(ends[k]), 1)] for k in range(prediction.members)]
        return Page(
            "lunarsci demo", [document], ground=self.drive.scene.terrain, ways=drives("predicted drives", ways)
        ).html(time=False)


def demo(seed: int = 0, *, say: Callable[[str], None] = lambda step: None) -> Demonstration:
    """Run the whole chain; `say` is told each step."""
    say("1/4 synthetic pictures of the ground ahead, and heights from them")
    seen = _ground_ahead(seed)
    if seen is None:
        say("    left out: pictures need OpenCV; pip install 'lunarsci[images]'")
    say("2/4 a synthetic rock: calibration, bands, Modified Gaussian Model and shares of minerals")
    rock = _rock(seed)
    say("3/4 a drive of 9.8 m on synthetic terrain, over 81 soils")
    drive = _drive(seed)
    say("4/4 the soil that the wheels of that drive reveal")
    return Demonstration(seed, seen, rock, drive, _ground(drive, seed))


def _drive_findings(the_drive: PredictedDrive) -> list[dict[str, Any]]:
    limits = {limit.quantity: limit for limit in the_drive.verdict.limits}
    slip, end = limits["slip_ratio"], the_drive.verdict.endpoint
    findings = [_finding("drive: largest slip ratio, 95 % of drives below", slip.p95, None, None, "-", "drive.png")]
    if end is not None:
        findings.append(
            _finding("drive: all ends within, of the destination", end.covering_radius_m, None, None, "m", "drive.png")
        )
    return findings


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


def _pictures(
    seen: SeenGround | None, rock: StudiedRock, drive: PredictedDrive, soil: Identification
) -> dict[str, Callable[[], bytes]]:
    """File name to what draws it."""
    pages: dict[str, Callable[[], Iterable[Figure]]] = {} if seen is None else {"ground.png": seen.heights.figures}
    pages |= {
        "calibration.png": lambda: calibration_pages([rock.calibration]),
        "bands.png": lambda: band_pages([rock.bands]),
        "fit.png": lambda: fit_pages([rock.fit]),
        "shares.png": rock.shares.figures,
        "drive.png": lambda: [path_fan(drive.prediction, drive.verdict)],
        "soil.png": lambda: [characteristic_curves(soil, synthetic=True)],
    }

    def drawn(name: str) -> bytes:
        with styled():
            return picture_bytes(pages[name](), Path(name))

    return {name: partial(drawn, name) for name in pages}
