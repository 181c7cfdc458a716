# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""Mesh files, and distances from meshes with and without a volume."""

import shutil
import sys

import numpy as np
import pytest
import trimesh
from support.balls import RADIUS, URDF, distances, model

import mp_pca_planner as mp
from mp_pca_planner.exceptions import RobotError, WorldError
from mp_pca_planner.motion.collision import CollisionModel
from mp_pca_planner.robot.meshes import THICKNESS, package_folders, read_mesh, solid_of

# pycollada uses matrices of NumPy.
pytestmark = pytest.mark.filterwarnings("ignore:the matrix subclass")

FLOOR = (
    np.array([[-1.0, -1.0, 0.0], [1.0, -1.0, 0.0], [1.0, 1.0, 0.0], [-1.0, 1.0, 0.0]]),
    np.array([[0, 1, 2], [0, 2, 3]]),
)
CORNERS_OF_L = [[0, 0, 0], [2, 0, 0], [2, 1, 0], [1, 1, 0], [1, 2, 0], [0, 2, 0]]
TRIANGLES_OF_L = [[0, 1, 2], [0, 2, 3], [0, 3, 5], [3, 4, 5]]
CLOUD = np.random.default_rng(28).uniform(-0.5, 0.5, (60, 3))
TRIPLES = np.arange(60).reshape(-1, 3)
NEEDLE = np.outer(np.linspace(-1, 1, 60), [1.0, 0.0, 0.0])
THIN = {
    **{f"flat to 1e-{n}": CLOUD * [1.0, 1.0, 10.0**-n] for n in (5, 6, 7, 8, 10, 15)},
    **{f"thin to 1e-{n}": CLOUD * [1.0, *[10.0**-n] * 2] for n in (5, 6, 7, 8, 10, 15)},
    "tilted needle": np.outer(np.linspace(-1, 1, 60), [0.3, 0.5, 0.7]),
    "tilted plate": CLOUD * [1, 1, 1e-8] @ np.linalg.qr(CLOUD[:3])[0],
    "cloud": CLOUD,
    "far away": 999.0 + 1e-3 * CLOUD,
    "one triangle": np.tile(np.eye(3), (20, 1)),
}


def sphere(n: int) -> tuple[np.ndarray, np.ndarray]:
    """A mesh of the unit sphere: n rings of 2 n triangles each."""
    a, b = np.meshgrid(np.linspace(0, np.pi, n), np.linspace(0, 2 * np.pi, n), indexing="ij")
    points = np.stack([np.sin(a) * np.cos(b), np.sin(a) * np.sin(b), np.cos(a)], axis=2)
    grid = np.arange(n * n).reshape(n, n)
    one, two, three, four = grid[:-1, :-1], grid[1:, :-1], grid[1:, 1:], grid[:-1, 1:]
    cells = [np.stack([one, two, three], axis=2), np.stack([one, three, four], axis=2)]
    return points.reshape(-1, 3), np.concatenate(cells).reshape(-1, 3)


# Surfaces without a volume


@pytest.mark.parametrize("turn", [np.eye(3), np.linalg.qr(np.arange(9.0).reshape(3, 3) ** 2)[0]])
@pytest.mark.parametrize("height", [0.15, 0.3, 0.9])
def test_distance_of_a_floor_is_the_height_above_it(turn, height):
    # The slider is a ball at (x, 0, 1).
    floor = mp.Mesh(FLOOR[0] @ turn.T, FLOOR[1], np.array([0, 0, 1.0]) - height * turn[:, 2])
    found = model(mp.Obstacle("floor", floor))
    expected = height - RADIUS - 0.5 * THICKNESS
    assert distances(found, [0.0, 0.0])["slider", "floor"] == pytest.approx(expected, abs=1e-6)
    assert not found.collides(np.zeros(2))
    assert model(mp.Obstacle("floor", floor), margin=expected + 1e-3).collides(np.zeros(2))


def test_a_body_in_a_floor_is_in_collision():
    floor = mp.Obstacle("floor", mp.Mesh(*FLOOR, (0.0, 0.0, 0.95)))
    found = model(floor)
    depth = distances(found, [0.0, 0.0])["slider", "floor"]
    assert depth == pytest.approx(0.05 - RADIUS - 0.5 * THICKNESS, abs=1e-6)
    assert found.collides(np.zeros(2))


def test_distance_beside_a_floor_is_that_of_its_edge():
    floor = mp.Obstacle("floor", mp.Mesh(0.2 * FLOOR[0], FLOOR[1], (0.0, 0.6, 0.7)))
    expected = np.hypot(0.4, 0.3 - 0.5 * THICKNESS) - RADIUS
    found = distances(model(floor), [0.0, 0.0])["slider", "floor"]
    assert found == pytest.approx(expected, abs=1e-6)


