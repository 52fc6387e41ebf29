"""Finds figures, targets and operations: every module in `figures`, `plane` and `operations` has some."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterable, Iterator, Mapping
from functools import cache
from importlib import import_module
from pkgutil import iter_modules
from types import ModuleType

from stillflux.evidence.figure import Experiment
from stillflux.evidence.operation import Operation
from stillflux.evidence.target import Target

__all__ = [
    "choose_figures",
    "choose_operations",
    "choose_targets",
    "experiments",
    "figures",
    "operations",
    "targets",
]


@cache
def experiments() -> Mapping[str, Experiment]:
    """All experiments of the paper's drive by name, in the order of the paper's figures."""
    found = {x.name: x for module in _modules("figures") for x in module.EXPERIMENTS}
    return dict(sorted(found.items(), key=lambda item: not item[1].of_paper))


@cache
def figures() -> tuple[str, ...]:
    """Names of those that are figures of the paper."""
    return tuple(name for name, x in experiments().items() if x.of_paper)


@cache
def targets() -> Mapping[str, Target]:
    """All targets of the plane by name."""
    found = [target for module in _modules("plane") for target in module.TARGETS]
    return {target.name: target for target in sorted(found, key=lambda target: target.order)}


@cache
def operations() -> Mapping[str, Operation]:
    """All operations by name."""
    found = [operation for module in _modules("operations") for operation in module.OPERATIONS]
    return {operation.name: operation for operation in sorted(found, key=lambda operation: operation.order)}


def choose_figures(names: Iterable[str]) -> tuple[str, ...]:
    """Figures by number: "13" stands for 13a and 13b; none: all of them and the headline.

    Raises ValueError for one that does not exist.
    """

    def matches(name: str) -> list[str]:
        every = experiments()
        return [f for f in every if f == name or (f.startswith(name) and not f[len(name)].isdigit())]

    return _chosen("figure", names, matches, tuple(experiments()))


def choose_targets(names: Iterable[str]) -> tuple[str, ...]:
    """Targets by name or its beginning: "plane" stands for all maps; none: all of them.

    Raises ValueError for one that does not exist.
    """
    return _chosen("target", names, _beginning(targets()), tuple(targets()))


def choose_operations(names: Iterable[str]) -> tuple[str, ...]:
    """Operations by name or its beginning; none: all of them.

    Raises ValueError for one that does not exist.
    """
    return _chosen("operation", names, _beginning(operations()), tuple(operations()))


def _beginning(every: Iterable[str]) -> Callable[[str], list[str]]:
    """Matches the name, or else those of which it is the beginning."""
    return lambda name: [x for x in every if x == name] or [x for x in every if x.startswith(f"{name}-")]


def _chosen(
    kind: str, names: Iterable[str], matches: Callable[[str], list[str]], every: tuple[str, ...]
) -> tuple[str, ...]:
    chosen: list[str] = []
    for name in names:
        found = matches(name)
        if not found:
            raise ValueError(f"there is no {kind} {name}; there are {', '.join(every)}")
        chosen += found
    return tuple(dict.fromkeys(chosen)) or every


def _modules(package: str) -> Iterator[ModuleType]:
    """Modules of a package beside this one, numbered ones first, sorted by name with numbers as numbers."""
    name = f"{__package__}.{package}"
    found = [module.name for module in iter_modules(import_module(name).__path__)]
    for module in sorted(found, key=lambda name: ("_" in name, _natural(name))):
        yield import_module(f"{name}.{module}")


def _natural(name: str) -> list[tuple[int, str]]:
    return [(int(part or 0), text) for text, part in re.findall(r"(\D+)(\d*)", name)]
