"""Own readers of PDS and ENVI files beside `pdr`, `pds4_tools` and `spectral`: values, wavelengths, marks of no data.

    pip install pdr pds4_tools spectral
    python tests/benchmarks/label_readers.py [FOLDER OF THE REFERENCE DATA]

Makes a file of each layout, and one that is cut, reads each with each reader in a process of its own, and prints what
it found, its time with imports and its peak memory. The large cube has 304 x 2,000 x 85 floats, 207 MB. The labels of
M3 are real: two crops of Level 1B whose headers are not beside them.
"""

import json
import os
import subprocess
import sys
import tempfile
import time
import warnings
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

NM = np.arange(400.0, 2510.0, 10.0)
R = 0.2 - 0.05 * np.exp(-(((NM - 940) / 100) ** 2))
MARKED = np.where(NM > 2450, 65535.0, R)
LARGE = (2000, 304)
READERS = ("lunarsci", "pdr", "pds4_tools", "spectral")


def _pds3_table(folder: Path, kept: int = NM.size) -> Path:
    rows = [f"{nm / 1000:10.4f}{r:10.6g}{0.001:10.5f}\r\n" for nm, r in zip(NM, MARKED, strict=True)]
    (folder / "a.tab").write_text("".join(rows[:kept]), newline="")
    columns = "".join(
        f"  OBJECT = COLUMN\n    NAME = {name}\n    DATA_TYPE = ASCII_REAL\n    START_BYTE = {start}\n    BYTES = 10\n"
        f"{more}  END_OBJECT = COLUMN\n"
        for name, start, more in (
            ("WAVELENGTH", 1, "    UNIT = MICROMETER\n"),
            ("REFLECTANCE", 11, "    MISSING_CONSTANT = 65535.\n"),
            ("STANDARD_DEVIATION", 21, ""),
        )
    )
    (folder / "a.lbl").write_text(
        f"PDS_VERSION_ID = PDS3\nRECORD_TYPE = FIXED_LENGTH\nRECORD_BYTES = 32\nFILE_RECORDS = {NM.size}\n^TABLE = "
        f'"a.tab"\nOBJECT = TABLE\n  INTERCHANGE_FORMAT = ASCII\n  ROWS = {NM.size}\n  COLUMNS = 3\n  ROW_BYTES = 32\n'
        f"{columns}END_OBJECT = TABLE\nEND\n"
    )
    return folder / "a.lbl"


def _pds4(folder: Path, data: str, area: str, before: str = "") -> Path:
    (folder / "a.xml").write_text(
        '<?xml version="1.0" encoding="UTF-8"?>\n<Product_Observational xmlns="http://pds.nasa.gov/pds4/pds/v1">'
        "<Identification_Area><logical_identifier>urn:nasa:pds:a</logical_identifier><version_id>1.0</version_id>"
        "<information_model_version>1.22.0.0</information_model_version></Identification_Area>"
        f"<Observation_Area>{before}</Observation_Area><File_Area_Observational><File><file_name>{data}</file_name>"
        f"</File>{area}</File_Area_Observational></Product_Observational>"
    )
    return folder / "a.xml"


def _pds4_table(folder: Path, kind: str, kept: int = NM.size) -> Path:
    values = np.stack([NM / 1000, MARKED, np.full(NM.size, 0.001)], axis=1)
    record, sizes, type_ = {"Character": (32, 10, "ASCII_Real"), "Binary": (24, 8, "IEEE754LSBDouble")}[kind]
    if kind == "Binary":
        (folder / "a.tab").write_bytes(values[:kept].astype("<f8").tobytes())
    else:
        lines = [f"{a:10.4f}{b:10.6g}{c:10.5f}\r\n" for a, b, c in values[:kept]]
        (folder / "a.tab").write_text("".join(lines), newline="")
    fields = "".join(
        f"<Field_{kind}><name>{name}</name><field_number>{k + 1}</field_number><field_location unit='byte'>"
        f"{1 + k * sizes}</field_location><data_type>{type_}</data_type><field_length unit='byte'>{sizes}"
        f"</field_length>{more}</Field_{kind}>"
        for k, (name, more) in enumerate(
            (
                ("Wavelength", "<unit>micrometer</unit>"),
                ("Reflectance", "<Special_Constants><missing_constant>65535</missing_constant></Special_Constants>"),
                ("Standard Deviation", ""),
            )
        )
    )
    return _pds4(
        folder, "a.tab",
        f"<Table_{kind}><offset unit='byte'>0</offset><records>{NM.size}</records>"
        f"{'<record_delimiter>Carriage-Return Line-Feed</record_delimiter>' if kind == 'Character' else ''}"
        f"<Record_{kind}><fields>3</fields><groups>0</groups><record_length unit='byte'>{record}</record_length>"
        f"{fields}</Record_{kind}></Table_{kind}>",
    )  # fmt: skip


