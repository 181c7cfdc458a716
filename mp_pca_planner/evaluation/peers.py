# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""Planners of others on the same problems: Crocoddyl; among obstacles OMPL, VAMP, RoboPlan."""

from __future__ import annotations

import time
from collections.abc import Callable
from importlib import import_module
from itertools import combinations
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np
import pinocchio as pin
import yaml

from ..arrays import FloatArray
from ..exceptions import PlannerError, require
from ..files import read_text
from ..motion.collision import package_folders
from ..motion.trajectory import Trajectory
from ..planning.search.detours import sampled_path
from ..robot.limits import JointLimits
from ..robot.model import Robot
from ..robot.world import Box, Capsule, Cylinder, Obstacle, Shape, Sphere, World
from .methods import Method, PeerResult, minimum_jerk
from .problems import Problem, Scene
from .referee import RigidArm

# Weights of costs are multiples of the mean of ½‖τ‖² of the minimum-jerk motion. With these, goal
# errors are below 0.1 mrad and limit violations about 0.5 %; larger ones take more iterations.
_GOAL_WEIGHT = 1e4
_BARRIER_WEIGHT = 1e2
# Longest time step [s].
_STEP = 0.01
# Relative difference from the converged cost that ends a timed run.
_CONVERGENCE = 0.01
# Iterations after which a run has converged.
_MAX_ITERATIONS = 200


def crocoddyl_method(scene: Scene, max_time: float, *, box: bool) -> Method:
    """One of Crocoddyl's solvers, run until it is within 1 % of its own converged cost.

    The states at every step are the unknowns: semi-implicit Euler integration, J = ½∫‖τ‖²dt as the
    running cost, the goal as a terminal cost, limits of positions and velocities as quadratic
    barriers. BoxFDDP has the efforts as controls, with hard limits; FDDP has the accelerations,
    which improves its convergence, and a barrier for the limits of the efforts.

    A run to convergence without a clock finds the number of iterations after which the cost stays
    within 1 % of the last one; the timed runs do as many. Threads may slow each other down.
    Therefore the faster of two runs counts: one with the solver's default number of threads, and
    one with a single thread.
    """
    shooting = _Shooting(scene, box)
    iterations: dict[Problem, int] = {}

    def solve(problem: Problem) -> PeerResult:
        """Solve one problem; the time to set it up is not counted."""
        if problem not in iterations:
            iterations[problem] = _iterations_needed(shooting, problem, max_time)
        if iterations[problem] == 0:
            return PeerResult(None, float("nan"), status=f"not converged in {max_time:g} s")
        took = []
        for one_thread in (False, True):
            solver, states, controls = shooting.set_up(problem)
            if one_thread:
                solver.problem.nthreads = 1
            began = time.perf_counter()
            solver.solve(states, controls, iterations[problem], False)
            took.append(time.perf_counter() - began)
        motion = shooting.trajectory(solver.xs, problem)
        return PeerResult(motion, min(took), iterations[problem])

    kind = "BoxFDDP, efforts limited" if box else "FDDP, efforts by a barrier"
    about = (
        f"Crocoddyl's {kind}, steps of {1e3 * _STEP:g} ms, until within "
        f"{_CONVERGENCE:.0%} of its own converged cost"
    )
    return Method("box_fddp" if box else "fddp", about, solve, slow=True)


def _iterations_needed(shooting: _Shooting, problem: Problem, max_time: float) -> int:
    """Iterations after which the cost stays within 1 % of the converged one, 0 if never."""
    solver, states, controls = shooting.set_up(problem)
    deadline = time.perf_counter() + max_time
    costs: list[float] = []

    class Recorder(shooting.crocoddyl.CallbackAbstract):  # type: ignore[misc, name-defined]
        def __call__(self, running: Any) -> None:
            costs.append(running.cost if running.isFeasible else np.inf)
            if time.perf_counter() > deadline:
                raise TimeoutError

    solver.setCallbacks([Recorder()])
    try:
        solver.solve(states, controls, _MAX_ITERATIONS, False)
    except TimeoutError:
        return 0
    if not costs or not np.isfinite(costs[-1]):
        return 0
    outside = np.flatnonzero(np.abs(np.array(costs) / costs[-1] - 1.0) > _CONVERGENCE)
    return int(outside[-1]) + 2 if outside.size else 1


