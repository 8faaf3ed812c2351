# SPDX-License-Identifier: Apache-2.0
"""The command preflight hears the base and its robots, and is green once all is mended."""

from importlib.metadata import version
from itertools import groupby
import os
import re
import subprocess
import sys

from base import Base, GRID
from kbnitp_msgs.msg import AgentHealth
from kbnitp_ros.core import Grid
from kbnitp_ros.messages.health import Health, health_message
from kbnitp_ros.messages.operator_actions import Action
from kbnitp_ros.nodes.runtime import qos
from laws import for_each

COMMAND = [sys.executable, '-m', 'kbnitp_ros', 'preflight']


def preflight(field, wait, *options):
    """Run the command; return its exit code and its output."""
    running = subprocess.Popen(
        [*COMMAND, '--wait', str(wait), *options],
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
        env=os.environ,
    )
    field.until(lambda: running.poll() is not None, 'end of the command')
    return running.returncode, running.communicate()[0]


def test_a_base_that_is_not_heard_is_named(field):
    code, told = preflight(field, 0.5)
    assert code == 2
    assert told == (
        'preflight: no planner is heard on /mission: start the base, name another '
        '--namespace, or set ROS_DOMAIN_ID to the number that the base was started with\n'
    )


@for_each('name, meant', [('journal', ''), ('battary', 'did you mean battery? ')])
def test_a_check_that_is_mandatory_or_unknown_is_not_skipped(field, name, meant):
    code, told = preflight(field, 0.5, '--skip', 'clock', '--skip', name)
    assert code == 2
    assert told == (
        f'preflight: --skip {name}: there is no such check that may be skipped; {meant}they are '
        'clock, pose, action server, battery, disk, parameters\n'
    )


def test_a_robot_is_red_for_seven_reasons_mended_one_by_one(field):
    base = Base(field, robots=1, min_battery=0.3)
    field.until(lambda: base.beliefs, 'prior')
    publisher = field.node.create_publisher(AgentHealth, '/scout_1/health', qos.READINGS)
    says = {'version': '0.9.0', 'battery': 0.18, 'journal': False, 'behind': 5 * 10**9}

    def repeat():
        now, health = field.now(), dict(says)
        stamp = now - health.pop('behind')
        publisher.publish(health_message('scout_1', Health(stamp, **health)))

    def red(*skipped):
        options = [word for name in skipped for word in ('--skip', name)]
        code, told = preflight(field, 5.0, *options)
        lines = [line for line in told.splitlines() if line.startswith('RED')]
        assert code == bool(lines) or 'no planner is heard' in told, told
        return [line.partition(':')[0].split(maxsplit=1)[1] for line in lines]

    def until_red(*names, skipped=()):
        # A command on a busy machine may not hear all in its time.
        field.until(lambda: red(*skipped) == [*names], f'{names} alone')

    until_red('scout_1 heard')
    field.node.create_timer(0.2, repeat)
    field.stand('scout_1', Grid(6, 5), is_at_base=False)
    reasons = ['version', 'field', 'at its base', 'journal', 'clock', 'battery']
    mend = {
        'version': lambda: says.update(version=version('kbnitp_ros')),
        'field': lambda: field.stand('scout_1', GRID, is_at_base=False),
        'at its base': lambda: field.stand('scout_1', GRID),
        'journal': lambda: says.update(journal=True),
        'clock': lambda: says.update(behind=0),
        'battery': lambda: says.update(battery=0.9),
    }
    while reasons:
        until_red(*(f'scout_1 {reason}' for reason in reasons))
        if reasons == ['clock', 'battery']:
            until_red('scout_1 battery', skipped=['clock'])
            code, told = preflight(field, 60.0, '--skip', 'battery')
            assert code == 0
            assert 'SKIP  scout_1 battery: 18 %: 30 % needed' in told
            assert 'SKIP  scout_1 clock: -5.' in told
            assert field.set_parameter('/planner', 'preflight_skip', ['pose']).successful
            until_red('scout_1 clock', 'scout_1 battery')
        mend[reasons.pop(0)]()
    code, told = preflight(field, 60.0)
    assert code == 0, told
    assert 'GREEN scout_1 battery: 90 %' in told
    assert 'INFO  scout_1 pose: not known' in told
    assert 'GREEN disk: ' in told
    assert re.search(r'INFO  scout_1 round trip: \d+ ms for a service call', told)
    assert 'INFO  losses: without hazards' in told
    assert 'INFO  duds: can a hazard be dead, or a decoy? If so, add duds to learn.numbers' in told
    # What is skipped is on record, and lasts.
    changes = [each.parameters for each in base.actions if each.action == Action.SET]
    skipped = ('[clock]', '[battery, clock]', '[pose]')
    assert [each for each, _ in groupby(changes)] == [
        [f'{{preflight_skip: {names}}}'] for names in skipped
    ]
    base.crash()
    words = "parameter preflight_skip is ['pose'], as the operator had set"
    field.until(lambda: words in field.said('/planner'), words)
