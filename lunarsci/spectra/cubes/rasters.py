"""Cubes in GeoTIFF and NetCDF files, by rasterio and xarray, and which of all formats a file is.

GDAL opens a file with the driver that its content names and with no other.

Cubes in flat files are read here, too: ENVI with its header, the Moon Mineralogy Mapper (M3) among them, images of
VNIS, and those that a label of the Planetary Data System describes, as of CRISM and IIRS (why no library does it is
said in `lunarsci.spectra.readers.pds`).

M3's products lie in the archive as `M3G20090203T175131_V01_RFL.IMG` (reflectance, 32-bit floats, band interleaved by
line, -999 for no value) with a header of the same name; `..._LOC.IMG` has longitude, latitude and radius of each pixel
(64-bit floats), `..._OBS.IMG` ten angles and distances: Green et al. (2011), J. Geophys. Res. 116, E00G19,
10.1029/2011JE003797, and the archive's labels. Blocks of lines come through numpy's memory maps: GDAL is an extra.
"""

import math
import re
import warnings
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass, replace
from functools import lru_cache
from importlib import import_module
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from lunarsci.arrays import FloatArray
from lunarsci.errors import DataError, ParameterError, warn
from lunarsci.heights.rasters import MOST_BLOCK_BYTES, check_blocks
from lunarsci.io.inputs import read_input, text, unheard
from lunarsci.io.tables import MOST_CELLS
from lunarsci.spectra.cubes.cube import (
    MOST_VALUES,
    SYNTHETIC,
    Backplane,
    Cube,
    FlatFile,
    Layout,
    PixelFrame,
    Source,
    Stated,
    cube_of,
    sha256_of,
)
from lunarsci.spectra.photometry import correction_factor
from lunarsci.spectra.readers.columns import CHANNELS, is_spectral_axis
from lunarsci.spectra.readers.envi import SUFFIX, EnviHeader, data_names, header_names, partner
from lunarsci.spectra.readers.pds import (
    CALIBRATE,
    LABELS,
    data_file,
    is_pds_label,
    label_beside,
    radiance,
    read_pds_label,
)
from lunarsci.spectra.readers.table import WavelengthUnit, length_unit, wavelength_unit_in
from lunarsci.spectra.rows import number, quoted, separator_of, split_fields, split_lines
from lunarsci.spectra.solar import sun_moon_distance_au
from lunarsci.spectra.vnis.channels import CUBE_SHAPE, VNIR_NM, fwhm_nm
from lunarsci.spectra.vnis.detector import IN_FLIGHT_VERSION, default_settings, irradiance_at, reflectance_factor
from lunarsci.spectra.vnis.label import product_name
from lunarsci.spectra.vnis.observation import find_parts, read_observation


def label_of_cube(path: str) -> str | None:
    """The label that a path is, or that lies beside the data file it is; None where there is none."""
    if Path(path).suffix.lower() in LABELS:
        return path if is_pds_label(read_input(path)) else None
    beside = label_beside(path)
    return beside if beside is not None and is_pds_label(read_input(beside)) else None


def open_pds(path: str) -> Layout:
    """The image with most bands of a label. Raises DataError for radiance, and for what is no image of spectra."""
    images = read_pds_label(read_input(path)).images
    image = max(images, key=lambda one: (radiance(one.unit), one.bands), default=None)
    if image is None or radiance(image.unit) or not image.dtype:
        why = "is the label of a table, no image; `lunarsci spectra bands` takes tables of spectra"
        if image is not None:
            size = f"{image.lines} lines, {image.samples} samples and {image.bands} bands"
            kind = f"in {image.unit}: radiance; {CALIBRATE}" if radiance(image.unit) else ""
            why = f"{image.file} has {size} {kind or 'of a type that is not read; convert it to ENVI'}"
        raise DataError(f"{path}: {why}")
    data = data_file(path, image.file)
    source = FlatFile(data, image.dtype, image.offset, image.lines, image.samples, image.bands, image.interleave)
    _check_size(source, path, exact=False)
    wavelength = np.array(image.wavelength) if len(image.wavelength) == image.bands else None
    return Layout(
        name=data, format="pds", source=source, shape=(image.lines, image.samples), dtype=np.dtype(image.dtype),
        wavelength=wavelength, unit=length_unit(image.wavelength_unit), ignored=image.ignored,
        inputs={path: sha256_of(path), data: sha256_of(data)},
    )  # fmt: skip


