# SPDX-License-Identifier: Apache-2.0
"""All losses held together, against the posterior given all evidence at once."""

from itertools import product
import os
import subprocess
import sys
import tracemalloc

import brute_force
from extent import FULL
from kbnitp_ros.core import (
    Belief,
    Estimator,
    Grid,
    METHODS,
    Observation,
    SensorModel,
    update,
    World,
)
from kbnitp_ros.core.inference.smoothing import smoother
from laws import for_each
import numpy as np
import pytest

# Log odds of what is as good as certain.
CERTAIN = 500.0


def expit(log_odds):
    """Return the probability at these log odds."""
    return 0.5 + 0.5 * np.tanh(0.5 * log_odds)


def random_mission(rng, width, height, robots, malfunction=0.05):
    """Draw a belief, a model and what robots on random walks met in a world of that belief."""
    joint = brute_force.random_joint(rng, width * height, 0)
    model = SensorModel(float(rng.uniform(0.1, 1)), malfunction=malfunction)
    world = np.array([rng.choice(4, p=cell.ravel()) for cell in joint])
    s, on = brute_force.step_survival(model), brute_force.detection(model)
    seen = []
    for _ in range(robots):
        path = brute_force.random_path(rng, width, height, 0, int(rng.integers(2, 6)))
        survived = all(rng.random() < s[world[cell] // 2] for cell in path[1:])
        readings = [bool(rng.random() < on[world[cell] % 2]) for cell in path[1:]]
        seen.append((path, readings if survived else None))
    return joint, model, seen


def smoothed(joint, model, seen):
    estimator = Estimator(Belief(joint), model, 'kappa_bnitp_smoothed')
    for path, readings in seen:
        estimator.assimilate(Observation(path, readings is not None, readings))
    return estimator.belief.joint


@for_each('seed', range(60))
def test_one_deployment_is_taken_in_exactly(seed):
    rng = np.random.default_rng(seed)
    joint, model, seen = random_mission(rng, 3, 3, 1)
    path, readings = seen[0]
    exact = update(Belief(joint), model, Observation(path, readings is not None, readings)).joint
    np.testing.assert_allclose(smoothed(joint, model, seen), exact, rtol=0, atol=1e-9)


@for_each('seed', range(40))
def test_a_few_uncertain_cells_are_taken_in_exactly(seed):
    joint, model, seen = random_mission(np.random.default_rng(seed), 2, 2, 8)
    exact = brute_force.posterior(joint, model, *seen)
    np.testing.assert_allclose(smoothed(joint, model, seen), exact, rtol=0, atol=1e-9)


def test_losses_in_a_chain_are_taken_in_exactly():
    """Each loss shares one cell with the next: no cycle, so messages settle on the posterior."""
    rng = np.random.default_rng(0)
    joint, model = brute_force.random_joint(rng, 8, 0), SensorModel(0.6)
    seen = [([0, cell, cell + 1, 0], None) for cell in range(1, 7)]
    exact = brute_force.posterior(joint, model, *seen)
    np.testing.assert_allclose(smoothed(joint, model, seen), exact, rtol=0, atol=1e-6)


def test_many_losses_are_taken_in_closer_than_by_one_pass():
    worse, better = [], []
    for seed in range(30):
        joint, model, seen = random_mission(np.random.default_rng(seed), 4, 2, 12)
        exact = brute_force.posterior(joint, model, *seen)
        one_pass = Belief(joint)
        for path, readings in seen:
            one_pass = update(one_pass, model, Observation(path, readings is not None, readings))
        worse.append(abs(one_pass.joint - exact).max())
        better.append(abs(smoothed(joint, model, seen) - exact).max())
    assert np.mean(better) < 0.2 * np.mean(worse)
    assert max(better) < 0.05


@for_each('seed', range(20))
def test_the_order_of_deployments_does_not_matter(seed):
    rng = np.random.default_rng(seed)
    joint, model, seen = random_mission(rng, 2, 2, 6)
    shuffled = [seen[i] for i in rng.permutation(len(seen))]
    np.testing.assert_allclose(
        smoothed(joint, model, seen), smoothed(joint, model, shuffled), rtol=0, atol=1e-9
    )


def test_a_refused_deployment_leaves_no_trace():
    joint = Belief.from_maps([0, 0, 0.5], [0.5] * 3, [0.5] * 3).joint
    model = SensorModel(0.5, malfunction=0.0)
    estimator = Estimator(Belief(joint), model, 'kappa_bnitp_smoothed')
    with pytest.raises(ValueError, match='impossible'):
        estimator.assimilate(Observation([0, 1, 0], False))
    assert estimator.belief.joint.tobytes() == joint.tobytes()
    estimator.assimilate(Observation([0, 1, 2, 0], False))
    unaware = smoothed(joint, model, [([0, 1, 2, 0], None)])
    assert estimator.belief.joint.tobytes() == unaware.tobytes()


def test_a_deployment_impossible_only_after_an_earlier_one_is_refused():
    """The loss can only be cell 1's doing, which is deadly: nobody returns from there."""
    belief = Belief.from_maps([0, 0.5], [0.5] * 2, [0.5] * 2)
    model = SensorModel(1.0, malfunction=0.0, false_negative=0.0)
    for method in ('kappa_bnitp', 'kappa_bnitp_smoothed'):
        estimator = Estimator(belief, model, method)
        estimator.assimilate(Observation([0, 1, 0], False))
        assert estimator.belief.hazard[1] == pytest.approx(1)
        before = estimator.belief.joint.tobytes()
        with pytest.raises(ValueError, match='impossible'):
            estimator.assimilate(Observation([0, 1, 0], True, [True, False]))
        assert estimator.belief.joint.tobytes() == before


HAZARDS = np.array([[0, *bits] for bits in np.ndindex(*15 * [2])], dtype=float)


def posterior_of_hazards(joint, model, seen):
    """Enumerate the hazards of 4x4 cells, none at the base; targets are told by them alone."""
    survive, on = np.array(brute_force.step_survival(model)), brute_force.detection(model)
    local, weight = joint.copy(), np.ones(len(HAZARDS))
    for path, readings in seen:
        if readings is None:
            exposed = HAZARDS @ np.bincount(path[1:], minlength=16)
            weight *= 1 - survive[0] ** (len(path) - 1 - exposed) * survive[1] ** exposed
        else:
            for cell, reading in zip(path[1:], readings):
                read = np.array([p if reading else 1 - p for p in on])
                local[cell] *= survive[:, None] * read
    of_hazard = local.sum(axis=2)
    weight *= np.where(HAZARDS, of_hazard[:, 1], of_hazard[:, 0]).prod(axis=1)
    hazard = weight @ HAZARDS / weight.sum()
    given = local / np.where(of_hazard > 0, of_hazard, 1)[:, :, None]
    return np.stack([1 - hazard, hazard], axis=-1)[:, :, None] * given


def divergence(exact, belief):
    """KL divergence of a belief from the exact one, nats, summed over the cells."""
    possible = exact > 0
    return (exact[possible] * np.log(exact[possible] / belief[possible])).sum()


@pytest.mark.slow
@for_each('lethality', [0.9, 0.1, 0.3, 0.5], every=4)
def test_a_mission_is_taken_in_nearly_exactly(lethality):
    """25 robots on 4x4 cells from a prior of maximum entropy."""
    model = SensorModel(lethality)
    joint = Belief.prior(Grid(4, 4), 0.5, 0.45, 0.8).joint
    near, far = [], []
    for seed in range(20 if FULL else 6):
        rng = np.random.default_rng(seed)
        world = World.random(Grid(4, 4), rng, 0.5, 0.8, 0.1)
        paths = [brute_force.random_path(rng, 4, 4, 0, rng.integers(1, 11)) for _ in range(25)]
        observations = [world.traverse(path, model, rng) for path in paths]
        seen = [(o.path.tolist(), o.readings) for o in observations]
        exact = posterior_of_hazards(joint, model, seen)
        one_pass = Estimator(Belief(joint), model)
        for observation in observations:
            one_pass.assimilate(observation)
        near.append(divergence(exact, smoothed(joint, model, seen)))
        far.append(divergence(exact, one_pass.belief.joint))
    assert np.mean(near) < 1e-4
    assert np.mean(near) < 0.01 * np.mean(far)


@for_each('seed', range(40))
def test_a_last_contact_is_taken_in_exactly(seed):
    rng = np.random.default_rng(seed)
    joint, model, _ = random_mission(rng, 3, 3, 1)
    path = brute_force.random_path(rng, 3, 3, 0, 5)
    observation = Observation(path, False, steps_survived=int(rng.integers(len(path) - 1)))
    estimator = Estimator(Belief(joint), model, 'kappa_bnitp_smoothed')
    estimator.assimilate(observation)
    exact = update(Belief(joint), model, observation).joint
    np.testing.assert_allclose(estimator.belief.joint, exact, rtol=0, atol=1e-9)


def long_mission(robots, lethality, side=6, seed=1):
    """Return a prior, a model and what robots on random walks from a corner met."""
    grid, rng = Grid(side, side), np.random.default_rng(seed)
    model, prior = SensorModel(lethality), Belief.prior(grid, 0.5, 0.45, 0.8)
    world = World.random(grid, rng, 0.15, 0.8, 0.1)
    # Some walks are taken again and again, as by a planner that has learnt what it can.
    walks = [brute_force.random_path(rng, side, side, 0, rng.integers(2, 13)) for _ in range(30)]
    paths = [
        walks[number % 30]
        if number % 3 == 0
        else brute_force.random_path(rng, side, side, 0, rng.integers(2, 13))
        for number in range(robots)
    ]
    return prior, model, [world.traverse(path, model, rng) for path in paths]


def converged_messages(odds, lost, of_cell, of_path, messages):
    """
    Send the messages of all lost paths at once, and damped, until they stay.

    Arguments are the log odds of the cells, 1 - s_z^n of each entry (a cell of a path), which cell
    and which path it is of, as matrices of zeros and ones, and the messages to start from.

    Returns the messages and the Bethe log evidence.
    """
    for _ in range(3000):
        cavity = of_cell @ (odds + messages @ of_cell) - messages
        log_survival = np.log1p(-(lost[:, 0] + expit(cavity) * (lost[:, 1] - lost[:, 0])))
        others = (of_path @ (log_survival @ of_path) - log_survival)[:, None]
        to_one = np.log(-np.expm1(np.log1p(-lost) + others))
        change = 0.3 * (to_one[:, 1] - to_one[:, 0] - messages)
        messages = messages + change
        if abs(change).max() < 1e-9:
            break
    cells = np.logaddexp(0, odds + messages @ of_cell) - np.logaddexp(0, odds)
    entries = np.logaddexp(0, cavity + messages) - np.logaddexp(0, cavity)
    factors = np.log(-np.expm1(log_survival @ of_path))
    return messages, factors.sum() + cells.sum() - entries.sum()


def from_scratch(prior, model, observations):
    """Return the hazards by messages that are sent from nothing until they stay, all at once."""
    local = np.log(prior.joint[1:])
    entries = []
    for number, seen in enumerate(observations):
        visited, counts = np.unique(seen.path[1:], return_counts=True)
        if seen.survived:
            for cell, read in zip(seen.path[1:], seen.readings):
                if cell:
                    local[cell - 1] += model.log_survival[:, None] + model.log_reading[int(read)]
        else:
            entries += [(cell, number, count) for cell, count in zip(visited, counts)]
    of_hazard = np.logaddexp.reduce(local, axis=2)
    odds = np.concatenate([[-CERTAIN], of_hazard[:, 1] - of_hazard[:, 0]])
    cell, number, count = np.array(entries).T
    of_cell = (cell[:, None] == np.arange(prior.cells)).astype(float)
    of_path = (number[:, None] == np.unique(number)).astype(float)
    lost = -np.expm1(count[:, None] * model.log_survival)
    plain, _ = converged_messages(odds, lost, of_cell, of_path, np.zeros(len(cell)))
    said = plain @ of_cell
    hazard = expit(odds + said)
    fixed = np.argsort(-np.round(said * hazard * (1 - hazard), 8), kind='stable')[:4]
    weights, hazards = [], []
    for values in product((False, True), repeat=4):
        given = odds.copy()
        given[fixed] = np.where(values, CERTAIN, -CERTAIN)
        messages, evidence = converged_messages(given, lost, of_cell, of_path, plain)
        weights.append(evidence - np.logaddexp(0, np.where(values, -1, 1) * odds[fixed]).sum())
        hazards.append(expit(given + messages @ of_cell))
    return np.average(hazards, axis=0, weights=np.exp(np.array(weights) - max(weights)))


@pytest.mark.slow
def test_messages_kept_are_those_sent_from_scratch_to_convergence():
    for lethality in (0.1, 0.5, 0.9):
        prior, model, observations = long_mission(400, lethality)
        estimator = Estimator(prior, model, 'kappa_bnitp_smoothed')
        for robots, observation in enumerate(observations, 1):
            estimator.assimilate(observation)
            if robots in (50, 150, 400):
                expected = from_scratch(prior, model, observations[:robots])
                assert abs(estimator.belief.hazard - expected).max() < 2e-4


@pytest.mark.slow
def test_a_deployment_costs_no_more_for_those_before_it(monkeypatch):
    """Counted in how often a factor sends its messages."""
    times = []
    propagate = smoother.propagate
    monkeypatch.setattr(
        smoother, 'propagate', lambda *arguments: times.append(propagate(*arguments))
    )
    prior, model, observations = long_mission(1500, 0.5)
    estimator, sent = Estimator(prior, model, 'kappa_bnitp_smoothed'), []
    for observation in observations:
        estimator.assimilate(observation)
        sent.append(sum(times))
        times.clear()
    assert np.mean(sent[-200:]) < 3 * np.mean(sent[100:300])


@pytest.mark.slow
def test_memory_grows_by_the_deployment_alone():
    prior, model, observations = long_mission(600, 0.5)
    estimator = Estimator(prior, model, 'kappa_bnitp_smoothed')
    tracemalloc.start()
    sizes = []
    for robots, observation in enumerate(observations, 1):
        estimator.assimilate(observation)
        if robots % 200 == 0:
            sizes.append(tracemalloc.get_traced_memory()[0])
    tracemalloc.stop()
    assert sizes[2] - sizes[1] < 1.1 * (sizes[1] - sizes[0])
    assert (sizes[2] - sizes[1]) / 200 < 2000


def test_equal_paths_share_a_factor():
    prior, model = Belief.prior(Grid(3, 3), 0.5, 0.45, 0.8), SensorModel(0.5)
    estimator = Estimator(prior, model, 'kappa_bnitp_smoothed')
    paths = [[0, 1, 4, 3, 0], [0, 3, 4, 1, 0], [0, 1, 1, 4, 3, 0], [0, 1, 4, 3, 0]]
    for path in paths:
        estimator.assimilate(Observation(path, False))
    assert estimator._inference._losses.graph.copies.tolist() == [3, 1]
    shared = smoothed(prior.joint, model, [(path, None) for path in paths])
    assert estimator.belief.joint.tobytes() == shared.tobytes()


MISSION = """
from hashlib import sha256
import numpy as np
from kbnitp_ros.core import Belief, Estimator, Grid, SensorModel, World
grid, rng = Grid(4, 4), np.random.default_rng(1)
for lethality, malfunction in [(0.5, 0.05), (1.0, 0.0), (0.9, 1e-6)]:
    model = SensorModel(lethality, malfunction, false_negative=0.0)
    world = World.random(grid, rng, 0.2, 0.8, 0.1)
    estimator = Estimator(Belief.prior(grid, 0.5, 0.45, 0.8), model, 'kappa_bnitp_smoothed')
    for robot in range(40):
        path = [0]
        for _ in range(rng.integers(1, 6)):
            path.append(rng.choice(grid.neighbors(path[-1])))
        path += path[-2::-1]
        estimator.assimilate(world.traverse(path, model, rng))
    print(sha256(estimator.belief.joint.tobytes()).hexdigest())
"""


@pytest.mark.processes
def test_kernels_give_the_same_bits_compiled_and_interpreted():
    def run(before='', **environment):
        return subprocess.run(
            [sys.executable, '-W', 'error:::numpy', '-c', before + MISSION],
            env=os.environ | environment,
            stdout=subprocess.PIPE,
            check=True,
        ).stdout

    compiled = run()
    assert compiled == run(NUMBA_DISABLE_JIT='1')
    assert compiled == run("import sys; sys.modules['numba'] = None")
    assert compiled == run(NUMBA_NUM_THREADS='1', OMP_NUM_THREADS='1')


def test_a_mission_gives_what_it_gave():
    """The hazards were computed by commit 2fccc0f, with messages that were less converged."""
    paths = [
        [0, 1, 4, 3, 0],
        [0, 4, 8, 5, 1, 0],
        [0, 3, 7, 8, 4, 0],
        [0, 1, 2, 5, 4, 0],
        [0, 3, 6, 7, 4, 0],
    ]
    prior = Belief.prior(Grid(3, 3), 0.5, 0.45, 0.8)
    estimator = Estimator(prior, SensorModel(0.5), 'kappa_bnitp_smoothed')
    for number in range(20):
        path = paths[number % 5]
        readings = [(number + step) % 2 == 0 for step in range(len(path) - 1)]
        estimator.assimilate(
            Observation(path, False) if number % 3 else Observation(path, True, readings)
        )
    recorded = [
        0.0,
        0.051821594780674794,
        0.29509516363107935,
        0.39774958240235064,
        0.7621869471480331,
        0.740656639640997,
        0.8538292329937381,
        0.1482819934979857,
        0.5089447886815168,
    ]
    np.testing.assert_allclose(estimator.belief.hazard, recorded, rtol=0, atol=1e-5)


@for_each('method', METHODS)
def test_a_path_out_of_the_field_is_refused(method):
    estimator = Estimator(Belief.prior(Grid(3, 3), 0.5, 0.45, 0.8), SensorModel(0.5), method)
    with pytest.raises(ValueError, match='path has the cell 9: the belief has the cells 0 to 8'):
        estimator.assimilate(Observation([0, 9, 0], False))


def test_versions_are_known():
    prior = Belief.prior(Grid(3, 3), 0.5, 0.45, 0.8)
    assert {name: Estimator(prior, SensorModel(0.5), name).version for name in METHODS} == {
        **dict.fromkeys(METHODS, 1),
        'kappa_bnitp_smoothed': 2,
        'kappa_bnitp_sampled': 2,
    }
