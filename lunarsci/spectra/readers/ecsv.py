"""ECSV tables (https://github.com/astropy/astropy-APEs/blob/main/APE6.rst): text with units and metadata."""

import csv
import re
import warnings
from collections import Counter
from typing import Any

from lunarsci import inputs
from lunarsci.errors import DataError, LunarSciWarning
from lunarsci.inputs import InputFile
from lunarsci.spectra.readers.astropy_columns import one_line, spectrum_table
from lunarsci.spectra.readers.table import SpectrumTable
from lunarsci.spectra.rows import quoted

__all__ = ["read_ecsv"]

_COMMA = re.compile(r"^# delimiter: *['\"]?,", re.MULTILINE)


def read_ecsv(source: InputFile) -> SpectrumTable:
    """Read an ECSV table; column units and header metadata are kept. Raises DataError when it is broken."""
    text = inputs.text(source)
    with warnings.catch_warnings(record=True) as said:
        warnings.simplefilter("always")
        table = _parsed(text, source.name)
    _check_names(text, source.name)
    for message in said:
        warnings.warn(f"{source.name}: {one_line(message.message)}", LunarSciWarning, stacklevel=2)
    return spectrum_table(table, source, "ecsv")


def _check_names(text: str, file: str) -> None:
    # astropy renames the second of two columns of one name and says nothing.
    header = next((line for line in text.splitlines() if line.strip() and not line.startswith("#")), "")
    delimiter = "," if _COMMA.search(text) else " "
    names = next(csv.reader([header], delimiter=delimiter), [])
    twice = [name for name, count in Counter(names).items() if name and count > 1]
    if twice:
        raise DataError(f"{file}: two columns are named {quoted(twice[0])}; give each column its own name")


def _parsed(text: str, file: str) -> Any:
    from astropy.io import ascii

    try:
        return ascii.read(text.splitlines(), format="ecsv", guess=False)
    # astropy and its YAML parser raise a dozen kinds of errors for a broken file, and document none of them.
    except Exception as error:
        raise DataError(f"{file}: broken ECSV table ({one_line(error)}); correct it or fetch the file again") from error
