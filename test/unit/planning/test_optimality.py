# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""Solutions of the planner's solver, against another solver that starts from them."""

import pytest
from campaigns.optimality import improvement, is_held, solved_programs


@pytest.mark.slow
@pytest.mark.parametrize(("coupling", "n_components"), [("arm", 6), ("joint", 4)])
def test_slsqp_finds_no_better_motion_nearby(coupling, n_components):
    solved = solved_programs("human_arm", coupling, n_components, 5)
    assert len(solved) >= 4
    assert any(is_held(*pair) for pair in solved)
    assert max(improvement(*pair) for pair in solved) < 1e-3
