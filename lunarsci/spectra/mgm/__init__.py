"""The Modified Gaussian Model: absorption bands as Gaussians in ln reflectance over a continuum."""
