"""`lunarsci spectra library`: end-member spectra with what is known of them."""

from pathlib import Path
from typing import Annotated, Literal

import typer

from ..shared.command import command
from ..shared.options import Output
from ..shared.report import Report
from .options import Files, ReflectanceUnit, WavelengthUnit

__all__ = ["app"]

app = typer.Typer(
    no_args_is_help=True,
    help="Libraries of end-member spectra: make one from laboratory files, list, draw and check it.",
)

Libraries = Annotated[
    list[str], typer.Argument(help="Libraries (.ecsv of `library import`), or other files of spectra; - is stdin.")
]


@command(app, "import")
def import_(
    files: Files,
    output: Output,
    mineral: Annotated[
        Literal["olivine", "orthopyroxene", "clinopyroxene", "plagioclase", "opaque", "glass", "other"] | None,
        typer.Option(help="Mineral of all spectra of which --metadata says nothing."),
    ] = None,
    metadata: Annotated[
        str | None,
        typer.Option(
            metavar="FILE.csv",
            help="Table by id: mineral, fo, fs, en, wo, an (0 to 1), min_um, max_um, source; or, instead of the "
            "mineral, modes vol_ol, vol_opx, vol_cpx, vol_plg and opx_fs, cpx_fs and the like. Mixtures are left out.",
        ),
    ] = None,
    source: Annotated[str, typer.Option(metavar="TEXT", help="Where spectra come from whose source is unknown.")] = "",
    wavelength_unit: WavelengthUnit = None,
    reflectance_unit: ReflectanceUnit = None,
) -> Report:
    """Make a library from RELAB, USGS splib07, ENVI .sli, CSV, ECSV or FITS files: -o LIBRARY.ecsv writes it.

    Libraries among the files are merged.
    """
    from .library_report import import_report, imported

    found = imported(files, mineral, metadata, source, wavelength_unit, reflectance_unit)
    return import_report(found, output.path)


@command(app, "list")
def list_(files: Libraries) -> Report:
    """What a library holds."""
    from .library_report import list_report, read_libraries

    return list_report(read_libraries(files))


@command(app, "check")
def check(files: Libraries) -> Report:
    """What must be mended before a library is used, and what one should know; exit code 3 where something must."""
    from .library_report import check_report, read_libraries

    return check_report(read_libraries(files))


@command(app, "plot")
def plot(files: Libraries, output: Output) -> Report:
    """Draw a library, one panel for each mineral: -o FILE.png, .svg or .pdf."""
    from .library_report import list_report, read_libraries

    if output.plot is None and (output.path is None or not _is_picture(output.path)):
        raise typer.BadParameter("name the picture: -o FILE.png, .svg or .pdf")
    return list_report(read_libraries(files))


def _is_picture(path: Path) -> bool:
    return path.suffix.lower() in (".png", ".svg", ".pdf")
