"""Several rovers side by side: where their numbers lie, how the drive of each can end, and vectors of them.

GROUP members of an ensemble are driven together. Every quantity is a row of GROUP numbers, one for each member;
formulas work on eight of them at once, and know the rows by name.
"""

from collections.abc import Iterable
from typing import Any, NamedTuple, SupportsInt

import numpy as np

from lunarsci.arrays import FloatArray, IntArray
from lunarsci.compiled.formulas import formula
from lunarsci.compiled.lanes import Fields, aligned

GROUP = 16
"""Members of a group, a multiple of the lanes of a vector."""

BODY = Fields(
    GROUP, position=3, quaternion=4, joints=3, speed=3, spin=3, rates=3, x_row=3, y_row=3, z_row=3, omega=3, change=9,
    energy=1, power=1, excess=1, error=1, outcome=1,
)  # fmt: skip
"""Rows of `Work.body`.

Pose: place of the origin, unit quaternion body-to-world (w, x, y, z), angles of differential, left and right bogie.
Velocity: of the origin, angular in the world, rates of the joints. Rows of the chassis' rotation. Angular
velocity in the body frame. Change of the velocity in a step. Energy [J], power of the rims [W], energy that came from
nowhere [J], and how far forces along the wheels are from what the steps took them to be, in the mean of the last steps
[N]. Outcome that the step has found.
"""
WHEEL = Fields(
    GROUP, center=3, arm=3, swing=3, bogie_swing=3, axle=3, acceleration=3, ground=3, soil=8, sinkage=1, velocity=3,
    normal=1, drawbar=1, side=1, resistance=1, forward=3, across=3, upward=3, force=3, moment=3, by_forward=3,
    by_across=3, stiff=2, steer=1, rim=1, slip=1, travel=1, last=1, hold=3, twist=3, rate=3, rut=2, missed=1, tread=5,
    cell=4, nodes=16,
)  # fmt: skip
"""Rows of one wheel of `Work.wheels`, vectors in the world frame.

Centre; its arm from the origin; its velocity per rate of the differential and of the bogie; axle; acceleration that
remains without generalised acceleration; height and gradient of the terrain; soil. What the contact found: sinkage,
velocity along the contact frame, forces, and the axes of that frame; force and moment of wheel and inertia along them;
derivatives of the wrench by the forward velocity (drawbar, normal, resistance) and by the lateral one (side force, its
moments about the first and last axis); what normal damping and stiffness add to the matrix, and to the right side.
Commands: steering angle, and speed of the rim over ground, r_s omega, negative backwards. The wheel's own r_s, c1, c2
and c3, and r_s as a multiple of the stated one: these turn at the stated rate.
What the contact remembers: the slip ratio that the bearing has taken up; the travel ratio before the rim stood still;
the speed of the rim in the step before; force and torque along the surface at the end of it, for a wheel that does not
move, and how they change with its speed. How deep wheels before pressed the ground, and how deep it is still. How far
the force of a step's end was from what the step had taken it to be. Column and row of the terrain's cell below it, 1
where it is known, else 0, and 1 where its ground is no ground to drive on; the heights of the 4 x 4 nodes about it.
"""
SYSTEM = Fields(GROUP, matrix=64, right=8)
"""Rows of one side of `Work.sides`: the 8 x 8 matrix by rows, and the right side. The matrix of the nine coordinates is
the sum of both sides, the eighth coordinate being each side's own bogie."""
STEEPEST_DEG = 60.0
"""No soil stands steeper, and no wheel meets it in one plane; a rover tilted by more has overturned. Assumed."""
OUTCOMES = (
    "finished",
    "left the terrain: a wheel passed the edge of the map",
    "hole in the terrain: no height below a wheel",
    f"overturned: the chassis tilted by more than {STEEPEST_DEG:g} deg",
    "diverged: loads or energy that no drive has; the wheel model does not hold for this soil, speed and ground",
    "did not settle: no static equilibrium at the start pose",
    "sank: a wheel is buried to its axle",
    f"cliff: the ground below or before a wheel is steeper than {STEEPEST_DEG:g} deg",
    "fell: it moved 1 m/s faster than its wheels can drive it, off a cliff or down a slope that does not hold it",
)
"""How the drive of a member can end, in words of results."""
FINISHED, LEFT, HOLE, OVERTURNED, DIVERGED, UNSETTLED, SANK, CLIFF, FELL = range(len(OUTCOMES))
"""Numbers of the outcomes. While a rover is driven FINISHED stands for one that nothing has stopped yet."""


class Work(NamedTuple):
    """Scratch arrays of a group of rovers, so that a step allocates nothing.

    Rows are of GROUP numbers, one a rover; the tables below name them.

    Attributes
    ----------
    body : rows `BODY`. (BODY.rows * GROUP,)
    wheels : rows `WHEEL` of each wheel. (wheels, WHEEL.rows * GROUP)
    sides : rows `SYSTEM` of the left and the right side. (2, SYSTEM.rows * GROUP)
    code : how the drive of each rover ended, a number of `OUTCOMES`; FINISHED while it goes on. (GROUP,)
    ruts : depths that wheels have pressed, and what is left of them; a single node where ruts are left out. (GROUP, ny,
        nx, 2) [m]
    frame : where the nodes of ruts are: x, y of the start, cosine and sine of its heading over the spacing, its column
        and row; and 0 where a step does not look ruts up again, else 1. (7,) [m, m, 1/m, 1/m, -, -, -]
    """

    body: FloatArray
    wheels: FloatArray
    sides: FloatArray
    code: IntArray
    ruts: FloatArray
    frame: FloatArray


def new_work(wheels: int) -> Work:
    """Scratch arrays for a group of rovers with this many wheels, without ruts."""
    return Work(
        aligned(1, BODY.rows * GROUP)[0],
        aligned(wheels, WHEEL.rows * GROUP),
        aligned(2, SYSTEM.rows * GROUP),
        np.zeros(GROUP, dtype=np.int64),
        np.zeros((GROUP, 1, 1, 2)),
        np.ones(7),
    )


def outcome_texts(codes: Iterable[SupportsInt]) -> list[str]:
    """The outcomes among some numbers that are no end as planned, each once, in alphabetical order."""
    return sorted({OUTCOMES[int(code)] for code in codes if code != FINISHED})


@formula
def dot(a: Any, b: Any) -> Any:
    """Scalar product of two triples."""
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


@formula
def cross(a: Any, b: Any) -> Any:
    """Vector product of two triples."""
    return (a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0])


def plus(*terms: Any) -> Any:
    """Sum of triples."""
    return tuple(sum(parts[1:], parts[0]) for parts in zip(*terms, strict=True))


def times(a: Any, factor: Any) -> Any:
    """A triple times a number."""
    return tuple(part * factor for part in a)


def seen_from(axes: Any, v: Any) -> Any:
    """Components of a vector along three axes: M v, from the rows of M."""
    return tuple(dot(axis, v) for axis in axes)