class _Shooting:
    """Problems of one scene as Crocoddyl's shooting problems."""

    def __init__(self, scene: Scene, box: bool) -> None:
        self.crocoddyl = require("crocoddyl", "peers", "the peers 'fddp' and 'box_fddp'")
        self._box, self._limits = box, scene.limits
        self._joints = scene.robot.joint_names
        self._arm = RigidArm(scene.urdf, self._joints)
        self._state = self.crocoddyl.StateMultibody(self._arm.model)
        self._actuation = self.crocoddyl.ActuationModelFull(self._state)

    def set_up(self, problem: Problem) -> tuple[Any, list[FloatArray], list[FloatArray]]:
        """The solver, and the minimum-jerk motion with its controls as a start."""
        crocoddyl, arm = self.crocoddyl, self._arm
        n_steps = int(np.ceil(problem.duration / _STEP))
        q, v, a = minimum_jerk(problem, np.linspace(0.0, 1.0, n_steps + 1))
        guess = [np.r_[arm.configuration(x), arm.velocity(y)] for x, y in zip(q, v, strict=True)]
        tau = [arm.velocity(x) for x in arm.efforts(q, v, a)[:-1]]
        controls = tau if self._box else [arm.velocity(x) for x in a[:-1]]
        unit = 0.5 * float(np.mean(np.sum(np.square(tau), axis=1)))
        running = self._action(self._running_costs(unit), problem.duration / n_steps)
        ending = crocoddyl.CostModelSum(self._state)
        target = np.r_[arm.configuration(problem.goal), v[-1]]
        residual = crocoddyl.ResidualModelState(self._state, target)
        goal = crocoddyl.CostModelResidual(self._state, residual)
        ending.addCost("goal", goal, _GOAL_WEIGHT * unit)
        final = self._action(ending, 0.0)
        shooting = crocoddyl.ShootingProblem(guess[0], [running] * n_steps, final)
        kind = crocoddyl.SolverBoxFDDP if self._box else crocoddyl.SolverFDDP
        return kind(shooting), guess, controls

    def _running_costs(self, unit: float) -> Any:
        """J, and barriers for the limits."""
        crocoddyl, state, arm, limits = self.crocoddyl, self._state, self._arm, self._limits
        # The controls of BoxFDDP are the efforts; the efforts of FDDP follow from its
        # accelerations.
        effort = (
            crocoddyl.ResidualModelControl(state, state.nv)
            if self._box
            else crocoddyl.ResidualModelJointEffort(
                state, self._actuation, np.zeros(state.nv), state.nv
            )
        )
        costs = crocoddyl.CostModelSum(state)
        costs.addCost("effort", crocoddyl.CostModelResidual(state, effort), 1.0)
        lower = np.r_[arm.velocity(limits.lower), -arm.velocity(limits.velocity)]
        upper = np.r_[arm.velocity(limits.upper), arm.velocity(limits.velocity)]
        of_states = crocoddyl.ResidualModelState(state, state.zero())
        weight = _BARRIER_WEIGHT
        costs.addCost("states", self._barrier(of_states, lower, upper), weight * unit)
        if not self._box:
            bound = arm.velocity(limits.effort)
            costs.addCost("efforts", self._barrier(effort, -bound, bound), weight)
        return costs

    def _barrier(self, residual: Any, lower: FloatArray, upper: FloatArray) -> Any:
        crocoddyl = self.crocoddyl
        bounds = crocoddyl.ActivationBounds(lower, upper)
        barrier = crocoddyl.ActivationModelQuadraticBarrier(bounds)
        return crocoddyl.CostModelResidual(self._state, barrier, residual)

    def _action(self, costs: Any, step: float) -> Any:
        """One step of the dynamics with its costs."""
        crocoddyl = self.crocoddyl
        parts = self._state, self._actuation, costs
        if not self._box:
            dynamics = crocoddyl.DifferentialActionModelFreeInvDynamics(*parts)
            return crocoddyl.IntegratedActionModelEuler(dynamics, step)
        dynamics = crocoddyl.DifferentialActionModelFreeFwdDynamics(*parts)
        # With Pinocchio 4, Crocoddyl 3.2.1 omits gravity in its alternative computation by `aba`.
        dynamics.armature = np.zeros(self._state.nv)
        action = crocoddyl.IntegratedActionModelEuler(dynamics, step)
        bound = self._arm.velocity(self._limits.effort)
        action.u_lb, action.u_ub = -bound, bound
        return action

    def trajectory(self, states: Any, problem: Problem) -> Trajectory:
        """Positions and their finite differences, which avoid the error of an Euler step."""
        arm = self._arm
        x = np.array(states)
        q = np.array([arm.angles(configuration) for configuration in x[:, : arm.model.nq]])
        # A cosine and a sine do not count full turns, so each step is the smallest possible.
        q = np.where(arm.continuous, np.unwrap(np.vstack([problem.start, q]), axis=0)[1:], q)
        times = np.linspace(0.0, problem.duration, len(q))
        v = np.gradient(q, times, axis=0)
        v[[0, -1]] = x[[0, -1], arm.model.nq :][:, arm.velocity_index]
        return Trajectory(self._joints, times, q, v, np.gradient(v, times, axis=0))


