# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""Bags that no recorder writes are refused by name: in bounded memory, without waiting."""

from __future__ import annotations

import bz2
import os
import random
import shutil
import sqlite3
import struct
import tracemalloc
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from lz4.frame import compress as compress_lz4
from support.bags import EPOCH, FORMATS, S, reaching, read_joint_states, stamped, write_bag
from test_salvage import compressed_bag

from mp_pca_planner.exceptions import PlannerError, RecordingError
from mp_pca_planner.input_limits import INPUT_LIMITS, InputLimits
from mp_pca_planner.recordings.bags import bag, formats, write_joint_states
from mp_pca_planner.recordings.load import load_recordings
from mp_pca_planner.recordings.reading import inspect_recording

MB = 1 << 20
ZEROS = bytes(400 * MB)
COMPRESS: dict[str, Callable[[bytes], bytes]] = {
    "zstd": formats.zstd.compress,
    "lz4": compress_lz4,
    "bz2": bz2.compress,
}


def storage_file(path: Path) -> Path:
    return path if path.is_file() else next(f for f in path.iterdir() if f.suffix != ".yaml")


def refusal(path: Path, *, salvage: bool = False) -> str:
    (refused,) = load_recordings([path], salvage=salvage).refused
    return refused.reason


# Bombs


def mcap(path: Path, compression: str, stored: bytes, declared: int, *, indexed: bool) -> Path:
    """Write one chunk of any content, that says of itself what is given."""

    def record(code: int, content: bytes) -> bytes:
        return struct.pack("<BQ", code, len(content)) + content

    def text(content: bytes) -> bytes:
        return struct.pack("<I", len(content)) + content

    kind, magic = compression.encode(), b"\x89MCAP0\r\n"
    head = magic + record(0x01, text(b"ros2") + text(b""))
    about = struct.pack("<QQQI", 1, 2, declared, 0)
    chunk = record(0x06, about + text(kind) + struct.pack("<Q", len(stored)) + stored)
    data = head + chunk + record(0x0F, bytes(4))
    summary = record(
        0x03, b"\1\0" + text(b"sensor_msgs/msg/JointState") + text(b"ros2msg") + text(b"")
    )
    summary += record(0x04, b"\1\0\1\0" + text(b"/joint_states") + text(b"cdr") + text(b""))
    place = struct.pack("<QQQQ", 1, 2, len(head), len(chunk))
    counts = text(struct.pack("<HQ", 1, len(head) + len(chunk))) + struct.pack("<Q", 31)
    sizes = struct.pack("<QQ", len(stored), declared)
    summary += record(0x08, place + counts + text(kind) + sizes)
    summary += record(
        0x0B, struct.pack("<QHIIIIQQ", 9, 1, 1, 0, 0, 1, 1, 2) + text(struct.pack("<HQ", 1, 9))
    )
    footer = record(0x02, struct.pack("<QQI", len(data) if indexed else 0, 0, 0))
    path.write_bytes(data + (summary if indexed else b"") + footer + magic)
    return path


@pytest.mark.parametrize("salvage", [False, True])
@pytest.mark.parametrize("indexed", [False, True])
@pytest.mark.parametrize("declared", [100, len(ZEROS)])
@pytest.mark.parametrize("compression", ["zstd", "lz4"])
def test_chunk_unpacks_to_what_it_declares_and_a_limit(
    tmp_path: Path, compression: str, declared: int, indexed: bool, salvage: bool
) -> None:
    stored = COMPRESS[compression](ZEROS)
    path = mcap(tmp_path / "bomb.mcap", compression, stored, declared, indexed=indexed)
    tracemalloc.start()
    reason = refusal(path, salvage=salvage)
    _, peak = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    assert "bomb" in reason
    assert peak < 50 * MB


@pytest.mark.parametrize("compression", ["bz2", "lz4"])
def test_chunk_of_ros_1_unpacks_to_what_it_declares(tmp_path: Path, compression: str) -> None:
    path = compressed_bag(tmp_path, compression, 300)
    assert read_joint_states(path, "/joint_states").n_messages == 300
    content = path.read_bytes()
    place = content.index(b"size=", content.index(b"compression=")) + len(b"size=")
    path.write_bytes(content[:place] + struct.pack("<I", 100) + content[place + 4 :])
    assert "unpacks to more than 100 bytes" in refusal(path)


@pytest.mark.parametrize("compression", list(COMPRESS))
def test_bomb_of_any_compression_is_unpacked_to_the_limit_only(compression: str) -> None:
    stored = COMPRESS[compression](ZEROS[: 40 * MB])
    tracemalloc.start()
    with pytest.raises(formats.DamageError, match="more than 1,000 bytes"):
        formats.unpacked(compression, stored, 1000)
    _, peak = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    assert peak < 10 * MB
    twice = 2 * COMPRESS[compression](b"ab")
    assert formats.unpacked(compression, twice) == b"abab"


