# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""Valid files of every format that the package reads, and functions that corrupt them.

Structured files (trees of JSON and YAML, arrays, tables, messages in bags) are also corrupted
inside and get valid checksums. Otherwise the code behind the checksum would not be tested.
"""

from __future__ import annotations

import json
import re
import shutil
from collections.abc import Callable
from functools import cache
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np
import pyarrow
import yaml
from pyarrow import parquet
from support.arm import arm_robot
from support.bags import EPOCH, JOINT_STATE, Message, Messages, S, storage_file, write_messages
from support.datasets import write_dataset
from support.forged import rewrite
from support.marker_bags import TF
from support.marker_bags import Messages as MarkerMessages

from mp_pca_planner.cli.main import main as command
from mp_pca_planner.files import config_file
from mp_pca_planner.primitives.file import checksum
from mp_pca_planner.recordings.synthetic import JOINT_NAMES, continuous_recording, generate_motions

Random = np.random.Generator
Spoil = Callable[[Path, Random], None]

START, GOAL = "-0.2,-0.2,-0.1,-0.4", "0.1,-0.9,0.2,-0.9"
FORMATS = {".bag": "rosbag1", ".db3": "sqlite3", ".mcap": "mcap"}
RATE = 50.0
ODD_TEXTS = (
    *("", " ", "\x00", "\x1b[31m", "a\nb", "\u202e", "$$", "$\\frac$", "../x", "/etc/passwd"),
    *("~", "nan", "-inf", "1e308", "-1", "0", "9" * 400, "2001-02-30", "!!int x", "!!bool"),
    *("*a", "&a x", "{" * 2000, "[" * 2000, "<a>" * 2000, "a" * 5000, "é", "null", "true"),
    *("<", "&amp;", "%s", ","),
)
ODD_VALUES = (
    *(None, True, -1, 0, 1, 10**400, 1e308, -1e308, 1e-300, float("nan"), float("inf")),
    *("", "\x1b[31m", "\ud800", "../../x", "/x", "$$", "a" * 5000, [], {}, [[]], [None]),
    *({"": None}, ["a", "a"], list(range(1000))),
)
ODD_NUMBERS = (np.nan, np.inf, -np.inf, 1e308, -1e308, 1e-308, 0.0, -1.0, 1e6, 3000.0)
NUMBER_OR_WORD = re.compile(r"-?\d+\.?\d*(?:[eE][-+]?\d+)?|[A-Za-z_]\w*")
SRDF = """<robot name="human_arm">
 <disable_collisions link1="upper_arm" link2="lower_arm" reason="Adjacent"/>
 <disable_collisions link1="torso" link2="wrist" reason="Never"/>
</robot>
"""
SCENE = """\
robot_model_name: human_arm
allowed_collision_matrix:
  entry_names: [chest, table]
  entry_values: [[false, true], [true, false]]
fixed_frame_transforms:
  - {child_frame_id: world, transform: {translation: [0, 0, 0], rotation: [0, 0, 0, 1]}}
world:
  collision_objects:
    - id: table
      header: {frame_id: world}
      pose: {position: [0, 0, -0.1], orientation: [0, 0, 0, 1]}
      primitives: [{type: box, dimensions: [1.0, 1.0, 0.05]}, {type: sphere, dimensions: [0.1]}]
      primitive_poses:
        - {position: [0.8, 0.0, -0.5], orientation: [0, 0, 0, 1]}
        - {position: [0.9, 0.0, -0.4], orientation: [0, 0, 0.6, 0.8]}
    - id: plate
      meshes: [{vertices: [[1, 0, 0], [1, 1, 0], [1, 0, 1]], triangles: [[0, 1, 2]]}]
      mesh_poses: [{position: [0.5, 0, 0], orientation: [0, 0, 0, 1]}]
robot_state:
  attached_collision_objects:
    - link_name: wrist
      touch_links: [lower_arm]
      object:
        id: cup
        primitives: [{type: cylinder, dimensions: [0.1, 0.03]}]
        primitive_poses: [{position: [0, 0, -0.1], orientation: [0, 0, 0, 1]}]
