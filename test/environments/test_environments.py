# SPDX-License-Identifier: Apache-2.0
"""The environment for gymnasium: its rules, its beliefs, and many fields as single ones."""

from importlib import import_module
import warnings

from kbnitp_ros.core import (
    Belief,
    Grid,
    Observation,
    path_information,
    PathFinder,
    SearchOptions,
    SensorModel,
    update,
    World,
)
from laws import for_each
import numpy as np
import pytest

gymnasium = pytest.importorskip('gymnasium', reason='gymnasium is not installed')

SyncVectorEnv = gymnasium.vector.SyncVectorEnv
check_env = import_module('gymnasium.utils.env_checker').check_env
np_random = import_module('gymnasium.utils.seeding').np_random
environments = import_module('kbnitp_ros.environments')
field = import_module('kbnitp_ros.environments.field')
ID, FieldEnv, FieldVectorEnv = environments.ID, field.FieldEnv, field.FieldVectorEnv

WALLED = Grid(5, 4, base=7, blocked=(3, 12), through_corners=False)
MODEL = SensorModel(0.6, malfunction=0.02, false_negative=0.1, true_positive=0.9)
SETTINGS = {'grid': WALLED, 'model': MODEL, 'robots': 3, 'max_steps': 7, 'loss_cost': 0.5}
DENSITIES = {'hazard_density': 0.3, 'kappa': 0.7, 'target_background': 0.2}


def allowed(rng, mask):
    """Draw an allowed action for each row of a mask."""
    return (rng.random(mask.shape) * mask).argmax(axis=-1)


def flat(answer):
    """Return an answer of an environment as bytes by name."""
    return {name: np.asarray(each).tobytes() for name, each in answer.items()}


def test_gymnasium_makes_it_by_its_name_and_accepts_it():
    environments.register_environments()
    with warnings.catch_warnings():
        warnings.simplefilter('error')
        check_env(gymnasium.make(ID, robots=2).unwrapped)
        check_env(gymnasium.make(ID, **SETTINGS, **DENSITIES).unwrapped)
    made = gymnasium.make_vec(ID, num_envs=3, vectorization_mode='vector_entry_point')
    assert isinstance(made.unwrapped, FieldVectorEnv)
    observation, _ = made.reset(seed=1)
    assert observation in made.observation_space


@for_each('settings, masked', [({}, 0.0), (SETTINGS, 0.3), (SETTINGS | DENSITIES, 0.0)])
def test_many_fields_are_the_single_ones_bit_for_bit(settings, masked):
    count, rng = 5, np.random.default_rng(1)
    many = FieldVectorEnv(count, **settings)
    singles = SyncVectorEnv([lambda: FieldEnv(**settings)] * count)
    assert many.observation_space == singles.observation_space
    assert many.action_space == singles.action_space
    assert many.metadata['autoreset_mode'] == singles.metadata['autoreset_mode']
    for seed in (4, None, [7, 1, 9, 0, 2]):
        one, other = many.reset(seed=seed), singles.reset(seed=seed)
        over = 0
        for _ in range(120):
            for first, second in zip(one, other, strict=True):
                assert flat(first) == flat(second)
            mask = one[1]['action_mask'] if rng.random() >= masked else np.ones((count, 9))
            actions = allowed(rng, mask)
            one, other = (env.step(actions) for env in (many, singles))
            for first, second in zip(one[1:4], other[1:4], strict=True):
                assert first.tobytes() == second.astype(first.dtype).tobytes()
            over += one[2].sum()
            one, other = (one[0], one[4]), (other[0], other[4])
        assert over > 0 or not settings


