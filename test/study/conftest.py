# SPDX-License-Identifier: Apache-2.0
"""A small study, run once."""

from kbnitp_ros.study.results import Results
from kbnitp_ros.study.scenario import read_scenario
from kbnitp_ros.study.trial import run_trial, trials_of
import pytest
import small_study


@pytest.fixture(scope='session')
def scenario(tmp_path_factory):
    return read_scenario(small_study.write(tmp_path_factory.mktemp('study') / 'scenario.yaml'))


@pytest.fixture(scope='session')
def results(scenario):
    """Return the results of all trials; not to be changed."""
    return Results(scenario, {trial: run_trial(scenario, trial) for trial in trials_of(scenario)})
