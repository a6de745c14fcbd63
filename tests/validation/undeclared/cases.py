"""All that may be wrong, with the range of strengths from which it is drawn: from unnoticeable to gross."""

from __future__ import annotations

from functools import partial

from tests.validation.undeclared import (
    absorbed,
    beam_errors,
    closure,
    conventions,
    coupling,
    faults,
    gains,
    geometry,
    in_time,
    nights,
    noise,
    polarisation,
    skies,
    strange,
    unknown,
)
from tests.validation.undeclared.answer import Kind
from tests.validation.undeclared.setting import Plan

BAND = Plan(n_freqs=8)
FINE = Plan(n_times=40, cadence=180.0)
WIDE = Plan(wide=True)
CLOSE = Plan(spacing=4.0)
FEW = Plan(rows=(2, 3, 2), cadence=300.0)
SHORT = Plan(rows=(2, 3, 2), cadence=150.0)
SMALL = Plan(rows=(2, 3, 2), cadence=300.0, spacing=4.0)
BANDS = Plan(rows=(2, 3, 2), cadence=150.0, n_freqs=4, bandwidth=30e6)
SELF = Plan(radiometer=True)
NIGHTS = Plan(n_times=36, nights=3)
DELAYS = "antenna_delays"

NULLS = {"null": Plan(), "null_of_band": BAND}
"""Data with nothing wrong in them: of one channel, and of several whose beams are off alike."""

EFFECTS = {
    kind.name: kind
    for kind in (
        Kind("antenna_gains", gains.antenna_gains, 3e-4, 0.3, ""),
        Kind("antenna_delays", gains.antenna_delays, 2e-4, 1.0, "ns", BAND),
        Kind("cable_reflections", gains.cable_reflections, 3e-4, 0.1, "", BAND),
        Kind("cross_coupling", coupling.cross_coupling, 0.03, 10.0, "Jy", FINE),
        Kind("auto_coupling", coupling.auto_coupling, 1e-3, 0.1, "", FINE),
        Kind("closure_errors", closure.closure_errors, 3e-3, 0.3, ""),
        Kind("compression", strange.compression, 0.003, 0.1, ""),
        Kind("saturation", strange.saturating_receivers, 0.003, 0.3, "", FINE),
        Kind("ground_emitter", coupling.ground_emitter, 0.01, 3.0, "Jy", FINE),
        Kind("mutual_coupling", coupling.mutual_coupling, 1e-4, 0.03, ""),
        Kind("missing_sources", skies.missing_sources, 0.015, 10.0, "Jy"),
        Kind("faint_sources", skies.faint_sources, 0.1, 10.0, "Jy"),
        Kind("moving_sources", skies.moving_sources, 0.015, 10.0, "Jy", FINE),
        Kind("catalogue_flux", skies.catalogue_flux, 3e-3, 0.5, ""),
        Kind("polarised_sources", skies.polarised_sources, 0.01, 0.5, ""),
        Kind("source_positions", skies.source_positions, 0.1, 20.0, "arcmin"),
        Kind("spectral_index", skies.spectral_index, 0.03, 1.0, "", BAND),
        Kind("resolved_source", skies.resolved_source, 3.0, 90.0, "arcmin"),
        Kind("elongated_source", skies.elongated_source, 5.0, 90.0, "arcmin"),
        Kind("diffuse", skies.diffuse, 0.005, 10.0, "kJy/sr", CLOSE),
        Kind("antenna_positions", geometry.antenna_positions, 2e-4, 0.2, "m"),
        Kind("timestamp", geometry.timestamp, 0.04, 30.0, "s", FINE),
        Kind("orientation", geometry.orientation, 0.01, 20.0, "arcmin"),
        Kind("array_scale", geometry.array_scale, 0.001, 3.0, "%"),
        Kind("smearing", geometry.smearing, 3.0, 180.0, "s", FINE),
        Kind("antenna_pointing", beam_errors.antenna_pointing, 0.02, 3.0, "deg"),
        Kind("nonredundant_beams", beam_errors.nonredundant_beams, 1e-3, 0.1, ""),
        Kind("basis_truncation", beam_errors.basis_truncation, 1.5e-3, 0.1, ""),
        Kind("ionosphere", skies.ionosphere, 0.02, 10.0, "arcmin", BAND),
        Kind("leakage", polarisation.leakage, 4e-4, 0.1, ""),
        Kind("outliers", noise.outliers, 2.0, 100.0, "sigma"),
        Kind("noise_level", noise.noise_level, 0.02, 2.0, ""),
        Kind("horizon", skies.horizon, 0.3, 10.0, "deg", WIDE),
        Kind("gain_jitter", in_time.gain_jitter, 3e-3, 0.1, ""),
    )
}
"""Effects that the loop knows."""