_SAME_PLACE = 1e-3  # Distance of the hand in two models of a robot [m]; VAMP has 32 bits.


def ompl_method(scene: Scene, max_time: float) -> Method:
    """RRT-Connect of OMPL with shortcuts and smoothing, then TOPP-RA."""
    require("ompl", "ompl", "the peer 'ompl_toppra'")
    collision, limits = scene.collision, scene.limits
    assert collision is not None

    def search(problem: Problem) -> tuple[FloatArray | None, float]:
        """Search a path with the planner's own distances."""
        began = time.perf_counter()
        path = sampled_path(
            collision.collides,
            (limits.lower, limits.upper),
            (problem.start, problem.goal),
            lambda: time.perf_counter() - began > max_time,
            step=0.05,
            smooths=True,
        )
        return path, time.perf_counter() - began

    about = (
        "RRT-Connect of OMPL, shortcuts and smoothing, then TOPP-RA within the limits of "
        "velocities and accelerations"
    )
    return _along_paths("ompl_toppra", about, scene, search)


def vamp_method(scene: Scene, max_time: float) -> Method:
    """RRT-Connect of VAMP with its simplification, then TOPP-RA.

    Raises
    ------
    MissingDependencyError
        If VAMP is not installed.
    PlannerError
        If it has no such robot.
    """
    # A library for sound has the name `vamp`, too, but not this module.
    require("vamp.constants", "vamp", "the peer 'vamp_toppra'")
    vamp = import_module("vamp")
    name = vamp_robot(vamp, scene.robot)
    collision = scene.collision
    assert collision is not None
    robot, plan, options, shortening = vamp.configure_robot_and_planner_with_kwargs(name, "rrtc")

    def search(problem: Problem) -> tuple[FloatArray | None, float]:
        """Search a path among the obstacles of the collision model."""
        ends = problem.start.tolist(), problem.goal.tolist()
        environment = _environment(vamp, robot, collision.world, ends)
        began, sampler, path = time.perf_counter(), robot.halton(), None
        found = plan(*ends, environment, options, sampler)
        if found.solved:
            shorter = robot.simplify(found.path, environment, shortening, sampler).path
            path = np.array(shorter.numpy(), dtype=float)
        took = time.perf_counter() - began
        return (path if took <= max_time else None), took

    about = (
        f"RRT-Connect and simplification of VAMP with its model of '{name}', "
        f"{robot.n_spheres()} spheres in place of the links, then TOPP-RA as for OMPL"
    )
    return _along_paths("vamp_toppra", about, scene, search)


def _along_paths(
    name: str,
    about: str,
    scene: Scene,
    search: Callable[[Problem], tuple[FloatArray | None, float]],
) -> Method:
    """A search that returns a path and the time it took, then TOPP-RA.

    TOPP-RA keeps velocities and accelerations; jerks and efforts are not kept.
    """
    toppra = require("toppra", "peers", f"the peer '{name}'")
    limits, both, bounds = scene.limits, np.array([-1.0, 1.0]), toppra.constraint
    constraints = [bounds.JointVelocityConstraint(np.outer(limits.velocity, both))]
    if np.isfinite(limits.acceleration).all():
        bound = np.outer(limits.acceleration, both)
        constraints.append(bounds.JointAccelerationConstraint(bound))

    def timed(path: FloatArray) -> Any:
        """The time-optimal motion along a path; None if there is none."""
        lengths = np.linalg.norm(np.diff(path, axis=0), axis=1)
        path, lengths = path[np.append(True, lengths > 1e-6)], lengths[lengths > 1e-6]
        spline = toppra.SplineInterpolator(np.append(0.0, np.cumsum(lengths)), path)
        return toppra.algorithm.TOPPRA(constraints, spline).compute_trajectory()

    def solve(problem: Problem) -> PeerResult:
        """Find a path, and the shortest motion along it."""
        path, searched = search(problem)
        began = time.perf_counter()
        motion = None if path is None else timed(path)
        took = searched + time.perf_counter() - began
        if motion is None:
            what = "no path was found" if path is None else "the path could not be parametrised"
            return PeerResult(None, took, status=what, path_time=searched)
        # At most 10 ms apart.
        times = np.linspace(0.0, motion.duration, int(np.ceil(motion.duration / 0.01)) + 1)
        states = [motion(times, order) for order in range(3)]
        trajectory = Trajectory(limits.joint_names, times, *states)
        return PeerResult(trajectory, took, path_time=searched)

    return Method(name, about, solve)


