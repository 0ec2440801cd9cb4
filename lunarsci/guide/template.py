"""Files to begin with: every key of a rover, soil, plan, mission, table of states or other, with its unit and a value.

What stands behind a key is the description of the attribute of the class that the key is read into. A key that may be
left out is written as a comment. The reader of such files takes what is written here as it is.
"""

import dataclasses
import inspect
import json
import re
import textwrap
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, ClassVar

from lunarsci.errors import RequestError
from lunarsci.names import checked_name
from lunarsci.ranges import refuse
from lunarsci.result import Result
from lunarsci.rovers import DEFAULT_ROVER

COMMENT_WIDTH = 110
ATTRIBUTE = re.compile(
    r"^(\w+(?:, \w+)*) : (.+?)(?=^\w+(?:, \w+)* : |^Raises |^\S.*\n-+$|\Z)", re.DOTALL | re.MULTILINE
)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class FileTemplate(Result):
    """A file to begin with: its kind, its name and its text."""

    schema: ClassVar[str] = "template/1"
    kind: str
    name: str
    text: str

    def to_dict(self) -> dict[str, Any]:
        return {"kind": self.kind, "name": self.name, "text": self.text}

    def rows(self) -> Sequence[Mapping[str, Any]]:
        """One a line of the file."""
        return [{"line": line} for line in self.text.splitlines()]


def template(kind: str, rover: str | None = None) -> FileTemplate:
    """A file of a kind, one of `KINDS`, with the wheels of a rover where it has wheels.

    Raises ParameterError for another kind, RequestError for a rover where there are no wheels.
    """
    name, make = KINDS[checked_name(kind, KINDS, "a kind of file")]
    if kind in OF_A_ROVER:
        return FileTemplate(kind=kind, name=name, text=OF_A_ROVER[kind](rover or DEFAULT_ROVER))
    refuse({f"`rover` is of {' and '.join(OF_A_ROVER)}; a {kind} has no wheels": rover is not None}, kind=RequestError)
    return FileTemplate(kind=kind, name=name, text=make())


def described(*classes: type) -> dict[str, str]:
    """What the docstrings of classes say of their attributes, by attribute.

    >>> class Place:
    ...     '''A place.
    ...
    ...     Attributes
    ...     ----------
    ...     x_m, y_m : east and north. [m]
    ...     '''
    >>> described(Place)
    {'x_m': 'east and north. [m]', 'y_m': 'east and north. [m]'}
    """
    texts: dict[str, str] = {}
    for one in classes:
        for names, text in ATTRIBUTE.findall(inspect.getdoc(one) or ""):
            texts |= {name: " ".join(text.split()) for name in names.split(", ") if name not in texts}
    return texts


def _remark(key: str, texts: Mapping[str, str]) -> list[str]:
    """Comment lines on a key: what it is, and its unit."""
    return [f"# {line}" for line in textwrap.wrap(texts.get(key, ""), COMMENT_WIDTH)]


def _line(key: str, value: Any, *, optional: bool = False) -> str:
    return f"{'# ' if optional else ''}{key} = {_toml(value)}"


def _toml(value: Any) -> str:
    if isinstance(value, dict):
        return "{ " + ", ".join(f"{key} = {_toml(one)}" for key, one in value.items()) + " }"
    if isinstance(value, list | tuple):
        return "[" + ", ".join(map(_toml, value)) + "]"
    return json.dumps(value, ensure_ascii=False)


def _block(keys: Mapping[str, Any], texts: Mapping[str, str], optional: Iterable[str] = ()) -> list[str]:
    """Lines of some keys; a remark that holds for several stands above the first."""
    lines: list[str] = []
    before: list[str] = []
    for key, value in keys.items():
        remark = _remark(key, texts)
        lines += [*(remark if remark != before else ()), _line(key, value, optional=key in optional)]
        before = remark
    return lines


