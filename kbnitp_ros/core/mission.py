# SPDX-License-Identifier: Apache-2.0
"""A whole mission without ROS: plan, traverse, update, round after round."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from copy import deepcopy
from dataclasses import dataclass, replace
from typing import Any, overload, TYPE_CHECKING

from kbnitp_ros.core.decision.decision import Decision
from kbnitp_ros.core.decision.goals import Goal
from kbnitp_ros.core.decision.hazard_draws import HazardDraws, joint_hazards, Mixture
from kbnitp_ros.core.decision.rounds import plan_round, Stop
from kbnitp_ros.core.decision.told import with_told
from kbnitp_ros.core.field.belief import Belief, binary_entropy, log_loss
from kbnitp_ros.core.field.check import (
    generator,
    read_only,
    typed,
    typed_fields,
    Value,
    whole_number,
)
from kbnitp_ros.core.field.clustering import Clustering
from kbnitp_ros.core.field.grid import Grid
from kbnitp_ros.core.field.observation import as_observations, Observation
from kbnitp_ros.core.field.sensor import ORDINARY, RobotType, SensorModel
from kbnitp_ros.core.field.unknowns import ALL_KNOWN, Dynamics, Learnt, STATIC, Unknowns
from kbnitp_ros.core.field.world import AS_ORDERED, Execution, World
from kbnitp_ros.core.inference.estimator import Estimator
from kbnitp_ros.core.planning.objective import Objective
from kbnitp_ros.core.planning.options import SearchOptions
from kbnitp_ros.core.planning.planners import count_visits, NoPathError
from kbnitp_ros.core.planning.plans import Plan, Team, team_size
from kbnitp_ros.plugins import extra
import numpy as np
from numpy.typing import ArrayLike

if TYPE_CHECKING:
    from pandas import DataFrame


@dataclass(frozen=True, eq=False, repr=False)
class Deployment(Value):
    """
    One robot's part of a mission.

    Attributes
    ----------
    plan : Plan
        Its path and the expected results; with learnt numbers its survival is the mean over their
        particles.
    observation : Observation
        Its outcome.
    belief : Belief
        Belief after the deployment.
    model : SensorModel
        Sensor model of the common robot type for planning, after the deployment.
    parameters : mapping of str to Learnt
        Posteriors of the learnt numbers after the deployment.
    world : World
        Field after the deployment.
    decision : Decision or None
        Decision on the goal after the deployment; None without a goal.

    """

    plan: Plan
    observation: Observation
    belief: Belief
    model: SensorModel
    parameters: Mapping[str, Learnt]
    world: World
    decision: Decision | None = None


@typed_fields
@dataclass(frozen=True)
class Truth:
    """
    The true behaviour of the robots of a mission.

    Attributes
    ----------
    model : SensorModel, optional
        True sensor model of the common robot type; None: the believed model.
    execution : Execution
        Deviations from orders; none by default.
    dynamics : Dynamics, optional
        True dynamics of the hazards; None: the believed dynamics.
    target_dynamics : Dynamics, optional
        True dynamics of the targets, also 'moving'; None: the believed dynamics.

    """

    model: SensorModel | None = None
    execution: Execution = AS_ORDERED
    dynamics: Dynamics | None = None
    target_dynamics: Dynamics | None = None


@typed_fields
@dataclass(frozen=True)
class Learning:
    """
    The numbers that a mission learns besides the maps, and the clustering of hazards.

    Attributes
    ----------
    unknowns : Unknowns
        Unknown numbers of the sensor model and of the prior. Plans use the estimator's current
        model.
    seed : int
        Seed of the random numbers that the method draws.
    clustering : Clustering or None
        Believed clustering of the hazards; None: independent.

    """

    unknowns: Unknowns = ALL_KNOWN
    seed: int = 0
    clustering: Clustering | None = None

    def __post_init__(self) -> None:
        object.__setattr__(self, 'seed', whole_number('seed', self.seed, 0))


class Mission(Sequence[Deployment]):
    """
    A mission in a simulated field, and a sequence of its deployments.

    Any loop may send the robots along any closed paths::

        mission = Mission(grid, belief, model, world, rng=1)
        while len(mission) < 20:
            mission.send(plan(grid, mission.belief, mission.model))

    `run` plans with the options, the visits and the generator of the mission.

    Parameters
    ----------
    grid, belief, model, world, rng, method, options, truth, learning, dynamics, \
    target_dynamics, goal
        As in `run_mission`.

    Attributes
    ----------
    grid, options, goal
        As given.
    estimator : Estimator
        Estimator after the deployments so far.
    world : World
        Field after the deployments so far.
    rng : numpy.random.Generator
        The mission's generator. It spawns a generator for each robot, and planners with a
        parameter `rng` draw from it.
    visited : ndarray of int, shape (cells,)
        Number of visits to each cell by the paths of all deployments.
    sent, lost : int
        Number of robots sent and lost, with those before the mission was resumed.
    decision : Decision or None
        Decision on the goal; None without a goal.

    Raises
    ------
    ValueError
        As in `run_mission`.

    """

    @typed
    def __init__(
        self,
        grid: Grid,
        belief: Belief,
        model: SensorModel,
        world: World,
        rng: np.random.Generator | int,
        method: str | Callable[..., Any] = 'kappa_bnitp',
        options: SearchOptions = SearchOptions(),
        *,
        truth: Truth | None = None,
        learning: Learning | None = None,
        dynamics: Dynamics = STATIC,
        target_dynamics: Dynamics = STATIC,
        goal: Goal | None = None,
    ) -> None:
        truth, learning = truth or Truth(), learning or Learning()
        estimator = Estimator(
            belief,
            model,
            method,
            learning.unknowns,
            learning.seed,
            dynamics=dynamics,
            clustering=learning.clustering,
            target_dynamics=target_dynamics,
        )
        truth = replace(
            truth,
            model=truth.model or model,
            dynamics=truth.dynamics or dynamics,
            target_dynamics=truth.target_dynamics or target_dynamics,
        )
        self._begin(grid, estimator, world, rng, options, (), truth, goal)

    @classmethod
    @typed
    def resume(
        cls,
        grid: Grid,
        estimator: Estimator,
        world: World,
        rng: np.random.Generator | int,
        options: SearchOptions = SearchOptions(),
        *,
        before: Sequence[Observation] = (),
        truth: Truth | None = None,
        goal: Goal | None = None,
    ) -> Mission:
        """
        Return a mission that has begun, to go on from an estimator.

        Parameters
        ----------
        grid, world, rng, options, goal
            As in `run_mission`.
        estimator : Estimator
            Estimator after the deployments `before`; it is not changed.
        before : sequence of Observation
            Outcomes of the deployments that the estimator has assimilated; they count as sent, for
            the visits of planners, and for changes of the field.
        truth : Truth, optional
            True behaviour of the robots; by default as in the estimator.

        Raises
        ------
        ValueError
            As in `run_mission`.

        """
        mission = cls.__new__(cls)
        mission._begin(grid, estimator.copy(), world, rng, options, before, truth or Truth(), goal)
        return mission

    def _begin(
        self,
        grid: Grid,
        estimator: Estimator,
        world: World,
        rng: np.random.Generator | int,
        options: SearchOptions,
        before: Sequence[Observation],
        truth: Truth,
        goal: Goal | None,
    ) -> None:
        """Set the state before the first robot to send."""
        before = as_observations('before', before)
        for observation in before:
            grid.check_any_path(observation.path)
        self.grid, self.estimator, self.world = grid, estimator, world
        self.rng, self.options, self.goal = generator(rng), options, goal
        world.check(grid)
        estimator.prior.check(grid)
        own = estimator.prior.grid or grid
        if own.bases != grid.bases:
            raise ValueError(
                f'belief is of a grid with the bases {sorted(own.bases)}: the grid has '
                f'{sorted(grid.bases)}; make it with Belief.prior(grid, ...), or belief.on(grid)'
            )
        self._model = truth.model or estimator.model
        world.check_duds(self._model)
        self._execution = truth.execution
        self._dynamics = truth.dynamics or estimator.probable_dynamics
        self._dynamics.known_rates()
        self._target_dynamics = truth.target_dynamics or estimator.probable_target_dynamics
        self._target_dynamics.known_rates('target_dynamics')
        self._possible = grid.may_be_hazardous & (estimator.prior.hazard > 0.0)
        if goal is not None:
            goal.check(grid, options.max_steps)
        self._deployments: list[Deployment] = []
        self.visited = read_only(count_visits(grid, [each.path for each in before]))
        self.sent, self.lost = len(before), sum(not each.survived for each in before)
        self.decision = decided(goal, grid, estimator, self.sent, options)

    @property
    def belief(self) -> Belief:
        """Return the belief after the deployments so far."""
        return self.estimator.belief

    @property
    def model(self) -> SensorModel:
        """Return the sensor model of the common robot type to plan with."""
        return self.estimator.model

    @typed
    def send(self, path: ArrayLike | Plan, robot_type: RobotType = ORDINARY) -> Observation:
        """
        Send a robot, assimilate its outcome and append its deployment.

        Parameters
        ----------
        path : array_like of int, shape (steps + 1,), or Plan
            Cells, the base first and last; the options of the search do not limit them. The
            information of a `Plan` is kept as it is given.
        robot_type : RobotType
            Type of the robot; numbers that it sets are both believed and true.

        Raises
        ------
        ValueError
            If the path is invalid on the grid, or the outcome is impossible under the belief;
            nothing is then assimilated.

        """
        grid = self.grid.at(robot_type.base)
        cells = grid.check_path(path.path if isinstance(path, Plan) else path)
        if not isinstance(path, Plan):
            path = Plan.alone(cells, Objective.of(self.belief, robot_type.model(self.model)))
        return self._send(path, robot_type)

    def _send(self, plan: Plan, robot_type: RobotType) -> Observation:
        """Send a robot along a checked path."""
        if self.estimator.particles < np.inf:
            # A product of means is below the mean of products over particles.
            hazards = joint_hazards(self.estimator, self.sent)
            assert isinstance(hazards, Mixture)
            model = robot_type.model(self.model)
            survival = hazards.of_type(robot_type).survival(plan.path, model)
            plan = replace(plan, survival=survival)
        made = self._execution.follow(
            self.world,
            self.grid.at(robot_type.base),
            plan.path,
            robot_type.model(self._model),
            self.rng.spawn(1)[0],
            self._dynamics,
            self._possible if self.sent else None,
            self._target_dynamics,
        )
        self.estimator.assimilate(made.observation, robot_type)
        self.world = made.world
        self.visited = read_only(self.visited + count_visits(self.grid, [plan.path]))
        self.sent += 1
        self.lost += not made.observation.survived
        self.decision = decided(self.goal, self.grid, self.estimator, self.sent, self.options)
        after = self.belief, self.model, dict(self.estimator.parameters)
        self._deployments.append(
            Deployment(plan, made.observation, *after, self.world, self.decision)
        )
        return made.observation

    @typed
    def run(self, robots: int, *, team: Team | None = None, stop: Stop | None = None) -> Mission:
        """
        Plan and send further robots (arXiv:2305.06929, Algorithm 1, line 1); return the mission.

        Parameters
        ----------
        robots : int
            Number of further robots, at least 0.
        team, stop
            As in `run_mission`.

        Raises
        ------
        ValueError
            As in `run_mission`.

        """
        team, stop = team or Team(), stop or Stop()
        last = self.sent + whole_number('robots', robots, 0)
        team_size(self.grid, team.agents)
        stop.check(self.goal, last, self.estimator)
        while self.sent < last and not stop.why(self.decision, self.lost):
            leaving = team.first(last - self.sent)
            try:
                plans = plan_round(
                    self.goal,
                    HazardDraws.of(self.estimator, self.sent) if self.goal else None,
                    self.grid,
                    self.belief,
                    self.model,
                    leaving,
                    self.options,
                    visited=self.visited,
                    rng=self.rng,
                )
            except NoPathError:
                break
            if stop.why_not_worth(plans):
                break
            for planned, robot_type in zip(plans, leaving.types):
                self._send(planned, robot_type)
        return self

    @overload
    def __getitem__(self, place: int) -> Deployment: ...

    @overload
    def __getitem__(self, place: slice) -> list[Deployment]: ...

    def __getitem__(self, place: int | slice) -> Deployment | list[Deployment]:
        return self._deployments[place]

    def __eq__(self, other: object) -> bool:
        return isinstance(other, Mission) and self._deployments == other._deployments

    def __len__(self) -> int:
        return len(self._deployments)

    def __copy__(self) -> Mission:
        other = type(self).__new__(type(self))
        own = {'estimator': self.estimator.copy(), 'rng': deepcopy(self.rng)}
        vars(other).update(vars(self) | own | {'_deployments': self._deployments.copy()})
        return other

    def __repr__(self) -> str:
        return f'Mission({self.sent} robots, {self.lost} lost)'

    def to_dataframe(self) -> DataFrame:
        """Return a table with one row for each deployment."""
        table = deployments_table(
            [each.observation for each in self],
            [each.belief for each in self],
            [each.world for each in self],
        )
        table['information'] = [each.plan.information for each in self]
        table['survival'] = [each.plan.survival for each in self]
        for name in self[0].parameters if self else ():
            table[name] = [each.parameters[name].mean for each in self]
            table[f'{name}_sd'] = [each.parameters[name].sd for each in self]
        return table


@typed
def run_mission(
    grid: Grid,
    belief: Belief,
    model: SensorModel,
    world: World,
    robots: int,
    rng: np.random.Generator | int,
    method: str | Callable[..., Any] = 'kappa_bnitp',
    options: SearchOptions = SearchOptions(),
    *,
    team: Team | None = None,
    truth: Truth | None = None,
    learning: Learning | None = None,
    dynamics: Dynamics = STATIC,
    target_dynamics: Dynamics = STATIC,
    goal: Goal | None = None,
    stop: Stop | None = None,
) -> Mission:
    """
    Deploy robots one after another (arXiv:2305.06929, Algorithm 1), or several at a time.

    All robots of a round are planned on the same belief, and their evidence is assimilated in
    their order. Robot k of the mission is simulated with the k-th child of `rng`, so its outcome
    does not depend on earlier draws, and missions with different methods or teams share their
    random numbers.

    Parameters
    ----------
    grid : Grid
        The field.
    belief : Belief
        The prior.
    model : SensorModel
        Believed sensor model of the common robot type.
    world : World
        The hidden truth.
    robots : int
        Number of robots, at least 0.
    rng : int or numpy.random.Generator
        The only source of randomness: a generator or a seed. Each robot gets its child by
        ``rng.spawn(1)``.
    method : str or callable
        Inference method, one of `METHODS`.
    options : SearchOptions
        Options of the search for paths.
    team : Team, optional
        The robots of a round, by default one; the last round may have fewer. Numbers that their
        types set are both believed and true.
    truth : Truth, optional
        True behaviour of the robots; by default as believed.
    learning : Learning, optional
        Unknowns to learn besides the maps; none by default.
    dynamics : Dynamics
        How hazards are believed to change. The field that robot k - 1 left may change before
        robot k enters; the change is drawn with the second child of robot k's generator.
    target_dynamics : Dynamics
        How targets are believed to change, likewise, drawn with the third child.
    goal : Goal, optional
        Goal of the mission, such as `Lane` or `Area`; by default the field is mapped.
    stop : Stop, optional
        Conditions that end the mission early; by default only a reached goal does.

    Returns
    -------
    Mission
        The deployments in order; fewer than `robots` if the mission ended early: the goal was
        reached at its confidence, a condition of `stop` was met, or no path with the minimum
        survival was found.

    Raises
    ------
    ValueError
        If the world or the belief does not fit the grid, an argument is out of range, a robot's
        base is not one of the grid's, the goal cannot be reached, or `stop` does not fit the
        mission.

    """
    mission = Mission(
        grid,
        belief,
        model,
        world,
        rng,
        method,
        options,
        truth=truth,
        learning=learning,
        dynamics=dynamics,
        target_dynamics=target_dynamics,
        goal=goal,
    )
    return mission.run(robots, team=team, stop=stop)


def decided(
    goal: Goal | None, grid: Grid, estimator: Estimator, deployments: int, options: SearchOptions
) -> Decision | None:
    """Return the decision on a goal, with the numbers it trusts if it is reached."""
    if goal is None:
        return None
    hazards = joint_hazards(estimator, deployments)
    decision = goal.decide(grid, hazards, estimator.model, options.max_steps)
    return with_told(decision, estimator, deployments) if decision.reached else decision


def deployments_table(
    observations: Iterable[Observation],
    beliefs: Iterable[Belief | None],
    worlds: Iterable[World | None],
) -> DataFrame:
    """Return a table with one row for each deployment."""
    with extra('study'):
        import pandas
    rows = []
    for seen, belief, world in zip(observations, beliefs, worlds, strict=True):
        row: dict[str, Any] = {
            'path': seen.path.tolist(),
            'steps': len(seen.path) - 1,
            'survived': seen.survived,
            'steps_survived': None if seen.survived else seen.steps_survived,
            'readings': None if seen.readings is None else seen.readings.astype(int).tolist(),
            'entered': seen.is_entered.tolist() if seen.survived else None,
        }
        for name in ('hazard', 'target') if belief else ():
            values = getattr(belief, name)
            row[f'{name}_entropy'] = float(binary_entropy(values).sum())
            if world:
                row[f'{name}_log_loss'] = float(log_loss(values, getattr(world, name)))
        rows.append(row)
    return pandas.DataFrame(rows, index=pandas.RangeIndex(1, len(rows) + 1, name='deployment'))
