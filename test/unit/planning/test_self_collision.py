# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""Self-collision is checked where the robot has collision shapes, unless it is turned off."""

import numpy as np
import pytest
from support.chain import ACROSS_BASE, CHAIN, NAMES, chain, fold

from mp_pca_planner.exceptions import RobotError
from mp_pca_planner.motion.collision import CollisionModel
from mp_pca_planner.planning.options import PlannerOptions
from mp_pca_planner.planning.planner import Planner
from mp_pca_planner.robot.model import Robot
from mp_pca_planner.robot.world import Obstacle, Sphere, World

BALL = World([Obstacle("ball", [Sphere(0.05, [2.0, 2.0, 0.0])])])


def test_a_motion_across_the_base_goes_around_it_unless_that_is_turned_off():
    start, goal = ACROSS_BASE
    referee = CollisionModel(chain())
    careful, careless = (
        Planner(chain(), fold(), collision=collision).plan(goal, start)
        for collision in (True, False)
    )
    assert careless.is_executable and referee.collisions(careless.trajectory)
    assert not careful.is_executable or not referee.collisions(careful.trajectory)
    assert careful.is_executable, careful.message


@pytest.mark.parametrize("timing", ["auto", "demonstrated", "shortest"])
@pytest.mark.parametrize("end", ["start", "goal"])
def test_an_end_in_collision_is_told_before_any_search(end, timing):
    referee, middle = CollisionModel(chain()), np.array([0.0, 2.1, 2.09])
    assert referee.collides(middle)
    ends = {"start": ACROSS_BASE[0], "goal": ACROSS_BASE[1], end: middle}
    plan = Planner(chain(), fold(), options=PlannerOptions(timing=timing)).plan(**ends)
    assert not plan.is_executable and f"the {end} is in collision" in plan.message
    assert plan.iterations == 0


def test_shapes_that_overlap_in_the_demonstrations_are_left_out_by_name():
    # The demonstrations bend the last link to 2.5 rad, where a wide shape meets the first one's.
    before, _, after = CHAIN.rpartition('<sphere radius="0.04"/>')
    wide = Robot(f'{before}<sphere radius="0.3"/>{after}', NAMES)
    planner = Planner(wide, fold())
    assert planner.collision is not None
    (remark,) = planner.remarks
    dropped = set(CollisionModel(wide).pairs) - set(planner.collision.pairs)
    assert dropped and all(f"'{a}' and '{b}'" in remark for a, b in dropped)
    motion = fold().boundary_states[:, [0, 3]].reshape(-1, 3)
    assert not planner.collision.collide_anywhere(motion)
    assert Planner(chain(), fold()).remarks == ()


@pytest.mark.parametrize("collision", [True, False])
def test_missing_meshes_are_one_remark_and_stop_only_what_needs_them(collision):
    text = CHAIN.replace('<sphere radius="0.04"/>', '<mesh filename="package://arm/a.stl"/>')
    robot = Robot(text, NAMES)
    planner = Planner(robot, fold(), collision=collision)
    assert planner.collision is None
    assert ["--package-dirs" in remark for remark in planner.remarks] == [True] * collision
    assert planner.plan(*ACROSS_BASE[::-1]).is_executable
    with pytest.raises(RobotError, match="--package-dirs"):
        Planner(robot, fold(), collision=collision, world=BALL)


def test_a_robot_without_shapes_is_said_to_be_unchecked():
    bare = Robot(
        "".join(part.partition("</collision>")[2] or part for part in CHAIN.split("<collision>")),
        NAMES,
    )
    (remark,) = Planner(bare, fold()).remarks
    assert "no collision geometry" in remark
    with pytest.raises(RobotError, match="no collision geometry"):
        Planner(bare, fold(), world=BALL)
