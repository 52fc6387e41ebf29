"""The playground: the WebAssembly module computes the host's bits, and the page shows what it computes.

The builds take a minute or two: all that needs them is slow.
"""

from __future__ import annotations

import importlib
import json
import re
import shutil
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

import browser

CRATE = Path(__file__).resolve().parents[1] / "crates" / "stillflux-wasm"
sys.path.insert(0, str(CRATE))
playground: Any = importlib.import_module("playground")

SHOTS = playground.OUT.with_name("playground-shots")
PUBLISHED, ENHANCED = 0, 1
SPEED, LOAD, OFFSET, R_S, DEAD_TIME, C_OUT = range(6)
#: What may be sent for the whole page, bytes.
MOST = 500_000


@pytest.fixture(scope="module")
def chain() -> Any:
    try:
        return playground.find()
    except playground.toolchain.MissingError as missing:
        pytest.skip(str(missing))


@pytest.fixture(scope="module")
def page(chain: Any) -> Iterator[browser.Page]:
    """The page as it has just been built, opened as a file."""
    program = browser.find()
    if program is None:
        pytest.skip("no Chromium found (Debian/Ubuntu: apt-get install chromium)")
    out = playground.build(chain)
    profile = playground.BUILD / "profile"
    shutil.rmtree(profile, ignore_errors=True)
    with browser.Page(program, profile) as opened:
        opened.show(1366, 900)
        opened.open((out / "index.html").as_uri())
        opened.wait("Boolean(window.playground)")
        yield opened


# --- The same bits.


def course(installation: int, scheme: int, R_s: float, torque: float) -> list[str]:
    """100,000 periods, every one recorded, with every setting changed on the way."""
    changes = [
        (10_000, SPEED, 3.5),
        (20_000, LOAD, 0.6 * torque),
        (35_000, OFFSET, 0.05),
        (50_000, R_S, 1.1 * R_s),
        (60_000, DEAD_TIME, 2.2e-6),
        (70_000, SPEED, 2.0),
        (80_000, C_OUT, 1.6e-9),
        (90_000, C_OUT, 0.0),
    ]
    steps, done = [f"start:{installation},{scheme},1,7,1"], 0
    for at, setting, value in changes:
        steps += [f"run:{at - done}", f"set:{setting},{value!r}"]
        done = at
    return [*steps, f"run:{100_000 - done}"]


def difference(host: bytes, target: bytes) -> str:
    """Where two records differ first; empty: in no bit."""
    if len(host) != len(target):
        return f"{len(host)} bytes, {len(target)} bytes"
    a, b = (np.frombuffer(x, np.uint64) for x in (host, target))
    where = np.flatnonzero(a != b)
    return f"{len(where)} values differ, the first is number {where[0]}" if len(where) else ""


@pytest.mark.slow
@pytest.mark.parametrize(
    ("installation", "scheme", "R_s", "torque"),
    [(0, ENHANCED, 3.7, 14.6), (1, PUBLISHED, 0.2147, 72.0)],
    ids=["2.2 kW enhanced", "11 kW published"],
)
def test_module_computes_every_bit_as_the_host_does(
    chain: Any, tmp_path: Path, installation: int, scheme: int, R_s: float, torque: float
) -> None:
    node = shutil.which("node")
    if node is None:
        pytest.skip("node not found (Debian/Ubuntu: apt-get install nodejs)")
    steps = course(installation, scheme, R_s, torque)
    host, target = tmp_path / "host", tmp_path / "target"
    playground.toolchain.host_example("course", host, *steps)
    command = [node, CRATE / "course.mjs", playground.module(chain), target, *steps]
    done = subprocess.run(command, capture_output=True, text=True, check=True)
    assert host.stat().st_size >= 100_000 * 20 * 8
    assert difference(host.read_bytes(), target.read_bytes()) == ""
    # Every period was one of a drive that runs, but for the start.
    status = np.frombuffer(host.read_bytes()[-(10_000 * 8) :], np.float64)
    assert np.all(status == 3)
    took = json.loads(done.stdout)
    assert took["periods"] / 10_000 >= 5 * took["seconds"], "5 times real time"


