# SPDX-License-Identifier: Apache-2.0
"""One mission of a study: its world, its run and its measures."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from typing import Any, NamedTuple

from kbnitp_ros.core import (
    Belief,
    Decision,
    Estimator,
    Execution,
    Grid,
    Mission,
    Truth,
    World,
)
from kbnitp_ros.core.decision.hazard_draws import joint_hazards
from kbnitp_ros.core.field.belief import binary_entropy, log_losses, surprisal
from kbnitp_ros.core.field.unknowns import Learnt
from kbnitp_ros.study.scenario import ALONE, Scenario, Strategy
from kbnitp_ros.study.scenario_file import Study
import numpy as np
from numpy.typing import NDArray
import pandas
from pandas import DataFrame

# Seed key of random layouts, distinct from the keys of worlds and robots.
LAID_OUT = 0x4C41594F

# Seed key of errors in prior maps, distinct from the keys of worlds and robots.
MAPPED = 0x4D415053

# Seed key of factors that break ties, distinct from the keys of worlds and robots.
TIED = 0x54494544

# Seed key of duds, distinct from the keys of worlds and robots.
NEVER = 0x44554453

# Correlation length of blobs, in cells: the standard deviation of a Gaussian kernel.
REACH = 1.0
# Maximum number of hazards in a row.
ROW = 5


def draw_world(
    scenario: Scenario,
    grid: Grid,
    truth: Mapping[str, float],
    rng: np.random.Generator,
    trial: int,
) -> World:
    """Draw the world of a trial."""
    densities = {name: truth[name] for name in vars(scenario.world)}
    if scenario.hazards.layout == 'independent':
        return World.random(grid, rng, **densities)
    own = np.random.default_rng([LAID_OUT, scenario.seed, trial])
    lay_out = {'blobs': blobs, 'rows': rows}[scenario.hazards.layout]
    count = round(densities['hazard_density'] * grid.cells)
    hazard = lay_out(grid, count, own) & grid.may_be_hazardous
    chance = np.where(hazard, densities['kappa'], densities['target_background'])
    return World(hazard, (rng.random((2, grid.cells))[1] < chance) & grid.free)


def blobs(grid: Grid, count: int, rng: np.random.Generator) -> NDArray[np.bool_]:
    """Return the `count` cells where a smooth Gaussian random field is highest."""
    row, column = np.divmod(np.arange(grid.cells), grid.width)
    squares = (row[:, None] - row) ** 2 + (column[:, None] - column) ** 2
    height = np.exp(-squares / (2.0 * REACH**2)) @ rng.standard_normal(grid.cells)
    hazard = np.zeros(grid.cells, np.bool_)
    hazard[np.argsort(-height)[:count]] = True
    return hazard


def rows(grid: Grid, count: int, rng: np.random.Generator) -> NDArray[np.bool_]:
    """Return `count` cells in straight rows along x, y or a diagonal."""
    hazard = np.zeros((grid.height, grid.width), np.bool_)
    while hazard.sum() < count:
        up, along = rng.choice([(0, 1), (1, 0), (1, 1), (1, -1)])
        row, column = rng.integers(grid.height), rng.integers(grid.width)
        for _ in range(ROW):
            if hazard.sum() < count and 0 <= row < grid.height and 0 <= column < grid.width:
                hazard[row, column] = True
            row, column = row + up, column + along
    return hazard.ravel()


def surveyed(prior: Belief, world: World, team: Strategy, seed: int, trial: int) -> Belief:
    """Return the prior updated with a team's map of hazards."""
    if not team.survey:
        return prior
    drawn = np.random.default_rng([MAPPED, seed, trial]).random(prior.cells)
    mapped = world.hazard ^ (drawn >= team.survey)
    trusted = team.trusted or team.survey
    likelihood = np.where(mapped[:, None] == [False, True], trusted, 1.0 - trusted)
    joint = prior.joint * likelihood[:, :, None]
    return Belief(joint / joint.sum(axis=(1, 2), keepdims=True))


# Number of classes of probabilities, each as wide, in which beliefs are compared with the truth.
CLASSES = 10

# Probability at which a cell is declared free of hazards.
DECLARED = 0.95


class Trial(NamedTuple):
    """The key of a mission in a study."""

    # Lethality of the world; None if it is drawn.
    lethality: float | None
    # Name of the method in `METHODS`, or of `LEARNERS`.
    method: str
    # Number of the world, from 0.
    number: int
    # Strategy of the mission.
    team: Strategy = ALONE
    # Values of the study's choices.
    choices: tuple[Any, ...] = ()


