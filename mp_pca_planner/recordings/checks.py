# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""Notes on motions: units, limits of the robot, hesitations, kinds."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from itertools import pairwise

import numpy as np

from ..exceptions import RecordingError
from ..lazy import LazyModule
from .continuity import units_advice
from .demonstration import Demonstration
from .options import LoadOptions
from .segmentation import ABSURD_EXTENT, extent

hierarchy = LazyModule("scipy.cluster.hierarchy")

ABSURD = f"rad (or m), and over {ABSURD_EXTENT:g} is absurd"
"""In the note on a joint that moves absurdly far."""

# Distance beyond a limit that is no reason for a note, as of soft limits and noise, and one for
# which a recording is rejected: half a turn is beyond any calibration [rad or m].
_LIMIT_TOLERANCE = 0.0175
_ABSURD_EXCESS = 3.14

# Fewest motions that are looked at for kinds; most kinds; how many times farther kinds are from
# each other than the parts of one.
_LEAST_OF_KINDS, _MOST_KINDS, _APART = 8, 6, 2.5
# Share of its extent by which a motion that returns ends beside its start; share of such motions.
_RETURNS, _ARE_MOST = 0.1, 0.9
_MOST_COMPARED = 5000  # of 20,000, the distances of all pairs take 1.6 GB


def absurd(motions: Sequence[Demonstration], options: LoadOptions) -> tuple[str, ...]:
    """A note if a joint moves absurdly far."""
    ranges = np.max([np.ptp(motion.positions, axis=0) for motion in motions], axis=0)
    if ranges.max() <= ABSURD_EXTENT:
        return ()
    name = motions[0].joint_names[ranges.argmax()]
    advice = units_advice(float(ranges.max()), were_degrees=options.degrees)
    return (f"joint '{name}' moves over {ranges.max():.3g} {ABSURD}: {advice}",)


def beyond_limits(motions: Sequence[Demonstration], options: LoadOptions) -> tuple[str, ...]:
    """A note if motions are beyond the limits of the robot.

    Raises
    ------
    RecordingError
        If they are absurdly far beyond.
    """
    beyond: list[tuple[float, float, str]] = []
    for motion in motions:
        for name, q in zip(motion.joint_names, motion.positions.T.tolist(), strict=True):
            low, high = options.position_limits.get(name, (-np.inf, np.inf))
            beyond += [(low - min(q), min(q), name), (max(q) - high, max(q), name)]
    excess, position, name = max(beyond, default=(0.0, 0.0, ""))
    if excess <= _LIMIT_TOLERANCE:
        return ()
    text = (
        f"joint '{name}' is at {position:.3g} rad (or m), {excess:.3g} beyond its limit in the "
        "robot description"
    )
    if excess > _ABSURD_EXCESS:
        raise RecordingError(
            f"{text}: positions must be in radians (or m), not in degrees (or mm), and of this "
            "robot"
        )
    return (f"{text}: check that it is of this robot, and its zero position",)


def hesitations(motions: Sequence[Demonstration]) -> tuple[str, ...]:
    """A note on the cuts of a recording between motions without a rest between them."""
    pairs = [(a, b) for a, b in pairwise(motions) if a.end_time == b.start_time]
    if not pairs:
        return ()
    shortest = min(one.duration for pair in pairs for one in pair)
    return (
        f"{len(pairs)} cuts at hesitations, where the speed has a valley (shortest motion beside "
        f"them {shortest:.2g} s): to cut at rests alone, pass --cut rests (cut='rests' in Python)",
    )


def kinds(motions: Sequence[Demonstration]) -> tuple[str, ...]:
    """A note if motions are of a few kinds, by clusters of their starts and goals."""
    is_looked_at = _LEAST_OF_KINDS <= len(motions) <= _MOST_COMPARED
    if not is_looked_at or len({motion.joint_names for motion in motions}) != 1:
        return ()
    ends = np.array([motion.positions[[0, -1]] for motion in motions])
    back = ends[:, ::-1]  # a way and its way back are of one kind
    is_back = np.linalg.norm(back - ends[0], axis=(1, 2)) < np.linalg.norm(
        ends - ends[0], axis=(1, 2)
    )
    ends = np.where(is_back[:, None, None], back, ends)
    tree = hierarchy.linkage(ends.reshape(len(ends), -1), "average")
    kinds, greatest = list[int](), _APART
    for k in range(2, _MOST_KINDS + 1):
        sizes = Counter(hierarchy.fcluster(tree, k, "maxclust").tolist()).values()
        apart = tree[-k + 1, 2] / max(tree[-k, 2], 1e-9)
        if len(sizes) == k and min(sizes) > 1 and apart > greatest:
            kinds, greatest = sorted(sizes, reverse=True), apart
    if not kinds:
        return ()
    return (
        f"these look like {len(kinds)} kinds of motions ({', '.join(map(str, kinds))} of them), by "
        "their starts and goals: if they are, label them in a table of segments and learn each "
        "kind by itself (--write-segments, --segments and --by label)",
    )


def returns(motions: Sequence[Demonstration]) -> tuple[str, ...]:
    """A note if motions end where they start."""
    ways = [np.linalg.norm(x.positions[-1] - x.positions[0]) for x in motions]
    n = sum(way < _RETURNS * extent(x.positions) for way, x in zip(ways, motions, strict=True))
    if not n or n < _ARE_MOST * len(motions):
        return ()
    return (
        f"{n} of {len(motions)} motions end where they start, so a goal elsewhere is unlike them: "
        "cut them at their rests (--cut rests), or by a table (--segments; segments_csv in Python)",
    )
