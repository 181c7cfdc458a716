# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""Goals that come again: trials within the limits, learned from and resumed."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from support.arm import JOINTS, arm_primitive, arm_robot
from support.patience import NODE_EVER

pytest.importorskip("cmaes", reason="cmaes (extra 'learn') is not installed")

from mp_pca_planner.exceptions import LearningError, PlannerError
from mp_pca_planner.execution.parameters import Settings
from mp_pca_planner.execution.serving.assembly import Model, assemble_model
from mp_pca_planner.execution.serving.trial_store import ServedTrial, TrialStore
from mp_pca_planner.files import config_file
from mp_pca_planner.motion.collision import CollisionModel
from mp_pca_planner.motion.goal import JointGoal, JointState
from mp_pca_planner.motion.validation import check_executable, check_limits
from mp_pca_planner.planning.plan import Plan
from mp_pca_planner.planning.planner import Planner

URDF = config_file("human_arm.urdf").read_text(encoding="utf-8")
START, GOAL = arm_primitive().boundary_states[0][0], arm_primitive().boundary_states[0][3]
LIMITS = {name: {"max_velocity": 2.5, "max_acceleration": 12.0} for name in JOINTS}


@pytest.fixture
def model(tmp_path: Path) -> Model:
    settings = Settings(
        learn_trials=True, save_folder=str(tmp_path), limits=LIMITS, max_solve_time=NODE_EVER
    )
    return assemble_model(URDF, [arm_primitive()], settings)


def serve(
    store: TrialStore, model: Model, goal: np.ndarray = GOAL, start: np.ndarray = START
) -> tuple[Plan, ServedTrial]:
    request, here = JointGoal(JointState(JOINTS, goal)), JointState(JOINTS, start)
    plan, trial = store.vary(request, model.planner.plan(request, here), model)
    check_executable(plan.trajectory, plan.limit_check, here)
    assert not check_limits(plan.trajectory, arm_robot(), model.limits).violations
    return plan, trial


def test_trials_lower_the_cost_and_start_wherever_the_robot_is(model: Model) -> None:
    store, random = TrialStore(), np.random.default_rng(0)
    costs = []
    for number in range(1, 21):
        start = START + 0.005 * random.uniform(-1.0, 1.0, 4)
        plan, trial = serve(store, model, start=start)
        assert trial.number == number
        assert np.array_equal(plan.trajectory.positions[0], start)
        assert np.array_equal(plan.trajectory.positions[-1], GOAL)
        # A cost that the model knows nothing of: the elbow should be late.
        costs.append(float(np.mean((plan.trajectory.positions[:, 3] - START[3]) ** 2)))
        trial.record(costs[-1])
    parameters, facts = trial.to_keep()
    assert facts["n_trials"] == 20
    assert facts["planned_cost"] == pytest.approx(costs[0], rel=0.1)
    assert facts["trial_cost"] < 0.95 * facts["planned_cost"]
    assert 0.0 < facts["gain_error"] < 0.5 * (1.0 - facts["trial_cost"] / facts["planned_cost"])
    assert parameters.any()


def test_first_trial_is_the_planned_motion_and_repeats_until_its_cost_is_reported(
    model: Model,
) -> None:
    store = TrialStore()
    planned = model.planner.plan(JointGoal(JointState(JOINTS, GOAL)), JointState(JOINTS, START))
    for _ in range(2):
        plan, trial = serve(store, model)
        assert trial.number == 1
        np.testing.assert_allclose(
            plan.trajectory.positions, planned.trajectory.positions, atol=1e-9
        )
        assert plan.solution.effort_cost == pytest.approx(planned.solution.effort_cost, rel=1e-3)
    assert trial.to_keep()[1] == {}
    trial.record(3.0)
    with pytest.raises(LearningError, match="cost of trial 1 was reported before"):
        trial.record(2.0)
    second, trial = serve(store, model)
    assert trial.number == 2
    assert np.abs(second.trajectory.positions - plan.trajectory.positions).max() > 1e-3
    trial.record(4.0)
    with pytest.raises(LearningError, match="none of 2 trials costs less"):
        trial.to_keep()


