# SPDX-License-Identifier: Apache-2.0
"""
A recorder that is killed again and again loses no deployment.

With KBNITP_TESTS=full in the environment it is killed while recording 50 times instead of 2, in
three minutes.
"""

from array import array
import time

from extent import FULL
from kbnitp_msgs.msg import BeliefMaps, DeploymentReport, Recorded
from kbnitp_ros.log.files import parts_of
from kbnitp_ros.log.read import is_finished, read_log
from kbnitp_ros.messages.deployments import read_report
from kbnitp_ros.messages.headers import from_stamp
from kbnitp_ros.nodes.runtime import qos
from nav_msgs.msg import Path
import numpy as np
from rclpy.qos import QoSProfile
from rclpy.serialization import serialize_message
from samples import key, lost, path, prior
from std_msgs.msg import UInt8MultiArray

KILLS = 50 if FULL else 2

# All that a publisher keeps for a recorder that comes back.
DEPLOYMENTS = qos.DEPTH

PATH = 'nav_msgs/msg/Path'
REPORT = 'kbnitp_msgs/msg/DeploymentReport'


class Load:
    """Sends deployment after deployment, and much else."""

    def __init__(self, field):
        self._field = field
        self._paths = field.node.create_publisher(Path, '/m/scout_1/path', qos.EVIDENCE)
        self._reports = field.node.create_publisher(
            DeploymentReport, '/m/scout_1/report', qos.EVIDENCE
        )
        self._bulk = field.node.create_publisher(UInt8MultiArray, '/m/bulk', QoSProfile(depth=100))
        self._filling = serialize_message(UInt8MultiArray(data=array('B', bytes(10_000))))
        self.sent = 0

    def send(self, deployments, seconds):
        """Send so many deployments, spread over some time, and the rest as fast as it goes."""
        begun, before = time.monotonic(), self.sent
        while (passed := (time.monotonic() - begun) / seconds) < 1:
            while self.sent < before + deployments * passed:
                self.sent += 1
                self._paths.publish(path(self.sent))
                self._reports.publish(lost(self.sent))
            self._bulk.publish(self._filling)
            self._field.executor.spin_once(timeout_sec=0.001)


def stamps(log, kind):
    """Return which deployments the paths or the reports in a log are about."""
    messages = [logged.message for logged in read_log(log, {kind})]
    if kind == REPORT:
        return {read_report(message)[0].stamp for message in messages}
    return {from_stamp(message.header.stamp) for message in messages}


def test_a_recorder_killed_under_load_loses_no_deployment(field):
    rng = np.random.default_rng(50)
    log = field.folder / 'mission.mcap'
    field.node.create_publisher(BeliefMaps, '/m/belief', qos.LATCHED).publish(prior())
    told = field.listen(Recorded, '/m/scout_1/recorded', volatile=True)
    load = Load(field)
    recorder = field.start('recorder', {'file': str(log), 'max_file_size': 0}, '/m')
    load.send(100, 0.1)
    field.until(lambda: told, 'word of the first path')
    for kills in range(KILLS):
        # A recorder that is killed before it has a file of its own has nothing to lose.
        field.until(lambda kills=kills: len(parts_of(log)) > kills, 'file of the next recorder')
        load.send((DEPLOYMENTS - 100) // (2 * max(KILLS, 10)), rng.uniform(0.5, 2.5))
        recorder.kill()
        recorder.wait()
        parts = parts_of(log)
        if told:
            newest = from_stamp(told[-1].stamp)
            sent = {key(number).stamp for number in range(1, load.sent + 1)}
            # The word may have come from the recorder before the last.
            on_disk = set().union(*(stamps(part, PATH) for part in parts[-2:]))
            assert on_disk >= {stamp for stamp in sent if stamp <= newest}
        told.clear()
        recorder = field.start('recorder', {'resume': str(log), 'max_file_size': 0}, '/m')
    # Word from the one before may still come.
    field.until(lambda: len(parts_of(log)) > KILLS, 'file of the last recorder')
    last = key(load.sent).stamp
    field.until(lambda: told and from_stamp(told[-1].stamp) == last, 'word of the last path')
    field.until(lambda: last in stamps(parts_of(log)[-1], REPORT), 'last report')
    field.processes.stop()
    assert all(is_finished(part) for part in parts_of(log))
    missing = {key(number).stamp for number in range(1, load.sent + 1)} - stamps(log, REPORT)
    print(f'{KILLS} kills, {load.sent} deployments reported, {len(missing)} of them missing')
    assert not missing
    assert load.sent <= DEPLOYMENTS
