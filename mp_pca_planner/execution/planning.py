# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""The planner of a node: set up from primitives, a robot and settings, it plans one goal at a time.

It runs in a process of its own. It knows neither ROS nor the robot's present state beyond what a
request says.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Self

import numpy as np

from ..control.law import control_statement
from ..exceptions import GoalError, PlannerError, quote_names, unknown_name
from ..input_limits import INPUT_LIMITS
from ..motion.collision import CollisionModel
from ..motion.goal import JointState, PoseGoal, SequenceGoal
from ..motion.interpolation import hermite_functions
from ..motion.trajectory import Trajectory
from ..motion.validation import LimitCheck, check_limits
from ..planning.context import Budget
from ..planning.demonstrated import robot_collision
from ..planning.objectives import objective_weights, weighted_objectives
from ..planning.path_constraints import PathConstraint, path_constraints
from ..planning.plan import Plan
from ..planning.planner import Planner
from ..planning.report import motion_remarks
from ..primitives.library import PrimitiveLibrary, load_primitives
from ..primitives.primitive import MovementPrimitive
from ..robot.limits import JointLimits, Overrides, limits_file_note
from ..robot.locked import carrying_joints, mimicry, relevant_joints
from ..robot.meshes import package_folders
from ..robot.model import Robot
from ..robot.world import World
from .link import (
    ModelFacts,
    Planned,
    PlanRequest,
    Rejected,
    RunningMotion,
    SetUp,
    SetUpDone,
    WatchedRobot,
)
from .motions import MIN_STEP, PublishedMotion
from .parameters import REFUSE, Settings, check_limit_names, locked_positions

LOCKED_TOLERANCE = 1e-3
"""Distance from its position in the model up to which a locked joint counts as there [rad or m]:
more than the noise of sensors."""

# Change of the goal up to which a motion is displaced without planning, while it runs and at its
# end [rad or m]. Planned motions would swing as the demonstrations do.
_NEAR, _NEAR_AT_REST, _SAME = 0.15, 0.03, 1e-4
# Duration of a displaced motion in durations of the planned one.
_SLOWEST = 2.0


@dataclass(frozen=True, eq=False)
class Model:
    """A planner with its robot, limits and settings.

    Attributes
    ----------
    planner : Planner
        The planner.
    robot : Robot
        Its robot.
    limits : JointLimits
        The limits of its joints.
    settings : Settings
        The parameters.
    end_effector : str
        The link of pose goals and previews.
    urdf : str
        The robot description.
    collision : CollisionModel or None
        The collision model without obstacles. None if the robot's collision geometry can't be used.
    constraints : tuple of PathConstraint
        Constraints on every configuration.
    remarks : tuple of str
        What is not checked for collisions, against expectation.
    """

    planner: Planner
    robot: Robot
    limits: JointLimits
    settings: Settings
    end_effector: str
    urdf: str
    collision: CollisionModel | None = None
    constraints: tuple[PathConstraint, ...] = ()
    remarks: tuple[str, ...] = ()

    @property
    def facts(self) -> ModelFacts:
        """What the node needs to know of it."""
        links = {self.settings.end_effector_frame}
        robot, notes = self.robot, []
        if unlimited := self.limits.unlimited:
            notes.append(f"{unlimited}: set them with 'limits_file' before a real robot moves")
        if found := self.planner.default_accelerations:
            listed = ", ".join(f"'{name}' {value:.3g}" for name, value in found.items())
            notes.append(
                "joints without a limit of acceleration keep the demonstrated one times "
                f"{self.settings.demonstrated_margin:g} [/s²]: {listed}; stops "
                "keep only limits that are set"
            )
        if note := limits_file_note(self.settings.limits_file):
            notes.append(note)
        notes += self.remarks
        if not self.settings.collision:
            notes.append("self-collision is not checked: set 'collision' to true to avoid it")
        return ModelFacts(
            self.limits,
            dict(robot.drives),
            dict(robot.locked_positions),
            carrying_joints(robot, links),
            unknown_positions(self, World()),
            self.end_effector,
            tuple(notes),
        )


