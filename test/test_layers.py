# SPDX-License-Identifier: Apache-2.0
"""The layers import downwards only, and the core is arithmetic alone."""

import ast
from collections import defaultdict
from functools import cache
from graphlib import TopologicalSorter
from pathlib import Path
import re
import subprocess
import sys

import pytest

ROOT = Path(__file__).parents[1]

# Layers (folders) that each layer may import.
BELOW = {
    'files': set(),
    'plugins': set(),
    'core.field': set(),
    'core.inference': {'core.field', 'plugins'},
    'core.planning': {'core.field', 'core.inference', 'plugins'},
    'core.decision': {'core.field', 'core.inference', 'core.planning', 'plugins'},
    'core': {'core.decision', 'core.field', 'core.inference', 'core.planning', 'plugins'},
    'testing': {'plugins', 'core'},
    'environments': {'plugins', 'core'},
    'messages': {'core'},
    'maps': {'files', 'plugins', 'core'},
    'base': {'files', 'core', 'messages'},
    'log': {'files', 'core', 'messages', 'base'},
    'robot': {'files', 'core', 'messages'},
    'styles': {'core'},
    'figures': {'core', 'plugins', 'styles'},
    'study': {'files', 'plugins', 'core', 'figures', 'styles'},
    'report': {'files', 'core', 'maps', 'messages', 'base', 'log', 'styles'},
    'configuration': {'files', 'plugins', 'core', 'maps', 'messages', 'base', 'log'},
    'nodes.runtime': {'files', 'core', 'maps', 'messages', 'log', 'configuration'},
    'nodes': {
        'files', 'core', 'messages', 'log', 'base', 'robot', 'configuration',
        'nodes.runtime',
    },
    'cli': {
        'files', 'core', 'messages', 'base', 'log', 'styles', 'study', 'figures', 'report',
        'configuration', 'nodes.runtime',
    },
}  # fmt: skip

# Names in a method for its object or class.
OWN = ('self', 'cls')

# Modules and functions of files, processes and sockets that the core must not use.
FILES = 'glob io multiprocessing os pathlib pickle shutil socket subprocess tempfile'
CALLS = 'fromfile genfromtxt load loadtxt memmap open print save savetxt savez tofile'

PATHS = sorted(ROOT.joinpath('kbnitp_ros').rglob('*.py'))

MODULES = {
    '.'.join(path.relative_to(ROOT).with_suffix('').parts).removesuffix('.__init__'): path
    for path in PATHS
}


@cache
def sources():
    return {path: ast.parse(path.read_text()) for path in PATHS}


def find_layer(path):
    inside = path.relative_to(ROOT / 'kbnitp_ros')
    return '.'.join(inside.parts[:-1]) or (inside.stem if inside.stem in BELOW else '')


def layer_seen(layer, module):
    """Return a module's layer as another layer sees it: rooms of the core are its own affair."""
    below = find_layer(MODULES[module])
    return below if layer.startswith('core') else re.sub(r'^core\..*', 'core', below)


def find_module(name):
    """Return the module of kbnitp_ros that an imported name is, or is in."""
    while name not in MODULES:
        name = name.rpartition('.')[0]
    return name


@cache
def imports():
    return list(find_imports())


def find_imports():
    for path, tree in sources().items():
        package = path.parent.relative_to(ROOT).parts
        for node in ast.walk(tree):
            if isinstance(node, ast.Import):
                names = [alias.name for alias in node.names]
            elif isinstance(node, ast.ImportFrom):
                start = package[: len(package) + 1 - node.level] if node.level else ()
                module = [*start, *([node.module] if node.module else [])]
                names = ['.'.join([*module, alias.name]) for alias in node.names]
            else:
                continue
            for name in names:
                yield str(path.relative_to(ROOT)), find_layer(path), name


def test_every_folder_is_a_layer_that_imports_the_layers_below_it_and_no_others():
    assert {find_layer(path) for path in PATHS} - {''} == BELOW.keys()
    used = {layer: set() for layer in BELOW}
    for _, layer, name in imports():
        if layer and name.startswith('kbnitp_ros.'):
            used[layer].add(layer_seen(layer, find_module(name)))
    assert {layer: each - {layer} for layer, each in used.items()} == BELOW


