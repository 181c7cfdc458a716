# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""Statistics of demonstrations: what is kept of them is enough, and can be merged."""

import numpy as np
import pytest
from numpy.polynomial import legendre
from support.arm import JOINTS, arm_demonstrations

from mp_pca_planner.motion.interpolation import boundary_values, hermite_functions
from mp_pca_planner.primitives.build import PrimitiveOptions, build_primitive
from mp_pca_planner.primitives.timing import own_phases

PHASES = np.linspace(0.0, 1.0, 101)


def sampled_shapes(demonstrations, primitive):
    """Shapes of all at once, shape (n_demonstrations, n_phases, n_joints)."""
    shapes = []
    for i, motion in enumerate(demonstrations):
        state = primitive.boundary_states[i]
        ends = boundary_values(tuple(state[:3]), tuple(state[3:]), motion.duration)
        aligned = motion.at(motion.duration * own_phases(primitive.warps[i], PHASES))
        shapes.append(aligned - hermite_functions(PHASES) @ ends)
    return np.array(shapes)


def polynomial_part(shapes):
    """Their least-squares fits of degree 15 with six conditions at the ends, another way."""
    s = PHASES[:, None]
    powers = (s * (1 - s)) ** 3 * legendre.legvander(2 * PHASES - 1, 9)
    fitted = np.linalg.lstsq(powers, np.moveaxis(shapes, 1, 0).reshape(101, -1), rcond=None)[0]
    return np.moveaxis((powers @ fitted).reshape(101, len(shapes), -1), 0, 1)


def smoothed(curves):
    """Curves of such polynomials, shape (101, n), with less jerk, most of all near their ends."""
    bump = legendre.Legendre([1.0]) * (1 - legendre.Legendre([0.0, 1.0]) ** 2) ** 3
    several = [bump * legendre.Legendre.basis(k) for k in range(10)]
    values = np.column_stack([one(2 * PHASES - 1) for one in several])
    jerks = 8 * np.column_stack([one.deriv(3)(2 * PHASES - 1) for one in several])
    prices = np.where(np.abs(PHASES - 0.5) > 0.4, 3e-8, 1e-9)
    rows = np.concatenate([values, np.sqrt(prices)[:, None] * jerks])
    return values @ np.linalg.lstsq(rows, np.vstack([curves, 0 * curves]), rcond=None)[0]


@pytest.mark.parametrize("method", ["linear", "arc_length"])
def test_primitive_has_the_covariances_of_the_samples(method):
    demonstrations = arm_demonstrations(40, 2)
    options = PrimitiveOptions(n_components=5, align=method)
    primitive = build_primitive(demonstrations, "x", options)
    shapes = sampled_shapes(demonstrations, primitive)
    fitted = polynomial_part(shapes)
    vectors = fitted.reshape(40, -1)
    values, components = np.linalg.eigh(np.cov(vectors, rowvar=False))
    np.testing.assert_allclose(primitive.explained_variance, values[::-1][:5], rtol=1e-9)
    found = primitive.basis.functions(PHASES).reshape(-1, 5)
    by_joint = components[:, ::-1][:, :5].reshape(101, -1)
    smooth = smoothed(by_joint).reshape(found.shape)
    signs = np.sign(np.sum(found * smooth, axis=0))
    np.testing.assert_allclose(found, smooth * signs, atol=1e-6)
    exact = components[:, ::-1][:, :5] * signs
    weights = (vectors - vectors.mean(axis=0)) @ exact
    np.testing.assert_allclose(primitive.weights, weights, atol=1e-9)
    # What the polynomials leave counts as variance that is not explained.
    deviations = np.sum((shapes - fitted.mean(axis=0)) ** 2, axis=(0, 1))
    np.testing.assert_allclose(primitive.total_variance, deviations / 39, rtol=1e-9)
    reproduced = np.array([primitive.basis.shape(w, PHASES) for w in primitive.weights])
    residual = np.sqrt(np.mean((shapes - reproduced) ** 2, axis=1))
    np.testing.assert_allclose(primitive.fit_residual, residual, atol=1e-9)


def test_shares_of_joint_angles_are_those_of_the_sampled_angles():
    primitive = build_primitive(arm_demonstrations(), "x")
    angles = np.array([d.time_normalised(101) for d in arm_demonstrations()])
    for joint, name in enumerate(JOINTS):
        values = np.linalg.eigvalsh(np.cov(angles[:, :, joint], rowvar=False))[::-1]
        shares = primitive.metadata["angle_variance_ratio"][name]
        np.testing.assert_allclose(shares, values[:4] / values.sum(), atol=1e-5)
