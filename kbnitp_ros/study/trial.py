# SPDX-License-Identifier: Apache-2.0
"""One mission of a study: its world, its run and its measures."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from typing import NamedTuple

from kbnitp_ros.core import (
    Belief,
    Decision,
    Estimator,
    Execution,
    Grid,
    HazardDraws,
    Mission,
    Truth,
    World,
)
from kbnitp_ros.core.field.belief import binary_entropy, log_losses, surprisal
from kbnitp_ros.core.field.unknowns import Learnt
from kbnitp_ros.study.scenario import ALONE, DecisionRequest, NUMBERS, Scenario, Strategy
import numpy as np
from numpy.typing import ArrayLike, NDArray

# Seed key of random layouts, distinct from the keys of worlds and robots.
LAID_OUT = 0x4C41594F

# Seed key of errors in prior maps, distinct from the keys of worlds and robots.
MAPPED = 0x4D415053

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


# Measures before the first robot and after each; entropies and losses are sums over cells.
MEASURES = (
    'entropy_hazard',
    'entropy_target',
    'entropy',
    'joint_entropy',
    'hazard_log_loss',
    'target_log_loss',
    'hazard_brier',
    'target_brier',
    'robots_lost',
    'planned_information',
    'realised_information',
)

# Statistics saved of the posterior of a number.
QUANTILES = (0.05, 0.25, 0.5, 0.75, 0.95)
LEARNT = ('mean', 'sd', *QUANTILES)


class Trial(NamedTuple):
    """The key of a mission in a study."""

    # Lethality of the world; None if it is drawn.
    lethality: float | None
    # Name of the method in `METHODS`, or `LEARNING`.
    method: str
    # Number of the world, from 0.
    number: int
    # Strategy of the mission.
    team: Strategy = ALONE


class MissionResult(NamedTuple):
    """The saved result of a mission."""

    # The measures of `measure_names` before the first robot and after each, shape (robots + 1,
    # measures); constant after the end of a mission. Information is NaN in the first row.
    measures: NDArray[np.float64]
    # The hazard and the target map after the last robot, shape (2, cells).
    believed: NDArray[np.float64]
    # The true hazards and targets after the last robot, shape (2, cells).
    truth: NDArray[np.bool_]
    # Statistics `LEARNT` of the posterior of each of `NUMBERS`, shape (robots + 1, numbers,
    # learnt); NaN for known numbers.
    learnt: NDArray[np.float64]
    # The world's `NUMBERS`, shape (numbers,).
    numbers: NDArray[np.float64]


def measure_names(scenario: Scenario) -> tuple[str, ...]:
    """Return the names of a scenario's measures."""
    return MEASURES if scenario.asked is None else MEASURES + OF_GOALS


def list_trials(scenario: Scenario) -> list[Trial]:
    """Return all missions of a scenario in the order of its table."""
    return [
        Trial(lethality, method, number, team)
        for lethality in scenario.lethalities
        for method, team in scenario.contenders
        for number in range(scenario.trials)
    ]


