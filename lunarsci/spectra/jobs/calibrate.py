"""VNIS radiance to reflectance factor: what can be asked, and the spectra of many observations."""

from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from lunarsci.constants import PAPER
from lunarsci.errors import BatchError, DataError, Failure, NoFilesError, ParameterError
from lunarsci.io.inputs import InputFile, expand_inputs, read_input
from lunarsci.io.tables import table_hashes
from lunarsci.options import request_of
from lunarsci.result import Doubt, MadeFrom, Progress, Result, job
from lunarsci.spectra.jobs.requests import CalibrateRequest
from lunarsci.spectra.photometry import PHASE_FUNCTIONS, phase_function, read_phase_function
from lunarsci.spectra.readers.solar_table import read_solar_spectrum
from lunarsci.spectra.solar import SOLAR_SPECTRA, solar_spectrum
from lunarsci.spectra.spectrum import Spectrum
from lunarsci.spectra.vnis.calibrate import calibrate_files
from lunarsci.spectra.vnis.calibration import Calibration, CalibrationFailure, calibration_pages, to_ecsv, to_fits
from lunarsci.spectra.vnis.detector import Settings, read_channel_factors
from lunarsci.spectra.vnis.label import product_name
from lunarsci.spectra.vnis.observation import one_per_observation

if TYPE_CHECKING:
    from matplotlib.figure import Figure


MOST_IN_FITS = 55
"""A FITS table has 999 columns at most; an observation takes up to 18."""
INSTRUMENT = "Li et al. (2019), Rev. Sci. Instrum. 90, 103106, 10.1063/1.5089737"
Products = str | Path | Sequence[str | Path]


def settings_of(request: CalibrateRequest) -> Settings:
    """With the tables read. Raises DataError for one that cannot be used, ParameterError for a value."""
    inputs: dict[str, str] = {}

    def table(given: Any, named: Any, read: Callable[[InputFile], Any], names: Collection[str]) -> Any:
        if isinstance(given, str) and given in names:
            return named(given)
        file = read_input(given)
        inputs[file.name] = file.sha256
        return read(file)

    solar = table(request.solar, solar_spectrum, read_solar_spectrum, SOLAR_SPECTRA)
    return Settings(
        solar=solar,
        other_solar=solar_spectrum("g173" if solar is solar_spectrum("e490") else "e490"),
        photometry=request.photometry,
        phase=table(request.phase, phase_function, read_phase_function, PHASE_FUNCTIONS),
        shadow_limit=request.shadow,
        remove_vnir_steps=request.vnir_steps == "remove",
        factors=None if request.calibration is None else table(request.calibration, None, read_channel_factors, ()),
        inputs=inputs,
    )


@dataclass(frozen=True, slots=True)
class Calibrations(Result):
    """Calibrated observations, one at least, and those that gave no spectrum, with what was used for all."""

    observations: Sequence[Calibration]
    failed: Sequence[CalibrationFailure]
    settings: Settings
    schema = "spectra-calibrate/1"

    @property
    def spectra(self) -> list[Spectrum]:
        """The spectra for the other jobs."""
        return [item.to_spectrum() for item in self.observations]

    @property
    def made_from(self) -> MadeFrom:
        phase = [self.settings.phase.source] if self.settings.photometry != "none" else []
        return MadeFrom(
            inputs={path: digest for item in self.observations for path, digest in item.inputs.items()},
            tables=table_hashes(*self.settings.tables),
            sources=[PAPER, INSTRUMENT, self.settings.solar.source, *phase],
        )

    @property
    def doubt(self) -> Doubt:
        """The first doubt, and how many observations have any."""
        doubtful = [item for item in self.observations if item.doubts]
        if not doubtful:
            return Doubt()
        more = f" (and {len(doubtful) - 1} more observations)" if len(doubtful) > 1 else ""
        return Doubt.of(f"{doubtful[0].id}: {doubtful[0].doubts[0]}{more}")

    @property
    def failures(self) -> Sequence[Failure]:
        return [Failure.of(item.id, item.status) for item in self.failed]

    def to_dict(self) -> dict[str, Any]:
        return {"spectra": [item.to_dict() for item in self.observations]}

    def rows(self) -> list[dict[str, Any]]:
        """One a channel."""
        return [row for item in self.observations for row in item.rows()]

    def figures(self) -> "Iterator[Figure]":
        return calibration_pages(self.observations)

    def to_ecsv(self, provenance: Mapping[str, Any]) -> bytes:
        """As `lunarsci.spectra.vnis.calibration.to_ecsv`."""
        return to_ecsv(self.observations, provenance)

    def to_fits(self, provenance: Mapping[str, Any]) -> bytes:
        """As `lunarsci.spectra.vnis.calibration.to_fits`."""
        return to_fits(self.observations, provenance)


@job
def calibrate(
    products: Products,
    request: CalibrateRequest | None = None,
    *,
    progress: Progress | None = None,
    **options: Any,
) -> Calibrations:
    """Calibrate VNIS observations: one file of each, folders of them, or patterns.

    Raises DataError when nothing could be calibrated, or a table of the request cannot be used.

    Examples
    --------
    >>> figure = lunarsci.calibrate("scene", photometry="akimov").plot()
    """
    settings = settings_of(request_of(CalibrateRequest, request, options))
    paths, failures = _observations(products)
    results = calibrate_files(paths, settings, progress)
    good = [item for item in results if isinstance(item, Calibration)]
    failed = [
        *(CalibrationFailure(name, str(why)) for name, why in failures),
        *(item for item in results if isinstance(item, CalibrationFailure)),
    ]
    if not good:
        reasons = dict(failures)
        raise BatchError.of([Failure.of(item.id, reasons.get(item.id, item.status)) for item in failed])
    return Calibrations(good, failed, settings)


def check_fits(path: Path | None, products: Products) -> None:
    """Raise ParameterError, before the work, where a FITS table would need more columns than the format has."""
    if (
        path is not None
        and path.suffix.lower() == ".fits"
        and (count := len(_observations(products)[0])) > MOST_IN_FITS
    ):
        raise ParameterError(f"{path}: a FITS table holds {MOST_IN_FITS} observations, here are {count}; use .ecsv")


def _observations(products: Products) -> tuple[list[str], list[tuple[str, DataError]]]:
    """One file of each observation, and the arguments that name none, with the reason."""
    result: list[str] = []
    failures: list[tuple[str, DataError]] = []
    for argument in [products] if isinstance(products, str | Path) else products:
        try:
            result += _products(str(argument))
        except DataError as error:
            failures.append((str(argument), error))
    return one_per_observation(result), failures


def _products(argument: str) -> list[str]:
    """The VNIS products of a folder or pattern; a file's own name whatever it is, since reading it tells."""
    if argument == "-":
        raise DataError("-: a product is several files and cannot come from stdin; name its label")
    names = expand_inputs([argument], all_files=True)
    if names == [argument]:
        return names
    products = [name for name in names if product_name(name)]
    if not products:
        raise NoFilesError(f"{argument}: no VNIS product in it (CE4_GRAS_VNIS-....2BL and .2B); check the folder")
    return products
