# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""Links without a valid inertia are refused by name where efforts count, and only there."""

import re

import numpy as np
import pytest
from hypothesis import assume, given
from hypothesis import strategies as st
from support.arm import JOINTS, arm_demonstrations, arm_primitive, sequence_planner

from mp_pca_planner.control.closed_loop import ControlLoop, simulate
from mp_pca_planner.control.law import COMPUTED_TORQUE, FEEDFORWARD_PD, ControlLaw
from mp_pca_planner.control.stability import ErrorModel, analyse
from mp_pca_planner.exceptions import RobotError
from mp_pca_planner.files import config_file
from mp_pca_planner.learning.refinement import refine
from mp_pca_planner.motion.goal import JointGoal, JointState
from mp_pca_planner.motion.trajectory import Trajectory
from mp_pca_planner.motion.validation import check_limits
from mp_pca_planner.planning.objectives import effort, energy, jerk
from mp_pca_planner.planning.options import PlannerOptions
from mp_pca_planner.planning.plan import SOLVED
from mp_pca_planner.planning.planner import Planner
from mp_pca_planner.recordings.reaches import random_reaches
from mp_pca_planner.robot.model import Robot

NAMES = ["ixx", "iyy", "izz", "ixy", "ixz", "iyz"]


def tensor(*values: object) -> str:
    pairs = zip(NAMES, (*values, 0, 0, 0)[:6], strict=True)
    return "<inertia " + " ".join(f'{name}="{value}"' for name, value in pairs) + "/>"


def inertial(mass: object = 2, inertia: str = tensor(0.1, 0.2, 0.15), xyz: str = "0 0 -0.5") -> str:
    return f'<inertial><origin xyz="{xyz}"/><mass value="{mass}"/>{inertia}</inertial>'


GOOD = inertial()
SHAPE = '<visual><geometry><sphere radius="0.1"/></geometry></visual>'


def pendulum(middle: str = GOOD, tip: str = GOOD, *, last: str = "fixed") -> str:
    """Base, a link `middle` on a joint `swing`, and a link `tip` on it."""
    limit = '<limit lower="-2" upper="2" velocity="5" effort="50"/>'
    return f"""<robot name="pendulum"><link name="base"/>
<joint name="swing" type="revolute"><parent link="base"/><child link="middle"/>
  <axis xyz="0 1 0"/>{limit}</joint><link name="middle">{middle}</link>
<joint name="end" type="{last}"><origin xyz="0 0 -1"/><parent link="middle"/><child link="tip"/>
  <axis xyz="0 1 0"/>{limit}</joint><link name="tip">{tip}</link></robot>"""


def refusal(urdf: str) -> str:
    with pytest.raises(RobotError) as caught:
        Robot(urdf).require_inertias("tests")
    return str(caught.value)


BROKEN = {
    "no mass": "",
    "mass 0": inertial(0, tensor(0, 0, 0)),
    "mass 0 with a tensor": inertial(0),
    "empty": "<inertial/>",
    "mass alone": '<inertial><mass value="1"/></inertial>',
    "mass without value": "<inertial><mass/>" + tensor(1, 1, 1) + "</inertial>",
    "NaN": inertial("nan"),
    "absurd": inertial("1e308"),
    "infinite": inertial("inf"),
    "text": inertial("2 kg"),
    "comma": inertial("2,5"),
    "negative": inertial(-2),
    "NaN in the tensor": inertial(2, tensor("nan", 1, 1)),
    "part of a tensor": inertial(2, '<inertia ixx="1"/>'),
    "wrong origin": inertial(xyz="0 0"),
    "point": inertial(2, tensor(0, 0, 0)),
    "negative moment": inertial(2, tensor(-0.1, 1, 1)),
    "products": inertial(2, tensor(1, 1, 1, 1.5, 0, 0)),
    "triangle": inertial(2, tensor(1, 1, 2.5)),
}


