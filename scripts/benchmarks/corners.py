"""Wrong corners and wrong images of a camera on the hand: what is set aside.

The truth is a robot whose joint frames are off by a millimeter and a milliradian, whose
gears have a ripple that no parameter describes, and a camera, by kinematics of numpy
alone. Jobs differ in what is wrong: nothing; corners that are off by 2 to 40 px, or
have each other's numbers; images with the joints of another; both. Options are those
of a deviation that is stated too small, and of the number of jobs.
"""

from __future__ import annotations

import argparse
from collections.abc import Mapping
from dataclasses import dataclass
from xml.etree import ElementTree

import numpy as np
from scipy.spatial.transform import Rotation

import calib_pin
from calib_pin.kinematics.chain import Chain
from calib_pin.kinematics.spatial import Floats
from calib_pin.observations import Measurements
from calib_pin.setup import BoardSetup, CameraSetup, Setup

BOARD = BoardSetup("charuco", 7, 5, 0.03, 0.022)
SIZE, FOCAL, CENTER = np.array([1280, 960]), np.array([905.0, 903.0]), (641.0, 478.0)
HOME = np.array([0.2, -1.5, 1.6, -1.7, -1.5, 0.3])
IMAGES, NEW = 20, 50
NOISE = 0.1
"""Standard deviation of a corner [px]."""

OFF, TURN, RIPPLE = 1e-3, 1e-3, 4e-5
"""Errors of joint frames [m, rad], and amplitude of the gears [rad]."""

CORNERS, SHOTS = 0.03, 0.15
"""Parts of the corners and of the images that are wrong."""

KINDS: Mapping[str, tuple[float, float]] = {
    "nothing": (0.0, 0.0),
    "corners": (CORNERS, 0.0),
    "images": (0.0, SHOTS),
    "both": (CORNERS, SHOTS),
}


@dataclass(frozen=True)
class Robot:
    """A serial robot with revolute joints, in numpy.

    Attributes:
        origins: Joint frames in the frames before, and that of the tip, (J + 1, 4, 4).
        axes: Axes of the joints, shape (J, 3).
        phase: Phases of the gears, shape (J,); their amplitude is `ripple`.
        ripple: Amplitude [rad].
    """

    origins: Floats
    axes: Floats
    phase: Floats
    ripple: float = 0.0

    @classmethod
    def of(cls, chain: Chain) -> Robot:
        """The nominal robot of a URDF, from base to tip."""
        root = ElementTree.fromstring(chain.robot.source)
        above = {j.find("child").get("link"): j for j in root.iterfind("joint")}  # type: ignore[union-attr]
        link, path = chain.tip, []
        while link in above and link != chain.base:
            path.insert(0, above[link])
            link = above[link].find("parent").get("link")  # type: ignore[union-attr, assignment]
        origins, axes, before = [], [], np.eye(4)
        for joint in path:
            T, origin = np.eye(4), joint.find("origin")
            about = {} if origin is None else origin.attrib
            T[:3, 3] = [*map(float, about.get("xyz", "0 0 0").split())]
            turn = [*map(float, about.get("rpy", "0 0 0").split())]
            T[:3, :3] = Rotation.from_euler("xyz", turn).as_matrix()
            before = before @ T
            if joint.get("type") != "fixed":
                origins.append(before)
                axis = joint.find("axis")
                axes.append([*map(float, (axis.get("xyz") or "").split())])  # type: ignore[union-attr]
                before = np.eye(4)
        return cls(np.array([*origins, before]), np.array(axes), np.zeros(len(axes)))

    def drawn(self, rng: np.random.Generator) -> Robot:
        """A real one."""
        count = len(self.axes)
        E = np.tile(np.eye(4), (count + 1, 1, 1))
        E[:, :3, 3] = rng.normal(0.0, OFF, (count + 1, 3))
        turns = rng.normal(0.0, TURN, (count + 1, 3))
        E[:, :3, :3] = Rotation.from_rotvec(turns).as_matrix()
        phase = rng.uniform(0.0, 2.0 * np.pi, count)
        return Robot(self.origins @ E, self.axes, phase, RIPPLE)

    def poses(self, q: Floats) -> Floats:
        """Poses of the tip, shape (N, 4, 4)."""
        q = q + self.ripple * np.sin(7.0 * q + self.phase)
        T = np.tile(np.eye(4), (len(q), 1, 1))
        for origin, axis, angle in zip(self.origins, self.axes, q.T, strict=False):
            turn = np.tile(np.eye(4), (len(q), 1, 1))
            vectors = angle[:, None] * axis / np.linalg.norm(axis)
            turn[:, :3, :3] = Rotation.from_rotvec(vectors).as_matrix()
            T = T @ origin @ turn
        return T @ self.origins[-1]


@dataclass(frozen=True)
class Job:
    """A simulated job.

    Attributes:
        data: Its measurements.
        bad: Rows that are wrong, shape (N,).
        new: Other configurations that see the board, shape (M, J).
        camera: True poses of the camera before the board there, shape (M, 4, 4).
    """

    data: Measurements
    bad: Floats
    new: Floats
    camera: Floats


