# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""Keeps a motion that was published as a primitive file of its own."""

from __future__ import annotations

import re
from collections.abc import Mapping
from itertools import count
from pathlib import Path
from typing import Any

from ..exceptions import GoalError
from ..learning.family import family_around
from ..learning.refined_motion import RefinedMotion
from ..planning.plan import Plan
from ..primitives.file import save_primitive
from .adaptation import AdaptedPlan
from .motion_server import Served


def keep_motion(served: Served, folder: Path, provenance: Mapping[str, Any]) -> Path:
    """Write the family of motions around a published one as a new primitive file.

    Of a goal that is learned by trials, the best trial is kept, and its trials are over.

    Parameters
    ----------
    served : Served
        What was published.
    folder : Path
        Where to; the file is called after the primitive with the first number that is free.
    provenance : mapping
        What to keep of where it comes from, of JSON types.

    Raises
    ------
    PlannerError
        If the motion is a sequence, no trial was better than the planned motion, or the file
        can't be written.
    """
    plan = served.plan
    if isinstance(plan, Plan) and plan.mode:
        raise GoalError(
            "the last motion can't be kept: it is a sequence, and a primitive is made of the "
            "motion to a single goal"
        )
    if isinstance(plan, AdaptedPlan):
        raise GoalError(
            "the last motion can't be kept: it continues a running motion to a new goal; send the "
            "goal again when the robot is at rest"
        )
    known = {primitive.name: primitive for primitive in served.model.planner.primitives}
    primitive = known[plan.primitive]
    # Names may hold anything, a path for example.
    stem = re.sub(r"[^A-Za-z0-9_-]+", "_", primitive.name)[:100]
    for number in count(1):
        name, file = f"{primitive.name}_{number}", folder / f"{stem}_{number}.npz"
        if name not in known and not file.exists():
            break
    trial, parameters = served.trial, None
    if trial is not None:
        parameters, facts = trial.to_keep()
        provenance = {**provenance, **facts}
    motion = RefinedMotion([plan.motion], parameters)
    save_primitive(family_around(primitive, motion, name, provenance), file)
    if trial is not None:
        trial.close()
    return file
