# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""Kinds of motions in a heap."""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from support.motion_kinds import generate_kinds

from mp_pca_planner.exceptions import PrimitiveError
from mp_pca_planner.primitives.build import PrimitiveOptions
from mp_pca_planner.primitives.build_library import (
    OUTLIERS,
    adjusted_rand_index,
    build_library,
    library_content,
)
from mp_pca_planner.primitives.kinds import OUTLIER, KindOptions, find_kinds, kind_names
from mp_pca_planner.primitives.library import VersionedLibrary, check_name
from mp_pca_planner.primitives.motion_statistics import MotionStatistics, source_rows
from mp_pca_planner.primitives.prediction import left_out_squares
from mp_pca_planner.recordings.demonstration import Demonstration
from mp_pca_planner.recordings.synthetic import generate_motions
from mp_pca_planner.robot.model import Robot

N_PHASES = PrimitiveOptions().n_phases


@cache
def statistics(n_motions: int, n_kinds: int = 6, seed: int = 0) -> MotionStatistics:
    made = generate_kinds(n_motions, n_kinds, seed)
    motions = [
        replace(x, recording=f"r{i}", label=f"kind {i % n_kinds}", checksum=f"{i:064x}")
        for i, x in enumerate(made)
    ]
    return MotionStatistics.of(motions, PrimitiveOptions())


def reversed_motion(motion: Demonstration) -> Demonstration:
    return replace(
        motion,
        positions=motion.positions[::-1],
        velocities=-motion.velocities[::-1],
        accelerations=motion.accelerations[::-1],
    )


def true_kinds(n_motions: int, n_kinds: int = 6) -> np.ndarray:
    return np.arange(n_motions) % n_kinds


@pytest.mark.parametrize("seed", [0, 1, 2])
def test_kinds_are_those_that_the_motions_were_made_of(seed):
    kinds = find_kinds(statistics(60, seed=seed), N_PHASES)
    assert adjusted_rand_index(kinds.assigned, true_kinds(60)) > 0.95
    unrelated = np.random.default_rng(0).permutation(kinds.assigned)
    assert abs(adjusted_rand_index(unrelated, true_kinds(60))) < 0.1


def test_motions_beyond_the_tree_join_the_kinds_that_it_finds():
    found = find_kinds(statistics(300), N_PHASES, KindOptions(max_clustered=60))
    assert adjusted_rand_index(found.assigned, true_kinds(300)) > 0.95


@settings(max_examples=5)
@given(st.integers(0, 2**32 - 1))
def test_kinds_do_not_depend_on_the_order_of_the_motions(seed):
    order = np.random.default_rng(seed).permutation(60)
    one = find_kinds(statistics(60), N_PHASES).assigned[order]
    other = find_kinds(statistics(60).chosen(order), N_PHASES).assigned
    assert adjusted_rand_index(one, other) == 1.0


def test_a_motion_and_its_return_are_of_one_kind():
    motions = generate_kinds(60, 6, 0)
    motions = [reversed_motion(x) if i % 4 < 2 else x for i, x in enumerate(motions)]
    found = find_kinds(MotionStatistics.of(motions, PrimitiveOptions()), N_PHASES)
    assert adjusted_rand_index(found.assigned, true_kinds(60)) > 0.95


def test_motions_of_one_kind_are_not_divided():
    found = find_kinds(statistics(80, n_kinds=1), N_PHASES)
    assert np.all(found.assigned == 0)


def test_strangers_are_outliers():
    strangers = statistics(2, n_kinds=2, seed=9)
    found = find_kinds(MotionStatistics.merged([statistics(60), strangers]), N_PHASES)
    assert found.assigned[60:].tolist() == [OUTLIER, OUTLIER]
    assert not found.explained_by[60:].any()


@pytest.mark.parametrize("n", [1, 2, 4])
def test_few_motions_are_one_kind(n):
    found = find_kinds(statistics(6).chosen(range(n)), N_PHASES)
    assert found.assigned.tolist() == [0] * n
    assert found.positions.shape == (n, 2)


