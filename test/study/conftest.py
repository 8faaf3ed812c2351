# SPDX-License-Identifier: Apache-2.0
"""A small study, run once; only one test draws its figures unless all tests run."""

from extent import FULL
from kbnitp_ros.study import benchmark, comparing
from kbnitp_ros.study.results import Results
from kbnitp_ros.study.scenario_file import read_study
import pytest
import small_study


def placeholders(figure, path, *formats):
    """Write empty files for a figure, which `test_results.py` draws."""
    files = [path.with_suffix(f'.{each}') for each in formats]
    for file in files:
        file.write_text(file.name)
    return files


@pytest.fixture
def pictures():
    """Draw figures in this test."""


@pytest.fixture(autouse=True)
def _pictures_if_asked_for(request, monkeypatch):
    if not FULL and 'pictures' not in request.fixturenames:
        for module in (benchmark, comparing):
            monkeypatch.setattr(module, 'save', placeholders)


@pytest.fixture(scope='session')
def study(tmp_path_factory):
    return read_study(small_study.write(tmp_path_factory.mktemp('study') / 'scenario.yaml'))


@pytest.fixture(scope='session')
def scenario(study):
    return study.first


@pytest.fixture(scope='session')
def outcomes(study):
    return small_study.run(study)


@pytest.fixture(scope='session')
def results(study, outcomes):
    return Results.of(study, outcomes)
