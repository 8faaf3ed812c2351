# SPDX-License-Identifier: Apache-2.0
"""The unknowns of a mission: numbers and kinds of hazards."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any, TypeAlias

from kbnitp_ros.core.field.check import (
    check_word,
    in_short,
    number,
    probability,
    read_only,
    Value,
)
from kbnitp_ros.core.field.grid import Grid
import numpy as np
from numpy.typing import NDArray

# Number of values of an unknown number, evenly spaced in asin(sqrt(p)). On that scale an estimate
# of a rate from n trials has the standard deviation 0.5 / sqrt(n) at any rate; the spacing of 64
# values is less than two standard deviations for up to 1,600 trials.
VALUES = 64
# Number of points in a value's bin at which the prior density is summed.
POINTS = 32
# Probability in each tail that is left out where quantiles of a narrow prior are computed.
TAIL = 1e-12
# Minimum width of an interval that is refined.
SMALLEST = 1e-9

EXPONENT = 'above 0 and finite'


@dataclass(frozen=True)
class Beta:
    """
    A Beta distribution on an interval: the prior of an unknown number.

    Parameters
    ----------
    a, b : float
        Positive exponents of the density, proportional to p^(a-1) (1-p)^(b-1). If `low` is above
        0, `a` may be 0: with `b` = 1 the density is then log-uniform.
    low, high : float
        Interval of the number, in [0, 1].
    zero : float
        Probability, below 1, that the number is 0 whatever the interval; only of reach, duds
        and rates of change.

    Raises
    ------
    ValueError
        If the interval is empty, reversed or not within [0, 1], or `a`, `b` or `zero` is out of
        range.

    """

    a: float = 1.0
    b: float = 1.0
    low: float = 0.0
    high: float = 1.0
    zero: float = 0.0

    def __post_init__(self) -> None:
        low, high = probability('low', self.low), probability('high', self.high)
        a = number('a of a Beta', self.a, EXPONENT, lambda a: 0.0 < a < np.inf or a == 0.0 < low)
        b = number('b of a Beta', self.b, EXPONENT, lambda b: 0.0 < b < np.inf)
        zero = number('zero of a Beta', self.zero, 'in [0, 1)', lambda p: 0.0 <= p < 1.0)
        vars(self).update(a=a, b=b, low=low, high=high, zero=zero)
        if low >= high:
            raise ValueError(
                f'interval is from {self.low} to {self.high}: it must end above its start'
            )

    def bins(self) -> Bins:
        """Return bins of the interval and their prior probabilities (:eq:`value-bins`)."""
        bounds, middle, mass = self._masses(self.low, self.high)
        mass = mass.clip(min=np.finfo(np.float64).tiny).reshape(VALUES, POINTS)
        weight = mass.sum(axis=1)
        values = (mass * middle.reshape(VALUES, POINTS)).sum(axis=1) / weight
        return Bins(bounds[::POINTS], values, np.log(weight / weight.sum()))

    def quantiles(self, q: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return quantiles, interpolated on a grid that is refined to where the mass is."""
        low, high = self.low, self.high
        while True:
            bounds, _, mass = self._masses(low, high)
            below = np.concatenate([[0.0], mass.cumsum()]) / mass.sum()
            first = int(np.searchsorted(below, TAIL, 'right')) - 1
            last = int(np.searchsorted(below, 1.0 - TAIL))
            if 2 * (last - first) >= mass.size or high - low < SMALLEST:
                return np.interp(q, below, bounds)
            low, high = bounds[first], bounds[last]

    def _masses(self, low: float, high: float) -> tuple[NDArray[np.float64], ...]:
        """Return the edges of fine bins, their middles and masses, up to a common factor."""
        start, end = np.arcsin(np.sqrt([low, high])).tolist()
        edges = np.linspace(start, end, VALUES * POINTS + 1)
        middle = np.sin((edges[1:] + edges[:-1]) / 2.0) ** 2
        bounds = (np.sin(edges) ** 2).clip(self.low, self.high)
        log_density = (self.a - 1.0) * np.log(middle) + (self.b - 1.0) * np.log1p(-middle)
        return bounds, middle, np.diff(bounds) * np.exp(log_density - log_density.max())


@dataclass(frozen=True, eq=False, repr=False)
class Bins(Value):
    """The possible values of a number."""

    # Edges of the interval that each value stands for, shape (values + 1,).
    edges: NDArray[np.float64]
    # The values, ascending, shape (values,).
    values: NDArray[np.float64]
    # Log prior probability of each value, shape (values,).
    log_prior: NDArray[np.float64]

    def __post_init__(self) -> None:
        vars(self).update({name: read_only(values) for name, values in vars(self).items()})

    @classmethod
    def known(cls, value: float) -> Bins:
        """Return the single bin of a known number."""
        return cls(np.array([value, value]), np.array([value]), np.zeros(1))