def test_left_out_squares_are_those_of_separate_fits():
    chosen = statistics(60).chosen(range(0, 60, 6))
    shapes = chosen.both_shapes()
    found = left_out_squares(chosen.requests(), shapes)
    # Only the weights of the kernels come from all motions: leaving one out hardly changes them.
    assert np.all(found < np.sum(shapes[0] ** 2, axis=1))


def test_the_adjusted_rand_index_is_that_of_its_paper():
    # Hubert and Arabie's definition, by counting pairs one by one.
    first, second = np.random.default_rng(3).integers(0, 3, (2, 40))
    pairs = [(i, j) for i in range(40) for j in range(i)]
    together = np.array([[x[i] == x[j] for i, j in pairs] for x in (first, second)])
    a, b = together.sum(axis=1)
    expected = a * b / len(pairs)
    index = (np.sum(together[0] & together[1]) - expected) / ((a + b) / 2 - expected)
    assert adjusted_rand_index(first, second) == pytest.approx(index)
    assert adjusted_rand_index(first, 7 - first) == 1.0


def test_a_library_has_a_primitive_for_each_kind_that_predicts_it_better_than_all_pooled():
    made = statistics(60)
    content = library_content(made, PrimitiveOptions())
    assert [len(x.durations) for x in content.primitives] == [10] * 6
    assert np.sqrt(np.mean(content.errors_alone**2)) < np.sqrt(np.mean(content.errors_pooled**2))
    assert content.label_agreement() == 1.0
    # By what most of them are called.
    assert {x.name for x in content.primitives} == {f"kind_{i}" for i in range(6)}


def test_kinds_keep_their_names_when_motions_are_added():
    first = library_content(replace_labels(statistics(60)), PrimitiveOptions())
    known = {x.name: x.statistics for x in first.primitives}
    more = library_content(replace_labels(statistics(120)), PrimitiveOptions(), known=known)
    assert {x.name for x in more.primitives} == set(known)
    for primitive in more.primitives:
        old = {m.checksum for m in known[primitive.name].motions}
        assert old <= {m.checksum for m in primitive.statistics.motions}


def replace_labels(made: MotionStatistics) -> MotionStatistics:
    return replace(made, sources=source_rows(m._replace(label="") for m in made.motions))


def gantry() -> Robot:
    """A robot whose joint positions are the place of its end effector."""
    inertial = '<mass value="1"/><inertia ixx="1" ixy="0" ixz="0" iyy="1" iyz="0" izz="1"/>'
    links = [f'<link name="l{i}"><inertial>{inertial}</inertial></link>' for i in range(4)]
    axes = {"x": "1 0 0", "y": "0 1 0", "z": "0 0 1"}
    joints = [
        f'<joint name="{name}" type="prismatic"><axis xyz="{axis}"/>'
        f'<parent link="l{i}"/><child link="l{i + 1}"/>'
        '<limit lower="-2" upper="2" velocity="9" effort="9"/></joint>'
        for i, (name, axis) in enumerate(axes.items())
    ]
    return Robot(f'<robot name="gantry">{"".join(links + joints)}</robot>')


def kind_of(*motions: tuple[list[float], list[float]], seconds: float = 1.0) -> MotionStatistics:
    """Statistics of minimum-jerk motions of the gantry between these places."""
    times = np.linspace(0.0, 1.0, 101)
    share = (10 - 15 * times + 6 * times**2) * times**3
    made = [
        Demonstration.from_arrays(
            ["x", "y", "z"],
            seconds * times,
            np.outer(1 - share, a) + np.outer(share, b),
            recording=f"{i}",
        )
        for i, (a, b) in enumerate(motions)
    ]
    return MotionStatistics.of(made, PrimitiveOptions())


RIGHT, LEFT = [0.5, -0.4, 0.2], [0.5, 0.4, 0.2]


def raised(place: list[float], height: float = 0.6) -> list[float]:
    return [*place[:2], place[2] + height]


