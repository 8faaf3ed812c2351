# SPDX-License-Identifier: Apache-2.0
"""The laws find planted faults."""

from contextlib import suppress
from itertools import count

from kbnitp_ros.core import Belief, Candidate, KnownModel, PLANNERS, update
from kbnitp_ros.core.field.sensor import times_log
from kbnitp_ros.testing import check_allocation, check_method, check_planner
from laws import for_each
import numpy as np
import pytest


class Sound(KnownModel):
    """A method that keeps the laws."""

    def assimilate(self, observation, robot_type):
        self.belief = update(self.belief, robot_type.model(self.model), observation)


class OwnCopy(Sound):
    """A copy is the object itself."""

    def copy(self):
        return self


class Shared(Sound):
    """Copies share the list behind the belief."""

    def __init__(self, belief, model, *_):
        super().__init__(belief, model)
        self._prior, self._seen = belief, []

    def assimilate(self, observation, robot_type):
        after = self._prior
        for each, its_type in [*self._seen, (observation, robot_type)]:
            after = update(after, its_type.model(self.model), each)
        self._seen.append((observation, robot_type))
        self.belief = after


class Small(Sound):
    """A cell is missing."""

    def assimilate(self, observation, robot_type):
        super().assimilate(observation, robot_type)
        self.belief = Belief(self.belief.joint[1:])


class Blurred(Sound):
    """Cells off the path lose their evidence."""

    def assimilate(self, observation, robot_type):
        super().assimilate(observation, robot_type)
        self.belief = Belief(0.99 * self.belief.joint + 0.01 / 4)


class Chancy(Sound):
    """Every second instance ignores losses."""

    made = count()

    def __init__(self, belief, model, *_):
        super().__init__(belief, model)
        self._forgets = next(self.made) % 2 == 1

    def assimilate(self, observation, robot_type):
        if observation.survived or not self._forgets:
            super().assimilate(observation, robot_type)


class Lenient(Sound):
    """Impossible evidence passes silently."""

    def assimilate(self, observation, robot_type):
        with suppress(ValueError):
            super().assimilate(observation, robot_type)


class Hasty(Sound):
    """The state changes before impossible evidence is refused."""

    def __init__(self, belief, model, *_):
        super().__init__(belief, model)
        self._taken = 0

    def assimilate(self, observation, robot_type):
        self._taken += 1
        super().assimilate(observation, robot_type)
        if self._taken > 2 and not observation.survived:
            super().assimilate(observation, robot_type)


class Inverted(Sound):
    """Readings are inverted."""

    def assimilate(self, observation, robot_type):
        model = robot_type.model(self.model)
        swapped = type(model)(
            model.lethality,
            model.malfunction,
            model.false_negative,
            model.false_positive,
            model.true_positive,
        )
        self.belief = update(self.belief, swapped, observation)


class Alike(Sound):
    """All robots are treated as ordinary ones."""

    def assimilate(self, observation, robot_type):
        self.belief = update(self.belief, self.model, observation)


class Moved(Sound):
    """A loss moves targets without hazards."""

    def assimilate(self, observation, robot_type):
        super().assimilate(observation, robot_type)
        if not observation.survived:
            joint = self.belief.joint.copy()
            joint[observation.path] = self.belief.independent().joint[observation.path]
            self.belief = Belief(joint)


class Particles(KnownModel):
    """Whole fields, drawn once from the prior and weighted by all evidence."""

    tolerance = 0.2

    def __init__(self, belief, model, unknowns, seed):
        super().__init__(belief, model)
        drawn = np.random.default_rng(seed).random((20000, belief.cells, 1))
        self._state = (drawn > belief.joint.reshape(-1, 4).cumsum(axis=1)).sum(axis=2).clip(max=3)
        self._log_weights = np.zeros(len(drawn))

    def assimilate(self, observation, robot_type):
        model = robot_type.model(self.model)
        path, readings = observation.evidence
        if path.max() >= self.belief.cells:
            raise ValueError('the path leaves the field')
        hazard, target = self._state // 2, self._state % 2

        def survived(cells):
            visits = np.bincount(cells, minlength=self.belief.cells)
            return times_log(hazard, np.diff(model.log_survival)) @ visits + len(cells) * safe

        safe, first = model.log_survival[0], observation.steps_survived + 1
        log_weights = self._log_weights + survived(path[1:first])
        if observation.survived:
            log_weights += survived(path[1:])
            for cell, read in zip(path[1:], readings):
                log_weights += model.log_reading[read * 1, target[:, cell]] if read >= 0 else 0.0
        else:
            log_weights += np.log(-np.expm1(survived(path[first:])))
        if log_weights.max() == -np.inf:
            raise ValueError('the outcome is impossible')
        weights = np.exp(log_weights - log_weights.max())
        joint = [weights @ (self._state == state) / weights.sum() for state in range(4)]
        self._log_weights = log_weights
        self.belief = Belief(np.stack(joint, axis=1).reshape(-1, 2, 2))


