"""`lunarsci` for tests that run many commands: each is forked from a process that has begun already.

As a program it serves: `python forked_program.py FOLDER`. Each command has the arguments, folder, environment and open
files of its caller, and a process of its own; only the second is saved that it takes to import everything and to read
compiled code and fonts. That the program starts from nothing is shown by test_wheel.py and cli/test_startup.py.
"""

import contextlib
import importlib
import json
import os
import pkgutil
import socket
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from pathlib import Path

CALL = """#!{python} -SE
import json, os, socket, sys
with socket.socket(socket.AF_UNIX) as line:
    line.connect({address!r})
    told = json.dumps([sys.argv[1:], os.getcwd(), dict(os.environ)]).encode()
    socket.send_fds(line, [len(told).to_bytes(8, "big")], [0, 1, 2])
    line.sendall(told)
    code = line.recv(1)
sys.exit(code[0] if code else 1)
"""
WARM_UP = (
    "template plan -o plan.toml",
    "twin predict plan.toml --plot drive.png",
    "twin simulate plan.toml --seed 1 -o drive",
    "twin states drive/telemetry.csv plan.toml --track drive/track.csv -o states",
    "spectra simulate --rock ol=0.1,opx=0.4,cpx=0.2,plg=0.3 --seed 1 -o scene",
    "spectra calibrate scene -o rock.ecsv",
    "spectra fit rock.ecsv --assemblage OPX-CPX",
    "spectra unmix rock.ecsv --kind solid-rock",
)
"""What reads most of the compiled code, and the fonts."""


def write_program(path: Path, address: Path) -> None:
    """A program that hands its call over to the process that serves."""
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(CALL.format(python=sys.executable, address=str(address)))
    path.chmod(0o755)


def import_everything() -> None:
    import lunarsci

    for module in pkgutil.walk_packages(lunarsci.__path__, "lunarsci."):
        if not module.name.endswith("__main__"):
            importlib.import_module(module.name)
    for name in ("astropy.io.ascii", "astropy.io.fits", "astropy.table", "matplotlib.figure", "pandas", "rich.table",
                 "matplotlib.backends.backend_agg", "scipy.optimize", "scipy.spatial", "scipy.stats"):  # fmt: skip
        importlib.import_module(name)


def warm_up() -> None:
    """Run some commands, silently; each succeeds or is not to be trusted."""
    from lunarsci.cli import main

    home = Path.cwd()
    with tempfile.TemporaryDirectory() as folder, Path(os.devnull).open("w") as nowhere:
        os.chdir(folder)
        with contextlib.redirect_stdout(nowhere), contextlib.redirect_stderr(nowhere):
            codes = [main(line.split()) for line in WARM_UP]
        os.chdir(home)
    assert set(codes) <= {0, 3}, codes


def answer(line: socket.socket) -> None:
    """Run one command in this process, and leave."""
    from lunarsci.cli import main

    size, files, _, _ = socket.recv_fds(line, 8, 3)
    told = b""
    while len(told) < int.from_bytes(size, "big"):
        told += line.recv(1 << 16)
    arguments, folder, environment = json.loads(told)
    for number, file in enumerate(files):
        os.dup2(file, number)
        os.close(file)
    sys.stdin, sys.stdout, sys.stderr = (os.fdopen(k, mode, encoding="utf-8") for k, mode in enumerate("rww"))
    os.chdir(folder)
    os.environ.clear()
    os.environ.update(environment)
    code = main(arguments)
    for stream in (sys.stdout, sys.stderr):
        with contextlib.suppress(BrokenPipeError):
            stream.flush()
    line.sendall(bytes([code]))
    os._exit(0)


@contextlib.contextmanager
def begun(shared: Path) -> Iterator[Path]:
    """The folder of a program whose process has begun; it ends when all who were given it, by one folder, are done."""
    import fcntl

    with (shared / "program.lock").open("w") as lock:
        fcntl.flock(lock, fcntl.LOCK_EX)
        at = shared / "program.at"
        users = _user_of(Path(at.read_text())) if at.exists() else None
        if users is None:
            folder = Path(tempfile.mkdtemp(prefix="lunarsci-"))  # short, as the address of a socket must be
            write_program(folder / "bin/lunarsci", folder / "line")
            os.mkfifo(folder / "users")
            command = [sys.executable, __file__, str(folder)]
            process = subprocess.Popen(command, stdout=subprocess.PIPE, start_new_session=True)
            users = os.open(folder / "users", os.O_WRONLY)
            assert process.stdout is not None and process.stdout.readline() == b"ready\n"
            at.write_text(str(folder))
    try:
        yield Path(at.read_text()) / "bin"
    finally:
        os.close(users)


def _user_of(folder: Path) -> int | None:
    """A file that keeps its process from ending while it is open; None where it has ended."""
    with contextlib.suppress(OSError):
        return os.open(folder / "users", os.O_WRONLY | os.O_NONBLOCK)
    return None


def serve(folder: Path) -> None:
    """Answer until nobody holds the file of its users open any more."""
    import gc
    import select
    import shutil
    import signal

    users = os.open(folder / "users", os.O_RDONLY)
    import_everything()
    warm_up()
    gc.collect()
    gc.freeze()  # or every command would look through all that, and copy it
    signal.signal(signal.SIGCHLD, signal.SIG_IGN)
    with socket.socket(socket.AF_UNIX) as server:
        server.bind(str(folder / "line"))
        server.listen()
        print("ready", flush=True)  # noqa: T201
        while server in select.select([server, users], [], [])[0]:
            line, _ = server.accept()
            if os.fork() == 0:
                server.close()
                answer(line)
            line.close()
    for name in ("bin/lunarsci", "users", "line"):
        (folder / name).unlink()
    shutil.rmtree(folder / "bin")
    folder.rmdir()


if __name__ == "__main__":
    serve(Path(sys.argv[1]))
