# SPDX-License-Identifier: Apache-2.0
"""The journal of a robot: a file on its own disk with its deployments."""

from __future__ import annotations

from collections import deque
from contextlib import suppress
from dataclasses import dataclass, field
from errno import ENOENT
import fcntl
from hashlib import sha256
import json
import os
from pathlib import Path
import re
from typing import Any
from uuid import uuid4
import zlib

from kbnitp_ros.core import Grid, Observation
from kbnitp_ros.files import naming, sync_folder
from kbnitp_ros.robot.way import steps_within
import numpy as np

NOT_LOOKED = -1

# Stands for the reading of a step that the robot does not vouch for.
NOT_ENTERED = -2


@dataclass
class Step:
    """A step of a walk, into a cell or staying there."""

    cell: int
    # Time of the step, nanoseconds of ROS time.
    time: int
    # 1 if the detector saw a target in the cell, 0 if it saw none, -1 without a detection.
    reading: int = NOT_LOOKED
    # Whether the robot vouches that it was in the cell; known when it is home.
    is_entered: bool = True


@dataclass
class JournaledDeployment:
    """A deployment: its order, and its walk so far."""

    # Stamp of the path, nanoseconds, which names the deployment.
    stamp: int
    # Start of its mission, nanoseconds.
    mission: int
    # The cells of its path.
    path: tuple[int, ...]
    # Time of the reported departure, nanoseconds; 0 before.
    departed: int = 0
    # The steps made so far.
    steps: list[Step] = field(default_factory=list)
    # Whether the robot is back at its base, after its last step.
    is_home: bool = False

    @property
    def cells(self) -> list[int]:
        """Return the cells of the walk so far, the base first."""
        return [self.path[0], *(step.cell for step in self.steps)]

    def observation(self, most: int) -> Observation:
        """Return the observation of a robot that is home."""
        kept = steps_within(self.cells, most)
        steps = [self.steps[number - 1] for number in kept] or [Step(self.path[0], 0)]
        walk = np.array([self.path[0], *(step.cell for step in steps)], dtype=np.intp)
        readings = np.array([step.reading for step in steps], dtype=np.int8)
        entered = np.array([step.is_entered for step in steps])
        return Observation(walk, True, readings, entered=entered)


# Version of the lines; kbnitp_ros 1.x wrote 1 and 2.
VERSION = 3

# Properties of the field that are recorded; blocked cells are recorded as a hash.
FIELD = ('width', 'height', 'base', 'resolution', 'origin', 'connectivity', 'through_corners')


