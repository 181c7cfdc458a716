# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""What the planner can't serve: a sentence that names it and what is accepted."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from support.arm import JOINTS, arm_demonstrations, arm_primitive, arm_robot
from support.arm_plans import planner, request

from mp_pca_planner.exceptions import PlannerError
from mp_pca_planner.motion.goal import JointGoal, JointState, Pose, PoseGoal, SequenceGoal
from mp_pca_planner.motion.validation import check_limits
from mp_pca_planner.planning.objectives import objective_by_name
from mp_pca_planner.planning.options import PlannerOptions
from mp_pca_planner.planning.plan import ALREADY_THERE
from mp_pca_planner.planning.planner import Planner
from mp_pca_planner.planning.resolve import check_goal
from mp_pca_planner.planning.time_scaling import shortest_durations
from mp_pca_planner.primitives.build import build_primitive

GOAL, START = request(1)
HERE, THERE = START.positions, GOAL.state


def joint_goal(positions, names=JOINTS, velocities=None, **options):
    return JointGoal(JointState(names, positions, velocities), **options)


def sequence(*targets, times=()):
    return SequenceGoal(targets, times)


def plan(goal, start=START, *mode, **options):
    return planner(**options).plan(goal, start, *mode)


def of_three_joints():
    parts = [
        type(d)(
            JOINTS[:3],
            d.times,
            *(x[:, :3] for x in (d.positions, d.velocities, d.accelerations)),
            recording="x",
            start_time=0.0,
            end_time=1.0,
        )
        for d in arm_demonstrations()
    ]
    return build_primitive(parts, "other")


REFUSED = {
    # Options
    "basis": (lambda: PlannerOptions(basis="fourier"), "'pca'"),
    "period": (lambda: PlannerOptions(sample_period=0.0), "sample_period"),
    "no objective": (lambda: PlannerOptions(objectives=()), "objective"),
    "objective": (lambda: objective_by_name("effrt", arm_robot()), "'effrt'.*'effort'"),
    "frame": (lambda: objective_by_name("straightness", arm_robot(), "tool"), "'tool'.*valid"),
    # Primitives
    "twice": (lambda: Planner(arm_robot(), [arm_primitive()] * 2), "'arm_arm_4'"),
    "other joints": (lambda: Planner(arm_robot(), [of_three_joints()]), "'other' moves"),
    "primitive": (
        lambda: plan(request(primitive="arm_am")[0]),
        "no primitive is called 'arm_am'.*'arm_arm_4'",
    ),
    # Goals
    "joint": (lambda: plan(joint_goal([0.0, 0.0], ["elbow", "wrist"])), "'wrist'.*'shoulder1'"),
    "absurd": (lambda: plan(joint_goal([1e300], ["shoulder1"])), r"'shoulder1' is 1e\+300"),
    "outside": (
        lambda: plan(joint_goal([5.0], ["elbow"])),
        r"'elbow' is 5, outside its limits \[.*\] in radians; in degrees, 286.48, outside \[.*\]$",
    ),
    "degrees": (
        lambda: plan(joint_goal([-50.0], ["elbow"])),
        "'elbow' is -50, outside .*; commands read degrees with --degrees$",
    ),
    "end velocity": (
        lambda: plan(joint_goal(THERE.positions, velocities=[0, 0, 0, -0.2])),
        "goal velocity of joint 'elbow' is not 0",
    ),
    "long": (lambda: plan(request(duration=1e9)[0]), r"1e\+09 s, at most 600 s"),
    "dense": (lambda: plan(request(duration=11.0)[0], sample_period=1e-4), "at most 10 s"),
    "short": (
        lambda: plan(request(duration=1e-7)[0]),
        "of at least 1e-06, got 1e-07",
    ),
    "no frame": (lambda: plan(PoseGoal(Pose("hand", [0.3, 0, 0]))), "'hand'.*'wrist'"),
    # Starts
    "start outside": (
        lambda: plan(GOAL, JointState(JOINTS, [*HERE[:3], 1.0])),
        "start position of joint 'elbow' is 1.*; move it inwards, or widen its limits",
    ),
    "start lacks": (lambda: plan(GOAL, JointState(JOINTS[:3], HERE[:3])), "lacks 'elbow'"),
    "start too fast": (
        lambda: plan(GOAL, JointState(JOINTS, HERE, [0, 0, 0, 99.0])),
        "start velocity of joint 'elbow' is 99, outside",
    ),
    # Sequences
    "out of reach": (
        lambda: plan(sequence(THERE, Pose("wrist", [9, 9, 9]))),
        "target 2: no configuration within the joint limits",
    ),
    "joint of a target": (
        lambda: plan(sequence(THERE, JointState(["elbo"], [0.0]))),
        "target 2 .* no joint is called 'elbo'",
    ),
    "many": (lambda: plan(sequence(*(THERE,) * 201)), "number of targets must be .* 200, got 201"),
    "endless": (
        lambda: plan(sequence(*(THERE, START) * 100, times=(599.9, *[None] * 199))),
        "sequence would take",
    ),
    "mode": (lambda: plan(sequence(THERE), START, "fast"), "the mode must be one of"),
}


