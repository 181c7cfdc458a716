# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""Plan, execute, record, learn, and plan again: the whole loop with a simulated robot.

The robot is the human-like arm with other masses and inertias than its model says, simulated
with Pinocchio's forward dynamics under the control law that is paired with the primitive. The
planner node plans the first motion; trials of it, scaled and warped, are executed, each recorded
into a bag from the robot's joint_states topic; the best becomes a new primitive, which the node
loads to plan the same goal again.

    PYTHONPATH=.:test python3 test/integration/learning_loop.py [--trials 20]

needs ROS 2 and the extras `learn` and `plot`. Leaves the bags, the primitives, and a picture of
the cost over the trials.
"""

from __future__ import annotations

import argparse
import os
import signal
import time
import xml.etree.ElementTree as ET
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np
import yaml
from scipy.integrate import trapezoid

from mp_pca_planner.control.closed_loop import ControlLoop, simulate
from mp_pca_planner.control.law import FEEDFORWARD_PD, ControlLaw, pair_law, paired_law
from mp_pca_planner.files import config_file
from mp_pca_planner.learning.refined_motion import primitive_around
from mp_pca_planner.learning.trials import improve_by_trials
from mp_pca_planner.motion.goal import JointGoal, JointState
from mp_pca_planner.motion.trajectory import Trajectory
from mp_pca_planner.planning.planner import Planner
from mp_pca_planner.primitives.build import build_primitive
from mp_pca_planner.primitives.file import save_primitive
from mp_pca_planner.recordings.bags import write_joint_states
from mp_pca_planner.recordings.synthetic import JOINT_NAMES, generate_motions
from mp_pca_planner.robot.model import Robot

MODEL_ERROR = 0.3
NATURAL_FREQUENCY = 30.0
PUBLISHED_EVERY = 10  # control periods of 1 ms
STILL_SECONDS = 1.5  # more than the node needs to see that a robot rests, also on a busy machine


def main() -> None:
    """Run the loop."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--output", type=Path, default=Path("loop_output"), metavar="DIR")
    parser.add_argument("--trials", type=int, default=20)
    arguments = parser.parse_args()
    folder = arguments.output
    (folder / "primitives").mkdir(parents=True, exist_ok=True)
    from support.node_setup import RobotClient, start_node

    from mp_pca_planner.ros.client import this_machine_only

    os.environ.update(this_machine_only())
    urdf = config_file("human_arm.urdf").read_text(encoding="utf-8")
    model = Robot(urdf, JOINT_NAMES)
    request = generate_motions(1, 5)[0].positions
    start, goal = JointState(JOINT_NAMES, request[0]), JointState(JOINT_NAMES, request[-1])
    primitive = build_primitive(generate_motions(30, 1), "shown")
    planner = Planner(model, [primitive], model.limits())
    plan = planner.plan(JointGoal(goal), start)
    law = ControlLaw.from_frequency(FEEDFORWARD_PD, model, plan.trajectory, NATURAL_FREQUENCY)
    primitive = pair_law(primitive, law, {})
    save_primitive(primitive, folder / "primitives" / "shown.npz", overwrite=True)

    # On a busy machine stamps come late, so that some trajectories would be stamped and others not.
    values = {
        "primitives": [str(folder / "primitives")],
        "robot_description": urdf,
        "stamp_trajectories": False,
    }
    parameters = {"mp_pca_planner": {"ros__parameters": values}}
    (folder / "planner.yaml").write_text(yaml.safe_dump(parameters), encoding="utf-8")
    node = start_node("--params-file", str(folder / "planner.yaml"), "--log-level", "warn")
    try:
        with RobotClient("robot_and_user") as client:
            robot = SimulatedRobot(perturbed(urdf), model, law, client, folder)
            client.wait_for_node()
            client.wait_for_model()
            planned = plan_by_node(client, robot, start, goal)
            costs = [robot.execute(planned, "planned")]

            def run(trajectory: Trajectory) -> float:
                costs.append(robot.execute(trajectory, f"trial_{len(costs)}"))
                return costs[-1]

            best = improve_by_trials(plan, run, arguments.trials).motion
            family = primitive_around(primitive, best, "learned", {"trials": arguments.trials})
            save_primitive(family, folder / "primitives" / "learned.npz", overwrite=True)
            (folder / "primitives" / "shown.npz").rename(folder / "shown.npz")
            answer = client.call("reload_primitives")
            if not answer.success:
                raise SystemExit(answer.message)
            again = robot.execute(plan_by_node(client, robot, start, goal), "planned_again")
    finally:
        node.send_signal(signal.SIGINT)
        node.wait()
    assert paired_law(family) is not None
    draw(folder / "cost_over_trials.png", costs, again)
    print(f"planned          cost {costs[0]:.2f}")
    print(f"best trial       cost {min(costs[1:]):.2f} ({int(np.argmin(costs[1:])) + 1})")
    print(f"planned again    cost {again:.2f}, {1.0 - again / costs[0]:.1%} less")
    print(f"see {folder / 'cost_over_trials.png'}")


