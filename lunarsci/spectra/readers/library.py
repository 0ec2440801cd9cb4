"""End members, each the spectrum of one mineral with what is known of the sample, and libraries of them as files.

A library is an ECSV table of spectra like any other (`wavelength_nm`, then one column per end member, empty where it
has no channel), so every command reads it; `end_members` in its header holds mineral, chemistry, grain size and source
by id.
"""

import io
import math
import warnings
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

import numpy as np

from lunarsci.arrays import FloatArray
from lunarsci.errors import DataError, LunarSciWarning
from lunarsci.figure import LINE_STYLES, as_label, page
from lunarsci.io.inputs import InputFile
from lunarsci.minerals import ABBREVIATIONS, CHEMISTRY, COMPONENTS, CONSTITUENTS, MINERALS, WORDS
from lunarsci.provenance import plain
from lunarsci.spectra.readers.columns import assign_roles, rows_by_id
from lunarsci.spectra.readers.dispatch import read_spectra
from lunarsci.spectra.readers.table import ReflectanceUnit, WavelengthUnit
from lunarsci.spectra.rows import number, quoted
from lunarsci.spectra.spectrum import WIDEST_GAP_NM, Spectrum, channel_arrays

if TYPE_CHECKING:
    from matplotlib.figure import Figure


def mineral_named(name: str, where: str = "") -> str | None:
    """One of `CONSTITUENTS` by its name or usual abbreviation, None for a blank. Raises DataError for any other."""
    word = name.strip().casefold()
    if not word:
        return None
    if word not in WORDS:
        raise DataError(f"{where}mineral {name!r} is not known; use one of {', '.join(CONSTITUENTS)}")
    return WORDS[word]


@dataclass(frozen=True, slots=True, eq=False)
class EndMember:
    """The reflectance spectrum of one mineral, channels without a measurement left out.

    Attributes
    ----------
    id : name of the spectrum, not empty.
    mineral : one of `CONSTITUENTS` (`lunarsci/minerals.py`); None where nobody said.
    wavelength_nm : shape (n,), n >= 1, finite, above 0, strictly ascending. [nm]
    reflectance : shape (n,), finite, fraction of 1; what is not above 0 or above 1 is for `check_library` to find. [-]
    fo, fs, en, wo, an : forsterite, ferrosilite, enstatite, wollastonite, anorthite; mole fraction 0 to 1, or None. [-]
    min_um, max_um : grain sizes, 0 or more, min_um <= max_um, or None. [um]
    source : where the spectrum comes from.
    specimen : the rock or crystal that it was made of; powders of one are siblings, "" for one without any.

    Raises
    ------
    DataError when a rule above is broken; the message begins with the id.
    """

    id: str
    mineral: str | None
    wavelength_nm: FloatArray
    reflectance: FloatArray
    fo: float | None = None
    fs: float | None = None
    en: float | None = None
    wo: float | None = None
    an: float | None = None
    min_um: float | None = None
    max_um: float | None = None
    source: str = ""
    specimen: str = ""

    def __post_init__(self) -> None:
        if not self.id.strip() or (self.mineral is not None and self.mineral not in CONSTITUENTS):
            what = f"mineral {self.mineral!r}, or an empty id; minerals are {', '.join(CONSTITUENTS)}"
            raise DataError(f"{self.id}: {what}")
        wavelength, reflectance = channel_arrays(self.id, self.wavelength_nm, self.reflectance)
        if not np.isfinite(reflectance).all():
            raise DataError(f"{self.id}: a reflectance is not finite; leave that channel out")
        object.__setattr__(self, "wavelength_nm", wavelength)
        object.__setattr__(self, "reflectance", reflectance)
        self._check_sample()

    def _check_sample(self) -> None:
        for names, least, most, what in (
            (COMPONENTS, 0.0, 1.0, "no mole fraction; give 0 to 1, not per cent"),
            (("min_um",), 0.0, 1e9, "no grain size; give um, 0 or more"),
            (("max_um",), self.min_um or 0.0, 1e9, f"no grain size from {self.min_um or 0.0:g} um on; give um"),
        ):
            for name in names:
                value = getattr(self, name)
                if value is not None and not least <= value <= most:
                    raise DataError(f"{self.id}: {name} = {value:g} is {what}")

    def sample(self) -> dict[str, Any]:
        """Everything but the id and the spectrum, as plain values."""
        names = ("mineral", *COMPONENTS, "min_um", "max_um", "source")
        result = {name: getattr(self, name) for name in names}
        return result | ({"specimen": self.specimen} if self.specimen else {})


