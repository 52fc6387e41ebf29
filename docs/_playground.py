"""Hook of mkdocs: the playground within the site, if `make playground` has built it."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from mkdocs.structure.files import File, Files

BUILT = Path(__file__).resolve().parents[1] / "target" / "playground"
_PLACE = "<!-- playground -->"


def on_files(files: Files, config: Any) -> Files:
    """Adds the page."""
    if BUILT.is_dir():
        for file in sorted(BUILT.iterdir()):
            files.append(File.generated(config, f"live/{file.name}", content=file.read_bytes()))
    return files


def on_page_markdown(markdown: str, **_: Any) -> str:
    """A link to it where it belongs."""
    return markdown.replace(_PLACE, "[Open it](live/index.html)." if BUILT.is_dir() else "")
