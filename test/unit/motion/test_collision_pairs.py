# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""Which pairs of links are checked, against sets that are computed from the URDF on its own."""

import xml.etree.ElementTree as ET
from collections import Counter
from itertools import combinations
from pathlib import Path

import numpy as np
import pinocchio as pin
import pytest
from support.arm import JOINTS

from mp_pca_planner.files import config_file
from mp_pca_planner.motion.collision import CollisionModel
from mp_pca_planner.robot.examples import EXAMPLE_ROBOTS, example_file
from mp_pca_planner.robot.meshes import package_folders
from mp_pca_planner.robot.model import Robot

loader = pytest.importorskip(
    "example_robot_data.robots_loader",
    reason="example-robot-data is not installed (extra 'peers')",
)
PANDA = "panda_description/urdf/panda.urdf"
FOLDER = Path(loader.getModelPath(PANDA))
# Files of example-robot-data with an arm, of each kind.
ARMS = [
    *("TwoDofs", "anymal-kinova", "baxter", "bluevolta_bravo7_gripper", "borinot_flying_arm_2"),
    *("double_pendulum_continuous", "finger_edu", "hextilt_flying_arm_5", "pr2", "tiago"),
    *("talos_left_arm", "ur5_gripper", "ur5_joint_limited_robot"),
]
MOVABLE = ("revolute", "continuous", "prismatic")
TOUCHING = 1e-6


class Tree:
    """Links and joints of a URDF by name, read without the package."""

    def __init__(self, path):
        root = ET.parse(path).getroot()
        self.joints, self.ranges = {}, {}
        for joint in root.findall("joint"):
            ends = (joint.find(end).get("link") for end in ("parent", "child"))
            self.joints[joint.get("name")] = (*ends, joint.get("type") in MOVABLE)
            limit = joint.find("limit")
            ends = (-np.inf, np.inf)
            if limit is not None and joint.get("type") != "continuous":
                ends = tuple(float(limit.get(end, "0")) for end in ("lower", "upper"))
            self.ranges[joint.get("name")] = ends
        self.above = {child: name for name, (_, child, _) in self.joints.items()}

    def carrier(self, link, moving):
        """The first of the moving joints on the way from a link to the root, None without one."""
        while link in self.above:
            name = self.above[link]
            if name in moving:
                return name
            link = self.joints[name][0]
        return None


def shapes_and_distances(path, folders, reference):
    """Links of the collision shapes, and the distance [m] of any two, by a model of its own."""
    model = pin.buildModelFromUrdf(str(path))
    kind = pin.GeometryType.COLLISION
    geometry = pin.buildGeomFromUrdf(model, str(path), kind, package_dirs=folders)
    links = [model.frames[shape.parentFrame].name for shape in geometry.geometryObjects]
    pairs = list(combinations(range(len(links)), 2))
    for first, second in pairs:
        geometry.addCollisionPair(pin.CollisionPair(first, second))
    data, q = geometry.createData(), pin.neutral(model)
    for name, position in reference.items():
        joint = model.joints[model.getJointId(name)]
        if joint.nq == 1:  # continuous joints have 2, and 0 is their neutral angle
            q[joint.idx_q] = position
    pin.updateGeometryPlacements(model, model.createData(), geometry, data, q)
    return {
        (k, links[first], links[second]): pin.computeDistance(geometry, data, k).min_distance
        for k, (first, second) in enumerate(pairs)
    }


def expected_pairs(path, joint_names, folders):
    """How often two links are to be checked: once for each two shapes of them."""
    tree = Tree(path)
    every_moving = {name for name, (_, _, moves) in tree.joints.items() if moves}
    reference = {name: np.clip(0.0, *tree.ranges[name]) for name in every_moving}
    expected = Counter()
    for (_, a, b), distance in shapes_and_distances(path, folders, reference).items():
        i, j = (tree.carrier(link, every_moving) for link in (a, b))
        before = [tree.carrier(tree.joints[k][0], every_moving) if k else None for k in (i, j)]
        neighbours = i == j or (j is not None and i == before[1]) or (i and j == before[0])
        fixed = len({tree.carrier(link, set(joint_names)) for link in (a, b)}) == 1
        if not neighbours and not fixed and distance >= TOUCHING:
            expected[frozenset((a, b))] += 1
    return expected


def checked(model):
    """How often two links are checked: once for each two shapes."""
    return Counter(map(frozenset, model.pairs))


def example(name):
    """A file, and the joints that move: those of an example, whose gripper is locked."""
    if name == "human_arm":
        return config_file("human_arm.urdf"), JOINTS
    if name in EXAMPLE_ROBOTS:
        return example_file(name)
    (path,) = FOLDER.glob(f"**/{name}.urdf")
    return path, None


@pytest.mark.parametrize("name", [*EXAMPLE_ROBOTS, *ARMS])
def test_pairs_of_every_arm_are_the_expected_ones(name):
    path, joints = example(name)
    folders, robot = package_folders([], path), Robot.from_file(path, joints)
    actual = checked(CollisionModel(robot, package_dirs=folders))
    assert actual == expected_pairs(path, robot.joint_names, [str(x) for x in folders])
    if name == "kinova":  # lost once
        for links in (("link_3", "link_finger_1"), ("link_4", "link_finger_tip_1")):
            assert frozenset(f"j2s6s200_{name}" for name in links) in actual


@pytest.mark.parametrize(("arm", "srdf"), [("panda", "panda"), ("ur5_robot", "ur5")])
def test_an_srdf_disables_the_pairs_it_names_and_no_others(arm, srdf):
    (path,), (file,) = FOLDER.glob(f"**/{arm}.urdf"), FOLDER.glob(f"**/{srdf}.srdf")
    pairs = ET.parse(file).getroot().iter("disable_collisions")
    disabled = {frozenset((pair.get("link1"), pair.get("link2"))) for pair in pairs}
    robot, tree, folders = Robot.from_file(path), Tree(path), package_folders([], path)
    shapes = shapes_and_distances(path, [str(x) for x in folders], {})
    moving = set(robot.joint_names)
    expected = Counter(
        frozenset((a, b))
        for _, a, b in shapes
        if frozenset((a, b)) not in disabled and tree.carrier(a, moving) != tree.carrier(b, moving)
    )
    model = CollisionModel(robot, srdf=file, package_dirs=folders)
    assert disabled and checked(model) == expected
