"""What the evidence is made of: claims, controls, seeds, the committed table; and who imports it."""

from __future__ import annotations

import ast
import json
import math
import pickle
import re
import subprocess
import sys
from dataclasses import replace
from importlib import import_module
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

import stillflux as sf
from stillflux.evidence import beyond, documents, figure, judge, operate, registry, reproduce
from stillflux.evidence.claims import (
    Claim,
    at_least,
    at_most,
    equal,
    holds,
    reported,
    worst,
    worst_of_runs,
)
from stillflux.evidence.conditions import SCHEMES
from stillflux.evidence.journal import Journal, from_json, to_json
from stillflux.evidence.machines import OwnMachine
from stillflux.evidence.seeds import SEEDS
from stillflux.evidence.table import DRAWS, Line, Table, agree
from stillflux.parallel import Stopped
from stillflux.result import Result
from test_architecture import circle

PACKAGE = Path(sf.__file__).parent
ROOT = Path(__file__).parent.parent


# The imports.


def modules() -> dict[str, Path]:
    """Every Python module of the package by its name."""
    found = {}
    for path in sorted(PACKAGE.rglob("*.py")):
        parts = path.relative_to(PACKAGE.parent).with_suffix("").parts
        found[".".join(parts[:-1] if parts[-1] == "__init__" else parts)] = path
    return found


def imports(name: str, path: Path, known: set[str]) -> set[str]:
    """Modules of the package that a module imports, at once or later; not those for type checking only."""
    found: set[str] = set()

    def visit(node: ast.AST) -> None:
        if isinstance(node, ast.If) and "TYPE_CHECKING" in ast.dump(node.test):
            for branch in node.orelse:
                visit(branch)
            return
        if isinstance(node, ast.Import):
            found.update(alias.name for alias in node.names)
        elif isinstance(node, ast.ImportFrom):
            assert node.level == 0, f"{name}: imports are absolute"
            assert node.module is not None
            for alias in node.names:
                within = f"{node.module}.{alias.name}"
                found.add(within if within in known else node.module)
        for child in ast.iter_child_nodes(node):
            visit(child)

    visit(ast.parse(path.read_text(encoding="utf-8")))
    return found & known


def graph() -> dict[str, set[str]]:
    paths = modules()
    # The compiled part imports nothing of Python.
    known = {*paths, "stillflux._core"}
    return {name: imports(name, path, known) for name, path in paths.items()} | {"stillflux._core": set()}


def test_no_circle_of_imports() -> None:
    edges = graph()
    assert len(edges) > 50
    assert circle(edges) == []
    # The walk would see one.
    edges["stillflux.metrics"].add("stillflux.evidence.judge")
    assert circle(edges) != []


def test_library_never_imports_evidence() -> None:
    edges = graph()
    library = {name for name in edges if not name.startswith("stillflux.evidence")}
    assert {"stillflux.cli", "stillflux.metrics", "stillflux.simulation"} <= library
    assert [name for name in sorted(library) if edges[name] - library] == []


