"""Which soil lies on a terrain: the one that was asked for, the terrain's own, or a common one; never in silence."""

from collections.abc import Iterable
from dataclasses import dataclass, replace
from typing import Any, Literal

import numpy as np

from lunarsci.regolith.soil import Soil
from lunarsci.twin.ground.terrain import SOIL_COLUMNS, Terrain, from_si
from lunarsci.twin.ground.terrain_files import TerrainFile

__all__ = ["DrivenSoil", "Origin", "lay_soil_on", "soil_record"]

Origin = Literal["option", "default", "terrain", "belief", "priors", "samples", "map"]


@dataclass(frozen=True, slots=True)
class DrivenSoil:
    """Where the soil of a terrain comes from.

    Attributes
    ----------
    name : of the soil, or the file that has it.
    of : `option` where it was asked for, `terrain` where the terrain's file carries it, `default` otherwise.
    carried : parameters that the terrain's file has.
    rest : soil of the parameters that it lacks; empty where it lacks none, or where its own soil is not driven on.
    """

    name: str
    of: Origin
    carried: tuple[str, ...] = ()
    rest: str = ""

    @property
    def replaced(self) -> tuple[str, ...]:
        """Parameters of the terrain's file that are not driven on."""
        return self.carried if self.of == "option" else ()


def lay_soil_on(file: TerrainFile, path: str, soil: Soil, name: str, *, asked: bool) -> tuple[Terrain, DrivenSoil]:
    """The terrain of a file with the soil that is driven on, and where this comes from.

    `soil` is what the file was read with and `name` says which; one that was `asked` for lies everywhere, whatever the
    file carries, and another only fills in what the file lacks.
    """
    if asked:
        everywhere = np.array(soil.vector()).reshape(1, 1, 8)
        return replace(file.terrain, soil=everywhere), DrivenSoil(name, "option", file.carries)
    if not file.carries:
        return file.terrain, DrivenSoil(name, "default")
    rest = name if len(file.carries) < len(SOIL_COLUMNS) else ""
    return file.terrain, DrivenSoil(path, "terrain", file.carries, rest)


def soil_record(driven: DrivenSoil, terrain: Terrain, drawn: Iterable[str] = ()) -> dict[str, Any]:
    """The soil for a result: name, origin, its parameters but those that each drive draws for itself, and `drawn`.

    A parameter that changes from place to place has its lowest and highest value.
    """
    taken = sorted(drawn)
    values = {
        name: _range(from_si(name, terrain.soil[..., k])) for name, k in SOIL_COLUMNS.items() if name not in taken
    }
    return {
        "name": driven.name,
        "of": driven.of,
        "rest_of": driven.rest or None,
        "replaces_of_terrain": list(driven.replaced),
        "parameters": values,
        "drawn": taken,
    }


def _range(values: Any) -> float | dict[str, float]:
    low, high = (float(f"{value:.12g}") for value in (values.min(), values.max()))
    return low if low == high else {"low": low, "high": high}