@pytest.mark.parametrize("middle", BROKEN.values(), ids=BROKEN)
def test_links_without_a_valid_inertia_are_refused_by_name_and_in_silence(middle, capfd):
    message = refusal(pendulum(middle, "", last="fixed"))
    assert "these have no valid one: 'middle'; give each an <inertial> with a positive" in message
    assert capfd.readouterr() == ("", "")


@pytest.mark.parametrize("broken", BROKEN.values(), ids=BROKEN)
def test_what_does_not_move_needs_no_inertia(broken, capfd):
    robot = Robot(pendulum().replace('<link name="base"/>', f'<link name="base">{broken}</link>'))
    robot.require_inertias("tests")
    locked = Robot(pendulum(broken, GOOD, last="revolute"), ["end"])
    locked.require_inertias("tests")
    assert capfd.readouterr() == ("", "")


def test_fixed_links_count_as_one_body():
    # A frame without mass at the tip, or a bare bracket that carries a mass.
    for urdf in (pendulum(GOOD, ""), pendulum("", GOOD), pendulum(SHAPE, GOOD)):
        Robot(urdf).require_inertias("tests")
    thin = inertial(1, tensor(0.1, 0.1, 0.9))  # impossible alone, but not with what it carries
    Robot(pendulum(thin, GOOD)).require_inertias("tests")


def test_a_bracket_without_mass_has_the_efforts_of_what_it_carries():
    robot = Robot(pendulum("", GOOD))
    q, a = np.array([[0.3], [-1.0]]), np.array([[2.0], [-1.0]])
    arm = 1.5  # from the axis to the centre of mass
    expected = (0.2 + 2.0 * arm**2) * a + 2.0 * 9.81 * arm * np.sin(q)
    np.testing.assert_allclose(robot.inverse_dynamics(q, 0.0 * q, a), expected, atol=1e-12)


def test_links_without_mass_between_two_axes_are_valid_unless_they_have_a_shape():
    Robot(pendulum("", GOOD, last="revolute")).require_inertias("tests")
    assert "one: 'middle'; give" in refusal(pendulum(SHAPE, GOOD, last="revolute"))
    Robot.from_file(config_file("human_arm.urdf"), JOINTS).require_inertias("tests")


def test_unknown_efforts_are_not_a_number():
    robot = Robot(pendulum(GOOD, "", last="revolute"))
    one = np.ones((1, 2))
    assert np.isnan(robot.inverse_dynamics(one, one, one)).all()
    assert robot.known_efforts(one, one, one) is None
    sound = Robot(pendulum(GOOD, GOOD, last="revolute"))
    np.testing.assert_array_equal(
        sound.known_efforts(one, one, one), sound.inverse_dynamics(one, one, one)
    )


points = st.lists(
    st.tuples(st.floats(0.1, 5.0), *(st.floats(-1.0, 1.0) for _ in range(3))), min_size=3
)


@given(points, st.integers(0, 2**32 - 1), st.floats(1.05, 10.0))
def test_bodies_of_point_masses_are_valid_and_others_are_not(cloud, seed, excess):
    masses, places = np.array([p[0] for p in cloud]), np.array([p[1:] for p in cloud])
    places -= masses @ places / masses.sum()
    spread = (masses[:, None] * places).T @ places
    turned = np.linalg.eigh(spread)[1]
    moments = np.diag(turned.T @ (np.trace(spread) * np.eye(3) - spread) @ turned)
    assume(moments.min() > 1e-6)  # not on a line
    valid = turned @ np.diag(moments) @ turned.T
    Robot(pendulum(inertial(masses.sum(), symmetric(valid)), "")).require_inertias("tests")
    rotation = np.linalg.qr(np.random.default_rng(seed).normal(size=(3, 3)))[0]
    wrong = rotation @ np.diag([*moments[:2], excess * moments[:2].sum()]) @ rotation.T
    assert "one: 'middle'; give" in refusal(pendulum(inertial(1, symmetric(wrong)), ""))


