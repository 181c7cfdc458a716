# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""Datasets as LeRobot's documentation describes them, written for tests."""

from __future__ import annotations

import json
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pytest

STATE = "observation.state"


def write_dataset(
    folder: Path,
    episodes: Sequence[np.ndarray],
    names: object,
    *,
    version: str = "v3.0",
    columns: Sequence[str] = (STATE,),
    times: str = "seconds",
    shape: Sequence[int] | None = None,
) -> Path:
    """Episodes at 50 Hz; each has a file in versions before 3.0, and all share one since then."""
    arrow = pytest.importorskip("pyarrow", reason="pyarrow (extra 'lerobot') is not installed")
    from pyarrow import parquet

    n, is_old = episodes[0].shape[1], version.startswith("v2")
    path = f"data/chunk-000/{'episode_{:06d}' if is_old else 'file-{:03d}'}.parquet"
    vector = {"dtype": "float32", "shape": shape or [n], "names": names}
    image = {"dtype": "video", "shape": [480, 640, 3], "names": ["height", "width", "channels"]}
    features = {**dict.fromkeys(columns, vector), "observation.images.top": image}
    info = {"codebase_version": version, "fps": 50.0, "data_path": path, "features": features}
    info["total_episodes"] = len(episodes)
    for part in ("meta", "data/chunk-000"):
        (folder / part).mkdir(parents=True)
    (folder / "meta/info.json").write_text(json.dumps(info), encoding="utf-8")
    kind, tables = arrow.list_(arrow.float32(), n if is_old else -1), []
    for k, q in enumerate(episodes):
        steps = np.arange(len(q))
        content = {name: arrow.array(list(q.astype(np.float32)), kind) for name in columns}
        content |= {"frame_index": steps, "episode_index": np.full(len(q), k)}
        if times != "missing":
            content["timestamp"] = steps / 50.0 if times == "seconds" else np.zeros(len(q))
        tables.append(arrow.table(content))
    for k, table in enumerate(tables if is_old else [arrow.concat_tables(tables)]):
        parquet.write_table(table, folder / path.format(k))
    return folder
