"""Files and page of a synthetic observation: layout of the public level 2B products, marked synthetic throughout.

Labels are as those of observation 136 of Chang'E-4 (2020-07-16): names, order and units of elements are interface and
kept, oddities included. The texts are our own.
"""

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass
from datetime import UTC, datetime, timedelta
from typing import TYPE_CHECKING, Any
from xml.sax.saxutils import escape

import numpy as np

from lunarsci.arrays import FloatArray
from lunarsci.figure import BLUE, GREEN, VERMILION, headline, legend_below, page
from lunarsci.provenance import to_json
from lunarsci.spectra.photometry import Geometry
from lunarsci.spectra.vnis.calibration import draw_footprint
from lunarsci.spectra.vnis.channels import CUBE_SHAPE, FOOTPRINT, IMAGE_NM, SWIR_NM, VNIR_NM, Detector
from lunarsci.spectra.vnis.observation import LANDING_SITE
from lunarsci.spectra.vnis.simulation.instrument import Simulation
from lunarsci.spectra.vnis.simulation.scene import Scene, azimuth_difference_deg

if TYPE_CHECKING:
    from matplotlib.figure import Figure

SUN_AZIMUTH_DEG, ROVER_XYZ_M, ARM_M = 60.0, (-287.5, 127.3, -1.7), (0.96, -0.90, 0.30)
"""Azimuth of the Sun, place of the rover from the lander, and of its origin from the ground in the centre of the image;
assumed."""
INTEGRATION_MS = 54.2
"""As in the product of observation 136 of Chang'E-4, CNSA (2020), Lunar and Planetary Data Release System."""
ELEVATION_CODE, QUALITY_CODE = "0xc1", "0x00"
"""Codes as in the public table; what the first one counts is not published."""
HALF_IMAGE = 0.5 * CUBE_SHAPE[2] * 0.025 / 43.0
"""Tangent of half the field of view of the imager: 256 pixels of 25 um behind a lens of 43 mm, by the product labels
(CNSA 2020, Lunar and Planetary Data Release System)."""
MARK = "SYNTHETIC, made by lunarsci: not a measurement"
NAMESPACES = (
    'xmlns="http://pds.nasa.gov/pds4/pds/v1" xmlns:pds="http://pds.nasa.gov/pds4/pds/v1" '
    'xmlns:sp="http://pds.nasa.gov/pds4/sp/v1" xmlns:xsi="http://www.w3.org/2001/XMLSchema-instance" '
    'xsi:schemaLocation="http://pds.nasa.gov/pds4/pds/v1,https://starbase.jpl.nasa.gov/pds4/1500/dph_example_products/'
    'xml_schema/PDS4_PDS_1500.xsd,http://pds.nasa.gov/pds4/sp/v1 PDS4_SP_1001.xsd"'
)


