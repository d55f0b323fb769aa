"""`calib-pin export`: a calibration in a file that other software loads."""

from __future__ import annotations

from calib_pin.cli import files
from calib_pin.cli.asked import Export
from calib_pin.errors import OptionError, require_known
from calib_pin.io import exchange, results


def export(asked: Export) -> int:
    """Do what `Export` asks for."""
    form, output, template = asked.format, asked.output, asked.template
    wanted = exchange.FORMATS[form]
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