def perturbed(urdf: str) -> Robot:
    """The arm with other masses and inertias than its model says."""
    rng = np.random.default_rng(0)
    root = ET.fromstring(urdf)
    for inertial in root.iter("inertial"):
        factor = 1.0 + MODEL_ERROR * rng.uniform(-1.0, 1.0)
        for element in inertial:
            for key, text in element.attrib.items():
                if element.tag in ("mass", "inertia"):
                    element.set(key, repr(factor * float(text)))
    return Robot(ET.tostring(root, encoding="unicode"), JOINT_NAMES)


class SimulatedRobot:
    """Follows trajectories under a control law; publishes its joint states and records them."""

    def __init__(self, robot, model, law, client, folder):
        self._robot, self._model, self._law = robot, model, law
        self._client, self._folder = client, folder

    def publish(self, position, velocity, effort) -> int:
        """Publish one joint state; returns its stamp [ns]."""
        from sensor_msgs.msg import JointState as Message

        stamp = time.time_ns()
        message = Message(name=list(JOINT_NAMES))
        message.header.stamp.sec, message.header.stamp.nanosec = divmod(stamp, 10**9)
        message.position, message.velocity = position.tolist(), velocity.tolist()
        message.effort = effort.tolist()
        self._client.publish("joint_states", message)
        return stamp

    def execute(self, trajectory: Trajectory, name: str) -> float:
        """Follow a trajectory in real time, record it, and return its cost."""
        loop = ControlLoop(self._model, self._law, trajectory, self._model.limits().effort)
        errors, acted = simulate(loop, self._robot, np.zeros(len(JOINT_NAMES)))
        times = loop.times
        q = loop.reference[0] - errors
        rows, began = [], time.perf_counter()
        # To its end, which the published steps need not meet.
        for k in sorted({*range(0, len(times), PUBLISHED_EVERY), len(times) - 1}):
            time.sleep(max(0.0, times[k] - (time.perf_counter() - began)))
            velocity = (q[min(k + 1, len(q) - 1)] - q[max(k - 1, 0)]) / (2.0 * loop.period)
            self.publish(q[k], velocity, acted[k])
            rows.append((int(times[k] * 1e9), q[k], acted[k]))
        stamps, positions, efforts = (np.array(column) for column in zip(*rows, strict=True))
        bag = self._folder / "bags" / f"{name}.mcap"
        bag.parent.mkdir(exist_ok=True)
        write_joint_states(
            bag, "mcap", JOINT_NAMES, stamps + 10**18, positions, efforts=efforts, overwrite=True
        )
        return 0.5 * float(trapezoid(np.sum(acted**2, axis=1), times))


def plan_by_node(client, robot: SimulatedRobot, start: JointState, goal: JointState) -> Trajectory:
    """Let the robot rest at the start, send the goal, and take what the node publishes."""
    from sensor_msgs.msg import JointState as Message

    from mp_pca_planner.ros.messages import to_trajectory

    zero = np.zeros(len(JOINT_NAMES))
    for _ in range(10):
        robot.publish(start.positions, zero, zero)
        time.sleep(STILL_SECONDS / 10)
    answer = client.send(Message(name=list(JOINT_NAMES), position=goal.positions.tolist()))
    if answer.trajectory is None:
        raise SystemExit(answer.report.message)
    return to_trajectory(answer.trajectory)


def draw(path: Path, costs: list[float], again: float) -> None:
    """Draw the cost over the trials."""
    trials = np.arange(1, len(costs))
    figure, axes = plt.subplots(figsize=(7.0, 4.0), layout="constrained")
    axes.plot(trials, costs[1:], "o", color="0.6", label="trials")
    axes.plot(trials, np.minimum.accumulate(costs[1:]), color="C0", label="best trial so far")
    axes.axhline(costs[0], color="C3", linestyle="--", label="planned with what was shown")
    axes.axhline(again, color="C2", label="planned again with what was learned")
    axes.set_xlabel("trial")
    axes.set_ylabel("measured effort ½∫‖τ‖²dt [N²m²s]")
    axes.legend()
    figure.savefig(path, dpi=120)
    plt.close(figure)


if __name__ == "__main__":
    main()
