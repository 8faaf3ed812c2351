# SPDX-License-Identifier: Apache-2.0
"""A study of a few short missions."""

from dataclasses import asdict

from kbnitp_ros.study.scenario_file import Study
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


def single(scenario):
    """Return a study of one scenario without choices."""
    return Study(asdict(scenario), (), {(): scenario})


def run(study):
    """Return the outcomes of all trials."""
    return {trial: run_trial(study, trial) for trial in list_trials(study)}
