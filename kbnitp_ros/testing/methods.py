# SPDX-License-Identifier: Apache-2.0
"""Laws that every inference method obeys, as checks."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import replace
from functools import partial
from typing import cast

from kbnitp_ros.core import (
    Belief,
    DeploymentKey,
    Estimator,
    Ledger,
    METHODS,
    Observation,
    ORDINARY,
    Report,
    RobotType,
    SensorModel,
    Unknowns,
)
from kbnitp_ros.core.field.check import probability
from kbnitp_ros.core.inference.methods import CALLED, Inference, KNOWN, Method
from kbnitp_ros.testing.laws import (
    draw_mission,
    draw_walk,
    hold,
    MissionCase,
    require,
    require_close,
    require_same,
    ROUNDING,
    with_type,
)
import numpy as np

# Number of steps of a long path, whose survival probability is tiny or underflows to 0.
LONG = 3000

# Prior of a number that is learnt.
LETHALITY = (0.2, 0.8)


def check_method(
    method: str | object, *, cases: int = 10, seed: int = 0, tolerance: float | None = None
) -> None:
    """
    Check that a method obeys the laws of this package, in random cases.

    Parameters
    ----------
    method : str or callable
        Name in `METHODS`, or the method.
    cases : int
        Number of random missions.
    seed : int
        Seed of the first mission; mission k has the seed `seed` + k.
    tolerance : float, optional
        Maximum error of a probability. By default the method's attribute `tolerance`, by which a
        method says that it samples; without it rounding, 1e-9.

    Raises
    ------
    AssertionError
        If the method breaks a law.

    """
    given = METHODS.get(method) if isinstance(method, str) else method
    told = getattr(given, 'tolerance', ROUNDING) if tolerance is None else tolerance
    draw = partial(draw_mission, tolerance=probability('tolerance', told))
    hold(METHODS, method, LAWS, draw, cases, seed)


def start(method: Method, mission: MissionCase, model: SensorModel | None = None) -> Inference:
    """Return the inference of a method before the first deployment."""
    return method(mission.prior, model or mission.model, Unknowns(), mission.seed)


def fold(
    inference: Inference, deployments: Iterable[tuple[Observation, RobotType]]
) -> list[Belief]:
    """Assimilate deployments; return the belief before the first and after each."""
    beliefs = [inference.belief]
    for observation, robot_type in deployments:
        inference.assimilate(observation, robot_type)
        beliefs.append(inference.belief)
    return beliefs


def can_be_used(method: Method, mission: MissionCase) -> None:
    """Check that an inference has the methods and attributes that an estimator uses."""
    inference = start(method, mission)
    for name in (*CALLED, *KNOWN):
        require(hasattr(inference, name), f'The inference has no {name}')
    fold(inference, mission.deployments)
    require(isinstance(inference.model, SensorModel), f'model is {inference.model!r}')
    error = inference.sampling_error
    require(0.0 <= error < np.inf, f'sampling_error is {error}')
    require(inference.is_converged in (True, False), f'is_converged is {inference.is_converged!r}')


def begins_with_the_prior(method: Method, mission: MissionCase) -> None:
    """Check that the first belief has the hazards and targets of the prior."""
    inference = start(method, mission)
    prior = mission.prior
    require_close(
        inference.belief.hazard, prior.hazard, 'Hazards of the first belief', mission.tolerance
    )
    require_close(
        inference.belief.target, prior.target, 'Targets of the first belief', mission.tolerance
    )
    require(not inference.parameters, f'parameters has {list(inference.parameters)}')


def is_a_distribution(method: Method, mission: MissionCase) -> None:
    """Check that each belief is a distribution in every cell, and is not changed later."""
    inference = start(method, mission)
    given = [(inference.belief, require_distribution(inference.belief, mission, 0))]
    for number, (observation, robot_type) in enumerate(mission.deployments, 1):
        inference.assimilate(observation, robot_type)
        given.append((inference.belief, require_distribution(inference.belief, mission, number)))
    for number, (belief, bits) in enumerate(given):
        words = f'The belief after {number} deployments was changed later'
        require(belief.joint.tobytes() == bits, words)


def require_distribution(belief: Belief, mission: MissionCase, number: int) -> bytes:
    """Return a belief's bits; raise an AssertionError if it is no distribution on the field."""
    after = f'After {number} deployments'
    require(isinstance(belief, Belief), f'{after} the belief is {belief!r}')
    cells, joint = mission.prior.cells, belief.joint
    require(belief.cells == cells, f'{after} the belief has {belief.cells} cells, not {cells}')
    within = (joint >= 0.0) & (joint <= 1.0 + ROUNDING)
    require(within.all(), f'{after} a value is not in [0, 1]')
    require_close(joint.sum(axis=(1, 2)), np.ones(cells), f'{after}, sum of each cell')
    return joint.tobytes()


