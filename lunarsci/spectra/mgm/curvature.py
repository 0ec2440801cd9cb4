"""From the sums over channels to the curvature and the slope of chi-square in a fit's parameters, eight at a time."""

from typing import Any

from lunarsci.compiled import compiled
from lunarsci.spectra.mgm.forward import FWHM_OVER_SIGMA
from lunarsci.spectra.mgm.lanes import choose, load, store
from lunarsci.spectra.mgm.moments import MOMENTS, ORIGIN

__all__ = ["update"]


@compiled(forceinline=True)  # type: ignore[untyped-decorator]
def _keep(target: Any, row: int, taken: Any, value: Any) -> None:
    store(target, row, choose(taken, value, load(target, row)))


@compiled(forceinline=True)  # type: ignore[untyped-decorator]
def _shape(point: Any, band: int) -> Any:
    """A band's derivatives are g, by strength; by_centre (t - centre) g; and by_width (t - centre)^2 g."""
    centre, inverse = load(point, band) - ORIGIN, FWHM_OVER_SIGMA / load(point, band + 1)
    by_centre = load(point, band + 2) * inverse * inverse
    return centre, by_centre, by_centre / load(point, band + 1)


@compiled(forceinline=True)  # type: ignore[untyped-decorator]
def _keep_band(target: Any, row: int, stride: int, taken: Any, shape: Any, s0: Any, s1: Any, s2: Any) -> None:
    """Sums of something with g, t g, t^2 g become those with a band's derivatives by centre, width and strength."""
    centre, by_centre, by_width = shape
    _keep(target, row, taken, (s1 - s0 * centre) * by_centre)
    _keep(target, row + stride, taken, (s2 - (s1 * 2.0 - s0 * centre) * centre) * by_width)
    _keep(target, row + 2 * stride, taken, s0)


@compiled(forceinline=True)  # type: ignore[untyped-decorator]
def _between_bands(sums: Any, row: int, first: Any, second: Any, target: Any, at: int, side: int, taken: Any) -> None:
    """The nine products of the derivatives of two bands."""
    s0, s1, s2 = load(sums, row), load(sums, row + 1), load(sums, row + 2)
    s3, s4 = load(sums, row + 3), load(sums, row + 4)
    centre, by_centre, by_width = first
    _keep_band(
        target, at, 1, taken, second, (s1 - s0 * centre) * by_centre, (s2 - s1 * centre) * by_centre,
        (s3 - s2 * centre) * by_centre,
    )  # fmt: skip
    _keep_band(
        target, at + side, 1, taken, second, (s2 - (s1 * 2.0 - s0 * centre) * centre) * by_width,
        (s3 - (s2 * 2.0 - s1 * centre) * centre) * by_width, (s4 - (s3 * 2.0 - s2 * centre) * centre) * by_width,
    )  # fmt: skip
    _keep_band(target, at + 2 * side, 1, taken, second, s0, s1, s2)


@compiled
def update(sums: Any, point: Any, degrees: int, taken: Any, curvature: Any, slope: Any) -> None:
    """In the lanes where `taken` is above 0: the upper triangle of J J' into `curvature` (p p, 8), J r into `slope`."""
    size, plain = point.shape[0], degrees + 1
    bands = (size - degrees) // 3
    with_bands = plain * plain
    between = with_bands + 3 * plain * bands
    for c in range(degrees):
        for d in range(degrees):
            _keep(curvature, c * size + d, taken, load(sums, c * plain + d))
        _keep(slope, c, taken, load(sums, c * plain + degrees))
    for a in range(bands):
        p = degrees + 3 * a
        first = _shape(point, p)
        for c in range(plain):
            row = with_bands + 3 * (c * bands + a)
            s0, s1, s2 = load(sums, row), load(sums, row + 1), load(sums, row + 2)
            if c < degrees:
                _keep_band(curvature, c * size + p, 1, taken, first, s0, s1, s2)
            else:
                _keep_band(slope, p, 1, taken, first, s0, s1, s2)
        for b in range(a, bands):
            q = degrees + 3 * b
            _between_bands(
                sums, between + MOMENTS * (a * bands + b), first, _shape(point, q), curvature, p * size + q, size, taken
            )
