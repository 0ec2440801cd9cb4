"""Synthetic products: layout against the public labels, radiance worked by hand, noise against its published spread."""

import json
import math
from dataclasses import replace
from datetime import UTC, datetime
from typing import Any
from xml.etree import ElementTree

import numpy as np
import pytest

from lunarsci.errors import ParameterError
from lunarsci.spectra.photometry import Geometry, correction_factor, phase_function
from lunarsci.spectra.solar import in_band_irradiance, solar_spectrum
from lunarsci.spectra.vnis.channels import SPLICED_NM, SWIR_NM, VNIR_NM, fwhm_nm
from lunarsci.spectra.vnis.simulation.instrument import (
    SHAPE,
    Instrument,
    Simulation,
    _half_plane,
    draw,
    scene_radiance,
    simulate,
)
from lunarsci.spectra.vnis.simulation.scene import Material, Scene, SceneComposition, SceneRock, surface_reflectance
from lunarsci.spectra.vnis.simulation.template import HALF_IMAGE, _views, product_files

EXACT = Instrument(noise=0)
PLAIN = Scene(texture=0, disk=None)
MIXED = Scene(
    rock=SceneRock(radius_px=40),
    shadow_fraction=0.1,
    geometry=Geometry(60.0, 45.0, 70.0),
    swir_incidence_deg=59.5,
    disk="akimov",
    phase="sp-mid",
    sequence=42,
)
NAMESPACE = "{http://pds.nasa.gov/pds4/pds/v1}"
STEM = "CE4_GRAS_VNIS-{}_20200716081709_20200716082500_0001_B.2B"
DISTANCE_AU = 1.014822
"""From the Sun to the Moon at observation 136, 2020-07-16T08:20Z, as published with its reflectance."""


@pytest.fixture(scope="module")
def mixed() -> Simulation:
    return simulate(MIXED, EXACT, seed=3)


@pytest.fixture(scope="module")
def files() -> dict[str, bytes]:
    return product_files(simulate(PLAIN, EXACT))


def footprint() -> np.ndarray:
    lines, samples = np.mgrid[:256, :256]
    return np.hypot(lines - 127, samples - 97) <= 53.8


def reflectance_factor(radiance: np.ndarray, wavelength_nm: np.ndarray, detector: str, incidence_deg: float):
    """pi L d^2 / (E0 cos i)."""
    irradiance = in_band_irradiance(solar_spectrum("e490"), wavelength_nm, fwhm_nm(wavelength_nm, detector))
    return math.pi * radiance * DISTANCE_AU**2 / (irradiance * math.cos(math.radians(incidence_deg)))


# -- Surface ----------------------------------------------------------------------------------------------------------


def test_a_surface_without_mineral_bands_is_the_continuum_with_the_bands_of_every_surface() -> None:
    bare = Material(SceneComposition(plagioclase=1), albedo=0.2, red_slope=0.5, contrast=0)
    far = np.array([1750.0, 2395.0])
    assert surface_reflectance(far, bare) == pytest.approx(0.2 * (1 + 0.5 * (far - 750) / 1000), rel=1e-6)
    # exp(-0.30 exp(-0.5 (2.3548 120/250)^2) - 0.05 exp(-0.5 (2.3548 30/150)^2) - 0.03 exp(-0.5 (2.3548 190/180)^2))
    # = exp(-0.30 0.5279 - 0.05 0.8950 - 0.03 0.0456) at 450 nm
    continuum = 0.2 * (1 - 0.5 * 0.3)
    assert surface_reflectance(np.array([450.0]), bare)[0] == pytest.approx(
        continuum * math.exp(-0.1584 - 0.0448 - 0.0014), rel=3e-4
    )


