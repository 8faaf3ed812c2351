# SPDX-License-Identifier: Apache-2.0
"""What a study comes to: where the methods stand after the last robot, and how far apart."""

from __future__ import annotations

from typing import Any, NamedTuple

from kbnitp_ros.study.results import Results
from kbnitp_ros.study.scenario import ALONE, Team
import numpy as np
from numpy.typing import NDArray

# The total log loss: how far the belief is from the truth, both maps together.
LOG_LOSS = ('hazard_log_loss', 'target_log_loss')

SUMMARISED = {
    'log_loss': LOG_LOSS,
    'hazard_log_loss': LOG_LOSS[:1],
    'target_log_loss': LOG_LOSS[1:],
    'entropy': ('entropy',),
    'robots_lost': ('robots_lost',),
}

RESAMPLES = 2000

# Beyond these a summary would show how sums were rounded.
DECIMALS = 6


class Mean(NamedTuple):
    """A mean over trials and its 95 % interval; each shape (...)."""

    mean: NDArray[np.float64]
    low: NDArray[np.float64]
    high: NDArray[np.float64]


def mean_of(samples: NDArray[np.float64]) -> Mean:
    """
    Return the mean over trials with its 95 % bootstrap interval.

    The trials are resampled with the same random numbers in every call. The interval spans the
    2.5 % and 97.5 % quantiles of the resampled means; of a single trial it is NaN.

    Parameters
    ----------
    samples : ndarray, shape (trials, ...)
        One value, or one series, a trial.

    """
    trials = len(samples)
    mean = samples.mean(axis=0)
    if trials == 1:
        return Mean(mean, np.full_like(mean, np.nan), np.full_like(mean, np.nan))
    drawn = np.random.default_rng(0).multinomial(trials, np.full(trials, 1 / trials), RESAMPLES)
    low, high = np.quantile(np.tensordot(drawn / trials, samples, 1), (0.025, 0.975), axis=0)
    return Mean(mean, low, high)


def summarise(results: Results) -> dict[str, Any]:
    """
    Return where every method stands after the last robot, as JSON can hold it.

    Returns
    -------
    dict
        ``trials``, ``robots``, ``reference`` (the scenario's last method) and ``rows``: one for
        each lethality, method and team, with the mean and interval of each of `SUMMARISED`, of
        ``false_targets``, how many targets are believed to be in cells with a hazard alone, and
        of ``difference``, the reference's total log loss less this method's with the same team in
        the same trial: negative where the reference is nearer to the truth.

    """
    scenario = results.scenario
    reference = scenario.methods[-1]
    rows = []
    for lethality in scenario.lethalities:
        for method, team in scenario.contenders:
            row: dict[str, Any] = {'lethality': lethality, 'method': method, **vars(team)}
            for name, measures in SUMMARISED.items():
                row[name] = _entry(results.series(lethality, method, *measures, team=team)[:, -1])
            believed, truth = results.final_maps(lethality, method, team)
            hazard_alone = truth[:, 0] & ~truth[:, 1]
            row['false_targets'] = _entry((believed[:, 1] * hazard_alone).sum(axis=1))
            if method != reference:
                nearest, this = (
                    results.series(lethality, name, *LOG_LOSS, team=team)[:, -1]
                    for name in (reference, method)
                )
                row['difference'] = _entry(nearest - this)
            rows.append(row)
    return {
        'trials': scenario.trials,
        'robots': scenario.robots,
        'reference': reference,
        'rows': rows,
    }


def _entry(samples: NDArray[np.float64]) -> dict[str, float | None]:
    return {
        name: None if np.isnan(value) else round(float(value), DECIMALS)
        for name, value in mean_of(samples)._asdict().items()
    }


def markdown(summary: dict[str, Any]) -> str:
    """Return a summary as a table for people."""
    columns = [*SUMMARISED, 'false_targets', 'difference']
    lines = [
        f'After {summary["robots"]} robots: means of {summary["trials"]} trials with 95 % '
        'bootstrap intervals. Losses and entropy are in nats, summed over the cells. '
        'False targets: the number believed to be in cells with a hazard alone. Difference: the '
        f'log loss of `{summary["reference"]}` less that of the method, trial by trial.',
        '',
        f'| lethality | method | {" | ".join(name.replace("_", " ") for name in columns)} |',
        '|---|---|' + '---|' * len(columns),
    ]
    for row in summary['rows']:
        team = Team(row['agents'], row['allocation'], row['loss_cost'])
        method = f'`{row["method"]}`' if team == ALONE else f'`{row["method"]}`, {team}'
        cells = [f'{row["lethality"]:.4g}', method]
        cells += [_shown(row[name]) if name in row else '' for name in columns]
        lines.append(f'| {" | ".join(cells)} |')
    return '\n'.join(lines) + '\n'


def _shown(entry: dict[str, float | None]) -> str:
    if entry['low'] is None:
        return f'{entry["mean"]:.1f}'
    return f'{entry["mean"]:.1f} [{entry["low"]:.1f}, {entry["high"]:.1f}]'
