# SPDX-License-Identifier: Apache-2.0
"""The launch file, the configuration and the RViz view fit the nodes."""

from pathlib import Path
import re
import signal
import subprocess
import sys
import time

from kbnitp_ros.cli.processes import environment, free_domain
from kbnitp_ros.log.bag.reader import LogError, read_log
from kbnitp_ros.log.replay import replay, REPORT
from kbnitp_ros.messages.headers import from_stamp
from kbnitp_ros.nodes.given import read_sections, values_for
from kbnitp_ros.nodes.parameters import NODES, parameters_of
import pytest
import yaml

ROOT = Path(__file__).parents[1]
CONFIG = ROOT / 'config' / 'mission.yaml'
POSES = 'tf2_msgs/msg/TFMessage'

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


@pytest.mark.parametrize('node', NODES)
def test_the_configuration_has_every_parameter_with_its_default(node):
    given = values_for(read_sections(CONFIG), f'/north/{node}')
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


def launched(folder, domain, *arguments):
    """Start the launch file with these arguments; the paths in them are relative to a folder."""
    command = [sys.executable, '-c', LAUNCH, ROOT / 'launch' / 'mission.launch.py', *arguments]
    return subprocess.Popen(command, cwd=folder, env=environment(domain))


def run_until_reported(folder, reports, missions):
    """
    Launch missions, end them as Ctrl-C does when each has so many reports, and check that.

    The missions are the arguments of the launch file by the names of their logs.
    """
    with free_domain() as domain:
        running = [launched(folder, domain, *arguments) for arguments in missions.values()]
        try:
            deadline = time.monotonic() + 30
            while any(reports_in(folder / log) < reports for log in missions):
                assert time.monotonic() < deadline
                assert {mission.poll() for mission in running} == {None}
                time.sleep(0.2)
        finally:
            for mission in running:
                mission.send_signal(signal.SIGINT)
            status = {mission.wait(timeout=60) for mission in running}
    assert status == {0}
    for log in missions:
        report = replay(folder / log)
        assert report.reproduced
        assert len(report.evidence.complete) == reports


@pytest.fixture
def configured(tmp_path):
    """Return a function that changes lines of the configuration, in the file short.yaml."""
    pytest.importorskip('launch_ros', reason='launch comes with an installation of ROS 2 only')

    def change(**values):
        config = CONFIG.read_text()
        for name, value in values.items():
            config = re.sub(rf'(?m)^( *{name}:) \S+', rf'\1 {value}', config)
        (tmp_path / 'short.yaml').write_text(config)

    return change


def test_the_launch_file_runs_a_mission_in_a_namespace_and_goes_on_with_it(tmp_path, configured):
    arguments = ['params_file:=short.yaml', 'namespace:=north']
    configured(robots=3)
    run_until_reported(tmp_path, 3, {'mission.mcap': arguments})
    configured(robots=5)
    run_until_reported(tmp_path, 5, {'mission.mcap': [*arguments, 'resume:=mission.mcap']})


def test_two_teams_are_launched_side_by_side(tmp_path, configured):
    configured(robots=6, publish_pose='true', step_period=0.01)
    teams = {'north': 3, 'south': 2}
    missions = {
        f'{team}.mcap': [
            'params_file:=short.yaml',
            f'namespace:={team}',
            f'agents:={agents}',
            f'file:={team}.mcap',
        ]
        for team, agents in teams.items()
    }
    run_until_reported(tmp_path, 6, missions)
    for team, agents in teams.items():
        logged = read_log(tmp_path / f'{team}.mcap', [REPORT, POSES])
        reports = {f'/{team}/scout_{number + 1}/report' for number in range(agents)}
        assert {each.topic for each in logged} == {*reports, f'/{team}/tf'}


@pytest.mark.parametrize('agents', ['0', 'two'])
def test_the_launch_file_refuses_a_team_of_no_number(tmp_path, configured, agents, capfd):
    with free_domain() as domain:
        assert launched(tmp_path, domain, f'agents:={agents}').wait(timeout=60) == 1
    told = capfd.readouterr().out
    assert f"agents is '{agents}': it must be a whole number, at least 1" in told
