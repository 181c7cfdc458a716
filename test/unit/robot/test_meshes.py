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
CLOUD = np.random.default_rng(28).uniform(-0.5, 0.5, (60, 3))
TRIPLES = np.arange(60).reshape(-1, 3)
THIN = {
    **{f"flat to 1e-{n}": CLOUD * [1.0, 1.0, 10.0**-n] for n in (6, 7, 15)},
    **{f"thin to 1e-{n}": CLOUD * [1.0, *[10.0**-n] * 2] for n in (6, 7, 15)},
    "tilted needle": np.outer(np.linspace(-1, 1, 60), [0.3, 0.5, 0.7]),
    "tilted plate": CLOUD * [1, 1, 1e-8] @ np.linalg.qr(CLOUD[:3])[0],
    "far away": 999.0 + 1e-3 * CLOUD,
    "one triangle": np.tile(np.eye(3), (20, 1)),
}


def sphere(n):
    """A mesh of the unit sphere: n rings of 2 n triangles each."""
    a, b = np.meshgrid(np.linspace(0, np.pi, n), np.linspace(0, 2 * np.pi, n), indexing="ij")
    points = np.stack([np.sin(a) * np.cos(b), np.sin(a) * np.sin(b), np.cos(a)], axis=2)
    grid = np.arange(n * n).reshape(n, n)
    one, two, three, four = grid[:-1, :-1], grid[1:, :-1], grid[1:, 1:], grid[:-1, 1:]
    cells = [np.stack([one, two, three], axis=2), np.stack([one, three, four], axis=2)]
    return points.reshape(-1, 3), np.concatenate(cells).reshape(-1, 3)


def distance_from(mesh):
    """Of the slider, a ball at (0, 0, 1)."""
    return distances(model(mp.Obstacle("mesh", mesh)), [0.0, 0.0])["slider", "mesh"]


@pytest.mark.parametrize("turn", [np.eye(3), np.linalg.qr(np.arange(9.0).reshape(3, 3) ** 2)[0]])
@pytest.mark.parametrize("height", [0.05, 0.15, 0.9])
def test_distance_of_a_floor_is_the_height_above_it(turn, height):
    floor = mp.Mesh(FLOOR[0] @ turn.T, FLOOR[1], np.array([0, 0, 1.0]) - height * turn[:, 2])
    expected = height - RADIUS - 0.5 * THICKNESS
    assert distance_from(floor) == pytest.approx(expected, abs=1e-6)
    obstacle = mp.Obstacle("floor", floor)
    assert model(obstacle).collides(np.zeros(2)) == (expected < 0.0)
    assert model(obstacle, margin=abs(expected) + 1e-3).collides(np.zeros(2))


def test_distances_of_an_edge_a_needle_and_a_notch_are_their_own():
    edge = mp.Mesh(0.2 * FLOOR[0], FLOOR[1], (0.0, 0.6, 0.7))
    expected = np.hypot(0.4, 0.3 - 0.5 * THICKNESS) - RADIUS
    assert distance_from(edge) == pytest.approx(expected, abs=1e-6)
    # The thickness of a needle is that of a square.
    needle = mp.Mesh(np.outer(np.linspace(-1, 1, 60), [1, 0, 0]), TRIPLES, (0.0, 0.3, 1.4))
    assert distance_from(needle) == pytest.approx(0.5 - RADIUS, abs=THICKNESS)
    # The notch of an L, of corners (0.5, 0.5) and (1, 1), is above the slider.
    corners = np.array([[0, 0, 0], [2, 0, 0], [2, 1, 0], [1, 1, 0], [1, 2, 0], [0, 2, 0]])
    faces = [[0, 1, 2], [0, 2, 3], [0, 3, 5], [3, 4, 5]]
    flat = mp.Mesh(0.5 * corners, faces, (-0.75, -0.75, 1.0))
    assert distance_from(flat) == pytest.approx(0.15, abs=1e-6)
    assert not model(mp.Obstacle("mesh", flat)).collides(np.zeros(2))


@pytest.mark.parametrize("name", THIN)
def test_a_mesh_without_a_volume_ends_no_process(name):
    q = np.random.default_rng(0).uniform(-1.0, 1.0, (5, 2))
    found = model(mp.Obstacle("mesh", mp.Mesh(THIN[name], TRIPLES)), margin=0.01)
    near = found.near(q, 1e4)
    assert np.isfinite(near.distances).all() and np.isfinite(near.rows).all()
    found.collides(q[0])