@dataclass(frozen=True, eq=False, repr=False)
class Learnt(Value):
    """
    The posterior of a learnt number.

    Attributes
    ----------
    bins : Bins
        Possible values.
    weights : ndarray, shape (values,)
        Posterior probability of each value.
    effective_samples : float
        Number of independent posterior draws that would estimate the mean as precisely.

    """

    bins: Bins
    weights: NDArray[np.float64]
    effective_samples: float = np.inf

    def __repr__(self) -> str:
        return f'Learnt(mean={self.mean:.4g}, sd={self.sd:.2g})'

    @classmethod
    def by_groups(cls, bins: Bins, weights: NDArray[np.float64]) -> Learnt:
        """Return the posterior from the weights of each group of samples, (groups, values)."""
        learnt = cls(bins, weights.mean(axis=0))
        of_mean = (weights * bins.values).sum(axis=1).var(ddof=1) / len(weights)
        return replace(learnt, effective_samples=learnt.sd**2 / of_mean if of_mean else np.inf)

    @property
    def zero(self) -> float:
        """Return the probability that the number is 0."""
        return float(self.weights[self.bins.values == 0.0].sum())

    @property
    def mean(self) -> float:
        """Return the mean."""
        return float((self.weights * self.bins.values).sum())

    @property
    def sd(self) -> float:
        """Return the standard deviation."""
        return float(np.sqrt((self.weights * (self.bins.values - self.mean) ** 2).sum()))

    def quantile(self, q: float) -> float:
        """Return the quantile `q`."""
        below = np.concatenate([[0.0], np.cumsum(self.weights)])
        return float(np.interp(probability('q', q) * below[-1], below, self.bins.edges))


# Prior probability of 0 of numbers that are rarely not 0.
ZERO = {'reach': 0.95, 'duds': 0.75}

Interval: TypeAlias = 'Beta | Sequence[float]'


@dataclass(frozen=True)
class Unknowns:
    """
    The unknown numbers, each with its prior.

    ``(low, high)`` is a uniform prior on an interval, a `Beta` any other prior. None: the number
    is known, from the sensor model or the prior maps.

    Parameters
    ----------
    lethality, malfunction, true_positive, false_positive : (float, float) or Beta, optional
        Numbers of the sensor model. The false negative is always known, since no evidence
        separates it from the lethality.
    hazard_density : (float, float) or Beta, optional
        Mean prior hazard of the cells where the prior is neither 0 nor 1; all their log odds are
        shifted by one offset to give the prior map this mean.
    kappa : (float, float) or Beta, optional
        P(X = 1 | Z = 1), likewise.
    target_background : (float, float) or Beta, optional
        P(X = 1 | Z = 0), likewise.
    reach : (float, float) or Beta, optional
        Reach of the hazards. Of an interval only a twentieth is believed: the reach is 0 with the
        prior probability .95. A `Beta` has its own `zero`.

    duds : (float, float) or Beta, optional
        Share of the hazards that never strike. Of an interval only a quarter is believed: there
        are no duds with the prior probability .75. Learn kappa and the target background as well.

    Raises
    ------
    ValueError
        If an interval is empty, reversed or not within [0, 1], or a number other than the reach
        and the duds may be 0.

    """

    lethality: Interval | None = None
    malfunction: Interval | None = None
    hazard_density: Interval | None = None
    kappa: Interval | None = None
    target_background: Interval | None = None
    true_positive: Interval | None = None
    false_positive: Interval | None = None
    reach: Interval | None = None
    duds: Interval | None = None

    def __post_init__(self) -> None:
        for name, given in [*vars(self).items()]:
            if isinstance(given, Beta) and given.zero and name not in ZERO:
                raise ValueError(
                    f'{name} has a prior with zero = {given.zero}: only {", ".join(ZERO)} may be 0'
                )
            if given is None or isinstance(given, Beta):
                continue
            try:
                if np.ndim(given) != 1 or len(given) != 2:
                    raise ValueError('it must be two numbers, low and high')
                zero = ZERO.get(name, 0.0)
                vars(self)[name] = Beta(low=given[0], high=given[1], zero=zero)
            except (TypeError, ValueError) as error:
                words = f'{name} is unknown within {in_short(given)}: {error}'
                raise ValueError(words) from error

    @property
    def priors(self) -> dict[str, Beta]:
        """Return the priors of the unknown numbers, by name."""
        return {name: prior for name, prior in vars(self).items() if prior is not None}


ALL_KNOWN = Unknowns()


HAZARDS = ('static', 'changing', 'used_up', 'moving', 'learn')

