# SPDX-License-Identifier: Apache-2.0
"""The lists of CONTRIBUTING.md are followed on a copy of the package: what they name is enough."""

import gzip
import os
from shutil import copytree
import subprocess
import sys

from documented import ROOT
import pytest

LISTS = ROOT.joinpath('CONTRIBUTING.md').read_text().split('## Steps of frequent changes')[1]

COLUMN = """
from pathlib import Path
from kbnitp_ros.report.tables import curves_of
from kbnitp_ros.report.mission import read_mission
from kbnitp_ros.report.tables import write_tables
mission = read_mission('log.mcap')
write_tables(Path(), mission, curves_of(mission))
head, *lines = Path('deployments.csv').read_text().splitlines()
place = head.split(',').index('"first_cell"')
assert lines and all(line.split(',')[place] == '0' for line in lines), lines
"""

METHOD = """
from kbnitp_ros.core import METHODS
from kbnitp_ros.testing import check_method
assert 'late' in METHODS
check_method('late', cases=1)
"""

COMPARISON = """
from types import SimpleNamespace
from kbnitp_ros.study.comparison import COMPARISONS
last = COMPARISONS[-1]
section = last.summarise(SimpleNamespace(scenario=None))
assert last.table(section).markdown().splitlines()[-1] == '| 0.5 | 3 |'
"""

LATE = """
from kbnitp_ros.core.inference.sampler import Sampler


class Late(Sampler):
    version = 1
"""

BY_LUCK = """
    AREAS,
    Comparison(
        name='luck',
        applies=learns,
        caption='Luck.',
        columns={'luck': ('luck', '{}')},
        head=lambda scenario: {},
        rows=lambda results: [{'lethality': 0.5, 'luck': 3}],
    ),
)
"""


def paragraph(beginning):
    """Return the list of a change."""
    (found,) = (each for each in LISTS.split('\n\n') if each.startswith(beginning))
    return found


@pytest.mark.processes
@pytest.mark.parametrize('change, edits, script', [
    (
        'A column of the report',
        {
            'kbnitp_ros/report/tables.py': {
                "('path', pyarrow": "('first_cell', pyarrow.int64()),\n        ('path', pyarrow",
                "'path': text(": "'first_cell': deployment.path[0],\n            'path': text(",
            },
        },
        COLUMN,
    ),
    pytest.param(
        'A method',
        {
            'kbnitp_ros/core/inference/late.py': {'': LATE},
            'kbnitp_ros/core/inference/methods.py': {
                "        'relaxed_itp': ": "        'late': Late,\n        'relaxed_itp': ",
                'from kbnitp_ros.core.inference.sampler': (
                    'from kbnitp_ros.core.inference.late import Late\n'
                    'from kbnitp_ros.core.inference.sampler'
                ),
            },
        },
        METHOD,
        marks=pytest.mark.full,
    ),
    (
        'A comparison in studies',
        {'kbnitp_ros/study/comparison.py': {'\n    AREAS,\n)\n': BY_LUCK}},
        COMPARISON,
    ),
])  # fmt: skip
def test_a_list_names_all_that_a_change_needs(tmp_path, change, edits, script):
    copytree(ROOT / 'kbnitp_ros', tmp_path / 'kbnitp_ros')
    listed = paragraph(change)
    for name, replaced in edits.items():
        folder, _, file = name.rpartition('/')
        path = tmp_path / name
        assert name in listed or (folder in listed and (not path.exists() or file in listed)), name
        source = path.read_text() if path.exists() else ''
        for before, after in replaced.items():
            assert not before or source.count(before) == 1, before
            source = source.replace(before, after) if before else after
        path.write_text(source)
    log = ROOT / 'test' / 'log' / 'recorded' / 'kappa_bnitp.mcap.gz'
    tmp_path.joinpath('log.mcap').write_bytes(gzip.decompress(log.read_bytes()))
    path = os.pathsep.join([str(tmp_path), os.environ.get('PYTHONPATH', '')])
    told = subprocess.run(
        [sys.executable, '-c', script],
        cwd=tmp_path,
        env={**os.environ, 'PYTHONPATH': path},
        capture_output=True,
        text=True,
    )
    assert told.returncode == 0, told.stderr
