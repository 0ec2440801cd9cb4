"""Options that the commands of `lunarsci spectra` share."""

from typing import Annotated

import typer

from ..shared.options import option

Files = Annotated[
    list[str],
    typer.Argument(
        help="Spectra: ECSV, CSV or text (first column wavelength, then one or many spectra), RELAB .tab/.asc, FITS "
        "table, ENVI library (.sli, .hdr), USGS splib07 text, VNIS products (.2BL, .2B); several files, folders or "
        "patterns; - is stdin."
    ),
]
UNITS = {
    "wavelength_unit": option("State the unit of the wavelengths where the file does not."),
    "reflectance_unit": option("State the unit of the reflectance."),
}
