# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""Problems among obstacles in the files of MotionBenchMaker, made by the tests."""

import yaml

# A plate between the ends of a motion of the primitive of the arm.
WALL = ("wall", "box", [0.5, 0.5, 0.04], [0.363, -0.331, 0.003])


def write_scene(path, obstacles, robot="robot"):
    """Write a planning scene of obstacles (name, type, dimensions, position)."""
    content = {
        "robot_model_name": robot,
        "world": {
            "collision_objects": [
                {
                    "id": name,
                    "primitives": [{"type": kind, "dimensions": list(map(float, sizes))}],
                    "primitive_poses": [
                        {
                            "position": list(map(float, position)),
                            "orientation": [0.0, 0.0, 0.0, 1.0],
                        }
                    ],
                }
                for name, kind, sizes, position in obstacles
            ]
        },
    }
    path.write_text(yaml.safe_dump(content), encoding="utf-8")
    return path
