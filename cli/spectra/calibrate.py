"""`lunarsci spectra calibrate`: VNIS radiance to reflectance factor."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Annotated

import typer

from lunarsci.spectra.jobs.requests import CalibrateRequest

from ..shared.command import command
from ..shared.emit import Report
from ..shared.options import Output, option
from ..shared.table import TextTable, counted, plus_minus

if TYPE_CHECKING:
    from lunarsci.spectra.jobs.calibrate import Calibrations
    from lunarsci.spectra.vnis.calibration import Calibration

Products = Annotated[
    list[str],
    typer.Argument(
        help="Labels (.2BL) or data files (.2B) of Chang'E-4 VNIS level 2B, or folders of them; the other files of an "
        "observation are found beside it by their sequence number."
    ),
]
CORRECTION, DETECTOR = "Reflectance", "Detectors"
OPTIONS = {
    "photometry": option(panel=CORRECTION),
    "phase": option(kind=str, metavar="NAME|FILE", panel=CORRECTION),
    "solar": option(kind=str, metavar="NAME|FILE", panel=CORRECTION),
    "shadow": option(panel=DETECTOR),
    "vnir_steps": option(panel=DETECTOR),
    "calibration": option(kind=str | None, metavar="FILE", panel=DETECTOR),
}
EXAMPLES = (
    "lunarsci spectra calibrate lunarsci-demo/*.2BL -o rock.ecsv",
    "lunarsci spectra calibrate scene --photometry akimov --csv",
)


@command("calibrate", EXAMPLES, OPTIONS, batch=True)
def calibrate(files: Products, request: CalibrateRequest, output: Output) -> Report:
    """VNIS radiance to reflectance factor, 390 channels, with independent and shared errors.

    -o FILE.ecsv or FILE.fits writes the spectra with units and provenance; the other commands read them. These also
    take the labels themselves, and then calibrate as this command does without options.
    """
    from lunarsci.spectra.jobs.calibrate import calibrate, check_fits

    check_fits(output.path, files)
    result = calibrate(files, request, progress=output.progress("calibrating"))
    formats = {".ecsv": result.to_ecsv, ".fits": result.to_fits}
    return Report(result, result_tables(result), formats=formats)


def result_tables(result: Calibrations) -> list[TextTable]:
    """The observations, a line each."""
    return [_table(result.observations)]


def _table(good: Sequence[Calibration]) -> TextTable:
    headers = [
        "observation", "i [deg]", "e [deg]", "g [deg]", "Sun [AU]", "lit pixels", "step", "gain", "R at 750 nm",
        "shared [%]", "masked",
    ]  # fmt: skip
    notes_by_id = [(note, item.id) for item in good for note in item.notes]
    notes = counted([note for note, _ in notes_by_id], len(good), "observations", [name for _, name in notes_by_id])
    return TextTable(headers, [_row(item) for item in good], notes=notes)


def _row(item: Calibration) -> list[str]:
    geometry, (level, sigma, shared) = item.vnir.geometry, item.at_nm(750.0)
    return [
        item.id,
        *(f"{angle:.2f}" for angle in (geometry.incidence_deg, geometry.emission_deg, geometry.phase_deg)),
        f"{item.vnir.distance_au:.6f}",
        f"{int(item.footprint.lit.sum())} of {int(item.footprint.inside.sum())}",
        plus_minus(item.splice.step.factor, item.splice.step.sigma, digits=4),
        plus_minus(item.splice.gain, item.splice.gain_sigma, digits=4),
        plus_minus(level, sigma, digits=4),
        plus_minus(100 * shared / level, digits=1),
        str(item.summary()["channels_masked"]),
    ]
