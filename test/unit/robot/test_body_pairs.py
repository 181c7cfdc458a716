# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""Distances of links and obstacles, against closed forms and plain calls of Pinocchio."""

import numpy as np
import pinocchio as pin
import pytest
from support.arm import arm_robot
from support.balls import RADIUS, URDF, distances, model
from support.worlds import TETRAHEDRON, TRAY, plain_distances, random_world

import mp_pca_planner as mp
from mp_pca_planner.exceptions import WorldError
from mp_pca_planner.motion.collision import CollisionModel
from mp_pca_planner.robot.distances import JointTree

# Closed forms


def test_distance_of_spheres_is_that_of_their_centres_less_the_radii():
    found = distances(model(mp.Obstacle("ball", mp.Sphere(0.2, (0.3, 0.4, 1.0)))), [0.0, 0.0])
    assert found["slider", "ball"] == pytest.approx(0.5 - 0.2 - RADIUS, abs=1e-6)
    assert found["turner", "ball"] == pytest.approx(np.hypot(0.2, 0.4) - 0.3, abs=1e-6)


def test_distance_of_a_sphere_from_a_box_is_that_of_its_centre_from_the_box():
    # A face is nearest to the slider, an edge to the turner.
    turned = (0.0, 0.0, np.sqrt(0.5), np.sqrt(0.5))
    box = mp.Obstacle("box", mp.Box((0.4, 0.2, 0.2), (0.0, 0.5, 1.0), turned))
    found = distances(model(box), [0.0, 0.0])
    assert found["slider", "box"] == pytest.approx(0.3 - RADIUS, abs=1e-6)
    assert found["turner", "box"] == pytest.approx(np.hypot(0.4, 0.3) - RADIUS, abs=1e-6)


def test_a_link_may_be_a_capsule():
    ball = f'<geometry><sphere radius="{RADIUS}"/>'
    capsule = '<geometry><capsule radius="0.1" length="0.4"/>'
    found = distances(CollisionModel(mp.Robot(URDF.replace(ball, capsule, 1))), [0.0, 0.0])
    # Its upper half sphere is the nearest part to the turner.
    expected = np.hypot(0.5, 1.0 - 0.2) - 0.1 - RADIUS
    assert found["base", "turner"] == pytest.approx(expected, abs=1e-6)


@pytest.mark.parametrize("n_others", [0, 60, 400])
def test_configurations_are_checked_with_the_margin_among_few_and_many_bodies(n_others):
    ball = mp.Obstacle("ball", mp.Sphere(0.2, (0.0, 0.8, 1.0)))
    others = [mp.Obstacle(f"o{k}", mp.Sphere(0.1, (3.0 + k, 0.0, 1.0))) for k in range(n_others)]
    # The slider is 0.5 m away from the ball.
    assert not model(ball, *others, margin=0.49).collides(np.zeros(2))
    assert model(ball, *others, margin=0.51).collides(np.zeros(2))


def test_margin_is_subtracted_from_distances_of_obstacles_alone():
    ball = mp.Obstacle("ball", mp.Sphere(0.2, (0.0, 0.8, 1.0)))
    near, far = distances(model(ball), [0, 0]), distances(model(ball, margin=0.3), [0, 0])
    assert far["slider", "ball"] == pytest.approx(near["slider", "ball"] - 0.3, abs=1e-9)
    assert far["base", "turner"] == near["base", "turner"]


def test_open_mesh_is_a_surface_and_a_closed_convex_one_is_solid():
    tray = mp.Mesh(TRAY.vertices, TRAY.triangles, (0.0, 0.0, 0.5))
    inside = distances(model(mp.Obstacle("tray", tray)), [0.0, 0.0])
    assert inside["slider", "tray"] == pytest.approx(0.5 - RADIUS, abs=1e-6)
    solid = mp.Mesh(10.0 * np.vstack([-np.ones(3), np.eye(3)]), TETRAHEDRON)
    assert distances(model(mp.Obstacle("solid", solid)), [0.0, 0.0])["slider", "solid"] < -1.0


def test_order_of_the_joints_changes_the_order_of_columns_alone():
    world = mp.World([mp.Obstacle("ball", mp.Sphere(0.2, (0.3, 0.9, 1.0)))])
    usual, other = (
        CollisionModel(mp.Robot(URDF, names), world=world)
        for names in (["slide", "turn"], ["turn", "slide"])
    )
    assert usual.pairs == other.pairs
    for q in np.random.default_rng(0).uniform(-2.0, 2.0, (20, 2)):
        one, two = usual.near(q[None], np.inf), other.near(q[None, ::-1], np.inf)
        np.testing.assert_allclose(one.distances, two.distances)
        np.testing.assert_allclose(one.rows, two.rows[:, ::-1], atol=1e-9)
        assert usual.collides(q) == other.collides(q[::-1])
    np.testing.assert_array_equal(usual.body_pairs.levers, other.body_pairs.levers[:, ::-1])