def test_what_is_convex_is_known():
    angles = np.linspace(0.0, 2.0 * np.pi, 400, endpoint=False)
    ring = np.stack([np.cos(angles), np.sin(angles), np.zeros(400)], axis=1)
    sides = [[k, (k + 1) % 400, 400] for k in range(400)]
    cone = solid_of(np.vstack([ring, [0.0, 0.0, 1.0]]), np.array(sides))
    # Coal accepts no corner of so many faces: a box is around it.
    assert cone.hull.num_points == 8 and not cone.is_convex
    vertices, triangles = sphere(110)
    assert solid_of(vertices, triangles).is_convex
    bowl = vertices[triangles].mean(axis=1)[:, 2] < 0.5
    mesh = mp.Mesh(vertices, triangles[bowl], (0.0, 0.0, 1.0))
    # The slider is in its centre.
    assert distance_from(mesh) == pytest.approx(1.0 - RADIUS, abs=1e-3)


# Files


def saved(path, vertices, triangles, **kind):
    trimesh.Trimesh(vertices, triangles, process=False).export(path, **kind)
    return path


@pytest.mark.parametrize("name", ["a.stl", "text.STL", "a.obj", "a.dae"])
def test_stl_obj_and_collada_of_a_mesh_are_the_same(tmp_path, name):
    vertices, triangles = sphere(12)
    kind = {"file_type": "stl_ascii"} if name == "text.STL" else {}
    found = read_mesh(saved(tmp_path / name, vertices, triangles, **kind))
    np.testing.assert_allclose(found.vertices[found.triangles], vertices[triangles], atol=1e-6)


TRIANGLES = (
    '<triangles count="2" material="s"><input semantic="VERTEX" source="#v" offset="0"/>'
    "<p>0 1 2 0 2 3</p></triangles>"
)
BARE = "<instance_geometry url='#g'/>"


def collada(node=f"<node>{BARE}</node>", faces=TRIANGLES, unit="1"):
    """The floor, in nodes of a scene."""
    axes = "".join(f'<param name="{x}" type="float"/>' for x in "XYZ")
    numbers = " ".join(f"{x:g}" for x in FLOOR[0].ravel())
    return f"""<?xml version="1.0"?>
<COLLADA xmlns="http://www.collada.org/2005/11/COLLADASchema" version="1.4.1">
<asset><unit name="x" meter="{unit}"/><up_axis>Y_UP</up_axis></asset>
<library_effects><effect id="e"><profile_COMMON><technique sid="t"><phong><diffuse>
<color>1 0 0.2 1</color></diffuse></phong></technique></profile_COMMON></effect></library_effects>
<library_materials><material id="m"><instance_effect url="#e"/></material></library_materials>
<library_geometries><geometry id="g"><mesh>
<source id="p"><float_array id="f" count="12">{numbers}</float_array>
<technique_common><accessor source="#f" count="4" stride="3">{axes}</accessor></technique_common>
</source><vertices id="v"><input semantic="POSITION" source="#p"/></vertices>
{faces}</mesh></geometry></library_geometries>
<library_visual_scenes><visual_scene id="s">{node}</visual_scene></library_visual_scenes>
<scene><instance_visual_scene url="#s"/></scene></COLLADA>"""


def test_collada_nodes_are_placed_in_metres_and_keep_their_colours(tmp_path):
    painted = (
        "<instance_geometry url='#g'><bind_material><technique_common>"
        "<instance_material symbol='s' target='#m'/></technique_common></bind_material>"
        "</instance_geometry>"
    )
    nodes = (
        "<node><translate>0 0 7</translate><rotate>0 0 1 90</rotate><node><scale>2 2 2</scale>"
        f"{painted}</node></node>"
        f"<node><matrix>1 0 0 5 0 1 0 0 0 0 1 0 0 0 0 1</matrix>{BARE}</node>"
    )
    (tmp_path / "a.dae").write_text(collada(nodes, unit="0.01"))
    found = read_mesh(tmp_path / "a.dae")
    floor = FLOOR[0][FLOOR[1]]
    first = 2.0 * np.stack([-floor[..., 1], floor[..., 0], floor[..., 2] + 3.5], axis=-1)
    expected = np.concatenate([first, floor + np.array([5.0, 0.0, 0.0])])
    np.testing.assert_allclose(found.vertices[found.triangles], 0.01 * expected, atol=1e-7)
    assert found.colours[0].tolist() == [255, 0, 51, 255]
    assert found.colours[2].tolist() != [255, 0, 51, 255]


