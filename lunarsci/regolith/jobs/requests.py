"""What the jobs of this part can be asked: every option with its meaning, its type and its default.

The command line reads it at every start: it imports no module that computes.
"""

from dataclasses import dataclass
from itertools import pairwise
from typing import Literal

from lunarsci.constants import LUNAR_GRAVITY, gravity_of
from lunarsci.errors import RequestError, within_option
from lunarsci.ranges import refuse
from lunarsci.regolith.wheel import DENSITY_KG_M3, Bulldozing, ShearLaw, ShearSign, SlipSinkageLaw

MOST_SLIPS = 10_000


@dataclass(frozen=True, slots=True, kw_only=True)
class WheelForcesRequest:
    """A wheel on a soil.

    Attributes
    ----------
    sinkage : Sinkage in m, above 0, below the wheel radius.
    load : Wheel load in N; the sinkage under it is solved for.
    slip : Slip ratio, -1 (locked) to 1 (no travel); negative is skid; or a curve, FIRST:LAST:N or
        several with commas.
    side_slip : Side slip angle in deg, within ±90.
    rover : Rover or wheel: a name (yutu2, cmu-grouser, hit-smooth, rashid-1, lrv …) or a TOML file.
    soil : Soil: a name or a TOML file.
    stiffness : K_s in kPa m^-N.
    exponent : Sinkage exponent N.
    cohesion : Cohesion c in Pa.
    friction_angle : φ in deg.
    shear_modulus : K_x in mm.
    external_friction_angle : φ_y in deg.
    lateral_modulus : K_y in mm.
    reading : Sign of the shear law: signed agrees with measured wheels; the others only reproduce numbers.
    exact : Integrate the stresses (Eqs 1-17) instead of Eqs 21-24.
    shear : Strength along and across: each its own, or one shared along the velocity or the displacement.
    bulldozing : Soil against the side face, by Hegedus or by passive pressure.
    density : Soil density in kg/m³, for `bulldozing` and Reece's moduli.
    gravity : Gravity: moon, mars, earth, or a number in m/s², for `bulldozing` and Reece's moduli.
    rebound : Share of the sinkage that springs back behind the wheel, 0-1.
    rut : Depth in m to which a wheel before has pressed the soil; needs `reload`.
    reload : Slope of loading in a rut in N/m³, k_0 of Wong's reloading line.
    slip_sinkage : With `load`: how slip deepens the sinkage of a wheel that does not slip.
    reece_cohesive : Reece's k_c'; K_s then follows density and gravity.
    reece_frictional : Reece's k_φ', with k_c'.

    Raises RequestError for options that exclude each other.
    """

    sinkage: float | None = None
    load: float | None = None
    slip: float | str = 0.0
    side_slip: float = 0.0
    rover: str = "yutu2"
    soil: str = "lunar-typical"
    stiffness: float | None = None
    exponent: float | None = None
    cohesion: float | None = None
    friction_angle: float | None = None
    shear_modulus: float | None = None
    external_friction_angle: float | None = None
    lateral_modulus: float | None = None
    reading: ShearSign = "signed"
    exact: bool = False
    shear: ShearLaw = "separate"
    bulldozing: Bulldozing = "none"
    density: float = DENSITY_KG_M3
    gravity: float | str = LUNAR_GRAVITY.value
    rebound: float | None = None
    rut: float = 0.0
    reload: float = 0.0
    slip_sinkage: Literal["none", "lyasko", "linear"] = "none"
    reece_cohesive: float | None = None
    reece_frictional: float | None = None

    def __post_init__(self) -> None:
        faults = {
            "give either `sinkage` or `load`": (self.sinkage is None) == (self.load is None),
            "`slip_sinkage` needs `load`, and a slip of 0 or more; skid has no such law":
                self.slip_sinkage != "none" and (self.load is None or min(self.slips()) < 0),
            "`reece_cohesive` and `reece_frictional` go together; give both":
                (self.reece_cohesive is None) != (self.reece_frictional is None),
            "K_s comes from `stiffness` or from Reece's moduli; give one":
                self.reece_cohesive is not None and self.stiffness is not None,
        }  # fmt: skip
        refuse(faults, kind=RequestError)
        with within_option("gravity"):
            object.__setattr__(self, "gravity", gravity_of(self.gravity))
        if isinstance(self.slip, str) and not {*":,"} & {*self.slip}:
            object.__setattr__(self, "slip", self.slips()[0])

    def slips(self) -> list[float]:
        """Slips that were asked for, in order. Raises RequestError."""
        text = str(self.slip)
        try:
            if ":" in text:
                first, last, count = map(float, text.split(":"))
                if not (2 <= count <= MOST_SLIPS and count == int(count)):
                    raise ValueError
                shares = [k / (int(count) - 1) for k in range(int(count))]
                slips = [first * (1.0 - share) + last * share for share in shares]
            else:
                slips = [*map(float, text.split(","))]
            if len(slips) > MOST_SLIPS or any(not one < two for one, two in pairwise(slips)):
                raise ValueError
        except ValueError as error:
            ways = f"a number, several that grow, with commas, or FIRST:LAST:N with N from 2 to {MOST_SLIPS}"
            raise RequestError(f"`slip` is '{text}'; give {ways}") from error
        return slips

    @property
    def law(self) -> SlipSinkageLaw | None:
        """How slip deepens the sinkage; None for not at all."""
        return None if self.slip_sinkage == "none" else self.slip_sinkage


