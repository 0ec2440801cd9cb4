"""The image cube of the VNIR detector: 100 bands of 256 x 256 pixels, 4-byte floats without a header."""

import numpy as np
import numpy.typing as npt

from lunarsci.errors import DataError
from lunarsci.inputs import InputFile
from lunarsci.spectra.vnis.channels import CUBE_SHAPE
from lunarsci.spectra.vnis.label import DataFile, Label

__all__ = ["CUBE_BYTES", "Cube", "read_cube"]

Cube = npt.NDArray[np.float32]

CUBE_BYTES = 4 * int(np.prod(CUBE_SHAPE))
_AXES = tuple(zip(("band", "line", "sample"), CUBE_SHAPE, strict=True))
_TYPES = {"ieee754lsbsingle": "<f4", "ieee754msbsingle": ">f4"}
_PLAUSIBLE = (1e-8, 1e3)
"""Radiance of sunlit ground is some 1e-4 to 1 W m-2 sr-1 nm-1; numbers far from it are not radiance. [same]"""
_WORST_SHARE = 0.5


def read_cube(source: InputFile, label: Label) -> Cube:
    """Radiance as the file has it, shape (100, 256, 256); read-only and not copied. [W m-2 sr-1 nm-1]

    Raises DataError when size, axes, number type or byte order are not those of a VNIR cube.
    """
    described = next((file for file in label.files if file.axes), None)
    if described is None:
        raise DataError(f"{label.file}: describes no image array; fetch the label of the VD product again")
    _check_description(described, label.file)
    if len(source.data) != CUBE_BYTES:
        short = "truncated; " if len(source.data) < CUBE_BYTES else ""
        raise DataError(f"{source.name}: {len(source.data)} bytes, a cube has {CUBE_BYTES}; {short}fetch it again")
    kind = _TYPES[(described.data_type or "").lower()]
    cube = np.frombuffer(source.data, kind).reshape(CUBE_SHAPE)
    if _implausible(cube):
        swapped = not _implausible(cube.view(cube.dtype.newbyteorder()))
        why = "its byte order is not what the label says" if swapped else "its numbers are no radiances"
        raise DataError(f"{source.name}: {why}; fetch data and label again")
    return cube.astype(np.float32, copy=False)


def _check_description(described: DataFile, label: str) -> None:
    if described.axes != _AXES:
        stated = " x ".join(f"{elements} {name}" for name, elements in described.axes)
        raise DataError(f"{label}: states {stated[:80]}, a cube has 100 band x 256 line x 256 sample; fetch it again")
    if (described.data_type or "").lower() not in _TYPES:
        raise DataError(f"{label}: states numbers of type {described.data_type!r}; a cube has IEEE754LSBSingle")
    if described.size not in (None, CUBE_BYTES):
        raise DataError(f"{label}: states {described.size} bytes, a cube has {CUBE_BYTES}; fetch data and label again")


def _implausible(cube: npt.NDArray[np.floating]) -> bool:
    """Whether most of a sample of the numbers is neither zero nor of a radiance's size, or absurd."""
    sample = cube[::9, ::8, ::8]
    with np.errstate(all="ignore"):
        size = np.abs(sample.astype(np.float64))
        good = (size == 0) | ((size > _PLAUSIBLE[0]) & (size < _PLAUSIBLE[1])) | np.isnan(size)
    return bool(good.mean() < _WORST_SHARE)
