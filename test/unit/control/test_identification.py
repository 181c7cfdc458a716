# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""Friction and rotor inertias from recordings whose friction and rotor inertias are known."""

import json
from pathlib import Path

import numpy as np
import pinocchio as pin
import pytest
from support.arm import JOINTS, arm_primitive, arm_robot

from mp_pca_planner.arrays import FloatArray
from mp_pca_planner.cli.main import main
from mp_pca_planner.control.identification import identify, measured_motions
from mp_pca_planner.exceptions import ControlError, RecordingError
from mp_pca_planner.files import config_file
from mp_pca_planner.primitives.file import save_primitive
from mp_pca_planner.recordings.bags import write_joint_states

FRICTION = np.array([0.3, 0.2, 0.1, 0.05])
VISCOUS = np.array([0.1, 0.0, 0.05, 0.02])
ARMATURE = np.array([0.05, 0.03, 0.0, 0.01])


def write(
    path: Path,
    friction: FloatArray = FRICTION,
    *,
    moving: int = 4,
    seconds: float = 30.0,
    noise: float = 0.0,
    sign: float = 1.0,
) -> Path:
    """A recording of sines of which the efforts follow from the equation of motion."""
    times, rng = np.arange(0.0, seconds, 0.004), np.random.default_rng(0)
    rates, shifts = rng.uniform(0.8, 5.0, (3, 1, 4)), rng.uniform(0.0, 6.0, (3, 1, 4))
    angles = rates * times[:, None] + shifts
    sizes = np.array([0.33, 0.2, 0.1])[:, None, None] * (np.arange(4) < moving)
    q, v, a = (
        np.sum(sizes * factor * rates**order, axis=0)
        for order, factor in enumerate((np.sin(angles), np.cos(angles), -np.sin(angles)))
    )
    efforts = arm_robot().inverse_dynamics(q, v, a)
    efforts += friction * np.sign(v) + VISCOUS * v + ARMATURE * a
    efforts += noise * rng.normal(size=q.shape)
    stamps = np.round(times * 1e9).astype(np.int64) + 10**18
    write_joint_states(path, "mcap", JOINTS, stamps, q, None, sign * efforts)
    return path


def test_known_friction_and_rotor_inertias_are_identified(tmp_path: Path) -> None:
    motions = measured_motions(write(tmp_path / "exact.mcap"), JOINTS)
    found = identify(arm_robot(), motions)
    np.testing.assert_allclose(found.values, [FRICTION, VISCOUS, ARMATURE], atol=0.005)
    assert not found.rejected


def test_errors_are_within_a_few_standard_errors_under_noise(tmp_path: Path) -> None:
    motions = measured_motions(write(tmp_path / "noisy.mcap", noise=0.3), JOINTS)
    found = identify(arm_robot(), motions)
    missed = np.abs(found.values - [FRICTION, VISCOUS, ARMATURE])
    assert np.all(missed < 4.0 * found.errors + 0.005)
    # A bound covers the true friction at any speed of the motion; armature that is 0 stays so.
    speeds = np.full(4, 2.0)
    assert np.all(found.friction(speeds, np.zeros(4)) > FRICTION + VISCOUS * speeds)
    assert found.armature[2] == 0.0
    assert np.all(found.armature[[0, 1, 3]] > 0.0)


def test_joints_that_do_not_move_are_rejected_with_a_sentence(tmp_path: Path) -> None:
    motions = measured_motions(write(tmp_path / "partly.mcap", moving=3), JOINTS)
    found = identify(arm_robot(), motions)
    assert list(found.rejected) == [JOINTS[3]]
    assert "it moves for 0.0 s forwards and 0.0 s backwards" in found.rejected[JOINTS[3]]
    stated = np.array([0.0, 0.0, 0.0, 0.7])
    assert found.friction(np.ones(4), stated)[3] == 0.7
    assert found.armature[3] == 0.0
    still = write(tmp_path / "still.mcap", moving=0, noise=0.1)
    with pytest.raises(ControlError, match="no joint can be identified; joint 'shoulder1': it mo"):
        identify(arm_robot(), measured_motions(still, JOINTS))


def test_efforts_that_drive_the_motion_are_rejected(tmp_path: Path) -> None:
    motions = measured_motions(write(tmp_path / "negative.mcap", -3.0 * FRICTION), JOINTS)
    with pytest.raises(ControlError, match="instead of resisting it; check the sign"):
        identify(arm_robot(), motions)


def test_recordings_without_efforts_are_rejected(tmp_path: Path) -> None:
    zeros, short, none = (tmp_path / f"{name}.mcap" for name in ("zeros", "short", "none"))
    stamps, values = np.arange(500) * 4_000_000 + 10**18, np.zeros((500, 4))
    write_joint_states(zeros, "mcap", JOINTS, stamps, values, None, values)
    with pytest.raises(RecordingError, match="are 0: expected measured efforts"):
        measured_motions(zeros, JOINTS)
    with pytest.raises(RecordingError, match="for 1 s without a gap"):
        measured_motions(write(short, seconds=0.5), JOINTS)
    write_joint_states(none, "mcap", JOINTS, stamps, values)
    with pytest.raises(RecordingError, match="lack positions or efforts"):
        measured_motions(none, JOINTS)


@pytest.mark.skipif(
    pin.__version__.startswith("2."), reason="rotor inertias need Pinocchio 3 or newer"
)
def test_verify_uses_what_is_identified(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    primitive, recording = tmp_path / "reach.npz", write(tmp_path / "arm.mcap", 0.01 * FRICTION)
    save_primitive(arm_primitive(), primitive)
    request = ["--robot", str(config_file("human_arm.urdf")), "--start=-0.5,-0.9,0.9,-0.5"]
    command = ["verify", str(primitive), *request, "--goal=-0.2,-0.4,0.9,-0.9", "--trials", "2"]
    main([*command, "--identify", str(recording), "--json"])
    facts = json.loads(capsys.readouterr().out)
    np.testing.assert_allclose(facts["identified"]["friction"], 0.01 * FRICTION, atol=0.005)
    np.testing.assert_allclose(facts["assumed"]["armature"], ARMATURE, atol=0.005)
    assert np.all(np.array(facts["assumed"]["friction"]) >= 0.01 * FRICTION - 0.005)
    main([*command, "--identify", str(recording), "--friction", "0.001"])
    text = capsys.readouterr().out
    assert "viscous friction" in text and "±" in text
    main([*command, "--identify", str(recording), "--friction", "0.001", "--json"])
    assert json.loads(capsys.readouterr().out)["assumed"]["friction"] == [0.001] * 4
