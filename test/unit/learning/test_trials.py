# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""Learning by trials keeps what is cheaper and valid."""

import numpy as np
import pytest
from scipy.integrate import trapezoid

import mp_pca_planner as mp
from mp_pca_planner.exceptions import LearningError
from mp_pca_planner.learning.refinement import refine
from mp_pca_planner.learning.trials import improve_by_trials
from mp_pca_planner.motion.validation import check_limits

pytest.importorskip("cmaes", reason="cmaes (extra 'learn') is not installed")


@pytest.fixture(scope="module")
def planned(tmp_path_factory):
    """A planner and its plan."""
    urdf = mp.config_file("human_arm.urdf")
    path = tmp_path_factory.mktemp("bag") / "motions.mcap"
    motions = mp.load_demonstrations(mp.write_example_recording(path, 6), robot=urdf)
    planner = mp.Planner(mp.Robot.from_file(urdf), mp.MovementPrimitive.fit(motions))
    return planner, planner.plan(start=motions[0].positions[0], goal={"elbow": -0.8})


def effort_on(robot):
    def effort(trajectory):
        acting = robot.inverse_dynamics(*trajectory.states)
        return 0.5 * trapezoid(np.sum(np.square(acting), axis=1), trajectory.times)

    return effort


def refined(planner, plan):
    return refine(plan.motions, planner.robot, planner.limits)


@pytest.fixture(scope="module")
def wrong_effort(planned):
    """Effort on a robot with other masses than the model, and friction."""
    factors = 1.0 + 0.3 * np.random.default_rng(0).uniform(-1.0, 1.0, (4, 1))
    robot = planned[0].robot
    changed = robot.with_link_inertias(np.repeat(factors[: len(robot.link_inertias)], 4, 1))

    def effort(trajectory):
        acting = changed.inverse_dynamics(*trajectory.states) + 3.0 * trajectory.velocities
        return 0.5 * trapezoid(np.sum(np.square(acting), axis=1), trajectory.times)

    return effort


def test_trials_are_valid_and_the_cheapest_is_kept_without_noise(planned):
    planner, plan = planned
    costs, tried = [], []

    def run(trajectory):
        assert not check_limits(trajectory, planner.robot, planner.limits).violations
        tried.append(trajectory)
        costs.append(abs(trajectory.positions[len(trajectory.times) // 3]).sum())
        return costs[-1]

    best = improve_by_trials(planner, plan, run, 26)
    assert len(costs) == 26 and min(costs) < costs[0]
    assert best.cost == pytest.approx(min(costs)) == pytest.approx(run(best.trajectory))
    assert best.planned_cost == pytest.approx(costs[0]) and best.noise < 1e-12
    assert best.trajectory.duration == pytest.approx(plan.duration)


def test_trials_improve_on_the_refinement_on_a_robot_unlike_its_model(planned, wrong_effort):
    best = improve_by_trials(*planned, wrong_effort, 60)
    known = min(wrong_effort(one.trajectory) for one in (planned[1], refined(*planned)))
    assert wrong_effort(best.trajectory) < 0.995 * known
    assert best.cost == pytest.approx(wrong_effort(best.trajectory))


def test_noise_does_not_displace_the_best_known_motion(planned):
    """On the robot of the model, the refinement is the best: no noise makes it be dropped."""
    (planner, plan), noise = planned, 0.1
    effort, known = effort_on(planner.robot), refined(*planned)
    ends = []
    for seed in range(5):
        rng = np.random.default_rng(seed)
        best = improve_by_trials(
            planner, plan, lambda x, rng=rng: effort(x) * (1.0 + noise * rng.normal()), 24, seed
        )
        ends.append(effort(best.trajectory))
        assert 0.2 * noise < best.noise / best.cost < 2.5 * noise
    assert max(ends) < 0.5 * (effort(known.trajectory) + effort(plan.trajectory))
    assert np.median(ends) == pytest.approx(effort(known.trajectory), rel=1e-3)


@pytest.mark.parametrize(("gain", "is_kept"), [(1.5, False), (1.8, True)])
def test_a_gain_counts_from_twice_the_standard_error_of_a_difference_on(planned, gain, is_kept):
    """Each mean is of three measurements with a deviation of 1: 2 √(1/3 + 1/3) = 1.63."""
    means = 13.0, 10.0, 9.0, 10.0 - gain  # of plan, refinement, search, and the one found
    costs = iter([mean + noise for mean in means for noise in (-1.0, 0.0, 1.0)])
    best = improve_by_trials(*planned, lambda _: next(costs), 12)
    assert best.cost == pytest.approx(10.0 - gain if is_kept else 10.0)
    assert best.noise == pytest.approx(1.0)


def test_what_can_not_be_learned_from_is_refused(planned):
    with pytest.raises(LearningError, match="finite"):
        improve_by_trials(*planned, lambda _: float("nan"))
    with pytest.raises(LearningError, match="n_trials must be at least 12, got 4"):
        improve_by_trials(*planned, lambda _: 1.0, 4)
