# SPDX-License-Identifier: Apache-2.0
"""The agents, robots, sensors and dynamics that the parameters describe."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import fields
import itertools
from typing import Any

from kbnitp_ros.configuration.table import LEARN, LEARNT_WITH_DUDS, MAX_AGENTS, OPERATOR
from kbnitp_ros.core import (
    Beta,
    Clustering,
    Dynamics,
    Execution,
    Grid,
    RobotType,
    SensorModel,
    Unknowns,
)
from kbnitp_ros.core.field.sensor import OF_HAZARDS, SENSORS
from kbnitp_ros.core.field.unknowns import HAZARD_RATES, ZERO
from kbnitp_ros.core.inference.estimator import has_ability
from kbnitp_ros.core.inference.methods import check_able
from kbnitp_ros.plugins import entry_name


def make_sensor_model(values: Mapping[str, Any]) -> SensorModel:
    """Return the sensor model that these parameters describe."""
    return SensorModel(**{name: values[f'sensor.{name}'] for name in (*SENSORS, *OF_HAZARDS)})


def make_priors(values: Mapping[str, Any]) -> dict[str, Beta]:
    """Return the priors of learnable numbers and rates, by name."""
    learn = values['learn.numbers']
    if len(set(learn)) < len(learn):
        raise ValueError(
            f'parameter learn.numbers is {list(learn)}: it must name each number once'
        )
    priors = {}
    for name in LEARN:
        believed = values[f'learn.{name}']
        try:
            if len(believed) not in (2, 4):
                raise ValueError('it must be low and high, or low, high, a and b')
            own = dict(zip(('low', 'high', 'a', 'b'), believed))
            priors[name] = Beta(**own, zero=ZERO.get(name, 0.0))
        except ValueError as error:
            raise ValueError(f'parameter learn.{name} is {list(believed)}: {error}') from error
    return priors


def make_unknowns(values: Mapping[str, Any]) -> Unknowns:
    """Return the unknown numbers, which are learnt."""
    priors, rates = make_priors(values), [*itertools.chain(*HAZARD_RATES.values())]
    return Unknowns(**{name: priors[name] for name in learnt_numbers(values) if name not in rates})


def learnt_numbers(values: Mapping[str, Any]) -> tuple[str, ...]:
    """Return the numbers to learn: `learn.numbers`, and those that are learnt with duds."""
    learn = tuple(values.get('learn.numbers') or ())
    return tuple(dict.fromkeys((*learn, *(LEARNT_WITH_DUDS if 'duds' in learn else ()))))


def check_duds(values: Mapping[str, Any]) -> None:
    """Check that method, hazards and believed targets allow duds, if there may be some."""
    told, learnt = values['sensor.duds'], 'duds' in learnt_numbers(values)
    if not (told or learnt):
        return
    given = f'parameter sensor.duds is {told}' if told else 'parameter learn.numbers has duds'
    dynamics = {'hazards': make_dynamics(values)}
    # Agents believe nothing, and their targets may change.
    if 'method' in values:
        dynamics['targets'] = make_target_dynamics(values)
        needed = ('reaches', 'correlated') if learnt else ('reaches',)
        check_able(
            values['method'],
            lambda each: all(has_ability(name, each) for name in needed),
            f'{given}, and method {entry_name(values["method"])} does not take them',
        )
    for what, each in dynamics.items():
        if each.effect != 'static':
            raise ValueError(f'{given}, and {what}.dynamics is {each.kind}: duds are static')


def make_dynamics(values: Mapping[str, Any]) -> Dynamics:
    """Return the believed dynamics of hazards."""
    kind = values['hazards.dynamics']
    # Agents have no parameter learn.numbers.
    learn = values.get('learn.numbers', ())
    priors = make_priors(values) if 'learn.numbers' in values else {}
    rates = {}
    try:
        for own, name in ((own, name) for own, names in HAZARD_RATES.items() for name in names):
            rate = values[f'hazards.{name}']
            if name in learn and rate:
                raise ValueError(
                    f'{name} is {rate}, but learn.numbers names {name}: leave it at 0'
                )
            if name in learn and kind not in (own, 'learn'):
                raise ValueError(
                    f'dynamics is {kind}, but learn.numbers has {name}, a rate of {own} hazards'
                )
            is_open = name in learn or (kind == 'learn' and not rate)
            rates[name] = priors.get(name, rate) if is_open else rate
        return Dynamics(kind, **rates)
    except ValueError as error:
        raise ValueError(f'parameter hazards.{error}') from error


def make_target_dynamics(values: Mapping[str, Any]) -> Dynamics:
    """Return the dynamics of targets."""
    rates = {name: values[f'targets.{name}'] for name in ('appear', 'vanish', 'move')}
    try:
        return Dynamics(values['targets.dynamics'], **rates)
    except ValueError as error:
        raise ValueError(f'parameter targets.{error}'.replace('hazards', 'targets')) from error


def true_dynamics(values: Mapping[str, Any]) -> tuple[Dynamics, Dynamics]:
    """Return the true dynamics of hazards and targets; refuse an unknown kind or rate."""
    check_duds(values)
    dynamics = {'hazards': make_dynamics(values), 'targets': make_target_dynamics(values)}
    for what, each in dynamics.items():
        try:
            each.known_rates()
        except ValueError as error:
            raise ValueError(
                f'parameter {what}.{error}; to learn it, set it for the estimator only, such as '
                f'estimator:{what}.dynamics=learn'
            ) from error
    return dynamics['hazards'], dynamics['targets']


def make_clustering(values: Mapping[str, Any], grid: Grid) -> Clustering | None:
    """Return the clustering of hazards; None if they are independent."""
    coupling = values['prior.clustering']
    return Clustering(grid, coupling) if coupling else None


def make_execution(values: Mapping[str, Any]) -> Execution:
    """Return the deviations of simulated robots from their orders."""
    if values['silent_loss'] and values['contact_probability'] > 0.0:
        raise ValueError(
            f'contact_probability is {values["contact_probability"]}, and silent_loss is true: '
            'simulated robots either report their steps or are silent; set only one of them'
        )
    return Execution(
        detour=values['detour_probability'],
        early_return=values['early_return_probability'],
        contact=values['contact_probability'],
        camera_failure=values['camera_failure_probability'],
    )


def agent_names(values: Mapping[str, Any], grid: Grid) -> tuple[str, ...]:
    """Return the names of the agents."""
    agents: tuple[str, ...] = values['agents']
    named = f'parameter agents is {list(agents)}'
    counted = f'parameter agents has {len(agents)} names'
    if not agents or len(set(agents)) < len(agents):
        raise ValueError(f'{named}: it must be one or more names, no two alike')
    if OPERATOR in agents:
        raise ValueError(
            f'{named}: {OPERATOR} cannot name an agent, since a topic of the planner has that name'
        )
    if len(agents) > MAX_AGENTS:
        raise ValueError(f'{counted}: there can be at most {MAX_AGENTS}')
    free = int(grid.free.sum())
    if len(agents) > free:
        raise ValueError(f'{counted}: there can be at most one for each of the {free} free cells')
    return agents


def value_for(values: Mapping[str, Any], name: str, agent: str) -> Any:
    """Return an agent's own value of a parameter, or else the common value."""
    return values.get(f'team.{agent}.{name}', values[name])


