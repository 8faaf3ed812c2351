# SPDX-License-Identifier: Apache-2.0
"""A small study, run once, whose pictures are drawn by one test unless all are run."""

from extent import FULL
from kbnitp_ros.study import benchmark, comparison
from kbnitp_ros.study.scenario_file import read_scenario
import pytest
import small_study


def placeholders(figure, path, *formats):
    """Write the files of a figure, which `test_study_figures.py` draws."""
    files = [path.with_suffix(f'.{each}') for each in formats]
    for file in files:
        file.write_text(file.name)
    return files


@pytest.fixture
def pictures():
    """Have pictures drawn."""


@pytest.fixture(autouse=True)
def _pictures_if_asked_for(request, monkeypatch):
    if not FULL and 'pictures' not in request.fixturenames:
        for module in (benchmark, comparison):
            monkeypatch.setattr(module, 'save', placeholders)


@pytest.fixture(scope='session')
def scenario(tmp_path_factory):
    return read_scenario(small_study.write(tmp_path_factory.mktemp('study') / 'scenario.yaml'))


@pytest.fixture(scope='session')
def results(scenario):
    """Return the results of all trials; not to be changed."""
    return small_study.run(scenario)
