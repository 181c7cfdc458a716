# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""Nodes beside those of the process."""

from __future__ import annotations

from typing import Self

import rclpy
from rclpy.signals import SignalHandlerOptions


class NodeInOwnContext:
    """A node in a context of its own; use it as a context manager.

    The context of the process and its signal handlers stay as they are.

    Attributes
    ----------
    context : Context
        The context.
    node : Node
        The node.
    """

    def __init__(self, name: str, namespace: str = "") -> None:
        self.context = rclpy.Context()
        rclpy.init(args=[], context=self.context, signal_handler_options=SignalHandlerOptions.NO)
        self.node = rclpy.create_node(name, context=self.context, namespace=namespace)

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.node.destroy_node()
        rclpy.try_shutdown(context=self.context)