@dataclass(frozen=True, slots=True, kw_only=True)
class IdentifyRequest:
    """What is assumed, and how errors are drawn.

    Of each pair what is given is assumed and the other is solved for; with both given, each is solved at the other's
    value; with none, the lunar values of `Assumptions` are taken.

    Attributes
    ----------
    rover : Rover or wheel: a name (yutu2, cmu-grouser, hit-smooth, rashid-1, lrv …) or a TOML file; left out, the one
        that the states name, else yutu2.
    exponent : Assume N and solve K_s; 1.0 if neither is given.
    stiffness : Assume K_s in kPa m^-N and solve N.
    cohesion : Assume c in Pa and solve φ; 520 if neither is given.
    friction_angle : Assume φ in deg and solve c.
    shear_modulus : Assumed K_x in mm.
    lateral_modulus : Assume K_y in mm, one or several by commas, and solve φ_y; 13,40 if not given.
    external_friction_angle : Assume φ_y in deg and solve K_y.
    reading : Sign of the shear law: signed agrees with measured wheels; the others only reproduce numbers.
    draws : Monte Carlo draws per state.
    seed : Seed of the random numbers.
    sinkage_error : 1σ of the sinkage, in m.
    force_error : 1σ of the forces, relative.
    travel_error : 1σ of the travelled distance, relative; slip errs by it times 1 - abs(s).
    side_slip_error : 1σ of the side slip, relative.
    sensitivity : How much of each variance comes from each measured quantity.
    units : Units of columns by COLUMN=UNIT with commas between: N, kN, kgf, lbf, of a pull load (its share of the
        load); m, cm, mm; of a slip rim, 1 - v/(r_s ω), travel, r_s ω/v - 1, or %. COLUMN=-1 turns its sign,
        COLUMN=+0.004 adds to it. Several of one column count together.
    """

    rover: str | None = None
    exponent: float | None = None
    stiffness: float | None = None
    cohesion: float | None = None
    friction_angle: float | None = None
    shear_modulus: float = 17.8
    lateral_modulus: str | float | None = None
    external_friction_angle: float | None = None
    reading: ShearSign = "signed"
    draws: int = 1024
    seed: int = 0
    sinkage_error: float = 0.00033
    force_error: float = 0.1 / 3
    travel_error: float = 0.04 / 3
    side_slip_error: float = 0.04 / 3
    sensitivity: bool = False
    units: str = ""


@dataclass(frozen=True, slots=True, kw_only=True)
class InferRequest(IdentifyRequest):
    """What is asked of all states at once, beside what each state gives by itself.

    Attributes
    ----------
    prior : Priors in place of the lunar ones.
    law : Wheel-soil law: as the options say (given), or the one that predicts states left out best, with its scores
        (auto); auto if none of `exact`, `shear`, `bulldozing` and `contact` is given.
    exact : Integrate the stresses instead of Eqs 21-24.
    shear : As in `regolith forces`.
    bulldozing : As in `regolith forces`.
    density : Soil density in kg/m³, for `bulldozing` and `law` auto.
    gravity : Gravity: moon, mars, earth, or a number in m/s², for `bulldozing` and `law` auto.
    contact : Contact angles c1-c3 and the exponent's slope in skid are unknown too; by integration.
    sample : Draw from the posterior itself, not from a normal distribution.
    profile : Intervals by profile: the best of all else at each value.
    model_error : Share of the load by which the model misses a force; found from the residuals if not given.
    predict : Wheel states whose forces the soil predicts: slip_ratio, side_slip_deg, normal_force_n, and where known
        sinkage_m.
    predict_rover : Wheel of `predict`; that of the states if not given.

    Raises RequestError for options that exclude each other.
    """

    prior: str | None = None
    law: Literal["given", "auto"] | None = None
    exact: bool = False
    shear: ShearLaw = "separate"
    bulldozing: Bulldozing = "none"
    density: float = DENSITY_KG_M3
    gravity: float | str = LUNAR_GRAVITY.value
    contact: bool = False
    sample: bool = False
    profile: bool = False
    model_error: float | None = None
    predict: str | None = None
    predict_rover: str | None = None

    def __post_init__(self) -> None:
        faults = {
            "`sample` and `profile` are two ways to the intervals; give one": self.sample and self.profile,
            f"`reading` {self.reading} only reproduces numbers; this needs signed": self.reading != "signed",
            "`law` auto chooses itself; leave out `exact`, `shear`, `bulldozing` and `contact`":
                self.law == "auto" and (self.exact or self.beyond),
        }  # fmt: skip
        refuse(faults, kind=RequestError)
        with within_option("gravity"):
            object.__setattr__(self, "gravity", gravity_of(self.gravity))

    def chooses(self, computed: bool) -> bool:
        """Whether the law is chosen by how it predicts, for forces that were measured or computed of a motion."""
        return self.law == "auto" or (self.law is None and not (self.exact or self.beyond or computed))

    @property
    def beyond(self) -> bool:
        """Whether something is asked for that only the integrals know."""
        return self.shear != "separate" or self.bulldozing != "none" or self.contact


@dataclass(frozen=True, slots=True, kw_only=True)
class CompareSoilsRequest:
    """The site, where it is not a result.

    Attributes
    ----------
    rover : Rover whose wheel sets the width, a name or a TOML file; left out, that of the result, or yutu2.
    stiffness : K_s in kPa m^-N.
    exponent : Sinkage exponent N.
    cohesion : Cohesion c in Pa.
    friction_angle : φ in deg.
    """

    rover: str | None = None
    stiffness: float | None = None
    exponent: float | None = None
    cohesion: float | None = None
    friction_angle: float | None = None

    @property
    def stated(self) -> bool:
        """Whether anything of the site is given."""
        return any(v is not None for v in (self.stiffness, self.exponent, self.cohesion, self.friction_angle))
