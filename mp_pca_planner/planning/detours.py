# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""Detours: motions that start from collision-free paths, where descent finds no motion.

A path is a straight line in joint space, or else one of RRT-Connect; without the extra ``ompl``,
two lines that meet at a random via. B-splines lead the primitive's motion along it. The program
then lowers the cost within limits and clearances, as for any other motion.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass

import numpy as np
from scipy.linalg import block_diag

from ..arrays import FloatArray
from ..exceptions import MissingDependencyError
from ..primitives.basis import BSplineBasis, SumBasis
from ..primitives.boundary import hermite_functions
from ..primitives.primitive import MovementPrimitive
from .attempt import Attempt, checked
from .bases import MotionBasis
from .budget import Budget
from .clearance import least_distances
from .constraints import LimitTables
from .fallback import Paths
from .motion import Motion
from .plan import MotionSolution
from .recoveries import Setting
from .request import Request
from .sampling import SamplingOptions, sampled_path
from .setup import Setup
from .starts import StartPoint
from .time_scaling import kinematic_stretch, slowdown
from .unknowns import QuadratureTables


@dataclass(frozen=True)
class DetourOptions:
    """Options of detours.

    Attributes
    ----------
    n_vias : int
        Number of random vias that are tried where there is no search for paths.
    via_spread : float
        Standard deviation of vias from the middle of the motion [rad or m].
    n_paths : int
        Number of searches for paths, with different seeds.
    n_checks : int
        Number of configurations that the first search checks; each further one checks as many more.
    share_of_search : float
        Share of the remaining time for a path, 0 to 1.
    step : float
        Distance between the configurations of a line that are checked [rad or m].
    fine_step : float
        The same where the motion rests at the corners of a path.
    n_control_points : int
        Control points of the B-splines of each joint.
    spread : float
        Deviation of these from the path with the cost of naturalness [rad or m].
    n_phases : int
        Number of points of the path that the B-splines follow.
    min_naturalness : float
        Least weight ρ of deviations from the path. Without it, the program takes too many passes.
    """

    n_vias: int = 40
    via_spread: float = 0.6
    n_paths: int = 4
    n_checks: int = 12_000
    share_of_search: float = 0.9
    step: float = 0.07
    fine_step: float = 0.03
    n_control_points: int = 6
    spread: float = 0.3
    n_phases: int = 80
    min_naturalness: float = 0.02


_OPTIONS = DetourOptions()


@dataclass(frozen=True, eq=False)
class Detour:
    """A start of motions along a collision-free path.

    Attributes
    ----------
    basis : MotionBasis
        The primitive's components and B-splines. The path takes the place of the prediction.
    path : array, shape (n_points, n_joints)
        The path.
    duration : float
        Duration in which the motion along the path keeps the limits of velocity, acceleration and
        jerk [s].
    """

    basis: MotionBasis
    path: FloatArray
    duration: float


