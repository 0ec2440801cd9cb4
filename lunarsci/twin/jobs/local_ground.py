"""Finer terrains over parts of a site: what is looked for ways on, and what is driven on, in their place."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from lunarsci.arrays import FloatArray
from lunarsci.errors import RequestError
from lunarsci.twin.ground.finer_ground import check_finer, driven_ground, lengths_checked, patch
from lunarsci.twin.ground.footprint import rover_footprint, swept_nodes
from lunarsci.twin.ground.hazards import Traversability
from lunarsci.twin.ground.terrain import Terrain
from lunarsci.twin.jobs.requests import GroundRequest, PlanRequest
from lunarsci.twin.jobs.terrain import Progress, SurveyedSite, read_site
from lunarsci.twin.plans.path import poses_along
from lunarsci.twin.routes.planner import PLACES_M, PlannedPath, search_margin_m

CHECKED_EVERY_M = 0.1
DRIFT_M = 3.0
"""Ground beyond what is searched that drives may come to; assumed."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class LocalGround:
    """A site with its local terrains, the finest last; there may be none.

    Attributes
    ----------
    site : the first terrain, with the hashes of all.
    surface : its maps.
    finer : the maps of the local ones.
    likely : heights of all of them as they are likely to be, the first one first; empty where they are not driven on.
    """

    site: SurveyedSite
    surface: Traversability
    finer: tuple[Traversability, ...]
    likely: tuple[Terrain, ...] = ()

    @classmethod
    def of(
        cls, asked: PlanRequest, site: SurveyedSite, surface: Traversability, progress: Progress | None
    ) -> "LocalGround":
        """Raises DataError, and RequestError where heights have errors that drives on several terrains cannot have."""
        alone = GroundRequest(rover=asked.rover, keep_out=asked.keep_out)
        driven, inputs = asked.risk is not None or asked.mission is not None, dict(site.inputs)
        found: list[tuple[Traversability, Terrain]] = []
        for path in asked.local:
            local = read_site(path, alone, next(iter(_names(asked)), None), asked.limits_of_ground(), site.terrain.crs)
            check_finer(path, local.terrain, site.terrain)
            if driven and not asked.exact_terrain and (local.file.states_errors or site.file.states_errors):
                raise RequestError(
                    f"heights of {path if local.file.states_errors else site.terrain.name} have errors, and beside "
                    "`local` all are driven on as they are likely to be; give `exact_terrain`, too"
                )
            found.append((local.surface(asked.baseline, progress), likely_ground_of(local)))
            inputs |= local.inputs
        found.sort(key=lambda one: -one[0].terrain.spacing_m)
        return cls(
            site=replace(site, inputs=inputs),
            surface=surface,
            finer=tuple(one for one, _ in found),
            likely=(likely_ground_of(site), *(ground for _, ground in found)) if driven and found else (),
        )

    def searched(self, points_m: FloatArray) -> Traversability:
        """The maps on which ways between places (n, 2) are looked for; those of the site without finer ones near."""
        if not self.finer:
            return self.surface
        return patch(self.surface, self.finer, points_m, self._margin_m(points_m) + self.surface.terrain.spacing_m)

    def driven(self, points_m: FloatArray) -> Terrain | None:
        """What is driven on about places (n, 2); None without local terrains."""
        if not self.likely:
            return None
        return driven_ground(self.likely[0], self.likely[1:], points_m, self._margin_m(points_m) + DRIFT_M)

    def _margin_m(self, points_m: FloatArray) -> float:
        return search_margin_m(rover_footprint(self.site.rover), float(np.hypot(*np.ptp(points_m, axis=0))))

    def on_site(self, path: PlannedPath) -> PlannedPath:
        """A path found on a patch, with the nodes of the site that it sweeps."""
        if not self.finer:
            return path
        poses = poses_along(path.plan, PLACES_M)
        return replace(path, swept=swept_nodes(path.footprint, self.surface.terrain, poses))

    def checked(self, path: PlannedPath) -> list[dict[str, Any]]:
        """On how much of the path which terrain was looked at, the first one first; nothing without local ones."""
        if not self.finer:
            return []
        poses = poses_along(path.plan, CHECKED_EVERY_M)
        lengths = lengths_checked(poses, path.plan.length_m / len(poses), path.footprint, self.finer)
        terrains = (self.site.terrain, *(one.terrain for one in self.finer))
        return [
            {"terrain": terrain.name, "spacing_m": terrain.spacing_m, "length_m": length}
            for terrain, length in zip(terrains, (path.plan.length_m - sum(lengths), *lengths), strict=True)
        ]


def _names(asked: PlanRequest) -> Sequence[str]:
    """The soil of a path on the maps, which alone may be laid over a local terrain's own."""
    return asked.soil if asked.risk is None and asked.mission is None else ()


def likely_ground_of(site: SurveyedSite) -> Terrain:
    """Heights as they are likely to be below a wheel."""
    as_read = replace(site.terrain, height_m=site.file.terrain.height_m, errors=None)
    return replace(site.file.likely(as_read, site.rover.wheel.width_m), errors=None)
