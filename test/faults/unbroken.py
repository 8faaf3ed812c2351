# SPDX-License-Identifier: Apache-2.0
"""The undisturbed mission in the core, and random faults for its nodes."""

from dataclasses import dataclass, replace
from signal import SIGKILL, Signals, SIGSTOP

from kbnitp_ros.configuration import make_estimator, make_goal, make_grid, TABLE
from kbnitp_ros.configuration.agents import (
    make_clustering,
    make_dynamics,
    make_execution,
    make_robot_types,
    make_sensor_model,
    make_target_dynamics,
    make_unknowns,
)
from kbnitp_ros.configuration.mission import make_stop, search_options
from kbnitp_ros.core import Learning, METHODS, Observation, run_mission, Team, Truth, World
import numpy as np


def draw_parameters(rng):
    side = int(rng.integers(5, 6, endpoint=True))
    method = str(rng.choice(list(METHODS)))
    learn = ['lethality', 'hazard_density'] if method == 'kappa_bnitp_sampled' else []
    drawn = {
        'grid.width': side, 'grid.height': side, 'max_steps': 10, 'robots': 15, 'method': method,
        'learn.numbers': learn, 'planner': str(rng.choice(['relaxed', 'beam'])), 'beam_width': 4,
        'seed': int(rng.integers(2**31)),
        'agents': [f'scout_{number + 1}' for number in range(rng.integers(1, 4, endpoint=True))],
        'rolling': bool(rng.random() < 0.25), 'silent_loss': bool(rng.random() < 0.25),
        'return_deadline': 0.5, **draw_conduct(rng),
    }  # fmt: skip
    if drawn['silent_loss']:
        # The simulation refuses silent losses together with contacts.
        drawn.pop('contact_probability', None)
        # Robots are given up by the duration of a step.
        drawn['step_period'] = 0.001
    return drawn


def draw_conduct(rng):
    """Draw deviations of robots from their orders; half of the missions have none."""
    if rng.random() < 0.5:
        return {}
    return {
        'detour_probability': 0.1,
        'early_return_probability': 0.02,
        'contact_probability': 0.3,
        'camera_failure_probability': 0.05,
    }


def with_defaults(parameters):
    """Return the values of all parameters of all nodes."""
    return {parameter.name: parameter.default for parameter in TABLE} | parameters


def true_values(parameters):
    """Return the agents' true values, by names that begin with true."""
    return {
        name.removeprefix('true.'): value
        for name, value in parameters.items()
        if name.startswith('true.')
    }


def core_mission(parameters):
    values = with_defaults(parameters)
    grid = make_grid(values)
    true = {**values, **true_values(parameters), 'learn.numbers': ()}
    rng = np.random.default_rng(values['seed'])
    world = World.random(
        grid,
        rng,
        values['world.hazard_density'],
        values['world.kappa'],
        values['world.target_background'],
    )
    if duds := true['sensor.duds']:
        world = world.with_duds(duds, values['seed'])
    return run_mission(
        grid,
        make_estimator(values, make_grid(values)).prior,
        make_sensor_model(values),
        world,
        values['robots'],
        rng,
        values['method'],
        search_options(values),
        team=Team(
            len(values['agents']),
            values['allocation'],
            tuple(make_robot_types(values, grid).values()),
        ),
        truth=Truth(
            execution=make_execution(values),
            dynamics=make_dynamics(true),
            target_dynamics=make_target_dynamics(true),
        ),
        learning=Learning(make_unknowns(values), values['seed'], make_clustering(values, grid)),
        dynamics=make_dynamics(values),
        target_dynamics=make_target_dynamics(values),
        goal=make_goal(values, grid),
        stop=make_stop(values),
    )


def says_more(report):
    """Return the more informative of two reports, which counts."""
    return report.survived, report.steps_survived, len(report.lost_at) - sum(report.lost_at)


def folded(parameters, evidence):
    """Return the belief after all deployments, in their order; a return beats a loss."""
    values = with_defaults(parameters)
    grid = make_grid(values)
    estimator = make_estimator(values, make_grid(values))
    for key in sorted(evidence.reports, key=lambda key: key.stamp):
        (path, *_) = evidence.paths[key]
        report = max(evidence.reports[key], key=says_more)
        walk, readings = grid.cells_at(path), None
        if report.survived:
            steps, readings = zip(*report.readings)
            walk = [walk[0], *steps]
        known, lost_at = report.steps_survived, report.lost_at or None
        observation = Observation(walk, report.survived, readings, known, lost_at)
        estimator.assimilate(observation, make_robot_types(values, grid)[key.agent])
    return estimator.belief


NODES = ('recorder', 'estimator', 'agent', 'planner')

# Number of nodes that each kind of fault hits.
STRUCK = {'kill': 1, 'stop': 1, 'two': 2, 'all': len(NODES)}

# A mixed mission has faults of all kinds.
KINDS = (*STRUCK, 'mixed')


@dataclass(frozen=True)
class Fault:
    """One or more nodes hit at a moment, each back after a pause."""

    kind: str
    reports: int
    delay: float
    pauses: dict[str, float]
    # Whether the operator pauses the mission meanwhile, or is about to.
    is_held: bool = False

    @property
    def signal(self) -> Signals:
        """Return the signal: stopped nodes continue, killed ones are restarted."""
        return SIGSTOP if self.kind == 'stop' else SIGKILL


def draw_faults(rng: np.random.Generator, kind: str, robots: int) -> list[Fault]:
    """Draw one to five faults of a kind, ordered by the number of reports they wait for."""
    reports_at = rng.integers(0, robots, size=2)
    faults = []
    for reports in sorted(rng.choice(reports_at, size=rng.integers(1, 6)).tolist()):
        drawn = rng.choice(list(STRUCK), p=(0.4, 0.2, 0.2, 0.2)) if kind == 'mixed' else kind
        struck = rng.permutation(NODES)[: STRUCK[drawn]]
        longest = 2.0 if not reports or rng.random() < 0.15 else 0.06
        pauses = {str(node): rng.uniform(0.0, 0.5) for node in struck}
        faults.append(Fault(str(drawn), reports, rng.uniform(0.0, longest), pauses))
    return [replace(fault, is_held=bool(rng.random() < 0.3)) for fault in faults]
