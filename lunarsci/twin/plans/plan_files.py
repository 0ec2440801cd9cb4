"""Plans as TOML files."""

import json
from pathlib import Path

from lunarsci.errors import DataError, OutputError, ParameterError
from lunarsci.io.documents import toml_of
from lunarsci.io.inputs import Source, read_input
from lunarsci.twin.plans.limits import Limit, parse_limit
from lunarsci.twin.plans.plan import Leg, Plan


def plan_text(plan: Plan) -> str:
    """The TOML text that `read_plan` reads back as the same plan, but for `origin`."""
    lines = [
        f"name = {_quoted(plan.name)}",
        *([f"crs = {_quoted(plan.crs)}"] if plan.crs else []),
        *_maker_lines(plan),
        "",
        "[start]",
        *(f"{name} = {float(getattr(plan, name))!r}" for name in ("x_m", "y_m", "heading_deg")),
        "",
        "[drive]",
        *(f"{name} = {float(getattr(plan, name))!r}" for name in ("speed_m_s", "blend_m")),
        *([] if plan.accepted_risk is None else [f"accepted_risk = {float(plan.accepted_risk)!r}"]),
    ]
    for leg in plan.legs:
        values = ((name, float(getattr(leg, name))) for name in Leg.__slots__ if name != "wheel_test")
        lines += ["", "[[leg]]", *(f"{name} = {value!r}" for name, value in values if value)]
        if (test := leg.wheel_test) is not None:
            ratio = float(test.rate_ratio)
            lines.append(f"wheel_test = {{ wheel = {_quoted(test.wheel)}, rate_ratio = {ratio!r} }}")
    if plan.fixes is not None:
        names = ("position_sigma_m", "heading_sigma_deg", *(("halt_s",) if plan.fixes.halt_s else ()))
        lines += ["", "[fixes]", *(f"{name} = {float(getattr(plan.fixes, name))!r}" for name in names)]
    for circle in plan.exclusion_zones:
        places = (f"{name} = {float(getattr(circle, name))!r}" for name in ("x_m", "y_m", "radius_m"))
        lines += ["", "[[keep_out]]", f"name = {_quoted(circle.name)}", *places]
    lines += ["", "[limits]"]
    for limit in plan.limits:
        source, assumed = _quoted(limit.source), "true" if limit.assumed else "false"
        lines.append(f"{limit.quantity} = {{ value = {limit.limit!r}, assumed = {assumed}, source = {source} }}")
    lines += ["", "[sweep]"]
    lines += [f"{sweep.name} = {_quoted(_range(sweep.low, sweep.high, sweep.count))}" for sweep in plan.sweep]
    return "\n".join(lines) + "\n"


def read_limits(source: Source) -> tuple[Limit, ...]:
    """The [limits] of a TOML file, which may be a plan. Raises DataError, also for one without any."""
    file = read_input(source)
    try:
        table = toml_of(file.name, file.data).get("limits")
        if not isinstance(table, dict) or not table:
            raise ParameterError("no [limits] in it; write quantities and their limits there, as endpoint_miss_m = 0.5")
        if "keep_out_m" in table:
            raise ParameterError("limit keep_out_m is of the circles of one plan; leave it out, or make these wider")
        return tuple(parse_limit(quantity, entry, file.name) for quantity, entry in table.items())
    except ParameterError as error:
        raise DataError(f"{file.name}: {error}") from error


def write_plan(plan: Plan, path: str | Path) -> None:
    """Write a plan as `read_plan` reads it. Raises OutputError."""
    try:
        Path(path).write_text(plan_text(plan), "utf-8")
    except OSError as error:
        raise OutputError(f"{path}: {error.strerror}") from error


def _maker_lines(plan: Plan) -> list[str]:
    if plan.made_for is None:
        return []
    table = plan.made_for.to_table().items()
    rows = (f"{name} = {_quoted(value) if isinstance(value, str) else repr(float(value))}" for name, value in table)
    return ["", "[made_for]", *rows]


def _range(low: float, high: float, count: int) -> str:
    return f"{float(low)!r}:{float(high)!r}:{count}"


def _quoted(text: str) -> str:
    # The escapes of JSON are among those of TOML, which also forbids a bare delete character.
    return json.dumps(text, ensure_ascii=False).replace("\x7f", "\\u007f")