DATA_SUFFIXES = (".img", ".dat", ".bsq", ".bil", ".bip", ".raw", ".bin", ".cub")
M3_NAME = re.compile(r"(M3[GT]\d{8}T\d{6})_V\d\d_(RFL|L2|RDN|L1B|LOC|OBS|SUP)(?![A-Z0-9])", re.IGNORECASE)
M3_IGNORED = -999.0
"""What products of M3 (Green et al. 2011, 10.1029/2011JE003797) have where nothing was measured, by their labels."""
M3_OTHERS = {"RDN": "radiance", "L1B": "radiance", "LOC": "places of pixels", "OBS": "angles", "SUP": "a supplement"}
"""Its files without reflectances."""
_IMAGES = ("envi standard", "")
_OBS = {
    "sun_azimuth": (0, "azimuth of the Sun", "degree"),
    "sun_zenith": (1, "angle of the Sun from the zenith", "degree"),
    "sensor_azimuth": (2, "azimuth of the sensor", "degree"),
    "sensor_zenith": (3, "angle of the sensor from the zenith", "degree"),
    "phase": (4, "phase angle", "degree"),
    "facet_cos_incidence": (9, "cosine of the incidence on the local slope", "1"),
}
"""Bands of an OBS file that go into maps."""


def _m3(path: str) -> re.Match[str] | None:
    """The name of a product of M3, None for another. Raises DataError for a file without reflectances."""
    m3 = M3_NAME.search(Path(path).name)
    if m3 and (other := M3_OTHERS.get(m3[2].upper())):
        raise DataError(f"{path}: is M3's {m3[2].upper()} file, {other}; {CALIBRATE}")
    return m3


def open_envi(path: str, locations: str | None, framed: Callable[[str], PixelFrame | None]) -> Layout:
    """A cube of the data file or the header at `path`; the other one lies beside it.

    `framed` says where the pixels of a data file lie whose header has `map info`.

    Raises DataError when one of them is missing, the header is no image's or contradicts itself, or the data file has
    another size than the header says.
    """
    header, data = _pair(path)
    result = EnviHeader.of(read_input(header))
    source = flat_file(result, data)
    m3 = _m3(data)
    planes, used = _backplanes(data, source, locations, m3[1] if m3 else None)
    return Layout(
        name=data,
        format="m3" if m3 else "envi",
        source=source,
        shape=(source.lines, source.samples),
        dtype=np.dtype(source.dtype),
        wavelength=result.numbers("wavelength", source.channels, "bands"),
        unit=result.wavelength_unit(),
        fwhm=result.numbers("fwhm", source.channels, "bands"),
        bad=None if (good := result.numbers("bbl", source.channels, "bands")) is None else good == 0,
        **_scales(result, source.channels),
        ignored=[mark for mark in (result.number("data ignore value"), M3_IGNORED if m3 else None) if mark is not None],
        frame=framed(data) if "map info" in result.fields else None,
        names=result.cells("band names") if "band names" in result.fields else (),
        backplanes=planes,
        inputs={name: sha256_of(name) for name in (header, data, *used)},
        remarks=_remarks(result, m3 is not None),
    )


def _pair(path: str) -> tuple[str, str]:
    """Names of header and data file."""
    given = Path(path)
    if (m3 := M3_NAME.search(given.name)) and given.suffix.lower() == ".lbl":
        name = given.name[: m3.start(2)] + "RFL.IMG"
        return _pair(partner(path, [str(given.with_name(name)), str(given.with_name(name.lower()))], "image"))
    if given.suffix.lower() == SUFFIX:
        return path, partner(path, data_names(path, DATA_SUFFIXES), "data file (.img)")
    return partner(path, header_names(path), "header (.hdr)"), path


def has_header(path: str) -> bool:
    """Whether a file is one of the two of an ENVI image, or M3's label of one, by names."""
    given = Path(path)
    label = given.suffix.lower() == ".lbl" and (m3 := M3_NAME.search(given.name)) is not None
    label = label and not (m3 and m3[2].upper() in ("L1B", "RDN"))
    return label or given.suffix.lower() == SUFFIX or any(Path(name).is_file() for name in header_names(path))


