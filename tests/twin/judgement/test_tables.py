"""Profiles against distance, and the pages that draw them."""

import dataclasses

import numpy as np
import pandas as pd
import pytest

from lunarsci.errors import ParameterError
from lunarsci.twin.figures.prediction import box_pages, grouped, path_fan, profile_page
from lunarsci.twin.ground.hazards import ExclusionZone
from lunarsci.twin.judgement.quantities import abscissa, along
from lunarsci.twin.judgement.safety import judge
from lunarsci.twin.judgement.tables import drive_layers, path_table, profile_table, state_table
from lunarsci.twin.plans.plan import Limit, rover_limits
from lunarsci.twin.simulation.ensemble import Prediction


@pytest.fixture(scope="module")
def uneven(driven: Prediction) -> Prediction:
    """Some drives that stopped on the way, and a circle to keep out of."""
    recorded = driven.recorded.copy()
    recorded[:3] = 4, 7, 0
    plan = dataclasses.replace(driven.plan, exclusion_zones=(ExclusionZone("rock", 0.5, 1.5, 0.3),))
    return dataclasses.replace(driven, recorded=recorded, plan=plan)


def summary(groups: "pd.api.typing.SeriesGroupBy") -> pd.DataFrame:  # type: ignore[type-arg]
    quantiles = {name: groups.quantile(q) for name, q in (("p05", 0.05), ("p50", 0.5), ("p95", 0.95))}
    return pd.DataFrame({**quantiles, "min": groups.min(), "max": groups.max()})


def test_the_table_is_what_pandas_makes_of_states_and_paths(uneven: Prediction) -> None:
    table = profile_table(uneven).set_index(["quantity", "wheel", "distance_m"]).sort_index()
    states, paths = state_table(uneven), path_table(uneven)
    columns = ["p05", "p50", "p95", "min", "max"]
    for quantity in ("normal_force_n", "slip_ratio", "side_slip_deg", "sinkage_m"):
        truth = summary(states.groupby("distance_m")[quantity])
        assert np.allclose(table.loc[(quantity, "all"), columns], truth[columns], rtol=1e-12)
        truth = summary(states[states["wheel"] == "MR"].groupby("distance_m")[quantity])
        assert np.allclose(table.loc[(quantity, "MR"), columns], truth[columns], rtol=1e-12)
    for quantity in ("roll_deg", "pitch_deg"):
        truth = summary(paths.groupby("distance_m")[quantity])
        assert np.allclose(table.loc[(quantity, ""), columns], truth[columns], rtol=1e-12)


def test_the_layers_are_the_tables_by_member_time_and_wheel(uneven: Prediction) -> None:
    layers, states, paths = drive_layers(uneven), state_table(uneven), path_table(uneven)
    count = len(uneven.rover.wheels)
    for name in ("sinkage_m", "slip_ratio", "valid"):
        axes, values = layers[name]
        assert axes == ("member", "time_s", "wheel") and values.shape[:2] == uneven.reached.shape
        assert np.array_equal(values[uneven.reached].ravel(), states[name])
    assert np.array_equal(layers["x_m"][1][uneven.reached], paths["x_m"])
    assert np.array_equal(layers["wheel_x_m"][1][uneven.reached].ravel(), states["x_m"])
    assert np.isnan(layers["slip_ratio"][1][~uneven.reached]).all() and not layers["valid"][1][~uneven.reached].any()
    assert len(layers["wheel"][1]) == count and list(layers["time_s"][1]) == list(uneven.time_s)


def test_the_table_has_every_quantity_with_its_unit(uneven: Prediction) -> None:
    table = profile_table(uneven)
    assert list(table.columns) == [
        *("distance_m", "time_s", "quantity", "wheel", "p05", "p50", "p95", "min", "max", "unit")
    ]
    units = dict(zip(table["quantity"], table["unit"], strict=True))
    assert units == {
        **{"tilt_deg": "deg", "roll_deg": "deg", "pitch_deg": "deg", "clearance_m": "m", "keep_out_m": "m"},
        **{"miss_m": "m", "normal_force_n": "N", "slip_ratio": "-", "side_slip_deg": "deg", "sinkage_m": "m"},
    }
    assert len(table) == 11 * (6 + 4 * 7) and (table["p05"] <= table["p95"]).all()
    bare = dataclasses.replace(uneven, rover=dataclasses.replace(uneven.rover, body=None))
    bare = dataclasses.replace(bare, plan=dataclasses.replace(bare.plan, exclusion_zones=()))
    assert not {"clearance_m", "keep_out_m"} & set(profile_table(bare)["quantity"])


