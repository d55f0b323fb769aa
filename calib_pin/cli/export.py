"""`calib-pin export`: a calibration in a file that other software loads."""

from __future__ import annotations

from calib_pin.cli import files, printing
from calib_pin.cli.asked import Export
from calib_pin.errors import OptionError, require_known
from calib_pin.io import exchange, results
from calib_pin.report.blocks import table


def export(asked: Export) -> int:
    """Do what `Export` asks for."""
    form, output, template = asked.format, asked.output, asked.template
    if form == "list":
        rows = [
            (f.name, f.summary + f" (--template {f.template})" * bool(f.template))
            for f in exchange.FORMATS.values()
        ]
        printing.show([table("", ("|word", "|remark"), rows)])
        return 0
    wanted = exchange.FORMATS[form]
    if output is None:
        raise OptionError(f"-o is missing: the {wanted.suffix} file to write")
    if template is None and wanted.template == "required":
        raise OptionError(f"{form} needs --template: your own file, which is corrected")
    if template is not None and not wanted.template:
        raise OptionError(f"{form} takes no --template")
    file = results.document_file(asked.calibration)
    result = results.read_result(file)
    inputs = [file, template, result.model.chains.robot.file]
    files.check_outputs([output], inputs, asked.force)
    if asked.chain is not None:
        require_known("measured chain", asked.chain, result.model.measured_chains)
    encoded = wanted.encode(exchange.Exported(result, file, asked.chain), template)
    for remark in encoded.remarks:
        asked.tell(remark)
    asked.give({output: encoded.data})
    return 0
