"""The scene of a robot, its measurements and a plan, as plain data.

All of it stands in one link: the base of the chain, or the root of the robot where
chains have several bases. A calibrated robot is drawn with the
joint origins of its corrected URDF and, where it has corrections of the joints, with
these turned as it says. What it corrects behind the tip moves no link: it shows in the
place of the tool only.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

from calib_pin.errors import enumerated
from calib_pin.estimation.problem import error_table, tool_points
from calib_pin.io.measurements import read_configurations
from calib_pin.io.robot_shapes import robot_shapes
from calib_pin.io.table import read_table
from calib_pin.io.urdf_tree import edit_origins, parse_robot
from calib_pin.kinematics.chains import Chains
from calib_pin.kinematics.robot import Robot
from calib_pin.kinematics.shapes import Shape
from calib_pin.kinematics.skeleton import Skeleton, base_poses, drawn_link
from calib_pin.kinematics.spatial import Floats
from calib_pin.observations import Observations
from calib_pin.parameterizations import NOTHING
from calib_pin.setup import Setup
from calib_pin.validation.calibrated_model import CalibratedModel
from calib_pin.validation.evaluation import registered_robot
from calib_pin.validation.model_errors import Registered


@dataclass(frozen=True)
class StageErrors:
    """Errors of N measurements as one robot predicts them, in one of its links.

    Attributes:
        points: The measured points of its tool, shape (N, 3) [m].
        vectors: Predicted minus measured position, shape (N, 3) [m]; NaN where none
            is measured.
        sizes: Sizes of the errors by the name of the quantity, shape (N,); NaN where a
            measurement does not have it, infinite where it cannot be predicted.
        units: Unit of each quantity: `m`, `rad` or `px`.
    """

    points: Floats
    vectors: Floats
    sizes: Mapping[str, Floats]
    units: Mapping[str, str]


@dataclass(frozen=True)
class Body:
    """One robot as it is drawn.

    Attributes:
        name: Its name: `robot`, or `nominal` and `corrected`.
        skeleton: Where its links are.
        model: Calibrated model that corrects the commanded joints; None where
            nothing does.
        factor: Magnification of all corrections.
    """

    name: str
    skeleton: Skeleton
    model: CalibratedModel | None = None
    factor: float = 1.0

    def magnified(self, factor: float) -> Body:
        """The same with its corrections magnified; it stays as it is without any.

        Links hang together: screws of joint origins and angles of joints are
        multiplied, so that a small error of a link is magnified as much.
        """
        if self.model is None:
            return self
        return corrected(self.model, self.skeleton.base, factor)

    def placements(self, q: Floats, payload: str = "") -> Floats:
        """Poses of all links in the base link, shape (L, 4, 4).

        Args:
            q: Commanded positions of the skeleton's joints, shape (K,) [rad, m].
            payload: Name of what the robot carries; nothing, or the only payload
                there is, where it is empty.
        """
        moved, model = q.copy(), self.model
        if model is not None and len(model.setup.payloads) > 1:
            payload = payload or NOTHING
        index = {joint: k for k, joint in enumerate(self.skeleton.joints)}
        for chain in [] if model is None else map(model.of, model.measured_chains):
            joints = chain.chain.joints
            commanded = self.skeleton.positions(joints, q)
            error = chain.error.carrying(payload)
            (turned,) = error.joint_positions(commanded[None], chain.theta)
            turned = commanded + self.factor * (turned - commanded)
            for joint, position in zip(joints, turned, strict=True):
                if joint in index:  # One that follows another follows it as it is.
                    moved[index[joint]] = position
        return self.skeleton.placements(moved)


@dataclass(frozen=True)
class Rows:
    """Measurements and their errors.

    Attributes:
        data: The N measurements.
        stages: Errors by stage, `before` and, of a calibration, `after`.
    """

    data: Observations
    stages: dict[str, StageErrors]


@dataclass(frozen=True, eq=False)
class Scene:
    """All that is drawn.

    Attributes:
        title: Name of the robot.
        shapes: Shapes of the links of all bodies.
        bodies: The robot, or the nominal and the corrected one.
        chains: The chains that measurements and plan move; may be none.
        rows: Measurements, if there are any.
        plan: Planned configurations of the chains, shape (M, n) [rad, m]; None for
            none.
    """

    title: str
    shapes: tuple[Shape, ...]
    bodies: tuple[Body, ...]
    chains: Chains
    rows: Rows | None = None
    plan: Floats | None = None

    @cached_property
    def moved(self) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
        """Joints of the chains with a position of their own, (m,), among the bodies'.

        The first are their columns in configurations of the chains, the second are
        their places among the joints of the bodies.
        """
        names, joints = self.bodies[0].skeleton.joints, enumerate(self.chains.joints)
        pairs = [(k, names.index(joint)) for k, joint in joints if joint in names]
        columns, places = np.array(pairs, np.intp).reshape(-1, 2).T
        return columns, places

    @property
    def start(self) -> Floats:
        """Joint positions of the first measurement or plan, or neutral, shape (K,)."""
        q, (columns, places) = self.bodies[0].skeleton.neutral, self.moved
        if self.rows is not None:
            q[places] = self.rows.data.q[0, columns]
        elif self.plan is not None:
            q[places] = self.plan[0, columns]
        return q


def bodies_of(robot: Robot, base: str, model: CalibratedModel | None) -> list[Body]:
    """The robot by itself, or as it is nominally and as its calibration corrects it."""
    if model is None:
        return [Body("robot", Skeleton(robot, base))]
    return [Body("nominal", Skeleton(robot, base)), corrected(model, base)]


def corrected(model: CalibratedModel, base: str, factor: float = 1.0) -> Body:
    """The robot as its calibration corrects it, so many times over."""
    robot = model.chains.robot
    origins = {
        joint: pin.exp6(factor * pin.log6(correction))
        for joint, correction in model.urdf_corrections().items()
    }
    written = edit_origins(robot.source, origins, robot.file)
    skeleton = Skeleton(parse_robot(written, robot.file), base)
    return Body("corrected", skeleton, model, factor)


def stage_errors(robot: Registered, link: str) -> StageErrors:
    """Errors of the measurements that a robot is prepared for, in one of its links."""
    problem, theta = robot.problem.rebased(robot.theta)
    data, residual = problem.data, problem.errors(theta)
    points, vectors = np.zeros((len(data), 3)), np.full((len(data), 3), np.nan)
    for block, seen in zip(problem.blocks, tool_points(problem, theta), strict=True):
        rows, chain = block.rows, block.term.key.chain
        T = base_poses(problem.chains, chain, link, data.q[rows])
        T = T @ block.term.error.base.inverse().homogeneous
        turn = T[:, :3, :3]
        points[rows] = np.einsum("nij,nj->ni", turn, seen) + T[:, :3, 3]
        errors = block.table(residual)
        for quantity in block.term.measurement.quantities:
            columns = errors[:, quantity.columns]
            if quantity.unit == "m" and columns.shape[1] == 3:
                vectors[rows] = np.einsum("nij,nj->ni", turn, columns)
    table, quantities = error_table(problem, theta), problem.layout.quantities
    sizes = {q.name: np.linalg.norm(table[:, q.columns], axis=1) for q in quantities}
    return StageErrors(points, vectors, sizes, {q.name: q.unit for q in quantities})


def make_scene(
    chains: Chains,
    model: CalibratedModel | None,
    setup: Setup,
    data: Observations | None,
    plan: Path | None,
    package_dirs: Sequence[Path],
    *,
    tell: Callable[[str], None],
    stage: Callable[[str], object],
) -> Scene:
    """The scene of a robot, or of one nominally and as it was calibrated.

    Args:
        chains: The chains of the robot.
        model: The calibration, if there is one.
        setup: The setup.
        data: The measurements, if there are any.
        plan: File of configurations, if there is one.
        package_dirs: Folders of packages, see `io.packages.locate_mesh`.
        tell: Called with one line for what may be otherwise than one thinks.
        stage: Told what begins.
    """
    rows, planned, ready = None, None, list[Registered]()
    if data is not None:
        stage("errors")
        ready.append(registered_robot(chains, data, setup))
        if reason := ready[0].reason:
            tell(f"the errors before cannot be trusted: {reason}")
        ready += [] if model is None else [registered_robot(model, data)]
        errors = [stage_errors(robot, drawn_link(chains)) for robot in ready]
        rows = Rows(data, dict(zip(("before", "after"), errors, strict=False)))
    if not chains.names and (plan is not None or setup.base):
        named = ("",) if plan is None else read_table(plan).labels("chain").distinct
        chains = chains.named(named)
    link = drawn_link(chains)
    if plan is not None:
        planned = read_configurations(plan, chains, setup.joints)
    stage("shapes")
    shapes = robot_shapes(chains.robot, package_dirs)
    if shapes.missing:
        hint = "name the folder of their package with --package-dir"
        missing = f"replaced by simple shapes: {enumerated(shapes.missing)}; {hint}"
        tell(f"meshes missing or unreadable and {missing}")
    bodies = tuple(bodies_of(chains.robot, link, model))
    return Scene(chains.robot.name, shapes.parts, bodies, chains, rows, planned)
