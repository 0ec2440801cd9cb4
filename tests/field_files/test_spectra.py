"""Spectra as instruments, archives and programs write them, each after a public description that its kind names.

One made-up rock stands in all of them. It is read from Python and by the command line, and must be the same rock.
"""

import json
import warnings
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from functools import cache
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest

import lunarsci
from lunarsci.arrays import FloatArray
from lunarsci.errors import LunarSciWarning
from lunarsci.guide.info import info
from lunarsci.io.inputs import InputFile
from lunarsci.spectra.readers.dispatch import read_spectra
from lunarsci.spectra.spectrum import Spectrum

NM = np.arange(400.0, 2501.0, 10.0)


def rock(nm: FloatArray) -> FloatArray:
    """Reflectance with bands at 950 and 1950 nm, and noise that is the same whenever it is made."""
    one, two = (np.exp(-0.5 * ((nm - at) / width) ** 2) for at, width in ((950, 70), (1950, 180)))
    wiggle = 1e-4 * np.sin(nm * 12.9898) * np.cos(nm * 78.233)
    return np.asarray((0.18 + 5e-5 * (nm - 400)) * (1 - 0.28 * one) * (1 - 0.15 * two) + wiggle)


R = rock(NM)
DOWN = slice(None, None, -1)


def rows(*columns: FloatArray, gap: str = "\t", comma: bool = False, before: str = "", end: str = "\n") -> str:
    lines = (before + gap.join(f"{value:.8g}" for value in row) + end for row in zip(*columns, strict=True))
    return "".join(line.replace(".", ",") if comma else line for line in lines)


@dataclass(frozen=True)
class Written:
    """Files of a kind, of which the first is given, and what must be read.

    `source` is the public description; `count` the spectra, all of the rock times `scale`; `missing` how many channels
    of the first have no number; `sigma` that of all channels, None where none is stated.
    """

    source: str
    files: Mapping[str, str | bytes]
    count: int = 1
    missing: int = 0
    sigma: float | None = None
    scale: float = 1.0
    tolerance: float = 2e-5
    options: Mapping[str, str] = field(default_factory=dict)


def one(name: str, content: str | bytes) -> dict[str, str | bytes]:
    return {name: content}


def splib06() -> str:
    marked = np.where(NM > 2450, -1.23e34, R)
    return (
        "USGS Digital Spectral Library splib06a\nClark and others 2007, USGS, Data Series 231.\n\n"
        "For further information on spectroscopy, see: http://speclab.cr.usgs.gov\n\n"
        "ASCII Spectral Data file contents:\n     line 15 title\n     line 16 history\n"
        "     line 17 to end:  3-columns of data:\n        wavelength    reflectance    standard deviation\n\n"
        "     (standard deviation of 0.000000 means not measured)\n"
        "     (      -1.23e34  indicates a deleted number)\n"
        "----------------------------------------------------\n"
        "Basalt made up                  W1R1Ba AREF\nmade for a test\n"
        + rows(NM / 1000, marked, 0 * R + 0.001, gap="       ", before="       ")
    )


def oceanview() -> str:
    head = (
        "Data from FLMS00001__0.txt Node\n\nDate: Mon Jan 06 12:00:00 CET 2020\nUser: made up\n"
        "Spectrometer: FLMS00001\n"
        "Trigger mode: 0\nIntegration Time (sec): 1.000000E-2\nScans to average: 10\nNonlinearity correction enabled: "
        "true\nBoxcar width: 5\nXAxis mode: Wavelengths\nNumber of Pixels in Spectrum: "
    )
    return f"{head}{NM.size}\n>>>>>Begin Spectral Data<<<<<\n" + rows(NM, R)


