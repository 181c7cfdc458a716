# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""Detours: motions that start from collision-free paths, where descent finds no motion.

B-splines lead the primitive's motion along a path of :mod:`.paths`. The program then lowers the
cost within limits and clearances, as for any other motion.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from functools import partial

import numpy as np
from scipy.linalg import block_diag

from ..arrays import FloatArray
from ..primitives.basis import BSplineBasis, SumBasis
from ..primitives.boundary import quintics
from ..primitives.primitive import MovementPrimitive
from .attempt import Attempt, checked
from .bases import MotionBasis
from .budget import Budget
from .constraints import LimitTables
from .fallback import Paths
from .motion import Motion
from .paths import PathFinder
from .plan import DEMONSTRATED, FREE, MotionSolution
from .recoveries import Setting
from .request import Request
from .setup import Setup
from .starts import StartPoint
from .time_scaling import kinematic_stretch, slowdown
from .unknowns import QuadratureTables


@dataclass(frozen=True)
class DetourOptions:
    """Options of detours.

    Attributes
    ----------
    n_control_points : int
        Control points of the B-splines of each joint.
    spread : float
        Deviation of these from the path with the cost of naturalness [rad or m].
    n_phases : int
        Number of points of the path that the B-splines follow.
    min_naturalness : float
        Least weight ρ of deviations from the path. Without it, the program takes too many passes.
    shares_of_solving : tuple of float
        Shares of the remaining time for a motion near a path, 0 to 1, in turn until it may be
        executed. The rest is for checks and for other paths.
    """

    n_control_points: int = 6
    spread: float = 0.3
    n_phases: int = 80
    min_naturalness: float = 0.005
    shares_of_solving: tuple[float, ...] = (0.2, 0.8)


_OPTIONS = DetourOptions()


