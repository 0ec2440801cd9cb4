"""Every command of docs/howto/pictures.md runs, with a rig of few pixels in place of the Navcam."""

import json
import os
import re
import subprocess
from pathlib import Path

import numpy as np
import pytest

from lunarsci.images.rig_files import read_rig, rig_text

PAGE = (Path(__file__).parents[1] / "docs/howto/pictures.md").read_text("utf-8")
SCRIPT = "".join(re.findall(r"```sh\n(.*?)```", PAGE, re.DOTALL))


@pytest.mark.slow
def test_from_pictures_to_the_next_drive(tmp_path: Path, program: Path) -> None:
    pytest.importorskip("cv2")
    (tmp_path / "rig.toml").write_text(rig_text(read_rig("yutu2-navcam").with_pixels(400)))
    script = SCRIPT.replace("--rig yutu2-navcam", "--rig rig.toml").replace("-o A\n", "--rays 1 -o A\n")
    script = script.replace("-o B\n", "--rays 1 -o B\n").replace("--plot predicted.png", "--json >predicted.json")
    environment = os.environ | {"PATH": os.pathsep.join([str(program), os.environ["PATH"]])}
    line = ["bash", "-euo", "pipefail", "-c", script]
    done = subprocess.run(line, cwd=tmp_path, env=environment, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    found = json.loads((tmp_path / "predicted.json").read_text())["result"]
    assert found["terrain_errors"]["pairs"] == 3 and 0 < found["terrain_errors"]["end"] <= 1
    with np.load(tmp_path / "A/truth.npz") as truth, np.load(tmp_path / "dem.npz") as model:
        x0, y0, step = truth["grid"]
        x, y = np.meshgrid(model["x_m"], model["y_m"])
        near = np.isfinite(model["height_m"]) & (np.hypot(x + 2.4, y) < 4)
        rows, columns = ((v[near] - o) / step for v, o in ((y, y0), (x, x0)))
        off = model["height_m"][near] - truth["ground_m"][np.rint(rows).astype(int), np.rint(columns).astype(int)]
    assert np.median(np.abs(off)) < 0.02
    for name in ("dem.png", "rocks.png", "maps.png", "merged.png", "map.npz", "depths.csv"):
        assert (tmp_path / name).stat().st_size > 0, name
