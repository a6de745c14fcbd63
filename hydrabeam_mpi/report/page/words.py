"""What a result says, in plain words."""

from __future__ import annotations

import fnmatch
from collections import Counter
from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import Any

from hydrabeam_mpi.inference.predictive_checks import LARGEST_PREDICTIVE
from hydrabeam_mpi.model.bases import BASES, MADE_OF_OTHERS
from hydrabeam_mpi.model.bases.base import LinearBasis
from hydrabeam_mpi.model.sky import REFERENCE_FREQ
from hydrabeam_mpi.report.page.key_numbers import format_value
from hydrabeam_mpi.report.page.result import Channel, Result
from hydrabeam_mpi.words import joined

NEARLY_ONE = 1.1
"""Reduced chi^2 up to which residuals are as large as expected, for words."""
OFTEN = {2: "every second time", 3: "every third time"}
RESTS = ("rest", "with_rest")
"""Kinds of bases that have what a model beam is beyond modes as a function of its own."""


def megahertz(freq: float) -> str:
    """Write a frequency in MHz with as many digits as it needs, four decimals at most."""
    return f"{freq / 1e6:.4f}".rstrip("0").rstrip(".") + " MHz"


def introduction(result: Result) -> str:
    """Tell in one paragraph what was inferred from what."""
    job, channels, numbers = result.provenance.get("job", {}), result.channels, result.numbers
    first = channels[0]
    n_data = sum(channel.numbers.get("n_data", 0) for channel in channels)
    where = f"at {megahertz(first.freq)}"
    if len(channels) > 1:
        where = f"in {len(channels)} channels from {megahertz(first.freq)[:-4]} to {megahertz(channels[-1].freq)}"
    text = f"The power beam that all antennas share (polarisation {result.polarization}), inferred {where}"
    if n_data:
        text += f" from {n_data:,} complex visibilities"
        unique = first.numbers.get("n_unique_baselines")
        text += f" on {unique:,} different baseline vectors" if unique else ""
    origin = _origin(job.get("data", {}), result.provenance.get("sha256", {}))
    text += f", which {origin}. {_basis(first)}{_prior(job, numbers)}{_sky(job)}{_holdout(job)}"
    text += over_frequency_words(numbers)
    if "ranks" in numbers and "wall_s" in numbers:
        ranks = numbers["ranks"]
        text += f" {ranks} rank{'s' if ranks != 1 else ''} took {format_value(numbers['wall_s'])} s for the inference."
    return text


def over_frequency_words(numbers: dict[str, Any]) -> str:
    """Tell how the beams of all channels hang together; empty where they do not."""
    told = numbers.get("over_frequency")
    if not told:
        return ""
    settings = told["settings"]
    if settings["kind"] == "modes":
        how = f"each coefficient is a sum of {told['n_modes']} {settings['modes']} modes along frequency"
    else:
        length = f", length {megahertz(told['length'])}" if "length" in told else ""
        how = f"each coefficient is a Gaussian process over frequency ({settings['kernel']}{length})"
    text = f" Channels hang together: {how}, {told['n_unknowns']:,} unknowns in all"
    if "log_evidence" in told:
        gain = told["log_evidence"] - told["log_evidence_independent"]
        text += f"; ln evidence {gain:+.1f} against independent channels"
    return f"{text}."


def _origin(data: dict[str, Any], read: Iterable[str]) -> str:
    """Say where the data are from; of files that wildcards name, those count that were ``read``."""
    if data.get("simulate"):
        return "were simulated with a known beam"
    files = sum(1 if name in read else len(fnmatch.filter(read, name)) or 1 for name in data.get("files", ()))
    return f"were read from {files} file{'s' if files != 1 else ''}" if files else "were measured"


def _basis(channel: Channel) -> str:
    form, n = "complex" if channel.is_complex else "real", len(channel.arrays["mean"])
    kinds = list(dict.fromkeys(_kinds(channel.basis)))
    beyond = any(kind in RESTS for kind in kinds)
    titles = [BASES.get(kind, LinearBasis).title for kind in kinds if kind not in MADE_OF_OTHERS]
    rest = " and what the model beam has beyond them," if beyond else ""
    return f"The beam is a sum of {n - beyond:,} {joined(titles)} modes{rest} with {form} coefficients"


def _kinds(basis: dict[str, Any]) -> Iterator[str]:
    """Yield the kind of a basis and of all that it is made of."""
    yield str(basis.get("kind", ""))
    for part in basis.get("parts", ()):
        yield from _kinds(part)


def _prior(job: dict[str, Any], numbers: dict[str, Any]) -> str:
    """Tell of the prior that the result has, the widths of which the data may have chosen."""
    prior, source = job.get("prior", {}), job.get("beam", {}).get("source")
    centre = f" is centred on the fit of the model beam ({Path(source).name})" if source else ""
    adapted, file = numbers.get("prior_adapted"), Path(str(prior.get("file")))
    std = "standard deviations that these data chose:" if adapted else "a standard deviation of"
    texts = {
        "fraction": f"; its prior{centre or ' is Gaussian'}, with {std} {_widths(prior | (adapted or {}))}.",
        "flat": "; its prior is flat.",
        "file": f"; its prior{centre or ' is Gaussian'}, with the covariance of {file.name}."
        if file.suffix
        else f"; its prior is the result {file.name} of other data.",
    }
    return texts.get(prior.get("kind", ""), ".")


