# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""Distances of links and obstacles, against closed forms and plain calls of Pinocchio."""

import numpy as np
import pytest
from support.arm import arm_robot
from support.balls import RADIUS, URDF, distances, model
from support.chain import CHAIN, NAMES
from support.worlds import TETRAHEDRON, TRAY, plain_distances, random_world

import mp_pca_planner as mp
from mp_pca_planner.exceptions import WorldError
from mp_pca_planner.motion.collision import CollisionModel

BALL = mp.Obstacle("ball", mp.Sphere(0.2, (0.0, 0.8, 1.0)))
LIMITS = arm_robot().limits()

# Closed forms


def test_open_meshes_attached_obstacles_and_capsules_of_links_have_their_distances():
    ball = mp.Obstacle("ball", mp.Sphere(0.2, (0.3, 0.4, 1.0)))
    held = mp.Obstacle("held", mp.Sphere(0.1, (0.8, 0.0, 0.0)), "turner")
    tray = mp.Obstacle("tray", mp.Mesh(TRAY.vertices, TRAY.triangles, (0.0, 0.0, 0.5)))
    closed = mp.Mesh(10.0 * np.vstack([-np.ones(3), np.eye(3)]), TETRAHEDRON)
    found = distances(model(ball, held, tray, mp.Obstacle("solid", closed)), [0.0, 0.5 * np.pi])
    assert found["slider", "ball"] == pytest.approx(0.5 - 0.2 - RADIUS, abs=1e-6)
    assert found["ball", "held"] == pytest.approx(np.hypot(0.3, 0.4) - 0.3, abs=1e-6)
    assert found["slider", "tray"] == pytest.approx(0.5 - RADIUS, abs=1e-6)
    assert found["slider", "solid"] < -1.0
    sphere, capsule = f'sphere radius="{RADIUS}"', 'capsule radius="0.1" length="0.4"'
    links = CollisionModel(mp.Robot(URDF.replace(sphere, capsule, 1)))
    # Its upper half sphere is the nearest part to the turner.
    expected = np.hypot(0.5, 1.0 - 0.2) - 0.1 - RADIUS
    assert distances(links, [0.0, 0.0])["base", "turner"] == pytest.approx(expected, abs=1e-6)


@pytest.mark.parametrize("n_others", [0, 60, 400])
def test_margin_is_subtracted_from_distances_of_obstacles_alone(n_others):
    others = [mp.Obstacle(f"o{k}", mp.Sphere(0.1, (3.0 + k, 0.0, 1.0))) for k in range(n_others)]
    # The slider is 0.5 m away from the ball.
    assert not model(BALL, *others, margin=0.49).collides(np.zeros(2))
    assert model(BALL, *others, margin=0.51).collides(np.zeros(2))
    near, far = distances(model(BALL), [0, 0]), distances(model(BALL, margin=0.3), [0, 0])
    assert far["slider", "ball"] == pytest.approx(near["slider", "ball"] - 0.3, abs=1e-9)
    assert far["base", "turner"] == near["base", "turner"]


# Pairs


def test_pairs_that_move_relative_to_each_other_and_may_not_touch_are_checked():
    held = mp.Obstacle("held", mp.Sphere(0.1, (0.8, 0, 0)), "turner", ["slider"])
    links = {("base", "turner")}
    among = {("slider", "ball"), ("turner", "ball")}
    assert set(model(BALL).pairs) == links | among
    assert set(model(BALL, held).pairs) == links | among | {("ball", "held"), ("base", "held")}
    world = mp.World([BALL], allowed=[("ball", "slider"), ("base", "turner")])
    assert CollisionModel(mp.Robot(URDF), world=world).pairs == (("turner", "ball"),)
    alone = CollisionModel(mp.Robot(URDF), world=mp.World([BALL]), self_collision=False)
    assert set(alone.pairs) == among


@pytest.mark.parametrize(
    ("obstacle", "message"),
    [
        (mp.Obstacle("ball", mp.Sphere(1.0), "turnr"), "no link is called 'turnr' .did you mean"),
        (mp.Obstacle("slider", mp.Sphere(1.0)), "'slider' has the name of a link"),
    ],
)
def test_world_that_does_not_fit_the_robot_is_rejected_and_the_old_one_kept(obstacle, message):
    found = model(BALL)
    pairs, world = found.pairs, found.world
    with pytest.raises(WorldError, match=message):
        found.set_world(mp.World([obstacle]))
    with pytest.raises(WorldError, match="margin of the clearance must be from 0"):
        found.set_world(mp.World(), -1.0)
    assert found.pairs == pairs and found.world is world


# Random worlds


def random_models(seed, n, **options):
    """Models of the arm in random worlds, with random configurations."""
    rng = np.random.default_rng(seed)
    for _ in range(n):
        found = CollisionModel(arm_robot(), world=random_world(rng), **options)
        yield found, rng.uniform(LIMITS.lower, LIMITS.upper, (16, 4)), rng


