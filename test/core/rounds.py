# SPDX-License-Identifier: Apache-2.0
"""Problems of small fields, plans of rounds in one call, and groups of methods."""

from functools import cache

import brute_force
from kbnitp_ros.core import (
    Belief,
    Grid,
    ORDINARY,
    PathFinder,
    plan_team,
    SearchOptions,
    SensorModel,
    Team,
    update,
)
from kbnitp_ros.core.inference.one_pass import KnownModel
from kbnitp_ros.core.planning.plans import divided, TeamMember
import numpy as np

BASES = (0, 5, 2, 15)  # corner, inside, edge, last cell


def random_problem(seed):
    rng = np.random.default_rng(seed)
    grid = Grid(4, 4, base=BASES[seed % len(BASES)])
    belief = Belief(brute_force.random_joint(rng, 16, grid.base))
    return grid, belief, SensorModel(float(rng.choice([0.01, 0.1, 0.3, 0.5, 0.6, 0.9])))


@cache
def every_path(base, most_steps):
    return brute_force.all_visit_counts(4, 4, base, most_steps)


def plan_round(
    grid,
    belief,
    model,
    max_steps,
    agents,
    allocation='greedy',
    planner='beam',
    *,
    types=(),
    in_flight=(),
    visited=(),
    keepout=(),
    **options,
):
    team = Team(agents, allocation, types)
    search = SearchOptions(planner, max_steps, keepout=keepout, **options)
    return plan_team(grid, belief, model, team, search, in_flight=in_flight, visited=visited)


def regions_of_team(grid, belief, model, max_steps, agents, types=()):
    """Return the regions of a team under the allocation voronoi."""
    finder = PathFinder(grid, SearchOptions('relaxed', max_steps))
    members = {kind: TeamMember.of(kind, finder, belief, model) for kind in types or (ORDINARY,)}
    return divided([members[each] for each in types or (ORDINARY,) * agents])


# Methods that condition on losses, and so refuse impossible ones.
LEARN_FROM_LOSSES = (
    'relaxed_itp',
    'relaxed_bnitp',
    'kappa_bnitp_published',
    'kappa_bnitp',
    'kappa_bnitp_sampled',
)


class Ignorant(KnownModel):
    """Learn from returns alone."""

    def __init__(self, belief, model, unknowns, seed):
        super().__init__(belief, model)

    def assimilate(self, observation, robot_type):
        if observation.survived:
            self.belief = update(self.belief, robot_type.model(self.model), observation)
