# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""Fuzz test of the Python API: calls with wrong types, shapes and values.

    python3 benchmarks/fuzz_calls.py [--calls 5000] [--seed 0]
    python3 benchmarks/fuzz_calls.py --only 17           # one call, with its traceback

Each call is one of a public name or method of the front door, with valid arguments of which one or
several are replaced by odd ones; its number is the seed. It may succeed or raise a `PlannerError`.
It fails the test if it raises another error or computes for more than 5 s. The script exits with 1
on any failure.
"""

from __future__ import annotations

import argparse
import contextlib
import io
import os
import signal
import sys
import tempfile
import time
import traceback
import warnings
from collections import Counter
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from decimal import Decimal
from fractions import Fraction
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np

import mp_pca_planner as mp
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

CPU_SECONDS = 5.0
ROBOT = mp.config_file("human_arm.urdf")


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


def calls(folder: Path) -> list[Call]:
    """The public names and methods, with valid arguments."""
    planner, primitive, plan, demonstrations = planned()
    robot, one = planner.robot, next(iter(demonstrations))
    names, q = primitive.joint_names, primitive.boundary_states[0, 0]
    there = primitive.boundary_states[0, 3]
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
        Call("JointLimits", mp.JointLimits, {"joint_names": names, "limits": limits}),
        Call("PlannerOptions", mp.PlannerOptions, options),
        Call("Upright", mp.Upright, {"frame": "wrist", "angle": 0.3, "axis": (0.0, 1.0, 0.0)}),
        Call("PlannerOptions", mp.PlannerOptions, {"constraints": (mp.Upright("wrist", 0.3),)}),
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
        Call("Planner.use_collision", planner.use_collision, {"collision": None}, free=False),
        Call("show", mp.show, {"planner": None, "plan": plan, "port": "x"}, free=False),
        Call("Plan.show", plan.show, {"port": "x"}, free=False),
        Call("Plan.summary", plan.summary, {}),
        Call("MovementPrimitive.fit", primitive.fit, {"demonstrations": demonstrations}),
        Call("MovementPrimitive.fit", primitive.fit, {"demonstrations": [one, one], "name": "a"}),
        Call("MovementPrimitive.load", primitive.load, {"path": folder / "missing.npz"}),
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
        Call("Demonstration.at", one.at, {"times": times}),
        Call("Demonstration.time_normalised", one.time_normalised, {"n_phases": 10}),
        Call("Demonstration.thinned", one.thinned, {"most_samples": 10}),
        Call("load_demonstrations", mp.load_demonstrations, {"paths": "x", "robot": ROBOT}),
        Call(
            "write_example_recording",
            mp.write_example_recording,
            {"path": folder / "b.mcap", "n_motions": 1, "seed": 1},
        ),
        Call("config_file", mp.config_file, {"name": "human_arm.urdf"}),
        Call("Robot", mp.Robot, {"urdf": ROBOT.read_text(), "joint_names": names}),
        Call("Robot.from_file", mp.Robot.from_file, {"path": ROBOT, "joint_names": names}),
        Call("Robot.limits", robot.limits, {}),
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
        Call("Mesh.from_file", mp.Mesh.from_file, {"path": folder / "no.stl", "scale": 1.0, **at}),
        Call("Obstacle", mp.Obstacle, {"name": "a", "shapes": mp.Sphere(0.1), "frame": "wrist"}),
        Call("World", mp.World, {"obstacles": [ball]}),
        Call("World.from_file", mp.World.from_file, {"path": folder / "missing.yaml"}),
        Call("World.with_obstacles", world.with_obstacles, {"obstacles": ball}),
        Call("World.without", world.without, {"names": ["ball"]}),
        Call("World.allows", world.allows, {"first": "ball", "second": "wrist"}),
    ]
    return found


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
    arguments, positional = dict(call.arguments), []
    names = list(arguments)
    n_odd = int(random.integers(1, max(len(names), 1) + 1)) if random.random() < 0.3 else 1
    if os.environ.get("FUZZ_TRACE"):
        print(number, call.name, file=sys.__stderr__, flush=True)
    for name in random.permutation(names)[:n_odd].tolist():
        arguments[name] = odd(random)
    if call.name in ("Robot.limits", "World.with_obstacles"):  # they have any number of arguments
        positional, arguments = [odd(random)], {}
    elif random.random() < 0.03:
        positional, arguments = [], {}
    began = time.process_time()
    signal.signal(signal.SIGPROF, _stop)
    signal.setitimer(signal.ITIMER_PROF, CPU_SECONDS)
    try:
        with printing_nothing(), warnings.catch_warnings():
            warnings.simplefilter("ignore", RuntimeWarning)
            call.function(*positional, **arguments)
    except mp.PlannerError as error:
        return call.name, "" if error.args and str(error).strip() else "an empty message"
    except TypeError as error:
        # Python itself rejects a call without its arguments.
        if "required positional argument" in str(error) and not arguments:
            return call.name, ""
        return call.name, _described(error)
    except TooLong:
        return call.name, f"computed for over {CPU_SECONDS} s: {_stated(arguments)}"
    except BaseException as error:
        return call.name, _described(error)
    finally:
        signal.setitimer(signal.ITIMER_PROF, 0.0)
    seconds = time.process_time() - began
    return call.name, f"took {seconds:.1f} s" if seconds > CPU_SECONDS else ""


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
        os.chdir(temporary)
        folder, problems, made = Path(temporary), Counter[str](), Counter[str]()
        if options.only is not None:
            os.environ["FUZZ_TRACEBACK"] = "1"
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
