"""Options that several regolith commands share."""

from typing import Annotated, Literal

import typer

__all__ = ["Reading", "Rover"]

Rover = Annotated[
    str, typer.Option(help="Rover or wheel: a name (yutu2, cmu-grouser, hit-smooth, rashid-1, lrv …) or a TOML file.")
]
Reading = Annotated[
    Literal["signed", "printed", "slip-branch"],
    typer.Option(help="Sign of the shear law: signed agrees with measured wheels; the others only reproduce numbers."),
]
