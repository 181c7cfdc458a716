# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""Fuzz test of the Python API: calls with wrong types, shapes and values.

    python3 benchmarks/fuzz_calls.py [--calls 5000] [--seed 0]
    python3 benchmarks/fuzz_calls.py --only 17           # one call, with its traceback

Each call is one of a public name of the package, of a method of its classes, or of a method of what
these return, with valid arguments of which one or several are replaced by odd ones; its number is
the seed. It may succeed or raise a `PlannerError`. It fails the test if it raises another error,
computes for more than 5 s or takes more than 500 MB. The script exits with 1 on any failure, and if
a public function has no valid call in `calls`.
"""

from __future__ import annotations

import argparse
import contextlib
import copy
import inspect
import io
import os
import resource
import signal
import sys
import tempfile
import time
import traceback
import warnings
from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass, fields
from decimal import Decimal
from fractions import Fraction
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np

import mp_pca_planner as mp
from mp_pca_planner.exceptions import MissingDependencyError
from mp_pca_planner.motion.collision import CollisionModel
from mp_pca_planner.planning.options import (
    BrakingOptions,
    ClearanceOptions,
    DetourOptions,
    PathOptions,
    PoseSearchOptions,
    SearchOptions,
    SelectionOptions,
    SolverOptions,
)
from mp_pca_planner.primitives.library import PrimitiveLibrary

CPU_SECONDS = 5.0
MEGABYTES = 500
ROBOT = mp.config_file("human_arm.urdf")
TETRAHEDRON = """v 0 0 0
v 1 0 0
v 0 1 0
v 0 0 1
f 1 3 2
f 1 2 4
f 1 4 3
f 2 3 4
"""
SCENE = """world:
  collision_objects:
    - {id: ball, primitives: [{type: 2, dimensions: [0.1]}]}
