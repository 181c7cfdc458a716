#!/usr/bin/env python3
# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""Differences between demonstrated motions and those predicted from their ends and durations.

    python3 benchmarks/prediction.py BAG... [--segments FILE.csv] [--by-label] [--by-activity]
        [--align arc_length] [--robot URDF] [--tip FRAME] [--no-peers] [--json]

Each motion is left out in turn (with --by-activity: together with all of its label) and predicted
by a model of the others; with a robot it is planned, too, without limits, so that only the methods
are compared. For every method: the RMS error in time / after the best time alignment / in path
[deg]; with a robot also that of the tip's path [mm], and the effort as a multiple of least-effort
B-splines' (median). In brackets: the 95 % bootstrap interval of the method's error less that of the
planner's default (without a robot: of the primitive's prediction). Above 0 the default is better.
ProMP and DMP are those of movement_primitives (extra peers). The ProMP is learned from all other
motions, re-timed, with a shrunk covariance, and conditioned on both ends. The DMP is learned from
the motion with the nearest ends. "speed", "end acceleration" and "end jerk": the 95 % quantile of
the predictions, relative to that of the demonstrations. The ends are the first and the last tenth
of a prediction; of a demonstration, which may be cut off at a speed, all of it counts. ProMP and
DMP are interpolated linearly, so their jerk means nothing.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple

import numpy as np
from scipy.integrate import trapezoid
from scipy.interpolate import CubicSpline
from support.tables import Table, benchmark_parser, show

from mp_pca_planner.arrays import FloatArray
from mp_pca_planner.cli.common import progress_bar
from mp_pca_planner.exceptions import PrimitiveError, require
from mp_pca_planner.motion.goal import JointGoal, JointState
from mp_pca_planner.motion.interpolation import hermite_functions
from mp_pca_planner.planning.options import PlannerOptions
from mp_pca_planner.planning.planner import Planner
from mp_pca_planner.planning.request import NATURAL
from mp_pca_planner.primitives.basis import legendre_values
from mp_pca_planner.primitives.build import PrimitiveOptions, build_primitive
from mp_pca_planner.primitives.differences import (
    FINE_PHASES,
    PHASES,
    by_path_share,
    expected_motion,
    minimum_jerk_motion,
    path_difference,
)
from mp_pca_planner.primitives.primitive import MovementPrimitive
from mp_pca_planner.primitives.timing import arc_length_warp, fit_paces, time_scaling
from mp_pca_planner.recordings.demonstration import Demonstration
from mp_pca_planner.recordings.load import load_recordings
from mp_pca_planner.robot.limits import JointLimits
from mp_pca_planner.robot.model import Robot

MEASURES = ("time", "aligned", "path")
"""RMS differences over phases and joints: at equal shares of the time; at each instant of the
motion after the best warp of the prediction; at equal shares of the path. Only the first depends on
the timing."""

QUANTITIES = (
    *(*MEASURES, "tip", "peak", "deviation", "effort", "solve_time"),
    *("speed", "acceleration", "jerk"),
)
"""Of each prediction: RMS differences [rad], see `MEASURES`; RMS distance of the tip in path [m];
error of the phase of peak speed; RMS of the weights' deviations from the expected ones in standard
deviations; effort J [N²·m²·s]; time to find it [s], where it is optimised; largest speed [rad/s],
and largest acceleration [rad/s²] and jerk [rad/s³] in the first and last tenth of the duration. NaN
where there is no robot."""

FEWEST = 5
"""Least number of motions of a label."""

MINIMUM_JERK, MEAN_SHAPE, RIDGE = "minimum-jerk", "mean shape", "ridge regression"
EXPECTED, BSPLINES = "expected (ρ = ∞)", "least-effort B-splines"
LEAST_EFFORT, PLANNED = "planned, ρ = 0", f"planned, ρ = {NATURAL:g}"

_OPTIONS = PrimitiveOptions()


RELATIVE = ("speed", "acceleration", "jerk")
ENDS = ("speed", "end acceleration", "end jerk")
_N_DMP_STEPS = 500


class Prediction(NamedTuple):
    """The motion that a method predicts from the ends and the duration of another one.

    Attributes
    ----------
    positions : array, shape (1001, n_joints)
        Positions at the fine phases [rad or m].
    effort : float or None
        J [N²·m²·s], if the method computes the effort.
    solve_time : float
        Time to optimise it [s], of all starts.
    starts : array, shape (n_starts, 2), or None
        Effort and time [s] of each start, if the method makes several.
    """

    positions: FloatArray
    effort: float | None = None
    solve_time: float = float("nan")
    starts: FloatArray | None = None


