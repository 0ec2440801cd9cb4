"""Rocks in a pair of pictures, and how many of them are missed."""

import json
import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass
from typing import Any, ClassVar

from lunarsci.images.jobs.dem import StereoTerrain, dem
from lunarsci.images.jobs.requests import RocksRequest
from lunarsci.images.rocks import RockSurvey, find_rocks
from lunarsci.io.documents import geojson_feature
from lunarsci.io.inputs import Source
from lunarsci.options import request_of
from lunarsci.result import Doubt, Figures, MadeFrom, Progress, Result, job

SOURCES = [
    "Golombek & Rapp (1997), J. Geophys. Res. 102, 4117, 10.1029/96JE03319: heights of rocks",
    "LeCun et al. (1998), Proc. IEEE 86, 2278, 10.1109/5.726791: networks of this kind",
    "Efron (2008), Stat. Sci. 23, 1, 10.1214/07-STS236: probability of a single find",
    "Elias & Gygi (2007), Nat. Methods 4, 207, 10.1038/nmeth1019: false finds by competition with decoys",
]
CORNERS = 24
"""Corners of the polygon in the place of the circle about a rock, in GeoJSON."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class RockList(Result):
    """Rocks of a pair of pictures, the likeliest first.

    Attributes
    ----------
    ground : heights and matches of the pair.
    survey : the rocks, and how sure and complete they are.
    request : what was asked.
    """

    schema: ClassVar[str] = "images-rocks/1"
    ground: StereoTerrain
    survey: RockSurvey
    request: RocksRequest

    @property
    def made_from(self) -> MadeFrom:
        return MadeFrom(inputs=self.ground.inputs, sources=SOURCES, seed=self.request.seed)

    @property
    def doubt(self) -> Doubt:
        share = self.survey.false_share
        bumps = f"{100 * share:.0f} % of these finds are probably bumps of the ground; each has its own probability"
        return Doubt.of(self.ground.doubt, bumps if share > 0.5 else "")

    def to_dict(self) -> dict[str, Any]:
        survey = self.survey
        return {
            "terrain": self.ground.model.summary(),
            "threshold": survey.threshold,
            "expected_false_share": survey.false_share,
            "rocks": self.rows(),
            "completeness": [asdict(entry) for entry in survey.completeness],
            "searched": self.searched(),
            "notes": self.notes(),
        }

    def searched(self) -> dict[str, Any]:
        """Where was looked: from which place, how much ground, and under which Sun."""
        azimuth, elevation = self.survey.sun_deg
        return {
            "camera_m": [float(v) for v in self.ground.pose.center_m],
            "area_m2": self.survey.searched_m2,
            "sun_azimuth_deg": azimuth,
            "sun_elevation_deg": elevation,
        }

    def rows(self) -> Sequence[Mapping[str, Any]]:
        """One a rock."""
        margin = self.request.margin
        return [
            {"id": k} | asdict(rock) | {"keepout_m": rock.keepout_m + margin}
            for k, rock in enumerate(self.survey.rocks, start=1)
        ]

    def figures(self) -> Figures:
        from lunarsci.images.figures import rocks_page

        yield rocks_page(self.ground.model, self.survey)

    def as_input(self, role: str) -> dict[str, Callable[[], bytes]]:
        return {"rocks.geojson": self.geojson} if role == "keep_out" else {}

    def geojson(self) -> bytes:
        """Circles to keep out of, in the coordinates of the model, in m."""
        features = []
        for row in self.rows():
            turns = [2 * math.pi * k / CORNERS for k in range(CORNERS)] + [0.0]
            # The circle lies within its polygon.
            radius = row["keepout_m"] / math.cos(math.pi / CORNERS)
            ring = [[row["x_m"] + radius * math.cos(t), row["y_m"] + radius * math.sin(t)] for t in turns]
            features.append(geojson_feature("Polygon", [ring], row))
        search = {"searched": self.searched() | {"completeness": self.to_dict()["completeness"]}}
        document = {"type": "FeatureCollection", "features": features} | search
        return (json.dumps(document, sort_keys=True) + "\n").encode()

    def notes(self) -> list[str]:
        """What the numbers rest on."""
        notes = [
            "looked for on lit ground that both pictures show; in deep shadow and behind crests no rock is seen",
            "the network that knows rocks was taught on SYNTHETIC scenes and has seen none of the Moon: on other bumpy "
            "ground, that of `images render`, 107 of 121 finds were bumps",
            "completeness is of stones with flat faces that were rendered into these pictures",
        ]
        if self.request.sun is None:
            notes.append("the Sun's direction was taken from the light of the ground: `sun` states it")
        if self.ground.model.synthetic:
            notes.append("the pictures are SYNTHETIC")
        return notes


@job
def rocks(
    left: Source,
    right: Source,
    request: RocksRequest | None = None,
    *,
    progress: Progress | None = None,
    **options: Any,
) -> RockList:
    """Rocks in a pair of pictures, each with its probability, and the share of those that are missed.

    Raises DataError where the pictures do not match or show too little ground, and RequestError.

    Examples
    --------
    >>> demo = ("lunarsci-demo/left.png", "lunarsci-demo/right.png")
    >>> rocks = lunarsci.rocks(*demo, rig="lunarsci-demo/rig.toml", pose="lunarsci-demo/pose.toml").to_table()
    """
    request = request_of(RocksRequest, request, options)
    ground = dem(left, right, rig=request.rig, pose=request.pose)
    survey = find_rocks(
        ground.matches,
        ground.pose,
        sun_deg=request.sun_deg(),
        largest_m=request.largest,
        false_share=request.false_share,
        sizes_m=request.diameters(),
        seed=request.seed,
        progress=progress,
    )
    return RockList(ground=ground, survey=survey, request=request)
