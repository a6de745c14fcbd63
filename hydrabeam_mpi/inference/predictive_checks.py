"""Held-out data against predictions: additive statistics of the residuals (HDBI II, section 4.3)."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from hydrabeam_mpi.data.observation import ComplexArray, FloatArray

# z-scores are counted in bins that are even near zero and logarithmic far out, up to |z| of about 1e6.
Z_EDGES: FloatArray = np.sinh(np.linspace(-14.5, 14.5, 581))
LARGEST_PREDICTIVE = 2.0
"""Above this held-out reduced chi^2 under the posterior predictive a warning says that the posterior is too narrow.

Standard deviations are then too small by 1.4 or more, which no number of data makes up for.
"""


@dataclass
class HeldoutStatistics:
    """Sums over held-out visibilities, additive over rows and ranks.

    The z-scores are those of real and imaginary parts: of the data about the posterior predictive, whose variance
    is noise plus model, and of the data about the model beam's prediction with the noise alone.

    Flux scale and beam amplitude cannot be told apart, and an inferred beam takes up what is wrong with either. The
    model beam is therefore also compared with one free amplitude ("scaled"), fitted to the held-out data themselves,
    which favours the model beam.

    Attributes
    ----------
    sums : ndarray, (14,)
        Number of parts; sum of z, of z^2 and of the log predictive density (natural, per Jy^2) for the inferred
        beam; sum of z and z^2 for the model beam; sum of w|d|^2, w|r|^2 (inferred), w|r|^2 (model); sum of w, and
        of w Re(d* m), w|m|^2 and w Im(d* m) with m the model beam's prediction; sum of w|m - F b|^2 with b the model
        beam's fit in the basis.
    counts : ndarray, (2, Nbins)
        Histograms of z over `Z_EDGES`, inferred and model beam.
    largest : ndarray, (2,)
        Largest absolute z of each; combined by maximum.
    """

    sums: FloatArray = field(default_factory=lambda: np.zeros(14))
    counts: FloatArray = field(default_factory=lambda: np.zeros((2, len(Z_EDGES) - 1)))
    largest: FloatArray = field(default_factory=lambda: np.zeros(2))

    def add(
        self,
        data: ComplexArray,
        inv_noise_var: FloatArray,
        mean: ComplexArray,
        variance: FloatArray,
        before: ComplexArray,
        as_read: tuple[ComplexArray, FloatArray] | None = None,
        in_basis: ComplexArray | None = None,
    ) -> None:
        """Add visibilities, all (N,), but ``variance``, the model variance of the two parts, (2, N).

        Where effects have been taken out of the data, those that were read, and their weights, are ``as_read``: what
        the model beam is compared with. What its fit in the basis predicts is ``in_basis``, where that is asked.
        """
        used = inv_noise_var > 0
        if not used.any():
            return
        after = _parts(data[used] - mean[used])
        total = 0.5 / inv_noise_var[used] + variance[:, used]
        z = after / np.sqrt(total)
        log_density = -0.5 * np.sum(z**2 + np.log(2 * np.pi * total))
        observed, weights = (values[used] for values in as_read or (data, inv_noise_var))
        predicted = before[used]
        raw = _parts(observed - predicted)
        left = np.zeros(1) if in_basis is None else _parts(predicted - in_basis[used])
        z_before = raw * np.sqrt(2 * weights)
        self.sums += [
            z.size, z.sum(), np.sum(z**2), log_density, z_before.sum(), np.sum(z_before**2),
            np.sum(weights * np.abs(observed) ** 2), np.sum(inv_noise_var[used] * after**2), np.sum(weights * raw**2),
            weights.sum(), np.sum(weights * (observed.conj() * predicted).real),
            np.sum(weights * np.abs(predicted) ** 2), np.sum(weights * (observed.conj() * predicted).imag),
            np.sum(weights * left**2),
        ]  # fmt: skip
        for row, scores in enumerate((z, z_before)):
            self.counts[row] += np.histogram(np.clip(scores, Z_EDGES[0], Z_EDGES[-1]), Z_EDGES)[0]
            self.largest[row] = max(self.largest[row], float(np.abs(scores).max()))

    def summary(self) -> dict[str, float]:
        """Return the numbers that ``summary.json`` shows; empty where nothing was held out.

        ``heldout_chi2_predictive`` is the mean of z^2 under the posterior predictive, whose variance is that of noise
        and beam: one where the posterior is right. ``heldout_chi2_noise_only`` divides the same residuals by the noise
        alone, and is above one by what the data leave uncertain of the beam. A plain rms is sqrt(sum w|x|^2 / sum w),
        Jy: of the residual, of the data (what predicting zero leaves) and of the noise alone; ``_complex`` has the
        model beam with its best complex scale, and ``_beyond_basis`` is that of what the basis leaves of the model
        beam's prediction, where that is known. ``heldout_log_density`` is complete, with the logarithm of the
        variances, of each part by itself.
        """
        n, z, z2, log_density, z_before, z2_before, *products = self.sums.tolist()
        if not n:
            return {}
        power, after, before, weight, overlap, model_power, overlap_imag, left = products
        amplitude = overlap / model_power if model_power else 0.0
        scaled = max(power - amplitude * overlap, 0.0)
        complex_scaled = max(scaled - (overlap_imag**2 / model_power if model_power else 0.0), 0.0)
        numbers = {
            "ppd_z_std": _std(n, z, z2),
            "ppd_z_max": float(self.largest[0]),
            "ppd_z_std_unperturbed": _std(n, z_before, z2_before),
            "ppd_z_max_unperturbed": float(self.largest[1]),
            "heldout_chi2_predictive": z2 / n,
            "heldout_log_density": log_density,
            "heldout_n": n / 2,
            "heldout_rms_jy_data": float(np.sqrt(power / weight)),
            "heldout_rms_jy_noise": float(np.sqrt(0.5 * n / weight)),
            "heldout_rms_jy_unperturbed_complex": float(np.sqrt(complex_scaled / weight)),
            "heldout_explained_unperturbed_complex": 1 - complex_scaled / power if power else 0.0,
            "heldout_amplitude_unperturbed": amplitude,
        }
        if left:
            numbers["heldout_rms_jy_beyond_basis"] = float(np.sqrt(left / weight))
        for name, residual in {"": after, "_unperturbed": before, "_unperturbed_scaled": scaled}.items():
            numbers[f"heldout_chi2{name or '_noise_only'}"] = 2 * residual / n
            numbers[f"heldout_explained{name}"] = 1 - residual / power if power else 0.0
            numbers[f"heldout_rms_jy{name}"] = float(np.sqrt(residual / weight))
        return numbers


def _parts(values: ComplexArray) -> FloatArray:
    """Stack real and imaginary parts, (2, N)."""
    return np.stack([values.real, values.imag])


def _std(n: float, total: float, squares: float) -> float:
    """Return the standard deviation from sums."""
    return float(np.sqrt(max(squares / n - (total / n) ** 2, 0.0)))