Rate: TypeAlias = 'float | Sequence[float] | Beta'
Rates: TypeAlias = 'float | NDArray[np.float64]'

# The rates of each kind of hazards.
HAZARD_RATES = {'changing': ('appear', 'vanish'), 'moving': ('move',)}

# The prior of a completely unknown rate: log-uniform.
ANY_RATE = Beta(0.0, 1.0, 0.001, 0.1)

# Kinds of targets, those that a belief may assume, and the name of their learnt rate.
TARGET_KINDS = ('static', 'changing', 'moving', 'learn')
TARGETS = ('static', 'changing', 'learn')
TARGET_VANISH = 'target_vanish'
# Prior probability of still targets where their kind is learnt. Still targets are common, and the
# evidence of changing ones is strong: .9 costs nothing there, and nothing where targets are still.
STILL = 0.9


@dataclass(frozen=True)
class Dynamics:
    """
    Dynamics of hazards from one deployment to the next.

    Parameters
    ----------
    kind : str
        ``'static'``: hazards stay, even if they strike. ``'changing'``: before every deployment
        but the first, each cell changes by itself. ``'used_up'``: a hazard that strikes is gone,
        whether or not the robot survives. ``'moving'``: before every deployment but the first,
        each hazard may move to a neighbouring cell that has no hazard and may have one.
        ``'learn'``: the kind is inferred from the evidence. Targets are static, changing or of a
        kind to learn, and in worlds also moving; what is said of hazards is said of them.
    appear : float
        Chance in [0, 1] that a hazard-free cell of a changing field has a hazard at the next
        deployment. If it is 0 and `vanish` is unknown, hazards appear at the rate that keeps their
        expected number as in the prior.
    vanish : float, (float, float) or Beta
        Chance in [0, 1] that a hazard of a changing field is gone by the next deployment; if
        unknown, a prior, or the two ends of a log-uniform prior.
    move : float, (float, float) or Beta
        Chance in [0, 1] that a moving hazard leaves its cell if it can; if unknown, as `vanish`.

    'changing' or 'moving' hazards with rates of 0 are static. With 'learn', a `vanish` or `move`
    of 0 stands for an unknown rate, log-uniform from .001 to .1.

    Raises
    ------
    ValueError
        If the kind is unknown, a rate is NaN or outside [0, 1], or the kind does not have a given
        rate.

    """

    kind: str = 'static'
    appear: float = 0.0
    vanish: Rate = 0.0
    move: Rate = 0.0

    def __post_init__(self) -> None:
        check_word('dynamics', self.kind, HAZARDS)
        for kind, names in HAZARD_RATES.items():
            for name in names:
                rate = as_rate(name, getattr(self, name))
                if self.kind == 'learn' and name != 'appear' and not rate:
                    rate = ANY_RATE
                if rate and self.kind not in (kind, 'learn'):
                    raise ValueError(
                        f'{name} is {rate} and hazards are {self.kind}: only {kind} hazards use it'
                    )
                vars(self)[name] = rate

    @property
    def effect(self) -> str:
        """Return the kind; 'static' if all rates of its changes are 0."""
        always = self.kind in ('used_up', 'learn')
        return self.kind if always or self.appear or self.vanish or self.move else 'static'

    @property
    def unknown_rates(self) -> dict[str, Beta]:
        """Return the priors of the unknown rates, by name."""
        rates = {name: getattr(self, name) for name in ('vanish', 'move')}
        return {name: rate for name, rate in rates.items() if isinstance(rate, Beta)}

    @property
    def kinds(self) -> tuple[Dynamics, ...]:
        """Return the dynamics of each possible kind of hazards."""
        if self.kind != 'learn':
            return (self,)
        changing = Dynamics('changing', self.appear, self.vanish)
        return STATIC, Dynamics('used_up'), changing, Dynamics('moving', move=self.move)

    @property
    def target_rates(self) -> dict[str, Beta]:
        """Return the prior of the rate at which targets vanish, by its name, if it is unknown."""
        if not isinstance(self.vanish, Beta):
            return {}
        still = STILL if self.kind == 'learn' else self.vanish.zero
        return {TARGET_VANISH: replace(self.vanish, zero=still)}

    def check_targets(self) -> None:
        """Check that a belief may assume these dynamics of targets."""
        if self.kind not in TARGETS:
            raise ValueError(
                f'target_dynamics is {self.kind}: a belief takes targets that are '
                f'{", ".join(TARGETS)}; targets that move are learnt as changing ones'
            )
        if self.kind == 'learn' and (self.appear or not isinstance(self.vanish, Beta)):
            raise ValueError(
                'target_dynamics is learn with a known rate: leave appear and vanish at 0, or '
                'give vanish a prior'
            )

    def known_rates(self, name: str = 'dynamics') -> dict[str, float]:
        """Return the rates by name; raise ValueError if one is unknown."""
        if self.kind == 'learn':
            raise ValueError(
                f"{name} is 'learn', but a world is of a known kind: use one of "
                + ', '.join(HAZARDS[:-1])
            )
        for name, prior in self.unknown_rates.items():
            raise ValueError(
                f'{name} is unknown, from {prior.low} to {prior.high}: a world needs a number'
            )
        return {name: getattr(self, name) for name in ('appear', 'vanish', 'move')}


