"""Made-up contents of ``loop.json``: nothing found, two effects found, and something that none explains."""

from __future__ import annotations

from typing import Any

import numpy as np

from hydrabeam_mpi.effects.registry import EFFECTS, REWEIGHTINGS

KINDS = (*EFFECTS, *REWEIGHTINGS)
Entry = dict[str, Any]
ANTENNAS = [0, 1, 2, 11, 12, 13, 23, 24]
FREQ = 150e6


def statistics(level: float, antenna: int = 23, boost: float = 1.0, seed: int = 0) -> Entry:
    """Statistics of residuals with reduced χ² ``level``, and ``boost`` times that where ``antenna`` takes part."""
    rng = np.random.default_rng(seed)

    def listed(what: list[Any], factors: Any = 1.0) -> list[Entry]:
        n = 900
        chi2 = level * np.broadcast_to(factors, len(what)) * rng.normal(1, n**-0.5, len(what))
        rows = zip(what, chi2.tolist(), strict=True)
        return [{"what": w, "chi2": c, "sigma": (c - 1) * n**0.5, "n": n} for w, c in rows]

    pairs = [[one, two] for i, one in enumerate(ANTENNAS) for two in ANTENNAS[i + 1 :]]
    times = [{"jd": 2458098.4 + 0.004 * t, "lst_h": 2.0 + 0.096 * t} for t in range(20)]
    lsts = np.arange(2.25, 4, 0.5)
    swing = 1 + 0.4 * (boost > 1) * np.sin(np.arange(20) / 3)
    axes = {
        "antennas": listed(ANTENNAS, [boost if number == antenna else 1.0 for number in ANTENNAS]),
        "baselines": listed(pairs, [boost if antenna in pair else 1.0 for pair in pairs]),
        "groups": listed(list(range(9))),
        "lengths": listed([14.6, 25.3, 29.2, 38.6, 43.8], np.linspace(0.8, 1.2, 5)),
        "directions": listed([-75.0, -60.0, -30.0, 0.0, 30.0, 60.0]),
        "times": listed(times, swing),
        "lsts": listed(lsts.tolist()),
        "freqs": listed([FREQ]),
        "fringe_rates": listed(np.linspace(-1.4e-3, 1.3e-3, 20).tolist(), 1 + 2 * (boost > 1) * np.eye(20)[12]),
    }
    overall = {"chi2": level, "n": 9000, "sigma": (level - 1) * 9000**0.5}
    worst = max(axes["antennas"], key=lambda entry: entry["sigma"])
    return {
        "overall": overall,
        "axes": axes,
        "entries": {name: len(rows) for name, rows in axes.items()},
        "unevenness": dict.fromkeys(axes, 0.3),
        "redundancy": {"common": overall, "scatter": {"chi2": 0.98, "sigma": -0.4, "n": 4000}},
        "correlations": [{"what": "neighbouring times", "correlation": 1 - 1 / level, "sigma": 7.5, "n": 8500}],
        "tails": {
            "kurtosis": {"excess": 0.01, "sigma": 0.2},
            "largest": {"z": 4.4, "corrected_sigma": -0.6, "freq_hz": FREQ, "jd": 2458098.4, "baseline": [0, 23]},
        },
        "looks": 173,
        "significance": {
            "axis": "antennas", "what": worst["what"], "sigma": worst["sigma"],
            "p": 0.2 if level < 1.1 else 0.0, "log10_p": -0.7 if level < 1.1 else -4321.0, "corrected_sigma": 0.8,
        },
    }  # fmt: skip


def parameter(name: str, value: float, std: float, unit: str = "", freq: float | None = FREQ) -> Entry:
    return {"name": name, "unit": unit, "value": value, "std": std, "freq_hz": freq}


def ranking(best: dict[str, float]) -> list[Entry]:
    """A ranking with these ln Bayes factors; the other effects have some below zero."""
    scores = {kind: best.get(kind, -0.1 * place) for place, kind in enumerate(KINDS)}
    return [
        {"effect": kind, "log_bayes_factor": score, "chi2_drop": max(2 * score, 0.0), "effective_parameters": 3.2,
         "n_parameters": 16, "absorbed_by_beam": 0.1, "rank": 15}
        for kind, score in sorted(scores.items(), key=lambda item: -item[1])
    ]  # fmt: skip


