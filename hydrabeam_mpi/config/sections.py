"""The tables of a job file: frozen, with the default, the unit and the meaning of each key."""

from __future__ import annotations

from typing import TYPE_CHECKING, Annotated, Any, Literal, Self

from pydantic import AfterValidator, Field, ValidationInfo, model_validator

from hydrabeam_mpi.config.base import Section, key, refuse_unused
from hydrabeam_mpi.config.frequency import OverFrequency
from hydrabeam_mpi.config.quantities import (
    AntennaPair,
    Degrees,
    File,
    FluxRange,
    Hertz,
    Jansky,
    JdRange,
    LstRange,
    Metres,
    from_job,
)
from hydrabeam_mpi.data.limits import EARTH_DIAMETER, LARGEST
from hydrabeam_mpi.model.bases import JOB_NAMES
from hydrabeam_mpi.model.engines import ENGINES

if TYPE_CHECKING:
    BasisName = str
    EngineName = str
else:  # a job may ask for what there is
    BasisName = Literal[tuple(JOB_NAMES)]
    EngineName = Literal[tuple(ENGINES)]

ANALYTIC_BEAMS = ("gaussian", "airy")
EMBEDDED_BEAM = "hera-vivaldi-131MHz"
BUILT_IN_BEAMS = (EMBEDDED_BEAM, *ANALYTIC_BEAMS)


class Noise(Section):
    """Where the noise variance comes from."""

    kind: Literal["autocorrelations", "constant", "file", "time-differences", "frequency-differences"] = key(
        "autocorrelations", "where sigma comes from"
    )
    sigma: Jansky | None = key(None, "Jy of V = I B / 2, root of the mean |n|^2; kind = 'constant'", gt=0, le=LARGEST)
    file: File | None = key(None, "kind = 'file': uvh5 of sigmas, or HDF5 or npz with freqs and sigma")

    @model_validator(mode="after")
    def _has_what_it_needs(self) -> Self:
        _go_together(self, "kind", "constant", "sigma", "'... Jy'")
        _go_together(self, "kind", "file", "file", "'...'")
        if self.sigma is not None and self.sigma < 1 / LARGEST:
            raise ValueError(f"sigma is {self.sigma:.3g} Jy, of which no sum has a digit; give {1 / LARGEST:g} or more")
        return self


class Holdout(Section):
    """Which data are kept from the inference, to test it."""

    kind: Literal["times", "lst", "jd", "baselines", "none"] = key("times", "what is held out")
    every: int = key(2, "kind = 'times': the last of every so many integrations", ("kind", "times"), ge=2)
    lst_ranges: tuple[LstRange, ...] = key((), "h, kind = 'lst': [[from, to], ...]")
    jd_ranges: tuple[JdRange, ...] = key((), "kind = 'jd': [[from, to], ...], such as whole nights")
    antpairs: tuple[AntennaPair, ...] = key((), "kind = 'baselines': [[ant1, ant2], ...]")

    @model_validator(mode="after")
    def _has_what_it_needs(self) -> Self:
        _go_together(self, "kind", "lst", "lst_ranges", "[[from, to], ...]")
        _go_together(self, "kind", "jd", "jd_ranges", "[[from, to], ...]")
        _go_together(self, "kind", "baselines", "antpairs", "[[ant1, ant2], ...]")
        return self


class SkyColumns(Section):
    """Columns of a VOTable; defaults are GLEAM's power-law fits. Without it, GLEAM's subbands are read."""

    table: str = key("GLEAM", "name of the table, or part of it")
    name: str = key("GLEAM", "column of the sources' names")
    lon: str = key("RAJ2000", "column")
    lat: str = key("DEJ2000", "column")
    frame: str = key("fk5", "astropy's name of the frame of lon and lat")
    flux: tuple[str, ...] = key(("Fintfit200",), "one column, or one for each of freqs", min_length=1)
    freqs: tuple[Hertz, ...] = key((), "Hz, of several flux columns")
    reference_freq: Hertz = key(200e6, "Hz, of a single flux column")
    spectral_index: str = key("alpha", "column, or '' where a single flux column holds at all frequencies")

    @model_validator(mode="after")
    def _has_what_it_needs(self) -> Self:
        if len(self.flux) > 1 and len(self.freqs) != len(self.flux):
            raise ValueError(f"{len(self.flux)} flux columns, {len(self.freqs)} freqs; give one for each")
        several, one = "several flux columns", "a single one"
        for name in ("reference_freq", "spectral_index") if len(self.flux) > 1 else ("freqs",):
            if getattr(self, name) != type(self).model_fields[name].default:
                refuse_unused(self, name, *((one, several) if len(self.flux) > 1 else (several, one)))
        return self


MOCK = ("kind", "mock")


