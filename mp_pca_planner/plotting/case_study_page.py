# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""The page of the case study: tables beside the paper's, pictures, and an animation."""

from __future__ import annotations

import io
import json
from collections.abc import Mapping, Sequence
from html import escape

import numpy as np

from ..arrays import FloatArray
from ..evaluation.case_study import OURS, PAPER, CaseStudy
from ..evaluation.naturalness import BSPLINES, DEFAULT_RHO, EXPECTED, Comparison, planned
from ..evaluation.paper import N_COMPONENTS
from ..robot.model import Robot
from .case_study_tables import Table, less_than_paper, tables, verdict
from .drawing import draw_arm, draw_components, draw_trade_off
from .page import html_image, html_page, html_table

_DRAWN = (BSPLINES, PAPER, OURS)
_PERSON = "the person"
_N_FRAMES = 61


def draw_pictures(study: CaseStudy, robot: Robot, frames: Sequence[str]) -> dict[str, io.BytesIO]:
    """Draw all pictures as PNGs, by the names of their files."""
    pictures = {name: io.BytesIO() for name in ("figure_2", "figures_3_4", "trade_off")}
    draw_components(
        pictures["figure_2"],
        joint_names=study.motions[0].joint_names,
        components=[found.truncated(N_COMPONENTS).components for found in study.components],
        title="Principal components of the joint angles (paper: Fig. 2)",
    )
    draw_arm(
        pictures["figures_3_4"],
        frames,
        _chains(study, robot, frames),
        title="The arm-raising motion (paper: Figs. 3 and 4)",
    )
    draw_trade_off(
        pictures["trade_off"],
        _curve(study.held_out),
        {
            name: _place(study.held_out, name)
            for name in study.held_out.results
            if not name.startswith("planned") and name != EXPECTED
        },
        title="Effort against distance to people's motions",
    )
    return pictures


def case_study_page(
    study: CaseStudy,
    robot: Robot,
    frames: Sequence[str],
    source: str,
    pictures: Mapping[str, io.BytesIO],
) -> str:
    """Make the page."""
    title = "Case study: movement primitives of arm motions"
    found = tables(study)
    raising = study.raising.motion
    sections = [
        f"<h1>{title}</h1>",
        f"<p>{escape(source)} {len(study.motions)} motions, from all activities in turn.</p>",
        f"<p><strong>{escape(verdict(study))}</strong></p>",
        "<h2>Components</h2>",
        _table(found["table_2"], "Table 2: variance of the joint angles, ours and the paper's [%]"),
        "<p>Of many activities together the second component is larger than the paper's: motions "
        "there and back differ in direction, which takes the first, and in their way.</p>"
        if study.shares_by_activity
        else "",
        _by_activity(study, found["table_2_by_activity"]),
        html_image(pictures["figure_2"], "Principal components of each joint over time", "wide"),
        "<h2>The arm-raising motion</h2>",
        f"<p>Of the {len(study.motions)} motions the one that lifts the hand most ("
        f"{escape(raising.recording)} {escape(raising.label)} at {raising.start_time:.2f} s, "
        f"{raising.duration:.2f} s long), planned from its ends and its duration by what the "
        "others teach, without limits. The paper's variant leaves the velocities at the ends "
        "free; the other motions start and end at rest, which takes effort that it saves.</p>",
        _table(found["table_3"], "Table 3: effort, and time to optimise it (median)"),
        _table(
            found["table_3_all_motions"],
            f"The same for all {len(study.motions)} motions, each left out: medians, RMS errors",
        ),
        html_image(pictures["figures_3_4"], "Stills of the arm, front and side view", "wide"),
        _animation(study, robot, frames),
        "<h2>Naturalness</h2>",
        "<p>Each motion is left out and made from its ends and its duration: RMS errors in time, "
        "after the best time alignment, and in path; beside each the 95 % bootstrap interval of "
        "the difference from the planner's default, above 0 where that is nearer to the person. "
        "Deviation: of the weights, in standard deviations. Effort: a multiple of that of "
        "B-splines (median).</p>",
        _table(found["naturalness"], "Each motion left out alone"),
        html_image(pictures["trade_off"], "Effort and error as ρ goes from 0 to ∞", "wide"),
    ]
    if "naturalness_other_activities" in found:
        sections.append(
            _table(
                found["naturalness_other_activities"],
                "Each motion left out with all others of its activity",
            )
        )
    return html_page(title, "\n".join(section for section in sections if section))


def _by_activity(study: CaseStudy, content: Table) -> str:
    if not study.shares_by_activity:
        return ""
    below = less_than_paper(study)
    text = (
        f"<p>Below 90 %: {escape(', '.join(below))}. Strokes there and back go different ways "
        "there, so that direction, way and extent take a component each.</p>"
        if below
        else "<p>Two components explain over 90 % of every joint's variance in every activity.</p>"
    )
    return _table(content, "First two components of all motions of each activity [%]") + text


