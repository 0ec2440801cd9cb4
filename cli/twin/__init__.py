"""`lunarsci twin`: whether the next drive is safe."""

import typer

from . import compare, forces, history, loads, plan, predict, simulate, states, terrain, update

__all__ = ["app"]

TEXT = "Whether the next drive is safe: a rover simulated on deformable ground."

app = typer.Typer(no_args_is_help=True, help=TEXT)
for part in (predict, terrain, plan, simulate, states, forces, loads, update, compare, history):
    part.add_to(app)
