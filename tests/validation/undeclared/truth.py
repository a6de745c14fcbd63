"""What is so, as far as it differs from what the files say."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from tests.validation.undeclared.beams import FloatArray, Shape
from tests.validation.undeclared.setting import Catalogue, Setting

ComplexArray = NDArray[np.complex128]
Corruption = Callable[[ComplexArray], ComplexArray]


@dataclass
class Truth:
    """The instrument and the sky as they are. Effects change it; `simulator.visibilities` observes with it.

    Attributes
    ----------
    setting : Setting
        What the files say.
    shapes : list of Shape
        Each antenna's beam.
    antpos : ndarray, (Nants, 3)
        Where the antennas stand, metres ENU.
    clock : float or ndarray, (Ntimes,)
        Seconds by which the data were taken later than the file says.
    integration : float
        Seconds over which they are means; zero for instants.
    catalogue : Catalogue
    sky_of : list of callable
        (channel, time index, catalogue) -> catalogue, for skies that change.
    shape_of : callable, optional
        (channel, time index, shape) -> shape, for beams that change.
    shape_of_antenna : dict of int to callable
        The same of single antennas, by index.
    corruptions : list of callable
        Applied one after another to all correlations (Nfreqs, Ntimes, Nants, Nants), autocorrelations included.
    noise : list of callable
        (noise, rng) -> noise, of the visibilities, (Nfreqs, Ntimes, Nbls), which comes in units of sigma.
    filed : list of callable
        (data) -> data, the last thing before the file: conventions.
    filed_autos : list of callable
        The same of the autocorrelations, (Nfreqs, Ntimes, Nants).
    leakage : ndarray, (Nants, 2), optional
        What of the other feed gets into feed East and into feed North; the file then has all four polarisations.
    """

    setting: Setting
    shapes: list[Shape]
    antpos: FloatArray
    catalogue: Catalogue
    clock: float | FloatArray = 0.0
    integration: float = 0.0
    sky_of: list[Callable[[int, int, Catalogue], Catalogue]] = field(default_factory=list)
    shape_of: Callable[[int, int, Shape], Shape] | None = None
    shape_of_antenna: dict[int, Callable[[int, int, Shape], Shape]] = field(default_factory=dict)
    corruptions: list[Corruption] = field(default_factory=list)
    noise: list[Callable[[ComplexArray, np.random.Generator], ComplexArray]] = field(default_factory=list)
    filed: list[Corruption] = field(default_factory=list)
    filed_autos: list[Callable[[FloatArray], FloatArray]] = field(default_factory=list)
    leakage: ComplexArray | None = None

    @classmethod
    def of(cls, setting: Setting, shape: Shape) -> Truth:
        """Nothing is wrong; the beam is not the job's."""
        return cls(setting, [shape] * setting.n_ants, setting.antpos.copy(), setting.catalogue)

    @property
    def changes(self) -> bool:
        """Whether sky or beam change with time or frequency in ways of their own."""
        return bool(self.sky_of or self.shape_of_antenna) or self.shape_of is not None

    def shapes_at(self, channel: int, time: int) -> list[Shape]:
        """Return each antenna's beam; those that share one go on sharing it."""
        shapes = list(self.shapes)
        if self.shape_of is not None:
            changed = {id(shape): self.shape_of(channel, time, shape) for shape in shapes}
            shapes = [changed[id(shape)] for shape in shapes]
        for antenna, change in self.shape_of_antenna.items():
            shapes[antenna] = change(channel, time, shapes[antenna])
        return shapes

    def time(self, index: int) -> float:
        """Return when an integration was really taken, JD."""
        return float((self.setting.times + self.clock / 86400)[index])