def flat_file(header: EnviHeader, data: str) -> FlatFile:
    """Where the numbers of a data file are. Raises DataError where header and size do not agree."""
    kind = " ".join(header.fields.get("file type", "").split()).lower()
    interleave = header.fields.get("interleave", "bsq").strip().lower()
    lines, samples, bands = (header.whole(key) for key in ("lines", "samples", "bands"))
    packed = header.fields.get("file compression", "0").strip() not in ("0", "")
    for wrong, what in (
        (kind not in _IMAGES, f"is the header of an {quoted(kind)}, no image of spectra; give an ENVI Standard file"),
        (interleave not in ("bsq", "bil", "bip"), f"'interleave' is {quoted(interleave)}; it must be bsq, bil or bip"),
        (packed, "the data file is compressed; write it without compression"),
        (
            not 0 < lines * samples * bands <= MOST_VALUES,
            f"lines = {lines}, samples = {samples}, bands = {bands} are no image; check it",
        ),
    ):
        if wrong:
            raise DataError(f"{header.file}: {what}")
    dtype = header.dtype().str
    flat = FlatFile(data, dtype, header.whole("header offset", "0"), lines, samples, bands, interleave)
    _check_size(flat, header.file, exact=True)
    return flat


def _check_size(flat: FlatFile, header: str, *, exact: bool) -> None:
    """Raise DataError for a file shorter than its header says, or of another length where it must be `exact`."""
    size = Path(flat.path).stat().st_size
    if size < flat.bytes or (exact and size != flat.bytes):
        what = "shorter" if size < flat.bytes else "longer"
        raise DataError(
            f"{flat.path}: has {size} bytes, {what} than the {flat.bytes} that {Path(header).name} announces "
            f"({flat.lines} lines of {flat.samples} samples and {flat.channels} bands, "
            f"{np.dtype(flat.dtype).itemsize} bytes each); fetch both again"
        )


def _scales(header: EnviHeader, bands: int) -> dict[str, Any]:
    """Gains, offsets and scale. Raises DataError where a header has several of them for the same."""
    pairs = [(f"data {kind}gain values", f"data {kind}offset values") for kind in ("reflectance ", "")]
    named = [pair for pair in pairs if any(key in header.fields for key in pair)]
    scale = header.scale()
    if named and scale is not None:
        raise DataError(f"{header.file}: has '{named[0][0]}' and 'reflectance scale factor'; leave the wrong one out")
    gain, offset = (_each(header, key, bands) for key in named[0]) if named else (None, None)
    if named and gain is None:
        gain = np.ones(bands)
    return {"gain": gain, "offset": offset, "scale": scale}


def _each(header: EnviHeader, key: str, bands: int) -> FloatArray | None:
    """A number for each band; one alone is that of all."""
    if key in header.fields and len(header.cells(key)) == 1:
        only = header.numbers(key, 1, "bands")
        return None if only is None else np.full(bands, only[0])
    return header.numbers(key, bands, "bands")


def _backplanes(
    data: str, source: FlatFile, locations: str | None, m3: str | None
) -> tuple[dict[str, Backplane], list[str]]:
    """Longitude and latitude of pixels, angles; and the files they are from."""
    planes: dict[str, Backplane] = {}
    used: list[str] = []
    loc = locations or (_beside(data, m3, "LOC") if m3 else None)
    if loc is not None:
        plane, files = _plane_file(loc, source, stated=locations is not None, fewest=2)
        if plane is not None:
            planes["longitude"] = Backplane(plane, 0, "longitude", "degrees_east")
            planes["latitude"] = Backplane(plane, 1, "latitude", "degrees_north")
            used += files
    if m3 and (obs := _beside(data, m3, "OBS")) is not None:
        plane, files = _plane_file(obs, source, stated=False, fewest=10)
        if plane is not None:
            planes |= {name: Backplane(plane, *rest) for name, rest in _OBS.items()}
            used += files
    return planes, used


def envi_plane(path: str) -> FlatFile:
    """An image beside a cube, of whatever it holds. Raises DataError as `flat_file` does."""
    header, data = _pair(path)
    return flat_file(EnviHeader.of(read_input(header)), data)


