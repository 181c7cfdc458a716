# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""The planner: goals in, executable motions of little effort out."""

import numpy as np
import pytest
from scipy.integrate import trapezoid
from scipy.interpolate import BPoly
from support.arm import JOINTS, arm_primitive, arm_robot
from support.arm_plans import REQUESTS, planner, request
from support.patience import EVER, PATIENT

from mp_pca_planner.motion.goal import JointGoal, JointState
from mp_pca_planner.motion.validation import LIMIT_TOLERANCE, START_TOLERANCE, check_limits
from mp_pca_planner.planning.options import PlannerOptions
from mp_pca_planner.planning.plan import INFEASIBLE, SOLVED
from mp_pca_planner.planning.planner import Planner
from mp_pca_planner.planning.resolve import check_goal
from mp_pca_planner.primitives.build import PrimitiveOptions, build_primitive
from mp_pca_planner.recordings.demonstration import Demonstration
from mp_pca_planner.robot.model import Robot


@pytest.mark.parametrize("coupling", ["arm", "joint"])
def test_random_goals_inside_the_demonstrations_are_met_exactly_with_less_effort(coupling):
    subject = planner(coupling)
    for i in range(len(REQUESTS)):
        goal, start = request(i)
        plan = subject.plan(goal, start)
        assert plan.status == SOLVED, plan.message
        assert plan.goal_error <= 1e-12 and plan.facts["start_error"] <= 1e-12
        np.testing.assert_allclose(
            plan.trajectory.positions[[0, -1]], REQUESTS[i], rtol=0.0, atol=1e-12
        )
        assert np.all(plan.trajectory.velocities[-1] == 0.0)
        assert plan.solution.effort_cost <= plan.solution.start_cost
        assert plan.limit_check.worst_excess == 0.0


@pytest.mark.parametrize("end", ["start", "goal"])
def test_a_joint_far_outside_its_demonstrated_range_is_named_whatever_the_score(end):
    goal, start = request()
    primitive = arm_primitive("arm")
    demonstrated = primitive.boundary_states[:, 0 if end == "start" else 3, 3]
    far = demonstrated.max() + 2.5 * max(demonstrated.std(), 0.1)
    moved = {"start": start.positions.copy(), "goal": goal.state.positions.copy()}
    moved[end][3] = far
    wide = {JOINTS[3]: {"min_position": -9.0, "max_position": 9.0}}
    plan = planner(overrides=wide).plan(moved["goal"], moved["start"])
    found = f"the {end} of '{JOINTS[3]}', {far:.3g}, is outside"
    assert any(remark.startswith(found) for remark in plan.remarks)
    assert found in repr(plan)
    assert planner().plan(*request()).remarks == ()


@pytest.mark.parametrize("timing", ["demonstrated", "free"])
def test_efforts_of_the_drives_are_planned_stated_and_limited(timing):
    drive = {"armature": 0.05, "damping": 2.0, "friction": 0.3}
    robot = arm_robot().with_drives(dict.fromkeys(JOINTS, drive))
    goal, start = request(2)

    def of_drives(plan):
        q, v, a = plan.trajectory.states
        rigid = arm_robot().inverse_dynamics(q, v, a)
        return rigid + 0.05 * a + 2.0 * v + 0.3 * np.tanh(v / 0.02)

    costs, limits = [], robot.limits()
    for rho in (1.0, 1e-3):
        options = PlannerOptions(naturalness=rho, timing=timing, max_solve_time=EVER)
        plan = Planner(robot, [arm_primitive()], limits, options).plan(goal, start)
        tau = of_drives(plan)
        np.testing.assert_allclose(plan.trajectory.efforts, tau, atol=1e-9)
        costs.append(0.5 * trapezoid(np.sum(tau**2, axis=1), plan.trajectory.times))
        assert plan.status == "solved"
        assert plan.effort_cost == pytest.approx(costs[-1], rel=2e-3)
        assert "viscous damping" in plan.summary()["effort_parts"]
    assert costs[1] < costs[0]
    peaks = np.abs(tau).max(axis=0)
    tight = robot.limits(
        {n: {"max_effort": float(0.95 * x)} for n, x in zip(JOINTS, peaks, strict=True)}
    )
    plan = Planner(robot, [arm_primitive()], tight, options).plan(goal, start)
    assert plan.is_executable
    assert np.all(np.abs(of_drives(plan)) <= 0.95 * peaks * (1.0 + 1e-4))


def test_of_several_optima_the_best_is_taken():
    # Slowly there are several ways to hang: one start finds a dear one here.
    goal = JointGoal(JointState(JOINTS, REQUESTS[9][1]), 2.0)
    start = JointState(JOINTS, REQUESTS[9][0])
    one, several, again = (
        planner(naturalness=0.0, n_starts=n).plan(goal, start) for n in (1, 5, 5)
    )
    assert one.status == several.status == SOLVED
    assert several.solution.effort_cost < 0.9 * one.solution.effort_cost
    assert several.solution.iterations > one.solution.iterations
    np.testing.assert_array_equal(several.trajectory.positions, again.trajectory.positions)


def test_a_motion_starts_from_a_moving_state():
    goal, start = request(4)
    moving = JointState(JOINTS, start.positions, [0.3, -0.2, 0.1, 0.4], [1.0, 0.0, -1.0, 0.5])
    plan = planner().plan(goal, moving)
    assert plan.status == SOLVED
    np.testing.assert_array_equal(plan.trajectory.velocities[0], moving.velocities)
    np.testing.assert_array_equal(plan.trajectory.accelerations[0], moving.accelerations)


