"""Defects of joint columns."""

from __future__ import annotations

from benchmarks.findings.defect import Defect

DEFECTS: tuple[Defect, ...] = ()
