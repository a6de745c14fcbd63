"""What a correlator does to single baselines: V_jk -> f_jk V_jk."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from tests.validation.undeclared.answer import Drawn, Parameter, Where, baseline, pairs
from tests.validation.undeclared.coupling import some_baselines
from tests.validation.undeclared.truth import ComplexArray, Truth


def closure_errors(truth: Truth, rng: np.random.Generator, strength: float, counts: Sequence[int] = (1, 6)) -> Drawn:
    """One baseline or six have a complex factor, off by about ``strength``."""
    chosen = some_baselines(truth, rng, counts)
    off = strength * (rng.standard_normal(len(chosen)) + 1j * rng.standard_normal(len(chosen))) / np.sqrt(2)
    return _multiplied(truth, chosen, 1 + off)


def decorrelation(truth: Truth, rng: np.random.Generator, strength: float) -> Drawn:
    """Four baselines without an antenna in common lose a part of about ``strength`` each, all the time."""
    left = list(rng.permutation(truth.setting.n_ants))
    chosen = []
    for _ in range(4):
        two = {left.pop(), left.pop()}
        chosen.append(next(bl for bl, pair in enumerate(truth.setting.antpairs.tolist()) if set(pair) == two))
    return _multiplied(truth, chosen, 1 - strength * rng.uniform(0.7, 1.0, len(chosen)) + 0j)


def _multiplied(truth: Truth, chosen: list[int], factors: ComplexArray) -> Drawn:
    """Multiply some baselines, either way round."""
    of_pair = np.ones((truth.setting.n_ants, truth.setting.n_ants), dtype=complex)
    one, two = truth.setting.antpairs[chosen].T
    of_pair[one, two], of_pair[two, one] = factors, factors.conj()
    truth.corruptions.append(lambda vis: vis * of_pair)
    parameters = [
        parameter
        for bl, number in zip(chosen, np.log(factors).tolist(), strict=True)
        for parameter in (
            Parameter(baseline(truth, bl), "ln amplitude", "", number.real),
            Parameter(baseline(truth, bl), "phase", "rad", number.imag),
        )
    ]
    return Drawn(parameters, Where(antpairs=pairs(truth, chosen)), 2 * len(chosen))