def test_band_strengths_go_with_fraction_and_contrast() -> None:
    """At 2300 nm, the centre of CPX 2, orthopyroxene's band leaves 0.1378 of its strength, 440 nm off its centre."""
    grid = np.array([2300.0])

    def absorption(contrast: float, **fractions: float) -> float:
        material = Material(SceneComposition(**fractions), contrast=contrast)
        return math.log(
            surface_reflectance(grid, material)[0] / surface_reflectance(grid, replace(material, contrast=0))[0]
        )

    whole = absorption(1, clinopyroxene=1)
    assert whole == pytest.approx(-0.40, abs=1e-4)
    assert absorption(1, clinopyroxene=0.25, plagioclase=0.75) == pytest.approx(whole / 4, abs=1e-4)
    assert absorption(0.5, clinopyroxene=1) == pytest.approx(whole / 2, abs=1e-4)
    assert absorption(1, orthopyroxene=1) == pytest.approx(-0.45 * 0.1371, abs=1e-3)


def test_plagioclase_is_weak_at_1250_nm_and_pyroxene_deep_at_1_and_2_um() -> None:
    def depth(at_nm: float, **fractions: float) -> float:
        material = Material(SceneComposition(**fractions))
        grid = np.array([at_nm])
        return 1 - surface_reflectance(grid, material)[0] / surface_reflectance(grid, replace(material, contrast=0))[0]

    assert 0.03 < depth(1250, plagioclase=1) < 0.08
    assert depth(915, orthopyroxene=1) > 0.3
    assert depth(2300, clinopyroxene=1) > 0.3
    assert depth(1043, olivine=1) > 0.3


SOIL = SceneComposition(plagioclase=1)
OUT_OF_RANGE = {
    Scene: [
        *({"texture": 0.6}, {"texture": math.nan}, {"texture_scale_px": 0}, {"shadow_fraction": 1.0}),
        *({"shadow_level": -0.1}, {"shadow_shape": "round"}, {"sequence": 0}, {"latitude_deg": 91}),
        *({"latitude_deg": 1.0}, {"time": datetime(2020, 7, 16)}),
    ],
    Instrument: [{"noise": -1}, {"pixel": 0.5}, {"vnir_gain": 0}, {"swir_gain": math.nan}],
    Material: [{"composition": SOIL, **bad} for bad in ({"albedo": 0}, {"red_slope": 5}, {"contrast": -1})],
    SceneRock: [{"radius_px": 0}, {"center_line": 1e4}],
    SceneComposition: [{"olivine": 0.9}, {"olivine": 1.2, "plagioclase": -0.2}, {"olivine": math.nan}, {}],
}


@pytest.mark.parametrize("kind", OUT_OF_RANGE)
def test_what_is_out_of_range_is_refused(kind: Any) -> None:
    for given in OUT_OF_RANGE[kind]:
        with pytest.raises(ParameterError, match=r"give|choose"):
            kind(**given)


def test_a_continuum_that_falls_to_0_is_refused() -> None:
    with pytest.raises(ParameterError, match="falls to 0"):
        surface_reflectance(np.array([9000.0]), Material(SOIL, red_slope=-0.5))


# -- Exact products ---------------------------------------------------------------------------------------------------


def test_radiance_without_noise_is_the_reflectance_turned_round_by_hand() -> None:
    """pi L d^2 / (E0 cos i) with the published distance; each product with its own incidence."""
    made = simulate(PLAIN, EXACT)
    vnir = reflectance_factor(made.vnir[:, 10, 20].astype(float), VNIR_NM, "vnir", 64.412)
    swir = reflectance_factor(made.swir, SWIR_NM, "swir", 64.412 + 0.0334)
    assert vnir == pytest.approx(surface_reflectance(VNIR_NM, PLAIN.soil), rel=2e-5)
    assert swir == pytest.approx(surface_reflectance(SWIR_NM, PLAIN.soil), rel=2e-5)
    assert np.ptp(made.vnir[50]) == 0


def test_radiance_is_as_bright_as_chang_e_4_measures_it() -> None:
    """Ground of 0.0706 at 900 nm under 64.445 deg gives 8.6e-3 W m-2 sr-1 nm-1, worked from E0 = 0.914 W m-2 nm-1."""
    by_hand = 0.0706 * 0.914 * 0.43137 / (math.pi * DISTANCE_AU**2)
    assert by_hand == pytest.approx(8.6e-3, rel=0.01)
    made = simulate(PLAIN, EXACT)
    wanted = by_hand * surface_reflectance(np.array([900.0]), PLAIN.soil)[0] / 0.0706
    assert made.swir[0] == pytest.approx(wanted, rel=0.03)