def test_names_say_where_the_end_effector_goes_and_ends():
    low, high = kind_of((RIGHT, LEFT)), kind_of((raised(RIGHT), raised(LEFT)))
    back = kind_of((raised(LEFT), raised(RIGHT)))
    assert kind_names([low, high, back], robot=gantry()) == [
        "reach_left_low", "reach_left_high", "reach_right_high",
    ]  # fmt: skip


def test_names_say_how_far_from_the_base_and_on_which_side():
    near, far = [0.4, 0.0, 0.2], [0.9, 0.0, 0.2]
    lifts = [kind_of((x, raised(x))) for x in (near, far)]
    assert kind_names(lifts, robot=gantry()) == ["reach_up_near", "reach_up_far"]
    lifts = [kind_of((x, raised(x))) for x in (RIGHT, LEFT)]
    assert kind_names(lifts, robot=gantry()) == ["reach_up_at_right", "reach_up_at_left"]
    assert kind_names([kind_of((near, raised(near)))], robot=gantry()) == ["reach_up"]


def test_a_kind_with_returns_goes_both_ways():
    both = kind_of((RIGHT, LEFT), (LEFT, RIGHT))
    assert kind_names([both], robot=gantry()) == ["reach_left_and_right"]


def test_without_a_robot_names_say_which_joint_moves_most():
    kinds = [kind_of((RIGHT, LEFT)), kind_of((LEFT, RIGHT)), kind_of((LEFT, raised(LEFT)))]
    assert kind_names(kinds) == ["y_plus", "y_minus", "z_plus"]


def test_equal_kinds_get_distinct_names():
    ends = [0.5, -0.8, 0.2], [0.5, 0.0, 0.2]
    kinds = [kind_of(ends), kind_of(ends), kind_of(ends, seconds=2.0)]
    names = kind_names(kinds, ["reach_left"], gantry())
    assert names == ["reach_left_fast", "reach_left_fast_2", "reach_left_slow"]


@settings(max_examples=20)
@given(st.lists(st.text(max_size=90), min_size=2, max_size=4))
def test_names_are_distinct_and_valid_whatever_the_labels(labels):
    made = kind_of((RIGHT, LEFT))
    kinds = [
        replace(made, sources=source_rows(m._replace(label=label) for m in made.motions))
        for label in labels
    ]
    names = kind_names(kinds, [OUTLIERS], gantry())
    assert len({*names, OUTLIERS}) == len(names) + 1
    for name in names:
        check_name(name)
    assert names == kind_names(kinds, [OUTLIERS], gantry())


def test_a_kind_labelled_as_outliers_does_not_take_their_name():
    labelled = statistics(12, n_kinds=1)
    sources = source_rows(m._replace(label=OUTLIERS) for m in labelled.motions)
    content = library_content(replace(labelled, sources=sources), PrimitiveOptions())
    assert OUTLIERS not in {x.name for x in content.primitives}


def test_a_library_is_built_from_motions_and_grows(tmp_path):
    """Motions of two sets of joints make a library each; more motions are added to theirs."""
    made = generate_motions(12, 3)
    motions = [replace(x, recording=f"r{i}", checksum=f"{i}") for i, x in enumerate(made)]
    other = [replace(x, joint_names=("a", "b", "c", "d")) for x in motions[:3]]
    first = build_library([*motions[:6], *other], tmp_path / "x")
    assert sorted(len(x.statistics.durations) for x in first.values()) == [3, 6]
    second = build_library(motions[3:], tmp_path / "x")
    assert sorted(len(x.statistics.durations) for x in second.values()) == [3, 12]
    assert second.keys() == first.keys()
    for folder, content in second.items():
        assert set(VersionedLibrary(folder).in_use()) == {x.name for x in content.primitives}
    third = build_library([], tmp_path / "x", removed=["r9"])
    assert sorted(len(x.statistics.durations) for x in third.values()) == [3, 11]


@pytest.mark.parametrize("motions", [[], ["bags/"]])
def test_a_library_of_no_motions_is_refused(tmp_path, motions):
    with pytest.raises(PrimitiveError, match="got none|not a demonstration"):
        build_library(motions, tmp_path / "x")
    assert not (tmp_path / "x").exists()
