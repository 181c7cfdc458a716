#!/usr/bin/env python3
# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""Efforts of planned motions on arms of MuJoCo Menagerie, beside those that plans state.

    python3 benchmarks/mujoco_arms.py [--goals 60] [--arms panda,ur5e,xarm7]
        [--models FOLDER] [--json]

The models come from the package mujoco-menagerie, which downloads them, or from a clone of it
(--models). Links, joints, inertias, rotors, damping, friction and effort limits are Menagerie's;
the planner has them all. MuJoCo moves the arms, two steps each millisecond, by two kinds of drives:

pd: the position servos of the model, with the planned velocities, too, and MuJoCo's own bias forces
    (gravity, Coriolis) added.
own: the same servos, commanded the planned positions alone: the arm lags behind and sags.

Each reach is driven by three motions of the same duration: the planner's with ρ = 1 and with ρ = 0,
and the minimum-jerk motion. The effort is ½∫‖τ‖²dt of the drives.
"""

from __future__ import annotations

import sys
import xml.etree.ElementTree as ET
from pathlib import Path

import mujoco
import numpy as np
import pinocchio as pin
from support.motion_referee import executed
from support.tables import benchmark_parser, show

from mp_pca_planner.arrays import FloatArray
from mp_pca_planner.motion.goal import JointGoal, JointState
from mp_pca_planner.motion.interpolation import hermite_functions
from mp_pca_planner.motion.trajectory import Trajectory
from mp_pca_planner.planning.options import PlannerOptions
from mp_pca_planner.planning.planner import Planner
from mp_pca_planner.primitives.build import build_primitive
from mp_pca_planner.recordings.reaches import random_reaches
from mp_pca_planner.robot.model import Robot

ARMS = {
    "panda": ("franka_emika_panda", "panda_nohand"),
    "ur5e": ("universal_robots_ur5e", "ur5e"),
    "xarm7": ("ufactory_xarm7", "xarm7_nohand"),
}
VELOCITY = 2.0  # Menagerie has no limits of velocities [rad/s]
ACCELERATION, JERK = 4.0, 80.0  # and of their derivatives
STEP = 5e-4  # of MuJoCo [s]
REST = 1.0  # time before and after a motion [s]
ARRIVED = 0.01  # largest error of a motion that arrives [rad]
MOTIONS = ("ρ = 1", "ρ = 0", "minimum jerk")


def main() -> int:
    """Print a row for each arm and drive."""
    parser = benchmark_parser(__doc__)
    parser.add_argument("--goals", type=int, default=60, help="for each arm")
    parser.add_argument("--arms", default="panda,ur5e,xarm7", help=f"of {', '.join(ARMS)}")
    parser.add_argument("--models", type=Path, help="clone of mujoco_menagerie")
    arguments = parser.parse_args()
    rows = []
    for name in arguments.arms.split(","):
        model = arm_model(name, arguments.models)
        motions = planned_motions(model, arguments.goals)
        for drive in ("pd", "own"):
            rows.append([name, drive, str(arguments.goals), *figures(model, motions, drive)])
    header = ["arm", "drive", "goals", "arrived [%]", "end error [mrad], median", "largest"]
    header += ["effort / stated, median", "least", "most", "torque / limit", "speed / limit"]
    header += ["saved by ρ = 0 over ρ = 1 [%]", "over minimum jerk [%]"]
    show({"Arms of MuJoCo Menagerie": (header, rows)}, as_json=arguments.json)
    return 0


def arm_model(name: str, folder: Path | None) -> mujoco.MjModel:
    """An arm without its shapes, which are not needed."""
    directory, entry = ARMS[name]
    if folder is None:
        import mujoco_menagerie

        folder = mujoco_menagerie.get(directory).path().parent
    root = ET.parse(folder / directory / f"{entry}.xml").getroot()
    for parent in list(root.iter()):
        for child in list(parent):
            if child.tag in ("geom", "asset", "light", "contact", "keyframe"):
                parent.remove(child)
    model = mujoco.MjSpec.from_string(ET.tostring(root, encoding="unicode")).compile()
    model.opt.timestep = STEP
    model.opt.integrator = mujoco.mjtIntegrator.mjINT_IMPLICITFAST
    return model


def urdf_of(model: mujoco.MjModel) -> str:
    """The links, joints, inertias, friction and limits of an arm as a URDF."""
    root = ET.Element("robot", name="arm")
    ET.SubElement(root, "link", name="world")

    def pose(parent: ET.Element, position: FloatArray, quaternion: FloatArray) -> None:
        w, x, y, z = quaternion
        rpy = pin.rpy.matrixToRpy(pin.Quaternion(w, x, y, z).normalized().matrix())
        ET.SubElement(parent, "origin", xyz=text(position), rpy=text(rpy))

    efforts = effort_limits(model)
    for i in range(1, model.nbody):
        body, parent = model.body(i), model.body(model.body_parentid[i])
        link = ET.SubElement(root, "link", name=body.name)
        inertial = ET.SubElement(link, "inertial")
        pose(inertial, body.ipos, body.iquat)
        ET.SubElement(inertial, "mass", value=text(body.mass))
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
            dof = found.dofadr[0]
            ET.SubElement(joint, "axis", xyz=text(found.axis))
            lower, upper = map(repr, found.range.tolist())
            limits = {"lower": lower, "upper": upper, "velocity": str(VELOCITY)}
            ET.SubElement(joint, "limit", limits, effort=text(efforts[dof]))
            damping, friction = model.dof_damping[dof], model.dof_frictionloss[dof]
            ET.SubElement(joint, "dynamics", damping=text(damping), friction=text(friction))
    return ET.tostring(root, encoding="unicode")


def text(values: FloatArray | float) -> str:
    """Numbers of an attribute."""
    return " ".join(repr(float(x)) for x in np.atleast_1d(values))


def effort_limits(model: mujoco.MjModel) -> FloatArray:
    """Largest efforts of the joints [N·m]."""
    found = np.zeros(model.nv)
    found[model.jnt_dofadr[model.actuator_trnid[:, 0]]] = model.actuator_forcerange[:, 1]
    return found


def planned_motions(
    model: mujoco.MjModel, n_goals: int
) -> list[dict[str, tuple[Trajectory, float]]]:
    """For each goal the motions by their names, and the efforts that are stated for them."""
    robot = Robot(urdf_of(model))
    names = robot.joint_names
    rotors = model.dof_armature[dofs_of(model, names)]
    robot = robot.with_drives(
        {name: {"armature": float(x)} for name, x in zip(names, rotors, strict=True)}
    )
    limits = robot.limits(
        {name: {"max_acceleration": ACCELERATION, "max_jerk": JERK} for name in names}
    )
    primitive = build_primitive(random_reaches(robot, limits, 30, 1), "reach")
    natural, least = (
        Planner(
            robot,
            [primitive],
            limits,
            PlannerOptions(naturalness=rho, max_solve_time=60.0),
            collision=False,
        )
        for rho in (1.0, 0.0)
    )
    found = []
    for reach in random_reaches(robot, limits, n_goals, 2):
        start, goal = (JointState(names, reach.positions[k]) for k in (0, -1))
        usual = natural.plan(JointGoal(goal), start)
        quiet = least.plan(JointGoal(goal, usual.motion.duration), start)
        straight = minimum_jerk(usual.trajectory)
        motions = {}
        for name, plan in zip(MOTIONS, (usual, quiet), strict=False):
            if not plan.is_executable:
                print(f"no motion with {name}: {plan.message}", file=sys.stderr)
                break
            motions[name] = plan.trajectory, plan.effort_cost
        else:
            found.append(motions | {MOTIONS[2]: (straight, np.nan)})
    return found


def minimum_jerk(trajectory: Trajectory) -> Trajectory:
    """The minimum-jerk motion with the ends and the duration of another one."""
    phases, ends = trajectory.times / trajectory.duration, trajectory.positions[[0, -1]]
    states = [
        hermite_functions(phases, order)[:, [0, 3]] @ ends / trajectory.duration**order
        for order in range(3)
    ]
    return Trajectory(trajectory.joint_names, trajectory.times, *states)


def dofs_of(model: mujoco.MjModel, names: tuple[str, ...]) -> FloatArray:
    """Where MuJoCo has some joints."""
    return np.array([model.joint(name).dofadr[0] for name in names])


def figures(
    model: mujoco.MjModel, found: list[dict[str, tuple[Trajectory, float]]], drive: str
) -> list[str]:
    """What became of the motions with one kind of drives."""
    driven = [
        {name: execute(model, motion, drive) for name, (motion, _) in motions.items()}
        for motions in found
    ]
    planned = [
        (one[name], motions[name][1])
        for one, motions in zip(driven, found, strict=True)
        for name in MOTIONS[:2]
    ]
    errors = np.array([1e3 * error for (_, error, _, _), _ in planned])
    ratios = np.array([effort / stated for (effort, *_), stated in planned])
    torque, speed = np.max([rest for (_, _, *rest), _ in planned], axis=0)
    efforts = np.array([[one[name][0] for name in MOTIONS] for one in driven])
    saved = 100.0 * (1.0 - np.median(efforts[:, [1]] / efforts[:, [0, 2]], axis=0))
    return [
        f"{100.0 * np.mean(errors < 1e3 * ARRIVED):.0f}",
        *(f"{x:.2f}" for x in (np.median(errors), errors.max())),
        *(f"{x:.3f}" for x in (np.median(ratios), ratios.min(), ratios.max())),
        *(f"{x:.2f}" for x in (torque, speed)),
        *(f"{x:.1f}" for x in saved),
    ]


def execute(
    model: mujoco.MjModel, motion: Trajectory, drive: str
) -> tuple[float, float, float, float]:
    """Drive a motion.

    Returns
    -------
    effort, error, torque, speed : float
        Effort of the drives until the end of the motion [N²·m²·s], largest error after it [rad],
        and largest torques and speeds as shares of their limits.
    """
    data = mujoco.MjData(model)
    there = dofs_of(model, motion.joint_names)
    servos = [list(model.actuator_trnid[:, 0]).index(model.dof_jntid[dof]) for dof in there]
    data.qpos[there] = data.ctrl[servos] = motion.positions[0]
    n_rest = round(REST / STEP)
    for _ in range(n_rest):  # the servos come to rest
        drive_step(model, data, drive)
    curve, n = executed(motion), round(motion.duration / STEP)
    times = np.minimum(np.arange(n + n_rest) * STEP, motion.duration)
    lead = -model.actuator_biasprm[servos, 2] / model.actuator_gainprm[servos, 0]
    commands = curve(times) + (lead * curve.derivative()(times) if drive == "pd" else 0.0)
    efforts = np.empty((n, len(there)))
    speed = 0.0
    for k, command in enumerate(commands):
        data.ctrl[servos], before = command, data.qvel[there]
        drive_step(model, data, drive)
        if k < n:
            # MuJoCo takes the velocity gain at the end of a step, but reports it at the beginning.
            efforts[k] = (data.qfrc_actuator + data.qfrc_applied)[there]
            efforts[k] -= model.actuator_biasprm[servos, 2] * (before - data.qvel[there])
            speed = max(speed, float(np.abs(data.qvel[there]).max()) / VELOCITY)
    return (
        0.5 * float(np.sum(efforts**2)) * STEP,
        float(np.abs(data.qpos[there] - motion.positions[-1]).max()),
        float((np.abs(efforts) / effort_limits(model)[there]).max()),
        speed,
    )


def drive_step(model: mujoco.MjModel, data: mujoco.MjData, drive: str) -> None:
    """Move for one step; of "pd", with the bias forces of the step before."""
    if drive == "pd":
        data.qfrc_applied[:] = data.qfrc_bias
    mujoco.mj_step(model, data)


if __name__ == "__main__":
    sys.exit(main())