def test_photometry_divides_by_the_correction_of_each_product() -> None:
    flat = simulate(replace(MIXED, disk=None), EXACT, seed=3)
    made = simulate(MIXED, EXACT, seed=3)
    phase = phase_function("sp-mid")
    wanted = correction_factor(MIXED.geometry, VNIR_NM, "akimov", phase)
    assert flat.vnir[:, 127, 97] / made.vnir[:, 127, 97] == pytest.approx(wanted, rel=1e-5)
    wanted = correction_factor(MIXED.swir_geometry(), SWIR_NM, "akimov", phase)
    assert flat.swir / made.swir == pytest.approx(wanted, rel=1e-12)


def test_the_short_wave_phase_is_that_of_its_label() -> None:
    """Observation 136: the azimuths of both labels give their phases; here both scans share the azimuths of the images.

    cos g = cos 64.445 cos 45.557 + sin 64.445 sin 45.557 cos 64.401, where 64.401 comes from the images' 54.505.
    """
    geometry = Scene(swir_incidence_deg=64.445).swir_geometry()
    i, e, turn = np.radians([64.445, 45.557, 64.401])
    wanted = math.degrees(math.acos(math.cos(i) * math.cos(e) + math.sin(i) * math.sin(e) * math.cos(turn)))
    assert geometry.incidence_deg == 64.445
    assert geometry.phase_deg == pytest.approx(wanted, abs=2e-3)
    assert Scene(swir_incidence_deg=64.412).swir_geometry().phase_deg == pytest.approx(54.505, abs=1e-12)
    assert Scene(geometry=Geometry(30.0, 0.0, 30.0)).swir_geometry().phase_deg == pytest.approx(30.0334, abs=1e-9)


def test_the_truth_is_the_mean_over_lit_pixels_of_the_footprint(mixed: Simulation) -> None:
    frame, seen = mixed.source.frame, footprint()
    lit = seen & ~frame.shadow
    assert seen.sum() == 9085
    images = mixed.vnir[:, lit].astype(float).mean(axis=1)
    images *= correction_factor(MIXED.geometry, VNIR_NM, "akimov", phase_function("sp-mid"))
    assert reflectance_factor(images, VNIR_NM, "vnir", 60.0)[:90] == pytest.approx(
        mixed.truth.reflectance[:90], rel=2e-5
    )
    assert np.array_equal(mixed.truth.wavelength_nm, SPLICED_NM)
    assert mixed.truth.rock_fraction == pytest.approx((frame.rock & lit).sum() / lit.sum())
    assert mixed.truth.shadow_fraction == pytest.approx((frame.shadow & seen).sum() / 9085)
    assert sum(mixed.truth.composition.fractions.values()) == pytest.approx(1)


def test_the_short_wave_pixel_averages_the_whole_footprint_with_its_shadows(mixed: Simulation) -> None:
    """Soil and rock of unit brightness, read from single pixels, weighted with brightness over all 9085 pixels."""
    seen, frame = footprint(), mixed.source.frame
    overlap = VNIR_NM >= 900
    images = mixed.vnir[overlap][:, seen].astype(float).mean(axis=1)
    phase = phase_function("sp-mid")
    images *= correction_factor(MIXED.geometry, VNIR_NM[overlap], "akimov", phase)
    swir = mixed.swir[:10] * correction_factor(MIXED.swir_geometry(), SWIR_NM[:10], "akimov", phase)
    seen_by_swir = reflectance_factor(swir, SWIR_NM[:10], "swir", 59.5)
    assert seen_by_swir == pytest.approx(reflectance_factor(images, VNIR_NM[overlap], "vnir", 60.0), rel=2e-5)
    lit = seen & ~frame.shadow
    assert mixed.vnir[60][lit].min() > 20 * mixed.vnir[60][frame.shadow].max()


