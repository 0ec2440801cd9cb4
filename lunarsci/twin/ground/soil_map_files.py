"""Soil maps as files: JSON with the beliefs of the zones and their places."""

import json
from collections.abc import Mapping
from dataclasses import asdict
from typing import Any

import numpy as np

from lunarsci.errors import DataError, ParameterError
from lunarsci.inputs import InputFile, text
from lunarsci.regolith.belief import belief_of
from lunarsci.regolith.prior import PARAMETERS, Law
from lunarsci.twin.ground.soil_map import SoilMap, Zone

__all__ = ["SCHEMA", "read_soil_map", "soil_map_bytes"]

SCHEMA = "lunarsci/soil-map/1"


def soil_map_bytes(soil_map: SoilMap) -> bytes:
    """As `read_soil_map` reads it; places to a millimetre."""
    document = {
        "schema": SCHEMA,
        "correlation_m": soil_map.correlation_m,
        "reach_m": soil_map.reach_m,
        "laws": {name: asdict(law) for name, law in soil_map.laws.items()},
        "zones": [
            {
                "name": zone.name,
                "x_m": np.round(zone.place_m[:, 0], 3).tolist(),
                "y_m": np.round(zone.place_m[:, 1], 3).tolist(),
                "belief": json.loads(zone.belief.to_json()),
            }
            for zone in soil_map.zones
        ],
    }
    return (json.dumps(document, indent=1, sort_keys=True, ensure_ascii=False, allow_nan=False) + "\n").encode()


def read_soil_map(source: InputFile) -> SoilMap:
    """Read a soil map. Raises DataError for text that is none."""
    try:
        return _soil_map(json.loads(text(source), parse_constant=_refuse))
    except json.JSONDecodeError as error:
        raise DataError(
            f"{source.name}, line {error.lineno}: not valid JSON: {error.msg}; is the file complete?"
        ) from error
    except ParameterError as error:
        raise DataError(f"{source.name}: {error}") from error


def _soil_map(document: Any) -> SoilMap:
    if not isinstance(document, Mapping) or document.get("schema") != SCHEMA:
        raise ParameterError(f"not a soil map; its schema must be {SCHEMA}; `twin update --save-map` writes one")
    try:
        return SoilMap(
            laws={name: Law(**document["laws"][name]) for name in PARAMETERS},
            correlation_m=float(document["correlation_m"]),
            reach_m=float(document["reach_m"]),
            zones=tuple(_zone(entry) for entry in document["zones"]),
        )
    except KeyError as error:
        raise ParameterError(f"no {error} in it") from error
    except (TypeError, ValueError) as error:
        raise ParameterError(str(error)) from error


def _zone(entry: Mapping[str, Any]) -> Zone:
    places = [np.array(entry[key], dtype=np.float64) for key in ("x_m", "y_m")]
    return Zone(name=str(entry["name"]), place_m=np.column_stack(places), belief=belief_of(entry["belief"]))


def _refuse(name: str) -> float:
    raise ParameterError(f"{name} is no number that a soil map can have")
