# SPDX-License-Identifier: Apache-2.0
"""
Logs that an earlier version recorded replay bit for bit.

Those in `recorded/` are of demos by the version 2fccc0f: `demo --robots 8 --size 5x4 --max-steps 8
--seed 3 --method METHOD`. Reports had no last contacts and no missing readings then, and beliefs
did not tell which steps a robot can take.
"""

import gzip
from pathlib import Path

from kbnitp_ros.core import Grid
from kbnitp_ros.log.deployments import read_deployments
from kbnitp_ros.log.history import read_history
from kbnitp_ros.log.replay import replay
import pytest

LOGS = sorted(Path(__file__).with_name('recorded').glob('*.mcap.gz'))
GRID = Grid(5, 4)


@pytest.fixture(params=LOGS, ids=lambda log: log.name.partition('.')[0])
def log(request, tmp_path):
    """Return a log, as it was recorded."""
    path = tmp_path / 'mission.mcap'
    path.write_bytes(gzip.decompress(request.param.read_bytes()))
    return path


def test_it_is_reproduced(log):
    report = replay(log)
    assert report.mismatches == report.undecided == report.passed_over == []
    assert report.reproduced
    assert report.evidence.refused == []
    assert report.compared == dict.fromkeys(
        ('/belief', '/belief/hazard', '/belief/target', '/belief/kappa'), 9
    )


def test_its_deployments_can_be_gone_on_with(log):
    history, deployments = read_history(log), read_deployments(log, GRID, 8)
    assert history.grid == GRID
    assert len(history.observations) == len(deployments) == 8
    assert {each.survived for each in history.observations} == {True, False}
    for each, deployment in zip(history.observations, deployments.values()):
        assert each.path.tolist() == deployment.path.tolist()
        assert each.steps_survived == 0
        assert each.readings is None or each.readings.dtype == bool
