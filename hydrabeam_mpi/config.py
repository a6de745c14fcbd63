"""The job file: one validated, frozen section per TOML table, with units and with errors that name the key."""

from __future__ import annotations

import difflib
import tomllib
from collections.abc import Callable
from pathlib import Path
from typing import Annotated, Any, Literal, Self

from astropy import units
from pydantic import BaseModel, BeforeValidator, ConfigDict, Field, ValidationError, model_validator

from hydrabeam_mpi.errors import InputError


def _quantity(unit: str, equivalencies: list[Any] | None = None) -> Callable[[Any], float]:
    """Return a validator that takes a plain number in ``unit``, or text with any unit of the same kind."""

    def parse(value: Any) -> float:
        if isinstance(value, bool) or not isinstance(value, int | float | str):
            raise ValueError(f"should be a number in {unit}, or text with a unit such as '1 {unit}'")
        if not isinstance(value, str):
            return float(value)
        try:
            quantity = units.Quantity(value)
            if quantity.unit == units.dimensionless_unscaled:
                return float(quantity.value)
            return float(quantity.to_value(unit, equivalencies or []))
        except (TypeError, ValueError, units.UnitConversionError) as error:
            raise ValueError(f"'{value}' is not a quantity in {unit}, such as '1 {unit}'") from error

    return parse


Hertz = Annotated[float, BeforeValidator(_quantity("Hz"))]
Metres = Annotated[float, BeforeValidator(_quantity("m"))]
Seconds = Annotated[float, BeforeValidator(_quantity("s"))]
Jansky = Annotated[float, BeforeValidator(_quantity("Jy"))]
Degrees = Annotated[float, BeforeValidator(_quantity("deg"))]
# "6 h" and "6 hourangle" are one sidereal time, "90 deg" another way to write it.
Hours = Annotated[float, BeforeValidator(_quantity("hourangle", [(units.h, units.hourangle)]))]
Polarization = Literal["ee", "nn", "en", "ne", "xx", "yy", "xy", "yx"]


class Section(BaseModel):
    """A table of the job file: frozen, and an unknown key is an error."""

    model_config = ConfigDict(frozen=True, extra="forbid", validate_default=True, allow_inf_nan=False)


class Array(Section):
    """The antennas of a simulation: a hexagon, or positions from a file."""

    hex: tuple[Annotated[int, Field(ge=1)], Annotated[int, Field(ge=1)]] = (4, 7)
    spacing: Annotated[Metres, Field(gt=0)] = 14.6
    file: Path | None = None


class Perturbation(Section):
    """The perturbed beam of HDBI II, eqs 16-21; stretch 1 and sidelobe 0 leave the beam as it is."""

    stretch: tuple[Annotated[float, Field(gt=0)], Annotated[float, Field(gt=0)]] = (1.01, 1.02)
    sidelobe: Annotated[float, Field(ge=0)] = 0.2


class Simulate(Section):
    """Mock data as in HDBI II, section 3: array, times, channels, perturbed beam and noise."""

    array: Array = Array()
    latitude: Annotated[Degrees, Field(ge=-90, le=90)] = -30.7215
    longitude: Degrees = 21.4283
    height: Metres = 1051.69
    start: float = 2459866.0
    lst_range: tuple[Hours, Hours] = (6.0, 12.0)
    n_times: Annotated[int, Field(ge=1)] = 60
    freqs: tuple[Annotated[Hertz, Field(gt=0)], ...] = (131e6,)
    channel_width: Annotated[Hertz, Field(gt=0)] = 100e3
    integration_time: Annotated[Seconds, Field(gt=0)] = 10.0
    nsamples: Annotated[float, Field(gt=0)] = 100.0
    noise: bool = True
    perturb: Perturbation | None = Perturbation()


class Data(Section):
    """Which visibilities: files and a selection of them, or a simulation."""

    files: tuple[str, ...] = ()
    simulate: Simulate | None = None
    polarization: Polarization = "ee"
    pol_convention: Literal["sum", "avg"] | None = None
    gains: tuple[str, ...] = ()
    antennas: tuple[int, ...] | None = None
    exclude_antennas: tuple[int, ...] = ()
    antpairs: tuple[tuple[int, int], ...] | None = None
    lst_range: tuple[Hours, Hours] | None = None
    time_range: tuple[float, float] | None = None
    freq_range: tuple[Annotated[Hertz, Field(gt=0)], Annotated[Hertz, Field(gt=0)]] | None = None
    freqs: tuple[Annotated[Hertz, Field(gt=0)], ...] | None = None
    channels: tuple[Annotated[int, Field(ge=0)], ...] | None = None
    channel_width: Annotated[Hertz, Field(gt=0)] | None = None
    min_bl_length: Annotated[Metres, Field(ge=0)] = 0.0
    max_bl_length: Annotated[Metres, Field(gt=0)] | None = None
    redundancy_tol: Annotated[Metres, Field(gt=0)] = 1e-7

    @model_validator(mode="after")
    def _one_origin(self) -> Self:
        if bool(self.files) == (self.simulate is not None):
            raise ValueError("needs either files = [...] or a [data.simulate] table, not both")
        return self


