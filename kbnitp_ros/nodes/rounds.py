# SPDX-License-Identifier: Apache-2.0
"""Rounds of robots that depart together, planned in the background."""

from __future__ import annotations

from collections.abc import Callable, Collection, Container, Mapping, Sequence
from concurrent.futures import Future
from dataclasses import dataclass, field, replace
from functools import partial
import time
from typing import Any

from kbnitp_ros.configuration import make_goal, value_for
from kbnitp_ros.configuration.agents import most_distance
from kbnitp_ros.configuration.mission import make_stop, search_options, type_to_plan
from kbnitp_ros.core import DeploymentKey, Grid, HazardDraws, Plan, SearchOptions, Team
from kbnitp_ros.core.decision.rounds import plan_round, why_worthless
from kbnitp_ros.core.planning.planners import count_visits
from kbnitp_ros.core.planning.regions import keepout_cells, without
from kbnitp_ros.messages.beliefs import Snapshot
from kbnitp_ros.messages.headers import next_name
import numpy as np
from numpy.typing import NDArray


@dataclass(frozen=True)
class Search:
    """A search for the paths of a round; searches for the same round are equal."""

    # The name of the belief's evidence: epoch and changes.
    belief: tuple[int, int]
    # The agents of the round.
    agents: list[str]
    # Number of plans that the operator has refused.
    refused: int
    # Number of parameter changes.
    changes: int
    # The result; None before the start.
    found: Future[PlannedRound] | None = field(default=None, compare=False)

    @property
    def is_running(self) -> bool:
        """Return whether the search has started and not finished."""
        return self.found is not None and not self.found.done()

    def lasts(self, now: Search, is_rolling: bool) -> bool:
        """Return whether the plans still apply: same belief, free agents, no changes."""
        # With `rolling`, plans on an earlier belief apply as well.
        return (
            (is_rolling or self.belief == now.belief)
            and {*self.agents} <= {*now.agents}
            and (self.refused, self.changes) == (now.refused, now.changes)
        )


# Paths and plans by deployment.
Paths = dict[DeploymentKey, NDArray[np.intp]]
Plans = dict[DeploymentKey, Plan]


@dataclass(frozen=True)
class PlannedRound:
    """The result of a search."""

    plans: Plans
    # Reason why the gain of the plans ends the mission; empty if it does not.
    why_not_worth: str
    # Reason why no plan is worth a robot; empty if any plan is.
    why_worthless: str
    # Duration of the search, seconds.
    seconds: float


class Rounds:
    """A planner of rounds of robots, given a belief."""

    def __init__(
        self,
        grid: Grid,
        values: Mapping[str, Any],
        warn: Callable[[str], object],
    ) -> None:
        self._grid = grid
        self._values = values
        self._warn = warn
        self._is_slow = False
        # Visits of each cell by the paths of all robots sent.
        self._visited = count_visits(grid, [])

    def count_path(self, path: NDArray[np.intp], robots: int = 1) -> None:
        """Add the visits of a path, shape (steps + 1,); robots=-1 removes a refused path."""
        np.add.at(self._visited, path[1:], robots)

    def search(
        self,
        known: Snapshot,
        agents: Sequence[str],
        out: Paths,
        stamp: int,
        refused: Sequence[Sequence[NDArray[np.intp]]] = (),
        noted: Sequence[NDArray[np.intp]] = (),
        draws: HazardDraws | None = None,
        no_go: Collection[int] = (),
    ) -> Callable[[], PlannedRound]:
        """Return a function that searches for the paths of a round; a goal needs draws."""
        robot_type = partial(
            type_to_plan, self._values, grid=self._grid, believed=known.robot_types
        )
        types = tuple(map(robot_type, agents))
        most_steps = max(value_for(self._values, 'max_steps', agent) for agent in agents)
        goal, stop = make_goal(self._values, self._grid), make_stop(self._values)
        keepout = keepout_cells(
            without(self._grid, no_go),
            most_steps,
            [each.base for each in types],
            refused,
            most_distance(self._values, agents),
        )
        closed = [*keepout.tolist(), *no_go]
        options = replace(search_options(self._values), keepout=closed)
        # Loss costs are in nats: gains of other objectives and of goals are not.
        is_mapping = goal is None and options.objective == 'information'
        loss_cost = options.loss_cost if is_mapping else 0.0
        plan = partial(
            plan_round,
            goal,
            draws,
            self._grid,
            known.belief,
            known.model,
            Team(len(agents), self._values['allocation'], types),
            options,
            in_flight=[(path, robot_type(key.agent)) for key, path in out.items()],
            visited=self._visited - count_visits(self._grid, noted),
        )

        def planned() -> PlannedRound:
            start = time.monotonic()
            found = plan()
            plans = {
                DeploymentKey(agent, stamp + number): each
                for number, (agent, each) in enumerate(zip(agents, found))
            }
            worthless = why_at_base(found, options) or why_worthless(found, loss_cost)
            seconds = time.monotonic() - start
            return PlannedRound(plans, stop.why_not_worth(found), worthless, seconds)

        return planned

    def missing(
        self,
        planned_on: Snapshot,
        agents: Sequence[str],
        recorded: Paths,
        refused: Sequence[Sequence[NDArray[np.intp]]] = (),
        at_base: Container[DeploymentKey] = (),
        no_go: Collection[int] = (),
    ) -> Plans:
        """Return the plans of a round for the agents whose paths are missing in the log."""
        if make_goal(self._values, self._grid) is not None:
            # Draws of a past belief are not kept: the missing robots leave in the next round.
            return {}
        agents = agents[: max(0, self._values['robots'] - planned_on.deployments)]
        if len(recorded) >= len(agents):
            return {}
        first = next_name(planned_on.stamp, planned_on.mission)
        noted = [path for key, path in recorded.items() if key not in at_base]
        search = self.search(planned_on, agents, {}, first, refused, noted, no_go=no_go)
        planned = search().plans
        # If recorded paths differ from the plans, agents or parameters have changed since then.
        if not all(
            key in planned and np.array_equal(path, planned[key].path)
            for key, path in recorded.items()
        ):
            return {}
        return {key: plan for key, plan in planned.items() if key not in recorded}

    def warn_if_slow(self, planned: PlannedRound) -> None:
        """Warn once if planning takes longer than the robots are away."""
        away = max(
            value_for(self._values, 'step_period', key.agent) * (len(plan.path) - 1)
            for key, plan in planned.plans.items()
        )
        if 0.0 < away < planned.seconds and not self._is_slow:
            self._is_slow = True
            self._warn(
                f'planning took {planned.seconds:.1f} s, longer than the robots are away '
                f'({away:.1f} s): reduce beam_width, or set planner to relaxed'
            )


def why_at_base(plans: Sequence[Plan], options: SearchOptions) -> str:
    """Describe a path that never leaves the base; empty if there is none."""
    for plan in plans:
        if (plan.path == plan.path[0]).all():
            found = f'the planner {options.planner} found the path {plan.path.tolist()}'
            return f'{found}, which never leaves the base'
    return ''


def describe_plan(grid: Grid, plan: Plan) -> str:
    """Describe the destination and the expected results of a plan."""
    steps_to_base = grid.at(int(plan.path[0])).steps_to_base
    farthest = plan.path[np.argmax(steps_to_base[plan.path])]
    ((x, y),) = grid.centers([farthest]).tolist()
    return (
        f'for ({x:.6g}, {y:.6g}) m and back in {plan.path.size - 1} steps: it returns with '
        f'probability {plan.survival:.2f}, expected information {plan.information:.3g} nats'
    )