SMOOTH, NIGHTLY = "smooth", "nightly"
STRONG = {
    kind.name: kind
    for kind in (
        Kind("flux_at_transit", absorbed.flux_at_transit, 0.05, 0.5, "", FEW, "catalogue_flux"),
        Kind("clock_of_few", geometry.timestamp, 3.0, 30.0, "s", SHORT, "timestamp"),
        Kind("walking_refraction", absorbed.walking_refraction, 0.3, 5.0, "arcmin", BANDS, "ionosphere", SMOOTH),
        Kind("phase_gradient", skies.phase_gradient, 0.3, 10.0, "arcmin", BAND, "ionosphere"),
        Kind("diffuse_of_few", skies.diffuse, 0.5, 20.0, "kJy/sr", SMALL, "diffuse"),
        Kind("one_gain", partial(gains.antenna_gains, counts=(1,)), 3e-3, 0.3, "", effect="antenna_gains"),
        Kind("centred_delays", partial(gains.antenna_delays, counts=(2,), centred=True), 0.01, 3.0, "ns", BAND, DELAYS),
        Kind("decorrelation", closure.decorrelation, 0.01, 0.3, "", effect="closure_errors"),
        Kind("compressed_alike", partial(strange.compression, alike=True), 3e-3, 0.1, "", effect="compression"),
        Kind("two_couplings", partial(coupling.cross_coupling, counts=(2,)), 0.3, 10.0, "Jy", effect="cross_coupling"),
    )
}
"""Effects that it knows, strong, of a single thing, or such that a beam can take up most of them."""

ONE_GAIN = partial(in_time.drifting_gains, counts=(1,))
GAINS, COUPLING, MISSING = "antenna_gains", "cross_coupling", "missing_sources"
IN_TIME = {
    kind.name: kind
    for kind in (
        Kind("water_vapour", strange.water_vapour, 0.003, 0.3, "", effect="gain_jitter"),
        Kind("drifting_gain", ONE_GAIN, 1e-3, 0.1, "", effect=GAINS, law=SMOOTH),
        Kind("drifting_gains", in_time.drifting_gains, 1e-3, 0.1, "", effect=GAINS, law=SMOOTH),
        Kind("gain_jump", in_time.gain_jump, 0.003, 0.3, "", effect=GAINS, law="piecewise"),
        Kind("ambient_temperature", strange.ambient_temperature, 0.003, 0.1, "", effect=GAINS, law=SMOOTH),
        Kind("drifting_coupling", in_time.drifting_coupling, 0.1, 10.0, "Jy", FINE, COUPLING, SMOOTH),
        Kind("drifting_delays", in_time.drifting_delays, 0.01, 3.0, "ns", BAND, DELAYS, SMOOTH),
        Kind("drifting_clock", in_time.drifting_clock, 0.2, 60.0, "s", FINE, "timestamp", SMOOTH),
        Kind("clock_jump", in_time.clock_jump, 0.1, 30.0, "s", FINE, "timestamp", "piecewise"),
        Kind("drifting_pointing", in_time.drifting_pointing, 0.05, 3.0, "deg", effect="antenna_pointing", law=SMOOTH),
        Kind("fading_source", in_time.fading_source, 0.01, 0.5, "", effect="catalogue_flux", law=SMOOTH),
        Kind("fading_missing_source", in_time.fading_missing_source, 0.1, 10.0, "Jy", effect=MISSING, law=SMOOTH),
        Kind("sidereal_gains", nights.sidereal_gains, 1e-3, 0.1, "", NIGHTS, GAINS, "sidereal"),
        Kind("nightly_gains", nights.nightly_gains, 1e-3, 0.1, "", NIGHTS, GAINS, NIGHTLY),
        Kind("levels_of_nights", nights.levels_of_nights, 1e-3, 0.1, "", NIGHTS, GAINS, NIGHTLY),
        Kind("nightly_coupling", nights.nightly_coupling, 0.1, 10.0, "Jy", NIGHTS, COUPLING, NIGHTLY),
    )
}
"""Effects that it knows and that change during the night."""

