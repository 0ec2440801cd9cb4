"""Which rover drives on which ground: the options that requests of drives share."""

from dataclasses import dataclass

from lunarsci.heights.grid import HeightUnit


@dataclass(frozen=True, slots=True, kw_only=True)
class RoverOnGround:
    """What drives where.

    Attributes
    ----------
    rover : name or TOML file; Yutu-2 where it is None.
    terrain : `synthetic-longji`, which is taken where it is None, or a file.
    height_unit : of the terrain's heights, in place of what its file states; None for that, and m where it states none.
    gravity : `moon`, which is taken where it is None, `mars`, `earth` or a number in m/s2.
    interpolation : of the ground between nodes, `smooth` or `triangles`.
    """

    rover: str | None = None
    terrain: str | None = None
    height_unit: HeightUnit | None = None
    gravity: str | None = None
    interpolation: str = "smooth"

    @property
    def heights_without_unit(self) -> bool:
        """Whether a terrain was given and not what unit its heights are in."""
        return self.terrain is not None and self.height_unit is None

    @property
    def ground(self) -> tuple[str | None, str | None, str, HeightUnit | None, str | None]:
        """The same in the order of `read_drive_inputs`."""
        return self.rover, self.terrain, self.interpolation, self.height_unit, self.gravity
