"""`lunarsci regolith`: what the ground is."""

import typer

from . import regolith_compare, regolith_forces, regolith_identify

__all__ = ["app"]

app = typer.Typer(
    no_args_is_help=True,
    help="What the ground is: wheel-soil forces, the soil that wheel states reveal, and soils alike.",
)
regolith_forces.add_to(app)
regolith_identify.add_to(app)
regolith_compare.add_to(app)
