"""Pictures as grey numbers: PNG, TIFF and JPEG of 8 to 16 bits, and products with labels of PDS3, VICAR and PDS4."""

import io
import math
import re
import warnings
from contextlib import ExitStack
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
from scipy.ndimage import convolve

from lunarsci.arrays import FloatArray
from lunarsci.errors import DataError, ParameterError
from lunarsci.images.cahv import LABEL_BYTES, is_xml, label_of
from lunarsci.io.documents import xml_root
from lunarsci.io.inputs import InputFile, read_input, unheard
from lunarsci.ranges import refuse

CHINESE = re.compile(r"\.2[abc]l", re.IGNORECASE)
"""Ends of names of PDS4 labels of the Chinese archive: an l after the end of the raw file."""
PLAIN = (b"\x89PNG", b"\xff\xd8", b"II*\0", b"MM\0*")
"""Begins of PNG, JPEG and TIFF."""
RAW_TYPES = {
    "UnsignedByte": "u1",
    "UnsignedLSB2": "<u2",
    "UnsignedMSB2": ">u2",
    "SignedLSB2": "<i2",
    "SignedMSB2": ">i2",
}
"""Types of numbers of PDS4 labels, as NumPy calls them."""
MOST_PIXELS = 50_000_000
"""Of a picture, with all colours of a raw one: it takes 0.4 GB as numbers, and reading it five times as much."""
NO_PICTURE = "no picture that can be read; give PNG, TIFF, JPEG, or a product with a label of PDS3, VICAR or PDS4"
TOO_LARGE = f"a picture of more than {MOST_PIXELS / 1e6:.0f} million pixels; cut out the part that is wanted"


class _OpenCV:
    """The module cv2, imported when it is needed. Raises ParameterError, which names the extra, where it is missing."""

    def __getattr__(self, name: str) -> Any:
        try:
            import cv2 as module
        except ImportError as error:
            raise ParameterError("pictures need OpenCV; pip install 'lunarsci[images]'") from error
        return getattr(module, name)


cv2 = _OpenCV()


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Picture:
    """A grey picture.

    Attributes
    ----------
    source : the file it was read from.
    values : (height, width), counted from 0, in the numbers of the file.
    bits : how many it was counted with: those of its label's bit mask, 8, or 10, 12, 14 or 16 by its largest number.
    """

    source: InputFile
    values: FloatArray
    bits: int

    @property
    def size(self) -> tuple[int, int]:
        """Width and height. [px]"""
        return self.values.shape[1], self.values.shape[0]

    @property
    def saturated(self) -> npt.NDArray[np.bool_]:
        """Where light was more than a number can say. (height, width)"""
        return np.asarray(self.values >= 2**self.bits - 1.5)

    def check(self) -> None:
        """Raise DataError for a picture that is overexposed, or of one number in 8 bits, as OpenCV looks at it."""
        low, high = np.percentile(self.values, [1, 99])
        full = self.saturated.mean()
        reasons = {
            f"{full:.0%} of it is overexposed; take a shorter one": full > 0.5,
            f"shows nothing: values {low:g} to {high:g} of {2**self.bits - 1}": high - low < 2**self.bits / 256,
        }
        refuse(reasons, self.source.name, DataError)


def read_picture(source: str | Path | InputFile) -> Picture:
    """Read a picture; colours become grey, Bayer mosaics of the Chinese archive too.

    A label of PDS3, VICAR or PDS4 is in the file or lies beside it, and names the raw file where it is alone. Raises
    DataError for what is none, and ParameterError without OpenCV, or rasterio for such labels.
    """
    file = read_input(source)
    label = None if file.data.startswith(PLAIN) else label_of(file)
    if label is not None and is_xml(label) and CHINESE.fullmatch(Path(label.name).suffix):
        return _read_pds4(label)
    if label is not None:
        return _read_labelled(file, label)
    _check_size(file)
    with unheard():
        values = cv2.imdecode(np.frombuffer(file.data, dtype=np.uint8), cv2.IMREAD_UNCHANGED)
    if values is None:
        raise DataError(f"{file.name}: {NO_PICTURE}")
    if values.ndim == 3:
        values = cv2.cvtColor(values[..., :3], cv2.COLOR_BGR2GRAY) if values.shape[2] > 2 else values[..., 0]
    return _picture(file, values)


def _picture(file: InputFile, values: npt.NDArray[Any], bits: int = 0) -> Picture:
    if values.dtype not in (np.uint8, np.uint16, np.int16):
        raise DataError(f"{file.name}: numbers of type {values.dtype}; give a picture of 8 or 16 bits")
    top = int(values.max(initial=0))
    counted = 8 if values.dtype == np.uint8 else next(bits for bits in (10, 12, 14, 16) if top < 2**bits)
    return Picture(source=file, values=np.maximum(values, 0).astype(np.float64), bits=max(bits, counted))