def _numbers(shape: tuple[int, int], bands: int) -> np.ndarray[Any, Any]:
    """(lines, bands, samples), one pixel without a value."""
    found = np.tile(R[:bands][:, None], (shape[0], 1, shape[1])).astype("<f4")
    found[0, :, 0] = 65535
    return found


def _pds3_cube(folder: Path, shape: tuple[int, int] = (4, 3), bands: int = NM.size) -> Path:
    (folder / "a.img").write_bytes(_numbers(shape, bands).tobytes())
    centres = ", ".join(f"{nm:g}" for nm in NM[:bands])
    (folder / "a.lbl").write_text(
        f'PDS_VERSION_ID = PDS3\nRECORD_TYPE = FIXED_LENGTH\nRECORD_BYTES = {4 * shape[1]}\n^IMAGE = "a.img"\nOBJECT = '
        f"IMAGE\n LINES = {shape[0]}\n LINE_SAMPLES = {shape[1]}\n SAMPLE_TYPE = PC_REAL\n SAMPLE_BITS = 32\n BANDS = "
        f"{bands}\n BAND_STORAGE_TYPE = LINE_INTERLEAVED\n MISSING_CONSTANT = 65535.\n GROUP = BAND_BIN\n"
        f"  BAND_BIN_CENTER = ({centres})\n  BAND_BIN_UNIT = NANOMETER\n END_GROUP = BAND_BIN\nEND_OBJECT = IMAGE\n"
        "END\n"
    )
    return folder / "a.lbl"


def _pds4_cube(folder: Path) -> Path:
    (folder / "a.qub").write_bytes(_numbers((4, 3), NM.size).swapaxes(0, 1).tobytes())
    axes = "".join(
        f"<Axis_Array><axis_name>{name}</axis_name><elements>{count}</elements><sequence_number>{k}</sequence_number>"
        "</Axis_Array>"
        for k, (name, count) in enumerate((("Band", NM.size), ("Line", 4), ("Sample", 3)), 1)
    )
    bins = "".join(f'<Band_Bin><center_wavelength unit="nm">{nm:g}</center_wavelength></Band_Bin>' for nm in NM)
    return _pds4(
        folder, "a.qub",
        "<Array_3D_Image><offset unit='byte'>0</offset><axes>3</axes><axis_index_order>Last Index Fastest"
        f"</axis_index_order><Element_Array><data_type>IEEE754LSBSingle</data_type></Element_Array>{axes}"
        "<Special_Constants><missing_constant>65535</missing_constant></Special_Constants></Array_3D_Image>",
        f"<Discipline_Area><Band_Bin_Set>{bins}</Band_Bin_Set></Discipline_Area>",
    )  # fmt: skip