def keeps_what_is_certain(method: Method, mission: MissionCase) -> None:
    """Check that cells free of hazard stay free, and blocked cells unchanged."""
    before, *_, after = fold(start(method, mission), mission.deployments)
    safe = before.hazard == 0.0
    require(safe[mission.grid.base], 'The prior has a hazard at the base')
    require_close(
        after.hazard[safe],
        before.hazard[safe],
        'Hazards of cells free of hazard',
        mission.tolerance,
    )
    blocked = ~mission.grid.free
    require_close(
        after.joint[blocked], before.joint[blocked], 'Belief in blocked cells', mission.tolerance
    )


def keeps_cells_without_evidence(method: Method, mission: MissionCase) -> None:
    """Check that the belief in cells without evidence does not change."""
    before, *_, after = fold(start(method, mission), mission.deployments)
    elsewhere = np.ones(mission.grid.cells, dtype=bool)
    for observation, _ in mission.deployments:
        elsewhere[observation.path] = False
    require_close(
        after.joint[elsewhere],
        before.joint[elsewhere],
        'Belief in unvisited cells',
        mission.tolerance,
    )


def is_reproducible(method: Method, mission: MissionCase) -> None:
    """Check that the same evidence and seed give the same belief, bit for bit."""
    one, other = (fold(start(method, mission), mission.deployments) for _ in range(2))
    for number, (first, second) in enumerate(zip(one, other)):
        require_same(second, first, f'Second run, after {number} deployments')


def copies_go_on_by_themselves(method: Method, mission: MissionCase) -> None:
    """Check that a copy and its original do not affect each other."""
    half = len(mission.deployments) // 2
    first, second = mission.deployments[:half], mission.deployments[half:]
    expected = fold(start(method, mission), mission.deployments)[-1]
    inference = start(method, mission)
    before = fold(inference, first)[-1]
    copied = inference.copy()
    require(copied is not inference, 'copy returns the inference itself')
    require_same(copied.belief, before, 'The belief of a copy differs from that of its original')
    fold(copied, second)
    require_same(inference.belief, before, 'Evidence of a copy changes its original')
    fold(copied, first)
    require_same(fold(inference, second)[-1], expected, 'Original, continued after its copy')
    third = start(method, mission)
    fold(third, first)
    kept = third.copy()
    fold(third, second)
    require_same(kept.belief, before, 'Evidence of an original changes its copy')
    require_same(fold(kept, second)[-1], expected, 'Copy, continued after its original')


def is_a_fold_of_the_evidence(method: Method, mission: MissionCase) -> None:
    """Check that the belief does not depend on the order in which evidence arrives."""
    expected = fold(start(method, mission), mission.deployments)[-1]
    robot_types = {
        f'robot_{n}': robot_type for n, (_, robot_type) in enumerate(mission.deployments)
    }
    longest = max(each.steps for each, _ in mission.deployments)
    # A ledger calls only methods of an estimator that an inference also has.
    ledger = Ledger(mission.grid, longest, cast(Estimator, start(method, mission)), robot_types)
    rng = np.random.default_rng(mission.seed)
    said: list[tuple[DeploymentKey, object]] = []
    for number, (observation, _) in enumerate(mission.deployments):
        key, cells = DeploymentKey(f'robot_{number}', number), observation.path.tolist()
        read = () if observation.readings is None else observation.readings.astype(int).tolist()
        report = Report(
            observation.survived,
            tuple(zip(cells[1:], read)),
            steps_survived=observation.steps_survived,
            entered=tuple(observation.is_entered.tolist()) if observation.survived else (),
        )
        said += [(key, tuple(cells)), (key, report)]
        if observation.survived:
            # A late return: the planner had given the robot up.
            said.append((key, Report(False)))
    for place in [*rng.permutation(len(said)), *rng.permutation(len(said))]:
        key, each = said[place]
        if isinstance(each, Report):
            ledger.record_report(key, each)
        else:
            ledger.record_path(key, cast(tuple[int, ...], each))
    require_same(ledger.belief, expected, 'Belief after paths and reports in random order')


def forgets_the_order_of_returns(method: Method, mission: MissionCase) -> None:
    """Check that the order of returns does not matter."""
    one, other = (
        fold(start(method, mission), returns)[-1]
        for returns in (mission.returns, mission.returns[::-1])
    )
    require_close(
        other.joint, one.joint, 'Belief after returns in reverse order', mission.tolerance
    )


def takes_returns_in_exactly(method: Method, mission: MissionCase) -> None:
    """Check that returns are assimilated exactly, by Bayes' rule."""
    inference = start(method, mission)
    joint = inference.belief.joint.copy()
    found = fold(inference, mission.returns)[-1]
    for observation, robot_type in mission.returns:
        model, (path, readings) = robot_type.model(mission.model), observation.evidence
        survival, reading = model.survival(np.arange(2)), model.reading(np.arange(2))
        for cell, read in zip(path[1:], () if readings is None else readings):
            of_target = np.ones(2) if read == -1 else reading if read else 1.0 - reading
            joint[cell] *= survival[:, None] * of_target
    joint /= joint.sum(axis=(1, 2), keepdims=True)
    require_close(found.joint, joint, 'Belief after returns', mission.tolerance)


