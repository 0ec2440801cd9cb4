"""Many spectra as arrays: those of a file, on the same wavelengths, and those of many files together."""

import hashlib
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any, NamedTuple, overload

import numpy as np

from lunarsci.arrays import BoolArray, FloatArray, IndexArray, IntArray, spans
from lunarsci.spectra.spectrum import Spectrum

_DIGESTED = 4096
"""Rows that are digested at a time."""


class Picked(Sequence[Any]):
    """Those of a sequence at some places, each made when it is asked for."""

    def __init__(self, whole: Sequence[Any], places: Sequence[int]) -> None:
        self.whole, self.places = whole, places

    def __len__(self) -> int:
        return len(self.places)

    def __getitem__(self, index: Any) -> Any:
        place = self.places[index]
        return Picked(self.whole, place) if isinstance(index, slice) else self.whole[place]


class AlikeSpectra(NamedTuple):
    """Arrays of n spectra with the same c usable channels and kinds of errors, in these channels.

    Attributes
    ----------
    wavelength_nm, reflectance : (c,) and (n, c). [nm, -]
    sigma : (n, c), or None where no errors are known. [-]
    shifts : (n, k, c) of the errors that all channels share. [-]
    """

    wavelength_nm: FloatArray
    reflectance: FloatArray
    sigma: FloatArray | None
    shifts: FloatArray


def alike_channels(usable: BoolArray) -> list[tuple[BoolArray, IndexArray]]:
    """Usable channels (n,), and the rows of (m, n) that have just these, in the order of the rows."""
    if usable.all():
        return [(usable[0], np.arange(len(usable)))] if len(usable) else []
    packed = np.packbits(usable, axis=1)
    keys = np.ascontiguousarray(packed).view(f"V{packed.shape[1]}").ravel()
    _, first, place = np.unique(keys, return_index=True, return_inverse=True)
    order = np.argsort(place, kind="stable")
    parts = np.split(order, np.cumsum(np.bincount(place))[:-1])
    return [(usable[at], rows) for at, rows in zip(first, parts, strict=True)]


@dataclass(frozen=True, slots=True, eq=False)
class SpectrumRows(Sequence[Spectrum]):
    """n spectra on the same wavelengths; a `Spectrum`, which has the rules for all, is made of a row when asked for.

    Attributes
    ----------
    ids : of the rows.
    wavelength_nm : (c,). [nm]
    reflectance, mask : (n, c), a channel that cannot be used is masked. [-]
    about : makes the metadata of a row.
    uncertainty : (n, c), or None where that of no row is known. [-]
    has_sigma : (n,) whether the uncertainty of a row is known.
    systematic : of the rows that have some.
    """

    ids: Sequence[str]
    wavelength_nm: FloatArray
    reflectance: FloatArray
    mask: BoolArray
    about: Callable[[int], Mapping[str, Any]]
    uncertainty: FloatArray | None
    has_sigma: BoolArray
    systematic: Mapping[int, Mapping[str, FloatArray]] = field(default_factory=dict)

    @classmethod
    def of(cls, one: Spectrum) -> "SpectrumRows":
        """One row."""
        sigma = None if one.uncertainty is None else one.uncertainty[None]
        has_sigma, shifts = np.array([sigma is not None]), {0: one.systematic} if one.systematic else {}
        mask = np.asarray(one.mask)[None]
        values, about = one.reflectance[None], [one.metadata].__getitem__
        return cls([one.id], one.wavelength_nm, values, mask, about, sigma, has_sigma, shifts)

    def __len__(self) -> int:
        return len(self.ids)

    @overload
    def __getitem__(self, index: int) -> Spectrum: ...
    @overload
    def __getitem__(self, index: slice) -> list[Spectrum]: ...
    def __getitem__(self, index: int | slice) -> Spectrum | list[Spectrum]:
        row = range(len(self))[index]
        if isinstance(row, range):
            return [self[k] for k in row]
        sigma = self.uncertainty[row] if self.uncertainty is not None and self.has_sigma[row] else None
        return Spectrum(
            self.ids[row], self.wavelength_nm, self.reflectance[row], sigma, self.mask[row], self.about(row),
            self.systematic.get(row, {}),
        )  # fmt: skip

    def kinds(self, rows: IndexArray) -> Iterator[tuple[Any, IndexArray]]:
        """What spectra that are alike have in common, and places in `rows` of those that are, by their first one."""
        shifts = np.zeros(len(self), np.uint8)
        for row, result in self.systematic.items():
            shifts[row] = len(result)
        flags = np.column_stack([np.packbits(~self.mask[rows], axis=1), self.has_sigma[rows], shifts[rows]])
        keys = np.ascontiguousarray(flags).view(f"V{flags.shape[1]}").ravel()
        _, first, which = np.unique(keys, return_index=True, return_inverse=True)
        for kind in np.argsort(first):
            row = rows[first[kind]]
            usable = self.wavelength_nm[~self.mask[row]].tobytes()
            yield (usable, bool(self.has_sigma[row]), int(shifts[row])), np.flatnonzero(which.ravel() == kind)

    def arrays(self, rows: IndexArray) -> AlikeSpectra:
        """Of rows that are alike."""
        inside = np.ix_(rows, np.flatnonzero(~self.mask[rows[0]]))
        channels = self.wavelength_nm[inside[1][0]]
        sigma = self.uncertainty[inside] if self.uncertainty is not None and self.has_sigma[rows[0]] else None
        shifts = [[shift[inside[1][0]] for shift in self.systematic.get(row, {}).values()] for row in rows.tolist()]
        shape = len(rows), len(shifts[0]), channels.size
        return AlikeSpectra(channels, self.reflectance[inside], sigma, np.array(shifts).reshape(shape))

    def digested(self, rows: IndexArray) -> Iterator[Any]:
        """All numbers of some rows, for a digest."""
        yield self.wavelength_nm
        for block in spans(len(rows), _DIGESTED):
            block_rows = rows[block.start : block.stop]
            yield from (self.reflectance[block_rows], self.mask[block_rows], self.has_sigma[block_rows])
            if self.uncertainty is not None:
                yield self.uncertainty[block_rows]
            for row in set(block_rows.tolist()) & set(self.systematic):
                yield from self.systematic[row].values()


