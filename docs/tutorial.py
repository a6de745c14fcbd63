# %% [markdown]
# # From visibilities to a beam, and to what the model lacks
#
# This is a script with cells; it runs as it is (`python docs/tutorial.py`, less than a minute on one core), and any
# notebook opens it. `mpiexec -n 4 python` with `comm=MPI.COMM_WORLD` in each `Setup` shares the work.

# %%
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
from pyuvdata import UVData

import hydrabeam_mpi as hb

# %% [markdown]
# ## The data
#
# The experiment of Wilensky et al. 2025 (HDBI II), but smaller: 19 antennas, 300 sources, six hours. The array's own
# beam is not quite the model's: its main lobe is 2% wider. With data of your own begin at `UVData.from_file`; beam and
# sky are then a `UVBeam` and a `SkyModel`, or the names of their files.

# %%
place = TemporaryDirectory()
folder = Path(place.name)
beam = {"source": "hera-vivaldi-131MHz"}  # or a UVBeam, or a BeamInterface
sky = {"n_sources": 300}  # or a SkyModel
simulate = {"array": {"hex": [3, 5]}, "n_times": 24, "freqs": [131e6], "nsamples": 0.03}
simulate["perturb"] = {"stretch": [1.02, 1.02], "sidelobe": 0.0}
mock = hb.simulate({"data": {"simulate": simulate}, "beam": beam, "sky": sky, "seed": 4})
mock.uvd.write_uvh5(folder / "data.uvh5")

uvd = UVData.from_file(folder / "data.uvh5")
print(f"{uvd.Ntimes} times, {uvd.Nbls} baselines with autocorrelations, {uvd.freq_array[0] / 1e6:g} MHz")

# %% [markdown]
# ## The posterior
#
# The beam's coefficients have a Gaussian posterior. Every second time is held out to test it.

# %%
choices = {"beam": beam, "sky": sky, "seed": 4}
basis = hb.FourierBessel(n_modes=600, k_max=30, m_max=12)
result = hb.infer(hb.Setup(uvd, basis=basis, holdout={"kind": "times", "every": 2}, **choices))

maps = result.beam.maps
truth = mock.beams[0](*np.deg2rad(np.indices((91, 360)).reshape(2, -1))).reshape(91, 360)
error, model_error = (np.abs(maps[name].real - truth) for name in ("mean", "model"))
rms, model_rms = (np.sqrt(np.mean(one**2)) for one in (error, model_error))
std = maps["std"]
heldout = float(result.heldout["chi2_predictive"][0])
print(f"held-out reduced chi^2: {heldout:.2f}")
print(f"beam: median error {np.median(error):.1e}, median posterior std {np.median(std):.1e}")
print(f"rms error: {rms:.1e}; that of the model beam was {model_rms:.1e}")

# %% [markdown]
# Draws are other beams that the data allow, and `to_uvbeam` is the best one for any other program.

# %%
draws = result.beam.draw(10, seed=1)
print(f"draws (number, channels, modes): {draws.shape}")
print(f"a UVBeam: {result.beam.to_uvbeam().data_array.shape}")

# %% [markdown]
# ## What the model lacks
#
# Antenna 7 is given a gain that is 5% too large, of which nothing is told.

# %%
damaged = uvd.copy()
gain = np.where(np.arange(uvd.telescope.antenna_numbers.max() + 1) == 7, 1.05, 1.0)
damaged.data_array *= (gain[damaged.ant_1_array] * gain[damaged.ant_2_array])[:, np.newaxis, np.newaxis]

looked_for = {"effects": ["antenna_gains", "cross_coupling", "timestamp"]}  # all, if nothing is said
found = hb.close_loop(hb.Setup(damaged, basis=basis, loop=looked_for, **choices))
print(f"verdict: {found.verdict}")
for one in found.rounds:
    print(one["sentence"])

# %% [markdown]
# `found.result` is that of the amended model, and `found.amended` the setup that has the effect in it.

# %%
again = hb.infer(found.amended)
amended_heldout = float(again.heldout["chi2_predictive"][0])
print(f"held-out reduced chi^2 with the effect in the model: {amended_heldout:.2f}")

# %% [markdown]
# ## Corrected data
#
# What the loop found of the instrument is taken out of the data: `gains.calfits` and `corrected.uvh5`, for any other
# program.

# %%
corrected = hb.correct(found, hb.Setup(damaged, basis=basis, **choices))
corrected.write(folder / "corrected")
gain_of_7 = float(np.abs(corrected.gains[0, :, 7]).mean())
print(f"gain of antenna 7: {gain_of_7:.4f}")
print(sorted(path.name for path in (folder / "corrected").glob("*.uvh5")))

# %% [markdown]
# ## Results on disk
#
# `write` makes the folder that `hydrabeam loop` makes, for `hydrabeam report` and for `hb.load`.

# %%
found.write(folder / "result")
loaded = hb.load(folder / "result")
assert loaded.verdict == found.verdict
np.testing.assert_array_equal(loaded.beam.covariance, found.beam.covariance)
place.cleanup()
