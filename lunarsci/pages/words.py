"""Numbers and keys of results as people read them."""

import math
from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, TypeAlias, TypeVar

from lunarsci.figure import FIRST_PAGE
from lunarsci.names import counted
from lunarsci.units import ENDS, unit_of

ASTROPY = {"pix": "px", "m2": "m²", "1 / m": "1/m", "deg / s": "°/s", "m / s": "m/s", "deg": "°", "N m": "N m"}
LARGE = 1e9
"""Numbers below it are written without an exponent."""
NAMES = {
    "exponent": "sinkage exponent N",
    "bc1000_nm": "centre of the 1 µm band [nm]",
    "bc2000_nm": "centre of the 2 µm band [nm]",
    "bd1000": "depth of the 1 µm band",
    "bd2000": "depth of the 2 µm band",
    "ba1000_nm": "area of the 1 µm band [nm]",
    "ba2000_nm": "area of the 2 µm band [nm]",
    "bas1000": "asymmetry of the 1 µm band",
    "bas2000": "asymmetry of the 2 µm band",
    "center_nm": "centre [nm]",
    "fwhm_nm": "full width at half maximum [nm]",
    "strength": "strength [ln R]",
    "opx": "share of orthopyroxene in the strength of the pyroxene bands",
    "cpx": "share of clinopyroxene in the strength of the pyroxene bands",
    "nbsr": "ratio of band strengths",
    "rms_ln": "residual, root mean square [ln R]",
    "reduced_chi2": "reduced chi-square",
    "bic": "Bayesian information criterion",
    "left_of_prior": "range now, as a share of that before any drive",
    "covering_radius_m": "all drives end within, of the destination [m]",
    "scatter_radius_m": "drives end within, of their middle [m]",
    "p05": "5 %",
    "p50": "median",
    "p95": "95 %",
    "kept_by_95": "95 % of drives",
    "feo_lucey_wt": "FeO, Clementine [wt %]",
    "feo_zhang_wt": "FeO, M3 [wt %]",
    "tio2_lucey_wt": "TiO2, Clementine [wt %]",
    "stiffness_kpa_m_n": "stiffness K_s [kPa/m^N]",
    "sinkage_exponent": "sinkage exponent N",
    "sinkage_exponent_slip": "sinkage exponent with slip n₁",
    "cohesion_pa": "cohesion c [Pa]",
    "friction_angle_deg": "internal friction angle φ [°]",
    "shear_modulus_mm": "shear modulus K_x [mm]",
    "external_friction_angle_deg": "external friction angle φ_y [°]",
    "lateral_modulus_mm": "lateral shear modulus K_y [mm]",
    "slip_ratio": "slip ratio",
    "side_slip_deg": "side slip [°]",
    "sinkage_m": "sinkage [m]",
    "tilt_deg": "tilt [°]",
    "clearance_m": "ground clearance [m]",
    "endpoint_miss_m": "distance from the destination [m]",
    "normal_force_n": "normal force [N]",
    "drawbar_pull_n": "drawbar pull [N]",
    "lateral_force_n": "lateral force [N]",
    "resistance_torque_nm": "resistance torque [N m]",
    "um1": "1 µm",
    "um2": "2 µm",
}


def unit(key: str) -> str:
    """The unit of a key, as it is printed; '' where it names none."""
    name = unit_of(key)
    return ASTROPY.get(name, name)


def words(key: str) -> str:
    """A key in words, its unit in brackets.

    >>> words("center_nm"), words("slip_ratio"), words("result.rover_id")
    ('centre [nm]', 'slip ratio', 'result, rover id')
    """
    if key in NAMES:
        return NAMES[key]
    bare, symbol = key, unit(key)
    if symbol:
        end = next((one for one in ENDS if key.endswith(one)), "")
        bare = key.removesuffix(end).rpartition("_")[0] + end
    plain = (bare or key).replace("_", " ").replace(".", ", ")
    return f"{plain} [{symbol}]" if symbol and bare else plain


def quantity(key: str) -> str:
    """A key in words without its unit."""
    return words(key).partition(" [")[0]


def number(value: Any, digits: int = 4) -> str:
    """A number with so many digits; what is no number as it is, nothing as `not determined`."""
    if value is None:
        return "not determined"
    if isinstance(value, bool):
        return "yes" if value else "no"
    if isinstance(value, int):
        return str(value)
    if not isinstance(value, float):
        return str(value)
    if math.isnan(value):
        return "not determined"
    if 10**digits <= abs(value) < LARGE:
        return f"{value:.0f}"
    return f"{value:.{digits}g}".replace("e-0", "e-").replace("e+0", "e")


def measured(
    value: Any, sigma: Any = None, symbol: str = "", within: tuple[float, float] = (-math.inf, math.inf)
) -> str:
    """A value with its error, both to the error's second digit; `within` are the lowest and the highest that can be.

    >>> measured(943.84, 2.72, "nm"), measured(0.47381, 0.17), measured(0.5, 3.0, within=(0, 1))
    ('943.8 ± 2.7 nm', '0.47 ± 0.17', 'not determined')
    """
    low, high = within
    if isinstance(value, int | float) and not low <= value <= high:
        return number(None)
    if isinstance(sigma, int | float) and sigma > high - low:
        return number(None)
    after = f"\u202f{symbol}" if symbol == "°" else f" {symbol}" if symbol else ""
    if not isinstance(value, int | float) or isinstance(value, bool):
        return number(value)
    if not isinstance(sigma, int | float) or not math.isfinite(sigma) or sigma <= 0:
        return f"{number(float(value), 3)}{after}"
    places = 1 - math.floor(math.log10(sigma))
    shown = [f"{round(one, places):.{max(places, 0)}f}" for one in (float(value), float(sigma))]
    return f"{shown[0]} ± {shown[1]}{after}"