class DetourPlanner:
    """Plans motions along detours.

    Parameters
    ----------
    setup : Setup
        Robot, limits and options of the planner.
    solve : callable
        Attempts a request with a setting in the time of a budget.
    """

    def __init__(
        self, setup: Setup, solve: Callable[[Request, Setting, Budget], tuple[Attempt, Setting]]
    ) -> None:
        self._setup, self._solve = setup, solve
        self._finder = DetourFinder(setup)

    @property
    def hint(self) -> str:
        """Which extra is missing for further paths; empty if none."""
        return self._finder.hint

    def may_serve(self, request: Request) -> bool:
        """Whether a request without a motion by descent is tried with detours."""
        collision = self._setup.collision
        return collision is not None and bool(collision.pairs) and not request.n_vias

    def better(
        self, failed: Attempt, request: Request, budget: Budget, paths: Paths
    ) -> tuple[Attempt, bool]:
        """The best motion along a detour, or the failed attempt if there is none.

        If no motion keeps the limits, a path that was found is added to `paths`. Returns also
        whether the search for paths was complete, so that more descent is of no use.
        """
        # Collisions of a motion outside the limits are not known yet.
        met = failed.collisions or failed.has_clearances
        if failed.is_hopeless or not (met or self._setup.collisions(failed.trajectory)):
            return failed, False
        best, path = failed, None
        for detour in self._finder.detours(request, budget):
            path = detour.path if path is None else path
            tried = self._attempt(request, detour, budget)
            if tried.violation < best.violation:
                best = tried
            if best.is_valid or budget.is_over():
                break
        if path is not None and not best.is_valid:
            paths[id(request.goal)] = self._finder.corners(path)
        return best, not self.hint

    def _attempt(self, request: Request, detour: Detour, budget: Budget) -> Attempt:
        """The motion of least cost near a path, or else the one along it."""
        duration = request.usual_duration
        if request.duration_is_free:
            duration = max(duration, detour.duration)
        along = self._along(request, detour.basis, duration)
        if request.duration_is_free and along.check.violations:
            duration *= slowdown(along.check)
            along = self._along(request, detour.basis, duration)
        if budget.is_over():
            return along
        naturalness = max(self._setup.options.naturalness, _OPTIONS.min_naturalness)
        setting = Setting(detour.basis, duration, naturalness, is_first=True)
        found, _ = self._solve(request, setting, budget)
        if found.check.violations and request.duration_is_free:
            # A little slower, the same path keeps the limits.
            slower = found.duration * slowdown(found.check)
            found = self._along(request, detour.basis, slower, found.motions[0].weights)
        return min(found, along, key=lambda one: one.violation)

    def _along(
        self,
        request: Request,
        basis: MotionBasis,
        duration: float,
        weights: FloatArray | None = None,
    ) -> Attempt:
        """The motion of some weights, or else that along a path, without optimisation."""
        weights = basis.expected if weights is None else weights
        motion = Motion(request.start, request.goal, duration, basis.basis, weights)
        solution, phases = MotionSolution.unknown(), (1.0,) * len(request.conditions)
        return checked(self._setup, request, (basis,), (motion,), solution, phases)


class DetourFinder:
    """Finds detours for the requests of one planner.

    Parameters
    ----------
    setup : Setup
        Robot, limits and options of the planner, with a collision model.

    Attributes
    ----------
    hint : str
        Which extra would help if no path was found; empty if none.
    """

    def __init__(self, setup: Setup) -> None:
        self._setup, self.hint = setup, ""
        self._followers: dict[str, PathFollower] = {}

    def detours(self, request: Request, budget: Budget) -> Iterator[Detour]:
        """Detours along different paths, the cheapest to find first.

        Parameters
        ----------
        request : Request
            A request without vias.
        budget : Budget
            The time for all of it.
        """
        primitive = request.primitive
        if primitive.name not in self._followers:
            self._followers[primitive.name] = PathFollower(primitive, self._setup)
        follower = self._followers[primitive.name]
        for path in self._paths(request, budget):
            yield follower.detour(request, path)

    def _paths(self, request: Request, budget: Budget) -> Iterator[FloatArray]:
        """Collision-free paths, shape (n_points, n_joints)."""
        collision, limits = self._setup.collision, self._setup.limits
        assert collision is not None
        bounds = limits.lower, limits.upper
        ends = request.start.positions, request.goal.positions
        if _is_free(collision.collides, *ends, _OPTIONS.step):
            yield np.array(ends)
        collides = collision.check(least_distances(np.array(ends), collision))
        for seed in range(1, _OPTIONS.n_paths + 1):
            search = budget.share(_OPTIONS.share_of_search)
            # Few searches take far longer than most: another seed is often faster.
            n_checks = _OPTIONS.n_checks * seed
            options = SamplingOptions(seed, _OPTIONS.step, max_checks=n_checks)
            try:
                path = sampled_path(collides, bounds, ends, options, search.is_over)
            except MissingDependencyError as error:
                self.hint = str(error)
                yield from paths_by_vias(collides, bounds, ends, budget.is_over)
                return
            if path is not None:
                yield path
            elif search.is_over():
                return

    def corners(self, path: FloatArray) -> FloatArray:
        """The points of a path between which straight lines are free of collisions."""
        assert self._setup.collision is not None
        kept = [0]
        while kept[-1] < len(path) - 1:
            here, k = path[kept[-1]], len(path) - 1
            while k > kept[-1] + 1 and not _is_free(
                self._setup.collision.collides, here, path[k], _OPTIONS.fine_step
            ):
                k -= 1
            kept.append(k)
        return path[kept]


