"""The loop's parameters beside those of an answer."""

from __future__ import annotations

import re
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from astropy.time import Time
from numpy.polynomial.legendre import Legendre
from numpy.typing import NDArray

from tests.validation.undeclared.setting import LOCATION

FloatArray = NDArray[np.float64]
Found = dict[tuple[str, str], tuple[float, float]]
"""(thing, quantity) -> value and standard deviation."""

SIGMAS = 3.0
ENOUGH = 0.95
SAME_PLACE_DEG = 1.0
ORDERS = {"level": 0, "drift from first to last time": 1, "curvature, ends less middle": 2}
"""Of polynomials with a name of their own."""
HERE, AMONG_STARS = ("East", "North", "Up"), ("RA 0 h, Dec 0", "RA 6 h, Dec 0", "the North pole")
"""Axes about which things are turned."""
NOT_FOUND = 99.0
"""Deviation that stands for a thing that is there and was not found."""


@dataclass(frozen=True)
class Comparison:
    """Deviations in standard deviations, after combinations that no data tell are taken out.

    Attributes
    ----------
    z : ndarray
    of : list of (str, str)
        Thing and quantity of each.
    """

    z: FloatArray
    of: list[tuple[str, str]] = field(default_factory=list)

    @property
    def within(self) -> int:
        """How many are within three sigma."""
        return int(np.sum(np.abs(self.z) <= SIGMAS))

    @property
    def holds(self) -> bool | None:
        """Whether at least 95% are within three sigma; None where nothing could be compared."""
        return None if not len(self.z) else bool(self.within >= ENOUGH * len(self.z))


OF_NIGHTS = ("level", "drift from first to last time")
# What antennas have in common and no data tell: with which sign it is in which quantities of an antenna.
COMMON: dict[str, tuple[dict[str, float], ...]] = {
    "antenna_gains": (
        {"ln amplitude": 1},
        {"phase": 1},
        {"phase, drift from first to last time": 1},
        {"phase, curvature, ends less middle": 1},
        *({f"phase, night {night}: {what}": 1} for night in (1, 2, 3) for what in OF_NIGHTS),
    ),
    "antenna_delays": (
        {"delay": 1},
        {"phase": 1},
        {"delay, drift from first to last time": 1},
        {"phase, drift from first to last time": 1},
    ),
    "antenna_positions": ({"displaced East": 1}, {"displaced North": 1}, {"displaced Up": 1}),
    "antenna_pointing": ({"tilted towards East": 1}, {"tilted towards North": 1}),
    "nonredundant_beams": ({"width East-West": 1}, {"width North-South": 1}),
    # d_e + c with d_n - c*: feeds with equal beams see the same part of an unpolarised sky.
    "leakage": (
        {"feed e leakage, real part": 1, "feed n leakage, real part": -1},
        {"feed e leakage, imaginary part": 1, "feed n leakage, imaginary part": 1},
    ),
}


def compare(effect: dict[str, Any], found_round: dict[str, Any], answer: dict[str, Any]) -> Comparison:
    """Compare an effect of an answer with the round of a loop that names it."""
    kind = effect["kind"]
    truth = {(p["thing"], p["quantity"]): p["value"] for p in effect["parameters"]}
    found = READERS.get(kind, read_plain)(found_round["parameters"], truth, answer)
    keys = [key for key in truth if key in found]
    if _lacks(kind, keys, truth):
        return Comparison(np.array([NOT_FOUND]), [("nothing", kind)])
    if not keys:
        return Comparison(np.zeros(0))
    value, std = np.array([found[key] for key in keys]).T
    difference = value - np.array([truth[key] for key in keys])
    usable = std > 0
    difference, std = difference[usable], std[usable]
    keys = [key for key, good in zip(keys, usable, strict=True) if good]
    for signs in COMMON.get(kind, ()):
        sign = np.array([signs.get(quantity, 0) if thing.startswith("antenna") else 0 for thing, quantity in keys])
        if 2 * np.count_nonzero(sign) > sum(quantity in signs for _, quantity in truth):
            weight = sign / std**2
            difference -= sign * (weight @ difference) / (weight @ sign)
    if kind == "cross_coupling" and any(other["kind"] == "antenna_gains" for other in answer["effects"]):
        # What is added before gains is so many Jy by them, and how large they all are only the beam's prior tells.
        weight = value[usable] / std**2
        difference -= value[usable] * (weight @ difference) / (weight @ value[usable])
    return Comparison(difference / std, keys)