def _envi(folder: Path, kind: str, kept: float = 1.0, shape: tuple[int, int] = (4, 3), bands: int = NM.size) -> Path:
    library = kind == "library"
    values = MARKED[None] if library else _numbers(shape, bands).swapaxes(0, 1)
    scale, type_, code = ("", "<f4", 4)
    if kind == "integers":
        values, type_, code = np.where(values < 1, values * 10_000, 65535), "<u2", 12
        scale = "reflectance scale factor = 10000\n"
    data = values.astype(type_).tobytes()
    name = folder / ("a.sli" if library else "a.img")
    name.write_bytes(data[: int(kept * len(data))])
    sizes = (bands, 1, 1) if library else (shape[1], shape[0], bands)
    (folder / "a.hdr").write_text(
        f"ENVI\nsamples = {sizes[0]}\nlines = {sizes[1]}\nbands = {sizes[2]}\nheader offset = 0\ninterleave = bsq\n"
        f"file type = ENVI {'Spectral Library' if library else 'Standard'}\ndata type = {code}\nbyte order = 0\n"
        f"{scale}data ignore value = 65535\nwavelength units = Nanometers\n"
        f"wavelength = {{{', '.join(map(str, NM[:bands]))}}}\n" + ("spectra names = {rock}\n" if library else "")
    )
    return folder / "a.hdr"


