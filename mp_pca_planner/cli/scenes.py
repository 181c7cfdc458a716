# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""`benchmark --scenes`: comparison with other methods among obstacles."""

from __future__ import annotations

import argparse
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from ..evaluation.problems import Scene, demonstrations_in, demonstrations_of
from ..evaluation.scene_problems import SceneProblem, scene_problems, scene_robot
from ..evaluation.scene_run import (
    OWN,
    PEERS,
    compare_in_scenes,
    scene_methods,
    summarise_scenes,
)
from ..exceptions import PlannerError
from ..motion.collision import CollisionModel, package_folders
from ..plotting.page import Table
from ..plotting.text import cells, table
from ..primitives.primitive import MovementPrimitive
from ..resources import config_file
from ..robot.model import Robot
from .common import limits_of, named_peers, print_json, progress_bar
from .terminal import DONE, say

_COLUMNS = {
    "solved [%]": ("solved_share", ".0f", 100.0),
    "in 100 ms [%]": ("solved_in_100_ms_share", ".0f", 100.0),
    "collisions": ("n_collisions", "g", 1.0),
    "limits kept [%]": ("limits_kept_share", ".0f", 100.0),
    "all [ms]": ("time_of_all_s", ".0f", 1e3),
    "time [ms]": ("solve_time_s", ".0f", 1e3),
    "T [s]": ("duration", ".2f", 1.0),
    "J": ("effort_cost", ".4g", 1.0),
    "path [rad]": ("path_length", ".2f", 1.0),
    "jerk [rad/s³]": ("rms_jerk", ".3g", 1.0),
    "clearance [mm]": ("clearance", ".1f", 1e3),
    "J ratio": ("effort_cost_ratio", ".2f", 1.0),
    "J lower [%]": ("effort_cost_lower_share", ".0f", 100.0),
    "jerk lower [%]": ("rms_jerk_lower_share", ".0f", 100.0),
}


def run_scenes(arguments: argparse.Namespace, primitive: MovementPrimitive | None) -> int:
    """Run the comparison; returns the exit status."""
    if arguments.plot is not None or arguments.random_ends:
        raise PlannerError("--plot and --random-ends are not for --scenes: leave them out")
    peers = named_peers(arguments.peers, list(PEERS))
    max_time = arguments.time_limit or 1.0
    problems = scene_problems(arguments.scenes, arguments.problems)
    scene = _scene(arguments, problems[0], primitive)
    srdf = _existing(scene.urdf.with_suffix(".srdf"))
    folders = package_folders([scene.urdf.parent], scene.urdf)
    collision = CollisionModel(scene.robot, srdf=srdf, package_dirs=folders)
    methods, absent = scene_methods(scene, collision, peers, max_time)
    with progress_bar("planning", "problem") as progress:
        results = compare_in_scenes(scene, collision, methods, problems, srdf, progress)
    facts = {
        "robot": scene.name,
        "n_joints": scene.robot.n_joints,
        "n_problems": len(problems),
        "time_limit_s": max_time,
        "methods": {method.name: method.about for method in methods},
        "absent": absent,
        "problems": [
            {"group": problem.group, "number": problem.number}
            | {name: result.facts() for name, result in found.items()}
            for problem, found in results
        ],
        "summary": summarise_scenes(results),
    }
    facts["tables"] = {group: one._asdict() for group, one in _tables(facts).items()}
    if arguments.json:
        print_json(facts)
    else:
        say(*_text(facts))
    return DONE


def _scene(
    arguments: argparse.Namespace, problem: SceneProblem, primitive: MovementPrimitive | None
) -> Scene:
    """The robot of the problems, with reaches between random postures as demonstrations."""
    urdf = scene_robot(problem) if arguments.robot is None else Path(arguments.robot)
    known = [name for name in problem.start if name in problem.goal]
    joints = primitive.joint_names if primitive else arguments.joints or known
    robot = Robot.from_file(urdf, joints)
    limits = limits_of(robot, arguments.limits or _shipped_limits(urdf.stem))
    motions = (
        demonstrations_in(primitive) if primitive else demonstrations_of(urdf.stem, robot, limits)
    )
    return Scene(urdf.stem, urdf, robot, limits, tuple(motions), primitive)


def _shipped_limits(name: str) -> Path | None:
    """Limits of accelerations and jerks, if the package ships some for a robot of this name."""
    try:
        return config_file(f"{name}_joint_limits.yaml")
    except PlannerError:
        return None


def _existing(path: Path) -> Path | None:
    return path if path.is_file() else None


def _text(facts: Mapping[str, Any]) -> list[str]:
    lines = [
        f"{facts['n_problems']} problems of '{facts['robot']}', {facts['n_joints']} joints, "
        f"within {facts['time_limit_s']:g} s"
    ]
    for group, (header, rows) in _tables(facts).items():
        lines += ["", group, *table(rows, header=header).splitlines()]
    return [
        *lines,
        "",
        "By the referee: solved: reaches the goal without a collision on a 1 ms grid. Medians over",
        "the solved problems; 'all' over all. Ratio and shares: "
        f"{OWN} over the method, where both solve.",
        "",
        *(f"{name}: {about}" for name, about in facts["methods"].items()),
        *(f"{name} is absent: {reason}" for name, reason in facts["absent"].items()),
    ]


def _tables(facts: Mapping[str, Any]) -> dict[str, Table]:
    """A table for each group of problems."""
    return {
        group: Table(
            ["method", *_COLUMNS],
            [[name, *cells(values, _COLUMNS)] for name, values in summary.items()],
        )
        for group, summary in facts["summary"].items()
    }
