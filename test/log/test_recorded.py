# SPDX-License-Identifier: Apache-2.0
"""
Recorded logs that every later version must replay.

`recorded_logs.py` made them, test_day.py the log of `day`, and two robots that Nav2 drove that of
`nav2` (docs/field.md). A change to the results of a method needs a new version of it; the
kbnitp_ros that has the earlier one is named. `recorded_by_1_9.npz` has the evidence of the logs
that 1.9 could read, with the joint after it.
"""

from collections import ChainMap, Counter
import gzip
import json
import os
from pathlib import Path
import re
import subprocess
import sys

from kbnitp_ros.cli.parameters import asked_on_record
from kbnitp_ros.configuration.given import check_sections, values_for
from kbnitp_ros.core import (
    Belief,
    Beta,
    Clustering,
    DeploymentKey,
    Dynamics,
    Estimator,
    Grid,
    Ledger,
    METHODS,
    Report,
    SensorModel,
    Unknowns,
    Verdict,
)
from kbnitp_ros.log.history import read_history
from kbnitp_ros.log.read import read_parameters
from kbnitp_ros.log.record import read_resumed
from kbnitp_ros.log.replay import replay
from kbnitp_ros.log.replayed import Grade
from kbnitp_ros.log.roles import MissionLog
from laws import for_each
import numpy as np
import pytest
from recorded_logs import KINDS
import yaml

ROOT = Path(__file__).parents[2]
RECORDED = Path(__file__).with_name('recorded')
REAL = {'day', 'nav2'}
NAMES = sorted({path.name.partition('.')[0] for path in RECORDED.glob('*.mcap.gz')} - REAL)
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
from kbnitp_ros.report.mission import read_summary
from kbnitp_ros.report.folder import write_report
for log in sys.argv[1:]:
    found = replay(log)
    print(found.grade.name, found.compared.total(), len(read_history(log).observations))
    mission = read_summary(log)
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


EARLIER = np.load(Path(__file__).with_name('recorded_by_1_9.npz'))
EARLIER_NAMES = sorted(name.partition(' ')[0] for name in EARLIER if name.endswith(' joint'))


@for_each('name', EARLIER_NAMES)
def test_the_evidence_of_earlier_logs_gives_the_same_belief(name):
    """Their messages cannot be read any more."""
    rules = json.loads(str(EARLIER[f'{name} rules']))
    grid = Grid(**rules['grid'])
    learnt = {number: Beta(**prior) for number, prior in rules['unknowns'].items()}
    clustering = Clustering(grid, 'learn') if rules['clustering'] else None
    estimator = Estimator(
        Belief(EARLIER[f'{name} prior'], grid),
        SensorModel(**rules['model']),
        rules['method'],
        Unknowns(**learnt),
        rules['seed'],
        dynamics=Dynamics(**rules['dynamics']),
        clustering=clustering,
    )
    ledger = Ledger(grid, rules['max_steps'], estimator)
    for deployment in json.loads(str(EARLIER[f'{name} deployments'])):
        key = DeploymentKey(deployment['agent'], deployment['stamp'])
        readings = zip(deployment['walk'][1:], deployment['readings'] or ())
        ledger.record_path(key, deployment['path'])
        ledger.record_report(
            key,
            Report(
                deployment['survived'],
                tuple(readings),
                steps_survived=deployment['steps_survived'],
                lost_at=tuple(deployment['lost_at'] or ()),
            ),
        )
    np.testing.assert_allclose(ledger.belief.joint, EARLIER[f'{name} joint'], rtol=0, atol=1e-12)


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
    topics = '/belief', '/standings', '/belief/hazard', '/belief/target', '/belief/kappa'
    assert report.compared == Counter(
        dict.fromkeys(topics, beliefs)
        | ({'/model': beliefs} if report.evidence.prior.unknowns.priors else {})
    )


def test_a_day_in_the_field_is_reproduced_with_all_that_people_said(tmp_path):
    path = log('day', tmp_path)
    report = replay(path, asked=asked_on_record(MissionLog(path)))
    assert report.grade != Grade.DIFFERENT, report.mismatches
    assert report.not_compared == report.repeated == report.passed_over == []
    (refused,) = {each.partition(': ')[0] for each in report.evidence.refused}
    assert refused == '/mission/scout_3/state'
    verdicts = Counter(each.verdict for each in report.evidence.standings.values())
    assert verdicts == {Verdict.RETURN: 5, Verdict.LOSS: 2, Verdict.WITHDRAWN: 1}
    assert report.compared['/mission/decision'] > 8


def test_a_mission_with_nav2_is_reproduced(tmp_path):
    """One of two robots was lost and replaced, and the others kept to their paths."""
    path = log('nav2', tmp_path)
    report = replay(path, asked=asked_on_record(MissionLog(path)))
    assert report.grade != Grade.DIFFERENT, report.mismatches
    assert report.not_compared == report.repeated == report.evidence.refused == []
    assert report.passed_over == report.not_yet_held == []
    verdicts = Counter(each.verdict for each in report.evidence.standings.values())
    assert verdicts == {Verdict.RETURN: 3, Verdict.LOSS: 1}
    history = read_history(path)
    resumed = read_resumed(MissionLog(path), history.evidence.grid, 24)
    for key, observation in zip(resumed.orders, history.observations, strict=True):
        assert observation.path.tolist() == resumed.paths[key].tolist()
        # They vouch for all their steps.
        assert observation.entered is None
    assert history.decision.p_free > 0.95


def test_parameters_of_nav2_fit_the_mission_and_are_those_of_the_page(tmp_path):
    nav2 = yaml.safe_load(ROOT.joinpath('config', 'nav2.yaml').read_text())
    controller = nav2['controller_server']['ros__parameters']
    tolerance = controller['general_goal_checker']['xy_goal_tolerance']
    parameters = read_parameters(log('nav2', tmp_path))
    robot = parameters['/mission/scout_1/robot']
    assert tolerance <= min(robot['arrival_tolerance'], robot['grid.resolution'] / 2)
    assert controller['FollowPath']['lookahead_dist'] <= robot['grid.resolution'] / 2
    costmap = nav2['local_costmap']['local_costmap']['ros__parameters']
    assert costmap['robot_radius'] == robot['robot_radius']
    for kind in ('controller', 'goal_checker', 'progress_checker'):
        assert len(controller[f'{kind}_plugins']) == 1
    page = ROOT.joinpath('docs', 'field.md').read_text()
    rows = re.findall(r'^\| `(\w+)\.(\w+)` \| ([\d.]+) \|', page, re.MULTILINE)
    assert len(rows) > 3
    for plugin, name, value in rows:
        assert controller[plugin][name] == float(value), name
    # The parameters of the mission on the page are those on record.
    (shown,) = re.findall(r'```yaml\n(/\*\*:.*?)```', page, re.DOTALL)
    given = values_for(check_sections(yaml.safe_load(shown), {}), '/mission/planner')
    recorded = dict(ChainMap(*parameters.values()))
    assert {name: recorded[name] for name in given} == given


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
