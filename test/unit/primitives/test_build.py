# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""Demonstrations to a primitive."""

from dataclasses import replace

import numpy as np
import pytest
from support.arm import JOINTS, arm_demonstrations, arm_primitive

from mp_pca_planner.exceptions import PrimitiveError
from mp_pca_planner.motion.interpolation import boundary_values, hermite_functions
from mp_pca_planner.primitives.build import PrimitiveOptions, build_primitive
from mp_pca_planner.primitives.motion_statistics import shape_functions, shape_smoother
from mp_pca_planner.primitives.timing import aligned_positions
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


@pytest.mark.parametrize("coupling", ["arm", "joint"])
def test_weights_bring_every_demonstration_back_to_the_stated_residual(coupling):
    primitive = arm_primitive(coupling)
    phases = np.linspace(0.0, 1.0, 101)
    for i, demonstration in enumerate(arm_demonstrations()):
        states = primitive.boundary_states[i]
        values = boundary_values(tuple(states[:3]), tuple(states[3:]), primitive.durations[i])
        motion = hermite_functions(phases) @ values
        motion += primitive.basis.shape(primitive.weights[i], phases)
        error = motion - aligned_positions(demonstration, primitive.warps[i], phases)
        np.testing.assert_allclose(
            np.sqrt(np.mean(error**2, axis=0)), primitive.fit_residual[i], atol=1e-9
        )
    assert np.rad2deg(primitive.fit_residual).max() < 1.5


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


def test_smoothing_leaves_half_of_a_wave_of_a_fifth_and_nearly_all_of_a_slow_one():
    functions, _ = shape_functions(25, 201)
    phases = np.linspace(0.0, 1.0, 201)
    for waves, low, high in ((1.0, 0.98, 1.0), (5.0, 0.3, 0.7), (10.0, 0.0, 0.15)):
        wave = np.sin(np.pi * phases) ** 4 * np.cos(2.0 * np.pi * waves * phases)
        coefficients = wave @ functions
        smooth = coefficients @ shape_smoother(25, 201)
        assert low < smooth @ coefficients / (coefficients @ coefficients) < high


def test_enough_components_reproduce_the_demonstrations():
    primitive = build_primitive(
        arm_demonstrations(), "all", PrimitiveOptions(n_components=19, degree=25)
    )
    assert np.rad2deg(primitive.fit_residual).max() < 0.15  # what is left is tremor


@pytest.mark.parametrize("coupling", ["arm", "joint"])
def test_shares_are_the_eigenvalues_over_the_variance_of_the_shapes(coupling):
    primitive = arm_primitive(coupling)
    shares = primitive.explained_variance_ratio
    assert list(shares) == (["arm"] if coupling == "arm" else list(JOINTS))
    for values in shares.values():
        assert len(values) == 4
        assert np.all(np.diff(values) <= 0.0) and 0.95 < sum(values) <= 1.0
    np.testing.assert_allclose(
        primitive.weights.var(axis=0, ddof=1), primitive.explained_variance, rtol=1e-9
    )


def test_joint_coupling_moves_one_joint_per_component():
    primitive = arm_primitive("joint")
    moved = np.abs(primitive.component_coefficients).max(axis=2) > 0.0
    assert moved.sum(axis=1).tolist() == [1] * 16
    assert primitive.joint_of_component == tuple(np.repeat(range(4), 4))


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


def test_one_demonstration_gives_its_shape_and_no_components():
    primitive = build_primitive(arm_demonstrations()[:1], "single")
    assert primitive.n_components == 0
    assert np.rad2deg(primitive.fit_residual).max() < 0.5


def test_the_fewest_components_for_a_share_of_the_variance_are_kept():
    shares = [
        build_primitive(
            arm_demonstrations(), "x", PrimitiveOptions(n_components=k)
        ).explained_variance_ratio["arm"]
        for k in (1, 2, 3)
    ]
    wanted = sum(shares[1]) - 1e-6
    primitive = build_primitive(arm_demonstrations(), "x", PrimitiveOptions(variance=wanted))
    assert primitive.n_components == 2


def test_the_same_demonstrations_in_another_order_span_the_same_family():
    one = arm_primitive()
    other = build_primitive(arm_demonstrations()[::-1], "x", PrimitiveOptions(n_components=4))
    np.testing.assert_allclose(other.component_coefficients, one.component_coefficients, atol=1e-8)


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"coupling": "leg"}, "coupling"),
        ({"align": "fourier"}, "align must be one of .*'arc_length'.*'fourier'"),
        ({"n_components": 0}, "components must be a whole number of at least 1"),
        ({"variance": 0.0}, "variance must be a number from 1e-09 to 1"),
        ({"variance": float("nan")}, "variance"),
        ({"degree": 5}, "degree .* from 6 to 30"),
        ({"degree": 31}, "degree"),
        ({"n_phases": 20}, "at least twice the degree"),
    ],
)
def test_options_out_of_range_are_refused(options, message):
    with pytest.raises(PrimitiveError, match=message):
        PrimitiveOptions(**options)


def test_nothing_to_learn_from_is_refused():
    with pytest.raises(PrimitiveError, match="there is no demonstration"):
        build_primitive([], "x")
    demonstration = arm_demonstrations()[0]
    for joint in range(4):
        demonstration = still(demonstration, joint)
    with pytest.raises(PrimitiveError, match="no joint moves"):
        build_primitive([demonstration], "x")


@pytest.mark.parametrize("name", [None, ["reach"]], ids=["None", "list"])
def test_name_that_is_no_text_is_refused(name):
    with pytest.raises(PrimitiveError, match="the name of a primitive must be a str"):
        build_primitive(arm_demonstrations(), name)


def test_demonstrations_of_other_joints_are_refused_by_name():
    other = Demonstration(
        ("a",),
        [0.0, 1.0],
        [[0.0], [1.0]],
        [[0.0], [0.0]],
        [[0.0], [0.0]],
        recording="stranger",
        start_time=0.0,
        end_time=1.0,
    )
    with pytest.raises(PrimitiveError, match="'stranger'"):
        build_primitive([arm_demonstrations()[0], other], "x")