def nearest(effect: dict[str, Any], found: dict[str, Any], answer: dict[str, Any]) -> dict[str, Any]:
    """Return a round with its parameters, or with those of a place that it does not tell from it, if these are nearer.

    An array on a lattice sees some directions alike; where a loop says so, either place is right.
    """
    each = [found]
    for other in found.get("elsewhere") or []:
        things = {one["name"].partition(":")[0] for one in found["parameters"]}
        if len(things) == 1:
            each.append({**found, "parameters": other["parameters"]})
    return min(each, key=lambda one: float(np.abs(compare(effect, one, answer).z).max(initial=0.0)))


def is_flux(quantity: str) -> bool:
    """Whether a quantity is a flux, or the number of one function of a flux that varies."""
    return quantity.split(",")[0] == "flux"


def _lacks(kind: str, keys: list[tuple[str, str]], truth: dict[tuple[str, str], float]) -> bool:
    """Tell whether nothing was found where something is; of missing sources the strongest must be found."""
    if kind == "missing_sources":
        strongest = max((value, thing) for (thing, quantity), value in truth.items() if is_flux(quantity))[1]
        return (strongest, max(q for t, q in truth if t == strongest and is_flux(q))) not in keys
    return bool(truth) and not keys


def averaged(parameters: list[dict[str, Any]]) -> dict[str, tuple[float, float]]:
    """Return every name's mean over channels, weighted, with its standard deviation."""
    by_name: dict[str, list[tuple[float, float]]] = {}
    for p in parameters:
        by_name.setdefault(p["name"], []).append((p["value"], p["std"]))
    out = {}
    for name, pairs in by_name.items():
        value, std = np.array(pairs).T
        if not np.all(std > 0):
            continue
        weight = std**-2.0
        out[name] = float(weight @ value / weight.sum()), float(weight.sum() ** -0.5)
    return out


def read_plain(parameters: list[dict[str, Any]], truth: dict[tuple[str, str], float], answer: dict[str, Any]) -> Found:
    """Read names that are the thing followed by the quantity."""
    found = averaged(parameters)
    keys = {f"{thing} {quantity}": (thing, quantity) for thing, quantity in truth}
    return {keys[name]: value for name, value in found.items() if name in keys}


def read_gains(parameters: list[dict[str, Any]], truth: dict[tuple[str, str], float], answer: dict[str, Any]) -> Found:
    """Read "antenna 3 phase" and the like; of "phase, jump at JD 2459866.12345" the first time after it counts."""
    return read_plain(with_places(parameters, answer), truth, answer)


def with_places(parameters: list[dict[str, Any]], answer: dict[str, Any]) -> list[dict[str, Any]]:
    """Name the first time after a jump where a loop has its JD."""
    times = np.array(answer["times"])

    def place(match: re.Match[str]) -> str:
        return f"jump before time {np.searchsorted(times, float(match[1]))}"

    return [{**p, "name": re.sub(r"jump at JD ([\d.]+)", place, p["name"])} for p in parameters]


def read_baselines(
    parameters: list[dict[str, Any]], truth: dict[tuple[str, str], float], answer: dict[str, Any]
) -> Found:
    """Read "baseline 3-17 real"; where the loop has it the other way round, the second part changes its sign."""
    out: Found = {}
    for name, (value, std) in averaged(parameters).items():
        match = re.fullmatch(r"baseline (\d+)-(\d+) ((?:real|imaginary|ln amplitude|phase).*)", name)
        if match is None:
            continue
        one, two, part = match.groups()
        for first, second, sign in ((one, two, 1), (two, one, -1)):
            key = (f"baseline {first}-{second}", part)
            if key in truth:
                out[key] = (sign * value if part.startswith(("imaginary", "phase")) else value), std
    return out


