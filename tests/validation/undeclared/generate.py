"""Data with an undeclared effect: `generate`."""

from __future__ import annotations

import json
import zlib
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np

from tests.validation.undeclared.answer import Drawn, Kind
from tests.validation.undeclared.basis import BASES
from tests.validation.undeclared.beams import drawn_shape
from tests.validation.undeclared.cases import ALL, EFFECTS, NULLS, UNKNOWN, merged
from tests.validation.undeclared.detect import chi2_beyond_beam, numbers_of_unknown, shows
from tests.validation.undeclared.files import CHANNEL_WIDTH, INTEGRATION, write_all
from tests.validation.undeclared.polarisation import polarised
from tests.validation.undeclared.setting import Plan, Setting, draw_setting
from tests.validation.undeclared.simulator import correlations, corrupted, on_baselines
from tests.validation.undeclared.truth import ComplexArray, Truth

GIVEN, SEALED = "given", "sealed"

MOST_BEYOND_BASIS = 5.0
"""chi^2 of what the job's basis lacks of the beam, over all data, of which half are fitted: data without an effect must
have none, and of 20 a loop can tell something, at log Bayes factors of 5 to 8."""
RECEIVERS = ("antenna_gains", "antenna_delays", "cable_reflections")


def stream(seed: int, what: str) -> np.random.Generator:
    """Return random numbers of their own for each purpose."""
    return np.random.default_rng([seed, zlib.crc32(what.encode())])


@dataclass(frozen=True)
class Made:
    """What was made up: the truth, and each effect with its strength."""

    truth: Truth
    effects: list[tuple[Kind, float, Drawn]]


def make(seed: int, kinds: list[Kind], present: list[Kind], basis: str = "study", plan: Plan | None = None) -> Made:
    """Draw an experiment that serves ``kinds``, or a ``plan`` of no kind, with those that are ``present`` in it."""
    plan = plan or merged([kind.plan for kind in kinds])
    setting = draw_setting(stream(seed, "setting"), plan, BASES[basis])
    truth = Truth.of(setting, drawn_shape(stream(seed, "beam"), setting.model_shape))
    effects = []
    # What receivers and cables do comes after all else, and multiplies that, too.
    for kind in sorted(present, key=lambda one: one.is_called in RECEIVERS):
        rng = stream(seed, kind.name)
        # Several at once are drawn strong enough to be seen, mostly.
        low, high = np.log(kind.weakest), np.log(kind.strongest)
        strength = float(np.exp(rng.uniform(low if len(kinds) == 1 else 0.5 * (low + high), high)))
        effects.append((kind, strength, kind.apply(truth, rng, strength)))
    return Made(truth, sorted(effects, key=lambda one: present.index(one[0])))


def generate(seed: int, folder: Path, case: str | None = None, basis: str = "study") -> None:
    """Write data, catalogue, beam and job to ``folder/given``, and what is wrong to ``folder/sealed/answer.json``.

    Parameters
    ----------
    seed : int
    folder : Path
    case : str, optional
        One of `cases.NULLS`, a name of `cases.ALL`, or some with "+" between them; drawn from the effects that the loop
        knows where it is not given.
    basis : str, optional
        One of `basis.BASES`.
    """
    if case is None:
        case = str(stream(seed, "case").choice(list(EFFECTS)))
    kinds = [] if case in NULLS else [ALL[name] for name in case.split("+")]
    clean = make(seed, kinds, [], basis, NULLS.get(case)).truth
    setting = clean.setting
    reference = correlations(clean)
    sigma = _noise_level(setting, on_baselines(clean, reference))
    made = make(seed, kinds, kinds, basis, NULLS.get(case))
    measured = reference if not kinds else corrupted(made.truth)
    by_pol = {pol: on_baselines(clean, vis) for pol, vis in polarised(made.truth, measured).items()}
    data = {pol: _filed(made.truth, vis, sigma, stream(seed, f"noise {pol}")) for pol, vis in by_pol.items()}
    autos = np.einsum("ftjj->ftj", measured).real
    if setting.radiometer:
        autos = np.full_like(autos, sigma * np.sqrt(CHANNEL_WIDTH * INTEGRATION))
    for change in made.truth.filed_autos:
        autos = change(autos)
    write_all(folder / GIVEN, setting, sigma, data, autos, seed)
    # What is alone has been simulated already.
    alone = [made.truth] if len(kinds) == 1 else [make(seed, kinds, [kind], basis).truth for kind in kinds]
    changed = [measured] if len(kinds) == 1 else [corrupted(truth) for truth in alone]
    effects = [
        _told(one, truth, *_visible(truth, vis, reference, sigma, seed))
        for one, truth, vis in zip(made.effects, alone, changed, strict=True)
    ]
    answer = {
        "case": case,
        "seed": seed,
        "basis": basis,
        "sigma": sigma,
        "times": setting.times.tolist(),
        "freqs": setting.freqs.tolist(),
        "effects": effects,
    }
    (folder / SEALED).mkdir(parents=True, exist_ok=True)
    (folder / SEALED / "answer.json").write_text(json.dumps(answer, indent=1) + "\n")