def assemble_model(
    urdf: str,
    primitives: Sequence[MovementPrimitive],
    settings: Settings,
    measured: Mapping[str, float] | None = None,
) -> Model:
    """Set up a planner for the joints of the primitives.

    Parameters
    ----------
    urdf :
        The robot description, XML text.
    primitives :
        At least one.
    settings :
        Limits and options.
    measured :
        Measured positions of any joints [rad or m]; those that the primitives do not move are
        locked there.

    Raises
    ------
    PlannerError
        If these are inconsistent.
    """
    joint_names = primitives[0].joint_names
    check_limit_names((f"limits.{joint}.max_velocity" for joint in settings.limits), joint_names)
    robot = Robot(urdf, joint_names)
    known = [name for name in robot.movable_joints if name not in joint_names]
    for name in locked_positions(settings.locked_joints):
        if name not in known:
            reason = unknown_name("joint that the primitives do not move", name, known)
            raise PlannerError(f"parameter 'locked_joints': {reason}")
    if locked := _locked(robot, settings, measured or {}):
        robot = Robot(urdf, joint_names, locked=locked)
    given: tuple[Overrides | str, ...] = (settings.limits_file or {}, settings.limits)
    robot, limits = robot.with_drives(*given), robot.limits(*given)
    # Made now, so that no goal among the first obstacles waits for it.
    collision, remarks = _collision(robot, primitives, settings, World())
    frame = settings.end_effector_frame or robot.end_effector
    if frame not in robot.frame_names:
        reason = unknown_name("link of the robot description", frame, robot.frame_names)
        raise PlannerError(f"parameter 'end_effector_frame': {reason}")
    weights = objective_weights(settings.objective, "parameter 'objective'")
    options = replace(
        settings.planner_options,
        objectives=weighted_objectives(weights, robot, frame),
        constraints=path_constraints(settings.constraints, "parameter 'constraints'", robot),
    )
    planner = Planner(robot, primitives, limits, options, collision=False)
    if collision is not None and settings.collision:
        planner.use_collision(collision.with_world(World()))
    constraints = options.constraints
    return Model(planner, robot, limits, settings, frame, urdf, collision, constraints, remarks)


def is_outdated(model: Model, measured: Mapping[str, float], world: World) -> bool:
    """Whether a joint that makes a difference was measured away from where a model locks it.

    Parameters
    ----------
    model :
        The model.
    measured :
        Measured positions of any joints [rad or m].
    world :
        The obstacles.
    """
    used = model.robot.locked_positions
    moved = {
        name
        for name, position in _locked(model.robot, model.settings, measured).items()
        if name not in used or abs(position - used[name]) > LOCKED_TOLERANCE
    }
    return bool(moved and moved.intersection(_relevant(model, world)))


def unknown_positions(model: Model, world: World) -> str:
    """Which joints make a difference and have an unknown position; empty if there are none."""
    known, relevant = model.robot.locked_positions, _relevant(model, world)
    if texts := mimicry(model.robot, relevant):
        return texts[0]
    unknown = [name for name in relevant if name not in known]
    if not unknown:
        return ""
    return (
        f"the positions of joints {quote_names(unknown)} are not known: the primitives do not move "
        "them, but they place links with a mass or a collision shape; publish them in "
        "joint_states, or set the parameter 'locked_joints' (name=value,…)"
    )


def _relevant(model: Model, world: World) -> tuple[str, ...]:
    """The locked joints whose positions make a difference."""
    links = {model.settings.end_effector_frame, *(obstacle.frame for obstacle in world)}
    links |= {constraint.frame for constraint in model.constraints}
    pairs = model.collision is not None and model.collision.checks_links
    return relevant_joints(model.robot, pairs=pairs, links=links)


def _locked(robot: Robot, settings: Settings, measured: Mapping[str, float]) -> dict[str, float]:
    """Positions of the joints that do not move: those given, replaced by those measured."""
    given = locked_positions(settings.locked_joints)
    names = set(robot.movable_joints) - set(robot.joint_names)
    return {
        name: position
        for name, position in {**given, **measured}.items()
        if name in names and math.isfinite(position)
    }


