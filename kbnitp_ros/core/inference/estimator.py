# SPDX-License-Identifier: Apache-2.0
"""The estimator of a mission's belief."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import replace
from functools import partial
from typing import Any, cast

from kbnitp_ros.core.field.belief import Belief
from kbnitp_ros.core.field.check import (
    Floats,
    generator,
    in_short,
    shallow_copy,
    typed,
    whole_number,
)
from kbnitp_ros.core.field.clustering import Clustering
from kbnitp_ros.core.field.finding import Finding
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
from kbnitp_ros.core.inference.filter import ratio
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
from kbnitp_ros.core.inference.particles import prior_density, Series
from kbnitp_ros.core.inference.prior_maps import told_numbers, with_number
from kbnitp_ros.core.inference.sampler import Sampler
from kbnitp_ros.plugins import entry_name, PluginError
import numpy as np
from numpy.typing import NDArray


class Estimator:
    """
    A belief that assimilates one deployment after another, and findings between them.

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
                partial(has_ability, 'changes_targets'),
                f'{name} does not take targets that change',
            )
        if model.reach or unknowns.reach is not None:
            check_able(method, partial(has_ability, 'reaches'), f'{name} takes no reach')
            if dynamics.kind in ('used_up', 'learn'):
                raise ValueError(
                    f'reach is not 0, and hazards are {dynamics.kind}: hazards that reach are '
                    'static, changing or moving'
                )
        if model.duds or unknowns.duds is not None:
            check_able(method, partial(has_ability, 'reaches'), f'{name} takes no duds')
            for what, each in (('hazards', dynamics), ('targets', target_dynamics)):
                if each.effect != 'static':
                    raise ValueError(f'duds is not 0, and {what} are {each.kind}: duds are static')
        rates = {**dynamics.unknown_rates, **target_dynamics.target_rates}
        unknown = {**unknowns.priors, **rates}
        if unknown:
            check_able(
                method,
                lambda each: each.learns,
                f'{name} takes all numbers as given and cannot learn {" and ".join(unknown)}',
            )
        if clustering is not None:
            check_able(
                method,
                partial(has_ability, 'clusters'),
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
        self._evidence = Series[tuple[Observation | Finding, RobotType]]()
        self._checker: Checker | None = None
        is_one_pass = isinstance(start, OnePass) and start.learns
        if is_one_pass or (start is Sampler and not clusters):
            correlated = getattr(start, 'correlated', True)
            predicts = is_one_pass and bool(unknown or dynamics.kind == 'learn')
            self._checker = Checker(
                partial(
                    Alternatives,
                    belief if correlated else belief.independent(),
                    model,
                    unknowns,
                    self.seed,
                    dynamics,
                    target_dynamics,
                    correlated,
                    predicts,
                )
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
    def model_check(self) -> ModelCheck:
        """
        Return the evidence for alternatives to the model (:eq:`model-check`).

        'kappa_bnitp', 'relaxed_itp' and, with independent hazards, 'kappa_bnitp_sampled' have
        alternatives. The check may miss moving hazards, which hardly affect returns, and duds.
        """
        if self._checker is None:
            name = entry_name(self.method)
            if self.clustering is not None:
                name += ' with clustered hazards'
            return ModelCheck(
                False,
                {},
                f'{name} has no model check: kappa_bnitp, relaxed_itp and kappa_bnitp_sampled '
                'with independent hazards have one',
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
    def assimilate(
        self, observation: Observation | Finding, robot_type: RobotType = ORDINARY
    ) -> None:
        """
        Assimilate one deployment, or a finding.

        A finding counts as no deployment, and nothing in the field changes between the last
        deployment and it. It is applied now, whatever its `since`.

        Parameters
        ----------
        observation : Observation or Finding
            Outcome of the deployment, or what a person knows of cells.
        robot_type : RobotType
            Type of the robot; numbers that it sets are known, and replace the numbers of the
            estimator's model, given or learnt.

        Raises
        ------
        ValueError
            If the path or a finding leaves the belief's cells, either is impossible under the
            belief, or the method does not use `lost_at`, `by_hazard`, findings or changes; the
            belief is then unchanged.
        PluginError
            If a method of another package breaks the rules; the belief is then unchanged.

        """
        if isinstance(observation, Finding):
            self._check_finding(observation, robot_type)
        else:
            for name, ability in (('lost_at', 'takes_lost_at'), ('by_hazard', 'takes_causes')):
                if getattr(observation, name) is not None:
                    check_able(
                        self.method,
                        partial(has_ability, ability),
                        f'{name} is given, and {entry_name(self.method)} does not use it',
                    )
        inference: Any = self._inference.copy()
        if isinstance(observation, Finding):
            assimilate = partial(inference.assimilate_finding, observation)
        else:
            assimilate = partial(inference.assimilate, observation, robot_type)
        if self.method in METHODS.own:
            assimilate()
        else:
            with METHODS.blamed(self.method):
                assimilate()
                self._checked(inference)
        self._inference = inference
        self._evidence = self._evidence.plus((observation, robot_type))

    def _check_finding(self, finding: Finding, robot_type: RobotType) -> None:
        """Check that the method takes a finding."""
        name = entry_name(self.method)
        check_able(
            self.method,
            partial(has_ability, 'takes_findings'),
            f'{name} takes no findings',
        )
        if finding.changed and self.clustering is not None:
            raise ValueError(
                'changed is True, and hazards are clustered: clustered hazards are static; give '
                'no clustering, or a finding that is not changed'
            )
        if finding.changed:
            check_able(
                self.method,
                partial(has_ability, 'takes_changes'),
                f'changed is True, and {name} takes no field that people change',
            )
        if robot_type != ORDINARY:
            raise ValueError(
                f'robot_type is {in_short(robot_type)}: a finding is of no robot, leave it out'
            )

    def _checked(self, inference: Inference) -> Inference:
        """Check the inference that a method returned."""
        needed = [*CALLED, *KNOWN]
        if getattr(METHODS.find(self.method), 'takes_findings', False):
            needed.append('assimilate_finding')
        lacking = [name for name in needed if not hasattr(inference, name)]
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


def has_ability(name: str, method: object) -> bool:
    """Return whether a method has an ability, which methods of other packages may not name."""
    return bool(getattr(method, name, False))
