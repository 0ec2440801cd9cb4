"""Calibrated spectra as files: ECSV and FITS, with units and provenance, readable by the other commands."""

import io
import json
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

from lunarsci.provenance import plain
from lunarsci.spectra.spectrum import FloatArray
from lunarsci.spectra.vnis.calibration import Calibration
from lunarsci.spectra.vnis.channels import SPLICED_NM

if TYPE_CHECKING:
    from astropy.table import Table

__all__ = ["columns", "to_ecsv", "to_fits"]

_PROVENANCE_HDU = "PROVENANCE"


def columns(calibrations: Sequence[Calibration]) -> dict[str, FloatArray]:
    """Column name to values: `wavelength_nm`, then ID, ID_sigma and ID_systematic_NAME of every observation.

    An id that comes twice gets the suffix -2, -3 and so on.
    """
    table: dict[str, FloatArray] = {"wavelength_nm": SPLICED_NM}
    seen: dict[str, int] = {}
    for item in calibrations:
        seen[item.id] = seen.get(item.id, 0) + 1
        name = item.id if seen[item.id] == 1 else f"{item.id}-{seen[item.id]}"
        table[name] = item.reflectance
        table[f"{name}_sigma"] = item.sigma
        table |= {f"{name}_systematic_{key}": mode for key, mode in item.systematic.items()}
    return table


def to_ecsv(calibrations: Sequence[Calibration], provenance: Mapping[str, Any]) -> bytes:
    """An ECSV table; the header holds the provenance and what is known of every observation."""
    table = _table(calibrations)
    table.meta.update(_description(calibrations) | {"provenance": plain(provenance)})
    buffer = io.StringIO()
    table.write(buffer, format="ascii.ecsv")
    return buffer.getvalue().encode()


def to_fits(calibrations: Sequence[Calibration], provenance: Mapping[str, Any]) -> bytes:
    """A FITS file: a binary table of the spectra, and one whose only cell is the same record as JSON."""
    from astropy.io import fits
    from astropy.table import Table

    spectra = fits.table_to_hdu(_table(calibrations))
    spectra.name = "SPECTRA"
    record = json.dumps(_description(calibrations) | {"provenance": plain(provenance)}, sort_keys=True)
    note = fits.table_to_hdu(Table({"json": [record]}))
    note.name = _PROVENANCE_HDU
    buffer = io.BytesIO()
    fits.HDUList([fits.PrimaryHDU(), spectra, note]).writeto(buffer)
    return buffer.getvalue()


def _table(calibrations: Sequence[Calibration]) -> "Table":
    from astropy.table import Table

    table = Table(columns(calibrations))
    table["wavelength_nm"].unit = "nm"
    for name in table.colnames[1:]:
        table[name].unit = ""
    return table


def _description(calibrations: Sequence[Calibration]) -> dict[str, Any]:
    synthetic = any(item.synthetic for item in calibrations)
    title = "reflectance factor of Chang'E-4 VNIS observations"
    return {
        "title": f"SYNTHETIC {title}" if synthetic else title,
        "observations": [plain(item.summary()) for item in calibrations],
    }
