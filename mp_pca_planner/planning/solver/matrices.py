# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""Symmetric matrices of programs: dense arrays, and chains of overlapping blocks.

A program of many segments has a Hessian that is a sum of blocks, one per segment, each over a slice
of the unknowns. It is factorised as a band, so that a step takes time linear in the number of
segments; the unknown part of the Hessian is estimated block by block (Griewank and Toint,
"Partitioned variable metric updates", Numerische Mathematik 39, 1982).
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
from scipy.linalg import lapack

from ...arrays import FloatArray


@dataclass(frozen=True, eq=False)
class BlockMatrix:
    """A sum of symmetric blocks on overlapping slices, neighbours along the diagonal.

    Attributes
    ----------
    slices : tuple of slice
        Rows and columns of each block, in increasing order; together they cover the matrix.
    blocks : tuple of array
        Symmetric matrices of the sizes of the slices.
    """

    slices: tuple[slice, ...]
    blocks: tuple[FloatArray, ...]

    @property
    def size(self) -> int:
        """Number of rows."""
        return int(self.slices[-1].stop)

    def __mul__(self, factor: float) -> BlockMatrix:
        return replace(self, blocks=tuple(factor * block for block in self.blocks))

    def __matmul__(self, vector: FloatArray) -> FloatArray:
        product = np.zeros(self.size)
        for where, block in zip(self.slices, self.blocks, strict=True):
            product[where] += block @ vector[where]
        return product

    def dense(self) -> FloatArray:
        """The matrix as an array, shape (size, size)."""
        whole = np.zeros((self.size, self.size))
        for where, block in zip(self.slices, self.blocks, strict=True):
            whole[where, where] += block
        return whole

    def lower_band(self) -> FloatArray:
        """The diagonal and the diagonals below it, shape (bandwidth + 1, size)."""
        band = np.zeros((max(map(len, self.blocks)), self.size))
        for where, block in zip(self.slices, self.blocks, strict=True):
            for d in range(len(block)):
                band[d, where.start : where.stop - d] += np.diagonal(block, -d)
        return band


Matrix = FloatArray | BlockMatrix
"""A symmetric matrix of a program."""


class Factor(NamedTuple):
    """A Cholesky factor L of a matrix H = LLᵀ.

    Attributes
    ----------
    lower : array
        L, or its diagonals.
    is_band : bool
        Whether `lower` holds diagonals.
    """

    lower: FloatArray
    is_band: bool

    def solve_lower(self, right: FloatArray) -> FloatArray:
        """L⁻¹ times a matrix or vector."""
        return self._solve(right, 0)

    def solve_upper(self, right: FloatArray) -> FloatArray:
        """L⁻ᵀ times a matrix or vector."""
        return self._solve(right, 1)

    def solve(self, right: FloatArray) -> FloatArray:
        """H⁻¹ times a matrix or vector."""
        return self.solve_upper(self.solve_lower(right))

    def _solve(self, right: FloatArray, transposed: int) -> FloatArray:
        if self.is_band:
            side = b"T" if transposed else b"N"
            found, _ = lapack.dtbtrs(self.lower, right, uplo=b"L", trans=side)
            return np.asarray(found).reshape(right.shape)
        found, _ = lapack.dtrtrs(self.lower, right, lower=1, trans=transposed)
        return np.asarray(found)


def cholesky(matrix: Matrix, shift: float = 0.0) -> Factor | None:
    """The factor of H + shift·I; None if that is not positive definite."""
    if isinstance(matrix, BlockMatrix):
        band = matrix.lower_band()
        band[0] += shift
        lower, failed = lapack.dpbtrf(band, lower=1)
        return None if failed else Factor(lower, True)
    lower, failed = lapack.dpotrf(shifted(matrix, shift), lower=1)
    return None if failed else Factor(lower, False)


def shifted(matrix: FloatArray, shift: float) -> FloatArray:
    """H + shift·I of an array."""
    return matrix + shift * np.eye(len(matrix)) if shift else matrix


def added(first: Matrix, second: Matrix) -> Matrix:
    """The sum of two matrices of the same kind."""
    if isinstance(first, BlockMatrix):
        assert isinstance(second, BlockMatrix)
        blocks = map(np.add, first.blocks, second.blocks)
        return replace(first, blocks=tuple(blocks))
    return np.asarray(np.add(first, as_array(second)))


def as_array(matrix: Matrix) -> FloatArray:
    """The matrix as an array."""
    return matrix.dense() if isinstance(matrix, BlockMatrix) else matrix


def mean_diagonal(matrix: Matrix) -> float:
    """Mean of the diagonal."""
    if isinstance(matrix, BlockMatrix):
        return sum(float(np.trace(block)) for block in matrix.blocks) / matrix.size
    return float(np.trace(matrix)) / len(matrix)