def gains_round() -> Entry:
    rng = np.random.default_rng(1)
    values = {number: rng.normal(0, 1e-3, 2) + 0.041 * (number == 23) for number in ANTENNAS}
    parameters = [
        parameter(f"antenna {number} {what}", float(value), 1.1e-3, unit)
        for number, pair in values.items()
        for what, unit, value in zip(("ln amplitude", "phase"), ("", "rad"), pair, strict=True)
    ]
    return {
        "effect": "antenna_gains",
        "title": "antenna gains",
        "sentence": "Antenna gains: antenna 23 ln amplitude 0.041 +- 0.0011 at 150 MHz; and 15 more (log Bayes factor "
        "8,312; the beam can absorb 2% of it). Added. Held-out reduced chi^2 11.4 -> 2.31.",
        "parameters": parameters,
        "log_bayes_factor": 8312.4,
        "absorbed_by_beam": 0.021,
        "chi2_before": 10.9,
        "chi2_after": 2.25,
        "heldout_before": 11.4,
        "heldout_after": 2.31,
        "heldout_sigma": 57.3,
        "rms_before": 9.1,
        "rms_after": 4.2,
        "runner_up": "antenna_positions",
        "indistinguishable_from": [],
        "beam_change_max": 3.1e-3,
        "n_parameters": 16,
        "effective_parameters": 14.2,
        "prior_scale": 0.04,
        "ranking": ranking({"antenna_gains": 8312.4, "antenna_positions": 5120.0, "missing_sources": 940.0}),
        "residual": statistics(11.4, boost=2.5),
    }


def source_round() -> Entry:
    return {
        "effect": "missing_sources",
        "title": "missing sources",
        "sentence": "Missing sources: source 1 flux 4.20 +- 0.11 Jy.",
        "parameters": [
            parameter("source 1 flux", 4.2, 0.11, "Jy"),
            parameter("source 1 right ascension", 52.31, 0.02, "deg", None),
            parameter("source 1 declination", -28.4, 0.02, "deg", None),
        ],
        "log_bayes_factor": 905.2,
        "absorbed_by_beam": 0.34,
        "chi2_before": 2.25,
        "chi2_after": 0.99,
        "heldout_before": 2.31,
        "heldout_after": 1.03,
        "heldout_sigma": 21.0,
        "runner_up": "catalogue_flux",
        "indistinguishable_from": [{"effect": "catalogue_flux", "law": "smooth"}, {"effect": "diffuse", "law": None}],
        "beam_change_max": 4.4e-4,
        "n_parameters": 3,
        "effective_parameters": 2.9,
        "prior_scale": 4.0,
        "ranking": ranking({"missing_sources": 905.2, "catalogue_flux": 903.0, "diffuse": 901.7}),
        "residual": statistics(2.31, seed=2),
    }


def record(verdict: str, rounds: list[Entry], before: float, after: float) -> Entry:
    return {
        "name": "made up",
        "verdict": verdict,
        "error_before": before,
        "error_after": after,
        "sentence": f"So it ended (held-out reduced chi^2 {before} -> {after}).",
        "said": [*(one["sentence"] for one in rounds), "That is all."],
        "rounds": rounds,
        "last_ranking": ranking({"diffuse": 3.1}),
        "tried": [],
        "skipped": [
            {"effect": "leakage", "reason": "needs cross-polarisations; the files have ee alone"},
            {"effect": "antenna_delays", "reason": "needs several channels; the job has one"},
        ],
        "undecidable": [{"what": "common flux scale", "why": "all fluxes times a number are the same as another beam"}],
        "conventions": {
            "found": None,
            "remedy": None,
            "tested": [
                {"name": "as they are", "chi2": 11.4, "explained": 0.9994},
                {"name": "conjugated", "chi2": 15321.0, "explained": 0.12},
            ],
        },
        "where": None,
        "residual": statistics(after, seed=5),
        "structures": None,
        "seconds": {"prepare": 1.24, "attribution": 12.5},
    }


def consistent() -> Entry:
    return record("consistent", [], 1.01, 1.01)


def explained() -> Entry:
    return record("explained", [gains_round(), source_round()], 11.4, 1.03)


