"""Reflectance spectra: reading them, their absorption bands, and the Modified Gaussian Model."""
