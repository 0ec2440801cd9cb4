"""Reading a table written in the test itself."""

from collections.abc import Callable
from typing import Any

import pytest

from lunarsci.errors import DataError
from lunarsci.io.inputs import InputFile
from lunarsci.spectra.readers.dispatch import read_spectra
from lunarsci.spectra.spectrum import Spectrum

Read = Callable[..., list[Spectrum]]
Refuse = Callable[..., str]


@pytest.fixture
def read() -> Read:
    """Read text or bytes as if they were a file of that name."""

    def read(content: str | bytes, name: str = "rock.csv", **options: Any) -> list[Spectrum]:
        data = content.encode() if isinstance(content, str) else content
        return read_spectra(InputFile(name, data), **options)

    return read


@pytest.fixture
def refuse(read: Read) -> Refuse:
    """The message of the DataError that reading must raise: one line that begins with the file's name, not too long."""

    def refuse(content: str | bytes, name: str = "rock.csv", **options: Any) -> str:
        with pytest.raises(DataError) as error:
            read(content, name, **options)
        message = str(error.value)
        assert message.startswith(f"{name}: ")
        assert "\n" not in message
        assert len(message) < 300
        return message

    return refuse
