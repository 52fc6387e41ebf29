"""Self-contained HTML pages: contents list, tables that become cards on a narrow screen, light and dark.

Nothing is loaded from elsewhere, and nothing needs a script.
"""

from __future__ import annotations

import html
import io
import re
from pathlib import Path
from typing import TYPE_CHECKING

from stillflux.outputs import write_text

if TYPE_CHECKING:
    from matplotlib.figure import Figure

__all__ = ["page", "svg", "write"]

_STYLE = """
:root { color-scheme: light dark; --paper: #fff; --ink: #1d2125; --faint: #5b646c; --line: #dfe3e6;
 --shade: #f2f4f5; --good: #176f2c; --bad: #b3261e; --limit: #8a5a00; --control: #35516b; --link: #14569c;
 --true: #1b4f8f; --third: #5f6b73; --grid: #e4e4e4 }
@media (prefers-color-scheme: dark) { :root {
 --paper: #14171a; --ink: #e3e6e8; --faint: #9aa4ab; --line: #353b40;
 --shade: #23282c; --good: #6ac987; --bad: #ff8a80; --limit: #e0b04c; --control: #9dbad6; --link: #8ab8ec;
 --true: #6fa8e6; --third: #a0abb3; --grid: #30363b } }
* { box-sizing: border-box }
body { font: 15px/1.5 system-ui, sans-serif; color: var(--ink); background: var(--paper);
 max-width: 64rem; margin: 2rem auto; padding: 0 1rem; overflow-wrap: break-word }
h1 { font-size: 1.7rem; line-height: 1.25 } h2 { font-size: 1.3rem; margin-top: 2.5rem }
h2, h3, h4, section { scroll-margin-top: 1rem }
a { color: var(--link) }
nav { background: var(--shade); border-radius: .4rem; padding: .6rem 1rem; margin: 1rem 0 }
nav summary { cursor: pointer; font-weight: 600 }
nav ul { columns: 20rem; margin: .5rem 0; padding-left: 1.1rem } nav li { break-inside: avoid }
.wide { overflow-x: auto; margin: 1rem 0 }
table { border-collapse: collapse } caption { text-align: left; color: var(--faint) }
td, th { padding: .3rem .8rem .3rem 0; border-bottom: 1px solid var(--line); vertical-align: top;
 text-align: left }
.ok { color: var(--good) } .failed { color: var(--bad); font-weight: 600 }
.limit { color: var(--limit) } .control { color: var(--control) }
figure { margin: 1rem 0; overflow-x: auto } svg { max-width: 100%; height: auto; fill: var(--ink) }
code { background: var(--shade); padding: .1rem .3rem; border-radius: .2rem } pre { white-space: pre-wrap }
@media (max-width: 40rem) {
 body { margin: 1rem auto } nav ul { columns: auto }
 figure svg { min-width: min(46rem, .85 * var(--width, 40rem)) }
 table, tbody, tr { display: block } tr:has(> th) { display: none }
 tr { border-bottom: 1px solid var(--line); padding: .5rem 0 }
 td { display: inline-block; border: 0; padding: .1rem 1.2rem .1rem 0 } td:empty { display: none }
 td:first-child { display: block; font-weight: 600 }
 td[data-head]:not(:first-child)::before { content: attr(data-head) " "; color: var(--faint) }
}
"""

_TABLE = re.compile(r"<table>.*?</table>", re.DOTALL)
_ROW = re.compile(r"<tr>.*?</tr>", re.DOTALL)
_CELL = re.compile(r"<(td|th)\b([^>]*)>", re.DOTALL)
_HEADING = re.compile(r"<h2(?: id='(?P<id>[^']*)')?>(?P<text>.*?)</h2>", re.DOTALL)
_TAG = re.compile(r"<[^>]*>")
# Colours of the figures that would not be read on a dark page. White lines lie on maps and stay.
_COLOURS = {
    "fill: #ffffff": "fill: var(--paper, #ffffff)",
    "#000000": "var(--ink, #000000)",
    "#1b4f8f": "var(--true, #1b4f8f)",
    "#5f6b73": "var(--third, #5f6b73)",
    "#e4e4e4": "var(--grid, #e4e4e4)",
}


def page(title: str, body: str) -> str:
    """A page of a body in HTML: `h2` headings are its contents, tables `<table><tr><th>…` get their heads
    into each cell."""
    text, contents = _with_contents(body)
    return (
        f"<!doctype html>\n<html lang='en'><head><meta charset='utf-8'><title>{html.escape(title)}</title>"
        f"<meta name='viewport' content='width=device-width, initial-scale=1'>"
        f"<style>{_STYLE}</style></head>\n"
        f"<body><h1>{html.escape(title)}</h1>\n{contents}{_TABLE.sub(_carded, text)}\n</body></html>\n"
    )


def write(path: Path, title: str, body: str) -> None:
    """Writes a page, and its folder where there is none."""
    path.parent.mkdir(parents=True, exist_ok=True)
    write_text(path, page(title, body))


def svg(figure: Figure) -> str:
    """A figure for inclusion in a page: in its colours, without anything that varies from run to run."""
    import matplotlib as mpl

    buffer = io.StringIO()
    with mpl.rc_context({"svg.hashsalt": "stillflux"}):
        figure.savefig(buffer, format="svg", metadata={"Date": None})
    text = buffer.getvalue()
    text = text[text.index("<svg") :]
    for colour, variable in _COLOURS.items():
        text = text.replace(colour, variable)
    # On a narrow screen a figure is made somewhat smaller, and scrolls; a small one is not made larger.
    width = round(96 * float(figure.get_figwidth()))
    return text.replace("<svg ", f"<svg style='--width: {width}px' ", 1)


def _with_contents(body: str) -> tuple[str, str]:
    """The body with an anchor at every `h2`, and the list of them; none of fewer than three."""
    entries: list[str] = []

    def anchored(match: re.Match[str]) -> str:
        anchor = match["id"] or f"part-{len(entries) + 1}"
        entries.append(f"<li><a href='#{anchor}'>{_TAG.sub('', match['text'])}</a></li>")
        return f"<h2 id='{anchor}'>{match['text']}</h2>"

    text = _HEADING.sub(anchored, body)
    if len(entries) < 3:
        return text, ""
    return (
        text,
        f"<nav><details open><summary>Contents</summary><ul>{''.join(entries)}</ul></details></nav>\n",
    )


def _carded(match: re.Match[str]) -> str:
    """A table within a frame that scrolls, each cell with the head of its column: on a narrow screen a row
    becomes a card."""
    rows = _ROW.findall(match[0])
    if not rows or "<th" not in rows[0]:
        return f"<div class='wide'>{match[0]}</div>"
    heads = [_TAG.sub("", cell) for cell in re.findall(r"<th[^>]*>(.*?)</th>", rows[0], re.DOTALL)]
    lines = [rows[0]]
    for row in rows[1:]:
        at = 0

        def labelled(cell: re.Match[str]) -> str:
            nonlocal at
            head = heads[at] if at < len(heads) else ""
            span = re.search(r"colspan='(\d+)'", cell[2])
            at += int(span[1]) if span else 1
            quoted = head.replace("'", "&#39;")
            label = f" data-head='{quoted}'" if head and not span else ""
            return f"<{cell[1]}{cell[2]}{label}>"

        lines.append(_CELL.sub(labelled, row))
    return f"<div class='wide'><table>{''.join(lines)}</table></div>"
