# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""Demonstrations to a primitive."""

from dataclasses import replace

import numpy as np
import pytest
from support.arm import JOINTS, arm_demonstrations, arm_primitive

from mp_pca_planner.exceptions import PrimitiveError
from mp_pca_planner.primitives.build import PrimitiveOptions, build_primitive
from mp_pca_planner.recordings.demonstration import Demonstration


def still(demonstration, joint):
    """The same motion with one joint standing still."""
    arrays = [x.copy() for x in (demonstration.positions, demonstration.velocities)]
    arrays.append(demonstration.accelerations.copy())
    for array, value in zip(arrays, (0.3, 0.0, 0.0), strict=True):
        array[:, joint] = value
    return Demonstration(
        JOINTS, demonstration.times, *arrays, recording="still", start_time=0.0, end_time=1.0
    )


def cut_off(motion: Demonstration, share: float) -> Demonstration:
    """A motion without its slow ends, as where the speed between two motions is no rest."""
    n = round(share * motion.times.size)
    inner = slice(n, motion.times.size - n)
    return replace(
        motion,
        times=motion.times[inner] - motion.times[n],
        **{
            name: getattr(motion, name)[inner]
            for name in ("positions", "velocities", "accelerations")
        },
    )


def test_motions_that_are_cut_off_teach_no_jerk():
    demonstrations = [cut_off(motion, 0.12) for motion in arm_demonstrations()]
    primitive = build_primitive(demonstrations, "cut off")
    for demonstration in demonstrations:
        start, goal = demonstration.positions[[0, -1]]
        motion = primitive.predict(start, goal)
        jerk = np.diff(motion.accelerations, axis=0) / np.diff(motion.times)[:, None]
        minimum_jerk = 60.0 * np.abs(goal - start).max() / motion.duration**3
        assert np.abs(jerk).max() < 15.0 * minimum_jerk


@pytest.mark.parametrize("coupling", ["arm", "joint"])
def test_a_joint_that_never_moves_gets_no_component_and_no_nan(coupling):
    demonstrations = [still(d, 2) for d in arm_demonstrations()]
    primitive = build_primitive(demonstrations, "still", PrimitiveOptions(coupling=coupling))
    assert np.abs(primitive.component_coefficients[:, 2]).max() < 1e-30
    assert np.abs(primitive.mean_coefficients[2]).max() < 1e-15
    for owner in (primitive, primitive.model):
        for array in vars(owner).values():
            assert not (isinstance(array, np.ndarray) and np.isnan(array).any())
    if coupling == "joint":
        assert primitive.explained_variance_ratio[JOINTS[2]] == []


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"coupling": "leg"}, "coupling"),
        ({"n_components": 0}, "components must be a whole number of at least 1"),
        ({"degree": 31}, "degree .* from 6 to 30"),
    ],
)
def test_options_out_of_range_are_refused(options, message):
    with pytest.raises(PrimitiveError, match=message):
        PrimitiveOptions(**options)


@pytest.mark.parametrize("coupling", ["arm", "joint"])
def test_shares_are_the_eigenvalues_over_the_variance_of_the_shapes(coupling):
    primitive = arm_primitive(coupling)
    shares = primitive.explained_variance_ratio
    assert list(shares) == (["arm"] if coupling == "arm" else list(JOINTS))
    for values in shares.values():
        assert len(values) == 4
        assert np.all(np.diff(values) <= 0.0) and 0.95 < sum(values) <= 1.0
    variances = primitive.weights.var(axis=0, ddof=1)
    np.testing.assert_allclose(variances, primitive.explained_variance, rtol=1e-9)
    if coupling == "joint":
        moved = np.abs(primitive.component_coefficients).max(axis=2) > 0.0
        assert moved.sum(axis=1).tolist() == [1] * 16
        assert primitive.joint_of_component == tuple(np.repeat(range(4), 4))
    else:
        options = PrimitiveOptions(variance=sum(shares["arm"][:2]) - 1e-6)
        assert build_primitive(arm_demonstrations(), "x", options).n_components == 2


def test_what_can_not_be_learned_from_is_refused():
    motion = arm_demonstrations()[0]
    stranger = replace(motion, joint_names=tuple("abcd"), recording="stranger")
    resting = motion
    for joint in range(4):
        resting = still(resting, joint)
    for given, name, message in (
        ([], "x", "there is no demonstration"),
        ([resting], "x", "no joint moves"),
        ([motion], None, "the name of a primitive must be a str"),
        ([motion, stranger], "x", "joints of 'stranger'.*are not those of 'motion_0'"),
    ):
        with pytest.raises(PrimitiveError, match=message):
            build_primitive(given, name)
    assert build_primitive([motion] * 11, "copies").n_components == 0