def _plane_file(path: str, of: FlatFile, *, stated: bool, fewest: int) -> tuple[FlatFile | None, Sequence[str]]:
    """A file beside the cube; where it does not belong to it, an error if it was stated, else a warning."""
    try:
        result = envi_plane(path)
        if (result.lines, result.samples) != (of.lines, of.samples) or result.channels < fewest:
            what = f"{result.lines} lines, {result.samples} samples, {result.channels} bands"
            raise DataError(f"{path}: has {what}; the cube has {of.lines} lines and {of.samples} samples")
    except DataError as error:
        if stated:
            raise
        warn(f"{error}; it is not used")
        return None, ()
    return result, _pair(path)


def _beside(data: str, m3: str, kind: str) -> str | None:
    """The image of an observation of M3 in the same folder, of whatever version."""
    wanted = re.compile(rf"{m3}_V\d\d_{kind}\.IMG", re.IGNORECASE)
    result = sorted(item.name for item in Path(data).parent.iterdir() if wanted.fullmatch(item.name))
    return str(Path(data).with_name(result[-1])) if result else None


def _remarks(header: EnviHeader, m3: bool) -> list[str]:
    """What the header of an ENVI file says that a user should know."""
    description = header.fields.get("description", "")
    notes = [f"its header calls it {SYNTHETIC}"] if SYNTHETIC.lower() in description.lower() else []
    if header.fields.get("flip", "0") not in ("0", ""):
        notes.append(
            f"its header says flip = {header.fields['flip']}; lines and samples are taken as they lie in the file"
        )
    if m3:
        notes.append(
            "reflectance of M3 is radiance factor at 30, 0, 30 degrees; reflectance factors of other instruments are "
            "1 / cos 30 = 1.155 times that"
        )
    return notes


def open_vnis(path: str) -> Layout:
    """The image of an observation of VNIS, 450-945 nm, as reflectance factor at the standard geometry.

    Each pixel as `spectra calibrate` does it for the mean of many, but that the angles are those of the image's middle
    for all of them. Raises DataError as `read_observation` does.
    """
    observation, settings, file = read_observation(path), default_settings(), find_parts(path).cube
    label = observation.cube_label
    distance = sun_moon_distance_au(label.start + (label.stop - label.start) / 2)
    irradiance = irradiance_at("vnir", settings.solar)
    factor = reflectance_factor(np.ones(VNIR_NM.size), irradiance, label.geometry.incidence_deg, distance)
    bands, lines, samples = CUBE_SHAPE
    lsb = any("lsb" in (item.data_type or "").lower() for item in label.files if item.axes)
    notes = ["one geometry is taken for the whole image", *observation.doubts]
    if observation.synthetic:
        notes.append(f"its label calls it {SYNTHETIC}")
    if label.calibration_version < IN_FLIGHT_VERSION:
        notes.append("radiance from before the in-flight calibration (version 1)")
    return Layout(
        name=file,
        format="vnis",
        source=FlatFile(file, ("<" if lsb else ">") + "f4", 0, lines, samples, bands, "bsq"),
        shape=(lines, samples),
        dtype=np.dtype("f4"),
        wavelength=VNIR_NM,
        unit="nm",
        fwhm=fwhm_nm(VNIR_NM, "vnir"),
        bad=observation.cube_flags,
        gain=factor * correction_factor(label.geometry, VNIR_NM, settings.photometry, settings.phase),
        inputs=observation.inputs,
        remarks=notes,
    )


HINT = "cubes and maps need rasterio, xarray, h5netcdf and h5py; install them with: pip install 'lunarsci[cubes]'"
_TIFF = (b"II*\x00", b"MM\x00*", b"II+\x00", b"MM\x00+")
HDF = b"\x89HDF"
_WAVELENGTH = re.compile(
    r"^(wavelengths?|wvls?|wl|lambda|band_?(wavelength|center|centre)s?)(_?(nm|um))?$", re.IGNORECASE
)
_STANDARD = {"radiation_wavelength", "sensor_band_central_radiation_wavelength"}
_IN_NAME = re.compile(r"(\d+(?:\.\d+)?)\s*(nm|nanomet\w+|um|µm|μm|microns?|micromet\w+)?", re.IGNORECASE)


def open_cube(path: str, stated: Stated | None = None) -> Cube:
    """The cube in a file: ENVI, M3, GeoTIFF, NetCDF or a VNIS image.

    Raises DataError, one line with file and remedy, for files that cannot be used as a cube; ParameterError where the
    extra for it is missing.
    """
    given = stated or Stated()
    layout = _layout(path, given)
    return cube_of(_with_wavelengths(layout, given) if given.wavelengths else layout, given)


