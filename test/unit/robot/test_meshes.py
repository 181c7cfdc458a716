# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""Mesh files, and distances from meshes with and without a volume."""

import os
import signal
import threading
import weakref
from pathlib import Path

import numpy as np
import pytest
from mesh_inputs import (
    FILES,
    FLOOR,
    GEOMETRY,
    INSTANCE,
    NODE,
    SOUPS,
    binary_stl,
    dae,
    obj,
    text_stl,
)
from test_body_pairs import RADIUS, URDF, distances, model

import mp_pca_planner as mp
from mp_pca_planner.exceptions import RobotError, WorldError
from mp_pca_planner.input_limits import InputLimits
from mp_pca_planner.motion.collision import CollisionModel
from mp_pca_planner.robot import mesh_files
from mp_pca_planner.robot.bodies import shared
from mp_pca_planner.robot.mesh_files import MeshProcess, read_mesh
from mp_pca_planner.robot.mesh_pieces import THICKNESS, pieces_of, whole_piece

USED = {
    *("UPPER.STL", "floor.stl", "text floor.stl", "solid.stl", "needle.stl", "flat.stl"),
    *("20,000 triangles.stl", "floor.obj", "cloud.obj", "needle.obj", "floor.dae", "no scene.dae"),
    *(f"material {name}.obj" for name in ("in a pipe", "of a device", "of itself")),
    *("calls itself.obj", "200,000 faces of 3.obj", "utf-7.dae", "texture of a pipe.dae"),
    *("26,000 instances.dae", "flat by scale.dae", "face of 200,000.obj"),
    *("polygon of 100,000.dae", "two corners.obj"),
}
CUBE = np.array([[x, y, z] for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)], dtype=float)


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
    assert found.notes == (
        "obstacle 'floor': a mesh has no volume: it is used as a surface 0.1 mm thick",
    )


def test_distance_beside_a_floor_is_that_of_its_edge():
    floor = mp.Obstacle("floor", mp.Mesh(0.2 * FLOOR[0], FLOOR[1], (0.0, 0.6, 0.7)))
    expected = np.hypot(0.4, 0.3 - 0.5 * THICKNESS) - RADIUS
    found = distances(model(floor), [0.0, 0.0])["slider", "floor"]
    assert found == pytest.approx(expected, abs=1e-6)


def test_distance_of_a_needle_is_that_of_its_line():
    needle = mp.Mesh(*SOUPS["needle"], (0.0, 0.3, 1.4))
    found = distances(model(mp.Obstacle("needle", needle)), [0.0, 0.0])["slider", "needle"]
    # Its thickness is that of a square.
    assert found == pytest.approx(0.5 - RADIUS, abs=THICKNESS)


def test_notch_of_a_flat_mesh_is_free():
    # The notch of the L, of corners (0.5, 0.5) and (1, 1), is above the slider.
    flat = mp.Mesh(*SOUPS["floor in an L"], (-0.75, -0.75, 1.0))
    found = model(mp.Obstacle("flat", flat))
    assert distances(found, [0.0, 0.0])["slider", "flat"] == pytest.approx(0.15, abs=1e-6)
    assert not found.collides(np.zeros(2))


@pytest.mark.parametrize("name", SOUPS)
def test_every_mesh_is_used_or_rejected_in_one_sentence(name):
    try:
        obstacle = mp.Obstacle("mesh", mp.Mesh(*SOUPS[name]))
    except WorldError as error:
        rejection = str(error)
    else:
        rejection = ""
    assert rejection.isprintable()
    if rejection:
        return
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
    piece = whole_piece(points, np.arange(60).reshape(-1, 3))
    a, b, c = np.moveaxis(piece.corners[piece.faces], 1, 0)
    normals = np.cross(b - a, c - a)
    normals /= np.linalg.norm(normals, axis=1)[:, None]
    heights = np.einsum("fi,nfi->nf", normals, points[:, None] - a[None])
    assert heights.max() < 1e-9
    assert piece.is_thin == (seed >= 3)


def test_large_meshes_are_cut_and_their_distances_stay():
    vertices, triangles = sphere(110)
    bowl = vertices[triangles].mean(axis=1)[:, 2] < 0.5
    pieces = pieces_of(vertices, triangles[bowl])
    assert len(pieces) > 1 and max(len(piece.triangles) for piece in pieces) <= 5_000
    assert sum(len(piece.triangles) for piece in pieces) == bowl.sum()
    mesh = mp.Mesh(vertices, triangles[bowl], (0.0, 0.0, 1.0))
    near = model(mp.Obstacle("bowl", mesh)).near(np.zeros((1, 2)), np.inf)
    # The slider is in the centre; a face is nearer than the corners.
    assert near.bounds.min() == pytest.approx(1.0 - RADIUS - 0.5, abs=0.2)
    (whole,) = pieces_of(*sphere(80))
    assert whole.is_convex


