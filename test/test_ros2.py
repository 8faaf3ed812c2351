# SPDX-License-Identifier: Apache-2.0
"""The lines of `ros2` on the pages run, where it is installed."""

from contextlib import contextmanager
import re
import shlex
import shutil
import subprocess
import time

from documented import ROOT
from kbnitp_ros.cli.processes import environment, free_domain
from kbnitp_ros.log.replay import replay
from launches import interrupt, PATIENCE
import pytest

PAGES = [ROOT / 'README.md', *sorted(ROOT.joinpath('docs').rglob('*.md'))]

# A line of a block, or a command in a sentence or a substitution.
LINE = re.compile(
    r'(?m)^(?: {4})?(?:\w+=\S+ )*(ros2 \w.*)$|`(?:\w+=\S+ )?(ros2 [^`]+)`|\$\((ros2 [^)]+)\)'
)
LINES = sorted(
    {
        ' '.join(''.join(found).split())
        for page in PAGES
        for found in LINE.findall(page.read_text())
    }
)

# Beginnings of lines that this module does not run.
LEFT_OUT = {
    'ros2 bag': 'logs are read by mcap and rosbags, in test/log',
    'ros2 launch nav2_bringup': 'Nav2 is another package',
    'ros2 run rmw_zenoh_cpp': 'Zenoh is another middleware',
    'ros2 security': 'the wheels of Fast DDS have no security',
    'ros2 service call /add_finding': 'test/nodes/test_people.py',
    'ros2 service call /annotate': 'test/nodes/test_people.py',
    'ros2 service call /revoke': 'test/nodes/test_people.py',
    'ros2 service call /take_back': 'test/nodes/test_taken_back.py',
    **{
        f'ros2 service call /{name} ': 'test/nodes/test_operator.py'
        for name in ('approve', 'end_mission', 'give_up', 'no_go', 'pause')
    },
}

# Lines of a running mission, and a text of each answer.
ASKED = {
    'ros2 param dump': '/planner:\n  ros__parameters:',
    'ros2 param set /planner loss_cost 0.5': 'Set parameter successful',
    'ros2 pkg prefix --share kbnitp_ros': 'share/kbnitp_ros',
    'ros2 service call /mission/end_mission std_srvs/srv/Trigger': 'success=True',
    'ros2 topic echo /diagnostics': 'hardware_id: kbnitp_ros',
    'ros2 topic echo /operator': 'action: ',
    'ros2 topic echo /progress': 'reason: ',
    'ros2 topic echo /scout_1/state': 'agent: scout_1',
    'ros2 topic info --verbose TOPIC': 'Durability: TRANSIENT_LOCAL',
}

# Lines that start nodes, and those that run commands on a log.
STARTED = [
    line
    for line in LINES
    if line.startswith('ros2 launch kbnitp_ros')
    or re.fullmatch(r'ros2 run kbnitp_ros (agent|estimator|planner|robot)', line)
]
READ = [line for line in LINES if re.match(r'ros2 run kbnitp_ros (replay|report)\b', line)]
WATCHED = 'ros2 run kbnitp_ros watch --control --namespace /mission'

# What stands in a line for what a page leaves to the reader, and so that it ends by itself.
FILLED = {
    '/etc/kbnitp/mission.yaml': 'short.yaml',
    ':=mission.yaml': ':=short.yaml',
    ':=FILE': ':=short.yaml',
    'runs/TIME/mission.mcap': 'mission.mcap params_file:=short.yaml',
    '/var/lib/kbnitp/mission/mission.mcap': 'mission.mcap',
    'rviz:=true': 'rviz:=false',
    '/mission/end_mission': '/end_mission',
    'TOPIC': '/scout_1/path',
    'param dump': 'param dump /planner',
    'topic echo': 'topic echo --once',
    'kbnitp_ros report': 'kbnitp_ros report mission.mcap --out report',
}


def marked(test):
    """Mark a test that needs `ros2`."""
    needs = pytest.mark.skipif(not shutil.which('ros2'), reason='ros2 is not installed')
    return pytest.mark.processes(pytest.mark.full(needs(test)))


def test_each_line_of_the_pages_is_run_or_left_out():
    run = {*ASKED, *STARTED, *READ, WATCHED}
    assert run <= set(LINES)
    left_out = [line for line in LINES if line.startswith(tuple(LEFT_OUT))]
    # A command without its verb or its arguments runs nothing.
    named = [line for line in LINES if re.fullmatch(r'ros2 \w+', line)]
    assert [line for line in LINES if line not in {*run, *left_out, *named}] == []
    assert [each for each in LEFT_OUT if not any(line.startswith(each) for line in LINES)] == []