def simulated(chain: Chain, kind: str, stated: float, seed: int) -> Job:
    """A job of a kind, with deviations that are stated so many times too small."""
    rng = np.random.default_rng([seed, *map(ord, kind)])
    true = Robot.of(chain).drawn(rng)
    tool = np.eye(4)
    tool[:3, :3] = Rotation.from_rotvec(rng.normal(0.0, 0.1, 3)).as_matrix()
    tool[:3, 3] = 0.03, -0.02, 0.08
    points = np.array([point.xyz for point in BOARD.points.values()])
    base = true.poses(HOME[None])[0] @ tool
    base[:3, 3] += base[:3, :3] @ ([0.0, 0.0, 0.45] - points.mean(axis=0))
    found = list[tuple[Floats, Floats]]()
    while len(found) < IMAGES + NEW:
        q = HOME + rng.normal(0.0, 0.35, (2000, len(HOME)))
        T = np.linalg.inv(base) @ true.poses(q) @ tool
        X = np.einsum("nji,npj->npi", T[:, :3, :3], points - T[:, None, :3, 3])
        uv = X[..., :2] / X[..., 2:] * FOCAL + CENTER
        seen = ((uv > 10) & (uv < SIZE - 10)).all(axis=(1, 2)) & (T[:, 2, 2] > 0.5)
        seen &= (X[..., 2] > 0.2).all(axis=1)
        found += zip(q[seen], uv[seen], strict=True)
    q, uv = (np.array(part) for part in zip(*found[: IMAGES + NEW], strict=True))
    new, count = q[IMAGES:], len(points)
    camera = np.linalg.inv(base) @ true.poses(new) @ tool
    q, uv = q[:IMAGES].copy(), uv[:IMAGES] + rng.normal(0, NOISE, (IMAGES, count, 2))
    corners, shots = KINDS[kind]
    bad = rng.random((IMAGES, count)) < corners
    for image, corner in np.argwhere(bad):
        if rng.random() < 0.3:
            other = (corner + 1 + rng.integers(count - 1)) % count
            bad[image, other] = True
            uv[image, [corner, other]] = uv[image, [other, corner]]
        else:
            angle, size = rng.uniform(0.0, 2.0 * np.pi), 2.0 * 20.0 ** rng.random()
            uv[image, corner] += size * np.array([np.cos(angle), np.sin(angle)])
    wrong = rng.permutation(IMAGES)[: round(shots * IMAGES)]
    q[wrong] = q[np.roll(wrong, 1)]
    bad[wrong] = True
    names = tuple(BOARD.points) * IMAGES
    values = uv.reshape(-1, 2)
    sigma = np.full_like(values, NOISE / stated) * rng.uniform(
        0.8, 1.25, (len(values), 1)
    )
    # Images of one configuration are told apart, as those of a log are.
    q = q + rng.normal(0.0, 1e-9, q.shape)
    rows = np.repeat(q, count, axis=0)
    data = Measurements(chain.joints, rows, "camera", values, sigma, names)
    return Job(data, bad.ravel(), new, camera)


def judged(chain: Chain, job: Job) -> tuple[float, float, float, str]:
    """Error at new views [mm], part of right rows lost, of wrong ones kept, verdict."""
    camera = CameraSetup(
        "hand", (900.0, 900.0), (639.5, 479.5), size=(1280.0, 960.0), estimate=True
    )
    setup = Setup(board=BOARD, camera=camera, model="camera")
    found = calib_pin.calibrate(chain, job.data, setup, validate=False)
    out = np.zeros(len(job.bad), bool)
    out[[o.row for o in found.statistics.outliers if o.weight == 0.0]] = True
    model = found.model.of()
    far = (model.poses(job.new) - job.camera)[:, :3, 3]
    error = 1e3 * float(np.sqrt(np.mean(np.sum(far**2, axis=1))))
    right, wrong = ~job.bad, job.bad
    lost = float(out[right].mean())
    kept = float((~out)[wrong].mean()) if wrong.any() else 0.0
    return error, lost, kept, found.verdict


def main() -> None:
    """Print a line for each kind of job."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--jobs", type=int, default=100)
    parser.add_argument("--stated", type=float, default=1.0)
    options, _ = parser.parse_known_args()
    chain = calib_pin.load_chain("example:ur5_robot", base="base_link", tip="tool0")
    print(f"{'wrong':<10} error [mm]: median, 95 %, max   right lost   wrong kept")
    for kind in KINDS:
        jobs = (simulated(chain, kind, options.stated, k) for k in range(options.jobs))
        found = [judged(chain, job) for job in jobs]
        errors, lost, kept = (
            np.array(part) for part in [*zip(*found, strict=True)][:3]
        )
        middle, high = np.quantile(errors, [0.5, 0.95])
        print(
            f"{kind:<10}{middle:10.3f}{high:10.3f}{errors.max():10.3f}"
            f"{100 * lost.mean():12.2f} %{100 * kept.mean():10.2f} %"
        )