def read_reflections(
    parameters: list[dict[str, Any]], truth: dict[tuple[str, str], float], answer: dict[str, Any]
) -> Found:
    """Read "antenna 3 reflection at 93.2 ns: amplitude" and so on, of the strongest echo of each antenna."""
    echoes: dict[tuple[str, str], dict[str, tuple[float, float]]] = {}
    for name, pair in averaged(parameters).items():
        match = re.fullmatch(r"(antenna \d+) reflection at (-?[\d.]+) ns: (.*)", name)
        if match is not None:
            echoes.setdefault((match[1], match[2]), {})[match[3]] = pair
    out: Found = {}
    for (thing, _), told in sorted(echoes.items(), key=lambda echo: echo[1].get("amplitude", (0.0,))[0]):
        if {"amplitude", "phase"} <= told.keys():
            (size, size_std), (phase, phase_std) = told["amplitude"], told["phase"]
            along, aside = size_std, size * phase_std
            cos, sin = np.cos(phase), np.sin(phase)
            out[thing, "reflection real"] = float(size * cos), float(np.hypot(cos * along, sin * aside))
            out[thing, "reflection imaginary"] = float(size * sin), float(np.hypot(sin * along, cos * aside))
        if "delay" in told:
            out[thing, "reflection delay"] = told["delay"]
    return out


def read_sources(
    parameters: list[dict[str, Any]], truth: dict[tuple[str, str], float], answer: dict[str, Any]
) -> Found:
    """Read flux and places of sources, and give to each true one the strongest within a degree."""
    places: dict[str, dict[str, tuple[float, float]]] = {}
    for name, pair in averaged(parameters).items():
        match = re.fullmatch(r"(source at .*): (.*)", name)
        if match is not None:
            places.setdefault(match[1], {})[match[2]] = pair
    out: Found = {}
    for told in sorted(places.values(), key=lambda one: max((abs(one[q][0]) for q in one if is_flux(q)), default=0.0)):
        if not {"right ascension", "declination"} <= told.keys():
            continue
        (found_ra, ra_std), (found_dec, _) = told["right ascension"], told["declination"]
        cosine = np.cos(np.deg2rad(found_dec))
        for thing in {thing for thing, _ in truth}:
            true_ra, true_dec = truth[thing, "right ascension"], truth[thing, "declination"]
            apart = np.hypot(((true_ra - found_ra + 180) % 360 - 180) * cosine, true_dec - found_dec)
            if apart < SAME_PLACE_DEG:
                turns = 360 * np.round((true_ra - found_ra) / 360)
                same = {quantity: pair for quantity, pair in told.items() if is_flux(quantity) or "motion" in quantity}
                out |= {(thing, quantity): pair for quantity, pair in same.items()}
                out[thing, "declination"] = told["declination"]
                out[thing, "right ascension"] = found_ra + turns, ra_std
    return out


def read_fluxes(parameters: list[dict[str, Any]], truth: dict[tuple[str, str], float], answer: dict[str, Any]) -> Found:
    """Read "source 17: relative flux error" and how that goes on in time, its spectral index, width or polarisation."""
    heads = {"relative flux error": "relative change of flux", "error of the spectral index": "change of index"}
    shapes = ("width (FWHM)", "major axis (FWHM)", "minor axis (FWHM)", "position angle")
    heads |= {same: same for same in (*shapes, "Q/I", "U/I")}
    heads |= {"offset east": "east of its place", "offset north": "north of its place"}
    either = "|".join(map(re.escape, heads))
    found = averaged(parameters)
    matches = {name: re.fullmatch(rf"(.*): ({either})(.*)", name) for name in found}
    out = {(match[1], heads[match[2]] + match[3]): found[name] for name, match in matches.items() if match is not None}
    for (thing, quantity), (value, std) in out.items():
        if quantity == "position angle":
            turns = np.round((truth.get((thing, quantity), value) - value) / 180)
            out[thing, quantity] = float(value + 180 * turns), std
    return out


def read_clock(parameters: list[dict[str, Any]], truth: dict[tuple[str, str], float], answer: dict[str, Any]) -> Found:
    """Read the one offset, or by how much the clock drifts or jumps."""
    pairs = averaged(with_places(parameters, answer)).items()
    return {("clock", ", ".join(["later", *name.split(", ")[1:]])): pair for name, pair in pairs if "later" in name}