CASES: dict[str, Callable[[Path], Path]] = {
    "PDS3 table": _pds3_table,
    "PDS3 table cut": lambda folder: _pds3_table(folder, NM.size // 2),
    "PDS3 cube": _pds3_cube,
    "PDS3 cube of 207 MB": lambda folder: _pds3_cube(folder, LARGE, 85),
    "PDS4 table of text": lambda folder: _pds4_table(folder, "Character"),
    "PDS4 table of text cut": lambda folder: _pds4_table(folder, "Character", NM.size // 2),
    "PDS4 table of bytes": lambda folder: _pds4_table(folder, "Binary"),
    "PDS4 table of bytes cut": lambda folder: _pds4_table(folder, "Binary", NM.size // 2),
    "PDS4 cube": _pds4_cube,
    "ENVI library": lambda folder: _envi(folder, "library"),
    "ENVI library cut": lambda folder: _envi(folder, "library", 0.5),
    "ENVI cube": lambda folder: _envi(folder, "cube"),
    "ENVI cube of integers": lambda folder: _envi(folder, "integers"),
    "ENVI cube cut": lambda folder: _envi(folder, "cube", 0.5),
    "ENVI cube of 207 MB": lambda folder: _envi(folder, "cube", 1.0, LARGE, 85),
}


def _own(path: str) -> Any:
    from lunarsci.io.inputs import read_input
    from lunarsci.spectra.cubes.rasters import open_cube
    from lunarsci.spectra.readers.dispatch import read_spectra
    from lunarsci.spectra.readers.pds import is_pds_label, read_pds_label

    source = read_input(path)
    if "Array" in (text := source.data.decode("latin-1")) or "LINE_SAMPLES" in text or "ENVI Standard" in text:
        if is_pds_label(source) and any("W/" in one.unit for one in read_pds_label(source).images):
            from lunarsci.spectra.cubes.cube import FlatFile
            from lunarsci.spectra.readers.pds import data_file

            return None, [
                FlatFile(data_file(path, i.file), i.dtype, i.offset, i.lines, i.samples, i.bands, i.interleave)
                .read(slice(0, i.lines), slice(0, i.samples)) for i in read_pds_label(source).images
            ]  # fmt: skip
        cube = open_cube(path)
        blocks = [cube.read(slice(k, k + 64), slice(0, cube.shape[1]))[0] for k in range(0, cube.shape[0], 64)]
        blocks = blocks if cube.shape[0] < LARGE[0] else blocks[:1]
        return cube.wavelength_nm, [np.concatenate(blocks)]
    [spectrum] = read_spectra(path)
    return spectrum.wavelength_nm, [spectrum.reflectance]


def _pdr(path: str) -> Any:
    import pdr

    data = pdr.read(path)
    names = list(data.keys())  # iterating over it gives values
    images = [key for key in names if key.endswith("IMAGE") or key.startswith("ARRAY")]
    keys = images or [key for key in names if "TABLE" in key.upper()]
    found = [data[key] for key in keys]
    if any(one is None for one in found):
        raise ValueError(f"{', '.join(keys)}: nothing loaded")
    if hasattr(found[0], "columns"):
        table = found[0]
        return np.asarray(table.iloc[:, 0], float), [np.asarray(table.iloc[:, 1], float)]
    scaled = [np.ma.filled(np.ma.asarray(data.get_scaled(key)).astype(float), np.nan) for key in keys]
    return None, [np.moveaxis(one, 0, -1) for one in scaled]


def _pds4_tools(path: str) -> Any:
    import pds4_tools

    structure = pds4_tools.read(path, quiet=True, lazy_load=True)[0]
    masked = structure.as_masked().data
    if structure.is_table():
        names = masked.dtype.names
        return np.asarray(masked[names[0]], float), [np.ma.filled(np.ma.asarray(masked[names[1]]), np.nan)]
    return None, [np.moveaxis(np.ma.filled(np.ma.asarray(masked).astype(float), np.nan), 0, -1)]


def _spectral(path: str) -> Any:
    import spectral.io.envi as envi

    image = envi.open(path)
    if hasattr(image, "spectra"):
        return np.asarray(image.bands.centers), [np.asarray(image.spectra, float)[0]]
    last = min(64, image.nrows) if image.nrows >= LARGE[0] else image.nrows
    return np.asarray(image.bands.centers), [np.asarray(image[:last, :, :], float)]


def _read(reader: str, path: str) -> dict[str, Any]:
    begun = time.perf_counter()
    how = {"lunarsci": _own, "pdr": _pdr, "pds4_tools": _pds4_tools, "spectral": _spectral}[reader]
    with warnings.catch_warnings(record=True) as said:
        warnings.simplefilter("always")
        wavelength, values = how(path)
    seconds = time.perf_counter() - begun
    one = np.asarray(values[0], float)
    last = one[1, 1] if one.ndim == 3 else one
    marked = bool(np.isnan(one[0, 0]).all()) if one.ndim == 3 else bool(np.isnan(one[-1]))
    expected = R[: last.size]
    known = np.isfinite(last) & (last < 60_000)
    right = bool(np.allclose(last[known], expected[: last.size][known], atol=2e-4)) if last.size > 10 else None
    in_nm = None if wavelength is None else bool(np.allclose(wavelength, NM[: wavelength.size]))
    status = Path("/proc/self/status").read_text()
    peak = int(status.partition("VmHWM:")[2].split()[0]) / 1024
    sums = [[list(np.shape(v)), float(np.nansum(np.where(np.abs(v) < 1e30, v, 0)))] for v in values]
    return {"values": right, "channels": int(last.size), "wavelength_nm": in_nm, "marked": marked, "said": len(said),
            "s": round(seconds, 2), "mb": round(peak), "sums": sums}  # fmt: skip


def main() -> None:
    """Print a line for each case and reader."""
    if sys.argv[1:2] == ["--one"]:
        try:
            found = _read(*sys.argv[2:4])
        except Exception as error:  # whatever a library raises is what is looked for
            found = {"error": f"{type(error).__name__}: {' '.join(str(error).split())[:110]}"}
        os.write(1, b"\n@" + json.dumps(found).encode() + b"\n")
        return
    with tempfile.TemporaryDirectory() as base:
        given = {name: str(made(_folder(base, name))) for name, made in CASES.items()}
        if len(sys.argv) > 1:
            given |= {f"M3 {p.name[:3]}": str(p) for p in sorted(Path(sys.argv[1]).glob("spectra/m3/*/*.LBL"))}
        for name, path in given.items():
            readers = ("lunarsci", "spectral") if "ENVI" in name else READERS[:3] if "PDS4" in name else READERS[:2]
            for reader in readers:
                done = subprocess.run([sys.executable, __file__, "--one", reader, path], capture_output=True, text=True)
                line = next((line for line in done.stdout.splitlines() if line.startswith("@")), "@none")
                print(f"{name:26} {reader:11} {line[1:]}", flush=True)


def _folder(base: str, name: str) -> Path:
    folder = Path(base) / name.replace(" ", "_")
    folder.mkdir()
    return folder


if __name__ == "__main__":
    main()
