# SPDX-License-Identifier: Apache-2.0
"""Teams are compared by the robots they send and by the rounds it takes."""

from dataclasses import replace

from kbnitp_ros.study.comparison import BY_SIZE, write_report
from kbnitp_ros.study.questions import differ_in_size
from kbnitp_ros.study.results import after_rounds
from kbnitp_ros.study.scenario import Strategy
from kbnitp_ros.study.trial import MEASURES, Trial
from laws import for_each
import numpy as np
import pytest
from small_study import compared_by

pytestmark = pytest.mark.slow

TEAMS = (Strategy(), Strategy(3, 'independent'), Strategy(2, 'voronoi'))


@pytest.fixture(scope='module')
def teams(scenario):
    """Return the results of missions of four robots: in four rounds, and twice in two."""
    return compared_by(scenario, TEAMS)


@for_each('robots, agents, expected', [
    (4, 1, [0, 1, 2, 3, 4]),
    (4, 2, [0, 2, 4]),
    (4, 3, [0, 3, 4]),
    (4, 4, [0, 4]),
    (4, 8, [0, 4]),
])  # fmt: skip
def test_a_round_is_over_when_its_last_robot_is(robots, agents, expected):
    series = np.arange(3.0)[:, None] + np.arange(robots + 1.0)
    assert after_rounds(series, agents)[0].tolist() == expected
    assert after_rounds(series, agents)[2].tolist() == [2 + value for value in expected]


def test_teams_differ_in_size(scenario):
    for differ, teams in (
        (True, TEAMS),
        (False, TEAMS[:1]),
        (False, (Strategy(2, 'voronoi'), Strategy(2, 'greedy'))),
        (False, (Strategy(1), Strategy(2, loss_cost=0.1))),
    ):
        assert differ_in_size(replace(scenario, teams=teams)) is differ


def test_what_a_robot_and_a_round_bring(teams):
    """With three at a time one full round can be made: what it brings is compared with others."""
    summary = BY_SIZE.summarise(teams)
    assert (summary['robots'], summary['rounds']) == (4, 1)
    assert [row['rounds'] for row in summary['rows']] == [4, 2, 2]

    def mean(team, robots, *names):
        """Return the sum of some measures after some robots, the mean over trials."""
        outcomes = [teams.outcomes[Trial(0.9, 'kappa_bnitp', t, team)] for t in range(3)]
        values = [[o.measures[robots, MEASURES.index(name)] for name in names] for o in outcomes]
        return np.sum(values) / 3

    loss = ('hazard_log_loss', 'target_log_loss')
    for row, team in zip(summary['rows'], TEAMS, strict=True):
        assert {name: row[name] for name in vars(team)} == vars(team)
        prior = mean(team, 0, 'joint_entropy')
        gained = prior - mean(team, 4, 'joint_entropy')
        first = {1: 1, 2: 2, 3: 3}[team.agents]
        for name, expected in {
            'information_a_robot': gained / 4,
            'information_a_round': gained / row['rounds'],
            'log_loss': mean(team, 4, *loss),
            'difference': mean(team, 4, *loss) - mean(Strategy(), 4, *loss),
            'early_information': prior - mean(team, first, 'joint_entropy'),
            'early_log_loss': mean(team, first, *loss),
            'early_robots_lost': mean(team, first, 'robots_lost'),
        }.items():
            assert row[name]['mean'] == pytest.approx(expected, abs=1e-6), name
            assert row[name]['low'] <= row[name]['mean'] <= row[name]['high']
    assert summary['rows'][0]['difference'] == {'mean': 0.0, 'low': 0.0, 'high': 0.0}
    # A robot's information is what its own update took, robot after robot.
    realised = teams.series(0.9, 'kappa_bnitp', 'realised_information', team=TEAMS[1])
    gained = summary['rows'][1]['information_a_robot']['mean']
    assert gained == pytest.approx(realised[:, 1:].mean(), abs=1e-6)


def test_the_report_of_teams_alone_has_their_figure(teams, results, tmp_path):
    names = set()
    for study in (results, teams):
        folder = tmp_path / str(len(study.scenario.teams))
        folder.mkdir()
        written = write_report(study, folder)
        assert sorted(folder.iterdir()) == sorted(written)
        assert all(path.stat().st_size for path in written)
        names ^= {path.name for path in written}
        as_markdown = (folder / 'summary.md').read_text()
        assert ('a round' in as_markdown) == (study is teams)
    assert names == {'by_round.png', 'by_round.svg', 'by_round.pdf'}
