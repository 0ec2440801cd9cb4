"""The 1 and 2 um absorption bands of many spectra, and the composition that published regressions make of them."""

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import TYPE_CHECKING, Any

from lunarsci.arrays import spans
from lunarsci.constants import PAPER, SMOOTHING
from lunarsci.errors import Failure
from lunarsci.io.records import BLOCK_THINGS, Records, RecordsInBlocks, Where, in_blocks
from lunarsci.io.tables import table_hashes
from lunarsci.names import some_of
from lunarsci.options import request_of
from lunarsci.result import Doubt, MadeFrom, Result, job
from lunarsci.spectra.band_status import BANDS, CODE, NO_PYROXENE, STATUS
from lunarsci.spectra.bands import BandsOfSpectra, SpectrumBands, measure_batch
from lunarsci.spectra.chemistry.bands import KEYS, chemistries, plane_pages
from lunarsci.spectra.chemistry.bands import TABLE as CHONDRITES
from lunarsci.spectra.chemistry.plane import PLANE_TABLE, TABLE, Estimates
from lunarsci.spectra.collection import Picked
from lunarsci.spectra.jobs.requests import BandsRequest
from lunarsci.spectra.readers.batch import SpectraBatch, SpectraSource, read_batch
from lunarsci.spectra.spectrum import Smoothing

if TYPE_CHECKING:
    from matplotlib.figure import Figure


MOST_NAMED = 5
"""Spectra that one sentence names."""
REGRESSIONS = {
    "gaffey-2002": "Gaffey et al. (2002), Asteroids III, 183 (Fs, Wo)",
    "burbine-2007": "Burbine et al. (2009), Meteorit. Planet. Sci. 44, 1331, 10.1111/j.1945-5100.2009.tb01225.x (HED)",
    "dunn-2010": "Dunn et al. (2010), Icarus 208, 789, 10.1016/j.icarus.2010.02.016 (chondrites)",
    "chondrite-bands": "Korda et al. (2023), Astron. Astrophys. 669, A101, 10.1051/0004-6361/202243886 (chondrites)",
    "cloutis-1986": "Cloutis et al. (1986), J. Geophys. Res. 91, 11641, 10.1029/JB091iB11p11641 (area ratio)",
    "opx-band-trend": "Klima et al. (2007), Meteorit. Planet. Sci. 42, 235, 10.1111/j.1945-5100.2007.tb00230.x (opx)",
    "olivine-bc1000": "King & Ridley (1987), J. Geophys. Res. 92, 11457, 10.1029/JB092iB11p11457 (the trend)",
}
"""What to cite where a regression may be used, by its entry of `sources.toml`."""
CHEMISTRY = (
    "Sanchez et al. (2012), Icarus 220, 36, 10.1016/j.icarus.2012.04.008 (temperature)",
    "Adams (1974), J. Geophys. Res. 79, 4829, 10.1029/JB079i032p04829 (the plane of the centres)",
)
"""The same wherever bands are measured."""
SHORT = {
    "fs": "Fs",
    "wo": "Wo",
    "en": "En",
    "fo": "Fo",
    "fa": "Fa",
    "ol_share": "olivine share",
    "opx_share": "opx share",
}
"""What tables call a quantity of the chemistry."""
METHODS = {
    "gaffey": "Gaffey 2002",
    "burbine": "Burbine 2009",
    "trend": "synthetic opx",
    "dunn": "Dunn 2010",
    "chondrite": "recalibrated",
    "cloutis": "Cloutis 1986",
    "bc1000": "1 µm centre",
}
"""What they call a regression, by a part of its key."""


def regression(key: str) -> str:
    """The name of a regression.

    >>> regression("fs_burbine_bc2000"), regression("fo_bc1000")
    ('Burbine 2009, 2 µm', '1 µm centre')
    """
    name = next(text for part, text in METHODS.items() if part in key)
    band = "" if name == METHODS["bc1000"] else ", 1 µm" if "bc1000" in key else ", 2 µm" if "bc2000" in key else ""
    return name + band


