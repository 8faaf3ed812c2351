# SPDX-License-Identifier: Apache-2.0
"""Real `robot` nodes whose robots a simulator drives in its own process."""

from collections import defaultdict
from dataclasses import replace
from itertools import groupby
import json
from math import hypot
import os
from pathlib import Path
import signal
import time

from action_msgs.srv import CancelGoal
from forked import ForkedProcess, run_simulator
from kbnitp_msgs.msg import DeploymentReport, Recorded
from kbnitp_ros.core import DeploymentKey, Grid
from kbnitp_ros.messages.deployments import path_message, read_report
from kbnitp_ros.messages.headers import content_hash, from_stamp
from kbnitp_ros.nodes.runtime import qos
from nav_msgs.msg import Path as PathMessage
from std_msgs.msg import Bool, String

SIMULATOR = Path(__file__).with_name('simulator.py')

# 12 m by 12 m with four obstacles, whose corners robots avoid.
GRID = Grid(12, 12, blocked=[26, 27, 50, 64], through_corners=False)
FIELD = {
    'grid.width': 12, 'grid.height': 12, 'grid.blocked': sorted(GRID.blocked),
    'grid.corners': 'avoid', 'max_steps': 20,
}  # fmt: skip
TARGETS = [2, 14, 25, 38, 52, 65]

# Metres from the centre of a cell within which a robot that is sent there arrives.
NEAR = 0.25


