# SPDX-License-Identifier: Apache-2.0
"""The launch file, the configuration and the RViz view fit the nodes."""

import os
from pathlib import Path
import re
from shutil import which
import signal
import subprocess
from subprocess import DEVNULL
import time

from kbnitp_ros.cli.parameters import node_values
from kbnitp_ros.cli.processes import environment, free_domain, Processes
from kbnitp_ros.configuration import node_parameters, NODES
from kbnitp_ros.configuration.given import read_sections, values_for
from kbnitp_ros.configuration.table import IN_FIELD
from kbnitp_ros.log.read import read_log, read_parameters
from kbnitp_ros.log.replay import replay
from kbnitp_ros.messages.topics import REPORT
from launches import interrupt, launched, node_pids, reports_in
from laws import for_each
import pytest

ROOT = Path(__file__).parents[1]
CONFIG = ROOT / 'config' / 'mission.yaml'
POSES = 'tf2_msgs/msg/TFMessage'


@for_each('node', NODES)
def test_the_configuration_has_every_parameter_with_its_default(node):
    given = values_for(read_sections(CONFIG), f'/north/{node}')
    table = node_parameters(node)
    # Lines of parameters with other defaults in the field are comments.
    assert table.keys() - given.keys() == table.keys() & IN_FIELD.keys()
    assert {name: table[name].check(given[name]) for name in table.keys() & given.keys()} == {
        name: table[name].default for name in table.keys() - IN_FIELD.keys()
    }


@for_each('name, file', [('kbnitp-base', 'base'), ('kbnitp-robot@', 'robot')])
def test_units_of_systemd_give_launch_files_arguments_that_they_take(name, file):
    unit = ROOT.joinpath('config/systemd', f'{name}.service').read_text()
    assert f'ros2 launch kbnitp_ros {file}.launch.py' in unit
    sources = (ROOT / 'launch' / f'{file}.launch.py', ROOT / 'kbnitp_ros/launching.py')
    known = ''.join(source.read_text() for source in sources)
    arguments = set(re.findall(r'(\w+):=', unit))
    assert {'namespace', 'params_file'} <= arguments
    assert [argument for argument in arguments if f"'{argument}'" not in known] == []


def run_until_over(folder, reports, missions):
    """Launch missions, and check that each ends with its number of reports."""
    with free_domain() as domain:
        running = [launched(folder, domain, *arguments) for arguments in missions.values()]
        try:
            assert {mission.wait(timeout=120) for mission in running} == {0}
        finally:
            for mission in running:
                interrupt(mission)
    for log in missions:
        assert_is_whole(folder / log, reports)
        assert not replay(folder / log).not_yet_held


def assert_is_whole(log, reports):
    """Check that a log is reproduced, and its number of deployments."""
    report = replay(log)
    assert report.reproduced
    assert len(report.evidence.standings) == reports


@pytest.fixture
def configured(tmp_path):
    pytest.importorskip('launch_ros', reason='launch comes with an installation of ROS 2 only')

    def change(**values):
        config = CONFIG.read_text()
        # Planning takes no time, so that nodes end quickly.
        for name, value in {'width': 4, 'height': 4, 'max_steps': 6, **values}.items():
            config = re.sub(rf'(?m)^( *)(?:# )?({name}:) \S+(  #.*)?$', rf'\1\2 {value}', config)
        (tmp_path / 'short.yaml').write_text(config)

    return change


@pytest.mark.processes
def test_the_launch_file_runs_and_resumes_a_mission_in_a_namespace(tmp_path, configured):
    arguments = ['params_file:=short.yaml', 'namespace:=north', 'file:=mission.mcap']
    configured(robots=3)
    run_until_over(tmp_path, 3, {'mission.mcap': arguments})
    configured(robots=5)
    run_until_over(tmp_path, 5, {'mission.mcap': [*arguments, 'resume:=mission.mcap']})


@pytest.mark.processes
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
    run_until_over(tmp_path, 6, missions)
    for team, agents in teams.items():
        logged = read_log(tmp_path / f'{team}.mcap', [REPORT, POSES])
        reports = {f'/{team}/scout_{number + 1}/report' for number in range(agents)}
        assert {each.topic for each in logged} == {*reports, f'/{team}/tf'}


@pytest.mark.processes
def test_a_finished_mission_stays_on_request_and_takes_options(tmp_path, configured):
    configured(robots=1000)
    log = tmp_path / 'mission.mcap'
    arguments = ['params_file:=short.yaml', 'file:=mission.mcap', 'robots:=2', 'max_steps:=4']
    with free_domain() as domain:
        mission = launched(tmp_path, domain, *arguments, 'keep_running:=true')
        try:
            deadline = time.monotonic() + 120
            while reports_in(log) < 2:
                assert time.monotonic() < deadline
                time.sleep(0.2)
            time.sleep(1)
            assert mission.poll() is None
        finally:
            interrupt(mission)
        assert mission.wait(timeout=120) == 0
    assert_is_whole(log, 2)
    parameters = read_parameters(log)
    assert parameters['/planner']['max_steps'] == parameters['/estimator']['max_steps'] == 4