def _collision(
    robot: Robot, primitives: Iterable[MovementPrimitive], settings: Settings, world: World
) -> tuple[CollisionModel | None, tuple[str, ...]]:
    """The collision model of a robot, and what it does not check."""
    return robot_collision(
        robot,
        primitives,
        self_collision=settings.collision,
        srdf=settings.srdf or None,
        package_dirs=package_folders(settings.package_folders),
        world=world,
        margin=settings.obstacle_margin,
    )


@dataclass(frozen=True, eq=False)
class WatchedModel:
    """A robot and its settings, for its collisions with obstacles alone.

    Attributes
    ----------
    robot, settings, collision
        As of a `Model`.
    """

    robot: Robot
    settings: Settings
    collision: CollisionModel | None

    @classmethod
    def of(cls, watched: WatchedRobot) -> Self:
        """The robot that a message describes."""
        robot = Robot(watched.urdf, watched.joint_names, locked=watched.locked)
        settings = replace(watched.settings, collision=False)
        return cls(robot, settings, _collision(robot, (), settings, World())[0])


def in_world(model: Model | WatchedModel, world: World) -> CollisionModel:
    """The collision model of a robot among obstacles.

    Raises
    ------
    RobotError
        If the robot's geometry can't be used.
    """
    if model.collision is not None:
        return model.collision.with_world(world)
    made, _ = _collision(model.robot, (), model.settings, world)
    assert made is not None, "obstacles need a collision model"
    return made


