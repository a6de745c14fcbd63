"""How Fourier-Bessel functions are put together: which products make the columns, and which columns a function."""

from __future__ import annotations

from itertools import groupby
from typing import Any

import numpy as np


def complex_columns(modes: list[tuple[int, int]]) -> list[tuple[int, int]]:
    """List the cosine (m >= 0) and sine (m < 0) columns that complex modes need, side by side for one m."""
    needed = sorted({(abs(m), k) for k, m in modes})
    columns: list[tuple[int, int]] = []
    for m, group in groupby(needed, key=lambda entry: entry[0]):
        ks = [k for _, k in group]
        columns += [(k, m) for k in ks]
        columns += [(k, -m) for k in ks if m]
    return columns


def plan_products(k_row: list[int], m_row: list[int]) -> list[tuple[Any, Any, Any]]:
    """List which radial and azimuthal rows make which columns, in few products.

    One product makes either the columns of consecutive k at one m, or cosine and sine of one (k, |m|).
    """
    rows = list(zip(k_row, m_row, strict=True))
    plan: list[tuple[Any, Any, Any]] = []
    start = 0
    while start < len(rows):
        k, m = rows[start]
        length = 1
        while rows[start + length : start + length + 1] == [(k + length, m)]:
            length += 1
        if length == 1 and m % 2 == 0 and rows[start + 1 : start + 2] == [(k, m + 1)]:
            plan.append((slice(start, start + 2), k, slice(m, m + 2)))
            start += 2
        else:
            plan.append((slice(start, start + length), slice(k, k + length), m))
            start += length
    return plan


def plan_mixing(modes: list[tuple[int, int]], columns: list[tuple[int, int]]) -> tuple[Any, Any, Any]:
    """Return, for every mode, its cosine column, its sine column and the factor i sign(m) of the latter."""
    index = {column: i for i, column in enumerate(columns)}
    cos = np.array([index[k, abs(m)] for k, m in modes])
    sin = np.array([index[k, -abs(m)] for k, m in modes])
    return cos, sin, np.array([1j * np.sign(m) for _, m in modes])