def test_no_private_name_of_another_module_is_imported():
    private = [
        (path, name)
        for path, _, name in imports()
        if name.startswith('kbnitp_ros.')
        if any(re.fullmatch('_(?!_).*', part) for part in name.split('.'))
    ]
    assert not private


def private_names(tree):
    """Return the private names that a module defines, with those of its classes."""
    names = set()
    for node in ast.walk(tree):
        if isinstance(node, (ast.FunctionDef, ast.ClassDef)):
            names.add(node.name)
        elif isinstance(node, ast.Name) and isinstance(node.ctx, ast.Store):
            names.add(node.id)
        elif isinstance(node, ast.Attribute) and isinstance(node.ctx, ast.Store):
            names.add(node.attr)
    return {name for name in names if re.fullmatch('_(?!_).*', name)}


def test_no_private_name_of_an_object_is_reached_from_another_module():
    own = {path: private_names(tree) for path, tree in sources().items()}
    everywhere = set().union(*own.values())
    reached = [
        (str(path.relative_to(ROOT)), node.lineno, node.attr)
        for path, tree in sources().items()
        for node in ast.walk(tree)
        if isinstance(node, ast.Attribute) and getattr(node.value, 'id', '') not in OWN
        if node.attr in everywhere - own[path]
    ]
    assert not reached


def test_no_files_import_each_other():
    needs = defaultdict(set)
    for path, _, name in imports():
        if name.startswith('kbnitp_ros.') and MODULES[find_module(name)] != ROOT / path:
            needs[path].add(str(MODULES[find_module(name)].relative_to(ROOT)))
    TopologicalSorter(needs).prepare()


def test_only_nodes_and_commands_run_ros():
    spinning = [
        (path, name)
        for path, layer, name in imports()
        if layer.split('.')[0] not in ('nodes', 'cli') and name.split('.')[0] == 'rclpy'
    ]
    assert not spinning


# These modules import packages of ROS to make messages.
WRITERS = {'messages/markers.py', 'messages/poses.py', 'messages/progress.py'}


def test_logs_are_read_without_ros():
    """Only modules that make messages, or describe a log's types, import packages of ROS."""
    needed = [
        (str(path.relative_to(ROOT)), name)
        for path, tree in sources().items()
        if find_layer(path).split('.')[0]
        in ('messages', 'log', 'report', 'maps', 'figures', 'styles')
        if str(path.relative_to(ROOT / 'kbnitp_ros')) not in WRITERS
        for node in tree.body
        if isinstance(node, ast.ImportFrom | ast.Import)
        for name in [getattr(node, 'module', None) or node.names[0].name]
        if re.match(r'(ament|rclpy|rosidl|\w+_(msgs|interfaces)\b)', name)
    ]
    assert not needed


def test_the_core_needs_numpy_only_and_compiles_in_one_place():
    allowed = sys.stdlib_module_names - set(FILES.split()) | {'kbnitp_ros', 'numpy'}
    foreign = [
        (path, name)
        for path, layer, name in imports()
        if layer.split('.')[0] == 'core' and name.split('.')[0] not in allowed
    ]
    # pandas is imported for a table only.
    assert {path: name.split('.')[0] for path, name in foreign} == {
        'kbnitp_ros/core/field/compiled.py': 'numba',
        'kbnitp_ros/core/mission.py': 'pandas',
    }


def test_the_core_reads_and_writes_nothing():
    calls = [
        (str(path.relative_to(ROOT)), node.lineno)
        for path, tree in sources().items()
        for node in ast.walk(tree)
        if find_layer(path).split('.')[0] == 'core' and isinstance(node, ast.Call)
        if getattr(node.func, 'id', getattr(node.func, 'attr', None)) in CALLS.split()
    ]
    assert not calls


@pytest.mark.processes
def test_core_and_replay_run_without_pandas_and_jinja2():
    code = (
        'import sys; sys.modules.update(pandas=None, jinja2=None); '
        'import kbnitp_ros.core, kbnitp_ros.cli.replay'
    )
    done = subprocess.run([sys.executable, '-c', code], capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