def test_distance_of_a_needle_is_that_of_its_line():
    needle = mp.Mesh(NEEDLE, TRIPLES, (0.0, 0.3, 1.4))
    found = distances(model(mp.Obstacle("needle", needle)), [0.0, 0.0])["slider", "needle"]
    # Its thickness is that of a square.
    assert found == pytest.approx(0.5 - RADIUS, abs=THICKNESS)


def test_notch_of_a_flat_mesh_is_free():
    # The notch of the L, of corners (0.5, 0.5) and (1, 1), is above the slider.
    flat = mp.Mesh(0.5 * np.array(CORNERS_OF_L), TRIANGLES_OF_L, (-0.75, -0.75, 1.0))
    found = model(mp.Obstacle("flat", flat))
    assert distances(found, [0.0, 0.0])["slider", "flat"] == pytest.approx(0.15, abs=1e-6)
    assert not found.collides(np.zeros(2))


@pytest.mark.parametrize("name", THIN)
def test_a_mesh_without_a_volume_ends_no_process(name):
    obstacle = mp.Obstacle("mesh", mp.Mesh(THIN[name], TRIPLES))
    q = np.random.default_rng(0).uniform(-1.0, 1.0, (5, 2))
    found = model(obstacle, margin=0.01)
    near = found.near(q, 1e4)
    assert np.isfinite(near.distances).all() and np.isfinite(near.rows).all()
    for one in q:
        found.collides(one)


def test_a_mesh_without_an_extent_is_rejected():
    with pytest.raises(WorldError, match="must have an extent, but all its vertices are at one"):
        mp.Mesh(np.ones((3, 3)), [[0, 1, 2]])


@pytest.mark.parametrize("seed", range(5))
def test_hulls_hold_their_vertices_and_their_faces_look_outwards(seed):
    rng = np.random.default_rng(seed)
    points = rng.normal(size=(60, 3)) * [1.0, 1.0, 10.0 ** -(2 * seed)]
    solid = solid_of(points, TRIPLES)
    a, b, c = np.moveaxis(solid.corners[solid.faces], 1, 0)
    normals = np.cross(b - a, c - a)
    normals /= np.linalg.norm(normals, axis=1)[:, None]
    heights = np.einsum("fi,nfi->nf", normals, points[:, None] - a[None])
    assert heights.max() < 1e-9


def test_a_cone_of_many_sides_is_used_with_a_box_around_it():
    angles = np.linspace(0.0, 2.0 * np.pi, 400, endpoint=False)
    ring = np.stack([np.cos(angles), np.sin(angles), np.zeros(400)], axis=1)
    sides = [[k, (k + 1) % 400, 400] for k in range(400)]
    cone = solid_of(np.vstack([ring, [0.0, 0.0, 1.0]]), np.array(sides))
    assert cone.hull.num_points == 8 and not cone.is_convex


def test_a_closed_ball_is_convex_and_what_is_in_a_bowl_is_free():
    vertices, triangles = sphere(110)
    assert solid_of(vertices, triangles).is_convex
    bowl = vertices[triangles].mean(axis=1)[:, 2] < 0.5
    mesh = mp.Mesh(vertices, triangles[bowl], (0.0, 0.0, 1.0))
    near = model(mp.Obstacle("bowl", mesh)).near(np.zeros((1, 2)), np.inf)
    # The slider is in the centre.
    assert near.bounds.min() == pytest.approx(1.0 - RADIUS - 0.5, abs=0.2)


# Files


def saved(path, vertices, triangles):
    trimesh.Trimesh(vertices, triangles, process=False).export(path)
    return path


@pytest.mark.parametrize("name", ["a.stl", "text.STL", "a.obj", "a.dae"])
def test_stl_obj_and_collada_of_a_mesh_are_the_same(tmp_path, name):
    vertices, triangles = sphere(12)
    kind = {"file_type": "stl_ascii"} if name == "text.STL" else {}
    trimesh.Trimesh(vertices, triangles, process=False).export(tmp_path / name, **kind)
    found = read_mesh(tmp_path / name)
    np.testing.assert_allclose(found.vertices[found.triangles], vertices[triangles], atol=1e-6)


