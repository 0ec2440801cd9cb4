"""The film of a drive."""

import dataclasses
import io
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from lunarsci.errors import ParameterError
from lunarsci.twin.figures.animation import animate, check_format, median_member
from lunarsci.twin.judgement.safety import judge
from lunarsci.twin.simulation.ensemble import Prediction


@pytest.fixture(scope="module")
def film(driven: Prediction) -> tuple[bytes, list[tuple[int, int]]]:
    told: list[tuple[int, int]] = []
    content = animate(
        driven, judge(driven), Path("drive.GIF"), frames=5, progress=lambda done, total: told.append((done, total))
    )
    return content, told


def test_a_gif_has_the_frames_asked_for_and_they_move(film: tuple[bytes, list[tuple[int, int]]]) -> None:
    content, told = film
    picture = Image.open(io.BytesIO(content))
    assert picture.format == "GIF" and picture.n_frames == 5 and picture.info["loop"] == 0
    assert told == [(k, 5) for k in range(1, 6)]
    frames = []
    for k in range(5):
        picture.seek(k)
        frames.append(np.asarray(picture.convert("RGB"), dtype=int))
        assert picture.info["duration"] == pytest.approx(1000 / 12, abs=10)
    changed = [np.abs(frame - frames[0]).max(axis=2) > 60 for frame in frames]
    shares = [share.mean() for share in changed]
    assert shares[1] > 0.002 and shares[-1] < 0.5, "the rover moves, the ground does not"
    # What moved in the map lies further right in each frame: the rover drives along x.
    rights = [np.flatnonzero(share[:, :570].any(axis=0)).max() for share in changed[1:]]
    assert (np.diff(rights) > 0).all()
    assert len(content) < 5e6


def test_a_film_has_no_more_frames_than_samples(driven: Prediction) -> None:
    content = animate(driven, judge(driven), Path("drive.gif"))
    assert Image.open(io.BytesIO(content)).n_frames == 11


def test_the_rover_shown_is_the_median_one(driven: Prediction) -> None:
    paths = driven.paths.copy()
    misses = np.random.default_rng(2).permutation(np.linspace(0.0, 0.19, 20))
    paths[:, -1, :2] = driven.planned[-1, :2] + np.column_stack([misses, np.zeros(20)])
    outcome = np.where(misses < 0.095, 0, 1)
    assert misses[median_member(dataclasses.replace(driven, paths=paths))] == pytest.approx(0.09)
    half = dataclasses.replace(driven, paths=paths, outcome=outcome)
    assert misses[median_member(half)] == pytest.approx(0.04)
    assert median_member(dataclasses.replace(half, outcome=np.ones(20, dtype=int))) >= 0


def test_what_cannot_be_filmed_is_refused(driven: Prediction, monkeypatch: pytest.MonkeyPatch) -> None:
    from matplotlib.animation import FFMpegWriter

    verdict = judge(driven)
    for frames in (1, 121):
        with pytest.raises(ParameterError, match="2 to 120"):
            animate(driven, verdict, Path("drive.gif"), frames=frames)
    with pytest.raises(ParameterError, match=r"\.gif, \.mp4"):
        animate(driven, verdict, Path("drive.avi"))
    monkeypatch.setattr(FFMpegWriter, "isAvailable", classmethod(lambda cls: False))
    with pytest.raises(ParameterError, match="ffmpeg; install it"):
        check_format(Path("drive.mp4"))


def test_a_drive_that_never_began_is_filmed_all_the_same(driven: Prediction) -> None:
    lost = dataclasses.replace(driven, recorded=np.zeros(20, dtype=int), outcome=np.full(20, 5))
    assert Image.open(io.BytesIO(animate(lost, judge(lost), Path("x.gif"), frames=3))).format == "GIF"


def test_an_mp4_is_one(driven: Prediction) -> None:
    from matplotlib.animation import FFMpegWriter

    if not FFMpegWriter.isAvailable():
        pytest.skip("no ffmpeg here")
    content = animate(driven, judge(driven), Path("drive.mp4"), frames=4)
    assert content[4:8] == b"ftyp"
