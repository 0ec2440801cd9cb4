"""Synthetic VNIS products of a made-up scene: what can be asked, and the files with the truth."""

from collections.abc import Iterator
from contextlib import suppress
from dataclasses import dataclass, replace
from datetime import UTC, datetime
from typing import TYPE_CHECKING, Any

from lunarsci.errors import ParameterError
from lunarsci.io.tables import table_hashes
from lunarsci.minerals import MINERALS, WORDS
from lunarsci.options import request_of
from lunarsci.result import MadeFrom, Result
from lunarsci.spectra.jobs.requests import SimulateVnisRequest
from lunarsci.spectra.mgm.assemblages import TABLES as BANDS_TABLES
from lunarsci.spectra.photometry import TABLE as PHASE_TABLE
from lunarsci.spectra.photometry import Geometry, phase_function
from lunarsci.spectra.rows import number
from lunarsci.spectra.solar import SOLAR_SPECTRA, table_name
from lunarsci.spectra.vnis.channels import TABLES
from lunarsci.spectra.vnis.simulation.instrument import Instrument, Simulation
from lunarsci.spectra.vnis.simulation.instrument import simulate as simulated
from lunarsci.spectra.vnis.simulation.scene import ROCK, SOIL, Scene, SceneComposition, SceneRock
from lunarsci.spectra.vnis.simulation.template import product_files, simulation_page

if TYPE_CHECKING:
    from matplotlib.figure import Figure


def scene_of(request: SimulateVnisRequest) -> Scene:
    """What is looked at. Raises ParameterError for what there cannot be."""
    rock = request.rock and SceneRock(
        replace(ROCK, composition=_composition(request.rock)), radius_px=request.rock_radius
    )
    return Scene(
        soil=replace(SOIL, composition=_composition(request.soil)),
        rock=rock or None,
        shadow_fraction=request.shadow,
        geometry=Geometry(request.incidence, request.emission, request.phase_angle),
        disk=None if request.photometry == "none" else request.photometry,
        phase=request.phase,
        time=_moment(request.time),
        sequence=request.sequence,
    )


@dataclass(frozen=True, slots=True)
class SimulatedVnis(Result):
    """A synthetic observation and its files, name to content."""

    simulation: Simulation
    files: dict[str, bytes]
    schema = "spectra-simulate/1"

    @property
    def made_from(self) -> MadeFrom:
        scene = self.simulation.scene
        return MadeFrom(
            tables=table_hashes(*TABLES, table_name(scene.solar), PHASE_TABLE, *BANDS_TABLES),
            sources=[SOLAR_SPECTRA[scene.solar], phase_function(scene.phase).source],
            seed=self.simulation.seed,
        )

    def to_dict(self) -> dict[str, Any]:
        truth = self.simulation.truth
        return {
            "synthetic": True,
            "observation": f"SYNTHETIC-CE4-{self.simulation.scene.sequence:04d}",
            "files": [{"name": name, "bytes": len(content)} for name, content in self.files.items()],
            "composition": truth.composition.fractions,
            "rock_fraction": truth.rock_fraction,
            "shadow_fraction": truth.shadow_fraction,
            "wavelength_nm": truth.wavelength_nm,
            "reflectance": truth.reflectance,
        }

    def rows(self) -> list[dict[str, Any]]:
        """One a channel: the true reflectance factor."""
        truth = self.simulation.truth
        pairs = zip(truth.wavelength_nm, truth.reflectance, strict=True)
        return [{"wavelength_nm": wavelength, "reflectance": value} for wavelength, value in pairs]

    def figures(self) -> "Iterator[Figure]":
        yield simulation_page(self.simulation)


def simulate(request: SimulateVnisRequest | None = None, **options: Any) -> SimulatedVnis:
    """What VNIS would have measured of a made-up scene. Raises ParameterError for what there cannot be."""
    asked = request_of(SimulateVnisRequest, request, options)
    simulation = simulated(scene_of(asked), Instrument(noise=asked.noise), asked.seed)
    return SimulatedVnis(simulation, product_files(simulation))


def _composition(text: str) -> SceneComposition:
    """A composition from `ol=0.1,opx=0.3,cpx=0.2,plg=0.4`. Raises ParameterError for anything else."""
    keys = {key.lower(): name for key, name in MINERALS.items() if name in SceneComposition.__dataclass_fields__}
    fractions: dict[str, float] = {}
    for part in text.split(","):
        key, _, value = part.partition("=")
        name = WORDS.get(key.strip().lower(), "")
        fraction = number(value.strip())
        if name not in keys.values() or name in fractions or fraction is None:
            raise ParameterError(
                f"composition '{text[:60]}': '{part}' is none of {', '.join(keys)} = fraction, each once; write "
                "ol=0.1,opx=0.9"
            )
        fractions[name] = fraction
    return SceneComposition(**fractions)


def _moment(text: str) -> datetime:
    """A UTC time from ISO 8601. Raises ParameterError."""
    time = datetime.min
    with suppress(ValueError):
        time = datetime.fromisoformat(text)
    if not 1960 <= time.year < 2100:
        raise ParameterError(f"'{text[:40]}' is no time from 1960 to 2099; write it as 2020-07-16T08:20:00")
    return time.replace(tzinfo=UTC) if time.tzinfo is None else time.astimezone(UTC)
