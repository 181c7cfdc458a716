# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""Mesh files as arrays: STL, Wavefront OBJ without materials, and COLLADA.

Other parsers accept dozens of formats, follow references to other files, and take minutes or
gigabytes for small files. These ones read bytes that are in memory, and nothing else.
"""

from __future__ import annotations

import re
import xml.etree.ElementTree as ET
from collections.abc import Callable, Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ..arrays import FloatArray
from ..input_limits import INPUT_LIMITS

_STL_HEADER = 84  # bytes: a comment, then the number of triangles
_STL_TRIANGLE = np.dtype([("normal", "<f4", 3), ("corners", "<f4", (3, 3)), ("colour", "<u2")])

# COLLADA: nodes within nodes and instances of nodes, and all nodes of a scene.
_MAX_DEPTH, _MAX_NODES = 50, 10_000
_PLAIN = (194, 201, 212, 255)
# Transforms with their counts of numbers, and elements with triangles.
_TRANSFORMS = {"matrix": 16, "translate": 3, "rotate": 4, "scale": 3}
_COUNTED = ("triangles", "polylist", "polygons", "tristrips", "trifans")

Indices = NDArray[np.int64]


@dataclass(frozen=True, eq=False)
class MeshContent:
    """The surface in a mesh file.

    Attributes
    ----------
    vertices : array, shape (n_vertices, 3)
        Coordinates: those of the file, in metres if it states a unit.
    triangles : array of int, shape (n_triangles, 3)
        Indices of the vertices of each triangle.
    colours : array of uint8, shape (n_triangles, 4), or None
        Red, green, blue and opacity of each triangle, if the file states any.
    """

    vertices: FloatArray
    triangles: NDArray[np.int32]
    colours: NDArray[np.uint8] | None = None


def parse_mesh(content: bytes, suffix: str) -> MeshContent:
    """Parse a mesh file.

    Parameters
    ----------
    content : bytes
        The file.
    suffix : str
        End of its name: ``.stl``, ``.obj`` or ``.dae``, as in `PARSERS`.

    Raises
    ------
    ValueError, LookupError, SyntaxError, …
        If the content is malformed, is of another format, or has no or too many triangles: call it
        within :func:`.files.reading`.
    """
    found = PARSERS[suffix](content)
    check_count(len(found.triangles))
    if not len(found.triangles):
        raise ValueError("it has no triangles")
    used = found.vertices[found.triangles.ravel()]
    if not np.isfinite(used).all():
        raise ValueError("it has coordinates that are not finite")
    if np.abs(used).max() > (most := INPUT_LIMITS.description_value):
        raise ValueError(f"it has coordinates above {most:g}")
    return found


def check_count(n_triangles: int) -> None:
    """Reject too many triangles, as soon as their number is known."""
    if n_triangles > (most := INPUT_LIMITS.mesh_triangles):
        raise ValueError(f"it has {n_triangles} triangles, at most {most} are accepted")


def fans(corners: NDArray[np.int64], counts: NDArray[np.int64]) -> NDArray[np.int64]:
    """The triangles of polygons, from their first corners to each of their edges.

    They cover a polygon that is not convex, and a little more.

    Parameters
    ----------
    corners : array of int, shape (n_corners,)
        The corners of all polygons, one after the other.
    counts : array of int, shape (n_polygons,)
        Number of corners of each; polygons of fewer than 3 have no triangles.

    Returns
    -------
    triangles : array of int, shape (n_triangles, 3)
        The corners of the triangles.
    """
    if np.any(counts < 0) or counts.sum() > len(corners):
        raise ValueError("its polygons have more corners than there are")
    n_triangles = np.maximum(counts - 2, 0)
    check_count(int(n_triangles.sum()))
    starts = np.repeat(np.cumsum(counts) - counts, n_triangles)
    # 0, 1, … within each polygon.
    steps = np.arange(len(starts)) - np.repeat(np.cumsum(n_triangles) - n_triangles, n_triangles)
    places = np.stack([starts, starts + steps + 1, starts + steps + 2], axis=1)
    return np.asarray(corners[places])


def _stl(content: bytes) -> MeshContent:
    """An STL file; binary ones may begin like one of text."""
    count = int.from_bytes(content[80:_STL_HEADER], "little")
    if len(content) == _STL_HEADER + count * _STL_TRIANGLE.itemsize and content[80:]:
        check_count(count)
        found = np.frombuffer(content, _STL_TRIANGLE, offset=_STL_HEADER)["corners"]
        return _soup(found.reshape(-1, 3).astype(np.float64))
    if not content[:80].lstrip().lower().startswith(b"solid") or b"\0" in content:
        raise ValueError(
            f"it is not an STL file: one of {count} triangles has "
            f"{_STL_HEADER + count * _STL_TRIANGLE.itemsize} bytes, this one has {len(content)}"
        )
    words = content.lower().split()
    at = [i for i, word in enumerate(words) if word == b"vertex"]
    if len(at) % 3 or words.count(b"facet") * 3 != len(at):
        raise ValueError(f"it has {len(at)} vertices of {words.count(b'facet')} triangles")
    check_count(len(at) // 3)
    numbers = [word for i in at for word in words[i + 1 : i + 4]]
    return _soup(np.array(numbers, dtype=np.float64).reshape(-1, 3))


def _soup(corners: FloatArray) -> MeshContent:
    """Triangles that don't share vertices."""
    return MeshContent(corners, np.arange(len(corners), dtype=np.int32).reshape(-1, 3))