FORMAT = "lunarsci-library/1"
_NUMBERS = (*COMPONENTS, "min_um", "max_um")


def read_library(
    source: InputFile,
    *,
    wavelength_unit: WavelengthUnit | None = None,
    reflectance_unit: ReflectanceUnit | None = None,
) -> list[EndMember]:
    """Read the end members of a library, in file order; of any other file of spectra, without what describes them.

    Spectra without a reflectance in any channel are left out, which the reader's LunarSciWarning says. The units are
    those of `read_spectra`. Raises DataError, one line with the file, when the file or an entry of its header cannot be
    used. Whether the spectra are fit for use is another question: `check_library` answers it.
    """
    spectra = read_spectra(source, wavelength_unit=wavelength_unit, reflectance_unit=reflectance_unit)
    measured = [spectrum for spectrum in spectra if np.isfinite(spectrum.reflectance).any()]
    return [_member(spectrum, source.name) for spectrum in measured]


def _member(spectrum: Spectrum, file: str) -> EndMember:
    header = spectrum.metadata.get("header")
    described = header.get("end_members", {}) if isinstance(header, Mapping) else {}
    if not isinstance(described, Mapping):
        raise DataError(f"{file}: 'end_members' in the header is no mapping; write the library again")
    column = str(spectrum.metadata.get("column", ""))
    id = column if column in described else spectrum.id
    return _in_file(spectrum, id, described.get(column, {}), file)


def _in_file(spectrum: Spectrum, id: str, sample: Any, file: str) -> EndMember:
    try:
        return end_member(spectrum, sample, id=id)
    except DataError as error:
        raise DataError(f"{file}: {error}") from error


def end_member(spectrum: Spectrum, sample: Any, *, id: str | None = None) -> EndMember:
    """An end member from a spectrum, its channels with a reflectance, and the fields of `EndMember` by name.

    Fields that are left out or None are unknown. Raises DataError for a value that is none, or a spectrum without any.
    """
    name = id or spectrum.id
    measured = np.isfinite(spectrum.reflectance)
    if not isinstance(sample, Mapping):
        raise DataError(f"{name}: its description is no mapping of names to values; write the library again")
    if not measured.any():
        raise DataError(f"{name}: has no reflectance in any channel; delete it")
    mineral = mineral_named(str(sample.get("mineral") or ""), f"{name}: ")
    notes: dict[str, Any] = {key: _number(sample.get(key), f"{name}: {key}") for key in _NUMBERS}
    notes |= {key: str(sample.get(key) or "") for key in ("source", "specimen")}
    return EndMember(name, mineral, spectrum.wavelength_nm[measured], spectrum.reflectance[measured], **notes)


def _number(value: Any, what: str) -> float | None:
    if value is None or value == "":
        return None
    try:
        return float(value)
    except (TypeError, ValueError) as error:
        raise DataError(f"{what} is {str(value)[:40]!r}, no number; correct it or leave it out") from error


