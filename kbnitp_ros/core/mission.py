# SPDX-License-Identifier: Apache-2.0
"""A whole mission without ROS: plan, traverse, update, round after round."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, TYPE_CHECKING

from kbnitp_ros.core.decision.decision import Decision
from kbnitp_ros.core.decision.goals import Goal
from kbnitp_ros.core.decision.hazard_draws import HazardDraws
from kbnitp_ros.core.decision.rounds import plan_round, Stop
from kbnitp_ros.core.field.belief import Belief, binary_entropy, log_loss
from kbnitp_ros.core.field.check import generator, typed, typed_fields, Value, whole_number
from kbnitp_ros.core.field.clustering import Clustering
from kbnitp_ros.core.field.grid import Grid
from kbnitp_ros.core.field.observation import Observation
from kbnitp_ros.core.field.sensor import SensorModel
from kbnitp_ros.core.field.unknowns import ALL_KNOWN, Dynamics, Learnt, STATIC, Unknowns
from kbnitp_ros.core.field.world import AS_ORDERED, Execution, World
from kbnitp_ros.core.inference.estimator import Estimator
from kbnitp_ros.core.planning.options import SearchOptions
from kbnitp_ros.core.planning.planners import count_visits, NoPathError
from kbnitp_ros.core.planning.plans import Plan, Team, team_size
from kbnitp_ros.plugins import extra
import numpy as np

if TYPE_CHECKING:
    from pandas import DataFrame


@dataclass(frozen=True, eq=False, repr=False)
class Deployment(Value):
    """
    One robot's part of a mission.

    Attributes
    ----------
    plan : Plan
        Its path and the expected results.
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


class SimulatedMission(list[Deployment]):
    """The deployments of a mission in order."""

    def __repr__(self) -> str:
        lost = sum(not each.observation.survived for each in self)
        return f'SimulatedMission({len(self)} robots, {lost} lost)'

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

    """

    model: SensorModel | None = None
    execution: Execution = AS_ORDERED
    dynamics: Dynamics | None = None


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
    goal: Goal | None = None,
    stop: Stop | None = None,
) -> SimulatedMission:
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
    goal : Goal, optional
        Goal of the mission, such as `Lane` or `Area`; by default the field is mapped.
    stop : Stop, optional
        Conditions that end the mission early; by default only a reached goal does.

    Returns
    -------
    SimulatedMission
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
    truth, learning = truth or Truth(), learning or Learning()
    truth = replace(truth, model=truth.model or model, dynamics=truth.dynamics or dynamics)
    estimator = Estimator(
        belief,
        model,
        method,
        learning.unknowns,
        learning.seed,
        dynamics=dynamics,
        clustering=learning.clustering,
    )
    return continue_mission(
        grid, estimator, world, robots, rng, options, team=team, truth=truth, goal=goal, stop=stop
    )


@typed
def continue_mission(
    grid: Grid,
    estimator: Estimator,
    world: World,
    robots: int,
    rng: np.random.Generator | int,
    options: SearchOptions = SearchOptions(),
    *,
    before: Sequence[Observation] = (),
    team: Team | None = None,
    truth: Truth | None = None,
    goal: Goal | None = None,
    stop: Stop | None = None,
) -> SimulatedMission:
    """
    Continue a mission from an estimator.

    This is the loop over robots (arXiv:2305.06929, Algorithm 1, line 1).

    Parameters
    ----------
    grid, world, rng, options, team, goal, stop
        As in `run_mission`.
    truth : Truth, optional
        True behaviour of the robots; by default as in the estimator.
    estimator : Estimator
        Estimator to start from; it is not changed.
    robots : int
        Number of further robots, at least 0.
    before : sequence of Observation
        Outcomes of the deployments that the estimator has assimilated.

    Returns
    -------
    SimulatedMission
        The deployments that follow.

    Raises
    ------
    ValueError
        As in `run_mission`.

    """
    team, truth, stop = team or Team(), truth or Truth(), stop or Stop()
    rng = generator(rng)
    world.check(grid)
    estimator, model = estimator.copy(), truth.model or estimator.model
    dynamics = truth.dynamics or estimator.probable_dynamics
    dynamics.known_rates()
    possible = grid.may_be_hazardous & (estimator.prior.hazard > 0.0)
    robots = whole_number('robots', robots, 0)
    team_size(grid, team.agents)
    stop.check(goal, len(before) + robots)
    if goal is not None:
        goal.check(grid, options.max_steps)
    deployments: list[Deployment] = []
    visited = count_visits(grid, [each.path for each in before])
    lost = sum(not each.survived for each in before)
    draws, decision = decided(goal, grid, estimator, len(before), options)
    while len(deployments) < robots and not stop.why(decision, lost):
        leaving = team.first(robots - len(deployments))
        try:
            known = estimator.belief, estimator.model
            plans = plan_round(goal, draws, grid, *known, leaving, options, visited=visited)
        except NoPathError:
            break
        if stop.why_not_worth(plans):
            break
        visited += count_visits(grid, [plan.path for plan in plans])
        for plan, robot_type in zip(plans, leaving.types):
            made = truth.execution.traverse(
                world,
                grid.at(robot_type.base),
                plan.path,
                robot_type.model(model),
                rng.spawn(1)[0],
                dynamics,
                changing=possible if before or deployments else None,
            )
            world = made.world
            estimator.assimilate(made.observation, robot_type)
            lost += not made.observation.survived
            number = len(before) + len(deployments) + 1
            draws, decision = decided(goal, grid, estimator, number, options)
            after = estimator.belief, estimator.model, dict(estimator.parameters)
            deployments.append(Deployment(plan, made.observation, *after, world, decision))
    return SimulatedMission(deployments)


def decided(
    goal: Goal | None, grid: Grid, estimator: Estimator, deployments: int, options: SearchOptions
) -> tuple[HazardDraws | None, Decision | None]:
    """Return the draws and the decision for a goal; None and None without a goal."""
    if goal is None:
        return None, None
    draws = HazardDraws.of(estimator, deployments)
    return draws, goal.decide(grid, draws, estimator.model, options.max_steps)


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