class Sky(Section):
    """The sky model: the mock of HDBI II, or a catalogue."""

    kind: Literal["mock", "catalogue"] = key("mock", "drawn at random, or from a file")
    n_sources: int = key(10000, "mock", MOCK, ge=1)
    flux_range: FluxRange = key((0.1, 100.0), "Jy at reference_freq, log-flat: mock", MOCK)
    reference_freq: Hertz | None = key(
        None, "Hz, to which fluxes of the mock and cuts refer; by default 100 MHz, or the nearest that a catalogue has"
    )
    spectral_index: float = key(-2.7, "mock", MOCK)
    file: File | None = key(None, "skyh5, VOTable, text or FHD .sav: catalogue")
    columns: SkyColumns | None = None
    diffuse: File | None = key(None, "folder of the GSM 2016 maps, added to the sources")
    positions: Literal["apparent", "lst"] | None = key(
        None, "apparent places (a catalogue's default), or turned by LST alone (a mock's)"
    )
    flux_min: Jansky = key(0.0, "Jy at reference_freq; fainter sources do not exist", ge=0)
    model_flux_min: Jansky = key(0.0, "Jy at reference_freq; fainter sources are not modelled", ge=0)

    @model_validator(mode="after")
    def _has_what_it_needs(self) -> Self:
        _go_together(self, "kind", "catalogue", "file", "'...'")
        if self.columns is not None and self.kind != "catalogue":
            raise ValueError("columns are of a catalogue; leave them out or set kind = 'catalogue'")
        return self


def _beam_file(source: str, info: ValidationInfo) -> str:
    return source if source in BUILT_IN_BEAMS else str(from_job(source, info))


class Beam(Section):
    """The electromagnetic beam model that is nearly right; the prior mean is its fit."""

    source: Annotated[str, AfterValidator(_beam_file)] = key(
        EMBEDDED_BEAM, f"beam file, or '{EMBEDDED_BEAM}', 'gaussian' or 'airy'"
    )
    east_feed: Literal["x", "y"] | None = key(None, "feed that points East, instead of what the file says")
    diameter: Metres | None = key(None, "m, of 'gaussian' or 'airy'", gt=0, le=EARTH_DIAMETER)
    frequency: Literal["match", "interpolate", "scale"] = key(
        "match", "where the file lacks a channel: an error, interpolate, or scale za with the wavelength"
    )

    @model_validator(mode="after")
    def _has_what_it_needs(self) -> Self:
        if (self.source in ANALYTIC_BEAMS) != (self.diameter is not None):
            raise ValueError("a formula goes with a diameter; give both, such as 'airy' and '14 m', or neither")
        if self.source in BUILT_IN_BEAMS and self.east_feed is not None:
            refuse_unused(self, "east_feed", "a beam file", f"'{self.source}'")
        if self.source in ANALYTIC_BEAMS and self.frequency != "match":
            refuse_unused(self, "frequency", "a beam with channels of its own", f"'{self.source}'")
        return self


FOURIER_BESSEL = ("kind", "fourier-bessel")
MOST_ZEROS = 1200
"""Of a Bessel function, as SciPy's `jn_zeros` finds them."""
MOST_ORDERS = 180
"""Higher ones look like lower ones on the one-degree grid, on which beams are fitted and told."""


class Basis(Section):
    """The linear basis of the inferred beam."""

    kind: BasisName = key("fourier-bessel", "family of functions")
    form: Literal["real", "complex"] = key("real", "fourier-bessel: of the coefficients", FOURIER_BESSEL)
    n_modes: int = key(2048, "fourier-bessel: coefficients kept, the largest of the model beam", FOURIER_BESSEL, ge=1)
    k_max: int = key(80, "fourier-bessel: radial orders 1 to k_max", FOURIER_BESSEL, ge=1, le=MOST_ZEROS)
    m_max: int = key(45, "fourier-bessel: azimuthal orders -m_max to m_max", FOURIER_BESSEL, ge=0, le=MOST_ORDERS)
    rest: bool = key(
        False, "fourier-bessel: with all that the model beam has beyond these as one more function", FOURIER_BESSEL
    )
    edge: Degrees = key(92.0, "deg of zenith angle where the functions end", ge=90, le=180)
    boundary: Literal["dirichlet", "neumann"] = key(
        "neumann", "fourier-bessel: zero at the edge, or flat", FOURIER_BESSEL
    )
    max_degree: int = key(30, "zernike", ("kind", "zernike"), ge=0)

    @model_validator(mode="after")
    def _has_so_many_modes(self) -> Self:
        if self.kind == "fourier-bessel" and self.n_modes > self.k_max * (2 * self.m_max + 1):
            raise ValueError(
                f"n_modes = {self.n_modes}, but k_max and m_max give {self.k_max * (2 * self.m_max + 1)}"
                "; ask for fewer, or for higher orders"
            )
        return self


FRACTION = ("kind", "fraction")
RESOLVED = 2.0**-52
"""Relative spacing of doubles."""
MOST_DECAY = 5.0
"""With more each order has less than a hundredth of the one before, and only the lowest are free."""
Decay = Annotated[float, Field(ge=0, le=MOST_DECAY)]
LEAST_WIDTH = 1e-9
"""Of what the model's coefficients are multiplied by: no data tell a beam to so little of itself."""
Factor = Annotated[float, Field(ge=LEAST_WIDTH, le=LARGEST)]


