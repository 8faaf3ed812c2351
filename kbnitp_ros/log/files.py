# SPDX-License-Identifier: Apache-2.0
"""The files of a log, their errors, and the lock that excludes a second writer."""

from __future__ import annotations

from collections.abc import Mapping
from datetime import datetime
import fcntl
from functools import lru_cache
import os
from pathlib import Path, PurePath
import re
import time
from typing import Any, IO

from kbnitp_ros.files import NotYamlError, read_yaml


class LogError(ValueError):
    """A file is not a mission log or is corrupt, or files are parts of different logs."""


SUFFIXES = ('.mcap', '.db3')
METADATA = 'metadata.yaml'
INFORMATION = 'rosbag2_bagfile_information'

# Suffix of the names of later parts: at most five digits, since a date has more.
NUMBER = r'_([1-9]\d{0,4})'


# Names of the parts of a log by rosbag2 from 0.33 on: number, name of the log, and date.
SPLIT = re.compile(r'(\d{1,5})_(.+)_\d{4}_\d\d_\d\d-\d\d_\d\d_\d\d')


def log_parts(path: str | Path) -> list[Path]:
    """Return the files of a log in order, from its first file or its folder."""
    path = Path(path)
    try:
        if not path.is_dir():
            return [path] if is_later_part(path) else with_later_parts(path)
        files = sorted(file for file in path.iterdir() if file.suffix in SUFFIXES)
        listed = [path / name for name in listed_parts(path)]
        if listed and not listed[0].exists():
            raise LogError(
                f'{listed[0]}, which {METADATA} lists, is missing: restore it, or name '
                'all other parts one by one'
            )
        firsts = [*listed[:1], *(file for file in files if not is_later_part(file))]
        if not firsts:
            raise LogError(f'{path} holds no log: there is no file *.mcap or *.db3 in it')
        parts = with_later_parts(firsts[0])
        if others := [file.name for file in files if file not in parts]:
            raise LogError(
                f'{path} holds {parts[0].name} and {others[0]}, which belong to different logs: '
                'name the first file of one log'
            )
    except OSError as error:
        raise LogError(f'{path} cannot be read: {error.strerror}') from error
    return parts


def with_later_parts(first: Path) -> list[Path]:
    """Return the first file of a log and its later parts."""
    listed = listed_parts(first.parent)
    if not listed and (split := SPLIT.fullmatch(first.stem)):
        return with_later_splits(first, split)
    names = listed if first.name in listed[:1] else [first.name]
    numbers = [number for number, file in numbered(first).items() if file.name not in names]
    names += [part_path(first, number).name for number in range(1, max(numbers, default=0) + 1)]
    parts = [first.with_name(name) for name in dict.fromkeys(names)]
    if missing := [part.name for part in parts[1:] if not part.exists()]:
        raise LogError(
            f'{missing[0]} of the log {first} is missing: restore it, or name each part'
        )
    return parts


def with_later_splits(first: Path, split: re.Match[str]) -> list[Path]:
    """Return the parts of a log that rosbag2 split, from a file of it on."""
    parts: dict[int, Path] = {}
    for file in first.parent.iterdir():
        other = SPLIT.fullmatch(file.stem)
        if other and other[2] == split[2] and file.suffix == first.suffix:
            if int(other[1]) in parts:
                raise LogError(
                    f'{file.parent} holds {parts[int(other[1])].name} and {file.name}, which '
                    'belong to different logs: move one of them to another folder'
                )
            parts[int(other[1])] = file
    if int(split[1]) > 0:
        return [first]
    if missing := sorted({*range(max(parts))} - parts.keys()):
        raise LogError(
            f'part {missing[0]} of the log {first} is missing: restore it, or name each part'
        )
    return [parts[number] for number in sorted(parts)]


def part_note(path: str | Path) -> str:
    """Return a note if a file is a later part of a log, which is read alone; else ''."""
    path = Path(path)
    if path.is_dir() or not is_later_part(path):
        return ''
    return f'{path} is one file of several of a log: name the folder {path.parent} to read all'


def numbered(first: Path) -> dict[int, Path]:
    """Return the files of later parts, by number."""
    pattern = re.compile(re.escape(base(first)) + NUMBER + re.escape(first.suffix))
    matches = ((file, pattern.fullmatch(file.name)) for file in first.parent.iterdir())
    return {int(match[1]): file for file, match in matches if match}


def part_path(first: Path, number: int) -> Path:
    """Return the path of a later part, numbered from 1."""
    return first.with_name(f'{base(first)}_{number}{first.suffix}')


def base(first: Path) -> str:
    """Return the prefix that the names of all parts share."""
    return first.stem.removesuffix('_0')