def read_scale(parameters: list[dict[str, Any]], truth: dict[tuple[str, str], float], answer: dict[str, Any]) -> Found:
    """Read by how much baselines are longer."""
    (pair,) = averaged(parameters).values()
    return {("array", "longer"): pair}


def read_turns(parameters: list[dict[str, Any]], truth: dict[tuple[str, str], float], answer: dict[str, Any]) -> Found:
    """Read what is turned about which axes, those here or those among the stars in the middle of the data.

    Few minutes do not tell these, nor whether beams are turned with the sky, which is a matter of their prior.
    """
    found, true_axes = Found(), [quantity for _, quantity in truth]
    named = [(re.search(r"turned.* about (.+)", name), pair) for name, pair in averaged(parameters).items()]
    by_axis = {match[1]: pair for match, pair in named if match}
    for axes, into in ((HERE, AMONG_STARS), (AMONG_STARS, HERE)):
        if all(f"turned about {axis}" in true_axes for axis in into) and all(axis in by_axis for axis in axes):
            turn = _from_stars(answer) if into is HERE else _from_stars(answer).T
            value, std = np.array([by_axis[axis] for axis in axes]).T
            pairs = zip(turn @ value, np.sqrt(turn**2 @ std**2), strict=True)
            by_axis = {axis: (float(one), float(error)) for axis, (one, error) in zip(into, pairs, strict=True)}
            break
    for thing, quantity in truth:
        if quantity.removeprefix("turned about ") in by_axis:
            found[thing, quantity] = by_axis[quantity.removeprefix("turned about ")]
    return found


def _from_stars(answer: dict[str, Any]) -> NDArray[np.float64]:
    """Return the matrix that takes vectors of the equator to East, North and Up in the middle of the data, (3, 3)."""
    middle = Time(np.mean(answer["times"]), format="jd")
    lst, lat = middle.sidereal_time("apparent", LOCATION.lon).rad, LOCATION.lat.rad
    north = [-np.sin(lat) * np.cos(lst), -np.sin(lat) * np.sin(lst), np.cos(lat)]
    up = [np.cos(lat) * np.cos(lst), np.cos(lat) * np.sin(lst), np.sin(lat)]
    return np.array([[-np.sin(lst), np.cos(lst), 0.0], north, up])


def read_lengths(
    parameters: list[dict[str, Any]], truth: dict[tuple[str, str], float], answer: dict[str, Any]
) -> Found:
    """Read over how many seconds the data are means."""
    pairs = [pair for name, pair in averaged(parameters).items() if name.startswith("integrations")]
    return {("integrations", "length"): pairs[0]} if pairs else {}


def read_compression(
    parameters: list[dict[str, Any]], truth: dict[tuple[str, str], float], answer: dict[str, Any]
) -> Found:
    """Read what all antennas have in common, and what each has beyond that, whose errors are taken as independent."""
    told = averaged(parameters)
    common, std = told.get("compression of all antennas", (0.0, 0.0))
    out: Found = {}
    for thing, quantity in truth:
        own, own_std = told.get(f"{thing} compression beyond that", (0.0, 0.0))
        out[thing, quantity] = common + own, float(np.hypot(std, own_std))
    return out


def read_emitter(
    parameters: list[dict[str, Any]], truth: dict[tuple[str, str], float], answer: dict[str, Any]
) -> Found:
    """Read power and azimuth of the strongest emitter."""
    told = averaged(parameters)
    powers = [(value, name) for name, (value, _) in told.items() if name.endswith(": power")]
    if not powers:
        return {}
    name = max(powers)[1].removesuffix(": power")
    azimuth, std = told[f"{name}: azimuth"]
    turns = 360 * round((truth["emitter", "azimuth"] - azimuth) / 360)
    return {("emitter", "power"): told[f"{name}: power"], ("emitter", "azimuth"): (azimuth + turns, std)}


def read_shifts(parameters: list[dict[str, Any]], truth: dict[tuple[str, str], float], answer: dict[str, Any]) -> Found:
    """Read "shift towards East at JD 2459866.12345", or "shift towards East, " with what changes during the night."""
    found = at_times(parameters, answer) | drifting(parameters, answer)
    return {(f"time {time}", name): pair for (name, time), pair in found.items() if name.startswith("shift towards ")}


