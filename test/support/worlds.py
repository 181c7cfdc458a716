# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""Random worlds around the human arm, and distances in them by plain calls of the libraries."""

import coal
import numpy as np
import pinocchio as pin
from support.arm import arm_robot

import mp_pca_planner as mp
from mp_pca_planner.files import config_file
from mp_pca_planner.motion.interpolation import interpolate

TETRAHEDRON = [[0, 2, 1], [0, 1, 3], [0, 3, 2], [1, 2, 3]]
# The sides and the bottom of a box, open at the top.
TRAY = mp.Mesh(
    [[x, y, z] for x in (-1, 1) for y in (-1, 1) for z in (0, 1)],
    np.reshape(
        [0, 1, 3, 0, 3, 2, 4, 6, 7, 4, 7, 5, 0, 4, 5, 0, 5, 1, 2, 3, 7, 2, 7, 6, 0, 2, 6, 0, 6, 4],
        (-1, 3),
    ),
)


def random_world(rng: np.random.Generator) -> mp.World:
    """A shape of each kind within reach of the human arm."""

    def place() -> tuple[np.ndarray, np.ndarray]:
        quaternion = rng.normal(size=4)
        position = rng.uniform([0.2, -0.9, -0.3], [0.9, 0.3, 0.7])
        return position, quaternion / np.linalg.norm(quaternion)

    sizes = rng.uniform(0.02, 0.15, 3)
    pyramid = np.vstack([np.zeros(3), np.diag(sizes)])
    shapes = (
        mp.Box(sizes, *place()),
        mp.Sphere(sizes[0], *place()),
        mp.Cylinder(sizes[0], sizes[1], *place()),
        mp.Capsule(sizes[0], sizes[1], *place()),
        mp.Mesh(TRAY.vertices * sizes, TRAY.triangles, *place()),
        mp.Mesh(pyramid, TETRAHEDRON, *place()),
    )
    return mp.World([mp.Obstacle(f"o{k}", shape) for k, shape in enumerate(shapes)])


def plain_distances(world: mp.World, q: np.ndarray) -> np.ndarray:
    """Distances of the links of the human arm from obstacles, by Pinocchio and its library."""
    path = str(config_file("human_arm.urdf"))
    model = pin.buildModelFromUrdf(path)
    shapes = pin.buildGeomFromUrdf(model, path, pin.GeometryType.COLLISION)
    moving = [i for i, part in enumerate(shapes.geometryObjects) if part.parentJoint]
    for obstacle in world:
        (shape,) = obstacle.shapes
        number = shapes.addGeometryObject(
            pin.GeometryObject(
                obstacle.name,
                parent_joint=0,
                placement=pin.XYZQUATToSE3(shape.pose),
                collision_geometry=_body(shape),
            )
        )
        for i in moving:
            shapes.addCollisionPair(pin.CollisionPair(i, number))
    order = [arm_robot().joint_names.index(name) for name in model.names[1:]]
    data, poses = model.createData(), shapes.createData()
    least = np.empty((len(q), len(world)))
    for k, one in enumerate(q):
        pin.computeDistances(model, data, shapes, poses, one[order])
        found = [result.min_distance for result in poses.distanceResults]
        least[k] = np.reshape(found, (len(world), len(moving))).min(axis=1)
    return least


def _body(shape: object) -> object:
    if isinstance(shape, mp.Mesh):
        body = coal.BVHModelOBBRSS()
        body.beginModel(len(shape.triangles), len(shape.vertices))
        body.addVertices(shape.vertices)
        body.addTriangles(shape.triangles)
        body.endModel()
        return body
    sizes = [np.ravel(value) for value in vars(shape).values()][:-2]
    return getattr(coal, type(shape).__name__)(*map(float, np.concatenate(sizes)))


def least_distance(world: mp.World, motion: mp.Trajectory) -> float:
    """Least distance of the links of the human arm from obstacles, every 3 ms of a motion."""
    return float(plain_distances(world, interpolate(motion).q[::3]).min())


def ball_beside(clear: mp.Trajectory, other: mp.Trajectory) -> mp.World:
    """A ball more than 5 mm beside one motion, where the hand is farthest from it in another."""
    robot = arm_robot()
    one, two = (
        robot.frame_positions(motion.positions, [robot.frame_names[-1]])[:, 0]
        for motion in (clear, other)
    )
    away = np.linalg.norm(two[:, None] - one[None], axis=2)
    k = away.min(axis=1).argmax()
    direction = (two[k] - one[away[k].argmin()]) / away[k].min()
    for off in np.linspace(0.0, 0.2, 201):
        world = mp.World([mp.Obstacle("ball", mp.Sphere(0.03, two[k] + off * direction))])
        if least_distance(world, clear) > 5e-3:
            return world
    raise AssertionError("the motions are too near to each other")
