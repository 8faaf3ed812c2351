# SPDX-License-Identifier: Apache-2.0
"""A study of a few short missions."""

from dataclasses import replace
import json

from kbnitp_ros.study.comparison import write_report
from kbnitp_ros.study.results import Results
from kbnitp_ros.study.trial import list_trials, run_trial
import yaml

CONTENT = {
    'seed': 7,
    'trials': 3,
    'robots': 4,
    'methods': ['relaxed_bnitp', 'kappa_bnitp_published', 'kappa_bnitp'],
    'lethalities': [0.2, 0.9],
    'grid': {'width': 4, 'height': 3, 'base': 5},
    'planning': {'planner': 'relaxed', 'max_steps': 6, 'width': 1, 'max_visits': 2},
    'world': {'hazard_density': 0.3, 'kappa': 0.8, 'target_background': 0.1},
    'sensor': {
        'malfunction': 0.05,
        'false_negative': 0.05,
        'true_positive': 0.95,
        'false_positive': 0.05,
    },
    'prior': {'hazard': 0.3, 'target': 0.31, 'kappa': 0.8},
}


def changed(key, value):
    """Return the content with one key (dots for levels) changed, or removed."""
    content = {k: dict(v) if isinstance(v, dict) else v for k, v in CONTENT.items()}
    *sections, last = key.split('.')
    section = content
    for name in sections:
        section = section[name]
    if value is None:
        del section[last]
    else:
        section[last] = value
    return content


def write(path, content=CONTENT):
    path.write_text(yaml.safe_dump(content, sort_keys=False))
    return path


def run(scenario):
    """Return the results of all trials."""
    return Results(
        scenario, {trial: run_trial(scenario, trial) for trial in list_trials(scenario)}
    )


def compared_by(scenario, teams):
    """Return the results of missions by strategies, of one method at one lethality."""
    return run(replace(scenario, teams=teams, methods=('kappa_bnitp',), lethalities=(0.9,)))


def written(results, comparison, folder):
    write_report(results, folder)
    summary = json.loads((folder / 'summary.json').read_text())
    told = comparison.table(summary[comparison.name]).markdown()
    assert (folder / 'summary.md').read_text().endswith(told)
    lines = (line.strip('| ').split(' | ') for line in told.splitlines()[4:])
    return summary, list(zip(summary[comparison.name]['rows'], lines, strict=True))
