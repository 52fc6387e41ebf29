"""Command line and report."""

from __future__ import annotations

import errno
import os
import re
import signal
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import stillflux as sf
from stillflux import plots
from stillflux.cli import main
from stillflux.evidence import beyond, demo
from stillflux.evidence.claims import at_most
from stillflux.evidence.report import page
from stillflux.outputs import check_file, naming, whole, write_text

SCENARIO = """
motor = "2.2kW"
inverter = {preset = "2.2kW", f_s = 5e3}
plant_motor = {preset = "2.2kW", R_s = 4.0}
duration = 1.8
omega_ref = [[0.0, 0.0], [1.6, 0.0], [1.6, 3.0]]
plant = {current_offset = [0.01, 0.02]}
changes = [[1.7, {R_s = 4.2}]]
"""


def test_simulate_writes_plot_and_record(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (tmp_path / "run.toml").write_text(SCENARIO)
    plot, record = tmp_path / "run.png", tmp_path / "run.npz"
    assert main(["simulate", str(tmp_path / "run.toml"), "--plot", str(plot), "--save", str(record)]) == 0
    assert "status: running" in capsys.readouterr().out
    result = sf.Result.load(record)
    assert result.scenario.inverter.f_s == 5e3
    assert result.scenario.plant["current_offset"] == 0.01 + 0.02j
    assert result["R_s"][-1] == 4.2
    assert plot.stat().st_size > 10_000


def test_the_run_of_the_examples(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    examples = Path(__file__).parents[1] / "examples"
    machine = ["--motor", str(examples / "machines" / "pump-4kW.toml")]
    for own in ([], machine):
        assert main(["simulate", str(examples / "run.toml"), *own]) == 0
        shown = capsys.readouterr().out
        assert "status: running" in shown
        assert float(re.findall(r"field angle error: (\S+)° at most", shown)[0]) < 5.0


def test_simulate_plots_chosen_signals(tmp_path: Path) -> None:
    (tmp_path / "run.toml").write_text('signals = ["omega_m"]\n' + SCENARIO)
    plot = tmp_path / "run.png"
    assert main(["simulate", str(tmp_path / "run.toml"), "--plot", str(plot)]) == 0
    assert plot.stat().st_size > 5_000


def test_errors_are_one_line(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = tmp_path / "bad.toml"
    for text, expected in [
        (SCENARIO.replace("1.8", "-1.0"), "duration = -1"),
        (SCENARIO + "speed = 3\n", "speed is not a field"),
        (SCENARIO + "settings = 5\n", "settings = 5 is not a table"),
        (
            SCENARIO.replace("plant = {current_offset = [0.01, 0.02]}", "plant = 5"),
            "plant = 5 is not a table",
        ),
        (SCENARIO + "record_every = -1\n", "record_every = -1 is not a whole number of periods from 1"),
        ("a = " + "[" * 5000 + "]" * 5000, "nested too deeply"),
        ("duration =", "bad.toml|Invalid|invalid"),
    ]:
        path.write_text(text)
        assert main(["simulate", str(path)]) == 2
        error = capsys.readouterr().err
        assert re.search(expected, error)
        assert error.count("\n") == 1
    capsys.readouterr()
    assert main(["simulate", str(tmp_path / "none.toml")]) == 2
    assert capsys.readouterr().err == f"stillflux: {tmp_path / 'none.toml'}: No such file or directory\n"
    path.write_text(SCENARIO)
    capsys.readouterr()
    for output, expected in [
        (["--save", "run.csv"], "run.csv: .csv is not one of .npz"),
        (["--plot", str(tmp_path / "none" / "x.png")], "there is no folder"),
        (["--plot", "run"], "no suffix"),
    ]:
        assert main(["simulate", str(path), *output]) == 2
        assert expected in capsys.readouterr().err


@pytest.mark.parametrize(
    "command", [[], ["demo"], ["reproduce"], ["beyond"], ["simulate"], ["sweep"], ["replay"]]
)
def test_every_command_explains_its_use(command: list[str], capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit) as stop:
        main([*command, "--help"])
    assert stop.value.code == 0
    assert "usage: stillflux" in capsys.readouterr().out


@pytest.mark.parametrize("command", ["demo", "reproduce", "beyond"])
def test_a_folder_that_cannot_be_is_named_before_the_runs(
    command: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    file = tmp_path / "file"
    file.touch()
    assert main([command, "--out", str(file / "reports")]) == 2
    assert capsys.readouterr().err == f"stillflux: {file / 'reports'}: Not a directory\n"


def test_a_full_disk_is_named_with_the_file() -> None:
    with pytest.raises(OSError, match="No space") as caught, naming("run.npz"):
        raise OSError(errno.ENOSPC, "No space left on device")
    assert caught.value.filename == "run.npz"


def test_files_are_written_whole_or_not_at_all(tmp_path: Path) -> None:
    path, link = tmp_path / "page.html", tmp_path / "link.html"
    path.write_text("before")
    link.symlink_to(path)

    def fails() -> None:
        with whole(path) as part:
            part.write_text("half")
            raise ZeroDivisionError

    with pytest.raises(ZeroDivisionError):
        fails()
    assert (path.read_text(), len(list(tmp_path.iterdir()))) == ("before", 2)
    write_text(link, "after")
    assert (path.read_text(), link.is_symlink()) == ("after", True)
    (tmp_path / "other").write_text("")
    assert path.stat().st_mode == (tmp_path / "other").stat().st_mode
    with pytest.raises(FileNotFoundError, match="there is no folder"):
        write_text(tmp_path / "none" / "page.html", "")
    with pytest.raises(OSError, match="/dev/full"):
        write_text(Path("/dev/full"), "x")
    assert not Path("/dev/full").is_file()


def test_a_result_is_kept_when_nothing_can_be_printed(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def closed(*_: object, file: object = None, **__: object) -> None:
        if file is None:
            raise BrokenPipeError(errno.EPIPE, "Broken pipe")

    path, record = tmp_path / "run.toml", tmp_path / "run.npz"
    path.write_text('motor = "2.2kW"\nduration = 0.01\n')
    monkeypatch.setattr("builtins.print", closed)
    assert main(["simulate", str(path), "--save", str(record)]) == 141
    monkeypatch.undo()
    assert sf.Result.load(record).t[-1] > 0.0


def test_a_reader_that_has_seen_enough_ends_it_quietly(tmp_path: Path) -> None:
    path, record = tmp_path / "run.toml", tmp_path / "run.npz"
    path.write_text('motor = "2.2kW"\nduration = 0.01\n')
    for command in (["simulate", str(path), "--save", str(record)], ["--help"]):
        read, write = os.pipe()
        os.close(read)
        run = subprocess.run(
            [sys.executable, "-m", "stillflux", *command], stdout=write, stderr=subprocess.PIPE, text=True
        )
        os.close(write)
        # argparse leaves out by itself what cannot be printed.
        assert run.returncode in (141, *([0] if command == ["--help"] else []))
        assert run.stderr.replace("simulation: done\n", "") == ""
    assert record.exists()


def test_an_error_of_what_is_in_a_file_names_the_file(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    for command, text, expected in (
        ("simulate", 'motor = "2.2kW"\nduration = -1\n', "own.toml: duration = -1 s"),
        ("simulate", 'motor = "2.2kW"\nduration = 1\nsettings = {psi_reff = 1}\n', "own.toml: the drive has"),
        ("sweep", "[scenario]\n", "own.toml: a sweep file has [scenario] and one of"),
        ("commission", "[motr]\n", "own.toml: motr is not known in a commissioning file"),
        ("commission", f"{PLATE}[inverter]\nudc = 540.0\n", "own.toml: [inverter] udc is not known; 'u_dc'?"),
    ):
        Path("own.toml").write_text(text)
        assert main([command, "own.toml"]) == 2
        errors = [line for line in capsys.readouterr().err.splitlines() if "[plant.motor]" not in line]
        assert errors[0].startswith(f"stillflux: {expected}")
        assert errors[0].count("own.toml") == len(errors) == 1


def test_what_a_commissioning_file_cannot_have_is_named_with_its_table(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    for table, expected in (
        ("[plant]\nadc_nois = 1.0", "[plant] adc_nois is not known; 'adc_noise'?"),
        ("[plant]\nadc_noise = 'x'", "[plant] adc_noise = 'x' is not a number"),
        ("[plant]\nprogress = 5", "[plant] progress is not known; there are mode, seed, "),
        ("[plant]\nplant_motor = 5", "[plant] plant_motor is not known; 'motor'?"),
        ("[plant]\nchannels = [0, 1, 5]", "[plant] channels = 5 is outside the admissible range 0 to 2"),
        (
            "[plant]\ncurrent_sensors = -1",
            "[plant] current_sensors = -1 is outside the admissible range 2 to 3",
        ),
        ("[plant]\nmotor = 5", "[plant.motor] 5 is not a table of fields"),
        ("[plant.inverter]\nudc = 5.0", "[plant.inverter] udc is not known; 'u_dc'?"),
        ("[plant.inverter]\nu_dc = 'a'", "[plant.inverter] u_dc = 'a' is not a number"),
        ("[plant]\ninverter = 5", "[plant.inverter] 5 is not a table of fields"),
        ("[deviation]\nRs = 0.1", "[deviation] Rs is not known; 'R_s'?"),
        ("[deviation]\nR_s = 'a'", "[deviation] R_s = 'a' is outside 0 … 10"),
        ("plant = 5", "plant is not a table: write [plant] and its fields below it"),
        ("deviation = 5", "deviation is not a table: write [deviation] and its fields below it"),
    ):
        Path("own.toml").write_text(f"{PLATE}{table}\n" if "[" in table[:1] else f"{table}\n{PLATE}")
        assert main(["commission", "own.toml", "--only", "wiring"]) == 2
        errors = capsys.readouterr().err.splitlines()
        assert errors[-1].startswith(f"stillflux: own.toml: {expected}")


PLATE = "[nameplate]\nP_N = 4000.0\nU_N = 400.0\nI_N = 8.2\nf_N = 50.0\nn_N = 1435.0\ncos_phi = 0.82\n"


def test_a_plant_that_is_the_guess_itself_is_called_so(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(beyond, "run_all", lambda *_, **__: [])
    said = "stillflux: plate.toml has no [plant.motor]: the motor that follows from the plate is simulated\n"
    Path("plate.toml").write_text(PLATE)
    Path("whole.toml").write_text(f"{PLATE}[plant.motor]\npreset = '2.2kW'\n")
    Path("run.toml").write_text('motor = "2.2kW"\nduration = 0.01\n')
    Path("own.toml").write_text('motor = "plate.toml"\nduration = 0.01\n')
    Path("truth.toml").write_text('motor = "plate.toml"\nplant_motor = "2.2kW"\nduration = 0.01\n')
    Path("sweep.toml").write_text(
        "[scenario]\nmotor = 'plate.toml'\nduration = 0.01\n[grid]\nload_torque = [0]\n"
    )
    for command, times in (
        ("simulate run.toml --motor plate.toml", 1),
        ("simulate own.toml", 1),
        ("sweep sweep.toml", 1),
        ("beyond plane-ramps --motor plate.toml", 1),
        ("simulate run.toml", 0),
        ("simulate run.toml --motor whole.toml", 0),
        ("simulate truth.toml", 0),
        ("beyond plane-ramps --motor whole.toml", 0),
    ):
        assert main(command.split()) == 0
        assert capsys.readouterr().err.count(said) == times, command


def test_a_mark_of_the_byte_order_is_no_error(tmp_path: Path) -> None:
    path, motor = tmp_path / "run.toml", tmp_path / "motor.toml"
    path.write_bytes(b'\xef\xbb\xbfmotor = "2.2kW"\r\nduration = 0.01\r\n')
    motor.write_bytes(b'\xef\xbb\xbf[motor]\npreset = "2.2kW"\n')
    assert main(["simulate", str(path), "--motor", str(motor)]) == 0


def test_an_interruption_without_a_text_is_called_so(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    def interrupted(*_: object) -> int:
        raise KeyboardInterrupt

    monkeypatch.setattr(demo, "run", interrupted)
    assert main(["demo", "--machine", "2.2kW", "--out", str(tmp_path)]) == 130
    assert capsys.readouterr().err == "\nstillflux: interrupted\n"


def test_a_console_without_greek_letters_loses_nothing(tmp_path: Path) -> None:
    path, record = tmp_path / "run.toml", tmp_path / "run.npz"
    path.write_text(SCENARIO)
    run = subprocess.run(
        [sys.executable, "-m", "stillflux", "simulate", str(path), "--save", str(record)],
        env={**os.environ, "PYTHONIOENCODING": "ascii"},
        capture_output=True,
        text=True,
    )
    assert (run.returncode, record.exists()) == (0, True), run.stderr
    assert "status: running" in run.stdout


def test_a_motor_that_is_no_file_is_called_so(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    Path("run.toml").write_text(SCENARIO)
    for command in (
        ["simulate", "run.toml", "--motor", ""],
        ["commission", "--motor", ""],
        ["commission", ""],
    ):
        assert main(command) == 2
        assert "motor = '' is neither a preset (2.2kW, 11kW) nor a motor file" in capsys.readouterr().err
    with pytest.raises(ValueError, match=r"is neither a preset .* nor a motor file"):
        sf.load_machine(tmp_path)


@pytest.mark.skipif(not Path("/proc/self").exists(), reason="a folder that takes no files, whoever asks")
def test_a_folder_that_takes_no_file_is_said_before_the_run_and_by_the_name_that_was_given(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "run.toml").write_text(SCENARIO)
    assert main(["simulate", str(tmp_path / "run.toml"), "--save", "/proc/x.npz"]) == 2
    assert capsys.readouterr().err == "stillflux: /proc/x.npz cannot be written\n"
    with pytest.raises(OSError, match=r"'/proc/x\.txt'$"):
        write_text(Path("/proc/x.txt"), "text")


def test_a_run_that_diverges_keeps_its_record(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    def diverges(scenario: sf.Scenario, progress: bool) -> sf.Result:
        raise sf.DivergenceError("omega_m is not finite from t = 0.01 s on", simulate(scenario))

    path, record = tmp_path / "run.toml", tmp_path / "run.npz"
    path.write_text('motor = "2.2kW"\nduration = 0.01\n')
    simulate = sf.simulate
    monkeypatch.setattr("stillflux.cli.simulate", diverges)
    assert main(["simulate", str(path), "--save", str(record)]) == 2
    assert "omega_m is not finite" in capsys.readouterr().err
    assert len(sf.Result.load(record).t) > 1


def test_no_output_takes_the_place_of_an_input_or_of_another(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    Path("log.csv").write_text("t,i_a\n")
    Path("own.toml").write_text("[nameplate]\n")
    Path("sweep.toml").write_text("")
    Path("link.csv").symlink_to("log.csv")
    Path("link.toml").symlink_to("s.html")
    for command, expected in (
        ("replay log.csv --motor 2.2kW --out log.csv", "--out log.csv is the file of LOG"),
        ("replay log.csv --motor 2.2kW --out ./link.csv", "--out link.csv is the file of LOG"),
        ("commission own.toml --out own.toml", "--out own.toml is the file of MACHINE"),
        ("commission 2.2kW --out link.toml --report s.html", "--report s.html is the file of --out"),
        ("commission 2.2kW --out found.json", "found.json: .json is not one of .toml"),
        ("commission 2.2kW --report x.pdf", "x.pdf: .pdf is not one of .html, .htm"),
        ("commission 5.5kW", "motor = '5.5kW' is neither a preset (2.2kW, 11kW) nor a motor file"),
        ("replay log.csv --column i_a=Iu --column i_a=Iv", "--column i_a=Iv: i_a is given twice"),
        ("sweep sweep.toml --resume none/s.jsonl", "none/s.jsonl: there is no folder none"),
        ("sweep sweep.toml --resume s.csv --out s.csv", "--out s.csv is the file of --resume"),
    ):
        assert main(command.split()) == 2
        assert expected in capsys.readouterr().err
    assert Path("log.csv").read_text() == "t,i_a\n"


def test_where_no_file_can_come_to_be_is_said_before_the_run(tmp_path: Path) -> None:
    (tmp_path / "dangling.npz").symlink_to(tmp_path / "none" / "x.npz")
    with pytest.raises(ValueError, match="there is no folder"):
        check_file(tmp_path / "dangling.npz")
    long = tmp_path / ("a" * 250 + ".csv")
    check_file(long)
    write_text(long, "x")
    assert long.read_text() == "x"


def test_report_is_self_contained(scenario: sf.Scenario, tmp_path: Path) -> None:
    section = page.Section("A < B", "run", sf.simulate(scenario), [at_most("x", 2.0, 1.0)])
    path = tmp_path / "sub" / "report.html"
    page.write(path, "Title", "stillflux demo", [section])
    text = path.read_text(encoding="utf-8")
    assert text.count("<svg") == 3
    assert "A &lt; B" in text
    assert "failed" in text
    # No file or address is loaded: the only addresses are the names of XML namespaces and metadata.
    assert not re.search(r"<(img|script|link)\b|@import|url\((?!#)", text)
    assert not re.search(r'(?:src|href)="(?!#)', text)
    assert sorted(p.name for p in path.parent.iterdir()) == ["report.html", "run-flux.png", "run-signals.png"]


@pytest.mark.slow
def test_the_demo_passes_and_writes_one_small_page(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["demo", "--machine", "2.2kW", "--out", str(tmp_path)]) == 0
    assert "FAILED" not in capsys.readouterr().out
    assert 10_000 < (tmp_path / "demo.html").stat().st_size < 3_000_000


def test_a_demo_that_is_interrupted_keeps_its_runs(
    scenario: sf.Scenario, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    def sections(machine: str, arithmetic: str) -> Iterator[page.Section]:
        result = sf.simulate(scenario.replace(signals=None))
        yield page.Section(f"{machine}: first", "first", result, [at_most("x", 1.0, 2.0)])
        raise KeyboardInterrupt("interrupted at t = 3 s")

    def pressed_again(*arguments: Any) -> None:
        signal.raise_signal(signal.SIGINT)
        write(*arguments)

    write = page.write
    monkeypatch.setattr(demo, "_sections", sections)
    monkeypatch.setattr(page, "write", pressed_again)
    assert main(["demo", "--machine", "2.2kW", "--out", str(tmp_path)]) == 130
    text = (tmp_path / "demo.html").read_text(encoding="utf-8")
    assert "2.2kW: first" in text
    assert "Not whole: interrupted at t = 3 s" in text
    assert "interrupted at t = 3 s" in capsys.readouterr().err


def test_thinning_keeps_extremes_and_the_end() -> None:
    t = np.arange(100_007, dtype=float)
    x = np.sin(t)
    x[[77_777, 100_005]] = 9.0, -9.0
    thin_t, thin_x = plots.thin(t, x, 1000)
    assert len(thin_t) < 1300
    assert {9.0, -9.0} <= set(thin_x)
    assert np.diff(thin_t).max() < 500
    assert thin_t[-1] == t[-1]


def test_a_drive_that_ends_with_a_fault_is_seen_in_the_exit_status(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path, record = tmp_path / "run.toml", tmp_path / "run.npz"
    path.write_text('motor = "2.2kW"\nduration = 0.5\nchanges = [[0.4, {u_dc = 10.0}]]\n')
    assert main(["simulate", str(path), "--save", str(record)]) == 1
    assert "status: fault: under-voltage" in capsys.readouterr().out
    assert record.exists()


def test_what_comes_after_the_end_of_a_run_is_one_line(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = tmp_path / "run.toml"
    path.write_text('motor = "2.2kW"\nduration = 0.01\nload_torque = [[0.0, 0.0], [6.0, 0.0], [6.0, 5.0]]\n')
    assert main(["simulate", str(path)]) == 0
    said = capsys.readouterr()
    text = "load_torque[2] comes after the end, from t = 6 s on"
    assert said.err.splitlines()[0] == f"stillflux: {text}: duration = 0.01 s"
    assert f"not reached: {text}\n" in said.out


def test_a_run_that_is_interrupted_says_so_and_keeps_its_record(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    path, record = tmp_path / "run.toml", tmp_path / "run.npz"
    path.write_text('motor = "2.2kW"\nduration = 0.01\n')

    def interrupted(scenario: sf.Scenario, progress: object = None) -> sf.Result:
        raise sf.Interrupted(sf.simulate(scenario))

    monkeypatch.setattr("stillflux.cli.simulate", interrupted)
    assert main(["simulate", str(path), "--save", str(record)]) == 130
    assert "stillflux: interrupted at t = 0.009 s" in capsys.readouterr().err
    assert len(sf.Result.load(record).t) == 10
