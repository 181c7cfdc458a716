# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""Bags that no recorder writes are refused by name: in bounded memory, without waiting."""

from __future__ import annotations

import os
import random
import shutil
from pathlib import Path

import numpy as np
import pytest
from support.bags import EPOCH, FORMATS, S, reaching, stamped, write_bag
from support.compressed_bags import compressed_bag

from mp_pca_planner.exceptions import PlannerError
from mp_pca_planner.input_limits import INPUT_LIMITS
from mp_pca_planner.recordings.bags import write_joint_states
from mp_pca_planner.recordings.load import load_recordings
from mp_pca_planner.recordings.reading import inspect_recording


def refusal(path: Path) -> str:
    (refused,) = load_recordings([path]).refused
    return refused.reason


# What is no content of a bag


def test_pipe_or_device_is_refused_without_waiting(tmp_path: Path) -> None:
    for name in ("pipe.bag", "zero.mcap"):
        path = tmp_path / name
        path.symlink_to("/dev/zero") if name == "zero.mcap" else os.mkfifo(path)
        assert "expected a regular" in refusal(path)
    bag = write_bag(tmp_path / "x", "mcap", stamped(reaching([0, 1])))
    (bag / "metadata.yaml").unlink()
    os.mkfifo(bag / "metadata.yaml")
    assert "not a regular file" in refusal(bag)


def test_more_joints_than_any_robot_has_are_refused_unless_some_are_chosen(tmp_path: Path) -> None:
    n = 3000
    names = [f"joint_{index}" for index in range(n)]
    motion = reaching([0, 1], rate=5)[:, :1]
    stamps = EPOCH + np.arange(len(motion)) * S // 5
    write_joint_states(tmp_path / "x", "mcap", names, stamps, motion * np.linspace(-1, 1, n))
    reason = refusal(tmp_path / "x")
    assert f"{n} joints of '/joint_states' are more than the {INPUT_LIMITS.joints}" in reason
    (chosen,) = load_recordings([tmp_path / "x"], joints=["joint_2999"]).demonstrations
    assert chosen.positions.shape[1] == 1
    (refused,) = load_recordings([tmp_path / "x"], joints=["jont_5"]).refused
    assert "'joint_5'" in refused.reason
    assert len(refused.reason) < 5000


# Mutations


def mutated(content: bytes, random_: random.Random) -> bytes:
    """Flip, cut off, splice or number anew."""
    changed = bytearray(content)
    place, other = (random_.randrange(len(changed)) for _ in range(2))
    size = random_.randrange(1, 100)
    match random_.randrange(5):
        case 0:
            for _ in range(8):
                changed[random_.randrange(len(changed))] = random_.randrange(256)
        case 1:
            del changed[place:]
        case 2:
            changed[place : place + size] = content[other : other + size]
        case 3:
            del changed[place : place + size]
        case _:
            number = random_.choice([0, 1, 2**31, 2**32 - 1, 2**63, 2**64 - 1])
            changed[place : place + 8] = number.to_bytes(8, "little")
    return bytes(changed)


@pytest.mark.parametrize("kind", [*FORMATS, "bz2", "lz4", "zstd", "zstd file", "zstd message"])
def test_mutated_bags_are_used_or_refused_by_name(tmp_path: Path, kind: str) -> None:
    good = (
        write_bag(tmp_path / "x", kind, stamped(reaching([0, 1])))
        if kind in FORMATS
        else compressed_bag(tmp_path, kind, 300)
    )
    random_ = random.Random(kind)
    victim = tmp_path / f"victim{good.suffix}"
    for number in range(40):
        shutil.copytree(good, victim) if good.is_dir() else shutil.copy(good, victim)
        files = sorted(victim.iterdir()) if victim.is_dir() else [victim]
        file = random_.choice(files)
        file.write_bytes(mutated(file.read_bytes(), random_))
        loaded = load_recordings([victim], salvage=number % 2 == 0)
        assert len(loaded.reports) + len(loaded.refused) == 1
        assert number % 2 == 0 or {report.n_messages for report in loaded.reports} <= {300}
        try:
            inspect_recording(victim, salvage=number % 2 == 0)
        except PlannerError as error:
            assert victim.name in str(error)  # noqa: PT017
        if victim.is_dir():
            shutil.rmtree(victim)
