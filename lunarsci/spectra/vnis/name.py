"""File names of Chang'E spectrometer products, and what they say."""

import re
from dataclasses import dataclass
from pathlib import Path

from lunarsci.errors import DataError

_NAME = re.compile(
    r"(?P<synthetic>SYNTHETIC_)?(?P<mission>CE\d)[A-Z0-9-]*_[A-Z0-9]+_(?P<instrument>VNIS|LMS)-(?P<kind>[A-Z]+)[A-Z0-9-]*"
    r"_(?P<role>SCI|AUX|CAL)_[A-Z]_(?P<start>\d{14})_(?P<stop>\d{14})_(?P<sequence>\d{4})_(?P<version>[A-Z])"
    r"\.(?P<level>\d[A-Z])(?P<label>L?)",
    re.IGNORECASE,
)


_LONGEST = 255


@dataclass(frozen=True, slots=True)
class ProductName:
    """A name taken apart, letters in upper case.

    Attributes
    ----------
    mission, instrument, kind, role : such as CE4, VNIS, VD (image cube) or SD (short-wave table), SCI or AUX.
    start, stop : session times, 14 digits. sequence : 4 digits, the same for the parts of one observation.
    version : letter of the processing. level : such as 2B. is_label : the detached label rather than the data.
    synthetic : made by `lunarsci spectra simulate`.
    """

    mission: str
    instrument: str
    kind: str
    role: str
    start: str
    stop: str
    sequence: str
    version: str
    level: str
    is_label: bool
    synthetic: bool

    @property
    def is_read(self) -> bool:
        """Whether it is a part of a Chang'E-4 level 2B observation."""
        part = self.role == "SCI" and self.kind in ("VD", "SD")
        return part and (self.mission, self.instrument, self.level) == ("CE4", "VNIS", "2B")

    @property
    def observation(self) -> str:
        """Id of the observation that the product is a part of, such as CE4-0136."""
        return f"{'SYNTHETIC-' if self.synthetic else ''}{self.mission}-{self.sequence}"


def product_name(path: str) -> ProductName | None:
    """The parts of a file's name, whatever the case of its letters; None for other names."""
    name = Path(path).name
    match = _NAME.fullmatch(name) if len(name) <= _LONGEST else None
    if match is None:
        return None
    part = {key: (value or "").upper() for key, value in match.groupdict().items()}
    return ProductName(
        mission=part["mission"],
        instrument=part["instrument"],
        kind=part["kind"],
        role=part["role"],
        start=part["start"],
        stop=part["stop"],
        sequence=part["sequence"],
        version=part["version"],
        level=part["level"],
        is_label=part["label"] == "L",
        synthetic=bool(part["synthetic"]),
    )


def check_supported(name: ProductName, file: str) -> None:
    """Raise DataError, with the reason, for products whose layout is not known well enough to read them."""
    if name.instrument == "LMS":
        why = "the wavelengths of its table are not part of the product and not published with it"
        raise DataError(f"{file}: lunar mineralogical spectrometer (LMS): {why}; convert it to CSV with wavelengths")
    if name.mission != "CE4":
        why = "its attached labels do not describe the data"
        raise DataError(f"{file}: VNIS of {name.mission}: {why}; only Chang'E-4 is read, convert it to CSV")
    if name.level != "2B":
        raise DataError(f"{file}: is level {name.level}, radiance is in level 2B; fetch the file ending in .2B")
    if name.kind not in ("VD", "SD") or name.role == "CAL":
        raise DataError(f"{file}: is the product {name.kind}, not an image cube VD or a table SD; name one of these")
