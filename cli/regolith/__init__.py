"""`lunarsci regolith`: what the ground is."""

import typer

from . import compare, forces, identify, infer


def add_to(group: typer.Typer) -> None:
    """Register the commands."""
    for part in (forces, identify, infer, compare):
        part.add_to(group)
