"""Whether what a label says of time, place and Sun can be true together, and fits the name of its file.

The Sun's direction depends on nothing but time and place: an angle, a year, a hemisphere that is wrong shows, whatever
else agrees with it. What shows nowhere: a time off by whole synodic months (29.5 days), which moves the Sun by a degree
or two and changes its distance by up to 3 %, where names, labels and tables agree on it.
"""

import math
from datetime import UTC, datetime, timedelta

from lunarsci.errors import DataError
from lunarsci.spectra.vnis.label import Label
from lunarsci.sun import sun_incidence_deg

LANDING_SITE = (177.5991, -45.4446)
"""Longitude and latitude of Chang'E-4, Liu et al. (2019), Nat. Commun. 10, 4229, 10.1038/s41467-019-12278-3, for labels
without a place of the rover; it has stayed within 0.1 deg. [deg]"""
SUN_DEG, WRONG_SUN_DEG = 0.3, 3.0
"""An incidence further than the first from the Sun's is in doubt, than the second is wrong: the two labels of
observation 136 agree with the Sun to 0.01 deg, which moves by 0.5 deg in an hour. 0.3 deg change the reflectance by 1 %
at 64 deg and by 2 % at 77 deg. Assumed. [deg]"""
_SESSION_SLACK = timedelta(minutes=10)
_WRONG_SESSION = timedelta(days=1)
"""A product's name has the times of the session that it was measured in; the one public observation whose times are
known lies within it. Slack and what is wrong are assumed."""


def doubts_of(label: Label) -> list[str]:
    """Why a label cannot be trusted, one sentence each; none for a sound one.

    Raises DataError where Sun or session are so far off that time, place or angles must be wrong.
    """
    return [doubt for doubt in (_of_sun(label), _of_session(label)) if doubt]


def _of_sun(label: Label) -> str:
    stated = label.geometry.incidence_deg
    known = math.isfinite(label.longitude_deg) and math.isfinite(label.latitude_deg)
    place = (label.longitude_deg, label.latitude_deg) if known else LANDING_SITE
    found = sun_incidence_deg(label.start + (label.stop - label.start) / 2, *place)
    if abs(stated - found) <= SUN_DEG:
        return ""
    says = f"{label.file}: states the Sun {stated:.2f} deg from the vertical; then and there it stood {found:.2f} deg"
    if abs(stated - found) > WRONG_SUN_DEG:
        raise DataError(f"{says}: angle, time or place is wrong, fetch the label again")
    return f"{says} from it"


def _of_session(label: Label) -> str:
    try:
        first, last = (
            datetime.strptime(text, "%Y%m%d%H%M%S").replace(tzinfo=UTC) for text in (label.name.start, label.name.stop)
        )
    except ValueError:
        return f"{label.file}: its name has {label.name.start} to {label.name.stop}, which are no times"
    outside = max(first - label.start, label.stop - last)
    if outside <= _SESSION_SLACK:
        return ""
    says = f"{label.file}: was measured at {label.start:%Y-%m-%dT%H:%M}, outside the {first:%Y-%m-%dT%H:%M} to "
    says += f"{last:%Y-%m-%dT%H:%M} of its name"
    if outside > _WRONG_SESSION:
        raise DataError(f"{says}; it belongs to another observation, or a time is wrong, fetch it again")
    return says