def spectrasuite() -> str:
    return (
        "SpectraSuite Data File\n++++++++++++++++++++++++++++++++++++\nDate: 01-06-2020, 12:00:00\n"
        "Integration Time (usec): 100000 (USB2E1)\nSpectra Averaged: 20 (USB2E1)\n"
        f"Number of Pixels in Processed Spectrum: {NM.size}\n>>>>>Begin Processed Spectral Data<<<<<\n"
        + rows(NM, R)
        + ">>>>>End Processed Spectral Data<<<<<\n"
    )


def avasoft() -> str:
    table = rows(NM, 0 * R + 900, 0 * R + 20, 0 * R + 5000, 100 * R, gap=";", comma=True)
    return (
        "trt0001\nIntegration time [ms]: 10,000\nAverage Nr. [scans]: 10\nSmoothing Nr. [pixels]: 1\n"
        "Data measured with spectrometer [name]: 0001\n"
        "Wave   ;Sample   ;Dark     ;Reference;Reflectance\n[nm]   ;[counts] ;[counts] ;[counts] ;[%]\n\n" + table
    )


def perkin_elmer() -> str:
    names = (
        "PE UV       SUBTECH     SPECTRUM    ASCII       PEDS        4.00        \n-1\nROCK.ASC\n"
        "20/01/06\n12:00:00.00\n"
    )
    settings = "".join(f"{value}\n" for value in (8, 0, 860.8, "2500.000000 - 400.000000", 1, 0.2, 100.0, 3, 4, 5))
    return (
        f"{names}{settings}#HDR\n-1\n-1\n#GR\nnm\n%R\n1.000000\n0.000000\n2500.000000\n-10.000000\n{NM.size}\n4\n"
        "20.000000\n10.000000\n#DATA\n" + rows(NM[DOWN], 100 * R[DOWN])
    )


def cary() -> str:
    return (
        "Baseline 100%T,,Rock,\nWavelength (nm),%R,Wavelength (nm),%R,\n".replace("Baseline 100%T", "Rock a")
        + rows(NM[DOWN], 100 * R[DOWN], NM[DOWN], 100 * R[DOWN], gap=",", end=",\n")
        + "\nRock a\nCollection Time: 1/6/2020 12:00:00 PM\nScan Software Version: 5.1.3(1042)\n"
    )


def jasco() -> str:
    return (
        "TITLE\trock\nDATA TYPE\tULTRAVIOLET SPECTRUM\nORIGIN\tJASCO\nOWNER\t\nDATE\t20/01/06\nTIME\t12:00:00\n"
        "SPECTROMETER/DATA SYSTEM\tJASCO Corp., V-770, Rev. 1.00\nDELTAX\t-10\nXUNITS\tNANOMETERS\nYUNITS\t%R\n"
        f"FIRSTX\t2500\nLASTX\t400\nNPOINTS\t{NM.size}\nFIRSTY\t20\nMAXY\t28\nMINY\t12\nXYDATA\n"
        + rows(NM[DOWN], 100 * R[DOWN])
        + "\n##### Extended Information\n[Comments]\nSample name\trock\nUser\tmade up\n"
    )


def jcamp(compressed: bool = False) -> str:
    numbers = np.round(R[DOWN] / 1e-6).astype(int)
    nm, lines = NM[DOWN], []
    for k in range(0, NM.size, 8):
        own = numbers[k : k + 8]
        if compressed:
            first = max(k - 1, 0)
            lines.append(f"{nm[first]:g}" + squeezed(numbers[first : k + 8].tolist()))
        else:
            lines.append(f"{nm[k]:g}" + "".join(f" {value}" for value in own))
    return (
        "##TITLE= made-up rock\n##JCAMP-DX= 4.24 $$ made for a test\n##DATA TYPE= UV/VIS SPECTRUM\n##ORIGIN= nobody\n"
        "##OWNER= public domain\n##XUNITS= NANOMETERS\n##YUNITS= REFLECTANCE\n##XFACTOR= 1.0\n##YFACTOR= 1E-6\n"
        f"##FIRSTX= 2500\n##LASTX= 400\n##DELTAX= -10\n##NPOINTS= {NM.size}\n##XYDATA= (X++(Y..Y))\n"
        + "\n".join(lines)
        + "\n##END=\n"
    )