def list_trials(study: Study) -> list[Trial]:
    """Return all missions of a study in the order of its table."""
    return [
        Trial(lethality, method, number, team, choices)
        for choices, scenario in study.scenarios.items()
        for lethality in scenario.lethalities
        for method, team in scenario.contenders
        for number in range(scenario.trials)
    ]


# Maximum bytes of the mission in each worker, and of all results.
MAX_MISSION_BYTES = 1 << 30
MAX_BYTES = 1 << 32


def check_memory(study: Study) -> None:
    """Check that a study fits in memory."""
    scenario = study.first
    cells, rows = scenario.field().cells, scenario.robots + 1
    missions = len(list_trials(study))
    # A mission keeps all beliefs; it has some 15 measures a robot and 60 at the end, each of which
    # takes 200 bytes while the table is made.
    for what, numbers, most in (
        ('a mission', 4 * cells * rows, MAX_MISSION_BYTES),
        (f'{missions} missions', missions * 25 * (15 * rows + 60), MAX_BYTES),
    ):
        if 8 * numbers > most:
            raise ValueError(
                f'{what} of {scenario.robots} robots on {cells} cells takes about '
                f'{8 * numbers / 1e9:.1f} GB, and {most / 1e9:.1f} GB are allowed: lower '
                'grid.width, grid.height, robots or trials'
            )


def run_trial(study: Study, trial: Trial) -> DataFrame:
    """
    Run one mission; equal arguments give equal bits.

    Returns a row before the first robot and after each, which is constant after the end of a
    mission, with a column for each measure, NaN where there is none.
    """
    scenario = study.scenarios[trial.choices]
    rng = np.random.default_rng([scenario.seed, trial.number])
    grid = scenario.field()
    truth = scenario.truth(trial.lethality, trial.number)
    world = draw_world(scenario, grid, truth, rng, trial.number)
    if truth['duds']:
        own = np.random.default_rng([NEVER, scenario.seed, trial.number])
        world = world.with_duds(truth['duds'], own)
    prior, model = scenario.belief(truth), scenario.model(scenario.assumed(truth))
    if scenario.ties == 'random':
        prior = without_ties(prior, scenario.seed, trial.number)
    prior = surveyed(prior, world, trial.team, scenario.seed, trial.number)
    start = scenario.estimator(trial.method, trial.team, prior, model, trial.number)
    is_own = trial.team.paths == 'own'
    mission = Mission.resume(
        grid,
        start if is_own else Estimator(prior, model),
        world,
        rng,
        scenario.options(trial.team),
        truth=Truth(
            scenario.model(truth),
            Execution(contact=trial.team.last_contact),
            scenario.hazards.of_kind(scenario.hazards.dynamics),
            scenario.targets.truth,
        ),
        goal=scenario.goal(trial.team),
    ).run(scenario.robots, team=trial.team.leaving())
    known = list(knowledge(scenario, start, mission, is_own))
    beliefs = [each.belief for each in known]
    worlds = [world, *(deployment.world for deployment in mission)]
    lost = [not deployment.observation.survived for deployment in mission]
    # Maps before the first robot and after each, shape (robots + 1, cells).
    hazard = np.stack([belief.hazard for belief in beliefs])
    target = np.stack([belief.target for belief in beliefs])
    hazardous = np.stack([world.hazard for world in worlds])
    with_target = np.stack([world.target for world in worlds])
    of_hazard, of_target = (binary_entropy(maps).sum(axis=1) for maps in (hazard, target))
    hazard_loss, target_loss = log_losses(hazard, hazardous), log_losses(target, with_target)
    joint = np.stack([belief.joint.ravel() for belief in beliefs])
    joint_entropy = surprisal(joint).sum(axis=1)
    measured: dict[str, Iterable[float]] = {
        'entropy_hazard': of_hazard,
        'entropy_target': of_target,
        'entropy': of_hazard + of_target,
        'joint_entropy': joint_entropy,
        'hazard_log_loss': hazard_loss,
        'target_log_loss': target_loss,
        'log_loss': hazard_loss + target_loss,
        'hazard_brier': ((hazard - hazardous) ** 2).sum(axis=1),
        'target_brier': ((target - with_target) ** 2).sum(axis=1),
        'robots_lost': np.cumsum([0, *lost]),
        'false_targets': (target * (hazardous & ~with_target)).sum(axis=1),
        'planned_information': [np.nan, *(each.plan.information for each in mission)],
        'realised_information': -np.diff(joint_entropy, prepend=np.nan),
        **learnt_numbers([each.parameters for each in known], truth),
    }
    if scenario.asked is not None:
        decisions = [each.decision for each in known if each.decision is not None]
        measured |= measure_goal(list(scenario.asked.cells), decisions, hazard, hazardous)
    measures = DataFrame(measured, dtype=np.float64)
    at_end = {
        **calibration('hazard', hazard[-1], hazardous[-1]),
        **calibration('target', target[-1], with_target[-1]),
    }
    # A mission that ended keeps its last measures.
    measures = measures.reindex(range(scenario.robots + 1), method='ffill')
    return pandas.concat([measures, DataFrame(at_end, [scenario.robots])], axis=1)


