# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""Learning by trials: safe, repeatable, and unharmed by crashes."""

import json
import os
import subprocess
import sys
from functools import cache

import numpy as np
import pytest
from support.arm import JOINTS, arm_primitive, arm_robot
from support.patience import PATIENT
from support.worlds import ball_beside, least_distance

from mp_pca_planner.exceptions import LearningError
from mp_pca_planner.learning.refined_motion import AMPLITUDE, RefinedMotion
from mp_pca_planner.learning.refinement import RefinementOptions, parameter_bounds
from mp_pca_planner.learning.trials import TrialLearner
from mp_pca_planner.motion.collision import CollisionModel
from mp_pca_planner.motion.goal import JointGoal, JointState
from mp_pca_planner.motion.validation import check_limits
from mp_pca_planner.planning.planner import Planner

pytest.importorskip("cmaes", reason="cmaes (extra 'learn') is not installed")

ROBOT = arm_robot()


@cache
def motion():
    states = arm_primitive().boundary_states
    goal = JointGoal(JointState(JOINTS, states[3, 3]))
    planner = Planner(ROBOT, [arm_primitive()], ROBOT.limits(), PATIENT)
    return planner.plan(goal, JointState(JOINTS, states[0, 0])).motion


@cache
def tight_limits():
    """Limits that the motion only just keeps."""
    trajectory = RefinedMotion([motion()]).sample(ROBOT, 0.01)
    return ROBOT.limits(
        {
            name: {"max_velocity": 1.01 * v, "max_acceleration": 1.01 * a, "max_effort": 1.01 * tau}
            for name, v, a, tau in zip(
                JOINTS,
                np.abs(trajectory.velocities).max(axis=0),
                np.abs(trajectory.accelerations).max(axis=0),
                np.abs(trajectory.efforts).max(axis=0),
                strict=True,
            )
        }
    )


def test_no_trial_collides():
    options = RefinementOptions(time_price=1.0)
    learner = TrialLearner([motion()], ROBOT, ROBOT.limits(), options)
    original, *tried = learn_proposals(learner, 8)
    other = max(tried, key=lambda one: abs(one.motion.parameters[0, AMPLITUDE]))
    world = ball_beside(original.trajectory, other.trajectory)
    model = CollisionModel(ROBOT, world=world)
    assert model.collisions(other.trajectory)
    clear = TrialLearner([motion()], ROBOT, ROBOT.limits(), options, collision=model)
    for one in learn_proposals(clear, 8):
        assert least_distance(world, one.trajectory) > 0.0


def learn_proposals(learner, n):
    found = []
    for _ in range(n):
        found.append(learner.propose())
        learner.record(effort(found[-1]))
    return found


def effort(proposal):
    return proposal.motion.effort(ROBOT)


def learn(learner, n_trials):
    for _ in range(n_trials):
        learner.record(effort(learner.propose()))
    return learner


def test_trials_lower_the_cost_and_start_with_the_motion_itself():
    # Of these, some 40 search and the others repeat.
    learner = learn(TrialLearner([motion()], ROBOT, ROBOT.limits()), 80)
    assert not np.any(learner.trials[0].parameters)
    assert learner.best.cost < 0.95 * learner.trials[0].cost
    assert effort(learner.best_motion()) == pytest.approx(learner.best.cost, rel=1e-12)
    # Without noise, the gain is certain.
    gain = learner.gain()
    assert gain.is_certain and gain.error == pytest.approx(0.0, abs=1e-9 * gain.cost)
    assert gain.original_cost == pytest.approx(learner.trials[0].cost)


def noisy(seed, n_trials, noise=0.1):
    """A learner of costs with noise, from a motion that no trial can improve."""
    limits, rng = ROBOT.limits(), np.random.default_rng(seed)
    learner = TrialLearner([motion()], ROBOT, limits, RefinementOptions(seed=seed))
    for _ in range(n_trials):
        worse = 1.0 + 0.1 * np.abs(learner.propose().motion.parameters).sum()
        learner.record(worse * (1.0 + noise * rng.normal()))
    return learner


def test_noise_makes_no_gain():
    for seed in range(12):
        learner = noisy(seed, 40)
        gain = learner.gain()
        really = 0.1 * np.abs(gain.parameters).sum()
        assert not gain.is_certain or really < 0.01
        # The least of single measurements would be taken for a gain.
        assert min(trial.cost for trial in learner.trials) < 0.9
        assert 0.03 < gain.share_error < 0.3


def test_a_gain_is_judged_by_repetitions():
    learner = noisy(3, 40)
    gain, n = learner.gain(), len(learner.trials)
    repeated = [t for t in learner.trials if t.repeat]
    assert n // 4 < len(repeated) < n // 2
    own = [t.cost for t in repeated if t.parameters == gain.parameters]
    assert gain.cost == pytest.approx(np.mean(own))
    originals = [t.cost for t in learner.trials if not np.any(t.parameters)]
    assert gain.original_cost == pytest.approx(np.mean(originals))


def test_trials_of_an_earlier_release_are_read(tmp_path):
    file = tmp_path / "trials.json"
    learn(TrialLearner([motion()], ROBOT, ROBOT.limits(), state=file), 1)
    content = json.loads(file.read_text())
    for trial in content["trials"]:
        del trial["repeat"]
    file.write_text(json.dumps(content))
    resumed = TrialLearner([motion()], ROBOT, ROBOT.limits(), state=file)
    assert [trial.repeat for trial in resumed.trials] == [False]


