# SPDX-License-Identifier: Apache-2.0
"""Comparisons of teams, losses, learning and decisions."""

from __future__ import annotations

from collections.abc import Iterator
from itertools import product

from kbnitp_ros.core.decision.decision import FEWEST_LEFT_OUT
from kbnitp_ros.study.results import (
    after_robots,
    after_rounds,
    bootstrap_mean,
    HIGH,
    interval,
    LOG_LOSS,
    LOW,
    MEAN,
    Mean,
    means_after,
    of_number,
    resampled_means,
    Results,
    Row,
    SD,
    Series,
    trade,
)
from kbnitp_ros.study.scenario import (
    differ_only_in,
    LEARNING,
    Scenario,
    Strategy,
    team_labels,
)
import numpy as np
from numpy.typing import NDArray


def differ_in_size(scenario: Scenario) -> bool:
    """Return whether the teams differ in size, and otherwise at most in the allocation."""
    sizes = {team.agents for team in scenario.teams}
    return len(sizes) > 1 and differ_only_in(scenario, 'agents', 'allocation')


def common_rounds(scenario: Scenario) -> int:
    """Return the number of rounds that the largest team can complete."""
    return scenario.robots // max(team.agents for team in scenario.teams)


def team_rows(results: Results) -> Iterator[Row]:
    """Yield the results of each team: after all robots, and after equal numbers of rounds."""
    scenario = results.scenario
    labels, common = team_labels(scenario), common_rounds(scenario)
    smallest = min(scenario.teams, key=lambda team: team.agents)
    for row, team, series in results.missions():
        entropy, log_loss, lost = series('joint_entropy'), series(*LOG_LOSS), series('robots_lost')
        information = entropy[:, :1] - entropy
        rounds = after_rounds(information, team.agents).shape[1] - 1
        measured = {
            'information_a_robot': information[:, -1] / scenario.robots,
            'information_a_round': information[:, -1] / rounds,
            'log_loss': log_loss[:, -1],
            'difference': (log_loss - series(*LOG_LOSS, team=smallest))[:, -1],
            'early_information': after_rounds(information, team.agents)[:, common],
            'early_log_loss': after_rounds(log_loss, team.agents)[:, common],
            'early_robots_lost': after_rounds(lost, team.agents)[:, common],
        }
        row |= {**vars(team), 'label': labels[team], 'rounds': rounds}
        yield row | {name: bootstrap_mean(values) for name, values in measured.items()}


# Fields of a comparison at equal log loss.
EQUAL = ('log_loss', 'sent_at_least', 'sent', 'lost_at_least', 'lost', 'difference', 'fewer')


