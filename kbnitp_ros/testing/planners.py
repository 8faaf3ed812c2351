# SPDX-License-Identifier: Apache-2.0
"""Laws that every planner obeys, as checks."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from itertools import pairwise

from kbnitp_ros.core import Belief, Candidate, Grid, PathFinder, Plan, PLANNERS, SearchOptions
from kbnitp_ros.core.planning.objective import Objective
from kbnitp_ros.testing.laws import draw_field, draw_walk, FieldCase, hold, PLANS, require
import numpy as np

Planner = Callable[[PathFinder, Objective], list[Candidate]]

# Tolerance of the values of paths, nats, since planners round.
VALUE = 1e-6


@dataclass(frozen=True, eq=False)
class SearchCase(FieldCase):
    """A field, and the search for a path in it."""

    # The limits of the path, and earlier visits.
    finder: PathFinder
    # Objective of a robot alone, with or without a loss cost.
    objective: Objective
    # Objective of a robot that leaves after another one.
    after: Objective


def draw_search(seed: int) -> SearchCase:
    """Draw a field and the limits of a path in it."""
    rng = np.random.default_rng([PLANS, seed])
    field = draw_field(rng)
    finder = PathFinder(
        field.grid,
        SearchOptions(
            'beam',
            max_steps=int(rng.integers(1, 13)),
            width=int(rng.integers(1, 9)),
            max_visits=int(rng.integers(1, 4)),
        ),
        visited=rng.integers(0, 3, field.grid.cells),
    )
    options = replace(finder.options, loss_cost=float(rng.choice([0.0, 0.5])))
    finder = replace(finder, options=options)
    objective = Objective.of(field.prior, field.model, options)
    other = draw_walk(rng, field.grid, int(rng.integers(1, 7)))
    after = replace(objective, outcomes=objective.after(other))
    return SearchCase(field.grid, field.prior, field.model, finder, objective, after)


def check_planner(planner: str | object, *, cases: int = 25, seed: int = 0) -> None:
    """Check that a planner obeys the laws of this package, in random cases."""
    hold(PLANNERS, planner, LAWS, draw_search, cases, seed)


def finds_paths(planner: Planner, search: SearchCase) -> None:
    """Check that each path is closed, on free cells, and within max_steps and max_visits."""
    for objective in (search.objective, search.after):
        found = planner(search.finder, objective)
        require(len(found) > 0, 'The planner finds no path')
        for candidate in found:
            require(
                isinstance(candidate, Candidate),
                f'The planner returns {candidate!r}, which is no Candidate',
            )
            try:
                search.finder.check_path(candidate.path)
            except ValueError as error:
                raise AssertionError(f'Path {list(candidate.path)}: {error}') from error


def puts_the_best_first(planner: Planner, search: SearchCase) -> None:
    """Check that the best path comes first."""
    for objective in (search.objective, search.after):
        value = [each.value for each in planner(search.finder, objective)]
        for before, after in pairwise(value):
            require(
                after <= before + VALUE,
                f'A path of {after} nats comes after a path of {before} nats',
            )


def tells_the_value(planner: Planner, search: SearchCase) -> None:
    """Check that each path has the value stated."""
    # Only without robots in flight: given such robots, planners approximate values differently.
    for found in planner(search.finder, search.objective):
        plan = Plan.along(found.path, search.prior, search.model)
        value = plan.information - search.objective.loss_cost * (1.0 - plan.survival)
        words = f'Path {list(found.path)} has a value of {value} nats, not {found.value} as stated'
        require(abs(found.value - value) <= VALUE, words)


def is_reproducible(planner: Planner, search: SearchCase) -> None:
    """Check that the same belief gives the same paths."""
    first = planner(search.finder, search.objective)
    planner(search.finder, search.after)
    again = replace(search.objective, belief=Belief(search.prior.joint.copy()))
    second = planner(replace(search.finder), again)
    one, other = ([(each.value, list(each.path)) for each in found] for found in (first, second))
    require(one == other, f'The first search finds {one}, the second search {other}')


def stays_where_there_is_nowhere_to_go(planner: Planner, search: SearchCase) -> None:
    """Check that a robot stays at the base if all other cells are blocked."""
    grid = Grid(3, 1, base=1, blocked=(0, 2))
    belief = Belief.prior(grid, 0.3, 0.4, 0.8)
    finder = replace(search.finder, grid=grid, visited=np.zeros(3, dtype=np.intp))
    for candidate in planner(finder, Objective.of(belief, search.model, finder.options)):
        require(set(candidate.path) == {1}, f'The path is {list(candidate.path)}')


def leaves_what_it_is_given(planner: Planner, search: SearchCase) -> None:
    """Check that the planner does not change its arguments."""
    visited, interest = search.finder.visited.copy(), search.objective.interest.copy()
    planner(search.finder, search.objective)
    require(np.array_equal(search.finder.visited, visited), 'finder.visited has changed')
    require(np.array_equal(search.objective.interest, interest), 'objective.interest has changed')


LAWS: tuple[Callable[[Planner, SearchCase], None], ...] = (
    finds_paths,
    puts_the_best_first,
    tells_the_value,
    is_reproducible,
    stays_where_there_is_nowhere_to_go,
    leaves_what_it_is_given,
)
