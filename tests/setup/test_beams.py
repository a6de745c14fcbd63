"""Which modes a job's basis has, and how wide their prior is."""

import numpy as np
import pytest

from hydrabeam_mpi.config import Job
from hydrabeam_mpi.errors import InputError
from hydrabeam_mpi.model.bases.rings import Pixels, degree_grid
from hydrabeam_mpi.model.beam import SampledBeam
from hydrabeam_mpi.model.interpolate import AzZaGrid
from hydrabeam_mpi.setup.beams import fit_model_beams, load_beams, make_prior, shaped

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


def test_modes_that_the_model_beam_lacks_are_there_with_a_width():
    """A round model does not say that the beam is round: the prior lets it vary with azimuth, less at high orders."""
    modes, widths = modes_and_widths({})
    assert len(modes) >= 199
    width = dict(zip(modes, widths, strict=True))
    assert width[1, 0] > width[1, 2] > width[1, 4] > width[1, 3] > 1e-6 * widths.max()
    assert width[1, 2] == width[1, -2]


def test_a_model_that_has_all_modes_is_taken_as_it_is():
    """As in the paper: widths are a fraction of its own coefficients."""
    job = Job.model_validate(
        {
            "data": {"simulate": {"freqs": ("131 MHz",)}},
            "basis": {"n_modes": 200, "k_max": 30, "m_max": 8},
            "prior": {"fraction": 0.3},
        }
    )
    basis, (fit,) = fit_model_beams(job, load_beams(job, np.array([FREQ]), "ee"))
    np.testing.assert_array_equal(make_prior(job, fit).std(), 0.3 * basis.amplitudes(fit.coeffs))


@pytest.mark.parametrize("prior", [{"floor": 1e-4}, {"kind": "flat"}])
def test_a_prior_that_lets_them_move_keeps_them(prior):
    modes, widths = modes_and_widths(prior)
    assert len(modes) >= 199
    assert widths.min() >= 1e-4 * np.sort(widths)[-2] or np.isinf(widths).all()


def test_shape_is_that_of_the_fitted_model():
    """Whose samples may end before the horizon."""
    job = Job.model_validate(
        {
            "data": {"simulate": {"freqs": ("131 MHz",)}},
            "beam": {"source": "airy", "diameter": "14 m"},
            "basis": {"n_modes": 200, "k_max": 30, "m_max": 4},
            "prior": {"fraction": 0.1, "floor": 0.1},
        }
    )
    (beam,) = load_beams(job, np.array([FREQ]), "ee")
    za, az = degree_grid()
    some = za <= np.deg2rad(80)
    rings, turns = np.unique(za[some]), np.unique(az)
    values = beam(*(one.ravel() for one in np.meshgrid(rings, turns, indexing="ij")))
    grid = AzZaGrid(rings, turns, values.reshape(len(rings), len(turns)))
    ending = SampledBeam(grid, Pixels(za[some], az[some], beam(za, az)[some]), beam.info)
    with pytest.raises(InputError, match="end at a zenith angle of 80 deg"):
        ending(np.array([1.5]), np.zeros(1))
    basis, fits = fit_model_beams(job, [beam])
    whole, short = (shaped([make_prior(job, fits[0])], [one], basis)[0].shape for one in (beam, ending))
    np.testing.assert_array_equal(short, whole)
    assert whole.shape == (basis.n_modes, 61)
