# SPDX-License-Identifier: Apache-2.0
"""How robots execute their orders: the way they really go, and what the base hears of it."""

from __future__ import annotations

from dataclasses import dataclass

from kbnitp_ros.core.field.check import probabilities, Value
from kbnitp_ros.core.field.dynamics import Dynamics, STATIC
from kbnitp_ros.core.field.grid import Grid
from kbnitp_ros.core.field.observation import lost_after_contact, Observation
from kbnitp_ros.core.field.sensor import SensorModel
from kbnitp_ros.core.field.world import World
import numpy as np
from numpy.typing import ArrayLike, NDArray


@dataclass(frozen=True, eq=False, repr=False)
class Traverse(Value):
    """
    One robot's way through a world.

    Attributes
    ----------
    walk : ndarray of int, shape (steps + 1,)
        The cells of its way had it survived; it may be longer or shorter than its path.
    steps_made : int
        How many of its steps it survived. No base ever learns this of a lost robot: it is for
        those who watch a simulation.
    observation : Observation
        What the base learns.
    world : World
        The field as the robot leaves it.

    """

    walk: NDArray[np.intp]
    steps_made: int
    observation: Observation
    world: World


@dataclass(frozen=True)
class Execution:
    """
    How robots depart from their orders; each probability is that of one step, in [0, 1].

    Parameters
    ----------
    detour : float
        That a robot takes the step through a third cell which is next to both of its ends.
    early_return : float
        That it turns back before the step and takes a shortest way home; never before its first.
    contact : float
        That the base hears, once the step is survived, how far along its path the robot is.
    camera_failure : float
        That its camera fails in the step, for the rest of the way.

    Raises
    ------
    ValueError
        If a probability is out of range.

    """

    detour: float = 0.0
    early_return: float = 0.0
    contact: float = 0.0
    camera_failure: float = 0.0

    def __post_init__(self) -> None:
        probabilities(self)

    def traverse(
        self,
        world: World,
        grid: Grid,
        path: ArrayLike,
        model: SensorModel,
        rng: np.random.Generator | int,
        dynamics: Dynamics = STATIC,
        changing: NDArray[np.bool_] | None = None,
    ) -> Traverse:
        """
        Send a robot along a path; one that keeps to it fares as by `World.traverse`.

        A lost robot is heard of after each step survived with the chance `contact`, and what
        that and the silence afterwards tell of where it was lost is equation
        :eq:`contact-probability`.

        Parameters
        ----------
        world : World
            The hidden truth.
        grid : Grid
            Where the robot can go.
        path : array_like of int, shape (steps + 1,)
            Its orders.
        model : SensorModel
            What the robot, its sensor and the hazards are really like.
        rng : int or numpy.random.Generator
            The only source of randomness: of what happens in the steps made, and its first child
            of all that is told here, its second of how hazards change.
        dynamics : Dynamics
            How they do.
        changing : ndarray of bool, shape (cells,), optional
            Where hazards change or move before the robot leaves; None before the first.

        Raises
        ------
        ValueError
            If no robot can take the path on the grid.

        """
        ordered = grid.check_path(path)
        rng = np.random.default_rng(rng)
        own = rng.spawn(1)[0]
        if changing is not None and dynamics.effect in ('changing', 'moving'):
            world = world.after_change(dynamics, grid, changing, rng.spawn(1)[0])
        walk, passed = self._walk(grid, ordered, own)
        survived, readings, after = world.steps(walk, model, rng, dynamics)
        if survived.all():
            seen = np.cumsum(own.random(survived.size) < self.camera_failure) == 0
            read = np.where(seen, readings, -1)
            return Traverse(walk, survived.size, Observation(walk, True, read), after)
        steps_made = int(np.argmin(survived))
        heard = np.flatnonzero(own.random(steps_made) < self.contact)
        known = int(passed[heard[-1]]) if heard.size else 0
        lost = lost_after_contact(ordered, known, self.contact)
        return Traverse(walk, steps_made, lost, after)

    def _walk(
        self, grid: Grid, path: NDArray[np.intp], rng: np.random.Generator
    ) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
        """Draw the way a robot goes."""
        drawn = rng.random((len(path) - 1, 3))
        walk = [int(path[0])]
        passed: list[int] = []
        for step, (turns, strays, which) in enumerate(drawn):
            here, there = int(path[step]), int(path[step + 1])
            if step and turns < self.early_return:
                home = way_home(grid, here)
                return np.array(walk + home), np.array(passed + [step] * len(home))
            if strays < self.detour:
                between = np.intersect1d(grid.neighbors(here), grid.neighbors(there))
                between = between[(between != here) & (between != there)]
                if between.size:
                    walk.append(int(between[int(which * between.size)]))
                    passed.append(step)
            walk.append(there)
            passed.append(step + 1)
        return np.array(walk), np.array(passed)


AS_ORDERED = Execution()


def way_home(grid: Grid, cell: int) -> list[int]:
    """Return the cells of a shortest way from `cell`, which is left out, to the base."""
    way = []
    while cell != grid.base:
        around = grid.neighbors(cell)
        cell = int(around[np.argmin(grid.steps_to_base[around])])
        way.append(cell)
    return way