_LABEL = """\
Product_Observational {namespaces}
 Identification_Area
  logical_identifier: {product}
  version_id: 2.0
  title: SYNTHETIC product in the layout of the Chang'E 4(CE-4) mission, not a measurement
  information_model_version: 1.5.0.0
  product_class: Product_Observational
  Modification_History
   Modification_Detail
    modification_date: {day:%Y-%m-%d}
    version_id: 2.0
    description: {mark}. Layout and calibration as of version 2.0: no factors per channel to apply.
   Modification_Detail
    modification_date: {day:%Y-%m-%d}
    version_id: 1.0
    description: {mark}. No synthetic product of version 1.0 exists.
 Reference_List: None
 Observation_Area
  Time_Coordinates
   start_date_time: {start}
   stop_date_time: {stop}
  Primary_Result_Summary
   purpose: Science
   processing_level: Calibrated
   Science_Facets
    wavelength_range: {seen}
    domain: Surface
  Investigation_Area
   name: CE4
   type: Mission
  Observing_System
   name: Observing System for CE4Ro
   Observing_System_Component
    name: CE4Ro
    type: Spacecraft
    description: {mark}.
  Target_Identification
   name: Lunar
   type: Satellite
  Mission_Area
   product_id: {product}
   product_version: B
   product_level: 2B
   instrument_name: Visible and Near-infrared Imaging Spectrometer
   instrument_id: VNIS
   sequence_id: {sequence:04d}
   Instrument_Parm
{instrument}
{places}
   Vector_Cartesian_3_Pointing
    {frame_tag}: ROVER_COORDINATE_SYSTEM
{vectors}
   Angle_Pointing_Results
{angles}
{files}
"""
"""The label as an outline: a space for each level, then an element with its attributes, and after a colon its text."""
_INSTRUMENT = {
    "vnir": """\
    bands unit="nm": 450-945
    focal_length unit="mm": 43
    pixel_size unit="micrometer": 25
    principle_point_coordinate
     x unit="pixel": 128
     y unit="pixel": 128""",
    "swir": """\
    bands unit="nm": 900-2395
    focal_length unit="mm": 16
    pixel_size unit="mm": 1mm_Diameter
    principle_point_coordinate
     x unit="pixel": {line:.0f}
     y unit="pixel": {sample:.0f}
     description: {mark}. Counted from 1, the field of view of the short-wave detector in the VNIR image is the \
circle of {radius:g} pixels around line {line:.0f}, sample {sample:.0f}.""",
}
_PLACE = """\
   {}
    reference_frame: MOON_COORDINATE_SYSTEM
    longitude unit="deg": {:.6f}
    latitude unit="deg": {:.6f}"""
_POSITION = """\
   {}
    reference_frame: LANDER_COORDINATE_SYSTEM
    x unit="m": {:.6f}
    y unit="m": {:.6f}
    z unit="m": {:.6f}"""
_VECTOR = """\
    {}_point_observe_vector
     x: {:.6f}
     y: {:.6f}
     z: {:.6f}"""
_ANGLES = """\
    {}_point
     incidence_angle unit="deg": {:.6f}
     azimuth_angle unit="deg": {:.6f}
     phase_angle unit="deg": {:.6f}"""
_SUN = """\
    solar
     incidence_angle unit="deg": {:.6f}
     azimuth_angle unit="deg": {:.6f}"""
_FILE = """\
 File_Area_Observational
  File
   file_name: {name}
   local_identifier: None
   creation_date_time: {created}
   file_size unit="byte": {size}
   records: {records}"""
_ARRAY = """\
  Array_3D_Image
   offset unit="byte": 0
   axes: 3
   axis_index_order: Last Index Fastest
   Element_Array
    data_type: IEEE754LSBSingle
    unit: data number"""
_AXIS = """\
   Axis_Array
    axis_name: {}
    elements: {}
    sequence_number: {}"""
_TABLE = """\
  Table_Character
   offset unit="byte": 0
   records: {records}
   record_delimiter: Carriage-Return Line-Feed
   Record_Character
    fields: {fields}
    groups: 0
    record_length: {length}"""
"""The record length leaves the line's end out, as in the public labels."""
_COLUMN = """\
    Field_Character
     name: {column.name}
     field_number: {number}
     field_location unit="byte": {column.location}
     data_type: {column.data_type}
     field_length unit="byte": {column.length}
     field_format: {column.format}
{unit}     description: {column.description}"""


@dataclass(frozen=True, slots=True)
class Field:
    """A column: name, first character, data type, length, format, unit or none, description."""

    name: str
    location: int
    data_type: str
    length: int
    format: str
    unit: str
    description: str


