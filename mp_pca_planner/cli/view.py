# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""`view`: the robot, its primitives and plans on a page in the browser."""

from __future__ import annotations

import argparse
import threading
from dataclasses import replace

from ..primitives.primitive_library import load_primitives
from ..recordings.demonstrations import load_demonstrations
from ..view.page import ViewPage, read_content
from .common import limits_of
from .terminal import DONE, flush, say


def run(arguments: argparse.Namespace) -> int:
    """Serve the page until the time has passed or Ctrl-C; returns the exit status."""
    primitives = load_primitives(arguments.primitives)
    content = read_content(arguments.robot, primitives, arguments.package_dirs)
    limits = limits_of(content.robot, arguments.limits)
    recordings = None
    if arguments.demonstrations:
        recordings = load_demonstrations(
            arguments.demonstrations, robot=content.robot, topic=arguments.topic
        )
    content = replace(content, limits=limits, frame=arguments.frame, recordings=recordings)
    with ViewPage(content, arguments.host, arguments.port) as page:
        reach = "this machine only" if page.server.is_local else "every machine that reaches it"
        say(f"page         {page.url} (for {reach}; Ctrl-C ends it)")
        flush()
        try:
            threading.Event().wait(arguments.duration)
        except KeyboardInterrupt:  # the usual end
            pass
    return DONE
