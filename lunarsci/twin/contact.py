"""Where a wheel meets the terrain, and the wrench of the soil on it.

The interaction plane is the terrain's tangent plane below the wheel centre. The wheel rolls along the line in which
its own plane cuts the interaction plane; lateral and normal complete the contact frame.

F_DP and F_N act at the wheel centre and M_R about the axle, as in Eqs 21-24 of Ding et al. (2024),
10.1038/s41467-024-46233-8. F_L acts where the shear stress is centred, r_s below and ahead of the axle, which gives the
overturning and steering torques M_O and M_S their leading parts.
"""

import math
from typing import Any

from lunarsci.compiled import compiled
from lunarsci.regolith.forces import contact_angles, slip_ratio, wheel_forces_kernel
from lunarsci.twin.dynamics import cross, dot

__all__ = ["DEEPEST", "NORMAL_DAMPING", "VALID_SLIP", "contact_frame", "wheel_contact"]

# Assumed, for a calm touch-down: half of critical for a sixth of 135 kg on 7 kN/m; the soil's own is not published.
NORMAL_DAMPING = 400.0
# The closed form has no meaning once the wheel is buried to its axle; beyond this share of r the force stays constant.
DEEPEST = 0.9
# Range of |s| that the source states for the model.
VALID_SLIP = 0.6
# Below this sinkage [m] the contact angles round to nothing.
SHALLOWEST = 1e-9
# Relative step of the finite differences.
STEP = 1e-6


@compiled
def contact_frame(slope_x: float, slope_y: float, axle: Any) -> Any:
    """Forward, left and normal axis of the contact frame, from the terrain's gradient and the wheel's axle. [-]"""
    scale = 1.0 / math.sqrt(1.0 + slope_x * slope_x + slope_y * slope_y)
    normal = (-slope_x * scale, -slope_y * scale, scale)
    x = cross(axle, normal)
    length = math.sqrt(dot(x, x)) + 1e-300
    forward = (x[0] / length, x[1] / length, x[2] / length)
    return forward, cross(normal, forward), normal


@compiled
def fill_wrench(row: Any, forces: Any, approach: float, ahead: float, below: float) -> None:
    """Force [N] and moment about the wheel centre [N m] of the soil on the wheel, in the contact frame.

    `forces` as `wheel_forces_kernel` returns them; `approach` is the velocity of the centre along the normal [m/s]; F_L
    acts `ahead` and `below` of the centre [m]. The normal force never pulls.
    """
    normal, drawbar, side, resistance = forces
    row[0], row[1], row[2] = drawbar, -side, max(normal - NORMAL_DAMPING * approach, 0.0)
    row[3], row[4], row[5] = -below * side, -resistance, -ahead * side


@compiled
def rolling_contact(z: float, v: Any, ground_speed: float, wheel: Any, soil: Any, wrench: Any, slopes: Any) -> None:
    """Wrench and its derivatives by the three velocities (rows 0-2, per m/s) and the sinkage (row 3, per m).

    The derivatives only steady the implicit step, so they are as cheap as that allows: one more call, shifted forward
    and sideways at once (F_L depends on the lateral velocity, the rest on the forward one), and the stiffness of
    F_N ~ z^(n0 + 1/2).
    """
    travel, lateral = v[0] / ground_speed, v[1] / ground_speed
    theta_1, _, theta_2, theta_m = contact_angles(z, slip_ratio(travel), wheel)
    center = (theta_1 + theta_2 + theta_m) / 3.0
    ahead, below = wheel[3] * math.sin(center), wheel[3] * math.cos(center)
    for k in range(2):
        forces = wheel_forces_kernel(z, travel + STEP * k, lateral + STEP * k, wheel, soil, 0)
        fill_wrench(slopes[3 * k], forces, v[2], ahead, below)
    for i in range(6):
        wrench[i] = slopes[0, i]
    per_speed = 1.0 / (STEP * ground_speed)
    for i in range(6):
        change = (slopes[3, i] - wrench[i]) * per_speed
        sideways = i == 1 or i == 3 or i == 5
        slopes[0, i] = 0.0 if sideways else change
        slopes[1, i] = change if sideways else 0.0
        slopes[3, i] = 0.0
    slopes[2, 2] = -NORMAL_DAMPING if wrench[2] > 0.0 else 0.0
    slopes[3, 2] = (soil[1] + 0.5) * wrench[2] / z


@compiled
def wheel_contact(w: int, u: Any, ground_speed: float, wheel: Any, work: Any, shear: float) -> float:
    """Fill contact axes, wrench, derivatives and state of wheel `w` in `work`; returns its sinkage. [m]

    `work.node` holds the terrain below the wheel centre. State: x, y, sinkage, slip ratio, side slip [rad], F_N, F_DP,
    F_L, M_R, valid (1 or 0). F_N is the soil's, without the damping that the step adds to it.
    """
    node, state, center = work.node, work.state[w], work.center[w]
    frame = contact_frame(node[1], node[2], (work.axle[w, 0], work.axle[w, 1], work.axle[w, 2]))
    jacobian, rows = work.jacobian[w], work.rows[w]
    for a in range(3):
        x, y, z = frame[a]
        for i in range(9):
            rows[a, i] = x * jacobian[0, i] + y * jacobian[1, i] + z * jacobian[2, i]
            rows[3 + a, i] = x * jacobian[3, i] + y * jacobian[4, i] + z * jacobian[5, i]
    v = (row_dot(rows[0], u), row_dot(rows[1], u), row_dot(rows[2], u))
    sinkage: float = wheel[0] - (center[2] - node[0]) * frame[2][2]
    z = min(sinkage, DEEPEST * wheel[0])
    soil = (node[3], node[4], node[5], node[6], node[7], node[8], node[9], node[10])
    wrench, slopes = work.wrench[w], work.slopes[w]
    clear(wrench, slopes)
    if z > SHALLOWEST:
        motion = v if shear > 0.0 else (ground_speed, 0.0, 0.0)
        rolling_contact(z, motion, ground_speed, wheel, soil, wrench, slopes)
        if shear == 0.0:
            keep_normal(wrench, slopes)
    slip = slip_ratio(v[0] / ground_speed)
    state[0], state[1], state[2], state[3] = center[0], center[1], max(sinkage, 0.0), slip
    state[4] = math.atan2(v[1], abs(v[0]))
    damping = NORMAL_DAMPING * v[2] if shear > 0.0 and wrench[2] > 0.0 else 0.0
    state[5], state[6], state[7], state[8] = wrench[2] + damping, wrench[0], -wrench[1], -wrench[4]
    state[9] = 1.0 if SHALLOWEST < sinkage <= z and abs(slip) <= VALID_SLIP else 0.0
    return sinkage


@compiled
def clear(wrench: Any, slopes: Any) -> None:
    """No contact: no wrench, no derivatives."""
    for i in range(6):
        wrench[i] = 0.0
        for k in range(4):
            slopes[k, i] = 0.0


@compiled
def keep_normal(wrench: Any, slopes: Any) -> None:
    """Leave the normal force and its stiffness alone: the wheel at rest, before any shear."""
    normal, stiffness = wrench[2], slopes[3, 2]
    clear(wrench, slopes)
    wrench[2], slopes[3, 2] = normal, stiffness


@compiled
def row_dot(row: Any, u: Any) -> float:
    """Scalar product of two arrays of nine."""
    total = 0.0
    for i in range(9):
        total += row[i] * u[i]
    return total