def read_jitter(parameters: list[dict[str, Any]], truth: dict[tuple[str, str], float], answer: dict[str, Any]) -> Found:
    """Read "antenna 3 phase at JD 2459866.12345"."""
    out: Found = {}
    for (name, time), pair in at_times(parameters, answer).items():
        antenna, number, what = name.split(" ", 2)
        out[f"{antenna} {number}", f"{what} at time {time}"] = pair
    return out


def at_times(parameters: list[dict[str, Any]], answer: dict[str, Any]) -> dict[tuple[str, int], tuple[float, float]]:
    """Return what has a value at each of several times, by its name without that and by the number of the time."""
    times = np.array(answer["times"])
    out: dict[tuple[str, int], tuple[float, float]] = {}
    for name, pair in averaged(parameters).items():
        head, at, jd = name.partition(" at JD ")
        if at:
            out[head, int(np.argmin(np.abs(times - float(jd))))] = pair
    return out


def drifting(parameters: list[dict[str, Any]], answer: dict[str, Any]) -> dict[tuple[str, int], tuple[float, float]]:
    """Return what polynomials over the night add up to at each time, by its name and by the number of the time.

    Of these each goes from one extreme to the other by its number; their errors count as independent.
    """
    times = np.array(answer["times"])
    place = 2 * (times - times[0]) / (times[-1] - times[0]) - 1
    totals: dict[str, FloatArray] = {}
    for name, (value, std) in averaged(parameters).items():
        head, is_function, how = name.partition(", ")
        if is_function:
            named = re.search(r"order (\d+)", how)
            order = int(named[1]) if named else ORDERS[how]
            curve = Legendre.basis(order)(place)
            fine = Legendre.basis(order)(np.linspace(-1, 1, 2001))
            curve = curve / np.ptp(fine) if order else curve
            total = totals.setdefault(head, np.zeros((2, len(times))))
            total += [value * curve, (std * curve) ** 2]
    return {
        (head, time): (value, np.sqrt(variance))
        for head, total in totals.items()
        for time, (value, variance) in enumerate(total.T.tolist())
    }


def read_harmonics(
    parameters: list[dict[str, Any]], truth: dict[tuple[str, str], float], answer: dict[str, Any]
) -> Found:
    """Read "harmonic l=1 m=-1"."""
    return {("sky", name): pair for name, pair in averaged(parameters).items()}


def read_noise(parameters: list[dict[str, Any]], truth: dict[tuple[str, str], float], answer: dict[str, Any]) -> Found:
    """Read one scale for all, or one of all times one of each antenna that differs from others."""
    told = averaged(parameters)
    if set(told) == {"noise scale"}:
        return {("array", "noise scale"): told["noise scale"]}
    overall, common = told.pop("noise scale", (1.0, 0.0))
    out: Found = dict.fromkeys(truth, (overall, common)) if common else {}
    for name, (value, std) in told.items():
        out[name.removesuffix(" noise scale"), "noise scale"] = overall * value, np.hypot(overall * std, value * common)
    return out


READERS: dict[str, Callable[[list[dict[str, Any]], dict[tuple[str, str], float], dict[str, Any]], Found]] = {
    "antenna_gains": read_gains,
    "gain_jitter": read_jitter,
    "cross_coupling": read_baselines,
    "auto_coupling": read_baselines,
    "closure_errors": read_baselines,
    "cable_reflections": read_reflections,
    "missing_sources": read_sources,
    "moving_sources": read_sources,
    "catalogue_flux": read_fluxes,
    "source_positions": read_fluxes,
    "spectral_index": read_fluxes,
    "polarised_sources": read_fluxes,
    "resolved_source": read_fluxes,
    "elongated_source": read_fluxes,
    "timestamp": read_clock,
    "orientation": read_turns,
    "array_scale": read_scale,
    "smearing": read_lengths,
    "ground_emitter": read_emitter,
    "compression": read_compression,
    "ionosphere": read_shifts,
    "diffuse": read_harmonics,
    "noise_level": read_noise,
}
