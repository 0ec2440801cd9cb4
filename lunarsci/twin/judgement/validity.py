"""Where the wheel model was used outside of what is known about it."""

from dataclasses import dataclass

import numpy as np

from lunarsci.twin.lanes import HOLE, LEFT
from lunarsci.twin.simulation.contact_frame import DEEPEST, SHALLOWEST, VALID_SLIP
from lunarsci.twin.simulation.ensemble import STATE_COLUMNS, Prediction

CALIBRATED_SINKAGE_M = (0.005, 0.015)
"""Sinkages that the calibration of Ding et al. (2024), 10.1038/s41467-024-46233-8, covers: wheels of Yutu-2. [m]"""
MOST_BEYOND = 0.05
"""Share of the wheel states beyond the wheel model at which a verdict rests on nothing; assumed."""


@dataclass(frozen=True, slots=True)
class Validity:
    """Shares of the wheel states (every member, sample and wheel that was driven) by what is wrong with them.

    Attributes
    ----------
    wheel_states : how many there are.
    slip_share : |s| above 0.6, up to which the source states the wheel model.
    unloaded_share : wheels in the air.
    too_deep_share : sinkage beyond 0.9 radii, where the force no longer grows.
    beyond_share : slip or sinkage beyond the wheel model; a wheel in the air has no force, which is known.
    invalid_share : any of these.
    uncalibrated_share : loaded, but sinkage outside of 5 to 15 mm, which the source's calibration covers; still valid.
    members_off_map, members_in_hole : drives that ended at the edge of the map, or at ground of unknown height.
    """

    wheel_states: int
    slip_share: float
    unloaded_share: float
    too_deep_share: float
    beyond_share: float
    invalid_share: float
    uncalibrated_share: float
    members_off_map: int
    members_in_hole: int


def validity(prediction: Prediction) -> Validity:
    """Count what lies outside of the model; all shares are 0 but `invalid_share`, 1, where nothing was driven."""
    driven = prediction.states[prediction.reached]
    sinkage, slip, valid = (driven[..., STATE_COLUMNS.index(name)] for name in ("sinkage_m", "slip_ratio", "valid"))
    low, high = CALIBRATED_SINKAGE_M
    loaded = sinkage > SHALLOWEST
    slipping = loaded & (np.abs(slip) > VALID_SLIP)
    deep = sinkage > DEEPEST * prediction.rover.wheel.radius_m

    def share(where: "np.ndarray[tuple[int, ...], np.dtype[np.bool_]]") -> float:
        return float(where.mean()) if where.size else 0.0

    return Validity(
        wheel_states=int(valid.size),
        slip_share=share(slipping),
        unloaded_share=share(~loaded),
        too_deep_share=share(deep),
        beyond_share=share(slipping | deep),
        invalid_share=float(1.0 - valid.mean()) if valid.size else 1.0,
        uncalibrated_share=share(loaded & ((sinkage < low) | (sinkage > high))),
        members_off_map=int((prediction.outcome == LEFT).sum()),
        members_in_hole=int((prediction.outcome == HOLE).sum()),
    )


def validity_notes(found: Validity) -> list[str]:
    """One sentence for each kind that occurs."""
    low, high = (1e3 * limit for limit in CALIBRATED_SINKAGE_M)
    kinds = (
        (found.slip_share, f"slip more than the wheel model holds for (|s| > {VALID_SLIP})"),
        (found.unloaded_share, "are in the air"),
        (found.too_deep_share, f"sink deeper than the wheel model holds for ({DEEPEST} of the radius)"),
        (
            found.uncalibrated_share,
            f"sink less than {low:g} mm or more than {high:g} mm, the range of Yutu-2's calibration "
            "(Ding et al. 2024): forces there were not tried on the Moon",
        ),
    )
    return [f"{percent(share)} of the wheel states {what}" for share, what in kinds if share > 0]


def percent(share: float) -> str:
    """A share in words, never rounded to nothing."""
    return "less than 0.1 %" if share < 0.001 else f"{100 * share:.1f} %"