@dataclass(frozen=True, eq=False)
class Detour:
    """A start of motions along a collision-free path.

    Attributes
    ----------
    basis : MotionBasis
        The primitive's components and B-splines. The path takes the place of the prediction.
    duration : float
        Duration in which the motion along the path keeps the limits of velocity, acceleration and
        jerk [s].
    """

    basis: MotionBasis
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
        self._finder = PathFinder(setup)
        self._followers: dict[str, PathFollower] = {}

    @property
    def hint(self) -> str:
        """Which extra is missing for further paths; empty if none."""
        return self._finder.hint

    def may_serve(self, request: Request) -> bool:
        """Whether a request without a motion by descent is tried with detours."""
        collision = self._setup.collision
        return collision is not None and bool(collision.pairs) and not request.n_vias

    def may_help(self, request: Request, failed: Attempt) -> bool:
        """Whether an attempt failed by collisions between its ends."""
        if failed.is_hopeless or not self.may_serve(request):
            return False
        # Collisions of a motion outside the limits are not known yet.
        return failed.meets_bodies or bool(self._setup.collisions(failed.trajectory))

    def lead_first(self, request: Request, basis: MotionBasis) -> bool:
        """Whether detours are tried before descent from the expected motion.

        They are if that is in collision at a quadrature node: descent from there takes longer than
        a path. It stays nearer to the demonstrations, so it comes first where their timing or
        naturalness is asked for.
        """
        options, collision = self._setup.options, self._setup.collision
        is_natural = options.naturalness >= options.search.near_expected
        if is_natural or options.timing == DEMONSTRATED or not request.duration_is_free:
            return False
        if collision is None or not self.may_serve(request):
            return False
        duration = request.usual_duration
        motion = Motion(request.start, request.goal, duration, basis.basis, basis.expected)
        positions = motion.evaluate(duration * basis.tables.phases)[0]
        return collision.collide_anywhere(positions)

    def attempts(self, request: Request, budget: Budget, paths: Paths) -> Iterator[Attempt]:
        """The best motion along a detour, if there is a path; the search starts when it is needed.

        If no motion keeps the limits, a path that was found is added to `paths`.
        """
        best, path = None, None
        follower = self._follower(request.primitive)
        ends = request.start.positions, request.goal.positions
        for found in self._finder.paths(ends, budget):
            path = found if path is None else path
            tried = self._attempt(request, follower.detour(request, found), budget)
            if best is None or tried.violation < best.violation:
                best = tried
            if best.is_valid or budget.is_over():
                break
        if path is not None and best is not None and not best.is_valid:
            paths[id(request.goal)] = self._finder.corners(path)
        if best is not None:
            yield best

    def _follower(self, primitive: MovementPrimitive) -> PathFollower:
        if primitive.name not in self._followers:
            self._followers[primitive.name] = PathFollower(primitive, self._setup)
        return self._followers[primitive.name]

    def _attempt(self, request: Request, detour: Detour, budget: Budget) -> Attempt:
        """The motion of least cost near a path, or else the one along it."""
        duration, longest = request.usual_duration, self._setup.longest
        if request.duration_is_free:
            at_least = 0.0 if self._setup.options.timing == FREE else duration
            duration = min(max(at_least, detour.duration), longest)
            motion = self._motion(request, detour.basis, duration)
            slower = slowdown(self._setup.check(self._setup.sample([motion])))
            duration = min(duration * slower, longest)
        if budget.is_over():
            return self._along(request, detour.basis, duration)
        naturalness = max(self._setup.options.naturalness, _OPTIONS.min_naturalness)
        setting, along = Setting(detour.basis, duration, naturalness, is_first=True), None
        for share in _OPTIONS.shares_of_solving:
            found = self._near(request, setting, budget.share(share))
            if found.is_valid:
                return found
            along = along or self._along(request, detour.basis, duration)
            if found.solution.converged or budget.is_over():
                break
            start = StartPoint(found.motions[0].weights)
            basis = replace(detour.basis, starts=partial(iter, [start]))
            setting = replace(setting, basis=basis, duration=found.duration)
        assert along is not None
        return min(found, along, key=lambda one: one.violation)

    def _near(self, request: Request, setting: Setting, budget: Budget) -> Attempt:
        """The motion of least cost near a path, slower if it exceeds limits."""
        found, setting = self._solve(request, setting, budget)
        if not (found.check.violations and request.duration_is_free):
            return found
        # A little slower, the same path keeps the limits.
        slower = min(found.duration * slowdown(found.check), self._setup.longest)
        return self._along(request, setting.basis, slower, found.motions[0].weights)

    def _along(
        self,
        request: Request,
        basis: MotionBasis,
        duration: float,
        weights: FloatArray | None = None,
    ) -> Attempt:
        """The motion of some weights, or else that along a path, without optimisation."""
        motion = self._motion(request, basis, duration, weights)
        solution, phases = MotionSolution.unknown(), (1.0,) * len(request.conditions)
        return checked(self._setup, request, (basis,), (motion,), solution, phases)

    @staticmethod
    def _motion(
        request: Request, basis: MotionBasis, duration: float, weights: FloatArray | None = None
    ) -> Motion:
        weights = basis.expected if weights is None else weights
        return Motion(request.start, request.goal, duration, basis.basis, weights)


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
        least = _OPTIONS.min_naturalness
        self._share_of_path = least / max(setup.options.naturalness, least)
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
        # The path is no demonstration: it counts as little at any naturalness.
        of_path = np.eye(self._n_splines) * (self._share_of_path / _OPTIONS.spread**2)
        precision = block_diag(request.expected.precision, of_path)
        basis = MotionBasis(
            self._tables,
            self._limit_tables,
            weights,
            precision,
            self._primitive.n_components,
            partial(iter, [StartPoint(weights)]),
            is_detour=True,
        )
        return Detour(basis, self._least_duration(line.boundary, weights))

    def _least_duration(self, boundary: FloatArray, weights: FloatArray) -> float:
        """Shortest duration within the limits of velocity, acceleration and jerk [s]."""
        s = np.append(0.0, np.append(self._phases, 1.0))
        # By phase, which is by time in a duration of 1 s.
        rates = quintics(s, boundary, 3) + self._basis.shapes(weights, s, 3)
        return self._margin * kinematic_stretch(self._limits, rates[1:])
