"""Options that several regolith commands share."""

from typing import Annotated, Literal

import typer

__all__ = ["Reading", "Rover"]

Rover = Annotated[str, typer.Option(help="Rover whose wheel it is: a name (yutu2) or a TOML file.")]
Reading = Annotated[
    Literal["signed", "printed", "slip-branch"],
    typer.Option(help="Sign of the shear law: signed agrees with measured wheels; the others only reproduce numbers."),
]
