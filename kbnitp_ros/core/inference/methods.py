# SPDX-License-Identifier: Apache-2.0
"""
The inference methods.

A new method needs one file and one line here, or an entry point of another package.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import cast, Protocol

from kbnitp_ros.core.field.belief import Belief
from kbnitp_ros.core.field.check import in_short, typed
from kbnitp_ros.core.field.finding import Finding
from kbnitp_ros.core.field.observation import Observation
from kbnitp_ros.core.field.sensor import RobotType, SensorModel
from kbnitp_ros.core.field.unknowns import Dynamics, HAZARDS, Learnt, STATIC, Unknowns
from kbnitp_ros.core.inference.one_pass import OnePass
from kbnitp_ros.core.inference.sampler import Sampler
from kbnitp_ros.plugins import Registry, takes

# Functions and attributes that an inference must have.
CALLED = ('assimilate', 'copy')
KNOWN = ('belief', 'model', 'parameters', 'sampling_error', 'is_converged')


class Inference(Protocol):
    """The state of a method after some deployments."""

    # Belief given all deployments so far.
    belief: Belief
    # Sensor model for planning.
    model: SensorModel
    # The posterior of each unknown number.
    parameters: Mapping[str, Learnt]
    # Expected KL divergence of the belief due to sampling, nats.
    sampling_error: float
    # Whether the sampling error is within the method's limit.
    is_converged: bool

    def assimilate(self, observation: Observation, robot_type: RobotType) -> None:
        """Assimilate a deployment by a robot type; if it raises ValueError, nothing changes."""

    def copy(self) -> Inference:
        """Return an independent copy, which must take little memory."""


class Method(Protocol):
    """A factory of inferences from a prior, a sensor model, its unknowns and a seed."""

    @property
    def learns(self) -> bool: ...

    @property
    def version(self) -> int: ...

    def __call__(
        self,
        belief: Belief,
        model: SensorModel,
        unknowns: Unknowns,
        seed: int,
        dynamics: Dynamics = STATIC,
        /,
    ) -> Inference: ...


def as_method(given: object) -> Method:
    """Return `given`, checked to be an inference method."""
    takes(given, ('belief', 'model', 'unknowns', 'seed'))
    if dynamics := supported_dynamics(given):
        others = [kind for kind in dynamics if kind not in HAZARDS]
        if others:
            raise TypeError(
                f'it supports hazards of kind {others[0]!r}: known are {", ".join(HAZARDS)}'
            )
        takes(given, ('belief', 'model', 'unknowns', 'seed', 'dynamics'))
    if not isinstance(getattr(given, 'learns', None), bool):
        raise TypeError('it must have an attribute learns that is True or False')
    version = getattr(given, 'version', None)
    if not isinstance(version, int) or version < 1:
        raise TypeError('it must have an attribute version that is a whole number from 1')
    lacking = [name for name in CALLED if not callable(getattr(given, name, None))]
    if isinstance(given, type) and lacking:
        raise TypeError(f'it must have {" and ".join(lacking)}')
    return cast(Method, given)


def supported_dynamics(method: object) -> tuple[str, ...]:
    """Return the kinds of `Dynamics` that a method supports besides static hazards."""
    return tuple(getattr(method, 'dynamics', ()))


def check_able(
    given: str | Callable[..., object], is_able: Callable[[Method], object], lack: str
) -> None:
    """Check that a method has a capability; the error is `lack` and the methods that have it."""
    if not is_able(METHODS.find(given)):
        able = [name for name, each in METHODS.items() if is_able(each)]
        raise ValueError(f'{lack}: use {" or ".join(able)}')


METHODS = Registry(
    'method',
    as_method,
    {
        'relaxed_itp': OnePass(
            correlated=False,
            dynamics=('changing', 'used_up', 'moving', 'learn'),
            learns=True,
        ),
        'relaxed_bnitp': OnePass(correlated=False, is_published=True),
        # The paper's method: its printed update of a loss is overconfident.
        'kappa_bnitp_published': OnePass(correlated=True, is_published=True),
        # The default: the same with the exact update of a loss.
        'kappa_bnitp': OnePass(
            correlated=True,
            dynamics=('changing', 'used_up', 'moving', 'learn'),
            learns=True,
        ),
        'kappa_bnitp_sampled': Sampler,
    },
)


@typed
def update(
    belief: Belief,
    model: SensorModel,
    observation: Observation | Finding,
    method: str = 'kappa_bnitp',
) -> Belief:
    """
    Return the belief after one deployment or finding; other cells stay the same, bit for bit.

    If the robot returned, its cells are updated exactly (arXiv:2305.06929, eq. 6-8). If it was
    lost, P(Z) of each cell is updated with the method's likelihood of the loss, and P(X) follows
    through P(X | Z), which a loss leaves unchanged. Steps that it is known to have survived are
    assimilated first; the likelihood of the loss covers the remaining steps. A finding is exact
    with all methods (:eq:`finding`, :eq:`finding-changed`).

    Parameters
    ----------
    belief : Belief
        Belief before the deployment. Methods without kappa treat hazard and target as independent.
    model : SensorModel
        Believed sensor model of the robot.
    observation : Observation or Finding
        Outcome of the deployment, or what a person knows of cells.
    method : str
        A one-pass method.

    Raises
    ------
    ValueError
        If the method is unknown or not one-pass, the path or a finding leaves the belief's cells,
        or the outcome or finding is impossible under the belief.

    """
    one_pass = {name: each for name, each in METHODS.items() if isinstance(each, OnePass)}
    if not isinstance(method, str) or method not in one_pass:
        others = [name for name in METHODS if name not in one_pass]
        raise ValueError(
            f'method is {in_short(method)}: update takes {", ".join(one_pass)}; '
            f'{", ".join(others)} need all deployments: use an Estimator'
        )
    return one_pass[method].update(belief, model, observation)
