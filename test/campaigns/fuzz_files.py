# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""Valid files of every format that the package reads, and functions that corrupt them.

Structured files (trees of JSON and YAML, arrays, messages in bags) are also corrupted inside and
get valid checksums. Otherwise the code behind the checksum would not be tested.
"""

from __future__ import annotations

import io
import json
import re
import shutil
from collections.abc import Callable
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pinocchio as pin
import yaml
from rosbags.rosbag1 import Writer as Writer1
from rosbags.rosbag2 import StoragePlugin
from rosbags.rosbag2 import Writer as Writer2
from rosbags.typesys import Stores, get_typestore

from mp_pca_planner.cli.main import main as command
from mp_pca_planner.files import config_file
from mp_pca_planner.primitives.file import checksum
from mp_pca_planner.recordings.synthetic import JOINT_NAMES, continuous_recording, generate_motions

Random = np.random.Generator
Spoil = Callable[[Path, Random], None]

START, GOAL = "-0.2,-0.2,-0.1,-0.4", "0.1,-0.9,0.2,-0.9"
TRANSFORMS = "tf2_msgs/msg/TFMessage"
JOINT_STATE = "sensor_msgs/msg/JointState"
EPOCH = 1_700_000_000 * 10**9  # a plausible wall-clock time [ns]
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
ODD_NUMBERS = (np.nan, np.inf, -np.inf, 1e308, -1e308, 1e-308, 0.0, -1.0, 1e6)
NUMBER_OR_WORD = re.compile(r"-?\d+\.?\d*(?:[eE][-+]?\d+)?|[A-Za-z_]\w*")

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
SCENE_TEXT = """\
scene
* table
0.8 0 -0.5
0 0 0 1
1
box
1.0 1.0 0.05
0 0 0
0 0 0 1
0 0 0 0
0
* can
0.7 0.2 -0.4
0 0 0 1
1
cylinder
0.05 0.2
0 0 0
0 0 0 1
0 0 0 0
0
.
"""


def make_seeds(folder: Path) -> None:
    """Small valid files of every format."""
    for suffix in (".bag", ".db3", ".mcap"):
        _write(folder / f"a{suffix}", messages_of(suffix))
    with Writer2(folder / "folder", version=9) as writer:
        _write_to(writer, messages_of(".db3"))
    with Writer2(folder / "markers", version=9) as writer:
        _write_to(writer, marker_messages(), "/tf", TRANSFORMS)
    bag, primitive = str(folder / "a.mcap"), str(folder / "a.npz")
    urdf = config_file("human_arm.urdf")
    shutil.copy(urdf, folder / "a.urdf")
    (folder / "a.srdf").write_text(
        '<robot name="human_arm">\n <disable_collisions link1="upper_arm" link2="lower_arm" '
        'reason="Adjacent"/>\n <disable_collisions link1="torso" link2="wrist" reason="Never"/>\n'
        "</robot>\n"
    )
    (folder / "limits.yaml").write_text(
        "joint_limits:\n"
        + "".join(
            f"  {joint}: {{has_velocity_limits: true, max_velocity: 3.0, max_effort: 40.0,\n"
            "    has_acceleration_limits: true, max_acceleration: 20.0}\n"
            for joint in JOINT_NAMES
        )
    )
    (folder / "scene.yaml").write_text(SCENE)
    (folder / "a.scene").write_text(SCENE_TEXT)
    shutil.copy(config_file("human_arm_markers.yaml"), folder / "markers.yaml")
    _run("build_primitives", bag, "--output", primitive, "--write-segments", folder / "a.csv")


@cache
def messages_of(suffix: str) -> list[tuple[int, bytes]]:
    """Stamps [ns] and serialised joint states for a bag with this suffix."""
    recording = continuous_recording(generate_motions(5, seed=1, rate=50.0), seed=1)
    store = get_typestore(Stores.ROS1_NOETIC if suffix == ".bag" else Stores.ROS2_JAZZY)
    types, empty = store.types, np.zeros(0)
    sequence = {"seq": 0} if suffix == ".bag" else {}
    serialize = store.serialize_ros1 if suffix == ".bag" else store.serialize_cdr
    messages = []
    for time, q in zip(recording.times, recording.positions, strict=True):
        stamp = EPOCH + int(time * 1e9)
        header = types["std_msgs/msg/Header"](
            stamp=types["builtin_interfaces/msg/Time"](*divmod(stamp, 10**9)),
            frame_id="",
            **sequence,
        )
        message = types[JOINT_STATE](header, list(JOINT_NAMES), np.array(q), empty, empty)
        messages.append((stamp, bytes(serialize(message, JOINT_STATE))))
    return messages


def marker_messages() -> list[tuple[int, bytes]]:
    """Stamps [ns] and serialised transforms of the markers of the map while the arm moves."""
    recording = continuous_recording(generate_motions(1, seed=1, rate=50.0), seed=1)
    placements = yaml.safe_load(config_file("human_arm_markers.yaml").read_text())["markers"]
    model = pin.buildModelFromUrdf(str(config_file("human_arm.urdf")))
    data, store = model.createData(), get_typestore(Stores.ROS2_JAZZY)
    make, messages = store.types, []
    upright = make["geometry_msgs/msg/Quaternion"](0.0, 0.0, 0.0, 1.0)
    for time, q in zip(recording.times[::5], recording.positions[::5], strict=True):
        pin.framesForwardKinematics(model, data, np.array(q))
        stamp = EPOCH + int(time * 1e9)
        header = make["std_msgs/msg/Header"](
            make["builtin_interfaces/msg/Time"](*divmod(stamp, 10**9)), "world"
        )
        transforms = []
        for name, placement in placements.items():
            link = data.oMf[model.getFrameId(placement["link"])]
            place = make["geometry_msgs/msg/Vector3"](*link.act(np.array(placement["position"])))
            transform = make["geometry_msgs/msg/Transform"](place, upright)
            transforms.append(make["geometry_msgs/msg/TransformStamped"](header, name, transform))
        messages.append(
            (stamp, bytes(store.serialize_cdr(make[TRANSFORMS](transforms), TRANSFORMS)))
        )
    return messages


def _run(*arguments: object) -> None:
    if command([str(argument) for argument in arguments]) != 0:
        raise SystemExit(f"no valid file could be made by {arguments}")


def spoil_bytes(path: Path, random: Random) -> None:
    """Flip, cut out, repeat, insert or move some bytes."""
    content = bytearray(path.read_bytes())
    for _ in range(random.integers(1, 9)):
        n = len(content)
        at, to = sorted(int(k) for k in random.integers(0, n + 1, 2))
        to = min(to, at + int(random.choice([1, 4, 8, 64, n])))
        match random.integers(0, 6):
            case 0 if at < n:
                content[at] ^= 1 << int(random.integers(0, 8))
            case 1:
                content[at : at + 4] = [b"\x00" * 4, b"\xff" * 4, b"\x00\x00\x00\x80"][
                    int(random.integers(0, 3))
                ]
            case 2 if to - at < n // 2:
                del content[at:to]
            case 3:
                content[at:at] = content[at:to][:4096]
            case 4:
                content[at:at] = random.bytes(int(random.integers(1, 9)))
            case _ if random.random() < 0.3:
                del content[at:]
    path.write_bytes(bytes(content))


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
    """Corrupt one value of a YAML file, or its text."""
    if random.random() < 0.4:
        return spoil_text(path, random)
    spoilt = spoil_tree(yaml.safe_load(path.read_text()), random)
    path.write_text(json.dumps(spoilt) if random.random() < 0.3 else yaml.safe_dump(spoilt))
    return None


def spoil_npz(path: Path, random: Random) -> None:
    """Corrupt an array or the metadata of a primitive with a valid checksum; or its bytes."""
    if random.random() < 0.3:
        return spoil_bytes(path, random)
    with np.load(path) as content:
        arrays = {name: content[name] for name in content.files}
    metadata = json.loads(str(arrays.pop("metadata")))
    if random.random() < 0.5:
        metadata = spoil_tree(metadata, random)
    else:
        name = str(random.choice(list(arrays)))
        arrays[name] = _spoilt_array(arrays[name], random)
        if arrays[name] is None:
            del arrays[name]
    if isinstance(metadata, dict):
        metadata.pop("checksum", None)
        metadata["checksum"] = checksum(arrays, metadata)
    buffer = io.BytesIO()
    np.savez(buffer, metadata=np.array(json.dumps(metadata, sort_keys=True)), **arrays)
    path.write_bytes(buffer.getvalue())
    return None


def _spoilt_array(array: Any, random: Random) -> Any:
    match random.integers(0, 7):
        case 0 if array.size:
            spoilt = array.copy()
            spoilt.flat[random.integers(0, array.size)] = random.choice(ODD_NUMBERS)
            return spoilt
        case 1:
            return array[:0]
        case 2:
            return array[..., None]
        case 3:
            return array.astype(random.choice(["f4", "i8", "U8", "c16", "?"]))
        case 4:
            return np.zeros_like(array)
        case 5:
            return array[..., : array.shape[-1] // 2] if array.ndim else array
    return None


def spoil_bag(path: Path, random: Random) -> None:
    """Corrupt the bytes of messages in a well-formed bag; or the bytes of the bag."""
    if random.random() < 0.5:
        return spoil_bytes(path, random)
    worst = random.random() ** 3
    messages = [
        (_spoilt_stamp(stamp, random), _spoilt_message(raw, random))
        if random.random() < worst
        else (stamp, raw)
        for stamp, raw in messages_of(path.suffix)
    ]
    path.unlink()
    _write(path, messages)
    return None


def _spoilt_stamp(stamp: int, random: Random) -> int:
    return int(random.choice([stamp, stamp - 10**9, 0, 2**62, stamp + 10**12]))


def _spoilt_message(raw: bytes, random: Random) -> bytes:
    content = bytearray(raw)
    match random.integers(0, 4):
        case 0 if content:
            content[int(random.integers(0, len(content)))] = int(random.integers(0, 256))
        case 1:
            del content[int(random.integers(0, len(content) + 1)) :]
        case 2:
            at = 8 * int(random.integers(0, len(content) // 8 + 1))
            content[at : at + 8] = np.float64(random.choice(ODD_NUMBERS)).tobytes()
        case 3:
            at = 4 * int(random.integers(0, len(content) // 4 + 1))
            content[at : at + 4] = np.uint32(random.choice([0, 1, 2**31, 2**32 - 1])).tobytes()
    return bytes(content)


def _write(path: Path, messages: list[tuple[int, bytes]]) -> None:
    if path.suffix == ".bag":
        with Writer1(path) as writer:
            _write_to(writer, messages)
        return
    folder = path.parent / "new"
    plugin = StoragePlugin.MCAP if path.suffix == ".mcap" else StoragePlugin.SQLITE3
    with Writer2(folder, version=9, storage_plugin=plugin) as writer2:
        _write_to(writer2, messages)
    next(folder.glob(f"*{path.suffix}")).rename(path)
    shutil.rmtree(folder)


def _write_to(
    writer: Writer1 | Writer2,
    messages: list[tuple[int, bytes]],
    topic: str = "/joint_states",
    kind: str = JOINT_STATE,
) -> None:
    store = get_typestore(Stores.ROS1_NOETIC if isinstance(writer, Writer1) else Stores.ROS2_JAZZY)
    connection = writer.add_connection(topic, kind, typestore=store)
    for stamp, raw in messages:
        writer.write(connection, max(stamp, 0), raw)  # type: ignore[arg-type]
