# SPDX-License-Identifier: Apache-2.0
"""Gibbs chains that draw hazards and unknown numbers, and their averages."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

from kbnitp_ros.core.field.sensor import ORDINARY, SensorModel, times_log
from kbnitp_ros.core.field.unknowns import Bins, Learnt
from kbnitp_ros.core.inference import sampling_kernels as gibbs
from kbnitp_ros.core.inference.filters import safe_log
from kbnitp_ros.core.inference.hypotheses import (
    CERTAIN_HAZARD,
    CERTAIN_TARGET,
    Clusters,
    expit,
    Hypotheses,
    LIMITS,
    softplus,
)
from kbnitp_ros.core.inference.sampling_kernels import (
    draw_values,
    LARGE,
    sum_of_cells,
    weigh_by_located,
    weigh_by_losses,
)
from kbnitp_ros.core.inference.tally import Tally
import numpy as np
from numpy.typing import NDArray

CHAINS = 256
# Number of groups of chains; the spread of their averages gives the sampling error.
GROUPS = 16

Floats = NDArray[np.float64]
Places = NDArray[np.intp]

# Number of swaps proposed in a sweep.
SWAPS = 4
# Limit of the log odds from readings, below the log odds of certainty in a prior.
CERTAIN_READING = 1e5
# Numbers that the likelihood of readings depends on.
OF_READINGS = {'kappa', 'target_background', 'true_positive', 'false_positive'}


@dataclass(frozen=True, eq=False)
class ChainState:
    """State of the chains; arrays are never changed."""

    # Index of each number's value, by name, shape (chains,).
    place: Mapping[str, Places]
    # The cells in the chains, ascending, shape (held,).
    cells: Places
    # Hazards of `cells` in each chain, shape (chains, held).
    hazardous: NDArray[np.int8]

    @classmethod
    def start(cls, all_bins: Mapping[str, Bins], rng: np.random.Generator) -> ChainState:
        """Return chains without cells, their numbers drawn from the priors."""
        place = {
            name: np.searchsorted(
                np.cumsum(np.exp(bins.log_prior))[:-1], even(1, rng)[:, 0], 'right'
            )
            for name, bins in all_bins.items()
        }
        return cls(place, np.empty(0, np.intp), np.empty((CHAINS, 0), np.int8))

    def with_cells(
        self, cells: Places, hypotheses: Hypotheses, rng: np.random.Generator
    ) -> ChainState:
        """Return the state extended to `cells`, drawing new cells from the prior."""
        is_held = np.isin(cells, self.cells)
        offset = hypotheses.offset('hazard_density', self.place)
        probability = expit(hypotheses.maps['hazard_density'].at(offset, cells[~is_held]))
        hazardous = np.empty((CHAINS, cells.size), np.int8)
        hazardous[:, is_held] = self.hazardous
        hazardous[:, ~is_held] = even(np.count_nonzero(~is_held), rng) < probability
        return ChainState(self.place, cells, hazardous)


def even(numbers: int, rng: np.random.Generator) -> Floats:
    """Return `numbers` uniform numbers for each chain, stratified over the chains."""
    order = rng.permuted(np.tile(np.arange(CHAINS), (numbers, 1)), axis=1).T
    uniform: Floats = (order + rng.random(order.shape)) / CHAINS
    return uniform


class Chains:
    """Gibbs sweeps of the chains, given the evidence of a tally (:eq:`sampled-posterior`)."""

    def __init__(
        self,
        hypotheses: Hypotheses,
        tally: Tally,
        state: ChainState,
        rng: np.random.Generator,
    ) -> None:
        # Arrays below are indexed by place in `_cells` or `_elsewhere`, not by cell of the grid.
        self._cells = state.cells
        # Cells outside the chains have the joints of the prior with each chain's numbers.
        elsewhere = np.setdiff1d(np.arange(hypotheses.belief.cells), state.cells)
        self._elsewhere = elsewhere[:0] if hypotheses.prior_is_known else elsewhere
        self._elsewhere_odds = {
            name: each.within(self._elsewhere).odds(*LIMITS[name])
            for name, each in hypotheses.maps.items()
        }
        self._elsewhere_joints = np.zeros((GROUPS, self._elsewhere.size, 2, 2))
        self._hypotheses = hypotheses
        self._maps = maps = {
            name: each.within(state.cells) for name, each in hypotheses.maps.items()
        }
        possible, undecided = hypotheses.possible[state.cells], maps['hazard_density'].undecided
        self._tally = tally = tally.within(state.cells)
        self._read = np.flatnonzero(tally.read)
        self._rng = rng
        self._hazardous = state.hazardous.copy()
        self._place = {name: each.copy() for name, each in state.place.items()}
        self.sweeps = 0
        self._undecided = np.flatnonzero(undecided)
        # Only cells with a survived step need odds; the other cells have the odds of the prior.
        self._returned = np.flatnonzero(tally.survived.any(axis=0))
        self._prior_odds = {name: each.odds(*LIMITS[name]) for name, each in maps.items()}
        # Rates of each robot type, in the order of the tally.
        self._rates = [hypotheses.rates(robot_type) for robot_type in tally.robot_types]
        # Factors of the readings; None if they vary with an unknown number of OF_READINGS.
        self._of_readings = None if OF_READINGS & {*hypotheses.unknown} else self._given_readings()
        # Losses with the same robot type and number of steps share their factors.
        longest = tally.steps.max(initial=0)
        lengths, length = np.unique(
            tally.robot_type * (longest + 1) + tally.steps, return_inverse=True
        )
        type_of_length, steps = np.divmod(lengths, longest + 1)
        # Log chances of no malfunction and of no strike, each of shape (values, types).
        log_endured, log_spared = (
            np.stack(
                [
                    np.broadcast_to(getattr(rates, of), hypotheses.bins[name].values.size)
                    for rates in self._rates
                ],
                axis=1,
            )
            for name, of in (('malfunction', 'log_endured'), ('lethality', 'log_spared'))
        )
        neighbors: Places = np.empty((0, 4), np.intp)
        if hypotheses.clusters is not None:
            # The chains hold all cells.
            neighbors = hypotheses.clusters.neighbors
        self._factors = gibbs.Factors(
            odds=np.empty((0, 0)),
            length=length,
            robot_type=type_of_length,
            endured=np.exp(times_log(steps, np.take(log_endured, type_of_length, axis=1))),
            spared=np.exp(times_log(np.arange(longest + 1), log_spared[:, :, None])),
            step_endured=np.exp(log_endured),
            step_spared=np.exp(log_spared),
            graph=tally.loss_graph(possible, undecided),
            located=tally.located_graph(possible),
            neighbors=neighbors,
            coupling=self._coupling_strength(),
        )
        self._hazard_state = gibbs.HazardState(
            self._hazardous,
            np.zeros((CHAINS, tally.steps.size), np.int32),
            self._place['malfunction'],
            self._place['lethality'],
        )
        gibbs.count_exposures(self._hazard_state, self._factors.graph)
        self._uniform = np.empty(state.hazardous.shape)
        certain = np.where(possible, LARGE, 0.0)
        self._odds = np.tile(certain, (CHAINS, 1))
        self._joints = np.zeros((GROUPS, possible.size, 2, 2))
        self._weights = {
            name: np.zeros((GROUPS, hypotheses.bins[name].values.size))
            for name in hypotheses.unknown
        }
        # Sums, for the common type, of the chances to survive a step into a safe cell and into a
        # hazard.
        self._steps_survived = np.zeros(2)

    def sweep(self) -> None:
        """Draw all hazards and unknown numbers once, and add up conditional probabilities."""
        target_odds = self.draw_field()
        self._draw_survival()
        self._draw_the_rest(*target_odds)
        hazard, background, kappa = (
            self._elsewhere_odds[name][self._place[name]]
            for name in ('hazard_density', 'target_background', 'kappa')
        )
        gibbs.add_joints(hazard, background, kappa, self._elsewhere_joints)
        self.sweeps += 1

    def draw_field(self) -> tuple[Floats, Floats]:
        """Draw the hazards; return the odds of a target in a safe cell and in a hazardous cell."""
        hazard_odds, *target_odds = self._given_returns()
        factors = self._factors._replace(odds=hazard_odds)
        with np.errstate(over='ignore'):
            gibbs.draw_hazards(
                self._hazard_state,
                factors,
                self._undecided,
                self._rng.random(out=self._uniform),
                self._odds,
            )
            if self._tally.steps.size or self._tally.located_steps.size:
                proposals = self._rng.random((CHAINS, SWAPS, 4))
                gibbs.swap_hazards(self._hazard_state, factors, proposals)
            if_safe, if_hazardous = target_odds
            gibbs.add_joints(self._odds, if_safe, if_hazardous, self._joints)
        return if_safe, if_hazardous

    @property
    def state(self) -> ChainState:
        """Return the state, which shares arrays with the chains: call after the last sweep."""
        return ChainState(self._place, self._cells, self._hazardous)

    def hazards(self) -> NDArray[np.bool_]:
        """Return the hazards of all cells in each chain, shape (chains, cells)."""
        prior = self._hypotheses.maps['hazard_density'].at(self._offset('hazard_density'))
        hazards: NDArray[np.bool_] = self._rng.random((CHAINS, prior.shape[1])) < expit(prior)
        hazards[:, self._cells] = self._hazardous
        return hazards

    def models(self) -> list[SensorModel]:
        """Return the sensor model of the common robot type in each chain."""
        unknown = self._hypotheses.unknown
        values = [self._hypotheses.bins[name].values[self._place[name]] for name in unknown]
        numbers = np.reshape(values, (len(unknown), CHAINS)).T.tolist()
        return [self._hypotheses.model_with(dict(zip(unknown, each))) for each in numbers]

    def joint(self) -> tuple[Floats, float]:
        """Return joints and their sampling error (:eq:`averaged-belief`, :eq:`sampling-error`)."""
        by_group = np.tile(self._hypotheses.belief.joint, (GROUPS, 1, 1, 1))
        by_group[:, self._elsewhere] = self._elsewhere_joints / self.sweeps
        by_group[:, self._cells] = self._joints / self.sweeps
        joint = by_group.mean(axis=0)
        variance = by_group.var(axis=0, ddof=1) / GROUPS
        seen = joint > 0.0
        return joint, float((variance[seen] / joint[seen]).sum() / 2.0)

    def _offset(self, name: str) -> Places:
        """Return the index of the prior map's offset in each chain."""
        return self._hypotheses.offset(name, self._place)

    def _coupling_strength(self) -> Floats:
        """Return e^J of each chain."""
        clusters = self._hypotheses.clusters
        if clusters is None:
            return np.ones(CHAINS)
        strength: Floats = np.exp(clusters.coupling[self._place['coupling']])
        return strength

    def _of_chains(self, name: str, of_values: Floats) -> Floats:
        """Select the entry of `of_values` for each chain's value of a number, (1 or chains, 1)."""
        return of_values[None] if of_values.size == 1 else of_values[self._place[name], None]

    def _given_returns(self) -> tuple[Floats, Floats, Floats]:
        """Return hazard and target odds of all cells (:eq:`hazard-odds`, :eq:`reading-odds`)."""
        tally, cells = self._tally, self._returned
        told_if_safe, told_if_hazardous, target_if_safe, target_if_hazardous = (
            self._of_readings or self._given_readings()
        )
        log_odds = self._maps['hazard_density'].at(self._offset('hazard_density'), cells)
        for rates, survived in zip(self._rates, tally.survived[:, cells]):
            spared = self._of_chains('lethality', rates.log_spared)
            log_odds = log_odds + times_log(survived, spared)
        log_odds = log_odds + told_if_hazardous
        log_odds = log_odds - told_if_safe
        odds = self._odds_with('hazard_density', log_odds.clip(-CERTAIN_HAZARD, CERTAIN_HAZARD))
        return odds, target_if_safe, target_if_hazardous

    def _given_readings(self) -> tuple[Floats, Floats, Floats, Floats]:
        """Return the factors of the readings, each of shape (1 or chains, cells)."""
        tally, maps, cells = self._tally, self._maps, self._returned
        read: Floats = np.zeros((1, cells.size))
        if_safe = maps['target_background'].at(self._place['target_background'], cells)
        if_hazardous = maps['kappa'].at(self._place['kappa'], cells)
        for rates, positive, negative in zip(
            self._rates, tally.positive[:, cells], tally.negative[:, cells]
        ):
            true = self._of_chains('true_positive', rates.true_positive)
            false = self._of_chains('false_positive', rates.false_positive)
            with np.errstate(divide='ignore', invalid='ignore'):
                read = read + times_log(positive, np.log(true) - np.log(false))
                read = read + times_log(negative, np.log1p(-true) - np.log1p(-false))
        read = read.clip(-CERTAIN_READING, CERTAIN_READING)
        return (
            softplus(read + if_safe) - softplus(if_safe),
            softplus(read + if_hazardous) - softplus(if_hazardous),
            self._odds_with('target_background', np.minimum(read + if_safe, CERTAIN_TARGET)),
            self._odds_with('kappa', np.minimum(read + if_hazardous, CERTAIN_TARGET)),
        )

    def _odds_with(self, name: str, log_odds: Floats) -> Floats:
        """Return the odds of a prior map, replaced by `log_odds` in cells with survived steps."""
        of_values = self._prior_odds[name]
        is_known = of_values.shape[0] == 1
        odds = of_values[np.zeros(log_odds.shape[0], np.intp) if is_known else self._offset(name)]
        odds[:, self._returned] = np.exp(log_odds)
        return odds

    def _draw(self, name: str, log_likelihood: Floats) -> Floats:
        """Draw an unknown number in each chain, and add up the weights of its values."""
        log_weight = log_likelihood + self._hypotheses.bins[name].log_prior
        weight: Floats = np.exp(log_weight - log_weight.max(axis=1, keepdims=True))
        draw_values(weight, self._rng.random(CHAINS), self._place[name])
        self._weights[name] += weight.reshape(GROUPS, -1, weight.shape[1]).mean(axis=1)
        return weight

    def _draw_survival(self) -> None:
        """Draw lethality and malfunction given hazards (:eq:`rate-conditional`)."""
        tally, hypotheses = self._tally, self._hypotheses
        exposures, factors = self._hazard_state.exposures, self._factors
        malfunction, lethality = self._place['malfunction'], self._place['lethality']
        if 'lethality' in hypotheses.unknown:
            values, robot_types, most = factors.spared.shape
            likelihood = np.ones((CHAINS, values))
            endured = factors.endured[malfunction[:, None], factors.length]
            spared: Floats = factors.spared.reshape(values, robot_types * most).T.copy()
            place = exposures + (tally.robot_type * most).astype(np.int32)
            weigh_by_losses(endured, place, spared, likelihood)
            self._weigh_by_located(
                factors.step_endured[malfunction][:, :, None],
                factors.step_spared.T[None],
                likelihood,
            )
            log_likelihood = safe_log(likelihood)
            for robot_type, rates, survived in zip(tally.robot_types, self._rates, tally.survived):
                if robot_type.lethality is None:
                    exposed = (self._hazardous[:, self._returned] * survived[self._returned]).sum(
                        axis=1
                    )
                    log_likelihood = log_likelihood + exposed[:, None] * rates.log_spared
            weight = self._draw('lethality', log_likelihood)
            ordinary = self._rates[tally.robot_types.index(ORDINARY)]
            spared = (weight * np.exp(ordinary.log_spared)).sum(axis=1)
            endured = np.exp(ordinary.log_endured[malfunction])
            self._steps_survived += endured.sum(), (endured * spared).sum()
        if 'malfunction' in hypotheses.unknown:
            likelihood = np.ones((CHAINS, factors.endured.shape[0]))
            spared = factors.spared[lethality[:, None], tally.robot_type, exposures]
            length = np.broadcast_to(factors.length.astype(np.int32), spared.shape).copy()
            weigh_by_losses(spared, length, factors.endured.T.copy(), likelihood)
            self._weigh_by_located(
                factors.step_endured.T[None],
                factors.step_spared[lethality][:, :, None],
                likelihood,
            )
            log_likelihood = safe_log(likelihood)
            for robot_type, rates, survived in zip(tally.robot_types, self._rates, tally.survived):
                if robot_type.malfunction is None:
                    log_likelihood = log_likelihood + survived.sum() * rates.log_endured
            self._draw('malfunction', log_likelihood)

    def _weigh_by_located(self, endured: Floats, spared: Floats, likelihood: Floats) -> None:
        """Multiply `likelihood` by located losses; rates: (1 or chains, types, 1 or values)."""
        if self._tally.located_steps.size:
            shape = (CHAINS, endured.shape[1], likelihood.shape[1])
            safe, exposed = (
                np.ascontiguousarray(np.broadcast_to(each, shape))
                for each in (endured, endured * spared)
            )
            weigh_by_located(self._hazardous, self._factors.located, safe, exposed, likelihood)

    def _draw_the_rest(self, if_safe: Floats, if_hazardous: Floats) -> None:
        """Draw all other unknown numbers (:eq:`map-conditional`, :eq:`count-conditional`)."""
        tally, hypotheses, maps = self._tally, self._hypotheses, self._maps
        unknown = hypotheses.unknown
        hazardous = self._hazardous.astype(bool)
        if hypotheses.clusters is not None:
            self._draw_clustering(hypotheses.clusters)
        elif 'hazard_density' in unknown:
            prior = maps['hazard_density']
            count = (hazardous & prior.undecided).sum(axis=1)
            log_likelihood = prior.log_absent.sum(axis=0) + count[:, None] * prior.offset
            self._draw('hazard_density', log_likelihood)
        if self._of_readings is not None:
            return
        # Draw only targets with readings, the only evidence on them (:eq:`target-conditional`).
        read = self._read
        hazardous, if_safe, if_hazardous = (
            np.take(each, read, axis=1) for each in (hazardous, if_safe, if_hazardous)
        )
        of_target = np.where(hazardous, if_hazardous, if_safe)
        target = self._rng.random(of_target.shape) * (1.0 + of_target) < of_target
        for name, concerned in (('kappa', hazardous), ('target_background', ~hazardous)):
            if name in unknown:
                prior = maps[name]
                cells = concerned & prior.undecided[read]
                log_likelihood = (cells & target).sum(axis=1)[:, None] * prior.offset
                sum_of_cells(cells, prior.log_absent[read], log_likelihood)
                self._draw(name, log_likelihood)
        for name, concerned in (('true_positive', target), ('false_positive', ~target)):
            if name in unknown:
                values = hypotheses.bins[name].values
                learning = [getattr(robot_type, name) is None for robot_type in tally.robot_types]
                positive, negative = (
                    (concerned * counts[learning].sum(axis=0)[read]).sum(axis=1)[:, None]
                    for counts in (tally.positive, tally.negative)
                )
                log_likelihood = positive * np.log(values) + negative * np.log1p(-values)
                self._draw(name, log_likelihood)

    def _draw_clustering(self, clusters: Clusters) -> None:
        """Draw density and coupling, given hazards (:eq:`coupling-conditional`)."""
        unknown, place = self._hypotheses.unknown, self._place
        count = self._hazardous.sum(axis=1)[:, None]
        if 'hazard_density' in unknown:
            field, log_z = (each[place['coupling']] for each in (clusters.field, clusters.log_z))
            self._draw('hazard_density', field * count - log_z)
        if 'coupling' in unknown:
            pairs = np.empty(CHAINS, np.int64)
            gibbs.count_coupled(clusters.neighbors, self._hazardous, pairs)
            field, log_z = (
                each.T[place['hazard_density']] for each in (clusters.field, clusters.log_z)
            )
            self._draw('coupling', field * count + pairs[:, None] * clusters.coupling - log_z)
            self._factors = self._factors._replace(coupling=self._coupling_strength())

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
            means['lethality'] = self._hypotheses.lethality(spared / endured)
        return self._hypotheses.model_with(means)
