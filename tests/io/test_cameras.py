"""Intrinsics in the layouts of other software: the same camera, however written."""

from __future__ import annotations

import json

import pytest

from calib_pin.errors import InputError
from calib_pin.io.setup import read_setup

MATRIX = [[610.5, 0, 402], [0, 608, 297], [0, 0, 1]]
FLAT = [x for row in MATRIX for x in row]
LENS = [-0.12, 0.05, 0.0005, -0.0004, 0.01]

FILES = {
    "camera_info.yaml": f"""image_width: 800
image_height: 600
camera_name: left
camera_matrix: {{rows: 3, cols: 3, data: {FLAT}}}
distortion_model: plumb_bob
distortion_coefficients: {{rows: 1, cols: 5, data: {LENS}}}
projection_matrix: {{rows: 3, cols: 4, data: [1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 0]}}
""",
    "message.json": json.dumps(
        {"width": 800, "height": 600, "distortion_model": "plumb_bob"}
        | {"d": LENS, "k": FLAT, "r": [1, 0, 0, 0, 1, 0, 0, 0, 1], "p": [0.0] * 12}
    ),
    "opencv.yml": f"""%YAML:1.0
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
""",
    "opencv.xml": f"""<?xml version="1.0"?>
<opencv_storage>
<image_width>800</image_width>
<image_height>600</image_height>
<Camera_Matrix type_id="opencv-matrix"><rows>3</rows><cols>3</cols><dt>d</dt>
  <data>{" ".join(map(str, FLAT))}</data></Camera_Matrix>
<Distortion_Coefficients type_id="opencv-matrix"><rows>5</rows><cols>1</cols><dt>d</dt>
  <data>{" ".join(map(str, LENS))}</data></Distortion_Coefficients>
</opencv_storage>
""",
    "script.json": json.dumps(
        {"camera_matrix": MATRIX, "dist_coefs_5": [LENS]}
        | {"image_width": 800, "image_height": 600}
    ),
    "realsense.json": json.dumps(
        {"color": {"width": 800, "height": 600, "fx": 610.5, "fy": 608.0}}
        | {"depth_scale": 0.001}
    ).replace(
        '"fy": 608.0',
        '"fy": 608.0, "ppx": 402, "ppy": 297, "model": "distortion.brown_conrady", '
        f'"coeffs": {LENS}',
    ),
    "matlab.json": json.dumps(
        {"ImageSize": [600, 800], "FocalLength": [610.5, 608]}
        | {"PrincipalPoint": [403, 298], "RadialDistortion": [-0.12, 0.05, 0.01]}
        | {"TangentialDistortion": [0.0005, -0.0004], "Skew": 0}
        | {"IntrinsicMatrix": [[610.5, 0, 0], [0, 608, 0], [403, 298, 1]]}
    ),
    "zivid.yaml": """CameraIntrinsics:
  CameraMatrix: {FX: 610.5, FY: 608, CX: 402, CY: 297}
  Distortion: {K1: -0.12, K2: 0.05, K3: 0.01, P1: 0.0005, P2: -0.0004}
""",
}


def test_kalibr_names_its_cameras(tmp_path):
    one = "camera_model: pinhole, distortion_model: {}, distortion_coeffs: {}, "
    one += "intrinsics: [610.5, 608, 402, 297], resolution: [800, 600]"
    lenses = ("radtan", LENS[:4]), ("equidistant", [0.1, 0.2, 0.3, 0.4])
    lines = [f"cam{k}: {{{one.format(*lens)}}}" for k, lens in enumerate(lenses)]
    (tmp_path / "camchain.yaml").write_text("\n".join(lines))

    def read(camera: str) -> object:
        path = tmp_path / "setup.yaml"
        path.write_text(f"camera: {{mount: hand, file: camchain.yaml{camera}}}")
        return read_setup(path).camera

    assert read("#cam0").distortion == (*LENS[:4], 0.0)
    assert read("#cam1, estimate: true").distortion == (0.0,) * 5
    with pytest.raises(InputError, match="yaml#cam1"):
        read("")
    with pytest.raises(InputError, match="equidistant"):
        read("#cam1")


@pytest.mark.parametrize("name", FILES)
def test_one_camera_in_many_layouts(tmp_path, name):
    (tmp_path / name).write_text(FILES[name])
    path = tmp_path / "setup.yaml"
    path.write_text(f"camera: {{mount: hand, file: {name}}}")
    camera = read_setup(path).camera
    assert camera is not None and camera.file is None
    assert (camera.focal, camera.center) == ((610.5, 608.0), (402.0, 297.0))
    assert camera.distortion == tuple(LENS)
    assert camera.size == (None if name == "zivid.yaml" else (800.0, 600.0))


def test_files_without_a_camera(tmp_path):
    (tmp_path / "a.yaml").write_text("fx: 3")
    (tmp_path / "a.json").write_text("{")
    path = tmp_path / "setup.yaml"
    for name, reason in (("a.yaml", "holds no camera"), ("a.json", "no JSON")):
        path.write_text(f"camera: {{mount: hand, file: {name}}}")
        with pytest.raises(InputError, match=reason):
            read_setup(path)
