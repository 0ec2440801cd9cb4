"""Without OpenCV, of the extra `images`, what looks at pictures is left out."""

import importlib.util

collect_ignore = (
    [] if importlib.util.find_spec("cv2") else [f"test_{name}.py" for name in (
        "calibration", "gridding", "localisation", "matching", "rig_files")]
)  # fmt: skip
