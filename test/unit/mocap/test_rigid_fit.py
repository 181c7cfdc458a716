# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""The pose of a rigid body against SciPy's own solution and known poses."""

import numpy as np
from scipy.spatial.transform import Rotation

from mp_pca_planner.mocap.marker_joint_states import fit_poses, fix_a_pose

RNG = np.random.default_rng(3)
TURNS = Rotation.random(8, random_state=4)
SHIFTS = RNG.normal(size=(8, 3))
TRIANGLE = np.array([[0.0, 0.0, 0.0], [0.0, 0.0, 0.1], [0.0, -0.1, 0.0]])


def placed(points: np.ndarray) -> np.ndarray:
    return np.einsum("kij,pj->kpi", TURNS.as_matrix(), points) + SHIFTS[:, None]


def test_noisy_points_give_the_weighted_least_squares_of_scipy() -> None:
    points = RNG.normal(size=(6, 3))
    measured = placed(points) + 0.05 * RNG.normal(size=(8, 6, 3))
    weights = RNG.uniform(0.1, 2.0, size=(8, 6))
    rotations, translations = fit_poses(points, measured, weights)
    for k in range(8):
        w = weights[k][:, None] / weights[k].sum()
        centres = (w * measured[k]).sum(0), (w * points).sum(0)
        there, here = measured[k] - centres[0], points - centres[1]
        expected, _ = Rotation.align_vectors(there, here, weights=weights[k])
        np.testing.assert_allclose(rotations[k], expected.as_matrix(), atol=1e-9)
        np.testing.assert_allclose(translations[k], centres[0] - expected.apply(centres[1]))
    mirrored, _ = fit_poses(points, placed(points * [1.0, 1.0, -1.0]), weights)
    np.testing.assert_allclose(np.linalg.det(mirrored), 1.0, atol=1e-12)


def test_two_points_or_points_on_a_line_fix_no_pose() -> None:
    line = np.outer([0.0, 1.0, 2.0, 5.0], [1.0, 2.0, 3.0])
    assert not fix_a_pose(line, np.ones((1, 4)))[0]
    weights = np.array([[1.0, 1.0, 1.0], [1.0, 0.0, 1.0], [0.0, 0.0, 0.0]])
    assert fix_a_pose(TRIANGLE, weights).tolist() == [True, False, False]
    rotations, translations = fit_poses(TRIANGLE, placed(TRIANGLE)[:3], weights)
    assert np.isnan(rotations).all(axis=(1, 2)).tolist() == [False, True, True]
    assert np.isnan(translations).all(axis=1).tolist() == [False, True, True]