def test_large_meshes_of_links_are_cut_and_may_touch_other_links_at_the_start(tmp_path):
    vertices, triangles = sphere(110)
    bowl = triangles[vertices[triangles].mean(axis=1)[:, 2] < 0.5]
    (tmp_path / "bowl.stl").write_bytes(binary_stl(vertices, bowl))
    ball, at = f'<geometry><sphere radius="{RADIUS}"/>', '<origin xyz="0 0 1"/><geometry>'

    def robot_in_bowl(radius: float) -> CollisionModel:
        mesh = f'{at}<mesh filename="{tmp_path}/bowl.stl" scale="{radius} {radius} {radius}"/>'
        return CollisionModel(mp.Robot(URDF.replace(ball, mesh, 1)))

    found = robot_in_bowl(1.0)
    meshes = [one for one in found.body_pairs._bodies.shapes if hasattr(one, "num_tris")]
    assert len(meshes) > 1 and max(one.num_tris for one in meshes) <= 5_000
    assert sum(one.num_tris for one in meshes) == len(bowl)
    # The turner is at 0.5 m from the centre of the bowl.
    near = found.near(np.zeros((1, 2)), np.inf)
    of_turner = [k for k, pair in enumerate(found.pairs) if pair == ("base", "turner")]
    assert near.bounds[0, of_turner].min() == pytest.approx(0.5 - RADIUS, abs=1e-3)
    # A bowl that touches it in one place may always touch it.
    assert ("base", "turner") not in robot_in_bowl(0.5).pairs


# Files


def test_stl_obj_and_collada_of_a_mesh_are_the_same(tmp_path):
    vertices, triangles = sphere(12)
    contents = {
        "a.stl": binary_stl(vertices, triangles),
        "text.STL": text_stl(vertices, triangles),
        "a.obj": obj(vertices, triangles, head="# a ball\nmtllib none.mtl"),
        "a.dae": dae(
            geometry=GEOMETRY.replace(
                "\n-1 -1 0 1 -1 0 1 1 0 -1 1 0", " ".join(map(repr, vertices.ravel().tolist()))
            )
            .replace('"4"', f'"{len(vertices)}"')
            .replace("0 1 2 0 2 3", " ".join(map(str, triangles.ravel())))
        ),
    }
    for name, content in contents.items():
        (tmp_path / name).write_bytes(content)
        found = read_mesh(tmp_path / name)
        np.testing.assert_allclose(
            found.vertices[found.triangles], vertices[triangles], atol=1e-6, err_msg=name
        )


def test_obj_files_may_have_polygons_and_count_from_the_end(tmp_path):
    (tmp_path / "a.obj").write_text(
        "o x\nv 0 0 0\nv 1 0 0\nv 1 1 0\nv 0 1 0\nvn 0 0 1\n"
        "f 1//1 2//1 \\\n 3//1 4//1\nf -1/2 -2 -4\n"
    )
    found = read_mesh(tmp_path / "a.obj")
    np.testing.assert_array_equal(found.triangles, [[0, 1, 2], [0, 2, 3], [3, 2, 0]])


def test_collada_nodes_are_placed_in_metres_and_keep_their_colours(tmp_path):
    bound = INSTANCE.replace(
        "/>",
        "><bind_material><technique_common><instance_material symbol='s' target='#m'/>"
        "</technique_common></bind_material></instance_geometry>",
    )
    library = (
        "<library_effects><effect id='e'><profile_COMMON><technique><phong><diffuse>"
        "<color>1 0 0.2 1</color></diffuse></phong></technique></profile_COMMON></effect>"
        "</library_effects>"
        "<library_materials><material id='m'><instance_effect url='#e'/></material>"
        "</library_materials><library_nodes><node id='twice'><scale>2 2 2</scale>"
        f"{bound}</node></library_nodes>"
    )
    nodes = (
        "<node><translate>0 0 7</translate><rotate>0 0 1 90</rotate><instance_node url='#twice'/>"
        f"</node><node><matrix>1 0 0 5 0 1 0 0 0 0 1 0 0 0 0 1</matrix>{INSTANCE}</node>"
    )
    geometry = GEOMETRY.replace("<triangles ", "<triangles material='s' ")
    (tmp_path / "a.dae").write_bytes(dae(nodes, geometry, library, unit="0.01"))
    found = read_mesh(tmp_path / "a.dae")
    floor = FLOOR[0][FLOOR[1]]
    first = 2.0 * np.stack([-floor[..., 1], floor[..., 0], floor[..., 2] + 3.5], axis=-1)
    expected = np.concatenate([first, floor + np.array([5.0, 0.0, 0.0])])
    np.testing.assert_allclose(found.vertices[found.triangles], 0.01 * expected, atol=1e-12)
    assert found.colours[0].tolist() == [255, 0, 51, 255]
    assert found.colours[2].tolist() != [255, 0, 51, 255]


