# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""Keeping a published motion as a primitive."""

from __future__ import annotations

import re
from collections.abc import Mapping
from itertools import count
from pathlib import Path
from typing import Any

from ..exceptions import GoalError
from ..learning.refined_motion import RefinedMotion, primitive_around
from ..planning.plan import Plan
from ..primitives.file import save_primitive
from ..primitives.library import PrimitiveLibrary


def keep_motion(
    plan: Plan, library: PrimitiveLibrary, folder: Path, provenance: Mapping[str, Any]
) -> Path:
    """Write a primitive of the motions around a published one to a new file.

    Parameters
    ----------
    plan : Plan
        The motion.
    library : PrimitiveLibrary
        Has its primitive.
    folder : Path
        Folder of the file, which is named after the primitive with the first free number.
    provenance : mapping
        Origin of the motion, of JSON types.

    Raises
    ------
    PlannerError
        If the motion is a sequence, or the file can't be written.
    """
    if plan.mode:
        reason = "it is a sequence, and a primitive is made of the motion to a single goal"
        raise GoalError(f"the last motion can't be kept: {reason}")
    primitive = library.named(plan.primitive)
    # Names may contain any characters, a path for example.
    stem = re.sub(r"[^A-Za-z0-9_-]+", "_", primitive.name)[:100]
    names = ((f"{primitive.name}_{k}", folder / f"{stem}_{k}.npz") for k in count(1))
    name, file = next((n, f) for n, f in names if n not in library.names and not f.exists())
    motion = RefinedMotion([plan.motion])
    save_primitive(primitive_around(primitive, motion, name, provenance), file)
    return file
