"""All figures together: which there are, that they are part of a page, and last."""

from __future__ import annotations

import re
from collections.abc import Callable
from dataclasses import replace
from itertools import islice
from xml.etree import ElementTree

import matplotlib as mpl
import numpy as np
import pytest

import calib_pin
from calib_pin.io.urdf_tree import parse_robot
from calib_pin.kinematics.chain import Chain
from calib_pin.planning.plan import Plan
from calib_pin.report.figures import (
    COLORS,
    NAMES,
    Drawn,
    calibration_figures,
    plan_figures,
)
from calib_pin.report.figures.estimates import parameter_intervals
from calib_pin.report.figures.identifiability import correlations
from calib_pin.validation.result import CalibrationResult
from calib_pin.validation.summaries import Validation

# What has a direction is drawn as arrows, the rest in color; there is one block.
ABSENT = ("errors-in-workspace", "errors-by-block")
DRAWN = [name for name in NAMES["calibration"] if name not in ABSENT]


@pytest.fixture(scope="module")
def drawn(calibrated: CalibrationResult, planned: Plan) -> list[Drawn]:
    return [*calibration_figures(calibrated), *plan_figures(planned)]


@pytest.fixture(scope="module")
def inline(drawn: list[Drawn]) -> list[str]:
    return [figure.svg() for figure in drawn]


def test_all_figures_are_there_in_order(drawn: list[Drawn]) -> None:
    assert [figure.name for figure in drawn] == [*DRAWN, *NAMES["plan"]]
    for figure in drawn:
        assert figure.title and "\n" not in figure.reading
        assert figure.reading.endswith(".") and "  " not in figure.reading


def test_pictures_have_a_heading_and_say_what_to_look_for(drawn: list[Drawn]) -> None:
    """In a page they stand around the figure, which has to be as it was."""
    figure = drawn[-1]
    before = figure.svg()
    words = "".join(ElementTree.fromstring(figure.picture("svg")).itertext())
    assert figure.title in words
    assert all(word in words for word in figure.reading.split())
    assert figure.svg() == before
    assert figure.reading[:20] not in "".join(ElementTree.fromstring(before).itertext())


def test_figures_are_part_of_a_page(drawn: list[Drawn], inline: list[str]) -> None:
    found: list[str] = []
    for figure, svg in zip(drawn, inline, strict=True):
        assert svg.startswith("<svg ")
        root = ElementTree.fromstring(svg)
        assert root.get("role") == "img" and root.get("aria-label") == figure.title
        assert root.get("viewBox") and root.get("width") is None
        assert root[0].tag.endswith("title") and root[0].text == figure.title
        ids = [e.get("id", "") for e in root.iter() if e.get("id")]
        assert all(name.startswith(f"{figure.name}-") for name in ids)
        found += ids
        used = {e.get("href", "")[1:] for e in root.iter() if e.tag.endswith("use")}
        used |= set(re.findall(r"url\(#([^)]*)\)", svg))
        assert used and used <= set(ids)
    assert len(set(found)) == len(found)


def test_figures_take_fonts_and_colors_from_the_page(inline: list[str]) -> None:
    for svg in inline:
        assert "font-family" not in svg and "<style" not in svg
        assert "var(--ink)" in svg
        for color in (*COLORS.values(), "#000000"):
            assert color not in svg
        assert "<text" in svg, "text stays text"
    for name in ("before", "after", "grid", "muted"):
        assert f"var(--{name})" in inline[0]


def test_figures_refer_to_nothing_outside(inline: list[str]) -> None:
    for svg in inline:
        links = re.findall(r'(?:href|src)="([^"]*)"', svg)
        assert all(link.startswith(("#", "data:image/png;base64,")) for link in links)
        assert re.findall(r"https?://[^\" ]*", svg) == ["http://www.w3.org/2000/svg"]


@pytest.mark.parametrize(
    ("kind", "start"),
    [
        ("svg", b"<?xml"),
        pytest.param("png", b"\x89PNG", marks=pytest.mark.slow),
        pytest.param("pdf", b"%PDF", marks=pytest.mark.slow),
    ],
)
def test_the_same_numbers_give_the_same_bytes(
    calibrated: CalibrationResult, inline: list[str], kind: str, start: bytes
) -> None:
    first, again = (
        next(islice(calibration_figures(calibrated), 3, None)) for _ in range(2)
    )
    picture = first.picture(kind)
    assert picture.startswith(start) and picture == again.picture(kind)
    # A picture leaves the figure as it was.
    assert first.svg() == inline[3]


