# SPDX-License-Identifier: Apache-2.0
"""Beliefs about cells, and measures of beliefs and probabilities."""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import cached_property
from typing import Any

from kbnitp_ros.core.field.check import (
    as_array,
    as_floats,
    in_short,
    probability,
    probability_map,
    read_only,
    typed,
    Value,
    yes_or_no,
)
from kbnitp_ros.core.field.grid import Grid
import numpy as np
from numpy.typing import ArrayLike, NDArray

# Tolerance for rounding of a cell's probabilities and of their sum.
TOLERANCE = 1e-12

# Maximum number of cells named in an error.
MAX_NAMED = 8


def tolerance(given: np.dtype[Any]) -> float:
    """Return the tolerance of a sum of probabilities that were given as numbers of a type."""
    is_coarse = given.kind == 'f' and given.itemsize < 8
    return float(4 * np.finfo(given).eps) if is_coarse else TOLERANCE


@dataclass(frozen=True, eq=False, repr=False)
class Belief(Value):
    """
    Independent cells, each with a joint distribution of its hazard Z and its target X.

    The joint is the state; the hazard, target and kappa maps are views of it
    (arXiv:2305.06929, Algorithm 1, line 2).

    Parameters
    ----------
    joint : array_like, shape (cells, 2, 2)
        P(Z = z, X = x), indexed [cell, z, x].
    grid : Grid, optional
        Grid of the cells, if known; moving hazards need it.
    duds : ndarray, shape (cells, 2), optional
        P(X = x, the hazard is a dud), a part of the joint of Z = 1, if some may be duds.

    Raises
    ------
    ValueError
        If the shape is wrong or a cell's four values are not a distribution.

    """

    joint: NDArray[np.float64]
    grid: Grid | None = field(default=None, compare=False)
    duds: NDArray[np.float64] | None = None

    def __post_init__(self) -> None:
        joint = as_floats('joint', self.joint)
        given = getattr(self.joint, 'dtype', joint.dtype)
        if joint.ndim != 3 or joint.shape[1:] != (2, 2) or not len(joint):
            raise ValueError(f'joint has shape {joint.shape}: it must be (cells, 2, 2)')
        total = joint[:, 0, 0] + joint[:, 0, 1] + joint[:, 1, 0] + joint[:, 1, 1]
        # Also false for NaN.
        if not (joint.min() >= 0.0 and np.abs(total - 1.0).max() <= tolerance(given)):
            off = ~((joint >= 0.0).all(axis=(1, 2)) & (np.abs(total - 1.0) <= tolerance(given)))
            cell = np.argmax(off)
            raise ValueError(
                f'joint of cell {cell} is {joint[cell].tolist()}: '
                'it must be four probabilities that sum to 1'
            )
        grid = self.grid
        if grid is not None and not (isinstance(grid, Grid) and grid.cells == len(joint)):
            raise ValueError(f'grid is {in_short(grid)}: it must be a Grid of {len(joint)} cells')
        if given != np.float64:
            joint /= total[:, None, None]
        object.__setattr__(self, 'joint', read_only(joint))

    def __repr__(self) -> str:
        return f'Belief({self.cells} cells, {self.entropy():.4g} nats)'

    @classmethod
    def computed(
        cls,
        joint: NDArray[np.float64],
        grid: Grid | None,
        duds: NDArray[np.float64] | None = None,
    ) -> Belief:
        """Return the belief of computed joints, which need no check and are not changed."""
        belief = object.__new__(cls)
        duds = None if duds is None else read_only(duds)
        vars(belief).update(joint=read_only(joint), grid=grid, duds=duds)
        return belief

    def live(self, duds: float = 0.0) -> Belief:
        """Return the belief on hazards that can strike; `duds` is their share in a prior."""
        if self.duds is None and not duds:
            return self
        never = self.joint[:, 1] * duds if self.duds is None else self.duds
        joint = self.joint.copy()
        joint[:, 0] += never
        joint[:, 1] = (joint[:, 1] - never).clip(min=0.0)
        return Belief.computed(joint, self.grid)

    def with_duds(self, share: NDArray[np.float64]) -> Belief:
        """Return the belief on all hazards, given P(dud | no live hazard, X), shape (cells, 2)."""
        duds, joint = self.joint[:, 0] * share, self.joint.copy()
        joint[:, 0] -= duds
        joint[:, 1] += duds
        return Belief.computed(joint, self.grid, duds)

    @classmethod
    def from_maps(cls, hazard: ArrayLike, target: ArrayLike, kappa: ArrayLike) -> Belief:
        """
        Return the belief with these maps.

        Equation :eq:`joint`.

        Parameters
        ----------
        hazard : array_like, shape (cells,)
            P(Z = 1).
        target : array_like, shape (cells,)
            P(X = 1).
        kappa : array_like, shape (cells,)
            P(X = 1 | Z = 1).

        Raises
        ------
        ValueError
            If the maps' lengths differ, a value is no probability, or a cell has no joint
            distribution: kappa * hazard <= target <= kappa * hazard + 1 - hazard must hold.

        """
        z = probability_map('hazard', hazard)
        x = probability_map('target', target, z.size)
        k = probability_map('kappa', kappa, z.size)
        both = k * z
        target_only = x - both
        neither = (1.0 - z) - target_only
        least = -max(tolerance(np.asarray(each).dtype) for each in (hazard, target, kappa))
        bad = np.flatnonzero((target_only < least) | (neither < least))
        if bad.size:
            i, *others = bad[:MAX_NAMED].tolist()
            likewise = f'; likewise at cells {", ".join(map(str, others))}' if others else ''
            more = f' and {bad.size - MAX_NAMED} more' if bad.size > MAX_NAMED else ''
            raise ValueError(
                f'maps have no joint distribution at cell {i}: with hazard {z[i]} and kappa '
                f'{k[i]} its target must lie in [{both[i]:.6g}, {both[i] + 1.0 - z[i]:.6g}], '
                f'and is {x[i]}{likewise}{more}'
            )
        joint = np.stack([neither, target_only, (1.0 - k) * z, both], axis=-1).clip(min=0.0)
        if least < -TOLERANCE:
            joint /= joint.sum(axis=1, keepdims=True)
        return cls(joint.reshape(-1, 2, 2))

    @classmethod
    @typed
    def prior(cls, grid: Grid, hazard: ArrayLike, target: ArrayLike, kappa: ArrayLike) -> Belief:
        """
        Return a mission's belief before its first deployment.

        As `from_maps`, where a number stands for a uniform map. The bases of the grid have no
        hazard, and a target with the probability P(X = 1 | Z = 0) of the maps; blocked cells have
        neither hazards nor targets.

        Raises
        ------
        ValueError
            As `from_maps`; also if the given hazard of a base is 1.

        """
        maps: dict[str, Any] = {'hazard': hazard, 'target': target, 'kappa': kappa}
        for name, values in maps.items():
            if as_array(name, values).ndim == 0:
                maps[name] = np.full(grid.cells, probability(name, values))
        probability_map('hazard', maps['hazard'], grid.cells)
        return cls.from_maps(**maps).on(grid)

    def check(self, grid: Grid) -> None:
        """Check that this belief is of a grid."""
        if self.cells != grid.cells:
            raise ValueError(f'belief has {self.cells} cells: the grid has {grid.cells}')
        own = self.grid or grid
        if (own.width, own.height) != (grid.width, grid.height):
            raise ValueError(
                f'belief is of a grid of {own.width} x {own.height} cells: the grid has '
                f'{grid.width} x {grid.height}; make it with Belief.prior(grid, ...)'
            )

    @typed
    def on(self, grid: Grid) -> Belief:
        """Return the belief on a grid, with bases and blocked cells as in `prior`."""
        self.check(grid)
        joint = self.joint.copy()
        for base in sorted(grid.bases):
            joint[base, 1] = 0.0
            safe = joint[base].sum()
            if safe == 0.0:
                raise ValueError(
                    f'hazard of cell {base} is 1: that is a base, which is free of hazard'
                )
            joint[base] /= safe
        joint[~grid.free] = [[1.0, 0.0], [0.0, 0.0]]
        return Belief(joint, grid)

    def neighbors_in_reach(self) -> NDArray[np.intp]:
        """Return `Grid.around`; raise ValueError without a grid."""
        if self.grid is None:
            raise ValueError(
                'reach is not 0, and the belief has no grid to reach on: make it with '
                'Belief.prior(grid, ...) or belief.on(grid)'
            )
        return self.grid.around

    def with_reach(self, reach: float) -> Belief:
        """Return the belief with the hazards that act in each cell (:eq:`effective-hazard`)."""
        near = self.neighbors_in_reach()
        spared = np.append(1.0 - reach * self.hazard, 1.0)[near].prod(axis=1)[:, None]
        joint = self.joint.copy()
        joint[:, 1] += joint[:, 0] * (1.0 - spared)
        joint[:, 0] *= spared
        return Belief.computed(joint, self.grid)

    @property
    def cells(self) -> int:
        """Return the number of cells."""
        return len(self.joint)

    @cached_property
    def hazard(self) -> NDArray[np.float64]:
        """Return P(Z = 1), shape (cells,)."""
        return read_only(np.minimum(self.joint[:, 1, 0] + self.joint[:, 1, 1], 1.0))

    @cached_property
    def target(self) -> NDArray[np.float64]:
        """Return P(X = 1), shape (cells,)."""
        return read_only(np.minimum(self.joint[:, 0, 1] + self.joint[:, 1, 1], 1.0))

    @cached_property
    def kappa(self) -> NDArray[np.float64]:
        """Return P(X = 1 | Z = 1), shape (cells,); P(X = 1) where Z = 1 is impossible."""
        kappa = self.target.copy()
        np.divide(self.joint[:, 1, 1], self.hazard, out=kappa, where=self.hazard > 0.0)
        return read_only(kappa.clip(max=1.0))

    def entropy(self) -> float:
        """Return H(Z) + H(X) summed over the cells, in nats (:eq:`belief-entropy`)."""
        return float(binary_entropy(self.hazard).sum() + binary_entropy(self.target).sum())

    def joint_entropy(self) -> float:
        """Return H(Z, X) summed over the cells, in nats (:eq:`belief-entropy`)."""
        return float(surprisal(self.joint).sum())

    def independent(self) -> Belief:
        """Return the belief with the same hazard and target maps and kappa := target."""
        z = np.stack([1.0 - self.hazard, self.hazard], axis=-1)
        x = np.stack([1.0 - self.target, self.target], axis=-1)
        product = z[:, :, None] * x[:, None, :]
        # Leave an independent belief as it is: rounding would change it at every call.
        return (
            self if np.abs(self.joint - product).max() <= TOLERANCE else Belief(product, self.grid)
        )


