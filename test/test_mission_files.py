# SPDX-License-Identifier: Apache-2.0
"""The launch file, the configuration and the RViz view fit the nodes."""

from pathlib import Path
import signal
import subprocess
import sys
import time

from kbnitp_ros.cli.processes import environment, free_domain
from kbnitp_ros.log.reader import LogError, read_log
from kbnitp_ros.log.replay import replay, REPORT
from kbnitp_ros.messages.headers import from_stamp
from kbnitp_ros.nodes.parameters import check_config, NODES, parameters_of
import pytest
import yaml

ROOT = Path(__file__).parents[1]
CONFIG = ROOT / 'config' / 'mission.yaml'

LAUNCH = """
import sys
from launch import LaunchDescription, LaunchService
from launch.actions import IncludeLaunchDescription
from launch.launch_description_sources import PythonLaunchDescriptionSource

file, *arguments = sys.argv[1:]
service = LaunchService()
service.include_launch_description(LaunchDescription([IncludeLaunchDescription(
    PythonLaunchDescriptionSource(file),
    launch_arguments=[argument.split(':=') for argument in arguments],
)]))
sys.exit(service.run())
"""


def flattened(tree, prefix=''):
    for key, value in tree.items():
        if isinstance(value, dict):
            yield from flattened(value, f'{prefix}{key}.')
        else:
            yield prefix + key, value


@pytest.mark.parametrize('node', NODES)
def test_the_configuration_has_every_parameter_with_its_default(node):
    config = yaml.safe_load(CONFIG.read_text())
    check_config(config)
    sections = [config['/**'], config[f'/**/{node}']]
    given = dict(pair for each in sections for pair in flattened(each['ros__parameters']))
    table = parameters_of(node)
    assert {name: table[name].check(given.get(name)) for name in table} == {
        name: parameter.default for name, parameter in table.items()
    }


@pytest.mark.parametrize('name, agents', [('mission', 1), ('team', 8)])
def test_rviz_shows_beliefs_paths_and_readings_to_a_late_joiner(name, agents):
    view = yaml.safe_load((ROOT / 'rviz' / f'{name}.rviz').read_text())['Visualization Manager']
    assert view['Global Options']['Fixed Frame'] == 'map'
    displays = [each for each in view['Displays'] if not each['Class'].endswith('/TF')]
    assert len(view['Displays']) == len(displays) + (agents > 1)
    topics = {display['Topic']['Value']: display for display in displays}
    scouts = [f'scout_{number}' for number in range(1, agents + 1)]
    assert {topic: display['Class'].split('/')[1] for topic, display in topics.items()} == {
        'belief/hazard': 'Map',
        'belief/target': 'Map',
        'belief/kappa': 'Map',
        **{f'{scout}/path': 'Path' for scout in scouts},
        **{f'{scout}/readings': 'Marker' for scout in scouts},
    }
    for display in topics.values():
        assert display['Enabled']
        assert display['Topic']['Durability Policy'] == 'Transient Local'
        assert display['Topic']['Reliability Policy'] == 'Reliable'


def reports_in(log):
    """Return how many deployments are reported on disk; 0 before the recorder has begun."""
    try:
        return len({from_stamp(each.message.deployment) for each in read_log(log, [REPORT])})
    except LogError:
        return 0


def launch(folder, *arguments, until):
    """Launch a mission, end it as Ctrl-C does when its log has so many reports, and check that."""
    command = [sys.executable, '-c', LAUNCH, ROOT / 'launch' / 'mission.launch.py', *arguments]
    log = folder / 'mission.mcap'
    with free_domain() as domain:
        mission = subprocess.Popen(command, cwd=folder, env=environment(domain))
        try:
            deadline = time.monotonic() + 30
            while reports_in(log) < until and mission.poll() is None:
                assert time.monotonic() < deadline
                time.sleep(0.2)
        finally:
            mission.send_signal(signal.SIGINT)
            status = mission.wait(timeout=15)
    assert status == 0
    report = replay(log)
    assert report.reproduced
    assert len(report.evidence.complete) == until
    assert '/north/belief' in report.compared


def test_the_launch_file_runs_a_mission_in_a_namespace_and_goes_on_with_it(tmp_path):
    pytest.importorskip('launch_ros', reason='launch comes with an installation of ROS 2 only')
    config = tmp_path / 'short.yaml'
    arguments = [f'params_file:={config}', 'namespace:=north']
    config.write_text(CONFIG.read_text().replace('robots: 100', 'robots: 3'))
    launch(tmp_path, *arguments, until=3)
    config.write_text(CONFIG.read_text().replace('robots: 100', 'robots: 5'))
    launch(tmp_path, *arguments, 'resume:=mission.mcap', until=5)


def test_the_launch_file_runs_a_team(tmp_path):
    pytest.importorskip('launch_ros', reason='launch comes with an installation of ROS 2 only')
    config = tmp_path / 'short.yaml'
    config.write_text(CONFIG.read_text().replace('robots: 100', 'robots: 6'))
    launch(tmp_path, f'params_file:={config}', 'namespace:=north', 'agents:=3', until=6)
    topics = {logged.topic for logged in read_log(tmp_path / 'mission.mcap', [REPORT])}
    assert topics == {f'/north/scout_{number}/report' for number in (1, 2, 3)}
