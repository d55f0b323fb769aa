"""`calib-pin identify`: the identifiability of a robot's parameters."""

from __future__ import annotations

from dataclasses import fields, replace
from functools import partial
from itertools import chain

from calib_pin.calibration import calibrate as run
from calib_pin.cli import files, printing
from calib_pin.cli.asked import Identify
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
    stated, seed = files.stated_setup(asked), asked.seed
    found: Identification
    if asked.measurements:
        # What is learned has no parameters that could be known.
        stated = replace(stated, learned=None)
        with printing.progress_bar() as bar:
            chains = files.open_chains(asked, stated)
            chains, rows = files.open_rows(
                asked, asked.measurements, chains, stated, bar=bar
            )
            others = partial(other_robots, chains, stated)
            fit = partial(run, validate=False, seed=seed, others=others, progress=bar)
            result = with_suggestions(fit(chains, rows, stated))
        found, verdict, reason = result, result.verdict, result.reason
        faults = result.findings
    else:
        keys = files.stated_blocks(stated)
        chains = files.open_chains(asked, stated, keys)
        found = structural(chains, keys, stated, seed=seed)
        better = suggestions(chains, keys, stated, found, seed=seed)
        found = replace(found, suggestions=better)
        verdict, reason, faults = "good", "", ()
    files.tell_limits(chains)
    doubts = [judged(below(reason, faults), verdict)] if verdict not in TRUSTED else []
    fitted = bool(asked.measurements)
    told = identified(found, fitted=fitted, details=asked.details)

    def document() -> Json:
        # A fit has found more than this.
        own = {part.name: getattr(found, part.name) for part in fields(Identification)}
        return merged(
            format_keys("calib-pin/identification"),
            plain(Identification(**own)),
            {"verdict": {"status": verdict, "reason": reason}, "findings": faults},
        )

    asked.show(document, chain(doubts, findings(faults, reason), told))
    return 2 if doubts else 0
