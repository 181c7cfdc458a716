# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""Primitive files with changed content and the checksum of it."""

import json

import numpy as np

from mp_pca_planner.primitives.file import checksum


def forge(path, change):
    """Change arrays and metadata of a file, and give it the checksum that belongs to them."""

    def change_and_sign(arrays, metadata):
        change(arrays, metadata)
        metadata.pop("checksum")
        metadata["checksum"] = checksum(arrays, metadata)

    rewrite(path, change_and_sign)


def rewrite(path, change):
    """Change arrays and metadata of a file without a care for its checksum."""
    with np.load(path) as content:
        arrays = {name: content[name] for name in content.files}
    metadata = json.loads(str(arrays.pop("metadata")))
    change(arrays, metadata)
    np.savez(path, metadata=np.array(json.dumps(metadata)), **arrays)