class Fleet:
    """Robots in a field, with a record of all their true motion."""

    SOURCES = Path(__file__).parent

    def __init__(
        self,
        field,
        names=('scout_1',),
        speed=5.0,
        mission='',
        detection_type='bool',
        lifecycle=True,
        placed=(0.0, 0.0, 0.0),
        datum=(),
    ):
        self.field = field
        self.grid = replace(GRID, origin=placed[:2], yaw=placed[2])
        self.parameters = {**FIELD, 'grid.origin': list(placed)}
        self._placed = placed
        self._datum = list(datum)
        self._lifecycle = lifecycle
        self.names = names
        self._speed = speed
        self._mission = mission
        self._detection_type = detection_type
        self._talkers = {}
        self.simulator = None
        if not mission:
            self._hold = field.let_depart()
            self.statuses = {name: field.record_departures(name) for name in names}

    def simulate(self, wrong='', **places):
        """Start the simulator; robots begin where they were, or at these x and y."""
        truth = self.truth()
        known = {name: truth[name][-1] for name in self.names if truth[name]}
        begin = dict.fromkeys(self.names, (0.5, 0.5)) | known | places
        config = {
            'width': GRID.width,
            'height': GRID.height,
            'blocked': sorted(GRID.blocked),
            'robots': {f'/{name}': begin[name] for name in self.names},
            'targets': TARGETS,
            'detection_type': self._detection_type,
            'speed': self._speed,
            'lifecycle': self._lifecycle,
            'wrong': wrong,
            'placed': self._placed,
            'datum': self._datum,
            'track': str(self._track),
        }
        file = self.field.folder / 'simulation.json'
        file.write_text(json.dumps(config))
        output = self.field.folder / 'simulator.txt'
        output.touch()
        self.simulator = ForkedProcess(run_simulator, (file,), os.environ.copy(), str(output))
        self.field.processes.started[f'simulator {self.simulator.pid}'] = self.simulator
        self.field._outputs[f'simulator {self.simulator.pid}'] = output

    def start(self, name='scout_1', remapped=None, **parameters):
        given = {
            **self.parameters,
            'agent': name,
            'await_nodes': ['test'],
            'nav_namespace': name,
            'journal': str(self.journal(name)),
            'retry_delay': 0.1,
            'stay_time': 0.3,
            'detection_type': self._detection_type,
            'datum': self._datum,
            **parameters,
        }
        remaps = {
            '/tf': f'/{name}/tf',
            '/tf_static': f'/{name}/tf_static',
            'detections': f'/{name}/detections',
            'fix': f'/{name}/fix',
            **(remapped or {}),
        }
        return self.field.start('robot', given, f'{self._mission}/{name}', remaps)

    def journal(self, name):
        return self.field.folder / f'{name}.journal'

    @property
    def _track(self):
        return self.field.folder / 'track.jsonl'

    def truth(self):
        places = defaultdict(list)
        if self._track.exists():
            for line in self._track.read_text().splitlines():
                namespace, x, y = json.loads(line)
                places[namespace.strip('/')].append((x, y))
        return places

    def walked(self, name='scout_1', since=0, near=NEAR):
        """Return the cells whose centres a robot truly came near, in order."""
        cells = [
            int(y) * GRID.width + int(x)
            for x, y in self.truth()[name][since:]
            if hypot(x % 1 - 0.5, y % 1 - 0.5) < near
        ]
        return moves(cells)

    def is_away(self, name='scout_1'):
        """Return whether a robot truly is outside of the first cell."""
        return max(self.truth()[name][-1]) > 1

    def see_that_it_is_true(self, report, since=0, name='scout_1'):
        """Compare a report with the simulated motion and the true targets."""
        self.see_that_all_is_true([report], since, name)

    def see_that_all_is_true(self, reports, since=0, name='scout_1'):
        """Compare reports of successive deployments as `see_that_it_is_true` does one."""
        cells = [GRID.base]
        for report in reports:
            GRID.check_path([GRID.base, *(cell for cell, _ in report.readings)])
            cells += [cell for cell, _ in report.readings]
            for cell, reading in report.readings:
                assert reading in (cell in TARGETS, -1), (cell, report)
        assert is_within(moves(cells), self.walked(name, since, near=1.0))
        assert is_within(self.walked(name, since), moves(cells))

    def inject(self, what, name='scout_1'):
        talker = self._talker(String, f'/{name}/inject', 10)
        self.field.until(lambda: talker.get_subscription_count() == 1, 'one simulator')
        talker.publish(String(data=what))

    def hold(self, is_held):
        self._hold.publish(Bool(data=is_held))

    def wait(self, seconds):
        end = time.monotonic() + seconds
        self.field.until(lambda: time.monotonic() > end, 'moment', seconds + 60)

    def cancel_all(self, action, name='scout_1'):
        client = self.field.node.create_client(CancelGoal, f'/{name}/{action}/_action/cancel_goal')
        self.field.until(client.service_is_ready, 'service to cancel goals')
        answer = client.call_async(CancelGoal.Request())
        self.field.until(answer.done, 'answer')
        self.field.node.destroy_client(client)
        return len(answer.result().goals_canceling)

    def key(self, number, name='scout_1'):
        return DeploymentKey(name, number * 10**9)

    def send(self, number, cells, name='scout_1', mission=5):
        key = self.key(number, name)
        path = path_message(self.grid, cells, key.stamp, mission)
        self._talker(PathMessage, f'/{name}/path', qos.EVIDENCE).publish(path)
        recorded = Recorded(stamp=path.header.stamp, content=content_hash(path))
        self._talker(Recorded, f'/{name}/recorded', qos.EVIDENCE).publish(recorded)
        return key

    def _talker(self, kind, topic, profile):
        if topic not in self._talkers:
            self._talkers[topic] = self.field.talk(kind, topic, profile)
        return self._talkers[topic]

    def state(self, name='scout_1'):
        return self.field.state(f'{self._mission}/{name}/robot')

    @classmethod
    def simulated(cls, field, **options):
        """Return a fleet of simulated robots, and the list of the first one's reports."""
        fleet = cls(field, **options)
        reports = fleet.reports()
        fleet.simulate()
        return fleet, reports

    def reports(self, name='scout_1'):
        return self.field.listen(DeploymentReport, f'{self._mission}/{name}/report')

    def wait_for_report(self, reports, key, patience=60.0):
        """Wait for the report of a deployment and return it; repetitions must agree."""

        def found():
            return [report for report in reports if from_stamp(report.deployment) == key.stamp]

        self.field.until(found, f'report of {key}', patience)
        said = {read_report(each, key.agent) for each in found()}
        assert len(said) == 1
        ((told, report),) = said
        assert told == key
        assert report.survived
        return report

    def end_simulator(self, by=signal.SIGKILL):
        self.simulator.send_signal(by)
        self.simulator.wait()
        del self.field.processes.started[f'simulator {self.simulator.pid}']


def is_within(few, many):
    """Return whether some cells are in others, in their order."""
    rest = iter(many)
    return all(cell in rest for cell in few)


def moves(cells):
    """Return the cells of a walk without its stays."""
    return [cell for cell, _ in groupby(cells)]