@dataclass(frozen=True, eq=False)
class MeasuredBands(Result):
    """The bands of each spectrum, one at least, and why those without have none."""

    batch: SpectraBatch
    measured: BandsOfSpectra
    failures: Sequence[Failure] = ()
    schema = "spectra-bands/1"

    @cached_property
    def chemistry(self) -> Mapping[str, Estimates]:
        """What each regression makes of the bands."""
        return chemistries(self.measured.arrays.bands)

    @property
    def made_from(self) -> MadeFrom:
        tables = self.batch.tables | table_hashes(TABLE, PLANE_TABLE, CHONDRITES)
        sources = [PAPER, SMOOTHING, *self._regressions, *CHEMISTRY]
        return MadeFrom(inputs=self.batch.inputs, tables=tables, sources=sources)

    @cached_property
    def _regressions(self) -> list[str]:
        """The sources of those that some spectrum can use."""
        used = {str(one["source"]) for one in self.examples(KEYS).values()}
        return [text for source, text in REGRESSIONS.items() if source in used]

    @property
    def good(self) -> Sequence[SpectrumBands]:
        """Those with a result, each made when it is asked for."""
        return Picked(self.measured, [k for k in range(len(self.measured)) if k not in self.measured.reasons])

    @property
    def doubt(self) -> Doubt:
        narrow = self.measured.arrays.codes[:, -1, CODE.status] == STATUS.too_narrow
        named = some_of([self.batch.spectra.ids[place] for place in narrow.nonzero()[0]], MOST_NAMED)
        return Doubt.of(
            f"a narrow absorption is what there is at 2 µm in {named}, {NO_PYROXENE}" if narrow.any() else ""
        )

    def to_dict(self) -> dict[str, Any]:
        return self.batch.remarks | {"spectra": self.content()["spectra"].tolist()}

    def content(self) -> Mapping[str, Any]:
        return {**self.batch.remarks, "spectra": in_blocks(len(self.measured), self._records)}

    def rows(self) -> Records | RecordsInBlocks:
        """One a spectrum; value, error and range of each regression in columns of their own."""
        return in_blocks(len(self.measured), self._rows)

    def _part(self, block: range) -> "MeasuredBands":
        """Of some of the spectra, next to each other."""
        if len(block) == len(self.measured):
            return self
        subset = slice(block.start, block.stop)
        batch = replace(self.batch, spectra=self.batch.spectra[subset], origins=self.batch.origins[subset])
        return MeasuredBands(batch, self.measured.part(block), self.failures)

    def _records(self, block: range) -> Records:
        subset = self._part(block)
        result = subset.chemistry
        shown = {key: Where(result[key].present, result[key].columns()) if key in result else None for key in KEYS}
        return Records(subset.measured.columns() | {"chemistry": shown, "source": subset.batch.origins})

    def _rows(self, block: range) -> Records:
        subset = self._part(block)
        columns = subset.measured.columns() | {"source": subset.batch.origins}
        for key in KEYS:
            item = subset.chemistry.get(key)
            columns[key] = Where(item.present, item.value) if item else None
            columns[f"{key}_sigma"] = Where(item.present, item.sigma) if item else None
            columns[f"{key}_in_range"] = Where(item.present, item.in_range) if item else None
        return Records(columns)

    def remarks(self) -> list[tuple[int, str, str, str]]:
        """Place and id of the spectrum, key of the band and sentence of every note and status that is not `ok`."""
        names = self.batch.spectra.ids
        return [
            (place, names[place], band.key, text)
            for number, band in enumerate(BANDS)
            for which in (CODE.note, CODE.status)
            for place, text in enumerate(self.measured.texts(number, which))
            if text not in ("", "ok")
        ]

    def examples(self, keys: Sequence[str]) -> dict[str, Mapping[str, Any]]:
        """Of each of these regressions that some spectrum can use, what it says of the first."""
        result: dict[str, Mapping[str, Any]] = {}
        for block in spans(len(self.measured), BLOCK_THINGS):
            here = self._part(block).chemistry
            firsts = {key: here[key].first_usable for key in keys if key in here and key not in result}
            result |= {key: here[key].of(row).to_dict() for key, row in firsts.items() if row is not None}
            if len(result) == len(keys):
                break
        return {key: result[key] for key in keys if key in result}

    def figures(self) -> "Iterator[Figure]":
        from lunarsci.spectra.mgm.figure import band_pages

        return band_pages(self.good)

    def plane(self) -> "Iterator[Figure]":
        """The 2 um centres over the 1 um centres, among those of pyroxenes."""
        return plane_pages(self.good)


@job
def bands(
    spectra: "SpectraSource",
    request: BandsRequest | None = None,
    *,
    progress: Callable[[int, int], None] | None = None,
    **options: Any,
) -> MeasuredBands:
    """Measure the bands of spectra: centres in nm, depths and areas, with errors.

    Parameters
    ----------
    spectra : files, patterns, tables, `Spectrum`s or (wavelength_nm (n,), reflectance (n,) or (spectra, n)[, sigma]),
        one or a list; reflectance and its standard deviation sigma are fractions of 1.
    request, options : options as below, and a `BandsRequest` whose own they replace.
    progress : called with (done, total) spectra.

    Raises RequestError for impossible options; DataError when no spectrum can be read, or none has a result.

    Examples
    --------
    >>> bands = lunarsci.bands("lunarsci-demo/rock.ecsv", continuum="hull")
    >>> [center_nm] = bands.to_table()["bc1000_nm"]
    """
    asked = request_of(BandsRequest, request, options)
    smoothing = Smoothing(window_nm=asked.smooth_nm, order=asked.smooth_order, channels=asked.smooth)
    batch = read_batch(spectra, asked.wavelength_unit, asked.reflectance_unit, asked.id)
    measured = measure_batch(
        batch.spectra,
        continuum_name=asked.continuum,
        smoothing=smoothing,
        progress=progress,
    )
    reasons = {place: f"no result: {reason}" for place, reason in measured.uncovered.items()}
    return MeasuredBands(batch, measured, batch.failures_among(reasons))
