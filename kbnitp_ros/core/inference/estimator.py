# SPDX-License-Identifier: Apache-2.0
"""The estimator of a mission's belief, and the ledger that keeps it in deployment order."""

from __future__ import annotations

from bisect import bisect_left
from collections.abc import Callable, Mapping
from dataclasses import replace
from functools import partial
from types import MappingProxyType
from typing import Any, cast

from kbnitp_ros.core.field.belief import Belief
from kbnitp_ros.core.field.check import generator, shallow_copy, typed, whole_number
from kbnitp_ros.core.field.clustering import Clustering
from kbnitp_ros.core.field.grid import Grid
from kbnitp_ros.core.field.observation import Observation
from kbnitp_ros.core.field.sensor import ORDINARY, RobotType, SensorModel
from kbnitp_ros.core.field.unknowns import (
    ALL_KNOWN,
    appearance,
    Dynamics,
    Learnt,
    STATIC,
    TARGET_VANISH,
    Unknowns,
)
from kbnitp_ros.core.field.world import World
from kbnitp_ros.core.inference.bank import prior_density, Series
from kbnitp_ros.core.inference.filter import Floats, ratio
from kbnitp_ros.core.inference.methods import (
    CALLED,
    check_able,
    Inference,
    KNOWN,
    METHODS,
    supported_dynamics,
)
from kbnitp_ros.core.inference.model_check import Alternatives, Checker, ModelCheck
from kbnitp_ros.core.inference.one_pass import OnePass
from kbnitp_ros.core.inference.prior_maps import told_numbers, with_number
from kbnitp_ros.core.inference.record import deployment_order, DeploymentKey, MissionRecord, Report
from kbnitp_ros.plugins import entry_name, PluginError
import numpy as np
from numpy.typing import NDArray