def _soil() -> str:
    from lunarsci.regolith.soil import Soil, read_soil, soil_tables

    values = dataclasses.asdict(read_soil("lunar-typical"))
    optional = [field.name for field in dataclasses.fields(Soil) if field.default is not dataclasses.MISSING]
    head = ["# A soil; the numbers are those of `lunar-typical`. Without # are keys that must be given.", ""]
    source = soil_tables()["lunar-typical"]["source"]
    more = {"assumed": ["external_friction_angle_deg"], "source": str(source)}
    texts = described(Soil) | {"assumed": "names of the keys that are guesses", "source": "where the numbers come from"}
    return "\n".join([*head, *_block(values, texts, optional), *_block(more, texts), ""])


def _rover(name: str = "yutu2") -> str:
    from lunarsci.regolith.wheel import Wheel
    from lunarsci.rovers import PLACE_HOLDER, read_rover
    from lunarsci.twin.ground.hazards import Mobility
    from lunarsci.twin.rover import Body, Motors, PowerSupply, Rover

    texts = {
        "wheel": described(Wheel),
        "motors": described(Motors),
        "power": described(PowerSupply),
        "limits": described(Mobility),
        "body": described(Body),
    }
    of_rover = described(Rover)
    of_rover |= {"steered_wheels": of_rover["steered"], "offset_m": of_rover["steering_offset_m"]}
    description = read_rover(name)
    lines = [
        f"# A rover; the numbers are those of {name}, most of them assumed. Each is a value, or a table of value,",
        "# source and assumed. [motors], [power], [limits] and [body] may be left out. `lunarsci info` asks for those",
        f"# whose source still ends in '{PLACE_HOLDER}'.",
        "",
        'name = "my rover"',
    ]
    for table, keys in description.tables.items():
        guessed = [key for key in keys if f"{table}.{key}" in description.assumed]
        entries = {
            key: {"value": value, "source": f"{name}; {PLACE_HOLDER}"} | ({"assumed": True} if key in guessed else {})
            for key, value in keys.items()
        }
        lines += ["", f"[{table}]", *_block(entries, texts.get(table, of_rover))]
    return "\n".join([*lines, ""])


def _plan() -> str:
    from lunarsci.twin.plans.plan import LIMITS_RULE, Fixes, Leg, Plan, read_plan

    texts, embedded = described(Plan), read_plan()
    leg = described(Leg)
    lines = [
        "# A plan: an arc straight ahead, then one to the left. Keys and tables after # may be left out.",
        *_block({"name": "short drive"}, texts),
        "",
        "[start]",
        *_block({"x_m": 0.0, "y_m": 0.0, "heading_deg": 0.0}, texts),
        "",
        "[drive]",
        *_block({"speed_m_s": 0.05, "blend_m": 0.2}, texts),
    ]
    first, second = {"length_m": 1.0}, {"length_m": 0.8, "curvature_per_m": 0.2}
    others: dict[str, Any] = {key: 0.0 for key in leg if key not in second}
    others["wheel_test"] = {"wheel": "FL", "rate_ratio": 0.7}
    lines += ["", "[[leg]]", *_block(first, leg), "# Of an arc, or in its place:", *_block(others, leg, others)]
    lines += ["", "[[leg]]", *_block(second, {"curvature_per_m": leg["curvature_per_m"]})]
    fixes = {"position_sigma_m": 0.05, "heading_sigma_deg": 0.5}
    lines += ["", "# [fixes]", *_block(fixes, described(Fixes), fixes)]
    lines += ["", "# What counts as safe. Without this table the limits are those of the rover that drives:"]
    lines += [
        f"# {LIMITS_RULE}.",
        "# These are Yutu-2's; for another rover take the table out, or write its own.",
        "[limits]",
    ]
    for limit in embedded.limits:
        assumed = {"source": "assumed", "assumed": True}
        entry = {"value": limit.limit} | (assumed if limit.assumed else {"source": limit.source})
        lines += [f"# {limit.sense}, [{limit.unit}]", _line(limit.quantity, entry)]
    lines += [
        "",
        "# [sweep]",
        "# Uncertain parameters of the soil: lowest, highest, number of values.",
        '# friction_angle_deg = "25:55:9"',
    ]
    zone = {"name": "boulder", "x_m": 5.0, "y_m": 5.0, "radius_m": 0.5}
    lines += ["", "# [[keep_out]]", "# A circle that no part of the rover may enter.", *_block(zone, {}, zone), ""]
    return "\n".join(lines)


