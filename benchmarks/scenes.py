# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""Problems of a primitive, and MotionBenchMaker's with obstacles."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from scipy.interpolate import CubicSpline
from support.problems import Problem, Scene, held_out_problems

from mp_pca_planner.exceptions import PlannerError
from mp_pca_planner.files import load_yaml, read_text
from mp_pca_planner.primitives.primitive import MovementPrimitive
from mp_pca_planner.recordings.demonstration import Demonstration
from mp_pca_planner.robot.limits import JointLimits


def demonstrations_in(primitive: MovementPrimitive) -> list[Demonstration]:
    """The motions that a primitive was built from, as it reproduces them."""
    motions = []
    for i, duration in enumerate(primitive.durations):
        times = np.linspace(0.0, duration, max(round(duration * 100.0), 10) + 1)
        curve = CubicSpline(times, primitive.reproduction(i, times))
        name = f"{primitive.name} {i}"
        motions.append(Demonstration.of_curve(primitive.joint_names, curve, times, name))
    return motions


def own_problems(scene: Scene, n_problems: int, seed: int) -> list[Problem]:
    """Problems like the demonstrations: held-out ones, or between those of a primitive.

    With a primitive instead of demonstrations, each end is a random mean of the ends of two of
    its motions, and the duration is the one it predicts.
    """
    if scene.primitive is None:
        return held_out_problems(scene, n_problems, seed)
    return [
        _between(scene.primitive, scene.limits, np.random.default_rng([seed, i]))
        for i in range(n_problems)
    ]


def _between(
    primitive: MovementPrimitive, limits: JointLimits, rng: np.random.Generator
) -> Problem:
    states = primitive.boundary_states
    one, two = rng.integers(len(states), size=2)
    ends = []
    for state in (0, 3):
        share = rng.uniform()
        between = share * states[one, state] + (1.0 - share) * states[two, state]
        ends.append(np.clip(between, limits.lower, limits.upper))
    expected = primitive.model.predict(ends[0], ends[1])
    return Problem(ends[0], ends[1], expected.duration)


def scenes_in(folder: Path, n_scenes: int) -> list[Path]:
    """The scenes of problems among obstacles, in a folder and those below it.

    Parameters
    ----------
    folder : Path
        The folder.
    n_scenes : int
        Largest number of scenes of each subfolder, evenly spread.

    Raises
    ------
    PlannerError
        If there are none.
    """
    groups: dict[Path, list[Path]] = {}
    for scene in sorted(folder.rglob("scene*.yaml")):
        if _request_of(scene).is_file():
            groups.setdefault(scene.parent, []).append(scene)
    if not groups:
        raise PlannerError(
            f"no problems in '{folder}': expected scene0001.yaml beside request0001.yaml, as in "
            "MotionBenchMaker"
        )
    return [
        scenes[i]
        for scenes in groups.values()
        for i in np.linspace(0, len(scenes) - 1, min(n_scenes, len(scenes))).round().astype(int)
    ]


def robot_of_scene(scene: Path) -> Path:
    """The URDF file of the robot that a scene names, in one of four folders above or of that name.

    Raises
    ------
    PlannerError
        If there is none.
    """
    name = Path(_read(scene)["robot_model_name"]).name
    for folder in list(scene.resolve().parents)[:4]:
        for path in (folder / f"{name}.urdf", folder / name / f"{name}.urdf"):
            if path.is_file():
                return path
    raise PlannerError(f"no '{name}.urdf' in a folder '{name}' above '{scene}'; give it by --robot")


def requested_ends(scene: Path) -> tuple[dict[str, float], dict[str, float]]:
    """Start and goal of the problem in a scene, by joint name [rad or m]."""
    content = _read(_request_of(scene))
    state = content["start_state"]["joint_state"]
    goals = {
        one["joint_name"]: float(one["position"])
        for constraint in content["goal_constraints"]
        for one in constraint["joint_constraints"]
    }
    return dict(zip(state["name"], map(float, state["position"]), strict=True)), goals


def scene_problem(scene: Path, joint_names: Sequence[str]) -> Problem:
    """The problem in a scene, of any duration."""
    start, goal = (np.array([end[name] for name in joint_names]) for end in requested_ends(scene))
    return Problem(start, goal, float("nan"), scene=scene)


def _read(path: Path) -> Any:
    return load_yaml(read_text(path))


def _request_of(scene: Path) -> Path:
    return scene.with_name(scene.name.replace("scene", "request", 1))
