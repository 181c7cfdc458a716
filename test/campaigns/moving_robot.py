# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""Random events on simulated robots, judged by a referee from the commands alone.

Goals at rest and in motion, streams of goals that repeat, drift or alternate, stops, holds,
silences, speed scaling, delays, payloads, rejections, lost messages, stalls of the node and of the
joint states, and restarts of the node and of the controller: one disturbance at a time. Of four
runs, one has joint states without velocities, one has them in two messages, and one has both. The
node and the robot are stepped together in virtual time. Therefore the outcome does not depend on
the load of the machine, and a seed reproduces a run.

Some jumps are counted separately, because the sender can't prevent them. They are up to 10 mrad
with the state of the controller, and up to 50 mrad without. (1) If the robot's place on its motion
is unknown, a stop is a single point. The controller leads there from the measured state, so its
first command jumps by the tracking error. (2) A robot that was slowed is behind its motion by less
than `following_tolerance` at first: without the state of its controller, that can't be told from
the lag of servos, and goals and stops continue the motion by the clock. (3) A controller that
restarts shortly before the end of a motion holds a position close to that end.

    python3 -m campaigns.moving_robot [--events 1000] [--robots panda,ur5] [--seed 0] [--json]
    python3 -m campaigns.moving_robot --servos [--events 1000]

With `--servos`, there are goals and stops alone, without the state of the controller, of robots
whose drives lag and sag. That is no fault: no command jumps by more than 1 mrad, no goal is
rejected, and all motions end as arrived, replaced or stopped.