@for_each('settings', (SETTINGS, SETTINGS | DENSITIES, SETTINGS | {'model': SensorModel(1.0)}))
def test_the_belief_and_the_reward_are_those_of_the_core(settings):
    """With the same random numbers: a world, then (2, max_steps) for each deployment."""
    given = {'hazard_density': 0.1, 'kappa': 0.8, 'target_background': 0.05} | settings
    z, kappa, background = (given[name] for name in DENSITIES)
    model, choice = given['model'], np.random.default_rng(3)
    env, outcomes = FieldEnv(**settings), []
    for seed in range(20):
        rng = np_random(seed)[0]
        world = World.random(WALLED, rng, z, kappa, background)
        belief = Belief.prior(WALLED, z, z * kappa + (1 - z) * background, kappa)
        seen, info = env.reset(seed=seed)
        is_over = False
        while not is_over:
            path, reward = [WALLED.base], 0.0
            robots = seen['robots_left']
            while seen['robots_left'] == robots:
                assert reward == 0.0
                action = allowed(choice, info['action_mask'])
                row, col = divmod(path[-1], WALLED.width)
                path.append(WALLED.cell(row + action // 3 - 1, col + action % 3 - 1))
                seen, reward, is_over, _, info = env.step(action)
                assert seen['position'] == path[-1]
            drawn, cells = rng.random((2, 7))[:, : len(path) - 1], path[1:]
            returned = bool((drawn[0] < model.survival(world.hazard[cells])).all())
            readings = drawn[1] < model.reading(world.target[cells]) if returned else None
            before = belief
            belief = update(belief, model, Observation(path, returned, readings))
            assert info['returned'] == returned
            gained = before.joint_entropy() - belief.joint_entropy()
            assert reward == pytest.approx(gained - 0.5 * (not returned), abs=1e-9)
            maps = np.array([belief.hazard, belief.target, belief.kappa]).reshape(3, 4, 5)
            assert np.abs(seen['belief'] - maps).max() < 1e-6
            outcomes.append(returned)
    assert {True, False} == set(outcomes)


def test_on_average_the_reward_is_the_information_of_the_path():
    count, path = 20000, [0, 1, 11, 10, 0]
    env = FieldVectorEnv(count, robots=1, max_steps=6)
    env.reset(seed=0)
    for action in (5, 7, 3, 1):
        _, reward, over, _, _ = env.step(np.full(count, action))
    assert over.all()
    expected = path_information(env.prior, env.model, path)
    assert reward.mean() == pytest.approx(expected, abs=4 * reward.std() / count**0.5)


@for_each('grid', (WALLED, Grid(3, 3, base=4), Grid(4, 1), Grid(4, 4, connectivity=4)))
def test_the_mask_has_the_moves_that_leave_a_way_home(grid):
    env, rng = FieldVectorEnv(64, grid=grid, robots=3, max_steps=5), np.random.default_rng(1)
    finder = PathFinder(grid, SearchOptions(max_steps=5, max_visits=6))
    seen, info = env.reset(seed=1)
    for _ in range(40):
        for position, left, mask in zip(seen['position'], seen['steps_left'], info['action_mask']):
            moves = grid.neighbor_table[position][mask == 1]
            assert (moves >= 0).all()
            there = grid.neighbors(position)
            assert set(moves) == set(there[grid.steps_to_base[there] < left])
            if left == 5:
                assert set(moves) == set(finder.next_cells([grid.base]))
        seen, _, _, _, info = env.step(allowed(rng, info['action_mask']))


@for_each('given, words', [
    ({'robots': 0}, 'robots is 0: .*at least 1'),
    ({'max_steps': 1}, 'max_steps is 1: .*at least 2'),
    ({'hazard_density': 1.5}, r'hazard_density is 1.5: .*\[0, 1\]'),
    ({'loss_cost': -1}, 'loss_cost is -1: .*at least 0'),
    ({'grid': (9, 9)}, r'grid is \(9, 9\): it must be Grid'),
    ({'render_mode': 'rgb_array'}, "render_mode is 'rgb_array': it must be None"),
])  # fmt: skip
def test_wrong_parameters_are_refused(given, words):
    with pytest.raises((TypeError, ValueError), match=words):
        FieldEnv(**given)


@for_each('action', [-1, 9, True, 1.0, [4], np.array([[4, 4]]), 'up', None])
def test_wrong_actions_are_refused_and_change_nothing(action):
    one, many = FieldEnv(), FieldVectorEnv(2)
    with pytest.raises(gymnasium.error.ResetNeeded):
        many.step([4, 4])
    seen, _ = one.reset(seed=1)
    many.reset(seed=1)
    for env, given in ((one, action), (many, action), (many, [action])):
        with pytest.raises(ValueError, match='it must be a whole number from 0 to 8 for each of'):
            env.step(given)
    assert one.step(8)[0]['steps_left'] == seen['steps_left'] - 1
    with pytest.raises(ValueError, match='this environment has none'):
        many.reset(options={'reset_mask': [True, False]})


@for_each('seed, words', [
    ([1, 2], 'seed has 2 values: it must have 3, or be a number'),
    ('x', "seed is 'x': it must be a list, or a number"),
    (1.5, 'seed is 1.5: it must be a list, or a number'),
    (-1, 'seed is -1: it must be a whole number at least 0'),
    ([1, 2, 'x'], "seed is 'x': it must be a number"),
])  # fmt: skip
def test_seeds_are_one_for_each_field(seed, words):
    with pytest.raises((TypeError, ValueError), match=words):
        FieldVectorEnv(3).reset(seed=seed)


def test_generators_and_seeds_are_those_of_the_single_fields():
    many, singles = FieldVectorEnv(3), SyncVectorEnv([FieldEnv] * 3)
    assert len(set(many.np_random_seed)) == 3
    with pytest.raises(gymnasium.error.ResetNeeded):
        many.step([4, 4, 4])
    for seed in (4, None, [7, None, 9]):
        seen = [env.reset(seed=seed)[0] for env in (many, singles)]
        assert many.np_random_seed == singles.np_random_seed
        assert flat(seen[0]) == flat(seen[1])
        for one, other in zip(many.np_random, singles.np_random, strict=True):
            assert one.bit_generator.state == other.bit_generator.state