Predictor = Callable[[Demonstration, Sequence[Demonstration]], Prediction]
"""Predicts a motion from the others; of the motion only its ends and duration are used."""


@dataclass(frozen=True, eq=False)
class Comparison:
    """Results of every method on every motion.

    Attributes
    ----------
    motions : tuple of Demonstration
        The motions, each of which was left out.
    results : dict of str to array, shape (n_motions, n_quantities)
        By method: the `QUANTITIES`.
    reference : str
        The method that is the planner's default.
    predictions : tuple of dict of str to Prediction
        By motion and method.
    """

    motions: tuple[Demonstration, ...]
    results: dict[str, FloatArray]
    reference: str
    predictions: tuple[Mapping[str, Prediction], ...] = ()

    def column(self, method: str, quantity: str) -> FloatArray:
        """A quantity of each motion, shape (n_motions,)."""
        return self.results[method][:, QUANTITIES.index(quantity)]

    def rms(self, method: str, quantity: str) -> float:
        """RMS over the motions."""
        return float(np.sqrt(np.mean(self.column(method, quantity) ** 2)))

    def effort_ratio(self, method: str) -> float:
        """Median effort as a multiple of that of B-splines."""
        return float(np.median(self.column(method, "effort") / self.column(BSPLINES, "effort")))

    def interval(self, method: str, quantity: str) -> tuple[float, float]:
        """95 % bootstrap interval of a method's RMS less that of the reference.

        Above zero: the reference is nearer to the motions.
        """
        from scipy.stats import bootstrap  # imported late, because the import is slow

        def difference(other: FloatArray, ours: FloatArray, axis: int) -> FloatArray:
            """Difference of the RMS of two methods, given squares."""
            return np.asarray(np.sqrt(other.mean(axis=axis)) - np.sqrt(ours.mean(axis=axis)))

        found = bootstrap(
            [self.column(name, quantity) ** 2 for name in (method, self.reference)],
            difference,
            n_resamples=2000,
            paired=True,
            method="percentile",
            random_state=np.random.default_rng(1),
        )
        low, high = found.confidence_interval
        return float(low), float(high)


def compare(
    motions: Sequence[Demonstration],
    groups: Sequence[str] | None = None,
    *,
    robot: Robot | None = None,
    tip: str | None = None,
    options: PrimitiveOptions = _OPTIONS,
    more: Mapping[str, Predictor] | None = None,
    progress: Callable[[int, int], None] | None = None,
) -> Comparison:
    """Leave out and predict each motion in turn.

    Parameters
    ----------
    motions :
        Motions of the same joints, at least three.
    groups :
        Group of each motion; predictions use the other groups only. By default each motion is a
        group.
    robot :
        Model of the joints; without it nothing is planned.
    tip :
        Frame at the end of the arm.
    options :
        How primitives are built.
    more :
        Further methods by name.
    progress :
        Called with motions done and in all.

    Raises
    ------
    PrimitiveError
        If there are too few motions, or no primitive can be built from those that are left.
    """
    labels = list(range(len(motions))) if groups is None else list(groups)
    if len(set(labels)) < 2 or len(motions) < 3:
        raise PrimitiveError(
            f"naturalness is measured on at least 3 motions of 2 groups, got {len(motions)} of "
            f"{len(set(labels))}"
        )
    rows: dict[str, list[FloatArray]] = {}
    every: list[dict[str, Prediction]] = []
    for i, motion in enumerate(motions):
        others = [m for m, label in zip(motions, labels, strict=True) if label != labels[i]]
        primitive = build_primitive(others, "others", options)
        predictions = _predictions(motion, primitive, robot)
        predictions |= {name: predict(motion, others) for name, predict in (more or {}).items()}
        every.append(predictions)
        for name, prediction in predictions.items():
            row = _quantities(prediction, motion, primitive, robot, tip)
            rows.setdefault(name, []).append(row)
        if progress is not None:
            progress(i + 1, len(motions))
    reference = EXPECTED if robot is None else PLANNED
    results = {name: np.array(values) for name, values in rows.items()}
    return Comparison(tuple(motions), results, reference, tuple(every))


