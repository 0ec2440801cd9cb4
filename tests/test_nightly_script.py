"""The script of `docs/howto/scripts.md` for cron: a mail is of its own night, or says that there is no result."""

import email
import email.policy
import os
import re
import shutil
import subprocess
import sys
import time
from pathlib import Path

import pytest

PAGE = Path(__file__).parents[1] / "docs/howto/scripts.md"
SPECTRUM = "wavelength_nm,reflectance\n" + "".join(
    f"{nm},{0.3 - 0.1 * max(0.0, 1 - abs(nm - 930) / 180) - 0.06 * max(0.0, 1 - abs(nm - 1950) / 400):.5f}\n"
    for nm in range(500, 2600, 10)
)


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """With the files that the page writes, and a folder of inputs."""
    written = re.findall(r"^cat >(\S+) <<'END'\n(.*?)^END$", PAGE.read_text("utf-8"), re.DOTALL | re.MULTILINE)
    for name, text in written:
        (tmp_path / name).write_text(text, encoding="utf-8")
    assert {"nightly.sh", "mail.py"} <= {name for name, _ in written}
    (tmp_path / "in").mkdir()
    return tmp_path


def night(folder: Path, program: Path, **inputs: str) -> tuple[int, email.message.EmailMessage, str]:
    """Exit code, mail and what cron would mail by itself, of a night with these inputs."""
    shutil.rmtree(folder / "in")
    (folder / "in").mkdir()
    for name, text in inputs.items():
        (folder / "in" / f"{name}.csv").write_text(text)
    before = {*folder.glob("nights/*")}
    # A night has a folder by its second; no two begin in the same one.
    while any(one.name.endswith(time.strftime("%H%M%S")) for one in before):
        time.sleep(0.1)
    path = f"{program}:{Path(sys.executable).parent}:{os.environ['PATH']}"
    done = subprocess.run(
        ["sh", "nightly.sh", "in"], cwd=folder, env=os.environ | {"PATH": path}, capture_output=True, text=True
    )
    assert not done.stderr, done.stderr
    [new] = {*folder.glob("nights/*")} - before
    mail = email.message_from_bytes((new / "mail.eml").read_bytes(), policy=email.policy.default)
    assert isinstance(mail, email.message.EmailMessage)
    return done.returncode, mail, done.stdout


def attached(mail: email.message.EmailMessage) -> str:
    return "".join(str(part.get_content()) for part in mail.iter_attachments())


def told(mail: email.message.EmailMessage) -> str:
    body = mail.get_body(("plain",))
    return str(body.get_content())


def test_each_night_mails_its_own_page_and_a_night_without_a_result_none(folder: Path, program: Path) -> None:
    code, mail, said = night(folder, program, monday=SPECTRUM)
    assert (code, said) == (0, "")
    assert "monday" in attached(mail)
    code, mail, said = night(folder, program, broken="no spectrum", worse="x")
    assert code == 1
    assert attached(mail) == ""
    assert "No result tonight." in told(mail) and "broken.csv" in told(mail)
    assert "lunarsci left with 1" in said and "monday" not in told(mail) + said
    code, mail, said = night(folder, program, wednesday=SPECTRUM, broken="no spectrum")
    assert code == 1
    assert "wednesday" in attached(mail) and "monday" not in attached(mail)
    assert "broken.csv" in told(mail) and "The page is attached." in told(mail)
