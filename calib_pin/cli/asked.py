"""Everything a command can be asked for, one declaration for each.

A field is an argument or an option, whose help are the attributes in the docstring;
what stands above them is the help of the command. The work is in the module that has
its name, which is not loaded for help.
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Annotated

import calib_pin.cli.options as options
from calib_pin.cli.options import SEED, Request, Spec, known


class Init(options.Answer, options.OfStations):
    """Draft a setup file from a robot and its measurements.

    Finds the tip, the joints, what was measured, foreign names of columns and their
    units, by testing candidates on the nominal robot, and says in comments what it
    found. For what it cannot infer an error names the option that says it. The setup
    file that `detect` wrote (--setup) has the board and the camera.

    Attributes:
        measurements: CSV or Parquet files with one row per measurement, as they are.
        output: Setup file to write; without it, it is printed.
        tip: Last link of the chain; of chains that the measurements name, NAME=LINK,...
        distance: Known distance of the two sockets of each place, such as '50 mm'.
        board: Board of a camera, as for 'detect'.
    """

    measurements: Annotated[list[Path], Spec("MEASUREMENTS...", "")]
    output: Annotated[Path | None, Spec("YAML", "Output")] = None
    distance: Annotated[str | None, Spec("LENGTH", "Robot")] = None
    board: Annotated[str | None, Spec("SPEC", "Robot")] = None


class Calibrate(
    options.QuietAnswer,
    options.Shown,
    options.Shared,
    options.Pictured,
    options.Detailed,
    options.Request,
):
    """Fit a robot to measurements and write the corrected URDF.

    DIR receives <robot name>.urdf, nominal.urdf, calibration.json, measurements.csv
    (residuals) and report.html (for the browser); it can be moved as a whole. Without
    --validation, --holdout or a column 'set' (train, validate), five-fold
    cross-validation checks the fit. Where there is nothing to correct, <robot
    name>.urdf is the nominal file. Exit status 2: the result is unchecked or must not
    be trusted; the reason comes first, and no <robot name>.urdf is written.

    Attributes:
        output: Folder for the results; without it they are only printed.
    """

    output: Annotated[Path | None, options.Spec("DIR", "Output")] = None


class Watch(options.QuietAnswer, options.Shown, Request):
    """Follow measurements while they are taken.

    Reads the files again whenever another program has written to them. Each new row is
    compared with its prediction by the rows before it; the verdict so far, the expected
    accuracy and the configuration to measure next follow. Ctrl-C ends, with the result
    as calibrate would write it. The same command goes on with the rows that are there.
    Exit status 2: the result, or with --once the verdict so far, is unchecked or must
    not be trusted.

    Attributes:
        output: Folder for the results, written at the end as by calibrate.
        plan: Configurations to measure.
        type: Ask for the readings of --plan one by one, and write the rows.
        board: MEASUREMENTS are a folder of images of this board, see detect; their
            corners go to a file of its name beside it.
        joints: With --board, the configurations by a column 'image' (file name).
        limit: Expected error of the tool point to reach [m]; by default 'limit' of the
            setup file.
        srdf: SRDF file of the pairs of links that need no collision check.
        once: Look once, and end without a result.
    """

    output: Annotated[Path | None, Spec("DIR", "Output")] = None
    plan: Annotated[Path | None, Spec("CSV", "Watch")] = None
    type: Annotated[bool, Spec("", "Watch", needs="plan", excludes=("json",))] = False
    board: Annotated[str | None, Spec("SPEC", "Watch")] = None
    joints: Annotated[Path | None, Spec("CSV", "Watch", needs="board")] = None
    limit: Annotated[float | None, Spec("S", "Watch", (1e-6, 1))] = None
    srdf: Annotated[Path | None, Spec("FILE", "Watch")] = None
    once: Annotated[bool, Spec("", "Watch", excludes=("output", "type"))] = False


class Identify(
    options.Shown, options.Detailed, options.OfStations, options.OfParameters
):
    """Print which parameters are identifiable.

    Some are so in combinations only. Without measurements: structural identifiability,
    from the robot and the measurement model alone. With measurements: practical
    identifiability. No file is written.

    Attributes:
        measurements: CSV or Parquet files; without them identifiability is structural.
        seed: Random seed.
    """

    measurements: Annotated[list[Path] | None, Spec("[MEASUREMENTS...]", "")] = None
    seed: Annotated[int, Spec("N", parse=SEED)] = 0


class Evaluate(
    options.Shown, options.OfStations, options.OfChain, options.OfCalibration
):
    """Print the accuracy of a robot or a calibration on measurements.

    A URDF knows neither base nor tool: they are registered on these measurements, and
    the output says so. A calibration is used as it is unless --register is given. Exit
    status 2: the measurements are too few, or the calibration must not be trusted.

    Attributes:
        measurements: CSV or Parquet files.
        register: Register the frames and the instrument of a calibration on these
            measurements.
    """

    measurements: Annotated[list[Path], Spec("MEASUREMENTS...", "")]
    register: Annotated[bool, Spec()] = False


class Accept(options.QuietAnswer, options.OfCalibration):
    """Test repeated poses in the terms of ISO 9283.

    Measurements of the same configuration are visits of one pose; columns 'pose' and
    'cycle' number them. The commanded pose is that of the robot's model, with base and
    tool of a calibration, or of the setup ('frames'), or registered on measurements
    that a column 'set' marks 'train' beside visits marked 'validate'. Otherwise they
    are fitted to the visits, and AP is not testable. 'limit' in the setup says what
    must be reached, 'report' what stands on the printed report; without it both are
    those of the calibration. A certified test needs the standard itself. Exit status 2:
    a limit is not reached, or the test does not decide.

    Attributes:
        measurements: CSV files with the visits of poses, in their order.
        output: Folder for acceptance.json, .csv, .html and .pdf; without it the test is
            only printed.
        register: Fit the station of a calibration anew, never its tool.
    """

    measurements: Annotated[list[Path], Spec("MEASUREMENTS...", "")]
    output: Annotated[Path | None, Spec("DIR", "Output")] = None
    register: Annotated[bool, Spec("", "Robot")] = False


MANY = (1, 1e6)


class Simulate(options.Answer, options.OfParameters):
    """Simulate measurements of a robot with known errors.

    Errors that are not given are drawn uniformly within the expected size of each
    parameter, such as plus and minus 1 mm and 3 mrad for a placement. Frames and planes
    are taken from the setup file. Its chains, stations and tools share the
    configurations, unless columns 'chain', 'station' and 'tool' of --configurations say
    what is measured at each. Of a board each image shows all corners in sight.

    Attributes:
        output: Measurement file to write.
        model: Measurement model, or several joined by +.
        count: Number of random configurations, or
        configurations: the configurations of this file.
        errors: True errors by parameter name [m, rad]; by default drawn.
        seed: Random seed of errors, configurations and noise.
        noise: Standard deviation of every component [m, rad]; by default that of the
            setup file, or 0.1 mm and 0.1 mrad.
        repeats: Readings per configuration.
        truth: Write the robot with its true errors.
    """

    output: Annotated[Path, Spec("CSV", "Output")]
    count: Annotated[int | None, Spec("N", "Simulation", MANY)] = None
    configurations: Annotated[Path | None, Spec("CSV", "Simulation")] = None
    errors: Annotated[Path | None, Spec("YAML", "Simulation")] = None
    seed: Annotated[int, Spec("N", "Simulation", SEED)] = 0
    noise: Annotated[float | None, Spec("S", "Simulation", (0, 1))] = None
    repeats: Annotated[int, Spec("K", "Simulation", MANY)] = 1
    truth: Annotated[Path | None, Spec("URDF", "Output")] = None


MOUNT = known("mount", "", "hand", "world")

IMAGED = ("images", "output", "joints", "mount", "setup_output")
"""Fields that are for images of a board, not for the board itself."""


class Detect(options.QuietAnswer):
    """Find the corners of boards and tags in images.

    They are measurements of the model 'camera'. Corners are numbered row by row from 0,
    those of tag 7 are 7/0 to 7/3, clockwise. Pixel centers are whole numbers, the first
    is (0, 0). Standard deviations follow from the noise of the image and the edges at
    each corner. Needs OpenCV: pip install 'calib-pin[vision]'.

    Attributes:
        images: Images of one camera: PNG, JPEG, TIFF, BMP, PGM.
        output: Measurement file to write.
        board: The board, lengths in m: charuco:7x5:SQUARE:MARKER:DICT_4X4_50 (':legacy'
            at the end for boards of OpenCV before 4.6), chessboard:9x6:SQUARE,
            circles:9x6:DISTANCE, apriltag:6x6:EDGE:GAP,
            marker:1x1:EDGE:DICT_4X4_50:first=7; columns x rows of squares (not of inner
            corners), circles or tags. Default is 'board' of the setup file.
        setup: Setup file with the 'board'.
        joints: Configurations: those of a column 'image' (file name); a log with times,
            see --times; or in the order of the images, img_2 before img_10. All its
            columns are passed on, as 'time'. Without it the output has no joints; its
            column 'image' tells which to add.
        times: When the images were taken, columns 'image' and 'time': each gets the
            joints of its standstill in the log of --joints.
        mount: Where the camera is: hand (default) or world (board on the robot).
        setup_output: Write a setup file for calibrate: the board, and the camera with
            intrinsics to start from.
        draw: Write the board to print (charuco and tags) at its size; no images then.
    """

    images: Annotated[list[Path] | None, Spec("IMAGES...", "")] = None
    output: Annotated[Path | None, Spec("CSV", "Output")] = None
    board: Annotated[str | None, Spec("SPEC", "Images", excludes=("setup",))] = None
    setup: Annotated[Path | None, Spec("FILE", "Images")] = None
    joints: Annotated[Path | None, Spec("CSV", "Images")] = None
    times: Annotated[Path | None, Spec("CSV", "Images", needs="joints")] = None
    mount: Annotated[str, Spec("WHERE", "Images", MOUNT)] = "hand"
    setup_output: Annotated[Path | None, Spec("FILE", "Output")] = None
    draw: Annotated[Path | None, Spec("PNG", "Output", excludes=IMAGED)] = None


SECONDS = (1e-3, 60)


class Join(options.QuietAnswer):
    """Join two logs by time to a measurement file.

    Readings count where the joints stood still; those in motion are dropped and
    counted. The offset of both clocks is estimated from the motions between, if the
    instrument measured during some. The standard deviation of a mean is that of
    readings that scatter about it, by their autocorrelation. Images, which have a
    column 'image', stay apart; a list of images and times gets their joints. Files
    without times are joined by the names of points that both have. A bag with
    CalibrationData (robot_calibration) is given twice.

    Attributes:
        log: Log of the joints: CSV with a column of times, or a bag of ROS.
        measurements: Log of the instrument, by its own clock: CSV or a bag.
        output: Measurement file to write.
        setup: Setup file: 'columns' says which foreign names are ours.
        settle: Time that the joints stand before a reading counts [s]; default 0.5.
        tolerance: Longest time without a sample of the joints [s]; default 0.5.
        topic: Topic of MEASUREMENTS if it is a bag, of transforms the child frame;
            default the only one.
        joint_topic: Topic of JOINTS if it is a bag.
        keep: Keep every reading, instead of one mean for each standstill.
    """

    log: Annotated[Path, Spec("JOINTS", "")]
    measurements: Annotated[Path, Spec("MEASUREMENTS", "")]
    output: Annotated[Path, Spec("CSV", "Output")]
    setup: Annotated[Path | None, Spec("FILE", "Logs")] = None
    settle: Annotated[float, Spec("S", "Logs", SECONDS)] = 0.5
    tolerance: Annotated[float, Spec("S", "Logs", SECONDS)] = 0.5
    topic: Annotated[str | None, Spec("NAME", "Logs")] = None
    joint_topic: Annotated[str | None, Spec("NAME", "Logs")] = None
    keep: Annotated[bool, Spec("", "Logs")] = False


CRITERION = known("criterion", "planning.plan:CRITERION_NAMES")
METHOD = known("method", "planning.search:METHODS")


SELECTED = (
    *("model", "count", "add", "to", "criterion", "method", "candidates", "tests"),
    *("seed", "parameters"),
)
"""Fields of plans that an acceptance test has no use for."""

SOLID = ("srdf", "clearance")
"""Fields that are for collisions."""


class Plan(
    options.QuietAnswer,
    options.InDegrees,
    options.OfChain,
    options.OfParameters,
):
    """Choose optimal calibration configurations.

    They keep the joint limits, collide with nothing, lie in the region of the setup
    file, and are ordered for short travel. A table shows the accuracy that more or
    fewer of them would give.

    Attributes:
        count: Number of configurations.
        add: Plan what tells most beside the measurements of --to.
        to: Measurements that exist already; may be repeated.
        criterion: prediction (default; the predicted tool-point uncertainty),
            condition, or O1 to O5.
        method: auto (default; exchange, then gradient), exchange, greedy, pso, ga or
            gradient.
        candidates: Quasi-random configurations to choose from.
        seed: Random seed.
        start: Plan for a calibration that goes on from this older one.
        tests: Configurations where the robot is to be accurate; by default everywhere.
        accept: Plan an acceptance test instead: five poses of a cube, and its schedule.
        cycles: Visits of each pose of an acceptance test.
        srdf: SRDF file of the pairs of links that need no collision check.
        clearance: Least distance from obstacles and between links [m]; default 0.01.
        ignore_collisions: Check no collisions.
        output: File of configurations to write.
    """

    count: Annotated[int | None, Spec("N", "Plan", (1, 1000))] = None
    add: Annotated[bool, Spec("", "Plan", needs="to")] = False
    to: Annotated[list[Path] | None, Spec("CSV", "Plan", needs="add")] = None
    criterion: Annotated[str, Spec("NAME", "Plan", CRITERION)] = "prediction"
    method: Annotated[str, Spec("NAME", "Plan", METHOD)] = "auto"
    candidates: Annotated[int, Spec("N", "Plan", (1, 1e5))] = 1000
    seed: Annotated[int, Spec("N", "Plan", SEED)] = 0
    start: Annotated[Path | None, Spec("CALIBRATION", "Plan")] = None
    tests: Annotated[Path | None, Spec("CSV", "Plan")] = None
    accept: Annotated[bool, Spec("", "Plan", excludes=SELECTED)] = False
    cycles: Annotated[int, Spec("N", "Plan", (3, 1000), needs="accept")] = 30
    srdf: Annotated[Path | None, Spec("FILE", "Constraints")] = None
    clearance: Annotated[float, Spec("S", "Constraints", (0, 1))] = 0.01
    ignore_collisions: Annotated[bool, Spec("", "Constraints", excludes=SOLID)] = False
    output: Annotated[Path, Spec("CSV", "Output")]


FRAMES, POINTS = ("measuring", "base"), ("tool", "tip")
"""Frames of targets, and points that are brought there; the usual ones first."""

PROGRAM = known("format", "io.exchange.motions:PROGRAMS", "csv")
FRAME, POINT = known("frame", "", *FRAMES), known("point", "", *POINTS)


class Compensate(options.QuietAnswer, options.InDegrees, options.OfChain):
    """Find joint commands that reach targets on the real robot.

    Commands for targets have a column 'row', the line of the target. A motion keeps its
    other columns; its commands bring the tip link to where that of the nominal robot
    would be in the base link (with fewer than six joints: its position), as exactly as
    base and tool are known. Collisions are not checked. Exit status 2: a target cannot
    be reached (only the others are written, of a motion none), or the calibration must
    not be trusted (no command is written).

    Attributes:
        calibration: A calibration.
        targets: CSV file of positions or poses (optionally with joint positions to
            start from), or of joint positions alone: a motion of the nominal robot.
        output: File of joint commands to write.
        setup: Setup file (YAML); options override it.
        frame: Frame of the targets: measuring (default), that of the measurements, or
            base, the base link.
        point: Point to bring there: tool (default), the measured point, or tip, the tip
            link.
        payload: Payload of the robot, by its name in the setup of the calibration; none
            for nothing.
        station: Station in whose measurement frame the targets are; default the first.
        tool: Tool to bring there; default the first.
        position: Reach positions only, with any orientation.
        format: csv (default); urscript, a program of moves; joint-trajectory, a message
            of ROS (YAML).
        speed: Part of the URDF's joint speeds at which commands follow one another: of
            programs (default 0.25, or the file's own times), in CSV a column 'time'.
    """

    calibration: Annotated[Path, Spec("calibration.json", "")]
    targets: Annotated[Path, Spec("TARGETS", "")]
    output: Annotated[Path, Spec("CSV", "Output")]
    setup: Annotated[Path | None, Spec("FILE", "Robot")] = None
    frame: Annotated[str | None, Spec("NAME", "Targets", FRAME)] = None
    point: Annotated[str | None, Spec("NAME", "Targets", POINT)] = None
    payload: Annotated[str | None, Spec("NAME", "Targets")] = None
    station: Annotated[str | None, Spec("NAME", "Targets")] = None
    tool: Annotated[str | None, Spec("NAME", "Targets")] = None
    position: Annotated[bool, Spec("", "Targets")] = False
    format: Annotated[str, Spec("NAME", "Output", PROGRAM)] = "csv"
    speed: Annotated[float | None, Spec("PART", "Output", (1e-3, 1))] = None


FORMAT = known("format", "io.exchange:FORMATS")


class Export(options.QuietAnswer, options.OfChain):
    """Write a calibration as other software loads it.

    Exit status 1: the calibration must not be trusted, or has nothing of this kind.

    Attributes:
        calibration: Folder of the results, or its .json file.
        format: One of ur-kinematics, xarm-kinematics, xacro, mjcf, ros2-control,
            lerobot, joint-offsets, camera-info, dh, tf.
        output: The file to write.
        template: Your own file of this format, which is corrected: needed for
            ur-kinematics, xarm-kinematics and lerobot, possible for ros2-control.
    """

    calibration: Annotated[Path, Spec("DIR|CALIBRATION", "")]
    format: Annotated[str, Spec("NAME", "Output", FORMAT)]
    output: Annotated[Path, Spec("FILE", "Output")]
    template: Annotated[Path | None, Spec("FILE", "Output")] = None


class Fleet(options.QuietAnswer, options.Shared):
    """Calibrate many robots, or simulate them before a purchase.

    Every job gets a folder of results as 'calibrate' writes it. fleet.csv and
    fleet.html list verdicts, accuracy before and after, and the drift since the last
    calibration of the same serial number, those that need attention first. A job that
    fails is a row with its reason and stops nothing. Workers of a cluster need to see
    the same files. Exit status 2: some calibration failed or must not be trusted.

    Attributes:
        table: Table of calibrations, CSV or YAML: robot, measurements, setup,
            serial_number, date, ...
        monte_carlo: Simulate robots instead, as 'monte_carlo' in this setup file says:
            how accurate will they be, against number of configurations?
        seed: Random seed of the study.
        output: Folder for all results.
        resume: Go on with what a stopped run has left, as far as it is whole.
        no_pages: No report.html in the folders; 'calib-pin report' writes it later.
    """

    table: Annotated[Path | None, Spec("JOBS", "")] = None
    monte_carlo: Annotated[
        Path | None, Spec("SETUP", "Study", excludes=("table", "no_pages"))
    ] = None
    seed: Annotated[int, Spec("N", "Study", SEED, needs="monte_carlo")] = 0
    output: Annotated[Path, Spec("DIR", "Output")]
    resume: Annotated[bool, Spec("", "Output")] = False
    no_pages: Annotated[bool, Spec("", "Output")] = False


class Compare(options.Asked):
    """Print the difference between two calibrations of a robot.

    Tool points are compared in the base link. Where base and tool were estimated, a
    displacement of them is removed by a fit: a tracker at another station is no drift
    of the robot, nor is another tool. Parameters and combinations are listed where they
    differ by more than three standard deviations. Exit status 2: one of the
    calibrations must not be trusted, or they are of different robots.

    Attributes:
        first: A calibration of a robot.
        second: A later one, or another model of the robot.
        seed: Random seed of the configurations that are compared.
    """

    first: Annotated[Path, Spec("A.json", "")]
    second: Annotated[Path, Spec("B.json", "")]
    seed: Annotated[int, Spec("N", "Workspace", SEED)] = 0


class Report(options.QuietAnswer, options.Pictured, options.OfPackages):
    """Write the page and figures of a calibration again.

    calibration.json, measurements.csv and the robot are all that it takes. The robot is
    drawn with its meshes where they are found as in the calibration, and with simple
    shapes where the folder has been moved away from them. Without
    measurements.csv it has no figures of single measurements. '--pdf' writes a report
    to be printed and signed; 'report' in the setup of the calibration says whose robot
    it is. Exit status 2: the calibration must not be trusted.

    Attributes:
        calibration: Folder of the results, or its .json file.
        output: The page; default report.html of the folder, which is replaced.
        pdf: Write a PDF for a customer as well.
    """

    calibration: Annotated[Path, Spec("DIR|CALIBRATION", "")]
    output: Annotated[Path | None, Spec("PAGE", "Output")] = None
    pdf: Annotated[Path | None, Spec("FILE", "Output")] = None


class Windowed(options.Asked):
    """A page as it is asked for.

    Attributes:
        port: Port on this machine; 0 for any free port.
    """

    port: Annotated[int, Spec("N", "Window", (0, 65535))] = 8080


class View(Windowed, options.OfStations, options.OfChain, options.OfCalibration):
    """Show a robot, its errors and a plan in the browser.

    A calibration shows the nominal robot beside the corrected one. Errors are those of
    the nominal robot with base and tool registered on these measurements (before), and
    those of the calibration as it is (after). The page is open to this machine only, at
    the address that is printed.

    Attributes:
        measurements: CSV or Parquet files.
        plan: Configurations to go through.
    """

    measurements: Annotated[list[Path] | None, Spec("[MEASUREMENTS...]", "")] = None
    plan: Annotated[Path | None, Spec("CSV", "Window")] = None


class App(Windowed):
    """Calibrate in a page of the browser.

    A robot and measurements are dropped or chosen there; the page shows what was found,
    calibrates, and has the corrected URDF to download. It is open to this machine only,
    at the address that is printed. Every tab is a job of its own. What is dropped goes
    to a temporary folder, which is removed at the end.
    """


class Robots(options.Answer):
    """List the bundled robots, or copy one with example measurements.

    Their names can stand for a URDF file. A copy holds robot.urdf, measurements.csv and
    setup.yaml: a calibration to try.

    Attributes:
        name: The robot to copy; without it, a list.
        output: Folder for its URDF and example files.
    """

    name: Annotated[str | None, Spec("[NAME]", "")] = None
    output: Annotated[Path | None, Spec("DIR", "Output")] = None


COMMANDS: Mapping[str, type] = {
    kind.__name__.lower(): kind
    for kind in (
        *(Init, Calibrate, Watch, Identify, Evaluate, Accept, Simulate, Detect, Join),
        *(Plan, Compensate, Export, Fleet, Compare, Report, View, App, Robots),
    )
}
"""The commands by their names, in the order of their help."""
