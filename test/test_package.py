# SPDX-License-Identifier: Apache-2.0
"""Requirements and contents of the package are declared, locked, installed and tested."""

from collections import defaultdict
from importlib import metadata
import json
import os
from pathlib import Path
import re
import shutil
import subprocess
import sys
from xml.etree import ElementTree

from ament_index_python.packages import get_package_prefix, get_package_share_directory
from kbnitp_ros.starting import EXECUTABLES, NODES
from laws import for_each
import pytest
import yaml

ROOT = Path(__file__).parents[1]

# Import name -> its rosdep key and its wheel. Other imports are ROS packages: the key is the name,
# the wheels are those of rclpy and the common interfaces. rosdep has no key for None.
PYTHON_PACKAGES = {
    'colorspacious': (None, 'colorspacious'),
    'cyclonedds': (None, 'cyclonedds'),
    'hypothesis': ('python3-hypothesis', 'hypothesis'),
    'irsim': (None, 'ir-sim'),
    'joblib': ('python3-joblib', 'joblib'),
    'lz4': ('mcap-ros2-support', 'lz4'),
    'matplotlib': ('python3-matplotlib', 'matplotlib'),
    'mcap': ('mcap-ros2-support', 'mcap'),
    'mcap_ros2': ('mcap-ros2-support', 'mcap-ros2-support'),
    'numba': ('python3-numba', 'numba'),
    'numpy': ('python3-numpy', 'numpy'),
    'pandas': ('python3-pandas', 'pandas'),
    'PIL': ('python3-pil', 'pillow'),
    'playwright': (None, 'playwright'),
    'pyagrum': (None, 'pyagrum'),
    'pyproj': ('python3-pyproj', 'pyproj'),
    'pytest': ('python3-pytest', 'pytest'),
    'rosbags': ('python3-rosbags-pip', 'rosbags'),
    'threadpoolctl': (None, 'threadpoolctl'),
    'tqdm': ('python3-tqdm', 'tqdm'),
    'yaml': ('python3-yaml', 'PyYAML'),
    'zstandard': ('mcap-ros2-support', 'zstandard'),
}

# Hashes of types as nav2_msgs 1.3.13 and vision_msgs 4.1.1 of ROS 2 Jazzy define them.
TYPES = {
    'CostmapFilterInfo': '61ce391bf7690f76a331c01c9d5ce8ca71e6c99273b9fb75e48380f05c6dfdc8',
    'Detection2DArray': '214274120007f4a683866481336b70310268cfa107aebe9d594a6acf75bda968',
    'FollowPath': '9d95513552fb578cfb933d7e0160273911269cbdf4b348f1acb87d8a903b13cf',
    'FollowWaypoints': '09e36a19e0374ab692e78b877e3345daa223ca4186b8af90f77939b78c6e6d7b',
    'NavigateThroughPoses': '4e680a34fd27772095da6ffdb32ae348adbc3d948248d38cf8d5ca3fc7a3a6c4',
}

# Imported only by optional parts.
OPTIONAL = {'distributed', 'gymnasium', 'sphinx'}


IMPORT = r'^ *(?:import (?=[\w.]+$|\w+ as )|from (?=[\w.]+ import ))(\w+)'


def imported_by(*folders):
    """Return the names of external packages that sources in folders import."""
    names = set()
    local = {'kbnitp_ros', *(path.stem for path in ROOT.glob('benchmarks/*.py'))}
    for folder in folders:
        for path in ROOT.joinpath(folder).rglob('*.py'):
            local.add(path.stem)
            names |= set(re.findall(IMPORT, path.read_text(), re.MULTILINE))
    return names - sys.stdlib_module_names - local - OPTIONAL


def declared(manifest, *kinds):
    root = ElementTree.parse(ROOT / manifest).getroot()
    return {element.text for kind in kinds for element in root.iter(kind)}


REQUIREMENTS = ROOT / 'requirements'
FILES = sorted(path.name for path in REQUIREMENTS.glob('*.txt'))


def pinned(*files):
    lines = '\n'.join(REQUIREMENTS.joinpath(name).read_text() for name in files).splitlines()
    requirements = [line.partition('#')[0].strip() for line in lines]
    return {re.split(r'[\[=]', line)[0]: line for line in requirements if line}


@pytest.mark.slow
@for_each('folders, kinds, files', [
    (['kbnitp_ros', 'launch'], ['depend', 'exec_depend'], ['run.txt', 'study.txt']),
    (
        ['test'],
        ['depend', 'exec_depend', 'test_depend'],
        ['run.txt', 'study.txt', 'dev.txt'],
    ),
])  # fmt: skip
def test_imports_are_declared_for_ros_and_for_the_wheels(folders, kinds, files):
    imported = imported_by(*folders)
    keys = {PYTHON_PACKAGES.get(name, (name,))[0] for name in imported} - {None}
    wheels = {PYTHON_PACKAGES[name][1] for name in imported & PYTHON_PACKAGES.keys()}
    assert keys <= declared('package.xml', *kinds)
    assert wheels <= pinned(*files).keys()