def faces_of(kind, text):
    return f"<{kind} count='2'><input semantic='VERTEX' source='#v' offset='0'/>{text}</{kind}>"


def test_polygons_of_collada_are_split_into_triangles(tmp_path):
    for kind, text in (
        ("polylist", "<vcount>4 3</vcount><p>0 1 2 3 0 1 2</p>"),
        ("polygons", "<p>0 1 2 3</p><p>3 2 1</p>"),
    ):
        (tmp_path / "a.dae").write_text(collada(faces=faces_of(kind, text)))
        assert len(read_mesh(tmp_path / "a.dae").triangles) == 3


def stl(points, count):
    record = np.zeros(len(points) // 3, dtype=[("n", "<f4", 3), ("c", "<f4", (3, 3)), ("a", "<u2")])
    record["c"] = np.reshape(points, (-1, 3, 3))
    return bytes(80) + np.uint32(count).tobytes() + record.tobytes()


DOUBLE = "<node id='n{0}'><instance_node url='#n{1}'/><instance_node url='#n{1}'/></node>"
NODES = "".join(DOUBLE.format(k, k + 1) for k in range(40)) + f"<node id='n40'>{BARE}</node>"
BAD = {
    "empty.stl": b"",
    "truncated.stl": stl(CLOUD, 20)[:-60],
    "point.stl": stl(np.ones((3, 3)), 1),
    "beyond the end.obj": b"v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 9\n",
    "truncated.dae": collada()[:700].encode(),
    "beyond the end.dae": collada().replace("0 1 2 0", "0 1 9 0").encode(),
    "no scene.dae": collada().partition("<scene>")[0].encode() + b"</COLLADA>",
    "bomb.dae": collada().replace("?>", "?><!DOCTYPE C [<!ENTITY a 'a'>]>", 1).encode(),
    "doubled.dae": collada("<node><instance_node url='#n0'/></node>")
    .replace("<library_vis", f"<library_nodes>{NODES}</library_nodes><library_vis", 1)
    .encode(),
}


@pytest.mark.parametrize("name", BAD)
def test_bad_files_are_rejected_in_a_sentence_that_names_them(tmp_path, name):
    (tmp_path / name).write_bytes(BAD[name])
    expected = "all its vertices are at one" if name == "point.stl" else f"{name}' can't be read: "
    with pytest.raises(WorldError, match=expected) as rejection:
        mp.Mesh.from_file(tmp_path / name)
    assert str(rejection.value).isprintable()


BALL = f'<sphere radius="{RADIUS}"/>'


def test_links_have_flat_meshes_and_bad_ones_are_named(tmp_path):
    saved(tmp_path / "floor.stl", *FLOOR)
    (tmp_path / "bad.dae").write_bytes(b"<COLLADA")

    def collision(file, scale="1 1 1"):
        mesh = f'<mesh filename="{file}" scale="{scale}"/>'
        return CollisionModel(mp.Robot(URDF.replace(BALL, mesh, 1)))

    # The slider is 1 m above it, the turner is carried by the slider.
    near = distances(collision(f"{tmp_path}/floor.stl", "0.1 0.1 -0.1"), [0.0, 0.0])
    expected = np.hypot(1.0 - 0.5 * THICKNESS, 0.4) - RADIUS
    assert near["base", "turner"] == pytest.approx(expected, abs=1e-6)
    for file, scale, message in (
        (f"{tmp_path}/floor.stl", "1 0 1", "link 'base': scale of a mesh must not be 0, got 1, 0"),
        (f"{tmp_path}/bad.dae", "1 1 1", r"link 'base': mesh .*bad\.dae' can't be read: "),
        ("file:///home/user/ws/base.stl", "1 1 1", "its path is of another machine; write one"),
    ):
        with pytest.raises(RobotError, match=message):
            collision(file, scale)


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
    robots = [
        # With three slashes in talos_full_v2.urdf of example-robot-data.
        mp.Robot(URDF.replace(BALL, f'<mesh filename="{start}somebody/meshes/floor.stl"/>', 1))
        for start in ("package://", "package:///")
    ]
    assert all(CollisionModel(x, package_dirs=folders).has_geometry for x in robots)
    (package / "meshes/floor.stl").unlink()
    for robot in robots:
        with pytest.raises(RobotError, match=f"the package is in '.*{package.name}', which lacks"):
            CollisionModel(robot, package_dirs=folders)
    shutil.rmtree(package)
    for robot in robots:
        with pytest.raises(RobotError, match=r"holds the package 'somebody' by --package-dirs"):
            CollisionModel(robot, package_dirs=folders)
