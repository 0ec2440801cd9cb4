"""Cubes in flat files: ENVI with its header, the Moon Mineralogy Mapper (M3) among them, and images of VNIS.

M3's products lie in the archive as `M3G20090203T175131_V01_RFL.IMG` (reflectance, 32-bit floats, band interleaved by
line, -999 for no value) with a header of the same name; `..._LOC.IMG` has longitude, latitude and radius of each pixel
(64-bit floats), `..._OBS.IMG` ten angles and distances: Green et al. (2011), J. Geophys. Res. 116, E00G19,
10.1029/2011JE003797, and the archive's labels. Blocks of lines come through numpy's memory maps: GDAL is an extra.
"""

import re
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from lunarsci.arrays import FloatArray
from lunarsci.errors import DataError, warn
from lunarsci.io.inputs import read_input
from lunarsci.spectra.cubes.cube import MOST_VALUES, SYNTHETIC, Backplane, FlatFile, Layout, PixelFrame, sha256_of
from lunarsci.spectra.readers.envi_header import NUMBERS, SUFFIX, EnviHeader, data_names, header_names, partner
from lunarsci.spectra.rows import quoted

DATA_SUFFIXES = (".img", ".dat", ".bsq", ".bil", ".bip", ".raw", ".bin", ".cub")
M3_NAME = re.compile(r"(M3[GT]\d{8}T\d{6})_V\d\d_(RFL|L2|RDN|L1B|LOC|OBS|SUP)(?![A-Z0-9])", re.IGNORECASE)
M3_IGNORED = -999.0
"""What products of M3 (Green et al. 2011, 10.1029/2011JE003797) have where nothing was measured, by their labels."""
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