def _layout(path: str, given: Stated) -> Layout:
    """What the file of a cube says of itself, by its format. Raises DataError for another."""
    start = start_of(path)
    if product_name(path) is not None:
        return open_vnis(path)
    if start.startswith(_TIFF):
        return open_geotiff(path)
    if start.startswith((HDF, b"CDF")):
        return open_netcdf(path)
    if start.split(b"\n")[0].strip() == b"ENVI" or has_header(path):
        return open_envi(path, given.locations, _envi_frame)
    if label := label_of_cube(path):
        return open_pds(label)
    _m3(path)
    raise DataError(f"{path}: is no cube: no ENVI header beside it, no GeoTIFF, no NetCDF, no VNIS product")


def optional(module: str) -> Any:
    """A library that cubes and maps need. Raises ParameterError that names the extra where it is not installed."""
    try:
        return import_module(module)
    except ImportError as error:
        raise ParameterError(HINT) from error


@contextmanager
def opened(path: str, driver: str) -> Iterator[Any]:
    """A dataset of rasterio, by this driver of GDAL and no other. Raises DataError for what it cannot read."""
    rasterio = optional("rasterio")
    from rasterio.errors import NotGeoreferencedWarning, RasterioError

    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", NotGeoreferencedWarning)
            with unheard():
                dataset = rasterio.open(path, driver=driver)
            with dataset:
                check_blocks(dataset, path)
                yield dataset
    except (RasterioError, UnicodeDecodeError) as error:
        raise DataError(f"{path}: cannot be read ({' '.join(str(error).split())}); fetch or write it again") from error


def _envi_frame(data: str) -> PixelFrame | None:
    """As GDAL reads `map info` and `coordinate system string`."""
    with opened(data, "ENVI") as dataset:
        return frame_of(dataset)


def frame_of(dataset: Any) -> PixelFrame | None:
    """Where pixels of a dataset lie; None where it does not say."""
    if dataset.transform.is_identity:
        return None
    return PixelFrame(tuple(dataset.transform)[:6], dataset.crs.to_wkt() if dataset.crs else "")


@dataclass(frozen=True, slots=True)
class RasterFile:
    """Numbers in a file that GDAL reads."""

    path: str
    driver: str

    def read(self, lines: slice, samples: slice) -> npt.NDArray[Any]:
        """Numbers as the file has them, shape (lines, samples, bands)."""
        from rasterio.windows import Window

        window = Window(samples.start, lines.start, samples.stop - samples.start, lines.stop - lines.start)
        with opened(self.path, self.driver) as dataset:
            return np.moveaxis(dataset.read(window=window), 0, 2)


def open_geotiff(path: str) -> Layout:
    """A stack of bands; wavelengths are those that bands are described with. Raises DataError for what it is not."""
    with opened(path, "GTiff") as dataset:
        kinds = set(dataset.dtypes)
        if len(kinds) > 1:
            raise DataError(
                f"{path}: bands hold numbers of several types ({', '.join(sorted(kinds))}); write them alike"
            )
        wavelength, unit = _described(dataset)
        scaled = any(s != 1 for s in dataset.scales) or any(o != 0 for o in dataset.offsets)
        return Layout(
            name=path,
            format="geotiff",
            source=RasterFile(path, "GTiff"),
            shape=(dataset.height, dataset.width),
            dtype=np.dtype(dataset.dtypes[0]),
            wavelength=wavelength,
            unit=unit,
            gain=np.array(dataset.scales, float) if scaled else None,
            offset=np.array(dataset.offsets, float) if scaled else None,
            ignored=sorted({value for value in dataset.nodatavals if value is not None and np.isfinite(value)}),
            frame=frame_of(dataset),
            names=[name or "" for name in dataset.descriptions],
            inputs={path: sha256_of(path)},
        )


