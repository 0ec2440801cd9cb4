"""Readers of reflectance spectra; `FORMATS` of `lunarsci.registry` has every format, in the order of trying."""

from lunarsci.spectra.readers.dispatch import read_spectra

__all__ = ["read_spectra"]