# -- Frame ------------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("shape", ["half-plane", "blobs"])
@pytest.mark.parametrize("rock", [None, SceneRock(radius_px=30)])
def test_the_shadow_has_the_share_and_is_compact(shape: str, rock: SceneRock | None) -> None:
    scene = replace(PLAIN, shadow_fraction=0.2, shadow_shape=shape, rock=rock)
    shadow = scene_radiance(scene, seed=1).frame.shadow
    assert shadow.sum() == round(0.2 * 65536)
    edges = (shadow[1:] != shadow[:-1]).sum() + (shadow[:, 1:] != shadow[:, :-1]).sum()
    assert edges < 0.15 * shadow.sum()  # scattered pixels have 3.2 edges each


def test_blobs_lie_beside_the_rock() -> None:
    rock = SceneRock(center_line=60, center_sample=190, radius_px=30)
    shadow = scene_radiance(replace(PLAIN, rock=rock, shadow_fraction=0.02), seed=2).frame.shadow
    line, sample = np.argwhere(shadow).mean(axis=0)
    assert 10 < math.hypot(line - 60, sample - 190) < 60


def test_a_shadow_over_everything_in_view_is_refused() -> None:
    with pytest.raises(ParameterError, match="covers the whole"):
        simulate(replace(PLAIN, shadow_fraction=0.9999, shadow_shape="half-plane"))


