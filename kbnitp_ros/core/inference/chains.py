# SPDX-License-Identifier: Apache-2.0
"""Gibbs chains that draw hazards and unknown numbers, and their averages."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

from kbnitp_ros.core.field.check import Floats, Places
from kbnitp_ros.core.field.sensor import ORDINARY, SensorModel
from kbnitp_ros.core.field.unknowns import Learnt
from kbnitp_ros.core.inference import sampling_kernels as gibbs
from kbnitp_ros.core.inference.filter import ratio
from kbnitp_ros.core.inference.hypotheses import CERTAIN, Hypotheses, Tally
from kbnitp_ros.core.inference.prior_maps import expit
import numpy as np
from numpy.typing import NDArray

CHAINS = 256
# Number of groups of chains; the spread of their averages gives the sampling error.
GROUPS = 16

# Number of swaps proposed in a sweep.
SWAPS = 4

# Limits of log odds of hazards, and of those from readings, within the range of floating point.
CERTAIN_HAZARD = 300.0
CERTAIN_READING = 600.0


def even(numbers: int, rng: np.random.Generator) -> Floats:
    """Return `numbers` uniform numbers for each chain, stratified over the chains."""
    order = rng.permuted(np.tile(np.arange(CHAINS), (numbers, 1)), axis=1).T
    uniform: Floats = (order + rng.random(order.shape)) / CHAINS
    return uniform


def softplus(log_odds: Floats) -> Floats:
    """Return log(1 + exp(x)) without overflow."""
    result: Floats = np.maximum(log_odds, 0.0) + np.log1p(np.exp(-np.abs(log_odds)))
    return result


def finite_log(chance: Floats) -> Floats:
    """Return the logarithm, at least -`CERTAIN`."""
    with np.errstate(divide='ignore'):
        return np.log(chance).clip(min=-CERTAIN)


def over_types(log: Floats, counts: Floats) -> Floats:
    """Return logs, (n, types), times counts, (types, m), summed over the robot types."""
    # Without BLAS, whose sums depend on the number of threads.
    total: Floats = np.einsum('nt,tm->nm', log, counts)
    return total


@dataclass(frozen=True, eq=False)
class ChainState:
    """State of the chains; arrays are never changed."""

    # Index of each unknown number's value, by name, shape (chains,).
    place: Mapping[str, Places]
    # Mask of the cells in the chains, shape (cells,), and their hazards in each chain, shape
    # (chains, cells).
    is_held: NDArray[np.bool_]
    hazardous: NDArray[np.int8]

    @classmethod
    def start(cls, hypotheses: Hypotheses, rng: np.random.Generator) -> ChainState:
        """Return chains without cells, their numbers drawn from the priors."""
        place = {
            name: np.searchsorted(
                np.exp(bins.log_prior).cumsum()[:-1], even(1, rng)[:, 0], 'right'
            )
            for name, bins in hypotheses.bins.items()
        }
        cells = hypotheses.prior.cells
        return cls(place, np.zeros(cells, bool), np.zeros((CHAINS, cells), np.int8))

    def with_cells(
        self, is_held: NDArray[np.bool_], hypotheses: Hypotheses, rng: np.random.Generator
    ) -> ChainState:
        """Return the state with these cells too, drawing new cells from the prior."""
        new, hazardous = np.flatnonzero(is_held & ~self.is_held), self.hazardous.copy()
        log_odds = hypotheses.log_odds['hazard_density'][:, new]
        chance = expit(log_odds[hypotheses.index('hazard_density', self.place)])
        hazardous[:, new] = even(new.size, rng) < chance
        return ChainState(self.place, is_held | self.is_held, hazardous)


class Chains:
    """Gibbs sweeps of the chains, given all evidence (:eq:`sampled-posterior`)."""

    def __init__(
        self,
        hypotheses: Hypotheses,
        evidence: Tally,
        state: ChainState,
        rng: np.random.Generator,
    ) -> None:
        self._hypotheses, self._rng, self._is_held = hypotheses, rng, state.is_held
        # Cells outside the chains have the joints of the prior with each chain's numbers, which
        # matter if the prior has unknown numbers. Of cells with equal priors one is computed.
        held = np.flatnonzero(state.is_held)
        outside = np.flatnonzero(~state.is_held & (not hypotheses.prior_is_known))
        _, first, alike = np.unique(
            hypotheses.alike[outside], return_index=True, return_inverse=True
        )
        self._shown = shown = np.sort(np.concatenate([held, outside[first]]))
        # The cells that a belief has joints of, and the place of each in `shown`.
        self._cells = np.concatenate([held, outside])
        self._of_cell = shown.searchsorted(np.concatenate([held, outside[first][alike]]))
        self._place = {name: each.copy() for name, each in state.place.items()}
        self._hazardous = state.hazardous[:, shown]
        self._undecided = {name: each[shown] for name, each in hypotheses.undecided.items()}
        self._is_drawn = self._undecided['hazard_density'] & state.is_held[shown]
        self._drawn = np.flatnonzero(self._is_drawn)
        # Buffers, since new arrays of all chains take longer than what is computed.
        self._uniform = np.empty((CHAINS, self._drawn.size))
        self._work = np.empty((3, CHAINS, shown.size))
        self._survived, self._positive, self._negative = evidence.counts[:, :, shown] * 1.0
        found = evidence.found[shown]
        self._found_hazard = (found[:, 1, 0] - found[:, 0, 0]).clip(min=-CERTAIN)
        self._found_target = found[:, 0, 1] - found[:, 0, 0]
        counted = (self._positive + self._negative).any(axis=0)
        self._read = np.flatnonzero(counted | (self._found_target != 0.0))
        # The prior maps as log odds and as chances, by value, each (values, cells).
        self._log_odds = {name: each[:, shown] for name, each in hypotheses.log_odds.items()}
        self._absent = {name: expit(-each) for name, each in self._log_odds.items()}
        self._present = {name: expit(each) for name, each in self._log_odds.items()}
        self._log_absent = {
            name: np.where(self._undecided[name], -softplus(each), 0.0).T.copy()
            for name, each in self._log_odds.items()
            if name in hypotheses.bins
        }
        self._types = types = evidence.robot_types
        self._ordinary = types.index(ORDINARY)
        spares = 1.0 - np.array([each.model(hypotheses.model).false_negative for each in types])
        self._log_endured = finite_log(1.0 - hypotheses.by_type('malfunction', types))
        self._log_spared = finite_log(1.0 - hypotheses.by_type('lethality', types) * spares)
        # Logs of P(Y = y | X = x), by y and x, each (values, types).
        rates = [hypotheses.by_type(name, types) for name in ('false_positive', 'true_positive')]
        self._log_read = [[finite_log(1.0 - p) for p in rates], [finite_log(p) for p in rates]]
        most = 1 + max((loss.steps.size for loss in evidence.losses), default=0)
        endured, spared = (
            np.exp(np.arange(most) * log[:, :, None]).reshape(len(log), -1)
            for log in (self._log_endured, self._log_spared)
        )
        losses = evidence.blocks(shown, most)
        clustering, nowhere = hypotheses.clustering, np.zeros(CHAINS, np.intp)
        self._field = gibbs.ChainStates(
            losses,
            self._hazardous,
            np.zeros((CHAINS, losses.weight.size), np.int32),
            endured,
            spared,
            self._place.get('malfunction', nowhere),
            self._place.get('lethality', nowhere),
            np.empty((0, 4), np.intp) if clustering is None else clustering.neighbors,
            np.ones(CHAINS) if clustering is None else np.empty(CHAINS),
        )
        self._set_coupling()
        gibbs.count_exposures(self._field)
        self.discard()

    def discard(self) -> None:
        """Discard the averages of all sweeps so far."""
        self._joints = np.zeros((2, 2, GROUPS, self._shown.size))
        self._weights = {
            name: np.zeros((GROUPS, bins.values.size))
            for name, bins in self._hypotheses.bins.items()
        }
        # Sums, for the common type, of the chances to survive a step into a safe cell and into a
        # hazard.
        self._steps_survived = np.zeros(2)
        self.sweeps = 0

    def sweep(self, has_numbers: bool = True) -> None:
        """Draw hazards and unknown numbers once, and add up conditional probabilities."""
        given, targets = self._given_returns()
        hazard, safe, odds = self._work
        hazard[:] = odds[:] = given
        uniform = self._rng.random(out=self._uniform)
        gibbs.draw_hazards(self._field, self._drawn, odds, uniform, hazard)
        if self._field.losses.blocks.size:
            uniform = self._rng.random((CHAINS, SWAPS, 4))
            gibbs.swap_hazards(self._field, self._is_drawn, odds, uniform)
        np.divide(1.0, np.add(1.0, hazard, out=safe), out=safe)
        hazard *= safe
        for of_hazard, of_target, joints in zip((safe, hazard), targets, self._joints):
            for chance, joint in zip(of_target, joints):
                product = np.multiply(of_hazard, chance, out=odds)
                joint += product.reshape(GROUPS, CHAINS // GROUPS, -1).mean(axis=1)
        self.sweeps += 1
        if has_numbers:
            self._draw_survival()
            self._draw_prior()
            self._draw_camera(targets[0][1], targets[1][1])

    @property
    def state(self) -> ChainState:
        """Return the state of the chains."""
        hazardous = np.zeros((CHAINS, self._is_held.size), np.int8)
        hazardous[:, self._shown] = self._hazardous
        return ChainState(dict(self._place), self._is_held, hazardous)

    def hazards(self) -> NDArray[np.bool_]:
        """Return the hazards of all cells in each chain, shape (chains, cells)."""
        prior = self._hypotheses.log_odds['hazard_density']
        chance = expit(prior[self._hypotheses.index('hazard_density', self._place)])
        hazards: NDArray[np.bool_] = self._rng.random((CHAINS, chance.shape[1])) < chance
        return np.where(self._is_held, self.state.hazardous.astype(bool), hazards)

    def models(self) -> list[SensorModel]:
        """Return the sensor model of the common robot type in each chain."""
        bins = self._hypotheses.bins
        numbers = np.array([bins[name].values[self._place[name]] for name in bins])
        rows = numbers.reshape(len(bins), CHAINS).T.tolist()
        return [self._hypotheses.model_with(dict(zip(bins, each))) for each in rows]

    def joint(self) -> tuple[Floats, float]:
        """Return joints and their sampling error (:eq:`averaged-belief`, :eq:`sampling-error`)."""
        joint = self._hypotheses.prior.joint.copy()
        by_group = np.moveaxis(self._joints / self.sweeps, 3, 0)
        mean, variance = by_group.mean(axis=3), by_group.var(axis=3, ddof=1) / GROUPS
        joint[self._cells] = mean[self._of_cell]
        error = ratio(variance, mean).sum(axis=(1, 2))[self._of_cell].sum() / 2.0
        return joint, float(error)

    def learnt(self) -> dict[str, Learnt]:
        """Return the posterior of each unknown number, by name."""
        return {
            name: Learnt.by_groups(self._hypotheses.bins[name], weights / self.sweeps)
            for name, weights in self._weights.items()
        }

    def model(self) -> SensorModel:
        """Return the expected sensor model of the common robot type (:eq:`mean-model`)."""
        means = {name: learnt.mean for name, learnt in self.learnt().items()}
        if 'lethality' in means:
            # Average the chance to survive a hazard: malfunction and lethality are correlated.
            endured, spared = self._steps_survived
            strike = 1.0 - self._hypotheses.model.false_negative
            means['lethality'] = min(max((1.0 - spared / endured) / strike, 0.0), 1.0)
        return self._hypotheses.model_with(means)

    def _of_chains(self, name: str, of_values: Floats) -> Floats:
        """Select each chain's entry of the values of a number, (1 or chains, ...)."""
        return of_values[self._place[name]] if name in self._place else of_values

    def _given_returns(self) -> tuple[Floats, list[tuple[Floats, Floats]]]:
        """Return hazard odds, and P(X) for each Z (:eq:`hazard-odds`, :eq:`reading-odds`)."""
        read = self._found_target
        for (absent, present), counts in zip(self._log_read, (self._negative, self._positive)):
            if_absent = self._of_chains('false_positive', absent)
            if_present = self._of_chains('true_positive', present)
            read = read + over_types(if_present - if_absent, counts)
        ratio = np.exp(np.clip(read, -CERTAIN_READING, CERTAIN_READING))
        spared = self._of_chains('lethality', self._log_spared)
        log_odds = self._of_map('hazard_density', self._log_odds)
        log_odds = log_odds + over_types(spared, self._survived) + self._found_hazard
        targets = []
        for name, sign in (('target_background', -1.0), ('kappa', 1.0)):
            absent, present = self._of_map(name, self._absent), self._of_map(name, self._present)
            present = present * ratio
            total = absent + present
            present /= total
            targets.append((absent / total, present))
            log_odds = log_odds + np.multiply(sign, np.log(total, out=total), out=total)
        log_odds.clip(-CERTAIN_HAZARD, CERTAIN_HAZARD, out=log_odds)
        return np.exp(log_odds, out=log_odds), targets

    def _of_map(self, name: str, of_values: Mapping[str, Floats]) -> Floats:
        """Select each chain's row of a prior map, (1 or chains, cells)."""
        return of_values[name][self._hypotheses.index(name, self._place)]

    def _draw(self, name: str, log_likelihood: Floats) -> Floats:
        """Draw an unknown number in each chain, and add up the weights of its values."""
        log_weight = log_likelihood + self._hypotheses.bins[name].log_prior
        weight: Floats = np.exp(log_weight - log_weight.max(axis=1, keepdims=True))
        gibbs.draw_values(weight, self._rng.random(CHAINS), self._place[name])
        self._weights[name] += weight.reshape(GROUPS, -1, weight.shape[1]).mean(axis=1)
        return weight

    def _draw_survival(self) -> None:
        """Draw lethality and malfunction given hazards (:eq:`rate-conditional`)."""
        field, losses = self._field, self._field.losses
        exposed = losses.unexposed + field.exposures
        if 'lethality' in self._place:
            endured = field.endured[field.malfunction][:, losses.steps]
            likelihood = self._of_losses(endured, exposed, field.spared)
            strikes = self._hazardous.astype(float) @ self._survived.T
            likelihood += over_types(strikes, self._log_spared.T)
            weight = self._draw('lethality', likelihood)
            spared = (weight * np.exp(self._log_spared[:, self._ordinary])).sum(axis=1)
            log_endured = self._of_chains('malfunction', self._log_endured)
            alive = np.exp(log_endured[:, self._ordinary])
            self._steps_survived += alive.mean(), (alive * spared).mean()
        if 'malfunction' in self._place:
            spared = np.take_along_axis(field.spared[field.lethality], exposed.astype(np.intp), 1)
            steps = np.broadcast_to(losses.steps, exposed.shape)
            likelihood = self._of_losses(spared, steps, field.endured)
            survived = self._survived.sum(axis=1)
            self._draw('malfunction', likelihood + self._log_endured @ survived)

    def _of_losses(self, known: Floats, row: NDArray[np.int32], of_rate: Floats) -> Floats:
        """Return the log likelihood of all losses for each value of a rate, (chains, values)."""
        likelihood = np.ones((CHAINS, len(of_rate)))
        rows, rates = np.ascontiguousarray(row, np.int32), np.ascontiguousarray(of_rate.T)
        gibbs.weigh_by_losses(self._field.losses, known, rows, rates, likelihood)
        with np.errstate(divide='ignore'):
            return np.log(likelihood)

    def _draw_prior(self) -> None:
        """Draw density and coupling (:eq:`map-conditional`, :eq:`coupling-conditional`)."""
        hypotheses, place = self._hypotheses, self._place
        count = (self._hazardous & self._is_drawn).sum(axis=1)[:, None]
        if 'hazard_density' in place and hypotheses.clustering is None:
            absent = self._log_absent['hazard_density'][self._is_drawn].sum(axis=0)
            self._draw('hazard_density', absent + count * hypotheses.offset['hazard_density'])
        elif 'hazard_density' in place:
            of_chains = [
                self._of_chains('coupling', each) for each in (hypotheses.fields, hypotheses.log_z)
            ]
            self._draw('hazard_density', of_chains[0] * count - of_chains[1])
        if 'coupling' in place:
            pairs = np.empty(CHAINS, np.int64)
            gibbs.count_coupled(self._field, pairs)
            field, log_z = (
                self._of_chains('hazard_density', each.T)
                for each in (hypotheses.fields, hypotheses.log_z)
            )
            ties = pairs[:, None] * hypotheses.bins['coupling'].values
            self._draw('coupling', field * count + ties - log_z)
            self._set_coupling()

    def _set_coupling(self) -> None:
        """Set e^J of each chain."""
        if self._hypotheses.clustering is not None:
            values = self._hypotheses.clustering.bins.values
            self._field.coupling[:] = np.exp(self._of_chains('coupling', values))

    def _draw_camera(self, if_safe: Floats, if_hazardous: Floats) -> None:
        """Draw numbers of targets and readings (:eq:`count-conditional`)."""
        numbers = {'kappa', 'target_background', 'true_positive', 'false_positive'}
        if not numbers & self._place.keys():
            return
        # Draw only targets with readings or findings (:eq:`target-conditional`).
        read, place, bins = self._read, self._place, self._hypotheses.bins
        hazardous = self._hazardous[:, read].astype(bool)
        chance = np.where(hazardous, if_hazardous[:, read], if_safe[:, read])
        target = self._rng.random(chance.shape) < chance
        for name, concerned in (('kappa', hazardous), ('target_background', ~hazardous)):
            if name in place:
                cells = concerned & self._undecided[name][read]
                offset = self._hypotheses.offset[name]
                log_likelihood = (cells & target).sum(axis=1)[:, None] * offset
                gibbs.sum_of_cells(cells, self._log_absent[name][read], log_likelihood)
                self._draw(name, log_likelihood)
        for name, concerned in (('true_positive', target), ('false_positive', ~target)):
            if name in place:
                # Types that know their own camera tell nothing of the common one.
                learning = [getattr(each, name) is None for each in self._types]
                positive, negative = (
                    concerned.astype(float) @ counts[learning].sum(axis=0)[read]
                    for counts in (self._positive, self._negative)
                )
                values = bins[name].values
                log_likelihood = positive[:, None] * np.log(values)
                self._draw(name, log_likelihood + negative[:, None] * np.log1p(-values))