def squeezed(values: list[int]) -> str:
    """A line of values in the forms SQZ and DIF: the last of the line before as a check, then differences."""

    def coded(value: int, signs: str) -> str:
        digits = str(abs(value))
        letter = signs[int(digits[0])] if value >= 0 else signs[9 + int(digits[0])]
        return letter + digits[1:]

    first = coded(values[0], "@ABCDEFGHIabcdefghi")
    return first + "".join(coded(b - a, "%JKLMNOPQRjklmnopqr") for a, b in pairwise(values))


def envi_plot() -> str:
    head = (
        "ENVI ASCII Plot File [Mon Jan 06 12:00:00 2020]\nColumn 1: Wavelength\n"
        "Column 2: Mean: ROI #1 [Red] 12 points~~2\nColumn 3: X:12 Y:30~~3\n"
    )
    return head + rows(NM / 1000, R, R, gap="  ", before="  ")


def mrt() -> str:
    line = "-" * 80
    table = "".join(f"{nm / 1000:6.3f} {r:9.6f} {0.001:8.6f}\n" for nm, r in zip(NM, R, strict=True))
    return (
        "Title: A made-up rock\nAuthors: Nobody N.\nTable: Spectrum\n" + "=" * 80 + "\n"
        f"Byte-by-byte Description of file: made_up.txt\n{line}\n   Bytes Format Units  Label  Explanations\n{line}\n"
        "   1-  6 F6.3   um     Wave   Wavelength\n   8- 16 F9.6   ---    Refl   Reflectance\n"
        f"  18- 25 F8.6   ---    e_Refl Uncertainty in Refl\n{line}\n" + table
    )


def delimited_pds4() -> Mapping[str, str | bytes]:
    def column(name: str, number: int, unit: str) -> str:
        return (
            f"<Field_Delimited><name>{name}</name><field_number>{number}</field_number><data_type>ASCII_Real"
            f"</data_type><unit>{unit}</unit><Special_Constants><missing_constant>-999</missing_constant>"
            "</Special_Constants></Field_Delimited>"
        )

    head, body = "wavelength,reflectance\r\n", rows(NM, np.where(NM > 2450, -999, R), gap=",", end="\r\n")
    label = (
        '<?xml version="1.0" encoding="UTF-8"?>\n<Product_Observational xmlns="http://pds.nasa.gov/pds4/pds/v1">'
        "<File_Area_Observational><File><file_name>rock.csv</file_name></File><Header><offset unit='byte'>0</offset>"
        f"<object_length unit='byte'>{len(head)}</object_length></Header>"
        f"<Table_Delimited><offset unit='byte'>{len(head)}"
        f"</offset><records>{NM.size}</records><record_delimiter>Carriage-Return Line-Feed</record_delimiter>"
        "<field_delimiter>Comma</field_delimiter><Record_Delimited><fields>2</fields>"
        f"{column('Wavelength', 1, 'nm')}{column('Reflectance', 2, 'none')}"
        "</Record_Delimited></Table_Delimited></File_Area_Observational></Product_Observational>\n"
    )
    return {"rock.xml": label, "rock.csv": head + body}


def attached_pds3() -> str:
    label = (
        "PDS_VERSION_ID = PDS3\r\nRECORD_TYPE = FIXED_LENGTH\r\nRECORD_BYTES = 32\r\n"
        "LABEL_RECORDS = 40\r\n^SPECTRUM = 41\r\n"
        f"OBJECT = SPECTRUM\r\n INTERCHANGE_FORMAT = ASCII\r\n ROWS = {NM.size}\r\n COLUMNS = 2\r\n ROW_BYTES = 32\r\n"
        " OBJECT = COLUMN\r\n  NAME = WAVELENGTH\r\n  UNIT = MICRON\r\n  DATA_TYPE = ASCII_REAL\r\n  START_BYTE = 1\r\n"
        "  BYTES = 10\r\n END_OBJECT = COLUMN\r\n OBJECT = COLUMN\r\n"
        "  NAME = REFLECTANCE\r\n  DATA_TYPE = ASCII_REAL\r\n"
        "  START_BYTE = 11\r\n  BYTES = 12\r\n END_OBJECT = COLUMN\r\nEND_OBJECT = SPECTRUM\r\nEND\r\n"
    ).ljust(40 * 32)
    return label + "".join(f"{nm / 1000:10.4f}{r:12.8f}{'':8}\r\n" for nm, r in zip(NM, R, strict=True))


