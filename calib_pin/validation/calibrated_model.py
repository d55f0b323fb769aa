"""A robot with its calibration, which predicts measurements and corrects commands."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

from calib_pin.compiled.threads import serial_blas
from calib_pin.errors import require_known
from calib_pin.estimation.problem import Problem
from calib_pin.estimation.terms import FRAME, Term, Terms
from calib_pin.kinematics.chain import Chain
from calib_pin.kinematics.spatial import Floats
from calib_pin.measurement_models import measurement_model
from calib_pin.observations import BlockKey, Observations
from calib_pin.parameterizations import NOTHING
from calib_pin.parameterizations.base import frame_setup
from calib_pin.parameterizations.error_model import ErrorModel, beyond_urdf
from calib_pin.residual_models import LearnedCorrection
from calib_pin.setup import CameraSetup, FrameSetup, Setup
from calib_pin.setup.arguments import Brief, as_array

POSITION, POSE = "position", "pose"
"""Measurement models of a point, and of the tool that has it."""


@dataclass(frozen=True, repr=False)
class CalibratedChain(Brief):
    """A chain with its calibration, before one station and with one tool.

    Attributes:
        error: Error model about the fitted base and tool frame.
        theta: Values of its parameters, shape (P,), frames at zero.
        setup: The setup it was fitted with.
    """

    error: ErrorModel
    theta: Floats
    setup: Setup

    @property
    def chain(self) -> Chain:
        """The nominal chain."""
        return self.error.chain

    def carrying(self, payload: str) -> CalibratedChain:
        """The same with a payload of the setup, by its name; `none` for nothing.

        Raises:
            OptionError: If there is no payload of that name.
        """
        require_known("payload", payload, [*self.setup.payloads, NOTHING])
        return replace(self, error=self.error.carrying(payload))

    @serial_blas
    def poses(self, q: Floats) -> Floats:
        """Predicted tool poses in the measurement frame, shape (N, n) -> (N, 4, 4)."""
        q = as_array("q", q, "N", len(self.chain.joints))
        return self.error.poses(q, self.theta)

    def outside(self, q: Floats) -> NDArray[np.bool_]:
        """Where a learned correction is far from its training, shape (N,).

        Args:
            q: Commanded joint positions, shape (N, n) [rad, m].
        """
        q, learned = as_array("q", q, "N", len(self.chain.joints)), self.error.learned
        if not isinstance(learned, LearnedCorrection):
            return np.zeros(len(q), bool)
        return ~learned.model.region.inside(q)

    @property
    def geometric(self) -> bool:
        """Whether there is nothing but geometry, which a URDF can hold."""
        moved = self.theta[beyond_urdf(self.error)].any()
        return self.error.learned is None and not moved

    def urdf_corrections(self) -> dict[str, pin.SE3]:
        """Right-multiplied corrections of the URDF's joint origins, by joint name."""
        products = self.error.corrections(self.theta)
        names = [*self.chain.joints, self.chain.tip_joint]
        return {
            name: product
            for name, product in zip(names, products[1:-1], strict=True)
            if name is not None and product != pin.SE3.Identity()
        }

    @property
    def tool_carries_tip(self) -> bool:
        """Whether the tool frame holds an error that the URDF has no place for."""
        tip = self.error.corrections(self.theta)[-2]
        return self.chain.tip_joint is None and tip != pin.SE3.Identity()

    @property
    def tool(self) -> pin.SE3:
        """The tool in the tip frame of the corrected URDF.

        An error behind the last joint has no place in a URDF whose tip is that
        joint's own link; the tool frame carries it.
        """
        if self.chain.tip_joint is not None:
            return self.error.tool
        return self.error.corrections(self.theta)[-2] * self.error.tool


@dataclass(frozen=True, repr=False)
class CalibratedModel(Brief, Terms):
    """A robot with its calibration: all chains, stations, tools and instruments.

    Attributes:
        theta: Values of all parameters, shape (P,), frames and instruments at zero:
            the terms have these in their references.
        setup: The setup it was fitted with.
        placed: Its frames by name as a file states them, from which it was read: angles
            that turn into a matrix and back are others, by an eps.
    """

    theta: Floats
    setup: Setup
    placed: Mapping[str, FrameSetup] = field(default_factory=dict)

    @staticmethod
    def create(problem: Problem, theta: Floats) -> CalibratedModel:
        """The model of a problem at parameter values, shape (P,).

        Frames and instruments move into their references; the robot keeps its values.
        """
        moved, values = problem.rebased(theta)
        return CalibratedModel(
            moved.chains, moved.terms, moved.given, values, moved.setup
        )

    def of(self, chain: str | BlockKey | None = None) -> CalibratedChain:
        """A chain before its first station, with its first tool; or that of a block.

        Args:
            chain: Name of the chain, or a block; default the first that moves.
        """
        term = (
            self.terms[chain] if isinstance(chain, BlockKey) else self.of_chain(chain)
        )
        theta = self.theta[term.of_error]
        return CalibratedChain(term.error, theta, self.setup)

    @property
    def geometric(self) -> bool:
        """Whether there is nothing but geometry, which a URDF can hold."""
        return all(self.of(name).geometric for name in self.measured_chains)

    @property
    def without_corrections(self) -> CalibratedModel:
        """The robot without what a URDF cannot hold: of a true one, its geometry.

        Of a fit that is no use, see `CalibrationResult.geometry`.
        """
        theta, terms = self.theta.copy(), {}
        for key, term in self.terms.items():
            theta[term.index[beyond_urdf(term.error)]] = 0.0
            terms[key] = replace(term, error=replace(term.error, learned=None))
        return replace(self, terms=terms, theta=theta)

    @property
    def measured_chains(self) -> tuple[str, ...]:
        """Names of the chains with joints, each once."""
        return tuple(self.by_chain)

    @property
    def cameras(self) -> dict[str, CameraSetup]:
        """The cameras by name, with the intrinsics that were found."""
        setups = ((name, r.stated()) for (_, name), r in self.references.items())
        return {name: setup for name, setup in setups if isinstance(setup, CameraSetup)}

    def urdf_corrections(self) -> dict[str, pin.SE3]:
        """Right-multiplied corrections of the URDF's joint origins, by joint name."""
        return {
            joint: correction
            for name in self.measured_chains
            for joint, correction in self.of(name).urdf_corrections().items()
        }

    def frames(self) -> Mapping[str, FrameSetup]:
        """Where the fit has the stations, and then the tools, by their names."""
        if self.placed:
            return self.placed
        stations, tools = dict[str, FrameSetup](), dict[str, FrameSetup]()
        for key, term in self.terms.items():
            free, base = self.given.free[term.of_error], term.error.base
            tool = self.of(key).tool * term.frames.offset.inverse()
            station = frame_setup(base, known=not free[:FRAME].any())
            stations[term.frames.station] = station
            tools[term.frames.tool] = frame_setup(tool, known=not free[-FRAME:].any())
        return stations | tools

    def problem(self, data: Observations) -> Problem:
        """The problem of other measurements about this calibration.

        Of a tool whose poses were calibrated, positions alone may be measured.
        """
        terms, alone = dict[BlockKey, Term](), {*data.models} == {POSITION}
        for key, term in self.terms.items():
            point = key._replace(model=POSITION)
            if alone and key.model == POSE and point not in self.terms:
                measurement = measurement_model(POSITION, self.setup)
                terms[point] = replace(term, key=point, measurement=measurement)
            else:
                terms[key] = term
        return Problem(self.chains, terms, self.given, data, self.setup)
