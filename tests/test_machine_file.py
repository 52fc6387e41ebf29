"""Motor files: every way to describe a machine, and what is wrong with one."""

from __future__ import annotations

import pickle
from dataclasses import replace
from pathlib import Path

import pytest

import stillflux as sf
from stillflux.cli import main
from stillflux.evidence import reproduce
from stillflux.evidence.machines import MACHINES, OwnMachine, inverter_of, motor_of, option
from stillflux.evidence.paper import paper_drive
from stillflux.evidence.registry import experiments
from stillflux.machine_file import machine_to_toml

PUMP = Path(__file__).resolve().parents[1] / "examples" / "machines" / "pump-4kW.toml"
FIELDS = "n_p = 2\nJ = 0.015\nU_N = 400.0\nI_N = 5.0\nf_N = 50.0\nT_N = 14.6\n"


def test_what_is_written_is_read_back(tmp_path: Path) -> None:
    motor, inverter = sf.Motor.preset("2.2kW"), sf.Inverter.preset("2.2kW")
    path = tmp_path / "found.toml"
    path.write_text(
        machine_to_toml(motor, inverter, name="a 'b' é", deviation={"R_s": 0.01}), encoding="utf-8"
    )
    machine = sf.load_machine(path)
    assert (machine.motor, machine.inverter, machine.name) == (motor, inverter, "a 'b' é")
    assert machine.deviation == {"R_s": 0.01}


def test_every_circuit_and_a_changed_preset(tmp_path: Path) -> None:
    motor = sf.Motor.preset("2.2kW").replace(saturation=None)
    path = tmp_path / "m.toml"
    for circuit in (motor.to_gamma(), motor.to_t_model()):
        lines = "".join(f"{key} = {value!r}\n" for key, value in circuit.items())
        path.write_text(f"[motor]\n{lines}{FIELDS}")
        found = sf.load_machine(path)
        assert found.motor.L_sigma == pytest.approx(motor.L_sigma)
        assert found.inverter.u_dc == pytest.approx(1.35 * 400.0)
    path.write_text('[motor]\npreset = "11kW"\nR_s = 0.4\n[inverter]\nf_s = 4e3\n')
    found = sf.load_machine(path)
    assert found.motor == sf.Motor.preset("11kW").replace(R_s=0.4)
    assert found.inverter == sf.Inverter.preset("11kW").replace(f_s=4e3)
    assert sf.load_machine("11kW").motor == sf.Motor.preset("11kW")


def test_a_table_of_the_simulated_motor_needs_only_what_differs(tmp_path: Path) -> None:
    path, motor = tmp_path / "own.toml", sf.Motor.preset("2.2kW")
    path.write_text('[motor]\npreset = "2.2kW"\n[plant.motor]\nR_s = 3.9\n')
    assert sf.load_machine(path).plant_motor == motor.replace(R_s=3.9)
    # An equivalent circuit of its own has the rating of the other motor, and not its curve.
    path.write_text(
        '[motor]\npreset = "2.2kW"\n[plant.motor]\nR_s = 3.7\nR_r = 2.3\nL_l = 0.023\nL_s = 0.24\nJ = 0.02\n'
    )
    other = sf.load_machine(path).plant_motor
    assert other is not None
    assert (other.T_N, other.J, other.saturation) == (motor.T_N, 0.02, None)
    assert other.L_s == pytest.approx(0.24)
    path.write_text('[motor]\npreset = "2.2kW"\n[plant.motor]\nR_x = 3.9\n')
    with pytest.raises(ValueError, match=r"\[plant.motor\] R_x is not known; 'R_s'"):
        sf.load_machine(path)
    plain = {"motor": "2.2kW", "duration": 1.0, "plant_motor": {"R_s": 3.9}}
    assert sf.Scenario.from_dict(plain).plant_motor == motor.replace(R_s=3.9)


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        (
            "[motor]\nR_s = 3.7\nR_R = 2.1\nL_sigma = 0.021\nL_M = 0.2\n" + FIELDS.replace("J = 0.015\n", ""),
            r"\[motor\] has no J: a motor has n_p, J, U_N",
        ),
        ("status = 3\n[motor]\npreset = '2.2kW'\n", "status = 3 is not a text"),
        ("warnings = 'x'\n[motor]\npreset = '2.2kW'\n", "warnings = 'x' is not a list of texts"),
        ("[motor]\nR_s = 3.7\n", r"\[motor\] has no complete equivalent circuit"),
        ("[motor]\npreset = '2.2kW'\nR_s = -1.0\n", r"\[motor\] R_s = -1"),
        ("[motor]\npreset = '2.2kW'\nR_x = 1.0\n", r"\[motor\] R_x is not known; 'R_s'"),
        (
            "[motor]\npreset = '2.2kW'\n[inverter]\nudc = 3\n",
            r"\[inverter\] udc is not known; 'u_dc'",
        ),
        ("[nameplate]\nP_N = 4e3\nU_N = 400.0\n", r"\[nameplate\] has no I_N, f_N, n_N, cos_phi"),
        ("[motor]\npreset = '2.2kW'\n[inverter]\nf_s = 1.0\n", r"\[inverter\] f_s = 1"),
        ("[motor]\npreset = '2.2kW'\n[deviation]\nR_s = 'x'\n", r"\[deviation\] R_s = 'x'"),
        ("[motor]\npreset = '2.2kW'\n[plant]\nmotor = 3\n", r"\[plant.motor\] 3 is not a table of fields"),
        (
            "[motor]\npreset = '2.2kW'\n[deviation]\nR_S = 0.1\n",
            r"\[deviation\] R_S is not known; 'R_s'",
        ),
        ("[engine]\n", "engine is not known"),
        ("name = '../x'\n[motor]\npreset = '2.2kW'\n", "name = '../x' is no file name"),
        ("name = 'x'\n", r"one of the tables \[motor\] and \[nameplate\]"),
        ("[motor\n", "line 1"),
    ],
)
def test_errors_name_file_table_and_field(tmp_path: Path, text: str, expected: str) -> None:
    path = tmp_path / "bad.toml"
    path.write_text(text)
    with pytest.raises(ValueError, match=expected) as caught:
        sf.load_machine(path)
    assert "bad.toml" in str(caught.value)
    with pytest.raises(ValueError, match="neither a preset"):
        sf.load_machine("3kW")
    with pytest.raises(TypeError, match=r"motor = None is neither a preset \(2.2kW, 11kW\) nor a path"):
        sf.load_machine(None)  # type: ignore[arg-type]