@pytest.mark.processes
def test_nodes_need_no_package_that_robots_lack():
    """Packages that package.xml omits for KBNITP_ROLE robot cannot be imported here."""
    keys = {
        each.text
        for each in ElementTree.parse(ROOT / 'package.xml').getroot().iter('exec_depend')
        if each.get('condition') == '$KBNITP_ROLE != robot'
    }
    assert {'rviz2', 'python3-matplotlib'} < keys
    refused = {name for name, (key, _) in PYTHON_PACKAGES.items() if key in keys or not key}
    nodes = ', '.join(NODES.values())
    code = f'import sys; sys.modules.update(dict.fromkeys({refused | OPTIONAL})); import {nodes}'
    done = subprocess.run([sys.executable, '-c', code], capture_output=True, text=True)
    assert done.returncode == 0, done.stderr


@pytest.mark.processes
@pytest.mark.skipif(not shutil.which('hadolint'), reason='hadolint is not installed')
def test_the_dockerfile_is_linted():
    assert subprocess.run(['hadolint', ROOT / 'Dockerfile']).returncode == 0


def test_the_dockerfile_installs_by_the_commands_of_the_readme():
    said = ' '.join(ROOT.joinpath('Dockerfile').read_text().replace('\\\n', ' ').split())
    told = re.search(
        r'(rosdep install .*)\n(colcon build)\n', ROOT.joinpath('docs/commands.md').read_text()
    )
    assert told[1] in said
    assert told[2] in said


@for_each('file', FILES)
def test_all_installed_packages_are_locked_by_hashes(file):
    lock = REQUIREMENTS.joinpath(file).with_suffix('.lock').read_text()
    entries = re.findall(
        r'^([\w.\[\]-]+==[\w.]+)( ; .+)? \\\n((?:    --hash=sha256:[0-9a-f]{64}(?: \\)?\n)+)',
        lock,
        re.M,
    )
    # No other options, such as a registry.
    comment, _, rest = lock.partition('\n')
    assert comment.startswith('#')
    assert len(rest.splitlines()) == sum(1 + hashes.count('\n') for _, _, hashes in entries)
    locked = {re.sub(r'\[\w+\]', '', requirement) for requirement, _, _ in entries}
    required = {re.sub(r'\[\w+\]', '', line) for line in pinned(file).values()}
    assert {each.lower() for each in required} <= locked


def test_packages_in_several_locks_have_the_same_versions():
    found = defaultdict(set)
    for file in FILES:
        lock = REQUIREMENTS.joinpath(file).with_suffix('.lock').read_text()
        versions = defaultdict(set)
        for name, version, condition in re.findall(
            r'^([\w.\[\]-]+)==([\w.]+)(.*) \\$', lock, re.M
        ):
            versions[name].add((version, condition))
        for name, each in versions.items():
            found[name].add(frozenset(version for version, _ in each))
    assert {name: each for name, each in found.items() if len(each) > 1} == {}


def test_both_packages_and_the_installed_one_have_one_version():
    manifests = declared('package.xml', 'version') | declared('msg_defs/package.xml', 'version')
    assert manifests == {metadata.version('kbnitp_ros')}


def test_every_command_is_installed_as_an_executable():
    scripts = metadata.distribution('kbnitp_ros').entry_points.select(group='console_scripts')
    known = {script.name: script.value for script in scripts}
    expected = {name: f'kbnitp_ros.starting:{name}' for name in EXECUTABLES}
    expected['kbnitp'] = 'kbnitp_ros.__main__:main'
    assert known == expected, 'setup.py has changed: build again'
    folder = Path(get_package_prefix('kbnitp_ros'), 'lib', 'kbnitp_ros')
    assert all(os.access(folder / name, os.X_OK) for name in EXECUTABLES)


@pytest.mark.processes
@pytest.mark.skipif(ROOT.joinpath('.venv').is_symlink(), reason='another tree built .venv')
def test_python_of_the_environment_imports_the_package_without_env_sh():
    python = ROOT / '.venv/bin/python'
    if not python.exists():
        pytest.skip('the wheels are not used')
    done = subprocess.run([python, '-c', 'import kbnitp_ros.core'], env={}, cwd='/')
    assert done.returncode == 0


def test_launch_files_configuration_views_and_scenarios_are_installed():
    share = Path(get_package_share_directory('kbnitp_ros'))
    files = [
        path.relative_to(ROOT)
        for folder in ('config', 'launch')
        for path in ROOT.joinpath(folder).rglob('*.*')
    ]
    assert files
    assert [str(path) for path in files if not share.joinpath(path).is_file()] == []


@pytest.mark.processes
@pytest.mark.skipif(not ROOT.joinpath('.git').exists(), reason='the sources are no repository')
def test_no_ignored_file_is_in_the_repository():
    command = ['git', '-C', str(ROOT), 'ls-files', '--cached', '--ignored', '--exclude-standard']
    assert subprocess.run(command, check=True, capture_output=True).stdout == b''