def _noise_level(setting: Setting, reference: ComplexArray) -> float:
    """Return the noise's standard deviation, Jy: as drawn, or enough to hide what the job's basis lacks of the beam."""
    drawn = float(np.sqrt(np.mean(np.abs(reference) ** 2))) / setting.snr
    beyond = chi2_beyond_beam(setting, reference, drawn)[1]
    return drawn * max(float(np.sqrt(beyond / MOST_BEYOND_BASIS)), 1.0)


def _filed(truth: Truth, vis: ComplexArray, sigma: float, rng: np.random.Generator) -> ComplexArray:
    """Add noise and write down, with whatever goes wrong with either."""
    noise = (rng.standard_normal(vis.shape) + 1j * rng.standard_normal(vis.shape)) / np.sqrt(2)
    for change in truth.noise:
        noise = change(noise, rng)
    data = vis + sigma * noise
    for change_of_all in truth.filed:
        data = change_of_all(data)
    return data


def _told(effect: tuple[Kind, float, Drawn], truth: Truth, total: float, left: float) -> dict[str, Any]:
    """Describe one effect, and whether the data show it when it is alone."""
    kind, strength, drawn = effect
    # Of noise chi^2 is that of its variance already.
    is_unknown = kind.name in UNKNOWN and not truth.noise
    n_params = numbers_of_unknown(truth.setting, drawn.where) if is_unknown else drawn.n_params
    return {
        "kind": kind.is_called,
        "law": kind.law,
        "known": kind.is_called in EFFECTS,
        "strength": strength,
        "strength_unit": kind.unit,
        "parameters": [asdict(parameter) for parameter in drawn.parameters],
        "where": asdict(drawn.where),
        "about": drawn.about,
        "n_params": drawn.n_params,
        "chi2_total": total,
        "chi2_left": left,
        "detectable": shows(left, n_params),
    }


def _visible(truth: Truth, vis: ComplexArray, reference: ComplexArray, sigma: float, seed: int) -> tuple[float, float]:
    """Return chi^2 of what an effect changes of the ``reference``, and of what no beam absorbs of it.

    Of noise it is twice the expected logarithm of the likelihood ratio.
    """
    setting: Setting = truth.setting
    if truth.noise:
        excess = _noise_ratio(truth, stream(seed, "noise ee"))
        return excess, excess
    pols = polarised(truth, vis)
    before = {"ee": reference, "nn": reference, "en": 0 * reference, "ne": 0 * reference}
    total = left = 0.0
    for pol, after in pols.items():
        change = on_baselines(truth, after - before[pol])
        for filed in truth.filed:
            change = filed(on_baselines(truth, after)) - on_baselines(truth, before[pol])
        if pol in ("en", "ne"):
            # The job's beam has no say in these.
            both = 2 * float(np.sum(np.abs(change) ** 2)) / sigma**2, 0.0
            total, left = total + both[0], left + both[0]
            continue
        parts = chi2_beyond_beam(setting, change, sigma)
        total, left = total + parts[0], left + parts[1]
    return total, left


def _noise_ratio(truth: Truth, rng: np.random.Generator) -> float:
    """Return 2 sum (v - 1 - ln v) over all data, with v by how much the variance of each is changed."""
    noise = np.ones(truth.setting.shape, dtype=complex)
    for change in truth.noise:
        noise = change(noise, rng)
    variance = np.maximum(np.abs(noise) ** 2, 0.1)
    return 2 * float(np.sum(variance - 1 - np.log(variance)))
