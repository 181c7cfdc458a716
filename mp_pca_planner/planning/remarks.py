# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""Remarks on unusual properties of a planned motion."""

from __future__ import annotations

from typing import Protocol

from ..motion.validation import LimitCheck
from .plan import STOPPED_EARLY

UNUSUAL_IN_SPAN_SCORE = 3.0
"""In-span score above which a motion is reported as unlike the demonstrations."""


class AnyPlan(Protocol):
    """Common interface of all kinds of plans."""

    @property
    def status(self) -> str:
        """Status of the plan."""

    @property
    def message(self) -> str:
        """One sentence."""

    @property
    def in_span_score(self) -> float:
        """How far outside the demonstrations the request lies."""

    @property
    def limit_check(self) -> LimitCheck | None:
        """Its comparison with the limits."""


def remarks(plan: AnyPlan) -> list[str]:
    """Sentences on unusual properties of a plan; none for a usual one."""
    found = [plan.message] if plan.status == STOPPED_EARLY else []
    if plan.in_span_score > UNUSUAL_IN_SPAN_SCORE:
        found.append(
            f"the request is unlike the demonstrations (in-span score {plan.in_span_score:.1f}, "
            "about 1 is usual), so the motion may look unlike them, too"
        )
    if plan.limit_check is not None and plan.limit_check.remark:
        found.append(plan.limit_check.remark)
    return found
