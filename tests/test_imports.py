"""Which module may import which: read from the source, so that it also holds for imports inside functions."""

from __future__ import annotations

import ast
from collections.abc import Iterator
from pathlib import Path

import pytest

PACKAGE = "hydrabeam_mpi"
ROOT = Path(__file__).parents[1]
LAYERS = (
    ("compiled", "eigen", "errors", "launchers", "memory", "random", "registry", "version", "words"),
    ("extras",),
    ("data",),
    ("mpi", "terminal"),
    ("model.bases", "model.engines"),
    ("model",),
    ("inference", "tables"),
    ("effects.interface",),
    ("effects.shared",),
    ("effects.instrument", "effects.sky", "effects.noise"),
    ("effects",),
    ("config",),
    ("io",),
    ("sampling.storage",),
    ("sampling.convergence", "sampling.arviz", "sampling.heldout"),
    ("sampling.status",),
    ("setup",),
    ("fit",),
    ("result",),
    ("simulation",),
    ("loop.residuals", "loop.rules"),
    ("loop.attribution",),
    ("loop.selection",),
    ("loop.output",),
    ("loop.checks",),
    ("loop",),
    ("sampling",),
    ("planning",),
    ("report.page",),
    ("report.beam", "report.chains", "report.data", "report.loop"),
    ("report",),
    ("api",),
    ("commands",),
    ("cli",),
    ("__main__",),
)
"""The rooms from the ground up: what is in one may import from its own and from those in the layers before it."""
SERIAL = (
    "config",
    "data",
    "effects",
    "inference",
    "io",
    "model",
    "report",
    "sampling.arviz",
    "sampling.convergence",
    "sampling.heldout",
    "sampling.status",
    "sampling.storage",
    "tables",
    "terminal",
)
# What knows of processes: the layers that run.
RUNNING = (
    "mpi",
    "setup.earth_table",
    "setup.flagged",
    "setup.held",
    "setup.problem",
    "setup.job_file",
    "fit",
    "result",
    "simulation",
    "loop",
    "planning",
    "sampling.begin",
    "sampling.predictive",
    "sampling.run",
    "sampling.steps",
    "sampling.sweep",
    "sampling.variables",
    "sampling.walk",
    "api.setup",
    "api.preparation",
    "api.shared",
    "api.inference",
    "api.loop",
    "api.plan",
    "api.sampling",
    "api.simulation",
    "commands",
    "cli",
    "__main__",
)


def modules() -> dict[str, Path]:
    """Return the package's modules by name."""
    return {
        ".".join(path.relative_to(ROOT).with_suffix("").parts).removesuffix(".__init__"): path
        for path in sorted((ROOT / PACKAGE).rglob("*.py"))
    }


def imported(path: Path, *, at_load: bool = False) -> Iterator[str]:
    """Yield what a module imports, down to single names; ``at_load`` leaves out imports within functions."""
    waiting: list[ast.AST] = [ast.parse(path.read_text())]
    while waiting:
        node = waiting.pop()
        if isinstance(node, ast.Import):
            yield from (alias.name for alias in node.names)
        elif isinstance(node, ast.ImportFrom):
            assert node.level == 0, f"{path}: relative import"
            yield str(node.module)
            yield from (f"{node.module}.{alias.name}" for alias in node.names)
        if not (at_load and isinstance(node, ast.FunctionDef)):
            waiting += ast.iter_child_nodes(node)


MODULES = modules()


def inner_imports(name: str) -> set[str]:
    """Return the modules of the package that a module imports, within functions or not."""
    return {found for found in imported(MODULES[name]) if found in MODULES and found != name}


def in_any(name: str, parts: tuple[str, ...]) -> bool:
    return any(name == f"{PACKAGE}.{part}" or name.startswith(f"{PACKAGE}.{part}.") for part in parts)


def room_of(name: str) -> tuple[int, str]:
    """Return the layer and the room of a module, the innermost room that it is in."""
    rooms = [(layer, room) for layer, rooms in enumerate(LAYERS) for room in rooms if in_any(name, (room,))]
    return max(rooms, key=lambda one: len(one[1]))


def test_modules_are_found() -> None:
    assert {f"{PACKAGE}.cli", f"{PACKAGE}.mpi", f"{PACKAGE}.model.fit", f"{PACKAGE}.random"} <= set(MODULES)
    assert "mpi4py.MPI.Comm" in set(imported(MODULES[f"{PACKAGE}.mpi"]))
    assert f"{PACKAGE}.commands.infer" in set(imported(MODULES[f"{PACKAGE}.cli"]))
    assert f"{PACKAGE}.commands.infer" not in set(imported(MODULES[f"{PACKAGE}.cli"], at_load=True))


@pytest.mark.parametrize("name", [name for name in MODULES if name != PACKAGE])
def test_imports_run_one_way_between_rooms(name: str) -> None:
    layer, room = room_of(name)
    found = {one: room_of(one) for one in inner_imports(name) if one != PACKAGE}
    assert [one for one, (below, other) in found.items() if other != room and below >= layer] == []


@pytest.mark.parametrize("name", [name for name in MODULES if not in_any(name, ("effects", "loop.checks"))])
def test_effects_are_known_by_what_all_of_them_offer(name: str) -> None:
    """Nobody speaks to a single one, except for the check of leakage, which has rows of its own."""
    single = ("effects.instrument", "effects.sky", "effects.noise")
    assert [found for found in inner_imports(name) if in_any(found, single)] == []


@pytest.mark.parametrize("name", MODULES)
def test_mpi4py_is_imported_in_one_room(name: str) -> None:
    if not in_any(name, ("mpi",)):
        assert not [found for found in imported(MODULES[name]) if found.split(".")[0] == "mpi4py"]


@pytest.mark.parametrize("name", [name for name in MODULES if in_any(name, SERIAL)])
def test_serial_modules_never_see_processes(name: str) -> None:
    assert not [found for found in imported(MODULES[name]) if in_any(found, RUNNING)]


@pytest.mark.parametrize("name", [name for name in MODULES if in_any(name, ("mpi",))])
def test_processes_know_nothing_of_beams(name: str) -> None:
    allowed = ("mpi", "data", "errors", "launchers", "memory")
    within = [found for found in imported(MODULES[name]) if found.split(".")[0] == PACKAGE and found in MODULES]
    assert [found for found in within if found != PACKAGE and not in_any(found, allowed)] == []


@pytest.mark.parametrize("name", [name for name in MODULES if in_any(name, ("data", "random", "errors"))])
def test_data_know_nothing_of_models(name: str) -> None:
    allowed = ("data", "random", "errors")
    within = [found for found in imported(MODULES[name]) if found in MODULES and found != PACKAGE]
    assert [found for found in within if not in_any(found, allowed)] == []


def test_no_cycles() -> None:
    """An import within a function counts: the commands that `cli` loads when asked for lie below it, as all else."""
    finished: set[str] = set()

    def visit(name: str, path: tuple[str, ...]) -> None:
        assert name not in path, " -> ".join((*path, name))
        if name not in finished:
            for found in sorted(inner_imports(name)):
                visit(found, (*path, name))
            finished.add(name)

    for name in MODULES:
        visit(name, ())
    assert finished == set(MODULES)
