"""Options that the commands of `lunarsci spectra` share."""

from typing import Annotated

import typer

from lunarsci.registry import FORMATS

from ..shared.options import option

Files = Annotated[
    list[str],
    typer.Argument(
        metavar="FILE",
        help=f"Spectra: {', '.join(one.title for one in reversed(FORMATS.values()))}, VNIS products (.2BL, .2B); "
        "several files, folders or patterns; - is stdin.",
    ),
]
FILE = "What the file does not say"
UNITS = {
    "wavelength_unit": option(panel=FILE),
    "reflectance_unit": option(panel=FILE),
}
ONLY = {"id": option(panel=FILE, metavar="NAME")}