def _described(dataset: Any) -> tuple[FloatArray | None, WavelengthUnit | None]:
    """Wavelengths of bands, from their tags or descriptions, and their unit."""
    bands = range(1, dataset.count + 1)
    tags = [{**dataset.tags(band, ns="IMAGERY"), **dataset.tags(band)} for band in bands]
    for key, stated in (("CENTRAL_WAVELENGTH_UM", "um"), ("wavelength", None)):
        if all(key in tag for tag in tags):
            result = [
                (number(tag[key]) or np.nan, length_unit(stated or tag.get("wavelength_units", ""))) for tag in tags
            ]
            break
    else:
        named = [_in_name(name or "") for name in dataset.descriptions]
        if len(result := [one for one in named if one is not None]) < len(named):
            return None, None
    units = {unit for _, unit in result}
    return np.array([value for value, _ in result], float), units.pop() if len(units) == 1 else None


def _in_name(name: str) -> tuple[float, WavelengthUnit | None] | None:
    """The number of a description that is a wavelength: the one with a unit, else the only one above 0.2."""
    result = _IN_NAME.findall(name)
    with_unit = [(float(value), length_unit(unit)) for value, unit in result if unit]
    if len(with_unit) == 1:
        return with_unit[0]
    alone = name.strip()
    return (float(alone), None) if re.fullmatch(r"\d+(\.\d+)?", alone) and float(alone) > 0.2 else None


@dataclass(frozen=True, slots=True)
class NetcdfVariable:
    """A variable of a NetCDF file, `axes` its dimensions in the order lines, samples, channels (or the first two)."""

    path: str
    name: str
    axes: tuple[str, ...]

    def read(self, lines: slice, samples: slice) -> npt.NDArray[Any]:
        """Values with the file's scale and fill values applied, shape (lines, samples, channels)."""
        variable = netcdf(self.path)[self.name]
        with _netcdf_errors(self.path):
            chosen = variable.isel({self.axes[0]: lines, self.axes[1]: samples})
            part: npt.NDArray[Any] = chosen.transpose(*self.axes).values
        return part if part.ndim == 3 else part[..., None]


def netcdf(path: str) -> Any:
    """A data set of xarray, its numbers still on disk. Raises DataError for what is none."""
    start = start_of(path)
    status = Path(path).stat()
    return _netcdf(path, "h5netcdf" if start.startswith(HDF) else "scipy", status.st_mtime_ns, status.st_ino)


@lru_cache(maxsize=4)
def _netcdf(path: str, engine: str, *_version: int) -> Any:
    """An open file of xarray; `_version` makes a changed file another one. Raises DataError for one too large."""
    h5netcdf, xarray, _ = map(optional, ("h5netcdf", "xarray", "h5py"))
    with _netcdf_errors(path):
        if engine == "h5netcdf":  # what is packed may be far larger than its file, and xarray reads axes as it opens it
            with h5netcdf.File(path) as file:
                for name, item in file.variables.items():
                    _check_variable(path, name, item.shape, item.chunks or (), item.dtype.itemsize)
        result = xarray.open_dataset(path, engine=engine, decode_times=False)
    for name, item in result.variables.items():
        _check_variable(path, name, item.shape, (), item.dtype.itemsize)
    return result


def _check_variable(path: str, name: Any, shape: Sequence[int], chunks: Sequence[int], item_bytes: int) -> None:
    if (len(shape) < 2 and math.prod(shape) > MOST_CELLS) or math.prod(chunks) * item_bytes > MOST_BLOCK_BYTES:
        sizes = f"{math.prod(shape)} numbers{f' in chunks of {math.prod(chunks)}' if chunks else ''}"
        raise DataError(f"{path}: '{name}' has {sizes}, too many to be read at once; fetch it again, or write it anew")


@contextmanager
def _netcdf_errors(path: str) -> Iterator[None]:
    """Whatever xarray, h5netcdf, HDF5 and scipy meet in a damaged file, and do not name, is a DataError."""
    try:
        yield
    except DataError:
        raise
    except Exception as error:
        reason = " ".join(str(error).split())[:120]
        raise DataError(f"{path}: cannot be read as NetCDF ({reason}); fetch or write it again") from error


