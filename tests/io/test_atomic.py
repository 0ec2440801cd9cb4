"""Files that change together: a signal at every call of the system that changes names or content, and other writers."""

import multiprocessing
import os
import signal
import stat
import sys
from collections.abc import Callable, Iterator
from concurrent.futures import ProcessPoolExecutor
from pathlib import Path
from types import ModuleType
from typing import Any

import pytest

from lunarsci.errors import OutputError
from lunarsci.io.atomic import write_files

POINTS = {"open", "os.rename", "os.link", "os.remove", "os.rmdir", "os.mkdir", "os.chmod", "shutil.rmtree",
          "os.scandir", "ctypes.dlsym", "tempfile.mkstemp", "tempfile.mkdtemp", "a piece of content"}  # fmt: skip
OLD = {"result.json": "old result", "paths.csv": "old paths", "notes of the user.txt": "mine"}
NEW = {"result.json": "new result, longer", "paths.csv": "new", "states.csv": "new states"}
AFTER = {**OLD, **NEW}
POLITE = ["SIGINT", "SIGTERM", "SIGHUP"]


def pieces(text: str) -> Iterator[bytes]:
    for character in text:
        sys.audit("a piece of content")
        yield character.encode()


def make(folder: Path, *, nested: bool = False) -> None:
    """What an earlier run left: a folder of files, and a picture beside it."""
    folder.mkdir()
    for name, text in OLD.items():
        (folder / name).write_text(text)
    if nested:
        (folder / "mine").mkdir()
    folder.with_suffix(".png").write_text("old picture")


def write(folder: Path) -> None:
    contents = {folder.with_suffix(".png"): pieces("new picture")}
    write_files(contents | {folder / name: pieces(text) for name, text in NEW.items()}, force=True, folder=folder)


def stopped_at(point: int, number: int, folder: Path, told: Any) -> None:
    """Write, and get a signal at this point; how many points were passed goes to `told`."""
    for polite in POLITE:
        signal.signal(getattr(signal, polite), signal.default_int_handler)
    passed = 0

    def count(event: str, _: Any) -> None:
        nonlocal passed
        if event in POINTS:
            passed += 1
            if passed == point:
                os.kill(os.getpid(), number)

    sys.addaudithook(count)
    try:
        write(folder)
    except KeyboardInterrupt:
        os._exit(130)
    told.send(passed)
    os._exit(0)


def run(point: int, number: int, folder: Path) -> tuple[int, int]:
    """Exit code, and points passed (0 where it did not get to the end)."""
    here, there = multiprocessing.Pipe()
    process = multiprocessing.get_context("fork").Process(target=stopped_at, args=(point, number, folder, there))
    process.start()
    process.join()
    return process.exitcode or 0, here.recv() if here.poll() else 0


def found(folder: Path) -> dict[str, str]:
    return {file.name: file.read_text() for file in folder.iterdir() if file.is_file()}


Left = tuple[int, dict[str, str], str, list[str]]
"""Exit code at a point, files of the folder, the picture, and all names in both places."""


def every_point(tmp_path: Path, numbers: list[int], nested: bool) -> list[Left]:
    """What was left at one point after the other by these signals in turn, each in a folder of its own."""
    lefts, beyond, point = list[Left](), False, 0
    while not beyond:
        point += 1
        place = tmp_path / str(point)
        place.mkdir()
        make(folder := place / "out", nested=nested)
        code, passed = run(point, numbers[point % len(numbers)], folder)
        beyond = 0 < passed < point
        lefts.append((code, found(folder), folder.with_suffix(".png").read_text(), names_in(place)))
        write(folder)
        assert not [name for name in names_in(place) if name.startswith(".")], f"point {point}: left behind"
    return lefts


def names_in(place: Path) -> list[str]:
    return sorted(file.name for folder in (place, place / "out") for file in folder.iterdir())