def _table(content: Table, caption: str) -> str:
    header, rows = content
    return html_table(header, rows, caption)


def _chains(study: CaseStudy, robot: Robot, frames: Sequence[str]) -> dict[str, FloatArray]:
    """Origins of the frames, shape (n_frames, n_points, 3), by what the pictures call it."""
    raising = study.raising
    chosen = np.linspace(0, 1000, _N_FRAMES).round().astype(int)
    positions = {name: raising.predictions[name].positions[chosen] for name in _DRAWN}
    positions[_PERSON] = raising.motion.time_normalised(_N_FRAMES)
    return {name: robot.frame_positions(q, frames) for name, q in positions.items()}


def _curve(comparison: Comparison) -> dict[str, tuple[float, float]]:
    """The planner from ρ = 0 to ∞."""
    methods = [name for name in comparison.results if name.startswith("planned")]
    rhos = {name: name.removeprefix("planned, ") for name in methods}
    rhos[planned(DEFAULT_RHO)] += " (default)"
    return {
        **{label: _place(comparison, name) for name, label in rhos.items()},
        "ρ = ∞": _place(comparison, EXPECTED),
    }


def _place(comparison: Comparison, name: str) -> tuple[float, float]:
    ratio = comparison.column(name, "effort") / comparison.column(BSPLINES, "effort")
    return float(np.median(ratio)), float(np.rad2deg(comparison.rms(name, "path")))


def _animation(study: CaseStudy, robot: Robot, frames: Sequence[str]) -> str:
    chains = _chains(study, robot, frames)
    points = {name: np.round(chain, 4).tolist() for name, chain in chains.items()}
    data = json.dumps({"duration": study.raising.motion.duration, "chains": points})
    return _ANIMATION.replace("DATA", data.replace("</", "<\\/"))


_ANIMATION = """
<h3>In motion</h3>
<p><button type="button" id="play">Pause</button>
<label>Speed <select id="speed"><option value="1">1</option><option value="0.5">½</option>
<option value="0.25" selected>¼</option></select></label>
<span class="soft">Left: front view, as one who faces the person. Right: side view.</span></p>
<canvas id="arm" width="960" height="1180" style="width:100%;max-width:40rem"
 role="img" aria-label="The motions, front and side view"></canvas>
<script>
(() => {
const {duration, chains} = DATA;
const names = Object.keys(chains), canvas = document.getElementById("arm");
const context = canvas.getContext("2d"), colours = ["#0072B2", "#D55E00", "#009E73", "#333333"];
const all = names.flatMap(name => chains[name].flat());
const range = axis => [Math.min(...all.map(p => p[axis])), Math.max(...all.map(p => p[axis]))];
const [x, y, z] = [0, 1, 2].map(range), height = canvas.height / names.length;
const half = canvas.width / 2;
const scale = Math.min((height - 90) / (z[1] - z[0]),
  (half - 60) / Math.max(x[1] - x[0], y[1] - y[0]));
let phase = 0, last = null, playing = true;
const draw = () => {
  context.clearRect(0, 0, canvas.width, canvas.height);
  names.forEach((name, row) => {
    const steps = chains[name], at = phase * (steps.length - 1), i = Math.floor(at);
    const next = Math.min(i + 1, steps.length - 1);
    [[y, 1], [x, 0]].forEach(([span, axis], column) => {
      const place = p => [column * half + half / 2 + (p[axis] - (span[0] + span[1]) / 2) * scale,
        row * height + 60 + (z[1] - p[2]) * scale];
      context.strokeStyle = "#999999"; context.lineWidth = 2; context.setLineDash([6, 5]);
      context.beginPath();
      steps.forEach(chain => context.lineTo(...place(chain[chain.length - 1])));
      context.stroke(); context.setLineDash([]);
      const chain = steps[i].map((p, k) => p.map((v, c) => v + (at - i) * (steps[next][k][c] - v)));
      context.strokeStyle = context.fillStyle = colours[row % colours.length];
      context.lineWidth = 9; context.lineCap = context.lineJoin = "round"; context.beginPath();
      chain.forEach(p => context.lineTo(...place(p))); context.stroke();
      chain.forEach(p => { context.beginPath();
        context.arc(...place(p), 10, 0, 2 * Math.PI); context.fill(); });
    });
    context.fillStyle = "#1f2328"; context.font = "26px system-ui, sans-serif";
    context.fillText(name, 12, row * height + 32);
  });
};
const step = now => {
  if (playing && last !== null) {
    const speed = Number(document.getElementById("speed").value);
    phase = (phase + speed * (now - last) / 1000 / duration) % 1.25;
  }
  last = now;
  const shown = phase; phase = Math.min(phase, 1); draw(); phase = shown;
  requestAnimationFrame(step);
};
document.getElementById("play").addEventListener("click", event => {
  playing = !playing; event.target.textContent = playing ? "Pause" : "Play";
});
requestAnimationFrame(step);
})();
</script>"""
