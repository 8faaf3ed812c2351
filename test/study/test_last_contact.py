# SPDX-License-Identifier: Apache-2.0
"""Last contacts are compared with none, in the same worlds."""

from dataclasses import replace

from kbnitp_ros.core import continue_mission
from kbnitp_ros.study import trial as running
from kbnitp_ros.study.comparison import CONTACT
from kbnitp_ros.study.scenario import Strategy
from kbnitp_ros.study.trial import run_trial, trials_of
import pytest
from small_study import compared_by, written

pytestmark = pytest.mark.slow

TEAMS = (Strategy(last_contact=1.0), Strategy(), Strategy(last_contact=0.3))


@pytest.fixture(scope='module')
def contacts(scenario):
    """Return the results of missions with three probabilities of contact, not in their order."""
    return compared_by(scenario, TEAMS)


def test_the_base_hears_of_robots_as_often_as_told(scenario, monkeypatch):
    heard = []

    def noting(*arguments, truth, **options):
        contact = truth.execution.contact
        heard.append(contact)
        mission = continue_mission(*arguments, truth=truth, **options)
        known = [d.observation.steps_survived for d in mission if not d.observation.survived]
        assert any(known) == (contact > 0.0)
        return mission

    monkeypatch.setattr(running, 'continue_mission', noting)
    # Robots whose first step is their last have nothing to be heard of.
    scenario = replace(scenario, teams=TEAMS[:2], robots=30, trials=1, lethalities=(0.5,))
    for trial in trials_of(replace(scenario, methods=('kappa_bnitp',))):
        run_trial(scenario, trial)
    assert heard == [1.0, 0.0]


def test_each_is_compared_with_none(contacts):
    summary = CONTACT.summarise(contacts)
    assert (summary['least'], summary['robots']) == (0, [4])
    assert [row['last_contact'] for row in summary['rows']] == [0.3, 1.0]

    def log_loss(team):
        measures = ('hazard_log_loss', 'target_log_loss')
        return contacts.series(0.9, 'kappa_bnitp', *measures, team=team)[:, -1]

    for row, team in zip(summary['rows'], (TEAMS[2], TEAMS[0])):
        value = (log_loss(Strategy()) - log_loss(team)).mean()
        assert row['value'][0]['mean'] == pytest.approx(value, abs=1e-6)


def test_the_report_has_a_table_of_it(contacts, tmp_path):
    summary, rows = written(contacts, CONTACT, tmp_path)
    for row, cells in rows:
        assert cells[:3] == ['0.9', '`kappa_bnitp`', f'{row["last_contact"]:g}']
        assert cells[3].startswith(f'{row["value"][0]["mean"]:.1f} [')
    assert not {'loss_cost', 'teams'} & summary.keys()