# Pairs


def test_hulls_take_the_place_of_meshes_that_move_alone():
    nothing = np.zeros(2)
    held = mp.Mesh(TRAY.vertices, TRAY.triangles, (0.0, 0.0, -0.5))
    around = model(mp.Obstacle("tray", held, frame="slider"))
    distances = np.zeros(len(around.pairs))
    assert not around.check(distances)(nothing)
    assert around.check(distances, hulls=True)(nothing)  # the turner is inside the tray
    still = model(mp.Obstacle("tray", mp.Mesh(TRAY.vertices, TRAY.triangles, (0.0, 0.0, 0.5))))
    assert not still.check(np.zeros(len(still.pairs)), hulls=True)(nothing)


def test_pairs_without_relative_motion_are_not_checked():
    table = mp.Obstacle("table", mp.Sphere(0.1, (5, 0, 0)))
    held = mp.Obstacle("held", mp.Sphere(0.1, (0.8, 0, 0)), "turner")
    found = set(model(table, held).pairs)
    assert ("base", "table") not in found and ("turner", "held") not in found
    assert {("slider", "table"), ("turner", "table"), ("slider", "held")} < found
    assert ("table", "held") in found


def test_touch_links_and_allowed_contacts_are_not_checked():
    held = mp.Obstacle("held", mp.Sphere(0.1, (0.8, 0, 0)), "turner", ["slider"])
    assert ("slider", "held") not in model(held).pairs
    ball = mp.Obstacle("ball", mp.Sphere(0.1, (5, 0, 0)))
    world = mp.World([ball], allowed=[("ball", "slider"), ("base", "turner")])
    assert CollisionModel(mp.Robot(URDF), world=world).pairs == (("turner", "ball"),)
    only_world = CollisionModel(mp.Robot(URDF), world=mp.World([ball]), self_collision=False)
    assert set(only_world.pairs) == {("slider", "ball"), ("turner", "ball")}


def test_attached_obstacle_moves_with_its_link():
    held = mp.Obstacle("held", mp.Sphere(0.1, (0.8, 0.0, 0.0)), "turner")
    ball = mp.Obstacle("ball", mp.Sphere(0.1, (0.0, 2.0, 1.0)))
    found = distances(model(held, ball), [0.0, 0.5 * np.pi])
    assert found["held", "ball"] == pytest.approx(1.2 - 0.2, abs=1e-6)


@pytest.mark.parametrize(
    ("obstacle", "message"),
    [
        (mp.Obstacle("ball", mp.Sphere(1.0), "turnr"), "no link is called 'turnr' .did you mean"),
        (mp.Obstacle("slider", mp.Sphere(1.0)), "'slider' has the name of a link"),
    ],
)
def test_world_that_does_not_fit_the_robot_is_refused_and_the_old_one_kept(obstacle, message):
    found = model(mp.Obstacle("kept", mp.Sphere(0.1, (5, 0, 0))))
    pairs, world = found.pairs, found.world
    with pytest.raises(WorldError, match=message):
        found.set_world(mp.World([obstacle]))
    assert found.pairs == pairs and found.world is world
    with pytest.raises(WorldError, match="margin of the clearance must be from 0"):
        found.set_world(mp.World(), -1.0)


def test_replaced_world_gives_what_a_new_model_gives():
    rng, changed = np.random.default_rng(0), CollisionModel(arm_robot())
    for _ in range(3):
        world, q = random_world(rng), rng.uniform(-1.0, 1.0, (4, 4))
        changed.set_world(world, 0.02)
        fresh = CollisionModel(arm_robot(), world=world, margin=0.02)
        one, other = changed.near(q, np.inf), fresh.near(q, np.inf)
        assert changed.pairs == fresh.pairs
        np.testing.assert_array_equal(one.distances, other.distances)
        np.testing.assert_array_equal(one.rows, other.rows)


# All shapes


