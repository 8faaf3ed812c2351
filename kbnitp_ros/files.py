# SPDX-License-Identifier: Apache-2.0
"""YAML, files of the package, and error messages in words."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from difflib import get_close_matches
import errno
from importlib.metadata import version
import os
from pathlib import Path
import re
from typing import Any

import yaml

PACKAGE = Path(__file__).parent


def installed() -> str:
    """Return the version and the folder of the installed package: several may be installed."""
    return f'kbnitp_ros {version("kbnitp_ros")} in {PACKAGE}'


def share(relative: str) -> Path:
    """Return the path of a file or folder of the package, in the source tree or installed."""
    source = PACKAGE.parent / relative
    if source.exists():
        return source
    # pip and colcon install share/ beside the lib/ that contains this package.
    return PACKAGE.parents[3] / 'share/kbnitp_ros' / relative


def as_file(name: str, given: Any) -> Path:
    """Return the path of a file or folder; `name` is that of the argument."""
    if not isinstance(given, str | os.PathLike):
        raise TypeError(f'{name} is {given!r}: it must be the path of a file or folder')
    return Path(given)


def nearest(name: str, known: Iterable[str]) -> str:
    """Return 'did you mean' with the known names most similar to a name; empty if none is."""
    # Compare without the group as well, since lethality differs much from sensor.lethality.
    ends = {each: each.rpartition('.')[2] for each in sorted(known)}
    close = get_close_matches(name, sorted({*ends, *ends.values()}), n=1, cutoff=0.6)
    meant = [each for each, end in ends.items() if close and close[0] in (each, end)]
    return f'did you mean {" or ".join(meant)}? ' if meant else ''


class OutputError(Exception):
    """Standard output is a closed pipe, or a file on a full disk."""


@contextmanager
def writing() -> Iterator[None]:
    """Raise an OutputError if standard output cannot be written."""
    try:
        yield
    except OSError as error:
        raise OutputError(in_words(error)) from error


# Remedies for errors of the disk.
REMEDIES = {
    errno.ENOSPC: 'free some space on that disk',
    errno.EDQUOT: 'free some space within the disk quota',
    errno.EFBIG: 'raise the limit on the size of files, see ulimit -f',
    errno.EROFS: 'name a file on a disk that can be written to',
    errno.EACCES: 'check the permissions of the file and its folder',
    errno.EPERM: 'check the permissions of the file and its folder',
    errno.EIO: 'check the disk',
}

# Maximum number of items listed in a line.
NAMED = 3


@contextmanager
def naming(path: str | Path) -> Iterator[None]:
    """Add a file name to every OSError without one."""
    # An OSError names a file that cannot be opened, but not a file that cannot be written.
    try:
        yield
    except OSError as error:
        # Errors of libraries have no number, and would lose their text.
        if error.filename is None and error.errno is not None:
            error.filename = str(path)
        raise


def sync_folder(folder: Path) -> None:
    """Sync a folder, so that its list of files is on the disk."""
    descriptor = os.open(folder, os.O_RDONLY | os.O_DIRECTORY)
    try:
        with naming(folder):
            os.fsync(descriptor)
    finally:
        os.close(descriptor)


def in_words(error: BaseException) -> str:
    """Return an error as one line; a system error with file, reason and remedy."""
    if isinstance(error, OSError) and error.strerror:
        about = [error.filename] if error.filename is not None else []
        remedy = REMEDIES.get(error.errno or 0)
        return ': '.join(map(str, [*about, error.strerror])) + (f' ({remedy})' if remedy else '')
    return ' '.join(str(error).split()) or type(error).__name__


def some(items: Iterable[object], named: int = NAMED) -> str:
    """List the first few items in words, and count the rest."""
    first = [str(each) for each in items]
    more = len(first) - named
    return ', '.join(first[:named]) + (f' and {more} more' if more > 0 else '')


def counted(number: int, what: str) -> str:
    """Return a number with its noun."""
    return f'{number} {what}' if number == 1 else f'{number} {what}s'


def yaml_text(content: Any) -> str:
    """Return YAML of a value, with mappings in their order."""
    text: str = yaml.dump(content, Dumper=yaml.CSafeDumper, sort_keys=False)
    return text


class Loader(yaml.CSafeLoader):
    """A YAML 1.1 loader that reads numbers such as 1e-3, and tuples of launch files as lists."""


Loader.add_implicit_resolver(
    'tag:yaml.org,2002:float',
    re.compile(r'[-+]?(\d+\.?\d*|\.\d+)[eE][-+]?\d+$'),
    list('-+.0123456789'),
)
Loader.add_constructor(  # type: ignore[type-var]
    'tag:yaml.org,2002:python/tuple', Loader.construct_yaml_seq
)


class NotYamlError(ValueError):
    """A text is not valid YAML, for example because it was cut off."""


def read_yaml(path: str | Path) -> Any:
    """Return the content of a YAML file; raise an OSError, or an error of `parse_yaml`."""
    with naming(path):
        return parse_yaml(Path(path).read_bytes())


def parse_yaml(text: str | bytes) -> Any:
    """Return the content of a YAML text; raise NotYamlError, or ValueError for a repeated key."""
    try:
        node = yaml.compose(text, Loader)
        if node is None:
            return None
        # Repeated keys are searched first, since construction merges mappings.
        if not (repeated := repeated_key(node, set())):
            return Loader('').construct_document(node)
    except Exception as error:
        # PyYAML raises many types on a value that does not match its tag.
        raise NotYamlError(f'it is not YAML: {" ".join(str(error).split())}') from error
    raise ValueError(repeated)


def repeated_key(node: yaml.Node, seen: set[int]) -> str:
    """Describe the first repeated key of a mapping; a node is visited once, despite aliases."""
    if id(node) in seen or isinstance(node, yaml.ScalarNode):
        return ''
    seen.add(id(node))
    lines: dict[str, int] = {}
    for child in node.value:
        if isinstance(node, yaml.MappingNode):
            key, value = child
            if found := repeated_key(key, seen):
                return found
            if isinstance(key, yaml.ScalarNode):
                line = key.start_mark.line + 1
                if key.value in lines:
                    return (
                        f'the key {key.value!r} appears in line {line} and in line '
                        f'{lines[key.value]}'
                    )
                lines[key.value] = line
            child = value
        if found := repeated_key(child, seen):
            return found
    return ''


class Waiting(str):
    """The state of a node or a robot that waits for something, in words."""

    # The condition that it waits for, in words.
    what: str


def waiting_for(what: str) -> Waiting:
    """Return the state of a node or a robot that waits for something."""
    state = Waiting(f'waiting for {what}')
    state.what = what
    return state