class Noise(Section):
    """Where the noise variance comes from."""

    kind: Literal["autocorrelations", "constant", "file", "time-differences", "frequency-differences"] = (
        "autocorrelations"
    )
    sigma: Annotated[Jansky, Field(gt=0)] | None = None
    file: Path | None = None

    @model_validator(mode="after")
    def _has_what_it_needs(self) -> Self:
        if (self.kind == "constant") != (self.sigma is not None):
            raise ValueError("kind = 'constant' and sigma = '... Jy' go together")
        if (self.kind == "file") != (self.file is not None):
            raise ValueError("kind = 'file' and file = '...' go together")
        return self


class Holdout(Section):
    """Which data are kept from the inference, to test it."""

    kind: Literal["times", "lst", "jd", "baselines", "none"] = "times"
    every: Annotated[int, Field(ge=2)] = 2
    lst_ranges: tuple[tuple[Hours, Hours], ...] = ()
    jd_ranges: tuple[tuple[float, float], ...] = ()
    antpairs: tuple[tuple[int, int], ...] = ()

    @model_validator(mode="after")
    def _has_what_it_needs(self) -> Self:
        if (self.kind == "lst") != bool(self.lst_ranges):
            raise ValueError("kind = 'lst' and lst_ranges = [[from, to], ...] go together")
        if (self.kind == "jd") != bool(self.jd_ranges):
            raise ValueError("kind = 'jd' and jd_ranges = [[JD, JD], ...] go together")
        if (self.kind == "baselines") != bool(self.antpairs):
            raise ValueError("kind = 'baselines' and antpairs = [[ant1, ant2], ...] go together")
        return self


class SkyColumns(Section):
    """Columns of a VOTable; the defaults are those of GLEAM's power-law fits. Without it, GLEAM's subbands are read."""

    table: str = "GLEAM"
    name: str = "GLEAM"
    lon: str = "RAJ2000"
    lat: str = "DEJ2000"
    frame: str = "fk5"
    flux: tuple[str, ...] = ("Fintfit200",)
    freqs: tuple[Annotated[Hertz, Field(gt=0)], ...] = ()
    reference_freq: Annotated[Hertz, Field(gt=0)] | None = 200e6
    spectral_index: str | None = "alpha"


class Sky(Section):
    """The sky model: the mock of HDBI II, or a catalogue."""

    kind: Literal["mock", "catalogue"] = "mock"
    n_sources: Annotated[int, Field(ge=1)] = 10000
    flux_range: tuple[Annotated[Jansky, Field(gt=0)], Annotated[Jansky, Field(gt=0)]] = (0.1, 100.0)
    reference_freq: Annotated[Hertz, Field(gt=0)] = 100e6
    spectral_index: float = -2.7
    file: Path | None = None
    columns: SkyColumns | None = None
    diffuse: Path | None = None
    positions: Literal["apparent", "lst"] | None = None
    flux_min: Annotated[Jansky, Field(ge=0)] = 0.0
    model_flux_min: Annotated[Jansky, Field(ge=0)] = 0.0

    @model_validator(mode="after")
    def _has_what_it_needs(self) -> Self:
        if (self.kind == "catalogue") != (self.file is not None):
            raise ValueError("kind = 'catalogue' and file = '...' go together")
        return self


class Beam(Section):
    """The electromagnetic beam model that is nearly right; the prior mean is its fit."""

    source: str = "hera-vivaldi-131MHz"
    east_feed: Literal["x", "y"] | None = None
    diameter: Annotated[Metres, Field(gt=0)] | None = None
    frequency: Literal["match", "interpolate", "scale"] = "match"


class Basis(Section):
    """The linear basis of the inferred beam."""

    kind: Literal["fourier-bessel", "zernike"] = "fourier-bessel"
    form: Literal["real", "complex"] = "real"
    n_modes: Annotated[int, Field(ge=1)] = 1024
    k_max: Annotated[int, Field(ge=1)] = 80
    m_max: Annotated[int, Field(ge=0)] = 45
    edge: Annotated[Degrees, Field(ge=90, le=180)] = 92.0
    boundary: Literal["dirichlet", "neumann"] = "dirichlet"
    max_degree: Annotated[int, Field(ge=0)] = 30


