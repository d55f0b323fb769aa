"""`calib-pin identify`: the identifiability of a robot's parameters."""

from __future__ import annotations

from dataclasses import replace
from functools import partial
from itertools import chain

from calib_pin.calibration import calibrate as run
from calib_pin.cli import files, printing
from calib_pin.cli.asked import Identify
from calib_pin.cli.options import same
from calib_pin.estimation.evidence import TRUSTED
from calib_pin.io.json_text import Json, format_keys, merged, plain
from calib_pin.io.urdf import other_robots
from calib_pin.planning.suggestions import suggestions, with_suggestions
from calib_pin.report.identification import identified
from calib_pin.report.trust import below, findings, judged
from calib_pin.validation.assessment import identify as structural
from calib_pin.validation.result import Identification


def identify(asked: Identify) -> int:
    """Do what `Identify` asks for."""
    setup, seed = files.setup_for(asked), asked.seed
    result: Identification
    if asked.measurements:
        # What is learned has no parameters that could be known.
        setup = replace(setup, learned=None)
        with printing.progress_bar() as bar:
            chains = files.open_chains(asked, setup)
            chains, rows = files.open_rows(
                asked, asked.measurements, chains, setup, bar=bar
            )
            others = partial(other_robots, chains, setup)
            fit = partial(run, validate=False, seed=seed, others=others, progress=bar)
            fitted = with_suggestions(fit(chains, rows, setup))
        result, verdict, reason = fitted, fitted.verdict, fitted.reason
        faults = fitted.findings
    else:
        keys = files.block_keys(setup)
        chains = files.open_chains(asked, setup, keys)
        result = structural(chains, keys, setup, seed=seed)
        better = suggestions(chains, keys, setup, result, seed=seed)
        result = replace(result, suggestions=better)
        verdict, reason, faults = "good", "", ()
    files.tell_limits(chains)
    doubts = [judged(below(reason, faults), verdict)] if verdict not in TRUSTED else []
    blocks = identified(result, fitted=bool(asked.measurements), details=asked.details)

    def document() -> Json:
        # A fit knows more than this.
        known = plain(Identification(**same(result, Identification)))
        about = {"verdict": {"status": verdict, "reason": reason}, "findings": faults}
        return merged(format_keys("calib-pin/identification"), known, about)

    asked.show(document, chain(doubts, findings(faults, reason), blocks))
    return 2 if doubts else 0
