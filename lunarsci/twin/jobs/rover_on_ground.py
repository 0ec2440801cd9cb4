"""Which rover drives on which ground: the options that requests of drives share."""

from dataclasses import dataclass

from lunarsci.heights.units import HeightUnit


@dataclass(frozen=True, slots=True, kw_only=True)
class RoverOnGround:
    """What drives where.

    Attributes
    ----------
    rover : Rover: a name (yutu2, small-four) or a TOML file.
    terrain : Terrain: synthetic-longji, or a file (.npz, GeoTIFF, PDS3, PDS4, ISIS, netCDF, ESRI ASCII .asc, CSV of
        nodes).
    height_unit : Unit of the terrain's heights, in place of what its file states.
    gravity : Gravity: moon, mars, earth, or a number in m/s².
    interpolation : Ground between nodes: smooth (continuous gradient) or triangles (as in the paper).
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
