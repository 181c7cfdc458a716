# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""The command `refine`."""

import json

import numpy as np
import pytest
from support.arm import arm_primitive
from support.commands import GOAL, START, URDF, refusal, result, run

from mp_pca_planner.primitives.file import load_primitive, save_primitive


@pytest.fixture
def primitive(tmp_path):
    path = tmp_path / "reach.npz"
    save_primitive(arm_primitive(), path)
    return path


ENDS = ("--robot", URDF, "--start", START, "--goal", GOAL)


def refine(primitive, *options, ok=True):
    return json.loads(run("refine", primitive, *ENDS, *options, "--json", ok=ok).stdout)


def test_refined_motion_is_written_and_kept_as_a_primitive(primitive, tmp_path):
    new = tmp_path / "new.npz"
    facts = refine(primitive, "--output", new, "--name", "better")
    assert facts["cost"] < 0.99 * facts["original_cost"]
    assert facts["kept"] and facts["limit_violation"] == 0.0
    # The distances are those of an own comparison, at shares of the path on a fine grid.
    q = np.array(facts["positions"])
    expected = arm_primitive().predict(q[0], q[-1], facts["duration"]).positions
    apart = [by_share_of_path(x) for x in (q, expected)]
    distance = np.sqrt(np.mean(np.subtract(*apart) ** 2))
    assert facts["demonstrated_distance"] == pytest.approx(distance, rel=0.02)
    assert facts["original_demonstrated_distance"] < distance
    assert f"{facts['gain']:.1%} of the cost" in facts["message"]
    family = load_primitive(new)
    assert family.name == "better"
    assert family.metadata["refined_from"]["name"] == arm_primitive().name
    assert family.metadata["refined_from"]["cost"] == pytest.approx(facts["cost"])
    before, after = (result("plan", path, *ENDS)["effort_cost"] for path in (primitive, new))
    assert after < before
    # What can't be improved by one percent is not kept.
    facts = refine(new, "--output", tmp_path / "again.npz", "--duration", "30", ok=None)
    assert facts["kept"] == (facts["gain"] >= 0.01) == (tmp_path / "again.npz").exists()


def by_share_of_path(q):
    """Positions at the shares of a minimum-jerk motion of the path."""
    path = np.append(0.0, np.cumsum(np.linalg.norm(np.diff(q, axis=0), axis=1)))
    s = np.linspace(0.0, 1.0, 101)
    shares = 10 * s**3 - 15 * s**4 + 6 * s**5
    return np.column_stack([np.interp(shares, path / path[-1], x) for x in q.T])


def test_sequence_is_refined_and_kept_segment_by_segment(primitive, tmp_path):
    via = arm_primitive().boundary_states[1][3]
    new = tmp_path / "new.npz"
    facts = refine(primitive, "--via", ",".join(map(str, via)), "--output", new)
    assert facts["cost"] < 0.99 * facts["original_cost"]
    assert facts["kept"] and facts["limit_violation"] == 0.0
    assert len(facts["parameters"]) == 2
    times, q, v = (np.array(facts[key]) for key in ("times", "positions", "velocities"))
    # It goes through the via, and not from rest to rest.
    passed = np.abs(q - via).max(axis=1)
    moment = int(passed.argmin())
    speed = np.abs(v[moment]).max()
    assert passed[moment] <= speed * np.diff(times).max()
    assert speed > 0.05
    assert q[-1].tolist() == [-1.2, via[1], via[2], -0.9]
    families = [load_primitive(tmp_path / f"new_{k}.npz") for k in (1, 2)]
    assert [family.name for family in families] == [
        f"{arm_primitive().name}_refined_{k}" for k in (1, 2)
    ]
    ends = [family.metadata["refined_from"] for family in families]
    assert ends[0]["goal"] == ends[1]["start"] == via.tolist()
    assert not new.exists()


@pytest.mark.parametrize(
    ("options", "words"),
    [
        (("--time-price", "-1"), "--time-price: '-1' is not a number from 0"),
        (("--limits", "{tight}"), "no motion to refine"),
        (("--constraint", "upright:wrist:9"), "--constraint is not accepted"),
        (("--via", f"{GOAL}@0.5"), "(@ or --duration) are not accepted"),
    ],
)
def test_nonsense_is_refused_in_one_line(primitive, tmp_path, monkeypatch, options, words):
    monkeypatch.chdir(tmp_path)
    tight = tmp_path / "tight.yaml"
    tight.write_text("joint_limits: {elbow: {max_effort: 1.0e-6}}")
    options = [option.format(tight=tight) for option in options]
    assert words in refusal("refine", primitive, *ENDS, *options)