def collada(node, geometry="", *, unit="1", axis="Z_UP"):
    source = (
        '<source id="p"><float_array id="f" count="12">-1 -1 0 1 -1 0 1 1 0 -1 1 0</float_array>'
        '<technique_common><accessor source="#f" count="4" stride="3"><param name="X" '
        'type="float"/><param name="Y" type="float"/><param name="Z" type="float"/></accessor>'
        '</technique_common></source><vertices id="v"><input semantic="POSITION" source="#p"/>'
        "</vertices>"
    )
    faces = (
        geometry
        or '<triangles count="2" material="s"><input semantic="VERTEX" source="#v" offset="0"/>'
        "<p>0 1 2 0 2 3</p></triangles>"
    )
    return f"""<?xml version="1.0"?>
<COLLADA xmlns="http://www.collada.org/2005/11/COLLADASchema" version="1.4.1">
<asset><unit name="x" meter="{unit}"/><up_axis>{axis}</up_axis></asset>
<library_effects><effect id="e"><profile_COMMON><technique sid="t"><phong><diffuse>
<color>1 0 0.2 1</color></diffuse></phong></technique></profile_COMMON></effect></library_effects>
<library_materials><material id="m"><instance_effect url="#e"/></material></library_materials>
<library_geometries><geometry id="g"><mesh>{source}{faces}</mesh></geometry></library_geometries>
<library_visual_scenes><visual_scene id="s">{node}</visual_scene></library_visual_scenes>
<scene><instance_visual_scene url="#s"/></scene></COLLADA>"""


BARE = "<instance_geometry url='#g'/>"
BOUND = (
    "<instance_geometry url='#g'><bind_material><technique_common>"
    "<instance_material symbol='s' target='#m'/></technique_common></bind_material>"
    "</instance_geometry>"
)


@pytest.mark.parametrize("axis", ["Z_UP", "Y_UP"])
def test_collada_nodes_are_placed_in_metres_and_keep_their_colours(tmp_path, axis):
    nodes = (
        "<node><translate>0 0 7</translate><rotate>0 0 1 90</rotate><node><scale>2 2 2</scale>"
        f"{BOUND}</node></node>"
        f"<node><matrix>1 0 0 5 0 1 0 0 0 0 1 0 0 0 0 1</matrix>{BARE}</node>"
    )
    (tmp_path / "a.dae").write_text(collada(nodes, unit="0.01", axis=axis))
    found = read_mesh(tmp_path / "a.dae")
    floor = FLOOR[0][FLOOR[1]]
    first = 2.0 * np.stack([-floor[..., 1], floor[..., 0], floor[..., 2] + 3.5], axis=-1)
    expected = np.concatenate([first, floor + np.array([5.0, 0.0, 0.0])])
    np.testing.assert_allclose(found.vertices[found.triangles], 0.01 * expected, atol=1e-7)
    assert found.colours[0].tolist() == [255, 0, 51, 255]
    assert found.colours[2].tolist() != [255, 0, 51, 255]


@pytest.mark.parametrize(
    ("kind", "text", "n_triangles"),
    [
        ("polylist", "<vcount>4 3</vcount><p>0 1 2 3 0 1 2</p>", 3),
        ("polygons", "<p>0 1 2 3</p><p>3 2 1</p>", 3),
        ("lines", "<p>0 1</p>", 0),
        ("tristrips", "<p>0 1 2 3</p>", 2),
    ],
)
def test_kinds_of_faces_of_collada_are_read_or_rejected(tmp_path, kind, text, n_triangles):
    faces = f"<{kind} count='2'><input semantic='VERTEX' source='#v' offset='0'/>{text}</{kind}>"
    (tmp_path / "a.dae").write_text(collada(f"<node>{BARE}</node>", faces))
    if n_triangles:
        assert len(read_mesh(tmp_path / "a.dae").triangles) == n_triangles
    else:
        with pytest.raises(WorldError, match="a.dae' can't be read: "):
            read_mesh(tmp_path / "a.dae")