def run_trial(scenario: Scenario, trial: Trial) -> MissionResult:
    """Run one mission; equal arguments give equal bits."""
    rng = np.random.default_rng([scenario.seed, trial.number])
    grid = scenario.field()
    truth = scenario.truth(trial.lethality, trial.number)
    world = draw_world(scenario, grid, truth, rng, trial.number)
    believed = dict(truth)
    if scenario.believed_lethality is not None:
        believed['lethality'] = scenario.believed_lethality
    prior, model = scenario.belief(truth), scenario.model(believed)
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
        ),
        goal=scenario.goal(trial.team),
    ).run(scenario.robots, team=trial.team.leaving())
    beliefs, known = zip(*knowledge(start, mission, is_own))
    worlds = [world, *(deployment.world for deployment in mission)]
    lost = [not deployment.observation.survived for deployment in mission]
    # Maps before the first robot and after each, shape (robots + 1, cells).
    hazard = np.stack([belief.hazard for belief in beliefs])
    target = np.stack([belief.target for belief in beliefs])
    hazardous = np.stack([world.hazard for world in worlds])
    with_target = np.stack([world.target for world in worlds])
    of_hazard, of_target = (binary_entropy(maps).sum(axis=1) for maps in (hazard, target))
    joint = np.stack([belief.joint.ravel() for belief in beliefs])
    joint_entropy = surprisal(joint).sum(axis=1)
    measured: dict[str, Iterable[float]] = {
        'entropy_hazard': of_hazard,
        'entropy_target': of_target,
        'entropy': of_hazard + of_target,
        'joint_entropy': joint_entropy,
        'hazard_log_loss': log_losses(hazard, hazardous),
        'target_log_loss': log_losses(target, with_target),
        'hazard_brier': ((hazard - hazardous) ** 2).sum(axis=1),
        'target_brier': ((target - with_target) ** 2).sum(axis=1),
        'robots_lost': np.cumsum([0, *lost]),
        'planned_information': [np.nan, *(each.plan.information for each in mission)],
        'realised_information': -np.diff(joint_entropy, prepend=np.nan),
    }
    if scenario.asked is not None:
        measured |= measured_for(
            scenario.asked,
            grid,
            scenario.planning.max_steps,
            start,
            mission,
            is_own,
            beliefs,
            worlds,
        )
    return MissionResult(
        carried([*zip(*(measured[name] for name in measure_names(scenario)))], scenario.robots),
        np.stack([hazard[-1], target[-1]]),
        np.stack([hazardous[-1], with_target[-1]]),
        carried(
            [[as_learnt(numbers.get(name)) for name in NUMBERS] for numbers in known],
            scenario.robots,
        ),
        np.array([truth[name] for name in NUMBERS]),
    )


def knowledge(
    start: Estimator, mission: Mission, is_own: bool
) -> Iterator[tuple[Belief, Mapping[str, Learnt]]]:
    """Yield the belief and the posteriors of numbers, before the first robot and after each."""
    yield start.belief, start.parameters
    estimator = start.copy()
    for deployment in mission:
        if is_own:
            yield deployment.belief, deployment.parameters
        else:
            estimator.assimilate(deployment.observation)
            yield estimator.belief, estimator.parameters


def carried(rows: ArrayLike, robots: int) -> NDArray[np.float64]:
    """Return `robots` + 1 rows: after an early end the last row is repeated."""
    array = np.array(rows, dtype=np.float64)
    after_the_last = (0, robots + 1 - len(array)), *[(0, 0)] * (array.ndim - 1)
    return np.pad(array, after_the_last, 'edge')


def as_learnt(number: Learnt | None) -> tuple[float, ...]:
    """Return the statistics `LEARNT` of a number; NaN if it is known."""
    if number is None:
        return (np.nan,) * len(LEARNT)
    return number.mean, number.sd, *map(number.quantile, QUANTILES)


# Probability at which a cell is declared free of hazards.
DECLARED = 0.95


# Measures of decisions: robots sent; believed probability that the goal is free, and whether it is
# free; independent draws; shares of the goal's cells declared free, and rightly declared free.
OF_GOALS = ('sent', 'p_free', 'free', 'independent_draws', 'declared', 'declared_free')


def measured_for(
    asked: DecisionRequest,
    grid: Grid,
    max_steps: int,
    estimator: Estimator,
    mission: Mission,
    is_own: bool,
    beliefs: Sequence[Belief],
    worlds: Sequence[World],
) -> dict[str, Iterable[float]]:
    """Return the measures `OF_GOALS` before the first robot and after each."""
    goal = asked.sought()

    def decide(deployments: int) -> Decision:
        draws = HazardDraws.of(estimator, deployments)
        return goal.decide(grid, draws, estimator.model, max_steps)

    decisions = [decide(0)]
    for number, deployment in enumerate(mission, 1):
        if is_own and deployment.decision is not None:
            decisions.append(deployment.decision)
        else:
            estimator.assimilate(deployment.observation)
            decisions.append(decide(number))
    cells, hazard = list(asked.cells), np.stack([world.hazard for world in worlds])
    declared = np.stack([belief.hazard[cells] <= 1.0 - DECLARED for belief in beliefs])
    return {
        'sent': range(len(decisions)),
        'p_free': [decision.p_free for decision in decisions],
        'free': [float(not true[each.cells].any()) for true, each in zip(hazard, decisions)],
        'independent_draws': [decision.independent_draws for decision in decisions],
        'declared': declared.mean(axis=1),
        'declared_free': (declared & ~hazard[:, cells]).mean(axis=1),
    }