def test_the_comparison_notices_one_bit() -> None:
    host = np.arange(8.0).tobytes()
    target = bytearray(host)
    target[24] ^= 1
    assert difference(host, bytes(target)) == "1 values differ, the first is number 3"
    assert difference(host, host[:-8]) == "64 bytes, 56 bytes"
    assert difference(host, host) == ""


# --- The page.


def choose(page: browser.Page, scheme: int, experiment: int | None = None) -> None:
    """Starts anew with a scheme, as a user does."""
    if experiment is not None:
        page.value(f"document.querySelectorAll('#experiments button')[{experiment}].click()")
    page.value(f"document.querySelector('[name=scheme][value=\"{scheme}\"]').click()")
    page.value("document.getElementById('restart').click()")


@pytest.mark.slow
def test_page_is_complete_small_and_without_complaints(page: browser.Page) -> None:
    assert playground.compressed(playground.OUT) <= MOST
    assert {Path(url).name for url in page.requests if not url.startswith("data:")} == {
        file.name for file in playground.OUT.iterdir()
    }
    assert all(url.startswith(("file://", "data:")) for url in page.requests)
    assert page.complaints == []


@pytest.mark.slow
def test_signals_run_at_five_times_real_time(page: browser.Page) -> None:
    page.value("document.getElementById('rate').value = '10'")
    choose(page, ENHANCED)
    page.wait("playground.verdict.state === 'held'")
    begin, simulated = time.monotonic(), page.value("playground.done")
    time.sleep(3)
    simulated = (page.value("playground.done") - simulated) / 1e4
    assert simulated >= 5 * (time.monotonic() - begin)
    # They are those of a drive that holds its speed, in the units that are shown.
    shown = page.value("playground.history.last('omega_m')") * 60 / (2 * np.pi)
    assert shown == pytest.approx(30, abs=1.5)
    assert page.value("document.getElementById('rate-reached').textContent").endswith("× real time.")


@pytest.mark.slow
def test_a_lost_run_is_shown_as_lost_beside_the_confidence_of_the_drive(page: browser.Page) -> None:
    page.value("document.getElementById('rate').value = '20'")
    choose(page, PUBLISHED, 0)
    page.wait("playground.verdict.state === 'lost'", 60)
    # The page speaks twice a second.
    page.wait("document.getElementById('verdict').dataset.state === 'lost'")
    lost = page.value("playground.verdict.lost")
    assert lost["t"] > 7, "not before the resistance rises"
    assert lost["excursion"]
    assert page.value("document.getElementById('verdict-word').textContent") == "Lost"
    text = page.value("document.getElementById('verdict-text').textContent")
    assert f"confidence was {lost['confidence']:.2f}" in text
    # Lost it stays, and what happened stays in view.
    page.wait("playground.over")
    assert page.value("playground.verdict.state") == "lost"
    assert page.value("playground.history.last('t')") <= lost["t"] + 2.1
    # The other scheme, in the same experiment, is not.
    choose(page, ENHANCED)
    page.wait("playground.done > 150000", 60)
    assert page.value("playground.verdict.lost") is None
    assert page.value("playground.experiment.name") == "A load is lowered, the resistance rises"


@pytest.mark.slow
def test_sliders_are_moved_by_keys_and_say_their_unit(page: browser.Page) -> None:
    choose(page, ENHANCED)
    page.value("document.getElementById('set-speed').focus()")
    before = page.value("playground.slider('speed').value")
    page.press("ArrowRight", 39)
    assert page.value("playground.slider('speed').value - " + repr(before)) == pytest.approx(2 * np.pi / 60)
    units = {"speed": "r/min", "load": "N·m", "offset": "mA", "R_s": "Ω", "dead_time": "µs", "c_out": "nF"}
    for name, unit in units.items():
        assert unit in page.value(f"document.getElementById('set-{name}').getAttribute('aria-valuetext')")
        assert unit in page.value(f"document.querySelector('output[for=set-{name}]').textContent")
    page.wait("playground.done > 1000")
    reference = page.value("playground.history.last('reference')")
    assert reference == pytest.approx(page.value("playground.slider('speed').value"))
    # Tab goes through all of them.
    page.value("document.body.focus()")
    page.value("document.activeElement.blur()")
    visited = set()
    for _ in range(40):
        page.press("Tab", 9)
        visited.add(page.value("document.activeElement.id || document.activeElement.textContent"))
    assert {f"set-{name}" for name in units} | {"restart", "pause", "offset-estimator"} <= visited