def vamp_robot(vamp: Any, robot: Robot) -> str:
    """The name that VAMP has for a robot.

    Raises
    ------
    PlannerError
        If it has none with these joints in this order and the hand in the same place.
    """
    known = {tuple(getattr(vamp, name).joint_names()): str(name) for name in vamp.robots}
    if robot.joint_names not in known:
        robots = "; ".join(f"{name}: {', '.join(joints)}" for joints, name in known.items())
        raise PlannerError(
            f"VAMP has no robot with the joints {', '.join(robot.joint_names)} in this order; it "
            f"has {robots}"
        )
    name = known[robot.joint_names]
    model, q = getattr(vamp, name), np.full(robot.n_joints, 0.3)
    hand = model.end_effector()
    place = robot.frame_positions(q[None], [hand])[0, 0]
    distance = np.linalg.norm(place - model.eefk(q.tolist())[:3, 3])
    if distance > _SAME_PLACE:
        raise PlannerError(
            f"VAMP's model of '{name}' has '{hand}' {distance:.3g} m from here: expected the URDF "
            "of MotionBenchMaker"
        )
    return name


def _environment(vamp: Any, robot: Any, world: World, ends: tuple[list[float], ...]) -> Any:
    """Obstacles for VAMP; cylinders are boxes where capsules would contain a part of the robot.

    Raises
    ------
    PlannerError
        If the start or the goal is in collision.
    """
    add = {"Sphere": "add_sphere", "Cuboid": "add_cuboid", "Cylinder": "add_capsule"}
    for boxes in (False, True):
        environment = vamp.Environment()
        for kind, sizes in vamp_shapes(world, boxes=boxes):
            getattr(environment, add[kind])(getattr(vamp, kind)(*sizes))
        if all(robot.validate(end, environment) for end in ends):
            return environment
    raise PlannerError("the start or the goal is in collision for VAMP's spheres of the robot")


def vamp_shapes(world: World, *, boxes: bool) -> list[tuple[str, tuple[Any, ...]]]:
    """VAMP's classes for the shapes of a world, and their arguments.

    Its cylinders are capsules. As in VAMP's own scripts for MotionBenchMaker, capsules or boxes
    that contain them stand for cylinders.

    Parameters
    ----------
    world : World
        Spheres, boxes, capsules and cylinders.
    boxes : bool
        Whether cylinders become boxes.

    Raises
    ------
    PlannerError
        If there is another shape, or an obstacle that moves with a link.
    """
    return [_vamp_shape(one, shape, boxes) for one in world for shape in one.shapes]


def _vamp_shape(obstacle: Obstacle, shape: Shape, boxes: bool) -> tuple[str, tuple[Any, ...]]:
    if obstacle.frame:
        raise PlannerError(f"VAMP gets no obstacles on links, as '{obstacle.name}'")
    angles = pin.rpy.matrixToRpy(pin.Quaternion(np.array(shape.orientation)).matrix())
    place, pose = shape.position.tolist(), (shape.position.tolist(), angles.tolist())
    if isinstance(shape, Sphere):
        return "Sphere", (place, shape.radius)
    if isinstance(shape, Box):
        return "Cuboid", (*pose, (0.5 * shape.size).tolist())
    if isinstance(shape, Cylinder) and boxes and not isinstance(shape, Capsule):
        return "Cuboid", (*pose, [shape.radius, shape.radius, 0.5 * shape.height])
    if isinstance(shape, Cylinder):
        return "Cylinder", (*pose, shape.radius, shape.height)
    raise PlannerError(f"VAMP has no meshes, as of obstacle '{obstacle.name}'")


