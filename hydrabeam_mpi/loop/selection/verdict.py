"""How a loop ended: whether its last fit explains the data, and why it does not."""

from __future__ import annotations

from hydrabeam_mpi.loop.selection.acceptance import Checked, Round

LEFT_OUT = "the data that carry something unknown are left out, and of all others nothing significant is left"
"""Why data stay unexplained of which some are left out that carry something unknown."""


def why_unexplained(last: Checked, control: Round | None, n_given: int) -> str | None:
    """Say why the last fit does not explain the data; None where it does.

    The first ``n_given`` changes of the weights are those of the job itself, which knows what it leaves out.
    """
    now = last.numbers.of_all
    rms = f"the held-out residual has {now['rms']:.4g} Jy rms"
    if last.remains.stands_out:
        return (
            f"predictions are calibrated as a whole (predictive chi^2 {last.score.chi2:.4g}), but what is left is not "
            f"noise alone: it stands out in {last.remains.stands_out}"
        )
    if not last.remains.consistent:
        return (
            f"predictions are not calibrated: what is left is more than they expect (predictive chi^2 "
            f"{last.score.chi2:.4g}), and {rms} where the noise has {now['rms_noise']:.4g} Jy"
        )
    if not last.at_noise:
        return (
            f"predictions are calibrated, but only as they are wide: {rms}, where the noise has "
            f"{now['rms_noise']:.4g} Jy and, with what the data leave uncertain of the model, "
            f"{now['rms_expected']:.4g} Jy are expected"
        )
    if control is not None:
        return f"{control.candidate.title} would explain more than any effect"
    if any(one.change.is_of_unknown for one in last.fitted.values.reweighted[n_given:]):
        return LEFT_OUT
    return None


def verdict_of(why: str | None, added: bool) -> str:
    """Say how a loop ended, by `why_unexplained` and by whether it claims that anything was ``added``."""
    if why is not None:
        return "unexplained"
    return "explained" if added else "consistent"
