# SPDX-License-Identifier: Apache-2.0
"""
Logs that replay for ever.

Those named after a method are of `demo --robots 8 --size 5x4 --max-steps 8 --seed 3 --method
METHOD` by the first version with these messages; that of `kappa_bnitp_sampled` learns two numbers.
`late_return` is by `late_return.py`. Whoever changes what a method computes gives it a new version
and keeps the one that these are replayed by.
"""

from collections import Counter
import gzip
import os
from pathlib import Path
import subprocess
import sys

from kbnitp_ros.core import METHODS
from kbnitp_ros.log.deployments import read_deployments
from kbnitp_ros.log.history import read_history
from kbnitp_ros.log.replay import replay
from kbnitp_ros.log.replay_report import Grade
import numpy as np
import pytest

RECORDED = Path(__file__).with_name('recorded')
NAMES = sorted(path.name.partition('.')[0] for path in RECORDED.glob('*.mcap.gz'))
# What numpy uses of this processor beside what all have.
EXTENSIONS = np.show_config(mode='dicts')['SIMD Extensions'].get('found')

# A Python in which nothing of ROS is installed.
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
from kbnitp_ros.report import curves_of, read_mission, write_report
log, out = sys.argv[1:]
found = replay(log)
print(found.grade.name, found.compared.total(), len(read_history(log).observations))
mission = read_mission(log)
write_report(Path(out), mission, curves_of(mission))
"""


def test_there_is_one_of_each_method():
    assert {*METHODS, 'late_return'} == set(NAMES)


@pytest.fixture(params=NAMES)
def log(request, tmp_path):
    """Return a log, as it was recorded."""
    tmp_path.joinpath(request.param).touch()
    path = tmp_path / 'mission.mcap'
    path.write_bytes(gzip.decompress((RECORDED / f'{request.param}.mcap.gz').read_bytes()))
    return path


def test_it_is_reproduced(log):
    report = replay(log)
    assert report.grade != Grade.DIFFERENT, report.mismatches
    assert report.not_compared == report.repeated == report.evidence.refused == []
    assert report.passed_over == report.not_yet_held == []
    # The prior, one after each deployment, and one more for a late return.
    beliefs = 7 if log.with_name('late_return').exists() else 9
    assert report.compared == Counter(
        dict.fromkeys(('/belief', '/belief/hazard', '/belief/target', '/belief/kappa'), beliefs)
        | ({'/model': beliefs} if report.prior.unknowns.priors else {})
    )


def test_its_deployments_can_be_gone_on_with(log):
    history = read_history(log)
    deployments = read_deployments(log, history.grid, 8)
    assert len(history.observations) == len(deployments) >= 5
    assert {each.survived for each in history.observations} == {True, False}
    for each, deployment in zip(history.observations, deployments.values()):
        assert each.path.tolist() == deployment.path.tolist()


@pytest.mark.processes
def test_it_is_read_where_ros_is_not_installed(log, tmp_path):
    done = subprocess.run(
        [sys.executable, '-c', WITHOUT_ROS, log, tmp_path / 'report'],
        capture_output=True,
        text=True,
    )
    assert done.returncode == 0, done.stderr
    assert done.stdout.startswith(('IDENTICAL', 'EQUAL'))
    assert tmp_path.joinpath('report', 'report.html').exists()


@pytest.mark.processes
@pytest.mark.skipif(not EXTENSIONS, reason='numpy knows one way to compute on this processor')
def test_another_processor_reproduces_it_up_to_rounding(log):
    """One that can do less, for which numpy computes logarithms otherwise."""
    done = subprocess.run(
        [sys.executable, '-m', 'kbnitp_ros', 'replay', log],
        env={**os.environ, 'NPY_DISABLE_CPU_FEATURES': ' '.join(EXTENSIONS)},
        capture_output=True,
        text=True,
    )
    assert done.returncode == 0, done
    assert 'not reproduced' not in done.stdout
    if 'of them equal to 1e-09' in done.stdout:
        assert 'equal to 1e-09, not identical: the largest difference is ' in done.stdout
        assert 'made with processor features ' in done.stdout