class Journal:
    """A journal in a file, which is created if it is missing."""

    def __init__(self, path: str | Path, agent: str, grid: Grid) -> None:
        self.path = Path(path).expanduser()
        blocked = ','.join(map(str, sorted(grid.blocked)))
        field = {name: getattr(grid, name) for name in FIELD} | {
            'origin': list(grid.origin),
            'blocked': sha256(blocked.encode()).hexdigest()[:16],
        }
        if grid.yaw:
            field['yaw'] = grid.yaw
        # Content of the first line, apart from the identifier.
        self._heading = {'journal': VERSION, 'agent': agent, 'grid': field}
        self._open()

    def _open(self) -> None:
        """Open and read the file; create it if it is missing."""
        self.deployments: list[JournaledDeployment] = []
        # Refused orders by the stamps of their paths: time, nanoseconds, and reason.
        self.refusals: dict[int, tuple[int, str]] = {}
        # Description of the bytes cut off on opening; empty if the file was whole.
        self.corruption = ''
        # Identifier of this file, by which a base tells robots of one name apart.
        self.id = uuid4().hex
        # Whether lines after the last deployment were corrupt.
        self._is_damaged = False
        # Records that could not be written yet.
        self._unwritten: deque[dict[str, Any]] = deque()
        self._check = 0
        self._size = 0
        self.path.parent.mkdir(parents=True, exist_ok=True)
        self._file = os.open(self.path, os.O_RDWR | os.O_CREAT | os.O_CLOEXEC, 0o644)
        try:
            self._lock()
            is_of_this_field = self._read()
        except BaseException:
            os.close(self._file)
            raise
        if not is_of_this_field:
            self._set_aside()

    @property
    def is_written(self) -> bool:
        """Return whether all records are on the disk."""
        return not self._unwritten

    def _set_aside(self) -> None:
        """Move the file to a folder named after its mission, and begin a new file."""
        kept = self.path.parent / str(self.mission or 0) / self.path.name
        while kept.exists():
            kept = kept.with_name(f'{kept.name}.again')
        with naming(kept):
            kept.parent.mkdir(exist_ok=True)
            self.path.replace(kept)
        for folder in (kept.parent, self.path.parent):
            sync_folder(folder)
        self.close()
        self._open()

    def begin(self, mission: int) -> None:
        """Begin the mission with this start, in nanoseconds, while the robot is at home."""
        self.write()
        if self.mission not in (None, mission):
            self._set_aside()

    def _lock(self) -> None:
        try:
            fcntl.flock(self._file, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError as error:
            raise ValueError(
                f'journal {self.path} is in use by another process: each robot needs its own'
            ) from error

    def _read(self) -> bool:
        """Read the file and cut off its corrupt end; return whether it is for this field."""
        no_journal = (
            f'{self.path} is not the journal of a robot: set the parameter journal to another '
            'file, or move this one away'
        )
        heading: dict[str, Any] = {**self._heading, 'id': self.id}
        with naming(self.path):
            content = os.pread(self._file, os.fstat(self._file).st_size, 0)
        *lines, rest = content.split(b'\n')
        for number, line in enumerate(lines):
            try:
                entry = json.loads(line[9:])
                if journal_line(entry, self._check)[0] != line + b'\n':
                    raise ValueError('the checksum differs')
                if number:
                    self._take(entry)
                elif 'journal' in entry:
                    heading = entry
                else:
                    raise ValueError('it is the first line of another file')
            except (ValueError, KeyError, TypeError, IndexError) as error:
                if not number:
                    raise ValueError(no_journal) from error
                break
            self._check = int(line[:8], 16)
            self._size += len(line) + 1
        if not lines and not self._is_torn_heading(rest.rstrip(b'\0')):
            raise ValueError(no_journal)
        differing = [name for name, wanted in self._heading.items() if heading.get(name) != wanted]
        if 'journal' in differing:
            raise ValueError(
                f'journal {self.path} is of version {heading["journal"]}, and this node reads '
                f'version {VERSION}: end its mission with the kbnitp_ros that wrote it (1.9 or '
                'earlier), or move it away'
            )
        self.id = heading['id']
        # A robot that is at home may begin on another field.
        if differing and (differing != ['grid'] or self.under_way):
            name = differing[0]
            raise ValueError(
                f'journal {self.path} was written with {name} {json.dumps(heading[name])}, and '
                f'this node has {json.dumps(self._heading[name])}: set the parameter journal to '
                'another file, or move this one away'
            )
        whole = self._size
        is_damaged = self._cut(content[whole:])
        if self._size == 0:
            self._append(heading)
            # A new file survives a power loss only if its folder is synced, too.
            sync_folder(self.path.parent)
        if is_damaged:
            self._append({'corrupt': len(content) - whole})
            self._is_damaged = True
        return not differing

    def _is_torn_heading(self, rest: bytes) -> bool:
        """Return whether bytes begin like a first line: a power loss may cut it."""
        heading = json.dumps(self._heading, separators=(',', ':')).encode()[:-1]
        # The checksum and the identifier of that line are not known.
        check, text = rest[:9], rest[9:]
        return bool(re.fullmatch(rb'[0-9a-f]{0,8}|[0-9a-f]{8} ', check)) and (
            heading.startswith(text) or text.startswith(heading)
        )

    def _take(self, entry: dict[str, Any]) -> None:
        """Apply a line of the file."""
        if 'deployment' in entry:
            path = tuple(entry['orders'])
            self._is_damaged = False
            self.deployments.append(
                JournaledDeployment(entry['deployment'], entry['mission'], path, entry['departed'])
            )
        elif 'refused' in entry:
            self.refusals[entry['refused']] = entry['time'], entry['reason']
        elif 'step' in entry:
            steps, number = self.deployments[-1].steps, entry['step']
            if not 1 <= number <= len(steps) + 1:
                raise ValueError(f'step {number} follows step {len(steps)}')
            step = Step(entry['cell'], entry['time'], entry['reading'])
            before = number - 1
            steps[before:number] = [step]
        elif 'home' in entry:
            deployment = self.deployments[-1]
            for step, reading in zip(deployment.steps, entry['evidence']):
                step.is_entered = reading != NOT_ENTERED
                step.reading = max(reading, NOT_LOOKED)
            deployment.is_home = True
        elif 'corrupt' in entry:
            self._is_damaged = True
        else:
            raise ValueError('the line is of no known kind')

    def _cut(self, corrupt: bytes) -> bool:
        """Cut off corrupt bytes at the end; keep lines in a file, and return if there are any."""
        if not corrupt:
            return False
        has_lines = b'\n' in corrupt
        self.corruption = f'journal {self.path}: its last {len(corrupt)} bytes were cut off'
        if has_lines:
            kept = self.path.with_name(f'{self.path.name}.corrupt-{self._size}')
            with naming(kept), kept.open('wb') as file:
                file.write(corrupt)
                file.flush()
                os.fsync(file.fileno())
            sync_folder(self.path.parent)
            self.corruption += f', since they are corrupt, and kept as {kept}'
        else:
            self.corruption += ': the power was lost while they were written'
        with naming(self.path):
            os.ftruncate(self._file, self._size)
            os.fsync(self._file)
        return has_lines

    @property
    def mission(self) -> int | None:
        """Return the start of the journal's mission, nanoseconds; None without deployments."""
        return self.deployments[-1].mission if self.deployments else None

    @property
    def under_way(self) -> JournaledDeployment | None:
        """Return the deployment in flight; None if the robot is home."""
        newest = self.deployments[-1] if self.deployments else None
        return None if newest is None or newest.is_home else newest

    def may_lack(self, deployment: JournaledDeployment) -> bool:
        """Return whether a deployment may have been in lines that were cut off."""
        return self._is_damaged and self.mission in (None, deployment.mission)

    def depart(self, deployment: JournaledDeployment) -> None:
        """Record a deployment, before its departure is reported."""
        self.write()
        self._append(
            {
                'deployment': deployment.stamp,
                'mission': deployment.mission,
                'orders': list(deployment.path),
                'departed': deployment.departed,
            }
        )
        self.deployments.append(deployment)
        self._is_damaged = False

    def refuse(self, stamp: int, time: int, reason: str) -> None:
        """Record that the robot refuses an order for good, with time and reason."""
        self.write()
        self._append({'refused': stamp, 'time': time, 'reason': reason})
        self.refusals[stamp] = time, reason

    def step(self, deployment: JournaledDeployment, number: int) -> None:
        """Record a step of a deployment; raise OSError as `write` does."""
        step = deployment.steps[number - 1]
        self._unwritten.append(
            {
                'step': number,
                'cell': step.cell,
                'time': step.time,
                'reading': step.reading,
            }
        )
        self.write()

    def arrive(self, deployment: JournaledDeployment, time: int) -> None:
        """Record that the robot is home, and the evidence of its steps, as `write` does."""
        deployment.is_home = True
        evidence = [step.reading if step.is_entered else NOT_ENTERED for step in deployment.steps]
        self._unwritten.append({'home': time, 'evidence': evidence})
        self.write()

    def write(self) -> None:
        """Write pending records to the disk; raise OSError if that fails."""
        while self._unwritten:
            self._append(self._unwritten[0])
            self._unwritten.popleft()

    def _append(self, entry: dict[str, Any]) -> None:
        """Write a line to the disk, completely or not at all."""
        line, check = journal_line(entry, self._check)
        if not os.fstat(self._file).st_nlink:
            raise FileNotFoundError(ENOENT, 'The file was deleted', str(self.path))
        try:
            written = 0
            with naming(self.path):
                while written < len(line):
                    written += os.pwrite(self._file, line[written:], self._size + written)
                os.fsync(self._file)
        except OSError:
            with suppress(OSError):
                os.ftruncate(self._file, self._size)
            raise
        self._size += len(line)
        self._check = check

    def close(self) -> None:
        """Close the file, and release it for other processes."""
        os.close(self._file)


def journal_line(entry: dict[str, Any], before: int) -> tuple[bytes, int]:
    """Return a line of a journal and its checksum; `before` is the checksum of the last line."""
    text = json.dumps(entry, separators=(',', ':')).encode()
    check = zlib.crc32(text, before)
    return b'%08x %s\n' % (check, text), check