def sig() -> str:
    """Three detectors that overlap at 970-1010 and 1880-1910 nm, the first two off the level of the last."""
    parts = [(np.arange(400, 1011, 1.5), 1.04), (np.arange(971, 1911, 3.7), 0.97), (np.arange(1880, 2501, 2.6), 1.0)]
    nm = np.concatenate([part for part, _ in parts])
    r = np.concatenate([gain * rock(part) for part, gain in parts])
    return (
        "/*** Spectra Vista SIG Data ***/\nname= rock.sig\ninstrument= HI: 1234567 (HR-1024i)\n"
        "integration= 10.0, 20.0, 10.0\n"
        "units= Radiance, Radiance\nfactors= 1.000, 1.000, 1.000 [Overlap: Preserve]\ndata= \n"
        + rows(nm, 0 * nm + 900, 900 * r, 100 * r, gap="  ")
    )


def smass() -> str:
    """A rejected channel has -1 and the number 0."""
    bad = NM == 1400
    return rows(
        NM / 1000, np.where(bad, -1, R), np.where(bad, -1, 0.001), np.where(bad, 0, np.where(NM > 900, 7, 1)), gap="  "
    )


def votable() -> str:
    cells = "".join(f"<TR><TD>{nm / 1000:g}</TD><TD>{r:.8g}</TD></TR>" for nm, r in zip(NM, R, strict=True))
    return (
        '<?xml version="1.0" encoding="UTF-8"?>\n<VOTABLE version="1.3" xmlns="http://www.ivoa.net/xml/VOTable/v1.3">'
        '<RESOURCE><TABLE><FIELD name="wavelength" datatype="double" unit="um" ucd="em.wl"/>'
        '<FIELD name="reflectance" datatype="double"/><DATA><TABLEDATA>'
        f"{cells}</TABLEDATA></DATA></TABLE></RESOURCE></VOTABLE>\n"
    )


def fits_of(columns: Mapping[str, tuple[FloatArray, str | None]], header: Mapping[str, object] | None = None) -> bytes:
    import io

    from astropy.io import fits

    table = fits.BinTableHDU.from_columns(
        [fits.Column(name=name, format="D", array=values, unit=unit) for name, (values, unit) in columns.items()]
    )
    stream = io.BytesIO()
    fits.HDUList([fits.PrimaryHDU(np.zeros((4, 4), np.int16)), table]).writeto(stream)
    return stream.getvalue()


def spex() -> bytes:
    import io

    from astropy.io import fits

    hdu = fits.PrimaryHDU(np.stack([NM / 1000, R, 0 * R + 0.001]))
    hdu.header.update({"XUNITS": "microns", "YUNITS": "DN / s", "INSTR": "SpeX"})
    hdu.header["YUNITS"] = "reflectance"
    stream = io.BytesIO()
    hdu.writeto(stream)
    return stream.getvalue()


def wide(head: str, *ids: str, gap: str = ",") -> str:
    lines = [gap.join([head, *(f"{nm:g}" for nm in NM)])]
    return "\n".join([*lines, *(gap.join([id, *(f"{value:.8g}" for value in R)]) for id in ids)]) + "\n"


def origin() -> str:
    return "Wavelength\tReflectance\tError\nnm\t%\t%\n\trock A\t\n" + rows(NM, 100 * R, 0 * R + 0.1)


