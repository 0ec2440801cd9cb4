"""`lunarsci spectra map`: maps of bands, fits and shares of minerals from an image cube."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Annotated, Any

import typer

from lunarsci.spectra.jobs.requests import MapRequest

from ..shared.command import command
from ..shared.emit import Report
from ..shared.options import BLOCKS, Output, option
from ..shared.table import TextTable
from .options import FILE

if TYPE_CHECKING:
    from lunarsci.spectra.jobs.map_cube import CubeMap, PixelSpectrum

PIXELS, SETTINGS = "Pixels", "Products"

CubeFile = Annotated[
    str,
    typer.Argument(
        help="Image cube: ENVI (.img or .hdr), M3 reflectance (_RFL.IMG), GeoTIFF stack, NetCDF, VNIS image (.2B).",
        metavar="CUBE",
    ),
]
Spectrum = Annotated[
    str | None,
    typer.Option(
        metavar="X,Y",
        help="Write no map, but the spectrum of sample X and line Y (from 0) as a table for the other commands.",
        rich_help_panel=PIXELS,
    ),
]
OPTIONS = {
    "products": option(panel=SETTINGS, metavar="NAMES"),
    "roi": option(panel=PIXELS, metavar="BOX|FILE"),
    "mask": option(panel=PIXELS, metavar="FILE"),
    "every": option(panel=PIXELS, min=1, metavar="N"),
    "band_continuum": option(panel=SETTINGS),
    "smooth_nm": option(panel=SETTINGS, min=0),
    "assemblage": option(panel=SETTINGS, metavar="NAMES"),
    "continuum": option(panel=SETTINGS),
    "model_error": option(panel=SETTINGS),
    "starts": option(panel=SETTINGS, min=1),
    "neighbours": option("--neighbours/--no-neighbours", panel=SETTINGS),
    "contest_every": option(panel=SETTINGS, min=1, max=32),
    "kind": option(panel=SETTINGS),
    "both": option(panel=SETTINGS),
    "craters": option(panel=SETTINGS, metavar="FILE"),
    "single_precision": option(panel=SETTINGS),
    "wavelengths": option(panel=FILE, metavar="FILE"),
    "wavelength_unit": option(panel=FILE),
    "scale": option(panel=FILE),
    "ignore": option(panel=FILE),
    "saturated": option(panel=FILE),
    "locations": option(panel=FILE, metavar="FILE"),
}
EXAMPLES = (
    "lunarsci spectra map lunarsci-demo/*VD_SCI*.2B --spectrum 128,128",
    "lunarsci spectra map lunarsci-demo/*VD_SCI*.2B --products indices \\\n  --every 16 -o map.nc",
)


@command("map", EXAMPLES, OPTIONS, blocks=BLOCKS)
def maps(cube: CubeFile, request: MapRequest, output: Output, spectrum: Spectrum = None) -> Report:
    """Maps of an image cube: bands, indices, fits and shares in every pixel, with errors and flags.

    -o MAP.nc writes NetCDF (CF conventions), -o MAP.tif GeoTIFF; --plot draws a quick look.
    """
    from lunarsci.spectra.jobs.map_cube import map_cube, pixel

    if spectrum is not None:
        one = pixel(cube, spectrum, request)
        return Report(one, [_pixel_table(one)])
    result = map_cube(
        cube,
        output.path or "",
        request,
        force=output.force,
        time=not output.no_time,
        progress=output.progress("mapping lines"),
    )
    return Report(result, result_tables(result), written=[result.path])


def result_tables(result: CubeMap) -> list[TextTable]:
    """One row a layer of values."""
    record = result.to_dict()
    headers = ["layer", "what", "unit", "determined", "5 %", "median", "95 %"]
    rows = [_row(row) for row in record["layers"] if row["kind"] == "value"]
    return [TextTable(headers, rows, title=_title(record["cube"]), notes=_notes(record))]


def _row(row: Mapping[str, Any]) -> list[str]:
    share = "-" if row["determined"] is None else f"{100 * row['determined']:.0f} %"
    numbers = ["-" if row[key] is None else f"{row[key]:.4g}" for key in ("p05", "median", "p95")]
    return [row["name"], row["long_name"], "" if row["units"] == "1" else row["units"], share, *numbers]


def _title(cube: Mapping[str, Any]) -> str:
    good = cube["channels"] - cube["bad_channels"]
    size = f"{cube['lines']} lines of {cube['samples']} samples"
    reach = f"{good} good channels, {cube['first_nm']:.0f}-{cube['last_nm']:.0f} nm"
    return f"{cube['file']} ({cube['format']}): {size}, {reach}"


def _notes(record: Mapping[str, Any]) -> Sequence[str]:
    counts = record["pixels"]
    flags = [f"{count} {name.replace('_', ' ')}" for name, count in counts.items() if name != "pixels" and count]
    coded = [f"{row['name']}: {row['codes'].replace(' ', ', ')}" for row in record["layers"][1:] if row["codes"]]
    return [", ".join([f"{counts['pixels']} pixels", *flags]), *coded, *record["cube"]["remarks"]]


def _pixel_table(pixel: PixelSpectrum) -> TextTable:
    rows = [[f"{row['wavelength_nm']:.2f}", _shown(row[pixel.id])] for row in pixel.rows()]
    flags = [f"flags: {', '.join(pixel.flags)}"] if pixel.flags else []
    return TextTable(["wavelength [nm]", "reflectance"], rows, title=pixel.id, notes=flags)


def _shown(value: float) -> str:
    return "-" if value != value else f"{value:.6f}"
