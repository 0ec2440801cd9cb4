"""`lunarsci images`: from the rover's pictures to terrain, positions and tracks."""

import typer

from . import calibrate, cameras, dem, locate, merge, render, rocks, track


def add_to(group: typer.Typer) -> None:
    """Register the commands."""
    for part in (cameras, calibrate, render, dem, locate, merge, track, rocks):
        part.add_to(group)
