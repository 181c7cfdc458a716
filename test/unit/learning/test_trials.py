# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""Learning by trials keeps what is cheaper and valid."""

import numpy as np
import pytest
from scipy.integrate import trapezoid

import mp_pca_planner as mp
from mp_pca_planner.exceptions import LearningError
from mp_pca_planner.learning.trials import improve_by_trials
from mp_pca_planner.motion.validation import check_limits

pytest.importorskip("cmaes", reason="cmaes (extra 'learn') is not installed")


@pytest.fixture(scope="module")
def plan(tmp_path_factory):
    urdf = mp.config_file("human_arm.urdf")
    path = tmp_path_factory.mktemp("bag") / "motions.mcap"
    motions = mp.load_demonstrations(mp.write_example_recording(path, 6), robot=urdf)
    planner = mp.Planner(mp.Robot.from_file(urdf), mp.MovementPrimitive.fit(motions))
    return planner.plan(start=motions[0].positions[0], goal={"elbow": -0.8})


def test_trials_are_valid_and_the_cheapest_is_kept(plan):
    costs, tried = [], []

    def run(trajectory):
        assert not check_limits(trajectory, plan.planner.robot, plan.planner.limits).violations
        tried.append(trajectory)
        costs.append(abs(trajectory.positions[len(trajectory.times) // 3]).sum())
        return costs[-1]

    best = improve_by_trials(plan, run, 20)
    assert len(costs) == 20 and min(costs) < costs[0]
    assert best.trajectory is tried[costs.index(min(costs))]
    assert best.trajectory.duration == pytest.approx(plan.duration)


def test_trials_save_effort_on_a_robot_with_other_masses_than_the_model(plan):
    model = plan.planner.robot
    factors = 1.0 + 0.3 * np.random.default_rng(0).uniform(
        -1.0, 1.0, len(model.link_inertias.links)
    )
    robot = model.with_link_inertias(np.repeat(factors[:, None], 4, axis=1))

    def effort(trajectory):
        acting = robot.inverse_dynamics(*trajectory.states)
        return 0.5 * trapezoid(np.sum(np.square(acting), axis=1), trajectory.times)

    best = improve_by_trials(plan, effort, 40)
    assert effort(best.trajectory) < 0.98 * effort(plan.trajectory)


def test_cost_that_is_no_number_is_refused(plan):
    with pytest.raises(LearningError, match="finite"):
        improve_by_trials(plan, lambda _: float("nan"), 2)
