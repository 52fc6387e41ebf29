"""Hook of mkdocs: runs the examples and makes the gallery of what they print and draw."""

from __future__ import annotations

import re
import subprocess
import sys
import tempfile
from pathlib import Path
from typing import Any

from mkdocs.structure.files import File, Files

EXAMPLES = Path(__file__).resolve().parents[1] / "examples"
GALLERY = ("own_motor", "observability", "lost_and_held", "bridge_curve", "replay_log", "sweep_dask")
_PICTURES = (".png", ".gif")


def on_files(files: Files, config: Any) -> Files:
    """Adds the gallery with its pictures; an example that fails stops the build."""
    sections = ["# Gallery", "", "Each example is a file of `examples/`, run when this page was built."]
    for name in GALLERY:
        source = (EXAMPLES / f"{name}.py").read_text(encoding="utf-8")
        with tempfile.TemporaryDirectory() as folder:
            command = [sys.executable, str(EXAMPLES / f"{name}.py")]
            ran = subprocess.run(command, cwd=folder, check=True, capture_output=True, text=True)
            pictures = sorted(p for p in Path(folder).iterdir() if p.suffix in _PICTURES)
            for picture in pictures:
                path = f"gallery/{picture.name}"
                files.append(File.generated(config, path, content=picture.read_bytes()))
        shown = "\n\n".join(f"![{name}](gallery/{picture.name})" for picture in pictures)
        title = name.replace("_", " ").capitalize()
        output = f"```text\n{ran.stdout.rstrip()}\n```"
        sections += ["", f"## {title}", "", shown, "", output, "", f"```python\n{source}```"]
    files.append(File.generated(config, "gallery.md", content="\n".join(sections) + "\n"))
    return files


def on_page_markdown(markdown: str, **_: Any) -> str:
    """A link to the README, which is no page of the site, becomes its text."""
    return re.sub(r"\[([^\]]+)\]\(\.\./README\.md[^)]*\)", r"\1", markdown)