class Prior(Section):
    """The Gaussian prior on the coefficients."""

    kind: Literal["fraction", "flat", "file"] = "fraction"
    fraction: Annotated[float, Field(gt=0)] = 1.0
    floor: Annotated[float, Field(ge=0)] = 0.0
    file: Path | None = None

    @model_validator(mode="after")
    def _has_what_it_needs(self) -> Self:
        if (self.kind == "file") != (self.file is not None):
            raise ValueError("kind = 'file' and file = '...' go together")
        return self


class Solver(Section):
    """How the design matrix is computed."""

    engine: Literal["gemm", "nufft"] = "gemm"
    compress: bool = True


class Output(Section):
    """What is written beside the posterior mean and covariance."""

    draws: Annotated[int, Field(ge=0)] = 100


class Job(Section):
    """A whole job file."""

    name: str = "job"
    seed: Annotated[int, Field(ge=0)] = 0
    data: Data
    noise: Noise = Noise()
    holdout: Holdout = Holdout()
    sky: Sky = Sky()
    beam: Beam = Beam()
    basis: Basis = Basis()
    prior: Prior = Prior()
    solver: Solver = Solver()
    output: Output = Output()


def load_job(path: Path) -> Job:
    """Read and validate a job file; file names in it are relative to its folder.

    Raises
    ------
    InputError
        If it cannot be read, is not TOML, or a key is unknown, missing or of the wrong type or unit.
    """
    try:
        with path.open("rb") as file:
            table = tomllib.load(file)
    except OSError as error:
        raise InputError(f"cannot be read ({error.strerror})", file=path, remedy="check the path") from error
    except (tomllib.TOMLDecodeError, UnicodeDecodeError) as error:
        raise InputError(f"is not a TOML file ({error})", file=path, remedy="mend that line") from error
    try:
        return Job.model_validate(_with_absolute_paths(table, path.resolve().parent))
    except ValidationError as error:
        raise _as_input_error(error, path) from error


PATH_KEYS = (("data", "files"), ("data", "gains"), ("data", "simulate", "array", "file"), ("noise", "file"),
             ("sky", "file"), ("sky", "diffuse"), ("beam", "source"), ("prior", "file"))  # fmt: skip


def _with_absolute_paths(table: dict[str, Any], folder: Path) -> dict[str, Any]:
    """Resolve the file names of a job against the folder of the job file."""

    def resolve(value: Any) -> Any:
        if isinstance(value, list):
            return [resolve(item) for item in value]
        return str(folder / Path(value).expanduser()) if isinstance(value, str) else value

    for *parents, key in PATH_KEYS:
        section: Any = table
        for parent in parents:
            section = section.get(parent) if isinstance(section, dict) else None
        if isinstance(section, dict) and key in section and not _is_built_in(parents, section[key]):
            section[key] = resolve(section[key])
    return table


def _is_built_in(parents: list[str], value: Any) -> bool:
    """Tell a named beam from the path of a beam file."""
    return parents == ["beam"] and value in BUILT_IN_BEAMS


BUILT_IN_BEAMS = ("hera-vivaldi-131MHz", "gaussian", "airy")


def _as_input_error(error: ValidationError, path: Path) -> InputError:
    """Turn the first validation error into one line that names the key and, if misspelt, the nearest one."""
    first = error.errors()[0]
    location = [str(part) for part in first["loc"]]
    field = _name_of_key(location)
    if first["type"] == "extra_forbidden":
        known = _known_keys(location[:-1])
        near = difflib.get_close_matches(location[-1], known, n=1, cutoff=0.4)
        remedy = f"did you mean '{near[0]}'?" if near else f"known keys: {', '.join(known)}"
        return InputError("unknown key", file=path, field=field, remedy=remedy)
    if first["type"] == "missing":
        return InputError("is missing", file=path, field=field, remedy="add it, see the README's job file")
    message = first["msg"].removeprefix("Value error, ")
    given = "" if isinstance(first["input"], dict | BaseModel) else f", but is {first['input']!r}"
    return InputError(f"{message[0].lower()}{message[1:]}{given}", file=path, field=field, remedy="correct the value")


def _name_of_key(location: list[str]) -> str:
    """Write a key as the job file shows it, ``[section] key``."""
    if len(location) == 1:
        return f"[{location[0]}]" if location[0] in Job.model_fields and location[0] not in ("name", "seed") else location[0]
    tables = location[:-1] if not location[-1].isdigit() else location[:-2]
    keys = location[len(tables) :]
    return f"[{'.'.join(tables)}] {'.'.join(keys)}" if tables else ".".join(keys)


def _known_keys(parents: list[str]) -> list[str]:
    """List the keys of the section at ``parents``."""
    model: type[BaseModel] = Job
    for name in parents:
        annotation = model.model_fields[name].annotation
        candidates = [annotation, *getattr(annotation, "__args__", ())]
        model = next(item for item in candidates if isinstance(item, type) and issubclass(item, BaseModel))
    return list(model.model_fields)
