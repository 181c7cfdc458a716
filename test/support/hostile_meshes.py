# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""Meshes of many triangles, and mesh files that take a reader's time or memory."""

from __future__ import annotations

from pathlib import Path

import numpy as np


def soup(n: int) -> np.ndarray:
    """Triangles of a wavy surface, shape (n, 3, 3) [m]."""
    random = np.random.default_rng(1)
    corners = random.uniform(-0.5, 0.5, (n, 1, 3)) + random.uniform(-0.01, 0.01, (n, 3, 3))
    corners[..., 2] = 0.1 * np.sin(9.0 * corners[..., 0]) * np.cos(7.0 * corners[..., 1])
    return corners


def write_stl(file: Path, triangles: np.ndarray) -> None:
    """Write a binary STL file."""
    kind = [("normal", "<f4", 3), ("corners", "<f4", (3, 3)), ("attribute", "<u2")]
    facets = np.zeros(len(triangles), dtype=kind)
    facets["corners"] = triangles
    file.write_bytes(bytes(80) + len(triangles).to_bytes(4, "little") + facets.tobytes())


_ENTITIES = "".join(
    f'<!ENTITY e{k} "{f"&e{k - 1};" * 10 if k else "lol lol lol"}">' for k in range(10)
)
_CYCLE = (
    '<library_nodes><node id="a"><instance_node url="#b"/></node>'
    '<node id="b"><instance_node url="#a"/></node></library_nodes><library_visual_scenes>'
    '<visual_scene id="s"><node><instance_node url="#a"/></node></visual_scene>'
    '</library_visual_scenes><scene><instance_visual_scene url="#s"/></scene>'
)
_COLLADA = '<COLLADA xmlns="http://www.collada.org/2005/11/COLLADASchema" version="1.4.1">'
_DEEP = "<node>" * 20_000 + "</node>" * 20_000
_BOMBS = {
    "entities.dae": f"<!DOCTYPE x [{_ENTITIES}]>{_COLLADA}<asset>&e9;</asset></COLLADA>",
    "cycle.dae": f"{_COLLADA}{_CYCLE}</COLLADA>",
    "deep.dae": f"{_COLLADA}<library_nodes>{_DEEP}</library_nodes></COLLADA>",
    "indices.obj": "v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 999999999\n" * 1000,
}


def write_bombs(folder: Path) -> list[Path]:
    """Write mesh files that take a reader's time or memory."""
    for name, text in _BOMBS.items():
        (folder / name).write_text(text, encoding="utf-8")
    return [folder / name for name in _BOMBS]