def test_a_method_that_samples_keeps_the_laws_within_its_tolerance():
    check_method(Particles, cases=2)
    with pytest.raises(AssertionError, match='cells without evidence'):
        check_method(Particles, cases=5, tolerance=1e-9)
    with pytest.raises(AssertionError, match='returns are assimilated exactly'):
        check_method(Inverted, tolerance=0.2)


METHODS = {
    OwnCopy: 'a copy and its original do not .* copy returns the inference itself',
    Shared: 'a copy and its original do not affect each other',
    Small: 'each belief is a distribution',
    Blurred: 'cells free of hazard stay free, .* Hazards of cells free of hazard',
    Chancy: 'the same evidence and seed give the same belief',
    Lenient: 'impossible evidence raises a ValueError .* raises no ValueError',
    Hasty: 'impossible evidence raises .* Belief after further evidence',
    Inverted: 'returns are assimilated exactly',
    Alike: 'returns are assimilated exactly|robots of a type',
    Moved: r'a loss does not change P\(target \| hazard\)',
}


def test_the_sound_method_keeps_the_laws():
    check_method(Sound)
    check_planner(PLANNERS['beam'], cases=5)
    check_allocation(independent, cases=5)


@for_each('method, law', METHODS.items())
def test_a_fault_of_a_method_is_found(method, law):
    with pytest.raises(AssertionError, match=f'breaks a law with seed .*: ({law})'):
        check_method(method)


def open_ended(finder, objective):
    return [Candidate(each.value, each.path[:-1]) for each in PLANNERS['beam'](finder, objective)]


def too_long(finder, objective):
    base = finder.grid.base
    return [Candidate.along(np.full(finder.options.max_steps + 2, base), objective)]


def too_often(finder, objective):
    return [Candidate.along(np.full(finder.options.max_steps + 1, finder.grid.base), objective)]


def worst_first(finder, objective):
    return PLANNERS['beam'](finder, objective)[::-1]


def boastful(finder, objective):
    return [
        Candidate(1.01 * worth + 1.0, path) for worth, path in PLANNERS['beam'](finder, objective)
    ]


def moody():
    asked = []

    def plan(finder, objective):
        asked.append(1)
        return PLANNERS['beam'](finder, objective)[: 1 + len(asked) % 3]

    return plan


PLANS = {
    'path must end at the base|at least two cells': open_ended,
    'at most max_steps': too_long,
    'at most max_visits': too_often,
    'the best path comes first': worst_first,
    'each path has the value stated': boastful,
    'the same belief gives the same paths': moody(),
}


@for_each('law, planner', PLANS.items())
def test_a_fault_of_a_planner_is_found(law, planner):
    with pytest.raises(AssertionError, match=f'breaks a law with seed .*({law})'):
        check_planner(planner)


def independent(robots):
    return [robot.finder.candidates(robot.objective)[0].path for robot in robots]


def one_for_all(robots):
    return independent(robots)[:1]


def as_the_first(robots):
    return independent(robots)[:1] * len(robots)


def second_best(robots):
    return [robot.finder.candidates(robot.objective)[-1].path for robot in robots]


ALLOCATIONS = {
    'each robot has one path, .* Number of paths: 1; ': one_for_all,
    'each robot has one path, .* at most max_steps': as_the_first,
    'a team of one robot gets the best path of a single robot': second_best,
}


@for_each('law, allocation', ALLOCATIONS.items())
def test_a_fault_of_an_allocation_is_found(law, allocation):
    with pytest.raises(AssertionError, match=f'breaks a law with seed .*: ({law})'):
        check_allocation(allocation)


@for_each('check', [check_method, check_planner, check_allocation])
def test_an_object_of_another_type_is_reported(check):
    with pytest.raises(AssertionError, match='is invalid: it is 3: it must be callable with'):
        check(3)
    with pytest.raises(ValueError, match="is 'guess': known are"):
        check('guess')
