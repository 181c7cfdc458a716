# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""Remarks on what is unusual about a planned motion."""

from __future__ import annotations

from typing import Protocol

from .plan import STOPPED_EARLY

UNUSUAL_IN_SPAN_SCORE = 3.0
"""In-span score above which a motion is reported as unlike the demonstrations."""


class AnyPlan(Protocol):
    """What every kind of plan says of itself."""

    @property
    def status(self) -> str:
        """Whether it was solved, and in time."""

    @property
    def message(self) -> str:
        """One sentence."""

    @property
    def in_span_score(self) -> float:
        """How far outside the demonstrations the request lies."""


def remarks(plan: AnyPlan) -> list[str]:
    """Sentences on what is unusual about a plan; none for a usual one."""
    found = [plan.message] if plan.status == STOPPED_EARLY else []
    if plan.in_span_score > UNUSUAL_IN_SPAN_SCORE:
        found.append(
            f"the request is unlike the demonstrations (in-span score {plan.in_span_score:.1f}, "
            "about 1 is usual), so the motion may look unlike them, too"
        )
    return found