def most_steps(values: Mapping[str, Any]) -> int:
    """Return the largest `max_steps` of any agent."""
    return max(int(value_for(values, 'max_steps', agent)) for agent in values['agents'])


def most_distance(values: Mapping[str, Any], agents: Iterable[str]) -> float:
    """Return the largest `max_distance` of these agents, metres; 0 for no limit."""
    distances = [value_for(values, 'max_distance', agent) for agent in agents]
    return max(distances) if all(distances) else 0.0


def cell_at(values: Mapping[str, Any], name: str, grid: Grid) -> int | None:
    """Return the cell at the position in a parameter; None if it is empty."""
    position = values.get(name)
    check_position(name, position)
    try:
        return int(grid.cells_at([position])[0]) if position else None
    except ValueError as error:
        raise ValueError(f'parameter {name}: {error}') from error


def check_position(name: str, position: Sequence[float] | None) -> None:
    """Check that a position has two coordinates, unless it is empty."""
    if position and len(position) != 2:
        raise ValueError(f'parameter {name} is {list(position)}: it must be x and y, or empty')


def own_base(values: Mapping[str, Any], agent: str, grid: Grid) -> int | None:
    """Return an agent's own base; None if it has the common base."""
    name = f'team.{agent}.base'
    cell, has_position = values.get(name), bool(values.get(f'{name}_position'))
    if cell is not None and has_position:
        raise ValueError(f'parameters {name} and {name}_position are both given: give one of them')
    return cell_at(values, f'{name}_position', grid) if has_position else cell


def make_robot_type(values: Mapping[str, Any], agent: str, grid: Grid) -> RobotType:
    """Return the type of an agent's robots."""
    sensor = {each.name for each in fields(SensorModel)}
    names = {each.name for each in fields(RobotType)} - {'base'}
    given = {name: f'sensor.{name}' if name in sensor else name for name in names}
    return RobotType(
        base=own_base(values, agent, grid),
        **{name: values.get(f'team.{agent}.{each}') for name, each in given.items()},
    )


def make_robot_types(values: Mapping[str, Any], grid: Grid) -> dict[str, RobotType]:
    """Return the robot types of all agents, on the grid of these parameters."""
    return {agent: make_robot_type(values, agent, grid) for agent in values['agents']}


def own_robot_types(values: Mapping[str, Any], grid: Grid) -> dict[str, RobotType]:
    """Return the robot types of agents that differ from the common type."""
    types = make_robot_types(values, grid)
    return {agent: robot_type for agent, robot_type in types.items() if robot_type.own}
