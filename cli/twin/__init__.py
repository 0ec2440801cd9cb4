"""`lunarsci twin`: whether the next drive is safe."""

import typer

from . import compare, forces, history, loads, plan, predict, simulate, states, sweep, terrain, update


def add_to(group: typer.Typer) -> None:
    """Register the commands."""
    for part in (terrain, plan, predict, simulate, states, forces, loads, update, compare, history, sweep):
        part.add_to(group)
