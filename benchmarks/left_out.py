# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""Differences between demonstrated motions and motions planned from their ends and duration.

Every motion is predicted from the others (all others, or those of other activities), by the planner
with several naturalness weights ρ and by other methods. There are no joint limits, so that only the
methods are compared.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from scipy.integrate import trapezoid
from scipy.interpolate import CubicSpline

from mp_pca_planner.arrays import FloatArray
from mp_pca_planner.exceptions import PrimitiveError
from mp_pca_planner.motion.goal import JointGoal, JointState
from mp_pca_planner.motion.interpolation import hermite_functions
from mp_pca_planner.planning.options import PlannerOptions
from mp_pca_planner.planning.planner import Planner
from mp_pca_planner.planning.request import NATURAL
from mp_pca_planner.primitives.build import PrimitiveOptions, build_primitive
from mp_pca_planner.primitives.differences import (
    FINE_PHASES,
    PHASES,
    by_way,
    expected_motion,
    minimum_jerk_motion,
    path_difference,
)
from mp_pca_planner.primitives.primitive import MovementPrimitive
from mp_pca_planner.primitives.timing import fit_paces
from mp_pca_planner.recordings.demonstration import Demonstration
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

DEFAULT_RHO = NATURAL
RHOS = (0.0, 0.01, 0.03, 0.1, 0.3)
"""Naturalness weights that are compared with the default."""

MINIMUM_JERK, MEAN_SHAPE, RIDGE = "minimum-jerk", "mean shape", "ridge regression"
EXPECTED, BSPLINES = "expected (ρ = ∞)", "least-effort B-splines"

_OPTIONS = PrimitiveOptions()


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


def planned(rho: float) -> str:
    """Name of the planner's method with a naturalness ρ."""
    return f"planned, ρ = {rho:g}"


def compare(
    motions: Sequence[Demonstration],
    groups: Sequence[str] | None = None,
    *,
    robot: Robot | None = None,
    tip: str | None = None,
    options: PrimitiveOptions = _OPTIONS,
    rhos: Sequence[float] = RHOS,
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
    rhos :
        Naturalness weights to plan with beside the default.
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
        predictions = _predictions(motion, primitive, robot, rhos)
        predictions |= {name: predict(motion, others) for name, predict in (more or {}).items()}
        every.append(predictions)
        for name, prediction in predictions.items():
            row = _quantities(prediction, motion, primitive, robot, tip)
            rows.setdefault(name, []).append(row)
        if progress is not None:
            progress(i + 1, len(motions))
    reference = EXPECTED if robot is None else planned(DEFAULT_RHO)
    results = {name: np.array(values) for name, values in rows.items()}
    return Comparison(tuple(motions), results, reference, tuple(every))


def _predictions(
    motion: Demonstration, primitive: MovementPrimitive, robot: Robot | None, rhos: Sequence[float]
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
        for rho in sorted({*rhos, DEFAULT_RHO}):
            found[planned(rho)] = plan_like(motion, primitive, robot, "pca", rho)
        found[BSPLINES] = plan_like(motion, primitive, robot, "bspline", 0.0)
    return found


def plan_like(
    motion: Demonstration, primitive: MovementPrimitive, robot: Robot, basis: str, rho: float
) -> Prediction:
    """Plan between the ends of a motion with its duration."""
    options = PlannerOptions(basis=basis, naturalness=rho, max_solve_time=10.0)
    unlimited = JointLimits(robot.joint_names, {})
    planner = Planner(robot, [primitive], unlimited, options)
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
        there, here = (robot.frame_positions(by_way(x), [tip])[:, 0] for x in (positions, truth))
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
    rest = by_way(positions) - straight - basis.shape(np.zeros(basis.n_weights), PHASES)
    functions = basis.functions(PHASES).reshape(-1, basis.n_weights)
    weights = np.linalg.lstsq(functions, rest.ravel(), rcond=None)[0] - expected.weights
    return float(np.sqrt(weights @ expected.precision @ weights / basis.n_weights))


def _effort(positions: FloatArray, motion: Demonstration, robot: Robot) -> float:
    """J of a motion given by its positions, differentiated numerically."""
    times = motion.duration * FINE_PHASES
    curve = CubicSpline(times, positions)
    efforts = robot.inverse_dynamics(*(curve(times, order) for order in range(3)))
    return float(trapezoid(np.sum(efforts**2, axis=1), times) / 2.0)