def surprisal(probability: ArrayLike) -> NDArray[np.float64]:
    """Return -p log p, with 0 log 0 = 0; any shape, in nats (:eq:`shannon-entropy`)."""
    p = np.asarray(probability, dtype=np.float64)
    surprisals: NDArray[np.float64] = -p * np.log(np.where(p > 0.0, p, 1.0))
    return surprisals


def binary_entropy(probability: ArrayLike) -> NDArray[np.float64]:
    """Return h(p), the entropy of a coin, in nats, any shape (:eq:`shannon-entropy`)."""
    p = np.asarray(probability, dtype=np.float64)
    return surprisal(p) + surprisal(1.0 - p)


# Minimum probability of the truth in a log loss, which limits the loss of a cell to 36 nats.
SMALLEST = np.finfo(np.float64).eps


def log_loss(probability: NDArray[np.float64], truth: ArrayLike) -> float:
    """
    Return the log loss of a map, summed over the cells.

    Equation :eq:`log-loss`.

    Parameters
    ----------
    probability : ndarray, shape (cells,)
        Believed P(present), e.g. `Belief.hazard`.
    truth : array_like of bool, shape (cells,)
        True presence.

    Returns
    -------
    float
        -sum log P(truth) in nats, at least 0; the loss of each cell is at most 36.

    Raises
    ------
    ValueError
        If the truth has another shape.

    """
    return float(log_losses(probability, as_truth(probability, truth)))