def _obj(content: bytes) -> MeshContent:
    """The vertices and faces of an OBJ file; normals, textures and materials are skipped."""
    if b"\0" in content:
        raise ValueError("it is not an OBJ file, which is text")
    vertices: list[list[bytes]] = []
    corners: list[int] = []
    counts: list[int] = []
    n_triangles = 0
    for line in content.replace(b"\\\r\n", b" ").replace(b"\\\n", b" ").splitlines():
        word, *values = line.split() or [b""]
        if word == b"v":
            if len(values) < 3:
                raise ValueError(f"a vertex has {len(values)} coordinates, expected 3")
            vertices.append(values[:3])
        elif word == b"f":
            for value in values:
                # Negative numbers count from the last vertex before the face.
                index = int(value.split(b"/", 1)[0])
                corners.append(index - 1 if index > 0 else len(vertices) + index)
            counts.append(len(values))
            n_triangles += max(len(values) - 2, 0)
            check_count(n_triangles)
    if not counts:
        raise ValueError("it has no faces")
    points = np.array(vertices or np.zeros((0, 3)), dtype=np.float64)
    return indexed(points, fans(np.array(corners, dtype=np.int64), np.array(counts)))


def indexed(
    points: FloatArray, triangles: NDArray[np.int64], colours: NDArray[np.uint8] | None = None
) -> MeshContent:
    """A mesh of checked indices.

    Raises
    ------
    ValueError
        If a triangle has a vertex that does not exist.
    """
    wrong = triangles[(triangles < 0) | (triangles >= len(points))]
    if wrong.size:
        raise ValueError(f"a triangle has the vertex {wrong[0] + 1}, but there are {len(points)}")
    used, indices = np.unique(triangles, return_inverse=True)
    return MeshContent(points[used], indices.reshape(-1, 3).astype(np.int32), colours)


# COLLADA


def _collada(content: bytes) -> MeshContent:
    """The triangles of the scene of a COLLADA file (1.4 or 1.5) in metres, with plain colours.

    The upward axis of the file is not applied, as in RViz. Document types, and with them entities,
    are rejected. References stay inside the file; instances of nodes are followed to a limited
    depth and number.
    """
    text = content.decode("utf-8-sig")
    if re.search(r"<!(DOCTYPE|ENTITY)", text):
        raise ValueError("it has a document type, which is not accepted")
    root = ET.fromstring(text)
    for element in root.iter():
        element.tag = element.tag.rpartition("}")[2]
    if root.tag != "COLLADA":
        raise ValueError(f"it is not a COLLADA file: its root element is <{root.tag:.40}>")
    return _Document(root).content()