"""


class Hostile:
    """An object whose every conversion fails."""

    def _fail(self, *_: object) -> Any:
        raise ZeroDivisionError("hostile")

    __array__ = __float__ = __index__ = __len__ = __iter__ = __bool__ = __repr__ = _fail
    __eq__ = __hash__ = __lt__ = __fspath__ = _fail  # type: ignore[assignment]


def recursive() -> list[Any]:
    """A list that holds itself."""
    own: list[Any] = [0.0]
    own.append(own)
    return own


def nested(depth: int) -> list[Any]:
    """Lists in lists."""
    inner: list[Any] = []
    for _ in range(depth):
        inner = [inner]
    return inner


def of_objects(value: object) -> Any:
    """An array of four objects."""
    array = np.empty(4, dtype=object)
    for i in range(4):
        array[i] = value
    return array


NUMBERS: tuple[Callable[[], Any], ...] = tuple(
    (lambda value=value: value)
    for value in (
        *(None, True, False, 0, -1, 1, 3, 1.5, -0.0, 5e-324, 1e-300, 1e308, -1e308),
        *(float("nan"), float("inf"), -float("inf"), 1j, complex("nan"), 2**31, 2**63, -(2**64)),
        *(10**400, -(10**400), 10**5000, Fraction(1, 3), Fraction(10**400), Decimal("0.1")),
        *(Decimal("nan"), Decimal("1e999999"), np.float32(0.1), np.float64("nan"), np.int8(-3)),
        *(np.uint64(2**64 - 1), np.longdouble("1e4000"), np.bool_(True), np.complex64(1j)),
        *(np.datetime64("2020-01-01"), np.timedelta64(3, "s"), np.str_("0.1"), np.bytes_(b"1")),
    )
)
OTHERS: tuple[Callable[[], Any], ...] = (
    *(lambda: "", lambda: "abc", lambda: "0.1", lambda: "nan", lambda: "\0", lambda: "\ud800"),
    *(lambda: "a" * 5000, lambda: "elbow", lambda: "../..", lambda: "\x1b[31m\n", lambda: b""),
    *(lambda: b"\xff\0", lambda: bytearray(4), lambda: memoryview(b"1234"), object, Hostile),
    *(list, tuple, dict, set, frozenset, lambda: [[]], lambda: [None], lambda: ["a", 1, None]),
    *(lambda: [float("nan")] * 4, lambda: [10**400] * 4, lambda: [1j] * 4, lambda: ["0.1"] * 4),
    *(lambda: [10**5000] * 4, lambda: [[1, 2], [3]], recursive, lambda: nested(50)),
    *(lambda: nested(100_000), lambda: [Hostile()] * 4, lambda: [[0.1] * 4] * 3),
    *(lambda: {"elbow": "x"}, lambda: {"elbow": 10**400}, lambda: {1: 2}, lambda: {None: None}),
    *(lambda: {"elbow": recursive()}, lambda: {"elbow": None}, lambda: {"elbow": [0.1]}),
    *(lambda: {"elbow": np.zeros(3)}, lambda: {"elbow": {"max_velocity": 10**400}}),
    *(lambda: {"elbow": {"max_velocity": np.zeros(2)}}, lambda: {"elbow": {1: 1}}),
    *(lambda: range(4), lambda: range(10**15), lambda: (x for x in (0.1, 0.2)), lambda: iter([1])),
    *(lambda: map(float, "123"), lambda: {"a": 1}.keys(), lambda: zip([1], [2], strict=True)),
    *(lambda: len, lambda: int, lambda: np, lambda: ValueError("x"), lambda: NotImplemented),
    *(lambda: Ellipsis, lambda: slice(3), lambda: Path(), lambda: Path("no/such\0file")),
    *(lambda: Path("/dev/null"), lambda: Path("missing.urdf"), lambda: io.BytesIO(b"abc")),
    *(lambda: mp.Pose("wrist", [0, 0, 0]), lambda: mp.JointState(["a"], [0.0]), lambda: mp.World()),
    *(lambda: mp.JointGoal({"elbow": -0.5}), lambda: mp.Planner),
)
ARRAYS: tuple[Callable[[], Any], ...] = (
    *(lambda: np.zeros(0), lambda: np.zeros((0, 4)), lambda: np.zeros((4, 1)), lambda: np.array(1)),
    *(lambda: np.zeros((1, 4)), lambda: np.zeros((2, 4)), lambda: np.zeros((4, 4, 4))),
    *(lambda: np.full(4, np.nan), lambda: np.full(4, np.inf), lambda: np.full(4, 1e308)),
    *(lambda: np.full(3, 1e-320), lambda: np.full((3, 4), 1e200), lambda: np.zeros(3)),
    *(lambda: np.array([None] * 4), lambda: np.array([10**400] * 4, dtype=object)),
    *(lambda: np.array([[1], [2, 3]], dtype=object), lambda: of_objects(Hostile())),
    *(lambda: np.array(["0.1"] * 4), lambda: np.array([b"1"] * 4), lambda: np.full(4, 1j)),
    *(lambda: np.zeros(4, "M8[s]"), lambda: np.zeros(4, "m8[s]"), lambda: np.zeros(4, bool)),
    *(lambda: np.zeros(4, "f4,i4"), lambda: np.zeros(4, np.int8), lambda: np.zeros(4, np.float16)),
    *(lambda: np.full(4, 2**63, np.uint64), lambda: np.zeros(4, np.longdouble)),
    *(lambda: np.ma.masked_array(np.zeros(4), [1, 0, 0, 0]), lambda: np.matrix([[0.0] * 4])),
    *(lambda: np.broadcast_to(0.0, 10**12), lambda: np.broadcast_to(0.0, (10**6, 10**6, 4))),
    *(lambda: np.broadcast_to(0.0, (10**9, 4)), lambda: np.zeros(8)[::2], lambda: np.zeros((4, 0))),
    *(lambda: np.zeros(4, ">f8"), lambda: np.zeros((1,) * 20), lambda: np.array([], dtype=str)),
)


@dataclass(frozen=True)
class Call:
    """A function with valid arguments.

    Attributes
    ----------
    name : str
        Its name.
    function : callable
        What is called.
    arguments : dict
        Valid arguments by name.
    free : bool
        Whether a call with valid values may be made.
    """

    name: str
    function: Callable[..., Any]
    arguments: dict[str, Any]
    free: bool = True

    def made(self, arguments: Mapping[str, Any]) -> Any:
        """Call it; what it takes in any number is one of the arguments."""
        parameters = inspect.signature(self.function).parameters.values()
        several = [p.name for p in parameters if p.kind is p.VAR_POSITIONAL]
        named = {name: value for name, value in arguments.items() if name not in several}
        return self.function(*(arguments[name] for name in several if name in arguments), **named)


@cache
def planned() -> tuple[mp.Planner, mp.MovementPrimitive, mp.Plan, Any]:
    """A planner with its primitive, a plan of it, and the demonstrations."""
    folder = Path(tempfile.mkdtemp())
    demonstrations = mp.load_demonstrations(
        mp.write_example_recording(folder / "motions.mcap", 8), robot=ROBOT
    )
    primitive = mp.MovementPrimitive.fit(demonstrations, name="reach")
    robot = mp.Robot.from_file(ROBOT, primitive.joint_names)
    planner = mp.Planner(robot, [primitive], options=mp.PlannerOptions(max_solve_time=0.05))
    start = primitive.boundary_states[0, 0]
    return planner, primitive, planner.plan({"elbow": -0.9}, start), demonstrations


@cache
def prepared() -> tuple[Any, ...]:
    """A collision model, the content of a library, and files: a bag, the library, and so on."""
    planner, primitive, plan, demonstrations = planned()
    folder = Path(tempfile.mkdtemp())
    (content,) = mp.build_library(demonstrations, folder / "library").values()
    bag = mp.write_example_recording(folder / "bag.mcap", 2)
    primitive.save(folder / "primitive.npz")
    plan.trajectory.save(folder / "motion.csv")
    (folder / "mesh.obj").write_text(TETRAHEDRON)
    (folder / "scene.yaml").write_text(SCENE)
    collision = CollisionModel(planner.robot, package_dirs=[ROBOT.parent])
    return collision, content, bag, folder


# Not checked: arithmetic inside the package, whose arguments users don't have.
INNER = {
    *("Bodies", "BodyPairs", "CollisionModel", "ConditionalModel", "LinkInertias"),
    *("MotionSources", "MotionStatistics", "PacedBasis", "PolynomialBasis"),
    *("Demonstration.of_curve", "MovementPrimitive.paced_basis"),
    "MovementPrimitive.prediction_error",
}


def public_functions(values: Iterable[object]) -> set[str]:
    """Qualified names of what the front door offers.

    Its classes and functions, the public methods of its classes, and those of values and of what
    these hold in their public attributes.
    """
    front = [getattr(mp, name) for name in mp.__all__]
    front = [one for one in front if not (isinstance(one, type) and issubclass(one, Exception))]
    held, left = set[type](), list(values)
    while left:
        value = left.pop()
        kind = type(value)
        if isinstance(value, Mapping):
            left += value.values()
        elif isinstance(value, tuple | list):
            left += value[:100]
        elif (
            kind.__module__.startswith("mp_pca_planner.")
            and kind.__name__ not in INNER
            and kind not in held
        ):
            held.add(kind)
            left += [getattr(value, name) for name in dir(value) if name[0] != "_"]
    classes = held.union(one for one in front if isinstance(one, type))
    methods = {
        method.__qualname__
        for one in classes
        for name in dir(one)
        if name[0] != "_"
        and inspect.isroutine(method := getattr(one, name))
        and str(method.__module__).startswith("mp_pca_planner.")
    }
    return {one.__qualname__ for one in front} | methods - INNER


def calls(folder: Path) -> list[Call]:
    """The public names and methods, with valid arguments."""
    planner, primitive, plan, demonstrations = planned()
    collision, content, bag, files = prepared()
    robot, one = planner.robot, next(iter(demonstrations))
    arc_times = np.linspace(0.0, 1.0, 21)
    rise = 10.0 * arc_times**3 - 15.0 * arc_times**4 + 6.0 * arc_times**5
    arc, upright = np.outer(rise, [0.1, 0.2, 0.3, 0.4]), mp.Upright("wrist", 0.3)
    points = {"frames": ["wrist"], "offsets": [[0.0, 0.0, 0.1]]}
    names, q = primitive.joint_names, primitive.boundary_states[0, 0]
    there = primitive.boundary_states[0, 3]
    ends = {"start": q, "goal": there, "duration": 1.0}
    state, pose = mp.JointState(names, there), mp.Pose("wrist", [0.1, 0.2, 0.3])
    times, zeros = np.linspace(0.0, 1.0, 5), np.zeros((5, 4))
    ball = mp.Obstacle("ball", mp.Sphere(0.01, [2.0, 0.0, 0.0]))
    world, cube = mp.World([ball]), np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1.0]])
    mesh = {"vertices": cube, "triangles": [[0, 1, 2], [0, 1, 3], [0, 2, 3], [1, 2, 3]]}
    at = {"position": [0.1, 0.2, 0.3], "orientation": [0.0, 0.0, 0.0, 1.0]}
    limits = {"elbow": {"max_velocity": 2.0}}
    goal = mp.JointGoal({"elbow": -0.9})
    recorded = {"recording": "r", "joint_names": names, "times": times}
    recorded |= {"start_time": 0.0, "end_time": 1.0}
    curves = dict.fromkeys(("positions", "velocities", "accelerations"), zeros)
    options = {
        "basis": "pca",
        "objectives": planner.options.objectives,
        "timing": "free",
        "naturalness": 1.0,
        "sample_period": 0.01,
        "max_solve_time": 0.1,
        "n_starts": 1,
        "n_nodes": 20,
        "allow_nonzero_end_velocity": False,
        "solver": SolverOptions(),
        "search": SearchOptions(),
    }
    matrix = {"q": zeros, "v": zeros, "a": zeros}
    found = [
        Call("JointState", mp.JointState, {"joint_names": names, "positions": q, "velocities": q}),
        Call("Pose", mp.Pose, {"frame": "wrist", **at}),
        Call("JointGoal", mp.JointGoal, {"state": state, "duration": 1.0}),
        Call("PoseGoal", mp.PoseGoal, {"pose": pose, "duration": 1.0, "primitive": "reach"}),
        Call(
            "SequenceGoal",
            mp.SequenceGoal,
            {"targets": (state, pose), "times": (1.0, 2.0), "stops": (True, False)},
        ),
        Call("Trajectory", mp.Trajectory, {"joint_names": names, "times": times, **curves}),
        Call("Trajectory.with_efforts", plan.trajectory.with_efforts, {"efforts": None}),
        Call(
            "Trajectory.save", plan.trajectory.save, {"path": folder / "a.csv", "overwrite": True}
        ),
        Call("Trajectory.load", mp.Trajectory.load, {"path": files / "motion.csv"}),
        Call("Trajectory.to_message", plan.trajectory.to_message, {"with_efforts": True}),
        Call("Trajectory.plot", plan.trajectory.plot, {"axes": None}, free=False),
        Call("Trajectory.columns", plan.trajectory.columns, {}),
        Call("Trajectory.table", plan.trajectory.table, {}),
        Call("JointLimits", mp.JointLimits, {"joint_names": names, "limits": limits}),
        Call("PlannerOptions", mp.PlannerOptions, options),
        Call("Upright.values", upright.values, {"robot": robot, "q": zeros}),
        Call("Upright", mp.Upright, {"frame": "wrist", "angle": 0.3, "axis": (0.0, 1.0, 0.0)}),
        Call("PlannerOptions", mp.PlannerOptions, {"constraints": (upright,)}),
        Call("SolverOptions", SolverOptions, vars(SolverOptions())),
        Call("SearchOptions", SearchOptions, vars(SearchOptions())),
        Call("SelectionOptions", SelectionOptions, vars(SelectionOptions())),
        Call("PoseSearchOptions", PoseSearchOptions, vars(PoseSearchOptions())),
        Call("ClearanceOptions", ClearanceOptions, vars(ClearanceOptions())),
        Call("PathOptions", PathOptions, vars(PathOptions())),
        Call("DetourOptions", DetourOptions, vars(DetourOptions())),
        Call("BrakingOptions", BrakingOptions, vars(BrakingOptions())),
        Call("Planner", mp.Planner, {"robot": robot, "primitives": [primitive], "world": world}),
        Call("Planner.plan", planner.plan, {"goal": there, "start": q, "mode": "optimal"}),
        Call("Planner.plan", planner.plan, {"goal": [there, q], "start": q, "duration": 3.0}),
        Call("Planner.plan", planner.plan, {"goal": pose, "start": q, "duration": 3.0}),
        Call("Planner.check", planner.check, {"goal": goal}),
        Call("Planner.target", planner.target, {"goal": goal, "start": state}),
        Call("Planner.use_collision", copy.copy(planner).use_collision, {"collision": collision}),
        Call(
            "Planner.is_too_far", planner.is_too_far, {"goal": goal, "start": state, "end": state}
        ),
        Call("PrimitiveLibrary.of", PrimitiveLibrary.of, {"primitives": [primitive]}),
        Call("PrimitiveLibrary.named", planner.primitives.named, {"name": "reach"}),
        Call("PrimitiveLibrary.check_name", planner.primitives.check_name, {"name": "reach"}),
        Call("Motion.evaluate", plan.motion.evaluate, {"times": times}),
        Call("Plan", mp.Plan, {one.name: getattr(plan, one.name) for one in fields(plan)}),
        Call("show", mp.show, {"planner": None, "plan": plan, "port": "x"}, free=False),
        Call("Plan.show", plan.show, {"port": "x"}, free=False),
        Call("Plan.plot", plan.plot, {"axes": None}, free=False),
        Call("Plan.summary", plan.summary, {}),
        Call("MovementPrimitive.fit", primitive.fit, {"demonstrations": demonstrations}),
        Call("MovementPrimitive.fit", primitive.fit, {"demonstrations": [one, one], "name": "a"}),
        Call(
            "MovementPrimitive.fit",
            primitive.fit,
            {"demonstrations": [arc, arc], "times": arc_times, "joint_names": names},
        ),
        Call("MovementPrimitive.errors", primitive.errors, {"demonstrations": demonstrations}),
        Call(
            "MovementPrimitive.errors",
            primitive.errors,
            {"demonstrations": [arc], "times": [arc_times]},
        ),
        Call("MovementPrimitive", mp.MovementPrimitive, vars(primitive)),
        Call("MovementPrimitive.arrays", primitive.arrays, {}),
        Call("MovementPrimitive.summary", primitive.summary, {}),
        Call("MovementPrimitive.plot", primitive.plot, {"axes": None}, free=False),
        Call("MovementPrimitive.in_span_score", primitive.in_span_score, ends),
        Call("MovementPrimitive.expected_error", primitive.expected_error, ends),
        Call(
            "MovementPrimitive.nearest_demonstrations",
            primitive.nearest_demonstrations,
            {"ends": [q, there]},
        ),
        Call("MovementPrimitive.load", primitive.load, {"path": files / "primitive.npz"}),
        Call(
            "MovementPrimitive.save", primitive.save, {"path": folder / "p.npz", "overwrite": True}
        ),
        Call("MovementPrimitive.predict", primitive.predict, {"start": q, "goal": there}),
        Call("MovementPrimitive.sample", primitive.sample, {"n": 2, "start": q, "goal": there}),
        Call(
            "MovementPrimitive.reproduction",
            primitive.reproduction,
            {"demonstration": 0, "times": times},
        ),
        Call("Demonstration", mp.Demonstration, {**recorded, **curves}),
        Call("Demonstration.curve", one.curve, {}),
        Call(
            "Demonstration.of_samples",
            one.of_samples,
            {"joint_names": names, "times": arc_times, "positions": arc, "recording": "a"},
        ),
        Call("Demonstration.at", one.at, {"times": times}),
        Call("Demonstration.time_normalised", one.time_normalised, {"n_phases": 10}),
        Call("Demonstration.thinned", one.thinned, {"most_samples": 10}),
        Call(
            "Demonstration.from_arrays",
            mp.Demonstration.from_arrays,
            {"joint_names": names, "times": arc_times, "positions": arc, "label": "a"},
        ),
        Call("RecordingSet.require_motion", demonstrations.require_motion, {}),
        Call("build_library", mp.build_library, {"motions": [one, one], "folder": files / "other"}),
        Call("LibraryContent.label_agreement", content.label_agreement, {}),
        Call("Kinds.members", content.kinds.members, {"kind": 0}),
        Call("load_demonstrations", mp.load_demonstrations, {"paths": bag, "robot": ROBOT}),
        Call(
            "write_example_recording",
            mp.write_example_recording,
            {"path": folder / "b.mcap", "n_motions": 1, "seed": 1},
        ),
        Call("config_file", mp.config_file, {"name": "human_arm.urdf"}),
        Call("Robot", mp.Robot, {"urdf": ROBOT.read_text(), "joint_names": names}),
        Call("Robot.from_file", mp.Robot.from_file, {"path": ROBOT, "joint_names": names}),
        Call("Robot.limits", robot.limits, {"overrides": limits}),
        Call("Robot.with_joints", robot.with_joints, {"joint_names": names}),
        Call(
            "Robot.with_armature",
            robot.with_armature,
            {"inertias": q * 0.0},
        ),
        Call("Robot.pinocchio_model", robot.pinocchio_model, {}),
        Call("Robot.mimicry", robot.mimicry, {"joint_names": names}),
        Call("Robot.relevant_joints", robot.relevant_joints, {"pairs": True, "links": ["wrist"]}),
        Call("Robot.link_bodies", robot.link_bodies, {"package_dirs": [folder]}),
        Call("Robot.are_neighbours", robot.are_neighbours, {"links": ["wrist"]}),
        Call("Robot.effort_slopes", robot.effort_slopes, {**matrix, "jerk": zeros}),
        Call(
            "Robot.attached_poses",
            robot.attached_poses,
            {"q": zeros, "frames": ["wrist"], "origins": np.zeros((1, 6))},
        ),
        Call("Robot.pose_error", robot.pose_error, {"frame": "wrist", "q": q, **at}),
        Call("Robot.attach_points", robot.attach_points, points),
        Call(
            "AttachedPoints.positions_and_jacobians",
            robot.attach_points(**points).positions_and_jacobians,
            {"q": zeros},
        ),
        Call("Robot.with_payload", robot.with_payload, {"mass": 1.0, "frame": None}),
        Call("Robot.with_link_inertias", robot.with_link_inertias, {"factors": np.ones((2, 4))}),
        Call("Robot.frame_positions", robot.frame_positions, {"q": zeros, "frames": ["wrist"]}),
        Call("Robot.chain_positions", robot.chain_positions, {"q": zeros, "frame": "wrist"}),
        Call("Robot.inverse_dynamics", robot.inverse_dynamics, matrix),
        Call("Robot.inverse_dynamics_derivatives", robot.inverse_dynamics_derivatives, matrix),
        Call("Robot.known_efforts", robot.known_efforts, matrix),
        Call("Robot.forward_dynamics", robot.forward_dynamics, {"q": q, "v": q, "tau": q}),
        Call("Robot.motion_equation", robot.motion_equation, {"q": q, "v": q}),
        Call("Robot.gravity_efforts", robot.gravity_efforts, {"q": q}),
        Call("Robot.require_inertias", robot.require_inertias, {"purpose": "this"}),
        Call("Box", mp.Box, {"size": [0.1, 0.1, 0.1], **at}),
        Call("Sphere", mp.Sphere, {"radius": 0.1, "position": [0.1, 0.2, 0.3]}),
        Call("Cylinder", mp.Cylinder, {"radius": 0.1, "height": 0.2, **at}),
        Call("Capsule", mp.Capsule, {"radius": 0.1, "height": 0.2, **at}),
        Call("Mesh", mp.Mesh, {**mesh, **at}),
        Call("Shape.moved", ball.shapes[0].moved, {"pose": [0.1, 0.2, 0.3, 0.0, 0.0, 0.0, 1.0]}),
        Call("Mesh.from_file", mp.Mesh.from_file, {"path": files / "mesh.obj", "scale": 1.0, **at}),
        Call("Obstacle", mp.Obstacle, {"name": "a", "shapes": mp.Sphere(0.1), "frame": "wrist"}),
        Call("World", mp.World, {"obstacles": [ball]}),
        Call("World.from_file", mp.World.from_file, {"path": files / "scene.yaml"}),
        Call("World.with_obstacles", world.with_obstacles, {"obstacles": ball}),
        Call("World.without", world.without, {"names": ["ball"]}),
        Call("World.allows", world.allows, {"first": "ball", "second": "wrist"}),
    ]
    return found


def without_call(known: list[Call]) -> list[str]:
    """Public functions that none of some calls is of; also those of what the calls return."""
    results = []
    with printing_nothing():
        for call in known:
            # What an extra that is not installed returns has no methods to call either.
            with contextlib.suppress(MissingDependencyError):
                if call.free:
                    results.append(call.made(call.arguments))
    return sorted(public_functions(results) - {call.name for call in known})


def odd(random: np.random.Generator) -> Any:
    """A wrong value, mostly."""
    kind = (NUMBERS, OTHERS, ARRAYS)[int(random.integers(0, 3))]
    value = kind[int(random.integers(0, len(kind)))]()
    wraps = int(random.integers(0, 12))
    if wraps == 0:
        return [value] * int(random.integers(1, 6))
    if wraps == 1:
        return dict.fromkeys(("shoulder1", "elbow")[: int(random.integers(1, 3))], value)
    if wraps == 2:
        return (value, 0.5)
    return value


class TooLong(BaseException):
    """A call exceeded its computing time."""


def try_call(number: int, seed: int, folder: Path) -> tuple[str, str]:
    """Make a call with odd arguments; return its name and the problem, empty if there is none."""
    random = np.random.default_rng([seed, number])
    every = calls(folder)
    call = every[int(random.integers(0, len(every)))]
    arguments = dict(call.arguments)
    names = list(arguments)
    n_odd = int(random.integers(1, max(len(names), 1) + 1)) if random.random() < 0.3 else 1
    if os.environ.get("FUZZ_TRACE"):
        print(number, call.name, file=sys.__stderr__, flush=True)
    for name in random.permutation(names)[:n_odd].tolist():
        arguments[name] = odd(random)
    if random.random() < 0.03:
        arguments = {}
    began, peak = time.process_time(), megabytes()
    signal.signal(signal.SIGPROF, _stop)
    signal.setitimer(signal.ITIMER_PROF, CPU_SECONDS)
    try:
        with printing_nothing(), warnings.catch_warnings():
            warnings.simplefilter("ignore", RuntimeWarning)
            call.made(arguments)
    except mp.PlannerError as error:
        return call.name, "" if error.args and str(error).strip() else "an empty message"
    except TypeError as error:
        # Python itself rejects a call without its arguments.
        if " argument" in str(error) and "missing" in str(error) and not arguments:
            return call.name, ""
        return call.name, _described(error)
    except TooLong:
        return call.name, f"computed for over {CPU_SECONDS} s: {_stated(arguments)}"
    except BaseException as error:
        return call.name, _described(error)
    finally:
        signal.setitimer(signal.ITIMER_PROF, 0.0)
    seconds, taken = time.process_time() - began, megabytes() - peak
    if taken > MEGABYTES:
        return call.name, f"took {taken:.0f} MB: {_stated(arguments)}"
    return call.name, f"took {seconds:.1f} s" if seconds > CPU_SECONDS else ""


def megabytes() -> float:
    """The most memory that this process has had."""
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024.0


def _stated(arguments: dict[str, Any]) -> str:
    return ", ".join(f"{name}: {type(value).__name__}" for name, value in arguments.items())


def _described(error: BaseException) -> str:
    own = [x for x in traceback.extract_tb(error.__traceback__) if "mp_pca_planner/" in x.filename]
    place = f"{Path(own[-1].filename).name}:{own[-1].lineno}" if own else "?"
    if os.environ.get("FUZZ_TRACEBACK"):
        traceback.print_exception(error)
    return f"{type(error).__name__} at {place}: {error!s:.150}"


def _stop(_signal: int, _frame: object) -> None:
    if os.environ.get("FUZZ_TRACEBACK"):
        traceback.print_stack(_frame, 12, file=sys.__stderr__)
    raise TooLong


@contextlib.contextmanager
def printing_nothing() -> Iterator[None]:
    """Discard what a call prints."""
    with contextlib.redirect_stdout(io.StringIO()), contextlib.redirect_stderr(io.StringIO()):
        yield


def main() -> int:
    """Make all calls; print the problems and the number of calls by name."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--calls", type=int, default=5000)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--only", type=int, help="number of the only call")
    options = parser.parse_args()
    here = Path.cwd()
    with tempfile.TemporaryDirectory() as temporary:
        inner = Path(temporary, "a", "b")  # "../.." is one of the odd paths
        inner.mkdir(parents=True)
        os.chdir(inner)
        folder, problems, made = Path(temporary), Counter[str](), Counter[str]()
        if options.only is not None:
            os.environ["FUZZ_TRACEBACK"] = "1"
        if missing := without_call(calls(folder)):
            print(f"add a valid call to calls() of: {', '.join(missing)}", file=sys.stderr)
            return 1
        resource.setrlimit(resource.RLIMIT_AS, (8 << 30, 8 << 30))  # not the whole machine's
        numbers = range(options.calls) if options.only is None else [options.only]
        for number in numbers:
            name, problem = try_call(number, options.seed, folder)
            made[name] += 1
            if problem:
                key = f"{name}: {problem.split(':')[0]}"
                problems[key] += 1
                if problems[key] == 1:
                    print(f"--only {number}: {name}: {problem}", file=sys.stderr, flush=True)
        os.chdir(here)
    print(", ".join(f"{name} {n}" for name, n in sorted(made.items())))
    print(f"{len(numbers)} calls, {sum(problems.values())} with problems")
    return int(bool(problems))


if __name__ == "__main__":
    sys.exit(main())
