"""What a calibration can be told: irradiance, photometric model, shadow limit, units, factors."""

from collections.abc import Mapping
from dataclasses import dataclass, field

from lunarsci.errors import ParameterError
from lunarsci.spectra.photometry import PhaseFunction, phase_function
from lunarsci.spectra.photometry.phase import TABLE as PHASE_TABLE
from lunarsci.spectra.photometry.phase import SelenePhase
from lunarsci.spectra.solar import M3_TABLE, SOLAR_SPECTRA, SolarSpectrum, solar_spectrum, table_name
from lunarsci.spectra.vnis.channels import TABLES
from lunarsci.spectra.vnis.reflectance import ChannelFactors

__all__ = ["RADIANCE_UNITS", "Settings", "default_settings"]

RADIANCE_UNITS: Mapping[str, float] = {"nm": 1.0, "um": 1e-3}
"""W m-2 sr-1 per nm or per um, and what brings it to per nm. The labels state no unit; the files are per nm."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Settings:
    """How to calibrate.

    Attributes
    ----------
    solar : irradiance at 1 AU. other_solar : a second spectrum; the difference of the two is the irradiance's error.
    disk : `lommel-seeliger`, `akimov`, `mcewen`, or None to leave the reflectance factor at the angles of measurement.
    phase : phase function, used with a disk function only.
    shadow_limit : pixels with a reflectance factor below it at 465 nm are shadows, 0 to below 1. [-]
    radiance_unit : `nm` or `um`, the wavelength that radiance is per.
    remove_vnir_steps : whether steps between the sub-bands of VNIR are removed, not only their error stated.
    factors : for products from before the in-flight calibration.

    Raises ParameterError outside these.
    """

    solar: SolarSpectrum
    other_solar: SolarSpectrum
    disk: str | None
    phase: PhaseFunction
    shadow_limit: float = 0.02
    radiance_unit: str = "nm"
    remove_vnir_steps: bool = False
    factors: ChannelFactors | None = None
    inputs: Mapping[str, str] = field(default_factory=dict)

    def __post_init__(self) -> None:
        if not 0 <= self.shadow_limit < 1:
            raise ParameterError(f"the shadow limit is {self.shadow_limit:g}; give a reflectance from 0 to below 1")
        if self.radiance_unit not in RADIANCE_UNITS:
            raise ParameterError(f"radiance per '{self.radiance_unit}' is unknown; use {' or '.join(RADIANCE_UNITS)}")

    @property
    def tables(self) -> tuple[str, ...]:
        """Files of `spectra_data` that a calibration reads, for the provenance."""
        solar = sorted({self.solar.name, self.other_solar.name} & set(SOLAR_SPECTRA))
        phase = [PHASE_TABLE] if self.disk is not None and isinstance(self.phase, SelenePhase) else []
        return (*TABLES, *map(table_name, solar), M3_TABLE, *phase)


def default_settings() -> Settings:
    """What `lunarsci spectra calibrate` does without options, and what other commands do with a label.

    The disk function is that of Ding et al. (2024). Of the two solar spectra E490 leaves less structure from channel to
    channel: on the median of 88 Chang'E-4 spectra the second differences are 4 to 20 % smaller in four of six ranges
    and equal in the other two; G173 is sampled at 5 nm from 1705 nm on.
    """
    return Settings(
        solar=solar_spectrum("e490"),
        other_solar=solar_spectrum("g173"),
        disk="lommel-seeliger",
        phase=phase_function("sp-mid"),
    )
