"""A synthetic observation as a picture: the image with rock, shadow and footprint, and the true reflectance."""

import numpy as np
from matplotlib.figure import Figure

from lunarsci.spectra.vnis.channels import FOOTPRINT, VNIR_NM
from lunarsci.spectra.vnis.simulation.instrument import Simulation

__all__ = ["simulation_page"]


def simulation_page(simulation: Simulation) -> Figure:
    """Image at 750 nm on the left, reflectance of soil, rock and the lit footprint on the right."""
    figure = Figure(figsize=(11, 5), layout="constrained")
    image, spectrum = figure.subplots(1, 2)
    frame = simulation.source.frame
    image.imshow(simulation.vnir[int(np.flatnonzero(VNIR_NM == 750.0)[0])], cmap="gray", interpolation="nearest")
    for mask, color, name in ((frame.rock, "#D55E00", "rock"), (frame.shadow, "#009E73", "shadow")):
        if mask.any():
            image.contour(mask, levels=[0.5], colors=color, linewidths=1)
            image.plot([], [], color=color, label=name)
    turn, (line, sample, radius) = np.linspace(0, 2 * np.pi, 181), FOOTPRINT
    image.plot(
        sample + radius * np.cos(turn), line + radius * np.sin(turn), color="#F0E442", label="SWIR field of view"
    )
    image.set(xlabel="sample [px]", ylabel="line [px]", title="image at 750 nm")
    image.legend(fontsize=8, loc="lower left")
    truth = simulation.truth
    spectrum.plot(truth.wavelength_nm, truth.reflectance, color="black", label="lit ground in the field of view")
    spectrum.plot(truth.wavelength_nm, truth.soil_reflectance, "--", color="#0072B2", label="soil")
    if truth.rock_reflectance is not None:
        spectrum.plot(truth.wavelength_nm, truth.rock_reflectance, "--", color="#D55E00", label="rock")
    spectrum.set(xlabel="wavelength [nm]", ylabel="reflectance factor at i 30°, e 0°, g 30°", title="truth")
    spectrum.legend(fontsize=8)
    figure.suptitle("SYNTHETIC, not a measurement")
    return figure
