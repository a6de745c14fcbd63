"""The amended job, written, read and restored, has the state that it was made of."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import tomli_w

from hydrabeam_mpi.config import Job, load_job
from hydrabeam_mpi.config.data import Data
from hydrabeam_mpi.config.effects import Effect as EffectEntry
from hydrabeam_mpi.config.sections import Prior
from hydrabeam_mpi.data.observation import FloatArray
from hydrabeam_mpi.effects.interface.effect import Effect
from hydrabeam_mpi.effects.interface.observing_setup import ObservingSetup
from hydrabeam_mpi.effects.registry import EFFECTS, REWEIGHTINGS, make_effect, make_reweighting
from hydrabeam_mpi.fit.joint import restore
from hydrabeam_mpi.fit.state import Active, Fit, Fitted, Reweighted, Values
from hydrabeam_mpi.inference.mode_widths import PriorWidths
from hydrabeam_mpi.loop.output.amendment import amended_job
from hydrabeam_mpi.random import generator
from tests.effects.cases import set_up
from tests.effects.small import small_setup

JOB = Job(data=Data(files=("/nowhere/data.uvh5",)))
LONG = small_setup(freqs=(140e6, 141e6, 142e6, 143e6), n_times=2)


def written_and_read(job: Job, folder: Path) -> Job:
    """As `hydrabeam loop` writes ``amended.toml`` and `hydrabeam infer` reads it."""
    (folder / "amended.toml").write_text(tomli_w.dumps(job.model_dump(mode="json", exclude_none=True)))
    return load_job(folder / "amended.toml")


def fitted(*effects: Effect, setup: ObservingSetup, reweighted: tuple[Reweighted, ...] = ()) -> Fitted:
    """Effects, as `one_fitted` gives them."""
    active, std = zip(*(one_fitted(effect, setup) for effect in effects), strict=True) if effects else ((), ())
    return Fitted(Values(active, reweighted), Fit(std=std))


def one_fitted(effect: Effect, setup: ObservingSetup) -> tuple[Active, FloatArray]:
    """The effect with every other element in use, at values and with errors that no short number has."""
    parameters = effect.parameters(setup)
    n, n_freqs = len(parameters), setup.observation.Nfreqs
    rng = generator(1, "amended", effect.kind)
    prior_var = np.where(parameters.element % 2 == 0, (0.3 * parameters.scale) ** 2, 0.0)
    start = Active.start(effect, setup, prior_var, np.zeros(n))
    used = np.isin(np.arange(n), start.used)
    x = np.where(used, parameters.scale * rng.standard_normal((1 if effect.shared else n_freqs, n)), 0.0)
    std = np.where(used, parameters.scale * rng.uniform(0.01, 0.1, (n_freqs, n)), 0.0)
    return replace(start, x=np.broadcast_to(x, (n_freqs, n))), std


@pytest.mark.parametrize("kind", EFFECTS)
def test_every_effect_comes_back(kind: str, tmp_path: Path) -> None:
    effect, block, _ = set_up(kind)
    made = fitted(effect, setup=block.setup)
    (one,), (std,) = made.values.active, made.fit.std
    assert len(one.used) > 0
    job = written_and_read(amended_job(JOB, made, block.setup), tmp_path)
    (entry,) = job.effects
    names = effect.parameters(block.setup).names
    assert entry.names == tuple(names[i] for i in one.used)
    np.testing.assert_array_equal(entry.std, std[:, one.used])
    (again,) = restore(job, block.setup).active
    assert again.kind == kind
    assert again.effect.describe() == effect.describe()
    np.testing.assert_array_equal(again.x, one.x)
    np.testing.assert_array_equal(again.used, one.used)
    np.testing.assert_allclose(again.prior.of(0).std(), one.prior.of(0).std(), rtol=1e-15)
    np.testing.assert_array_equal(again.step_limit, one.step_limit)
    np.testing.assert_array_equal(again.degenerate_directions, one.degenerate_directions)


@pytest.mark.parametrize("n_parameters", ["fewest", "most"])
@pytest.mark.parametrize("kind", REWEIGHTINGS)
def test_every_reweighting_comes_back(kind: str, n_parameters: str, tmp_path: Path) -> None:
    change = make_reweighting(kind, {})
    size = (min if n_parameters == "fewest" else max)(change.sizes(LONG))
    x = generator(2, kind).uniform(0.5, 2.0, (4, size))
    made = fitted(setup=LONG, reweighted=(Reweighted(change, x, 0.1 * x),))
    (again,) = restore(written_and_read(amended_job(JOB, made, LONG), tmp_path), LONG).reweighted
    assert again.change.kind == kind
    np.testing.assert_array_equal(again.x, x)
    np.testing.assert_array_equal(again.std, 0.1 * x)


def test_several_keep_their_order_and_the_rest_of_the_job_stays(tmp_path: Path) -> None:
    """Two of a kind are two, and weights come after effects."""
    effects = [make_effect(kind, {}) for kind in ("antenna_gains", "timestamp", "antenna_gains")]
    scales = Reweighted(make_reweighting("noise_level", {}), np.full((4, 1), 1.5), np.full((4, 1), 0.1))
    made = fitted(*effects, setup=LONG, reweighted=(scales,))
    amended = amended_job(JOB, made, LONG)
    assert [entry.kind for entry in amended.effects] == ["antenna_gains", "timestamp", "antenna_gains", "noise_level"]
    assert amended.model_copy(update={"effects": ()}) == JOB
    assert [one.kind for one in restore(written_and_read(amended, tmp_path), LONG).active] == [
        one.kind for one in effects
    ]
    # What the loop adds to a job that had effects takes their place: the fit has them.
    assert amended_job(amended, Fitted(), LONG).effects == ()


def test_a_fit_without_anything_leaves_the_job_as_it_is() -> None:
    assert amended_job(JOB, Fitted(), LONG) == JOB


@pytest.mark.parametrize("shape", [None, True, False])
@pytest.mark.parametrize("widths", [None, PriorWidths(0.25)])
def test_widths_are_those_of_the_fit_and_are_not_looked_for_again(
    widths: PriorWidths | None, shape: bool | None, tmp_path: Path
) -> None:
    """Also where the job leaves them to the data: with these beams may differ as a whole unless it says otherwise."""
    job = JOB.model_copy(update={"prior": Prior(widths="evidence", shape=shape)})
    amended = written_and_read(amended_job(job, Fitted(Values(prior_widths=widths)), LONG), tmp_path).prior
    assert (amended.widths, amended.has_shape) == ("stated", shape is not False)
    assert amended.fraction == (0.25 if widths else job.prior.fraction)


def test_a_baseline_may_be_named_the_other_way_round() -> None:
    """As earlier versions had those whose redundant group has them so: its number is the conjugate then."""
    setup = LONG
    one, two = setup.observation.antpairs[5].tolist()
    found = []
    for first, second, imaginary in ((one, two, 0.4), (two, one, -0.4)):
        names = tuple(f"baseline {first}-{second} {part}" for part in ("real", "imaginary"))
        entry = EffectEntry(
            kind="cross_coupling",
            settings={"baselines": [[first, second]]},
            names=names,
            index=(0, 1),
            values=((0.3, imaginary),) * 4,
            prior_std=(1.0, 1.0),
        )
        (active,) = restore(JOB.model_copy(update={"effects": (entry,)}), setup).active
        found.append(active.x)
    np.testing.assert_array_equal(found[0], [[0.3, 0.4]] * 4)
    np.testing.assert_array_equal(found[1], found[0])
