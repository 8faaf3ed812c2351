# SPDX-License-Identifier: Apache-2.0
"""
The methods: what each makes of the outcome of a deployment.

A new one is one file and one line here, or an entry point of another package.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Protocol

from kbnitp_ros.core.field import Belief, Kind, Observation, SensorModel
from kbnitp_ros.core.inference import exact, multi_universe, published
from kbnitp_ros.core.inference.one_pass import OnePass
from kbnitp_ros.core.inference.sampled import Sampler
from kbnitp_ros.core.inference.sampled_everywhere import EverywhereSampler
from kbnitp_ros.core.inference.smoothed import Smoother
from kbnitp_ros.core.inference.swept import SweptSmoother
from kbnitp_ros.core.inference.unknowns import Learnt, Unknowns
from kbnitp_ros.plugins import Registry, takes

# What an inference can do, and what it knows.
CALLED = ('assimilate', 'copy')
KNOWN = ('belief', 'model', 'parameters', 'sampling_error', 'is_settled')


class Inference(Protocol):
    """
    What a method made of a mission so far.

    Attributes
    ----------
    belief : Belief
        Given all deployments.
    model : SensorModel
        To plan with.
    parameters : mapping of str to Learnt
        What is known by now of each number that was not.
    sampling_error : float
        How far chance takes the belief from what the method would come to without, as an
        expected KL divergence in nats.
    is_settled : bool
        Whether that is as little as the method aims at.

    """

    belief: Belief
    model: SensorModel
    parameters: Mapping[str, Learnt]
    sampling_error: float
    is_settled: bool

    def assimilate(self, observation: Observation, kind: Kind) -> None:
        """Take in one deployment of a kind of robot; a ValueError leaves all as it was."""

    def copy(self) -> Inference:
        """Return one that goes on by itself from here, at next to no cost in memory."""


class Method(Protocol):
    """
    How a mission is started: with a prior, a sensor model, what is not known of them, and a seed.

    Attributes
    ----------
    learns : bool
        Whether it can learn numbers that are not known.

    """

    @property
    def learns(self) -> bool: ...

    def __call__(
        self, belief: Belief, model: SensorModel, unknowns: Unknowns, seed: int, /
    ) -> Inference: ...


def as_versions(given: object) -> tuple[Method, ...]:
    """
    Return the versions of a method that is to be registered: one, or a tuple of them.

    Raises
    ------
    TypeError
        If one of them is no `Method`.
    ValueError
        If there is none.

    """
    versions = given if isinstance(given, tuple) else (given,)
    if not versions:
        raise ValueError('it is an empty tuple: it must have the versions of a method')
    for each in versions:
        takes(each, ('belief', 'model', 'unknowns', 'seed'))
        if not isinstance(getattr(each, 'learns', None), bool):
            raise TypeError('it must have an attribute learns that is True or False')
        lacking = [name for name in CALLED if not callable(getattr(each, name, None))]
        if isinstance(each, type) and lacking:
            raise TypeError(f'it must have {" and ".join(lacking)}')
    return versions


# All versions of each method, which give different bits. The last is how it is computed now; a log
# is replayed by the one that it was recorded with.
METHODS = Registry(
    'method',
    as_versions,
    {
        'relaxed_itp': OnePass(multi_universe.lost_likelihood, correlated=False),
        'relaxed_bnitp': OnePass(published.lost_likelihood, correlated=False),
        'kappa_bnitp_published': OnePass(published.lost_likelihood, correlated=True),
        'kappa_bnitp': OnePass(exact.lost_likelihood, correlated=True),
        'kappa_bnitp_smoothed': (SweptSmoother, Smoother),
        'kappa_bnitp_sampled': (EverywhereSampler, Sampler),
    },
)


def versions(method: str) -> range:
    """
    Return the versions that there are of a method, from 1.

    Raises
    ------
    ValueError
        If the method is unknown.

    """
    return range(1, 1 + len(METHODS.find(method)))