def in_a_small_process(tmp_path: Path, *arguments: Any) -> list[Left]:
    """The same; forks of one that has imported the whole suite take several times as long."""
    with ProcessPoolExecutor(1, multiprocessing.get_context("spawn")) as pool:
        return pool.submit(every_point, tmp_path, *arguments).result()


@pytest.mark.skipif(sys.platform != "linux", reason="forks")
def test_killed_anywhere_a_folder_is_old_or_new(tmp_path: Path) -> None:
    lefts = in_a_small_process(tmp_path, [signal.SIGKILL], False)
    assert len(lefts) > 50
    assert {code for code, *_ in lefts} == {0, -signal.SIGKILL}
    assert all(picture in ("old picture", "new picture") for _, _, picture, _ in lefts)
    files = [files for _, files, _, _ in lefts]
    assert all(one in (OLD, AFTER) for one in files) and OLD in files and AFTER in files


@pytest.mark.slow
@pytest.mark.skipif(sys.platform != "linux", reason="forks")
@pytest.mark.parametrize("every", [8, pytest.param(1, marks=pytest.mark.study)])
def test_commands_killed_at_calls_that_write(
    every: int, load_benchmark: Callable[[str], ModuleType], tmp_path: Path
) -> None:
    """Folders, single files and pictures, over what is there and anew; nothing is left after the next run."""
    faults = load_benchmark("faults")
    found = faults.killed_at_writes(tmp_path, every=every)
    assert {name: writes.wrong[:3] for name, writes in found.items() if writes.wrong} == {}
    assert list(found) == list(faults.WRITERS)
    for name, writes in found.items():
        wanted = {target.strip("/") for target in faults.WRITERS[name][1].split()}
        assert wanted <= set(writes.targets), name
        assert writes.targets and writes.kills, name
    assert sum(writes.kills for writes in found.values()) >= 400 / every


def careless(folder: Path, how: str) -> int:
    """What a command would do that writes without `lunarsci.io.atomic`."""
    out, beside = folder / "out.json", folder / "out.tmp"
    if how == "leaves a file":
        beside.write_text("new")
        beside.rename(out)
    else:
        for name in ("a", "b"):
            (folder / "both" / name).write_text("new")
    return 0


def fault_is_seen(folder: Path, how: str, told: Any) -> None:
    import faults

    told.send(faults.killed_at_each_write(lambda: careless(folder, how), folder, faults.Calls()))


@pytest.mark.skipif(sys.platform != "linux", reason="forks")
@pytest.mark.parametrize(
    ("how", "said"),
    [("leaves a file", "out.tmp is neither old nor new"), ("file by file", "both is neither old nor new")],
)
def test_what_is_written_carelessly_is_seen(
    how: str, said: str, load_benchmark: Callable[[str], ModuleType], tmp_path: Path
) -> None:
    load_benchmark("faults")
    for name in ("out.json", "both/a", "both/b"):
        (tmp_path / name).parent.mkdir(exist_ok=True)
        (tmp_path / name).write_text("old")
    here, there = multiprocessing.Pipe()
    process = multiprocessing.get_context("fork").Process(target=fault_is_seen, args=(tmp_path, how, there))
    process.start()
    process.join()
    writes = here.recv()
    assert writes.kills >= 1
    assert said in " ".join(writes.wrong)


@pytest.mark.skipif(sys.platform != "linux", reason="forks")
@pytest.mark.parametrize("nested", [False, True], ids=["plain", "with a folder of the user's in it"])
def test_told_to_stop_everything_is_old_or_new_and_nothing_left(nested: bool, tmp_path: Path) -> None:
    """By each signal at a third of the points; also in a folder that cannot be swapped: its files change one by one."""
    lefts = in_a_small_process(tmp_path, [getattr(signal, name) for name in POLITE], nested)
    ends = [(files, picture) for _, files, picture, _ in lefts]
    assert all(end in ((OLD, "old picture"), (AFTER, "new picture")) for end in ends)
    assert {files == AFTER for files, _ in ends} == {False, True}
    assert {code for code, *_ in lefts} == {0, 130}
    assert not [names for *_, names in lefts if {*names} - {"out", "out.png", "mine", *AFTER}]