class GoalPlanner:
    """Plans motions for the goals of a node.

    Parameters
    ----------
    is_cancelled : callable
        Whether the request with a key is no longer needed.

    Attributes
    ----------
    model : Model or None
        The model in use.
    world : World
        The obstacles.
    unplaced : str
        Why it is unknown where an obstacle is; empty if that is known of all.
    settle : callable
        Called between planning and the answer: takes the obstacles that have arrived meanwhile.
    """

    def __init__(self, is_cancelled: Callable[[int], bool] = lambda _: False) -> None:
        self._is_cancelled = is_cancelled
        self.model: Model | None = None
        self.world, self.unplaced = World(), ""
        self.settle: Callable[[], None] = lambda: None
        # The files that were read last, and their primitives; none if they can't be read.
        self._paths: tuple[str, ...] = ()
        self._library: PrimitiveLibrary | None = None
        # The newest plans, to keep one of them as a primitive.
        self.plans: dict[int, Plan] = {}

    def set_up(self, message: SetUp) -> SetUpDone:
        """Use primitives, robot and parameters, if they fit together."""
        paths = message.settings.primitive_paths
        library = self._library
        if message.rereads or self._paths != paths:
            try:
                library = load_primitives(paths) if paths else None
            except (PlannerError, OSError) as error:
                if message.rereads:
                    self._paths = paths
                return SetUpDone(message.number, problem=str(error), is_unreadable=True)
        names = library.joint_names if library else ()
        primitives = tuple(library.names) if library else ()
        model = None
        if library is not None and message.urdf:
            try:
                model = assemble_model(message.urdf, library, message.settings, message.measured)
            except PlannerError as error:
                return SetUpDone(message.number, names, primitives, problem=str(error))
        self._paths, self._library, self.model = paths, library, model
        facts = model.facts if model else None
        return SetUpDone(message.number, names, primitives, facts)

    def lock(self, measured: Mapping[str, float]) -> None:
        """Lock the joints that do not move where they are, by another model if need be."""
        model, library = self.model, self._library
        if model is not None and library and is_outdated(model, measured, self.world):
            self.model = assemble_model(model.urdf, library, model.settings, measured)

    def plan(self, request: PlanRequest) -> Planned | Rejected:
        """Plan a motion, continue the one that is running, or say why there is none."""
        try:
            if self.model is None:
                raise GoalError("the planner is being set up; send the goal again")
            self.lock(request.measured)
            return self._planned(request, self.model)
        except PlannerError as error:
            return Rejected(request.key, str(error))

    def _planned(self, request: PlanRequest, model: Model) -> Planned | Rejected:
        world = self.world
        if self.unplaced and model.settings.unplaced_obstacles == REFUSE:
            raise GoalError(
                f"{self.unplaced}; with the parameter 'unplaced_obstacles' of 'warn', goals are "
                "served without it"
            )
        if unknown := unknown_positions(model, world):
            raise GoalError(unknown)
        self._use_world(model)
        found = self._continued(request, model) or self._solved(request, model)
        self.settle()
        if self.world is not world and isinstance(found, Planned):
            self._use_world(model)
            collision = model.planner.collision
            if collision is not None and (met := collision.collisions(found.trajectory)):
                raise GoalError(
                    f"the obstacles changed during planning: {met[0]}; send the goal again"
                )
        return found

    def _use_world(self, model: Model) -> None:
        """Give the planner the newest obstacles."""
        collision, world = model.planner.collision, self.world
        if len(world) if collision is None else collision.world is not world:
            model.planner.use_collision(in_world(model, world))

    def _solved(self, request: PlanRequest, model: Model) -> Planned | Rejected:
        """A plan that may be executed."""
        key, seconds = request.key, model.settings.planner_options.max_solve_time
        budget = Budget(seconds, lambda: self._is_cancelled(key))
        plan = model.planner.plan(request.goal, request.start, budget=budget)
        if self._is_cancelled(key):
            return Rejected(key, "it is not needed any more", is_preempted=True)
        if not plan.is_executable:
            return Rejected(key, plan.message, plan.summary())
        self.plans = {**dict(list(self.plans.items())[-3:]), key: plan}
        library = model.planner.primitives
        laws = {name: control_statement(library.named(name)) for name in plan.primitives}
        return Planned(
            key,
            request.goal,
            plan.trajectory,
            plan.limit_check,
            plan.message,
            plan.remarks,
            plan.summary(),
            plan.primitives,
            laws,
            plan.trajectory.duration,
            plan.solve_time,
        )

    def _continued(self, request: PlanRequest, model: Model) -> Planned | Rejected | None:
        """Displace the running motion to another goal near its end; None if that is impossible.

        To a goal elsewhere, it is displaced if there is no plan. Streams of goals that drift do not
        delay the arrival then. A motion of primitives that are no longer there is not continued.
        """
        goal, running = request.goal, request.running
        if running is None or isinstance(goal, SequenceGoal) or goal.duration or goal.primitive:
            return None
        old = running.planned
        is_gone = not set(old.primitives) <= set(model.planner.primitives.names)
        if is_gone or isinstance(old.goal, SequenceGoal):
            return None
        began, found = time.monotonic(), None
        if isinstance(goal, PoseGoal):
            found = self._solved(request, model)
            if isinstance(found, Rejected):
                return found
            end = found.trajectory.positions[-1]
            target = JointState(request.start.joint_names, end)
        else:
            target = model.planner.target(goal, request.start)
            if model.planner.is_too_far(goal, request.start, target):
                return None
        change = float(np.abs(target.positions - old.trajectory.positions[-1]).max())
        if running.is_over and not _SAME < change <= _NEAR_AT_REST:
            return found  # if the robot is there, no motion is needed, says the planner
        if change > _NEAR:
            found = found or self._solved(request, model)
            if isinstance(found, Planned) or found.is_preempted:
                return found
        if (moved := self._displaced(request, target, running, model, began)) is None:
            return found
        # The plan of this pose is not the motion that is executed.
        self.plans.pop(request.key, None)
        return moved

    def _displaced(
        self,
        request: PlanRequest,
        target: JointState,
        running: RunningMotion,
        model: Model,
        began: float,
    ) -> Planned | None:
        """The running motion displaced to a target, if that keeps what motions have to."""
        found = displaced(running, target, model.robot, model.limits, model.settings.sample_period)
        collision = model.planner.collision
        if found is None or (collision is not None and collision.collisions(found[0])):
            return None
        trajectory, check = found
        for constraint in model.constraints:
            if np.any(constraint.values(model.robot, trajectory.positions)[0] < 0.0):
                return None
        message, solve_time = "the motion is continued to the new goal", time.monotonic() - began
        planned = running.planned
        values = {
            **{name: planned.values[name] for name in ("status", "primitive", "in_span_score")},
            "message": message,
            "duration": trajectory.duration,
            "effort_cost": trajectory.effort_cost,
            "solve_time_s": solve_time,
            "iterations": 0,
            "limit_violation": check.worst_excess,
            "start_error": 0.0,
            "goal_error": 0.0,
        }
        return replace(
            planned,
            key=request.key,
            goal=request.goal,
            trajectory=trajectory,
            check=check,
            message=message,
            remarks=tuple(motion_remarks(planned.values["in_span_score"], check)),
            values=values,
            solve_time=solve_time,
        )


