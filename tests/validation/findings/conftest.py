"""Jobs of which something in the measurements was changed."""

from __future__ import annotations

from dataclasses import replace

import pytest

import calib_pin


@pytest.fixture(scope="module")
def told(moved_job):
    """The findings of a job's measurements of which something was changed."""

    def of(change, **more):
        job = moved_job((), (), 55, **more)
        block = replace(job.plain.only, sigma=None)
        rows = replace(block, **change(block))
        result = calib_pin.calibrate(job.chain, rows, validate=False)
        return {finding.code: finding for finding in result.findings}

    return of