def _read_labelled(file: InputFile, label: InputFile) -> Picture:
    """A picture that GDAL reads by its label: VICAR's where the file has one, PDS4 or PDS3."""
    try:
        import rasterio
        from rasterio.errors import RasterioError
    except ImportError as error:
        raise ParameterError(
            f"{file.name}: labels of PDS and VICAR need rasterio; pip install 'lunarsci[cubes]'"
        ) from error
    vicar = file.data.find(b"LBLSIZE", 0, LABEL_BYTES) if label is file else -1
    driver = "PDS4" if is_xml(label) else "VICAR" if vicar >= 0 else "PDS"
    attached = driver == "VICAR" or (label is file and not Path(label.name).exists())
    try:
        with ExitStack() as opened:
            opened.enter_context(unheard())
            opened.enter_context(warnings.catch_warnings(action="ignore"))
            memory = opened.enter_context(rasterio.MemoryFile(file.data[max(vicar, 0) :])) if attached else None
            raster = opened.enter_context(
                memory.open(driver=driver) if memory else rasterio.open(label.name, driver=driver)
            )
            if not 0 < raster.width * raster.height * raster.count <= MOST_PIXELS:
                raise DataError(f"{file.name}: {TOO_LARGE}")
            frame = raster.read()
    except (RasterioError, ValueError, MemoryError) as error:
        raise DataError(f"{file.name}: {NO_PICTURE} ({driver}: {error.__cause__ or error})") from error
    grey = frame[0] if len(frame) == 1 else frame.mean(axis=0).astype(frame.dtype)
    return _picture(file, grey, _bits_of(label))


def _bits_of(label: InputFile) -> int:
    """Bits that the mask of a label leaves, as 2#0000111111111111#; 0 where it has none."""
    mask = re.search(rb"SAMPLE_BIT_MASK\s*[=>]\s*'?2#0*(1[01]{0,15})#", label.data[:LABEL_BYTES], re.IGNORECASE)
    return len(mask[1]) if mask else 0


def _check_size(file: InputFile) -> None:
    """Raise DataError for what is no PNG, TIFF or JPEG, and for more pixels than are unpacked: its header says both."""
    from PIL import Image

    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            pixels = math.prod(Image.open(io.BytesIO(file.data), formats=("PNG", "TIFF", "JPEG")).size)
    except Image.DecompressionBombError:
        pixels = MOST_PIXELS + 1
    except (OSError, ValueError, SyntaxError, OverflowError):
        pixels = 0
    if not 0 < pixels <= MOST_PIXELS:
        raise DataError(f"{file.name}: {TOO_LARGE if pixels else NO_PICTURE}")


def _read_pds4(file: InputFile) -> Picture:
    root = xml_root(file.name, file.data)
    axes = [
        (str(a.findtext("axis_name")).lower(), _whole(file, a.findtext("elements"))) for a in root.iter("axis_array")
    ]
    kind = next((str(node.text).strip() for node in root.iter("data_type")), "")
    shape, offset = [count for _, count in axes], _whole(file, next((n.text for n in root.iter("offset")), "0"))
    count, names = math.prod(shape), [name for name, _ in axes]
    reasons = {
        f"axes {names} of {kind or 'no type'} are not known here":
            names not in (["line", "sample"], ["line", "sample", "band"]) or kind not in RAW_TYPES,
        f"{'x'.join(map(str, shape))} are no picture, or too large a one; fetch it again": not 0 < count <= MOST_PIXELS,
    }  # fmt: skip
    refuse(reasons, file.name, DataError)
    raw = read_input(Path(file.name).with_suffix(Path(file.name).suffix[:-1]))
    if (there := len(raw.data) - offset) < (needed := count * np.dtype(RAW_TYPES[kind]).itemsize):
        raise DataError(f"{raw.name}: {there} bytes, {needed} announced by its label; is it cut short?")
    frame = np.frombuffer(raw.data, RAW_TYPES[kind], count, offset).reshape(shape)
    picture = _picture(raw, (frame if frame.ndim == 2 else frame.mean(axis=2)).astype(frame.dtype.newbyteorder("=")))
    if frame.ndim == 2 and "-C-" in Path(file.name).name:
        return Picture(source=raw, values=_without_mosaic(picture.values), bits=picture.bits)
    return picture


def _whole(file: InputFile, cell: str | None) -> int:
    """A count of a label. Raises DataError for what is none."""
    if not re.fullmatch(r"\s*\d{1,12}\s*", cell or "", re.ASCII):
        raise DataError(f"{file.name}: its label says {str(cell)[:20]!r} for a count; fetch it again")
    return int(str(cell))


def _without_mosaic(values: FloatArray) -> FloatArray:
    """Grey of an RGGB mosaic: each pixel with its neighbours, weighted so that every place has each colour alike."""
    kernel = np.outer([0.25, 0.5, 0.25], [0.25, 0.5, 0.25])
    return np.asarray(convolve(values, kernel, mode="mirror"))


def png_bytes(values: npt.NDArray[np.uint16], words: dict[str, str]) -> bytes:
    """A grey PNG of 16 bits with words in its text chunks. (height, width)"""
    from PIL import Image
    from PIL.PngImagePlugin import PngInfo

    about = PngInfo()
    for key, word in words.items():
        about.add_text(key, word)
    written = io.BytesIO()
    Image.fromarray(np.ascontiguousarray(values, dtype=np.uint16)).save(written, format="png", pnginfo=about)
    return written.getvalue()
