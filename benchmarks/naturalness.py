# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""Differences between planned and demonstrated motions: README, "Measured".

Each motion is left out in turn (with --by-activity: together with all of its label) and predicted
from its end points and its duration by a model of the others. Prints for every method the RMS error
in time / after the best time alignment / in path [deg]; with a robot also that of the tip's path
[mm], and the effort as a multiple of least-effort B-splines' (median). In brackets: the 95 %
bootstrap interval of the method's error less that of the planner's default (without a robot: of the
primitive's prediction). Above 0 the default is better. "needed": number of such motions at which
the interval in path would exclude 0, if the difference stayed the same. ProMP and DMP are those of
movement_primitives (extra peers). The ProMP is learned from all other motions, re-timed, with a
shrunk covariance, and conditioned on both ends. The DMP is learned from the motion with the nearest
ends. "speed", "end acceleration" and "end jerk": the 95 % quantile of the predictions, relative to
that of the demonstrations. The ends are the first and the last tenth of a prediction; of a
demonstration, which may be cut off at a speed, all of it counts. ProMP and DMP are interpolated
linearly, so their jerk means nothing.

    python benchmarks/naturalness.py BAG... [--segments FILE.csv] [--by-label] [--by-activity]
        [--align linear,arc_length] [--robot URDF] [--tip FRAME] [--no-peers] [--json]
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from left_out import (
    BSPLINES,
    MEASURES,
    RHOS,
    Comparison,
    Prediction,
    Predictor,
    compare,
    planned,
)
from tables import Table, benchmark_parser, show

from mp_pca_planner.arrays import FloatArray
from mp_pca_planner.cli.common import progress_bar
from mp_pca_planner.exceptions import MissingDependencyError
from mp_pca_planner.primitives.basis import legendre_values
from mp_pca_planner.primitives.build import PrimitiveOptions
from mp_pca_planner.primitives.differences import FINE_PHASES, by_way
from mp_pca_planner.primitives.timing import arc_length_warp, fit_paces, time_scaling
from mp_pca_planner.recordings.demonstration import Demonstration
from mp_pca_planner.recordings.load import load_recordings
from mp_pca_planner.robot.model import Robot

FEWEST = 5
RELATIVE = ("speed", "acceleration", "jerk")
ENDS = ("speed", "end acceleration", "end jerk")
_N_DMP_STEPS = 500


def main() -> None:
    """Print a table per set of motions and alignment method."""
    parser = benchmark_parser(__doc__)
    parser.add_argument("bags", nargs="+")
    parser.add_argument("--topic")
    parser.add_argument("--segments")
    parser.add_argument("--segment", choices=("auto", "none"), default="auto")
    parser.add_argument("--by-label", action="store_true", help="one set per label")
    parser.add_argument("--by-activity", action="store_true", help="leave out whole labels")
    parser.add_argument("--joints", type=lambda text: text.split(","), metavar="a,b,c")
    parser.add_argument("--align", default="arc_length", help="separated by commas")
    parser.add_argument("--robot", metavar="URDF", help="plan, too")
    parser.add_argument("--no-peers", action="store_true", help="without ProMP and DMP")
    parser.add_argument("--tip", metavar="FRAME", help="end of the arm")
    arguments = parser.parse_args()
    found = load_recordings(
        arguments.bags,
        topic=arguments.topic,
        joints=arguments.joints,
        segment=arguments.segment,
        segments_csv=arguments.segments,
    ).demonstrations
    robot = None
    if arguments.robot:
        robot = Robot.from_file(Path(arguments.robot), found[0].joint_names)
    tables: dict[str, Table] = {}
    summary, methods = [], []
    for label in sorted({d.label for d in found}) if arguments.by_label else ["all"]:
        motions = [d for d in found if label in ("all", d.label)]
        if len(motions) < FEWEST:
            continue
        for way in arguments.align.split(","):
            with progress_bar(f"{label}, {way}", "motion") as progress:
                comparison = compare(
                    motions,
                    [d.label for d in motions] if arguments.by_activity else None,
                    robot=robot,
                    tip=arguments.tip,
                    options=PrimitiveOptions(align=way),
                    more={} if arguments.no_peers else peers(),
                    progress=progress,
                )
            # Other naturalness weights are in the tables of the sets.
            others = {planned(rho) for rho in RHOS}
            methods = [method for method in comparison.results if method not in others]
            name = label if "," not in arguments.align else f"{label}, {way}"
            summary.append([name, str(len(motions)), *(_errors(comparison, m) for m in methods)])
            tables[f"{name}, {len(motions)} motions"] = _table(comparison)
    title = "RMS error [deg]: in time / after time alignment / in path"
    tables = {title: (["motions", "n", *methods], summary), **tables}
    show(tables, as_json=arguments.json)


def _errors(comparison: Comparison, method: str) -> str:
    errors = (np.rad2deg(comparison.rms(method, q)) for q in MEASURES)
    return " / ".join(f"{error:.2f}" for error in errors)


def _table(comparison: Comparison) -> Table:
    rows = []
    for name in comparison.results:
        errors = [np.rad2deg(comparison.rms(name, q)) for q in MEASURES]
        row = [name]
        for q, error in zip(MEASURES, errors, strict=True):
            low, high = np.rad2deg(comparison.interval(name, q))
            row += [f"{error:.2f}", f"[{low:+.2f}, {high:+.2f}]"]
        row.append(f"{1e3 * comparison.rms(name, 'tip'):.0f}")
        row.append(f"{np.mean(comparison.column(name, 'peak')):.3f}")
        row.append(f"{np.median(comparison.column(name, 'deviation')):.2f}")
        row += [f"{relative_to_demonstrated(comparison, name, q):.2f}" for q in RELATIVE]
        has_efforts = BSPLINES in comparison.results
        row.append(f"{comparison.effort_ratio(name):.2f}" if has_efforts else "")
        rows.append(row)
    columns = [x for q in MEASURES for x in (q, "difference")]
    return ["", *columns, "tip [mm]", "peak", "deviation", *ENDS, "effort"], rows


def relative_to_demonstrated(
    comparison: Comparison, method: str, quantity: str, share: float = 0.95
) -> float:
    """Quantile of a method's speed, acceleration or jerk, relative to that demonstrated.

    Demonstrations count with their largest value at any time: they may be cut off at a speed.
    """
    of_motions = [_demonstrated(motion, quantity) for motion in comparison.motions]
    return float(np.quantile(comparison.column(method, quantity), share)) / float(
        np.quantile(of_motions, share)
    )


def _demonstrated(motion: Demonstration, quantity: str) -> float:
    """Largest speed, acceleration or jerk of a demonstration at any time."""
    curves = {"speed": motion.velocities, "acceleration": motion.accelerations}
    curve = curves.get(quantity)
    if curve is None:
        curve = np.gradient(motion.accelerations, motion.times, axis=0)
    return float(np.abs(curve).max())


def peers() -> dict[str, Predictor]:
    """The methods ProMP and DMP."""
    try:
        import movement_primitives  # noqa: F401  # whether it can be imported is the question
    except ImportError:
        raise MissingDependencyError("movement_primitives", "peers", "the comparison") from None
    return {"ProMP": promp, "DMP": dmp}


def promp(motion: Demonstration, others: Sequence[Demonstration]) -> Prediction:
    """Mean of a ProMP of all others, conditioned on both ends, at their mean time scaling.

    It learns from re-timed motions, with the covariance of the weights shrunk (Ledoit and Wolf,
    2004): with five to twenty motions the maximum-likelihood one is singular.
    """
    from movement_primitives.promp import ProMP

    phases = FINE_PHASES[::10]
    model = ProMP(n_dims=motion.n_joints, n_weights_per_dim=10)
    paths = [by_way(d.time_normalised(FINE_PHASES.size)) for d in others]
    weights = np.array([model.weights(phases, path) for path in paths])
    model.from_weight_distribution(weights.mean(axis=0), ledoit_wolf(weights))
    for phase, end in ((0.0, 0), (1.0, -1)):
        model = model.condition_position(motion.positions[end], t=phase, t_max=1.0)
    mean = model.mean_trajectory(phases)
    (pace,) = fit_paces(np.array([arc_length_warp(d.time_normalised(1001)) for d in others])).mean(
        axis=0, keepdims=True
    )
    return Prediction(np.column_stack([np.interp(_paced(pace), phases, x) for x in mean.T]))


def _paced(pace: FloatArray) -> FloatArray:
    """Aligned phases on the fine grid of phases."""
    return np.clip(legendre_values(time_scaling(pace), FINE_PHASES), 0.0, 1.0)


def ledoit_wolf(samples: FloatArray) -> FloatArray:
    """Covariance shrunk to a multiple of the identity, by Ledoit's and Wolf's lemma 3.2.

    Parameters
    ----------
    samples : array, shape (n_samples, n_features)
        At least one.
    """
    deviations = samples - samples.mean(axis=0)
    n, size = samples.shape
    covariance = deviations.T @ deviations / n
    target = np.trace(covariance) / size * np.eye(size)
    distance = np.sum((covariance - target) ** 2)
    errors = np.sum(np.sum(deviations**2, axis=1) ** 2) / n - np.sum(covariance**2)
    share = min(errors / n / distance, 1.0) if distance > 0.0 else 0.0
    return np.asarray(share * target + (1.0 - share) * covariance)


def dmp(motion: Demonstration, others: Sequence[Demonstration]) -> Prediction:
    """DMP of the motion with the nearest ends, adapted to the requested ends."""
    from movement_primitives.dmp import DMP

    ends = [d.positions[[0, -1]] for d in others]
    wanted = motion.positions[[0, -1]]
    nearest = others[int(np.argmin([np.sum((e - wanted) ** 2) for e in ends]))]
    times = np.linspace(0.0, motion.duration, _N_DMP_STEPS + 1)
    model = DMP(
        n_dims=motion.n_joints,
        execution_time=motion.duration,
        dt=times[1],
        n_weights_per_dim=25,
    )
    model.imitate(times, nearest.time_normalised(times.size))
    model.configure(start_y=wanted[0], goal_y=wanted[1])
    found, positions = model.open_loop()
    shares = found / found[-1]
    return Prediction(np.column_stack([np.interp(FINE_PHASES, shares, x) for x in positions.T]))


if __name__ == "__main__":
    main()