def without_ties(prior: Belief, seed: int, trial: int) -> Belief:
    """Return a prior that differs enough from cell to cell that no two plans are equally good."""
    drawn = np.random.default_rng([TIED, seed, trial]).random(prior.joint.shape)
    joint = prior.joint * (1.0 + 1e-6 * drawn)
    return Belief(joint / joint.sum(axis=(1, 2), keepdims=True))


def calibration(
    name: str, believed: NDArray[np.float64], true: NDArray[np.bool_]
) -> dict[str, float]:
    """Return the cells of each class, the number expected in them, and the true one."""
    place = np.minimum((CLASSES * believed).astype(np.intp), CLASSES - 1)
    return {
        f'{name}_{what}_{number}': float(count)
        for what, weights in (('cells', None), ('expected', believed), ('true', true))
        for number, count in enumerate(np.bincount(place, weights, CLASSES))
    }


class Knowledge(NamedTuple):
    """Knowledge of a strategy at a time; without a goal the decision is None."""

    belief: Belief
    parameters: Mapping[str, Learnt]
    decision: Decision | None


def knowledge(
    scenario: Scenario, start: Estimator, mission: Mission, is_own: bool
) -> Iterator[Knowledge]:
    """Yield what a strategy knows before the first robot and after each."""
    goal = None if scenario.asked is None else scenario.asked.sought()
    grid, steps, estimator = scenario.field(), scenario.planning.max_steps, start.copy()

    def known(robots: int) -> Knowledge:
        decision = None
        if goal is not None:
            decision = goal.decide(grid, joint_hazards(estimator, robots), estimator.model, steps)
        return Knowledge(estimator.belief, estimator.parameters, decision)

    yield known(0)
    for robots, deployment in enumerate(mission, 1):
        if is_own and (goal is None or deployment.decision is not None):
            yield Knowledge(deployment.belief, deployment.parameters, deployment.decision)
        else:
            estimator.assimilate(deployment.observation)
            yield known(robots)


def learnt_numbers(
    known: Sequence[Mapping[str, Learnt]], truth: Mapping[str, float]
) -> dict[str, Sequence[float]]:
    """Return mean, sd, 5 and 95 % quantiles of the learnt numbers, and the truth."""
    learnt = {name: [each[name] for each in known] for name in truth if name in known[0]}
    return {
        key: values
        for name, each in learnt.items()
        for key, values in {
            f'{name}_mean': [number.mean for number in each],
            f'{name}_sd': [number.sd for number in each],
            f'{name}_5': [number.quantile(0.05) for number in each],
            f'{name}_95': [number.quantile(0.95) for number in each],
            f'{name}_true': [truth[name]] * len(each),
        }.items()
    }


def measure_goal(
    cells: list[int],
    decisions: Sequence[Decision],
    hazard: NDArray[np.float64],
    hazardous: NDArray[np.bool_],
) -> dict[str, Iterable[float]]:
    """
    Return the measures of decisions before the first robot and after each.

    Robots sent; believed probability that the goal is free, its error, and whether it is free;
    shares of the goal's cells declared free, and rightly declared free.
    """
    declared = hazard[:, cells] <= 1.0 - DECLARED
    return {
        'sent': range(len(decisions)),
        'p_free': [decision.p_free for decision in decisions],
        'free': [float(not true[each.cells].any()) for true, each in zip(hazardous, decisions)],
        'p_free_error': [decision.error for decision in decisions],
        'declared': declared.mean(axis=1),
        'declared_free': (declared & ~hazardous[:, cells]).mean(axis=1),
    }