@pytest.mark.processes
@pytest.mark.usefixtures('configured')
def test_a_robot_is_launched_in_its_namespaces(tmp_path):
    given = {
        'namespace': 'north',
        'nav_namespace': '/',
        'agent': 'scout_7',
        'journal': tmp_path / 'journal',
        'params_file': CONFIG,
    }
    arguments = [f'{name}:={value}' for name, value in given.items()]
    with free_domain() as domain, tmp_path.joinpath('said').open('wb') as output:
        robot = launched(
            tmp_path, domain, *arguments, launch_file='robot', stdout=output, stderr=output
        )
        try:
            end = time.monotonic() + 60
            while 'waiting for' not in (said := tmp_path.joinpath('said').read_text()):
                assert robot.poll() is None, said
                assert time.monotonic() < end, said
                time.sleep(0.1)
        finally:
            interrupt(robot)
        assert robot.wait(60) == 0
    assert 'waiting for planner and' in said or 'waiting for planner to' in said
    assert '/north/scout_7/report' in said
    assert '"agent":"scout_7"' in tmp_path.joinpath('journal').read_text()


@pytest.mark.processes
def test_the_base_of_a_mission_is_launched_without_robots(tmp_path, configured):
    configured()
    arguments = ['params_file:=short.yaml', 'file:=mission.mcap', 'robots:=3', 'agents:=ada']
    with free_domain() as domain, Processes(domain) as robots:
        base = launched(tmp_path, domain, *arguments, launch_file='base')
        try:
            sections = read_sections(tmp_path / 'short.yaml')
            own = {'agent': 'ada', 'agents': ['ada'], 'recorded': True}
            values = node_values(sections, ['agent'])['agent']
            robots.start('agent', {**values, **own}, output=DEVNULL)
            assert base.wait(timeout=120) == 0
        finally:
            interrupt(base)
    assert_is_whole(tmp_path / 'mission.mcap', 3)
    # The file is for simulated robots, which return at once.
    planner = read_parameters(tmp_path / 'mission.mcap')['/planner']
    assert planner['silent_loss']
    assert (planner['step_period'], planner['return_deadline']) == (5.0, 60.0)


@pytest.mark.processes
@pytest.mark.skipif(not which('ros2'), reason='ros2 comes with an installation of ROS 2 only')
@pytest.mark.parametrize('file, arguments, code, told', [
    ('mission', ['params_file:=short.yaml', 'robots:=2'], 0, 'process has finished cleanly'),
    ('mission', ['robot:=2'], 1, 'launch argument robot is unknown: did you mean robots?'),
    ('base', ['params_file:=none.yaml'], 1, 'none.yaml: No such file or directory'),
])  # fmt: skip
def test_ros2_launch_ends_by_itself(tmp_path, configured, file, arguments, code, told):
    configured()
    with free_domain() as domain:
        ended = subprocess.run(
            ['ros2', 'launch', 'kbnitp_ros', f'{file}.launch.py', *arguments],
            cwd=tmp_path,
            env=environment(domain),
            timeout=120,
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT,
            text=True,
        )
    assert ended.returncode == code
    assert told in ended.stdout


INCLUDING = f"""
from launch import LaunchDescription
from launch.actions import GroupAction, IncludeLaunchDescription
from launch_ros.actions import PushROSNamespace

def generate_launch_description():
    given = {{'params_file': 'short.yaml', 'namespace': 'inner'}}.items()
    file = '{ROOT}/launch/mission.launch.py'
    ours = IncludeLaunchDescription(file, launch_arguments=given)
    return LaunchDescription([GroupAction([PushROSNamespace('fleet'), ours])])
"""


@pytest.mark.processes
def test_a_launch_file_that_includes_ours_has_arguments_and_a_namespace_of_its_own(
    tmp_path, configured
):
    configured(robots=2)
    with (tmp_path / 'short.yaml').open('a') as config:
        config.write('/fleet/inner/recorder: {ros__parameters: {file: mission.mcap}}\n')
    (tmp_path / 'including.launch.py').write_text(INCLUDING)
    with free_domain() as domain:
        names = ('world', 'map', 'site', 'use_rviz', 'model', 'respawn')
        arguments = [f'{name}:=mine' for name in names]
        mission = launched(tmp_path, domain, *arguments, launch_file=tmp_path / 'including')
        assert mission.wait(timeout=120) == 0
    assert '/fleet/inner/planner' in read_parameters(tmp_path / 'mission.mcap')


LATE = '/planner: {ros__parameters: {}}\n/**/planner: {ros__parameters: {robots: 5}}\n'