"""
_REST = "0 0 0\n0 0 0 1\n0 0 0 0\n0"
SCENE_TEXT = f"""\
scene
* table
0.8 0 -0.5
0 0 0 1
1
box
1.0 1.0 0.05
{_REST}
* can
0.7 0.2 -0.4
0 0 0 1
1
cylinder
0.05 0.2
{_REST}
.
"""


def make_seeds(folder: Path) -> None:
    """Small valid files of every format."""
    for suffix in FORMATS:
        _write(folder / f"a{suffix}", messages_of(suffix))
    write_messages(folder / "folder", Messages("sqlite3"), _entries(messages_of(".db3")))
    write_messages(folder / "markers", *_markers())
    for name in ("human_arm.urdf", "human_arm_markers.yaml", "human_arm_joint_limits.yaml"):
        shutil.copy(config_file(name), folder)
    for name, text in (("a.srdf", SRDF), ("scene.yaml", SCENE), ("a.scene", SCENE_TEXT)):
        (folder / name).write_text(text)
    q = continuous_recording(generate_motions(5, seed=1, rate=RATE), RATE, seed=1)
    header = ",".join(["time", *JOINT_NAMES])
    table = np.column_stack([q.times, q.positions])
    np.savetxt(folder / "table.csv", table, "%.6g", delimiter=",", header=header, comments="")
    motions = [motion.positions for motion in generate_motions(5, 3, rate=RATE)]
    write_dataset(folder / "dataset", motions, list(JOINT_NAMES))
    bag, primitive = str(folder / "a.mcap"), str(folder / "a.npz")
    segments = str(folder / "a.csv")
    if command(["build_primitives", bag, "--output", primitive, "--write-segments", segments]):
        raise SystemExit("no valid primitive could be made")


@cache
def messages_of(suffix: str) -> list[tuple[int, bytes]]:
    """Stamps [ns] and serialised joint states for a bag with this suffix."""
    recording = continuous_recording(generate_motions(5, seed=1, rate=RATE), seed=1)
    messages, stamps = Messages(FORMATS[suffix]), EPOCH + (recording.times * 1e9).astype(int)
    states = map(Message, [JOINT_NAMES] * len(stamps), recording.positions, stamps.tolist())
    made = ((x.stamp, messages.joint_state(x)) for x in states)
    return [(stamp, bytes(messages.serialise(state, JOINT_STATE))) for stamp, state in made]


def _markers() -> tuple[Messages, list[Any]]:
    """Transforms of the markers of the map while the arm moves."""
    recording = continuous_recording(generate_motions(1, seed=1, rate=RATE), seed=1)
    placements = yaml.safe_load(config_file("human_arm_markers.yaml").read_text())["markers"]
    links = [placement["link"] for placement in placements.values()]
    offsets = np.array([placement["position"] for placement in placements.values()])
    points = arm_robot().attach_points(links, offsets)
    places, _ = points.positions_and_jacobians(recording.positions[::5])
    messages, entries = MarkerMessages(), []
    for time, found in zip(recording.times[::5], places, strict=True):
        stamp = EPOCH + int(time * 1e9)
        named = zip(placements, found, strict=True)
        transforms = [messages.transform("world", name, place, stamp) for name, place in named]
        entries.append(("/tf", TF, stamp, messages.make(TF, transforms=transforms)))
    return messages, entries


def _entries(raw: list[tuple[int, bytes]]) -> list[Any]:
    return [("/joint_states", JOINT_STATE, max(stamp, 0), content) for stamp, content in raw]


def _write(path: Path, raw: list[tuple[int, bytes]]) -> None:
    """Write a bag of one file."""
    with TemporaryDirectory() as folder:
        messages, entries = Messages(FORMATS[path.suffix]), _entries(raw)
        shutil.move(storage_file(write_messages(Path(folder, "new"), messages, entries)), path)


def spoilt_bytes(raw: bytes, random: Random) -> bytes:
    """Bytes that are flipped, cut out, repeated, inserted, or odd numbers."""
    content = bytearray(raw)
    for _ in range(random.integers(1, 9)):
        n = len(content)
        at, to = sorted(int(k) for k in random.integers(0, n + 1, 2))
        to = min(to, at + int(random.choice([1, 4, 8, 64, n])))
        match random.integers(0, 7):
            case 0 if at < n:
                content[at] ^= 1 << int(random.integers(0, 8))
            case 1:
                odd = np.uint32(random.choice([0, 1, 2**31, 2**32 - 1]))
                content[4 * (at // 4) : 4 * (at // 4) + 4] = odd.tobytes()
            case 2:
                odd = np.float64(random.choice(ODD_NUMBERS))
                content[8 * (at // 8) : 8 * (at // 8) + 8] = odd.tobytes()
            case 3 if to - at < n // 2:
                del content[at:to]
            case 4:
                content[at:at] = content[at:to][:4096]
            case 5:
                content[at:at] = random.bytes(int(random.integers(1, 9)))
            case _ if random.random() < 0.3:
                del content[at:]
    return bytes(content)


def spoil_bytes(path: Path, random: Random) -> None:
    """Corrupt the bytes of a file."""
    path.write_bytes(spoilt_bytes(path.read_bytes(), random))


def spoil_text(path: Path, random: Random) -> None:
    """Replace numbers and words, repeat and drop lines; sometimes bytes."""
    if random.random() < 0.2:
        return spoil_bytes(path, random)
    text = path.read_text(encoding="utf-8", errors="replace")
    for _ in range(random.integers(1, 4)):
        tokens = list(NUMBER_OR_WORD.finditer(text))
        lines = text.splitlines(keepends=True)
        kind = random.integers(0, 6)
        if kind < 4 and tokens:
            token = tokens[int(random.integers(0, len(tokens)))]
            other = tokens[int(random.integers(0, len(tokens)))].group()
            odd = other if kind == 0 else str(random.choice(ODD_TEXTS))
            text = text[: token.start()] + odd + text[token.end() :]
        elif lines:
            at = int(random.integers(0, len(lines)))
            lines[at : at + 1] = [] if kind == 4 else [lines[at]] * int(random.choice([2, 200]))
            text = "".join(lines)
    path.write_text(text, encoding="utf-8", errors="replace")
    return None


def spoil_tree(tree: Any, random: Random) -> Any:
    """Replace one value of a tree of dicts and lists, or nest it deeply."""
    if isinstance(tree, dict | list) and tree and random.random() < 0.85:
        tree = dict(tree) if isinstance(tree, dict) else list(tree)
        keys = list(tree) if isinstance(tree, dict) else range(len(tree))
        key = keys[int(random.integers(0, len(keys)))]
        if isinstance(tree, dict) and random.random() < 0.2:
            tree[str(random.choice(ODD_TEXTS))] = tree.pop(key)
        else:
            tree[key] = spoil_tree(tree[key], random)
        return tree
    if random.random() < 0.05:
        for _ in range(600):
            tree = [tree]
        return tree
    return ODD_VALUES[int(random.integers(0, len(ODD_VALUES)))]


def spoil_yaml(path: Path, random: Random) -> None:
    """Corrupt one value of a YAML or JSON file, or its text."""
    if random.random() < 0.4:
        return spoil_text(path, random)
    spoilt = spoil_tree(yaml.safe_load(path.read_text()), random)
    is_json = path.suffix == ".json" or random.random() < 0.3
    path.write_text(json.dumps(spoilt) if is_json else yaml.safe_dump(spoilt))
    return None


def spoil_npz(path: Path, random: Random) -> None:
    """Corrupt arrays or the metadata of a primitive with a valid checksum; or its bytes."""
    if random.random() < 0.2:
        return spoil_bytes(path, random)

    def change(arrays: dict[str, Any], metadata: dict[str, Any]) -> None:
        if random.random() < 0.4:
            spoilt = spoil_tree(dict(metadata), random)
            metadata.clear()
            metadata.update(spoilt if isinstance(spoilt, dict) else {"metadata": spoilt})
        for name in random.choice(list(arrays), int(random.integers(1, 4))).tolist():
            arrays[name] = _spoilt_array(arrays.get(name), random)
            if arrays[name] is None:
                del arrays[name]
        metadata.pop("checksum", None)
        metadata["checksum"] = checksum(arrays, metadata)

    rewrite(path, change)
    return None


def _spoilt_array(array: Any, random: Random) -> Any:
    if array is None:
        return None
    match random.integers(0, 9):
        case 0 | 1 | 2 if array.size:
            spoilt = array.copy()
            spoilt.flat[random.integers(0, array.size)] = random.choice(ODD_NUMBERS)
            return spoilt
        case 3 if array.dtype.kind == "f":
            return array * random.choice([1e6, -1e3, 1e-9, 1e200])
        case 4:
            return array[:0]
        case 5:
            return array[..., None]
        case 6:
            return array.astype(random.choice(["f4", "i8", "U8", "c16", "?"]))
        case 7:
            return np.zeros_like(array)
        case 8:
            return array[..., : array.shape[-1] // 2] if array.ndim else array
    return None


def spoil_parquet(path: Path, random: Random) -> None:
    """Corrupt columns of a table, or repeat it, which compresses well; or its bytes."""
    if random.random() < 0.3:
        return spoil_bytes(path, random)
    table = parquet.read_table(path)
    if random.random() < 0.1:
        n = int(random.choice([2, 100, 1_000, 10_000]))
        parquet.write_table(pyarrow.concat_tables([table] * n), path, row_group_size=10_000)
        return None
    parquet.write_table(pyarrow.table(spoil_tree(table.to_pydict(), random)), path)
    return None


def spoil_bag(path: Path, random: Random) -> None:
    """Corrupt the bytes of messages in a well-formed bag; or the bytes of the bag."""
    if random.random() < 0.5:
        return spoil_bytes(path, random)
    worst = random.random() ** 3
    messages = messages_of(path.suffix).copy()
    for k in np.flatnonzero(random.random(len(messages)) < worst):
        stamp, raw = messages[k]
        stamp = int(random.choice([stamp, stamp - S, 0, 2**62, stamp + 1000 * S]))
        messages[k] = stamp, spoilt_bytes(raw, random)
    path.unlink()
    _write(path, messages)
    return None
