"""What is held of a soil beforehand: independent normal laws of transformed parameters.

What to ask of numbers that would be likely in another unit. A number is set against the law of what such numbers are,
as it is written and as it would be in other units. Another reading is held for as likely beforehand as one file in a
hundred. Where it is the likelier after all, a question is asked. A number that no unit explains is asked about where it
is rarer than a slip of any size would be.
"""

import math
import tomllib
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from functools import cache
from importlib.resources import files
from typing import Any

import numpy as np

from lunarsci.arrays import FloatArray
from lunarsci.errors import ParameterError, named
from lunarsci.io.documents import toml_of
from lunarsci.io.inputs import InputFile, text
from lunarsci.io.tables import table_hashes
from lunarsci.names import checked_name, one_of
from lunarsci.ranges import FINITE, NOT_NEGATIVE, POSITIVE, check_each, refuse
from lunarsci.regolith.wheel import Wheel

PRIORS = "priors.toml"
"""File beside this one, with a law for each parameter and its source."""
PARAMETERS = (
    "stiffness_kpa_m_n",
    "sinkage_exponent",
    "sinkage_exponent_slip",
    "cohesion_pa",
    "friction_angle_deg",
    "shear_modulus_mm",
    "external_friction_angle_deg",
    "lateral_modulus_mm",
)
"""Of a soil, in the order of arrays of parameters; the unit of each is in `UNITS`."""
CONTACT = ("skid_exponent_slip", "max_stress_c1", "max_stress_c2", "exit_c3")
"""What a contact may have unknown beside its soil: n2 of `ContactModel`, c1-c3 of `Wheel`."""
ROLLING = ("max_stress_c1", "max_stress_c2", "exit_c3", "shearing_radius_ratio")
"""What a rolling wheel may have unknown in the closed form: c1-c3, and r_s as a multiple of `shearing_radius_m`."""
UNITS = dict(zip(PARAMETERS, ("kPa/m^N", "-", "-", "Pa", "deg", "mm", "deg", "mm"), strict=True)) | dict.fromkeys(
    (*CONTACT, *ROLLING), "-"
)
"""Unit of every parameter."""
TRANSFORMS = {
    "ln": POSITIVE,
    "ln tan": "(0, 90)",
    "value": FINITE,
}
"""What a law may be of, and where its median lies."""
DETERMINED = 0.5
"""A parameter counts as determined where its standard deviation is below this share of the prior's; assumed."""
SIGNIFICANCE = 1e-3
"""Level of every test of wheel states, the strictest of Fisher & Yates (1938), Statistical Tables for Biological,
Agricultural and Medical Research."""
STRANGE, NINETY_FIVE = 3.290527, 1.959964
"""Beyond the first a normal law lies, to either side, by a chance of `SIGNIFICANCE`; the second is half of what holds
95 %. [standard deviations]"""
FIXED_SD = 1e-6
"""Standard deviation of the transform of a parameter that is given as exact."""


@dataclass(frozen=True, slots=True)
class Law:
    """Normal law of a parameter's transform.

    Attributes
    ----------
    of : `ln`, `ln tan` (of an angle in deg) or `value`.
    median : of the parameter, in its own unit; above 0 unless `of` is `value`, below 90 deg for angles.
    sd : of the transform, above 0; 0 for a parameter that is known.
    source : where it comes from.

    Raises ParameterError for values out of range.
    """

    of: str
    median: float
    sd: float
    source: str = ""

    def __post_init__(self) -> None:
        checked_name(self.of, TRANSFORMS, "a transform that a prior is of")
        check_each("a prior's", self, {"median": TRANSFORMS[self.of], "sd": NOT_NEGATIVE})

    @property
    def center(self) -> float:
        """Transform of the median."""
        return float(self.transformed(np.array(self.median)))

    @property
    def width(self) -> float:
        """Standard deviation of the transform, above 0."""
        return max(self.sd, FIXED_SD)

    def transformed(self, value: FloatArray) -> FloatArray:
        """From the parameter's unit."""
        if self.of == "ln":
            return np.log(value)
        return np.log(np.tan(np.radians(value))) if self.of == "ln tan" else np.asarray(value, dtype=np.float64)

    def widths_off(self, value: float) -> float:
        """How far a value, above 0 unless `of` is `value`, lies from the median. [standard deviations]"""
        return (float(self.transformed(np.array(value))) - self.center) / self.width

    def ln_density(self, value: float) -> float:
        """Of the transform of a value; minus infinite for one that the parameter cannot have."""
        if self.of != "value" and not 0 < value < (90.0 if self.of == "ln tan" else math.inf):
            return -math.inf
        return -0.5 * self.widths_off(value) ** 2 - math.log(self.width * math.sqrt(2.0 * math.pi))

    def back(self, transform: FloatArray) -> FloatArray:
        """To the parameter's unit."""
        if self.of == "ln":
            return np.exp(transform)
        return np.degrees(np.arctan(np.exp(transform))) if self.of == "ln tan" else np.asarray(transform)


LOAD_PRESSURE_PA = Law("ln", 3000.0, 0.9, "3 kPa of the Lunar Roving Vehicle; width assumed, 68 % span 1.2 to 7.4 kPa")
"""Load of a wheel over its radius times its width: 1.6 kPa of Yutu-2, 3.0 of the Lunar Roving Vehicle (Costes, Farmer &
George 1972, NASA TR R-401), 5.5 of the Mars Exploration Rovers (Lindemann & Voorhees 2005, 10.1109/ICSMC.2005.1571187).
"""


