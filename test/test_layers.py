# SPDX-License-Identifier: Apache-2.0
"""The layers import downwards only, and the core is arithmetic alone."""

import ast
from collections import defaultdict
from graphlib import TopologicalSorter
from pathlib import Path
import sys

ROOT = Path(__file__).parents[1]

# What each layer, a folder, may stand on.
BELOW = {
    'files': set(),
    'plugins': set(),
    'core.field': set(),
    'core.inference': {'core.field', 'plugins'},
    'core.planning': {'core.field', 'core.inference', 'plugins'},
    'core': {'core.field', 'core.inference', 'core.planning'},
    'testing': {'core', 'core.inference', 'core.planning'},
    'messages': {'core'},
    'maps': {'files', 'core'},
    'log.bag': {'files'},
    'log': {'files', 'core', 'messages', 'log.bag'},
    'robot': {'core'},
    'figures': set(),
    'study': {'files', 'core', 'maps', 'messages', 'figures'},
    'report': {'core', 'maps', 'messages', 'log', 'log.bag', 'figures'},
    'nodes.parameters': {'files', 'plugins', 'core', 'maps', 'messages', 'log'},
    'nodes': {
        'files',
        'core',
        'maps',
        'messages',
        'log',
        'log.bag',
        'study',
        'robot',
        'nodes.parameters',
    },
    'cli': {
        'files',
        'core',
        'maps',
        'messages',
        'log',
        'log.bag',
        'study',
        'report',
        'nodes',
        'nodes.parameters',
    },
}

# Modules and functions of files, processes and sockets that the core has no use for.
FILES = 'glob io multiprocessing os pathlib pickle shutil socket subprocess tempfile'
CALLS = 'fromfile genfromtxt load loadtxt memmap open print save savetxt savez tofile'

SOURCES = {
    path: ast.parse(path.read_text()) for path in sorted(ROOT.joinpath('kbnitp_ros').rglob('*.py'))
}

MODULES = {
    '.'.join(path.relative_to(ROOT).with_suffix('').parts).removesuffix('.__init__'): path
    for path in SOURCES
}


def layer_of(path):
    """Return the folder of a module in kbnitp_ros, dotted; empty for those beside the folders."""
    return '.'.join(path.relative_to(ROOT / 'kbnitp_ros').parts[:-1])


def module_of(name):
    """Return the module of kbnitp_ros that an imported name is, or is in."""
    while name not in MODULES:
        name = name.rpartition('.')[0]
    return name


def imports():
    """Yield (path, layer, absolute dotted name) for everything that is imported."""
    for path, tree in SOURCES.items():
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
                yield str(path.relative_to(ROOT)), layer_of(path), name


def test_every_folder_is_a_layer():
    assert {layer_of(path) for path in SOURCES} - {''} == BELOW.keys()


def test_imports_point_down():
    upwards = [
        (path, name)
        for path, layer, name in imports()
        if layer and name.startswith('kbnitp_ros.')
        if layer_of(MODULES[module_of(name)]) not in BELOW[layer] | {layer}
    ]
    assert not upwards


def test_no_files_import_each_other():
    needs = defaultdict(set)
    for path, _, name in imports():
        if name.startswith('kbnitp_ros.') and MODULES[module_of(name)] != ROOT / path:
            needs[path].add(str(MODULES[module_of(name)].relative_to(ROOT)))
    TopologicalSorter(needs).prepare()


def test_only_nodes_and_commands_run_ros():
    spinning = [
        (path, name)
        for path, layer, name in imports()
        if layer.split('.')[0] not in ('nodes', 'cli') and name.split('.')[0] == 'rclpy'
    ]
    assert not spinning


def test_the_core_needs_numpy_only_and_compiles_in_one_place():
    allowed = sys.stdlib_module_names - set(FILES.split()) | {'kbnitp_ros', 'numpy'}
    foreign = [
        (path, name)
        for path, layer, name in imports()
        if layer.split('.')[0] == 'core' and name.split('.')[0] not in allowed
    ]
    assert foreign == [('kbnitp_ros/core/field/compiled.py', 'numba')]


def test_the_core_reads_and_writes_nothing():
    calls = [
        (str(path.relative_to(ROOT)), node.lineno)
        for path, tree in SOURCES.items()
        for node in ast.walk(tree)
        if layer_of(path).split('.')[0] == 'core' and isinstance(node, ast.Call)
        if getattr(node.func, 'id', getattr(node.func, 'attr', None)) in CALLS.split()
    ]
    assert not calls