@pytest.mark.slow
def test_what_is_set_reaches_the_installation_but_not_the_drive(page: browser.Page) -> None:
    page.value("document.getElementById('rate').value = '20'")
    choose(page, ENHANCED)
    page.wait("playground.verdict.state === 'held'")
    slider = "document.getElementById('set-R_s')"
    page.value(f"{slider}.value = 10; {slider}.dispatchEvent(new Event('input'))")
    page.wait("playground.history.last('R_s') > 3.8")
    ratio = page.value("playground.history.last('R_s') / playground.slider('R_s').setting.default")
    assert ratio == pytest.approx(page.value("playground.slider('R_s').value") / 3.7)
    page.value("document.getElementById('as-data-sheet').click()")
    page.wait("playground.history.last('R_s') === 3.7")


def contrast(page: browser.Page, colour: str, ground: str) -> float:
    """Contrast of two colours of the style sheet by WCAG 2."""

    def luminance(name: str) -> float:
        text = page.value(f"getComputedStyle(document.documentElement).getPropertyValue('--{name}')").strip()
        rgb = np.array([int(text[k : k + 2], 16) for k in (1, 3, 5)]) / 255
        linear = np.where(rgb <= 0.03928, rgb / 12.92, ((rgb + 0.055) / 1.055) ** 2.4)
        return float(linear @ [0.2126, 0.7152, 0.0722])

    low, high = sorted([luminance(colour), luminance(ground)])
    return (high + 0.05) / (low + 0.05)


def pixels(page: browser.Page, canvas: str) -> NDArray[np.uint8]:
    """A canvas as RGBA values."""
    size = f"const c = document.querySelector('{canvas}'); const x = c.getContext('2d');"
    data = page.value(
        f"(() => {{ {size} return Array.from(x.getImageData(0, 0, c.width, c.height).data) }})()"
    )
    return np.array(data, np.uint8).reshape(-1, 4)


@pytest.mark.slow
@pytest.mark.parametrize("dark", [False, True], ids=["light", "dark"])
@pytest.mark.parametrize("width", [1366, 800, 390], ids=["desktop", "tablet", "phone"])
def test_page_is_readable_at_every_width_in_both_modes(page: browser.Page, width: int, dark: bool) -> None:
    phone = width < 600
    page.show(width, 844 if phone else 900, dark=dark, mobile=phone)
    page.open((playground.OUT / "index.html").as_uri())
    page.wait("Boolean(window.playground)")
    page.wait("playground.verdict.state === 'held' && playground.done > 50000", 60)
    time.sleep(0.6)
    SHOTS.mkdir(exist_ok=True)
    name = f"{width}-{'dark' if dark else 'light'}"
    page.screenshot(SHOTS / f"{name}.png")
    page.screenshot(SHOTS / f"{name}-whole.png", whole=True)
    # Nothing is wider than the window, no text wider than its box.
    assert page.value("document.documentElement.scrollWidth") <= width
    wide = "[...document.querySelectorAll('body *')].filter((e) => e.scrollWidth > e.clientWidth + 1"
    wide += " && e.clientWidth && getComputedStyle(e).display !== 'inline').map((e) => e.id || e.tagName)"
    assert page.value(wide) == []
    for colour in ("text", "quiet", "true", "estimate", "reference"):
        assert contrast(page, colour, "surface") >= 4.5, colour
    for colour in ("good", "warn", "bad"):
        assert contrast(page, colour, f"{colour}-ground") >= 4.5, colour
    # Both trajectories are drawn, in the colours of this mode.
    drawn = pixels(page, "#flux canvas")
    for colour in ("true", "estimate"):
        text = page.value(f"Drawing.colours['{colour}']")
        wanted = [int(text[k : k + 2], 16) for k in (1, 3, 5)]
        assert re.fullmatch("#[0-9a-f]{6}", text)
        assert np.any(np.all(abs(drawn[:, :3].astype(int) - wanted) <= 2, axis=1) & (drawn[:, 3] > 250)), (
            colour
        )
