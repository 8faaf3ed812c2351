# SPDX-License-Identifier: Apache-2.0
"""The hidden world that robots traverse, and how robots execute orders."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import Any

from kbnitp_ros.core.field.check import generator, probability, read_only, typed, Value, yes_or_no
from kbnitp_ros.core.field.grid import Grid
from kbnitp_ros.core.field.observation import as_path, lost_after_contact, Observation
from kbnitp_ros.core.field.sensor import SensorModel
from kbnitp_ros.core.field.unknowns import Dynamics, STATIC
import numpy as np
from numpy.typing import ArrayLike, NDArray


@dataclass(frozen=True, eq=False, repr=False)
class World(Value):
    """
    The true hazards and targets.

    Parameters
    ----------
    hazard, target : array_like of bool, shape (cells,)
        Z and X.
    grid : Grid, optional
        Grid of the cells, if known; hazards that reach need it.
    duds : array_like of bool, shape (cells,), optional
        Hazards that never strike, if they are known; see `with_duds`.

    Raises
    ------
    ValueError
        If the shapes differ or a value is neither true nor false.

    """

    hazard: NDArray[np.bool_]
    target: NDArray[np.bool_]
    grid: Grid | None = field(default=None, compare=False)
    duds: NDArray[np.bool_] | None = None

    def __post_init__(self) -> None:
        for name in ('hazard', 'target'):
            values = yes_or_no(f'{name} of a world', getattr(self, name))
            if values.ndim != 1 or not values.size:
                raise ValueError(
                    f'{name} of a world has shape {values.shape}: it must be one value a cell'
                )
            vars(self)[name] = read_only(values)
        if self.hazard.size != self.target.size:
            raise ValueError(
                f'target of a world has {self.target.size} cells, its hazard {self.hazard.size}'
            )

    def with_duds(self, share: float, rng: np.random.Generator | int) -> World:
        """Return the world where this share of the hazards never strikes, each by chance."""
        own = generator(rng)
        if own is not rng:
            # `random` draws the field from the first numbers of the same seed.
            own.random((2, self.hazard.size))
        drawn = own.random(self.hazard.size)
        return replace(self, duds=read_only(self.hazard & (drawn < probability('share', share))))

    def check_duds(self, model: SensorModel) -> None:
        """Check that the world says which hazards are duds, if the sensor model has some."""
        if model.duds and self.duds is None:
            raise ValueError(
                f'duds is {model.duds}, and the world does not say which hazards are duds: make '
                'it with World.with_duds(share, rng)'
            )

    def __repr__(self) -> str:
        hazards, targets = self.hazard.sum(), self.target.sum()
        return f'World({self.hazard.size} cells, {hazards} hazards, {targets} targets)'

    @classmethod
    @typed
    def random(
        cls,
        grid: Grid,
        rng: np.random.Generator | int,
        hazard_density: float,
        kappa: float,
        target_background: float,
    ) -> World:
        """
        Draw a world; each cell takes two uniform numbers, whatever the probabilities.

        Parameters
        ----------
        grid : Grid
            Grid of the world. Bases get no hazard; blocked cells get neither hazard nor target.
        rng : int or numpy.random.Generator
            The only source of randomness.
        hazard_density : float
            P(Z = 1) in [0, 1].
        kappa : float
            P(X = 1 | Z = 1) in [0, 1].
        target_background : float
            P(X = 1 | Z = 0) in [0, 1].

        Raises
        ------
        ValueError
            If a probability is out of range.

        """
        drawn = generator(rng).random((2, grid.cells))
        hazard = drawn[0] < probability('hazard_density', hazard_density)
        hazard &= grid.may_be_hazardous
        chance = np.where(
            hazard,
            probability('kappa', kappa),
            probability('target_background', target_background),
        )
        return cls(hazard, (drawn[1] < chance) & grid.free, grid)

    @typed
    def check(self, grid: Grid) -> None:
        """Check that this world fits a grid."""
        if self.hazard.size != grid.cells:
            raise ValueError(
                f'world has {self.hazard.size} cells: the grid has {grid.width} x {grid.height}'
            )
        for base in sorted(grid.bases):
            if self.hazard[base]:
                raise ValueError(f'world has a hazard at the base {base}: a base has none')
        filled = np.flatnonzero((self.hazard | self.target) & ~grid.free)
        if filled.size:
            raise ValueError(
                f'world has a hazard or target in cell {filled[0]}: that cell is blocked'
            )

    @typed
    def traverse(
        self, path: ArrayLike, model: SensorModel, rng: np.random.Generator | int
    ) -> Observation:
        """
        Send a robot along a path (arXiv:2305.06929, Algorithm 1, line 4).

        Two uniform numbers are drawn for each step, also after a loss.

        Parameters
        ----------
        path : array_like of int, shape (steps + 1,)
            Cells, the base first and last.
        model : SensorModel
            True sensor model.
        rng : int or numpy.random.Generator
            The only source of randomness.

        Raises
        ------
        ValueError
            If the path has no step, is not closed or leaves the world.

        """
        cells = as_path(path)
        beyond = cells[(cells < 0) | (cells >= self.hazard.size)]
        if beyond.size:
            raise ValueError(
                f'path has the cell {beyond[0]}: the world has the cells 0 to '
                f'{self.hazard.size - 1}'
            )
        survived, readings, _ = self.steps(cells, model, generator(rng))
        returned = bool(survived.all())
        return Observation(cells, returned, readings if returned else None)

    def steps(
        self,
        path: NDArray[np.intp],
        model: SensorModel,
        rng: np.random.Generator,
        dynamics: Dynamics = STATIC,
    ) -> tuple[NDArray[np.bool_], NDArray[np.bool_], World]:
        """Return survival and reading of each step, and the final field (:eq:`step-events`)."""
        entered = path[1:]
        drawn = rng.random((2, entered.size))
        chance = np.where(self.target[entered], model.true_positive, model.false_positive)
        readings = drawn[1] < chance
        if model.duds:
            if dynamics.effect != 'static':
                raise ValueError(
                    f'duds is {model.duds}, and hazards are {dynamics.effect}: duds are static'
                )
            self.check_duds(model)
            live = replace(self, hazard=self.hazard & ~np.asarray(self.duds), duds=None)
            model = replace(model, duds=0.0)
            return (*live.steps(path, model, rng)[:2], self)
        if model.reach:
            if dynamics.effect == 'used_up':
                raise ValueError('reach is not 0, and hazards are used up: only one can be so')
            return drawn[0] < self._survival_in_reach(entered, model), readings, self
        safe, deadly = model.step_survival
        if dynamics.effect != 'used_up':
            return drawn[0] < np.where(self.hazard[entered], deadly, safe), readings, self
        survived, hazard = np.ones(entered.size, np.bool_), self.hazard.copy()
        not_set_off = (1.0 - model.malfunction) * (1.0 - model.lethality)
        for step, cell in enumerate(entered.tolist()):
            survived[step] = drawn[0, step] < (deadly if hazard[cell] else safe)
            if not_set_off <= drawn[0, step] < 1.0 - model.malfunction:
                hazard[cell] = False
            if not survived[step]:
                break
        return survived, readings, replace(self, hazard=hazard)

    def _survival_in_reach(self, entered: NDArray[np.intp], model: SensorModel) -> Any:
        """Return the chance to survive each step beside hazards that reach (:eq:`reach`)."""
        if self.grid is None:
            raise ValueError(
                'reach is not 0, and the world has no grid to reach on: make it with '
                'World(hazard, target, grid) or World.random(grid, ...)'
            )
        near = np.append(self.hazard, False)[self.grid.around[entered]].sum(axis=1)
        strike, beside = model.strikes
        survives = (1.0 - model.malfunction) * (1.0 - beside) ** near
        return np.where(self.hazard[entered], 1.0 - strike, 1.0) * survives

    def after_change(
        self, dynamics: Dynamics, grid: Grid, possible: NDArray[np.bool_], rng: np.random.Generator
    ) -> World:
        """Draw the field after a change or moves of its hazards."""
        return replace(self, hazard=after_change(self.hazard, dynamics, grid, possible, rng))


@dataclass(frozen=True, eq=False, repr=False)
class Traverse(Value):
    """A robot's walk through a world."""

    # Cells of the walk as if the robot survived, shape (steps + 1,); errors of motion make it
    # differ from the path.
    walk: NDArray[np.intp]
    # Number of steps survived; unknown to the base if the robot is lost.
    steps_made: int
    # The observation at the base.
    observation: Observation
    # The field after the robot.
    world: World


