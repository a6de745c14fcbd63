"""The key numbers: what each means, how it is written, and what the paper found."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any, Literal

from hydrabeam_mpi.words import text_table

Kind = Literal["number", "percent", "count"]


@dataclass(frozen=True)
class KeyNumber:
    """A number of ``summary.json``.

    Attributes
    ----------
    key : str
    what : str
        Its meaning in a few words.
    kind : {"number", "percent", "count"}
    paper, incomplete : str
        What HDBI II found at 150 MHz with the complete and with the incomplete sky; empty where it does not say.
    """

    key: str
    what: str
    kind: Kind = "number"
    paper: str = ""
    incomplete: str = ""


GROUPS: dict[str, tuple[KeyNumber, ...]] = {
    "Coefficients": (
        KeyNumber("posterior_std_median", "median posterior std of a coefficient", paper="~4.5e-6"),
        KeyNumber("condition_number", "condition number of the posterior covariance", paper="~3700"),
        KeyNumber("correlation_below_0.1", "pairs correlated by less than 0.1", "percent", "96.5%"),
        KeyNumber("correlation_max_real", "largest correlation, real part", paper="~0.4"),
        KeyNumber("z_update_above_10", "modes updated by more than 10σ", "count", "first hundred or so"),
        KeyNumber("prior_departure", "departure from the model beam over what its prior expects"),
        KeyNumber("prior_departure_log_evidence", "rise of ln evidence with widths as much larger"),
        KeyNumber("fit_rms", "rms error of the model beam's fit"),
    ),
    "Beam on the one-degree grid": (
        KeyNumber("beam_error_below_1e-4", "pixels with an error below 1e-4", "percent", "“generally”"),
        KeyNumber("beam_error_max", "largest error"),
        KeyNumber("beam_error_max_za_deg", "zenith angle of the largest error, degrees"),
        KeyNumber("beam_error_rms", "rms error"),
        KeyNumber("model_error_max", "largest error of the model beam"),
        KeyNumber("beam_std_median", "median posterior std"),
        KeyNumber("beam_z_median", "median |error| in posterior std"),
        KeyNumber("beam_z_max", "largest |error| in posterior std"),
        KeyNumber("beam_update_max", "largest change from the model beam"),
        KeyNumber("beam_peak", "peak, inferred beam"),
        KeyNumber("beam_peak_model", "peak, model beam"),
        KeyNumber("beam_fwhm_ew_deg", "FWHM East-West, inferred beam, degrees"),
        KeyNumber("beam_fwhm_ew_deg_model", "FWHM East-West, model beam, degrees"),
        KeyNumber("beam_fwhm_ns_deg", "FWHM North-South, inferred beam, degrees"),
        KeyNumber("beam_fwhm_ns_deg_model", "FWHM North-South, model beam, degrees"),
        KeyNumber("imag_max", "largest imaginary part", paper="≲1e-5", incomplete="≲1e-3"),
        KeyNumber("negative_fraction", "pixels with a negative real part", "percent", incomplete="some"),
        KeyNumber("negative_beyond_errors", "pixels negative by more than three standard deviations", "percent"),
    ),
    "Held-out visibilities": (
        KeyNumber("ppd_z_std", "std of z, inferred beam", paper="nearly 1"),
        KeyNumber("ppd_z_max", "largest |z|, inferred beam"),
        KeyNumber("ppd_z_std_unperturbed", "std of z, model beam"),
        KeyNumber("ppd_z_max_unperturbed", "largest |z|, model beam", paper="up to 100"),
        KeyNumber("heldout_chi2_predictive", "reduced χ² under the posterior predictive (noise and beam)"),
        KeyNumber("heldout_chi2_noise_only", "the same residuals over the noise alone"),
        KeyNumber("heldout_chi2_unperturbed", "reduced χ² over the noise, model beam"),
        KeyNumber("heldout_chi2_unperturbed_scaled", "reduced χ² over the noise, scaled model beam"),
        KeyNumber("heldout_amplitude_unperturbed", "its scale, fitted to the held-out data"),
        KeyNumber("heldout_explained", "power explained by the inferred beam", "percent"),
        KeyNumber("heldout_explained_unperturbed", "power explained by the model beam", "percent"),
        KeyNumber("heldout_explained_unperturbed_scaled", "power explained by the scaled model beam", "percent"),
        KeyNumber(
            "heldout_explained_unperturbed_complex", "power explained by the model beam, complex scale", "percent"
        ),
        KeyNumber("heldout_rms_jy", "rms residual, inferred beam, Jy"),
        KeyNumber("heldout_rms_jy_unperturbed", "rms residual, model beam, Jy"),
        KeyNumber("heldout_rms_jy_unperturbed_scaled", "rms residual, scaled model beam, Jy"),
        KeyNumber("heldout_rms_jy_unperturbed_complex", "rms residual, model beam with its best complex scale, Jy"),
        KeyNumber("heldout_rms_jy_beyond_basis", "rms of what the basis leaves of the model beam's prediction, Jy"),
        KeyNumber("heldout_rms_jy_noise", "rms that the noise alone would give, Jy"),
        KeyNumber("heldout_rms_jy_data", "rms of the held-out data, which predicting zero leaves, Jy"),
        KeyNumber("heldout_log_density", "log predictive density (natural)"),
        KeyNumber("heldout_n", "visibilities held out", "count"),
    ),
    "Data and run": (
        KeyNumber("n_data", "visibilities used, complex", "count"),
        KeyNumber("n_unique_baselines", "different baseline vectors", "count"),
        KeyNumber("n_modes", "coefficients", "count"),
        KeyNumber("flux_removed", "flux left out of the sky model", "percent", incomplete="~1%"),
        KeyNumber("train_chi2", "reduced χ² of the fitted data at the MAP"),
        KeyNumber("log_evidence", "log evidence (natural)"),
        KeyNumber("wall_s", "seconds of the inference"),
        KeyNumber("ranks", "MPI ranks", "count"),
        KeyNumber("threads_per_rank", "BLAS threads a rank", "count"),
        KeyNumber("peak_rss_mb", "peak memory of a rank, MB"),
    ),
}
PAPER_HEADING = "the paper, 150 MHz"


@dataclass(frozen=True)
class Row:
    """A line of the table: all texts."""

    key: str
    value: str
    what: str
    paper: str


def table(numbers: dict[str, Any], job_name: str) -> dict[str, list[Row]]:
    """Return the lines of the table by group, of those numbers that are there; unknown ones come last.

    Parameters
    ----------
    numbers : dict
        As in ``summary.json``; what is no number is passed over.
    job_name : str
        The paper's results stand beside those of its own two experiments, "paper" and "incomplete sky".
    """
    setup = job_name.replace("_", " ").replace("-", " ").lower()
    groups: dict[str, list[Row]] = {}
    for group, entries in GROUPS.items():
        for entry in entries:
            if _is_number(numbers.get(entry.key)):
                paper = {"paper": entry.paper, "incomplete sky": entry.incomplete}.get(setup, "")
                row = Row(entry.key, format_value(numbers[entry.key], entry.kind), entry.what, paper)
                groups.setdefault(group, []).append(row)
    known = {entry.key for entries in GROUPS.values() for entry in entries} | {"freq_hz"}
    others = [key for key, value in numbers.items() if key not in known and _is_number(value)]
    if others:
        groups["Other"] = [Row(key, format_value(numbers[key]), "", "") for key in others]
    return groups


def _is_number(value: object) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool)


def format_value(value: float, kind: Kind = "number") -> str:
    """Write a number with three significant digits; shares near one with as many as tell them from one.

    >>> format_value(4.942e-6), format_value(19980, "count"), format_value(0.99999927, "percent")
    ('4.94e-6', '19,980', '99.999927%')
    """
    if not math.isfinite(value):
        return str(value)
    if kind == "count":
        return f"{value:,.0f}"
    if kind == "percent":
        return _percent(value)
    size = abs(value)
    if size and not 1e-3 <= size < 1e6:
        mantissa, exponent = f"{value:.2e}".split("e")
        return f"{mantissa}e{int(exponent)}"
    decimals = 0 if size >= 100 or value == 0 else 2 - math.floor(math.log10(size))
    return f"{value:,.{decimals}f}"


def _percent(share: float) -> str:
    """Write a share; near one, two digits of what is missing."""
    missing = abs(1 - share)
    if 0 < missing < 0.01:
        return f"{100 * share:.{min(-math.floor(math.log10(missing)) - 1, 12)}f}%"
    return f"{100 * share:.1f}%" if abs(share) >= 0.1 else f"{100 * share:.3g}%"


def as_text(groups: dict[str, list[Row]]) -> str:
    """Set the table in columns for a terminal."""
    rows = [row for lines in groups.values() for row in lines]
    heading = PAPER_HEADING if any(row.paper for row in rows) else ""
    cells = [(row.key, row.value, row.what, row.paper) for row in rows]
    return text_table([("summary.json key", "value", "what it is", heading), *cells], right=[1])