# A few characters beyond ASCII, as the public labels have them: a reader must get past these.
_TIME = Field("Time", 1, "ASCII_Time", 24, "A24", "YYYY-MM-DDThh:mm:ss.msZ", "合成: simulated time of the channel, UTC")
SWIR_FIELDS = (
    _TIME,
    Field("Data_Identifier", 26, "ASCII_Integer", 3, "I3", "", "合成: channel, 0-299"),
    Field("Visible_Bands_Integration_Time", 30, "ASCII_Real", 5, "F5.1", "ms", "合成: nominal integration time"),
    Field("Solar_Elevation_Angle", 36, "ASCII_String", 4, "A4", "", "合成: constant code"),
    Field("Spectrum_data1", 41, "ASCII_Real", 12, "E12.5[E3]", "", "合成: simulated radiance"),
    Field("Quality_Code", 54, "ASCII_String", 4, "A4", "", "合成: always good"),
)
AUX_FIELDS = (
    _TIME,
    Field("Data_Identifier", 26, "ASCII_String", 2, "I2", "", "合成: channel, 0-99"),
    Field("Visible_Bands_Integration_Time", 29, "ASCII_Real", 5, "F5.1", "ms", "合成: nominal integration time"),
    Field("Solar_Elevation_Angle", 35, "ASCII_String", 4, "A4", "", "合成: constant code"),
    Field("Quality_Code", 40, "ASCII_String", 4, "A4", "", "合成: always good"),
)


def product_label(product: str, scene: Scene, detector: Detector, sizes: Mapping[str, int], created: datetime) -> bytes:
    """The label of the image cube (vnir) or of the short-wave table (swir).

    The two differ in the order of the places, and in the name of the pointing's frame. `sizes` has the bytes of each
    file that it describes: the product, and for the cube its auxiliary table too.
    """
    vnir, (line, sample, radius) = detector == "vnir", FOOTPRINT
    times, geometry = scene.swir_times(), scene.swir_geometry()
    views = _views(scene.geometry)
    described = [_table(SWIR_FIELDS, SWIR_NM.size)]
    if vnir:
        times, geometry = scene.vnir_times(), scene.geometry
        axes = enumerate(zip(("Band", "Line", "Sample"), CUBE_SHAPE, strict=True), 1)
        array = "\n".join([_ARRAY, *(_AXIS.format(name, size, number) for number, (name, size) in axes)])
        described = [array, _table(AUX_FIELDS, VNIR_NM.size)]
    else:
        views = {"center": views["center"]}
    about = {"created": time_code(created), "records": (VNIR_NM if vnir else SWIR_NM).size}
    files = zip(sizes.items(), described, strict=True)
    lander, rover = _PLACE.format("Lander_Location", *LANDING_SITE), _POSITION.format("Rover_LocationXYZ", *ROVER_XYZ_M)
    centre = (r - a for r, a in zip(ROVER_XYZ_M, ARM_M, strict=True))
    places = [_PLACE.format("Rover_Location", *scene.place), *([lander, rover] if vnir else [rover, lander])]
    where = {"line": line + 1, "sample": sample + 1, "radius": radius}
    outline = _LABEL.format(
        namespaces=NAMESPACES, product=product, mark=MARK, day=scene.time.astimezone(UTC), sequence=scene.sequence,
        start=time_code(times[0]), stop=time_code(times[-1]),
        seen="Visible and NearInfrared" if vnir else "Short Wave Infrared",
        instrument=_INSTRUMENT[detector].format(mark=MARK, **where),
        places="\n".join([*places, _POSITION.format("Center_Point_LocationXYZ", *centre)]),
        frame_tag="reference_frame" if vnir else "coordinate_system_name",
        vectors="\n".join(_VECTOR.format(name, *vector) for name, vector in views.items()),
        angles=_angles(views, geometry),
        files="\n".join(f"{_FILE.format(name=name, size=size, **about)}\n{part}" for (name, size), part in files),
    )  # fmt: skip
    return ('<?xml version="1.0" encoding="UTF-8"?>\n' + "\n".join(_lines(outline)) + "\n").encode("utf-8")


def _lines(outline: str) -> Iterator[str]:
    """Lines of XML."""
    within: list[str] = []
    for line in outline.splitlines():
        content = line.lstrip(" ")
        while len(within) > len(line) - len(content):
            tag = within.pop()
            yield "\t" * len(within) + f"</{tag}>"
        opening, colon, text = content.partition(": ")
        tag = opening.split(" ", 1)[0]
        yield "\t" * len(within) + f"<{opening}>" + (f"{escape(text)}</{tag}>" if colon else "")
        within += [] if colon else [tag]
    while within:
        tag = within.pop()
        yield "\t" * len(within) + f"</{tag}>"