def test_trials_go_on_from_a_refinement_that_ended_at_a_bound():
    start = parameter_bounds(1) * [1.0 + 1e-12, 0.0, 0.0, 0.0, 0.0]
    learner = TrialLearner([motion()], ROBOT, ROBOT.limits(), start=start)
    assert len(learn(learner, 4).trials) == 4


def test_every_trial_is_within_the_limits():
    limits = tight_limits()
    learner = TrialLearner([motion()], ROBOT, limits)
    for _ in range(30):
        proposal = learner.propose()
        assert not check_limits(proposal.trajectory, ROBOT, limits).violations
        assert proposal.motion.duration == pytest.approx(motion().duration, rel=1e-12)
        learner.record(effort(proposal))
    assert learner.best.cost < learner.trials[0].cost


def test_proposal_stays_until_its_cost_is_told():
    learner = TrialLearner([motion()], ROBOT, ROBOT.limits())
    assert learner.propose() is learner.propose()


def test_same_seed_and_costs_give_the_same_trials():
    one, two, other = (
        TrialLearner([motion()], ROBOT, ROBOT.limits(), RefinementOptions(seed=seed))
        for seed in (1, 1, 2)
    )
    assert learn(one, 12).trials == learn(two, 12).trials
    assert learn(other, 12).trials != one.trials


@pytest.mark.parametrize("crash_after", [0, 1, 5, 9])
def test_learning_goes_on_after_a_crash_as_if_there_had_been_none(tmp_path, crash_after):
    whole = learn(TrialLearner([motion()], ROBOT, ROBOT.limits()), 20)
    file = tmp_path / "trials.json"
    learn(TrialLearner([motion()], ROBOT, ROBOT.limits(), state=file), crash_after)
    resumed = TrialLearner([motion()], ROBOT, ROBOT.limits(), state=file)
    assert resumed.trials == whole.trials[:crash_after]
    assert learn(resumed, 20 - crash_after).trials == whole.trials


def test_killed_learner_leaves_a_file_that_can_be_read(tmp_path):
    file = tmp_path / "trials.json"
    code = (
        "from pathlib import Path\n"
        "from test_trials import *\n"
        f"learner = TrialLearner([motion()], ROBOT, ROBOT.limits(), state=Path({str(file)!r}))\n"
        "print('ready', flush=True)\n"
        "learn(learner, 100_000)\n"
    )
    with subprocess.Popen(
        [sys.executable, "-c", code],
        env={**os.environ, "PYTHONPATH": os.pathsep.join(sys.path)},
        stdout=subprocess.PIPE,
        text=True,
    ) as process:
        assert process.stdout.readline() == "ready\n"
        while not file.exists() or len(json.loads(file.read_text())["trials"]) < 5:
            assert process.poll() is None
        process.kill()
    resumed = TrialLearner([motion()], ROBOT, ROBOT.limits(), state=file)
    n = len(resumed.trials)
    assert n >= 5
    whole = learn(TrialLearner([motion()], ROBOT, ROBOT.limits()), n + 2)
    assert learn(resumed, 2).trials == whole.trials


@pytest.mark.parametrize("cost", [np.nan, np.inf])
def test_cost_that_is_no_number_is_refused_and_nothing_is_learned(cost):
    learner = TrialLearner([motion()], ROBOT, ROBOT.limits())
    with pytest.raises(LearningError, match="finite"):
        learner.record(cost)
    assert learner.trials == ()


@pytest.mark.parametrize(
    ("content", "words"),
    [
        ("", "can't be read"),
        ("{}", "can't be read"),
        ('{"format": "x", "version": 1}', "not a file of trials"),
        (
            '{"format": "mp_pca_planner/trials", "version": 1, "motion": "x", "trials": []}',
            "of another motion",
        ),
        (
            '{"format": "mp_pca_planner/trials", "version": 1, "motion": "x", "trials": [5]}',
            r"trials\[0\] is 5, expected an object",
        ),
        ("[" * 100_000, "nested too deeply"),
        ("5", "expected an object"),
        ('{"format": []}', "expected text"),
    ],
)
def test_file_of_something_else_is_refused_and_left_alone(tmp_path, content, words):
    file = tmp_path / "trials.json"
    file.write_text(content)
    with pytest.raises(LearningError, match=words):
        TrialLearner([motion()], ROBOT, ROBOT.limits(), state=file)
    assert file.read_text() == content


@pytest.mark.parametrize(("index", "value"), [(1, 800.0), (0, -1.1), (4, 3.5)])
def test_stored_parameters_beyond_any_trial_are_refused(tmp_path, index, value):
    file = tmp_path / "trials.json"
    learn(TrialLearner([motion()], ROBOT, ROBOT.limits(), state=file), 2)
    content = json.loads(file.read_text())
    content["trials"][1]["parameters"][index] = value
    file.write_text(json.dumps(content))
    with pytest.raises(LearningError, match=rf"must be within .* at index {index}, got {value:g}"):
        TrialLearner([motion()], ROBOT, ROBOT.limits(), state=file)


def test_trials_of_another_seed_are_refused(tmp_path):
    file = tmp_path / "trials.json"
    learn(TrialLearner([motion()], ROBOT, ROBOT.limits(), state=file), 2)
    with pytest.raises(LearningError, match="other options"):
        TrialLearner([motion()], ROBOT, ROBOT.limits(), RefinementOptions(seed=1), state=file)
