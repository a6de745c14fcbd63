"""What a user reads who has written a job wrongly: table, key, what is there, what should be."""

from __future__ import annotations

from pathlib import Path

import pytest

from hydrabeam_mpi.config import load_job
from hydrabeam_mpi.effects.registry import KINDS
from hydrabeam_mpi.errors import InputError

DATA = "[data]\nfiles = ['a.uvh5']\n"
SIMULATE = "[data.simulate]\n"
EFFECT = DATA + "[[effects]]\nkind = 'diffuse'\n"
COMPLETE = EFFECT + "names = ['x']\nindex = [0]\nvalues = [[1]]\nprior_std = [1]\n"
TOGETHER = "[[effects]] number 1: names, index, prior_std and every list in values and std go together, one entry a "
INJECTED = "[[data.simulate.effects]]\nkind = 'diffuse'\n"
TABLES = {
    "": "", "data": "", "data.simulate": "", "data.simulate.array": "", "data.simulate.perturb": "", "noise": "",
    "holdout": "", "sky": "", "sky.columns": "[sky]\nkind = 'catalogue'\nfile = 'a.skyh5'\n", "beam": "", "basis": "",
    "prior": "", "prior.frequency": "", "solver": "", "output": "", "loop": "",
}  # fmt: skip


def complaint(text: str, folder: Path) -> str:
    """Return what is said of a job, without its file."""
    path = folder / "job.toml"
    path.write_text(text)
    with pytest.raises(InputError) as raised:
        load_job(path)
    said = str(raised.value)
    assert said.startswith(f"{path}: ")
    assert "\n" not in said
    assert raised.value.field
    assert raised.value.remedy
    return said.removeprefix(f"{path}: ")


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        # Keys and tables that do not exist: the nearest, or where they belong, or all there are.
        (DATA + "polarisation = 'ee'", "[data] polarisation: unknown key; did you mean 'polarization'?"),
        ("[dat]\nfiles = []", "[dat]: unknown key; did you mean 'data'?"),
        (DATA + "[simulate]\nn_times = 3", "[simulate]: unknown key; it belongs in [data.simulate]"),
        (DATA + "n_modes = 3", "[data] n_modes: unknown key; it belongs in [basis]"),
        (DATA + "seed = 3", "[data] seed: unknown key; it belongs in the first lines"),
        (
            DATA + "kind = 'x'",
            "[data] kind: unknown key; it belongs in [[data.simulate.effects]] or [noise] or [holdout] or [sky]"
            " or [basis] or [prior] or [prior.frequency] or [[sample.effects]] or [[effects]]",
        ),
        (
            DATA + "[solver]\nqwertz = 1",
            "[solver] qwertz: unknown key; the keys of [solver] are engine, compress, precision",
        ),
        (DATA + "qwertz = 1\n[sky]\nn_source = 1", "[data] qwertz: unknown key; the keys of [data] are files, "),
        ("[data.simulate.array]\nhxe = [4, 3]", "[data.simulate.array] hxe: unknown key; did you mean 'hex'?"),
        # What is lacking.
        ("", "[data]: is missing; add it; 'hydrabeam init' prints a whole job"),
        ("[data]", "[data]: no data; give either files = [...] or a [data.simulate] table"),
        (DATA + SIMULATE, "[data]: no data; give either files"),
        # Wrong types, told in the words of TOML and not of Python.
        ("data = 3", "[data]: is not a table; it should be keys and values below a line with its name in brackets"),
        (DATA + "[[sky]]\nkind = 'mock'", "[sky]: is not a table"),
        ("[data]\nfiles = 'a.uvh5'", '[data] files: is "a.uvh5"; it should be a list in brackets'),
        ("[data]\nfiles = [1]", "[data] files: is 1; it should be text in quotes"),
        (DATA + "[beam]\nsource = 3", "[beam] source: is 3; it should be text in quotes"),
        (DATA + "[prior]\nfile = 3", "[prior] file: is 3; it should be text in quotes"),
        (DATA + "[basis]\nn_modes = '16'", '[basis] n_modes: is "16"; it should be a whole number'),
        (DATA + "[basis]\nn_modes = 16.0", "[basis] n_modes: is 16.0; it should be a whole number"),
        (DATA + "[basis]\nn_modes = true", "[basis] n_modes: is true; it should be a whole number"),
        (DATA + "[solver]\ncompress = 1", "[solver] compress: is 1; it should be true or false"),
        (DATA + "[prior]\nfraction = 'half'", '[prior] fraction: is "half"; it should be a number'),
        ("seed = 1979-05-27\n" + DATA, 'seed: is "1979-05-27"; it should be a whole number'),
        (DATA + "antpairs = [[1, 2, 3]]", "[data] antpairs: is [1, 2, 3]; it should be a list of 2"),
        (DATA + "antpairs = [[1, 'a']]", '[data] antpairs: is "a"; it should be a whole number'),
        (DATA + "lst_range = [1]", "[data] lst_range: is [1]; it should be a list of two"),
        # Tables of which there may be several.
        (
            EFFECT + EFFECT.removeprefix(DATA) + "knd = 'x'",
            "[[effects]] number 2 knd: unknown key; did you mean 'kind'?",
        ),
        (
            EFFECT + "qwertz = 1",
            "[[effects]] number 1 qwertz: unknown key; the keys of [[effects]] are kind, settings,",
        ),
        (
            EFFECT + "strength = 1",
            "[[effects]] number 1 strength: unknown key; it belongs in [[data.simulate.effects]]",
        ),
        (DATA + "prior_std = 1", "[data] prior_std: unknown key; it belongs in [[sample.effects]] or [[effects]]"),
        (DATA + "[[effects]]", "[[effects]] number 1 kind: is missing; add it"),
        (
            COMPLETE + "[[effects]]\nkind = 'diffus'",
            "[[effects]] number 2 kind: is \"diffus\"; it should be 'antenna_gains', 'antenna_delays', ",
        ),
        (EFFECT + "values = [1]", "[[effects]] number 1 values: is 1; it should be a list in brackets"),
        (EFFECT + "values = [[1, 'x']]", '[[effects]] number 1 values: is "x"; it should be a number'),
        (EFFECT + "settings = 3", "[[effects]] number 1 settings: is 3; it should be keys and values in braces"),
        (EFFECT + "index = [-1]", "[[effects]] number 1 index: is -1; it should be at least 0"),
        (EFFECT + "prior_std = [0]", "[[effects]] number 1 prior_std: is 0; it should be at least 1e-30"),
        (EFFECT, TOGETHER + "parameter; use the table as 'hydrabeam loop' wrote it"),
        (EFFECT + "values = [[]]", TOGETHER),
        (COMPLETE.replace("[[1]]", "[[1], []]"), TOGETHER),
        (COMPLETE.replace("[0]", "[0, 1]"), TOGETHER),
        (COMPLETE.replace("[1]\n", "[1, 1]\n"), TOGETHER),
        (COMPLETE + "std = [[1, 1]]", TOGETHER),
        (COMPLETE + "std = [[1], [1]]", TOGETHER),
        (
            EFFECT + "names = ['x', 'x']\nindex = [0, 0]\nvalues = [[1, 1]]\nprior_std = [1, 1]",
            TOGETHER,
        ),
        ("effects = [3]\n" + DATA, "[[effects]] number 1: is not a table; it should be keys and values"),
        (
            DATA + "[effects]\nkind = 'diffuse'",
            "[[effects]]: there may be several of these; write [[effects]] above each",
        ),
        (
            SIMULATE + INJECTED + INJECTED + "strength = 0",
            "[[data.simulate.effects]] number 2 strength: is 0; it should be more than 0",
        ),
        (
            SIMULATE + INJECTED + "parameters = {'antenna 1 phase' = 'x'}",
            '[[data.simulate.effects]] number 1 parameters antenna 1 phase: is "x"; it should be a number',
        ),
        (
            SIMULATE + "[data.simulate.effects]\nkind = 'diffuse'",
            "[[data.simulate.effects]]: there may be several of these; write [[data.simulate.effects]] above each",
        ),
        (
            DATA + "[loop]\neffects = ['diffuse', 'antena_gains']",
            "[loop] effects: is \"antena_gains\"; it should be 'antenna_gains', 'antenna_delays', ",
        ),
        # Wrong units and values.
        (
            DATA + "[basis]\nedge = '92 m'",
            "[basis] edge: is \"92 m\"; it should be an angle, a number in deg or text such as '90 deg'",
        ),
        (DATA + "[basis]\nedge = 1.6", "[basis] edge: is 1.6; it should be at least 90"),
        (DATA + "[basis]\nn_modes = 0", "[basis] n_modes: is 0; it should be at least 1"),
        (DATA + "freqs = ['-131 MHz']", '[data] freqs: is "-131 MHz"; it should be more than 0'),
        (DATA + "freqs = []", "[data] freqs: is []; it should be a list of 1 or more"),
        (DATA + "channels = [-1]", "[data] channels: is -1; it should be at least 0"),
        (DATA + "lst_range = [1, 90]", "[data] lst_range: is 90; it should be at most 24"),
        (
            DATA + "lst_range = [1, 1]",
            "[data] lst_range: is [1, 1]; it should be [from, to] with two different times, [0, 24] for a whole day",
        ),
        (
            DATA + "freq_range = ['2 MHz', '1 MHz']",
            '[data] freq_range: is ["2 MHz", "1 MHz"]; it should be [from, to] with the lower value first',
        ),
        (DATA + "[sky]\nflux_range = [2, 1]", "[sky] flux_range: is [2, 1]; it should be [from, to]"),
        (DATA + "[noise]\nkind = 'constant'\nsigma = nan", "[noise] sigma: is NaN; it should be finite"),
        (DATA + "[noise]\nkind = 'constant'\nsigma = '0 Jy'", '[noise] sigma: is "0 Jy"; it should be more than 0'),
        (
            DATA + "[basis]\nform = 'reel'",
            "[basis] form: is \"reel\"; it should be 'real' or 'complex'; did you mean 'real'?",
        ),
        (DATA + "[basis]\nform = 'qwertz'", "[basis] form: is \"qwertz\"; it should be 'real' or 'complex'"),
        (SIMULATE + "start = 59866", "[data.simulate] start: is 59866; it should be at least 2437665"),
        (SIMULATE + "n_times = 0", "[data.simulate] n_times: is 0; it should be at least 1"),
        (
            SIMULATE + "freqs = [1e8, 1e8]",
            "[data.simulate] freqs: is [100000000.0, 100000000.0]; it should be a list that",
        ),
        (
            SIMULATE + "perturb = {stretch = [0.9, 1]}",
            "[data.simulate.perturb] stretch: is 0.9; it should be at least 1",
        ),
        (DATA + f"gains = {['x' * 20] * 9 + [1]}", "[data] gains: is 1; it should be text in quotes"),
        (DATA + f"polarization = '{'x' * 99}'", f'[data] polarization: is "{"x" * 59}...; it should be'),
        # Keys that do not fit together.
        (
            DATA + "[noise]\nkind = 'constant'",
            "[noise]: kind = 'constant' needs sigma; give sigma = '... Jy', or another kind",
        ),
        (
            DATA + "[noise]\nfile = 'a'",
            "[noise]: file is for kind = 'file', not 'autocorrelations'; leave it out or set",
        ),
        (
            DATA + "[holdout]\nkind = 'lst'",
            "[holdout]: kind = 'lst' needs lst_ranges; give lst_ranges = [[from, to], ...]",
        ),
        (
            DATA + "[holdout]\nkind = 'times'\nlst_ranges = [[5, 6]]",
            "[holdout]: lst_ranges is for kind = 'lst', not 'times'",
        ),
        (DATA + "[holdout]\nkind = 'none'\nevery = 3", "[holdout]: every = 3 is for kind = 'times', not 'none'; leave"),
        (DATA + "[holdout]\nkind = 'jd'", "[holdout]: kind = 'jd' needs jd_ranges; give jd_ranges = [[from, to], ...]"),
        (
            DATA + "[holdout]\nantpairs = [[1, 2]]",
            "[holdout]: antpairs is for kind = 'baselines', not 'times'; leave it out or set kind = 'baselines'",
        ),
        (
            DATA + "[sky]\nkind = 'catalogue'",
            "[sky]: kind = 'catalogue' needs file; give file = '...', or another kind",
        ),
        (DATA + "[sky.columns]\nname = 'x'", "[sky]: columns are of a catalogue; leave them out"),
        (
            TABLES["sky.columns"] + "[sky.columns]\nflux = ['a', 'b']\n" + DATA,
            "[sky.columns]: 2 flux columns, 0 freqs; give one for each",
        ),
        (DATA + "[prior]\nkind = 'file'", "[prior]: kind = 'file' needs file; give file = '...', or another kind"),
        (DATA + "[beam]\nsource = 'airy'", "[beam]: a formula goes with a diameter; give both, such as"),
        (DATA + "[beam]\ndiameter = 14", "[beam]: a formula goes with a diameter; give both, such as"),
        (
            DATA + "[basis]\nk_max = 2\nm_max = 1\nn_modes = 7",
            "[basis]: n_modes = 7, but k_max and m_max give 6; ask for fewer, or for higher orders",
        ),
        (SIMULATE + "freqs = [2e8, 1e8]", "[data.simulate]: freqs do not ascend; sort them"),
        (
            "[data.simulate.array]\nhex = [4, 3]",
            "[data.simulate.array]: hex = [4, 3] is no array; give [first row, middle row], such as [4, 7]",
        ),
        ("[data.simulate.array]\nhex = [1, 1]", "[data.simulate.array]: hex = [1, 1] is no array"),
        ("[data]\nchannels = [0]\n" + SIMULATE, "[data]: channels is for data from files; leave it out, or set it in"),
        ("[data]\npol_convention = 'avg'\n" + SIMULATE, "[data]: pol_convention is for data from files; leave it out"),
        # Keys that would not be used.
        (
            DATA + "[sky]\nkind = 'catalogue'\nfile = 'a.vot'\nn_sources = 3",
            "[sky]: n_sources = 3 is for kind = 'mock', not 'catalogue'; leave it out",
        ),
        (
            DATA + "[basis]\nkind = 'zernike'\nform = 'complex'",
            "[basis]: form = \"complex\" is for kind = 'fourier-bessel', not 'zernike'; leave it out",
        ),
        (DATA + "[basis]\nmax_degree = 3", "[basis]: max_degree = 3 is for kind = 'zernike', not 'fourier-bessel'"),
        (
            DATA + "[prior]\nkind = 'flat'\nfraction = 0.1",
            "[prior]: fraction = 0.1 is for kind = 'fraction', not 'flat'",
        ),
        (DATA + "[beam]\neast_feed = 'x'", "[beam]: east_feed = \"x\" is for a beam file, not 'hera-vivaldi-131MHz'"),
        (
            DATA + "[beam]\nsource = 'airy'\ndiameter = 14\nfrequency = 'scale'",
            "[beam]: frequency = \"scale\" is for a beam with channels of its own, not 'airy'; leave it out",
        ),
        (
            "[data.simulate.array]\nfile = 'a.csv'\nspacing = 10",
            "[data.simulate.array]: spacing = 10.0 is for a hexagon, not positions from a file; leave it out",
        ),
        (
            SIMULATE + INJECTED + "strength = 1\nparameters = {x = 1}",
            "[[data.simulate.effects]] number 1: strength = 1.0 is for parameters drawn at random, not those that are",
        ),
        (
            TABLES["sky.columns"] + "[sky.columns]\nfreqs = ['1 MHz']\n" + DATA,
            "[sky.columns]: freqs = [1000000.0] is for several flux columns, not a single one; leave it out",
        ),
        (
            TABLES["sky.columns"]
            + "[sky.columns]\nflux = ['a', 'b']\nfreqs = [1e8, 2e8]\nspectral_index = 'c'\n"
            + DATA,
            '[sky.columns]: spectral_index = "c" is for a single one, not several flux columns; leave it out',
        ),
        # Numbers that are no measure of anything.
        (DATA + "freqs = [1e-300]", "[data] freqs: is 1e-300; it should be at least 3000"),
        (DATA + "freqs = [1e300]", "[data] freqs: is 1e+300; it should be at most 3e+12"),
        (DATA + "freqs = ['1e400 Hz']", "[data] freqs: is Infinity; it should be "),
        (DATA + "freqs = ['1 Hz(1/0)']", '[data] freqs: is "1 Hz(1/0)"; it should be a frequency'),
        (DATA + "[noise]\nkind = 'constant'\nsigma = 1e300", "[noise] sigma: is 1e+300; it should be at most 1e+30"),
        (
            DATA + "[noise]\nkind = 'constant'\nsigma = 1e-300",
            "[noise]: sigma is 1e-300 Jy, of which no sum has a digit",
        ),
        (DATA + "[sky]\nflux_range = [1e-300, 1]", "[sky] flux_range: is 1e-300; it should be at least 1e-30"),
        (
            DATA + "[prior.frequency]\nkind = 'modes'",
            "[prior.frequency]: modes = 'legendre' needs n_modes; give n_modes = 3 or so",
        ),
        (
            DATA + "[prior.frequency]\nkind = 'modes'\nmodes = 'dpss'",
            "[prior.frequency]: modes = 'dpss' and delay go together; give both, such as 'dpss' and '100 ns', or",
        ),
        (
            DATA + "[prior.frequency]\nlength = '5 MHz'",
            "[prior.frequency]: length = [5000000.0] is for kind = 'gaussian-process', not 'independent'",
        ),
        (
            DATA + "[prior.frequency]\nsolver = 'dense'",
            "[prior.frequency]: solver = \"dense\" is for channels that hang together, not kind = 'independent'",
        ),
        (
            DATA + "[prior]\nkind = 'flat'\n[prior.frequency]\nkind = 'gaussian-process'",
            "[prior]: channels hang together by widths of independent coefficients, which kind = 'flat' has not",
        ),
        (DATA + "[prior]\nfraction = 1e-200", "[prior]: fraction = 1e-200 lets no coefficient move by a digit that a"),
        (DATA + "[prior]\nfraction = 1e200", "[prior]: fraction = 1e+200 is no prior; set kind = 'flat' to have none"),
        (DATA + "[prior]\nfloor = 1e200", "[prior] floor: is 1e+200; it should be at most 4.503599627e+15"),
        (DATA + "[basis]\nk_max = 1201", "[basis] k_max: is 1201; it should be at most 1200"),
        (DATA + "[basis]\nm_max = 181", "[basis] m_max: is 181; it should be at most 180"),
        (SIMULATE + "height = 1e300", "[data.simulate] height: is 1e+300; it should be at most 100000"),
        (
            SIMULATE + "integration_time = '2 d'",
            "[data.simulate] integration_time: is 172800.0; it should be at most 86400",
        ),
        (
            SIMULATE + "channel_width = 1\nintegration_time = 0.1\nnsamples = 1",
            "[data.simulate]: channel_width, integration_time and nsamples give 0.1 independent samples, less than",
        ),
        (
            SIMULATE + "perturb = {sidelobe = 1e300}",
            "[data.simulate.perturb] sidelobe: is 1e+300; it should be at most",
        ),
        (
            "[data.simulate.array]\nspacing = 1e9",
            "[data.simulate.array] spacing: is 1000000000.0; it should be at most",
        ),
    ],
)
def test_complaint(text: str, expected: str, tmp_path: Path) -> None:
    assert complaint(text, tmp_path).startswith(expected)


@pytest.mark.parametrize("table", TABLES)
def test_unknown_key_of_every_table(table: str, tmp_path: Path) -> None:
    data = "" if table.startswith("data") else DATA
    unknown = "xyzzy = 1\n"
    text = f"{TABLES[table]}[{table}]\n{unknown}{data}" if table else unknown + data
    where = f"[{table}] xyzzy" if table else "xyzzy"
    assert complaint(text, tmp_path).startswith(
        f"{where}: unknown key; the keys of {f'[{table}]' if table else 'a job'}"
    )


def test_unknown_effect_is_told_all_that_are_known(tmp_path: Path) -> None:
    said = complaint(DATA + "[loop]\nskip = ['antena_gains']", tmp_path)
    assert said.startswith('[loop] skip: is "antena_gains"; it should be ')
    assert all(f"'{kind}'" in said for kind in KINDS)
    assert said.endswith("did you mean 'antenna_gains'?")


def test_a_misspelt_key_comes_before_what_is_missing_for_it(tmp_path: Path) -> None:
    said = complaint("[data]\nfile = ['a.uvh5']", tmp_path)
    assert said == "[data] file: unknown key; did you mean 'files'?"