def test_distances_are_those_of_plain_calls_and_bounds_lie_below():
    rng, limits = np.random.default_rng(1), arm_robot().limits()
    n_clear = 0
    for _ in range(4):
        world = random_world(rng)
        found = CollisionModel(arm_robot(), world=world, self_collision=False)
        q = rng.uniform(limits.lower, limits.upper, (12, 4))
        near, plain = found.near(q, np.inf), plain_distances(world, q)
        own = np.full(plain.shape, np.inf)
        names = list(world.names)
        for k, pair, distance in zip(near.configurations, near.pairs, near.distances, strict=True):
            i = names.index(found.pairs[pair][1])
            own[k, i] = min(own[k, i], distance)
        # Of meshes far away, the distance of the hull is given.
        is_exact = np.array([not isinstance(o.shapes[0], mp.Mesh) for o in world])
        clear = plain > 1e-3
        n_clear += int(clear.sum())
        np.testing.assert_allclose(
            own[:, is_exact][clear[:, is_exact]], plain[:, is_exact][clear[:, is_exact]], atol=1e-5
        )
        assert np.all(own[clear] <= plain[clear] + 1e-5)
        assert np.all(own[plain <= -1e-3] < 1e-3)
        for enough in (0.0, 0.1, np.inf):
            bounds = found.body_pairs.bounds(q, enough)
            below = bounds[near.configurations, near.pairs]
            assert np.all(below <= np.maximum(near.distances, 0.0) + 1e-9)
        met = np.array([found.collides(one) for one in q])
        clearly = np.abs(plain[:, is_exact]).min(axis=1) > 1e-4
        hit = (plain[:, is_exact] < 0.0).any(axis=1)
        assert np.all(met[hit & clearly])
        assert not np.any(met[(plain > 1e-3).all(axis=1)])
        pairs = np.arange(len(found.pairs))
        least = np.array(
            [found.body_pairs.distances(one[None], 0 * pairs, pairs).min() for one in q]
        )
        clearly = np.abs(least) > 1e-4
        np.testing.assert_array_equal(met[clearly], least[clearly] < 0.0)
    assert n_clear > 100


@pytest.mark.parametrize("step", [0.02, 0.2, 2.0])
def test_near_pairs_are_the_same_after_those_of_configurations_nearby(step):
    rng, limits, reach, n_near, n_far = np.random.default_rng(3), arm_robot().limits(), 0.03, 0, 0
    for _ in range(6):
        found = CollisionModel(arm_robot(), world=random_world(rng), margin=0.01)
        q = rng.uniform(limits.lower, limits.upper, (20, 4))
        before = found.near(q, reach)
        for _ in range(3):
            q = q + rng.uniform(-step, step, q.shape)
            plain, exact = found.near(q, reach), found.near(q, np.inf).bounds
            before = found.near(q, reach, before)
            for name in ("configurations", "pairs", "distances", "rows"):
                np.testing.assert_array_equal(getattr(before, name), getattr(plain, name))
            assert np.all(before.bounds <= np.maximum(exact, 0.0) + 1e-9)
            n_near += before.pairs.size
            n_far += int(np.sum(before.bounds != plain.bounds))
    assert n_near > 50 and n_far > 50


def test_least_distance_is_the_least_of_all_distances():
    rng, limits = np.random.default_rng(5), arm_robot().limits()
    for _ in range(6):
        found = CollisionModel(arm_robot(), world=random_world(rng), margin=0.01)
        q = rng.uniform(limits.lower, limits.upper, (20, 4))
        pairs = np.flatnonzero(found.margins > 0.0)
        every = found.near(q, np.inf).bounds
        distance, pair = found.body_pairs.least(q, pairs)
        assert distance == every[:, pairs].min() == every[:, pair].min()


def test_derivatives_are_those_of_differences():
    rng, limits, step = np.random.default_rng(2), arm_robot().limits(), 1e-5
    n_checked = 0
    for _ in range(4):
        found = CollisionModel(arm_robot(), world=random_world(rng), margin=0.01)
        for q in rng.uniform(limits.lower, limits.upper, (6, 4)):
            near = found.near(q[None], np.inf)
            ahead, behind = (
                found.near(q + sign * step * np.eye(4), np.inf).distances.reshape(4, -1)
                for sign in (1.0, -1.0)
            )
            differences = (ahead - behind).T / (2.0 * step)
            # Where faces or edges are parallel, the nearest points jump.
            second = np.abs(ahead + behind - 2.0 * near.distances).max(axis=0)
            smooth = (near.distances > 5e-3) & (second < 1e-8)
            n_checked += int(smooth.sum())
            np.testing.assert_allclose(near.rows[smooth], differences[smooth], atol=5e-3)
    assert n_checked > 100


@pytest.mark.parametrize("kind", ["balls", "arm"])
def test_poses_of_all_joints_at_once_are_those_of_pinocchio(kind):
    robot = mp.Robot(URDF) if kind == "balls" else arm_robot()
    model, _ = robot.pinocchio_model()
    data, q = model.createData(), np.random.default_rng(3).uniform(-2, 2, (5, robot.n_joints))
    rotations, positions = JointTree(model, np.arange(model.nv)).poses(q)
    for k, one in enumerate(q):
        pin.forwardKinematics(model, data, one)
        for j in range(model.njoints):
            np.testing.assert_allclose(rotations[k, j], data.oMi[j].rotation, atol=1e-12)
            np.testing.assert_allclose(positions[k, j], data.oMi[j].translation, atol=1e-12)
