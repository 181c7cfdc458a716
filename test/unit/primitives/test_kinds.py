# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""Kinds of motions in a heap."""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from motion_kinds import generate_kinds

from mp_pca_planner.primitives.conditional_model import left_out_squares
from mp_pca_planner.primitives.kind_names import kind_names
from mp_pca_planner.primitives.kinds import OUTLIER, KindOptions, find_kinds
from mp_pca_planner.primitives.library_building import adjusted_rand_index, library_content
from mp_pca_planner.primitives.motion_sources import source_rows
from mp_pca_planner.primitives.motion_statistics import MotionStatistics
from mp_pca_planner.primitives.options import PrimitiveOptions
from mp_pca_planner.recordings.demonstration import Demonstration
from mp_pca_planner.resources import config_file
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
    requests, shapes, backward = statistics(60).chosen(range(0, 60, 6)).requests_and_shapes()
    found = left_out_squares(requests, shapes, backward)
    # Only the weights of the kernels come from all motions: leaving one out hardly changes them.
    assert np.all(found < np.sum(shapes**2, axis=1))


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


def test_a_library_has_a_primitive_for_each_kind_that_predicts_it_better_than_all_in_one_pot():
    made = statistics(60)
    content = library_content(made, PrimitiveOptions())
    assert [len(x.durations) for x in content.primitives] == [10] * 6
    assert np.sqrt(np.mean(content.errors_alone**2)) < np.sqrt(
        np.mean(content.errors_in_one_pot**2)
    )
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


def test_names_say_where_the_end_effector_goes():
    robot = Robot.from_file(config_file("human_arm.urdf"), statistics(6).joint_names)
    down = [-0.2, 0.0, 0.0, -0.1]
    times = np.linspace(0.0, 1.0, 101)

    def to(goal):
        share = (10 - 15 * times + 6 * times**2) * times**3
        rate = np.gradient(share, times)
        positions, step = np.outer(1 - share, down) + np.outer(share, goal), np.subtract(goal, down)
        zeros = np.zeros((101, 4))
        motion = Demonstration(
            robot.joint_names, times, positions, np.outer(rate, step), zeros,
            recording="x", start_time=0.0, end_time=1.0,
        )  # fmt: skip
        return MotionStatistics.of([motion], PrimitiveOptions())

    up = to([-2.2, 0.0, 0.0, -0.1])
    names = kind_names([up, up], ["up"], robot)
    assert all(name.startswith("up") for name in names)
    assert len({*names, "up"}) == 3