def _table(columns: Sequence[Field], records: int) -> str:
    last = columns[-1]
    head = _TABLE.format(records=records, fields=len(columns), length=last.location + last.length - 1)
    each = (
        _COLUMN.format(number=number, column=column, unit=f"     unit: {column.unit}\n" if column.unit else "")
        for number, column in enumerate(columns, 1)
    )
    return "\n".join([head, *each])


def time_code(time: datetime) -> str:
    """UTC with milliseconds and a Z, 24 characters."""
    return time.astimezone(UTC).replace(tzinfo=None).isoformat(timespec="milliseconds") + "Z"


def _views(geometry: Geometry) -> dict[str, FloatArray]:
    """Unit vectors from the instrument to the centre and the corners of the image, in the order of their vectors."""
    centre = _direction(geometry.emission_deg, SUN_AZIMUTH_DEG + azimuth_difference_deg(geometry))
    azimuth = math.radians(SUN_AZIMUTH_DEG + azimuth_difference_deg(geometry))
    right = np.array([-math.cos(azimuth), math.sin(azimuth), 0.0])
    up = np.cross(right, centre)
    views = {}
    for name, across, along in (
        ("up_left", -1, 1),
        ("down_left", -1, -1),
        ("up_right", 1, 1),
        ("down_right", 1, -1),
    ):
        corner = centre + HALF_IMAGE * (across * right + along * up)
        views[name] = corner / np.linalg.norm(corner)
    return {**views, "center": centre}


def _direction(angle_deg: float, azimuth_deg: float) -> FloatArray:
    """From above to the ground along a ray that leaves it at an angle to the vertical and an azimuth."""
    angle, azimuth = math.radians(angle_deg), math.radians(azimuth_deg)
    return -np.array([math.sin(angle) * math.sin(azimuth), math.sin(angle) * math.cos(azimuth), math.cos(angle)])


def _angles(views: dict[str, FloatArray], geometry: Geometry) -> str:
    """Angles of the views; the "incidence" of a view is its emission. The centre has the scene's own phase."""
    sun = _direction(geometry.incidence_deg, SUN_AZIMUTH_DEG)
    each = []
    for name in ("center", *(name for name in views if name != "center")):
        x, y, z = views[name]
        phase = math.degrees(math.acos(min(1.0, float(sun @ views[name]))))
        incidence, azimuth = math.degrees(math.acos(min(1.0, -float(z)))), math.degrees(math.atan2(-x, -y)) % 360
        each.append(_ANGLES.format(name, incidence, azimuth, geometry.phase_deg if name == "center" else phase))
    return "\n".join([*each, _SUN.format(geometry.incidence_deg, SUN_AZIMUTH_DEG)])


def product_files(simulation: Simulation, *, crlf: bool = False) -> dict[str, bytes]:
    """File name to content: image cube, short-wave table, their labels, the auxiliary table, and the truth as JSON.

    Table lines end in a line feed, which is what the file sizes of the public labels amount to; with `crlf`, in the
    carriage return and line feed that the same labels speak of. Equal simulations give equal bytes.
    """
    scene = simulation.scene
    end = "\r\n" if crlf else "\n"
    vnir, swir, aux, truth = (_name(scene, kind) for kind in ("VNIS-VD_SCI_N", "VNIS-SD_SCI_N", "VNIS-VD_AUX_N", ""))
    cube = simulation.vnir.astype("<f4", copy=False).tobytes()
    table, flags = _swir_table(scene, simulation.swir, end), _aux_table(scene, end)
    created = scene.vnir_times()[-1] + timedelta(hours=1)
    return {
        vnir: cube,
        f"{vnir}L": product_label(vnir, scene, "vnir", {vnir: len(cube), aux: len(flags)}, created),
        aux: flags,
        swir: table,
        f"{swir}L": product_label(swir, scene, "swir", {swir: len(table)}, created),
        truth: to_json(_truth(simulation)).encode(),
    }