def test_distances_are_those_of_plain_calls_and_bounds_lie_below():
    n_clear = 0
    for found, q, _ in random_models(1, 4, self_collision=False):
        world = found.world
        near, plain = found.near(q, np.inf), plain_distances(world, q)
        own = np.full(plain.shape, np.inf)
        others = [world.names.index(names[1]) for names in found.pairs]
        columns = np.array(others)[near.pairs]
        np.minimum.at(own, (near.configurations, columns), near.distances)
        # Of meshes far away, the distance of the hull is given.
        is_exact = np.array([not isinstance(o.shapes[0], mp.Mesh) for o in world])
        clear = plain > 1e-3
        n_clear += int(clear.sum())
        both = clear & is_exact
        np.testing.assert_allclose(own[both], plain[both], atol=1e-5)
        assert np.all(own[clear] <= plain[clear] + 1e-5)
        assert np.all(own[plain <= -1e-3] < 1e-3)
        for enough in (0.0, 0.1, np.inf):
            below = found.body_pairs.bounds(found.body_pairs.poses(q), enough)[
                near.configurations, near.pairs
            ]
            assert np.all(below <= np.maximum(near.distances, 0.0) + 1e-9)
        met = np.array([found.collides(one) for one in q])
        clearly = np.abs(plain[:, is_exact]).min(axis=1) > 1e-4
        assert np.all(met[(plain[:, is_exact] < 0.0).any(axis=1) & clearly])
        assert not np.any(met[clear.all(axis=1)])
        every = [found.collide_anywhere(one[None]) for one in q]
        least = near.bounds.min(axis=1)
        clearly = np.abs(least) > 1e-4
        np.testing.assert_array_equal(met[clearly], least[clearly] < 0.0)
        np.testing.assert_array_equal(met[clearly], np.array(every)[clearly])
    assert n_clear > 100


@pytest.mark.parametrize("step", [0.02, 0.2, 2.0])
def test_near_pairs_are_the_same_after_those_of_configurations_nearby(step):
    reach, n_near, n_far = 0.03, 0, 0
    for found, q, rng in random_models(3, 6, margin=0.01):
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


def test_nearest_distances_and_other_orders_and_replaced_worlds_agree():
    replaced = CollisionModel(arm_robot())
    for found, q, rng in random_models(5, 4, margin=0.01):
        near, pairs = found.near(q, np.inf), np.flatnonzero(found.margins > 0.0)
        moments, every = np.repeat(np.arange(len(q)), pairs.size), np.tile(pairs, len(q))
        distances = found.body_pairs.nearest(found.body_pairs.poses(q), moments, every)
        np.testing.assert_array_equal(distances, near.bounds[:, pairs].ravel())
        replaced.set_world(found.world, 0.01)
        order = rng.permutation(4)
        names = [arm_robot().joint_names[k] for k in order]
        other = CollisionModel(arm_robot().with_joints(names), world=found.world, margin=0.01)
        assert replaced.pairs == other.pairs == found.pairs
        again, moved = replaced.near(q, np.inf), other.near(q[:, order], np.inf)
        for one in (again, moved):
            np.testing.assert_allclose(one.distances, near.distances, atol=1e-9)
        np.testing.assert_allclose(again.rows, near.rows, atol=1e-9)
        np.testing.assert_allclose(moved.rows, near.rows[:, order], atol=1e-4)
        levers = found.body_pairs.levers
        np.testing.assert_allclose(other.body_pairs.levers, levers[:, order])
        assert [found.collides(x) for x in q] == [other.collides(x) for x in q[:, order]]


def test_derivatives_are_those_of_differences():
    step, n_checked = 1e-5, 0
    for found, every, _ in random_models(2, 4, margin=0.01):
        for q in every[:6]:
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


@pytest.mark.parametrize("step", [0.01, 0.1, 1.0])
def test_no_distance_changes_by_more_than_its_bound(step):
    tightest = np.inf
    sliding = mp.Robot(CHAIN.replace('"two" type="revolute"', '"two" type="prismatic"'), NAMES)
    for found, _, rng in random_models(7, 4, margin=0.01):
        for bodies in (found, CollisionModel(sliding, world=found.world, margin=0.05)):
            n = bodies.body_pairs.levers.shape[1]
            one = rng.uniform(-1.5, 1.5, (40, n))
            other = one + step * rng.uniform(-1.0, 1.0, one.shape)
            ends = np.array([bodies.near(q, np.inf).bounds for q in (one, other)])
            pairs = np.tile(np.arange(len(bodies.pairs)), len(one))
            moved = np.repeat(np.abs(other - one), len(bodies.pairs), axis=0)
            most = bodies.body_pairs.approaches(pairs, moved, ends.max(axis=0).ravel())
            # Penetrations of hulls are not those of meshes.
            clear = (ends > 0.0).all(axis=0).ravel() & (moved.max(axis=1) > 0.0)
            change = np.abs(ends[1] - ends[0]).ravel()
            assert np.all(change[clear] <= most[clear] + 1e-6)
            tightest = min(tightest, (most[clear] - change[clear]).min() / step)
    assert tightest < 0.05