def open_envi(path: str, locations: str | None, framed: Callable[[str], PixelFrame | None]) -> Layout:
    """A cube of the data file or the header at `path`; the other one lies beside it.

    `framed` says where the pixels of a data file lie whose header has `map info`.

    Raises DataError when one of them is missing, the header is no image's or contradicts itself, or the data file has
    another size than the header says.
    """
    header, data = _pair(path)
    found = EnviHeader.of(read_input(header))
    source = flat_file(found, data)
    m3 = M3_NAME.search(Path(data).name)
    if m3 and m3[2].upper() in ("RDN", "LOC", "OBS", "SUP"):
        raise DataError(f"{data}: is M3's {m3[2].upper()} file; reflectances are in the _RFL.IMG of Level 2")
    planes, used = _backplanes(data, source, locations, m3[1] if m3 else None)
    return Layout(
        name=data,
        format="m3" if m3 else "envi",
        source=source,
        shape=(source.lines, source.samples),
        dtype=np.dtype(source.dtype),
        wavelength=found.numbers("wavelength", source.channels, "bands"),
        unit=found.wavelength_unit(),
        fwhm=found.numbers("fwhm", source.channels, "bands"),
        bad=None if (good := found.numbers("bbl", source.channels, "bands")) is None else good == 0,
        **_scales(found, source.channels),
        ignored=[mark for mark in (found.number("data ignore value"), M3_IGNORED if m3 else None) if mark is not None],
        frame=framed(data) if "map info" in found.fields else None,
        names=found.cells("band names") if "band names" in found.fields else (),
        backplanes=planes,
        inputs={name: sha256_of(name) for name in (header, data, *used)},
        remarks=_remarks(found, m3 is not None),
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
    if kind not in _IMAGES:
        raise DataError(
            f"{header.file}: is the header of an {quoted(kind)}, no image of spectra; give an ENVI Standard file"
        )
    interleave = header.fields.get("interleave", "bsq").strip().lower()
    if interleave not in ("bsq", "bil", "bip"):
        raise DataError(f"{header.file}: 'interleave' is {quoted(interleave)}; it must be bsq, bil or bip")
    if header.fields.get("file compression", "0").strip() not in ("0", ""):
        raise DataError(f"{header.file}: the data file is compressed; write it without compression")
    lines, samples, bands = (header.whole(key) for key in ("lines", "samples", "bands"))
    if not 0 < lines * samples * bands <= MOST_VALUES:
        raise DataError(f"{header.file}: lines = {lines}, samples = {samples}, bands = {bands} are no image; check it")
    remedy = "a cube has whole numbers (1, 2, 3, 12, 13, 14, 15) or floats (4, 5); complex ones are no reflectances"
    dtype = header.dtype(NUMBERS, remedy).str
    found = FlatFile(data, dtype, header.whole("header offset", "0"), lines, samples, bands, interleave)
    if (size := Path(data).stat().st_size) != found.bytes:
        what = "shorter" if size < found.bytes else "longer"
        raise DataError(
            f"{data}: has {size} bytes, {what} than the {found.bytes} that {Path(header.file).name} announces ({lines} "
            f"lines of {samples} samples and {bands} bands, {np.dtype(dtype).itemsize} bytes each); fetch both again"
        )
    return found


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
        found = envi_plane(path)
        if (found.lines, found.samples) != (of.lines, of.samples) or found.channels < fewest:
            what = f"{found.lines} lines, {found.samples} samples, {found.channels} bands"
            raise DataError(f"{path}: has {what}; the cube has {of.lines} lines and {of.samples} samples")
    except DataError as error:
        if stated:
            raise
        warn(f"{error}; it is not used")
        return None, ()
    return found, _pair(path)


def _beside(data: str, m3: str, kind: str) -> str | None:
    """The image of an observation of M3 in the same folder, of whatever version."""
    wanted = re.compile(rf"{m3}_V\d\d_{kind}\.IMG", re.IGNORECASE)
    found = sorted(item.name for item in Path(data).parent.iterdir() if wanted.fullmatch(item.name))
    return str(Path(data).with_name(found[-1])) if found else None


def _remarks(header: EnviHeader, m3: bool) -> list[str]:
    told = header.fields.get("description", "")
    said = [f"its header calls it {SYNTHETIC}"] if SYNTHETIC.lower() in told.lower() else []
    if header.fields.get("flip", "0") not in ("0", ""):
        said.append(
            f"its header says flip = {header.fields['flip']}; lines and samples are taken as they lie in the file"
        )
    if m3:
        said.append(
            "reflectance of M3 is radiance factor at 30, 0, 30 degrees; reflectance factors of other instruments are "
            "1 / cos 30 = 1.155 times that"
        )
    return said


def open_vnis(path: str) -> Layout:
    """The image of an observation of VNIS, 450-945 nm, as reflectance factor at the standard geometry.

    Each pixel as `spectra calibrate` does it for the mean of many, but that the angles are those of the image's middle
    for all of them. Raises DataError as `read_observation` does.
    """
    from lunarsci.spectra.photometry.correction import correction_factor
    from lunarsci.spectra.solar import sun_moon_distance_au
    from lunarsci.spectra.vnis.channels import CUBE_SHAPE, VNIR_NM, fwhm_nm
    from lunarsci.spectra.vnis.detector import IN_FLIGHT_VERSION, default_settings, irradiance_at, reflectance_factor
    from lunarsci.spectra.vnis.observation import find_parts, read_observation

    observation, settings, file = read_observation(path), default_settings(), find_parts(path).cube
    label = observation.cube_label
    distance = sun_moon_distance_au(label.start + (label.stop - label.start) / 2)
    irradiance = irradiance_at("vnir", settings.solar)
    factor = reflectance_factor(np.ones(VNIR_NM.size), irradiance, label.geometry.incidence_deg, distance)
    bands, lines, samples = CUBE_SHAPE
    lsb = any("lsb" in (item.data_type or "").lower() for item in label.files if item.axes)
    said = ["one geometry is taken for the whole image", *observation.doubts]
    if observation.synthetic:
        said.append(f"its label calls it {SYNTHETIC}")
    if label.calibration_version < IN_FLIGHT_VERSION:
        said.append("radiance from before the in-flight calibration (version 1)")
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
        remarks=said,
    )