def open_netcdf(path: str) -> Layout:
    """The variable of three dimensions, one of which has wavelengths. Raises DataError where there is none, or many."""
    with _netcdf_errors(path):
        data = netcdf(path)
        waves = {axis: name for name in data.variables for axis in [_wave_axis(data[name], str(name))] if axis}
        cubes = [name for name, item in data.data_vars.items() if item.ndim == 3 and item.dtype.kind in "iufc"]
        with_waves = [name for name in cubes if set(data[name].dims) & set(waves)]
        if len(with_waves) > 1 or not cubes:
            listed = f" ({', '.join(map(str, with_waves[:5]))})" if with_waves else ""
            raise DataError(
                f"{path}: has {len(with_waves) or 'no'} variables of lines, samples and wavelengths{listed}; give a "
                "file with one cube"
            )
        variable = data[(with_waves or cubes)[0]]
        called = [name for name in map(str, variable.dims) if _WAVELENGTH.match(name) or CHANNELS.match(name)]
        axis = next((str(name) for name in variable.dims if name in waves), [*called, str(variable.dims[0])][0])
        lines, samples = (str(name) for name in variable.dims if name != axis)
        wave, stored = data[waves[axis]] if axis in waves else None, variable.encoding.get("dtype", variable.dtype)
        scaled = "scale_factor" in variable.encoding or "add_offset" in variable.encoding
        return Layout(
            name=path,
            format="netcdf",
            source=NetcdfVariable(path, str(variable.name), (lines, samples, axis)),
            shape=(variable.sizes[lines], variable.sizes[samples]),
            dtype=np.dtype(float) if scaled else np.dtype(stored),
            wavelength=None if wave is None else np.asarray(wave.values, float),
            unit=None if wave is None else length_unit(str(wave.attrs.get("units", ""))),
            **_channel_arrays(data, axis),
            frame=netcdf_frame(data, variable, lines, samples),
            backplanes=_netcdf_locations(data, path, lines, samples),
            inputs={path: sha256_of(path)},
        )


def _wave_axis(variable: Any, name: str) -> str | None:
    """The dimension that wavelengths belong to."""
    named = _WAVELENGTH.match(name) or variable.attrs.get("standard_name") in _STANDARD
    named = named or (variable.dims == (name,) and is_spectral_axis(name, variable.values))
    return str(variable.dims[0]) if named and variable.ndim == 1 and variable.dtype.kind in "iuf" else None


def _channel_arrays(data: Any, axis: str) -> dict[str, Any]:
    """Widths and bad bands, where variables along the channels have them."""
    along = {str(name).lower(): data[name] for name in data.variables if data[name].dims == (axis,)}
    good = next((along[name] for name in ("bbl", "good", "good_wavelengths", "good_bands") if name in along), None)
    fwhm = along.get("fwhm")
    return {
        "fwhm": None if fwhm is None else np.asarray(fwhm.values, float),
        "bad": None if good is None else np.asarray(good.values, float) == 0,
    }


def netcdf_frame(data: Any, variable: Any, lines: str, samples: str) -> PixelFrame | None:
    """From the grid mapping's GeoTransform, else from coordinates in equal steps."""
    named = variable.attrs.get("grid_mapping") or variable.encoding.get("grid_mapping") or "spatial_ref"
    mapping = data[named].attrs if named in data.variables else {}
    wkt = str(mapping.get("crs_wkt") or mapping.get("spatial_ref") or "")
    if len(parts := str(mapping.get("GeoTransform", "")).split()) == 6:
        c, a, b, f, d, e = map(float, parts)
        return PixelFrame((a, b, c, d, e, f), wkt)
    steps = [_steps(data, name) for name in (samples, lines)]
    if steps[0] is None or steps[1] is None:
        return None
    (x, dx), (y, dy) = steps[0], steps[1]
    return PixelFrame((dx, 0.0, x - dx / 2, 0.0, dy, y - dy / 2), wkt)


def _steps(data: Any, name: str) -> tuple[float, float] | None:
    """First coordinate and step, where they are equal."""
    if name not in data.coords or data[name].ndim != 1 or data[name].size < 2 or data[name].dtype.kind not in "iuf":
        return None
    values = np.asarray(data[name].values, float)
    step = (values[-1] - values[0]) / (values.size - 1)
    even = step != 0 and bool(np.abs(np.diff(values) - step).max() < 1e-3 * abs(step))
    return (float(values[0]), float(step)) if even else None


def _netcdf_locations(data: Any, path: str, lines: str, samples: str) -> dict[str, Backplane]:
    """Longitude and latitude of each pixel, where a file has both as variables over lines and samples."""
    planes = {}
    for key, units in (("longitude", "degrees_east"), ("latitude", "degrees_north")):
        for name in data.variables:
            item = data[name]
            named = item.attrs.get("standard_name") == key or str(name).lower() in (key, key[:3])
            if named and set(item.dims) == {lines, samples}:
                planes[key] = Backplane(NetcdfVariable(path, str(name), (lines, samples)), 0, key, units)
    return planes if len(planes) == 2 else {}


