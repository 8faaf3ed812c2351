# SPDX-License-Identifier: Apache-2.0
"""What a study varies and what it holds fixed, as a small YAML file says it."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, fields
from typing import Annotated, NamedTuple

from kbnitp_ros.core import (
    ALLOCATIONS,
    Belief,
    Beta,
    Clustering,
    Dynamics,
    Estimator,
    Goal,
    Grid,
    Lane,
    METHODS,
    OBJECTIVES,
    ORDINARY,
    PathFinder,
    Plan,
    PLANNERS,
    RobotType,
    safest_path,
    SearchOptions,
    SensorModel,
    Stop,
    Team,
    Unknowns,
)
from kbnitp_ros.core.decision.decision import there_and_back
from kbnitp_ros.core.decision.goals import GOALS, Situation
from kbnitp_ros.core.field.unknowns import ALL_KNOWN, HAZARD_RATES, HAZARDS
from kbnitp_ros.core.planning.options import ALPHAS
from kbnitp_ros.core.planning.plans import check_team, team_size
import numpy as np

# What robots are sent for, besides `GOALS`, to compare these with.
SAFEST_LANE = 'safest_lane'


@dataclass(frozen=True)
class Asked:
    """The decision that missions of a study are asked for, whatever their robots are sent for."""

    # Of `GOALS`, but for 'map'.
    goal: Annotated[str, GOALS]
    # Those of the goal.
    cells: tuple[Annotated[int, (0, 999_999)], ...]
    # The probability at which missions that are sent for the goal end; 0: they do not.
    confidence: Annotated[float, (0.0, 1.0)] = 0.0

    def sought(self) -> Goal:
        """Return the goal."""
        goal = GOALS[self.goal](self.cells, self.confidence or None)
        if goal is None:
            raise ValueError('map is no decision: ask for a goal that has one')
        return goal

    def goal_of(self, sent_for: str) -> Goal | None:
        """Return the goal of missions whose robots are sent for something; None for a map."""
        if sent_for == 'map':
            return None
        if sent_for == SAFEST_LANE and self.goal == Lane.name:
            return SafestLane(self.cells[0], self.confidence or None)
        if sent_for != self.goal:
            raise ValueError(f'robots are sent for {sent_for}, and {self.goal} is asked for')
        return self.sought()

    def check(self, grid: Grid, robots: int, max_steps: int) -> None:
        """Refuse a goal that is none, or cannot be reached on a field."""
        goal = self.sought()
        goal.check(grid, max_steps)
        Stop().check(goal, robots)


class SafestLane(Lane):
    """A lane, for which robots fly out and back on the one that is safest by now."""

    def flight(self, situation: Situation) -> Plan | None:
        """Return the safest lane, there and back."""
        grid, draws, model = situation.grid, situation.draws, situation.model
        half = situation.options.max_steps // 2
        lane = safest_path(grid, draws, model, grid.base, self.to, half).path
        return situation.planned(there_and_back(lane, lane), 0.0)


# What is compared: the methods, which are told all numbers, and the sampled one when it learns
# those of the section learn instead.
SAMPLED = 'kappa_bnitp_sampled'
LEARNING = f'{SAMPLED}_learning'

# The numbers that can be learnt.
NUMBERS = tuple(field.name for field in fields(Unknowns))

# The options of a search.
OPTIONS = tuple(field.name for field in fields(SearchOptions))

# How the hazards of worlds lie, as of `laid_out`.
LAYOUTS = ('independent', 'blobs', 'rows')

# On whose belief paths are planned.
PATHS = ('own', 'static')

# Keys of the generators of numbers that are drawn, which no world has.
DRAWN = 0x4452574E

# A value's type, and what is allowed: the lowest and the highest number, or names, as of a
# registry, and further ones.
Count = Annotated[int, (1, 1_000_000)]
Probability = Annotated[float, (0.0, 1.0)]


@dataclass(frozen=True)
class Extent:
    """The grid."""

    # Cells along x and y, 1 to 1000.
    width: Annotated[int, (1, 1000)]
    height: Annotated[int, (1, 1000)]
    # The cell (row * width + column, row 0 at the bottom) of every start and return.
    base: Annotated[int, (0, 999_999)]


@dataclass(frozen=True)
class Planning:
    """How paths are searched for, as of `SearchOptions`."""

    planner: Annotated[str, PLANNERS]
    max_steps: Count
    width: Count
    max_visits: Count
    max_distance: Annotated[float, (0.0, 1e9)] = 0.0


@dataclass(frozen=True)
class Strategy:
    """How robots are deployed: the team, what paths are planned for, what is known before."""

    # How many, at least 1.
    agents: Count = 1
    # Of `ALLOCATIONS`.
    allocation: Annotated[str, ALLOCATIONS] = 'greedy'
    # The cost of a lost robot, nats, 0 to 1000.
    loss_cost: Annotated[float, (0.0, 1000.0)] = 0.0
    # The probability that the base hears, after each step, how far a robot is, 0 to 1.
    last_contact: Probability = 0.0
    # Of `PLANNERS`; empty for that of the section planning.
    planner: Annotated[str, PLANNERS, ''] = ''
    # The part of the cells of which a map of hazards, known before the first robot, is right, 0 to
    # 1; 0 for no map.
    survey: Probability = 0.0
    # The part of which it is believed to be, 0 to 1; 0 for as many as it is.
    trusted: Probability = 0.0
    # Of `OBJECTIVES`.
    objective: Annotated[str, OBJECTIVES] = 'information'
    # Of the objective 'behavioral', 0.2 to 5.
    alpha: Annotated[float, ALPHAS] = 1.0
    # The kind of hazards that are believed in, of `HAZARDS`; empty for that of the worlds.
    dynamics: Annotated[str, HAZARDS, ''] = ''
    # 'learn': hazards are believed to cluster, with a coupling that is learnt; empty: they are
    # believed to lie independently.
    clustering: Annotated[str, ('learn',), ''] = ''
    # 'own': they are planned on what is believed. 'static': on what `kappa_bnitp` believes of
    # static hazards, so that all who have these paths have the same evidence.
    paths: Annotated[str, PATHS] = 'own'
    # The cell that every second robot of those that leave together starts and ends in; -1: all do
    # so in the base of the grid.
    second_base: Annotated[int, (-1, 999_999)] = -1
    # What robots are sent for: of `GOALS`, or 'safest_lane'.
    goal: Annotated[str, GOALS, SAFEST_LANE] = 'map'

    @property
    def sought(self) -> str:
        """Return what it seeks in a word: the alpha tells one behavioral objective from others."""
        return f'alpha {self.alpha:.4g}' if self.objective == 'behavioral' else self.objective

    def leaving(self) -> Team:
        """Return the robots that leave together."""
        types: tuple[RobotType, ...] = ()
        if self.second_base >= 0:
            types = tuple(
                RobotType(base=self.second_base) if robot % 2 else ORDINARY
                for robot in range(self.agents)
            )
        return Team(self.agents, self.allocation, types)


# Robots one by one, whatever they cost.
ALONE = Strategy()


class Contender(NamedTuple):
    """A way to do a mission: the method of its estimator and the team it sends."""

    method: str
    team: Strategy


def drawn_from(prior: Beta, rng: np.random.Generator) -> float:
    """Draw a number: where its uniform quantile lies among the bins of its prior."""
    bins = prior.bins()
    below = np.append(0.0, np.cumsum(np.exp(bins.log_prior)))
    return float(np.interp(rng.random() * below[-1], below, bins.edges))


@dataclass(frozen=True)
class Densities:
    """How worlds are drawn, as for `World.random`; None is drawn anew for each world."""

    hazard_density: Probability | None
    kappa: Probability | None
    target_background: Probability | None


@dataclass(frozen=True)
class Hazards:
    """How the hazards of the worlds lie and change."""

    # Their kind, of `HAZARDS`.
    dynamics: Annotated[str, HAZARDS] = 'static'
    # Rates of changing and of moving hazards, in the worlds and as believed.
    appear: Probability = 0.0
    vanish: Probability = 0.0
    move: Probability = 0.0
    # Of `LAYOUTS`.
    layout: Annotated[str, LAYOUTS] = 'independent'

    def of_kind(self, kind: str) -> Dynamics:
        """Return how hazards of a kind change; empty: as they do."""
        kind = kind or self.dynamics
        return Dynamics(kind, **{name: getattr(self, name) for name in HAZARD_RATES.get(kind, ())})


INDEPENDENT = Hazards()


@dataclass(frozen=True)
class Sensor:
    """The robots and their sensors but for the lethality, as for `SensorModel`."""

    malfunction: Probability | None
    false_negative: Probability
    true_positive: Probability | None
    false_positive: Probability | None


@dataclass(frozen=True)
class Prior:
    """What is believed of every cell but the base before the first robot."""

    hazard: Probability
    target: Probability
    kappa: Probability


@dataclass(frozen=True)
class Scenario:
    """A study: missions by every method and team, at every lethality, in the same worlds."""

    # At least 0. Trial t draws its world and its robots' outcomes from ``[seed, t]``, whatever the
    # method, the team and the lethality.
    seed: Annotated[int, (0, 2**63 - 1)]
    # Worlds, at least 1.
    trials: Count
    # Deployments of a mission, at least 1.
    robots: Count
    # Of `METHODS`, or `LEARNING`.
    methods: tuple[Annotated[str, METHODS, LEARNING], ...]
    # Of the worlds, in [0, 1]; None is drawn anew for each world.
    lethalities: tuple[Probability | None, ...]
    # Sections of their own. Without a prior it is that of the world's densities.
    grid: Extent
    planning: Planning
    world: Densities
    sensor: Sensor
    prior: Prior | None
    # What planner and estimator hold for the lethality, in [0, 1]; None for the world's.
    believed_lethality: Probability | None = None
    # Without them robots go one by one.
    teams: tuple[Strategy, ...] = (ALONE,)
    # What the method that learns is not told, and what numbers that are None are drawn from.
    learn: Unknowns = ALL_KNOWN
    # Without them they are static and lie independently.
    hazards: Hazards = INDEPENDENT
    # The decision that missions are asked for.
    asked: Asked | None = None

    @property
    def contenders(self) -> tuple[Contender, ...]:
        """Every method with every team."""
        return tuple(Contender(method, team) for method in self.methods for team in self.teams)

    def check_teams(self) -> None:
        """Refuse a team that has more robots than the grid has cells, or a base without robots."""
        for team in self.teams:
            team_size(self.field(), team.agents)
            if team.second_base >= 0 and team.agents < 2:
                raise ValueError(
                    f'second_base is {team.second_base} of {team.agents} robot: it is that of '
                    'every second one, so at least 2 agents must leave together'
                )

    def check_search(self) -> None:
        """Refuse paths that cannot be searched for, or not within the memory allowed."""
        for strategy in self.teams:
            finder = PathFinder(self.field(), self.options(strategy))
            check_team(finder, strategy.leaving().types)

    def check_asked(self) -> None:
        """Refuse a goal that cannot be reached, and robots that are sent for another one."""
        if self.asked is not None:
            self.asked.check(self.field(), self.robots, self.planning.max_steps)
        for team in self.teams:
            self.goal(team)

    def goal(self, strategy: Strategy) -> Goal | None:
        """Return the goal that a strategy sends robots for; None for a map."""
        if self.asked is None and strategy.goal != 'map':
            raise ValueError(f'robots are sent for {strategy.goal}, and nothing is asked for')
        return self.asked.goal_of(strategy.goal) if self.asked is not None else None

    def options(self, strategy: Strategy) -> SearchOptions:
        """Return the options of a strategy's search: its own, or else those of all."""
        own = {
            name: value
            for name, value in vars(strategy).items()
            if name in OPTIONS and value != ''
        }
        return SearchOptions(**(vars(self.planning) | own))

    def field(self) -> Grid:
        """Return the grid, with cells of 1 m and the bases of all teams."""
        others = {team.second_base for team in self.teams} - {-1}
        return Grid(self.grid.width, self.grid.height, self.grid.base, other_bases=others)

    def check_learning(self) -> None:
        """Refuse numbers to be drawn or learnt that have no prior."""
        priors = self.learn.priors
        if LEARNING in self.methods and not priors:
            raise ValueError(f'{LEARNING} has nothing to learn: name numbers with their priors')
        drawn = [name for name, value in self._given(self.lethalities[0]).items() if value is None]
        if None in self.lethalities:
            drawn.append('lethality')
        for name in drawn:
            if name not in priors:
                raise ValueError(
                    f'{name} has no prior here: without a value it is drawn from that'
                )

    def check_belief(self) -> None:
        """Refuse a prior that is none."""
        self.belief(self.truth(self.lethalities[0], 0))

    def check_hazards(self) -> None:
        """Refuse rates that no hazards have, and methods that do not take those believed in."""
        hazards, truth = self.hazards, self.truth(self.lethalities[0], 0)
        hazards.of_kind('').known_rates()
        kinds = {hazards.dynamics, *(team.dynamics for team in self.teams)}
        for kind, names in HAZARD_RATES.items():
            rates = {name: getattr(hazards, name) for name in names}
            for name, rate in rates.items():
                if rate and kind not in kinds:
                    raise ValueError(f'{name} is {rate}: no hazards are {kind} or believed to be')
            if kind in kinds and not any(rates.values()):
                raise ValueError(f'{kind} ones need a rate: {" or ".join(names)}')
        for method, team in self.contenders:
            if hazards.of_kind(team.dynamics).effect != 'static' or team.clustering:
                self.estimator(method, team, self.belief(truth), self.model(truth))

    def estimator(
        self, method: str, team: Strategy, prior: Belief, model: SensorModel, seed: int = 0
    ) -> Estimator:
        """Return what a contender knows before the first robot."""
        learns = method == LEARNING
        return Estimator(
            prior,
            model,
            SAMPLED if learns else method,
            self.learn if learns else ALL_KNOWN,
            seed,
            dynamics=self.hazards.of_kind(team.dynamics),
            clustering=Clustering(self.field(), team.clustering) if team.clustering else None,
        )

    def _given(self, lethality: float | None) -> dict[str, float | None]:
        return {'lethality': lethality, **vars(self.world), **vars(self.sensor)}

    def truth(self, lethality: float | None, trial: int) -> dict[str, float]:
        """Return the numbers of a world and of the robots in it, by name."""
        rng = np.random.default_rng([DRAWN, self.seed, trial])
        drawn = {name: drawn_from(prior, rng) for name, prior in self.learn.priors.items()}
        given = self._given(lethality)
        return {name: drawn[name] if value is None else value for name, value in given.items()}

    def belief(self, truth: Mapping[str, float]) -> Belief:
        """Return what is believed before the first robot where these numbers hold."""
        if self.prior is not None:
            given = self.prior.hazard, self.prior.target, self.prior.kappa
        else:
            hazard, kappa = truth['hazard_density'], truth['kappa']
            target = hazard * kappa + (1.0 - hazard) * truth['target_background']
            given = hazard, target, kappa
        return Belief.prior(self.field(), *given)

    @staticmethod
    def model(truth: Mapping[str, float]) -> SensorModel:
        """Return the sensor model with these numbers."""
        return SensorModel(**{field.name: truth[field.name] for field in fields(SensorModel)})


