# SPDX-License-Identifier: Apache-2.0
"""A base that dies while a real robot is out, and goes on from its log."""

from collections import Counter
from operator import itemgetter

from extent import FULL
from fleet import FIELD, Fleet
from kbnitp_msgs.msg import BeliefMaps
from kbnitp_ros.log.read import read_log
from kbnitp_ros.log.replay import replay
from kbnitp_ros.log.roles import REPORT
from kbnitp_ros.messages.deployments import read_report
from kbnitp_ros.messages.headers import from_stamp
from nav_msgs.msg import Path
import numpy as np

MISSION = '/mission'
NODES = ('recorder', 'estimator', 'planner')

# When the base dies, in seconds after a path was sent, and how long it is gone.
RNG = np.random.default_rng(4)
CRASHES = RNG.uniform(0, [3.0, 5.0], (20, 2)).tolist() if FULL else [[0.7, 0.0]]
ROBOTS = len(CRASHES) + 1


class Base:
    """Planner, estimator and recorder, which die at once."""

    def __init__(self, field):
        self.field = field
        self.log = field.folder / 'log' / 'mission.mcap'
        self.log.parent.mkdir()
        self._parameters = {
            **FIELD,
            'max_steps': 8,
            'robots': ROBOTS,
            'agents': ['scout_1'],
            'recorded': True,
        }
        self.start(file=str(self.log))

    def start(self, **own):
        for name in NODES:
            self.field.start(name, {**self._parameters, **own}, MISSION)

    def die(self):
        for name in NODES:
            self.field.processes.started[f'{MISSION}/{name}'].kill()
        for name in NODES:
            self.field.kill(f'{MISSION}/{name}')


def test_robots_that_were_out_when_the_base_died_are_taken_in_once(field):
    fleet = Fleet(field, mission=MISSION)
    heard = fleet.reports()
    paths = field.listen(Path, f'{MISSION}/scout_1/path')
    beliefs = field.listen(BeliefMaps, f'{MISSION}/belief')
    fleet.simulate()
    fleet.start(await_nodes=['planner', 'estimator', 'recorder'])
    base = Base(field)

    def sent():
        return len({from_stamp(path.header.stamp) for path in paths})

    where = Counter()
    for number, (after, gone) in enumerate(CRASHES, 1):
        field.until(lambda n=number: sent() == n, 'path')
        if not FULL:
            field.until(lambda: 'driving' in fleet.state(), 'robot under way')
        fleet.wait(after)
        said = field.said(f'{MISSION}/scout_1/robot')
        left, back = said.count('leaving on'), said.count('home from')
        where['at home' if back == number else 'out' if left == number else 'not left'] += 1
        base.die()
        fleet.wait(gone)
        base.start(resume=str(base.log))
    print(dict(where))
    done = f'done: {ROBOTS} of {ROBOTS} robots deployed'
    field.until(lambda: field.state(f'{MISSION}/planner') == done, done)
    # The planner may be heard before the belief that it is done by.
    field.until(lambda: beliefs[-1].deployments == ROBOTS, 'belief in all')
    assert where['out'] >= len(CRASHES) // 3
    assert sent() == beliefs[-1].deployments == ROBOTS
    assert field.said(f'{MISSION}/scout_1/robot').count('leaving on') == ROBOTS
    field.processes.stop()
    told = replay(base.log)
    assert told.reproduced
    assert not told.evidence.refused
    # What the recorder heard again says what it said before, and is what the robot said.
    on_record = {read_report(logged.message) for logged in read_log(base.log, [REPORT])}
    assert on_record == {read_report(message) for message in heard}
    assert len(on_record) == len({key for key, _ in on_record}) == ROBOTS
    reports = [report for _, report in sorted(on_record, key=itemgetter(0))]
    fleet.see_that_all_is_true(reports)