def displaced(
    running: RunningMotion, goal: JointState, robot: Robot, limits: JointLimits, period: float
) -> tuple[Trajectory, LimitCheck] | None:
    """Displace the end of a motion, within the limits and without shortening it.

    The displacement is the minimum-jerk polynomial from 0 to the change of the goal, similar to how
    dynamic movement primitives adapt to changed goals. No motion starts anew, so goals that repeat
    or drift are reached at any rate.

    Parameters
    ----------
    running : RunningMotion
        The motion. Each motion of a stream of goals displaces the one before, and would take ever
        longer than the planned one without a bound.
    goal : JointState
        The new end, with its velocities; of the joints of the motion.
    robot, limits :
        Of the same joints.
    period : float
        Longest time between points [s].

    Returns
    -------
    trajectory, check :
        The displaced motion from the place on with its efforts, and its comparison with the
        limits; None if every displacement breaks a limit or takes too long.
    """
    motion = PublishedMotion(running.planned.trajectory, 0.0)
    place = min(running.place, motion.duration)
    change = np.abs(goal.positions - motion.end)
    bounds = (limits.velocity, limits.acceleration, limits.jerk)
    # Of the minimum-jerk polynomial from 0 to 1 in unit time.
    peaks = (1.875, 5.7735, 60.0)
    needed = [
        float(np.max(peak * change / bound)) ** (1.0 / order)
        for order, (peak, bound) in enumerate(zip(peaks, bounds, strict=True), start=1)
    ]
    # Small displacements are smooth, too, if they take a quarter of a second.
    shortest = max(0.25, *needed)
    duration = max(motion.duration - place, shortest)
    longest = _SLOWEST * max(running.planned.planned_duration, shortest)
    longest = min(longest, INPUT_LIMITS.longest_motion(period))
    # Longer ones are tried, because the sum with the motion must keep the limits.
    while duration <= longest:
        trajectory = _displaced_in(duration, motion, place, goal, period)
        check = check_limits(trajectory, robot, limits)
        if not check.violations:
            return trajectory.with_efforts(check.efforts), check
        duration *= 1.25
    return None


def _displaced_in(
    duration: float, motion: PublishedMotion, place: float, goal: JointState, period: float
) -> Trajectory:
    """The motion from a place on, plus the polynomial to the change of its end."""
    # At the points of the motion: between others, a quintic over a jump of the jerk exceeds it.
    own = motion.rest(place).times if place < motion.duration else np.zeros(1)
    own = own[own < max(duration - MIN_STEP, MIN_STEP)]
    n_more = max(int(np.ceil((duration - own[-1]) / period - 1e-6)), 6 - len(own), 1)
    times = np.concatenate([own, np.linspace(own[-1], duration, n_more + 1)[1:]])
    last = motion.state(motion.duration)
    ends = zip(last.values, goal.values, strict=True)
    change = [(new - old) * duration**d for d, (old, new) in enumerate(ends)]
    boundary = np.vstack([np.zeros((3, len(goal.positions))), change])
    columns = [
        x + hermite_functions(times / duration, d) @ boundary / duration**d
        for d, x in enumerate(motion.sample(place + times))
    ]
    for x, end in zip(columns, goal.values, strict=True):
        x[-1] = end
    return Trajectory(motion.trajectory.joint_names, times, *columns)
