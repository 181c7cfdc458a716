# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""The movement primitive: a mean shape, its principal components, and their statistics."""

from __future__ import annotations

import warnings
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields
from importlib import import_module
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ..arrays import FloatArray, check_number
from ..exceptions import GoalError, PrimitiveError, printable, quote_names
from ..input_limits import INPUT_LIMITS
from ..motion.goal import StateLike, joint_positions
from ..motion.interpolation import boundary_values, hermite_functions, quintics
from ..motion.trajectory import Trajectory
from .basis import Basis, PacedBasis, PolynomialBasis
from .differences import FINE_PHASES, expected_motion, path_difference
from .in_span import UNUSUAL_IN_SPAN_SCORE
from .prediction import FREEDOM, ConditionalDistribution, ConditionalModel
from .timing import aligned_phases, time_scaling

if TYPE_CHECKING:
    from ..recordings.demonstration import Demonstration
    from ..recordings.recording_set import RecordingSet


COUPLINGS = ("joint", "arm")

_MAX_DRAWS = 10_000
# Motions of which the errors of left-out ones are uncertain, if there are fewer.
_FEW = 10
# Joints hardly turn further [rad]: more looks like degrees, as in demonstrations.
_MAX_ANGLE = 12.0


@dataclass(frozen=True, eq=False)
class MovementPrimitive:
    """A motion basis learned from demonstrations, with the statistics of their weights.

    A motion is q(s) = h(s) + μ(s) + Σ wₖ φₖ(s), see :mod:`.basis`.

    Attributes
    ----------
    name : str
        Name of the primitive.
    joint_names : sequence of str
        The n_joints joints.
    coupling : {'joint', 'arm'}
        Whether each component moves one joint ([P]) or all of them.
    metadata : mapping
        More facts, of JSON types: options, provenance, repairs.
    mean_coefficients : array, shape (n_joints, degree + 1)
        Legendre coefficients of μ [rad or m].
    component_coefficients : array, shape (n_components, n_joints, degree + 1)
        Legendre coefficients of the φₖ.
    explained_variance : array, shape (n_components,)
        The λₖ of [P] eq. (1), in decreasing order (joint by joint for coupling 'joint').
    total_variance : array, shape (n_joints,)
        Variance of the shapes of each joint, summed over the phases ([P] eq. (4)).
    weights : array, shape (n_demonstrations, n_components)
        Weights of the demonstrations ([P] eq. (2)).
    boundary_states : array, shape (n_demonstrations, 6, n_joints)
        q, q̇, q̈ of the aligned demonstrations at the start, then at the end; they count as at
        rest there.
    durations : array, shape (n_demonstrations,)
        Their durations [s].
    warps : array, shape (n_demonstrations, n_warp_phases)
        Timing of each: shares of its duration at evenly spaced aligned phases, strictly
        increasing from 0 to 1, see :mod:`.timing`.
    fit_residual : array, shape (n_demonstrations, n_joints)
        RMS difference between each demonstration and its reproduction with its weights and
        its own timing, over the aligned phases [rad or m].
    model : ConditionalModel
        Predicts the weights for a request.

    Examples
    --------
    >>> import mp_pca_planner as mp
    >>> motions = mp.load_demonstrations(mp.write_example_recording("motions.mcap", 6))
    >>> reach = mp.MovementPrimitive.fit(motions, name="reach")
    >>> expected = reach.predict(*motions[0].positions[[0, -1]])
    >>> expected.joint_names
    ('shoulder1', 'shoulder2', 'shoulder3', 'elbow')
    """

    name: str
    joint_names: tuple[str, ...]
    coupling: str
    metadata: Mapping[str, Any]
    mean_coefficients: FloatArray
    component_coefficients: FloatArray
    explained_variance: FloatArray
    total_variance: FloatArray
    weights: FloatArray
    boundary_states: FloatArray
    durations: FloatArray
    warps: FloatArray
    fit_residual: FloatArray
    model: ConditionalModel

    def __post_init__(self) -> None:
        for owner in (self, self.model):
            for field in fields(owner):
                array = getattr(owner, field.name)
                if isinstance(array, np.ndarray):
                    array.flags.writeable = False

    def __repr__(self) -> str:
        return (
            f"MovementPrimitive '{self.name}': {self.n_components} components of "
            f"{len(self.durations)} demonstrations, {self.n_joints} joints, "
            f"usually {np.median(self.durations):.3g} s"
        )

    def __str__(self) -> str:
        facts, words = self.summary(), prediction_words(self)
        rms = np.sqrt(np.mean(self.fit_residual**2))
        own = f"demonstrations: {rms:.3g} {_unit(self)} RMS from their reproductions"
        lines = [repr(self), f"  {own} by the components", *([f"  {words}"] if words else [])]
        for joint in self.joint_names:
            ends = (*facts["starts"][joint], *facts["goals"][joint])
            a, b, c, d = (round(x, 2) + 0.0 for x in ends)  # no minus before zero
            lines.append(
                f"  {printable(joint)}: starts {a:.2f} to {b:.2f}, goals {c:.2f} to {d:.2f}"
            )
        return "\n".join(lines)

    def summary(self) -> dict[str, Any]:
        """What the primitive was learned from, and how well it predicts.

        Returns
        -------
        facts : dict
            `left_out_error` and `minimum_jerk_error`: RMS distance of demonstrations that are left
            out from their prediction by the others, and from the minimum-jerk motion between their
            ends, at equal shares of the path, or of the time with `align` 'linear' [rad or m];
            NaN for one demonstration, and for a refined primitive.
            Whole shapes are predicted, so neither depends on the number of components:
            :meth:`errors` of motions that were held out does. `starts` and `goals`: lowest and
            highest demonstrated position by joint. `durations`: the shortest and the longest [s].
            `n_demonstrations`, `n_components`.
        """
        errors = (self.metadata.get(name) for name in ("left_out_error", "minimum_jerk_error"))
        left_out, straight = (float("nan") if x is None else x for x in errors)
        ends = self.boundary_states[:, [0, 3]]
        ranges = np.stack([ends.min(axis=0), ends.max(axis=0)], axis=-1).tolist()
        starts, goals = (dict(zip(self.joint_names, map(tuple, x), strict=True)) for x in ranges)
        return {
            "n_demonstrations": len(self.durations),
            "n_components": self.n_components,
            "left_out_error": left_out,
            "minimum_jerk_error": straight,
            "starts": starts,
            "goals": goals,
            "durations": (float(self.durations.min()), float(self.durations.max())),
        }

    @classmethod
    def fit(
        cls,
        demonstrations: Sequence[Demonstration] | RecordingSet | Sequence[ArrayLike],
        *,
        times: ArrayLike | Sequence[ArrayLike] | None = None,
        joint_names: Sequence[str] | None = None,
        name: str = "primitive",
        coupling: str = "arm",
        components: int | None = None,
        align: str = "arc_length",
    ) -> MovementPrimitive:
        """Learn a primitive from demonstrations.

        Parameters
        ----------
        demonstrations :
            Demonstrations, as a list or a `RecordingSet`, or the positions of motions
            [rad or m]: arrays of shape (n_samples, n_joints), or one array of shape
            (n_motions, n_samples, n_joints). Tables with named columns, such as DataFrames, are
            arrays. Each array is one motion from rest to rest: arrays are not cut at rests.
        times : array_like, shape (n_samples,), or sequence of these
            Times of the samples [s] where positions are given, one array for all motions or one
            for each.
        joint_names : sequence of str, optional
            Names of the joints where positions are given; the columns of tables, or joint1,
            joint2, … by default. Of tables, these columns are taken. A planner needs the names
            of the robot description.
        name : str
            Name of the primitive.
        coupling : {'arm', 'joint'}
            One PCA of all joints, or one for each joint as in [P], with far more weights.
        components : int, optional
            Components to keep (of each joint for coupling 'joint'); by default as few as explain
            99 % of the variance. :func:`.build_primitive` accepts other shares.
        align : {'arc_length', 'linear'}
            Whether equal shares of the path or of the time are compared, see
            :func:`.arc_length_warp`. All motions count as starting and ending at rest.

        Raises
        ------
        PrimitiveError
            If there is no demonstration, something else is among them, their joints differ, nothing
            moves, an option is unknown or out of its range, or positions seem to be in degrees.
        RecordingError
            If the arrays can't be used.

        Warns
        -----
        UserWarning
            If there is a single demonstration. Once if arrays begin or end faster than a fifth
            of their peak speed, and once if their times look like milliseconds.

        Examples
        --------
        >>> import numpy as np
        >>> import mp_pca_planner as mp
        >>> t = np.linspace(0.0, 1.0, 51)
        >>> rise = 10 * t**3 - 15 * t**4 + 6 * t**5
        >>> reaches = [np.column_stack([a * rise, a * rise**2]) for a in (0.5, 1.0, 1.5)]
        >>> names = ["shoulder", "elbow"]
        >>> mp.MovementPrimitive.fit(reaches, times=t, joint_names=names, name="reach")
        MovementPrimitive 'reach': 1 components of 3 demonstrations, 2 joints, usually 1 s
        """
        from .build import PrimitiveOptions, as_demonstrations, build_primitive

        options = PrimitiveOptions(coupling=coupling, n_components=components, align=align)
        several, sentences = as_demonstrations(demonstrations, times, joint_names)
        for sentence in sentences:  # from the line of the caller
            warnings.warn(sentence, stacklevel=2)
        primitive = build_primitive(several, name, options)
        if len(several) == 1:
            warnings.warn(
                f"primitive '{name}': one demonstration says nothing about variation, so its "
                "samples equal its predictions and its expected error is unknown",
                stacklevel=2,
            )
        return primitive

    def errors(
        self,
        demonstrations: Sequence[Demonstration] | RecordingSet | Sequence[ArrayLike],
        *,
        times: ArrayLike | Sequence[ArrayLike] | None = None,
    ) -> FloatArray:
        """How far predictions are from motions that the primitive was not learned from.

        Each motion is predicted from its ends and its duration. Both paths are compared at equal
        shares of their length, so the timing does not count.

        Parameters
        ----------
        demonstrations, times :
            As of :meth:`fit`, with the joints of the primitive.

        Returns
        -------
        errors : array, shape (n_demonstrations,)
            RMS difference of each path over its length and all joints [rad or m].

        Raises
        ------
        PrimitiveError
            If a motion has other joints, or something else is among them.
        RecordingError
            If the arrays can't be used.

        Examples
        --------
        >>> import mp_pca_planner as mp
        >>> motions = mp.load_demonstrations(mp.write_example_recording("motions.mcap"))
        >>> reach = mp.MovementPrimitive.fit(motions[:60])
        >>> errors = reach.errors(motions[60:])
        >>> errors.shape
        (19,)
        """
        from .build import as_demonstrations

        several, _ = as_demonstrations(demonstrations, times, self.joint_names)
        errors = []
        for motion in several:
            if motion.joint_names != self.joint_names:
                raise PrimitiveError(
                    f"a motion of '{motion.recording}' has the joints "
                    f"{quote_names(motion.joint_names)}, not those of primitive '{self.name}', "
                    f"{quote_names(self.joint_names)}, in this order"
                )
            truth = motion.time_normalised(FINE_PHASES.size)
            start, goal = motion.positions[[0, -1]]
            expected = expected_motion(self, start, goal, motion.duration)
            errors.append(path_difference(expected, truth))
        return np.array(errors)

    def predict(
        self, start: StateLike, goal: StateLike, duration: float | None = None
    ) -> Trajectory:
        """The expected motion from rest to rest, without regard to limits.

        Limits of a robot are not considered: the planner does that. A request far from the
        demonstrations (in-span score above 3) gives a warning (`UserWarning`) with its score.

        Parameters
        ----------
        start, goal : JointState, mapping or array, shape (n_joints,)
            End points [rad or m]. Joints that the goal doesn't name keep their position.
        duration : float, optional
            Duration [s]; the expected one unless given.

        Raises
        ------
        GoalError
            If an end point is none of these or not finite, or the duration is out of its range.
        """
        ends, expected = self._predicted(start, goal, duration)
        _warn_if_unusual(self.name, expected.in_span_score, ends)
        return self._motion(ends, expected, expected.weights)

    def in_span_score(
        self, start: StateLike, goal: StateLike, duration: float | None = None
    ) -> float:
        """Distance of a request from the demonstrations: about 1 is typical, above 3 unlike them.

        The predictions of requests far from the demonstrations may look unlike these.

        Parameters
        ----------
        start, goal, duration :
            As of :meth:`predict`; without a duration, only the end points count.

        Raises
        ------
        GoalError
            See :meth:`predict`.
        """
        return self._predicted(start, goal, duration)[1].in_span_score

    def sample(self, n: int, start: StateLike, goal: StateLike, seed: int = 0) -> list[Trajectory]:
        """Draw motions from the conditional distribution of a request.

        Weights are drawn from a Student's t distribution. All motions have the same, expected
        duration and time scaling. It warns as :meth:`predict` does.

        Parameters
        ----------
        n : int
            Number of motions.
        start, goal : JointState, mapping or array, shape (n_joints,)
            End points [rad or m]. Joints that the goal doesn't name keep their position.
        seed : int
            Seed of the random numbers.

        Raises
        ------
        GoalError
            If an end point is none of these or not finite, or `n` or `seed` is no whole number of
            at least 0; at most 10,000 motions.
        """
        check_number(n, "the number of motions", GoalError, 0, _MAX_DRAWS, is_whole=True)
        check_number(seed, "the seed", GoalError, 0, is_whole=True)
        ends, expected = self._predicted(start, goal, None)
        _warn_if_unusual(self.name, expected.in_span_score, ends)
        covariance = expected.variance * expected.covariance
        rng = np.random.default_rng(seed)
        errors = np.zeros((n, len(covariance)))
        if errors.size:  # a primitive of one demonstration has no components
            errors = rng.multivariate_normal(errors[0], covariance, n)
        errors *= np.sqrt((FREEDOM - 2.0) / rng.chisquare(FREEDOM, (n, 1)))
        return [self._motion(ends, expected, expected.weights + error) for error in errors]

    def _predicted(
        self, start: StateLike, goal: StateLike, duration: float | None
    ) -> tuple[FloatArray, ConditionalDistribution]:
        """End points, shape (2, n_joints), and the prediction for them."""
        first = joint_positions(start, self.joint_names, "the start")
        last = joint_positions(goal, self.joint_names, "the goal", first)
        ends, limit = np.array([first, last]), INPUT_LIMITS.position
        for position in ends.flat:
            check_number(position, "a position of the start or the goal", GoalError, -limit, limit)
        if duration is not None:
            check_number(duration, "the duration [s]", GoalError, 1e-3, INPUT_LIMITS.duration)
        expected, longest = self.model.predict(first, last, duration), INPUT_LIMITS.duration
        check_number(expected.duration, "the predicted duration [s]", GoalError, 0.0, longest)
        return ends, expected

    def _motion(
        self, ends: FloatArray, expected: ConditionalDistribution, weights: FloatArray
    ) -> Trajectory:
        """A motion with points at most 10 ms apart, as the planner's by default."""
        duration, rest = expected.duration, np.zeros(self.n_joints)
        phases = np.linspace(0.0, 1.0, max(int(np.ceil(duration / 0.01)), 1) + 1)
        boundary = boundary_values((ends[0], rest, rest), (ends[1], rest, rest), duration)
        shapes = self.paced_basis(ends[0], ends[1], expected.pace).shapes(weights, phases, 2)
        scales = duration ** np.arange(3.0)[:, None, None]
        q, v, a = (quintics(phases, boundary, 2) + shapes) / scales
        # A controller refuses a final velocity of 1e-17.
        q[[0, -1]], v[[0, -1]], a[[0, -1]] = ends, 0.0, 0.0
        return Trajectory(self.joint_names, duration * phases, q, v, a)

    def save(self, path: str | Path, *, overwrite: bool = False) -> None:
        """Write the primitive to a file, see :func:`.save_primitive`."""
        from .file import save_primitive

        save_primitive(self, path, overwrite=overwrite)

    @classmethod
    def load(cls, path: str | Path) -> MovementPrimitive:
        """Read a primitive from a file, see :func:`.load_primitive`."""
        from .file import load_primitive

        return load_primitive(path)

    def plot(self) -> Any:
        """Plot demonstrations and components in a new pyplot figure; return the array of its Axes.

        ``plt.savefig("primitive.png")`` writes it.
        """
        figures = import_module("..plotting.primitive", __package__)
        return figures.plot_primitive(self)

    @property
    def n_joints(self) -> int:
        """Number of joints."""
        return len(self.joint_names)

    @property
    def n_components(self) -> int:
        """Number of components, that is, of weights."""
        return len(self.component_coefficients)

    @property
    def degree(self) -> int:
        """Degree of the polynomials."""
        return int(self.mean_coefficients.shape[1]) - 1

    @property
    def basis(self) -> PolynomialBasis:
        """The basis functions by aligned phase."""
        return PolynomialBasis(
            self.mean_coefficients, self.component_coefficients, np.sqrt(self.explained_variance)
        )

    def paced_basis(self, start: FloatArray, goal: FloatArray, pace: FloatArray) -> Basis:
        """The basis for motions between two positions, shape (n_joints,), at a time scaling."""
        if not np.any(pace):
            return self.basis
        return PacedBasis(self.basis, goal - start, time_scaling(pace))

    @property
    def joint_of_component(self) -> tuple[int, ...]:
        """Which joint each component moves; only for coupling 'joint'."""
        magnitude = np.abs(self.component_coefficients).max(axis=2, initial=0.0)
        return tuple(int(j) for j in magnitude.argmax(axis=1))

    @property
    def explained_variance_ratio(self) -> dict[str, list[float]]:
        """λₖ as a share of the variance, [P] eq. (5), by joint name or under 'arm'."""
        if self.coupling == "arm":
            total = float(self.total_variance.sum())
            return {"arm": [float(v) / total for v in self.explained_variance]}
        shares: dict[str, list[float]] = {name: [] for name in self.joint_names}
        for variance, joint in zip(self.explained_variance, self.joint_of_component, strict=True):
            shares[self.joint_names[joint]].append(float(variance / self.total_variance[joint]))
        return shares

    def expected_error(
        self, start: StateLike, goal: StateLike, duration: float | None = None
    ) -> float:
        """RMS difference in path between the prediction and what would be demonstrated.

        A plan states it as `expected_error`, for its ends and its duration.

        Parameters
        ----------
        start, goal, duration :
            As of :meth:`predict`.

        Returns
        -------
        error : float
            Over the phases and the joints [rad or m]; NaN for a primitive of one demonstration,
            which says nothing about its errors.

        Raises
        ------
        GoalError
            See :meth:`predict`.

        Examples
        --------
        >>> import numpy as np
        >>> import mp_pca_planner as mp
        >>> t = np.linspace(0.0, 1.0, 51)
        >>> rise = 10 * t**3 - 15 * t**4 + 6 * t**5
        >>> lifts = [np.column_stack([a * rise, a * rise**2]) for a in (0.5, 1.0, 1.5)]
        >>> reach = mp.MovementPrimitive.fit(lifts, times=t)
        >>> reach.expected_error([0.0, 0.0], [0.8, 0.8]) < 0.1
        True
        """
        return self.prediction_error(self._predicted(start, goal, duration)[1])

    def prediction_error(self, expected: ConditionalDistribution) -> float:
        """What :meth:`expected_error` returns, for a prediction of the model."""
        if len(self.durations) < 2:
            return float("nan")
        n_components, n_joints, n_functions = self.component_coefficients.shape
        series = self.component_coefficients / np.sqrt(2.0 * np.arange(n_functions) + 1.0)
        rows = series.reshape(n_components, n_joints * n_functions)
        square = expected.variance * float(np.sum((rows @ rows.T) * expected.covariance))
        return float(np.sqrt(square / n_joints + np.mean(self.fit_residual**2)))

    def nearest_demonstrations(self, ends: FloatArray) -> NDArray[np.intp]:
        """Indices of the demonstrations by the distance of their ends from given ones.

        Parameters
        ----------
        ends : array, shape (2, n_joints)
            Start and goal [rad or m]; distances are in units of the demonstrations' spread.
        """
        demonstrated = self.boundary_states[:, [0, 3]]
        spread = demonstrated.std(axis=0) + 1e-3  # bounds the weight of a joint that never moved
        return np.argsort(np.sum(((demonstrated - ends) / spread) ** 2, axis=(1, 2)))

    def reproduction(self, demonstration: int, times: FloatArray) -> FloatArray:
        """Positions of a demonstration as its weights and its own timing reproduce it.

        Parameters
        ----------
        demonstration : int
            Index of the demonstration.
        times : array, shape (n_steps,)
            Times from 0 to its duration [s].
        """
        duration = float(self.durations[demonstration])
        phases = aligned_phases(self.warps[demonstration], times / duration)
        state = self.boundary_states[demonstration]
        boundary = boundary_values(tuple(state[:3]), tuple(state[3:]), duration)
        return np.asarray(
            hermite_functions(phases) @ boundary
            + self.basis.shape(self.weights[demonstration], phases)
        )


