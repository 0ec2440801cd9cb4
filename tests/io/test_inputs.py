"""Inputs: what is read, how it is decoded, and the one line said when it cannot be."""

import gzip
import hashlib
import io
import os
import sys
from collections.abc import Callable
from pathlib import Path

import pytest

import lunarsci
from lunarsci.errors import DataError, LunarSciWarning
from lunarsci.guide.info import info
from lunarsci.heights.grids import read_grid
from lunarsci.io.inputs import InputFile, expand_inputs, read_input, text
from lunarsci.regolith.soil import read_soil
from lunarsci.rovers import read_rover


def one_line(error: pytest.ExceptionInfo[DataError]) -> str:
    message = str(error.value)
    assert "\n" not in message
    return message


def test_a_file_is_read_whole_with_its_digest(tmp_path: Path) -> None:
    path = tmp_path / "rock.csv"
    path.write_bytes(b"abc")
    source = read_input(str(path))
    assert (source.name, source.data, source.stem) == (str(path), b"abc", "rock")
    # FIPS 180-2, appendix B.1
    assert source.sha256 == "ba7816bf8f01cfea414140de5dae2223b00361a396177a9cb410ff61f20015ad"


def test_dash_reads_standard_input(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(sys, "stdin", io.TextIOWrapper(io.BytesIO(b"\xff\x00piped")))
    source = read_input("-")
    assert (source.name, source.data, source.stem) == ("<stdin>", b"\xff\x00piped", "stdin")
    assert source.sha256 == hashlib.sha256(b"\xff\x00piped").hexdigest()


@pytest.mark.parametrize("stdin", [None, io.TextIOWrapper(io.BytesIO(b""))])
def test_no_standard_input_is_an_error(monkeypatch: pytest.MonkeyPatch, stdin: object) -> None:
    monkeypatch.setattr(sys, "stdin", stdin)
    with pytest.raises(DataError, match="<stdin>") as error:
        read_input("-")
    one_line(error)


def test_a_missing_file_a_folder_and_an_empty_file_are_errors(tmp_path: Path) -> None:
    (tmp_path / "empty.csv").touch()
    for name, reason in (("no.csv", "no such file"), ("", "is a folder"), ("empty.csv", "is empty"), ("a\0b", "null")):
        with pytest.raises(DataError, match=reason) as error:
            read_input(str(tmp_path) + "/" + name)
        assert ";" in one_line(error)


@pytest.mark.parametrize("name", ["rock.csv", "states.csv", "telemetry.csv", "plan.toml", "soil.toml", "rover.toml",
                                  "site.asc", "site.npz", "result.json"])  # fmt: skip
def test_a_compressed_file_is_named_so_by_all_that_read_it(tmp_path: Path, name: str) -> None:
    path = tmp_path / f"{name}.gz"
    path.write_bytes(gzip.compress(b"any"))
    readers: dict[str, Callable[[str], object]] = {
        "rock": lunarsci.bands, "states": lambda file: lunarsci.infer(file, rover="yutu2"),
        "telemetry": lunarsci.states, "plan": lunarsci.predict, "soil": read_soil, "rover": read_rover,
        "site": read_grid, "result": lunarsci.cite,
    }  # fmt: skip
    for read in (info, readers[name.partition(".")[0]]):
        with pytest.raises(DataError, match=r"\.gz: is compressed \(gzip\); unpack it first$"):
            read(str(path))


@pytest.mark.skipif(os.name != "posix" or os.geteuid() == 0, reason="access rights do not bind this user")
def test_a_forbidden_file_is_an_error(tmp_path: Path) -> None:
    path = tmp_path / "secret.csv"
    path.write_text("a")
    path.chmod(0)
    with pytest.raises(DataError, match="no permission"):
        read_input(str(path))


@pytest.mark.parametrize("failure", [PermissionError(13, "Permission denied"), OSError(5, "Input/output error")])
def test_failures_of_the_system_are_one_line(monkeypatch: pytest.MonkeyPatch, failure: OSError) -> None:
    def fail(self: Path) -> bytes:
        raise failure

    monkeypatch.setattr(Path, "read_bytes", fail)
    with pytest.raises(DataError, match=r"permission|Input/output error") as error:
        read_input("rock.csv")
    assert "rock.csv" in one_line(error)


@pytest.mark.parametrize("encoding", ["utf-8", "utf-8-sig", "utf-16", "utf-16-le-bom", "utf-16-be-bom"])
def test_unicode_is_decoded_by_its_mark(encoding: str) -> None:
    words = "wl [µm]\r\n0.5"
    if encoding.endswith("bom"):
        data = {"le": b"\xff\xfe", "be": b"\xfe\xff"}[encoding[7:9]] + words.encode(encoding[:9])
    else:
        data = words.encode(encoding)
    assert text(InputFile("a", data)) == words


def test_latin_1_is_read_and_said() -> None:
    with pytest.warns(LunarSciWarning, match=r"^a\.csv: .*Latin-1"):
        assert text(InputFile("a.csv", b"wl (\xb5m),R\n")) == "wl (µm),R\n"


@pytest.mark.filterwarnings("ignore::lunarsci.errors.LunarSciWarning")
@pytest.mark.parametrize(
    ("data", "said"),
    [
        *((data, "is a binary file") for data in (b"a\0b", "a\0b".encode("utf-16"), bytes(range(1, 32)) * 3)),
        (bytes(range(1, 256)), "is a binary file"),
        ("ab".encode("utf-16")[:-1], ".*UTF-16"),
        (b" \r\n\t\n", ".*only blanks"),
    ],
)
def test_content_that_is_no_text_is_refused(data: bytes, said: str) -> None:
    with pytest.raises(DataError, match=rf"^a\.csv: {said}"):
        text(InputFile("a.csv", data))


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    for name in ("b.csv", "a.csv", "c.txt", ".hidden", "deep/d.csv", "odd[1].csv"):
        (tmp_path / name).parent.mkdir(exist_ok=True)
        (tmp_path / name).write_text("x")
    return tmp_path


def relative(found: list[str], folder: Path) -> list[str]:
    return [str(Path(name).relative_to(folder)) for name in found]


def test_folders_and_patterns_are_expanded_sorted_and_without_hidden_files(folder: Path) -> None:
    assert relative(expand_inputs([str(folder)]), folder) == ["a.csv", "b.csv", "c.txt", "odd[1].csv"]
    assert relative(expand_inputs([f"{folder}/[ab].csv"]), folder) == ["a.csv", "b.csv"]
    assert relative(expand_inputs([f"{folder}/**/d*"]), folder) == ["deep/d.csv"]


def test_names_are_kept_in_order_and_listed_once(folder: Path) -> None:
    paths = ["-", f"{folder}/c.txt", f"{folder}/odd[1].csv", "missing.csv", f"{folder}/*.txt", "-"]
    assert expand_inputs(paths) == paths[:4]


def test_nothing_found_is_an_error(folder: Path) -> None:
    (folder / "void").mkdir()
    for path, reason in ((f"{folder}/*.fits", "matches no file"), (f"{folder}/void", "holds no files")):
        with pytest.raises(DataError, match=reason) as error:
            expand_inputs([path])
        assert path in one_line(error)


def test_a_folder_that_cannot_be_listed_is_an_error(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def fail(self: Path) -> None:
        raise PermissionError(13, "Permission denied")

    monkeypatch.setattr(Path, "iterdir", fail)
    with pytest.raises(DataError, match="cannot be listed"):
        expand_inputs([str(folder)])