def test_trials_avoid_self_collision_where_that_is_enabled(tmp_path: Path) -> None:
    # Past the chest, as near as it may be.
    start, end = arm_primitive().boundary_states[11][[0, 3]]
    goal, here = JointGoal(JointState(JOINTS, end)), JointState(JOINTS, start)
    collision, n_collisions = CollisionModel(arm_robot()), {}
    for is_enabled in (False, True):
        settings = Settings(
            learn_trials=True,
            save_folder=str(tmp_path),
            naturalness=0.0,
            collision=is_enabled,
            max_solve_time=NODE_EVER,
        )
        model = assemble_model(URDF, [arm_primitive()], settings)
        own = model.planner
        free = Planner(own.robot, own.primitives, own.limits, own.options, collision)
        planned = free.plan(goal, here)
        n_collisions[is_enabled], store = 0, TrialStore()
        for number in range(1, 4):
            plan, trial = store.vary(goal, planned, model)
            n_collisions[is_enabled] += len(collision.collisions(plan.trajectory))
            trial.record(1.0 / number)
        trial.close()
    assert n_collisions[False] > 0
    assert n_collisions[True] == 0


def test_process_that_was_killed_continues_with_the_next_trial(model: Model) -> None:
    store = TrialStore()
    for number in range(1, 6):
        _, trial = serve(store, model)
        if number in (2, 5):
            _, again = serve(TrialStore(), model)
            assert again.number == number
            np.testing.assert_allclose(again.parameters, trial.parameters, atol=1e-12)
        trial.record(1.0 / number)


def test_other_goals_and_starts_have_trials_of_their_own(model: Model, tmp_path: Path) -> None:
    store = TrialStore()
    for goal, start in ((GOAL, START), (0.9 * GOAL, START), (GOAL, START + 0.05)):
        _, trial = serve(store, model, goal, start)
        assert trial.number == 1
        trial.record(1.0)
    assert len(list(tmp_path.iterdir())) == 3
    # From files, too.
    assert serve(TrialStore(), model, GOAL, START + 0.049)[1].number == 2


def test_trials_begin_anew_when_the_best_was_kept(model: Model, tmp_path: Path) -> None:
    store = TrialStore()
    for cost in (2.0, 1.0):
        _, trial = serve(store, model)
        trial.record(cost)
    trial.close()
    assert not list(tmp_path.iterdir())
    with pytest.raises(LearningError, match="over"):
        trial.record(1.0)
    assert serve(store, model)[1].number == 1


def test_trials_that_cannot_be_continued_are_refused(model: Model, tmp_path: Path) -> None:
    _, trial = serve(TrialStore(), model)
    trial.record(1.0)
    (file,) = tmp_path.iterdir()
    other = assemble_model(URDF, [arm_primitive()], replace(model.settings, naturalness=9.0))
    with pytest.raises(LearningError, match="with other options: remove it"):
        serve(TrialStore(), other)
    text = file.read_text()
    file.write_text(text.replace('"start"', '"begin"'))
    with pytest.raises(LearningError, match="have no start of their motions"):
        serve(TrialStore(), model)
    file.write_text(text[:100])
    with pytest.raises(LearningError, match="can't be read"):
        serve(TrialStore(), model)
    nowhere = replace(model.settings, save_folder=str(tmp_path / "nowhere"))
    with pytest.raises(LearningError, match="no folder"):
        serve(TrialStore(), assemble_model(URDF, [arm_primitive()], nowhere))


def test_learning_without_a_folder_is_refused() -> None:
    with pytest.raises(PlannerError, match="'save_folder' to a folder first"):
        Settings(learn_trials=True)