def _widths(prior: dict[str, Any]) -> str:
    """Say how wide a prior is whose widths are parts of the model's coefficients."""
    of = "the largest of each coefficient and of those next to it in radial order" if prior.get("neighbours") else ""
    text = f"{100 * prior.get('fraction', 1):.3g}% of {of or 'each coefficient'}"
    if amplitude := prior.get("smooth", {}).get("amplitude"):
        text += f", and beside that {100 * amplitude:.3g}% of the largest of all at the lowest orders, less at others"
    if factors := prior.get("azimuthal"):
        text += f", times {joined([f'{one:.3g}' for one in factors])} at azimuthal orders from 0 on"
    if prior.get("shape"):
        text += "; the beam may also differ from its model as a whole, in amplitude, size, pointing and sidelobes"
    return text


def _sky(job: dict[str, Any]) -> str:
    sky = job.get("sky", {})
    if sky.get("kind") == "catalogue":
        diffuse = " with diffuse emission" if sky.get("diffuse") else ""
        return f" The sky model is the catalogue {Path(str(sky.get('file'))).name}{diffuse}."
    if "n_sources" not in sky:
        return ""
    faintest = sky.get("model_flux_min", 0)
    at = megahertz(sky.get("reference_freq", REFERENCE_FREQ))
    without = f" without those below {faintest:g} Jy at {at}" if faintest else ""
    return f" The sky model is a mock of {sky['n_sources']:,} point sources{without}."


def _holdout(job: dict[str, Any]) -> str:
    holdout = job.get("holdout", {})
    every = holdout.get("every")
    kinds = {
        "times": f"{OFTEN.get(every, f'one time in {every}')} was",
        "lst": "ranges of sidereal time were",
        "jd": "ranges of time were",
        "baselines": "some baselines were",
    }
    held = kinds.get(holdout.get("kind", ""))
    return f" To test it, {held} held out of the inference." if held else ""


def heldout_words(numbers: dict[str, Any]) -> str:
    """Tell what the inferred beam makes of held-out visibilities, before and after; empty where none were held out."""
    after, before = numbers.get("heldout_chi2_noise_only"), numbers.get("heldout_chi2_unperturbed")
    if after is None or before is None:
        return ""
    predictive = numbers.get("heldout_chi2_predictive")
    scaled, n = numbers.get("heldout_chi2_unperturbed_scaled"), numbers.get("heldout_n")
    fitted = "" if scaled is None else f" ({format_value(scaled)} with its amplitude fitted to these very data)"
    text = (
        f"On {f'{n:,.0f} ' if n else ''}held-out visibilities the reduced χ² {'falls' if after < before else 'rises'} "
        f"from {format_value(before)} with the model beam{fitted} to {format_value(after)} with the inferred beam; "
        "noise alone would give 1. "
    )
    if predictive is not None:
        text += (
            f"Under the posterior predictive, in which what the data leave uncertain of the beam counts beside the "
            f"noise, it is {format_value(predictive)}; a posterior that is right gives 1. "
        )
    sentences = {
        "The residual's rms changes from {} to {} Jy, of {} Jy in the data. ": (
            "heldout_rms_jy_unperturbed",
            "heldout_rms_jy",
            "heldout_rms_jy_data",
        ),
        "The standard deviation of z (its largest value) is {} ({}) before and {} ({}) after. ": (
            "ppd_z_std_unperturbed",
            "ppd_z_max_unperturbed",
            "ppd_z_std",
            "ppd_z_max",
        ),
    }
    for sentence, keys in sentences.items():
        if all(key in numbers for key in keys):
            text += sentence.format(*(format_value(numbers[key]) for key in keys))
    return text + verdict_words(numbers)


def answer_words(channels: list[Channel]) -> str:
    """Answer whether the inferred beam predicts data that it has not seen, a sentence for each outcome."""
    outcomes = Counter(filter(None, (verdict_words(channel.numbers) for channel in channels)))
    if not outcomes:
        return "A beam was inferred; on data that it has not seen it was not tested."
    if len(channels) == 1:
        return next(iter(outcomes))
    return " ".join(f"In {count} of {len(channels)} channels: {words}" for words, count in outcomes.most_common())


def verdict_words(numbers: dict[str, Any]) -> str:
    """Judge the inferred beam by held-out visibilities; empty where none were held out."""
    after, before = numbers.get("heldout_chi2_noise_only"), numbers.get("heldout_chi2_unperturbed")
    if after is None or before is None:
        return ""
    scaled = numbers.get("heldout_chi2_unperturbed_scaled")
    return _verdict(after, before if scaled is None else min(before, scaled), numbers.get("heldout_chi2_predictive"))


def _verdict(after: float, before: float, predictive: float | None) -> str:
    """Judge the point prediction against the model beam's, and what is left against what the posterior expects."""
    if after >= before:
        return "The inferred beam predicts data that it has not seen no better than the model beam does."
    if after < NEARLY_ONE:
        return "The inferred beam predicts data that it has not seen to the noise."
    if predictive is None:
        predictive = after
    if predictive < NEARLY_ONE:
        return "The inferred beam predicts data that it has not seen as well as its standard deviations say."
    if predictive <= LARGEST_PREDICTIVE:
        return "What is left is detectable, but of the order of what the posterior expects."
    return "What is left is far above what the posterior expects: something besides the beam is missing from the model."


def remarks(result: Result) -> list[str]:
    """Return what a reader must not overlook: the run's own warnings, and what the report adds to them."""
    said = list(result.warnings)
    removed = result.numbers.get("flux_removed")
    if removed:
        said.append(
            f"The sky model leaves out {format_value(removed, 'percent')} of the sky's flux. With an incomplete sky "
            "the beam takes up errors that are not its own: imaginary parts and negative power stand in for the "
            "missing sources, and the posterior standard deviation knows nothing of it."
        )
    if not any("heldout_chi2_noise_only" in channel.numbers for channel in result.channels):
        said.append("No data were held out, so nothing here tests the posterior on data that it has not seen.")
    return said
