"""Cubes that a label of the Planetary Data System describes, as those of CRISM and IIRS.

Why no library does it is said in `lunarsci.spectra.readers.pds_label`.
"""

from pathlib import Path

import numpy as np

from lunarsci.errors import DataError
from lunarsci.io.inputs import read_input
from lunarsci.spectra.cubes.cube import FlatFile, Layout, sha256_of
from lunarsci.spectra.readers.pds import radiance
from lunarsci.spectra.readers.pds_label import LABELS, data_file, is_pds_label, label_beside, read_pds_label
from lunarsci.spectra.readers.table import length_unit


def label_of_cube(path: str) -> str | None:
    """The label that a path is, or that lies beside the data file it is; None where there is none."""
    if Path(path).suffix.lower() in LABELS:
        return path if is_pds_label(read_input(path)) else None
    beside = label_beside(path)
    return beside if beside is not None and is_pds_label(read_input(beside)) else None


def open_pds(path: str) -> Layout:
    """The image with most bands of a label. Raises DataError for radiance, and for what is no image of spectra."""
    label = read_pds_label(read_input(path))
    if not label.images:
        raise DataError(f"{path}: is the label of a table, no image; `lunarsci spectra bands` takes tables of spectra")
    image = max(label.images, key=lambda one: (radiance(one.unit), one.bands))
    what = f"{image.lines} lines, {image.samples} samples and {image.bands} bands"
    if radiance(image.unit):
        raise DataError(f"{path}: {image.file} has {what} in {image.unit}: radiance; give the reflectances made of it")
    if not image.dtype:
        raise DataError(f"{path}: {image.file} has numbers of a type that is not read; convert it to ENVI")
    data = data_file(path, image.file)
    source = FlatFile(data, image.dtype, image.offset, image.lines, image.samples, image.bands, image.interleave)
    if (size := Path(data).stat().st_size) < source.bytes:
        raise DataError(f"{data}: has {size} bytes, {source.bytes} by its label (truncated?); fetch it again")
    wavelength = np.array(image.wavelength) if len(image.wavelength) == image.bands else None
    return Layout(
        name=data, format="pds", source=source, shape=(image.lines, image.samples), dtype=np.dtype(image.dtype),
        wavelength=wavelength, unit=length_unit(image.wavelength_unit), ignored=image.ignored,
        inputs={path: sha256_of(path), data: sha256_of(data)},
    )  # fmt: skip