def to_ecsv(members: Sequence[EndMember], provenance: Mapping[str, Any] | None = None) -> bytes:
    """The library as an ECSV file; `provenance` goes into its header.

    Raises DataError for no end members, for two of one id, and for an id that would be read as something else.
    """
    from astropy.table import MaskedColumn, Table

    _check_ids([member.id for member in members])
    grid: FloatArray = np.unique(np.concatenate([member.wavelength_nm for member in members]))
    table = Table({"wavelength_nm": grid})
    table["wavelength_nm"].unit = "nm"
    for member in members:
        values = np.full(grid.size, np.nan)
        values[np.searchsorted(grid, member.wavelength_nm)] = member.reflectance
        table[member.id] = MaskedColumn(values, mask=np.isnan(values), unit="")
    described = {member.id: plain(member.sample()) for member in members}
    table.meta.update({"format": FORMAT, "end_members": described})
    if provenance is not None:
        table.meta["provenance"] = plain(provenance)
    buffer = io.StringIO()
    table.write(buffer, format="ascii.ecsv")
    return buffer.getvalue().encode()


def _check_ids(ids: Sequence[str]) -> None:
    """Raises DataError for ids that come twice or that a reader of the library would take for another column."""
    twice = next((id for id in ids if ids.count(id) > 1), "")
    if twice or not ids:
        what = f"{twice}: two end members have this id; rename one" if ids else "no end member is left for the library"
        raise DataError(what)
    for id in ids:
        with warnings.catch_warnings():
            warnings.simplefilter("error", LunarSciWarning)
            try:
                roles = assign_roles(["wavelength_nm", id, f"not {id}"], InputFile("library", b""))
                fits = [place for place, _ in roles.spectra] == [1, 2]
            except (DataError, LunarSciWarning):
                fits = False
        if not fits:
            raise DataError(f"{id!r}: this id would be read as a column of another kind; rename the spectrum")


MOST_NAMES = 12