KINDS: dict[str, Written] = {
    "splib06": Written("USGS, 10.3133/ds231, ASCII spectra", one("a.asc", splib06()), missing=5, sigma=0.001),
    "oceanview": Written("Ocean Insight, OceanView manual, saving of spectra", one("a.txt", oceanview())),
    "spectrasuite": Written("Ocean Optics, SpectraSuite manual 000-20300-300-02", one("a.txt", spectrasuite())),
    "avasoft": Written("Avantes; lightr, 10.21105/joss.01857, lr_parse_trt", one("a.trt", avasoft())),
    "perkin elmer": Written("https://github.com/solarchemist/pelambda, layout of .asc", one("a.asc", perkin_elmer())),
    "cary": Written("Agilent Cary WinUV, CSV export", one("a.csv", cary()), count=2),
    "jasco": Written("https://github.com/garrekstemo/JASCOFiles.jl, heads", one("a.txt", jasco())),
    "jcamp": Written("McDonald & Wilks 1988, 10.1366/0003702884428734", one("a.jdx", jcamp())),
    "jcamp compressed": Written("McDonald & Wilks 1988, ASDF forms", one("a.dx", jcamp(True))),
    "opus dpt": Written(
        "Bruker OPUS, data point table", one("a.dpt", rows(1e7 / NM, R, gap=",")), tolerance=1e-4
    ),
    "envi plot": Written("NV5 ENVI, plot windows, export to ASCII", one("a.txt", envi_plot()), count=2),
    "machine-readable table": Written("AAS, https://journals.aas.org/mrt-overview", one("a.txt", mrt()), sigma=0.001),
    "pds4 delimited": Written("PDS4 Standards Reference, Table_Delimited", delimited_pds4(), missing=5),
    "pds3 attached": Written("PDS3 Standards Reference 3.8, attached labels, SPECTRUM", one("a.tab", attached_pds3())),
    "sig overlap": Written("Spectra Vista, SVC HR-1024i user manual", one("a.sig", sig()), tolerance=2e-4),
    "smass": Written("http://smass.mit.edu/minus_format.html", one("a.txt", smass()), missing=1, sigma=0.001),
    "votable": Written("IVOA VOTable 1.4, 10.5479/ADS/bib/2019ivoa.spec.1021O", one("a.xml", votable())),
    "fits units": Written(
        "FITS 4.0, TUNITn, 10.1051/0004-6361/201015362",
        one("a.fits", fits_of({"WAVE": (NM / 1000, "um"), "REFL": (100 * R, "percent"), "ERR": (0 * R + 0.1, "%")})),
        sigma=0.001,
    ),
    "spex": Written("Cushing et al. 2004, 10.1086/382907, Spextool output", one("a.fits", spex()), sigma=0.001),
    "asd several": Written(
        "ASD ViewSpec Pro user manual, ASCII export",
        one("a.txt", "Wavelength;a00000.asd;a00001.asd\n" + rows(NM, R, R, gap=";", comma=True)),
        count=2,
    ),
    "sed fraction": Written(
        "Spectral Evolution, DARWin SP user manual, SED files",
        one(
            "a.sed",
            "Comment: \nVersion: 2.2 [1.2.64D]\nFile Name: C:\\a.sed\nInstrument: SR-3500_SN0000000 [3]\n"
            "Channels: 1024\nColumns [5]:\nData:\nChan.#\tWvl\tNorm. DN (Ref.)\tNorm. DN (Target)\tReflect. [1.0]\n"
            + rows(np.arange(1.0, NM.size + 1), NM, 0 * R + 3e4, 3e4 * R, R),
        ),
    ),
    "R row names": Written(
        "R, utils::write.csv",
        one("a.csv", '"","wavelength","rock"\n' + "".join(
            f'"{k}",{nm:g},{r:.8g}\n' for k, (nm, r) in enumerate(zip(NM, R, strict=True), 1))),
    ),
    "pandas index": Written(
        "pandas, DataFrame.to_csv",
        one("a.csv", ",wavelength_nm,reflectance\n" + rows(np.arange(NM.size), NM, R, gap=",")),
    ),
    "plot digitizer": Written(
        "WebPlotDigitizer user manual, export of all data",
        one("a.csv", "rock A,,rock B,\nX,Y,X,Y\n" + rows(NM, R, NM, R, gap=", ")),
        count=2,
    ),
    "igor text": Written(
        "WaveMetrics, Igor Pro manual, Igor Text files",
        one("a.itx", "IGOR\r\nWAVES/D\twave_nm, refl\r\nBEGIN\r\n" + rows(NM, R, before="\t", end="\r\n") + "END\r\n"
            'X SetScale/P x 0,1,"", refl\r\n'),
    ),
    "origin": Written("OriginLab, export ASCII, long name, units, comments", one("a.txt", origin()), sigma=0.001),
    "pangaea": Written(
        "PANGAEA, https://wiki.pangaea.de/wiki/Format, tab-delimited text",
        one("a.tab", "/* DATA DESCRIPTION:\nCitation:\tNobody, N (2020): A made-up rock. PANGAEA\n"
            "Parameter(s):\tWAVELENGTH [nm] (Wavelength) * GEOCODE\n\tReflectance [%] (Refl) * PI: Nobody\n"
            f"Size:\t{2 * NM.size} data points\n*/\nWavelength [nm]\tRefl [%]\n" + rows(NM, 100 * R)),
    ),
    "unicode text of Excel": Written(
        "Microsoft, file formats of Excel, Unicode Text",
        one("a.txt", ("Wellenlänge [nm]\tReflexion [%]\r\n"
            + rows(NM, 100 * R, comma=True, end="\r\n")).encode("utf-16")),
    ),
    "old Macintosh": Written(
        "Unicode Standard Annex 14, CR as line end",
        one("a.csv", "wavelength_nm,rock\r" + rows(NM, R, gap=",", end="\r")),
    ),
    "thousands": Written(
        "CLDR, decimal and grouping signs, en",
        one("a.txt", "Wavelength (nm)\tReflectance (%)\n" + "".join(
            f"{nm:,.1f}\t{100 * r:.6f}\n" for nm, r in zip(NM, R, strict=True))),
    ),
    "thousands, German": Written(
        "CLDR, decimal and grouping signs, de",
        one("a.csv", "Wellenlänge (nm);Reflexionsgrad (%)\n" + "".join(
            f"{nm:,.1f};{100 * r:.6f}\n".replace(",", " ").replace(".", ",").replace(" ", ".")
            for nm, r in zip(NM, R, strict=True))),
    ),
    "idl comments": Written(
        "IDL: a semicolon begins a comment",
        one("a.dat", "; made-up rock\n; wavelength (um)   reflectance   error\n"
            + rows(NM / 1000, R, 0 * R + 0.001, gap="   ")),
        sigma=0.001,
    ),
    "grace": Written(
        "Grace user's guide, project files: @ lines, & after a set",
        one("a.agr", '# Grace project file\n@version 50125\n@    s0 legend  "rock"\n@target G0.S0\n@type xy\n'
            + rows(NM, R, gap=" ") + "&\n"),
    ),
    "specchio": Written(
        "SPECCHIO, Hueni et al. 2009, 10.1016/j.cageo.2008.03.015, CSV export",
        one("a.csv", "File Name,a.sig,b.sig\nInstrument,SVC,SVC\nAltitude,430.0,431.0\nLatitude,47.1,47.1\n"
            + rows(NM, R, R, gap=",")),
        count=2,
    ),
    "wavelengths in the first row": Written(
        "Unscrambler and Pirouette, samples by rows",
        one("a.txt", wide("Sample", "rock a", "rock b", gap="\t")),
        count=2,
    ),
    "json": Written(
        "pandas, DataFrame.to_json, orient='list' of to_dict",
        one("a.json", json.dumps({"wavelength_nm": NM.tolist(), "reflectance": R.tolist()})),
    ),
    "min and max": Written(
        "sample statistics as of ViewSpec Pro: Stdev beside the mean",
        one("a.txt", "Wavelength\tMean\tStdev\n" + rows(NM, R, 0 * R + 0.001)),
        sigma=0.001,
    ),
    "shimadzu": Written(
        "Shimadzu UVProbe, data print table",
        one("a.txt", '"File: rock - RawData - made-up.spc"\n"Wavelength nm.","R%"\n'
            + rows(NM[DOWN], 100 * R[DOWN], gap=",")),
    ),
    "seabass": Written(
        "NASA SeaBASS, https://seabass.gsfc.nasa.gov/wiki/metadataheaders",
        one("a.sb", "/begin_header\n/investigators=nobody\n/missing=-999\n/delimiter=comma\n/fields=wavelength,refl,"
            "refl_sd\n/units=nm,unitless,unitless\n/end_header\n"
            + rows(NM, np.where(NM > 2450, -999, R), np.where(NM > 2450, -999, 0.001), gap=",")),
        missing=5, sigma=0.001,
    ),
    "tables below each other": Written(
        "LabSolutions and Origin, several curves of one text file",
        one("a.txt", "".join(f"Sample {id}\nWavelength (nm)\tReflectance\n{rows(NM, R)}\n" for id in "AB")), count=2,
    ),
    "R table": Written(
        "R, utils::write.table: no name above the row names",
        one("a.txt", '"wavelength" "rock"\n' + "".join(
            f'"{k}" {nm:g} {r:.8g}\n' for k, (nm, r) in enumerate(zip(NM, R, strict=True), 1))),
    ),
    "names of bands": Written(
        "EnMAP-Box and QGIS, band names with wavelengths",
        one("a.csv", ",".join(["name", *(f"Band {k} ({nm:g} Nanometers)" for k, nm in enumerate(NM, 1))]) + "\nrock,"
            + ",".join(f"{r:.8g}" for r in R) + "\n"),
    ),
    "wide with semicolons": Written(
        "locale fr_FR, samples by rows",
        one("a.csv", ";".join(["id", *(f"{nm:.1f}" for nm in NM)]).replace(".", ",") + "\nrock;"
            + ";".join(f"{r:.8f}" for r in R).replace(".", ",") + "\n"),
    ),
    "thousands, Swiss": Written(
        "CLDR, de_CH", one("a.csv", "Wellenlänge (nm);R (%)\n" + "".join(
            f"{nm:,.1f};{100 * r:.6f}\n".replace(",", "'") for nm, r in zip(NM, R, strict=True))),
    ),
    "percent in cells": Written(
        "Microsoft, number format 0.00%, saved as CSV",
        one("a.csv", "Wavelength (nm),Reflectance\n" + "".join(
            f"{nm:g},{100 * r:.6f}%\n" for nm, r in zip(NM, R, strict=True))),
    ),
    "not determined": Written(
        "laboratory reports, n.d. for what was not determined",
        one("a.csv", "Wavelength (nm),Reflectance\n" + "".join(
            f"{nm:g},{f'{r:.8g}' if nm <= 2450 else 'n.d.'}\n" for nm, r in zip(NM, R, strict=True))),
        missing=5,
    ),
    "lambda in Angstrom": Written(
        "IRAF, wspectext with a header", one("a.dat", "# lambda(A) R(lambda)\n" + rows(10 * NM, R, gap=" "))),
    "errors of wavelengths": Written(
        "Levenberg fits of line lists: wl_err beside wl",
        one("a.csv", "wl_um,wl_err,R,R_err\n" + rows(NM / 1000, 0 * R + 0.005, R, 0 * R + 0.001, gap=",")), sigma=0.001,
    ),
    "wavenumber and wavelength": Written(
        "OMNIC and Spectragryph, both abscissae",
        one("a.csv", "Wavenumber (cm-1),Wavelength (um),Reflectance\n" + rows(1e7 / NM, NM / 1000, R, gap=",")),
    ),
    "empty column between": Written(
        "Excel sheets with a blank column",
        one("a.csv", "Wavelength (nm),,Reflectance\n" + "".join(
            f"{nm:g},,{r:.8g}\n" for nm, r in zip(NM, R, strict=True))),
    ),
    "json rows": Written(
        "pandas, DataFrame.to_json, orient='records'",
        one("a.json", json.dumps([
            {"wavelength": nm, "reflectance": r} for nm, r in zip(NM.tolist(), R.tolist(), strict=True)])),
    ),
}  # fmt: skip


