"""`lunarsci images`: from the rover's pictures to terrain, positions and tracks."""

import typer

from . import dem, locate, merge, render, rocks, track


def add_to(group: typer.Typer) -> None:
    """Register the commands."""
    for part in (render, dem, locate, merge, track, rocks):
        part.add_to(group)