def library_pages(members: Sequence[EndMember]) -> "Iterator[Figure]":
    """One page; colour runs with the first component of the chemistry, grey where unknown; at most 12 are named."""
    groups = {mineral: [m for m in members if m.mineral == mineral] for mineral in (*CONSTITUENTS, None)}
    groups = {mineral: group for mineral, group in groups.items() if group}
    columns = min(2, len(groups))
    rows = -(-len(groups) // columns)
    named = max((len(group) for group in groups.values() if len(group) <= MOST_NAMES), default=0)
    below = 0.16 * (-(-named // 2) if named > 3 else named)
    figure = page((2.7 + below) * rows if columns > 1 else 4.2 + below)
    panels = figure.subplots(rows, columns, squeeze=False).ravel()
    for panel, (mineral, group) in zip(panels, groups.items(), strict=False):
        _draw(panel, mineral, group)
    for panel in panels[len(groups) :]:
        panel.set_visible(False)
    yield figure


def _draw(panel: Any, mineral: str | None, group: Sequence[EndMember]) -> None:
    """The spectra of one mineral, or of those without one, in a panel."""
    from matplotlib import colormaps

    key = CHEMISTRY.get(mineral or "", ("",))[0]
    shares: list[float | None] = [getattr(member, key) if key else None for member in group]
    order = sorted(range(len(group)), key=lambda k: (shares[k] is None, shares[k] or 0.0))
    for place, (member, share) in enumerate((group[k], shares[k]) for k in order):
        # Dashes and widths tell in grey what one colour does not.
        color = "0.4" if share is None else colormaps["viridis"](0.9 * share)
        share_text = "" if share is None else f", {key.capitalize()} {100 * share:.0f}"
        dashes = LINE_STYLES[place % len(LINE_STYLES)]["linestyle"] if len(group) <= MOST_NAMES else "-"
        width = 1.0 + 0.8 * (place // len(LINE_STYLES) % 2) if len(group) <= MOST_NAMES else 0.8
        look: Any = {"linestyle": dashes, "linewidth": width, "label": f"{as_label(member.id, 24)}{share_text}"}
        panel.plot(member.wavelength_nm, member.reflectance, color=color, **look)
    by = f", dark to bright by {key.capitalize()}" if any(share is not None for share in shares) else ""
    panel.set_title(f"{mineral or 'mineral not stated'}: {len(group)}{by}")
    panel.set_xlabel("wavelength [nm]")
    panel.set_ylabel("reflectance [-]")
    top = max(float(np.max(member.reflectance)) for member in group)
    panel.set_ylim(0, 1.05 * min(max(top, 0.05), 1.5))
    if len(group) <= MOST_NAMES:
        panel.legend(loc="upper center", bbox_to_anchor=(0.5, -0.17), frameon=False, ncols=2 if len(group) > 3 else 1)


MIXTURE = "mixture"
"""What stands for the mineral of a sample that is none."""
PURE = 0.95
"""Share of the volume from which a sample is taken as an end member of its mineral; assumed."""


def read_metadata(source: InputFile) -> dict[str, dict[str, Any]]:
    """Description of each id, for `end_member`; `mineral` is `MIXTURE` where no mode reaches `PURE`.

    Chemistry that the mineral does not have is left out: tables often fill it with zeros. Raises DataError for a table
    without ids, an id that comes twice, or a cell that is no number.
    """
    return {id: _description(row, f"{source.name}: line {line}") for id, (line, row) in rows_by_id(source).items()}


def _description(row: Mapping[str, str], place: str) -> dict[str, Any]:
    """What a row of metadata says of a sample, as `end_member` takes it."""
    mineral = _mineral(row, place)
    prefix = f"{ABBREVIATIONS.get(mineral or '', '')}_".lower()
    wanted = CHEMISTRY.get(mineral, ()) if mineral else COMPONENTS
    result: dict[str, Any] = {"mineral": mineral, "source": row.get("source", "")}
    for key in _NUMBERS:
        if key in wanted or key.endswith("_um"):
            cell = row.get(prefix + key) or row.get(key, "")
            result[key] = _value(cell, f"{place}, column {key}")
    if not result["max_um"]:  # no grain is 0 um: such tables mean that nobody knows
        result["min_um"] = result["max_um"] = None
    return result


def _mineral(row: Mapping[str, str], place: str) -> str | None:
    """The mineral that a row states, or that makes up `PURE` of it; `MIXTURE`, or None where nothing says."""
    stated = row.get("mineral", "")
    if stated.casefold() == MIXTURE:
        return MIXTURE
    if stated:
        return mineral_named(stated, f"{place}: ")
    columns = {f"vol_{key.lower()}": mineral for key, mineral in MINERALS.items()}
    modes = {
        mineral: _value(row[key], f"{place}, column {key}") or 0.0 for key, mineral in columns.items() if key in row
    }
    total = sum(modes.values())
    if not modes or total <= 0:
        return None
    mineral = max(modes, key=lambda name: modes[name])
    return mineral if modes[mineral] >= PURE * total else MIXTURE


def _value(cell: str, place: str) -> float | None:
    value = number(cell)
    if value is None or math.isinf(value):
        raise DataError(f"{place}: {quoted(cell)} is not a number; correct it, or leave it blank if unknown")
    return None if math.isnan(value) else value


def with_description(member: EndMember, notes: Mapping[str, Any]) -> EndMember:
    """The end member with what a table says of it; what it leaves open stays. Raises DataError as `EndMember` does."""
    stated = {key: value for key, value in notes.items() if value not in (None, "")}
    if stated.get("mineral") not in (None, member.mineral):
        # The chemistry of another mineral would contradict it.
        member = replace(member, fo=None, fs=None, en=None, wo=None, an=None)
    return replace(member, **stated)


FEWEST_CHANNELS = 20
"""As many as it takes to measure a band (`lunarsci.spectra.bands`)."""
HIGHEST = 1.2
"""Reflectance factors of bright powders exceed 1, hardly this; assumed."""
SUM_TOLERANCE = 0.02
"""Fs + En + Wo, or shares that are stated, may differ from 1 by this: analyses leave out Mn, Na, Al; assumed."""
NEEDED_NM = (750.0, 2300.0)
"""What a spectrum must reach over to be mixed, from one side of the 1 um band to the 2 um band; assumed."""


@dataclass(frozen=True, slots=True)
class LibraryFinding:
    """One thing found in one end member.

    `must_mend` is False where the spectrum can be used but with less than one might expect; `text` says what and where.
    """

    must_mend: bool
    text: str


def check_library(members: Sequence[EndMember]) -> list[tuple[LibraryFinding, ...]]:
    """What is found in each end member, in their order; first what must be mended."""
    counts = Counter(member.id for member in members)
    return [
        (
            *(LibraryFinding(True, text) for text in _duplicates(counts[member.id])),
            *(LibraryFinding(True, text) for text in _faults(member)),
            *(LibraryFinding(False, text) for text in _remarks(member)),
        )
        for member in members
    ]


def _duplicates(count: int) -> list[str]:
    return [f"{count} end members have this id; rename all but one"] if count > 1 else []


def _faults(member: EndMember) -> list[str]:
    """What must be mended in an end member."""
    texts = []
    size = member.wavelength_nm.size
    if size < FEWEST_CHANNELS:
        texts.append(f"{size} channels; {FEWEST_CHANNELS} are needed")
    outside = ~((member.reflectance > 0) & (member.reflectance < HIGHEST))
    if outside.any():
        first = int(np.flatnonzero(outside)[0])
        texts.append(
            f"{outside.sum()} channels not between 0 and {HIGHEST:g}, first {member.reflectance[first]:.4g} at "
            f"{member.wavelength_nm[first]:.6g} nm; delete them, or correct the unit"
        )
    if member.mineral is None:
        texts.append("no mineral; import it again with --mineral or --metadata")
        return texts
    return texts + _chemistry_faults(member)


def _chemistry_faults(member: EndMember) -> list[str]:
    """Components that its mineral does not have, and such as do not add up."""
    wanted = CHEMISTRY.get(member.mineral or "", ())
    texts = [
        f"{key} = {getattr(member, key):g} in a mineral without it ({member.mineral}); delete it"
        for key in COMPONENTS
        if key not in wanted and getattr(member, key) is not None
    ]
    if "fs" in wanted:
        parts = [getattr(member, key) for key in ("fs", "en", "wo")]
        stated = [part for part in parts if part is not None]
        if len(stated) == len(parts) and abs(sum(stated) - 1) > SUM_TOLERANCE:
            texts.append(f"fs + en + wo = {sum(stated):.3f}, not 1; correct the analysis")
        elif sum(stated) > 1 + SUM_TOLERANCE:
            texts.append(f"fs, en, wo, as far as known, add up to {sum(stated):.3f}, more than 1; correct the analysis")
    return texts


def _remarks(member: EndMember) -> list[str]:
    """What is less than one might expect of an end member."""
    wavelength = member.wavelength_nm
    texts = [f"no {key}" for key in CHEMISTRY.get(member.mineral or "", ()) if getattr(member, key) is None]
    texts = [f"{', '.join(texts)}: composition unknown"] if texts else []
    if wavelength[0] > NEEDED_NM[0] or wavelength[-1] < NEEDED_NM[1]:
        texts.append(
            f"covers {wavelength[0]:.6g}-{wavelength[-1]:.6g} nm, not all of {NEEDED_NM[0]:g}-{NEEDED_NM[1]:g} nm"
        )
    texts += [f"gap of {high - low:.4g} nm after {low:.6g} nm" for low, high in gaps(member)]
    if member.max_um is None:
        texts.append("grain size unknown")
    return texts


def gaps(member: EndMember) -> list[tuple[float, float]]:
    """Pairs of neighbouring channels that are too far apart. [nm]"""
    steps = np.diff(member.wavelength_nm)
    if steps.size < 2:
        return []
    wide = np.flatnonzero(steps > WIDEST_GAP_NM)
    return [(float(member.wavelength_nm[k]), float(member.wavelength_nm[k + 1])) for k in wide]