def test_modes_stay_and_links_stay_links(tmp_path: Path) -> None:
    private, real, link = tmp_path / "private.json", tmp_path / "elsewhere.json", tmp_path / "link.json"
    private.write_text("old")
    private.chmod(0o600)
    real.write_text("old")
    link.symlink_to(real)
    folder = tmp_path / "out"
    make(folder)
    folder.chmod(0o700)
    (folder / "paths.csv").chmod(0o640)
    write_files({private: b"new", link: b"new"}, force=True)
    write(folder)
    assert (private.read_text(), stat.S_IMODE(private.stat().st_mode)) == ("new", 0o600)
    assert link.is_symlink()
    assert real.read_text() == "new"
    assert stat.S_IMODE(folder.stat().st_mode) == 0o700
    assert stat.S_IMODE((folder / "paths.csv").stat().st_mode) == 0o640
    assert found(folder) == AFTER


def test_a_folder_that_somebody_works_in_stays(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    folder = tmp_path / "out"
    make(folder)
    monkeypatch.chdir(folder)
    before = folder.stat().st_ino
    write_files({Path("result.json"): b"new"}, force=True, folder=Path())
    assert folder.stat().st_ino == before
    assert found(folder) == OLD | {"result.json": "new"}


def test_what_cannot_be_replaced_brings_all_back(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """As on a disk that fails when the third of four names is changed."""
    names = [tmp_path / f"{k}.csv" for k in range(4)]
    for name in names[:3]:
        name.write_text("old")
    real = Path.replace

    def failing(self: Path, target: Path) -> Path:
        if target == names[3]:
            raise OSError(5, "Input/output error")
        return real(self, target)

    monkeypatch.setattr(Path, "replace", failing)
    with pytest.raises(OutputError, match="nothing was written"):
        write_files(dict.fromkeys(names, b"new"), force=True)
    assert [name.read_text() for name in names[:3]] == ["old"] * 3
    assert sorted(tmp_path.iterdir()) == names[:3]


def test_without_force_nothing_that_appeared_meanwhile_is_replaced(tmp_path: Path) -> None:
    folder = tmp_path / "out"

    def another_writes() -> Iterator[bytes]:
        folder.mkdir()
        (folder / "result.json").write_text("another's")
        yield b"mine"

    with pytest.raises(OutputError, match="appeared while"):
        write_files({folder / "result.json": another_writes(), folder / "paths.csv": b"mine"}, folder=folder)
    assert found(folder) == {"result.json": "another's"}


def writing(folder: Path, mark: str) -> None:
    for _ in range(20):
        texts = {folder / f"{k}.csv": f"{mark} {k}".encode() for k in range(5)}
        write_files(texts, force=True, folder=folder)


@pytest.mark.skipif(sys.platform != "linux", reason="forks")
def test_two_writers_of_one_folder_never_mix(tmp_path: Path) -> None:
    folder = tmp_path / "out"
    writing(folder, "first")
    fork = multiprocessing.get_context("fork")
    both = [fork.Process(target=writing, args=(folder, mark)) for mark in ("left", "right")]
    for process in both:
        process.start()
    while any(process.is_alive() for process in both):
        handle = os.open(folder, os.O_RDONLY)  # the folder that has the name now, whatever takes it next
        try:
            with os.scandir(handle) as files:
                names = sorted(file.name for file in files)
            marks = {Path(f"/proc/self/fd/{handle}/{name}").read_text().split()[0] for name in names}
        except FileNotFoundError:
            continue  # an old folder that is being taken away
        finally:
            os.close(handle)
        assert len(marks) <= 1
    assert [process.exitcode for process in both] == [0, 0]
    assert [file.name for file in tmp_path.iterdir()] == ["out"]
    assert len({text.split()[0] for text in found(folder).values()}) == 1
