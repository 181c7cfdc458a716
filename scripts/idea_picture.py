#!/usr/bin/env python3
# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""Draw the picture of the idea: demonstrations, their shapes, and a new motion.

python3 scripts/idea_picture.py doc/idea.png
"""

from __future__ import annotations

import argparse
from pathlib import Path

import numpy as np
from gallery import GOAL, example

from mp_pca_planner.motion.interpolation import hermite_functions
from mp_pca_planner.plotting.style import LINES, palette_line, picture

N_PHASES, N_SHOWN, N_COMPONENTS = 101, 16, 3


def main() -> None:
    """Write the picture."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("picture", type=Path, help="PNG file to write")
    path = parser.parse_args().picture
    known = example()
    phases, primitive = np.linspace(0.0, 1.0, N_PHASES), known.primitive
    rise = hermite_functions(phases)[:, 3]
    mean = primitive.basis.shape(np.zeros(primitive.n_components), phases)
    deviations = np.diag(np.sqrt(primitive.explained_variance))[:N_COMPONENTS]
    components = [primitive.basis.shape(weights, phases) - mean for weights in deviations]
    joint = int(np.abs(components[0]).max(axis=0).argmax())
    motions = [one.time_normalised(N_PHASES)[:, joint] for one in known.recordings[:N_SHOWN]]
    shapes = [q - (q[0] + rise * (q[-1] - q[0])) for q in motions]
    goal = GOAL | {primitive.joint_names[joint]: -1.0}  # far from the start
    planned = known.planner().plan(start=known.start, goal=goal).trajectory
    start, goal = planned.positions[[0, -1], joint]
    with picture(path, force=True) as figure:
        figure.set_size_inches(9.0, 2.4)
        axes = figure.subplots(1, 4)
        titles = ("demonstrations", "minus minimum jerk", "components", "a new motion")
        for number, (one, title) in enumerate(zip(axes, titles, strict=True), start=1):
            one.set_title(f"{number}. {title}", fontsize=9)
            one.set_xlabel("share of the duration", fontsize=8)
            one.tick_params(labelsize=7)
        for one, curves in ((axes[0], motions), (axes[1], shapes)):
            for q in curves:
                one.plot(phases, np.rad2deg(q), **LINES["demonstration"])
        for k, shape in enumerate(components):
            curve = palette_line(f"component {k + 1}", k, 1.8)
            axes[2].plot(phases, np.rad2deg(shape[:, joint]), **curve)
        straight = start + rise * (goal - start)
        axes[3].plot(phases, np.rad2deg(straight), **LINES["minimum jerk"])
        share = planned.times / planned.duration
        plan = palette_line("plan", 0)
        axes[3].plot(share, np.rad2deg(planned.positions[:, joint]), **plan)
        for one, room in ((axes[2], 0.6), (axes[3], 0.4)):
            low, high = one.get_ylim()
            one.set_ylim(low, high + room * (high - low))  # for the legend
            one.legend(fontsize=7, loc="upper center")
        axes[0].set_ylabel(f"{primitive.joint_names[joint]} [deg]", fontsize=8)


if __name__ == "__main__":
    main()