def _predictions(
    motion: Demonstration, primitive: MovementPrimitive, robot: Robot | None
) -> dict[str, Prediction]:
    """Predictions by minimum jerk, by the primitive and, with a robot, by the planner."""
    start, goal = motion.positions[[0, -1]]
    basis = primitive.paced_basis(start, goal, fit_paces(primitive.warps).mean(axis=0))
    ends, mean = motion.positions[[0, -1]], np.zeros(primitive.n_components)
    straight = minimum_jerk_motion(*ends)
    found = {
        MINIMUM_JERK: Prediction(straight),
        MEAN_SHAPE: Prediction(straight + basis.shape(mean, FINE_PHASES)),
        RIDGE: Prediction(straight + basis.shape(_ridge_weights(primitive, motion), FINE_PHASES)),
        EXPECTED: Prediction(expected_motion(primitive, *ends, motion.duration)),
    }
    if robot is not None:
        for name, rho in ((LEAST_EFFORT, 0.0), (PLANNED, NATURAL)):
            found[name] = plan_like(motion, primitive, robot, "pca", rho)
        found[BSPLINES] = plan_like(motion, primitive, robot, "bspline", 0.0)
    return found


def plan_like(
    motion: Demonstration, primitive: MovementPrimitive, robot: Robot, basis: str, rho: float
) -> Prediction:
    """Plan between the ends of a motion with its duration."""
    options = PlannerOptions(basis=basis, naturalness=rho, max_solve_time=10.0)
    unlimited = JointLimits(robot.joint_names, {})
    planner = Planner(robot, [primitive], unlimited, options, collision=False)
    start, goal = (JointState(robot.joint_names, motion.positions[end]) for end in (0, -1))
    plan = planner.plan(JointGoal(goal, motion.duration), start)
    positions, _, _ = plan.motion.evaluate(plan.motion.duration * FINE_PHASES)
    return Prediction(positions, plan.solution.effort_cost, plan.solve_time)


def _ridge_weights(primitive: MovementPrimitive, motion: Demonstration) -> FloatArray:
    """Ridge regression of the weights on the request, penalty from leave-one-out errors."""
    states = primitive.boundary_states
    requests = np.column_stack([states[:, 0], states[:, 3], np.log(primitive.durations)])
    centred = requests - requests.mean(axis=0)
    request = np.concatenate([*motion.positions[[0, -1]], [np.log(motion.duration)]])
    errors, predictions = [], []
    for penalty in np.logspace(-3.0, 3.0, 25) * float(np.sum(centred.var(axis=0))):
        solved = np.linalg.solve(centred.T @ centred + penalty * np.eye(request.size), centred.T)
        # Leave-one-out residuals, from the diagonal of the hat matrix.
        hat = centred @ solved + 1.0 / len(requests)
        residuals = (primitive.weights - hat @ primitive.weights) / (1.0 - np.diag(hat))[:, None]
        errors.append(np.sum(residuals**2))
        share = (request - requests.mean(axis=0)) @ solved + 1.0 / len(requests)
        predictions.append(share @ primitive.weights)
    return np.asarray(predictions[int(np.argmin(errors))])


def _quantities(
    prediction: Prediction,
    motion: Demonstration,
    primitive: MovementPrimitive,
    robot: Robot | None,
    tip: str | None,
) -> FloatArray:
    """All quantities, in their order."""
    positions = prediction.positions
    truth = motion.time_normalised(FINE_PHASES.size)
    distance = effort = np.nan
    if robot is not None and tip is not None:
        there, here = (
            robot.frame_positions(by_path_share(x), [tip])[:, 0] for x in (positions, truth)
        )
        distance = float(np.sqrt(np.mean(np.sum((there - here) ** 2, axis=1))))
    if robot is not None:
        effort = prediction.effort or _effort(positions, motion, robot)
    peak = abs(_peak_phase(positions) - _peak_phase(truth))
    deviation = _deviation(positions, motion, primitive)
    rest = effort, prediction.solve_time, *_highest(positions, motion.duration)
    return np.array([*differences(positions, truth), distance, peak, deviation, *rest])


def differences(prediction: FloatArray, truth: FloatArray) -> FloatArray:
    """RMS differences of a prediction from a motion.

    Parameters
    ----------
    prediction, truth : array, shape (1001, n_joints)
        Positions at the fine phases [rad or m].

    Returns
    -------
    differences : array, shape (3,)
        By the `MEASURES`, in the same order [rad or m].
    """
    return np.array(
        [
            np.sqrt(np.mean((prediction[::10] - truth[::10]) ** 2)),
            _after_alignment(prediction[::2], truth[::10]),
            path_difference(prediction, truth),
        ]
    )


