"""From VNIS products to calibrated spectra, and from these to a `Report`."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from lunarsci.errors import DataError, ParameterError
from lunarsci.inputs import expand_inputs, read_input
from lunarsci.spectra.photometry import PHASE_FUNCTIONS, phase_function, read_phase_function
from lunarsci.spectra.readers.solar_table import read_solar_spectrum
from lunarsci.spectra.solar import SOLAR_SPECTRA, solar_spectrum
from lunarsci.spectra.vnis.calibration import Calibration, CalibrationFailure
from lunarsci.spectra.vnis.channels import SPLICED_NM
from lunarsci.spectra.vnis.detector import Settings, read_channel_factors
from lunarsci.spectra.vnis.name import product_name
from lunarsci.spectra.vnis.observation import one_per_observation
from lunarsci.tables import table_hashes

from ..shared.report import Report, together
from ..shared.table import TextTable, counted, plus_minus

__all__ = ["calibrate_report", "check_fits", "observations", "settings_from"]

MOST_IN_FITS = 55
"""A FITS table has 999 columns at most; an observation takes up to 18."""
SOURCES = [
    "Ding et al. (2024), Nat. Commun. 15, 2098, 10.1038/s41467-024-46233-8",
    "Li et al. (2019), Rev. Sci. Instrum. 90, 103106, 10.1063/1.5089737",
]


def settings_from(
    solar: str, disk: str, phase: str, shadow: float, vnir_steps: str, factors: str | None, radiance_per: str
) -> Settings:
    """Settings from the options: a name of an embedded table, or else a file. Raises DataError, ParameterError."""
    inputs: dict[str, str] = {}

    def opened(path: str) -> Any:
        source = read_input(path)
        inputs[source.name] = source.sha256
        return source

    irradiance = solar_spectrum(solar) if solar in SOLAR_SPECTRA else read_solar_spectrum(opened(solar))
    function = phase_function(phase) if phase in PHASE_FUNCTIONS else read_phase_function(opened(phase))
    return Settings(
        solar=irradiance,
        other_solar=solar_spectrum("g173" if solar == "e490" else "e490"),
        disk=None if disk == "none" else disk,
        phase=function,
        shadow_limit=shadow,
        radiance_unit=radiance_per,
        remove_vnir_steps=vnir_steps == "remove",
        factors=read_channel_factors(opened(factors)) if factors is not None else None,
        inputs=inputs,
    )


def observations(files: Sequence[str]) -> tuple[list[str], list[CalibrationFailure]]:
    """One file of each observation that the arguments name, and the arguments that name none."""
    found: list[str] = []
    failures: list[CalibrationFailure] = []
    for argument in files:
        try:
            found += _products(argument)
        except DataError as error:
            failures.append(CalibrationFailure(argument, str(error)))
    return one_per_observation(found), failures


def check_fits(path: Path | None, observations: int) -> None:
    """Raise ParameterError, before the work, where a FITS table would need more columns than the format has."""
    if path is not None and path.suffix.lower() == ".fits" and observations > MOST_IN_FITS:
        raise ParameterError(
            f"{path}: a FITS table holds {MOST_IN_FITS} observations, here are {observations}; use .ecsv"
        )


def _products(argument: str) -> list[str]:
    """The VNIS products of a folder or pattern; a file's own name whatever it is, since reading it tells."""
    if argument == "-":
        raise DataError("-: a product is several files and cannot come from stdin; name its label")
    names = expand_inputs([argument])
    if names == [argument]:
        return names
    products = [name for name in names if product_name(name)]
    if not products:
        raise DataError(f"{argument}: no VNIS product in it (CE4_GRAS_VNIS-....2BL and .2B); check the folder")
    return products


def calibrate_report(results: Sequence[Calibration | CalibrationFailure], settings: Settings) -> Report:
    """The report of `spectra calibrate`. Raises DataError when nothing could be calibrated."""
    good = [item for item in results if isinstance(item, Calibration)]
    failures = [item.status for item in results if isinstance(item, CalibrationFailure)]
    if not good:
        raise DataError(together(failures))

    def figures() -> Any:
        from lunarsci.spectra.vnis.figure import calibration_pages

        return calibration_pages(good)

    def ecsv(provenance: Mapping[str, Any]) -> bytes:
        from lunarsci.spectra.vnis.calibration import to_ecsv

        return to_ecsv(good, provenance)

    def fits(provenance: Mapping[str, Any]) -> bytes:
        from lunarsci.spectra.vnis.calibration import to_fits

        return to_fits(good, provenance)

    return Report(
        schema="spectra-calibrate/1",
        result={"spectra": [item.to_dict() for item in good]},
        tables=[_table(good)],
        rows=[row for item in good for row in _rows(item)],
        figures=figures,
        formats={".ecsv": ecsv, ".fits": fits},
        inputs={path: digest for item in good for path, digest in item.inputs.items()},
        data_tables=table_hashes(*settings.tables),
        sources=[*SOURCES, settings.solar.source, *([settings.phase.source] if settings.disk else [])],
        failures=failures,
    )


def _table(good: Sequence[Calibration]) -> TextTable:
    headers = [
        "observation", "i [deg]", "e [deg]", "g [deg]", "Sun [AU]", "lit pixels", "step", "gain", "R at 750 nm",
        "shared [%]", "masked",
    ]  # fmt: skip
    return TextTable(headers, [_row(item) for item in good], notes=_notes(good))


def _row(item: Calibration) -> list[str]:
    at = int((SPLICED_NM == 750.0).argmax())
    geometry = item.vnir.geometry
    level = item.reflectance[at]
    return [
        item.id,
        *(f"{angle:.2f}" for angle in (geometry.incidence_deg, geometry.emission_deg, geometry.phase_deg)),
        f"{item.vnir.distance_au:.6f}",
        f"{int(item.footprint.lit.sum())} of {int(item.footprint.inside.sum())}",
        plus_minus(item.splice.step.factor, item.splice.step.sigma, digits=4),
        plus_minus(item.splice.gain, item.splice.gain_sigma, digits=4),
        plus_minus(level, item.sigma[at], digits=4),
        plus_minus(100 * item.systematic_total[at] / level, digits=1),
        str(item.summary()["channels_masked"]),
    ]


def _notes(good: Sequence[Calibration]) -> list[str]:
    return counted([note for item in good for note in item.notes], len(good), "observations")


def _rows(item: Calibration) -> list[dict[str, Any]]:
    """One row per channel."""
    total = item.systematic_total
    return [
        {
            "id": item.id,
            "wavelength_nm": float(SPLICED_NM[k]),
            "reflectance": float(item.reflectance[k]),
            "reflectance_sigma": float(item.sigma[k]),
            "reflectance_systematic": float(total[k]),
            **{f"systematic_{name}": float(mode[k]) for name, mode in item.systematic.items()},
        }
        for k in range(SPLICED_NM.size)
    ]
