"""What Python holds in memory, as the files that jobs read: tables, grids, documents, open files and results.

Tables become CSV, grids netCDF or an archive of NumPy, dicts of keys TOML or JSON. Writing TOML is our own, since
Python reads it only.
"""

import functools
import io
import json
import os
import re
import tomllib
from collections.abc import Callable, Mapping, Sequence
from dataclasses import fields, is_dataclass, replace
from pathlib import Path
from tempfile import TemporaryDirectory, mkdtemp
from typing import Any, Protocol

from lunarsci.errors import DataError, ParameterError
from lunarsci.units import unit_of

FORMS = "a path, an open file, bytes, a dict, a table, a Dataset, or (x, y, heights)"
"""What can be given for a file, in words."""
FORMS_OF_CUBE = "a path, an open file, bytes, an array of xarray, or (wavelength_nm, reflectance of three dimensions)"
BEGINNINGS = {
    b"CDF": ".nc", b"\x89HDF": ".nc", b"II*\0": ".tif", b"MM\0*": ".tif", b"\x89PNG": ".png", b"\xff\xd8": ".jpg",
    b"{": ".json",
}  # fmt: skip
"""How files begin whose format is told so, and how their names end."""
_ROOM = "lunarsci-"
_FOLDERS = re.compile(rf"[^\s\"'`(,;:=]*{_ROOM}\w{{8}}[/\\]tmp\w{{8}}[/\\]([\w-]+[/\\])?")
"""Folders of files of what is in memory, with names as `tempfile` makes them."""
_KEY = re.compile(r"[A-Za-z0-9_-]+")


class AsFiles(Protocol):
    """A result: it says of which of its files an input is read."""

    def as_input(self, role: str) -> Mapping[str, Callable[[], bytes]]:
        """The file for the input `role`, or those of a folder, by name with what makes each."""


def content_of(value: Any) -> tuple[bytes, str] | None:
    """The bytes of a file that would hold something in memory, and how its name ends; None for what is no such thing.

    Bytes and open files as they are, tables and lists of rows as CSV, xarray and arrays (wavelength (n,), reflectance
    (lines, samples, n)) as netCDF, arrays (x (nx,), y (ny,), heights (ny, nx)) and dicts of them as an archive of
    NumPy, other dicts as TOML, or as JSON where they are such a document.

    Raises DataError for a table whose units contradict the names of its columns.
    """
    if hasattr(value, "as_input"):
        return None
    if isinstance(value, bytes | bytearray | memoryview) or is_open(value):
        data = _read(value) if is_open(value) else bytes(value)
        return data, _ending(data)
    if hasattr(value, "to_netcdf"):
        return _netcdf(value), ".nc"
    if isinstance(value, Mapping):
        return _of_dict(value)
    if hasattr(value, "colnames"):
        return _ecsv(value), ".csv"
    if hasattr(value, "to_pandas") or hasattr(value, "to_csv") or _is_records(value):
        return _csv(value.to_pandas() if hasattr(value, "to_pandas") else value), ".csv"
    if is_cube(value):
        return _netcdf(_cube(*value)), ".nc"
    return (_archive(dict(zip(("x_m", "y_m", "height_m"), value, strict=True))), ".npz") if _is_grid(value) else None


def is_open(value: Any) -> bool:
    """Whether something is an open file; tables of astropy can read, too."""
    return hasattr(value, "read") and not hasattr(value, "colnames")


def on_disk(role: str, value: Any) -> Any:
    """The path of a file that holds what is in memory, for the input `role`; text and numbers as they are.

    The file lies there until the process ends; `as_named` leaves its folder out of a text. Several in a list are
    several files. Raises ParameterError for a result that has no file for this input.
    """
    if value is None or isinstance(value, str | bool | int | float) or callable(value):
        return value
    if isinstance(value, os.PathLike):
        return os.fspath(value)
    if hasattr(value, "as_input"):
        return _in_a_folder(value.schema.partition("/")[0], _files_for(role, value))
    if isinstance(value, list | tuple) and not (_is_grid(value) or is_cube(value)):
        return type(value)([on_disk(role, one) for one in value])
    content = content_of(value)
    if content is None:
        return value
    name = getattr(value, "name", None)
    named = Path(name).name if isinstance(name, str) and is_open(value) and Path(name).suffix else ""
    return _in_a_folder(role, {named or f"{role}{content[1]}": lambda: content[0]})


def path_of(role: str, value: Any) -> Any:
    """The same for an input that is nothing but a file, or several. Raises ParameterError for what can be none."""
    given = on_disk(role, value)
    if not (given is None or isinstance(given, str | list | tuple)):
        forms = FORMS if role != "cube" else FORMS_OF_CUBE
        raise ParameterError(f"`{role}` is of {type(value).__name__}, which cannot be read; give {forms}")
    return given