class SpectrumCollection(Sequence[Spectrum]):
    """Spectra on any wavelengths, in the order of their parts; or some of these, by their places in all parts."""

    def __init__(self, parts: Sequence[SpectrumRows], places: IndexArray | None = None) -> None:
        self._parts = parts
        self._ends = np.cumsum([len(part) for part in parts])
        self._places = np.arange(self._ends[-1] if len(parts) else 0) if places is None else places

    @classmethod
    def of(cls, spectra: Sequence[Spectrum]) -> "SpectrumCollection":
        """Of spectra in memory; a collection as it is."""
        return spectra if isinstance(spectra, cls) else cls([SpectrumRows.of(one) for one in spectra])

    def __len__(self) -> int:
        return len(self._places)

    @overload
    def __getitem__(self, index: int) -> Spectrum: ...
    @overload
    def __getitem__(self, index: slice) -> "SpectrumCollection": ...
    def __getitem__(self, index: int | slice) -> "Spectrum | SpectrumCollection":
        if isinstance(index, slice):
            return self.taken(index)
        part, rows = next(self._runs(self._places[[index]]))
        return part[int(rows[0])]

    def taken(self, which: slice | IndexArray) -> "SpectrumCollection":
        """Some of them, by position."""
        return SpectrumCollection(self._parts, self._places[which])

    @property
    def ids(self) -> list[str]:
        """Names of all."""
        return [part.ids[row] for part, rows in self._runs(self._places) for row in rows.tolist()]

    def alike(self) -> list[IndexArray]:
        """Positions of those with the same usable channels and kinds of errors together, by the first of each."""
        groups: dict[Any, list[IndexArray]] = {}
        before = 0
        for part, rows in self._runs(self._places):
            for kind, block_rows in part.kinds(rows):
                groups.setdefault(kind, []).append(before + block_rows)
            before += len(rows)
        return [np.concatenate(result) for result in groups.values()]

    def arrays(self) -> AlikeSpectra:
        """Of all, which must be alike."""
        result = [part.arrays(rows) for part, rows in self._runs(self._places)]
        if len(result) == 1:
            return result[0]
        sigma = None if result[0].sigma is None else np.concatenate([one.sigma for one in result])
        values, shifts = (np.concatenate([getattr(one, name) for one in result]) for name in ("reflectance", "shifts"))
        return AlikeSpectra(result[0].wavelength_nm, values, sigma, shifts)

    def digest(self) -> str:
        """SHA-256 of their numbers, without their names."""
        whole = hashlib.sha256()
        for part, rows in self._runs(self._places):
            for values in part.digested(rows):
                whole.update(np.ascontiguousarray(values).data)
        return whole.hexdigest()

    def firsts(self) -> Iterator[Mapping[str, Any]]:
        """Metadata of one spectrum of each part."""
        return (part.about(int(rows[0])) for part, rows in self._runs(self._places))

    def _runs(self, places: IndexArray) -> Iterator[tuple[SpectrumRows, IndexArray]]:
        """Places next to each other in the same part: that part, and its rows."""
        number = np.searchsorted(self._ends, places, side="right")
        for block_rows in np.split(np.arange(len(places)), np.flatnonzero(np.diff(number)) + 1) if len(places) else ():
            part = self._parts[number[block_rows[0]]]
            yield part, places[block_rows] - (self._ends[number[block_rows[0]]] - len(part))


MOST_CHANNELS = 5000
"""Of a spectrum whose bands are measured; a channel every 0.4 nm from 400 to 2500 nm."""


def averaged(rows: SpectrumRows) -> tuple[SpectrumRows, int]:
    """Spectra with every few channels averaged where they have more than `MOST_CHANNELS`, and how many of these.

    A mean is over the usable channels, its error that of independent ones; an error that channels share is averaged.
    """
    size = rows.wavelength_nm.size
    each = -(-size // MOST_CHANNELS)
    if each <= 1:
        return rows, 1
    starts = np.arange(0, size, each)
    usable = ~rows.mask
    count = _sum(usable, starts)
    over = np.maximum(count, 1)
    sigma = None
    if rows.uncertainty is not None:
        squares = np.where(usable & np.isfinite(rows.uncertainty), rows.uncertainty, 0.0) ** 2
        sigma = np.where((count > 0) & (_sum(squares, starts) > 0), np.sqrt(_sum(squares, starts)) / over, np.nan)
    systematic = {
        row: {name: _sum(shift[None] * usable[row], starts)[0] / over[row] for name, shift in block_rows.items()}
        for row, block_rows in rows.systematic.items()
    }
    mean = _sum(np.where(usable, rows.reflectance, 0.0), starts) / over
    wavelength = _sum(rows.wavelength_nm[None], starts)[0] / np.diff(np.append(starts, size))
    result = replace(
        rows, wavelength_nm=wavelength, reflectance=np.where(count > 0, mean, np.nan), mask=count == 0,
        uncertainty=sigma, systematic=systematic,
    )  # fmt: skip
    return result, each


def _sum(values: FloatArray | BoolArray, starts: IntArray) -> FloatArray:
    return np.asarray(np.add.reduceat(values, starts, axis=1, dtype=float))
