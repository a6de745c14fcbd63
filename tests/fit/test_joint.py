"""What a joint fit says of the beams alone."""

from __future__ import annotations

import numpy as np
import pytest

from hydrabeam_mpi.fit.joint import beams_alone
from hydrabeam_mpi.fit.state import Fit
from hydrabeam_mpi.inference.posterior import Posterior
from hydrabeam_mpi.random import complex_normal, generator


@pytest.mark.parametrize("is_complex", [False, True], ids=["real", "complex"])
@pytest.mark.parametrize("n_known", [0, 2])
def test_effects_widen_the_beam_by_how_much_it_follows_them(is_complex: bool, n_known: int) -> None:
    """Of the covariance C of the effects by M C M^H, also where some of them are known exactly; the mean stays."""
    rng = generator(1, "beams alone", str(is_complex))

    def draw(*shape: int) -> np.ndarray:
        return complex_normal(rng, shape) if is_complex else rng.standard_normal(shape)

    root, response, errors = draw(6, 9), draw(6, 4), rng.standard_normal((4, 7))
    errors[:n_known] = 0.0
    posterior = Posterior(draw(6), np.linalg.cholesky(root @ root.conj().T), log_evidence=-3.0)
    (found,) = beams_alone(Fit((posterior,), (errors @ errors.T,), (response,)))
    expected = posterior.covariance + response @ errors @ errors.T @ response.conj().T
    np.testing.assert_allclose(found.covariance, expected, atol=1e-10 * np.abs(expected).max())
    np.testing.assert_array_equal(found.mean, posterior.mean)
    assert found.log_evidence == -3.0


def test_without_effects_beams_are_as_they_are() -> None:
    posterior = Posterior(np.zeros(2), np.eye(2))
    assert beams_alone(Fit((posterior,))) == (posterior,)
