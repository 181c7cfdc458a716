# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""Options of the loading of recordings."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Literal

import numpy as np

from ..arrays import as_list, check_choice, check_number, is_number, set_frozen
from ..exceptions import RecordingError
from ..renaming import Rename, check_rename

CUTS = ("valleys", "rests")
"""Where recordings are cut: at rests and at valleys of the speed, or at rests alone."""

MIN_REST = 0.6
"""Shortest rest that cuts [s], unless `min_rest` is given."""


@dataclass(frozen=True)
class LoadOptions:
    """Choice of the motions to load, and how they are repaired and cut.

    Attributes
    ----------
    topic : str or None
        Topic of the joint states; by default the only one. Of a LeRobot dataset the column; by
        default :data:`.tables.STATE`. Several, separated by commas, are taken together.
    joints : sequence of str or None
        Names of the joints; by default all that every message lists.
    moving_only : bool
        Leaves out those of `joints` that a recording does not list, or that never move in any
        recording, such as a gripper's. They are noted. Without effect on `markers`.
    rename : mapping of str to str
        New names of joints by patterns of recorded ones, see :data:`.renaming.Rename`. All other
        options use the new names. Of several topics, a pattern may be ``TOPIC/NAME``.
    scale : mapping of str to float
        Factors by joint, from recorded values to rad (or m).
    degrees : bool
        Whether recorded positions are in degrees, but those of `prismatic` joints, of joints with a
        `scale`, and of grippers of LeRobot datasets, which are percentages.
    segment : str
        "auto" cuts at rests and valleys of the speed, "none" takes each recording as one motion
        and only trims the stillness at both ends (a recording with gaps: one motion per piece).
    segments_csv : path or None
        A table of motions cut by hand, see :func:`.cutting.read_segments`; instead of
        `segment`.
    cut : {'valleys', 'rests'} or None
        Whether "auto" cuts at valleys of the speed, too, or at rests alone. By default recordings
        are cut at both, and episodes stay whole.
    min_rest : float or None
        Shorter rests don't cut [s], but they may be valleys; :data:`MIN_REST` by default. Given
        alone, it cuts episodes at rests.
    markers : MarkerSource or None
        Finds the joint states from markers, see :func:`.marker_joint_states.marker_source`;
        `topic` and `joints` are not used then.
    state_field : str or None
        The field of the topic's messages that is a JointState, with dots where it is a field of a
        field; needs `topic`. By default the messages themselves are.
    episodes : sequence of int or str, or None
        The episodes of LeRobot datasets or of CSV files to take; by default all.
    max_gap : float or None
        Longest time without messages that doesn't cut a recording [s], over 0. By default 0.5 s, or
        5 usual periods where these are longer.
    prismatic : sequence of str
        Joints that `degrees` doesn't convert, because they are measured in metres.
    position_limits : mapping of str to tuple of float
        Least and largest position of joints by name [rad or m]; none unless given. Motions beyond
        them are noted. See :func:`.load.facts_of_robot`.
    salvage : bool
        Takes the messages before the damage of a damaged recording.

    Raises
    ------
    RecordingError
        If a choice or a number is not accepted, or options exclude each other.
    """

    topic: str | None = None
    joints: Sequence[str] | None = None
    moving_only: bool = False
    rename: Rename = field(default_factory=dict)
    scale: Mapping[str, float] = field(default_factory=dict)
    degrees: bool = False
    segment: Literal["auto", "none"] = "auto"
    segments_csv: str | Path | None = None
    cut: Literal["valleys", "rests"] | None = None
    min_rest: float | None = None
    markers: Any = None
    state_field: str | None = None
    episodes: Sequence[int | str] | None = None
    max_gap: float | None = None
    prismatic: Collection[str] = ()
    position_limits: Mapping[str, tuple[float, float]] = field(default_factory=dict)
    salvage: bool = False

    def __post_init__(self) -> None:
        check_choice(self.segment, "segment", RecordingError, ("auto", "none"))
        if self.cut is not None:
            check_choice(self.cut, "the kind of cuts", RecordingError, CUTS)
        if self.min_rest is not None:
            check_number(self.min_rest, "the shortest rest 'min_rest' [s]", RecordingError, 1e-3)
        if self.cuts and (self.segments_csv is not None or self.segment == "none"):
            raise RecordingError(
                "--cut and --min-rest (cut=, min_rest=) are for --segment auto: remove them, or "
                "--segments and --segment"
            )
        if self.episodes is not None:
            what = "episodes: a list of their numbers is needed"
            set_frozen(self, episodes=as_list(self.episodes, what, RecordingError))
        if self.state_field is not None and self.topic is None:
            raise RecordingError(
                f"the field '{self.state_field}' needs a topic whose messages have this field"
            )
        check_rename(self.rename)
        for name, factor in self.scale.items():
            if not (is_number(factor) and np.isfinite(factor) and factor != 0.0):
                raise RecordingError(
                    f"the scale of joint '{name}' must be a number that is not 0, got {factor!r}"
                )

    @property
    def cuts(self) -> bool:
        """Whether cuts are asked for, which cut episodes, too."""
        return self.cut is not None or self.min_rest is not None

    @property
    def topics(self) -> list[str]:
        """The topics that are chosen; none by default."""
        return [] if self.topic is None else [topic.strip() for topic in self.topic.split(",")]