@pytest.mark.parametrize("salvage", [False, True])
def test_file_that_is_compressed_as_a_whole_does_not_fill_the_disk(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, salvage: bool
) -> None:
    (tmp_path / "bomb").mkdir()
    (tmp_path / "bomb" / "bomb_0.mcap.zstd").write_bytes(formats.zstd.compress(ZEROS))
    monkeypatch.setattr(formats, "INPUT_LIMITS", InputLimits(unpacked_bytes=MB))
    sizes: list[int] = []

    def watched(source: Path, target: Path) -> None:
        try:
            formats.copy_unpacked(source, target)
        finally:
            sizes.append(target.stat().st_size)

    monkeypatch.setattr(bag, "copy_unpacked", watched)
    assert "bomb" in refusal(tmp_path / "bomb", salvage=salvage)
    assert 0 < max(sizes) <= len(ZEROS) // 10


# What is no content of a bag


@pytest.mark.parametrize("name", ["pipe.bag", "pipe.db3", "pipe.mcap", "zero.mcap"])
def test_pipe_or_device_is_refused_without_waiting(tmp_path: Path, name: str) -> None:
    path = tmp_path / name
    path.symlink_to("/dev/zero") if name == "zero.mcap" else os.mkfifo(path)
    assert "expected a regular" in refusal(path)
    with pytest.raises(RecordingError, match="expected a regular"):
        inspect_recording(path)


def test_metadata_that_is_a_pipe_is_refused_without_waiting(tmp_path: Path) -> None:
    path = write_bag(tmp_path / "x", "mcap", stamped(reaching([0, 1])))
    (path / "metadata.yaml").unlink()
    os.mkfifo(path / "metadata.yaml")
    assert "not a regular file" in refusal(path)


def test_metadata_that_multiplies_by_aliases_is_refused(tmp_path: Path) -> None:
    path = write_bag(tmp_path / "x", "mcap", stamped(reaching([0, 1])))
    lines = ["a0: &a0 [x, x, x, x, x, x, x, x, x]"]
    lines += [f"a{i}: &a{i} [{', '.join(9 * [f'*a{i - 1}'])}]" for i in range(1, 12)]
    lines += ["rosbag2_bagfile_information: {version: *a11}"]
    (path / "metadata.yaml").write_text("\n".join(lines), encoding="utf-8")
    reason = refusal(path)
    assert "aliases" in reason
    assert len(reason) < 1000


@pytest.mark.parametrize(
    "change",
    [
        "UPDATE messages SET data = 'text' WHERE id = 7",
        "UPDATE messages SET timestamp = 'late' WHERE id = 7",
        "UPDATE messages SET timestamp = 1.5 WHERE id = 7",
        "UPDATE topics SET name = x'ff'",
        "UPDATE topics SET type = x'ff'",
        "ALTER TABLE messages RENAME COLUMN data TO q",
        "CREATE VIEW v AS WITH RECURSIVE n(i) AS (SELECT 1 UNION ALL SELECT i + 1 FROM n) SELECT i",
    ],
)
@pytest.mark.parametrize("salvage", [False, True])
def test_table_with_other_content_is_refused_by_name(
    tmp_path: Path, change: str, salvage: bool
) -> None:
    path = write_bag(tmp_path / "x", "sqlite3", stamped(reaching([0, 1])))
    with sqlite3.connect(storage_file(path)) as database:
        database.execute(change)
    assert str(path) in refusal(path, salvage=salvage) or salvage


def test_more_joints_than_any_robot_has_are_refused_unless_some_are_chosen(tmp_path: Path) -> None:
    n = 30_000
    names = [f"joint_{index}" for index in range(n)]
    motion = reaching([0, 1], rate=5)[:, :1]
    stamps = EPOCH + np.arange(len(motion)) * S // 5
    write_joint_states(tmp_path / "x", "mcap", names, stamps, motion * np.linspace(-1, 1, n))
    reason = refusal(tmp_path / "x")
    assert f"{n} joints of '/joint_states' are more than the {INPUT_LIMITS.joints}" in reason
    (chosen,) = load_recordings([tmp_path / "x"], joints=["joint_29999"]).demonstrations
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
        try:
            inspect_recording(victim, salvage=number % 2 == 0)
        except PlannerError as error:
            assert victim.name in str(error)  # noqa: PT017
        if victim.is_dir():
            shutil.rmtree(victim)
