# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""The planning method of [P], Section 4.

One PCA of the joint angles themselves for each joint; mean and components as fourth-order
polynomials; motions m(s) + Σ wₖ φₖ(s) whose end points are linear equality constraints on the
weights. Velocities at the ends are free, since [P] states no constraint on them. The weights that
meet the constraints are an affine space, whose coordinates are the unknowns: for every joint, their
number is that of the components kept minus two.
"""

from __future__ import annotations

import time
from collections.abc import Sequence

import numpy as np
from numpy.polynomial import legendre
from scipy.linalg import null_space

from ..arrays import FloatArray
from ..planning.compiler import MotionProgram
from ..planning.constraints import LimitedProgram, LimitTables
from ..planning.solver import solve
from ..planning.unknowns import QuadratureTables, Unknowns
from ..primitives.basis import PolynomialBasis, legendre_values
from ..primitives.differences import FINE_PHASES
from ..primitives.pca import PrincipalComponents, fit_components
from ..recordings.demonstration import Demonstration
from ..robot.limits import JointLimits
from ..robot.model import Robot
from .naturalness import Prediction, Predictor

TABLE_2 = {
    "shoulder1": (0.9249, 0.0639, 0.0082, 0.0013),
    "shoulder2": (0.8237, 0.1265, 0.0369, 0.0081),
    "shoulder3": (0.8563, 0.1190, 0.0190, 0.0029),
    "elbow": (0.7436, 0.2350, 0.0165, 0.0028),
}
"""[P] Table 2: shares of the first four components, joint by joint of the paper's arm."""

TABLE_3 = {"B-spline": (5.19594, 148.975), "PCA": (9.58805, 96.509)}
"""[P] Table 3: objective function value, and optimisation time [s]."""

N_COMPONENTS = 4
DEGREE = 4
_N_PHASES = 101


def angle_components(motions: Sequence[Demonstration]) -> list[PrincipalComponents]:
    """Components of the joint angles over time, joint by joint ([P] eq. (1)–(5))."""
    angles = np.array([motion.time_normalised(_N_PHASES) for motion in motions])
    return [fit_components(angles[:, :, j]) for j in range(angles.shape[2])]


def paper_basis(
    components: Sequence[PrincipalComponents], start: FloatArray, goal: FloatArray
) -> PolynomialBasis:
    """The basis of all motions between two positions that the components can represent.

    Parameters
    ----------
    components :
        Of each joint, see :func:`angle_components`.
    start, goal : array, shape (n_joints,)
        Positions [rad or m].

    Returns
    -------
    basis : PolynomialBasis
        Its mean is the likeliest of these motions; its weights, of unit variance, are those of
        the others. Unlike other bases, its functions include the boundary part.
    """
    n_joints, phases = len(components), np.array([0.0, 1.0])
    means, functions = [], []
    for j, found in enumerate(components):
        kept = found.truncated(N_COMPONENTS)
        # Scaled by standard deviations, so that the shortest vector of weights is the likeliest.
        scaled = kept.components * np.sqrt(kept.explained_variance)[:, None]
        mean, polynomials = _polynomials(kept.mean), _polynomials(scaled)
        at_ends = legendre_values(polynomials, phases).reshape(2, -1)
        missing = np.array([start[j], goal[j]]) - legendre_values(mean, phases)
        weights = np.linalg.lstsq(at_ends, missing, rcond=None)[0]
        means.append(mean + weights @ polynomials)
        for direction in null_space(at_ends).T if at_ends.size else ():
            function = np.zeros((n_joints, DEGREE + 1))
            function[j] = direction @ polynomials
            functions.append(function)
    return PolynomialBasis(
        np.array(means),
        np.reshape(functions, (-1, n_joints, DEGREE + 1)),
        np.ones(len(functions)),
    )


def paper_method(robot: Robot) -> Predictor:
    """The method of the paper, as a predictor for comparisons."""

    def predict(motion: Demonstration, others: Sequence[Demonstration]) -> Prediction:
        """Plan between the ends of a motion with its duration."""
        components = angle_components(others)
        start, goal = motion.positions[[0, -1]]
        began = time.perf_counter()
        basis = paper_basis(components, start, goal)
        nothing = np.zeros(basis.n_weights)
        # The basis includes the end points, so there is no boundary part.
        boundary = np.zeros((6, motion.n_joints))
        tables = QuadratureTables(basis)
        unknowns = Unknowns(tables.basis.scales, boundary, motion.duration)
        program = MotionProgram(robot, tables, unknowns, nothing)
        ends = np.zeros((2, 4, motion.n_joints))
        unlimited = JointLimits(robot.joint_names, {})
        solution = solve(LimitedProgram(program, LimitTables(tables), unlimited, ends), nothing)
        solve_time = time.perf_counter() - began
        positions = basis.shape(solution.unknowns, FINE_PHASES)
        return Prediction(positions, solution.cost, solve_time)

    return predict


def _polynomials(curves: FloatArray) -> FloatArray:
    """Legendre coefficients of least-squares fits to sampled curves, shape (..., degree + 1)."""
    x = np.linspace(-1.0, 1.0, _N_PHASES)
    return np.asarray(curves @ np.linalg.pinv(legendre.legvander(x, DEGREE)).T)