def as_rate(name: str, given: Rate) -> float | Beta:
    """Return a rate, or its prior if it is unknown."""
    if isinstance(given, Beta):
        return given
    rate: Any = given
    # Of objects: lists of different lengths are no numbers either.
    shape = np.shape(np.array(rate, dtype=object))
    if not shape and not isinstance(rate, str):
        return probability(name, rate)
    if name == 'appear' or shape != (2,):
        raise ValueError(
            f'{name} is {in_short(given)}: it must be a number'
            + (' or low and high' if name != 'appear' else '; at 0 it follows an unknown vanish')
        )
    low, high = (probability(name, each) for each in rate)
    if not 0.0 < low < high:
        raise ValueError(f'{name} is unknown within {given}: it must satisfy 0 < low < high')
    return Beta(0.0, 1.0, low, high)


def appearance(vanish: Any, density: Any) -> Any:
    """Return the rate of appearing that keeps the share of hazards (:eq:`tied-appearance`)."""
    return np.minimum(vanish * density / (1.0 - density), 1.0)


def targets_after(
    joint: NDArray[np.float64], ticks: NDArray[np.intp], appear: Rates, vanish: Rates
) -> NDArray[np.float64]:
    """Return the joints after targets of each cell changed so often (:eq:`target-change`)."""
    there = np.asarray(appear + vanish)
    share = np.divide(appear, there, out=np.zeros_like(there), where=there > 0.0)
    numbers, place = np.unique(ticks, return_inverse=True)
    kept = ((1.0 - there) ** numbers[:, None])[place.ravel()][:, None]
    changed = (1.0 - kept) * (joint[:, :, 0] + joint[:, :, 1])
    after: NDArray[np.float64] = kept[:, None] * joint
    after[:, :, 0] += changed * (1.0 - share)
    after[:, :, 1] += changed * share
    return after


def joint_after_change(
    joint: NDArray[np.float64], possible: NDArray[np.bool_], appear: Rates, vanish: Rates
) -> NDArray[np.float64]:
    """Return the joints after hazards changed; targets stay (:eq:`hazard-change`)."""
    safe, hazardous = joint[possible, 0], joint[possible, 1]
    after = joint.copy()
    after[possible, 0] = safe * (1.0 - appear) + hazardous * vanish
    after[possible, 1] = safe * appear + hazardous * (1.0 - vanish)
    return after


def joint_after_moves(
    joint: NDArray[np.float64], neighbors: NDArray[np.intp], move: Rates
) -> NDArray[np.float64]:
    """Move hazards in joints (:eq:`hazard-leaves`, :eq:`hazard-arrives`, :eq:`hazard-moves`)."""
    hazard = joint[:, 1].sum(axis=1)

    def around(values: NDArray[np.float64], without: float) -> NDArray[np.float64]:
        """Return the values of each cell's neighbours, (cells, 8, ...)."""
        padded = np.concatenate([values, np.full_like(values[:1], without)])
        return padded[neighbors]

    free = around(1.0 - hazard, 0.0).sum(axis=1)
    can_leave = 1.0 - around(hazard, 1.0).prod(axis=1)
    to_each = move * can_leave * inverse(free)
    comes = around(to_each * hazard, 0.0)
    into = 1.0 - (1.0 - comes).prod(axis=1)
    share = into * inverse(comes.sum(axis=1))
    out = to_each * around((1.0 - hazard) * share, 0.0).sum(axis=1)
    into, out = into[:, None], out[:, None]
    safe, hazardous = joint[:, 0], joint[:, 1]
    after = [safe * (1.0 - into) + hazardous * out, hazardous * (1.0 - out) + safe * into]
    return np.stack(after, axis=1)


def inverse(values: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return 1 / x, 0 for 0."""
    return np.divide(1.0, values, out=np.zeros_like(values), where=values > 0.0)


def neighbors_to_move_to(grid: Grid, possible: NDArray[np.bool_]) -> NDArray[np.intp]:
    """Return each cell's neighbours that may have a hazard, (cells, 8); `grid.cells` for none."""
    table = np.delete(grid.neighbor_table, 4, axis=1)
    is_open = (table >= 0) & possible[table] & possible[:, None]
    return np.where(is_open, table, grid.cells)


STATIC = Dynamics()
