# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""Modules that take long to import, and that many calls do not need."""

from importlib import import_module
from typing import Any


class LazyModule:
    """A module that is imported when one of its names is first used.

    Parameters
    ----------
    name : str
        Full name of the module.
    """

    def __init__(self, name: str) -> None:
        self._name = name

    def __getattr__(self, name: str) -> Any:
        value = getattr(import_module(self._name), name)
        setattr(self, name, value)  # from then on, it is found without this function
        return value
