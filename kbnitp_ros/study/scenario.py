# SPDX-License-Identifier: Apache-2.0
"""The scenario of a study, with the sections of its YAML file."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, fields, replace
from itertools import product
from typing import Annotated

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
from kbnitp_ros.core.decision.goals import FlightState, GOALS
from kbnitp_ros.core.field.sensor import OF_HAZARDS, SENSORS
from kbnitp_ros.core.field.unknowns import (
    ALL_KNOWN,
    HAZARD_RATES,
    HAZARDS,
    STATIC,
    TARGET_KINDS,
    ZERO,
)
from kbnitp_ros.core.planning.plans import check_team, team_size
import numpy as np

# Name of the baseline for flights to a lane, in addition to `GOALS`.
SAFEST_LANE = 'safest_lane'


@dataclass(frozen=True)
class DecisionRequest:
    """The decision requested of all missions of a study."""

    # Name of a goal in `GOALS`, except 'map'.
    goal: Annotated[str, GOALS]
    # Cells of the goal.
    cells: tuple[Annotated[int, (0, 999_999)], ...]
    # Confidence at which missions for the goal end; 0 for never.
    confidence: Annotated[float, (0.0, 1.0)] = 0.0

    def sought(self) -> Goal:
        """Return the goal."""
        goal = GOALS[self.goal](self.cells, self.confidence or None)
        if goal is None:
            raise ValueError('goal is map, which has no decision: choose another goal')
        return goal

    def goal_for(self, sent_for: str) -> Goal | None:
        """Return the goal of missions whose flights serve `sent_for`; None for 'map'."""
        if sent_for == 'map':
            return None
        if sent_for == SAFEST_LANE and self.goal == Lane.name:
            return SafestLane(self.cells[0], self.confidence or None)
        if sent_for != self.goal:
            raise ValueError(f'a team flies for {sent_for}, but the study asks for {self.goal}')
        return self.sought()

    def check(self, grid: Grid, robots: int, max_steps: int) -> None:
        """Check that the goal exists and can be reached on a field."""
        goal = self.sought()
        goal.check(grid, max_steps)
        Stop().check(goal, robots)


class SafestLane(Lane):
    """The goal of a lane; robots fly out and back along the currently safest lane."""

    def flight(self, situation: FlightState) -> Plan | None:
        """Return the safest lane, there and back."""
        grid, draws, model = situation.grid, situation.draws, situation.model
        half = situation.options.max_steps // 2
        lane = safest_path(grid, draws, model, grid.base, self.to, half).path
        return situation.planned(there_and_back(lane, lane), 0.0)


# The sampled method, and names of methods that learn the numbers of the section `learn`.
SAMPLED = 'kappa_bnitp_sampled'
LEARNING = f'{SAMPLED}_learning'
ONE_PASS_LEARNING = 'kappa_bnitp_learning'
LEARNERS = {LEARNING: SAMPLED, ONE_PASS_LEARNING: 'kappa_bnitp'}

# The numbers that can be learnt.
NUMBERS = tuple(field.name for field in fields(Unknowns))

# Options of a search.
OPTIONS = tuple(field.name for field in fields(SearchOptions))

# Layouts of the hazards of worlds.
LAYOUTS = ('independent', 'blobs', 'rows')

# Beliefs on which paths are planned.
PATHS = ('own', 'static')

# Rules that choose among equally good paths.
TIES = ('first', 'random')

# Seed key of drawn numbers, distinct from the keys of worlds.
DRAWN = 0x4452574E

# Types of numbers, with the lowest and the highest value.
Count = Annotated[int, (1, 1_000_000)]
Probability = Annotated[float, (0.0, 1.0)]


@dataclass(frozen=True)
class Extent:
    """The size of the grid."""

    # Cells along x and y, 1 to 1000.
    width: Annotated[int, (1, 1000)]
    height: Annotated[int, (1, 1000)]
    # The base (row * width + column) of every robot.
    base: Annotated[int, (0, 999_999)]


@dataclass(frozen=True)
class Planning:
    """Options of the search, as in `SearchOptions`."""

    planner: Annotated[str, PLANNERS]
    max_steps: Count
    width: Count
    max_visits: Count
    max_distance: Annotated[float, (0.0, 1e9)] = 0.0


@dataclass(frozen=True)
class Strategy:
    """The strategy of a mission: team, objective and prior knowledge."""

    # Number of robots, at least 1.
    agents: Count = 1
    # Name of an allocation in `ALLOCATIONS`.
    allocation: Annotated[str, ALLOCATIONS] = 'greedy'
    # Cost of a lost robot, nats, 0 to 1000.
    loss_cost: Annotated[float, (0.0, 1000.0)] = 0.0
    # Probability that the base receives the robot's progress after each step, 0 to 1.
    last_contact: Probability = 0.0
    # Name of a planner in `PLANNERS`; empty for the planner of the section `planning`.
    planner: Annotated[str, PLANNERS, ''] = ''
    # Share of right cells in a prior map of hazards, 0 to 1; 0 for no map.
    survey: Probability = 0.0
    # Believed share of right cells in the prior map, 0 to 1; 0 for the true share.
    trusted: Probability = 0.0
    # Name of an objective in `OBJECTIVES`.
    objective: Annotated[str, OBJECTIVES] = 'information'
    # Kind of hazards believed, one of `HAZARDS`; empty: the kind in the worlds.
    dynamics: Annotated[str, HAZARDS, ''] = ''
    # 'learn' for hazards believed clustered, with a learnt coupling; empty for independent
    # hazards.
    clustering: Annotated[str, ('learn',), ''] = ''
    # Kind of targets believed: 'static', or 'learn' to infer whether they change.
    target_dynamics: Annotated[str, ('static', 'learn')] = 'static'
    # 'own': paths are planned on the strategy's belief. 'static': on the belief of `kappa_bnitp`
    # with static hazards, which gives all strategies the same evidence.
    paths: Annotated[str, PATHS] = 'own'
    # Base of every second robot of a round; -1: all robots leave from the base of the grid.
    second_base: Annotated[int, (-1, 999_999)] = -1
    # Goal of the flights: of `GOALS`, or 'safest_lane'.
    goal: Annotated[str, GOALS, SAFEST_LANE] = 'map'

    def leaving(self) -> Team:
        """Return the team of a round."""
        types: tuple[RobotType, ...] = ()
        if self.second_base >= 0:
            types = tuple(
                RobotType(base=self.second_base) if robot % 2 else ORDINARY
                for robot in range(self.agents)
            )
        return Team(self.agents, self.allocation, types)


# Default strategy: one robot at a time, loss cost 0.
ALONE = Strategy()


# A method of estimation and the team that it plans for.
Contender = tuple[str, Strategy]


def drawn_from(prior: Beta, rng: np.random.Generator) -> float:
    """Draw a number from its prior, by a uniform quantile."""
    bins = prior.bins()
    below = np.append(0.0, np.cumsum(np.exp(bins.log_prior)))
    return float(np.interp(rng.random() * below[-1], below, bins.edges))


@dataclass(frozen=True)
class Densities:
    """Densities of the worlds, as in `World.random`; None: drawn for each world from `learn`."""

    hazard_density: Probability | None
    kappa: Probability | None
    target_background: Probability | None


@dataclass(frozen=True)
class Hazards:
    """Layout and dynamics of the worlds' hazards."""

    # Kind of hazards in `HAZARDS`.
    dynamics: Annotated[str, HAZARDS] = 'static'
    # Rates of changing and of moving hazards, in the worlds and as believed.
    appear: Probability = 0.0
    vanish: Probability = 0.0
    move: Probability = 0.0
    # Name of a layout in `LAYOUTS`.
    layout: Annotated[str, LAYOUTS] = 'independent'

    def of_kind(self, kind: str) -> Dynamics:
        """Return the dynamics of a kind of hazards; an empty kind is that of the worlds."""
        kind = kind or self.dynamics
        return Dynamics(kind, **{name: getattr(self, name) for name in HAZARD_RATES.get(kind, ())})


