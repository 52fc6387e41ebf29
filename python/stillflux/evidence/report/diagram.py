"""The drive as a block diagram, for the pages."""

from __future__ import annotations

import html

__all__ = ["drive"]

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
    ink, faint, shade = "var(--ink, #1d2125)", "var(--faint, #5b646c)", "var(--shade, #f2f4f5)"
    parts = [
        f"<svg xmlns='http://www.w3.org/2000/svg' viewBox='0 0 {_WIDTH} {_HEIGHT}' role='img' "
        f"aria-label='Block diagram of the drive' font-family='system-ui, sans-serif' font-size='14'>"
        "<defs><marker id='tip' viewBox='0 0 8 8' refX='7' refY='4' markerWidth='7' markerHeight='7' "
        f"orient='auto'><path d='M0 0 L8 4 L0 8 z' fill='{ink}'/></marker></defs>"
        f"<rect width='{_WIDTH}' height='{_HEIGHT}' fill='var(--paper, #fff)'/>"
    ]
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


def _text(x: float, y: float, text: str, colour: str, size: int) -> str:
    return (
        f"<text x='{x:g}' y='{y:g}' text-anchor='middle' fill='{colour}' font-size='{size}'>"
        f"{html.escape(text)}</text>"
    )