@pytest.mark.parametrize(
    ("steps", "noise"), [((1.5, 3.7, 2.6), 0.0), ((1.5, 3.7, 2.6), 0.0005), ((5.0, 10.0, 10.0), 0.0005)]
)
@pytest.mark.parametrize("common", [2, 3, 6])
def test_three_detectors_with_few_channels_in_common_are_joined(
    steps: tuple[float, float, float], noise: float, common: int
) -> None:
    """Rows in the order of wavelengths, as of field spectrometers with three detectors (Hueni & Bialek 2017)."""
    low = np.arange(400, 1000 + 1e-9, steps[0])
    middle = np.arange(low[-common] - 0.4 * steps[0], 1900, steps[1])
    high = np.arange(middle[-common] - 0.4 * steps[1], 2500, steps[2])
    nm = np.concatenate([low, middle, high])
    level = np.concatenate([1.05 * rock(low), 0.97 * rock(middle), rock(high)])
    level = level * (1 + noise * np.random.default_rng(1).normal(size=nm.size))
    order = np.argsort(nm)
    table = "wavelength_nm,rock\n" + rows(nm[order], level[order], gap=",")
    [spectrum] = quietly(lambda: list(read_spectra(InputFile("a.csv", table.encode()))))
    off = spectrum.reflectance / rock(spectrum.wavelength_nm) - 1
    assert np.abs(off).max() < 0.001 + 8 * noise
    assert len(spectrum.metadata["read_as"]) == 2


