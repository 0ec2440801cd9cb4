"""What `lunarsci reproduce` can be asked."""

from dataclasses import dataclass
from typing import Literal

from lunarsci.errors import RequestError
from lunarsci.ranges import refuse

WORK = {"spectra": 5, "soil": 4, "drive": 2}
"""Rough share of the time, for progress."""


@dataclass(frozen=True, slots=True, kw_only=True)
class ReproduceRequest:
    """Which part, rock being another name of spectra; measured spectra of boulders; a rover's name or file.

    Attributes
    ----------
    part : Which of the numbers, and of the pages of --plot; rock is another name of spectra.
    rocks : Measured spectra of boulders of Chang'E-4, in any form that `spectra fit` reads; of files with other targets
        too, those with 'rock' in their name. May be repeated.
    rover : Rover that drives, and whose wheel is taken: a name or a TOML file.
    """

    part: Literal["all", "spectra", "rock", "soil", "drive"] = "all"
    rocks: tuple[str, ...] = ()
    rover: str | None = None

    def __post_init__(self) -> None:
        faults = {
            f"`rover` has no use with `part` {self.part}, where nothing drives; leave it out":
                self.parts == ("spectra",) and self.rover is not None,
            f"`rocks` has no use with `part` {self.part}; give `part` spectra, or leave it out":
                bool(self.rocks) and "spectra" not in self.parts,
        }  # fmt: skip
        refuse(faults, kind=RequestError)

    @property
    def parts(self) -> tuple[str, ...]:
        """The parts that are computed."""
        return tuple(WORK) if self.part == "all" else ("spectra" if self.part == "rock" else self.part,)