class _Document:
    def __init__(self, root: ET.Element) -> None:
        self._root = root
        self._by_id = {one.get("id", ""): one for one in root.iter() if one.get("id")}
        self._geometries: dict[str, list[tuple[FloatArray, Indices, str]]] = {}
        self._points: list[FloatArray] = []
        self._triangles: list[Indices] = []
        self._colours: list[NDArray[np.uint8]] = []
        self._n_points = self._n_triangles = self._n_nodes = 0
        self._has_colours = False

    def content(self) -> MeshContent:
        unit = self._root.find("asset/unit")
        metre = 1.0 if unit is None else float(unit.get("meter", "1"))
        if not 0.0 < metre <= INPUT_LIMITS.world_length:
            raise ValueError(f"its unit is {metre:g} m")
        scene = self._root.find("scene/instance_visual_scene")
        if scene is None:
            for geometry in self._root.findall("library_geometries/geometry"):
                self._add(geometry, np.eye(4), {})
        else:
            for node in self._referred(scene, "visual_scene").findall("node"):
                self._visit(node, np.eye(4), 1)
        if not self._triangles:
            raise ValueError("it has no triangles")
        colours = np.concatenate(self._colours) if self._has_colours else None
        points = metre * np.concatenate(self._points)
        return indexed(points, np.concatenate(self._triangles), colours)

    def _referred(self, element: ET.Element, tag: str, key: str = "url") -> ET.Element:
        """The element of a tag that another one refers to."""
        reference = element.get(key, "")
        found = self._by_id.get(reference[1:]) if reference.startswith("#") else None
        if found is None or found.tag != tag:
            raise ValueError(f"there is no <{tag}> '{reference:.80}' in it")
        return found

    def _visit(self, node: ET.Element, above: FloatArray, depth: int) -> None:
        """Add the geometries of a node, of the nodes in it and of its instances."""
        self._n_nodes += 1
        if depth > _MAX_DEPTH or self._n_nodes > _MAX_NODES:
            raise ValueError(
                f"its nodes are more than {_MAX_NODES}, or within more than {_MAX_DEPTH} others"
            )
        place = above
        for step in node:
            if step.tag in _TRANSFORMS:
                place = place @ _transform(step)
            elif step.tag in ("lookat", "skew") and node.find(".//instance_geometry") is not None:
                raise ValueError(f"a node of shapes has a <{step.tag}>, which is not supported")
        for part in node:
            if part.tag == "node":
                self._visit(part, place, depth + 1)
            elif part.tag == "instance_node":
                self._visit(self._referred(part, "node"), place, depth + 1)
            elif part.tag == "instance_geometry":
                self._add(self._referred(part, "geometry"), place, self._materials(part))
            elif part.tag == "instance_controller":
                raise ValueError("it has a <controller>; export it with its deformations applied")

    def _add(
        self, geometry: ET.Element, place: FloatArray, materials: dict[str, ET.Element]
    ) -> None:
        """Add the triangles of a geometry in a place."""
        key = geometry.get("id", "")
        parts = self._geometries.get(key)
        if parts is None or not key:
            parts = self._geometries[key] = list(self._parts(geometry))
        for points, triangles, symbol in parts:
            self._n_triangles += len(triangles)
            check_count(self._n_triangles)
            self._points.append(points @ place[:3, :3].T + place[:3, 3])
            self._triangles.append(triangles + self._n_points)
            self._n_points += len(points)
            colour = self._colour(materials.get(symbol))
            self._has_colours |= colour is not None
            plain = np.array(_PLAIN if colour is None else colour, dtype=np.uint8)
            self._colours.append(np.tile(plain, (len(triangles), 1)))

    def _parts(self, geometry: ET.Element) -> Iterator[tuple[FloatArray, Indices, str]]:
        """Points, triangles and symbol of the material of each part of a geometry."""
        for mesh in geometry.findall("mesh"):
            for part in mesh:
                if part.tag not in _COUNTED:
                    continue
                inputs = part.findall("input")
                vertex = next((one for one in inputs if one.get("semantic") == "VERTEX"), None)
                if vertex is None:
                    raise ValueError(f"<{part.tag}> lacks an input of vertices")
                offsets = [int(one.get("offset", "0")) for one in inputs]
                offset, stride = int(vertex.get("offset", "0")), max(offsets) + 1
                if not 0 <= offset < stride <= 100:
                    raise ValueError(f"the offsets of the inputs of <{part.tag}> are wrong")
                corners = [
                    _whole(p)[offset::stride] for p in (*part.findall("p"), *part.findall("ph/p"))
                ]
                if not corners:
                    continue
                triangles = _triangles(part, corners)
                if triangles.size:
                    found = indexed(self._positions(vertex), triangles)
                    yield found.vertices, found.triangles.astype(np.int64), part.get("material", "")

    def _positions(self, vertex: ET.Element) -> FloatArray:
        """The coordinates of the vertices of an input."""
        for one in self._referred(vertex, "vertices", "source").findall("input"):
            if one.get("semantic") == "POSITION":
                source = self._referred(one, "source", "source")
                accessor = source.find("technique_common/accessor")
                if accessor is None:
                    raise ValueError("a <source> lacks its <accessor>")
                array = self._referred(accessor, "float_array", "source")
                values = np.array((array.text or "").split(), dtype=np.float64)
                stride, count, start = (
                    int(accessor.get(key, usual))
                    for key, usual in (("stride", "3"), ("count", "0"), ("offset", "0"))
                )
                if not (3 <= stride <= 100 and start >= 0 and 0 <= count <= len(values)):
                    raise ValueError("an <accessor> has wrong numbers")
                found = values[start : start + count * stride]
                if len(found) < (count - 1) * stride + 3:
                    raise ValueError(f"an <accessor> needs {count * stride} numbers of an array")
                padded = np.zeros(count * stride)
                padded[: len(found)] = found
                return padded.reshape(-1, stride)[:, :3]
        raise ValueError("<vertices> lack their positions")

    def _materials(self, instance: ET.Element) -> dict[str, ET.Element]:
        return {
            one.get("symbol", ""): one
            for one in instance.findall("bind_material/technique_common/instance_material")
        }

    def _colour(self, instance: ET.Element | None) -> tuple[int, ...] | None:
        """The diffuse colour of a material; None if it has none, such as one with a texture."""
        if instance is None:
            return None
        try:
            effect = self._referred(instance, "material", "target").find("instance_effect")
            found = None if effect is None else self._referred(effect, "effect")
        except ValueError:
            return None  # a colour is no reason to reject a shape
        colour = None if found is None else found.find(".//diffuse/color")
        values = [] if colour is None else [float(word) for word in (colour.text or "").split()]
        if len(values) not in (3, 4) or not np.isfinite(values).all():
            return None
        return tuple(np.rint(255.0 * np.clip([*values, 1.0][:4], 0.0, 1.0)).astype(int).tolist())


