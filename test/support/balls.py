# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""Balls that slide and turn, whose distances have closed forms."""

import numpy as np

import mp_pca_planner as mp
from mp_pca_planner.motion.collision import CollisionModel

RADIUS = 0.1
# A ball that slides along x, carries another one that turns about z at 0.5 m, and a third fixed to
# the base.
URDF = f"""<robot name="balls">
<link name="base"><collision><geometry><sphere radius="{RADIUS}"/></geometry></collision></link>
<link name="slider"><collision><geometry><sphere radius="{RADIUS}"/></geometry></collision></link>
<link name="turner"><collision><origin xyz="0.5 0 0"/><geometry><sphere radius="{RADIUS}"/>
</geometry></collision></link>
<joint name="slide" type="prismatic"><parent link="base"/><child link="slider"/>
<origin xyz="0 0 1"/><axis xyz="1 0 0"/>
<limit lower="-2" upper="2" velocity="1" effort="1"/></joint>
<joint name="turn" type="revolute"><parent link="slider"/><child link="turner"/><axis xyz="0 0 1"/>
<limit lower="-3" upper="3" velocity="1" effort="1"/></joint></robot>"""


def model(*obstacles: mp.Obstacle, **options: object) -> CollisionModel:
    return CollisionModel(mp.Robot(URDF), world=mp.World(obstacles), **options)


def distances(found: CollisionModel, q: list[float]) -> dict[tuple[str, str], float]:
    near = found.near(np.array([q]), np.inf)
    return {found.pairs[k]: d for k, d in zip(near.pairs, near.distances, strict=True)}
