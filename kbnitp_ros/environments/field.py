# SPDX-License-Identifier: Apache-2.0
"""The environment `kbnitp_ros/Field-v0`: one field, and many fields at once."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, ClassVar

import gymnasium
from gymnasium import spaces
from gymnasium.error import ResetNeeded
from gymnasium.utils.seeding import np_random
from gymnasium.vector import AutoresetMode, VectorEnv
from gymnasium.vector.utils import batch_space, create_empty_array
from kbnitp_ros.core import Belief, Grid, SensorModel, World
from kbnitp_ros.core.field.check import (
    cost,
    in_short,
    listed,
    probability,
    typed,
    whole_number,
)
from kbnitp_ros.core.field.sensor import OF_HAZARDS
from kbnitp_ros.environments.deployment_kernels import conclude
import numpy as np
from numpy.typing import NDArray

Answer = dict[str, Any]


class FieldVectorEnv(VectorEnv):  # type: ignore[misc]
    """
    Many missions at once, each in an unknown field: steer the robots cell by cell.

    A robot that enters the base is home. Only then the base learns if it came back and what it
    read. The reward is the information gained by this outcome (entropy of hazards and targets
    before minus after, nats; on average `path_information`) minus `loss_cost` of a lost robot; all
    other rewards are 0. A mission is over after its last robot. The field is reset in the next
    step, whose action it ignores (``AutoresetMode.NEXT_STEP``). Field i is the `FieldEnv` that is
    reset with seed + i, bit for bit.

    An observation has the maps of hazard, target and kappa, (3, height, width), row 0 at the
    bottom; the cell of the robot; and the steps and the robots left. Action 3 * row + col moves by
    row - 1 and col - 1; 4 is to stay. ``info['action_mask']`` has the moves that the grid allows
    and that leave enough steps home; any other action is a step home. ``info['returned']`` is
    false in the step in which a robot turned out to be lost.

    Parameters
    ----------
    num_envs, robots, max_steps : int
        Number of fields, of robots of a mission, and of steps of a robot at most.
    grid, model : Grid and SensorModel, optional
        By default 9 x 9 cells, and a lethality of 0.5; the model is both true and believed.
    hazard_density, kappa, target_background : float
        As in `World.random`, for the worlds and for the prior.
    loss_cost : float
        Cost of a lost robot, nats.

    """

    metadata: ClassVar[Answer] = {'autoreset_mode': AutoresetMode.NEXT_STEP}

    @typed
    def __init__(
        self,
        num_envs: int = 1,
        grid: Grid | None = None,
        model: SensorModel | None = None,
        robots: int = 20,
        max_steps: int = 18,
        hazard_density: float = 0.1,
        kappa: float = 0.8,
        target_background: float = 0.05,
        loss_cost: float = 0.0,
        render_mode: None = None,
    ) -> None:
        if render_mode is not None:
            raise ValueError(f'render_mode is {render_mode!r}: it must be None')
        self.num_envs = count = whole_number('num_envs', num_envs, 1)
        self.robots = whole_number('robots', robots, 1)
        self.max_steps = whole_number('max_steps', max_steps, 2)
        self.loss_cost = cost('loss_cost', loss_cost)
        self.grid, self.model = grid or Grid(9, 9), model or SensorModel(0.5)
        for name in OF_HAZARDS:
            if value := getattr(self.model, name):
                raise ValueError(f'{name} is {value}: it must be 0 in the environments')
        z = probability('hazard_density', hazard_density)
        background = probability('target_background', target_background)
        self._chances = z, probability('kappa', kappa), background
        self.prior = Belief.prior(self.grid, z, z * kappa + (1.0 - z) * background, kappa)
        self._log_step, cells = self.model.log_survival, self.grid.cells
        self._camera = np.array([self.model.false_positive, self.model.true_positive])
        shape = 3, self.grid.height, self.grid.width
        self.single_observation_space = spaces.Dict(
            belief=spaces.Box(0.0, 1.0, shape, np.float32),
            position=spaces.Discrete(cells),
            steps_left=spaces.Discrete(self.max_steps + 1),
            robots_left=spaces.Discrete(self.robots + 1),
        )
        # The columns of `Grid.neighbor_table`.
        self.single_action_space = spaces.Discrete(9)
        self.observation_space = batch_space(self.single_observation_space, count)
        self.action_space = batch_space(self.single_action_space, count)
        self._generators: list[tuple[np.random.Generator, int]] = []
        self._is_begun = False
        self._worlds, self._joint = (
            np.zeros((2, count, cells), bool),
            np.empty((count, cells, 2, 2)),
        )
        self._paths = np.full((count, self.max_steps + 1), self.grid.base)
        self._rows = np.arange(count)
        self._seen = create_empty_array(self.single_observation_space, count)

    @property
    def np_random(self) -> tuple[np.random.Generator, ...]:
        """Return the generator of each field, as `gymnasium.vector.SyncVectorEnv` does."""
        return tuple(rng for rng, _ in self._seeded())

    @property
    def np_random_seed(self) -> tuple[int, ...]:
        """Return the seed of each field's generator, as `gymnasium.vector.SyncVectorEnv` does."""
        return tuple(seed for _, seed in self._seeded())

    def _seeded(
        self, seeds: Sequence[int | None] | None = None
    ) -> list[tuple[np.random.Generator, int]]:
        """Return the generators, made anew of seeds that are given, and their seeds."""
        none = [None] * self.num_envs
        self._generators = [
            np_random(seed) if known is None or seed is not None else known
            for known, seed in zip(self._generators or none, seeds or none)
        ]
        return self._generators

    def reset(
        self, *, seed: int | Sequence[int | None] | None = None, options: Answer | None = None
    ) -> tuple[Answer, Answer]:
        """Begin missions in fields drawn anew; a field without a seed keeps its generator."""
        if options:
            raise ValueError(f'options are {options!r}: this environment has none')
        count = self.num_envs
        if isinstance(seed, int | np.integer):
            seed = [*range(seed, seed + count)]
        seeds = [
            each if each is None else whole_number('seed', each, 0)
            for each in listed('seed', [None] * count if seed is None else seed, ', or a number')
        ]
        if len(seeds) != count:
            raise ValueError(f'seed has {len(seeds)} values: it must have {count}, or be a number')
        self._seeded(seeds)
        self._is_begun = True
        self._restart(self._rows)
        return self._answer(np.ones(count, dtype=bool))

    def step(self, actions: Any) -> tuple[Answer, Any, Any, Any, Answer]:
        """Make one step of the robot in each field."""
        if not self._is_begun:
            raise ResetNeeded('call reset before step')
        given, actions = actions, np.asarray(actions)
        is_listed = actions.shape == (self.num_envs,) and actions.dtype.kind in 'iu'
        if not is_listed or actions.min() < 0 or actions.max() > 8:
            raise ValueError(
                f'action is {in_short(given)}: it must be a whole number from 0 to 8 for each of '
                f'{self.num_envs} fields'
            )
        seen, base, is_over = self._seen, self.grid.base, self._seen['robots_left'] == 0
        masked = ~self._mask[self._rows, actions]
        if masked.any():
            home = np.where(self._mask, self._home, self.grid.cells + 1).argmin(axis=1)
            actions = np.where(masked, home, actions)
        seen['position'] = np.where(is_over, base, self._onward[self._rows, actions])
        seen['steps_left'] -= ~is_over
        self._paths[self._rows, self.max_steps - seen['steps_left']] = seen['position']
        reward, returned = np.zeros(self.num_envs), np.ones(self.num_envs, dtype=bool)
        ended = np.flatnonzero(~is_over & (seen['position'] == base))
        if ended.size:
            reward[ended], returned[ended] = self._conclude(ended)
        self._restart(np.flatnonzero(is_over))
        answer, info = self._answer(returned)
        over = answer['robots_left'] == 0
        return answer, reward, over, np.zeros(self.num_envs, dtype=bool), info

    def _conclude(self, ended: NDArray[np.intp]) -> tuple[NDArray[Any], NDArray[Any]]:
        """Return the rewards of robots that are home or lost, and if they are home."""
        gained, returned = np.zeros(ended.size), np.ones(ended.size, dtype=bool)
        # All random numbers of a deployment in one call, whatever its path.
        drawn = np.array(
            [self._generators[field][0].random((2, self.max_steps)) for field in ended]
        )
        steps = self.max_steps - self._seen['steps_left'][ended]
        known = self._worlds, self._log_step, self._camera
        conclude(ended, self._paths[ended], steps, drawn, *known, self._joint, gained, returned)
        self._seen['steps_left'][ended] = self.max_steps
        self._seen['robots_left'][ended] -= 1
        self._map(ended)
        return gained - self.loss_cost * ~returned, returned

    def _restart(self, fields: NDArray[np.intp]) -> None:
        """Begin missions in some fields, in worlds drawn by their generators."""
        for field in fields:
            world = World.random(self.grid, self._generators[field][0], *self._chances)
            self._worlds[:, field] = world.hazard, world.target
        begin = self.grid.base, self.max_steps, self.robots
        for name, value in zip(('position', 'steps_left', 'robots_left'), begin):
            self._seen[name][fields] = value
        self._joint[fields] = self.prior.joint
        self._map(fields)

    def _map(self, fields: NDArray[np.intp]) -> None:
        """Update the maps of some fields."""
        joint, belief = self._joint[fields], self._seen['belief']
        hazard, target = joint[..., 1, :].sum(axis=-1), joint[..., 1].sum(axis=-1)
        kappa = np.divide(joint[..., 1, 1], hazard, out=target.copy(), where=hazard > 0.0)
        maps = np.stack([hazard, target, kappa], axis=1).clip(max=1.0)
        belief[fields] = maps.reshape(-1, *belief.shape[1:])

    def _answer(self, returned: NDArray[np.bool_]) -> tuple[Answer, Answer]:
        """Return observations and infos; find the moves after which a robot is home in time."""
        self._onward = self.grid.neighbor_table[self._seen['position']]
        self._home = self.grid.steps_to_base[self._onward]
        self._mask = (self._onward >= 0) & (self._home < self._seen['steps_left'][:, None])
        info = {'action_mask': self._mask.astype(np.int8), 'returned': returned}
        everywhere = {f'_{name}': np.ones(self.num_envs, dtype=bool) for name in info}
        return {name: each.copy() for name, each in self._seen.items()}, info | everywhere


class FieldEnv(gymnasium.Env):  # type: ignore[misc]
    """A mission in an unknown field: the first field of a `FieldVectorEnv`."""

    def __init__(self, **parameters: Any) -> None:
        self.fields = FieldVectorEnv(1, **parameters)
        self.observation_space = self.fields.single_observation_space
        self.action_space = self.fields.single_action_space

    def reset(
        self, *, seed: int | None = None, options: Answer | None = None
    ) -> tuple[Answer, Answer]:
        """Begin a mission in a field drawn anew."""
        super().reset(seed=seed)
        self.fields._generators = [(self.np_random, self.np_random_seed)]
        seen, info = self.fields.reset(options=options)
        return first(seen), first(info)

    def step(self, action: int) -> tuple[Answer, float, bool, bool, Answer]:
        """Make one step of the robot."""
        seen, reward, over, _, info = self.fields.step(np.array([action]))
        return first(seen), float(reward[0]), bool(over[0]), False, first(info)


def first(answers: Answer) -> Answer:
    """Return the answer of the first field."""
    own = {name: each[0] for name, each in answers.items() if name[0] != '_'}
    return {name: each if each.ndim else each.item() for name, each in own.items()}
