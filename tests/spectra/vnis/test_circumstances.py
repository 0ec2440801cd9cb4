"""The Sun over the rover, sessions, and gains beside each other."""

import math
from dataclasses import replace
from datetime import UTC, datetime, timedelta

import pytest

from lunarsci.errors import DataError
from lunarsci.spectra.photometry import Geometry
from lunarsci.spectra.vnis.label import Label, product_name
from lunarsci.spectra.vnis.observation import LANDING_SITE, SUN_DEG, doubts_of
from lunarsci.spectra.vnis.splice import usual_gains
from lunarsci.sun import sun_in_moon_frame, sun_incidence_deg

NAME = "CE4_GRAS_VNIS-SD_SCI_N_20200716031001_20200716100000_0136_B.2BL"


def label(incidence_deg: float = 64.445, start: datetime = datetime(2020, 7, 16, 8, 17, 4, tzinfo=UTC)) -> Label:
    name = product_name(NAME)
    assert name is not None
    geometry = Geometry(incidence_deg, 45.557, 54.505)
    return Label(NAME, name, 2.0, start, start + timedelta(minutes=6), geometry, -45.4446, 177.585, ())


def test_the_public_labels_of_observation_136_agree_with_the_sun() -> None:
    """64.445 deg in the label of the short-wave scan, 64.412 in that of the images, which follow it."""
    start = datetime(2020, 7, 16, 8, 17, 4, tzinfo=UTC)
    assert sun_incidence_deg(start, 177.585, -45.4446) == pytest.approx(64.445, abs=0.01)
    assert sun_incidence_deg(start + timedelta(minutes=7), 177.585, -45.4446) == pytest.approx(64.412, abs=0.01)
    assert doubts_of(label()) == []


def test_at_an_eclipse_the_sun_stands_over_the_near_or_the_far_side() -> None:
    assert sun_in_moon_frame(datetime(2019, 1, 21, 5, 16, tzinfo=UTC))[0] > 0.99  # a lunar one
    assert sun_in_moon_frame(datetime(2017, 8, 21, 18, 26, tzinfo=UTC))[0] < -0.99


@pytest.mark.parametrize("hours", [-2.0, 2.0, 8.0])
def test_hours_are_doubted(hours: float) -> None:
    moved = label(start=datetime(2020, 7, 16, 8, 17, 4, tzinfo=UTC) + timedelta(hours=hours))
    assert "from the vertical; then and there it stood" in doubts_of(moved)[0]


def test_what_is_far_off_is_refused() -> None:
    for spoilt in (label(45.557), label(start=datetime(2019, 7, 16, 8, 17, 4, tzinfo=UTC))):
        with pytest.raises(DataError, match="angle, time or place is wrong"):
            doubts_of(spoilt)


def test_a_label_without_a_place_is_looked_at_from_the_landing_site() -> None:
    unplaced = replace(label(), latitude_deg=math.nan, longitude_deg=math.nan)
    assert doubts_of(unplaced) == []
    assert abs(sun_incidence_deg(unplaced.start, *LANDING_SITE) - 64.445) < SUN_DEG / 10


def test_a_month_later_is_refused_by_the_session() -> None:
    later = label(66.2, datetime(2020, 8, 14, 21, 0, tzinfo=UTC))
    found = sun_incidence_deg(later.start, 177.585, -45.4446)
    with pytest.raises(DataError, match="outside the 2020-07-16T03:10 to 2020-07-16T10:00 of its name"):
        doubts_of(label(found, later.start))


def test_a_gain_unlike_the_others() -> None:
    assert usual_gains([0.98, 0.99, 0.97, 0.98, 0.88]) == [None, None, None, None, 0.98]
    assert usual_gains([0.98, 0.99, 0.97, 0.88]) == [None] * 4  # too few
    assert usual_gains([0.90, 0.95, 1.0, 1.05, 1.10]) == [None] * 5  # all differ