def test_a_file_that_is_not_in_utf_8_is_told_so_with_its_line(tmp_path: Path) -> None:
    path = tmp_path / "m.toml"
    path.write_bytes('# 4 kW\nname = "Lüfter"\n'.encode("latin-1"))
    with pytest.raises(
        ValueError, match=r"m\.toml, line 2: no text in UTF-8, as TOML has to be \(byte 0xfc\)"
    ):
        sf.load_machine(path)


def test_an_own_machine_goes_to_processes_with_its_parameters() -> None:
    name = OwnMachine.load(PUMP)
    assert name == "pump-4kW"
    again = pickle.loads(pickle.dumps(name))
    assert motor_of(again) == motor_of(name) == sf.load_machine(PUMP).motor
    assert inverter_of(again).f_s == 8e3
    assert "R_s=1.6" in repr(again), "a journal tells machines of one name apart"
    assert option(again) == f"--motor {PUMP}", "as a report names it"
    assert option("11kW") == "--machine 11kW"


def test_a_scenario_of_a_motor_file(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    scenario = sf.Scenario.from_dict({"motor": str(PUMP), "duration": 0.1})
    assert scenario.inverter == sf.load_machine(PUMP).inverter
    path = tmp_path / "run.toml"
    path.write_text('motor = "2.2kW"\nduration = 0.1\n')
    assert main(["simulate", str(path), "--motor", str(PUMP), "--save", str(tmp_path / "r.npz")]) == 0
    assert sf.Result.load(tmp_path / "r.npz").scenario.motor == scenario.motor
    text = machine_to_toml(
        scenario.motor,
        plant_motor=scenario.motor.replace(R_s=1.7),
        deviation=dict.fromkeys(("R_s", "R_R", "L_sigma", "L_M", "J", "loss", "c_out"), 0.02),
    )
    (tmp_path / "found.toml").write_text(text)
    found = ["--motor", str(tmp_path / "found.toml"), "--save", str(tmp_path / "r.npz")]
    assert main(["simulate", str(path), *found]) == 0
    ran = sf.Result.load(tmp_path / "r.npz").scenario
    assert (ran.motor.R_s, ran.plant_motor.R_s if ran.plant_motor else None) == (1.6, 1.7)
    assert "prior_R_s" in ran.settings
    assert ran.settings == sf.load_machine(tmp_path / "found.toml").settings
    # The same as the motor of a scenario; what the scenario says itself stands.
    named = {"motor": str(tmp_path / "found.toml"), "duration": 0.1}
    assert sf.Scenario.from_dict(named).replace(name=ran.name) == ran
    own = sf.Scenario.from_dict({**named, "plant_motor": "2.2kW", "settings": {"prior_R_s": 0.3}})
    assert (own.plant_motor, own.settings["prior_R_s"]) == (sf.Motor.preset("2.2kW"), 0.3)
    assert "prior_R_s" not in sf.Scenario.from_dict({**named, "scheme": "paper"}).settings
    with pytest.raises(ValueError, match=r"'5\.5kW' is neither a preset"):
        sf.load_machine("5.5kW")
    assert main(["simulate", str(path), "--motor", "none.toml"]) == 2
    assert "none.toml" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("command", "table", "field", "text"),
    [
        ("simulate", "", "motor", "{}\nduration = 0.01\n"),
        ("simulate", "", "plant_inverter", 'motor = "2.2kW"\n{}\nduration = 0.01\n'),
        ("sweep", "[scenario] ", "motor", "[scenario]\n{}\nduration = 0.01\n[grid]\nload_torque = [0]\n"),
        ("commission --only wiring", "", "motor", "{}\n"),
        ("commission --only wiring", "[plant] ", "inverter", '[plant]\n{}\n[motor]\npreset = "2.2kW"\n'),
    ],
)
def test_a_file_names_a_motor_file_relative_to_itself(
    command: str,
    table: str,
    field: str,
    text: str,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    (tmp_path / "runs" / "machines").mkdir(parents=True)
    (tmp_path / "runs" / "machines" / "own.toml").write_text('[motor]\npreset = "2.2kW"\n')
    # The one in the current folder is another file.
    (tmp_path / "machines").mkdir()
    (tmp_path / "machines" / "own.toml").write_text("[no]\n")
    monkeypatch.chdir(tmp_path)
    name, *options = command.split()
    file = Path("runs") / "task.toml"
    file.write_text(text.format(f'{field} = "machines/own.toml"'))
    assert main([name, str(file), *options]) == 0, capsys.readouterr().err
    file.write_text(text.format(f'{field} = "machines/none.toml"'))
    capsys.readouterr()
    assert main([name, str(file), *options]) == 2
    assert capsys.readouterr().err == (
        f"stillflux: {file}: {table}{field} = 'machines/none.toml' is neither a preset (2.2kW, 11kW) nor a "
        f"motor file: there is no {Path('runs/machines/none.toml')}\n"
    )


def test_the_bridge_of_the_paper_is_clamped_whatever_the_file_of_the_motor_simulates() -> None:
    pump = sf.load_machine(PUMP)
    found = replace(pump, plant_inverter=replace(pump.inverter, c_out=1e-9, dead_time=2.1e-6))
    scenario = paper_drive(OwnMachine(found), name="x", duration=0.1)
    assert scenario.plant_inverter is not None
    assert (scenario.inverter.c_out, scenario.plant_inverter.c_out) == (0.0, 0.0)
    assert scenario.plant_inverter.dead_time == 2.1e-6


def test_every_figure_is_built_for_an_own_machine() -> None:
    own = OwnMachine.load(PUMP)
    found = [
        name for name, experiment in experiments().items() if experiment.at(own) and experiment.runs(own)
    ]
    # Some claims are about one of the project's machines.
    assert set(experiments()) - set(found) == {
        name for name, x in experiments().items() if x.machines != MACHINES
    }
    assert {machine for _, machine, *_ in reproduce.jobs(found, [own])} == {own}
    with pytest.raises(ValueError, match="none of them is run at pump-4kW"):
        reproduce.run_all([name for name in experiments() if name not in found], [own])


@pytest.mark.slow
def test_demo_and_figures_of_an_own_machine(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["demo", "--motor", str(PUMP), "--out", str(tmp_path)]) == 0
    assert (tmp_path / "demo-pump-4kW-signals.png").exists()
    # Whether the claims hold on this machine is a result, not an error.
    capsys.readouterr()
    assert main(["reproduce", "9", "--motor", str(PUMP), "--out", str(tmp_path)]) in (0, 1)
    assert "Fig. 9 " in capsys.readouterr().out


def test_the_table_of_metrics_takes_no_own_machine(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["beyond", "--motor", str(PUMP), "--metrics", str(tmp_path / "m.csv")]) == 2
    assert "--motor" in capsys.readouterr().err


def test_a_nameplate_makes_a_machine(tmp_path: Path) -> None:
    path = tmp_path / "plate.toml"
    plate = sf.Nameplate(P_N=4000.0, U_N=400.0, I_N=8.2, f_N=50.0, n_N=1435.0, cos_phi=0.82)
    path.write_text(
        "[nameplate]\nP_N = 4000.0\nU_N = 400.0\nI_N = 8.2\nf_N = 50.0\nn_N = 1435.0\ncos_phi = 0.82\n"
        "[deviation]\nR_s = 0.05\n"
    )
    machine = sf.load_machine(path)
    assert machine.motor == plate.motor()
    assert machine.deviation == {**plate.deviation, "R_s": 0.05}
    path.write_text(
        "[nameplate]\nP_N = 4000.0\nU_N = 400.0\nI_N = 8.2\nf_N = 50.0\nn_N = 1435.0\ncos_phi = 2\n"
    )
    with pytest.raises(ValueError, match=r"plate.toml: \[nameplate\] cos_phi = 2"):
        sf.load_machine(path)