def is_rock(spectrum: Spectrum, made: Written) -> bool:
    good = spectrum.usable
    off = np.abs(spectrum.reflectance / made.scale / rock(spectrum.wavelength_nm) - 1.0)[good].max()
    return bool(off < made.tolerance) and int((~good).sum()) in (0, made.missing)


def quietly(job: Callable[[], object]) -> object:
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", LunarSciWarning)
        return job()


@pytest.mark.parametrize("kind", KINDS)
def test_the_rock_is_read(kind: str, tmp_path: Path) -> None:
    made = KINDS[kind]
    for name, content in made.files.items():
        (tmp_path / name).write_bytes(content if isinstance(content, bytes) else content.encode())
    path = tmp_path / next(iter(made.files))
    spectra = list(quietly(lambda: read_spectra(str(path), **made.options)))
    assert len(spectra) == made.count and all(is_rock(spectrum, made) for spectrum in spectra)
    for spectrum in spectra:
        assert (spectrum.uncertainty is None) == (made.sigma is None)
        if made.sigma is not None and spectrum.uncertainty is not None:
            np.testing.assert_allclose(spectrum.uncertainty[spectrum.usable], made.sigma, rtol=1e-4)
    found = info(path)
    assert (found.kind, found.trouble) == ("spectra", "")
    answer = quietly(lambda: lunarsci.bands(str(path)).to_dict()["spectra"])
    truth = expected()
    for one in answer:
        for band in ("bc1000_nm", "bc2000_nm"):
            assert abs(one[band] - truth[band]) < 3


@cache
def expected() -> dict[str, float]:
    """The bands of the rock as an array."""
    [found] = lunarsci.bands(NM, R).to_dict()["spectra"]
    return dict(found)
