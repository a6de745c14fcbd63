"""What pages show of the code."""

from __future__ import annotations

import importlib.util
import re
from pathlib import Path
from types import ModuleType

import pytest

from hydrabeam_mpi.effects.registry import KINDS

PAGES = Path(__file__).parents[2] / "docs"


@pytest.fixture(scope="module")
def made() -> ModuleType:
    spec = importlib.util.spec_from_file_location("made", PAGES / "made.py")
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def test_every_effect_has_names_of_its_parameters_with_units(made: ModuleType) -> None:
    sections = re.split(r"^## `(\w+)`$", made.effects(), flags=re.MULTILINE)[1:]
    told = dict(zip(sections[::2], sections[1::2], strict=True))
    assert told.keys() == set(KINDS)
    assert all(re.search(r"^Parameters such as `.+`.*\.$", text, re.MULTILINE) for text in told.values())
    assert "Parameters such as `antenna 0 ln amplitude`, `antenna 0 phase` (rad)." in told["antenna_gains"]
    assert re.search(r"`baseline \d+-\d+ real` \(Jy\), `baseline \d+-\d+ imaginary` \(Jy\)", told["cross_coupling"])
