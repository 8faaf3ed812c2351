# SPDX-License-Identifier: Apache-2.0
"""What docs/field.md shows of the consoles on a day in the field is what the nodes say."""

from pathlib import Path
import re

from fleet import FIELD, Fleet
from kbnitp_ros.log.replay import replay
import pytest

PAGE = Path(__file__).parents[2] / 'docs/field.md'
MISSION = '/mission'
ROBOT = f'{MISSION}/scout_1/robot'
NODES = ('recorder', 'estimator', 'planner')


def shown():
    """Return the lines that the page shows of consoles."""
    blocks = re.findall(r'^```text\n(.*?)^```', PAGE.read_text(), re.MULTILINE | re.DOTALL)
    return [line for block in blocks for line in block.splitlines()]


def matches(line):
    """Return what finds a line with other numbers, since times and paths differ."""
    return re.sub(r'\d+(?:\\\.\d+)?', r'[\\d.]+', re.escape(line))


@pytest.mark.full
def test_a_day_in_the_field_is_as_the_page_shows_it(field):
    fleet = Fleet(field, mission=MISSION)
    log = field.folder / 'log' / 'mission.mcap'
    log.parent.mkdir()
    base = {
        **FIELD, 'max_steps': 8, 'robots': 2, 'recorded': True, 'silent_loss': True,
        'step_period': 1.0, 'return_deadline': 300.0, 'keep_running': False,
    }  # fmt: skip

    def until_said(node, words):
        field.until(lambda: words in field.said(node), words)

    def robot():
        fleet.start(await_nodes=['planner', 'estimator', 'recorder'])

    robot()
    until_said(ROBOT, 'waiting for planner')
    field.start('recorder', {'file': str(log)}, MISSION)
    field.start('estimator', {**base, 'await_nodes': ['planner', 'recorder']}, MISSION)
    awaited = ['agent', 'estimator', 'recorder']
    planner = field.start('planner', {**base, 'await_nodes': awaited}, MISSION)
    until_said(ROBOT, 'waiting for TF')
    fleet.simulate(wrong='inactive')
    until_said(ROBOT, 'to be active')
    fleet.inject('live')
    field.until(lambda: len(set(fleet.walked())) > 1, 'robot in the field')
    field.kill(ROBOT)
    fleet.inject('die')
    fleet.inject('live')
    robot()
    field.until(lambda: field.said(ROBOT).count('leaving on') == 2, 'second robot')
    since = len(fleet.truth()['scout_1'])
    field.until(lambda: len(set(fleet.walked(since=since))) > 1, 'second robot in the field')
    fleet.cancel_all('follow_waypoints')
    field.until(lambda: planner.poll() is not None, 'end of the mission', may_end=True)
    said = '\n'.join(field.said(each) for each in (ROBOT, *(f'{MISSION}/{n}' for n in NODES)))
    field.processes.stop()
    assert replay(log).reproduced
    missing = [line for line in shown() if not re.search(matches(line), said)]
    assert not missing, said
