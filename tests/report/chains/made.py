"""Chains whose joint posterior is known: a beam that owes a known part of its spread to the flux of one source."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from hydrabeam_mpi.model.bases.fourier_bessel import FourierBessel
from hydrabeam_mpi.sampling.storage.store import ChainStore
from hydrabeam_mpi.sampling.storage.variable import Variable
from tests.sampling.made import write_values

N_MODES = 12
SHARE = 2.0
"""By so much more the beam follows the flux than it moves by itself, along the first function."""


def new_chains(folder: Path, n_chains: int = 4, n_draws: int = 300, rho: float = 0.3) -> ChainStore:
    basis = FourierBessel([(k, m) for k in range(1, 5) for m in (0, -1, 1)])
    variables = (
        Variable("beam", "beam", (2, N_MODES), ("freq", "mode"), {"freq": [1.2e8, 1.3e8]}, "", "power beam"),
        Variable("flux", "catalogue_flux", (3,), ("source",), {"source": ["Fornax A", "B", "C"]}, "Jy", "flux"),
        Variable(
            "noise", "noise_scale", (2,), ("freq",), {"freq": [1.2e8, 1.3e8]}, "1", "variance over what is stated"
        ),
    )
    store = ChainStore.create(folder, {"seed": 1}, variables, n_chains, n_draws, 0, {"basis": basis.describe()})
    rng = np.random.default_rng(3)
    shape = n_chains, n_draws
    white = rng.normal(size=(*shape, N_MODES + 5))
    for t in range(1, n_draws):
        white[:, t] = rho * white[:, t - 1] + np.sqrt(1 - rho**2) * white[:, t]
    flux, beam = white[..., :3], white[..., 3 : 3 + N_MODES]
    beam[..., 0] += SHARE * flux[..., 0]
    beams = 0.1 + 1e-3 * np.stack([beam, beam], axis=2)
    values = {"beam": beams, "flux": 100 + flux, "noise": 1 + 0.1 * white[..., -2:]}
    write_values(store, values, seconds=0.2)
    return store
