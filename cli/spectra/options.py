"""Options that the commands of `lunarsci spectra` share."""

from typing import Annotated

import typer

from ..shared.options import option

Files = Annotated[
    list[str],
    typer.Argument(
        metavar="FILE",
        help="Spectra: ECSV, CSV, text or Excel (first column wavelength, then spectra), RELAB .tab/.asc, PDS, FITS "
        "table, ENVI library (.sli, .hdr), USGS splib07 text, JCAMP-DX, JSON, VOTable, VNIS products (.2BL, .2B); "
        "several files, folders or "
        "patterns; - is stdin.",
    ),
]
FILE = "What the file does not say"
UNITS = {
    "wavelength_unit": option(panel=FILE),
    "reflectance_unit": option(panel=FILE),
}
ONLY = {"id": option(panel=FILE, metavar="NAME")}