def stl(points, count=None):
    record = np.zeros(len(points) // 3, dtype=[("n", "<f4", 3), ("c", "<f4", (3, 3)), ("a", "<u2")])
    record["c"] = np.reshape(points, (-1, 3, 3))
    return (
        bytes(80) + np.uint32(len(record) if count is None else count).tobytes() + record.tobytes()
    )


GOOD = collada(f"<node>{BARE}</node>")
DOUBLE = "<node id='n{0}'><instance_node url='#n{1}'/><instance_node url='#n{1}'/></node>"
DOUBLED = collada("<node><instance_node url='#n0'/></node>").replace(
    "<library_visual_scenes>",
    "<library_nodes>"
    + "".join(DOUBLE.format(k, k + 1) for k in range(40))
    + f"<node id='n40'>{BARE}</node></library_nodes><library_visual_scenes>",
    1,
)
BAD = {
    "empty.stl": b"",
    "empty.obj": b"",
    "empty.dae": b"",
    "header.stl": bytes(84),
    "truncated.stl": stl(CLOUD)[:-60],
    "count.stl": stl(CLOUD, 4_000_000_000),
    "text cut off.stl": b"solid x\nfacet normal 0 0 1\nouter loop\nvertex 0 0 0\nvertex 1 0",
    "nan.stl": stl(np.full((3, 3), np.nan)),
    "point.stl": stl(np.ones((3, 3))),
    "program.stl": b"\x7fELF" + bytes(200),
    "only vertices.obj": b"v 0 0 0\nv 1 0 0\nv 0 1 0\n",
    "beyond the end.obj": b"v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 9\n",
    "nan.obj": b"v nan 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n",
    "words.obj": b"v a b c\nf 1 1 1\n",
    "truncated.dae": GOOD[: len(GOOD) // 2].encode(),
    "beyond the end.dae": GOOD.replace("0 1 2 0", "0 1 9 0").encode(),
    "no scene.dae": GOOD[: GOOD.index("<scene>")].encode() + b"</COLLADA>",
    "bomb.dae": GOOD.replace("?>", "?><!DOCTYPE C [<!ENTITY a 'a'>]>", 1).encode(),
    "robot.dae": b"<robot/>",
    "doubled.dae": DOUBLED.encode(),
    "other.ply": b"ply\n",
}


@pytest.mark.parametrize("name", BAD)
def test_bad_files_are_rejected_in_a_sentence_that_names_them(tmp_path, name):
    (tmp_path / name).write_bytes(BAD[name])
    with pytest.raises(WorldError) as rejection:
        mp.Mesh.from_file(tmp_path / name)
    assert str(rejection.value).isprintable()
    if name != "point.stl":
        assert f"{name}' can't be read: " in str(rejection.value)


def test_links_have_flat_meshes_and_bad_ones_are_named(tmp_path):
    saved(tmp_path / "floor.stl", *FLOOR)
    ball = f'<sphere radius="{RADIUS}"/>'
    mesh = f'<mesh filename="{tmp_path}/{{}}" scale="{{}}"/>'
    urdf = URDF.replace(ball, mesh.format("floor.stl", "0.1 0.1 -0.1"), 1)
    found = CollisionModel(mp.Robot(urdf))
    # The slider is 1 m above it, the turner is carried by the slider.
    near = distances(found, [0.0, 0.0])
    assert near["base", "turner"] == pytest.approx(
        np.hypot(1.0 - 0.5 * THICKNESS, 0.4) - RADIUS, abs=1e-6
    )
    with pytest.raises(RobotError, match="link 'base': scale of a mesh must not be 0, got 1, 0, 1"):
        CollisionModel(mp.Robot(URDF.replace(ball, mesh.format("floor.stl", "1 0 1"), 1)))
    (tmp_path / "bad.dae").write_bytes(b"<COLLADA")
    with pytest.raises(RobotError, match=r"link 'base': mesh .*bad\.dae' can't be read: "):
        CollisionModel(mp.Robot(URDF.replace(ball, mesh.format("bad.dae", "1 1 1"), 1)))


NAMED = '<mesh filename="package://somebody/meshes/floor.stl"/>'


@pytest.mark.parametrize(
    "folder",
    [
        "robot/somebody",  # above the URDF
        "robot/clone-of-somebody",  # a clone with another name, the URDF in it
        "ros/share/somebody",
        "catkin/somebody",
        "site/share/somebody",  # beside example-robot-data
        "given/somebody",
    ],
)
def test_mesh_of_a_package_is_found(tmp_path, monkeypatch, folder):
    package = tmp_path / folder
    (package / "meshes").mkdir(parents=True)
    saved(package / "meshes/floor.stl", *FLOOR)
    (package / "package.xml").write_text("<package><name>somebody</name></package>")
    examples = tmp_path / "site/lib/example_robot_data/__init__.py"
    for file in (examples, tmp_path / "site/share/example-robot-data/x"):
        file.parent.mkdir(parents=True)
        file.touch()
    monkeypatch.syspath_prepend(tmp_path / "site/lib")
    monkeypatch.delitem(sys.modules, "example_robot_data", raising=False)
    monkeypatch.setenv("ROS_PACKAGE_PATH", f"/nowhere:{tmp_path / 'catkin'}")
    monkeypatch.setenv("AMENT_PREFIX_PATH", str(tmp_path / "ros"))
    urdf = tmp_path / "robot" / ("clone-of-somebody" if "clone" in folder else "") / "urdf/r.urdf"
    urdf.parent.mkdir(parents=True)
    folders = package_folders([tmp_path / "given"], urdf)
    robot = mp.Robot(URDF.replace(f'<sphere radius="{RADIUS}"/>', NAMED, 1))
    assert CollisionModel(robot, package_dirs=folders).has_geometry
    shutil.rmtree(package)
    with pytest.raises(RobotError, match=r"holds the package 'somebody' by --package-dirs"):
        CollisionModel(robot, package_dirs=folders)


def test_path_of_another_machine_is_said_to_be_one():
    mesh = '<mesh filename="file:///home/user/ws/install/arm/share/arm/meshes/base.stl"/>'
    robot = mp.Robot(URDF.replace(f'<sphere radius="{RADIUS}"/>', mesh, 1))
    with pytest.raises(RobotError, match="its path is of another machine; write one relative to"):
        CollisionModel(robot)