def percent(share: Any) -> str:
    """A share of one in percent, coarse enough to be read aloud."""
    if not isinstance(share, int | float):
        return "an unknown share"
    whole = 100 * share
    return f"{whole:.0f} %" if whole == 0 or whole >= 1 else f"{whole:.1g} %"


GO, STOP, DOUBT, PLAIN = "go", "no-go", "doubt", "plain"
"""Tones of an answer, see `ResultAnswer`."""
MOST = 4
"""Spectra, rocks or designs that are answered one by one; of more the kinds of answers are counted."""
Result: TypeAlias = Mapping[str, Any]
Answer = TypeVar("Answer", bound="Callable[[Result], ResultAnswer]")


@dataclass(frozen=True, slots=True)
class ResultAnswer:
    """What was found.

    Attributes
    ----------
    text : sentences.
    tone : `go`, `no-go`, `doubt` where the command says that it should not be trusted, else `plain`.
    trust : a sentence on that, in the command's own words.
    """

    text: str
    tone: str = PLAIN
    trust: str = ""


@dataclass(frozen=True, slots=True)
class AnsweredKind:
    """How results of a kind are answered on a page.

    Attributes
    ----------
    title : what they are called.
    answer : makes the answer of one, from its parsed `result`.
    """

    title: str
    answer: Callable[[Result], ResultAnswer]


ANSWERED: dict[str, AnsweredKind] = {}
"""By the schema of a result without its version; `answers` fills it."""


def answers(title: str, *kinds: str) -> Callable[[Answer], Answer]:
    """Give results of these kinds a title and, by the function that follows, their answer on a page."""

    def register(function: Answer) -> Answer:
        ANSWERED.update(dict.fromkeys(kinds, AnsweredKind(title, function)))
        return function

    return register


def each(
    items: Sequence[Result], sentence: Callable[[Result], str], thing: str, short: Callable[[Result], str] | None = None
) -> str:
    """A sentence for each; of more than a few how many have which `short` answer, or the sentences of the first."""
    if len(items) > MOST and short is not None:
        counts = Counter(short(item) for item in items)
        kinds = [
            f"{count} of them: {text}{'' if text.endswith('?') else '.'}" for text, count in counts.most_common(MOST)
        ]
        others = counts.total() - sum(count for _, count in counts.most_common(MOST))
        more = [f"{others} of them: other answers."] if others else []
        return " ".join([f"{counted(len(items), thing)}.", *kinds, *more])
    one_by_one = [sentence(item) for item in items[:MOST]]
    rest = [f"{counted(len(items), thing)} in all, those after the first {MOST} below."] if len(items) > MOST else []
    return " ".join([*one_by_one, *rest]) or f"No {thing}."


def sentence(text: str) -> str:
    """Text of a command with a capital letter and a full stop, where it does not ask.

    >>> sentence("no-go: too steep"), sentence("is it in km?")
    ('No-go: too steep.', 'Is it in km?')
    """
    return f"{text[:1].upper()}{text[1:].rstrip('.')}{'' if text.endswith('?') else '.'}" if text else ""


FORMER_PAGE = "holds the first page only; a .pdf holds all"
"""What results of former versions say in place of `FIRST_PAGE`."""


def of_first_page(text: object) -> bool:
    """Whether a warning is about a picture that has the first of several pages."""
    return FIRST_PAGE in str(text) or str(text).endswith(FORMER_PAGE)


def heard_of(record: Mapping[str, Any]) -> list[str]:
    """Warnings about a result: those about the pages of its picture say nothing of it."""
    return [str(text) for text in record.get("warnings") or () if not of_first_page(text)]


def trust(record: Mapping[str, Any], caution: str = "") -> tuple[bool, str]:
    """Whether the command that made a result trusts it, and what it says, from its provenance and a `caution`.

    Inputs that gave no result are said, and are nothing against the results of the others.
    """
    lines = [sentence(str(record["untrusted"]))] if record.get("untrusted") else []
    failed = record.get("failures") or []
    if failed:
        more = f" (and {len(failed) - 1} more)" if len(failed) > 1 else ""
        lines.append(f"{counted(len(failed), 'input')} gave no result: {str(failed[0]).rstrip('.')}{more}.")
    if lines:
        return not record.get("untrusted"), " ".join(lines)
    if "untrusted" not in record:
        return True, "The file does not say whether its command trusts it, as it is of an older version; make it anew."
    heard = heard_of(record)
    warned = f"; read its {counted(len(heard), 'warning')}" if heard else ""
    if caution:
        return True, f"The result may be used, but the command warns: {caution.rstrip('.')}."
    return True, f"No check speaks against this result{warned}."