INDEPENDENT = Hazards()


@dataclass(frozen=True)
class Targets:
    """Dynamics of the worlds' targets, as in `Dynamics`."""

    dynamics: Annotated[str, TARGET_KINDS[:-1]] = 'static'
    appear: Probability = 0.0
    vanish: Probability = 0.0
    move: Probability = 0.0

    @property
    def truth(self) -> Dynamics:
        """Return the dynamics."""
        return Dynamics(self.dynamics, self.appear, self.vanish, self.move)


STILL = Targets()


@dataclass(frozen=True)
class Sensor:
    """Sensor model without the lethality, as in `SensorModel`."""

    malfunction: Probability | None
    false_negative: Probability
    true_positive: Probability | None
    false_positive: Probability | None
    reach: Probability = 0.0
    duds: Probability = 0.0


@dataclass(frozen=True)
class Believed:
    """Numbers assumed by planner and estimator; None for the true one."""

    malfunction: Probability | None = None
    true_positive: Probability | None = None
    false_positive: Probability | None = None
    reach: Probability | None = None
    duds: Probability | None = None


RIGHT = Believed()


@dataclass(frozen=True)
class Prior:
    """The prior of every cell but the base."""

    hazard: Probability
    target: Probability
    kappa: Probability


@dataclass(frozen=True)
class Scenario:
    """A study: missions of every method and team at every lethality, in the same worlds."""

    # Seed, at least 0. Trial t draws its world and the outcomes of robots from ``[seed, t]``, so
    # they are the same for all methods, teams and lethalities.
    seed: Annotated[int, (0, 2**63 - 1)]
    # Number of worlds, at least 1.
    trials: Count
    # Number of deployments of a mission, at least 1.
    robots: Count
    # Names of methods in `METHODS`, or of `LEARNERS`.
    methods: tuple[Annotated[str, METHODS, LEARNING, ONE_PASS_LEARNING], ...]
    # Lethalities of the worlds, in [0, 1]; None: drawn for each world from `learn`.
    lethalities: tuple[Probability | None, ...]
    # Sections. If `prior` is None, the prior follows from the densities of the worlds.
    grid: Extent
    planning: Planning
    world: Densities
    sensor: Sensor
    prior: Prior | None
    # Lethality assumed by planner and estimator, in [0, 1]; None for the true one.
    believed_lethality: Probability | None = None
    # Strategies to compare; by default robots are sent one by one.
    teams: tuple[Strategy, ...] = (ALONE,)
    # Priors of numbers that the learning method learns; numbers given as None are drawn from them.
    learn: Unknowns = ALL_KNOWN
    # Layout and dynamics of hazards; by default static and independent.
    hazards: Hazards = INDEPENDENT
    # Dynamics of targets; by default static.
    targets: Targets = STILL
    # Numbers of the sensor model that are assumed; by default the true ones.
    believed: Believed = RIGHT
    # Decision requested of missions; None: the field is mapped.
    asked: DecisionRequest | None = None
    # 'first': of equally good paths the planner takes the first. 'random': factors of
    # 1 + 1e-6 u, drawn for each world, break ties of the prior.
    ties: Annotated[str, TIES] = 'first'

    @property
    def contenders(self) -> dict[Contender, str]:
        """Return the names of strategies: the method, a planner that is given, what differs."""
        teams = {team: vars(team) for team in self.teams}
        given = {key: {own[key] for own in teams.values()} for key in vars(ALONE)}
        shown = [
            key
            for key, values in given.items()
            if len(values) > 1 or (key == 'planner' and values != {''})
        ]
        defaults = {'planner': self.planning.planner, 'dynamics': self.hazards.dynamics}
        names = {}
        for method, (team, own) in product(self.methods, teams.items()):
            values = {key: own[key] if own[key] != '' else defaults.get(key) for key in shown}
            parts = [
                str(value) if key == 'planner' else f'{key.replace("_", " ")} {value}'
                for key, value in values.items()
            ]
            names[method, team] = ', '.join([method, *parts])
        return names

    def check_teams(self) -> None:
        """Check that each team fits the grid, and has a robot for each base."""
        known = set()
        for team in self.teams:
            whole = replace(
                team,
                planner=team.planner or self.planning.planner,
                dynamics=team.dynamics or self.hazards.dynamics,
                trusted=team.trusted or team.survey,
            )
            if whole in known:
                raise ValueError(f'two teams are the same with the defaults of the study: {whole}')
            known.add(whole)
            team_size(self.field(), team.agents)
            if team.second_base >= 0 and team.agents < 2:
                raise ValueError(
                    f'second_base is {team.second_base} and agents is {team.agents}: every second '
                    'robot leaves from it, so agents must be at least 2'
                )

    def check_search(self) -> None:
        """Check that the search options are valid, and that searches fit in memory."""
        for strategy in self.teams:
            finder = PathFinder(self.field(), self.options(strategy))
            check_team(finder, strategy.leaving().types)

    def check_asked(self) -> None:
        """Check that the goal can be reached, and that each team flies for it or for the map."""
        if self.asked is not None:
            self.asked.check(self.field(), self.robots, self.planning.max_steps)
        for team in self.teams:
            self.goal(team)

    def goal(self, strategy: Strategy) -> Goal | None:
        """Return the goal of a strategy's flights; None for a map."""
        if self.asked is None and strategy.goal != 'map':
            raise ValueError(f'robots are sent for the goal {strategy.goal}: give its cells')
        return self.asked.goal_for(strategy.goal) if self.asked is not None else None

    def options(self, strategy: Strategy) -> SearchOptions:
        """Return the search options of a strategy, by default those of the section `planning`."""
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
        """Check that drawn and learnt numbers have a prior."""
        priors = self.learn.priors
        for name in LEARNERS.keys() & {*self.methods}:
            if not priors:
                raise ValueError(f'{name} has nothing to learn: name numbers with their priors')
        drawn = [name for name, value in self._given(self.lethalities[0]).items() if value is None]
        if None in self.lethalities:
            drawn.append('lethality')
        for name in drawn:
            if name not in priors:
                raise ValueError(f'{name} has neither a value nor a prior: give one of them')

    def check_belief(self) -> None:
        """Check that the prior is valid."""
        self.belief(self.truth(self.lethalities[0], 0))

    def check_hazards(self) -> None:
        """Check the rates of hazards, and that the methods support the believed kind."""
        hazards, truth = self.hazards, self.truth(self.lethalities[0], 0)
        hazards.of_kind('').known_rates()
        kinds = {hazards.dynamics, *(team.dynamics for team in self.teams)}
        for kind, names in HAZARD_RATES.items():
            rates = {name: getattr(hazards, name) for name in names}
            for name, rate in rates.items():
                if rate and kind not in kinds:
                    raise ValueError(
                        f'{name} is {rate}: neither worlds nor teams have {kind} hazards'
                    )
            if kind in kinds and not any(rates.values()):
                raise ValueError(f'{kind} hazards need a rate: {" or ".join(names)}')
        targets, sensor = self.targets.truth.effect, self.sensor
        for method, team in self.contenders:
            changes = hazards.of_kind(team.dynamics).effect != 'static' or targets != 'static'
            if changes or team.clustering or sensor.reach or sensor.duds:
                self.estimator(method, team, self.belief(truth), self.model(self.assumed(truth)))

    def estimator(
        self, method: str, team: Strategy, prior: Belief, model: SensorModel, seed: int = 0
    ) -> Estimator:
        """Return the estimator of a contender before the first robot."""
        learn = ALL_KNOWN
        if method in LEARNERS:
            # No reach, and no duds, have a prior probability.
            learn = Unknowns(
                **{
                    name: replace(each, zero=ZERO.get(name, 0.0))
                    for name, each in self.learn.priors.items()
                }
            )
        return Estimator(
            prior,
            model,
            LEARNERS.get(method, method),
            learn,
            seed,
            dynamics=self.hazards.of_kind(team.dynamics),
            clustering=Clustering(self.field(), team.clustering) if team.clustering else None,
            target_dynamics=STATIC if team.target_dynamics == 'static' else Dynamics('learn'),
        )

    def _given(self, lethality: float | None) -> dict[str, float | None]:
        return {'lethality': lethality, **vars(self.world), **vars(self.sensor)}

    def truth(self, lethality: float | None, trial: int) -> dict[str, float]:
        """Return the numbers of a world and of the robots in it, by name."""
        rng = np.random.default_rng([DRAWN, self.seed, trial])
        drawn = {name: drawn_from(prior, rng) for name, prior in self.learn.priors.items()}
        given = self._given(lethality)
        return {name: drawn[name] if value is None else value for name, value in given.items()}

    def assumed(self, truth: Mapping[str, float]) -> dict[str, float]:
        """Return the numbers that planner and estimator assume in a world of these numbers."""
        given = {'lethality': self.believed_lethality, **vars(self.believed)}
        return {**truth, **{name: value for name, value in given.items() if value is not None}}

    def belief(self, truth: Mapping[str, float]) -> Belief:
        """Return the prior for these numbers."""
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
        return SensorModel(**{name: truth[name] for name in (*SENSORS, *OF_HAZARDS)})
