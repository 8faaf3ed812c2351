# SPDX-License-Identifier: Apache-2.0
"""
Recorded logs that every later version must replay.

Logs named after a one-pass method are of `demo --robots 8 --size 5x4 --max-steps 8 --seed 3
--method METHOD` by 1.0; those of kinds of hazards, of sampling and `late_return` are by
`recorded_logs.py`. A change to the results of a method needs a new version of it; the kbnitp_ros
that has the earlier one is named.
"""

from collections import Counter
import gzip
import os
from pathlib import Path
import subprocess
import sys

from kbnitp_ros.core import METHODS
from kbnitp_ros.log.files import LogError
from kbnitp_ros.log.history import read_history
from kbnitp_ros.log.record import read_resumed
from kbnitp_ros.log.replay import replay
from kbnitp_ros.log.replayed import Grade
from kbnitp_ros.log.roles import MissionLog
from laws import for_each
import numpy as np
import pytest
from recorded_logs import KINDS

RECORDED = Path(__file__).with_name('recorded')
NAMES = sorted(path.name.partition('.')[0] for path in RECORDED.glob('*.mcap.gz'))
# Instructions that numpy uses beyond the baseline.
EXTENSIONS = np.show_config(mode='dicts')['SIMD Extensions'].get('found')

# A Python without ROS.
WITHOUT_ROS = """
from pathlib import Path
import sys

class NoRos:
    def find_spec(self, name, path=None, target=None):
        if name.split('.')[0].endswith(('_msgs', '_interfaces')) or name.split('.')[0] in (
            'rclpy', 'rosidl_parser', 'rosidl_runtime_py', 'rpyutils', 'ament_index_python'
        ):
            raise ModuleNotFoundError(f'{name} is not installed', name=name)

sys.meta_path.insert(0, NoRos())
from kbnitp_ros.log.history import read_history
from kbnitp_ros.log.replay import replay
from kbnitp_ros.report.tables import mission_curves
from kbnitp_ros.report.mission import read_mission
from kbnitp_ros.report.folder import write_report
for log in sys.argv[1:]:
    found = replay(log)
    print(found.grade.name, found.compared.total(), len(read_history(log).observations))
    mission = read_mission(log)
    if mission.moments[-1].state.numbers:
        write_report(Path(log).parent / 'report', mission, mission_curves(mission))
"""

REPLAY = """
import sys
from kbnitp_ros.__main__ import main

for log in sys.argv[1:]:
    print(main(['replay', log]), end='\\0')
"""


def test_there_is_one_of_each_method_and_kind_of_hazards():
    assert {*METHODS, *KINDS, 'late_return'} == set(NAMES)


def test_a_log_of_an_earlier_sampler_names_the_version_that_replays_it(tmp_path):
    path = tmp_path / 'mission.mcap'
    path.write_bytes(gzip.decompress(RECORDED.with_name('sampled_by_1_0.mcap.gz').read_bytes()))
    with pytest.raises(LogError, match=r'version 2 of kappa_bnitp_sampled.*the log, 1\.0'):
        replay(path)
    assert len(read_history(path).observations) == 8


def log(name, folder):
    path = folder / 'mission.mcap'
    path.write_bytes(gzip.decompress((RECORDED / f'{name}.mcap.gz').read_bytes()))
    return path


def logs(tmp_path):
    for name in NAMES:
        tmp_path.joinpath(name).mkdir()
    return [log(name, tmp_path / name) for name in NAMES]


@for_each('name', NAMES)
def test_every_recorded_log_is_reproduced(name, tmp_path):
    report = replay(log(name, tmp_path))
    assert report.grade != Grade.DIFFERENT, report.mismatches
    assert report.not_compared == report.repeated == report.evidence.refused == []
    assert report.passed_over == report.not_yet_held == []
    # The prior, one per deployment, and one more for a late return.
    beliefs = 7 if name == 'late_return' else 9
    assert report.compared == Counter(
        dict.fromkeys(('/belief', '/belief/hazard', '/belief/target', '/belief/kappa'), beliefs)
        | ({'/model': beliefs} if report.evidence.prior.unknowns.priors else {})
    )


@for_each('name', NAMES)
def test_recorded_deployments_can_be_resumed(name, tmp_path):
    path = log(name, tmp_path)
    history = read_history(path)
    resumed = read_resumed(MissionLog(path), history.evidence.grid, 8)
    assert len(history.observations) == len(resumed.orders) >= 5
    assert {observation.survived for observation in history.observations} == {True, False}
    for each, key in zip(history.observations, resumed.orders):
        assert each.path.tolist() == resumed.paths[key].tolist()


def answers(script, paths, **environment):
    """Return a script's output for each log, and its errors."""
    done = subprocess.run(
        [sys.executable, '-c', script, *paths],
        env=os.environ | environment,
        capture_output=True,
        text=True,
    )
    assert done.returncode == 0, done.stderr
    return done.stdout


@pytest.mark.processes
@pytest.mark.full
def test_recorded_logs_are_read_without_ros(tmp_path):
    paths = logs(tmp_path)
    lines = answers(WITHOUT_ROS, paths).splitlines()
    assert len(lines) == len(NAMES)
    assert all(line.startswith(('IDENTICAL', 'EQUAL')) for line in lines), lines
    # The most detailed output.
    shown = [path for path in paths if path.with_name('report').joinpath('report.html').exists()]
    assert [path.parent.name for path in shown] == ['clustered', 'kappa_bnitp_sampled']


@pytest.mark.processes
@pytest.mark.skipif(not EXTENSIONS, reason='numpy knows one way to compute on this processor')
def test_another_processor_reproduces_it_up_to_rounding(tmp_path):
    """A simpler processor, on which numpy computes logarithms differently."""
    without = ' '.join(EXTENSIONS)
    *replays, end = answers(REPLAY, logs(tmp_path), NPY_DISABLE_CPU_FEATURES=without).split('\0')
    assert len(replays) == len(NAMES)
    assert end == ''
    for name, told in zip(NAMES, replays):
        assert told.endswith('\n0'), (name, told)
        assert 'not reproduced' not in told
        if 'of them within 1e-09' in told:
            assert 'equal within 1e-09, not identical: the largest difference is ' in told
            assert 'made with processor features ' in told
