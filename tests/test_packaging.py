"""What is made of the repository for a package index."""

from __future__ import annotations

import ast
import re
import sys
import tomllib
from importlib.metadata import packages_distributions
from pathlib import Path

ROOT = Path(__file__).parents[1]
README = (ROOT / "README.md").read_text()
PYPROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text())
HATCH = PYPROJECT["tool"]["hatch"]
TARGET = re.compile(r"\]\(([^)]*)\)")


def test_the_index_shows_no_picture_and_no_link_that_it_does_not_have() -> None:
    text = README
    for one in HATCH["metadata"]["hooks"]["fancy-pypi-readme"]["substitutions"]:
        text = re.sub(one["pattern"], one["replacement"], text)
    assert [target for target in TARGET.findall(text) if not target.startswith("http")] == []
    assert "![" not in text
    # The text of a link stays, and all else.
    assert "on the command line, in Python, glossary, coming from Hydra" in text
    words = re.sub(r"!\[[^]]*\]", "", TARGET.sub("]", README))
    assert re.findall(r"\w+", text) == re.findall(r"\w+", words)


def test_the_source_distribution_has_what_the_readme_names() -> None:
    there = [f"{path.removeprefix('/')}/" for path in HATCH["build"]["targets"]["sdist"]["include"]]
    targets = [target for target in TARGET.findall(README) if not target.startswith("http")]
    assert len(targets) > 30
    assert [target for target in targets if not f"{target}/".startswith(tuple(there))] == []


def test_what_is_imported_is_declared() -> None:
    """Not left to what other packages happen to bring."""
    project = PYPROJECT["project"]
    extras = [project["optional-dependencies"][name] for name in ("chains", "nufft", "plot", "casa")]
    declared = {normal(re.split(r"[\[<>=]", one)[0]) for one in sum(extras, project["dependencies"])}
    known = packages_distributions()
    imported = {name for path in (ROOT / "hydrabeam_mpi").rglob("*.py") for name in modules_of(path)}
    others = {name for name in imported - sys.stdlib_module_names - {"hydrabeam_mpi"} if name in known}
    assert len(others) > 15
    assert {name for name in others if not declared & set(map(normal, known[name]))} == set()


def normal(name: str) -> str:
    """Return a distribution's name as indices compare it."""
    return re.sub(r"[-_.]+", "-", name).lower()


def modules_of(path: Path) -> set[str]:
    """Return the top-level modules that a file imports."""
    nodes = list(ast.walk(ast.parse(path.read_text())))
    named = [one.name for node in nodes if isinstance(node, ast.Import) for one in node.names]
    named += [node.module or "" for node in nodes if isinstance(node, ast.ImportFrom) and not node.level]
    return {name.partition(".")[0] for name in named}
