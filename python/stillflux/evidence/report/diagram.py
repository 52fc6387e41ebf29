"""Diagrams for the pages: the blocks of the drive, and what its filter sees."""

from __future__ import annotations

import html
import math

__all__ = ["drive", "innovation"]

_WIDTH, _HEIGHT = 900, 340
_BOXES = (
    (75, 40, 130, 60, "speed control", "ramp, limits"),
    (250, 40, 150, 60, "flux and current", "control"),
    (450, 40, 160, 60, "inverter model", "dead time, threshold"),
    (690, 40, 150, 60, "PWM inverter", "dc link u_dc"),
    (690, 225, 150, 60, "induction motor", "load"),
    (215, 205, 380, 100, "estimator", ""),
)
"""Left, top, width, height, title, what is in it."""
_ARROWS = (
    ("M15 70 H73", (20, 60, "ω*")),
    ("M205 70 H248", (212, 60, "T*")),
    ("M400 70 H448", (412, 60, "u*")),
    ("M610 70 H688", (622, 60, "duties")),
    ("M765 100 V223", (774, 165, "u_s")),
    ("M690 255 H597", (605, 246, "i_a, i_b, i_c")),
    ("M530 100 V203", (538, 155, "voltage less losses")),
    ("M325 205 V102", (333, 155, "flux, its angle")),
    ("M215 255 H140 V102", (148, 155, "speed, torque")),
)
"""Path, and place and text of its label."""
_SCHEMES = (
    'scheme "paper": integrator, offset estimator,',
    "noise compensator, adaptation of r_s",
    'scheme "enhanced": one filter of eleven states',
)


def drive() -> str:
    """The drive as SVG: what is measured, what is estimated, what both schemes have in common. In the colours
    of the page."""
    ink, faint, shade = _INK, _FAINT, "var(--shade, #f2f4f5)"
    parts = [_begin(_WIDTH, _HEIGHT, "Block diagram of the drive")]
    for path, (x, y, text) in _ARROWS:
        parts.append(
            f"<path d='{path}' fill='none' stroke='{ink}' stroke-width='1.4' marker-end='url(#tip)'/>"
        )
        parts.append(f"<text x='{x}' y='{y}' fill='{faint}'>{html.escape(text)}</text>")
    for x, y, width, height, title, note in _BOXES:
        middle = x + width / 2
        parts.append(
            f"<rect x='{x}' y='{y}' width='{width}' height='{height}' rx='6' fill='{shade}' stroke='{ink}'/>"
        )
        parts.append(_text(middle, y + 26, title, ink, 14))
        parts.append(_text(middle, y + 46, note, faint, 12))
    for k, text in enumerate(_SCHEMES):
        parts.append(_text(405, 254 + 18 * k, text, faint, 12))
    parts.append(
        _text(450, 330, "sensors: two or three currents and the dc link; none at the shaft", faint, 13)
    )
    return "".join(parts) + "</svg>"


def innovation() -> str:
    """The error of the rotor flux that the innovation shows, at rest and while the field turns, as SVG."""
    q = 0.8
    parts = [_begin(_WIDTH, _HEIGHT, "Direction in which the filter sees the flux error")]
    for left, title, below in (
        (20, "ω_s = 0 under load", "one direction never shows: its variance grows"),
        (470, "the field turns", "the direction turns with it: all of the error shows"),
    ):
        x, y, length = left + 30.0, 235.0, 230.0
        tip = x + length
        parts.append(_text(left + 205, 28, title, _INK, 15))
        parts.append(_text(left + 205, _HEIGHT - 12, below, _FAINT, 13))
        # Magnitude by the current model: where the tip lies by the one measurement, if the angle were right.
        arc = [(x + length * math.cos(a), y - length * math.sin(a)) for a in (-0.3, 0.75)]
        parts.append(
            f"<path d='M{arc[0][0]:.1f} {arc[0][1]:.1f} A{length:g} {length:g} 0 0 0 {arc[1][0]:.1f} "
            f"{arc[1][1]:.1f}' fill='none' stroke='{_FAINT}' stroke-dasharray='4 4'/>"
        )
        seen = math.atan2(-q, 1.0)
        turns = (0.0,) if left < 100 else (0.0, 0.55, 1.1, 1.65, 2.2, 2.75)
        long, short = (84.0, 11.0) if left < 100 else (13.0, 11.0)
        # The axis that is not seen lies at right angles to the one that is.
        tilt = -math.degrees(seen + math.pi / 2)
        parts.append(
            f"<ellipse cx='{tip:g}' cy='{y:g}' rx='{long:g}' ry='{short:g}' fill='{_TRUE}' "
            f"fill-opacity='.25' stroke='{_TRUE}' transform='rotate({tilt:.1f} {tip:g} {y:g})'/>"
        )
        for turn in turns:
            dx, dy = 62.0 * math.cos(seen + turn), -62.0 * math.sin(seen + turn)
            faded = 1.0 if not turn else 0.35
            parts.append(
                f"<path d='M{tip - dx:.1f} {y - dy:.1f} L{tip + dx:.1f} {y + dy:.1f}' fill='none' "
                f"stroke='{_SEEN}' stroke-width='1.6' stroke-opacity='{faded:g}'/>"
            )
        parts.append(
            f"<path d='M{x:g} {y:g} H{tip:g}' fill='none' stroke='{_INK}' stroke-width='2' "
            f"marker-end='url(#tip)'/>"
        )
        parts.append(_text(x + 0.38 * length, y - 10, "estimated rotor flux, along n", _INK, 13))
        parts.append(_text(tip + 66, y + 66, "seen", _SEEN, 13))
        if left < 100:
            parts.append(_text(tip + 92, y - 84, "not seen", _TRUE, 13))
        parts.append(_text(x + 85, y - 130, "magnitude by the current", _FAINT, 12))
    return "".join(parts) + "</svg>"


_INK, _FAINT = "var(--ink, #1d2125)", "var(--faint, #5b646c)"
_TRUE, _SEEN = "var(--true, #1b4f8f)", "#c8501e"


def _begin(width: int, height: int, label: str) -> str:
    return (
        f"<svg xmlns='http://www.w3.org/2000/svg' viewBox='0 0 {width} {height}' role='img' "
        f"aria-label='{label}' font-family='system-ui, sans-serif' font-size='14'>"
        "<defs><marker id='tip' viewBox='0 0 8 8' refX='7' refY='4' markerWidth='7' markerHeight='7' "
        f"orient='auto'><path d='M0 0 L8 4 L0 8 z' fill='{_INK}'/></marker></defs>"
        f"<rect width='{width}' height='{height}' fill='var(--paper, #fff)'/>"
    )


def _text(x: float, y: float, text: str, colour: str, size: int) -> str:
    return (
        f"<text x='{x:g}' y='{y:g}' text-anchor='middle' fill='{colour}' font-size='{size}'>"
        f"{html.escape(text)}</text>"
    )