def _after_alignment(prediction: FloatArray, truth: FloatArray) -> float:
    """Least RMS difference over monotone matches of both ends, by dynamic programming."""
    squares = np.mean((truth[:, None] - prediction[None]) ** 2, axis=2)
    sums = np.full(len(prediction), np.inf)
    sums[0] = squares[0, 0]
    for row in squares[1:]:
        sums = row + np.minimum.accumulate(sums)
    return float(np.sqrt(sums[-1] / len(truth)))


def _highest(positions: FloatArray, duration: float) -> tuple[float, float, float]:
    """Largest speed, and largest acceleration and jerk in the first and last tenth."""
    highest = []
    for order, share in ((1, 1.0), (2, 0.1), (3, 0.1)):
        curves = np.abs(np.diff(positions, order, axis=0)) / (duration / 1000.0) ** order
        n = round(share * len(curves))
        highest.append(float(max(curves[:n].max(), curves[-n:].max())))
    return highest[0], highest[1], highest[2]


def _peak_phase(positions: FloatArray) -> float:
    speed = np.linalg.norm(np.gradient(positions, axis=0), axis=1)
    return float(FINE_PHASES[int(speed.argmax())])


def _deviation(positions: FloatArray, motion: Demonstration, primitive: MovementPrimitive) -> float:
    """Deviation of a path from the prediction, in standard deviations of a weight."""
    start, goal = motion.positions[[0, -1]]
    expected = primitive.model.predict(start, goal, motion.duration)
    basis = primitive.basis
    if not basis.n_weights:
        return float("nan")
    straight = start + hermite_functions(PHASES)[:, 3:4] * (goal - start)
    rest = by_path_share(positions) - straight - basis.shape(np.zeros(basis.n_weights), PHASES)
    functions = basis.functions(PHASES).reshape(-1, basis.n_weights)
    weights = np.linalg.lstsq(functions, rest.ravel(), rcond=None)[0] - expected.weights
    return float(np.sqrt(weights @ expected.precision @ weights / basis.n_weights))


def _effort(positions: FloatArray, motion: Demonstration, robot: Robot) -> float:
    """J of a motion given by its positions, differentiated numerically."""
    times = motion.duration * FINE_PHASES
    curve = CubicSpline(times, positions)
    efforts = robot.inverse_dynamics(*(curve(times, order) for order in range(3)))
    return float(trapezoid(np.sum(efforts**2, axis=1), times) / 2.0)


def _errors(comparison: Comparison, method: str) -> str:
    errors = (np.rad2deg(comparison.rms(method, q)) for q in MEASURES)
    return " / ".join(f"{error:.2f}" for error in errors)


def error_table(comparison: Comparison) -> Table:
    """Errors by method, with the interval of their difference from those of the default."""
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


def promp(motion: Demonstration, others: Sequence[Demonstration]) -> Prediction:
    """Mean of a ProMP of all others, conditioned on both ends, at their mean time scaling.

    It learns from re-timed motions, with the covariance of the weights shrunk (Ledoit and Wolf,
    2004): with five to twenty motions the maximum-likelihood one is singular.
    """
    module = require("movement_primitives.promp", "peers", "ProMP; or give --no-peers")
    phases = FINE_PHASES[::10]
    model = module.ProMP(n_dims=motion.n_joints, n_weights_per_dim=10)
    paths = [by_path_share(d.time_normalised(FINE_PHASES.size)) for d in others]
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
    module = require("movement_primitives.dmp", "peers", "DMP; or give --no-peers")
    ends = [d.positions[[0, -1]] for d in others]
    wanted = motion.positions[[0, -1]]
    nearest = others[int(np.argmin([np.sum((e - wanted) ** 2) for e in ends]))]
    times = np.linspace(0.0, motion.duration, _N_DMP_STEPS + 1)
    model = module.DMP(
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


PEERS: dict[str, Predictor] = {"ProMP": promp, "DMP": dmp}


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
    parser.add_argument("--align", default="arc_length")
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
        with progress_bar(label, "motion") as progress:
            comparison = compare(
                motions,
                [d.label for d in motions] if arguments.by_activity else None,
                robot=robot,
                tip=arguments.tip,
                options=PrimitiveOptions(align=arguments.align),
                more={} if arguments.no_peers else PEERS,
                progress=progress,
            )
        methods = [method for method in comparison.results if method != LEAST_EFFORT]
        summary.append([label, str(len(motions)), *(_errors(comparison, m) for m in methods)])
        tables[f"{label}, {len(motions)} motions"] = error_table(comparison)
    title = "RMS error [deg]: in time / after time alignment / in path"
    tables = {title: (["motions", "n", *methods], summary), **tables}
    show(tables, as_json=arguments.json)


if __name__ == "__main__":
    main()