def results_on_disk(role: str, value: Any) -> Any:
    """The same of results alone, one or several in a list, for a reader that takes all else as it is."""
    if isinstance(value, list):
        return [results_on_disk(role, one) for one in value]
    if not hasattr(value, "as_input") or not value.as_input(role):
        return value
    return on_disk(role, value)


def _files_for(role: str, result: AsFiles) -> Mapping[str, Callable[[], bytes]]:
    if files := result.as_input(role):
        return files
    raise ParameterError(f"`{role}`: a {type(result).__name__} holds nothing that it could be read from; give {FORMS}")


@functools.cache
def _room() -> "TemporaryDirectory[str]":
    """Where such files lie until the process ends."""
    return TemporaryDirectory(prefix=_ROOM)


def new_path(name: str) -> Path:
    """A path in a folder of its own that is there until the process ends."""
    return Path(mkdtemp(dir=_room().name)) / name


def _in_a_folder(name: str, contents: Mapping[str, Callable[[], bytes]]) -> str:
    folder = new_path(name)
    folder.mkdir()
    for file, make in contents.items():
        (folder / file).write_bytes(make())
    return str(folder / next(iter(contents)) if len(contents) == 1 else folder)


def as_named(text: str, *, role: bool = False) -> str:
    """A text without the folders in which files of what is in memory lie, of this process or an earlier one; but for
    the last one with a `role`.
    """
    if _ROOM not in text:
        return text
    here = _room().name if _room.cache_info().currsize else ""
    return _FOLDERS.sub(r"\1" if role else "", text.replace(here, Path(here).name) if here else text)


def named_within(value: Any) -> Any:
    """The same of all texts in dicts, their keys too, in lists and in dataclasses that have such a folder."""
    if isinstance(value, str):
        return as_named(value)
    if isinstance(value, Mapping):
        made: dict[Any, Any] = {}
        for key, one in value.items():
            made[_name_beside(made, key) if isinstance(key, str) else key] = named_within(one)
        return made
    if is_dataclass(value) and not isinstance(value, type):
        return replace(value, **{item.name: named_within(getattr(value, item.name)) for item in fields(value)})
    return type(value)(map(named_within, value)) if type(value) in (list, tuple) else value


def _name_beside(others: Mapping[Any, Any], path: str) -> str:
    """The name of an input: of several alike with its role, or numbered."""
    name = as_named(path)
    if name not in others:
        return name
    names = (as_named(path, role=True), *(f"{name} {k}" for k in range(2, len(others) + 3)))
    return next(one for one in names if one not in others)


def _read(file: Any) -> bytes:
    """All of an open file; one that was written or read to its end is read from its beginning."""
    content = file.read()
    if not content and hasattr(file, "seek") and getattr(file, "seekable", lambda: True)():
        file.seek(0)
        content = file.read()
    return content.encode() if isinstance(content, str) else bytes(content)


def _ending(data: bytes) -> str:
    start = data[:64].lstrip()
    if named := next((end for first, end in BEGINNINGS.items() if start.startswith(first)), ""):
        return named
    if start.startswith(b"PK"):
        return ".npz" if b".npy" in data else ".xlsx"
    try:
        return ".toml" if tomllib.loads(data.decode("utf-8")) else ".csv"
    except (ValueError, RecursionError):
        return ".csv"


def _dimensions(value: Any) -> int:
    """Of an array or nested lists of numbers; -1 for what is none."""
    import numpy as np

    try:
        array = np.asarray(value)
    except (TypeError, ValueError):
        return -1
    return array.ndim if array.dtype.kind in "fiub" else -1


def _is_grid(value: Any) -> bool:
    """Whether something is x and y of nodes, and their heights."""
    return isinstance(value, list | tuple) and len(value) == 3 and _dimensions(value[2]) == 2


def is_cube(value: Any) -> bool:
    """Whether something is wavelengths, and reflectances over lines, samples and these."""
    return isinstance(value, tuple) and len(value) == 2 and _dimensions(value[1]) == 3


def _cube(wavelength: Any, reflectance: Any) -> Any:
    """Raises ParameterError for reflectances whose last axis, or first, is not that of the wavelengths."""
    import numpy as np
    from xarray import DataArray

    count, values = np.size(wavelength), np.asarray(reflectance)
    if values.shape[-1] != count == values.shape[0]:
        values = np.moveaxis(values, 0, -1)
    if values.shape[-1] != count:
        shape = " x ".join(map(str, values.shape))
        raise ParameterError(
            f"`cube`: reflectances of {shape} beside {count} wavelengths; give (lines, samples, {count})"
        )
    axes = ("line", "sample", "wavelength")
    return DataArray(values, dims=axes, coords={"wavelength": wavelength}, name="reflectance")