def _warn_if_unusual(name: str, score: float, ends: FloatArray) -> None:
    """Warn the caller of a method of a primitive if a request is far from its demonstrations."""
    if score > UNUSUAL_IN_SPAN_SCORE:
        is_far = np.abs(ends).max() > _MAX_ANGLE
        question = ": are these degrees? Positions are in radians (or m)" if is_far else ""
        warnings.warn(
            f"the request is unlike the demonstrations of '{name}' (in-span score {score:.1f}, "
            f"about 1 is usual), so the motion may look unlike them{question}",
            stacklevel=3,
        )


def prediction_words(primitive: MovementPrimitive) -> str:
    """How near left-out motions are to their predictions; empty where that is unknown."""
    facts, n = primitive.summary(), len(primitive.durations)
    left_out, straight = facts["left_out_error"], facts["minimum_jerk_error"]
    if not left_out >= 0.0:
        return ""
    nearer = 1.0 - left_out / straight if straight > 0.0 else 0.0
    much = f"{nearer:.0%}" if nearer >= 0.1 else "barely"
    advice = "" if nearer >= 0.1 else ": show more demonstrations, of one kind"
    if n < _FEW:
        advice = f"; {n} motions give an uncertain estimate: record ten to thirty"
    return (
        f"left-out motions: {left_out:.3g} {_unit(primitive)} RMS from their predictions (for any "
        f"number of components), {much} nearer than minimum-jerk motions ({straight:.3g}){advice}"
    )


def _unit(primitive: MovementPrimitive) -> str:
    """Unit of values of all joints; only a robot description says which are prismatic."""
    return "rad or m" if primitive.metadata.get("prismatic_joints") else "rad"
