# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""Configuration files that are shipped with the package."""

from __future__ import annotations

from pathlib import Path

from .exceptions import PlannerError, unknown_name
from .files import as_path

PACKAGE = "mp_pca_planner"
INDEX_MARKER = Path("share/ament_index/resource_index/packages") / PACKAGE


def config_file(name: str) -> Path:
    """Return the path of a file shipped in ``config/``, such as ``planner.yaml``.

    Raises
    ------
    PlannerError
        If there is no such file, or the package was installed without its ``config/``.

    Examples
    --------
    >>> import mp_pca_planner as mp
    >>> mp.config_file("human_arm.urdf").name
    'human_arm.urdf'
    """
    folder = config_folder(Path(__file__))
    path = folder / as_path(name)
    if not path.is_file():
        shipped = sorted(entry.name for entry in folder.iterdir() if entry.is_file())
        raise PlannerError(unknown_name("configuration file", name, shipped))
    return path


def config_folder(module: Path) -> Path:
    """Return the ``config/`` that belongs to a module file of this package.

    The search starts from the code that runs, not from the environment: two installations on one
    machine never use each other's files, and no environment has to be sourced.

    Raises
    ------
    PlannerError
        If the module is neither in a source tree nor in an installation with the ament index.
    """
    # The links of an editable or symlink installation lead back to the source tree.
    module = module.resolve()
    source_tree = module.parents[1]
    if (source_tree / "package.xml").is_file():
        return source_tree / "config"
    for prefix in module.parents:
        if (prefix / INDEX_MARKER).is_file():
            return prefix / "share" / PACKAGE / "config"
    raise PlannerError(
        f"no configuration files belong to '{module.parent}': expected a source tree with "
        f"package.xml, or an installation prefix above it that has '{INDEX_MARKER}'"
    )
