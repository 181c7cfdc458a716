# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""An objective of one's own: keep the elbow near an angle, against the effort that it takes.

A class with a method `residuals` is all there is to write: it returns r and the derivatives of r
by positions, velocities, accelerations, jerks or efforts; ½∫‖r‖²dt is added to the objective.

    python examples/own_objective.py
"""

from __future__ import annotations

import numpy as np

from mp_pca_planner.motion.goal import JointGoal, JointState
from mp_pca_planner.planning.objectives import Effort, Nodes, Residuals
from mp_pca_planner.planning.plan import Plan, PlannerOptions
from mp_pca_planner.planning.planner import Planner
from mp_pca_planner.primitives.build import PrimitiveOptions, build_primitive
from mp_pca_planner.recordings.synthetic import JOINT_NAMES, generate_motions
from mp_pca_planner.resources import config_file
from mp_pca_planner.robot.model import Robot


class NearAngle:
    """Half the squared distance of a joint from an angle [rad²·s]."""

    def __init__(self, joint: str, angle: float) -> None:
        self._joint, self._angle = joint, angle

    def residuals(self, nodes: Nodes) -> Residuals:
        """The distance at every node, and its derivative by the positions."""
        j = nodes.robot.joint_names.index(self._joint)
        by_position = np.zeros((len(nodes.positions), 1, nodes.robot.n_joints))
        by_position[:, 0, j] = 1.0
        return Residuals(nodes.positions[:, [j]] - self._angle, {"positions": by_position})


def plan(weight: float) -> Plan:
    """Plan a made-up reach of the human-like arm with this weight of the new objective."""
    robot = Robot.from_file(config_file("human_arm.urdf"), JOINT_NAMES)
    motions = generate_motions(20, 5)
    demonstrations = [m.as_demonstration(f"motion_{i}") for i, m in enumerate(motions)]
    primitive = build_primitive(demonstrations, "reach", PrimitiveOptions(n_components=4))
    options = PlannerOptions(
        objectives=((1.0, Effort()), (weight, NearAngle("elbow", -0.4))), naturalness=0.01
    )
    planner = Planner(robot, [primitive], robot.limits(), options)
    start, goal = (JointState(JOINT_NAMES, motions[0].positions[end]) for end in (0, -1))
    return planner.plan(JointGoal(goal), start)


def main() -> None:
    """Print what more and more weight does."""
    for weight in (1e-3, 10.0, 1000.0):
        motion = plan(weight)
        elbow = motion.trajectory.positions[:, JOINT_NAMES.index("elbow")]
        away = np.sqrt(np.mean((elbow + 0.4) ** 2))
        effort = motion.solution.effort_cost
        print(f"weight {weight:g}: elbow {away:.3f} rad from -0.4, effort {effort:.1f} N²m²s")


if __name__ == "__main__":
    main()
