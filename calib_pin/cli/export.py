"""`calib-pin export`: a calibration in a file that other software loads."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

import calib_pin.cli.options as options
from calib_pin.cli.files import check_outputs
from calib_pin.cli.printing import notice, say_json, say_written
from calib_pin.errors import OptionError, require_known

FORMAT_NAMES = (
    "ur-kinematics, xarm-kinematics, urdf, xacro, mjcf, ros2-control, lerobot, "
    "joint-offsets, camera-info, dh, tf"
)


def export(
    calibration: Annotated[
        Path,
        typer.Argument(
            metavar="DIR|CALIBRATION", help="Folder of the results, or its .json file."
        ),
    ],
    form: Annotated[
        str,
        options.output(
            "--format NAME", f"One of {FORMAT_NAMES}; 'list' explains them."
        ),
    ],
    output: Annotated[
        Path | None, options.output("-o --output FILE", "The file to write.")
    ] = None,
    template: Annotated[
        Path | None,
        options.output(
            "--template FILE",
            "Your own file of this format, which is corrected: needed for "
            "ur-kinematics, xarm-kinematics and lerobot, possible for ros2-control.",
        ),
    ] = None,
    chain: options.ChainName = None,
    force: options.Force = False,
    quiet: options.Quiet = False,
    json: options.Json = False,
) -> int:
    """Write what other software loads: vendors' kinematics, offsets, cameras, frames.

    Exit status 1: the calibration must not be trusted, or has nothing of this kind.
    """
    from calib_pin.io.exchange import FORMATS, Exported
    from calib_pin.io.files import write_files
    from calib_pin.io.results import document_file, read_result

    if form == "list":
        for known in FORMATS.values():
            needs = f" (--template {known.template})" if known.template else ""
            print(f"{known.name:16} {known.summary}{needs}")
        return 0
    require_known("format", form, FORMATS)
    wanted = FORMATS[form]
    if output is None:
        raise OptionError(f"-o is missing: the {wanted.suffix} file to write")
    if template is None and wanted.template == "required":
        raise OptionError(f"{form} needs --template: your own file, which is corrected")
    if template is not None and not wanted.template:
        raise OptionError(f"{form} takes no --template")
    file = document_file(calibration)
    check_outputs([output], [file, template], force)
    result = read_result(file)
    check_outputs([output], [result.model.chains.robot.file], force)
    if chain is not None:
        require_known("measured chain", chain, result.model.measured_chains)
    encoded = wanted.encode(Exported(result, file, chain), template)
    with write_files({output: encoded.data}, force=force):
        pass
    if json:
        say_json({"format": form, "remarks": list(encoded.remarks)}, [output])
    elif not quiet:
        for remark in encoded.remarks:
            notice(remark)
        say_written([f"wrote {output}"])
    return 0
