# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""Problems among obstacles, in the files of MotionBenchMaker.

A folder holds ``sceneNNNN.yaml``, a planning scene of MoveIt, beside ``requestNNNN.yaml``, a start
state with the positions of a goal (Chamzas et al., RA-L 7(2), 2022).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from ..arrays import FloatArray
from ..exceptions import PlannerError
from ..files import load_yaml, read_text, reading

# Folders above the problems in which the robot's description is searched.
_LEVELS = 4


@dataclass(frozen=True, eq=False)
class SceneProblem:
    """A motion from rest to rest among obstacles.

    Attributes
    ----------
    group : str
        Name of the folder that holds it.
    number : str
        Its number in the names of the files.
    scene : Path
        The file of its obstacles.
    start, goal : dict
        Positions by joint name [rad or m].
    """

    group: str
    number: str
    scene: Path
    start: Mapping[str, float]
    goal: Mapping[str, float]

    def ends(self, joint_names: Sequence[str]) -> tuple[FloatArray, FloatArray]:
        """Positions at the start and at the goal, both of shape (n_joints,).

        Raises
        ------
        PlannerError
            If the request leaves a joint out.
        """
        for what, state in (("start", self.start), ("goal", self.goal)):
            for name in joint_names:
                if name not in state:
                    raise PlannerError(
                        f"the request of '{self.scene}' has no {what} position of joint '{name}'"
                    )
        start, goal = ([x[name] for name in joint_names] for x in (self.start, self.goal))
        return np.array(start), np.array(goal)


def scene_problems(folder: Path, n_problems: int) -> list[SceneProblem]:
    """The problems in a folder and those below it.

    Parameters
    ----------
    folder : Path
        The folder.
    n_problems : int
        Largest number of problems of each group, evenly spread.

    Raises
    ------
    PlannerError
        If there are none, or a request can't be read.
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
        _problem(scenes[i])
        for scenes in groups.values()
        for i in np.linspace(0, len(scenes) - 1, min(n_problems, len(scenes))).round().astype(int)
    ]


def scene_robot(problem: SceneProblem) -> Path:
    """The URDF file of the robot that a scene names, in a folder above or of that name.

    Raises
    ------
    PlannerError
        If there is none.
    """
    with reading(f"the scene '{problem.scene}'", PlannerError):
        content = load_yaml(read_text(problem.scene))
        name = Path(str(content["robot_model_name"])).name
    for folder in list(problem.scene.resolve().parents)[:_LEVELS]:
        for path in (folder / f"{name}.urdf", folder / name / f"{name}.urdf"):
            if path.is_file():
                return path
    raise PlannerError(
        f"no '{name}.urdf' in a folder '{name}' above '{problem.scene}'; give it by --robot"
    )


def _request_of(scene: Path) -> Path:
    return scene.with_name(scene.name.replace("scene", "request", 1))


def _problem(scene: Path) -> SceneProblem:
    path = _request_of(scene)
    with reading(f"the request '{path}'", PlannerError):
        content = load_yaml(read_text(path))
        state = content["start_state"]["joint_state"]
        start = _positions(zip(state["name"], state["position"], strict=True))
        goals = [
            (one["joint_name"], one["position"])
            for constraint in content["goal_constraints"]
            for one in constraint["joint_constraints"]
        ]
        number = scene.stem.removeprefix("scene")
        return SceneProblem(scene.parent.name, number, scene, start, _positions(goals))


def _positions(pairs: Any) -> dict[str, float]:
    """Positions by joint name; finite numbers."""
    found = {str(name): float(position) for name, position in pairs}
    for name, position in found.items():
        if not np.isfinite(position):
            raise ValueError(f"the position of joint '{name}' is {position}")
    return found
