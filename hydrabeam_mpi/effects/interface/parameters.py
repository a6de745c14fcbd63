"""The parameters of an effect: what they are called, how large they may be, and to which things they belong."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from hydrabeam_mpi.data.observation import BoolArray, FloatArray, IntArray


@dataclass(frozen=True)
class Parameters:
    """The real parameters of an effect, the same on every rank.

    Attributes
    ----------
    names : tuple of str
        In words, such as "antenna 23 amplitude".
    units : tuple of str
        Such as "ns"; "" for pure numbers. Parameters are stored in these units.
    scale : ndarray, (n_params,)
        Natural sizes: the prior is x_p ~ N(0, (tau scale_p)^2) with tau found from the data.
    element : ndarray of int, (n_params,)
        The thing (antenna, baseline, source ...) that each parameter belongs to, numbered from 0. Elements may be at
        fault one by one.
    nonlinear : ndarray of bool, (n_params,)
        True for parameters with no derivative at x = 0, such as the position of a source without flux. They are left
        out of the search and fitted once the effect is part of the model.
    trials : int
        Number of elements from which these were picked; the number of elements where there was no scan.
    nested : bool
        Whether elements are in an order in which none is zero if a later one is not.
    rare_above : float
        Size, in units of ``scale``, that no more than one element is expected to exceed, by what is known of them.
    across : ndarray of int, (n_params,), optional
        Numbers of sets across all elements, such as what changes with one function of time, each of a width of its own.
    across_trials : int
        Number of sets from which these were picked.
    sort : ndarray of int, (n_params,), optional
        Numbers of the sorts that each element has one of, such as amplitude and phase. All of a sort may be zero.
    """

    names: tuple[str, ...]
    units: tuple[str, ...]
    scale: FloatArray
    element: IntArray
    nonlinear: BoolArray
    trials: int
    nested: bool = False
    rare_above: float = np.inf
    across: IntArray | None = None
    across_trials: int = 0
    sort: IntArray | None = None

    @classmethod
    def of(
        cls,
        names: Sequence[str],
        units: Sequence[str] | str,
        scale: FloatArray | float,
        element: IntArray | Sequence[int] | None = None,
        nonlinear: Sequence[bool] | None = None,
        trials: int | None = None,
    ) -> Parameters:
        """Fill in defaults: one unit and one scale for all; all parameters of one element; nothing refined later.

        Arrays are (n_params,).
        """
        n = len(names)
        element = np.zeros(n, dtype=int) if element is None else np.asarray(element, dtype=int)
        return cls(
            tuple(names),
            (units,) * n if isinstance(units, str) else tuple(units),
            np.broadcast_to(np.asarray(scale, dtype=float), n).copy(),
            element,
            np.zeros(n, dtype=bool) if nonlinear is None else np.asarray(nonlinear, dtype=bool),
            trials if trials is not None else (int(element.max()) + 1 if n else 0),
        )

    def __len__(self) -> int:
        return len(self.names)
