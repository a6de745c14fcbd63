"""What the data sets of ``posterior.h5`` say of themselves."""

from __future__ import annotations

LONG_NAMES = {
    "mean": "posterior mean of the coefficients",
    "covariance": "posterior covariance of the coefficients",
    "std": "posterior standard deviation of the coefficients",
    "prior_mean": "prior mean of the coefficients",
    "prior_std": "prior standard deviation of the coefficients",
    "model_mean": "coefficients of the model beam",
    "draws": "posterior draws of the coefficients",
    "map_mean": "posterior mean of the power beam, in units of the model beam's peak",
    "map_std": "posterior standard deviation of the power beam, likewise",
    "map_model": "model power beam, likewise",
    "map_truth": "simulated power beam, likewise",
    "eigen_variances": "smallest eigenvalues of the covariance",
    "eigen_beams": "their eigenvectors on the sky",
    "z_edges": "edges of the histogram of held-out z-scores",
    "z_counts": "held-out z-scores in each bin, of the inferred and of the model beam",
    "effects_covariance": "posterior covariance of the parameters of effects, each in its own unit",
    "effects_beam_response": "change of the beam's coefficients with each parameter of an effect, per its unit",
    "information": "information of the channel's data on the coefficients",
    "score": "gradient of the ln likelihood of the channel's data in the coefficients at the prior mean",
    "heldout_data": "a sample of the held-out visibilities as they were read",
    "heldout_before": "what the model beam predicts of them, with nothing fitted",
    "heldout_after": "what the inferred beam predicts of them, with the effects of the model",
    "heldout_weights": "one over the variance of their noise, E|n|^2; zero where flagged",
    "baseline_n": "number of held-out visibilities of each baseline",
    "baseline_chi2": "their reduced chi^2, of the model beam and of the inferred beam",
}
"""What the data sets of a channel say of themselves."""
UNITS = dict.fromkeys(("heldout_data", "heldout_before", "heldout_after"), "Jy") | {"heldout_weights": "Jy^-2"}
"""Of those that are no pure numbers, but for parameters of effects, which have each its own."""
OBSERVED = {
    "antenna_numbers": ("1", "antennas"),
    "antenna_positions": ("m", "East, North and Up of the antennas"),
    "baselines": ("1", "the two antennas of each baseline"),
    "baseline_vectors": ("m", "East, North and Up of the redundant groups of baselines"),
    "baseline_counts": ("1", "number of baselines of each group"),
    "heldout_jd": ("d", "times of the sample of held-out visibilities, Julian dates (UTC)"),
    "heldout_lst": ("rad", "their local apparent sidereal times"),
    "heldout_antennas": ("1", "the two antennas of each baseline of the sample"),
    "track_flux": ("Jy", "flux densities in the first channel of the sources that the beam sees brightest"),
    "track_za": ("rad", "their zenith angles at some of the times; beyond a quarter turn they are below the horizon"),
    "track_az": ("rad", "their azimuths, from East through North"),
}
"""Data sets of the group ``observed`` with their units and long names."""