@dataclass(frozen=True, slots=True)
class ArrayFile:
    """Numbers in a NumPy file of two dimensions."""

    path: str

    def read(self, lines: slice, samples: slice) -> npt.NDArray[Any]:
        """Numbers as the file has them, shape (lines, samples, 1)."""
        return np.array(_plane_array(self.path)[lines, samples])[..., None]


def _plane_array(path: str) -> npt.NDArray[Any]:
    """Numbers of a NumPy file, left on disk. Raises DataError for what holds none."""
    result: npt.NDArray[Any] = np.empty(0, object)
    with suppress(Exception):  # whatever NumPy raises of a damaged file
        result = np.load(path, mmap_mode="r", allow_pickle=False)
    if result.dtype.kind not in "biuf":
        raise DataError(f"{path}: not a NumPy array of numbers that can be read; write it with numpy.save")
    return result


def plane_of(path: str) -> tuple[Source, tuple[int, int]]:
    """An image of one number a pixel, ENVI, GeoTIFF, NetCDF or `.npy`, and its lines and samples. Raises DataError."""
    start = start_of(path)
    source: Source | None = None
    shape: tuple[int, ...] = ()
    if start.startswith(b"\x93NUMPY"):
        source, shape = ArrayFile(path), _plane_array(path).shape
    elif start.startswith(_TIFF):
        with opened(path, "GTiff") as dataset:
            source, shape = RasterFile(path, "GTiff"), (dataset.height, dataset.width, dataset.count)
    elif start.startswith((HDF, b"CDF")):
        planes = {str(name): item for name, item in netcdf(path).data_vars.items() if item.ndim == 2}
        if len(planes) != 1:
            raise DataError(f"{path}: has {len(planes)} images ({', '.join([*planes][:5])}); give a file with one")
        [(name, image)] = planes.items()
        source, shape = NetcdfVariable(path, name, tuple(map(str, image.dims))), image.shape
    elif has_header(path):
        source = flat = envi_plane(path)
        shape = (flat.lines, flat.samples, flat.channels)
    if source is None or len(shape) < 2 or shape[2:] not in ((), (1,)):
        raise DataError(f"{path}: is no image of one band: ENVI with a header beside it, GeoTIFF, NetCDF or .npy")
    return source, (int(shape[0]), int(shape[1]))


def start_of(path: str) -> bytes:
    """First bytes of a file. Raises DataError where there is none."""
    if not Path(path).is_file():
        why = "is a folder; name the file in it" if Path(path).is_dir() else "no such file; check the path"
        raise DataError(f"{path}: {why}")
    with Path(path).open("rb") as stream:
        return stream.read(16)


def _with_wavelengths(layout: Layout, given: Stated) -> Layout:
    """With those of a table: a column of wavelengths, and where wanted `fwhm` and `good` (0 or 1) beside it."""
    source = read_input(file := str(given.wavelengths))
    lines = split_lines(text(source))[0]
    cells = [split_fields(line, separator_of(lines), f"{file}: line {n}") for n, line in lines]
    named = any(cells) and number(cells[0][0]) is None
    names = [name.lower() for name in cells.pop(0)] if named else []
    place = next((k for k, name in enumerate(names) if "wave" in name or name in ("nm", "um")), 0)
    others = {key: k for k, name in enumerate(names) for key in ("fwhm", "good") if key in name}
    columns = {"wavelength": place} | others
    values = {
        k: np.array([number(row[c]) if c < len(row) else None for row in cells], float) for k, c in columns.items()
    }
    count = layout.source.read(slice(0, 1), slice(0, 1)).shape[2]
    if len(cells) != count:
        raise DataError(f"{file}: has {len(cells)} wavelengths, {layout.name} has {count} bands; give one for each")
    unit = wavelength_unit_in(names[place], file) if names else None
    return replace(
        layout,
        wavelength=values["wavelength"],
        unit=unit,
        fwhm=values.get("fwhm"),
        bad=values["good"] == 0 if "good" in values else layout.bad,
        inputs={**layout.inputs, file: source.sha256},
    )