def roboplan_method(scene: Scene, max_time: float) -> Method:
    """RRT-Connect, shortcuts and TOPP-RA of RoboPlan, within velocities and accelerations.

    Raises
    ------
    MissingDependencyError
        If RoboPlan is not installed.
    """
    core = require("roboplan.core", "roboplan", "the peer 'roboplan'")
    rrt, toppra = import_module("roboplan.rrt"), import_module("roboplan.toppra")
    names, group = list(scene.robot.joint_names), "arm"
    collision = scene.collision
    assert collision is not None
    folders = [str(path) for path in package_folders([scene.urdf.parent], scene.urdf)]
    description = core.loadUrdfSceneDescription(str(scene.urdf), folders)
    srdf, rates = scene.urdf.with_suffix(".srdf"), _rates(scene.limits)

    def surroundings() -> Any:
        """The robot, its limits and the obstacles."""
        found = core.Scene("problem", description)
        if srdf.is_file():
            found.importSrdf(read_text(srdf))
        else:
            found.allowAdjacentLinkCollisions()
        with TemporaryDirectory() as folder:
            path = Path(folder) / "limits.yaml"
            path.write_text(yaml.safe_dump(rates), encoding="utf-8")
            found.importJointLimitsFromConfig(core.loadJointLimitsConfig(path))
        found.addGroup(group, names)
        own = [
            _add_shape(core, found, f"{one.name} {i}", one, shape)
            for one in collision.world
            for i, shape in enumerate(one.shapes)
        ]
        found.setCollisions(list(combinations(own, 2)), False)
        return found

    def solve(problem: Problem) -> PeerResult:
        """Find a path, and the shortest motion along it."""
        among = surroundings()
        ends = [core.JointConfiguration(names, q) for q in (problem.start, problem.goal)]
        began = time.perf_counter()
        options = rrt.RRTOptions(
            group_name=group, rrt_connect=True, max_planning_time=max_time, max_nodes=1_000_000
        )
        try:
            path = rrt.RRT(among, options).plan(*ends)
            shortcuts = core.PathShortcuttingOptions(group_name=group)
            path = core.PathShortcutter(among, shortcuts).shortcut(path)
            searched = time.perf_counter() - began
            timing = toppra.TOPPRAOptions(mode=toppra.SplineFittingMode.Adaptive)
            motion = toppra.PathParameterizerTOPPRA(among, group).generate(path, timing)
        except RuntimeError as error:
            return PeerResult(None, time.perf_counter() - began, status=str(error))
        took = time.perf_counter() - began
        states = map(np.array, (motion.positions, motion.velocities, motion.accelerations))
        return PeerResult(Trajectory(names, motion.times, *states), took, path_time=searched)

    about = (
        "RRT-Connect and shortcuts of RoboPlan, then its TOPP-RA (adaptive splines) within the "
        "limits of velocities and accelerations"
    )
    return Method("roboplan", about, solve)


def _rates(limits: JointLimits) -> dict[str, Any]:
    """Limits of velocities and accelerations in RoboPlan's form."""
    kinds = {"max_velocity": limits.velocity, "max_acceleration": limits.acceleration}
    return {
        "joint_limits": {
            name: {kind: [float(x[j])] for kind, x in kinds.items() if np.isfinite(x[j])}
            for j, name in enumerate(limits.joint_names)
        }
    }


def _add_shape(core: Any, among: Any, name: str, obstacle: Obstacle, shape: Shape) -> str:
    """Add a shape to a scene of RoboPlan; returns its name.

    Raises
    ------
    PlannerError
        If it moves with a link, or is neither a box, a sphere nor a cylinder.
    """
    if obstacle.frame:
        raise PlannerError(f"RoboPlan gets no obstacles on links, as '{obstacle.name}'")
    place = np.eye(4)
    place[:3, :3] = pin.Quaternion(np.array(shape.orientation)).matrix()
    place[:3, 3] = shape.position
    at = name, "universe"
    pose = np.asfortranarray(place), np.ones(4)
    if isinstance(shape, Box):
        among.addBoxGeometry(*at, core.Box(*shape.size), *pose)
    elif isinstance(shape, Sphere):
        among.addSphereGeometry(*at, core.Sphere(shape.radius), *pose)
    elif isinstance(shape, Cylinder) and not isinstance(shape, Capsule):
        among.addCylinderGeometry(*at, core.Cylinder(shape.radius, shape.height), *pose)
    else:
        raise PlannerError(
            f"RoboPlan gets boxes, spheres and cylinders, but '{obstacle.name}' is another shape"
        )
    return name
