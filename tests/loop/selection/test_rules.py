"""The numbers by which the loop decides: each changes what it says that it changes, and they cannot be changed."""

from __future__ import annotations

from dataclasses import FrozenInstanceError, fields, replace
from types import ModuleType

import numpy as np
import pytest

from hydrabeam_mpi.effects.instrument.antenna_gains import AntennaGains
from hydrabeam_mpi.effects.instrument.antenna_positions import AntennaPositions
from hydrabeam_mpi.effects.interface.effect import Parameters
from hydrabeam_mpi.inference.likelihood import Likelihood
from hydrabeam_mpi.loop.attribution import few_elements
from hydrabeam_mpi.loop.attribution.evidence import find_evidence
from hydrabeam_mpi.loop.rules import RULES, Rules
from hydrabeam_mpi.loop.selection import acceptance, refusal
from tests.loop.made import checked, effect_candidate, round_of, weights_candidate


def with_rules(monkeypatch: pytest.MonkeyPatch, module: ModuleType, **changes: float) -> None:
    monkeypatch.setattr(module, "RULES", replace(RULES, **changes))


def test_every_rule_has_its_reason() -> None:
    told = str(Rules.__doc__)
    assert all(field.name in told for field in fields(Rules))
    with pytest.raises(FrozenInstanceError):
        RULES.near = 0.5  # type: ignore[misc]


@pytest.mark.parametrize(("near", "may"), [(0.3, True), (0.31, False)])
def test_near(near: float, may: bool, monkeypatch: pytest.MonkeyPatch) -> None:
    with_rules(monkeypatch, acceptance, near=near)
    best = round_of(effect_candidate(AntennaGains(), 100.0), checked(2.0), checked(1.2))
    assert acceptance.may_be_better(effect_candidate(AntennaPositions(), 30.0), best, enough=False) == may
    order = acceptance.in_order([weights_candidate(100.0), effect_candidate(AntennaPositions(), 30.0)], 6)
    assert (order[0].finding is not None) == may


@pytest.mark.parametrize(("near", "may"), [(0.3, True), (0.31, False)])
def test_near_if_linear(near: float, may: bool, monkeypatch: pytest.MonkeyPatch) -> None:
    with_rules(monkeypatch, acceptance, near_if_linear=near)
    best = round_of(effect_candidate(AntennaPositions(), 100.0), checked(2.0), checked(1.2))
    assert acceptance.may_be_better(effect_candidate(AntennaGains(), 30.0), best, enough=False) == may


@pytest.mark.parametrize(("sigmas", "rises"), [(1.0, True), (1e3, False)])
def test_decided_sigmas_of_a_rise(sigmas: float, rises: bool, monkeypatch: pytest.MonkeyPatch) -> None:
    with_rules(monkeypatch, refusal, decided_sigmas=sigmas)
    assert (refusal.rise_of_rms(checked(5.0, rms=3.0), checked(1.0, rms=3.3)) is not None) == rises


@pytest.mark.parametrize(("nats", "taken"), [(4.0, 2), (40.0, 1)])
def test_element_nats(nats: float, taken: int, monkeypatch: pytest.MonkeyPatch) -> None:
    """One of ten antennas at 30 sigma, and one at 6."""
    with_rules(monkeypatch, few_elements, element_nats=nats)
    score = np.zeros(10)
    score[[2, 7]] = 30.0, 6.0
    block = Likelihood(np.eye(10), score, np.eye(10))
    parameters = Parameters.of([f"antenna {i}" for i in range(10)], "", 1.0, np.arange(10))
    assert np.count_nonzero(find_evidence([block], parameters).prior_var) == taken
