"""`lunarsci spectra`: what the rock is made of."""

import typer

from . import bands, calibrate, fit, indices, library, map, match, simulate, unmix


def add_to(group: typer.Typer) -> None:
    """Register the commands."""
    for part in (calibrate, simulate, bands, indices, fit, unmix, match, map, library):
        part.add_to(group)