def _mission() -> str:
    from lunarsci.twin.mission.mission import CommWindow, Mission, MissionStart, MissionTarget
    from lunarsci.twin.plans.plan import Fixes

    texts, target = described(Mission), described(MissionTarget)
    lines = [
        "# A mission: targets in order. Keys and tables after # may be left out.",
        *_block({"name": "two targets", "leg_m": 1.5, "localisation_s": 60.0}, texts),
        *_block({"time_budget_s": 7200.0, "speed_m_s": 0.05}, texts, ("time_budget_s", "speed_m_s")),
        "",
        "[start]",
        *_block({"x_m": 0.0, "y_m": 0.0, "heading_deg": 0.0}, described(MissionStart)),
        "",
        "# Errors of the localisation at the end of each leg.",
        "[fixes]",
        *_block({"position_sigma_m": 0.02, "heading_sigma_deg": 0.5}, described(Fixes)),
    ]
    for name, x, y in (("near", 2.0, 0.2), ("far", 4.0, -0.5)):
        keys = {"name": name, "x_m": x, "y_m": y, "tolerance_m": 0.5, "stay_s": 0.0}
        lines += ["", "[[target]]", *_block(keys, target if name == "near" else {})]
    window, zone = {"begin_s": 0.0, "end_s": 3600.0}, {"name": "boulder", "x_m": 5.0, "y_m": 5.0, "radius_m": 0.5}
    lines += ["", "# [[window]]", "# Hours of communication.", *_block(window, described(CommWindow), window)]
    return "\n".join([*lines, "", "# [[keep_out]]", *_block(zone, {}, zone), ""])


def _craters() -> str:
    from lunarsci.io.tables import table_rows
    from lunarsci.spectra.origin.catalogue import COLUMNS, REQUIRED, TABLE, Crater

    texts = described(Crater)
    texts |= {"age_low_ma": texts["age_ma"], "age_high_ma": texts["age_ma"]}
    lines = [f"# A catalogue of craters: the first two of `{TABLE}`. Only {', '.join(REQUIRED)} must be there;"]
    lines += ["# cells may be empty. Minerals are shares of 1, band centres in nm, _sigma their scatter."]
    lines += [f"# {name}: {texts[name]}" for name in COLUMNS if name in texts]
    rows = [",".join(_cell(row.get(name, "")) for name in COLUMNS) for row in table_rows(TABLE)[:2]]
    return "\n".join([*lines, ",".join(COLUMNS), *rows, ""])


def _cell(text: str) -> str:
    quoted = text.replace('"', '""')
    return f'"{quoted}"' if set(text) & set(',"') else text


