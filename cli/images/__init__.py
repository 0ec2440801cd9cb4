"""`lunarsci images`: from the rover's pictures to terrain, positions and tracks."""

import typer

from . import merge, rocks, track


def add_to(group: typer.Typer) -> None:
    """Register the commands."""
    for part in (merge, track, rocks):
        part.add_to(group)
