"""Several rovers in the lanes of the processor's vector instructions: where their numbers lie.

LANES members of an ensemble are driven together. Every quantity is a row of LANES numbers, one for each member;
the rows lie one after the other in flat arrays, at offsets that the compiler knows, so that it can turn a loop over the
members into vector instructions. Such a loop must not touch too many rows (about fifty), or the compiler gives up
proving that they do not overlap; this is why a wheel's part in a step is several loops.
"""

from typing import Any, NamedTuple

import numpy as np

from lunarsci.arrays import FloatArray, IntArray
from lunarsci.compiled import pasted

LANES = 16
"""Members in a group. With fewer the compiler, for the size of the code, would not check that rows do not overlap."""


def rows(*offsets: int) -> tuple[Any, ...]:
    """Offsets as numbers that the compiler folds, but does not compile a function anew for each."""
    return tuple(np.int64(offset) for offset in offsets)


# Rows of `Work.body`: pose (position, quaternion, three joint angles), velocity, rotation by rows, angular velocity in
# the body frame, change of the velocity in a step.
# At last energy [J], power of the rims [W], energy that came from nowhere [J], and how far forces along the wheels are
# from what the steps took them to be, in the mean of the last steps [N].
POSE, SPEED, ROTATION, OMEGA, CHANGE, ENERGY, POWER, EXCESS, ERROR, BODY_ROWS = rows(
    0, 10, 19, 28, 31, 40, 41, 42, 43, 44
)
# Rows of one wheel of `Work.wheels`, vectors in the world frame: centre; its arm from the origin; its velocity per rate
# of the differential and of the bogie; axle; acceleration that remains without generalised acceleration; height and
# gradient of the terrain; soil; then what the contact found.
CENTER, ARM, SWING, BOGIE_SWING, AXLE, ACCELERATION, GROUND, SOIL = rows(0, 3, 6, 9, 12, 15, 18, 21)
SINKAGE, VELOCITY, NORMAL, DRAWBAR, SIDE, RESISTANCE = rows(29, 30, 33, 34, 35, 36)
# Axes of the contact frame; force and moment of wheel and inertia along them; derivatives of the wrench by the forward
# velocity (drawbar, normal, resistance) and by the lateral one (side force, its moments about the first and last axis);
# what normal damping and stiffness add to the matrix, and to the right side. Commands: steering angle, and speed of the
# rim over ground, r_s omega, negative backwards.
AXES, FORCE, MOMENT, ALONG, ACROSS, STIFF, STEER, RIM = rows(37, 46, 49, 52, 55, 58, 60, 61)
# What the contact remembers: the slip ratio that the bearing has taken up; the travel ratio before the rim stood still;
# the speed of the rim in the step before; force and torque along the surface at the end of it, for a wheel that does
# not move, and how they change with its speed. How deep wheels before pressed the ground, and how deep it is still.
# How far the force of a step's end was from what the step had taken it to be.
SLIP, TRAVEL, LAST, HOLD, TWIST, RATE, RUT, MISSED, WHEEL_ROWS = rows(62, 63, 64, 65, 68, 71, 74, 76, 77)
# Rows of `Work.levers`, for coordinates 0 to 6 and the wheel's own bogie: velocity of the wheel centre along the axes
# per rate of the coordinate; the coefficients of its row of the matrix; its right side.
LEVER, COEFFICIENT, DRIVE, LEVER_ROWS = rows(0, 24, 48, 56)
# Rows of one side of `Work.sides`: the 8 x 8 matrix by rows, and the right side. The matrix of the nine coordinates is
# the sum of both sides, the eighth coordinate being each side's own bogie.
MATRIX, RIGHT, SIDE_ROWS = rows(0, 64, 72)
# Numbers of the rows of one side.
FIRST = np.int64(0)


class Work(NamedTuple):
    """Scratch arrays of a group of rovers, so that a step allocates nothing.

    `code` is the outcome of each lane. `ruts` (LANES, ny, nx, 2) has the depths that wheels have pressed and that are
    left of them [m], a single node where ruts are left out; `frame` says where: x, y of the start, cosine and sine of
    its heading over the spacing, its column and row, and 0 where a step does not look ruts up again.
    """

    body: FloatArray
    wheels: FloatArray
    levers: FloatArray
    sides: FloatArray
    code: IntArray
    ruts: FloatArray
    frame: FloatArray


def new_work(wheels: int) -> Work:
    """Scratch arrays for a group of rovers with this many wheels, without ruts."""
    return Work(
        np.zeros(BODY_ROWS * LANES),
        np.zeros((wheels, WHEEL_ROWS * LANES)),
        np.zeros(LEVER_ROWS * LANES),
        np.zeros((2, SIDE_ROWS * LANES)),
        np.zeros(LANES, dtype=np.int64),
        np.zeros((LANES, 1, 1, 2)),
        np.ones(7),
    )


@pasted
def get(rows: Any, k: Any, lane: Any) -> Any:
    """One number."""
    return rows[k * LANES + lane]


@pasted
def get3(rows: Any, k: Any, lane: Any) -> Any:
    """Three numbers in successive rows."""
    return rows[k * LANES + lane], rows[(k + 1) * LANES + lane], rows[(k + 2) * LANES + lane]


@pasted
def put(rows: Any, k: Any, lane: Any, value: Any) -> None:
    """Store one number."""
    rows[k * LANES + lane] = value


@pasted
def put3(rows: Any, k: Any, lane: Any, value: Any) -> None:
    """Store three numbers in successive rows."""
    rows[k * LANES + lane] = value[0]
    rows[(k + 1) * LANES + lane] = value[1]
    rows[(k + 2) * LANES + lane] = value[2]


@pasted
def dot(a: Any, b: Any) -> Any:
    """Scalar product of two triples."""
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


@pasted
def cross(a: Any, b: Any) -> Any:
    """Vector product of two triples."""
    return (a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0])


@pasted
def plus(a: Any, b: Any) -> Any:
    """Sum of two triples."""
    return (a[0] + b[0], a[1] + b[1], a[2] + b[2])


@pasted
def times(a: Any, factor: Any) -> Any:
    """A triple times a number."""
    return (a[0] * factor, a[1] * factor, a[2] * factor)