def _telemetry(rover: str) -> str:
    """Telemetry of a straight drive at 0.05 m/s, without noise."""
    from lunarsci.twin.rover import build_rover
    from lunarsci.twin.telemetry.reading import POSE_COLUMNS, WHEEL_COLUMNS, Telemetry

    drives, texts, speed = build_rover(rover), described(Telemetry), 0.05
    names, radius = drives.wheels, drives.wheel.radius_m
    per_wheel = {"angle_deg": "angle", "steered_deg": "steered"}
    columns = ["time_s", "x_m", "y_m", "sigma_m", "yaw_deg", "yaw_deg_sigma", "roll_deg", "pitch_deg"]
    wheels = [WHEEL_COLUMNS[name].format(wheel) for name in per_wheel for wheel in names]
    lines = [
        f"# Telemetry of a rover with the wheels {', '.join(names)}: made up, straight ahead without slip or noise.",
        "# time_s may count from elsewhere, such as 1970: `twin states --start-time S` says when the plan began.",
        "# x_m and y_m are blank where there is no position; sigma_m is the standard error of each of them.",
        *(f"# {name}: {texts[name]}" for name in ("time_s", *POSE_COLUMNS)),
        *(f"# {form.format('FL')} and so on: {texts[name]}" for name, form in WHEEL_COLUMNS.items()),
        "# Of the columns of a wheel angle, rate or speed must be there, and steered or steering.",
        ",".join([*columns, *wheels, "synthetic"]),
    ]
    for second in range(0, 61, 2):
        way = speed * second
        place = [f"{way:.3f}", "0.000", "0.010"] if second % 10 == 0 else ["", "", ""]
        angle = f"{way / radius * 57.29577951:.3f}"
        turned = [*[angle] * len(names), *["0.0"] * len(names)]
        lines.append(",".join([f"{second}", *place, "0.0", "0.1", "0.0", "0.0", *turned, "true"]))
    return "\n".join([*lines, ""])


def _states(rover: str) -> str:
    """What the closed form says of a rover's wheel under its share of the weight, over slip."""
    from lunarsci.regolith.jobs.wheel_forces import wheel_forces
    from lunarsci.regolith.states import COLUMNS
    from lunarsci.twin.rover import build_rover

    drives = build_rover(rover)
    load = drives.load_n
    texts = {
        "sinkage_m": "depth of the wheel's lowest point below the undisturbed ground. [m]; down is positive",
        "slip_ratio": "1 - v / (r_s ω) where the wheel drives, r_s ω / v - 1 where it skids. [-1 to 1], not %",
        "side_slip_deg": "angle from the wheel's heading to its velocity. [deg]; 0 where it runs straight",
        "normal_force_n": "of the ground on the wheel, its load. [N]; positive",
        "drawbar_pull_n": "net force of the ground along the heading. [N]; positive where the wheel pulls",
        "lateral_force_n": "of the ground across the heading. [N]; with the sign of the side slip that it acts against",
    }
    lines = [
        f"# Wheel states, a row each: made up, by the closed form, lunar-typical soil, {rover}'s wheel, without noise.",
        "# slip_ratio, side_slip_deg and lateral_force_n may be blank or left out. NAME_sigma is the standard",
        "# deviation of NAME, in its unit; without it the default errors of `lunarsci regolith infer` are taken.",
        *(f"# {name}: {texts[name]}" for name in COLUMNS),
        "# rover: name in its file and size of its wheels; leave it out, and name your rover or wheel with --rover.",
        ",".join([*COLUMNS, "sinkage_m_sigma", "synthetic", "rover"]),
    ]
    for row in wheel_forces(rover=rover, load=float(f"{load:.3g}"), slip="0:0.5:6", side_slip=2.0).rows():
        lines.append(",".join([*(f"{row[name]:.5g}" for name in COLUMNS), "0.0005", "true", row["rover"]]))
    return "\n".join([*lines, ""])


def _prior() -> str:
    from lunarsci.regolith.prior import UNITS, default_prior

    lines = [
        "# Priors of the parameters of a soil: those of the Moon, which hold without a file. Leave out what you keep.",
        "# `of`: what has a normal law: `ln` the logarithm, `ln tan` the logarithm of the tangent, `value` itself.",
        "# `median`: of the parameter, in its unit. `sd`: standard deviation of what `of` names: of a logarithm 0.7 is",
        "# a factor of exp(0.7) = 2 to either side, with 68 %; 0 for a parameter that is known.",
    ]
    for name, law in default_prior().items():
        lines += ["", f"# [{UNITS[name]}]", f"[{name}]", *_block(dataclasses.asdict(law), {})]
    return "\n".join([*lines, ""])


