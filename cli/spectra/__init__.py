"""`lunarsci spectra`: what the rock is made of."""

import typer

from . import bands, calibrate, fit, match, simulate, unmix
from .library import app as library

__all__ = ["app"]

app = typer.Typer(
    no_args_is_help=True, help="What the rock is made of: absorption bands and minerals from reflectance spectra."
)
for part in (calibrate, simulate, bands, fit, unmix, match):
    part.add_to(app)
app.add_typer(library, name="library")
