"""`lunarsci regolith`: what the ground is."""

import typer

from . import compare, forces, identify, infer

__all__ = ["app"]

app = typer.Typer(
    no_args_is_help=True,
    help="What the ground is: wheel-soil forces, the soil that wheel states reveal, and soils alike.",
)
for part in (forces, identify, infer, compare):
    part.add_to(app)
