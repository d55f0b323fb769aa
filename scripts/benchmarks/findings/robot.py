"""Defects of the robot and of the design of measurements."""

from __future__ import annotations

from benchmarks.findings.defect import Defect

DEFECTS: tuple[Defect, ...] = ()
