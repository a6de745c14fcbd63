"""All that may be wrong, with the range of strengths from which it is drawn: from unnoticeable to gross."""

from __future__ import annotations

from tests.validation.undeclared import (
    beam_errors,
    conventions,
    coupling,
    gains,
    geometry,
    noise,
    polarisation,
    skies,
    unknown,
)
from tests.validation.undeclared.answer import Kind
from tests.validation.undeclared.setting import Plan

BAND = Plan(n_freqs=8)
FINE = Plan(n_times=40, cadence=180.0)
WIDE = Plan(wide=True)
CLOSE = Plan(spacing=4.0)

EFFECTS = {
    kind.name: kind
    for kind in (
        Kind("antenna_gains", gains.antenna_gains, 3e-4, 0.3, ""),
        Kind("antenna_delays", gains.antenna_delays, 2e-4, 1.0, "ns", BAND),
        Kind("cable_reflections", gains.cable_reflections, 3e-4, 0.1, "", BAND),
        Kind("cross_coupling", coupling.cross_coupling, 0.03, 10.0, "Jy", FINE),
        Kind("auto_coupling", coupling.auto_coupling, 1e-3, 0.1, "", FINE),
        Kind("mutual_coupling", coupling.mutual_coupling, 1e-4, 0.03, ""),
        Kind("missing_sources", skies.missing_sources, 0.015, 10.0, "Jy"),
        Kind("catalogue_flux", skies.catalogue_flux, 3e-3, 0.5, ""),
        Kind("diffuse", skies.diffuse, 0.005, 10.0, "kJy/sr", CLOSE),
        Kind("antenna_positions", geometry.antenna_positions, 2e-4, 0.2, "m"),
        Kind("timestamp", geometry.timestamp, 0.04, 30.0, "s", FINE),
        Kind("antenna_pointing", beam_errors.antenna_pointing, 0.02, 3.0, "deg"),
        Kind("nonredundant_beams", beam_errors.nonredundant_beams, 1e-3, 0.1, ""),
        Kind("basis_truncation", beam_errors.basis_truncation, 1.5e-3, 0.1, ""),
        Kind("ionosphere", skies.ionosphere, 0.02, 10.0, "arcmin", BAND),
        Kind("leakage", polarisation.leakage, 4e-4, 0.1, ""),
        Kind("outliers", noise.outliers, 2.0, 100.0, "sigma"),
        Kind("noise_level", noise.noise_level, 0.02, 2.0, ""),
        Kind("horizon", skies.horizon, 0.3, 10.0, "deg", WIDE),
    )
}
"""Effects that the loop knows."""

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
        Kind("decorrelation", unknown.decorrelation, 0.01, 0.3, ""),
        Kind("drifting_noise", unknown.drifting_noise, 0.1, 3.0, ""),
        Kind("moving_source", unknown.moving_source, 0.1, 30.0, "Jy", Plan(n_times=40, cadence=60.0)),
        Kind("wandering_source", unknown.wandering_source, 0.3, 30.0, "arcmin", BAND),
        Kind("gain_jump", unknown.gain_jump, 0.003, 0.3, ""),
        Kind("correlated_noise", unknown.correlated_noise, 0.5, 30.0, "sigma"),
    )
}
"""Effects that it does not know."""

ALL = EFFECTS | CONVENTIONS | UNKNOWN

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
)
"""Effects that are drawn together."""


def merged(plans: list[Plan]) -> Plan:
    """Return a plan that serves all of some effects."""
    first = Plan()
    out = {}
    for name in Plan.__dataclass_fields__:
        values = [getattr(plan, name) for plan in plans if getattr(plan, name) != getattr(first, name)]
        out[name] = values[0] if values else getattr(first, name)
    return Plan(**out)
