# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""Hostile meshes: files that a URDF or a marker may name, and triangles of messages and scenes.

All of them are made by code. `FILES` has the functions that write a file, by its name; `SOUPS` the
vertices and triangles of meshes without a file.
"""

from __future__ import annotations

import io
import json
import os
import socket
import struct
import zipfile
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

Soup = tuple[Any, Any]
FLOOR: Soup = (
    np.array([[-1.0, -1.0, 0.0], [1.0, -1.0, 0.0], [1.0, 1.0, 0.0], [-1.0, 1.0, 0.0]]),
    np.array([[0, 1, 2], [0, 2, 3]]),
)
_RANDOM = np.random.default_rng(28)
_CLOUD = _RANDOM.uniform(-0.5, 0.5, (60, 3))
_TRIPLES = np.arange(60).reshape(-1, 3)
_BALL = _CLOUD / np.linalg.norm(_CLOUD, axis=1)[:, None]


def _soups() -> dict[str, Soup]:
    x, y = np.eye(3)[:2]
    found: dict[str, Soup] = {
        "floor": FLOOR,
        "floor, tilted": (FLOOR[0] @ np.linalg.qr(_CLOUD[:3])[0], FLOOR[1]),
        "floor, two sides": (FLOOR[0], np.vstack([FLOOR[1], FLOOR[1][:, ::-1]])),
        "floor of 2 km": (1e3 * FLOOR[0], FLOOR[1]),
        "floor of 2 mm": (1e-3 * FLOOR[0], FLOOR[1]),
        "floor of 2 um": (1e-6 * FLOOR[0], FLOOR[1]),
        "floor in an L": (
            np.array([[0, 0, 0], [2, 0, 0], [2, 1, 0], [1, 1, 0], [1, 2, 0], [0, 2, 0]]) * 0.5,
            np.array([[0, 1, 2], [0, 2, 3], [0, 3, 5], [3, 4, 5]]),
        ),
        "one triangle": (np.eye(3), [[0, 1, 2]]),
        "a sliver": (np.array([x, -x, 1e-9 * y]), [[0, 1, 2]]),
        "needle": (np.outer(np.linspace(-1, 1, 60), x), _TRIPLES),
        "needle, tilted": (np.outer(np.linspace(-1, 1, 60), [0.3, 0.5, 0.7]), _TRIPLES),
        "point": (np.ones((60, 3)), _TRIPLES),
        "point, nearly": (1.0 + 1e-9 * _CLOUD, _TRIPLES),
        "subnormal": (5e-324 * np.sign(_CLOUD), _TRIPLES),
        "one corner three times": (np.eye(3), [[0, 0, 0], [1, 1, 1]]),
        "one triangle 5,000 times": (_CLOUD, np.tile([[0, 1, 2]], (5000, 1))),
        "unused far vertices": (np.vstack([np.eye(3), 900 * _CLOUD]), [[0, 1, 2]]),
        "cloud": (_CLOUD, _TRIPLES),
        "cloud on a ball": (_BALL, _TRIPLES),
        "cube grid": (np.round(_CLOUD * 4) / 4, _TRIPLES),
        "far away": (999.0 + 1e-3 * _CLOUD, _TRIPLES),
        "not finite": (np.where(_CLOUD > 0.4, np.nan, _CLOUD), _TRIPLES),
        "infinite": (np.where(_CLOUD > 0.4, np.inf, _CLOUD), _TRIPLES),
        "too far": (1e4 * _CLOUD, _TRIPLES),
        "huge": (1e308 * np.sign(_CLOUD), _TRIPLES),
        "no triangles": (_CLOUD, np.zeros((0, 3), dtype=int)),
        "nothing": (np.zeros((0, 3)), np.zeros((0, 3), dtype=int)),
        "index beyond the end": (_CLOUD, [[0, 1, 60]]),
        "huge index": (_CLOUD, [[0, 1, 2**31]]),
        "huger index": (_CLOUD, [[0, 1, 2**62]]),
        "negative index": (_CLOUD, [[0, 1, -1]]),
    }
    for exponent in (3, 5, 6, 7, 8, 10, 12, 15):
        thin = _CLOUD * [1.0, 1.0, 10.0**-exponent]
        found[f"flat to 1e-{exponent}"] = thin, _TRIPLES
        found[f"thin to 1e-{exponent}"] = _CLOUD * [1.0, *[10.0**-exponent] * 2], _TRIPLES
        found[f"tilted, flat to 1e-{exponent}"] = thin @ np.linalg.qr(_CLOUD[3:6])[0], _TRIPLES
    return found


SOUPS: dict[str, Soup] = _soups()
"""Vertices and triangles of meshes."""


def binary_stl(vertices: Any, triangles: Any, count: int | None = None, more: bytes = b"") -> bytes:
    """An STL file of bytes, with another number of triangles than it has if asked."""
    record = np.zeros(len(triangles), dtype=[("n", "<f4", 3), ("c", "<f4", (3, 3)), ("a", "<u2")])
    with np.errstate(over="ignore"):
        record["c"] = np.asarray(vertices)[np.asarray(triangles, dtype=int)]
    n = len(triangles) if count is None else count
    return bytes(80) + struct.pack("<I", n) + record.tobytes() + more


def text_stl(vertices: Any, triangles: Any) -> bytes:
    """An STL file of text."""
    lines = ["solid x"]
    for triangle in np.asarray(vertices)[np.asarray(triangles, dtype=int)]:
        corners = "".join("vertex {} {} {}\n".format(*corner) for corner in triangle)
        lines.append(f"facet normal 0 0 1\nouter loop\n{corners}endloop\nendfacet")
    return "\n".join([*lines, "endsolid x", ""]).encode()


def obj(vertices: Any, triangles: Any, head: str = "") -> bytes:
    """An OBJ file."""
    lines = [head, *("v {} {} {}".format(*one) for one in vertices)]
    lines += ["f {} {} {}".format(*one) for one in np.asarray(triangles) + 1]
    return "\n".join([*lines, ""]).encode()


GEOMETRY = """<geometry id="g"><mesh><source id="p"><float_array id="a" count="12">
-1 -1 0 1 -1 0 1 1 0 -1 1 0</float_array><technique_common><accessor source="#a" count="4"
stride="3"/></technique_common></source><vertices id="v"><input semantic="POSITION" source="#p"/>
</vertices><triangles count="2"><input semantic="VERTEX" source="#v" offset="0"/>
<p>0 1 2 0 2 3</p></triangles></mesh></geometry>"""
INSTANCE = '<instance_geometry url="#g"/>'
NODE = f'<node id="n">{INSTANCE}</node>'


def dae(
    nodes: str = NODE, geometry: str = GEOMETRY, library: str = "", head: str = "", unit: str = "1"
) -> bytes:
    """A COLLADA file; of a floor unless its parts are replaced."""
    return (
        f'<?xml version="1.0"?>{head}<COLLADA xmlns="http://www.collada.org/2005/11/COLLADASchema" '
        f'version="1.4.1"><asset><unit meter="{unit}"/></asset><library_geometries>{geometry}'
        f"</library_geometries>{library}<library_visual_scenes><visual_scene "
        f'id="s">{nodes}</visual_scene></library_visual_scenes><scene><instance_visual_scene '
        'url="#s"/></scene></COLLADA>'
    ).encode()


def _geometry(old: str, new: str) -> bytes:
    assert old in GEOMETRY
    return dae(geometry=GEOMETRY.replace(old, new))


def _bomb(levels: int, width: int) -> str:
    """A document type whose entities expand to each other."""
    entities = '<!ENTITY e0 "0 0 0 ">' + "".join(
        f'<!ENTITY e{k} "{f"&e{k - 1};" * width}">' for k in range(1, levels)
    )
    return f"<!DOCTYPE COLLADA [{entities}]>"


def _collada_files() -> dict[str, bytes]:
    instance = '<instance_node url="#{}"/>'
    double = "".join(
        f'<node id="n{k}">' + 2 * instance.format(f"n{k + 1}") + "</node>" for k in range(40)
    )
    polygon = "<polylist count='1'><input semantic='VERTEX' source='#v' offset='0'/>"
    triangles = GEOMETRY[GEOMETRY.index("<triangles") : GEOMETRY.index("</mesh>")]
    many = " ".join(["0 1 2 3"] * 25_000)
    controller = '<node><instance_controller url="#c"/></node>'
    return {
        "floor.dae": dae(),
        "no scene.dae": dae().split(b"<library_visual")[0] + b"</COLLADA>",
        "cycle.dae": dae('<node id="n">' + instance.format("n") + "</node>"),
        "cycle of two.dae": dae(
            f'<node id="a1">{instance.format("b1")}</node><node id="b1">{instance.format("a1")}'
            "</node>"
        ),
        "doubled 40 times.dae": dae(double + NODE.replace('"n"', '"n40"')),
        "26,000 instances.dae": dae(f"<node>{26_000 * INSTANCE}</node>"),
        "20,000 nodes.dae": dae("<node/>" * 20_000),
        "deep nodes.dae": dae("<node>" * 1000 + NODE + "</node>" * 1000),
        "deeper nodes.dae": dae("<node>" * 60_000 + "</node>" * 60_000),
        "deep elements.dae": dae(geometry="<a>" * 120_000 + "</a>" * 120_000),
        "open elements.dae": b"<COLLADA>" + b"<a>" * 300_000,
        "many attributes.dae": dae(
            geometry="<a " + " ".join(f'a{k}="1"' for k in range(60_000)) + "/>"
        ),
        "entity bomb.dae": dae(head=_bomb(12, 10)).replace(b"0 1 2 0 2 3", b"&e11;"),
        "wide bomb.dae": dae(head=f'<!DOCTYPE C [<!ENTITY a "{"0 " * 50_000}">]>').replace(
            b"0 1 2 0 2 3", b"&a;" * 50_000
        ),
        "file entity.dae": dae(
            head='<!DOCTYPE C [<!ENTITY x SYSTEM "file:///etc/passwd">]>'
        ).replace(b"0 1 2", b"&x;"),
        "device entity.dae": dae(head='<!DOCTYPE C SYSTEM "file:///dev/zero">'),
        "parameter entity.dae": dae(head="<!DOCTYPE C [<!ENTITY % p '%p;'> %p;]>"),
        "bomb in utf-16.dae": dae(head=_bomb(12, 10)).decode().encode("utf-16"),
        "utf-7.dae": b'<?xml version="1.0" encoding="utf-7"?>' + dae()[21:],
        "not text.dae": bytes(range(256)) * 16,
        "empty.dae": b"",
        "another root.dae": b"<robot/>",
        "irrlicht.dae": b"<?xml version='1.0'?><irr_scene>" + b"<node type='mesh'>" * 20,
        "x3d.dae": b"<X3D><Scene>" + b"<Group DEF='a'><Group USE='a'/>" * 40,
        "no geometry.dae": dae(geometry=""),
        "empty geometry.dae": dae(geometry='<geometry id="g"/>'),
        "unknown scene.dae": dae().replace(b'url="#s"', b'url="#x"'),
        "geometry of a file.dae": dae('<node><instance_geometry url="file:///dev/zero#g"/></node>'),
        "controller.dae": dae(controller),
        "looks at.dae": dae(f"<node><lookat>1 2 3 4 5 6 7 8 9</lookat>{NODE}</node>"),
        "missing source.dae": _geometry('source="#a"', 'source="#x"'),
        "vertices of themselves.dae": _geometry('"POSITION" source="#p"', '"POSITION" source="#v"'),
        "accessor of 1e18.dae": _geometry('count="4"', 'count="1000000000000000000"'),
        "accessor of 1e5000.dae": _geometry('count="4"', f'count="{"9" * 5000}"'),
        "negative accessor.dae": _geometry('count="4"', 'count="-4"'),
        "stride of 0.dae": _geometry('stride="3"', 'stride="0"'),
        "negative stride.dae": _geometry('stride="3"', 'stride="-3"'),
        "huge stride.dae": _geometry('stride="3"', 'stride="1000000000"'),
        "not finite.dae": _geometry("-1 -1 0", "nan inf -inf"),
        "huge numbers.dae": _geometry("-1 -1 0", "1e308 -1e308 1e999"),
        "words for numbers.dae": _geometry("-1 -1 0", "one two three"),
        "index beyond the end.dae": _geometry("0 1 2 0", "0 1 4 0"),
        "huge index.dae": _geometry("0 1 2 0", "0 1 4294967295 0"),
        "huger index.dae": _geometry("0 1 2 0", f"0 1 {'9' * 30} 0"),
        "hugest index.dae": _geometry("0 1 2 0", f"0 1 {'9' * 9000} 0"),
        "negative index.dae": _geometry("0 1 2 0", "0 1 -1 0"),
        "fraction as index.dae": _geometry("0 1 2 0", "0 1 0.5 0"),
        "four corners.dae": _geometry("0 1 2 0 2 3", "0 1 2 0"),
        "huge offset.dae": _geometry('offset="0"', 'offset="1000000000"'),
        "negative offset.dae": _geometry('offset="0"', 'offset="-1"'),
        "polygon of 100,000.dae": _geometry(
            triangles, f"{polygon}<vcount>100000</vcount><p>{many}</p></polylist>"
        ),
        "polygon of 1e18.dae": _geometry(
            triangles, f"{polygon}<vcount>1{'0' * 18}</vcount><p>0 1 2</p></polylist>"
        ),
        "negative polygon.dae": _geometry(
            triangles, f"{polygon}<vcount>5 -2</vcount><p>0 1 2 3</p></polylist>"
        ),
        "polygons of 9e18.dae": _geometry(
            triangles, f"{polygon}<vcount>{'9223372036854775807 ' * 2}</vcount><p>0</p></polylist>"
        ),
        "unit of 0.dae": dae(unit="0"),
        "unit that is no number.dae": dae(unit="nan"),
        "huge unit.dae": dae(unit="1e300"),
        "tiny unit.dae": dae(unit="1e-300"),
        "scale of 0.dae": dae(f"<node><scale>0 0 0</scale>{NODE}</node>"),
        "flat by scale.dae": dae(f"<node><scale>1 0 1</scale>{NODE}</node>"),
        "matrix of nan.dae": dae(f"<node><matrix>{'nan ' * 16}</matrix>{NODE}</node>"),
        "matrix of 1e300.dae": dae(f"<node><matrix>{'1e300 ' * 16}</matrix>{NODE}</node>" * 3),
        "short matrix.dae": dae(f"<node><matrix>1 0 0</matrix>{NODE}</node>"),
        "texture of a pipe.dae": dae(
            library='<library_images><image id="i"><init_from>floor.stl.fifo</init_from></image>'
            "</library_images>"
        ),
    }


def _other_files() -> dict[str, bytes]:
    floor, cloud = FLOOR, (_CLOUD, _TRIPLES)
    gltf = json.dumps(
        {
            "asset": {"version": "2.0"},
            "buffers": [{"byteLength": 2**40, "uri": "data:application/octet-stream;base64,AAAA"}],
            "bufferViews": [{"buffer": 0, "byteLength": 2**40}],
            "accessors": [{"count": 2**31 - 1, "componentType": 5126, "type": "VEC3"}],
            "meshes": [{"primitives": [{"attributes": {"POSITION": 0}}]}],
            "nodes": [{"children": [0], "mesh": 0}],
            "scenes": [{"nodes": [0]}],
        }
    ).encode()
    deep_gltf = b'{"asset":' + b"[" * 100_000 + b"]" * 100_000 + b"}"
    glb = b"glTF" + struct.pack("<III", 2, 2**31 - 1, 2**31 - 1) + b"JSON{}"
    ac = b"AC3Db\nOBJECT world\nkids 1\nOBJECT poly\nnumvert 2000000000\n"
    ply = b"ply\nformat ascii 1.0\nelement vertex 2000000000\nproperty float x\nend_header\n"
    irr = b'<?xml version="1.0"?><irr_scene><node type="animatedMesh"><node type="mesh">'
    packed = io.BytesIO()
    with zipfile.ZipFile(packed, "w", zipfile.ZIP_DEFLATED) as archive:
        archive.writestr("a.dae", bytes(50_000_000))
    facet = b"facet normal 0 0 1\nouter loop\n"
    return {
        "floor.stl": binary_stl(*floor),
        "text floor.stl": text_stl(*floor),
        "UPPER.STL": text_stl(*cloud).upper(),
        "solid.stl": b"solid" + binary_stl(*cloud)[5:],
        "empty.stl": b"",
        "header.stl": bytes(84),
        "short header.stl": bytes(83),
        "no triangles.stl": b"solid x\nendsolid x\n",
        "count of 4e9.stl": binary_stl(*floor, count=2**32 - 1),
        "count of 86 million.stl": binary_stl(*floor, count=85_899_346),
        "count too large.stl": binary_stl(*floor, count=3),
        "count too small.stl": binary_stl(*floor, count=1),
        "trailing bytes.stl": binary_stl(*floor, more=b"xx"),
        "not finite.stl": binary_stl(np.full((3, 3), np.nan), [[0, 1, 2]]),
        "huge.stl": binary_stl(1e38 * _CLOUD, _TRIPLES),
        "point.stl": binary_stl(np.ones((3, 3)), [[0, 1, 2]] * 100),
        "needle.stl": binary_stl(*SOUPS["needle, tilted"]),
        "flat.stl": binary_stl(*SOUPS["tilted, flat to 1e-8"]),
        "subnormal.stl": binary_stl(1e-45 * _CLOUD, _TRIPLES),
        "noise.stl": _RANDOM.bytes(84 + 50 * 2000),
        "noise in floats.stl": bytes(80) + struct.pack("<I", 2000) + _RANDOM.bytes(50 * 2000),
        "text with NUL.stl": text_stl(*floor).replace(b"vertex", b"vert\0ex"),
        "text of words.stl": text_stl(*floor).replace(b"1.0", b"one"),
        "text of nan.stl": text_stl(*floor).replace(b"1.0", b"nan"),
        "text cut off.stl": text_stl(*floor)[:-60],
        "two corners.stl": b"solid x\n" + facet + b"vertex 0 0 0\nvertex 1 0 0\n",
        "only vertices.stl": b"solid " + b"vertex " * 140_000,
        "only facets.stl": b"solid " + facet * 30_000,
        "20,000 triangles.stl": binary_stl(_RANDOM.normal(size=(300, 3)), _many(300, 19_900)),
        "floor.obj": obj(*floor),
        "cloud.obj": obj(*cloud),
        "needle.obj": obj(*SOUPS["needle"]),
        "empty.obj": b"",
        "only vertices.obj": obj(_CLOUD, np.zeros((0, 3), dtype=int)),
        "only faces.obj": obj([], _TRIPLES),
        "vertex 0.obj": obj(_CLOUD, _TRIPLES - 1),
        "vertex beyond the end.obj": obj(_CLOUD, _TRIPLES + 1),
        "huge vertex.obj": obj(_CLOUD, _TRIPLES) + b"f 1 2 4294967296\n",
        "huger vertex.obj": obj(_CLOUD, _TRIPLES) + b"f 1 2 " + b"9" * 40 + b"\n",
        "hugest vertex.obj": obj(_CLOUD, _TRIPLES) + b"f 1 2 " + b"9" * 500_000 + b"\n",
        "negative vertex.obj": obj(_CLOUD, _TRIPLES) + b"f -1 -2 -61\n",
        "fraction as vertex.obj": obj(_CLOUD, _TRIPLES) + b"f 1 2 0.5\n",
        "not finite.obj": obj(SOUPS["not finite"][0], _TRIPLES),
        "huge.obj": obj(SOUPS["huge"][0], _TRIPLES),
        "two coordinates.obj": b"v 1 2\nf 1 1 1\n",
        "words.obj": b"v a b c\nf 1 1 1\n",
        "two corners.obj": obj(*floor).replace(b"f 1 2 3", b"f 1 2"),
        "face of 200,000.obj": obj(*floor) + b"f" + b" 1 2 3 4" * 50_000 + b"\n",
        "200,000 faces of 3.obj": b"v 0 0 0\nv 1 0 0\nv 0 1 0\n" + b"f 1 2 3\n" * 110_000,
        "continued lines.obj": obj(*floor) + b"f 1 2 \\\n" * 100_000,
        "one long line.obj": b"v " + b"1 " * 450_000 + b"\nf 1 1 1\n",
        "utf-16.obj": obj(*floor).decode().encode("utf-16"),
        "material in a pipe.obj": obj(*floor, head="mtllib pipe.mtl\nusemtl a"),
        "material of a device.obj": obj(*floor, head="mtllib /dev/zero\nusemtl a"),
        "material of itself.obj": obj(*floor, head="mtllib material of itself.obj\nusemtl a"),
        "calls itself.obj": obj(*floor, head="call calls itself.obj"),
        "noise.obj": _RANDOM.bytes(100_000),
        "gltf.stl": gltf,
        "gltf.obj": gltf,
        "gltf.dae": gltf,
        "bomb.gltf": gltf,
        "deep.gltf": deep_gltf,
        "deep gltf.obj": deep_gltf,
        "glb.stl": glb,
        "small.glb": glb,
        "ac.obj": ac,
        "small.ac": ac,
        "ply.stl": ply,
        "small.ply": ply,
        "irr.dae": irr,
        "small.irr": irr,
        "zip.dae": packed.getvalue(),
        "zip.zae": packed.getvalue(),
        "program.stl": b"\x7fELF" + bytes(200),
        "no suffix": binary_stl(*floor),
    }


def _many(n_vertices: int, n_triangles: int) -> Any:
    return _RANDOM.integers(0, n_vertices, (n_triangles, 3))


def _pipe(path: Path) -> None:
    os.mkfifo(path)


def _socket(path: Path) -> None:
    here = os.getcwd()
    os.chdir(path.parent)  # names of sockets are short
    with socket.socket(socket.AF_UNIX) as made:
        made.bind(path.name)
    os.chdir(here)


def _sparse(path: Path) -> None:
    with path.open("wb") as file:
        file.truncate(1 << 34)


def _content(content: bytes, path: Path) -> None:
    path.write_bytes(content)
    if b"pipe.mtl" in content and not (path.parent / "pipe.mtl").exists():
        os.mkfifo(path.parent / "pipe.mtl")


def _link(target: str, path: Path) -> None:
    path.symlink_to(target)


FILES: dict[str, Callable[[Path], None]] = {
    **{name: partial(_content, content) for name, content in _other_files().items()},
    **{name: partial(_content, content) for name, content in _collada_files().items()},
    **{f"pipe.{suffix}": _pipe for suffix in ("stl", "obj", "dae")},
    "socket.stl": _socket,
    "folder.stl": Path.mkdir,
    "sparse.stl": _sparse,
    "zeros.stl": partial(_link, "/dev/zero"),
    "noise device.obj": partial(_link, "/dev/urandom"),
    "terminal.dae": partial(_link, "/dev/tty"),
    "own input.stl": partial(_link, "/dev/stdin"),
    "own memory.obj": partial(_link, "/proc/self/mem"),
    "nowhere.stl": partial(_link, "nothing there"),
    "loop.stl": partial(_link, "loop.stl"),
}
"""The function that writes each file."""
