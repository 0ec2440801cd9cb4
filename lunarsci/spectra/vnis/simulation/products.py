"""A synthetic observation as files and as a picture.

Image cube, short-wave table, auxiliary table, labels, and the truth as JSON; layout of the public level 2B products of
observation 136 of Chang'E-4 (2020-07-16), SYNTHETIC in every name.
"""

from dataclasses import asdict
from datetime import timedelta
from typing import TYPE_CHECKING, Any

import numpy as np

from lunarsci.arrays import FloatArray
from lunarsci.figure import headline, legend_below, page
from lunarsci.provenance import to_json
from lunarsci.spectra.vnis.calibration import draw_footprint
from lunarsci.spectra.vnis.channels import FOOTPRINT, VNIR_NM
from lunarsci.spectra.vnis.simulation.instrument import Simulation
from lunarsci.spectra.vnis.simulation.scene import Scene
from lunarsci.spectra.vnis.simulation.template import MARK, product_label, time_code

if TYPE_CHECKING:
    from matplotlib.figure import Figure


INTEGRATION_MS = 54.2
"""As in the product of observation 136 of Chang'E-4, CNSA (2020), Lunar and Planetary Data Release System."""
ELEVATION_CODE, QUALITY_CODE = "0xc1", "0x00"
"""Codes as in the public table; what the first one counts is not published."""


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
        "scene": {**asdict(scene), "time": time_code(scene.time), **_place(scene)},
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


def _place(scene: Scene) -> dict[str, float]:
    longitude, latitude = scene.place
    return {"longitude_deg": longitude, "latitude_deg": latitude}


def simulation_page(simulation: Simulation) -> "Figure":
    """Image at 750 nm on the left, reflectance of soil, rock and the lit footprint on the right."""

    figure = page(3.7)
    image, spectrum = figure.subplots(1, 2)
    frame = simulation.source.frame
    image.imshow(simulation.vnir[int(np.flatnonzero(VNIR_NM == 750.0)[0])], cmap="gray", interpolation="nearest")
    for mask, color, style, name in (
        (frame.rock, "#D55E00", "-", "outline of the rock"),
        (frame.shadow, "#009E73", "-.", "outline of the shadow"),
    ):
        if mask.any():
            image.contour(mask, levels=[0.5], colors=color, linestyles=style, linewidths=1)
            image.plot([], [], color=color, linestyle=style, linewidth=1, label=name)
    turn, (line, sample, radius) = np.linspace(0, 2 * np.pi, 181), FOOTPRINT
    draw_footprint(image, sample + radius * np.cos(turn), line + radius * np.sin(turn), "SWIR field of view")
    image.set(xlabel="sample [px]", ylabel="line [px]", title="image at 750 nm")
    truth = simulation.truth
    spectrum.plot(truth.wavelength_nm, truth.reflectance, color="black", label="lit ground in the field of view")
    spectrum.plot(truth.wavelength_nm, truth.soil_reflectance, "--", color="#0072B2", label="soil")
    if truth.rock_reflectance is not None:
        spectrum.plot(truth.wavelength_nm, truth.rock_reflectance, ":", color="#D55E00", label="rock")
    spectrum.set(xlabel="wavelength [nm]", ylabel="reflectance factor [-]", title="truth, at i 30°, e 0°, g 30°")
    legend_below(figure, (image, spectrum), 3)
    headline(figure, "SYNTHETIC, not a measurement")
    return figure