@for_each('message', sorted(ROOT.glob('msg_defs/msg/*.msg')))
def test_every_field_of_a_message_is_explained(message):
    fields = [line for line in message.read_text().splitlines() if line and line[0] != '#']
    assert [line for line in fields if '#' not in line] == []


@for_each('name', TYPES)
def test_types_of_other_packages_are_those_of_jazzy(name):
    shares = map(get_package_share_directory, ('nav2_msgs', 'vision_msgs'))
    (file,) = (file for share in shares for file in Path(share).glob(f'*/{name}.json'))
    (own,) = (
        each['hash_string']
        for each in json.loads(file.read_text())['type_hashes']
        if each['type_name'].endswith(f'/{name}')
    )
    assert own == f'RIHS01_{TYPES[name]}'


@pytest.mark.full
@pytest.mark.processes
@pytest.mark.skipif(not ROOT.joinpath('.git').exists(), reason='the sources are no repository')
def test_a_clone_in_a_workspace_is_built_with_its_messages(tmp_path):
    """The message of the first build makes colcon find both packages."""
    clone = tmp_path / 'src' / 'kbnitp_ros'
    files = subprocess.check_output(['git', '-C', ROOT, 'ls-files', '-z'], text=True).split('\0')
    for name in filter(None, files):
        (clone / name).parent.mkdir(parents=True, exist_ok=True)
        if (ROOT / name).exists():
            shutil.copy(ROOT / name, clone / name)
    environment = {**os.environ, 'AMENT_PREFIX_PATH': sys.prefix, 'PYTHONPATH': ''}

    def run(*command):
        return subprocess.run(
            command, cwd=tmp_path, env=environment, capture_output=True, text=True, check=False
        )

    built = run('colcon', 'build')
    assert built.returncode == 0
    told = re.search(
        'no node can start without the package kbnitp_msgs.*: (ln -s .*)', built.stderr
    )
    node = tmp_path.joinpath('install', 'kbnitp_ros', 'lib', 'kbnitp_ros', 'planner')
    environment['PYTHONPATH'] = str(next(tmp_path.glob('install/kbnitp_ros/lib/*/site-packages')))
    assert "'kbnitp_msgs'; build it as well" in run(node, '--help').stderr
    assert run(*told[1].split()).returncode == 0
    found = run('colcon', 'list', '--names-only').stdout.split()
    assert found == ['kbnitp_msgs', 'kbnitp_ros']


def test_colcon_runs_the_tests_with_pytest():
    """Without this extra `colcon test` runs unittest, which finds no test and passes."""
    assert "'test': ['pytest']" in ROOT.joinpath('setup.py').read_text()


WORKFLOWS = sorted(ROOT.joinpath('.github/workflows').glob('*.yml'))
README = (ROOT / 'README.md').read_text()
COMMANDS = (ROOT / 'docs/commands.md').read_text()


def steps(name):
    workflow = yaml.safe_load((ROOT / f'.github/workflows/{name}.yml').read_text())
    (job,) = workflow['jobs'].values()
    return [line for step in job['steps'] for line in step.get('run', '').splitlines()]


@for_each('path', WORKFLOWS)
def test_actions_are_pinned_by_commit(path):
    used = re.findall(r'uses: (.*)', path.read_text())
    assert used
    for action in used:
        assert re.fullmatch(r'[\w-]+/[\w-]+@[0-9a-f]{40}  # v\d+\.\d+\.\d+', action)


def test_wheels_are_tested_by_the_commands_of_the_readme():
    made = [line.split()[1] for line in steps('wheels') if line.startswith('make ')]
    assert made == ['demo', 'check', 'docs', 'test']
    targets = re.findall(r'^(\w+):', (ROOT / 'Makefile').read_text(), re.MULTILINE)
    assert set(made) <= set(targets)
    assert '```bash\nmake demo\nmake test\n```' in README


def test_wheels_are_tested_with_every_supported_python():
    workflow = yaml.safe_load((ROOT / '.github/workflows/wheels.yml').read_text())
    versions = workflow['jobs']['build']['strategy']['matrix']['python']
    script = (ROOT / 'tools/check_machine.sh').read_text()
    assert ' | '.join(versions) + ')' in script


def test_ros_is_tested_by_the_commands_of_the_readme():
    run = steps('ros')
    told = re.search(r'(rosdep install .*)\n(colcon build)\n', COMMANDS)
    assert told[1] in run
    assert any(line.endswith(told[2]) for line in run)
    assert any('colcon test ' in line for line in run)
    assert 'colcon test-result --verbose' in run


@pytest.mark.slow
def test_ros_is_tested_with_packages_unknown_to_rosdep():
    imported = imported_by('kbnitp_ros', 'test')
    unknown = {wheel for name, (key, wheel) in PYTHON_PACKAGES.items() if key is None}
    wanted = {PYTHON_PACKAGES[name][1] for name in imported & PYTHON_PACKAGES.keys()} & unknown
    installed = {name for line in steps('ros') if 'pip install' in line for name in line.split()}
    assert len(wanted) > 4
    assert wanted <= installed
