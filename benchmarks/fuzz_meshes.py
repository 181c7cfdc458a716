# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""Functions that put hostile and corrupted meshes into URDFs and planning scenes."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import yaml
from fuzz_files import Random, spoil_bytes, spoil_text
from mesh_inputs import FILES, SOUPS, binary_stl, dae, obj, text_stl


def spoil_mesh(path: Path, random: Random) -> None:
    """Name a hostile mesh, or a valid one that is corrupted, in a URDF."""
    if random.random() < 0.5:
        name = str(random.choice(list(FILES)))
        FILES[name](path.parent / name)
    else:
        write = (binary_stl, text_stl, obj, lambda *_: dae())[kind := int(random.integers(0, 4))]
        name = f"spoilt{('.stl', '.stl', '.obj', '.dae')[kind]}"
        (path.parent / name).write_bytes(write(*SOUPS[str(random.choice(["floor", "cloud"]))]))
        (spoil_bytes if kind == 0 else spoil_text)(path.parent / name, random)
    text = path.read_text().replace("tool.stl", f"file://{path.parent}/{name}")
    sizes = random.choice(["1 1 1", "0.01 0.01 0.01", "1 0 1", "-1 1 1", "1e6 1e6 1e6", "1e-9 1 1"])
    path.write_text(text.replace("0.01 0.01 0.01", str(sizes)))


def spoil_plate(path: Path, random: Random) -> None:
    """Replace the mesh of a scene by a hostile one."""
    scene = yaml.safe_load(path.read_text())
    vertices, triangles = SOUPS[str(random.choice(list(SOUPS)))]
    mesh = {"vertices": np.asarray(vertices).tolist(), "triangles": np.asarray(triangles).tolist()}
    scene["world"]["collision_objects"][1]["meshes"] = [mesh]
    path.write_text(yaml.safe_dump(scene))
