# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""Buttons that save the planned motion as a file of the browser."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import viser

from ..planning.plan import Plan
from .stage import Stage

_FORMATS = {"CSV": "motion.csv", "JSON": "motion.json", "Bag (.mcap)": "motion.mcap"}


def add_export(stage: Stage, plan: Callable[[], Plan | None]) -> None:
    """Add the buttons.

    Parameters
    ----------
    stage : Stage
        The scene.
    plan : callable
        The present plan, if there is one. A plan that must not be executed is not saved.
    """
    formats = stage.server.gui.add_button_group(
        "Save as", tuple(_FORMATS), hint="Save the motion as a file"
    )

    def save(event: viser.GuiEvent[Any]) -> None:
        with stage.lock:
            present = plan()
        if event.client is None:
            return
        if present is None or not present.is_executable:
            text = "there is no motion to save"
            event.client.add_notification("Not saved", text, auto_close_seconds=4.0)
            return
        name = _FORMATS[formats.value]
        with TemporaryDirectory() as folder:
            path = Path(folder) / name
            present.trajectory.save(path)
            content = path.read_bytes()
        event.client.send_file_download(name, content, save_immediately=True)

    formats.on_click(save)
