"""`lunarsci spectra simulate`: synthetic VNIS products of a made-up scene."""

from dataclasses import replace
from typing import Annotated, Literal

import typer

from ..shared.command import command
from ..shared.report import Report

__all__ = ["add_to"]


def add_to(app: typer.Typer) -> None:
    """Register the command."""
    command(app, "simulate", folder=True)(simulate)


def simulate(
    soil: Annotated[
        str, typer.Option(metavar="MINERALS", help="Fractions of ol, opx, cpx, plg that add up to 1.")
    ] = "ol=0.05,opx=0.20,cpx=0.20,plg=0.55",
    rock: Annotated[
        str | None, typer.Option(metavar="MINERALS", help="The same for a rock in the image; none if left out.")
    ] = None,
    rock_radius: Annotated[float, typer.Option(help="Radius of the rock in px; the SWIR detector sees 53.8.")] = 54.0,
    shadow: Annotated[float, typer.Option(help="Share of the image in shadow, 0 to below 1.")] = 0.0,
    incidence: Annotated[float, typer.Option(help="Angle of the Sun from the normal in deg.")] = 64.412,
    emission: Annotated[float, typer.Option(help="Angle of the view from the normal in deg.")] = 45.557,
    phase_angle: Annotated[float, typer.Option(help="Angle between Sun and view in deg.")] = 54.505,
    photometry: Annotated[
        Literal["lommel-seeliger", "akimov", "mcewen", "none"],
        typer.Option(help="Disk function that the ground obeys; none for the same reflectance at all angles."),
    ] = "akimov",
    phase: Annotated[
        Literal["sp-low", "sp-mid", "sp-high", "flat"], typer.Option(help="Phase function that the ground obeys.")
    ] = "sp-high",
    noise: Annotated[float, typer.Option(help="Factor on the instrument's noise; 0 for none.")] = 1.0,
    time: Annotated[str, typer.Option(help="UTC time of the short-wave scan, ISO 8601.")] = "2020-07-16T08:20:00",
    sequence: Annotated[int, typer.Option(min=1, max=9999, help="Number of the observation.")] = 1,
    seed: Annotated[int, typer.Option(min=0, help="Seed of texture, shadows and noise.")] = 0,
) -> Report:
    """Synthetic VNIS products of a made-up scene: image cube, table, labels, and the truth.

    -o DIR writes them; every name and label says SYNTHETIC.
    """
    from lunarsci.spectra.photometry import Geometry
    from lunarsci.spectra.vnis.simulation.instrument import Instrument
    from lunarsci.spectra.vnis.simulation.instrument import simulate as simulated
    from lunarsci.spectra.vnis.simulation.scene import ROCK, SOIL, Scene, SceneRock

    from .simulate_report import composition, moment, simulate_report

    scene = Scene(
        soil=replace(SOIL, composition=composition(soil)),
        rock=SceneRock(replace(ROCK, composition=composition(rock)), radius_px=rock_radius) if rock else None,
        shadow_fraction=shadow,
        geometry=Geometry(incidence, emission, phase_angle),
        disk=None if photometry == "none" else photometry,
        phase=phase,
        time=moment(time),
        sequence=sequence,
    )
    return simulate_report(simulated(scene, Instrument(noise=noise), seed))
