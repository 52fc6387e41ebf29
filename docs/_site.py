"""Hook of mkdocs: runs the examples and makes the gallery of what they print and draw."""

from __future__ import annotations

import re
import subprocess
import sys
import tempfile
from importlib.util import find_spec, module_from_spec, spec_from_file_location
from pathlib import Path
from typing import Any

from mkdocs.structure.files import File, Files

from stillflux.evidence.report import diagram

EXAMPLES = Path(__file__).resolve().parents[1] / "examples"
SCRIPTS = ("observability", "lost_and_held", "bridge_curve", "sweep_dask")
NOTEBOOKS = ("own_motor", "own_log", "many_runs", "motulator_plant", "gym_electric_motor_plant")
_NEEDS = {"motulator_plant": "motulator", "gym_electric_motor_plant": "gym_electric_motor"}
_PICTURES = (".png", ".gif")


def on_files(files: Files, config: Any) -> Files:
    """Adds the gallery with its pictures; an example that fails stops the build."""
    sections = [
        "# Gallery",
        "",
        "Scripts and notebooks of `examples/`, run when this page was built: what they print and draw is of "
        "this version.",
    ]

    def picture(name: str, content: bytes) -> str:
        files.append(File.generated(config, f"gallery/{name}", content=content))
        return f"![{Path(name).stem}](gallery/{name})"

    files.append(File.generated(config, "gallery/drive.svg", content=diagram.drive()))
    files.append(File.generated(config, "gallery/innovation.svg", content=diagram.innovation()))
    for name in SCRIPTS:
        source = (EXAMPLES / f"{name}.py").read_text(encoding="utf-8")
        with tempfile.TemporaryDirectory() as folder:
            command = [sys.executable, str(EXAMPLES / f"{name}.py")]
            ran = subprocess.run(command, cwd=folder, check=True, capture_output=True, text=True)
            pictures = sorted(p for p in Path(folder).iterdir() if p.suffix in _PICTURES)
            shown = "\n\n".join(picture(p.name, p.read_bytes()) for p in pictures)
        title = name.replace("_", " ").capitalize()
        output = f"```text\n{ran.stdout.rstrip()}\n```"
        code = f'??? note "examples/{name}.py"\n\n' + _indented(f"```python\n{source}```")
        sections += ["", f"## {title}", "", shown, "", output, "", code]
    for name in NOTEBOOKS:
        sections += ["", *_notebook(name, picture)]
    files.append(File.generated(config, "gallery.md", content="\n".join(sections) + "\n"))
    return files


def _notebook(name: str, picture: Any) -> list[str]:
    """A notebook, run, with its headings one level down."""
    path = EXAMPLES / f"{name}.ipynb"
    if name in _NEEDS and find_spec(_NEEDS[name]) is None:
        raise RuntimeError(f"{path.name} needs {_NEEDS[name]}: pip install 'stillflux[examples]'")
    found: list[str] = []
    for k, cell in enumerate(_runner().executed(path)[0]):
        if not cell.code:
            found += [re.sub(r"^#", "##", cell.source, flags=re.M), ""]
            if not k:
                found += [f"Notebook: `examples/{path.name}`.", ""]
            continue
        found += [f"```python\n{cell.source}\n```", ""]
        if cell.text.strip():
            found += [f"```text\n{cell.text.rstrip()}\n```", ""]
        if cell.html:
            found += [cell.html, ""]
        if cell.picture:
            found += [picture(f"{name}-{k}.png", cell.picture), ""]
    return found


def _runner() -> Any:
    """The module beside this one; hooks are no package."""
    spec = spec_from_file_location("_notebook", Path(__file__).with_name("_notebook.py"))
    assert spec is not None
    assert spec.loader is not None
    module = module_from_spec(spec)
    sys.modules["_notebook"] = module
    spec.loader.exec_module(module)
    return module


def _indented(text: str) -> str:
    return "\n".join(f"    {line}" if line else "" for line in text.split("\n"))


def on_page_markdown(markdown: str, **_: Any) -> str:
    """A link to the README, which is no page of the site, becomes its text."""
    return re.sub(r"\[([^\]]+)\]\(\.\./README\.md[^)]*\)", r"\1", markdown)