def test_help_lists_the_commands_of_evidence_without_importing_it() -> None:
    code = (
        "import sys\nfrom stillflux.cli import main\n"
        "try:\n    main(['--help'])\nexcept SystemExit:\n    pass\n"
        "assert not [name for name in sys.modules if name.startswith('stillflux.evidence')]\n"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert {"demo", "reproduce", "beyond", "simulate", "replay"} <= set(done.stdout.split())


def test_registry_finds_every_file() -> None:
    of_figures = {p.stem for p in (PACKAGE / "evidence" / "figures").glob("*.py")} - {"__init__"}
    named = [x.name for m in of_figures for x in import_module(f"stillflux.evidence.figures.{m}").EXPERIMENTS]
    assert sorted(named) == sorted(registry.experiments())
    of_plane = {p.stem for p in (PACKAGE / "evidence" / "plane").glob("*.py")} - {"__init__"}
    named = [x.name for m in of_plane for x in import_module(f"stillflux.evidence.plane.{m}").TARGETS]
    assert sorted(named) == sorted(registry.targets())
    assert registry.figures()[:7] == ("2", "5", "6", "8", "9", "9-known", "10")


# Claims.


def test_a_claim_holds_on_its_side_of_the_bound() -> None:
    assert [at_most("x", v, 1.0).ok for v in (0.5, 1.0, 1.5, math.inf, math.nan)] == [
        True,
        True,
        *3 * [False],
    ]
    assert [at_least("x", v, 1.0).ok for v in (0.5, 1.0, 1.5, -math.inf, math.nan)] == [
        False,
        True,
        True,
        False,
        False,
    ]
    assert [equal("x", v, 6).ok for v in (5, 6, 7)] == [False, True, False]
    assert [holds("x", v).ok for v in (True, False)] == [True, False]
    assert reported("x", 1e9).ok


def test_the_worst_is_the_one_furthest_on_the_failing_side() -> None:
    values = (3.0, 1.0, 2.0)
    assert worst(at_most("≥ in its name", v, 9.0) for v in values).value == 3.0
    assert worst(at_least("≤ in its name", v, 0.0) for v in values).value == 1.0
    assert worst(equal("x", v, 2.0) for v in (2.0, 3.5, 1.0)).value == 3.5
    assert worst(holds("x", v) for v in (True, False, True)).value == 0.0
    assert math.isnan(worst(at_most("x", v, 1.0) for v in (0.5, math.nan)).value)


def test_a_claim_that_a_lost_run_does_not_make_fails_there() -> None:
    alive, lost = holds("runs", True), holds("runs", False)
    runs = [
        [replace(c, seed=0) for c in (alive, at_most("angle", 1.0, 5.0), at_least("time", 20.0, 10.0))],
        [replace(c, seed=1) for c in (lost,)],
    ]
    found = {claim.quantity: claim for claim in worst_of_runs(runs)}
    assert [claim.ok for claim in found.values()] == [False, False, False]
    assert [claim.seed for claim in found.values()] == [1, 1, 1]
    assert (found["angle"].value, found["time"].value) == (math.inf, -math.inf)


# Controls.


def controlled(claims: tuple[Claim, ...], lost: float = math.inf) -> bool:
    return figure.Controlled(claims, claims, lost, event=10.0).ok


def test_a_control_fails_for_its_reason_and_not_before_its_event() -> None:
    bad, good = at_most("x", 2.0, 1.0), at_most("x", 0.5, 1.0)
    assert controlled((bad,))
    assert controlled((good, bad), lost=11.0)
    assert not controlled((good,))
    assert not controlled(())
    assert not controlled((bad,), lost=9.0)


def test_a_control_is_judged_by_the_claims_it_names_and_by_its_first_loss(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    named, other = at_most("named", 2.0, 1.0), at_most("other", 2.0, 1.0)
    losses = iter((math.inf, 12.0, 14.0))
    monkeypatch.setattr(figure, "lost", lambda result, since: (next(losses), "angle"))
    runs = [*(object.__new__(Result) for _ in range(3)), "an open loop"]
    control = figure.Control("left out", lambda runs: runs, ("named",), event=10.0)
    experiment = replace(registry.experiments()["19"], check=lambda *results: [named, other], control=control)
    judged = experiment.judge_control(runs)
    assert (judged.expected, judged.lost, judged.event, judged.ok) == ((named,), 12.0, 10.0, True)
    # What fails is not what it is there for.
    good = replace(experiment, check=lambda *results: [replace(named, value=0.5), other])
    assert not good.judge_control(runs[3:]).ok


def test_a_control_differs_from_its_experiment() -> None:
    for experiment in registry.experiments().values():
        if experiment.control is None:
            continue
        for machine in experiment.machines:
            plain, control = (experiment.runs(machine, role=role) for role in ("published", "control"))
            # The runs of a chain differ in what each begins with.
            assert experiment.chained or plain != control, (experiment.name, machine)


def test_a_chain_takes_the_memory_along_but_for_its_control(monkeypatch: pytest.MonkeyPatch) -> None:
    begun: list[object] = []
    stored = sf.Drive(sf.Motor.preset("2.2kW"), sf.Inverter.preset("2.2kW"), scheme="paper").memory()

    def simulated(run: sf.Scenario) -> object:
        begun.append(run.memory)
        return SimpleNamespace(memory=stored)

    monkeypatch.setattr(figure, "until_it_runs_away", simulated)
    experiment = registry.experiments()["16"]
    assert experiment.chained
    experiment.simulate("2.2kW")
    assert [m is None for m in begun] == [True, *[False] * (len(begun) - 1)]
    assert len(begun) > 1
    begun.clear()
    experiment.simulate("2.2kW", role="control")
    assert begun == [None] * len(begun)


def test_a_run_whose_shaft_runs_away_is_judged_up_to_there(monkeypatch: pytest.MonkeyPatch) -> None:
    scenario = registry.experiments()["16"].runs("2.2kW")[0].replace(duration=0.01)
    before = sf.simulate(scenario)

    def diverges(run: sf.Scenario, progress: object = None) -> sf.Result:
        raise sf.DivergenceError("u_s is not finite", before)

    monkeypatch.setattr(figure, "simulate", diverges)
    assert figure.until_it_runs_away(scenario) is before


# Seeds.


def test_every_closed_loop_runs_under_at_least_five_seeds() -> None:
    for experiment in registry.experiments().values():
        for machine in filter(experiment.noisy, experiment.machines):
            seeds = {
                run.plant["seed"]
                for realisation in experiment.realisations(machine)
                for run in experiment.runs(machine, seed=realisation)[:1]
            }
            assert len(seeds) >= 5, (experiment.name, machine)
            found = [job for job in reproduce.jobs([experiment.name], [machine]) if job[3] == "published"]
            assert len(found) == len(experiment.realisations(machine))
            controls = [job for job in reproduce.jobs([experiment.name], [machine]) if job[3] == "control"]
            assert len(controls) == (2 if experiment.control else 0)
    for target in registry.targets().values():
        made = beyond.cases([target.name], ["2.2kW"], SCHEMES[1:])
        every: dict[tuple[str, str, str], set[int]] = {}
        for case in made:
            group = every.setdefault((case.machine, case.scheme, "" if target.map else case.label), set())
            group.add(case.scenario.plant["seed"])
        assert every
        assert min(map(len, every.values())) >= 5, target.name


def test_operations_run_under_five_seeds_and_the_worst_counts() -> None:
    def made(
        function: object, jobs: list[tuple[str, str, str, int]], *common: str, **_: object
    ) -> list[operate.Performed]:
        assert common == ("f32",)
        found = []
        for name, machine, scheme, seed in jobs:
            claims = [at_most("x", 0.1 * seed, 0.25), holds("kept", seed != 3)]
            without = [at_least("without: y", 5.0 - seed, 2.0)]
            claims, without = ([replace(claim, seed=seed) for claim in of] for of in (claims, without))
            found.append(operate.Performed(name, machine, scheme, claims, without, {}))
        return found

    names = ["speed-step", "hoist"]
    runs = operate.perform_all(names, ["2.2kW", "11kW"], ["enhanced"], "f32", runner=made)  # type: ignore[arg-type]
    assert len(runs) == 2 * 2 * len(SEEDS) == 20
    worst = operate.worst(runs)
    assert [(x.name, x.machine) for x in worst] == [(n, m) for n in names for m in ("2.2kW", "11kW")]
    for x in worst:
        assert [(c.value, c.seed, c.ok) for c in x.claims] == [(0.4, 4, False), (0.0, 3, False)]
        assert [(c.value, c.seed, c.ok) for c in x.without] == [(1.0, 4, False)]
        assert not x.ok


def test_every_experiment_has_a_control_or_says_why_not() -> None:
    for experiment in registry.experiments().values():
        assert (experiment.control is None) == bool(experiment.no_control), experiment.name


# The committed table.


def line(value: float, *, bound: float = 1.0, ok: bool = True, machine: str = "2.2kW") -> Line:
    text = "yes" if ok else "no"
    return Line(
        "figure", "5", machine, "paper", "x", f"{value:g}", f"{bound:g}", "at most", "", "", "0", text
    )


def test_table_keeps_what_agrees_and_what_was_not_measured() -> None:
    other = line(0.2, machine="11kW")
    table = Table([line(0.5), other])
    assert table.updated([line(0.45)]).text() == table.text()
    # Never better than measured, and where it was measured.
    assert table.updated([line(0.55)]).lines == [line(0.55), other]
    elsewhere = replace(line(0.45), seed="3")
    assert table.updated([elsewhere]).lines == [elsewhere, other]
    assert table.updated([line(0.2)]).lines == [line(0.2), other]
    assert table.updated([line(0.9)]).lines == [line(0.9), other]
    assert table.updated([line(1.1, ok=False)]).lines == [line(1.1, ok=False), other]


def test_what_other_draws_have_shown_is_written_anew() -> None:
    def measured(draws: int, nees: float) -> list[Line]:
        of = replace(line(nees), kind="consistency", name="consistency", scheme="enhanced")
        number = replace(of, quantity=DRAWS, value=f"{draws}", bound="", direction="reported")
        return [number, replace(of, bound="2")]

    table = Table(measured(10, 0.5))
    assert table.updated(measured(10, 0.45)).lines == measured(10, 0.5)
    assert table.updated(measured(40, 0.45)).lines == measured(40, 0.45)


def test_counts_and_rates_of_a_campaign_are_those_of_one_measurement() -> None:
    def measured(rate: float, angle: float) -> list[Line]:
        of = replace(
            line(rate), kind="tolerance", name="hold", scheme="enhanced", bound="", direction="reported"
        )
        return [replace(of, unit="%"), replace(of, quantity="y", value=f"{angle:g}", unit="°")]

    rate, _ = measured(0.75, 9.0)
    _, angle = measured(1.0, 10.0)
    assert Table(measured(1.0, 10.0)).updated(measured(0.75, 9.0)).lines == [rate, angle]


def test_what_fails_is_written_anew() -> None:
    assert not agree(line(1.1, ok=False), line(1.2, ok=False))
    assert agree(line(1.1, ok=False), line(1.1, ok=False))
    assert not agree(line(0.5), line(0.5, bound=2.0))
    assert not agree(line(0.5), line(math.inf))


def test_table_reads_what_it_writes(tmp_path: Path) -> None:
    table = Table([line(0.5), line(math.inf, ok=False, machine="11kW")])
    table.write(tmp_path / "t.csv")
    assert Table.read(tmp_path / "t.csv").lines == table.lines
    assert Table.read(tmp_path / "none.csv").lines == []
    (tmp_path / "t.csv").write_text("figure,value\n5,1\n", encoding="utf-8")
    with pytest.raises(ValueError, match="columns"):
        Table.read(tmp_path / "t.csv")


@pytest.mark.parametrize(
    ("line", "expected"),
    [
        ("", "columns none, expected kind, name"),
        ("t,i_a", "columns t, i_a, expected kind, name"),
        ("{columns}\nfigure,9", "line 2: 'figure,9' is no line of this table"),
        ("{columns}\nfigure,9,2.2kW,paper,x,many,1,at most,,,,yes", "line 2: 'figure,9,"),
        ("{columns}\nfigure,9,2.2kW,paper,x,1,1,below,,,,yes", "line 2: 'figure,9,"),
    ],
)
def test_what_is_no_table_is_named_with_its_line(tmp_path: Path, line: str, expected: str) -> None:
    path = tmp_path / "metrics.csv"
    path.write_text(line.replace("{columns}", Table().text().strip()))
    with pytest.raises(ValueError, match=f"metrics.csv.*{expected}"):
        Table.read(path)
    path.write_bytes(b"\x80\x81")
    with pytest.raises(ValueError, match=r"metrics\.csv"):
        Table.read(path)


def test_a_figure_without_control_leaves_no_line_of_one() -> None:
    control = replace(line(2.0), kind="control")
    assert Table([line(0.5), control]).updated([line(0.5)]).lines == [line(0.5)]


# The documents.


@pytest.mark.parametrize("document", documents.DOCUMENTS, ids=str)
def test_document_says_what_the_table_says(document: Path) -> None:
    text = (ROOT / document).read_text(encoding="utf-8")
    table = Table.read(ROOT / "tests" / "metrics.csv")
    assert re.search(r"<!-- (table|value):", text)
    assert documents.rendered(text, table) == text, "run `make docs`"


def test_every_table_is_in_a_document() -> None:
    text = "".join((ROOT / document).read_text(encoding="utf-8") for document in documents.DOCUMENTS)
    assert all(f"<!-- table: {name} -->" in text for name in documents.TABLES)


def test_a_changed_line_changes_the_document() -> None:
    table = Table.read(ROOT / "tests" / "metrics.csv")
    key = ("figure", "9", "2.2kW", "paper")
    text = (
        "<!-- table: around-zero -->\n<!-- end -->\n"
        "<!-- value: figure, 9, 2.2kW, paper: centre of ψ̂_1 -->?<!-- end -->"
    )
    before = documents.rendered(text, table)
    assert documents.rendered(before, table) == before
    worse = [replace(x, value="77", ok="no") if x.group == key else x for x in table.lines]
    after = documents.rendered(before, Table(worse))
    assert "**77 %**" in after
    assert after.endswith("-->77 % of ψ*<!-- end -->")
    with pytest.raises(ValueError, match="no table none"):
        documents.rendered("<!-- table: none -->\n<!-- end -->", table)
    with pytest.raises(KeyError, match="no line"):
        documents.rendered("<!-- value: figure, 9, 2.2kW, paper: nothing --><!-- end -->", table)


def test_a_document_calls_nothing_reproduced_whose_claim_or_control_does_not_hold() -> None:
    text = "<!-- table: verdicts -->\n<!-- end -->\n<!-- table: limits -->\n<!-- end -->"
    good = [replace(x, ok="yes") for x in Table.read(ROOT / "tests" / "metrics.csv").lines]

    def verdicts(lines: list[Line]) -> tuple[dict[str, str], str]:
        found = documents.rendered(text, Table(lines))
        rows = [row.split(" | ") for row in found.splitlines() if row.startswith("| **")]
        return {row[0].strip("|* "): row[-1].strip("|* ") for row in rows}, found

    shown, found = verdicts(good)
    assert set(shown) == set(registry.figures())
    assert set(shown.values()) == {"reproduced"}
    assert "every claim holds at both machines" in found
    for kind in ("figure", "control"):
        group = (kind, "19", "11kW", "paper")
        shown, found = verdicts([replace(x, ok="no") if x.group == group else x for x in good])
        assert [name for name, verdict in shown.items() if verdict == "FAILED"] == ["19"], kind
        assert "every claim holds" not in found
        assert (
            f"**Fig. 19** fails without a documented reason: 11kW, {'control' if kind != 'figure' else ''}"
            in found
        )
        shown, _ = verdicts([x for x in good if x.group != group])
        assert shown["19"] not in ("reproduced", "limit"), "not measured"
    # With the other scheme beside it the published one is judged.
    shown, _ = verdicts([replace(x, ok="no") if x.scheme == "enhanced" else x for x in good])
    assert set(shown.values()) == {"reproduced"}


def test_a_control_that_does_not_fail_is_not_said_to() -> None:
    text = "<!-- table: around-zero -->\n<!-- end -->"
    lines = [replace(x, ok="yes") for x in Table.read(ROOT / "tests" / "metrics.csv").lines]
    group = ("control", "19", "11kW", "paper")

    def row(lines: list[Line]) -> str:
        (found,) = (x for x in documents.rendered(text, Table(lines)).splitlines() if x.startswith("| 19 "))
        return found

    assert "as it must" not in row(lines)
    assert "(**does not fail as it must at 11kW**)" in row(
        [replace(x, ok="no") if x.group == group else x for x in lines]
    )
    assert "at 11kW)" in row([x for x in lines if x.group != group])


def test_a_limit_covers_what_it_names(monkeypatch: pytest.MonkeyPatch) -> None:
    lines = Table.read(ROOT / "tests" / "metrics.csv").lines
    first, second = [x for x in lines if x.group == ("figure", "19", "11kW", "paper")][:2]
    limit = figure.Limit((first.quantity,), "it cannot be")
    of_19 = replace(registry.experiments()["19"], limits={"11kW": limit})
    monkeypatch.setattr(documents, "experiments", lambda: {**registry.experiments(), "19": of_19})
    text = "<!-- table: verdicts -->\n<!-- end -->\n<!-- table: limits -->\n<!-- end -->"
    for bad, verdict in (((first,), "limit"), ((first, second), "FAILED")):
        table = Table([replace(x, ok="no" if x in bad else "yes") for x in lines])
        found = documents.rendered(text, table)
        (row,) = (row for row in found.splitlines() if row.startswith("| **19**"))
        assert row.split(" | ")[-1].strip("|* ") == verdict
        assert "**Fig. 19.** it cannot be" in found
        assert ("fails without a documented reason" in found) == (verdict == "FAILED")


def test_rows_of_the_readme_name_tests_that_exist() -> None:
    for name in documents.tests_named():
        file, function = name.split("::")
        tree = ast.parse((ROOT / "tests" / file).read_text(encoding="utf-8"))
        assert function in {node.name for node in tree.body if isinstance(node, ast.FunctionDef)}, name


# The journal.


def doubled(x: int) -> int:
    return 2 * x


def test_journal_goes_on_where_it_was(tmp_path: Path) -> None:
    path = tmp_path / "journal"

    def first(job: tuple[object, ...]) -> bool:
        return job[0] == 1

    def killed(done: int, total: int, found: int) -> None:
        del found
        assert total == 3
        if done == 2:
            raise KeyboardInterrupt

    with pytest.raises(Stopped):
        Journal(path, "beyond", "build").run(doubled, [(1,), (2,), (3,)], first=first, show=killed)
    with path.open("ab") as file:
        file.write(b'["half a record", {"tup')
    again = Journal(path, "beyond", "build")
    assert again.done == 2
    fresh: list[tuple[int, int, int]] = []
    found = again.run(doubled, [(1,), (2,), (3,)], first=first, show=lambda *x: fresh.append(x))
    assert found == [2, 4, 6]
    assert [(done, total) for done, total, _ in fresh] == [(3, 3)]
    assert Journal(path, "beyond", "build").done == 3
    assert Journal(path, "beyond", "another build").done == 0
    again.remove()
    assert not path.exists()


class Runs:
    """A pickle of it runs code where it is read."""

    def __reduce__(self) -> tuple[object, tuple[str]]:
        return exec, ("raise SystemExit('code of a journal was run')",)


@pytest.mark.parametrize(
    ("content", "expected"),
    [
        (b"[motor]\nR_s = 3.7\n", "is no journal"),
        (b"t,i_a\n0,1\n", "is no journal"),
        (b'["key", {"status": "running", "error": ""}]\n', "is no journal"),
        (pickle.dumps("build") + pickle.dumps(Runs()), "is no journal"),
        (
            b'{"stillflux": "journal", "campaign": "beyond tolerance", "build": "build"}\n["a", 1]\n',
            "is of `stillflux beyond tolerance`, not of `stillflux beyond`",
        ),
    ],
)
def test_a_file_that_is_no_journal_of_the_campaign_is_refused_and_kept(
    tmp_path: Path, content: bytes, expected: str
) -> None:
    path = tmp_path / "own.toml"
    path.write_bytes(content)
    with pytest.raises(ValueError, match=f"journal = .*own.toml {expected}"):
        Journal(path, "beyond", "build")
    assert path.read_bytes() == content


def test_a_journal_gives_back_exactly_what_was_written(tmp_path: Path) -> None:
    own = OwnMachine(sf.load_machine(ROOT / "examples" / "machines" / "pump-4kW.toml"), "pump.toml")
    calm = judge.Confidence(1.0, 0, 0, 0.0, 0, 0.0, 20.0)
    numbers = [np.float64(1 / 3), np.float32(0.1), math.nan, -math.inf, 0.1] * 2
    values: list[Any] = [math.inf, "ü", *numbers, calm]
    measured = judge.Measured(*values)
    claims = (at_most("x", 1 / 3, 0.0),)
    course = {"angle": (np.array([0.0, math.nan, -0.0]), np.array([1j, 2.0]))}
    row = beyond.Row("flying", own, "paper", "a", 3, "", (0.1, -1.0), measured, claims, course)
    region = np.array([[1, 2], [3, -1]], np.int8)[:, ::-1]
    for value in (
        [row, {1: None, (2, "b"): True}, region, np.bool_(True), 1 + 2j, np.zeros((0, 3))],
        0.1 + 0.2,
    ):
        again = from_json(json.loads(json.dumps(to_json(value))))
        assert pickle.dumps(again) == pickle.dumps(from_json(to_json(value)))
        assert repr(again) == repr(value)
    again = from_json(json.loads(json.dumps(to_json(row))))
    assert (again.machine.machine, again.machine.source) == (own.machine, "pump.toml")
    assert [type(x) for x in (again.measured.angle_held, again.measured.angle_settled)] == [
        np.float64,
        np.float32,
    ]
    assert [x.dtype for x in again.trace["angle"]] == [float, complex]
    assert again.trace["angle"][0].tobytes() == course["angle"][0].tobytes()
    again.trace["angle"][0][0] = 1.0
    with pytest.raises(TypeError, match="cannot be written into a journal"):
        to_json(tmp_path)


@pytest.mark.parametrize(
    "data",
    [
        {"class": "os:_Environ", "fields": {}},
        {"class": "stillflux.evidence.journal:Journal", "fields": {"path": "x", "campaign": "y"}},
        {"class": "stillflux.nothing:Row", "fields": {}},
        {"call": "print"},
        {"array": "AAAA", "type": "|O", "shape": [1]},
    ],
)
def test_a_journal_makes_nothing_but_dataclasses_of_this_package(
    data: dict[str, object], tmp_path: Path
) -> None:
    with pytest.raises((ValueError, TypeError)):
        from_json(data)
    path = tmp_path / "journal"
    Journal(path, "beyond", "build").run(doubled, [(1,)], first=lambda _: False)
    head, line = path.read_text().splitlines()
    path.write_text(f"{head}\n{json.dumps([json.loads(line)[0], data])}\n")
    with pytest.raises(ValueError, match="a result cannot be read"):
        Journal(path, "beyond", "build").run(doubled, [(1,)], first=lambda _: False)