def unexplained() -> Entry:
    loop = record("unexplained", [gains_round()], 11.4, 2.31)
    loop["tried"] = [
        {
            "effect": "diffuse",
            "law": "smooth",
            "log_bayes_factor": 55.1,
            "reason": "held-out chi^2 does not fall: 2.31 to 2.40",
        }
    ]
    loop |= {"rms_zero": 12.1, "rms_model": 10.2, "rms_model_scaled": 9.4, "rms_before": 9.1, "rms_after": 4.2}
    loop |= {"rms_noise": 3.9, "explained_before": 0.434, "explained_after": 0.88, "heldout_channels": []}
    loop |= {"predictive_chi2_before": 11.4, "predictive_chi2_after": 2.31, "noise_only_chi2_before": 11.9}
    loop |= {"noise_only_chi2_after": 2.6, "log_density_before": -91000.0, "log_density_after": -24000.0}
    loop["where"] = where()
    loop["sentence"] += f" {loop['where']['sentence']}"
    loop["structures"] = structures()
    loop["residual"] = statistics(2.31, antenna=11, boost=3.0, seed=7)
    return loop


def where() -> Entry:
    def carrier(what: Any, share: float, **more: Any) -> Entry:
        return {"what": what, "chi2": 7.7, "share": share, "sigma": 44.0} | more

    return {
        "sentence": "It lives in 4 of 20 times (LST 2.29-2.58 h) and on 2 of 8 antennas (11, 24). It is even over "
        "baseline lengths and redundant groups.",
        "antennas": {"state": "concentrated", "of": 8, "count": 2, "sigma": 30.1,
                     "entries": [carrier(11, 0.41), carrier(24, 0.29)]},
        "baselines": {"state": "uneven", "of": 28, "count": 9, "sigma": 12.0,
                      "entries": [carrier([11, pair], 0.08) for pair in (0, 1, 2, 12, 13, 23, 24)]},
        "groups": {"state": "uneven", "of": 9, "count": 4, "sigma": 5.1,
                   "entries": [carrier(3, 0.4, vector_m=[14.6, 0.0, 0.0])]},
        "lengths": {"state": "even", "of": 5, "count": 3, "sigma": 0.4, "entries": []},
        "times": {"state": "concentrated", "of": 20, "count": 4, "sigma": 25.0,
                  "entries": [carrier({"jd": 2458098.41 + 0.004 * t, "lst_h": 2.29 + 0.096 * t}, 0.2)
                              for t in range(4)]},
        "fringe_rates": {"state": "concentrated", "of": 20, "count": 1, "sigma": 9.0,
                         "entries": [carrier(-7.11e-5, 0.7)]},
    }  # fmt: skip


def structures(n_freqs: int = 1) -> Entry:
    """Two structures, over 20 times and some channels."""
    times, freqs = np.arange(20), np.arange(n_freqs)
    phase = times / 4 + freqs[:, np.newaxis] / 3

    def structure(value: float, sigma: float, share: float, envelope: Any) -> Entry:
        pairs = [[11, other] for other in ANTENNAS if other != 11]
        return {
            "singular_value": value,
            "sigma": sigma,
            "share": share,
            "baselines": [{"what": pair, "share": 0.2 / (1 + place)} for place, pair in enumerate(pairs)],
            "antennas": [{"what": 11, "share": 0.5}, {"what": 24, "share": 0.2}, {"what": 0, "share": 0.1}],
            "pattern": {
                "freqs_hz": (FREQ + 1e5 * freqs).tolist(),
                "jds": (2458098.4 + 0.004 * times).tolist(),
                "lsts_h": (2.0 + 0.096 * times).tolist(),
                "real": (envelope * np.cos(phase)).tolist(),
                "imag": (envelope * np.sin(phase)).tolist(),
            },
        }

    return {
        "singular_values": [41.0, 22.0, 10.4, 9.8, 9.3, 8.8, 8.1, 7.7, 7.0, 6.6],
        "edge": {
            "expected_noise": {"mean": 10.6, "std": 0.4},
            "noise_of_this_rms": {"mean": 16.1, "std": 0.6},
        },
        "structures": [
            structure(41.0, 76.0, 0.44, np.exp(-((times - 5) ** 2) / 10)),
            structure(22.0, 28.5, 0.13, 1.0),
        ],
    }
