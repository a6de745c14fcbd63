"""What is made of the repository for a package index."""

from __future__ import annotations

import re
import tomllib
from pathlib import Path

ROOT = Path(__file__).parents[1]
README = (ROOT / "README.md").read_text()
HATCH = tomllib.loads((ROOT / "pyproject.toml").read_text())["tool"]["hatch"]
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