@pytest.mark.parametrize(
    ("kind", "text", "expected"),
    [
        ("polylist", "<vcount>4 3</vcount><p>0 1 2 3 0 1 2</p>", [[0, 1, 2], [0, 2, 3], [0, 1, 2]]),
        ("polygons", "<p>0 1 2 3</p><p>3 2 1</p>", [[0, 1, 2], [0, 2, 3], [3, 2, 1]]),
        ("tristrips", "<p>0 1 2 3</p>", [[0, 1, 2], [1, 2, 3]]),
        ("trifans", "<p>3 0 1 2</p>", [[3, 0, 1], [3, 1, 2]]),
        ("lines", "<p>0 1 2</p>", None),
    ],
)
def test_all_kinds_of_faces_of_collada_are_read(tmp_path, kind, text, expected):
    old = GEOMETRY[GEOMETRY.index("<triangles") : GEOMETRY.index("</mesh>")]
    new = f"<{kind} count='1'><input semantic='VERTEX' source='#v' offset='0'/>{text}</{kind}>"
    (tmp_path / "a.dae").write_bytes(dae(NODE, GEOMETRY.replace(old, new)))
    if expected is None:
        with pytest.raises(WorldError, match="it has no triangles"):
            read_mesh(tmp_path / "a.dae")
    else:
        np.testing.assert_array_equal(read_mesh(tmp_path / "a.dae").triangles, expected)


@pytest.mark.parametrize("name", FILES)
def test_hostile_files_are_used_or_rejected_in_one_sentence(tmp_path, name):
    FILES[name](tmp_path / name)
    if name in USED:
        mp.Mesh.from_file(tmp_path / name)
    else:
        with pytest.raises(WorldError) as rejection:
            mp.Mesh.from_file(tmp_path / name)
        assert str(rejection.value).isprintable()
        assert "has ended" not in str(rejection.value)


def test_links_have_flat_meshes_with_a_note_and_hostile_ones_are_named(tmp_path):
    FILES["floor.stl"](tmp_path / "floor.stl")
    ball = f'<sphere radius="{RADIUS}"/>'
    mesh = f'<mesh filename="{tmp_path}/{{}}" scale="{{}}"/>'
    urdf = URDF.replace(ball, mesh.format("floor.stl", "0.1 0.1 -0.1"), 1)
    found = CollisionModel(mp.Robot(urdf))
    assert found.notes == (
        "link 'base': a mesh has no volume: it is used as a surface 0.1 mm thick",
    )
    # The slider is 1 m above it, the turner is carried by the slider.
    near = distances(found, [0.0, 0.0])
    assert near["base", "turner"] == pytest.approx(
        np.hypot(1.0 - 0.5 * THICKNESS, 0.4) - RADIUS, abs=1e-6
    )
    with pytest.raises(RobotError, match="link 'base': scale of a mesh must not be 0, got 1, 0, 1"):
        CollisionModel(mp.Robot(URDF.replace(ball, mesh.format("floor.stl", "1 0 1"), 1)))
    FILES["cycle.dae"](tmp_path / "cycle.dae")
    with pytest.raises(
        RobotError, match=r"link 'base': mesh .*cycle\.dae' can't be read: its nodes"
    ):
        CollisionModel(mp.Robot(URDF.replace(ball, mesh.format("cycle.dae", "1 1 1"), 1)))


# The process


def test_robots_with_equal_meshes_share_what_is_built_of_them():
    piece, same, other = (whole_piece(*sphere(n)) for n in (20, 20, 21))
    assert shared(piece) is piece and shared(same) is piece and shared(other) is other
    # Nobody needs them any more, so that they take no memory.
    kept = weakref.ref(piece.surface)
    del piece
    assert kept() is None


def test_a_process_that_ends_is_replaced():
    process = MeshProcess()
    floor = binary_stl(*FLOOR)
    assert len(process.parse(floor, ".stl").triangles) == 2
    for _ in range(2):
        os.kill(process._process.pid, signal.SIGKILL)
        process._process.wait()
        assert len(process.parse(floor, ".stl").triangles) == 2
    process._process.kill()
    process._process.wait()


@pytest.mark.parametrize(
    ("changed", "error", "reason"),
    [
        ({"mesh_wall_seconds": 0.0}, TimeoutError, "was not parsed within 0 s"),
        ({"mesh_wall_seconds": 60.0}, ValueError, "is not an STL file"),
    ],
)
def test_a_process_that_takes_too_long_is_ended(monkeypatch, changed, error, reason):
    monkeypatch.setattr(mesh_files, "INPUT_LIMITS", InputLimits(**changed))
    process = MeshProcess()
    with pytest.raises(error, match=reason):
        process.parse(b"x" * (32 << 20), ".stl")
    process._process.kill()
    process._process.wait()


def test_memory_of_the_process_is_limited():
    content = dae(geometry=1_200_000 * "<a b=''/>")
    process = MeshProcess()
    with pytest.raises((RuntimeError, ValueError), match="memory"):
        process.parse(content, ".dae")
    assert len(process.parse(binary_stl(*FLOOR), ".stl").triangles) == 2
    process._process.kill()
    process._process.wait()


def test_threads_share_the_process(tmp_path):
    failures = []

    def read(number: int) -> None:
        vertices, triangles = sphere(10 + number)
        for k in range(3):
            path = Path(tmp_path, f"{number}{k}.obj")
            path.write_bytes(obj(vertices + k, triangles))
            if len(read_mesh(path).triangles) != len(triangles):
                failures.append(path)

    threads = [threading.Thread(target=read, args=(k,)) for k in range(6)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert not failures
