#!/usr/bin/env python3
# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""Arms of MuJoCo Menagerie, driven by the core of the node: a physics engine of others.

The models come from the package mujoco-menagerie, which downloads them, or from a clone of it
(--models). Links, joints, inertias, rotors and effort limits are Menagerie's; MuJoCo moves them.
The planner gets the same links and joints as a URDF, but no rotors, as URDFs of real robots have
none. The controller is that of the simulated robot. Its drives replace those of Menagerie with
their damping: they are stiff, compensate gravity, and give no more than Menagerie's limits. Efforts
are those of the drives, relative to the planned ones. Node and arm are stepped in virtual time.

    PYTHONPATH=.:test python3 benchmarks/mujoco_arms.py [--goals 20]
        [--arms panda,ur5e,iiwa14] [--models FOLDER] [--json]
"""

from __future__ import annotations

import sys
import xml.etree.ElementTree as ET
from pathlib import Path

import mujoco
import numpy as np
import pinocchio as pin
from scipy.integrate import trapezoid
from support.tables import benchmark_parser, show
from support.virtual_node import VirtualNode

from mp_pca_planner.arrays import FloatArray
from mp_pca_planner.execution.outcomes import MotionOutcome
from mp_pca_planner.execution.parameters import Settings
from mp_pca_planner.execution.planning import assemble_model
from mp_pca_planner.motion.goal import JointGoal, JointState
from mp_pca_planner.motion.trajectory import Trajectory
from mp_pca_planner.primitives.build import build_primitive
from mp_pca_planner.recordings.reaches import random_reaches
from mp_pca_planner.robot.model import Robot
from mp_pca_planner.simulation.robot import PERIOD, Plant

ARMS = {
    "panda": ("franka_emika_panda", "panda_nohand"),
    "ur5e": ("universal_robots_ur5e", "ur5e"),
    "iiwa14": ("kuka_iiwa_14", "iiwa14"),
}
VELOCITY = 2.0  # Menagerie has no limits of velocities [rad/s]
ACCELERATION, JERK = 4.0, 80.0  # and of their derivatives
N_SUBSTEPS = 5  # the drives' torques are explicit, which is stable in shorter steps only
WAIT = 2.0  # longest time from the end of a motion to its report [s]


def main() -> int:
    """Print a row for each arm; returns 1 if a motion was refused or did not arrive."""
    parser = benchmark_parser(__doc__)
    parser.add_argument("--goals", type=int, default=20, help="for each arm")
    parser.add_argument("--arms", default=",".join(ARMS))
    parser.add_argument("--models", type=Path, help="clone of mujoco_menagerie")
    arguments = parser.parse_args()
    rows = []
    for name in arguments.arms.split(","):
        model = arm_model(name, arguments.models)
        rows.append([name, str(arguments.goals), *drive(model, arguments.goals)])
    header = ["arm", "goals", "arrived", "end error [mrad], median", "largest"]
    header += ["effort over planned, median", "largest", "saturated [%]"]
    show({"Arms of MuJoCo Menagerie": (header, rows)}, as_json=arguments.json)
    return int(any(row[1] != row[2] for row in rows))


def arm_model(name: str, folder: Path | None) -> mujoco.MjModel:
    """An arm without its shapes and drives, which are not needed."""
    directory, entry = ARMS[name]
    if folder is None:
        import mujoco_menagerie

        path = mujoco_menagerie.get(directory).path() / f"{entry}.xml"
    else:
        path = folder / directory / f"{entry}.xml"
    root = ET.parse(path).getroot()
    for parent in list(root.iter()):
        for child in list(parent):
            if child.tag in ("geom", "asset", "light", "contact", "keyframe"):
                parent.remove(child)
    spec = mujoco.MjSpec.from_string(ET.tostring(root, encoding="unicode"))
    spec.option.timestep = PERIOD / N_SUBSTEPS
    model = spec.compile()
    model.actuator_gainprm[:] = model.actuator_biasprm[:] = model.dof_damping[:] = 0.0
    return model


def urdf_of(model: mujoco.MjModel) -> str:
    """The links, joints, inertias and limits of an arm as a URDF."""
    root = ET.Element("robot", name="arm")
    ET.SubElement(root, "link", name="world")

    def pose(parent: ET.Element, position: FloatArray, quaternion: FloatArray) -> None:
        w, x, y, z = quaternion
        rpy = pin.rpy.matrixToRpy(pin.Quaternion(w, x, y, z).normalized().matrix())
        ET.SubElement(parent, "origin", xyz=text(position), rpy=text(rpy))

    for i in range(1, model.nbody):
        body, parent = model.body(i), model.body(model.body_parentid[i])
        link = ET.SubElement(root, "link", name=body.name)
        inertial = ET.SubElement(link, "inertial")
        pose(inertial, body.ipos, body.iquat)
        ET.SubElement(inertial, "mass", value=repr(float(body.mass[0])))
        xx, yy, zz = map(repr, body.inertia.tolist())
        ET.SubElement(inertial, "inertia", ixx=xx, iyy=yy, izz=zz, ixy="0", ixz="0", iyz="0")
        moves = bool(body.jntnum[0])
        name = model.joint(body.jntadr[0]).name if moves else f"to {body.name}"
        joint = ET.SubElement(root, "joint", name=name, type="revolute" if moves else "fixed")
        pose(joint, body.pos, body.quat)
        ET.SubElement(joint, "parent", link=parent.name)
        ET.SubElement(joint, "child", link=body.name)
        if moves:
            found = model.joint(name)
            ET.SubElement(joint, "axis", xyz=text(found.axis))
            lower, upper = map(repr, found.range.tolist())
            effort = repr(float(efforts_of(model)[found.dofadr[0]]))
            ET.SubElement(
                joint, "limit", lower=lower, upper=upper, effort=effort, velocity=str(VELOCITY)
            )
    return ET.tostring(root, encoding="unicode")


def text(values: FloatArray | list[float]) -> str:
    """Numbers of an attribute."""
    return " ".join(repr(float(x)) for x in values)


def efforts_of(model: mujoco.MjModel) -> FloatArray:
    """Largest efforts of the joints [N·m]."""
    found = np.full(model.nv, np.inf)
    for k in range(model.nu):
        joint = model.joint(model.actuator_trnid[k, 0])
        found[joint.dofadr[0]] = model.actuator_forcerange[k, 1]
    return found


class MujocoArm(Plant):
    """An arm that MuJoCo moves, with the drives of the simulated robot.

    Attributes
    ----------
    cost : float
        Effort of the drives J = ½∫‖τ‖²dt since it was set to 0 [N²·m²·s].
    n_saturated, n_steps : int
        Steps in which a drive was at its limit, and all steps.
    """

    def __init__(self, robot: Robot, start: FloatArray, model: mujoco.MjModel) -> None:
        super().__init__(robot, start)
        self._model, self._data = model, mujoco.MjData(model)
        self._dofs = np.array([model.joint(name).dofadr[0] for name in robot.joint_names])
        self._data.qpos[self._dofs] = start
        self._command, self.cost = start, 0.0
        self.n_saturated = self.n_steps = 0

    def step(self, command: FloatArray) -> None:
        """Move for one period towards commanded positions."""
        data, there = self._data, self._dofs
        rate = (command - self._command) / PERIOD
        self._command = command
        gravity = self._robot.gravity_efforts(self.q)
        for _ in range(N_SUBSTEPS):
            q, v = data.qpos[there], data.qvel[there]
            tau = gravity + self.kp * (command - self.lag * rate - q) + self.kd * (rate - v)
            acting = np.clip(tau, -self.effort, self.effort)
            data.qfrc_applied[there] = acting
            mujoco.mj_step(self._model, data)
            self.cost += 0.5 * float(acting @ acting) * PERIOD / N_SUBSTEPS
            self.n_saturated += int(np.any(acting != tau))
            self.n_steps += 1
        self.q, self.v = data.qpos[there].copy(), data.qvel[there].copy()


def drive(model: mujoco.MjModel, n_goals: int) -> list[str]:
    """Send goals to the node of an arm, and summarise what became of them."""
    urdf = urdf_of(model)
    robot = Robot(urdf)
    motions = random_reaches(robot, robot.limits(), 30, 1)
    limits = {
        name: {"max_acceleration": ACCELERATION, "max_jerk": JERK} for name in robot.joint_names
    }
    settings = Settings(limits=limits, max_solve_time=60.0)
    served = assemble_model(urdf, [build_primitive(motions, "reach")], settings, {})
    problems = random_reaches(robot, robot.limits(), n_goals, 2)
    start = problems[0].positions[0]
    node = VirtualNode(served, start)
    arm = node.robot.plant = MujocoArm(robot, start, model)
    node.run(0.1)  # the first joint states arrive
    errors, ratios, n_arrived = [], [], 0
    for i, problem in enumerate(problems):
        goal = problem.positions[-1 if i % 2 == 0 else 0]
        n_sent, n_reports = len(node.sent), len(node.execution_reports)
        arm.cost = 0.0
        node.goal(JointGoal(JointState(robot.joint_names, goal)), i)
        while len(node.sent) == n_sent and len(node.plan_reports) <= i:
            node.run(0.01)
        if len(node.sent) == n_sent:
            print(f"{i}: {node.plan_reports[-1].message}", file=sys.stderr)
            continue
        planned = node.sent[-1][1]
        deadline = node.now + planned.duration + WAIT
        while len(node.execution_reports) == n_reports and node.now < deadline:
            node.run(0.01)
        done = node.execution_reports[n_reports:]
        for _, report in done:
            if report.outcome != MotionOutcome.ARRIVED:
                print(f"{i}: {report.message}", file=sys.stderr)
        n_arrived += any(report.outcome == MotionOutcome.ARRIVED for _, report in done)
        errors.append(1e3 * float(np.abs(arm.q - goal).max()))
        ratios.append(arm.cost / planned_effort(robot, planned))
    return [
        str(n_arrived),
        f"{np.median(errors):.3f}",
        f"{max(errors):.3f}",
        f"{np.median(ratios):.3f}",
        f"{max(ratios):.3f}",
        f"{100.0 * arm.n_saturated / arm.n_steps:.2f}",
    ]


def planned_effort(robot: Robot, motion: Trajectory) -> float:
    """J of a planned motion by the planner's model [N²·m²·s]."""
    tau = robot.inverse_dynamics(motion.positions, motion.velocities, motion.accelerations)
    return float(trapezoid(0.5 * np.sum(tau**2, axis=1), motion.times))


if __name__ == "__main__":
    sys.exit(main())