def at_equal_log_loss(
    least: NDArray[np.float64], this: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Return the fields `EQUAL` of two mean missions, at the lowest log loss that both reach."""
    lowest = [np.minimum.accumulate(log_loss) for _, log_loss in (least, this)]
    level = max(log_loss[-1] for log_loss in lowest)
    # In reverse, to find the first robot at which the level is reached.
    sent = [np.interp(level, low[::-1], np.arange(low.size)[::-1]) for low in lowest]
    lost = [np.interp(n, np.arange(of.size), of) for n, (of, _) in zip(sent, (least, this))]
    return np.array([level, *sent, *lost, lost[1] - lost[0], sent[0] - sent[1]])


def compare(least: NDArray[np.float64], this: NDArray[np.float64]) -> dict[str, Mean]:
    """Compare the mean missions of two sets of trials, paired by world, at equal log loss."""
    resampled = [
        at_equal_log_loss(*means) for means in zip(resampled_means(least), resampled_means(this))
    ]
    found = at_equal_log_loss(least.mean(axis=0), this.mean(axis=0))
    compared = interval(found, np.reshape(resampled, (-1, found.size)))
    return {name: Mean(*values) for name, *values in zip(EQUAL, *compared)}


def at_equal_log_loss_more(series: Series, least: Strategy, this: Strategy) -> Mean:
    """Return the difference of robots lost at equal log loss, `this` minus `least`."""
    return compare(trade(series, least), trade(series, this))['difference']


def log_loss_at_equal_losses(series: Series, first: Strategy, this: Strategy) -> Mean:
    """Return the difference of log loss at equal numbers of lost robots, `this` minus `first`."""

    def difference(one: NDArray[np.float64], other: NDArray[np.float64]) -> float:
        lost = min(one[0, -1], other[0, -1])
        return float(np.interp(lost, *other) - np.interp(lost, *one))

    missions = trade(series, first), trade(series, this)
    resampled = [difference(*means) for means in zip(*map(resampled_means, missions))]
    found = difference(*(each.mean(axis=0) for each in missions))
    return interval(np.array(found), np.array(resampled))


def equal_rows(results: Results) -> Iterator[Row]:
    """Yield the comparison, at equal log loss, of each loss cost with the smallest."""
    least, *others = sorted(results.scenario.teams, key=lambda team: team.loss_cost)
    for row, team, series in results.missions(others):
        measured = compare(trade(series, least), trade(series, team))
        del measured['fewer']
        yield row | vars(team) | measured


def base_rows(results: Results) -> Iterator[Row]:
    """Yield the decrease of log loss by each second base, and a comparison at equal log loss."""
    one, *others = sorted(results.scenario.teams, key=lambda team: team.second_base)
    for row, two, series in results.missions(others):
        missions = trade(series, one), trade(series, two)
        equal = compare(*missions)
        yield row | {
            **vars(two),
            'value': bootstrap_mean(missions[0][:, 1, -1] - missions[1][:, 1, -1]),
            'log_loss': equal['log_loss'],
            'sent_from_one': equal['sent_at_least'],
            'sent': equal['sent'],
            'lost_from_one': equal['lost_at_least'],
            'lost': equal['lost'],
            'fewer': equal['fewer'],
        }


# Numbers of robots after which learning is compared, in addition to the end.
ROBOTS = (10, 25, 50, 100, 200)


def number_rows(results: Results) -> Iterator[Row]:
    """Yield the final errors of learnt numbers, a row for each lethality and number."""
    for lethality, name in product(results.scenario.lethalities, results.scenario.learn.priors):
        known, truth = of_number(results, lethality, name)
        first, last = known[:, 0], known[:, -1]
        is_within = (last[:, LOW] <= truth[:, 0]) & (truth[:, 0] <= last[:, HIGH])
        yield {
            'lethality': lethality,
            'number': name,
            'sd_before': bootstrap_mean(first[:, SD]),
            'sd': bootstrap_mean(last[:, SD]),
            'error': bootstrap_mean(np.abs(last[:, MEAN] - truth[:, 0])),
            'within': bootstrap_mean(is_within.astype(np.float64)),
        }


def cost_of_learning(results: Results) -> Iterator[Row]:
    """Yield the cost of learning, a row for each lethality and method without learning."""
    scenario = results.scenario
    team, robots = scenario.teams[0], after_robots(ROBOTS, scenario.robots)
    for lethality in scenario.lethalities:
        learner = results.series(lethality, LEARNING, *LOG_LOSS, team=team)
        for method in scenario.methods:
            if method != LEARNING:
                informed = results.series(lethality, method, *LOG_LOSS, team=team)
                costs = means_after(learner - informed, robots)
                yield {'lethality': lethality, 'method': method, 'costs': costs}


# Numbers of robots after which decisions on a lane are compared, in addition to the end.
DECIDED_AFTER = (10, 25, 50, 100)
# Confidences at which missions may end.
CONFIDENCES = (0.9, 0.95, 0.99)
# Share of an area to be declared free.
SHARE_OF_AREA = 0.8


def certifies(scenario: Scenario) -> bool:
    """Return whether missions end at a confidence."""
    return scenario.asked is not None and bool(scenario.asked.confidence)


def lane_rows(results: Results) -> Iterator[Row]:
    """Yield the true and the believed share of free lanes for each strategy."""
    scenario, labels = results.scenario, team_labels(results.scenario)
    for row, team, series in results.missions():
        free, base = series('free'), series('free', team=scenario.teams[0])
        for robots in after_robots(DECIDED_AFTER, scenario.robots):
            yield row | {
                'label': labels[team],
                'robots': robots,
                'free': bootstrap_mean(free[:, robots]),
                'believed': bootstrap_mean(series('p_free')[:, robots]),
                'difference': bootstrap_mean((free - base)[:, robots]),
                'lost': bootstrap_mean(series('robots_lost')[:, robots]),
            }


def certificate_rows(results: Results) -> Iterator[Row]:
    """Yield, for each confidence, the share of stopped missions whose goal is truly free."""
    asked = results.scenario.asked
    confidences = [each for each in CONFIDENCES if asked is None or each <= asked.confidence]
    for (row, _, series), confidence in product(results.missions(), confidences):
        p_free, free, draws = map(series, ('p_free', 'free', 'independent_draws'))
        are_enough = (1.0 - confidence) * draws >= FEWEST_LEFT_OUT
        is_sure = are_enough & (p_free >= confidence)
        stopped = is_sure.any(axis=1)
        if not stopped.any():
            continue
        at = np.argmax(is_sure[stopped], axis=1)[:, None]
        stated, true = (
            np.take_along_axis(each[stopped], at, axis=1)[:, 0] for each in (p_free, free)
        )
        yield row | {
            'confidence': confidence,
            'stopped': int(stopped.sum()),
            'sent': bootstrap_mean(at[:, 0].astype(np.float64)),
            'stated': bootstrap_mean(stated),
            'free': bootstrap_mean(true),
            'difference': bootstrap_mean(true - stated),
        }


def area_rows(results: Results) -> Iterator[Row]:
    """Yield, for each strategy, the robots sent until `SHARE_OF_AREA` is declared free."""
    scenario, labels = results.scenario, team_labels(results.scenario)
    for row, team, series in results.missions():
        declared, right, lost = map(series, ('declared', 'declared_free', 'robots_lost'))
        robots = needed(declared)
        yield row | {
            'label': labels[team],
            'reached': bootstrap_mean((declared.max(axis=1) >= SHARE_OF_AREA).astype(np.float64)),
            'needed': bootstrap_mean(robots),
            'difference': bootstrap_mean(
                robots - needed(series('declared', team=scenario.teams[0]))
            ),
            'lost': bootstrap_mean(lost[np.arange(len(lost)), robots.astype(np.intp)]),
            'declared': bootstrap_mean(declared[:, -1]),
            'wrong': bootstrap_mean((declared - right)[:, -1]),
        }


def needed(declared: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the robots sent until `SHARE_OF_AREA` is declared free, (trials,); all if never."""
    is_most = declared >= SHARE_OF_AREA
    is_most[:, -1] = True
    robots: NDArray[np.float64] = np.argmax(is_most, axis=1).astype(np.float64)
    return robots