class PathFollower:
    """Motions of a primitive along paths.

    Parameters
    ----------
    primitive : MovementPrimitive
        The primitive.
    setup : Setup
        Robot, limits and options of the planner.
    """

    def __init__(self, primitive: MovementPrimitive, setup: Setup) -> None:
        self._primitive, self._limits = primitive, setup.limits
        self._margin = setup.options.search.scaling_margin
        splines = BSplineBasis(primitive.n_joints, _OPTIONS.n_control_points)
        self._basis = SumBasis(primitive.basis, splines, _OPTIONS.spread)
        self._tables = QuadratureTables(self._basis, setup.options.n_nodes)
        self._limit_tables = LimitTables(self._tables)
        self._phases = np.linspace(0.0, 1.0, _OPTIONS.n_phases)[1:-1]
        # All joints have the same splines.
        of_one_joint = splines.functions(self._phases)[:, 0, : _OPTIONS.n_control_points]
        self._fit = np.linalg.pinv(of_one_joint)
        self._n_splines = splines.n_weights

    def detour(self, request: Request, path: FloatArray) -> Detour:
        """The motion of the expected weights, led along a path by the B-splines."""
        expected = np.append(request.expected.weights, np.zeros(self._n_splines))
        line = Motion(request.start, request.goal, request.usual_duration, self._basis, expected)
        s = self._phases
        lengths = np.append(0.0, np.cumsum(np.linalg.norm(np.diff(path, axis=0), axis=1)))
        # Minimum jerk along the path.
        along = lengths[-1] * (10.0 * s**3 - 15.0 * s**4 + 6.0 * s**5)
        points = np.stack([np.interp(along, lengths, q) for q in path.T], axis=1)
        off = points - line.evaluate(s * line.duration)[0]
        weights = expected.copy()
        weights[request.expected.weights.size :] = (self._fit @ off).T.ravel()
        precision = block_diag(
            request.expected.precision, np.eye(self._n_splines) / _OPTIONS.spread**2
        )
        basis = MotionBasis(
            self._tables,
            self._limit_tables,
            weights,
            precision,
            (StartPoint(weights),),
            self._primitive.n_components,
            is_detour=True,
        )
        return Detour(basis, path, self._least_duration(line.boundary, weights))

    def _least_duration(self, boundary: FloatArray, weights: FloatArray) -> float:
        """Shortest duration within the limits of velocity, acceleration and jerk [s]."""
        s = np.append(0.0, np.append(self._phases, 1.0))
        shapes = self._basis.shapes(weights, s, 3)
        # By phase, which is by time in a duration of 1 s.
        rates = [hermite_functions(s, d) @ boundary + shapes[d] for d in (1, 2, 3)]
        return self._margin * kinematic_stretch(self._limits, np.array(rates))


def paths_by_vias(
    collides: Callable[[FloatArray], bool],
    bounds: tuple[FloatArray, FloatArray],
    ends: tuple[FloatArray, FloatArray],
    should_stop: Callable[[], bool] = lambda: False,
) -> Iterator[FloatArray]:
    """Collision-free paths of two straight lines in joint space that meet at a random via.

    The same vias are drawn in every call.

    Parameters
    ----------
    collides : callable
        Whether a configuration is in collision.
    bounds : tuple of (array, shape (n_joints,))
        Least and largest positions.
    ends : tuple of (array, shape (n_joints,))
        Start and goal.
    should_stop : callable
        Whether to end the search.

    Yields
    ------
    path : array, shape (3, n_joints)
        Start, via and goal.
    """
    rng, middle = np.random.default_rng(0), 0.5 * (ends[0] + ends[1])
    for _ in range(_OPTIONS.n_vias):
        if should_stop():
            return
        off = _OPTIONS.via_spread * rng.standard_normal(middle.size)
        via = np.clip(middle + off, *bounds)
        if all(_is_free(collides, end, via, _OPTIONS.step) for end in ends):
            yield np.array([ends[0], via, ends[1]])


def _is_free(
    collides: Callable[[FloatArray], bool], start: FloatArray, goal: FloatArray, step: float
) -> bool:
    """Whether a straight line is free of collisions, coarsely first."""
    n = 1 + int(np.ceil(np.linalg.norm(goal - start) / step))
    shares = np.linspace(0.0, 1.0, n + 1)
    order = np.concatenate([shares[first::8] for first in (4, 0, 2, 6, 1, 3, 5, 7)])
    return not any(collides(start + share * (goal - start)) for share in order)
