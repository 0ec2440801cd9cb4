"""Rocks in an elevation model, and how many of them are missed."""

import json
import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass
from typing import TYPE_CHECKING, Any, ClassVar

from lunarsci.images.elevation import ElevationModel, read_elevation
from lunarsci.images.jobs.requests import RocksRequest
from lunarsci.images.rocks import RockSurvey, find_rocks
from lunarsci.io.documents import geojson_feature
from lunarsci.io.inputs import read_input
from lunarsci.options import request_of
from lunarsci.result import MadeFrom, Result, job

if TYPE_CHECKING:
    from matplotlib.figure import Figure


SOURCES = [
    "Golombek & Rapp (1997), J. Geophys. Res. 102, 4117, 10.1029/96JE03319: heights of rocks",
    "Elias & Gygi (2007), Nat. Methods 4, 207, 10.1038/nmeth1019: false finds from a search among decoys",
    "Wilson (1927), J. Am. Stat. Assoc. 22, 209, 10.1080/01621459.1927.10502953: interval of a share",
]
CORNERS = 24
"""Corners of the polygon in the place of the circle about a rock, in GeoJSON."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class RockList(Result):
    """Rocks of an elevation model, the surest first.

    Attributes
    ----------
    model : the heights that they were looked for in.
    survey : the rocks, and how sure and complete they are.
    request : what was asked.
    inputs : SHA-256 of each file by its name.
    """

    schema: ClassVar[str] = "images-rocks/1"
    model: ElevationModel
    survey: RockSurvey
    request: RocksRequest
    inputs: Mapping[str, str]

    @property
    def made_from(self) -> MadeFrom:
        return MadeFrom(inputs=self.inputs, sources=SOURCES, seed=self.request.seed)

    def to_dict(self) -> dict[str, Any]:
        survey = self.survey
        return {
            "terrain": self.model.summary(),
            "threshold": survey.threshold,
            "expected_false_share": survey.false_share,
            "rocks": self.rows(),
            "completeness": [asdict(entry) for entry in survey.completeness],
            "notes": self.notes(),
        }

    def rows(self) -> Sequence[Mapping[str, Any]]:
        """One a rock."""
        margin = self.request.margin
        return [
            {"id": k} | asdict(rock) | {"keepout_m": rock.keepout_m + margin}
            for k, rock in enumerate(self.survey.rocks, start=1)
        ]

    def figures(self) -> "Iterator[Figure]":
        from lunarsci.images.figures import rocks_page

        yield rocks_page(self.model, self.survey)

    def geojson(self) -> bytes:
        """Circles to keep out of, in the coordinates of the model, in m."""
        features = []
        for row in self.rows():
            turns = [2 * math.pi * k / CORNERS for k in range(CORNERS)] + [0.0]
            # The circle lies within its polygon.
            radius = row["keepout_m"] / math.cos(math.pi / CORNERS)
            ring = [[row["x_m"] + radius * math.cos(t), row["y_m"] + radius * math.sin(t)] for t in turns]
            features.append(geojson_feature("Polygon", [ring], row))
        return (json.dumps({"type": "FeatureCollection", "features": features}, sort_keys=True) + "\n").encode()

    def notes(self) -> list[str]:
        """What the numbers rest on."""
        notes = [
            "found in heights alone: flat or half buried rocks, and what lies in holes of the model, are not seen",
            "completeness is of half ellipsoids half as high as wide (assumed), put into this model",
        ]
        if self.model.height_m_sigma is None:
            notes.append("the model states no errors; the scatter of its heights stands for them")
        if self.model.synthetic:
            notes.append("the terrain is synthetic")
        return notes


@job
def rocks(
    terrain: str,
    request: RocksRequest | None = None,
    *,
    progress: Callable[[int, int], None] | None = None,
    **options: Any,
) -> RockList:
    """Rocks that stand out of an elevation model, with the share of false ones and of missed ones.

    Raises DataError, RequestError, and ParameterError for a grid too coarse.

    Examples
    --------
    >>> rocks = lunarsci.rocks("ground/terrain.npz").to_table()
    """
    request = request_of(RocksRequest, request, options)
    inputs = {terrain: read_input(terrain).sha256}
    model = read_elevation(terrain)
    survey = find_rocks(
        model,
        largest_m=request.largest,
        false_share=request.false_share,
        sizes_m=request.diameters(),
        seed=request.seed,
        progress=progress,
    )
    return RockList(model=model, survey=survey, request=request, inputs=inputs)