def keeps_kappa_in_a_loss(method: Method, mission: MissionCase) -> None:
    """Check that a loss does not change P(target | hazard)."""
    lost, robot_type = next(each for each in reversed(mission.deployments) if not each[0].survived)
    before, after = fold(start(method, mission), [(Observation(lost.path, False), robot_type)])
    # Of a hazard that is hardly possible, few samples tell the target.
    least = max(1e-6, mission.tolerance)
    told_apart = (before.hazard > least) & (after.hazard > least)
    within = max(1e-7, mission.tolerance)
    require_close(after.kappa[told_apart], before.kappa[told_apart], 'P(target | hazard)', within)


def refuses_the_impossible(method: Method, mission: MissionCase) -> None:
    """Check that impossible evidence raises a ValueError and changes nothing."""
    grid = mission.grid
    # A sensor that never errs, so that two different readings of one cell are impossible.
    model = replace(mission.model, true_positive=1.0, false_positive=0.0)
    around = grid.neighbors(grid.base)
    cell = int(around[mission.prior.hazard[around].argmax()])
    looked = np.array([True, False, True])
    twice = Observation(np.array([grid.base, cell, cell, grid.base]), True, looked)
    outside = Observation(np.array([grid.base, grid.cells, grid.base]), False)
    likely = Observation(np.array([grid.base, cell, grid.base]), False), ORDINARY
    expected = fold(start(method, mission, model), [likely, likely])[-1]
    inference = start(method, mission, model)
    before = fold(inference, [likely])[-1]
    for what, impossible in (
        ('contradictory readings', twice),
        ('a path out of the field', outside),
    ):
        try:
            inference.assimilate(impossible, ORDINARY)
        except ValueError:
            require_same(inference.belief, before, f'Belief after {what}')
        except Exception as error:
            raise AssertionError(
                f'Evidence with {what} raises {with_type(error)}, not a ValueError'
            ) from error
        else:
            raise AssertionError(f'Evidence with {what} raises no ValueError')
    require_same(fold(inference, [likely])[-1], expected, 'Belief after further evidence')


def knows_robot_types(method: Method, mission: MissionCase) -> None:
    """Check that robots of a type count like common robots with the numbers of that type."""
    robot_type = RobotType(lethality=0.3, malfunction=0.1, true_positive=0.8, false_positive=0.2)
    observations = [observation for observation, _ in mission.deployments]
    of_type = fold(start(method, mission), [(each, robot_type) for each in observations])[-1]
    alike = start(method, mission, robot_type.model(mission.model))
    expected = fold(alike, [(each, ORDINARY) for each in observations])[-1]
    within = 1e-12 if mission.tolerance == ROUNDING else mission.tolerance
    require_close(of_type.joint, expected.joint, 'Belief after robots of a type', within)


def stands_long_paths(method: Method, mission: MissionCase) -> None:
    """Check that long paths neither overflow nor underflow."""
    rng = np.random.default_rng(mission.seed)
    path = draw_walk(rng, mission.grid, LONG)
    readings = rng.random(LONG) < 0.5
    for observation in (Observation(path, False), Observation(path, True, readings)):
        joint = fold(start(method, mission), [(observation, ORDINARY)])[-1].joint
        require(bool(np.isfinite(joint).all()), f'After {LONG} steps a value is not finite')


def learns_within_the_prior(method: Method, mission: MissionCase) -> None:
    """Check that the posterior of a learnt number is within the interval of its prior."""
    if not method.learns:
        return
    low, high = LETHALITY
    unknowns = Unknowns(lethality=LETHALITY)
    inference = method(mission.prior, mission.model, unknowns, mission.seed)
    fold(inference, mission.deployments)
    names = list(inference.parameters)
    require(names == ['lethality'], f'parameters has {names}: it must have only lethality')
    learnt = inference.parameters['lethality']
    for q in (0.0, 0.5, 1.0):
        value = learnt.quantile(q)
        require(
            low - ROUNDING <= value <= high + ROUNDING,
            f'The quantile {q} of lethality is {value}, outside the prior from {low} to {high}',
        )
    total = float(learnt.weights.sum())
    require(abs(total - 1.0) <= ROUNDING, f'The weights of lethality sum to {total}, not 1')


LAWS: tuple[Callable[[Method, MissionCase], None], ...] = (
    is_a_distribution,
    can_be_used,
    begins_with_the_prior,
    keeps_what_is_certain,
    keeps_cells_without_evidence,
    is_reproducible,
    copies_go_on_by_themselves,
    is_a_fold_of_the_evidence,
    forgets_the_order_of_returns,
    takes_returns_in_exactly,
    keeps_kappa_in_a_loss,
    refuses_the_impossible,
    knows_robot_types,
    stands_long_paths,
    learns_within_the_prior,
)
