# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""Links without a valid inertia are rejected by name where efforts count, and only there."""

import re

import numpy as np
import pytest
from support.arm import JOINTS, arm_demonstrations, arm_primitive, arm_robot

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


def tensor(*values):
    pairs = zip(NAMES, (*values, 0, 0, 0)[:6], strict=True)
    return "<inertia " + " ".join(f'{name}="{value}"' for name, value in pairs) + "/>"


USUAL = tensor(0.1, 0.2, 0.15)


def inertial(mass=2, inertia=USUAL, xyz="0 0 -0.5"):
    return f'<inertial><origin xyz="{xyz}"/><mass value="{mass}"/>{inertia}</inertial>'


GOOD = inertial()
SHAPE = '<visual><geometry><sphere radius="0.1"/></geometry></visual>'


def pendulum(middle=GOOD, tip=GOOD, *, last="fixed", base=""):
    """Base, a link `middle` on a joint `swing`, and a link `tip` on it."""
    limit = '<limit lower="-2" upper="2" velocity="5" effort="50"/>'
    return f"""<robot name="pendulum"><link name="base">{base}</link>
<joint name="swing" type="revolute"><parent link="base"/><child link="middle"/>
  <axis xyz="0 1 0"/>{limit}</joint><link name="middle">{middle}</link>
<joint name="end" type="{last}"><origin xyz="0 0 -1"/><parent link="middle"/><child link="tip"/>
  <axis xyz="0 1 0"/>{limit}</joint><link name="tip">{tip}</link></robot>"""


def refusal(urdf):
    with pytest.raises(RobotError) as caught:
        Robot(urdf).require_inertias("tests")
    return str(caught.value)


BROKEN = {
    "no inertial": "",
    "mass 0": inertial(0, tensor(0, 0, 0)),
    "comma": inertial("2,5"),
    "NaN in the tensor": inertial(2, tensor("nan", 1, 1)),
    "products": inertial(2, tensor(1, 1, 1, 1.5, 0, 0)),
    "triangle": inertial(2, tensor(1, 1, 2.5)),
}


@pytest.mark.parametrize("broken", BROKEN.values(), ids=BROKEN)
def test_moving_links_without_a_valid_inertia_are_rejected_by_name_and_in_silence(broken, capfd):
    message = refusal(pendulum(broken, "", last="fixed"))
    assert "these have no valid one: 'middle'; give each an <inertial> with a positive" in message
    # What does not move needs none.
    Robot(pendulum(base=broken)).require_inertias("tests")
    Robot(pendulum(broken, GOOD, last="revolute"), ["end"]).require_inertias("tests")
    assert capfd.readouterr() == ("", "")


def test_fixed_links_count_as_one_body():
    # A frame without mass at the tip, or a bare bracket that carries a mass.
    for urdf in (pendulum(GOOD, ""), pendulum("", GOOD), pendulum(SHAPE, GOOD)):
        Robot(urdf).require_inertias("tests")
    thin = inertial(1, tensor(0.1, 0.1, 0.9))  # impossible alone, but not with what it carries
    Robot(pendulum(thin, GOOD)).require_inertias("tests")
    q, a = np.array([[0.3], [-1.0]]), np.array([[2.0], [-1.0]])
    arm = 1.5  # from the axis to the centre of mass
    expected = (0.2 + 2.0 * arm**2) * a + 2.0 * 9.81 * arm * np.sin(q)
    tau = Robot(pendulum("", GOOD)).inverse_dynamics(q, 0.0 * q, a)
    np.testing.assert_allclose(tau, expected, atol=1e-12)


def test_links_without_mass_between_two_axes_are_valid_unless_they_have_a_shape():
    Robot(pendulum("", GOOD, last="revolute")).require_inertias("tests")
    assert "one: 'middle'; give" in refusal(pendulum(SHAPE, GOOD, last="revolute"))


# Where efforts count


def test_whatever_computes_efforts_takes_inertias_and_nothing_else_does():
    text = config_file("human_arm.urdf").read_text(encoding="utf-8")
    bare = Robot(re.sub(r"<inertial>.*?</inertial>", "", text, flags=re.DOTALL), JOINTS)
    sound, primitives = arm_robot(), [arm_primitive()]
    limits = bare.limits({name: {"max_effort": np.inf} for name in JOINTS})
    shown = arm_demonstrations()[0]
    ends = (JointState(JOINTS, shown.positions[end]) for end in (-1, 0))
    goal, start = JointGoal(next(ends)), next(ends)
    trajectory = Trajectory(
        JOINTS, shown.times, shown.positions, shown.velocities, shown.accelerations
    )
    by_jerk = PlannerOptions(objectives=((1.0, jerk),))
    plans = [Planner(x, primitives, limits, by_jerk).plan(goal, start) for x in (sound, bare)]
    known, unknown = plans
    assert unknown.status == SOLVED
    np.testing.assert_array_equal(unknown.trajectory.positions, known.trajectory.positions)
    assert known.trajectory.efforts is not None and unknown.trajectory.efforts is None
    assert np.isfinite(known.solution.effort_cost) and np.isnan(unknown.solution.effort_cost)
    assert check_limits(trajectory, bare, limits).violations == ()

    def planner(objective):
        options = PlannerOptions(objectives=((1.0, jerk), (0.1, objective)))
        return Planner(bare, primitives, limits, options)

    law = ControlLaw.from_frequency(COMPUTED_TORQUE, sound, trajectory, 10.0)
    for attempt, advice in (
        (lambda: planner(effort), ".*choose an objective without efforts"),
        (lambda: planner(energy), ".*choose an objective without efforts"),
        (lambda: Planner(bare, primitives, bare.limits(), by_jerk), ".*max_effort: .inf"),
        (lambda: check_limits(trajectory, bare, bare.limits()), ".*max_effort: .inf"),
        (lambda: refine([known.motion], bare, limits), ""),
        (lambda: random_reaches(bare, limits, 1, 1), ""),
        (lambda: ControlLaw.from_frequency(FEEDFORWARD_PD, bare, trajectory, 10.0), ""),
        (lambda: analyse(ControlLoop(bare, law, trajectory, limits.effort), ErrorModel()), ""),
        (lambda: simulate(ControlLoop(sound, law, trajectory), bare, np.zeros(4)), ""),
    ):
        with pytest.raises(RobotError, match=f"'upper_arm', 'lower_arm'; give{advice}"):
            attempt()


def test_unknown_efforts_are_not_a_number():
    robot, one = Robot(pendulum(GOOD, "", last="revolute")), np.ones((1, 2))
    assert np.isnan(robot.inverse_dynamics(one, one, one)).all()