class Estimator:
    """
    A belief that assimilates one deployment after another.

    Parameters
    ----------
    belief : Belief
        The prior. A method without kappa uses only its hazard and target maps.
    model : SensorModel
        Believed sensor model of the robots.
    method : str or callable
        One of `METHODS`, or a callable that makes an `Inference`, such as a class.
    unknowns : Unknowns
        Numbers to learn. Methods: 'kappa_bnitp', 'relaxed_itp' (all numbers but kappa), and
        'kappa_bnitp_sampled' in static fields.
    seed : int
        Seed of the random numbers that a method draws, at least 0. The same evidence in the same
        order gives the same belief, bit for bit.
    dynamics : Dynamics
        How hazards change. The prior describes the field at the first deployment, the belief the
        field at the last deployment.
    clustering : Clustering, optional
        Clustering of static hazards; independent by default. All cells that may have a hazard then
        need the same prior hazard.
    target_dynamics : Dynamics
        How targets change between deployments: 'static', 'changing' or 'learn', whatever the
        hazards do. If the rate at which they vanish is unknown and `appear` is 0, targets appear
        at the rate that keeps their expected number. With 'learn' they are still with the prior
        probability .9.

    Attributes
    ----------
    prior, method, unknowns, seed, dynamics, clustering, target_dynamics
        As given.
    version : int
        Version of the method's arithmetic.

    Raises
    ------
    ValueError
        If the method is unknown or does not support the numbers to learn, the dynamics or the
        clustering, a number to learn has no effect, or another package's method breaks the rules.

    """

    @typed
    def __init__(
        self,
        belief: Belief,
        model: SensorModel,
        method: str | Callable[..., Any] = 'kappa_bnitp',
        unknowns: Unknowns = ALL_KNOWN,
        seed: int = 0,
        *,
        dynamics: Dynamics = STATIC,
        clustering: Clustering | None = None,
        target_dynamics: Dynamics = STATIC,
    ) -> None:
        start, name = METHODS.find(method), entry_name(method)
        if dynamics.effect != 'static':
            what = 'of an unknown kind' if dynamics.kind == 'learn' else dynamics.effect
            check_able(
                method,
                lambda each: dynamics.effect in supported_dynamics(each),
                f'{name} does not take hazards that are {what}',
            )
        target_dynamics.check_targets()
        if target_dynamics.effect != 'static':
            check_able(
                method,
                lambda each: getattr(each, 'changes_targets', False),
                f'{name} does not take targets that change',
            )
        if model.reach or unknowns.reach is not None:
            check_able(
                method, lambda each: getattr(each, 'reaches', False), f'{name} takes no reach'
            )
            if dynamics.kind in ('used_up', 'learn'):
                raise ValueError(
                    f'reach is not 0, and hazards are {dynamics.kind}: hazards that reach are '
                    'static, changing or moving'
                )
        if model.duds or unknowns.duds is not None:
            check_able(
                method, lambda each: getattr(each, 'reaches', False), f'{name} takes no duds'
            )
            for what, each in (('hazards', dynamics), ('targets', target_dynamics)):
                if each.effect != 'static':
                    raise ValueError(f'duds is not 0, and {what} are {each.kind}: duds are static')
        rates = {**dynamics.unknown_rates, **target_dynamics.target_rates}
        if unknown := {**unknowns.priors, **rates}:
            check_able(
                method,
                lambda each: each.learns,
                f'{name} takes all numbers as given and cannot learn {" and ".join(unknown)}',
            )
        if clustering is not None:
            check_able(
                method,
                lambda each: getattr(each, 'clusters', False),
                f'{name} does not take clustered hazards',
            )
        self.prior, self._given = belief, model
        self.method = method
        self.unknowns = unknowns
        self.seed = whole_number('seed', seed, 0)
        self.dynamics, self.target_dynamics = dynamics, target_dynamics
        self.clustering = clustering
        # Methods for independent static hazards do not accept these arguments.
        further = () if dynamics.effect == 'static' else (dynamics,)
        clusters = clustering is not None and clustering.coupling != 0.0
        named: dict[str, Any] = {'clustering': clustering} if clusters else {}
        if target_dynamics.effect != 'static':
            named['target_dynamics'] = target_dynamics
        make: Callable[..., Inference] = start
        self.version = start.version
        self._evidence = Series[tuple[Observation, RobotType]]()
        self._checker: Checker | None = None
        if isinstance(start, OnePass) and start.learns:
            prior = belief if start.correlated else belief.independent()
            self._checker = Checker(
                partial(Alternatives, prior, model, unknowns, self.seed, dynamics, target_dynamics)
            )
        try:
            with METHODS.blamed(method):
                self._inference = self._checked(
                    make(belief, model, unknowns, self.seed, *further, **named)
                )
        except PluginError as error:
            raise ValueError(str(error)) from error

    def __repr__(self) -> str:
        return f'Estimator({entry_name(self.method)}, {self.belief!r})'

    @property
    def belief(self) -> Belief:
        """Return the belief given all deployments so far, averaged over unknown numbers."""
        return self._inference.belief

    @property
    def model(self) -> SensorModel:
        """
        Return the sensor model to plan with: the given one, or its posterior mean.

        It is the model of the common robot type; `RobotType.model` derives those of other types.
        """
        return self._inference.model

    @property
    def parameters(self) -> Mapping[str, Learnt]:
        """Return the posterior of each number to learn, by its name in `Unknowns`."""
        return self._inference.parameters

    @property
    def kinds(self) -> Mapping[str, float]:
        """Return the probability of each kind of hazards; 1 if the kind is given."""
        kinds: Mapping[str, float] = getattr(self._inference, 'kinds', {self.dynamics.kind: 1.0})
        return kinds

    @property
    def target_kinds(self) -> Mapping[str, float]:
        """Return the probability of each kind of targets; 1 if the kind is given."""
        given = {self.target_dynamics.kind: 1.0}
        kinds: Mapping[str, float] = getattr(self._inference, 'target_kinds', given)
        return kinds

    @property
    def probable_target_dynamics(self) -> Dynamics:
        """Return the most probable kind of targets, with its mean rates."""
        if not self.target_dynamics.target_rates:
            return self.target_dynamics
        if self.target_kinds.get('static', 0.0) > 0.5:
            return STATIC
        learnt = self.parameters[TARGET_VANISH]
        vanish = learnt.mean / (1.0 - learnt.zero)
        appear = self.target_dynamics.appear
        if not appear:
            possible = self.prior.target > 0.0
            appear = appearance(vanish, float(self.prior.target[possible].mean()))
        return Dynamics('changing', float(appear), vanish)

    @property
    def probable_dynamics(self) -> Dynamics:
        """Return the most probable kind of hazards, with its mean rates."""
        probable = max(self.kinds, key=lambda kind: self.kinds[kind])
        dynamics = next(each for each in self.dynamics.kinds if each.kind == probable)
        rates: dict[str, Any] = {
            name: self.parameters[name].mean for name in dynamics.unknown_rates
        }
        if 'vanish' in rates and not dynamics.appear:
            learnt = self.parameters.get('hazard_density')
            density = learnt.mean if learnt else prior_density(self.prior)
            rates['appear'] = appearance(rates['vanish'], density)
        return replace(dynamics, **rates)

    @property
    def check(self) -> ModelCheck:
        """
        Return the evidence for alternatives to the model (:eq:`model-check`).

        Only 'kappa_bnitp' and 'relaxed_itp' have alternatives. The check may miss moving hazards,
        which hardly affect returns.
        """
        if self._checker is None:
            name = entry_name(self.method)
            return ModelCheck(
                False, {}, f'{name} has no model check: kappa_bnitp and relaxed_itp have one'
            )
        predicted = getattr(self._inference, 'predicted', None)
        return self._checker.check(self._evidence, predicted)

    @property
    def sampling_error(self) -> float:
        """
        Return the expected KL divergence of the belief due to sampling, nats; 0 if exact.

        The estimate is based on the spread of the chains, so it misses a bias common to all.
        """
        return self._inference.sampling_error

    @property
    def is_converged(self) -> bool:
        """Return whether the sampling error is within the method's limit."""
        return self._inference.is_converged

    @typed
    def assimilate(self, observation: Observation, robot_type: RobotType = ORDINARY) -> None:
        """
        Assimilate one deployment.

        Parameters
        ----------
        observation : Observation
            Its outcome.
        robot_type : RobotType
            Type of the robot; numbers that it sets are known, and replace the numbers of the
            estimator's model, given or learnt.

        Raises
        ------
        ValueError
            If the path leaves the belief's cells, the outcome is impossible under the belief, or
            the method does not use `lost_at`; the belief is then unchanged.
        PluginError
            If a method of another package breaks the rules; the belief is then unchanged.

        """
        if observation.lost_at is not None:
            check_able(
                self.method,
                lambda each: getattr(each, 'takes_lost_at', False),
                f'lost_at is given, and {entry_name(self.method)} does not use it',
            )
        inference = self._inference.copy()
        if self.method in METHODS.own:
            inference.assimilate(observation, robot_type)
        else:
            with METHODS.blamed(self.method):
                inference.assimilate(observation, robot_type)
                self._checked(inference)
        self._inference = inference
        self._evidence = self._evidence.plus((observation, robot_type))

    def _checked(self, inference: Inference) -> Inference:
        """Check the inference that a method returned."""
        lacking = [name for name in (*CALLED, *KNOWN) if not hasattr(inference, name)]
        if lacking:
            raise METHODS.fault(self.method, f'has no {" and no ".join(lacking)}')
        if not isinstance(inference.belief, Belief):
            raise METHODS.fault(self.method, f'gives {inference.belief!r} in place of a Belief')
        if inference.belief.cells != self.prior.cells:
            raise METHODS.fault(
                self.method,
                f'gives a belief of {inference.belief.cells} cells where the field has '
                f'{self.prior.cells}',
            )
        return inference

    @property
    def told(self) -> dict[str, float]:
        """Return the numbers of sensors and prior that are given and not 0, by name."""
        return {
            name: value
            for name, value in told_numbers(self.prior, self._given).items()
            if name not in self.unknowns.priors and value
        }

    def retold(self, name: str, factor: float) -> Estimator:
        """
        Return the estimator of the same evidence with a told number times a factor.

        Own numbers of robot types change as well. Learnt numbers keep their particles, which are
        weighed anew.
        """
        prior, model = with_number(self.prior, self._given, name, factor)

        def own(robot_type: RobotType) -> RobotType:
            value = robot_type.sensors.get(name)
            if value is None:
                return robot_type
            return replace(robot_type, **{name: min(value * factor, 1.0)})

        other = shallow_copy(self)
        if hasattr(self._inference, 'retold'):
            other._inference = self._inference.retold(prior, model, own)
            return other
        other = Estimator(
            prior,
            model,
            self.method,
            self.unknowns,
            self.seed,
            dynamics=self.dynamics,
            clustering=self.clustering,
            target_dynamics=self.target_dynamics,
        )
        for observation, robot_type in self._evidence:
            other.assimilate(observation, own(robot_type))
        return other

    @property
    def hypotheses(self) -> tuple[Floats, Floats, Mapping[str, Floats]] | None:
        """
        Return the hypotheses under which the hazards of all cells are independent.

        P(hazard) of each cell, shape (hypotheses, cells), the weights, (hypotheses,), and learnt
        numbers of the sensor model, by name; None for methods that draw all cells jointly.
        """
        given = getattr(self._inference, 'hypotheses', None)
        if given is not None:
            return cast(tuple[Floats, Floats, Mapping[str, Floats]], given())
        if hasattr(self._inference, 'draws'):
            return None
        return self.belief.hazard[None], np.ones(1), {}

    @property
    def particles(self) -> float:
        """Return the number of hypotheses that are drawn at random; infinity if none is."""
        return float(getattr(self._inference, 'particles', np.inf))

    @property
    def draws_are_exact(self) -> bool:
        """Return whether `draws` come from the joint posterior, without approximation."""
        return bool(getattr(self._inference, 'draws_are_exact', False))

    def draws(self, count: int, rng: np.random.Generator) -> tuple[NDArray[np.bool_], float]:
        """
        Draw the hazards of all cells jointly, given all deployments so far.

        'kappa_bnitp_sampled' draws from the joint posterior. One-pass methods, and methods of
        other packages that define no `draws`, draw each cell independently, given learnt numbers
        drawn first. Do not base a certificate on independent draws.

        Parameters
        ----------
        count : int
            Number of draws, at least 1.
        rng : numpy.random.Generator
            The only source of randomness.

        Returns
        -------
        hazardous : ndarray of bool, shape (count, cells)
            Hazards in each draw.
        independent : float
            Effective number of independent draws, at most `count`.

        Raises
        ------
        ValueError
            If `count` is out of range.
        PluginError
            If a method of another package breaks the rules.

        """
        count, rng = whole_number('count', count, 1), generator(rng)
        draw = getattr(self._inference, 'draws', None)
        if draw is None:
            return rng.random((count, self.belief.cells)) < self.belief.hazard, float(count)
        with METHODS.blamed(self.method):
            hazardous, independent = draw(count, rng)
            if np.shape(hazardous) != (count, self.belief.cells):
                raise METHODS.fault(
                    self.method,
                    f'draws hazards of shape {np.shape(hazardous)}: it must be '
                    f'({count}, {self.belief.cells})',
                )
        return hazardous, float(independent)

    def worlds(self, count: int, rng: np.random.Generator) -> list[tuple[World, SensorModel]]:
        """Draw fields: hazards as in `draws`, targets, and a sensor model for each field."""
        count, rng = whole_number('count', count, 1), generator(rng)
        draw = getattr(self._inference, 'draws_with_models', None)
        if draw is None:
            hazardous, models = self.draws(count, rng)[0], [self.model] * count
        else:
            hazardous, models = draw(count, rng)
        joint = self.belief.joint
        chance = joint.sum(axis=2)
        if_safe, if_hazardous = (joint[:, :, 1] / np.where(chance > 0.0, chance, 1.0)).T
        target = rng.random(hazardous.shape) < np.where(hazardous, if_hazardous, if_safe)
        fields = [(World(*maps), model) for *maps, model in zip(hazardous, target, models)]
        if self.belief.duds is None:
            return [(world.with_duds(model.duds, rng), model) for world, model in fields]
        # P(dud | hazard, X) of each cell.
        never = ratio(self.belief.duds, joint[:, 1])[np.arange(len(joint)), target.astype(int)]
        duds = hazardous & (rng.random(hazardous.shape) < never)
        return [(replace(world, duds=own), each) for (world, each), own in zip(fields, duds)]

    def copy(self) -> Estimator:
        """Return an independent copy; it shares arrays and takes little memory."""
        other = shallow_copy(self)
        other._inference = self._inference.copy()
        return other


