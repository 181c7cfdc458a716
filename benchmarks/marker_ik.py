# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""Accuracy of joint angles computed from markers, compared with those of another method.

Prints for each recording the computing time, the residuals of the markers and, where joint states
of the same name are given, the RMS difference of each joint.

    python benchmarks/marker_ik.py BAG... --markers TOPIC --robot URDF --marker-map FILE.yaml
        [--joint-states FOLDER] [--noise MILLIMETRES] [--drop SHARE]

`--noise` adds errors to the markers, `--drop` removes single markers at random.
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Collection
from dataclasses import replace
from pathlib import Path

import numpy as np

from mp_pca_planner.arrays import FloatArray, text_table
from mp_pca_planner.files import config_file
from mp_pca_planner.mocap.marker_joint_states import (
    MarkerSource,
    marker_source,
    solve_trajectories,
)
from mp_pca_planner.mocap.markers import MarkerTrajectories, read_markers
from mp_pca_planner.recordings.bags import (
    choose_topic,
    find_recordings,
    open_bag,
    recording_names,
)
from mp_pca_planner.recordings.recording_set import MarkerResidual


def main() -> None:
    """Print a row per recording."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("bags", nargs="+")
    parser.add_argument("--markers", default="/markers")
    parser.add_argument("--robot", default=config_file("human_arm.urdf"))
    parser.add_argument("--marker-map", default=config_file("human_arm_markers.yaml"))
    parser.add_argument("--joint-states", type=Path, help="folder with bags of the same names")
    parser.add_argument("--noise", type=float, default=0.0, help="standard deviation [mm]")
    parser.add_argument("--drop", type=float, default=0.0, help="share of markers taken away")
    arguments = parser.parse_args()
    source = marker_source(arguments.markers, arguments.robot, arguments.marker_map)
    paths = find_recordings(arguments.bags)
    rows = []
    for path, name in zip(paths, recording_names(paths), strict=True):
        theirs = None
        if arguments.joint_states is not None:
            theirs = _recorded(arguments.joint_states / name, source.joint_names)
        rows.append([name, *_measured(path, source, theirs, arguments.noise, arguments.drop)])
    header = ["recording", "frames", "solved", "frames/s", "median [mm]", "95 % [mm]"]
    print(text_table(rows, header=[*header, *(f"{name} [deg]" for name in source.joint_names)]))


def _measured(
    path: Path, source: MarkerSource, theirs: FloatArray | None, noise: float, drop: float
) -> list[str]:
    start = time.perf_counter()
    recorded = read_markers(path, source.topic, (*source.on_base, *source.moved))
    if noise or drop:
        recorded = _spoilt(recorded, noise, drop)
    joint_states, residuals = solve_trajectories(recorded, source)
    seconds = time.perf_counter() - start
    q = joint_states.layouts[0].positions
    usable = np.isfinite(q).all(axis=1)
    differences = [""] * len(source.joint_names)
    if theirs is not None:
        differences = [f"{np.rad2deg(np.sqrt(np.mean(d**2))):.3f}" for d in (q - theirs)[usable].T]
    return [
        str(len(q)),
        str(np.count_nonzero(usable)),
        f"{len(q) / seconds:.0f}",
        *_worst(residuals.values()),
        *differences,
    ]


def _worst(residuals: Collection[MarkerResidual]) -> list[str]:
    """The largest median and 95th percentile of all markers [mm]."""
    figures = (max(r.median for r in residuals), max(r.percentile_95 for r in residuals))
    return [f"{1000.0 * figure:.3f}" for figure in figures]


def _spoilt(recorded: MarkerTrajectories, noise: float, drop: float) -> MarkerTrajectories:
    random = np.random.default_rng(0)
    positions = recorded.positions + random.normal(0.0, noise / 1000.0, recorded.positions.shape)
    positions[random.random(positions.shape[:2]) < drop] = np.nan
    return replace(recorded, positions=positions)


def _recorded(path: Path, joint_names: tuple[str, ...]) -> FloatArray:
    with open_bag(path) as bag:
        raw = bag.joint_states(choose_topic(bag.topics).name)
    (layout,) = raw.layouts
    return layout.positions[:, [layout.joint_names.index(name) for name in joint_names]]


if __name__ == "__main__":
    main()