@cache
def _laws(names: tuple[str, ...]) -> Mapping[str, Law]:
    table = tomllib.loads((files(__package__) / PRIORS).read_text("utf-8"))
    return {name: Law(**table[name]) for name in names}


def default_prior() -> Mapping[str, Law]:
    """The laws of `priors.toml`, by parameter in the order of `PARAMETERS`."""
    return _laws(PARAMETERS)


def contact_prior() -> Mapping[str, Law]:
    """The laws of `priors.toml` for the parameters of `CONTACT`, in their order."""
    return _laws(CONTACT)


def rolling_prior(wheel: Wheel) -> dict[str, Law]:
    """The laws for `ROLLING`: about the angles that the wheel's file has, as wide as those of `priors.toml`."""
    return {name: replace(law, median=getattr(wheel, name, law.median)) for name, law in _laws(ROLLING).items()}


def strange(laws: Mapping[str, Law], transforms: FloatArray, sd: FloatArray) -> list[str]:
    """Parameters that no soil or wheel of the priors has, whatever what was found leaves open of them, in sentences.

    `transforms` and their standard deviations `sd` are in the order of `laws`. (p,), (p,)
    """
    width = np.array([law.width for law in laws.values()])
    off = (transforms - np.array([law.center for law in laws.values()])) / width
    return [
        f"{name} is {float(law.back(transforms[k])):.3g}, {abs(off[k]):.1f} standard deviations of its prior from "
        f"{law.median:g}"
        for k, (name, law) in enumerate(laws.items())
        if abs(off[k]) - NINETY_FIVE * sd[k] / width[k] > STRANGE
    ]


def prior_hash() -> dict[str, str]:
    """Name and SHA-256 of the default laws' table."""
    return table_hashes(PRIORS, package=__package__)


def read_prior(source: InputFile, contact: bool = False) -> dict[str, Law]:
    """The default laws with those of a TOML file in their place: a table `of`, `median`, `sd` for each parameter.

    With `contact` also those of `CONTACT`.

    Raises DataError for text that is no TOML, an unknown parameter, or a law out of range.
    """
    document = toml_of(source.name, text(source))
    laws = {**default_prior(), **(contact_prior() if contact else {})}
    with named(source.name):
        refuse(f"'{name}' is not a soil parameter; {one_of(name, laws)}" for name in document if name not in laws)
        for name, table in document.items():
            with named(f"[{name}]", ParameterError):
                laws[name] = Law(**({"of": laws[name].of, "source": source.name} | table))
    return laws


def values_of(
    prior: Mapping[str, Law], transforms: FloatArray, names: tuple[str, ...] = (*PARAMETERS, *CONTACT)
) -> FloatArray:
    """Parameters in their units, the first of `names`, (…, n) from transforms of the same shape."""
    names = names[: transforms.shape[-1]]
    columns = [prior[name].back(transforms[..., k]) for k, name in enumerate(names)]
    return np.stack(columns, axis=-1)


SLIPS = 0.01
"""Odds of another unit, or of a digit too many or too few, before a number is looked at; assumed. A tenth of it moves
where a number is asked about by 0.3 standard deviations of its law where units differ by 1000, by 0.9 where by 10;
`--as-written` asks nothing."""
AS_WRITTEN = "--as-written"
"""The option that takes all numbers as they are."""
DECADES = 6.0
"""From milli to kilo, over which a slip of any size is even in the logarithm. Twice as many move where a number that no
unit explains is asked about by 0.2 standard deviations of its law."""


@dataclass(frozen=True, slots=True)
class Question:
    """A doubt about a number that its user can settle.

    Attributes
    ----------
    quantity, value : as it is written.
    usual : the middle of what such numbers are.
    likely_unit : in which it would be likely; '' where none explains it.
    option : what settles it.
    unitless : whether it is asked because its column names no unit, not because the number is unusual.
    """

    quantity: str
    value: float
    usual: float
    likely_unit: str
    option: str
    unitless: bool = False

    @property
    def doubt(self) -> str:
        """What to ask, without what settles it."""
        likely = f"is it in {self.likely_unit}?" if self.likely_unit else "is it meant so?"
        if self.unitless:
            return f"the column names no unit, and {self.quantity} is {self.value:.3g}; {likely}"
        return f"{self.quantity} is {self.value:.3g}, where about {self.usual:.3g} is usual; {likely}"

    def __str__(self) -> str:
        return f"{self.doubt} ({self.option})"


def asked_in(questions: "Sequence[Question]") -> dict[str, Any]:
    """The key `questions` of a result; nothing where nothing is asked."""
    return {"questions": [asdict(one) for one in questions]} if questions else {}


def question(
    quantity: str, value: float, law: Law, units: Mapping[str, float], option: str = AS_WRITTEN
) -> Question | None:
    """What to ask of a number; None where it is most likely as it is written. 0 has no unit.

    Parameters
    ----------
    law : of what such numbers are.
    units : the others by name, each with the size of one of them in the unit that is meant.
    option : what settles it.
    """
    if not value:
        return None
    plain, readings = law.ln_density(value), {name: law.ln_density(value * size) for name, size in units.items()}
    likely = max(readings, key=lambda name: readings[name], default="")
    explained = bool(likely) and math.log(SLIPS) + readings[likely] > plain
    if not explained and plain > math.log(SLIPS) - math.log(DECADES * math.log(10.0)):
        return None
    return Question(quantity, value, law.median, likely if explained else "", option)
