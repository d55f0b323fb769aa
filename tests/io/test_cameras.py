"""Intrinsics in files of ROS and OpenCV; others are refused."""

from __future__ import annotations

import pytest

from calib_pin.errors import InputError
from calib_pin.io.setup import read_setup
from tests.shared import refused

FLAT = [610.5, 0, 402, 0, 608, 297, 0, 0, 1]
LENS = [-0.12, 0.05, 0.0005, -0.0004, 0.01]

ROS = f"""image_width: 800
image_height: 600
camera_name: left
camera_matrix: {{rows: 3, cols: 3, data: {FLAT}}}
distortion_model: plumb_bob
distortion_coefficients: {{rows: 1, cols: 5, data: {LENS}}}
projection_matrix: {{rows: 3, cols: 4, data: [1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 0]}}
"""

OPENCV = f"""%YAML:1.0
---
image_width: 800
image_height: 600
camera_matrix: !!opencv-matrix
   rows: 3
   cols: 3
   dt: d
   data: {FLAT}
distortion_coefficients: !!opencv-matrix
   rows: 14
   cols: 1
   dt: d
   data: {[*LENS, *[0.0] * 9]}
avg_reprojection_error: 2.1e-01
"""


@pytest.fixture
def camera(tmp_path):
    def camera(text: str, more: str = ""):
        (tmp_path / "c.yaml").write_text(text)
        path = tmp_path / "setup.yaml"
        path.write_text(f"camera: {{mount: hand, file: c.yaml{more}}}")
        return read_setup(path).camera

    return camera


@pytest.mark.parametrize("text", [ROS, OPENCV])
def test_a_camera_of_other_software(camera, text):
    found = camera(text)
    assert found is not None and found.file is None
    assert (found.focal, found.center) == ((610.5, 608.0), (402.0, 297.0))
    assert (found.distortion, found.size) == (tuple(LENS), (800.0, 600.0))
    assert camera(text.replace("image_width", "w")).size is None


@pytest.mark.parametrize("lens", ["rational_polynomial", "equidistant"])
def test_another_lens_is_fitted_or_refused(camera, lens):
    text = ROS.replace("plumb_bob", lens)
    with pytest.raises(InputError, match=lens):
        camera(text)
    assert camera(text, ", estimate: true").distortion == (0.0,) * 5
    with pytest.raises(InputError, match="6"):
        camera(OPENCV.replace("0.01, 0.0", "0.01, 0.3"))


@pytest.mark.parametrize(
    "text",
    [
        "- 3",
        "cam0: {intrinsics: [610.5, 608, 402, 297], resolution: [800, 600]}",
        ROS.replace("distortion_coefficients", "dist"),
        ROS.replace("camera_matrix", "IntrinsicMatrix"),
        "<opencv_storage><image_width>800</image_width></opencv_storage>",
    ],
)
def test_other_files_are_refused(camera, text):
    with refused(InputError, "no camera_info"):
        camera(text)
