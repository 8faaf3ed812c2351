# SPDX-License-Identifier: Apache-2.0
"""Numbers of the sensor model and of the prior that are not known, and what is learnt of them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields, replace
from typing import TypeAlias

from kbnitp_ros.core.field.check import frozen, probability, Value
import numpy as np
from numpy.typing import NDArray

# How many values of a number are weighed. Their spacing is even in asin(sqrt(p)), in which the
# deviation of a rate found from n trials is 0.5 / sqrt(n) whatever the rate: 64 are finer than
# twice that up to 1,600 trials, and the error of such a sum falls faster than any power.
VALUES = 64
# Points within each value's bin at which its prior is summed up.
POINTS = 32


@dataclass(frozen=True)
class Beta:
    """
    A Beta distribution, kept to an interval: the prior of an unknown number.

    Parameters
    ----------
    a, b : float
        Its density is proportional to p^(a-1) (1-p)^(b-1); above 0. With a `low` above 0 `a` may
        be 0: with a `b` of 1 the density is then log-uniform.
    low, high : float
        The interval it is kept to, in [0, 1].

    Raises
    ------
    ValueError
        If the interval is empty, reversed or not within [0, 1], or `a` or `b` is out of range.

    """

    a: float = 1.0
    b: float = 1.0
    low: float = 0.0
    high: float = 1.0

    def __post_init__(self) -> None:
        for name in ('low', 'high'):
            object.__setattr__(self, name, probability(name, getattr(self, name)))
        for name in ('a', 'b'):
            value = float(getattr(self, name))
            is_log_uniform = name == 'a' and value == 0.0 < self.low
            if not (0.0 < value < np.inf or is_log_uniform):
                raise ValueError(f'{name} of a Beta is {value}: it must be above 0 and finite')
            object.__setattr__(self, name, value)
        if self.low >= self.high:
            raise ValueError(
                f'interval is from {self.low} to {self.high}: it must end above its start'
            )

    def bins(self) -> Bins:
        """
        Return the interval in bins and what the prior gives each.

        Equation :eq:`value-bins`.
        """
        low, high = np.arcsin(np.sqrt([self.low, self.high]))
        edges = np.linspace(low, high, VALUES * POINTS + 1)
        middle = np.sin((edges[1:] + edges[:-1]) / 2.0) ** 2
        bounds = (np.sin(edges) ** 2).clip(self.low, self.high)
        log_density = (self.a - 1.0) * np.log(middle) + (self.b - 1.0) * np.log1p(-middle)
        mass = np.diff(bounds) * np.exp(log_density - log_density.max())
        mass = mass.clip(min=np.finfo(np.float64).tiny).reshape(VALUES, POINTS)
        weight = mass.sum(axis=1)
        values = (mass * middle.reshape(VALUES, POINTS)).sum(axis=1) / weight
        return Bins(bounds[::POINTS], values, np.log(weight / weight.sum()))


@dataclass(frozen=True, eq=False, repr=False)
class Bins(Value):
    """The values a number may have."""

    # Shape (values + 1,). Each value stands for all between two edges.
    edges: NDArray[np.float64]
    # Shape (values,). In (0, 1), ascending.
    values: NDArray[np.float64]
    # Shape (values,). Log probability of each.
    log_prior: NDArray[np.float64]

    def __post_init__(self) -> None:
        for field in fields(self):
            frozen(getattr(self, field.name))

    @classmethod
    def known(cls, value: float) -> Bins:
        """Return the bins of a number that is known."""
        return cls(np.array([value, value]), np.array([value]), np.zeros(1))


@dataclass(frozen=True, eq=False, repr=False)
class Learnt(Value):
    """
    What is known of a number by now.

    Attributes
    ----------
    bins : Bins
        The values it may have.
    weights : ndarray, shape (values,)
        The probability of each.
    effective_samples : float
        As many independent draws from the posterior would tell as much of the mean.

    """

    bins: Bins
    weights: NDArray[np.float64]
    effective_samples: float = np.inf

    def __repr__(self) -> str:
        return f'Learnt(mean={self.mean:.4g}, sd={self.sd:.2g})'

    @classmethod
    def by_groups(cls, bins: Bins, weights: NDArray[np.float64]) -> Learnt:
        """Return what groups of samples tell, from the weights of each, (groups, values)."""
        learnt = cls(bins, weights.mean(axis=0))
        of_mean = (weights * bins.values).sum(axis=1).var(ddof=1) / len(weights)
        return replace(learnt, effective_samples=learnt.sd**2 / of_mean if of_mean else np.inf)

    @property
    def mean(self) -> float:
        """Return the mean."""
        return float((self.weights * self.bins.values).sum())

    @property
    def sd(self) -> float:
        """Return the standard deviation."""
        return float(np.sqrt((self.weights * (self.bins.values - self.mean) ** 2).sum()))

    def quantile(self, q: float) -> float:
        """
        Return the value that the number is below with probability `q`.

        Raises
        ------
        ValueError
            If `q` is not in [0, 1].

        """
        below = np.concatenate([[0.0], np.cumsum(self.weights)])
        return float(np.interp(probability('q', q) * below[-1], below, self.bins.edges))


Interval: TypeAlias = 'Beta | Sequence[float]'


@dataclass(frozen=True)
class Unknowns:
    """
    Which numbers are not known, each with its prior.

    A number is known, as the sensor model and the prior maps say, if None is given for it. One
    that is not known has a uniform prior on an interval ``(low, high)``, or a `Beta`.

    Parameters
    ----------
    lethality, malfunction, true_positive, false_positive : (float, float) or Beta, optional
        Of the sensor model. A lethality is told from a false negative by nothing, so the latter
        stays as the model says.
    hazard_density : (float, float) or Beta, optional
        The prior hazard, averaged over the cells where the prior leaves it open. One offset of
        the log odds of all these cells takes the prior map to such an average.
    kappa : (float, float) or Beta, optional
        P(X = 1 | Z = 1), likewise.
    target_background : (float, float) or Beta, optional
        P(X = 1 | Z = 0), likewise.

    Raises
    ------
    ValueError
        If an interval is empty, reversed or not within [0, 1]; it is named.

    """

    lethality: Interval | None = None
    malfunction: Interval | None = None
    hazard_density: Interval | None = None
    kappa: Interval | None = None
    target_background: Interval | None = None
    true_positive: Interval | None = None
    false_positive: Interval | None = None

    def __post_init__(self) -> None:
        for field in fields(self):
            given = getattr(self, field.name)
            if given is not None:
                object.__setattr__(self, field.name, prior(field.name, given))

    @property
    def priors(self) -> dict[str, Beta]:
        """Those not known, by name."""
        given = {field.name: getattr(self, field.name) for field in fields(self)}
        return {name: prior for name, prior in given.items() if prior is not None}


ALL_KNOWN = Unknowns()


def prior(name: str, given: Interval) -> Beta:
    """Return an unknown number's prior."""
    if isinstance(given, Beta):
        return given
    try:
        if np.ndim(given) != 1 or len(given) != 2:
            raise ValueError('it must be two numbers, low and high')
        low, high = given
        return Beta(low=low, high=high)
    except (TypeError, ValueError) as error:
        raise ValueError(f'{name} is unknown within {given}: {error}') from error
