# SPDX-License-Identifier: Apache-2.0
"""Messages that come twice, late and in any order give the same belief."""

from __future__ import annotations

from contextlib import contextmanager
from pathlib import Path
import subprocess
import sys

from mission import NAMESPACE
from onlooker import AGENT
import pytest
from schedule import NODES

RELAY = Path(__file__).with_name('relay.py')
PARAMETERS = {
    'grid.width': 5, 'grid.height': 5, 'max_steps': 10, 'robots': 15, 'planner': 'relaxed',
    'seed': 11,
}  # fmt: skip
TOPICS = ('path', 'report')


def renamed(topics, namespace):
    """Return the remaps that move topics of the agent to another namespace."""
    return {f'{AGENT}/{topic}': f'{namespace}/{AGENT}/{topic}' for topic in topics}


@contextmanager
def relay(seed, source, target):
    """Relay from one namespace to another."""
    process = subprocess.Popen([sys.executable, RELAY, str(seed), source, target])
    try:
        yield
    finally:
        process.kill()
        process.wait()


@pytest.mark.full
@pytest.mark.parametrize('method, learn', [
    ('kappa_bnitp_published', []),
    ('kappa_bnitp', []),
    ('kappa_bnitp_sampled', ['lethality', 'malfunction']),
])  # fmt: skip
def test_an_estimator_behind_a_relay(set_out, method, learn):
    parameters = PARAMETERS | {'method': method, 'learn.numbers': learn}
    mission = set_out(
        parameters,
        awaited={
            'planner': ['agent', 'recorder', 'relay'],
            'agent': ['planner', 'recorder', 'relay'],
        },
        remaps={'estimator': renamed(TOPICS, '/late')},
    )
    reports = mission.onlooker.evidence.reports
    with relay(1, NAMESPACE, '/late'):
        mission.start(*NODES)
        mission.until(lambda: len(reports) >= 6, 'report 6')
        mission.restart('estimator')
        mission.until(lambda: len(reports) >= 9, 'report 9')
    # The next relay tells of all deployments so far at once, the estimator of before knows them.
    with relay(2, NAMESPACE, '/late'):
        mission.until(lambda: len(reports) >= 12, 'report 12')
        mission.kill('estimator')
    with relay(3, NAMESPACE, '/late'):
        mission.start('estimator')
        mission.until_over()
        # The last copies.
        mission.wait(0.5)
    # Where beliefs are not on record, since they came too fast for a topic that keeps one, replay
    # relies on the order that DDS keeps and the relay does not.
    assert not [found for found in mission.findings() if found[0] != 'replay']