def test_a_duration_that_is_given_is_kept_and_otherwise_like_the_demonstrations():
    assert planner().plan(*request(duration=1.234)).motion.duration == 1.234
    durations = arm_primitive().durations
    free = planner().plan(*request()).motion.duration
    assert durations.min() * 0.8 < free < durations.max() * 1.2


def test_the_state_may_have_more_joints_in_any_order():
    goal, start = request()
    wider = JointState(["gripper", *JOINTS[::-1]], [9.0, *start.positions[::-1]])
    np.testing.assert_array_equal(
        planner().plan(goal, wider).trajectory.positions,
        planner().plan(goal, start).trajectory.positions,
    )


def test_an_executable_plan_breaks_no_limit_on_a_finer_grid():
    robot = arm_robot()
    for i in range(20):
        plan = planner(sample_period=0.02).plan(*request(i))
        fine = plan.motion.evaluate(np.linspace(0.0, plan.motion.duration, 5000))
        limits = robot.limits()
        assert np.all((fine[0] >= limits.lower) & (fine[0] <= limits.upper))
        assert np.all(np.abs(fine[1]) <= limits.velocity)
        assert np.all(np.abs(robot.inverse_dynamics(*fine)) <= limits.effort)


@pytest.mark.parametrize("outside", [1e-6, 1e-4, 0.999 * START_TOLERANCE])
@pytest.mark.parametrize("joint", JOINTS)
@pytest.mark.parametrize("side", ["min_position", "max_position"])
def test_motion_from_slightly_outside_the_limits_leads_inwards(joint, side, outside):
    goal, start = request(1)
    j, sign = JOINTS.index(joint), 1.0 if side == "min_position" else -1.0
    limit = start.positions[j] + sign * outside
    limits = {side: limit}
    if sign * (goal.state.positions[j] - limit) < 0.0:  # to a goal on the limit
        goal = JointGoal(JointState([joint], [limit]))
    plan = planner(overrides={joint: limits}).plan(goal, start)
    assert plan.is_executable, plan.message
    np.testing.assert_array_equal(plan.trajectory.positions[0], start.positions)
    path = BPoly.from_derivatives(
        np.array(plan.trajectory.times),  # SciPy before 1.12 takes no read-only arrays
        np.stack([x[:, j] for x in plan.trajectory.states], axis=1),
    )
    within = sign * (path(np.linspace(0.0, plan.trajectory.duration, 10_000)) - limit)
    rounding = LIMIT_TOLERANCE * 2.0 * np.pi
    assert np.all(within >= np.minimum(np.maximum.accumulate(within), 0.0) - rounding)
    (remark,) = [one for one in plan.remarks if "outside its limits" in one]
    assert f"joint '{joint}' starts {outside:.2g} rad" in remark


def test_a_joint_that_turns_without_end_goes_the_shorter_way():
    urdf = """<robot name="wheel"><link name="base"/><link name="rim"><inertial>
    <origin xyz="0 0 0.1"/><mass value="1"/><inertia ixx="1" iyy="1" izz="1" ixy="0" ixz="0"
    iyz="0"/></inertial></link><joint name="turn" type="continuous"><parent link="base"/>
    <child link="rim"/><axis xyz="0 1 0"/></joint></robot>"""
    robot = Robot(urdf)
    times = np.linspace(0.0, 1.0, 101)
    smooth = (10 * times**3 - 15 * times**4 + 6 * times**5)[:, None]
    turns = [
        Demonstration(
            ("turn",),
            times,
            start + size * smooth,
            np.gradient(size * smooth[:, 0], times)[:, None],
            np.zeros((101, 1)),
            recording="x",
            start_time=0.0,
            end_time=1.0,
        )
        for start, size in ((0.0, 1.0), (0.1, 1.2), (-0.1, 0.8), (0.2, 1.1))
    ]
    primitive = build_primitive(turns, "turn", PrimitiveOptions(n_components=1))
    subject = Planner(robot, [primitive], robot.limits(), PATIENT)
    plan = subject.plan(
        JointGoal(JointState(["turn"], [-3.0])), JointState(["turn"], [3.0 + 4.0 * np.pi])
    )
    assert plan.is_executable
    travelled = plan.trajectory.positions[-1, 0] - plan.trajectory.positions[0, 0]
    assert travelled == pytest.approx(2.0 * np.pi - 6.0)
    assert plan.in_span_score < 100.0
    assert not check_limits(plan.trajectory, robot, robot.limits()).violations
    # Which turn a goal means depends on the start, and so does whether it is inside limits.
    bounded = robot.limits({"turn": {"min_position": 5.0, "max_position": 25.0}})
    careful, goal = (
        Planner(robot, [primitive], bounded, PATIENT),
        JointGoal(JointState(["turn"], [-3.0])),
    )
    check_goal(robot, bounded, goal)
    assert careful.plan(goal, JointState(["turn"], [3.0 + 4.0 * np.pi])).is_executable


def test_requests_above_the_largest_in_span_score_are_never_executable():
    goal, start = request()
    score = planner().plan(goal, start).in_span_score
    assert planner(max_in_span_score=1.01 * score).plan(goal, start).is_executable
    strict = planner(max_in_span_score=0.99 * score)
    plan = strict.plan(goal, start)
    assert plan.status == INFEASIBLE and plan.in_span_score == score
    assert f"in-span score is {score:.2f}" in plan.message
    end = strict.target(goal, start)
    assert strict.is_too_far(goal, start, end) and not planner().is_too_far(goal, start, end)
