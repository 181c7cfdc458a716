# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""Programs of made-up motions."""

import numpy as np
from support.arm import JOINTS, arm_primitive, arm_robot

from mp_pca_planner.motion.goal import JointState
from mp_pca_planner.planning.motion import N_NODES, Motion, Tables
from mp_pca_planner.planning.program.segment import SegmentProgram, Unknowns
from mp_pca_planner.primitives.basis import BSplineBasis
from mp_pca_planner.recordings.synthetic import generate_motions

BASES = {
    "arm": arm_primitive("arm").basis,
    "joint": arm_primitive("joint").basis,
    "bspline": BSplineBasis(4),
}


def compile_motion(basis, seed=0, n_nodes=N_NODES):
    """A program between the ends of a made-up motion, from a moving start, and its motion."""
    rng = np.random.default_rng(seed)
    ends = generate_motions(seed + 1, 77)[seed].positions
    start = JointState(JOINTS, ends[0], 0.5 * rng.normal(size=4), 2.0 * rng.normal(size=4))
    goal = JointState(JOINTS, ends[-1])
    weights = basis.scales * rng.normal(size=basis.n_weights) * 0.3
    motion = Motion(start, goal, 0.9, basis, weights)
    unknowns = Unknowns(basis.scales, motion.boundary, 0.9)
    program = SegmentProgram(arm_robot(), Tables(basis, n_nodes), unknowns, 0.5 * weights)
    return program, motion