def _name(scene: Scene, kind: str) -> str:
    """Session times without fractions of a second, as in the public names, and the number of the observation."""
    start, stop = scene.swir_times()[0], scene.vnir_times()[-1] + timedelta(seconds=1)
    session = f"{start:%Y%m%d%H%M%S}_{stop:%Y%m%d%H%M%S}_{scene.sequence:04d}"
    if not kind:
        return f"SYNTHETIC_CE4_GRAS_VNIS_{session}_truth.json"
    return f"SYNTHETIC_CE4_GRAS_{kind}_{session}_B.2B"


def _swir_table(scene: Scene, radiance: FloatArray, end: str) -> bytes:
    rows = (
        f"{time_code(time)} {k:3d} {INTEGRATION_MS:5.1f} {ELEVATION_CODE} {_scientific(value)} {QUALITY_CODE}{end}"
        for k, (time, value) in enumerate(zip(scene.swir_times(), radiance, strict=True))
    )
    return "".join(rows).encode("ascii")


def _aux_table(scene: Scene, end: str) -> bytes:
    rows = (
        f"{time_code(time)} {k:2d} {INTEGRATION_MS:5.1f} {ELEVATION_CODE} {QUALITY_CODE}{end}"
        for k, time in enumerate(scene.vnir_times())
    )
    return "".join(rows).encode("ascii")


def _scientific(value: float) -> str:
    """Six digits and an exponent of three, 12 characters."""
    mantissa, exponent = f"{value:.5E}".split("E")
    return f"{mantissa}E{int(exponent):+04d}"


def _truth(simulation: Simulation) -> dict[str, Any]:
    scene, truth, source = simulation.scene, simulation.truth, simulation.source
    return {
        "synthetic": True,
        "note": f"{MARK}. Strengths of bands, albedos, texture and noise of pixels are assumed.",
        "scene": asdict(scene)
        | {"time": time_code(scene.time)}
        | dict(zip(("longitude_deg", "latitude_deg"), scene.place, strict=True)),
        "instrument": asdict(simulation.instrument),
        "scene_seed": source.seed,
        "noise_seed": simulation.seed,
        "vnir_distance_au": source.vnir_distance_au,
        "swir_distance_au": source.swir_distance_au,
        "composition": truth.composition.fractions,
        "rock_fraction": truth.rock_fraction,
        "shadow_fraction": truth.shadow_fraction,
        "wavelength_nm": truth.wavelength_nm,
        "reflectance": truth.reflectance,
        "soil_reflectance": truth.soil_reflectance,
        "rock_reflectance": truth.rock_reflectance,
    }


def simulation_page(simulation: Simulation) -> "Figure":
    """Image at 750 nm on the left, reflectance of soil, rock and the lit footprint on the right."""
    figure = page(3.7)
    image, spectrum = figure.subplots(1, 2)
    frame = simulation.source.frame
    image.imshow(simulation.vnir[int(np.flatnonzero(VNIR_NM == IMAGE_NM)[0])], cmap="gray", interpolation="nearest")
    for mask, color, style, name in (
        (frame.rock, VERMILION, "-", "outline of the rock"),
        (frame.shadow, GREEN, "-.", "outline of the shadow"),
    ):
        if mask.any():
            image.contour(mask, levels=[0.5], colors=color, linestyles=style, linewidths=1)
            image.plot([], [], color=color, linestyle=style, linewidth=1, label=name)
    draw_footprint(image, "SWIR field of view")
    image.set(xlabel="sample [px]", ylabel="line [px]", title="image at 750 nm")
    truth = simulation.truth
    spectrum.plot(truth.wavelength_nm, truth.reflectance, color="black", label="lit ground in the field of view")
    spectrum.plot(truth.wavelength_nm, truth.soil_reflectance, "--", color=BLUE, label="soil")
    if truth.rock_reflectance is not None:
        spectrum.plot(truth.wavelength_nm, truth.rock_reflectance, ":", color=VERMILION, label="rock")
    spectrum.set(xlabel="wavelength [nm]", ylabel="reflectance factor [-]", title="truth, at i 30°, e 0°, g 30°")
    legend_below(figure, (image, spectrum), 3)
    headline(figure, "SYNTHETIC, not a measurement")
    return figure
