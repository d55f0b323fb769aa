"""Defects of measured values."""

from __future__ import annotations

from benchmarks.findings.defect import Defect

DEFECTS: tuple[Defect, ...] = ()