def filled(line):
    for name, value in FILLED.items():
        line = line.replace(name, value)
    return shlex.split(line)


@contextmanager
def started(command, folder, domain):
    """Yield a process and the file of its output; interrupt it in the end."""
    output = folder / f'{command[1]}.txt'
    with output.open('wb') as file:
        process = subprocess.Popen(
            command,
            cwd=folder,
            env=environment(domain),
            start_new_session=True,
            stdout=file,
            stderr=subprocess.STDOUT,
        )
    try:
        yield process, output
    finally:
        interrupt(process)
        process.wait(120)


def until_said(process, output, text):
    deadline = time.monotonic() + 120
    while not re.search(text, said := output.read_text()):
        assert process.poll() is None, said
        assert time.monotonic() < deadline, said
        time.sleep(0.1)


def asked(line, folder, domain):
    """Return what a line prints that ends by itself."""
    ended = subprocess.run(
        filled(line),
        cwd=folder,
        env=environment(domain),
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
        timeout=120,
    )
    assert ended.returncode == 0, f'{line}: {ended.stdout}'
    return ended.stdout


def launched_mission(folder, domain, *arguments):
    command = 'ros2 launch kbnitp_ros mission.launch.py params_file:=short.yaml'
    return started([*command.split(), *PATIENCE, *arguments], folder, domain)


def write_parameters(folder):
    """Write the parameters of a short mission."""
    text = ROOT.joinpath('config/mission.yaml').read_text()
    for name, value in {'width': 4, 'height': 4, 'max_steps': 6, 'robots': 3}.items():
        text = re.sub(rf'(?m)^( *)(?:# )?({name}:) \S+(  #.*)?$', rf'\1\2 {value}', text)
    folder.joinpath('short.yaml').write_text(text)


@pytest.fixture(scope='module')
def log(tmp_path_factory):
    """Return the log of a mission that `ros2 launch` started."""
    folder = tmp_path_factory.mktemp('recorded')
    write_parameters(folder)
    with (
        free_domain() as domain,
        launched_mission(folder, domain, 'file:=mission.mcap') as (process, output),
    ):
        assert process.wait(120) == 0, output.read_text()
    report = replay(folder / 'mission.mcap')
    assert report.reproduced
    assert len(report.evidence.standings) == 3
    return folder / 'mission.mcap'


@pytest.fixture
def folder(tmp_path, monkeypatch, log):
    """Return a folder with parameters and a log, which is also the home of journals."""
    write_parameters(tmp_path)
    shutil.copy(log, tmp_path)
    monkeypatch.setenv('HOME', str(tmp_path))
    return tmp_path


@marked
@pytest.mark.parametrize('line', STARTED)
def test_nodes_start_and_end(folder, line):
    command = [*filled(line), *(PATIENCE if 'launch' in line else [])]
    with free_domain() as domain, started(command, folder, domain) as (process, output):
        until_said(process, output, r'\]: (waiting for|.* leaves for|the mission is over)')
    assert process.returncode == 0, output.read_text()


@marked
def test_commands_read_a_log(folder):
    replayed, _ = (asked(line, folder, domain=0) for line in READ)
    assert 'reproduced' in replayed
    assert folder.joinpath('report/report.html').exists()


@marked
def test_a_running_mission_answers(folder):
    arguments = ('agents:=3', 'robots:=100', 'keep_running:=true')
    with (
        free_domain() as domain,
        launched_mission(folder, domain, *arguments) as (process, output),
    ):
        until_said(process, output, r'scout_1 at .* leaves for')
        try:
            answers = {line: asked(line, folder, domain) for line in ASKED}
        finally:
            asked('ros2 daemon stop', folder, domain)
    assert [line for line, text in ASKED.items() if text not in answers[line]] == []
    assert process.returncode == 0


@marked
def test_the_board_finds_a_mission_in_a_namespace(folder):
    with (
        free_domain() as domain,
        launched_mission(folder, domain, 'namespace:=mission', 'keep_running:=true') as base,
    ):
        until_said(*base, 'leaves for')
        with started(filled(WATCHED), folder, domain) as board:
            until_said(*board, r'#token=\w+&act=\w+')