def is_later_part(path: Path) -> bool:
    """Return whether the file is a later part of a log beside it."""
    if (split := SPLIT.fullmatch(path.stem)) and int(split[1]) > 0:
        return any(
            (first := SPLIT.fullmatch(file.stem)) and int(first[1]) == 0 and first[2] == split[2]
            for file in path.parent.iterdir()
        )
    match = re.fullmatch(f'(.+){NUMBER}', path.stem)
    return match is not None and any(
        path.with_name(f'{match[1]}{zero}{path.suffix}').exists() for zero in ('', '_0')
    )


def listed_parts(folder: Path) -> list[str]:
    """Return the files listed in metadata.yaml; none if all were renamed."""
    information = read_information(folder)
    mode = str(information.get('compression_mode') or 'none')
    if mode.lower() != 'none':
        raise LogError(f'{folder} is compressed, mode {mode}: decompress it with ros2 bag convert')
    listed = information.get('relative_file_paths')
    names = [PurePath(str(name)).name for name in listed] if isinstance(listed, list) else []
    return names if any((folder / name).exists() for name in names) else []


def read_information(folder: Path) -> Mapping[str, Any]:
    """Return the description of a bag in metadata.yaml; {} if it is missing or not YAML."""
    path = folder / METADATA
    try:
        return parsed_information(path, path.stat().st_mtime_ns)
    except FileNotFoundError:
        return {}


@lru_cache(maxsize=4)
def parsed_information(path: Path, _changed: int) -> Mapping[str, Any]:
    """Parse the metadata.yaml of a bag; cached until the file is modified."""
    try:
        content = read_yaml(path)
    except NotYamlError:
        return {}
    except ValueError as error:
        raise LogError(f'{path}: {error}; delete {path.name}: logs are read without it') from error
    information = content.get(INFORMATION) if isinstance(content, dict) else None
    return information if isinstance(information, dict) else {}


def check_is_new(first: Path) -> None:
    """Check that the name of a new log differs from the names of other logs and their parts."""
    if first.suffix != '.mcap':
        raise LogError(f'{str(first)!r} cannot name a log: it must end in .mcap')
    try:
        str(first).encode()
    except UnicodeEncodeError as error:
        raise LogError(f'{str(first)!r} cannot name a log: it must be UTF-8') from error
    if first.exists():
        raise FileExistsError(
            f'{first} exists and is not overwritten: name another file, or give the parameter '
            'resume this one to go on with its mission'
        )
    if is_later_part(first):
        raise FileExistsError(
            f'{first} is named like a later part of another log: choose another name'
        )
    if first.parent.is_dir() and (later := numbered(first)):
        raise FileExistsError(
            f'{next(iter(later.values()))} is named like a later part of {first}: choose another '
            'name for the new log'
        )


class LogLock:
    """A lock that keeps other processes from writing a log."""

    def __init__(self, first: Path) -> None:
        self.path = first
        try:
            # Network file systems only lock files that are open for writing.
            self._file = first.open('r+b')
        except OSError as error:
            raise LogError(f'{first} cannot be resumed: {error.strerror}') from error
        try:
            fcntl.flock(self._file, fcntl.LOCK_EX | fcntl.LOCK_NB)
            # The process that held the lock before may have replaced the file.
            self.check_in_place()
        except OSError as error:
            self.release()
            if isinstance(error, BlockingIOError):
                why = 'is being written by another recorder: end it before resuming the log'
            elif isinstance(error, FileNotFoundError):
                why = 'was replaced while it was opened: try again'
            else:
                why = f'cannot be locked against a second recorder: {error.strerror}; name a '
                why += 'file on another file system'
            raise LogError(f'{first} {why}') from error

    def check_in_place(self) -> None:
        """Check that the locked file was not replaced; raise FileNotFoundError."""
        check_in_place(self._file, self.path)

    def release(self) -> None:
        """Release the lock."""
        self._file.close()


def check_in_place(file: IO[bytes], path: Path) -> None:
    """Check that an open file was not removed or replaced."""
    try:
        is_in_place = os.path.samestat(os.fstat(file.fileno()), path.stat())
    except FileNotFoundError:
        is_in_place = False
    if not is_in_place:
        raise FileNotFoundError(f'{path} is gone: it was removed or replaced while in use')


NAME = 'mission.mcap'


def new_log(folder: Path | None = None) -> Path:
    """Return the path of a new log in a folder of its own: runs/TIME."""
    make_folder(folder or Path('runs'))
    while folder is None:
        new = Path('runs', datetime.now().strftime('%Y-%m-%d-%H-%M-%S'))
        try:
            new.mkdir()
            folder = new
        except FileExistsError:
            # Another mission began in this second.
            time.sleep(0.1)
    return folder / NAME


def make_folder(folder: Path) -> None:
    """Make the folder of a log; raises OSError."""
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise OSError(
            f'folder {folder} cannot be made ({error.strerror}): name another folder'
        ) from error
