"""Pages: contents, cards on a narrow screen, colours of light and dark; the map of the plane."""

from __future__ import annotations

import math
import re
from dataclasses import fields
from pathlib import Path
from typing import Any

import pytest

import stillflux as sf
from stillflux import html_page
from stillflux.evidence import plane_points
from stillflux.evidence.beyond import Row
from stillflux.evidence.claims import holds
from stillflux.evidence.documents import PLANE, README_MACHINES, draw_plane, drawn_from
from stillflux.evidence.judge import Measured
from stillflux.evidence.plane_points import PlanePoint
from stillflux.evidence.report import diagram, maps
from stillflux.plots import new_figure

ROOT = Path(__file__).resolve().parents[1]
POINTS = ROOT / "tests" / plane_points.FILE


def test_the_code_of_the_firmware_page_is_that_of_the_examples() -> None:
    """Each block names its source, whose lines are compiled by `test_firmware_examples.py`."""
    page = (ROOT / "docs" / "firmware.md").read_text(encoding="utf-8")
    blocks = re.findall(r"```rust\n// (\S+\.rs)\n(.*?)```", page, re.DOTALL)
    assert len(blocks) == 5
    for source, block in blocks:
        lines = {line.strip() for line in (ROOT / source).read_text(encoding="utf-8").splitlines()}
        missing = [line for line in block.splitlines() if line.strip() and line.strip() not in lines]
        assert not missing, source


def test_a_page_has_contents_of_its_headings() -> None:
    text = html_page.page("A < B", "<h2>one</h2><h2 id='x'>two <code>2</code></h2><h2>three</h2>")
    assert "<title>A &lt; B</title>" in text
    assert "name='viewport'" in text
    assert "prefers-color-scheme: dark" in text
    assert re.findall(r"<li><a href='#([^']*)'>([^<]*)</a>", text) == [
        ("part-1", "one"),
        ("x", "two 2"),
        ("part-3", "three"),
    ]
    assert "<nav>" not in html_page.page("A", "<h2>one</h2>")


def test_a_cell_has_the_head_of_its_column() -> None:
    table = (
        "<table><tr><th>claim</th><th>it's</th><th></th></tr>"
        "<tr><td>a</td><td class='ok'>1</td><td>x</td></tr><tr><td colspan='2'>b</td><td>y</td></tr></table>"
    )
    text = html_page.page("A", table + "<table><tr><td>plain</td></tr></table>")
    assert "<td data-head='claim'>a</td><td class='ok' data-head='it&#39;s'>1</td><td>x</td>" in text
    assert "<td colspan='2'>b</td><td>y</td>" in text
    assert text.count("<div class='wide'><table>") == 2
    assert "<table><tr><td>plain</td></tr></table>" in text


def test_a_figure_takes_the_colours_of_the_page() -> None:
    figure = new_figure(figsize=(2, 2))
    panel = figure.subplots()
    panel.plot([0, 1], color="#1b4f8f")
    panel.plot([1, 0], color="white")
    text = html_page.svg(figure)
    assert "fill: var(--paper, #ffffff)" in text
    assert "stroke: var(--true, #1b4f8f)" in text
    assert "stroke: #ffffff" in text
    assert html_page.svg(figure) == text


@pytest.mark.parametrize(("text", "boxes"), [(diagram.drive(), 7), (diagram.innovation(), 1)])
def test_a_diagram_lies_within_its_frame(text: str, boxes: int) -> None:
    width, height = map(float, re.findall(r"viewBox='0 0 (\d+) (\d+)'", text)[0])
    for x, y in re.findall(r"<(?:rect|text) x='([\d.]+)' y='([\d.]+)'", text):
        assert 0.0 < float(x) < width
        assert 0.0 < float(y) < height
    assert text.count("<rect") == boxes


def point(omega: float, torque: float, angle: float = 1.0, lost: str = "") -> PlanePoint:
    return PlanePoint("2.2kW", "paper", omega, torque, angle, not lost, lost)


def test_points_of_the_plane_are_kept_and_replaced(tmp_path: Path) -> None:
    path = tmp_path / plane_points.FILE
    assert plane_points.read(path) == []
    rows = [_row(0.1, 1.0, 0.5, ""), _row(0.1, 1.0, 0.25, ""), _row(-0.1, 0.0, math.inf, "fault")]
    plane_points.update(path, rows)
    assert plane_points.read(path) == [point(-0.1, 0.0, math.inf, "fault"), point(0.1, 1.0, 0.5)]
    plane_points.update(path, [_row(0.0, 0.2, 0.25, "")])
    assert plane_points.read(path) == [point(0.0, 0.2, 0.25)]
    before = path.read_bytes()
    plane_points.update(path, [_row(0.0, 0.2, 9.0, "", target="plane-drift")])
    assert path.read_bytes() == before
    path.write_text("a,b\n")
    with pytest.raises(ValueError, match="expected machine, scheme"):
        plane_points.read(path)


def _row(omega: float, torque: float, angle: float, why: str, target: str = plane_points.TARGET) -> Row:
    numbers: dict[str, Any] = {field.name: 0.0 for field in fields(Measured)}
    measured = Measured(**{**numbers, "angle_settled": angle, "why": why})
    return Row(target, "2.2kW", "paper", "", 1, "", (omega, torque), measured, (holds("met", not why),))


def test_the_map_is_drawn_once_from_its_points(tmp_path: Path) -> None:
    points, picture = tmp_path / plane_points.FILE, tmp_path / PLANE
    assert draw_plane(tmp_path, points) == []
    (tmp_path / "docs").mkdir()
    plane_points.update(points, [_row(x, y, 1.0, "") for x in (-0.1, 0.1) for y in (-1.0, 1.0)])
    assert draw_plane(tmp_path, points) == [PLANE]
    assert drawn_from(picture) == plane_points.digest(points)
    assert draw_plane(tmp_path, points) == []


def test_the_map_in_the_readme_is_of_the_committed_points() -> None:
    assert drawn_from(ROOT / PLANE) == plane_points.digest(POINTS)
    assert {x.machine for x in plane_points.read(POINTS)} & set(README_MACHINES)
    assert str(PLANE) in (ROOT / "README.md").read_text(encoding="utf-8")
    assert (ROOT / PLANE).stat().st_size < 500_000


def test_a_map_has_a_row_for_each_machine_and_a_legend() -> None:
    points = [
        PlanePoint(machine, scheme, x, y, 1.0, True, "")
        for machine in ("2.2kW", "11kW")
        for scheme in ("paper", "enhanced")
        for x in (-0.1, 0.1)
        for y in (-1.0, 1.0)
    ]
    figure = maps.plane(points)
    assert len(figure.axes) == 5
    assert [text.get_text() for text in figure.legends[0].get_texts()][:2] == ["lost", "not met"]


def test_the_documentation_has_every_name_of_the_package() -> None:
    """By itself, or with the module that defines it."""
    pages = "\n".join(page.read_text(encoding="utf-8") for page in sorted((ROOT / "docs").glob("*.md")))
    shown = set(re.findall(r"(?m)^::: (\S+)", pages))

    def missing(name: str) -> bool:
        module = getattr(getattr(sf, name), "__module__", sf.__name__)
        return not shown & {f"stillflux.{name}", f"{module}.{name}", module}

    assert [name for name in sf.__all__ if name != "__version__" and missing(name)] == []