def test_the_miss_along_the_drive_ends_in_that_of_the_end(driven: Prediction) -> None:
    assert along(driven, "miss_m")[:, -1] == pytest.approx(driven.miss_m)
    assert along(driven, "miss_m")[:, 0] == pytest.approx(0.0, abs=1e-9)
    with pytest.raises(ParameterError, match="colour"):
        along(driven, "colour")


def test_a_rover_that_waits_is_drawn_against_time(driven: Prediction) -> None:
    assert abscissa(driven)[1] == "commanded distance [m]"
    standing = dataclasses.replace(driven, distance_m=np.repeat(driven.distance_m[::2], 2)[:11])
    assert abscissa(standing)[1] == "time [s]"
    profile_page(standing, judge(driven)).canvas.draw()


def test_the_page_has_units_and_limits(uneven: Prediction) -> None:
    miss = Limit("endpoint_miss_m", "m", 1.0, "test", False)
    figure = profile_page(uneven, judge(uneven, dataclasses.replace(uneven.plan, limits=(miss,))))
    figure.canvas.draw()
    assert len(figure.axes) == 7 and all("[" in axes.get_ylabel() for axes in figure.axes)
    titles = [axes.get_title(loc="right") for axes in figure.axes]
    own = {one.quantity: f"{one.limit:g}" for one in rover_limits(uneven.rover)}
    assert titles[0] == f"limit {own['tilt_deg']} °" and titles[3] == "limit at the end 1 m"
    assert titles[5] == "limit at least 0 m" and titles[-1] == ""
    loads = figure.subfigs[1].legends[0]
    assert [text.get_text() for text in loads.get_texts()] == ["FL", "FR", "ML", "MR", "RL", "RR"]


def test_the_ends_are_drawn_with_their_ellipses(uneven: Prediction) -> None:
    from matplotlib.patches import Circle, Ellipse

    verdict = judge(uneven)
    figure = path_fan(uneven, verdict)
    figure.canvas.draw()
    ends = figure.axes[1]
    rings = [p for p in ends.patches if isinstance(p, Ellipse) and not isinstance(p, Circle)]
    sigma = verdict.endpoint.ellipse.semi_major_m
    assert sorted(ring.width / 2 / sigma for ring in rings) == pytest.approx([1.0, 2.0, 2.4477, 3.0], abs=1e-4)
    assert {ring.angle for ring in rings} == {verdict.endpoint.ellipse.azimuth_deg}
    circles = [p for p in figure.axes[0].patches if isinstance(p, Circle)]
    assert circles and all((c.center, c.radius) == ((0.5, 1.5), 0.3) for c in circles)


def test_boxes_take_each_value_of_a_grid_and_equal_shares_of_samples() -> None:
    grid = np.repeat([25.0, 40.0, 55.0], 7)
    assert [(value, int(members.sum())) for value, members in grouped(grid)] == [(25.0, 7), (40.0, 7), (55.0, 7)]
    samples = np.random.default_rng(1).permutation(np.arange(80.0))
    shares = grouped(samples)
    assert [int(members.sum()) for _, members in shares] == [10] * 8
    assert [value for value, _ in shares] == pytest.approx([4.5 + 10 * k for k in range(8)])
    assert all(
        set(samples[members]) == set(np.arange(10.0 * k, 10.0 * k + 10)) for k, (_, members) in enumerate(shares)
    )


def test_box_pages_have_three_parameters_each(driven: Prediction) -> None:
    names = ("friction_angle_deg", "lateral_modulus_mm", "cohesion_pa", "shear_modulus_mm")
    values = np.linspace(20.0, 40.0, 20)
    many = dataclasses.replace(driven, parameters={name: np.roll(values, k) for k, name in enumerate(names)})
    pages = list(box_pages(many))
    assert [len(page.axes) for page in pages] == [9, 3]
    labels = [axes.get_xlabel() for page in pages for axes in page.axes]
    assert all("[" in label and "eighth" in label for label in labels)
    assert list(box_pages(dataclasses.replace(driven, parameters={}))) == []
    for page in pages:
        page.canvas.draw()