def _is_records(value: Any) -> bool:
    """Whether something is a table as rows: dicts in a list, or an array with names."""
    if isinstance(value, list | tuple):
        return bool(value) and all(isinstance(one, Mapping) for one in value)
    return bool(getattr(getattr(value, "dtype", None), "names", None))


def _csv(table: Any) -> bytes:
    import pandas as pd

    frame = table if hasattr(table, "to_csv") else pd.DataFrame(table)
    if str(next(iter(getattr(frame, "columns", ())), "")).startswith("#"):  # pandas took a comment for the header
        cells = frame.to_csv(header=False, index=not isinstance(frame.index, pd.RangeIndex))
        return f"{','.join(map(str, frame.columns))}\n{cells}".encode()
    named = any(name is not None for name in getattr(frame.index, "names", ()))
    content: str = (frame.reset_index() if named else frame).to_csv(index=False)
    return content.encode()


def _ecsv(table: Any) -> bytes:
    """An astropy table as ECSV with commas, which readers of CSV take too."""
    from astropy.io import ascii

    plain = table.copy()
    for name in plain.colnames:
        unit, given = unit_of(name), getattr(plain[name], "unit", None)
        if unit and given is not None and given.is_equivalent(unit):
            plain[name] = plain[name].to(unit)
        elif unit and given is not None and "_" in name:
            raise DataError(f"<table>: column {name} is in {given}, its name says {unit}; rename it or convert it")
    written = io.StringIO()
    ascii.write(plain, written, format="ecsv", delimiter=",")
    return written.getvalue().encode()


def _netcdf(data: Any) -> bytes:
    """A Dataset or DataArray as netCDF 3, which scipy writes, with no attributes but units."""
    data = data.to_dataset(name=data.name or "values") if hasattr(data, "to_dataset") else data.copy()
    for one in (data, *data.variables.values()):
        one.attrs = {"units": str(one.attrs["units"])} if "units" in one.attrs else {}
        one.encoding = {}
    return bytes(data.to_netcdf(engine="scipy"))


def _archive(arrays: Mapping[str, Any]) -> bytes:
    import numpy as np

    written = io.BytesIO()
    arguments: dict[str, Any] = {name: np.asarray(values) for name, values in arrays.items()}
    np.savez(written, **arguments)
    return written.getvalue()


def _of_dict(value: Mapping[Any, Any]) -> tuple[bytes, str]:
    named = {str(key): one for key, one in value.items()}
    if not {"schema", "features", "geometry", "coordinates"}.isdisjoint(named):
        return json.dumps(named, default=_listed).encode(), ".json"
    dimensions = [_dimensions(one) for one in named.values() if not isinstance(one, str)]
    if 2 in dimensions:
        return _archive(named), ".npz"
    columns = [one for one in named.values() if not isinstance(one, str | Mapping) and hasattr(one, "__len__")]
    if any(map(len, columns)) and len(columns) == len(named) and not any(map(_is_records, columns)):
        lengths = {len(one) for one in columns}
        if len(lengths) > 1:
            raise DataError(f"<dict>: its columns are {sorted(lengths)} long; give all the same number of rows")
        return _csv(named), ".csv"
    return toml_text(named).encode(), ".toml"


def _listed(value: Any) -> Any:
    return value.tolist() if hasattr(value, "tolist") else str(value)


def toml_text(table: Mapping[str, Any]) -> str:
    """A table as TOML, a line for each key; keys without a value are left out.

    >>> print(toml_text({"name": "rig", "wheel": {"radius_m": 0.15}, "leg": [{"length_m": 3}], "note": None}), end="")
    name = "rig"
    wheel = { radius_m = 0.15 }
    leg = [{ length_m = 3 }]
    """
    return "".join(f"{_key(key)} = {_toml(value)}\n" for key, value in table.items() if value is not None)


def _key(key: Any) -> str:
    return str(key) if _KEY.fullmatch(str(key)) else json.dumps(str(key), ensure_ascii=False)


def _toml(value: Any) -> str:
    value = value.tolist() if hasattr(value, "tolist") else value
    if isinstance(value, Mapping):
        inner = ", ".join(f"{_key(key)} = {_toml(one)}" for key, one in value.items() if one is not None)
        return f"{{ {inner} }}"
    if isinstance(value, Sequence) and not isinstance(value, str):
        return f"[{', '.join(map(_toml, value))}]"
    if isinstance(value, bool):
        return str(value).lower()
    return repr(value) if isinstance(value, int | float) else json.dumps(str(value), ensure_ascii=False)