def _whole(element: ET.Element) -> Indices:
    return np.array((element.text or "").split(), dtype=np.int64)


def _triangles(part: ET.Element, corners: list[Indices]) -> Indices:
    """The triangles of an element, whose <p> have some corners."""
    every = np.concatenate(corners)
    sizes = np.array([len(one) for one in corners], dtype=np.int64)
    if part.tag == "triangles":
        if len(every) % 3:
            raise ValueError(f"<triangles> have {len(every)} corners")
        check_count(len(every) // 3)
        return every.reshape(-1, 3)
    if part.tag == "polylist":
        counts = part.find("vcount")
        return fans(every, np.zeros(0, dtype=np.int64) if counts is None else _whole(counts))
    if part.tag == "tristrips":
        check_count(int(np.maximum(sizes - 2, 0).sum()))
        strips = [np.stack([p[:-2], p[1:-1], p[2:]], axis=1) for p in corners if len(p) > 2]
        return np.concatenate([*strips, np.zeros((0, 3), dtype=np.int64)])
    return fans(every, sizes)  # polygons, whose holes are filled, and trifans


def _transform(step: ET.Element) -> FloatArray:
    """The matrix of an element of a node, shape (4, 4)."""
    count = _TRANSFORMS[step.tag]
    values = np.array((step.text or "").split(), dtype=np.float64)
    if len(values) != count or not np.isfinite(values).all():
        raise ValueError(f"a <{step.tag}> has {len(values)} numbers, expected {count} finite ones")
    matrix = np.eye(4)
    if step.tag == "matrix":
        return values.reshape(4, 4)
    if step.tag == "translate":
        matrix[:3, 3] = values
    elif step.tag == "scale":
        matrix[:3, :3] = np.diag(values)
    elif np.any(values[:3]):
        x, y, z = axis = values[:3] / np.linalg.norm(values[:3])
        angle = np.radians(values[3])
        across = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
        along = np.outer(axis, axis)
        matrix[:3, :3] = along + np.cos(angle) * (np.eye(3) - along) + np.sin(angle) * across
    return matrix


PARSERS: dict[str, Callable[[bytes], MeshContent]] = {
    ".stl": _stl,
    ".obj": _obj,
    ".dae": _collada,
}
"""The parser of each accepted suffix."""
