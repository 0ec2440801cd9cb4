"""Readers of reflectance spectra: ECSV, CSV and other text, RELAB and FITS tables; one file per format."""

from lunarsci.spectra.readers.dispatch import read_spectra

__all__ = ["read_spectra"]
