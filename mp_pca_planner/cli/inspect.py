# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""`inspect`: the content of bags and primitive files."""

from __future__ import annotations

import argparse
from dataclasses import asdict
from typing import Any

import numpy as np

from ..arrays import text_table
from ..control.law import control_statement
from ..exceptions import PlannerError, listed
from ..plotting.text import (
    components_words,
    prediction_words,
    prismatic_joints,
    unit_of,
    variance_report,
)
from ..primitives.file import load_primitive
from ..primitives.primitive import MovementPrimitive
from ..recordings.bags import find_recordings
from ..recordings.reading import RecordingInspection, inspect_recording
from ..recordings.repair import REPAIRS
from .common import print_json
from .terminal import DONE, PROGRAM, REFUSED, complain, say


def run(arguments: argparse.Namespace) -> int:
    """Run the command; files that can't be read are reported, the others are shown."""
    reports: list[dict[str, Any]] = []
    status = DONE
    for name in arguments.files:
        try:
            found = _contents(name, arguments)
        except PlannerError as error:
            complain(f"{PROGRAM} inspect: {error}")
            status = REFUSED
            continue
        for facts, lines in found:
            reports.append(facts)
            if not arguments.json:
                say(*lines, "")
    if arguments.json:
        print_json({"files": reports})
    return status if any(facts.get("refusal") is None for facts in reports) else REFUSED


def _contents(name: str, arguments: argparse.Namespace) -> list[tuple[dict[str, Any], list[str]]]:
    if name.endswith(".npz"):
        primitive = load_primitive(name)
        return [(_primitive_facts(name, primitive), _primitive_text(name, primitive))]
    found = [
        inspect_recording(
            path, arguments.topic, state_field=arguments.field, salvage=arguments.recover
        )
        for path in find_recordings([name])
    ]
    return [(asdict(facts), _recording_text(facts)) for facts in found]


def _recording_text(facts: RecordingInspection, max_joints: int = 100) -> list[str]:
    lines = [f"{facts.path} ({facts.format})"]
    lines += [f"  topic     {t.name}  {t.type}  {t.count} messages" for t in facts.topics]
    if facts.topic is not None:
        lines.append(f"  read      {facts.topic}: {facts.n_messages} messages")
    if facts.joint_names:
        lines.append(f"  joints    {listed(facts.joint_names, max_joints)}")
    if facts.rate is not None and facts.duration is not None:
        lines.append(f"  time      {facts.duration:.2f} s at {facts.rate:.1f} Hz")
    lines += [f"  repair    {kind}: {n} ({REPAIRS[kind]})" for kind, n in facts.repairs.items()]
    lines += [f"  note      {note}" for note in facts.notes]
    if facts.refusal is not None:
        lines.append(f"  can't be used: {facts.refusal}")
    return lines


def _primitive_facts(name: str, primitive: MovementPrimitive) -> dict[str, Any]:
    shown = (
        *("name", "joint_names", "coupling", "n_components", "degree"),
        *("explained_variance_ratio", "fit_residual", "metadata"),
    )
    return {
        "path": name,
        "format": "movement_primitive",
        **{field: getattr(primitive, field) for field in shown},
        **primitive.summary(),
        "durations": primitive.durations,
        "usual_error": _usual_error(primitive),
        "control_statement": control_statement(primitive),
    }


def _usual_error(primitive: MovementPrimitive) -> float:
    """Median of the expected errors at the ends of the demonstrations [rad or m]."""
    ends = primitive.boundary_states[:: -(-len(primitive.durations) // 200), [0, 3]]
    return float(np.median([primitive.prediction_error(primitive.model.predict(*x)) for x in ends]))


def _primitive_text(name: str, primitive: MovementPrimitive, most: int = 10) -> list[str]:
    residual = np.sqrt(np.mean(primitive.fit_residual**2, axis=1))
    unit = unit_of(primitive.joint_names, prismatic_joints(primitive))
    rows = []
    demonstrations = primitive.metadata["demonstrations"]
    for d, duration, error in zip(demonstrations, primitive.durations, residual, strict=True):
        name_of_motion = f"{d['recording']} {d['label']}".strip()
        times = [f"{d['start_time_s']:.2f}", f"{duration:.2f}"]
        rows.append([name_of_motion, *times, unit.number(error)])
    header = ["demonstration", "start [s]", "duration [s]", f"reproduced to [{unit.name} RMS]"]
    return [
        f"{name}: movement primitive '{primitive.name}'",
        f"joints      {', '.join(primitive.joint_names)}",
        f"components  {components_words(primitive)}, polynomials of degree {primitive.degree}",
        f"prediction  {prediction_words(primitive)}",
        f"control     {control_statement(primitive)}",
        "",
        *_range_lines(primitive),
        "",
        *variance_report(primitive),
        "",
        *text_table(rows[:most], header=header).splitlines(),
        *([f"… and {len(rows) - most} more demonstrations: --json lists all"] * (len(rows) > most)),
    ]


def _range_lines(primitive: MovementPrimitive) -> list[str]:
    """Demonstrated starts and goals by joint: for requests among these, the primitive is good."""
    facts, prismatic = primitive.summary(), prismatic_joints(primitive)
    rows = []
    for joint in primitive.joint_names:
        unit = unit_of([joint], prismatic)
        ends = [[unit.number(x) for x in facts[end][joint]] for end in ("starts", "goals")]
        rows.append([f"{joint} [{unit.name}]", *(f"{low} to {high}" for low, high in ends)])
    return text_table(rows, header=["joint", "starts", "goals"]).splitlines()
