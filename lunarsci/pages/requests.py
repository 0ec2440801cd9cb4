"""What `lunarsci report` can be asked."""

from dataclasses import dataclass


@dataclass(frozen=True, slots=True, kw_only=True)
class ReportRequest:
    """What a page shows beside its results.

    Attributes
    ----------
    title : Title of the page.
    terrain : Ground to turn in the page: synthetic-longji, or a file (.npz, GeoTIFF, ESRI ASCII .asc, CSV of nodes); if
        left out that of a result's folder or of its `terrain`.
    """

    title: str | None = None
    terrain: str | None = None
