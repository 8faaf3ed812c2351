# SPDX-License-Identifier: Apache-2.0
"""Forecasts of a mission: many missions in fields drawn from the belief."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from functools import partial
from math import nan, sqrt
from typing import NamedTuple

from kbnitp_ros.core.decision.decision import Decision
from kbnitp_ros.core.decision.goals import Goal
from kbnitp_ros.core.decision.rounds import Stop
from kbnitp_ros.core.field.belief import Belief
from kbnitp_ros.core.field.check import Floats, generator, in_short, typed, whole_number
from kbnitp_ros.core.field.grid import Grid
from kbnitp_ros.core.field.observation import as_observations, Observation
from kbnitp_ros.core.field.sensor import SensorModel
from kbnitp_ros.core.field.world import World
from kbnitp_ros.core.inference.estimator import Estimator
from kbnitp_ros.core.mission import decided, Mission, Truth
from kbnitp_ros.core.planning.options import SearchOptions
from kbnitp_ros.core.planning.plans import Team
import numpy as np

# Quantiles of a quantity over missions.
LEVELS = (0.05, 0.25, 0.5, 0.75, 0.95)
# Half width of a 95 % interval, in standard deviations.
DEVIATIONS = 1.96


class PossibleWorld(NamedTuple):
    """A possible field, with its robots."""

    # Index of the field, from 0.
    number: int
    # The field.
    world: World
    # The true sensor model of robots of the common type.
    model: SensorModel
    # Generator of the outcomes.
    rng: np.random.Generator

    def __str__(self) -> str:
        return f'the mission in world {self.number}'


# Arguments `sent`, `lost`, `entropy`, `p_free`, `reached` and `free` of `Forecast` for one
# mission.
Course = tuple[int, Floats, Floats, Floats, Floats, float]


def wilson_interval(successes: Floats) -> tuple[float, float, float]:
    """Return the proportion of successes and its 95 % interval (Wilson's)."""
    count, share = successes.size, float(successes.mean())
    narrowing = 1.0 + DEVIATIONS**2 / count
    middle = (share + DEVIATIONS**2 / (2 * count)) / narrowing
    spread = share * (1.0 - share) / count + (DEVIATIONS / (2 * count)) ** 2
    half = DEVIATIONS * sqrt(spread) / narrowing
    return share, max(0.0, middle - half), min(1.0, middle + half)


@dataclass(frozen=True, eq=False)
class Forecast:
    """
    The forecast of a mission.

    Attributes
    ----------
    goal : str
        Name of the goal; 'map' without one.
    confidence : float or None
        Confidence at which missions end.
    sent : ndarray, shape (worlds,)
        Number of robots sent by each mission.
    lost : ndarray, shape (worlds, robots + 1)
        Robots lost after each robot sent. Arrays of this shape are constant after the last robot.
    entropy : ndarray, shape (worlds, robots + 1)
        Entropy of hazards and targets, nats.
    p_free : ndarray, shape (worlds, robots + 1)
        Probability that the goal is free of hazards; NaN without a goal.
    reached : ndarray, shape (worlds, robots + 1)
        1 if the goal was reached at its confidence, else 0.
    free : ndarray, shape (worlds,)
        1 if the cells of the last decision are truly free of hazards, else 0; NaN without a goal.

    """

    goal: str
    confidence: float | None
    sent: Floats
    lost: Floats
    entropy: Floats
    p_free: Floats
    reached: Floats
    free: Floats

    @property
    def robots(self) -> int:
        """Return the maximum number of robots of each mission."""
        return self.lost.shape[1] - 1


@typed
def forecast(
    grid: Grid,
    estimator: Estimator,
    robots: int,
    worlds: int,
    rng: np.random.Generator | int,
    options: SearchOptions = SearchOptions(),
    *,
    before: Sequence[Observation] = (),
    team: Team | None = None,
    goal: Goal | None = None,
    stop: Stop | None = None,
    run: Callable[
        [Callable[[PossibleWorld], Course], Iterable[PossibleWorld]], Iterable[Course]
    ] = map,
) -> Forecast:
    """
    Run missions in fields drawn from the belief.

    If the belief is right, the real mission has the distribution of these missions.

    Parameters
    ----------
    grid, options, before, goal
        As in `Mission.resume`.
    robots, team, stop
        As in `Mission.run`; at least 1 robot.
    estimator : Estimator
        The prior, or the estimator after the deployments `before`.
    worlds : int
        Number of fields drawn, at least 1.
    rng : int or numpy.random.Generator
        The only source of randomness.
    run : callable
        Function that applies a function to each item and yields the results in order: `map`, or
        the map of a pool of processes.

    Raises
    ------
    ValueError
        If `robots` or `worlds` is below 1; also as in `run_mission`.

    """
    robots = whole_number('robots', robots, 1)
    rng, worlds = generator(rng), whole_number('worlds', worlds, 1)
    drawn = estimator.worlds(worlds, rng)
    possible = [
        PossibleWorld(number, *each, own)
        for number, (each, own) in enumerate(zip(drawn, rng.spawn(worlds)))
    ]
    before = as_observations('before', before)
    if not callable(run):
        raise TypeError(f'run is {in_short(run)}: it must be callable, as map is')
    estimator.prior.check(grid)
    begin = decided(goal, grid, estimator, len(before), options)
    resumed = partial(
        Mission.resume, grid, estimator, options=options, before=tuple(before), goal=goal
    )
    rest = partial(Mission.run, robots=robots, team=team, stop=stop)
    courses = run(partial(course, resumed, rest, robots, estimator.belief, begin), possible)
    name, confidence = ('map', None) if goal is None else (goal.name, goal.confidence)
    return Forecast(name, confidence, *map(np.array, zip(*courses, strict=True)))


def course(
    resumed: Callable[..., Mission],
    rest: Callable[[Mission], Mission],
    robots: int,
    belief: Belief,
    begin: Decision | None,
    possible: PossibleWorld,
) -> Course:
    """Run one mission."""
    made = rest(resumed(world=possible.world, rng=possible.rng, truth=Truth(possible.model)))
    decisions = [begin, *(each.decision for each in made)]
    lost = np.cumsum([0, *(not each.observation.survived for each in made)])
    beliefs = [belief, *(each.belief for each in made)]
    last = decisions[-1]

    def carried(values: Iterable[float]) -> Floats:
        series = np.array([*values], dtype=np.float64)
        return np.pad(series, (0, robots + 1 - series.size), 'edge')

    return (
        len(made),
        carried(lost),
        carried(belief.entropy() for belief in beliefs),
        carried(nan if each is None else each.p_free for each in decisions),
        carried(each is not None and each.reached for each in decisions),
        nan if last is None else float(not made.world.hazard[last.cells].any()),
    )
