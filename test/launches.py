# SPDX-License-Identifier: Apache-2.0
"""Launch files and commands as processes."""

from contextlib import suppress
import fcntl
import os
from pathlib import Path
import pty
import re
import signal
import struct
import subprocess
import sys
import termios

from kbnitp_ros.cli.processes import environment
from kbnitp_ros.log.read import LogError, read_log
from kbnitp_ros.messages.headers import from_stamp
from kbnitp_ros.messages.topics import REPORT

ROOT = Path(__file__).parents[1]

LAUNCH = """
import sys
from launch import LaunchDescription, LaunchService
from launch.actions import IncludeLaunchDescription
from launch.launch_description_sources import PythonLaunchDescriptionSource

file, *arguments = sys.argv[1:]
service = LaunchService(argv=arguments)
service.include_launch_description(LaunchDescription([IncludeLaunchDescription(
    PythonLaunchDescriptionSource(file),
    launch_arguments=[argument.split(':=') for argument in arguments],
)]))
sys.exit(service.run())
"""


# On a busy machine nodes may end later than launch waits for.
PATIENCE = ('sigterm_timeout:=60', 'sigkill_timeout:=60')


def launched(folder, domain, *arguments, launch_file='mission', **options):
    """Start a launch file with these arguments; their paths are relative to a folder."""
    file = ROOT / 'launch' / f'{launch_file}.launch.py'
    return subprocess.Popen(
        [sys.executable, '-c', LAUNCH, file, *PATIENCE, *arguments],
        cwd=folder,
        env=environment(domain),
        start_new_session=True,
        **options,
    )


def interrupt(mission):
    """Send SIGINT to launch and all its nodes, like a terminal."""
    with suppress(ProcessLookupError):
        os.killpg(mission.pid, signal.SIGINT)


def node_pids(mission):
    children = Path(f'/proc/{mission.pid}/task/{mission.pid}/children').read_text().split()
    found = {}
    for child in children:
        command = Path(f'/proc/{child}/cmdline').read_text()
        names = re.findall(r'__node:=(\w+)\0-r\0__ns:=([/\w]*)', command)
        found |= {f'{space.rstrip("/")}/{name}': int(child) for name, space in names}
    return found


def nodes_of_demo(demo):
    return {
        name: int(child)
        for child in Path(f'/proc/{demo.pid}/task/{demo.pid}/children').read_text().split()
        for name in re.findall(r'kbnitp_ros\0(\w+)', Path(f'/proc/{child}/cmdline').read_text())
    }


def reports_in(log):
    """Return the number of recorded reports; 0 before the recorder has begun."""
    try:
        return len({from_stamp(logged.message.deployment) for logged in read_log(log, [REPORT])})
    except LogError:
        return 0


def run_on_terminal(command):
    """Return the exit code of a command, and what it shows on a terminal as standard error."""
    terminal, screen = pty.openpty()
    fcntl.ioctl(terminal, termios.TIOCSWINSZ, struct.pack('4H', 24, 140, 0, 0))
    with subprocess.Popen(command, stderr=screen) as process:
        os.close(screen)
        shown = b''
        with suppress(OSError):  # a terminal's end
            while chunk := os.read(terminal, 4096):
                shown += chunk
    os.close(terminal)
    return process.returncode, shown.decode()