@dataclass(frozen=True)
class Execution:
    """
    Deviations of robots from their orders, as probabilities of each step, in [0, 1].

    Parameters
    ----------
    detour : float
        Probability of a detour through a third cell next to both ends of the step.
    early_return : float
        Probability of turning back before the step, by a shortest way home; never before the
        first.
    contact : float
        Probability that the base receives, after a survived step, how far along its path the robot
        is.
    camera_failure : float
        Probability that the camera fails in the step, for the rest of the way.

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
        vars(self).update({name: probability(name, value) for name, value in vars(self).items()})

    @typed
    def traverse(
        self,
        world: World,
        grid: Grid,
        path: ArrayLike,
        model: SensorModel,
        rng: np.random.Generator | int,
        dynamics: Dynamics = STATIC,
        changing: NDArray[np.bool_] | None = None,
        target_dynamics: Dynamics = STATIC,
    ) -> Traverse:
        """Simulate a deployment; `contact` reports steps (:eq:`contact-probability`)."""
        dynamics.known_rates()
        target_dynamics.known_rates()
        world.check(grid)
        ordered = grid.check_path(path)
        if changing is not None and yes_or_no('changing', changing).shape != (grid.cells,):
            words = f'changing has shape {np.shape(changing)}: it must be ({grid.cells},)'
            raise ValueError(words)
        how = dynamics, changing, target_dynamics
        return self.follow(world, grid, ordered, model, generator(rng), *how)

    def follow(
        self,
        world: World,
        grid: Grid,
        ordered: NDArray[np.intp],
        model: SensorModel,
        rng: np.random.Generator,
        dynamics: Dynamics,
        changing: NDArray[np.bool_] | None,
        target_dynamics: Dynamics,
    ) -> Traverse:
        """Simulate a deployment along a checked path."""
        deviates = any(vars(self).values())
        if world.grid is None:
            world = replace(world, grid=grid)
        changes = changing is not None and dynamics.effect in ('changing', 'moving')
        targets_change = changing is not None and target_dynamics.effect != 'static'
        # Deviations are drawn by the first child, changes of hazards by the second, of targets by
        # the third; spawning takes its time.
        needed = 3 if targets_change else 1 + changes
        children = rng.spawn(needed) if deviates or needed > 1 else []
        if changing is not None and changes:
            world = world.after_change(dynamics, grid, changing, children[1])
        if targets_change:
            how = target_dynamics, grid, grid.free, children[2]
            world = replace(world, target=after_change(world.target, *how))
        walk, passed = self._walk(grid, ordered, children[0]) if deviates else (ordered, ordered)
        survived, readings, after = world.steps(walk, model, rng, dynamics)
        if survived.all():
            if self.camera_failure:
                failed = np.cumsum(children[0].random(survived.size) < self.camera_failure) > 0
                readings = np.where(failed, -1, readings)
            return Traverse(walk, survived.size, Observation(walk, True, readings), after)
        steps_made, known = int(np.argmin(survived)), 0
        if self.contact:
            heard = np.flatnonzero(children[0].random(steps_made) < self.contact)
            known = int(passed[heard[-1]]) if heard.size else 0
        lost = lost_after_contact(ordered, known, self.contact)
        return Traverse(walk, steps_made, lost, after)

    def _walk(
        self, grid: Grid, path: NDArray[np.intp], rng: np.random.Generator
    ) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
        """Draw a robot's walk, and the number of `path` steps passed after each of its steps."""
        drawn = rng.random((len(path) - 1, 3))
        if not self.early_return and not self.detour:
            return path, np.arange(1, len(path))
        walk = [int(path[0])]
        passed: list[int] = []
        for step, (turns, strays, which) in enumerate(drawn):
            here, there = int(path[step]), int(path[step + 1])
            if step and turns < self.early_return:
                # Go home by a shortest path.
                while here != grid.base:
                    around = grid.neighbors(here)
                    here = int(around[np.argmin(grid.steps_to_base[around])])
                    walk.append(here)
                    passed.append(step)
                break
            if strays < self.detour:
                between = np.intersect1d(grid.neighbors(here), grid.neighbors(there))
                between = between[(between != here) & (between != there)]
                if between.size:
                    walk.append(int(between[int(which * between.size)]))
                    passed.append(step)
            walk.append(there)
            passed.append(step + 1)
        return np.array(walk), np.array(passed)


def after_change(
    present: NDArray[np.bool_],
    dynamics: Dynamics,
    grid: Grid,
    possible: NDArray[np.bool_],
    rng: np.random.Generator,
) -> NDArray[np.bool_]:
    """Draw hazards or targets after a change or moves (:eq:`hazard-change`)."""
    rates = dynamics.known_rates()
    if dynamics.kind == 'changing':
        stays_or_comes = np.where(present, 1.0 - rates['vanish'], rates['appear'])
        return np.where(possible, rng.random(present.size) < stays_or_comes, present)
    present = present.copy()
    for cell in rng.permutation(np.flatnonzero(present & possible)):
        if rng.random() < rates['move']:
            around = grid.neighbors(cell)
            free = around[possible[around] & ~present[around]]
            if free.size:
                present[cell], present[rng.choice(free)] = False, True
    return present


AS_ORDERED = Execution()