def test_the_style_of_others_is_left_alone(calibrated: CalibrationResult) -> None:
    before = dict(mpl.rcParams)
    figures = calibration_figures(calibrated)
    figure = next(figures)
    assert dict(mpl.rcParams) == before
    figure.svg()
    assert dict(mpl.rcParams) == before


HOSTILE = "$\\a^{2$_<b>&\"']]>\u4e2d\u202e" + 180 * "x" + "end"
"""The name of a joint."""


@pytest.fixture(scope="module")
def hostile() -> CalibrationResult:
    file = calib_pin.robot_file("space6", "robot.urdf")
    escaped = HOSTILE.replace("&", "&amp;").replace("<", "&lt;").replace('"', "&quot;")
    urdf = file.read_text().replace('"joint_3"', f'"{escaped}"')
    chain = Chain(parse_robot(urdf.encode(), "test.urdf"))
    rows = calib_pin.read_measurements(
        calib_pin.robot_file("space6", "measurements.csv"),
        calib_pin.load_chain("space6"),
    )
    rows = replace(rows.only, joints=chain.joints)
    result = calib_pin.calibrate(chain, rows, validate=False)
    assert any(HOSTILE in p.name for p in result.parameters if p.sigma)
    return result


def test_names_are_taken_as_they_are(
    hostile: CalibrationResult, draw: Callable[..., Drawn]
) -> None:
    for figure in (parameter_intervals, correlations):
        svg = draw(figure, hostile).svg()
        shown = "".join(ElementTree.fromstring(svg).itertext())
        assert "$\\a^{2$_<b>&\"'" in shown
        assert "\u202e" not in shown and HOSTILE[:60] not in shown


@pytest.mark.slow
@pytest.mark.parametrize("kind", ["png", "pdf"])
def test_names_in_pictures(
    kind: str, hostile: CalibrationResult, draw: Callable[..., Drawn]
) -> None:
    for figure in (parameter_intervals, correlations):
        assert draw(figure, hostile).picture(kind)


def one_row(result: CalibrationResult) -> CalibrationResult:
    rows = result.fitted
    names = ("before", "after", "sigma", "points", "leverage")
    first = replace(
        rows, rows=rows.rows.rows([0]), **{k: getattr(rows, k)[:1] for k in names}
    )
    none = replace(result.statistics, outliers=())
    return replace(result, fitted=first, held_out=first, statistics=none)


def without(result: CalibrationResult) -> CalibrationResult:
    """A result of which only the rows are left."""
    ranks = replace(
        result.identifiability, singular_values=(), structural_values=(), gap=np.inf
    )
    return replace(
        result,
        verdict="untrusted",
        parameters=(),
        groups=(),
        covariance=np.zeros((0, 0)),
        statistics=replace(result.statistics, sigma0=np.nan, noise=()),
        held_out=None,
        validation=Validation("none", 0),
        accuracies={"": replace(result.accuracy, tip=None)},
        identifiability=ranks,
        solver=replace(result.solver, history=()),
        model_selection=None,
    )


def test_a_single_row_is_drawn(calibrated: CalibrationResult) -> None:
    figures = list(calibration_figures(one_row(calibrated)))
    for figure in figures[:2]:
        ElementTree.fromstring(figure.svg())
    names = [figure.name for figure in figures]
    assert names == [name for name in DRAWN if not name.startswith("residuals")]


def test_what_says_nothing_is_left_out(calibrated: CalibrationResult) -> None:
    found = [figure.name for figure in calibration_figures(without(calibrated))]
    assert found == [
        *("robot-errors", "cumulative-errors"),
        *("errors-per-measurement", "error-vectors"),
        *("residuals-over-order", "residuals-by-joint"),
    ]


@pytest.mark.parametrize(
    ("before", "after"),
    [(0.0, 0.0), (1e-3, np.inf), (np.inf, 1e-300), (np.nan, np.nan), (1e-3, np.nan)],
)
def test_any_errors_can_be_drawn(
    calibrated: CalibrationResult,
    with_errors: Callable[..., CalibrationResult],
    before: float,
    after: float,
) -> None:
    result = with_errors(without(calibrated), before=before, after=after)
    for figure in calibration_figures(
        replace(result, statistics=calibrated.statistics)
    ):
        ElementTree.fromstring(figure.svg())


def test_many_rows_stay_small(many: Callable[[int], CalibrationResult]) -> None:
    names = ("errors-per-measurement", "error-vectors", "residuals")
    of_rows = [f for f in calibration_figures(many(10_000)) if f.name in names]
    svgs = [figure.svg() for figure in of_rows]
    assert sum(map(len, svgs)) < 1_000_000
    assert "<image" in svgs[0], "thousands of points are a picture"
    assert svgs[0].count("<use") < 200