@pytest.mark.parametrize("name", REFUSED)
def test_what_can_not_be_served_is_named_with_what_is_accepted(name):
    ask, words = REFUSED[name]
    with pytest.raises(PlannerError, match=words) as caught:
        ask()
    assert "\n" not in str(caught.value)


def attempt(ask):
    """The result, and what a refusal says."""
    try:
        return ask(), ""
    except PlannerError as error:
        return None, str(error)


extremes = st.one_of(
    st.floats(-1.0, 0.0), st.floats(allow_nan=False, allow_infinity=False), st.just(0.0)
)


@settings(max_examples=150, deadline=None)
@given(
    st.lists(extremes, min_size=20, max_size=20),
    st.one_of(st.none(), st.floats(1e-300, 1e300), st.floats(0.2, 3.0)),
    st.sampled_from([*[None] * 6, "arm_arm_4", "leg"]),
    st.sampled_from(["joints", "joints", "elbow", "pose"]),
)
def test_absurd_requests_are_refused_or_come_to_an_honest_plan(numbers, duration, name, kind):
    q0, v0, a0, q, v = np.reshape(numbers, (5, 4))
    subject = planner(allow_nonzero_end_velocity=True)
    start = JointState(JOINTS, q0, v0, a0)
    chosen = {"joints": slice(None), "elbow": slice(3, 4), "pose": slice(0, 3)}[kind]
    options = {"duration": duration, "primitive": name}
    goal, _ = attempt(
        lambda: (
            PoseGoal(Pose("wrist", q[chosen]), **options)
            if kind == "pose"
            else joint_goal(q[chosen], JOINTS[chosen], v[chosen], **options)
        )
    )
    if goal is None:
        return
    found, refused = attempt(lambda: subject.plan(goal, start))
    if kind != "pose":
        _, from_nowhere = attempt(lambda: check_goal(subject.robot, subject.limits, goal))
        assert refused or not from_nowhere
    if found is None or found.status == ALREADY_THERE:
        return
    if found.is_executable:
        assert not check_limits(found.trajectory, arm_robot(), arm_robot().limits()).violations
        np.testing.assert_array_equal(found.trajectory.positions[0], q0)
        assert found.goal_error <= 1e-6
        if kind == "joints":
            np.testing.assert_array_equal(found.trajectory.velocities[-1], v)
    elif found.status == "already_there":
        assert np.abs(v0).max() <= 1e-4
        assert kind == "pose" or np.abs(np.array([q - q0, v])[:, chosen]).max() <= 1e-4
    else:
        assert found.limit_check.worst_excess > 0.0


def test_a_duration_below_what_limits_allow_is_named_even_without_time_to_plan():
    found = plan(JointGoal(THERE, duration=0.02), max_solve_time=1e-9)
    assert not found.is_executable and "ran out" not in found.message
    assert "the duration of 0.02 s is too short: within its limits, joint" in found.message


def test_no_motion_is_shorter_than_the_shortest_durations():
    limits = arm_robot().limits({"elbow": {"max_velocity": 2.0, "max_acceleration": 4.0}})
    there = JointState(JOINTS, HERE + 3.0 * np.eye(4)[3])
    start = JointState(JOINTS, HERE)
    # One second up to 2 rad/s and half a second on, then down: 1 + 1 + 1 rad.
    assert shortest_durations(limits, start, there)[3] == pytest.approx(2.0)
    near = JointState(JOINTS, HERE + 0.25 * np.eye(4)[3])
    assert shortest_durations(limits, start, near)[3] == pytest.approx(0.5)
    moving = JointState(JOINTS, HERE, [0.0, 0.0, 0.0, 2.0])
    assert shortest_durations(limits, moving, there)[3] == pytest.approx(1.5)
    assert shortest_durations(limits, start, start).tolist() == [0.0] * 4
    fastest = planner(timing="shortest").plan(GOAL, START)
    bound = shortest_durations(planner().limits, START, fastest.motions[-1].goal)
    assert bound.max() <= fastest.duration
