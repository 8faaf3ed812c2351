# SPDX-License-Identifier: Apache-2.0
"""What docs/robots.md tells of agents, and the one that it prints."""

from pathlib import Path
import re
import subprocess
import sys

from kbnitp_msgs.msg import DeploymentReport
from kbnitp_ros.log.replay import replay
import pytest

PAGE = Path(__file__).parents[2] / 'docs/robots.md'
PRINTED = re.search(r'^```python\n(.*?)^```', PAGE.read_text(), re.MULTILINE | re.DOTALL)[1]


@pytest.fixture
def minimal_agent(tmp_path):
    """Provide a function that starts the agent as it is printed; it is ended in the end."""
    started = []

    def start():
        file = tmp_path / 'minimal_agent.py'
        file.write_text(PRINTED)
        started.append(subprocess.Popen([sys.executable, file]))

    yield start
    for process in started:
        process.kill()
        process.wait()


def test_the_agent_as_printed_completes_a_mission(field, minimal_agent):
    log = field.folder / 'log' / 'mission.mcap'
    log.parent.mkdir()
    reports = field.listen(DeploymentReport, '/scout_1/report')
    parameters = {'robots': 3, 'file': str(log), 'max_steps': 8, 'recorded': True}
    parameters |= {'silent_loss': True, 'step_period': 0.01}
    minimal_agent()
    for node in ('recorder', 'estimator'):
        field.start(node, parameters)
    # A log can be replayed from the belief before the first deployment.
    waiting = 'waiting for a planner to publish AGENT/path in'
    field.until(lambda: field.state('/recorder').startswith(waiting), 'belief to record')
    field.start('planner', parameters)
    field.until(lambda: field.state('/planner').startswith('done: 3 of 3'), 'end')
    assert [each.survived for each in reports] == [True] * 3
    field.processes.stop()
    replayed = replay(log)
    assert replayed.reproduced
    assert len(replayed.evidence.reports) == 3
