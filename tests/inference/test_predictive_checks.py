import numpy as np
import pytest
from scipy.stats import norm

from hydrabeam_mpi.inference.predictive_checks import Z_EDGES, HeldoutStatistics
from hydrabeam_mpi.random import complex_normal, generator


def sample(n, seed=0, scale=1.0):
    rng = generator(seed, "heldout")
    weights = rng.uniform(0.5, 2.0, n)
    mean = complex_normal(rng, (n,)) * 10
    variance = rng.uniform(0.0, 1.0, (2, n))
    noise = rng.standard_normal((2, n)) * np.sqrt(0.5 / weights + variance) * scale
    return mean + noise[0] + 1j * noise[1], weights, mean, variance


@pytest.mark.parametrize("scale", [1.0, 3.0])
def test_z_is_standard_normal_when_the_prediction_is_right(scale):
    data, weights, mean, variance = sample(20000, scale=scale)
    statistics = HeldoutStatistics()
    statistics.add(data, weights, mean, variance, mean + 5)
    summary = statistics.summary()
    assert summary["ppd_z_std"] == pytest.approx(scale, rel=0.02)
    assert summary["heldout_n"] == 20000
    assert statistics.counts.sum(axis=1).tolist() == [40000, 40000]


def test_log_density_matches_scipy():
    data, weights, mean, variance = sample(50)
    statistics = HeldoutStatistics()
    statistics.add(data, weights, mean, variance, mean)
    std = np.sqrt(0.5 / weights + variance)
    residual = data - mean
    expected = norm.logpdf(residual.real, scale=std[0]).sum() + norm.logpdf(residual.imag, scale=std[1]).sum()
    assert statistics.summary()["heldout_log_density"] == pytest.approx(expected, rel=1e-12)


def test_sums_add_up_over_parts_and_flags_do_not_count():
    data, weights, mean, variance = sample(60)
    weights[::7] = 0
    data[::7] = np.nan
    whole, parts = HeldoutStatistics(), [HeldoutStatistics() for _ in range(3)]
    whole.add(data, weights, mean, variance, mean)
    for part, index in zip(parts, np.array_split(np.arange(60), 3), strict=True):
        part.add(data[index], weights[index], mean[index], variance[:, index], mean[index])
    np.testing.assert_allclose(sum(part.sums for part in parts), whole.sums, rtol=1e-12)
    assert whole.summary()["heldout_n"] == np.sum(weights > 0)


def test_the_model_beam_with_its_best_complex_scale_and_the_noise():
    data, weights, mean, variance = sample(40)
    before = (0.3 + 0.2j) * data + mean
    weights[:3] = 0
    statistics = HeldoutStatistics()
    statistics.add(data, weights, mean, variance, before)
    summary = statistics.summary()
    root = np.sqrt(weights)
    (residual,) = np.linalg.lstsq((root * before)[:, None], root * data)[1]
    power = np.sum(weights * np.abs(data) ** 2)
    assert summary["heldout_rms_jy_unperturbed_complex"] == pytest.approx(np.sqrt(residual / weights.sum()), rel=1e-9)
    assert summary["heldout_explained_unperturbed_complex"] == pytest.approx(1 - residual / power, rel=1e-9)
    assert summary["heldout_rms_jy_unperturbed_complex"] < summary["heldout_rms_jy_unperturbed_scaled"]
    assert summary["heldout_rms_jy_noise"] == pytest.approx(np.sqrt(37 / weights.sum()), rel=1e-12)


def test_what_the_basis_leaves_of_the_model_beam():
    data, weights, mean, variance = sample(40)
    weights[:3] = 0
    statistics = HeldoutStatistics()
    statistics.add(data, weights, mean, variance, mean)
    assert "heldout_rms_jy_beyond_basis" not in statistics.summary()
    statistics = HeldoutStatistics()
    statistics.add(data, weights, mean, variance, mean, in_basis=mean + (3 - 4j) * (np.arange(40) < 20))
    expected = 5 * np.sqrt(weights[:20].sum() / weights.sum())
    assert statistics.summary()["heldout_rms_jy_beyond_basis"] == pytest.approx(expected, rel=1e-12)


def test_the_model_beam_with_its_best_amplitude_is_the_least_squares_fit():
    data, weights, mean, variance = sample(40)
    before = 0.3 * data + mean
    weights[:3] = 0
    statistics = HeldoutStatistics()
    statistics.add(data, weights, mean, variance, before)
    summary = statistics.summary()
    root = np.sqrt(weights)
    design, target = (np.concatenate([x.real, x.imag]) for x in (root * before, root * data))
    (amplitude,), (residual,) = np.linalg.lstsq(design[:, None], target)[:2]
    assert summary["heldout_amplitude_unperturbed"] == pytest.approx(amplitude, rel=1e-12)
    assert summary["heldout_chi2_unperturbed_scaled"] == pytest.approx(residual / 37, rel=1e-12)
    explained = 1 - residual / (target @ target)
    assert summary["heldout_explained_unperturbed_scaled"] == pytest.approx(explained, rel=1e-12)


def test_rms_is_the_weighted_root_mean_square_of_the_residual():
    data, weights, mean, variance = sample(40)
    statistics = HeldoutStatistics()
    statistics.add(data, weights, mean, variance, np.zeros(40, complex))
    summary = statistics.summary()
    rms = np.sqrt(np.average(np.abs(data - mean) ** 2, weights=weights))
    assert summary["heldout_rms_jy"] == pytest.approx(rms, rel=1e-12)
    assert summary["heldout_rms_jy_unperturbed"] == pytest.approx(summary["heldout_rms_jy_data"], rel=1e-12)
    assert summary["heldout_amplitude_unperturbed"] == 0


def test_far_outliers_stay_in_the_histogram():
    statistics = HeldoutStatistics()
    statistics.add(np.array([1e9 + 0j]), np.ones(1), np.zeros(1, complex), np.zeros((2, 1)), np.zeros(1, complex))
    assert statistics.counts[0].sum() == 2
    assert statistics.largest[0] > Z_EDGES[-1]


def test_nothing_held_out_has_no_numbers():
    assert HeldoutStatistics().summary() == {}
