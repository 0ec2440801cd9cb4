"""Cubes written by the test itself, byte by byte to the layout of the format."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from lunarsci.errors import DataError
from lunarsci.spectra.cubes.cube import Cube, Stated
from lunarsci.spectra.cubes.rasters import open_cube

WAVELENGTHS = np.round(np.linspace(460.99, 2976.2, 85), 2)
AXES = {"bsq": (2, 0, 1), "bil": (0, 2, 1), "bip": (0, 1, 2)}
TYPES = {"u1": 1, "i2": 2, "i4": 3, "f4": 4, "f8": 5, "u2": 12, "u4": 13}


def spectra(lines: int, samples: int, wavelength_nm: Any = WAVELENGTHS, seed: int = 0) -> Any:
    """SYNTHETIC reflectances (lines, samples, channels): a red slope, bands at 950 and 1950 nm, and noise."""
    rng = np.random.default_rng(seed)
    depth = rng.uniform(0.05, 0.3, (2, lines, samples, 1))
    bands = sum(
        d * np.exp(-0.5 * ((wavelength_nm - c) / w) ** 2) for d, c, w in zip(depth, (950, 1950), (90, 200), strict=True)
    )
    level = 0.08 + 3e-5 * wavelength_nm
    return level * np.exp(-bands) * (1 + 0.002 * rng.standard_normal((lines, samples, len(wavelength_nm))))


@pytest.fixture
def envi(tmp_path: Path) -> Callable[..., Path]:
    """Write an ENVI cube (lines, samples, channels); `keys` are lines of the header, None for none of that key."""

    def write(
        cube: Any, name: str = "cube.img", *, interleave: str = "bil", dtype: str = "<f4", offset: bytes = b"",
        header: str | None = None, **keys: Any,
    ) -> Path:  # fmt: skip
        lines, samples, bands = cube.shape
        fields: dict[str, Any] = {
            "samples": samples, "lines": lines, "bands": bands, "header offset": len(offset),
            "file type": "ENVI Standard", "data type": TYPES[np.dtype(dtype).str[1:]], "interleave": interleave,
            "byte order": int(dtype.startswith(">")), "wavelength units": "Nanometers",
            "wavelength": WAVELENGTHS if bands == WAVELENGTHS.size else np.linspace(500, 2500, bands),
        }  # fmt: skip
        fields |= {key.replace("_", " "): value for key, value in keys.items()}
        listed = {
            key: "{" + ", ".join(f"{item:.10g}" for item in value) + "}" if np.ndim(value) else value
            for key, value in fields.items()
            if value is not None
        }
        text = "ENVI\n" + "".join(f"{key} = {value}\n" for key, value in listed.items())
        path = tmp_path / name
        path.with_suffix(".hdr").write_text(header or text)
        path.write_bytes(offset + np.ascontiguousarray(cube.transpose(AXES[interleave])).astype(dtype).tobytes())
        return path

    return write


@pytest.fixture
def refused() -> Callable[..., str]:
    """The one line with which a cube is refused; it names the file and is not too long."""

    def refused(path: Path, **stated: Any) -> str:
        with pytest.raises(DataError) as error:
            open_cube(str(path), Stated(**stated))
        message = str(error.value)
        assert str(path.parent) in message
        assert "\n" not in message
        assert len(message) < 400
        return message

    return refused


def whole(cube: Cube) -> tuple[Any, Any]:
    """Reflectance and flags of every pixel."""
    return cube.read(slice(0, cube.shape[0]), slice(0, cube.shape[1]))
