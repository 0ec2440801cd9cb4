"""Readers of reflectance spectra: ECSV, text, RELAB, FITS tables, ENVI libraries, USGS splib07; one file per format."""

from lunarsci.spectra.readers.dispatch import read_spectra

__all__ = ["read_spectra"]