def _rig() -> str:
    from lunarsci.images.camera import INTRINSICS, RELATIVE, Camera, Sensor, StereoRig, vector_of
    from lunarsci.images.rig_files import SENSOR, read_rig

    rig, camera, texts = read_rig("yutu2-navcam"), described(Camera), described(StereoRig) | described(Sensor)
    size = {name: rig.sigmas.get(f"left_{name}", rig.sigmas.get(name, 0.0)) for name in (*INTRINSICS, *RELATIVE)}
    texts |= {"source": "where the numbers are from", "assumed": "names of the keys that are guesses"}
    texts["rotation_rad"] = (
        "from the left camera's frame to the right one's: rotation vector of R in X_right = R X_left + T. [rad]"
    )
    texts["translation_m"] = (
        "T: the left camera's centre in the right one's frame; x is negative, its length is the baseline. [m]"
    )
    known = {"name": "my rig", "source": "calibration of 2026-01-31", "mast_height_m": rig.height_m}
    more = {"nearest_m": rig.nearest_m, "assumed": ["read_noise_e"]} | {key: getattr(rig.sensor, key) for key in SENSOR}
    lines = [
        "# A stereo rig; the numbers are those of yutu2-navcam, most of them assumed. Keys after # may be left out.",
        "# Pixels: u to the right, v down, (0, 0) the centre of the first one. The frame of a camera: x to the right,",
        "# y down, z ahead. Files of OpenCV, ROS and Kalibr are taken as they are, or made into such a file by",
        "# `lunarsci images cameras FILE -o rig.toml`.",
        *_block(known, texts),
        *_block(more, texts, more),
    ]
    for side, one in (("left", rig.left), ("right", rig.right)):
        numbers = {key: getattr(one, key) for key in ("width_px", "height_px", *INTRINSICS)}
        lines += ["", f"[{side}]", *_block(numbers, camera if side == "left" else {}, INTRINSICS[4:])]
    place = {"rotation_rad": vector_of(rig.rotation).tolist(), "translation_m": rig.translation_m.tolist()}
    lines += [
        "",
        "[relative]",
        *_block(place, texts),
        "",
        "# Standard deviations of the calibration, in the units of the",
    ]
    lines += [
        "# keys, of either camera; left_fx_px or right_k1 of one. Without them heights have no common error.",
        "[sigma]",
    ]
    return "\n".join([*lines, *_block({key: one for key, one in size.items() if one}, {}), ""])


def _pose() -> str:
    from lunarsci.images.camera import Pose

    place = Pose.looking([0.0, 0.0, 1.5], 0.0, 25.0).to_dict()
    texts = {"position_m": "of the left camera: x, y and up. [m]", "down_deg": "below the horizon. [deg]"}
    texts |= {"heading_deg": "where it looks, from x towards y. [deg]"}
    texts |= {"roll_deg": "clockwise about its axis, as seen from behind. [deg]"}
    place |= {key: round(place[key], 6) + 0.0 for key in ("heading_deg", "down_deg", "roll_deg")}
    return "\n".join(
        ["# Where the left camera of a rig was; x and y are level.", *_block(place, texts, ["roll_deg"]), ""]
    )


KINDS: Mapping[str, tuple[str, Callable[[], str]]] = {
    "rover": ("rover.toml", _rover),
    "small-four": ("rover.toml", lambda: _rover("small-four")),
    "soil": ("soil.toml", _soil),
    "plan": ("plan.toml", _plan),
    "mission": ("mission.toml", _mission),
    "craters": ("craters.csv", _craters),
    "telemetry": ("telemetry.csv", lambda: _telemetry(DEFAULT_ROVER)),
    "states": ("states.csv", lambda: _states(DEFAULT_ROVER)),
    "prior": ("prior.toml", _prior),
    "rig": ("rig.toml", _rig),
    "pose": ("pose.toml", _pose),
}
"""What there is: the usual name of such a file, and what makes its text."""
OF_A_ROVER: Mapping[str, Callable[[str], str]] = {"telemetry": _telemetry, "states": _states}
"""Of these, what makes the text for the wheels of a rover."""