def differ_only_in(scenario: Scenario, *names: str) -> bool:
    """Return whether the teams of a scenario differ, and in these alone."""
    others = {
        tuple(value for name, value in vars(team).items() if name not in names)
        for team in scenario.teams
    }
    return len(scenario.teams) > 1 and len(others) == 1


def team_labels(scenario: Scenario) -> dict[Strategy, str]:
    """Return what tells each team of a scenario from the others; empty if there are no others."""
    differ = {
        field.name
        for field in fields(Strategy)
        if len({getattr(team, field.name) for team in scenario.teams}) > 1
    }
    return {team: ', '.join(_differing(team, scenario, differ)) for team in scenario.teams}


def _differing(team: Strategy, scenario: Scenario, differ: set[str]) -> Iterator[str]:
    """Yield the words for what teams differ in."""
    if differ & {'agents', 'allocation'}:
        yield 'one by one' if team.agents == 1 else f'{team.agents} {team.allocation}'
    if 'loss_cost' in differ:
        yield f'loss cost {team.loss_cost:.4g}'
    if 'last_contact' in differ:
        yield f'last contact {team.last_contact:.4g}'
    if 'planner' in differ:
        yield team.planner or scenario.planning.planner
    if differ & {'objective', 'alpha'}:
        yield team.sought
    if 'dynamics' in differ:
        yield (team.dynamics or scenario.hazards.dynamics).replace('_', ' ')
    if 'clustering' in differ:
        yield 'clustered' if team.clustering else 'independent'
    if 'paths' in differ:
        yield f'{team.paths} paths'
    if 'second_base' in differ:
        yield 'one base' if team.second_base < 0 else f'second base {team.second_base}'
    if 'goal' in differ:
        yield f'goal {team.goal}'
    if differ & {'survey', 'trusted'}:
        trusted = f' trusted as {team.trusted:.4g}' if team.trusted else ''
        yield f'map {team.survey:.4g}{trusted}' if team.survey else 'no map'


def in_percent(lethality: float | None) -> str:
    """Return the lethality of worlds for people."""
    return 'drawn' if lethality is None else f'{100 * lethality:.4g} %'


def in_short(lethality: float | None) -> str:
    """Return the lethality of worlds for a table."""
    return 'drawn' if lethality is None else f'{lethality:.4g}'


def asks_for(scenario: Scenario, goal: str) -> bool:
    """Return whether missions are asked for such a goal, and go on when it is reached."""
    asked = scenario.asked
    return asked is not None and asked.goal == goal and not asked.confidence