class Smooth(Section):
    """A part of the prior's widths that does not follow the model's coefficients; the squares of both are added."""

    amplitude: float = key(
        0.0, "standard deviation at the lowest orders, over the largest coefficient", ge=0, le=LARGEST
    )
    decay: Annotated[tuple[Decay, Decay], Field(strict=False)] = key(
        (0.0, 0.0), "ln of how much less it is for each radial and each azimuthal order"
    )


class Prior(Section):
    """The Gaussian prior on the coefficients."""

    kind: Literal["fraction", "flat", "file"] = key(
        "fraction", "independent coefficients, none, or 'file', which it is where one is given"
    )
    fraction: float = key(1.0, "standard deviation over the amplitude of the fitted coefficient", FRACTION, gt=0)
    floor: float = key(
        0.0,
        "the standard deviation is at least fraction times this part of the largest amplitude; where it is 0, "
        "coefficients that the model beam has nothing of get a width like those around them",
        FRACTION,
        ge=0,
        le=1 / RESOLVED,
    )
    neighbours: bool = key(
        False,
        "for the standard deviation take the largest amplitude of three: the coefficient's own, and those of the same "
        "azimuthal order at the next lower and higher radial order",
    )
    azimuthal: Annotated[tuple[Factor, ...], Field(strict=False)] = key(
        (), "factors of the widths at azimuthal orders 0, 1, 2 and so on; 1 beyond"
    )
    smooth: Smooth = Smooth()
    widths: Literal["stated", "evidence"] | None = key(
        None, "whether the data adapt the widths; by default 'stated' in infer, 'evidence' in the loop"
    )
    shape: bool | None = key(
        None,
        "whether beams may also differ from their model as a whole, by usual errors of amplitude, size, pointing and "
        "sidelobes; by default where the data adapt the widths",
    )
    file: File | None = key(None, "mean and covariance, or a result's folder: what other data have told is known")
    frequency: OverFrequency = OverFrequency()

    @model_validator(mode="before")
    @classmethod
    def _is_from_a_file(cls, content: Any) -> Any:
        is_file = isinstance(content, dict) and "file" in content and "kind" not in content
        return {**content, "kind": "file"} if is_file else content

    @model_validator(mode="after")
    def _has_what_it_needs(self) -> Self:
        _go_together(self, "kind", "file", "file", "'...'")
        if self.fraction < RESOLVED:
            raise ValueError(
                f"fraction = {self.fraction:.3g} lets no coefficient move by a digit that a double has"
                f"; give {RESOLVED:.2g} or more"
            )
        if self.fraction > 1 / RESOLVED:
            raise ValueError(f"fraction = {self.fraction:.3g} is no prior; set kind = 'flat' to have none")
        for name, is_given in (
            ("neighbours", self.neighbours),
            ("azimuthal", self.azimuthal),
            ("smooth", self.smooth.amplitude),
            ("shape", self.shape),
        ):
            if is_given and self.kind != "fraction":
                refuse_unused(self, name, "kind = 'fraction'", f"'{self.kind}'")
        if self.widths == "evidence" and (self.kind != "fraction" or self.frequency.couples):
            raise ValueError(
                "widths = 'evidence' is for independent coefficients of independent channels; set widths = 'stated'"
                ", or kind = 'fraction' and [prior.frequency] kind = 'independent'"
            )
        if self.shape and self.frequency.couples:
            raise ValueError(
                "channels hang together by widths of independent coefficients, and those of shape = true are not"
                "; set shape = false, or [prior.frequency] kind = 'independent'"
            )
        if self.frequency.couples and self.kind != "fraction":
            raise ValueError(
                f"channels hang together by widths of independent coefficients, which kind = '{self.kind}' has not"
                "; set kind = 'fraction', or [prior.frequency] kind = 'independent'"
            )
        return self

    @property
    def has_shape(self) -> bool:
        """Whether beams may differ from their model as a whole, where a job says so or its default does."""
        return self.widths == "evidence" if self.shape is None else self.shape


class Solver(Section):
    """How the design matrix is computed."""

    engine: EngineName = key("gemm", "matrix products, non-uniform FFTs for many baselines and sources, or the faster")
    compress: bool = key(True, "treat redundant baselines as one, which changes nothing but the time")
    precision: Literal["double", "mixed"] = key(
        "double", "'mixed': the design matrix in single precision where that suffices, else in double; infer only"
    )

    @model_validator(mode="after")
    def _has_such_a_precision(self) -> Self:
        if self.precision == "mixed" and self.engine == "nufft":
            refuse_unused(self, "precision", "engine = 'gemm'", "'nufft'")
        return self


class Output(Section):
    """What is written beside the posterior mean and covariance."""

    draws: int = key(100, "from the posterior", ge=0)


def _go_together(section: Section, switch: str, position: str, key: str, example: str) -> None:
    """Make sure that ``key`` is given where, and only where, ``switch`` asks for it."""
    actual, given = getattr(section, switch), bool(getattr(section, key))
    if actual == position and not given:
        raise ValueError(f"{switch} = '{position}' needs {key}; give {key} = {example}, or another {switch}")
    if actual != position and given:
        raise ValueError(
            f"{key} is for {switch} = '{position}', not '{actual}'; leave it out or set {switch} = '{position}'"
        )
