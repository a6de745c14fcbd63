"""What effects there are, as the command line tells it."""

from __future__ import annotations

import pytest

from hydrabeam_mpi.cli import main
from hydrabeam_mpi.effects.registry import EFFECTS, KINDS


def test_each_has_a_line_with_its_title(capfd: pytest.CaptureFixture[str]) -> None:
    assert main(["effects"]) == 0
    lines = capfd.readouterr().out.splitlines()
    assert [line.split()[0] for line in lines] == list(KINDS)
    assert f"{'timestamp':{max(map(len, KINDS))}}  {EFFECTS['timestamp'].title}" in lines


def test_one_is_told_with_its_equation_settings_and_parameters(capfd: pytest.CaptureFixture[str]) -> None:
    assert main(["effects", "antenna_gains"]) == 0
    told = capfd.readouterr().out
    assert "V_jk -> g_j g_k* V_jk with g = exp(a + i phi)" in told
    assert "- `channels` ({" in told
    assert told.endswith("Parameters such as `antenna 0 ln amplitude`, `antenna 0 phase` (rad).\n")


@pytest.mark.parametrize(("kind", "meant"), [("antenna_gain", "did you mean 'antenna_gains'"), ("x", "lists them")])
def test_another_is_refused_in_a_line(kind: str, meant: str, capfd: pytest.CaptureFixture[str]) -> None:
    assert main(["effects", kind]) == 2
    (line,) = capfd.readouterr().err.splitlines()
    assert f"no effect '{kind}'" in line
    assert meant in line
