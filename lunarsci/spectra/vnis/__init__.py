"""Visible and Near-infrared Imaging Spectrometer of Chang'E-4: from level 2B products to a reflectance spectrum."""