def symmetric(inertia: np.ndarray) -> str:
    places = ((0, 0), (1, 1), (2, 2), (0, 1), (0, 2), (1, 2))
    return tensor(*(float(inertia[place]) for place in places))


# Where efforts count

TEXT = config_file("human_arm.urdf").read_text(encoding="utf-8")
BARE = re.sub(r"<inertial>.*?</inertial>", "", TEXT, flags=re.DOTALL)
FREE = {name: {"max_effort": np.inf} for name in JOINTS}
MOTION = arm_demonstrations()[0]
GOAL = JointGoal(JointState(JOINTS, MOTION.positions[-1]))
START = JointState(JOINTS, MOTION.positions[0])
TRAJECTORY = Trajectory(
    JOINTS, MOTION.times, MOTION.positions, MOTION.velocities, MOTION.accelerations
)
BY_NAME = "'upper_arm', 'lower_arm'; give"


@pytest.mark.parametrize("objective", [effort, energy])
def test_objectives_with_efforts_take_inertias(objective):
    bare = Robot(BARE, JOINTS)
    options = PlannerOptions(objectives=((1.0, jerk), (0.1, objective)))
    with pytest.raises(RobotError, match=f"{BY_NAME}.*choose an objective without efforts"):
        Planner(bare, [arm_primitive()], bare.limits(FREE), options)


def test_limits_of_efforts_take_inertias():
    bare = Robot(BARE, JOINTS)
    options = PlannerOptions(objectives=((1.0, jerk),))
    some = {name: FREE[name] for name in JOINTS[1:]}
    for limits in (bare.limits(), bare.limits(some)):
        with pytest.raises(RobotError, match=f"{BY_NAME}.*remove those limits .max_effort: .inf"):
            Planner(bare, [arm_primitive()], limits, options)
        with pytest.raises(RobotError, match=BY_NAME):
            check_limits(TRAJECTORY, bare, limits)
    assert check_limits(TRAJECTORY, bare, bare.limits(FREE)).violations == ()


def test_a_robot_without_inertias_plans_what_takes_no_efforts():
    options = PlannerOptions(objectives=((1.0, jerk),))
    plans = []
    for text in (TEXT, BARE):
        robot = Robot(text, JOINTS)
        planner = Planner(robot, [arm_primitive()], robot.limits(FREE), options)
        plans.append(planner.plan(GOAL, START))
    known, unknown = plans
    assert unknown.status == SOLVED
    np.testing.assert_array_equal(unknown.trajectory.positions, known.trajectory.positions)
    assert known.trajectory.efforts is not None and unknown.trajectory.efforts is None
    assert np.isfinite(known.solution.effort_cost) and np.isnan(unknown.solution.effort_cost)


def test_whatever_else_computes_efforts_takes_inertias():
    bare, sound = Robot(BARE, JOINTS), Robot(TEXT, JOINTS)
    limits, zero = bare.limits(FREE), np.zeros(4)
    law = ControlLaw.from_frequency(COMPUTED_TORQUE, sound, TRAJECTORY, 10.0)
    plan = Planner(sound, [arm_primitive()], sound.limits()).plan(GOAL, START)
    for attempt in (
        lambda: sequence_planner(bare, [arm_primitive()], limits),
        lambda: refine([plan.motion], bare, limits),
        lambda: random_reaches(bare, limits, 1, 1),
        lambda: ControlLaw.from_frequency(FEEDFORWARD_PD, bare, TRAJECTORY, 10.0),
        lambda: analyse(ControlLoop(bare, law, TRAJECTORY, limits.effort), ErrorModel()),
        lambda: simulate(ControlLoop(sound, law, TRAJECTORY), bare, zero),
    ):
        with pytest.raises(RobotError, match=BY_NAME):
            attempt()