Exits with 1 if a command exceeded a limit by more than 1 %, or jumped by more than 0.2 mrad in a
millisecond. It also exits with 1 if a goal got no report or several, a motion got no execution
report or several or a false one, or the robot did not arrive at a reachable goal that was not
replaced.
"""

from __future__ import annotations

import sys
from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field
from itertools import product
from typing import Any

import numpy as np
from support.problems import Scene
from support.referee import Verdict
from support.tables import options, show
from support.virtual_node import VirtualNode, scene_and_model

from mp_pca_planner.execution.outcomes import GoalOutcome
from mp_pca_planner.execution.parameters import Settings
from mp_pca_planner.execution.planning import Model
from mp_pca_planner.motion.goal import JointGoal, JointState

EVENTS_IN_A_RUN = 10
RATES = (1.0, 5.0, 20.0, 50.0)  # rates of goal streams [Hz]
DRIFT = 0.1  # speed of moving goals [rad/s]
# Largest jump that the sender can't prevent, with and without the controller's state [rad].
LISTED_APART = {True: 1e-2, False: 5e-2}
LATELY = 4000  # ticks after speed scaling in which a robot counts as slowed
APART = {
    "point": "stop at a point",
    "hasty": "stop of a robot that was slowed",
    "slowed": "goal of a robot that was slowed",
    "unknown": "start at a rest of unknown command",
}
LAGS, SAGS = (0.02, 0.05, 0.1), (0.0, 0.006)  # of servos [s], [rad]
LARGEST_JUMP, GOOD_ENDS = 1e-3, ("arrived", "replaced", "stopped")  # with them [rad]
PERIOD = 1e-3  # of the controller [s]
FINEST = 1e-6  # step below the resolution of encoders [rad]
ARRIVED = 1e-3  # largest final error of the controller [rad]
TOLERANCE = Settings.following_tolerance  # what can be known of it without its state


class LaggingServos:
    """Drives that approach their commands with a time constant [s], less a sag [rad]."""

    def __init__(self, q: Any, lag: float, sag: float) -> None:
        self.q = np.array(q) - sag
        self.v = self.acting = np.zeros_like(self.q)
        self._share, self._sag = 1.0 - np.exp(-PERIOD / lag), sag

    def step(self, command: Any) -> None:
        """Move for one period."""
        moved = (command - self._sag - self.q) * self._share
        self.q, self.v = self.q + moved, moved / PERIOD


@dataclass
class Run:
    """A node, its robot, and the events of a run."""

    scene: Scene
    model: Model
    seed: int
    has_controller_state: bool = False
    servos: tuple[float, float] | None = None
    n_goals: int = 0
    events: list[str] = field(default_factory=list)

    def __post_init__(self) -> None:
        self.random = np.random.default_rng(self.seed)
        self.ends = np.array([m.positions[[0, -1]] for m in self.scene.demonstrations])
        self.node = VirtualNode(self.model, self.ends[0, 0], seed=self.seed)
        self.faults = self.node.robot.faults
        if self.servos:
            self.node.robot.plant = LaggingServos(self.ends[0, 0], *self.servos)
        self.node.has_controller_state = self.has_controller_state
        self.node.has_velocities, self.node.is_split = self.seed % 2 == 0, self.seed // 2 % 2 == 1
        # Before its first motion, the robot is commanded to be where it is measured.
        self.node.run(0.2)
        self.send(self.target())
        self.node.run(4.0)
        # With a sag, the first motion begins below the position that was commanded.
        self.first = len(self.node.robot.record) if self.servos else 0

    @property
    def joints(self) -> tuple[str, ...]:
        """The joints of the robot."""
        return self.model.robot.joint_names

    def target(self) -> Any:
        """The start or end of a demonstration, or a point between two of them."""
        one, other = self.random.choice(self.ends.reshape(-1, len(self.joints)), 2)
        return one + self.random.choice([0.0, self.random.uniform()]) * (other - one)

    def send(self, positions: Any, names: Sequence[str] | None = None) -> None:
        """Send a goal."""
        self.n_goals += 1
        self.last = np.array(positions)
        state = JointState(names or self.joints, positions)
        self.node.goal(JointGoal(state), (self.seed, self.n_goals))

    def happen(self) -> None:
        """Apply one random event, then advance the time."""
        event = str(self.random.choice(["goal", "stop"] if self.servos else list(EVENTS)))
        self.events.append(event)
        EVENTS[event](self)
        self.node.run(self.random.uniform(0.05, 1.5))

    def end(self) -> None:
        """Clear all disturbances, send a last goal, and wait until it is reached."""
        self.faults.speed_scaling, self.faults.held, self.faults.silent = 1.0, False, False
        self.faults.delay = self.faults.jitter = self.faults.drop = 0.0
        self.faults.active = True
        self.node.run(12.0)
        self.send(self.target())
        self.node.run(8.0)


def part_of_a_goal(run: Run) -> None:
    """Send a goal for two joints."""
    chosen = run.random.choice(len(run.joints), 2, replace=False)
    run.send(run.target()[chosen], [run.joints[k] for k in chosen])


def stream(n_targets: int, goal: Callable[..., Any]) -> Callable[[Run], None]:
    """Send goals at some rate: a function of their number, of the time, and of some targets."""

    def event(run: Run) -> None:
        targets = [run.target() for _ in range(n_targets)]
        rate = float(run.random.choice(RATES))
        for k in range(max(int(rate * run.random.uniform(0.5, 2.0)), 1)):
            run.send(goal(k, k / rate, *targets))
            run.node.run(1.0 / rate)

    return event


def drift(_: int, time: float, here: Any, there: Any) -> Any:
    """A goal that moves from one target to another one."""
    most = np.abs(there - here).max()
    return here + min(DRIFT * time, most) * (there - here) / max(most, 1e-3)


def stop(run: Run) -> None:
    """Send a goal, and a stop soon after."""
    run.send(run.target())
    run.node.run(run.random.uniform(0.02, 1.5))
    run.node.stop()


def faulty(name: str, draw: Callable[[np.random.Generator], Any]) -> Callable[[Run], None]:
    """Send a goal, then disturb the robot for a time; send a goal or a stop meanwhile."""

    def event(run: Run) -> None:
        usual = getattr(run.faults, name)
        run.send(run.target())
        run.node.run(run.random.uniform(0.0, 1.0))
        setattr(run.faults, name, draw(run.random))
        run.node.run(run.random.uniform(0.1, 1.5))
        if run.random.random() < 0.5:
            run.send(run.target())
        else:
            run.node.stop()
        run.node.run(run.random.uniform(0.1, 1.5))
        setattr(run.faults, name, usual)

    return event


def delays(run: Run) -> None:
    """Delay messages by up to 20 ms for a while."""
    delay = run.random.uniform(0.0, 0.02)
    run.faults.delay, run.faults.jitter = delay, run.random.uniform(0.0, 0.02 - delay)
    for _ in range(4):
        run.send(run.target())
        run.node.run(run.random.uniform(0.05, 1.0))
    run.faults.delay = run.faults.jitter = 0.0


def payload(run: Run) -> None:
    """Attach a payload at rest, move, and remove it at rest."""
    run.node.run(6.0)
    run.faults.payload = float(run.random.choice([1.0, 3.0]))
    run.node.run(1.0)
    for _ in range(3):
        run.send(run.target())
        run.node.run(run.random.uniform(0.5, 3.0))
    run.node.run(6.0)
    run.faults.payload = 0.0
    run.node.run(1.0)


def stalls(run: Run) -> None:
    """Let the node, or its joint states, stand still for a while, in motion and at rest."""
    for _ in range(4):
        run.send(run.target())
        run.node.run(run.random.uniform(0.0, 1.5))
        of_states = bool(run.random.random() < 0.5)
        run.node.stall(run.random.uniform(0.3, 1.0), of_states=of_states)
        if run.random.random() < 0.5:
            run.node.run(run.random.uniform(0.0, 1.0))


def restart_node(run: Run) -> None:
    """Restart the node."""
    run.node.restart()
    run.node.run(0.1)
    run.send(run.target())


def restart_controller(run: Run) -> None:
    """Restart the controller."""
    run.node.robot.restart_controller()
    run.node.run(run.random.uniform(0.0, 0.5))
    run.send(run.target())


EVENTS: dict[str, Callable[[Run], None]] = {
    "goal": lambda run: run.send(run.target()),
    "part of a goal": part_of_a_goal,
    "repeated goal": stream(1, lambda k, time, here: here),
    "drifting goal": stream(2, drift),
    "alternating goals": stream(2, lambda k, time, *both: both[k % 2]),
    "stop": stop,
    "hold": faulty("held", lambda _: True),
    "silence": faulty("silent", lambda _: True),
    "speed scaling": faulty("speed_scaling", lambda random: random.uniform(0.1, 1.0)),
    "rejection": faulty("active", lambda _: False),
    "lost message": faulty("drop", lambda _: 1.0),
    "delays": delays,
    "payload": payload,
    "stalls": stalls,
    "node restart": restart_node,
    "controller restart": restart_controller,
}


@dataclass(frozen=True)
class Result:
    """Outcome of a run."""

    run: Run
    verdict: Verdict
    n_jumps: int
    problems: tuple[str, ...]
    apart: dict[str, float]


def result_of(run: Run) -> Result:
    """Judge a run."""
    record, apart = run.node.robot.record, messages_apart(run)
    joins = sorted(apart["slowed"] | apart["hasty"] | apart["unknown"])
    verdict = run.node.verdict(cuts=apart["point"], joins=joins, finest=FINEST, first=run.first)
    known = set().union(*apart.values())
    most = LISTED_APART[run.has_controller_state]
    jumps = [jump for jump in verdict.jumps if jump[0] not in known or abs(jump[2]) > most]
    if run.servos:
        jumps = [jump for jump in verdict.jumps if abs(jump[2]) > LARGEST_JUMP]
    sizes = {
        kind: max((abs(size) for tick, _, size in verdict.jumps if tick in ticks), default=0.0)
        for kind, ticks in apart.items()
    }
    sizes["point"] = max(
        (np.abs(record.q[tick] - record.q[tick - 1]).max() for tick in apart["point"]), default=0.0
    )
    problems = [str(one) for one in verdict.exceeded]
    problems += [f"jump of {size:.2g} at {tick}, joint {j}" for tick, j, size in jumps]
    problems += [*unanswered(run), *untrue(run)]
    if run.servos:
        said = [r.status for r in run.node.plan_reports if r.status == "refused"]
        said += [r.outcome for _, r in run.node.execution_reports]
        problems += [f"reported: {word}" for word in said if word not in GOOD_ENDS]
    away = np.abs(record.q[-1] - run.last).max()
    if away > ARRIVED:
        problems.append(f"the last goal is missed by {away:.2g}")
    return Result(run, verdict, len(jumps), tuple(problems), sizes)


def messages_apart(run: Run) -> dict[str, set[int]]:
    """Ticks of messages whose jumps are counted separately, by reason."""
    robot = run.node.robot
    record = robot.record
    restarts = np.searchsorted(record.times, run.node.restarts)
    # After these, the held position is known to the controller only.
    unknown = {-1, *record.cuts, *restarts}
    # After a lost message, too, once the robot rests: under a new load it is not where it was sent.
    lost = np.searchsorted(record.times, [time for time, _ in robot.rejections])
    found: dict[str, set[int]] = {kind: set() for kind in APART}
    last = 0
    if run.servos:
        return found
    for tick, n_points in robot.taken:
        was_slowed = record.scaling[max(tick - LATELY, 0) : tick + 1].min() < 1.0
        if n_points == 1:
            found["point"].add(tick)
            unknown.add(tick)
        elif was_slowed and sent_as_stop(run, record.times[tick]):
            found["hasty"].add(tick)
        elif was_slowed:
            found["slowed"].add(tick)
        elif any(last <= cut <= tick for cut in unknown) or (
            not record.v[tick - 1].any() and any(last <= cut <= tick for cut in lost)
        ):
            # The effect of a message at rest may appear one tick later.
            found["unknown"] |= {tick, tick + 1}
        last = tick
    return found


def sent_as_stop(run: Run, time: float) -> bool:
    """Whether the message that the controller accepted at a time was a stop."""
    return any(time - 0.05 < when <= time for when in run.node.stops)


def unanswered(run: Run) -> list[str]:
    """Goals and motions with no report or several."""
    node, problems = run.node, []
    reports = Counter(report.name for report in node.plan_reports)
    n_restarts = run.events.count("node restart")
    silent = [k for k in range(1, run.n_goals + 1) if reports[run.seed, k] != 1]
    if len(silent) > n_restarts:
        problems.append(f"goals without exactly one report: {silent}")
    served = [r.name for r in node.plan_reports if r.status == "served"]
    executed = Counter(report.goal for _, report in node.execution_reports)
    unfollowed = [name for name in served if executed[name] != 1]
    if len(unfollowed) > n_restarts:
        problems.append(f"motions without exactly one execution report: {unfollowed}")
    return problems


def untrue(run: Run) -> list[str]:
    """Execution reports that say what did not happen."""
    robot, problems = run.node.robot, []
    record, taken = robot.record, np.array([tick for tick, _ in robot.taken])
    for now, report, execution in run.node.reported:
        began, here = np.searchsorted(record.times, [execution.motion.time, now])
        away = np.abs(record.q[min(here, len(record) - 1)] - execution.motion.end).max()
        was_taken = ((taken >= began) & (taken < here)).any()
        # Of a robot that is held, the node can't know whether it took the motion.
        was_cut = any(began <= cut <= here for cut in record.cuts)
        was_cut = was_cut or record.scaling[began : here + 1].min(initial=1.0) < 0.1
        is_false = {
            "arrived": away > (ARRIVED if run.has_controller_state else TOLERANCE),
            "never_started": was_taken and not was_cut,
            "not_followed": away < ARRIVED and not was_cut,
        }
        if is_false.get(report.outcome, False):
            problems.append(f"false report at {now:.2f} s, {away:.2g} away: {report.message}")
    return problems


def main() -> int:
    """Print a row per robot, and each problem with its seed."""
    arguments = options(
        __doc__,
        **{"events": 1000, "robots": "panda,ur5", "seed": 0, "json": False},
        **{"controller_state": False, "servos": False},
    )
    drives = list(product(LAGS, SAGS)) if arguments.servos else [None]
    found: dict[str, dict[str, Any]] = {}
    for name, servos in product(arguments.robots.split(","), drives):
        results = []
        title = name if servos is None else f"{name}, lag {servos[0]:g} s, sag {servos[1]:g} rad"
        n_events, stated = arguments.events // len(drives), arguments.controller_state
        for result in campaign(name, n_events, arguments.seed, stated, servos):
            results.append(result)
            for problem in result.problems:
                print(f"{title}, seed {result.run.seed}: {problem}", file=sys.stderr, flush=True)
        found[title] = summary(results)
    columns = list(dict.fromkeys(column for one in found.values() for column in one))
    rows = [[name, *(str(one.get(c, 0)) for c in columns)] for name, one in found.items()]
    show({"Random events": (["robot", *columns], rows)}, as_json=arguments.json)
    return int(any(one["runs with problems"] for one in found.values()))


def campaign(
    name: str,
    n_events: int,
    seed: int,
    controller_state: bool = False,
    servos: tuple[float, float] | None = None,
) -> Iterator[Result]:
    """Runs of ten events each, up to the given number of events."""
    scene, model = scene_and_model(name)
    for k in range(-(-n_events // EVENTS_IN_A_RUN)):
        run = Run(scene, model, seed + k, controller_state, servos)
        for _ in range(min(EVENTS_IN_A_RUN, n_events - k * EVENTS_IN_A_RUN)):
            run.happen()
        run.end()
        yield result_of(run)


def summary(results: Sequence[Result]) -> dict[str, Any]:
    """Counts over all runs."""
    runs = [result.run for result in results]
    plans = Counter(r.status for run in runs for r in run.node.plan_reports)
    ends = Counter(r.outcome for run in runs for _, r in run.node.execution_reports)
    return {
        "events": sum(len(run.events) for run in runs),
        "goals": sum(run.n_goals for run in runs),
        **{status: plans[status] for status in GoalOutcome},
        **dict(sorted(ends.items())),
        "limits exceeded": sum(len(result.verdict.exceeded) for result in results),
        "jumps": sum(result.n_jumps for result in results),
        **{
            f"{words} [mrad]": round(1e3 * max(r.apart[kind] for r in results), 2)
            for kind, words in APART.items()
        },
        "runs with problems": sum(bool(result.problems) for result in results),
    }


if __name__ == "__main__":
    sys.exit(main())