FAULTS = {
    kind.name: kind
    for kind in (
        Kind("wrong_scale", faults.wrong_scale, 1e-4, 0.2, "", SELF),
        Kind("dead_antennas", faults.dead_antennas, 1.0, 1.0, "", SELF),
        Kind("bad_integrations", faults.bad_integrations, 3.0, 300.0, "sigma"),
    )
}
"""Data that are not to be fitted as they are."""

CONVENTIONS = {
    f"convention: {name}": Kind(f"convention: {name}", apply, 1.0, 1.0, "")
    for name, apply in {
        "conjugated": conventions.conjugated,
        "halved": conventions.halved,
        "doubled": conventions.doubled,
        "north and east exchanged": conventions.north_and_east_exchanged,
        "times in TAI": conventions.times_in_tai,
        "antennas sorted by name": conventions.antennas_sorted_by_name,
    }.items()
}
"""Mistakes of the file."""

UNKNOWN = {
    kind.name: kind
    for kind in (
        Kind("drifting_beam", unknown.drifting_beam, 0.003, 0.1, ""),
        Kind("drifting_noise", unknown.drifting_noise, 0.1, 3.0, ""),
        Kind("moving_source", unknown.moving_source, 0.1, 30.0, "Jy", Plan(n_times=40, cadence=60.0)),
        Kind("wandering_source", unknown.wandering_source, 0.3, 30.0, "arcmin", BAND),
        Kind("correlated_noise", unknown.correlated_noise, 0.5, 30.0, "sigma"),
        Kind("turning_antenna", strange.turning_antenna, 0.003, 0.2, ""),
        Kind("jitter", strange.jitter, 0.01, 0.3, ""),
        Kind("board_stops_wrong_fringes", strange.board_stops_wrong_fringes, 0.003, 1.0, ""),
        Kind("board_drops_packets", strange.board_drops_packets, 0.01, 0.5, ""),
        Kind("cables_swapped", strange.cables_swapped, 1.0, 1.0, ""),
        Kind("wandering_oscillator", strange.wandering_oscillator, 0.1, 10.0, "Jy", FINE),
    )
}
"""Effects that it does not know."""

ALL = EFFECTS | STRONG | IN_TIME | FAULTS | CONVENTIONS | UNKNOWN

PAIRS = (
    ("antenna_gains", "missing_sources"),
    ("antenna_gains", "cross_coupling"),
    ("antenna_delays", "catalogue_flux"),
    ("antenna_positions", "catalogue_flux"),
    ("cable_reflections", "missing_sources"),
    ("timestamp", "antenna_gains"),
    ("cross_coupling", "missing_sources"),
    ("antenna_pointing", "missing_sources"),
    ("nonredundant_beams", "antenna_gains"),
    ("outliers", "antenna_gains"),
    ("noise_level", "missing_sources"),
    ("mutual_coupling", "antenna_gains"),
    ("ionosphere", "antenna_gains"),
    ("basis_truncation", "antenna_gains"),
    ("flux_at_transit", "one_gain"),
    ("two_couplings", "missing_sources"),
    ("clock_of_few", "one_gain"),
    ("clock_of_few", "missing_sources"),
    ("flux_at_transit", "two_couplings"),
    ("walking_refraction", "one_gain"),
    ("one_gain", "missing_sources"),
    ("diffuse_of_few", "two_couplings"),
    ("wrong_scale", "one_gain"),
    ("dead_antennas", "missing_sources"),
    ("bad_integrations", "one_gain"),
)
"""Effects that are drawn together."""

TRIPLES = (
    ("one_gain", "two_couplings", "missing_sources"),
    ("clock_of_few", "one_gain", "missing_sources"),
    ("flux_at_transit", "antenna_positions", "two_couplings"),
    ("wrong_scale", "one_gain", "missing_sources"),
    ("antenna_positions", "missing_sources", "outliers"),
    ("bad_integrations", "two_couplings", "one_gain"),
)
"""And three at once."""


def merged(plans: list[Plan]) -> Plan:
    """Return a plan that serves all of some effects."""
    first = Plan()
    out = {}
    for name in Plan.__dataclass_fields__:
        values = [getattr(plan, name) for plan in plans if getattr(plan, name) != getattr(first, name)]
        out[name] = values[0] if values else getattr(first, name)
    return Plan(**out)