def log_losses(probability: NDArray[np.float64], truth: NDArray[np.bool_]) -> NDArray[np.float64]:
    """Return the log losses of several maps, shapes (..., cells)."""
    given = np.where(truth, probability, 1.0 - probability)
    losses: NDArray[np.float64] = (-np.log(given.clip(min=SMALLEST))).sum(axis=-1)
    return losses


def brier_score(probability: NDArray[np.float64], truth: ArrayLike) -> float:
    """
    Return the squared error of a map, summed over the cells: its Brier score.

    Equation :eq:`brier-score`.

    Parameters
    ----------
    probability : ndarray, shape (cells,)
        Believed P(present), e.g. `Belief.target`.
    truth : array_like of bool, shape (cells,)
        True presence.

    Raises
    ------
    ValueError
        If the truth has another shape.

    """
    return float(((probability - as_truth(probability, truth)) ** 2).sum())


def as_truth(probability: NDArray[np.float64], truth: ArrayLike) -> NDArray[np.bool_]:
    """Return `truth` as booleans, checked against a map."""
    if not isinstance(probability, np.ndarray):
        raise TypeError(
            f'probability is {in_short(probability)}: it must be a map, such as Belief.hazard'
        )
    probability_map('probability', probability)
    present = yes_or_no('truth', truth)
    if present.shape != probability.shape:
        raise ValueError(f'truth has shape {present.shape}: the map has {probability.shape}')
    return present