@pytest.mark.processes
@pytest.mark.parametrize('arguments, content, told', [
    (['params_file:=none.yaml'], '', 'parameter file none.yaml: No such file or directory'),
    ([], '/**/plannr: {ros__parameters: {robots: 3}}', "'/**/plannr' names no node: did you"),
    ([], 'recorder: {ros__parameters: {step_period: 1.0}}', 'step_period is unknown to the recor'),
    (['robots:=3'], LATE, 'robots:=3 has no effect'),
    (['robots:=-1'], '', 'parameter robots is -1: it must be from 0 to 20000'),
    (['allocation:=fair'], '', "allocation is 'fair': it must be one of"),
    (['lose_cost:=1'], '', 'launch argument lose_cost is unknown: did you mean loss_cost?'),
    *((['agents:=' + each], '', f"agents is '{each}': it must be a whole number, at least 1, or")
      for each in ('0', '-1', 'a b')),
    (['file:=mission.mcap'], None, 'mission.mcap exists and is not overwritten: name'),
])  # fmt: skip
def test_bad_arguments_of_launch_start_no_node(tmp_path, configured, arguments, content, told):
    (tmp_path / 'mission.mcap').touch()
    if content:
        (tmp_path / 'own.yaml').write_text(content)
        arguments = ['params_file:=own.yaml', *arguments]
    with free_domain() as domain:
        mission = launched(
            tmp_path,
            domain,
            *arguments,
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT,
            text=True,
        )
        said, _ = mission.communicate(timeout=120)
    assert mission.returncode == 1
    assert told in said
    # Only the recorder sees that a log exists.
    assert ('process started' in said) == (content is None)
    assert ('the mission failed: recorder-1 ended with exit code 2' in said) == (content is None)


def launched_until(folder, domain, condition, *arguments):
    """Launch a mission; return it and its log with a default name, once a condition holds."""
    mission = launched(folder, domain, *arguments)
    deadline = time.monotonic() + 120
    while not (logs := list(folder.glob('runs/*/mission.mcap'))) or not condition(*logs):
        assert time.monotonic() < deadline
        assert mission.poll() is None
        time.sleep(0.1)
    return mission, *logs


@pytest.mark.processes
def test_two_missions_in_a_folder_have_logs_of_their_own(tmp_path, configured):
    configured(robots=2)
    for _ in range(2):
        with free_domain() as domain:
            mission = launched(tmp_path, domain, 'params_file:=short.yaml')
            assert mission.wait(timeout=120) == 0
    logs = list(tmp_path.glob('runs/*/mission.mcap'))
    assert [replay(log).reproduced for log in logs] == [True, True]


@pytest.mark.processes
def test_a_node_of_a_recorded_mission_that_dies_resumes_from_its_log(tmp_path, configured):
    configured(robots=1000, step_period=0.02)
    with free_domain() as domain:
        arguments = ['params_file:=short.yaml', 'agents:=2', 'namespace:=north']
        mission, log = launched_until(tmp_path, domain, reports_in, *arguments)
        for name in ('estimator', 'scout_2/agent', 'recorder', 'planner'):
            before, deadline = reports_in(log), time.monotonic() + 120
            os.kill(node_pids(mission)[f'/north/{name}'], signal.SIGKILL)
            while reports_in(log) < before + 5 or f'/north/{name}' not in node_pids(mission):
                assert time.monotonic() < deadline, name
                assert mission.poll() is None
                time.sleep(0.2)
        interrupt(mission)
        assert mission.wait(timeout=120) == 0
    assert replay(log).reproduced


@pytest.mark.processes
def test_a_node_of_an_unrecorded_mission_ends_it_when_it_dies(tmp_path, configured):
    configured(robots=1000, step_period=0.02)
    with free_domain() as domain:
        mission = launched(
            tmp_path, domain, 'params_file:=short.yaml', 'agents:=2', 'record:=false'
        )
        deadline = time.monotonic() + 120
        while len(node_pids(mission)) < 4:
            assert time.monotonic() < deadline
            time.sleep(0.1)
        os.kill(node_pids(mission)['/scout_2/agent'], signal.SIGKILL)
        time.sleep(2)
        # The other agents of a team continue.
        assert mission.poll() is None
        os.kill(node_pids(mission)['/estimator'], signal.SIGKILL)
        assert mission.wait(timeout=120) == 1


@pytest.mark.processes
@pytest.mark.parametrize('trial', range(5))
def test_any_number_of_interrupts_ends_a_mission(tmp_path, configured, trial):
    with free_domain() as domain:
        mission = launched(tmp_path, domain)
        deadline = time.monotonic() + 120
        while len(node_pids(mission)) < 4:
            assert time.monotonic() < deadline
        for _ in range(200):
            interrupt(mission)
            time.sleep(0.003)
        try:
            # The last interrupts may meet a Python that is ending.
            assert mission.wait(timeout=120) in (0, 1, -signal.SIGINT)
        finally:
            mission.kill()