def test_a_half_plane_of_shadow_lies_to_the_side_that_is_drawn() -> None:
    """Its edge is straight and lies across the angle, which turns from more samples to more lines."""
    size = SHAPE[0] * SHAPE[1]
    for angle, (samples, lines) in ((0.0, (1.0, 0.0)), (90.0, (0.0, 1.0)), (210.0, (-np.sqrt(0.75), -0.5))):
        depth = _half_plane(np.radians(angle))
        deep = np.zeros(size, dtype=bool)
        deep[np.argsort(depth + np.zeros(SHAPE), axis=None)[-size // 3 :]] = True
        line, sample = np.mgrid[: SHAPE[0], : SHAPE[1]]
        along = (samples * sample + lines * line).ravel()
        assert along[deep].min() >= along[~deep].max() - 1e-9


def test_texture_has_mean_1_and_its_spread_and_is_smooth() -> None:
    brightness = scene_radiance(replace(PLAIN, texture=0.1), seed=5).frame.brightness
    assert brightness.mean() == pytest.approx(1, abs=2e-3)
    assert brightness.std() == pytest.approx(0.1, rel=0.05)
    # White noise under a Gaussian of 4 px correlates over 2 px as exp(-2^2 / (4 4^2)) = 0.939.
    assert np.corrcoef(brightness[2:].ravel(), brightness[:-2].ravel())[0, 1] == pytest.approx(0.939, abs=0.02)


# -- Noise ------------------------------------------------------------------------------------------------------------

MEASURED_NOISE = [(450, 495, 2.32, 1.91), (500, 615, 1.61, 0.75), (620, 695, 1.24, 1.07), (700, 895, 1.02, 0.88)]
MEASURED_NOISE += [
    (910, 1045, 0.80, 0.31),
    (1055, 1370, 0.61, 0.44),
    (1385, 1695, 0.46, 0.59),
    (1705, 1995, 0.63, 0.76),
]
MEASURED_NOISE += [(2005, 2195, 0.97, 0.79), (2205, 2395, 0.81, 0.83)]
"""First and last channel [nm], random noise of a footprint mean and fixed pattern [%] of the Chang'E-4 spectra."""


@pytest.mark.parametrize(("random", "pattern"), [(1, 0), (0, 1), (1, 1)])
def test_noise_of_channels_has_the_stated_spread(random: float, pattern: float) -> None:
    source = scene_radiance(PLAIN)
    exact = draw(source, EXACT)
    instrument = Instrument(pixel=0, random=random, pattern=pattern)
    draws = (draw(source, instrument, seed) for seed in range(100))
    kept = [(one.vnir[:, 0, 0].copy(), one.swir) for one in draws]  # a pixel of each, not 100 cubes
    vnir = np.array([pixel for pixel, _ in kept]) / exact.vnir[:, 0, 0]
    swir = np.array([table for _, table in kept]) / exact.swir
    relative = np.concatenate([vnir[:, :90], swir], axis=1)
    for first, last, own, shared in MEASURED_NOISE:
        inside = (first <= SPLICED_NM) & (last >= SPLICED_NM)
        wanted = math.hypot(random * own, pattern * shared) / 100
        tolerance = 4 / math.sqrt(2 * 100 * inside.sum())
        assert relative[:, inside].std() == pytest.approx(wanted, rel=tolerance), (first, last)
    lag = ((vnir[:, :-1] - 1) * (vnir[:, 1:] - 1)).mean() / ((vnir - 1) ** 2).mean()
    assert abs(lag) < 0.05


def test_pixels_have_two_percent_of_their_own_in_every_channel() -> None:
    made = simulate(PLAIN, Instrument(random=0, pattern=0), seed=4)
    relative = made.vnir / simulate(PLAIN, EXACT).vnir
    assert relative.std(axis=(1, 2)) == pytest.approx(np.full(100, 0.02), rel=0.015)
    assert relative.mean(axis=(1, 2)) == pytest.approx(np.ones(100), abs=4 * 0.02 / 256)
    assert abs(np.corrcoef(relative[10].ravel(), relative[11].ravel())[0, 1]) < 4 / 256


def test_a_pattern_seed_keeps_the_pattern_from_one_observation_to_the_next() -> None:
    source, instrument = scene_radiance(PLAIN), Instrument(random=0, pixel=0, pattern_seed=8)
    first, second = (draw(source, instrument, seed) for seed in (1, 2))
    assert np.array_equal(first.swir, second.swir)
    assert np.array_equal(first.vnir, second.vnir)
    free = replace(instrument, pattern_seed=None)
    assert not np.array_equal(draw(source, free, 1).swir, draw(source, free, 2).swir)


def test_gains_and_the_step_between_sub_bands() -> None:
    source = scene_radiance(PLAIN)
    exact = draw(source, EXACT)
    made = draw(source, Instrument(noise=0, vnir_gain=1.1, swir_gain=0.9, sub_band_step=1.05))
    assert np.allclose(made.vnir / exact.vnir, 1.1, rtol=1e-6)
    assert made.swir[:96] / exact.swir[:96] == pytest.approx(np.full(96, 0.9 * 1.05))  # 900-1375 nm
    assert made.swir[96:] / exact.swir[96:] == pytest.approx(np.full(204, 0.9))  # 1380-2395 nm


def test_equal_seeds_give_equal_products_and_others_do_not() -> None:
    first, again, other = (product_files(simulate(MIXED, seed=seed)) for seed in (1, 1, 2))
    assert first == again
    assert set(first) == set(other)
    assert not any(first[name] == other[name] for name in first if "_SCI_" in name and name.endswith("B"))
    with pytest.raises(ParameterError, match="seed"):
        simulate(PLAIN, seed=-1)


def test_switching_one_noise_off_leaves_the_others() -> None:
    source = scene_radiance(PLAIN)
    both, one = (draw(source, Instrument(pixel=0, pattern=pattern), 3).swir for pattern in (1.0, 0.0))
    pattern = draw(source, Instrument(pixel=0, random=0), 3).swir / draw(source, EXACT).swir
    assert both == pytest.approx(one * pattern)


# -- Files ------------------------------------------------------------------------------------------------------------

IDENTIFICATION = """
Identification_Area logical_identifier version_id title information_model_version product_class Modification_History
Modification_Detail modification_date version_id description
Modification_Detail modification_date version_id description
Reference_List Observation_Area Time_Coordinates start_date_time stop_date_time Primary_Result_Summary purpose
processing_level Science_Facets wavelength_range domain Investigation_Area name type Observing_System name
Observing_System_Component name type description Target_Identification name type Mission_Area product_id product_version
product_level instrument_name instrument_id sequence_id Instrument_Parm bands focal_length pixel_size
principle_point_coordinate x y"""
ROVER = " Rover_Location reference_frame longitude latitude"
LANDER = " Lander_Location reference_frame longitude latitude"
ROVER_XYZ = " Rover_LocationXYZ reference_frame x y z"
CENTRE = " Center_Point_LocationXYZ reference_frame x y z Vector_Cartesian_3_Pointing"
ANGLES = " incidence_angle azimuth_angle phase_angle"
SUN = " solar incidence_angle azimuth_angle"
FILE = " File_Area_Observational File file_name local_identifier creation_date_time file_size records"
RECORD = " Table_Character offset records record_delimiter Record_Character fields groups record_length"
COLUMN = " Field_Character name field_number field_location data_type field_length field_format"
WITH_UNIT, WITHOUT = f"{COLUMN} unit description", f"{COLUMN} description"
CORNERS = ("up_left", "down_left", "up_right", "down_right")
ARRAY = " Array_3D_Image offset axes axis_index_order Element_Array data_type unit"
SD_ORDER = (
    f"Product_Observational {IDENTIFICATION} description {ROVER}{ROVER_XYZ}{LANDER}{CENTRE} coordinate_system_name"
    f" center_point_observe_vector x y z Angle_Pointing_Results center_point{ANGLES}{SUN}{FILE}{RECORD}"
    f"{WITH_UNIT}{WITHOUT}{WITH_UNIT}{WITHOUT * 3}"
).split()
VD_ORDER = (
    f"Product_Observational {IDENTIFICATION} {ROVER}{LANDER}{ROVER_XYZ}{CENTRE} reference_frame "
    + " ".join(f"{name}_point_observe_vector x y z" for name in (*CORNERS, "center"))
    + " Angle_Pointing_Results "
    + " ".join(f"{name}_point{ANGLES}" for name in ("center", *CORNERS))
    + f"{SUN}{FILE}{ARRAY}{' Axis_Array axis_name elements sequence_number' * 3}{FILE}{RECORD}"
    + f"{WITH_UNIT}{WITHOUT}{WITH_UNIT}{WITHOUT * 2}"
).split()
"""Elements in the order of the public labels of observation 136, written down from them."""


def label(files: dict[str, bytes], kind: str) -> ElementTree.Element:
    return ElementTree.fromstring(files[f"SYNTHETIC_{STEM.format(kind)}L"])


def texts(root: ElementTree.Element, path: str) -> list[str]:
    steps = "/".join(f"{NAMESPACE}{step}" for step in path.split("/"))
    return [element.text or "" for element in root.findall(f".//{steps}")]


def test_names_are_those_of_the_public_products_marked_synthetic(files: dict[str, bytes]) -> None:
    kinds = ("VD_SCI_N", "SD_SCI_N", "VD_AUX_N")
    data = {f"SYNTHETIC_{STEM.format(kind)}" for kind in kinds}
    labels = {f"SYNTHETIC_{STEM.format(kind)}L" for kind in kinds[:2]}
    assert set(files) == data | labels | {"SYNTHETIC_CE4_GRAS_VNIS_20200716081709_20200716082500_0001_truth.json"}


def test_sizes_are_those_of_the_public_products(files: dict[str, bytes]) -> None:
    sizes = {name.split("VNIS-")[1][:8]: len(data) for name, data in files.items() if name.endswith(".2B")}
    assert sizes == {"VD_SCI_N": 26_214_400, "SD_SCI_N": 17_400, "VD_AUX_N": 4_400}
    for kind, count in (("VD_SCI_N", 2), ("SD_SCI_N", 1)):
        root = label(files, kind)
        stated = dict(zip(texts(root, "File/file_name"), texts(root, "File/file_size"), strict=True))
        assert {name: int(size) for name, size in stated.items()} == {name: len(files[name]) for name in stated}
        assert len(stated) == count


@pytest.mark.parametrize(("kind", "order"), [("SD_SCI_N", SD_ORDER), ("VD_SCI_N", VD_ORDER)])
def test_elements_stand_in_the_order_of_the_public_labels(files: dict[str, bytes], kind: str, order: list[str]) -> None:
    found = [element.tag for element in label(files, kind).iter()]
    assert found == [NAMESPACE + tag for tag in order]


@pytest.mark.parametrize("kind", ["SD_SCI_N", "VD_SCI_N"])
def test_labels_say_what_was_simulated(files: dict[str, bytes], kind: str) -> None:
    root, swir = label(files, kind), kind == "SD_SCI_N"
    unit = {element.tag.removeprefix(NAMESPACE): element.get("unit") for element in root.iter() if element.get("unit")}
    incidence, phase = ("64.445400", "54.525446") if swir else ("64.412000", "54.505000")
    assert texts(root, "solar/incidence_angle") == [incidence]
    assert texts(root, "center_point/incidence_angle") == ["45.557000"]
    assert float(texts(root, "center_point/phase_angle")[0]) == pytest.approx(float(phase), abs=2e-3)
    assert texts(root, "Rover_Location/longitude") + texts(root, "Rover_Location/latitude") == [
        "177.585000",
        "-45.440000",
    ]
    assert texts(root, "sequence_id") == ["0001"]
    assert texts(root, "Identification_Area/version_id") == ["2.0"]
    assert texts(root, "bands") == (["900-2395"] if swir else ["450-945"])
    assert unit["file_size"] == unit["offset"] == unit["field_location"] == unit["field_length"] == "byte"
    assert unit["incidence_angle"] == unit["longitude"] == "deg"
    assert unit["pixel_size"] == ("mm" if swir else "micrometer")
    assert texts(root, "record_length") == (["57"] if swir else ["43"])


def test_labels_are_marked_synthetic_in_ids_title_and_descriptions(files: dict[str, bytes]) -> None:
    for kind in ("SD_SCI_N", "VD_SCI_N"):
        root = label(files, kind)
        for path in ("logical_identifier", "product_id", "title", "Modification_Detail/description", "File/file_name"):
            assert all(text.startswith("SYNTHETIC") for text in texts(root, path)), path
        assert "SYNTHETIC" in texts(root, "Observing_System_Component/description")[0]
    assert json.loads(files[next(name for name in files if name.endswith("json"))])["synthetic"] is True


def test_angles_and_vectors_of_a_label_agree_as_in_the_public_ones(files: dict[str, bytes]) -> None:
    """As in observation 136: view = -(sin e sin A, sin e cos A, cos e), and its angle to the sun is the phase."""
    root = label(files, "VD_SCI_N")
    sun_angle, sun_azimuth = (
        math.radians(float(texts(root, f"solar/{key}_angle")[0])) for key in ("incidence", "azimuth")
    )
    sun = direction(sun_angle, sun_azimuth)
    for name in (*CORNERS, "center"):
        e, azimuth, phase = (
            math.radians(float(texts(root, f"{name}_point/{key}_angle")[0]))
            for key in ("incidence", "azimuth", "phase")
        )
        stated = [float(texts(root, f"{name}_point_observe_vector/{axis}")[0]) for axis in "xyz"]
        assert stated == pytest.approx(direction(e, azimuth), abs=2e-6)
        assert math.cos(phase) == pytest.approx(float(direction(e, azimuth) @ sun), abs=2e-6)


def direction(angle: float, azimuth: float) -> np.ndarray:
    return -np.array([math.sin(angle) * math.sin(azimuth), math.sin(angle) * math.cos(azimuth), math.cos(angle)])


def test_the_short_wave_table_has_the_public_layout(files: dict[str, bytes]) -> None:
    lines = files[f"SYNTHETIC_{STEM.format('SD_SCI_N')}"].decode("ascii").split("\n")
    assert lines.pop() == ""
    assert {len(line) for line in lines} == {57}
    for k, line in enumerate(lines):
        time, identifier, integration = line[:24], line[25:28], line[29:34]
        assert datetime.fromisoformat(time).tzinfo == UTC
        assert time[10] == "T" and time.endswith("Z")
        assert (identifier, integration, line[35:39], line[53:]) == (f"{k:3d}", " 54.2", "0xc1", "0x00")
        assert line[40:52] == line[40:52].strip() and line[47:49] == "E-"
    assert lines[0].startswith("2020-07-16T08:17:09.362Z   0  54.2 0xc1 ")
    root = label(files, "SD_SCI_N")
    assert texts(root, "start_date_time") + texts(root, "stop_date_time") == [lines[0][:24], lines[-1][:24]]
    middle = datetime.fromisoformat(lines[95][:24]), datetime.fromisoformat(lines[96][:24])
    assert (middle[1] - middle[0]).total_seconds() == pytest.approx(23.012, abs=2e-3)


def test_the_auxiliary_table_has_the_public_layout(files: dict[str, bytes]) -> None:
    lines = files[f"SYNTHETIC_{STEM.format('VD_AUX_N')}"].decode("ascii").split("\n")[:-1]
    assert len(lines) == 100
    for k, line in enumerate(lines):
        assert line[24:] == f" {k:2d}  54.2 0xc1 0x00"


def test_carriage_returns_on_request() -> None:
    made = product_files(simulate(PLAIN, EXACT), crlf=True)
    table = made[f"SYNTHETIC_{STEM.format('SD_SCI_N')}"]
    assert table.count(b"\r\n") == table.count(b"\n") == 300
    assert texts(label(made, "SD_SCI_N"), "File/file_size") == [str(300 * 59)]


def test_data_files_hold_the_radiance_in_the_order_of_the_label(mixed: Simulation) -> None:
    made = product_files(mixed)
    cube = np.frombuffer(next(data for name, data in made.items() if "VD_SCI" in name and name.endswith("B")), "<f4")
    assert np.array_equal(cube.reshape(100, 256, 256), mixed.vnir)
    table = next(data for name, data in made.items() if "SD_SCI" in name and name.endswith("B"))
    radiance = [float(row.split()[4]) for row in table.decode().splitlines()]
    assert radiance == pytest.approx(mixed.swir, rel=5e-6)
    assert all("_0042_" in name for name in made)


def test_the_truth_is_complete(mixed: Simulation) -> None:
    made = product_files(mixed)
    truth = json.loads(made[next(name for name in made if name.endswith("_truth.json"))])
    assert len(truth["wavelength_nm"]) == len(truth["reflectance"]) == len(truth["rock_reflectance"]) == 390
    assert truth["reflectance"] == pytest.approx(mixed.truth.reflectance)
    assert truth["scene"]["time"] == "2020-07-16T08:20:00.000Z"
    assert truth["scene"]["geometry"] == {"incidence_deg": 60.0, "emission_deg": 45.0, "phase_deg": 70.0}
    assert truth["scene"]["rock"]["material"]["composition"]["olivine"] == 0.1
    assert truth["instrument"]["noise"] == 0
    assert (truth["scene_seed"], truth["noise_seed"]) == (3, 3)
    assert truth["vnir_distance_au"] == pytest.approx(DISTANCE_AU, abs=5e-6)
    assert "assumed" in truth["note"]


def test_the_corners_of_an_image_lie_about_its_centre_as_they_are_called() -> None:
    """Seen from above with north ahead: what is right of the view is clockwise of it, what is up is farther away."""
    views = _views(Geometry(incidence_deg=40.0, emission_deg=45.0, phase_deg=60.0))
    centre = views["center"]
    flat = {name: one / (one @ centre) - centre for name, one in views.items()}
    assert sum(flat.values()) == pytest.approx(np.zeros(3), abs=1e-12)
    for name, corner in flat.items():
        ahead, clockwise = (corner[:2] @ centre[:2]), corner[0] * centre[1] - corner[1] * centre[0]
        assert name == "center" or (clockwise > 0, ahead > 0) == ("right" in name, "up" in name), name
        assert np.linalg.norm(corner) == pytest.approx(0.0 if name == "center" else math.sqrt(2) * HALF_IMAGE)
