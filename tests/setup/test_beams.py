"""Which modes a job's basis has, and how wide their prior is."""

import numpy as np
import pytest

from hydrabeam_mpi.config import Job
from hydrabeam_mpi.setup.beams import fit_model_beams, load_beams, make_prior

FREQ = 131e6


def modes_and_widths(prior):
    """Fit an azimuthally symmetric model beam by 200 modes at most."""
    job = Job.model_validate(
        {
            "data": {"simulate": {"freqs": ("131 MHz",)}},
            "beam": {"source": "gaussian", "diameter": "14 m"},
            "basis": {"n_modes": 200, "k_max": 30, "m_max": 4},
            "prior": prior,
        }
    )
    basis, (fit,) = fit_model_beams(job, load_beams(job, np.array([FREQ]), "ee"))
    return basis.modes, make_prior(job, fit).std()


def test_modes_that_the_model_beam_lacks_stay_among_those_that_come_next():
    """Their prior would have no width: in the basis they could not move, nor be offered as what it lacks."""
    modes, widths = modes_and_widths({})
    assert {m for _, m in modes} == {0}
    assert len(modes) <= 30
    assert (widths > 0).all()


@pytest.mark.parametrize("prior", [{"floor": 1e-4}, {"kind": "flat"}])
def test_a_prior_that_lets_them_move_keeps_them(prior):
    modes, widths = modes_and_widths(prior)
    assert len(modes) >= 199
    assert widths.min() >= 1e-4 * np.sort(widths)[-2] or np.isinf(widths).all()