# Estimators are kept after each of the last 2 ** DENSE deployments, and after every second,
# fourth, eighth and so on further back; few deployments before a late one are then repeated.
DENSE = 2


class Ledger(MissionRecord):
    """
    The record of a mission and its belief, with each deployment counted exactly once.

    The belief assimilates, in deployment order, all deployments whose path and report are known:
    it is the same, bit for bit, whatever their order of arrival. A report that is impossible given
    the assimilated deployments is refused.

    Parameters
    ----------
    grid, max_steps, robot_types
        As in `MissionRecord`.
    estimator : Estimator
        Estimator before the first deployment.

    Attributes
    ----------
    deployments : list of DeploymentKey
        Deployments in the belief, in deployment order.
    newest : DeploymentKey or None
        Deployment assimilated last; None before the first.
    newest_stamp : int
        Stamp of its report, nanoseconds of ROS time.
    report_contents : dict of DeploymentKey to int
        Hashes of the messages of the reports in the belief; 0 for a report without a message.
    assimilations : int
        Number of deployments assimilated, including repetitions after late deployments.

    """

    def __init__(
        self,
        grid: Grid,
        max_steps: int,
        estimator: Estimator,
        robot_types: Mapping[str, RobotType] = MappingProxyType({}),
    ) -> None:
        super().__init__(grid, max_steps, robot_types)
        self.deployments: list[DeploymentKey] = []
        self.newest: DeploymentKey | None = None
        self.newest_stamp = 0
        self.report_contents: dict[DeploymentKey, int] = {}
        self.assimilations = 0
        # Estimators kept, by number of deployments.
        self._estimators = {0: estimator}

    @property
    def estimator(self) -> Estimator:
        """Return the estimator after all assimilated deployments."""
        return self._estimators[len(self.deployments)]

    @property
    def belief(self) -> Belief:
        """Return the belief after all assimilated deployments."""
        return self.estimator.belief

    def copy(self) -> Ledger:
        """Return an independent copy."""
        other = super().copy()
        other.deployments = self.deployments.copy()
        other.report_contents = self.report_contents.copy()
        return other

    def _hear_again(self, key: DeploymentKey, report: Report) -> None:
        # Refer to the new message: the first one may be in no log if its publisher was lost.
        self.report_contents[key] = report.content

    def _assimilate(self, key: DeploymentKey, outcome: Observation, report: Report) -> None:
        """Assimilate a deployment, and assimilate all later deployments again."""
        place = bisect_left(self.deployments, deployment_order(key), key=deployment_order)
        start = max(count for count in self._estimators if count <= place)
        estimators = {count: each for count, each in self._estimators.items() if count <= start}
        first_later = place + (key in self.outcomes)
        later = self.deployments[first_later:]
        deployments = [*self.deployments[start:place], key, *later]
        for count, each in enumerate(deployments, start + 1):
            self.assimilations += 1
            estimator = estimators[count - 1].copy()
            try:
                estimator.assimilate(
                    outcome if each == key else self.outcomes[each], self.robot_type(each)
                )
            except ValueError as error:
                if each == key:
                    raise
                raise ValueError(
                    f'report of deployment {key} contradicts the counted report of {each}: {error}'
                ) from error
            estimators[count] = estimator
            estimators = {
                kept: estimators[kept]
                for kept in estimators
                if kept % 2 ** max(0, (count - kept).bit_length() - DENSE) == 0
            }
        self._estimators = estimators
        self.deployments[start:] = deployments
        self.newest, self.newest_stamp = key, report.stamp
        self.report_contents[key] = report.content
