# SPDX-License-Identifier: Apache-2.0
"""Beliefs in kinds of hazards are compared, in worlds of each kind."""

from dataclasses import replace
import json

from kbnitp_ros.core import Grid, log_loss
from kbnitp_ros.study import trial as running
from kbnitp_ros.study.comparison import BY_KIND, OF_HAZARDS, write_report
from kbnitp_ros.study.scenario import Hazards, Strategy, team_labels
from kbnitp_ros.study.scenario_file import scenario_of
from kbnitp_ros.study.trial import blobs, rows, run_trial, Trial, world_of
from laws import for_each
import numpy as np
import pytest
from small_study import changed, run

RIGHT, STATIC, SAME = (Strategy(), Strategy(dynamics='static'), Strategy(paths='static'))
KINDS = {'changing': Hazards('changing', appear=0.1, vanish=0.3), 'used_up': Hazards('used_up')}


def of_kind(scenario, kind, teams=(RIGHT, STATIC, SAME)):
    """Return a study of one method in worlds of a kind."""
    return replace(
        scenario,
        hazards=KINDS[kind],
        teams=teams,
        methods=('kappa_bnitp',),
        lethalities=(0.9,),
        robots=12,
    )


@for_each('kind', KINDS)
def test_beliefs_are_scored_by_the_field_of_their_time(scenario, kind, monkeypatch):
    scenario, missions = of_kind(scenario, kind), []

    def keeping(*arguments, **options):
        missions.append(go_on(*arguments, **options))
        return missions[-1]

    go_on = running.continue_mission
    monkeypatch.setattr(running, 'continue_mission', keeping)
    outcome = run_trial(scenario, Trial(0.9, 'kappa_bnitp', 1, RIGHT))
    (mission,) = missions
    fields = [each.world.hazard.tolist() for each in mission]
    assert len(set(map(tuple, fields))) > 1
    losses = outcome.measures[1:, running.MEASURES.index('hazard_log_loss')]
    assert losses == pytest.approx([log_loss(e.belief.hazard, e.world.hazard) for e in mission])
    assert outcome.truth[0].tolist() == fields[-1]


@for_each('kind', KINDS)
def test_who_has_the_same_paths_has_the_same_evidence(scenario, kind):
    scenario = of_kind(scenario, kind)
    static, same = (run_trial(scenario, Trial(0.9, 'kappa_bnitp', 1, t)) for t in (STATIC, SAME))
    lost = running.MEASURES.index('robots_lost')
    assert (same.measures[:, lost] == static.measures[:, lost]).all()
    assert (same.truth == static.truth).all()
    assert not np.array_equal(same.believed, static.believed)
    # In the worlds of static hazards all of them believe the same.
    still = replace(scenario, hazards=Hazards())
    a, b, c = (run_trial(still, Trial(0.9, 'kappa_bnitp', 1, team)) for team in scenario.teams)
    assert a.believed.tobytes() == b.believed.tobytes() == c.believed.tobytes()
    assert a.measures.tobytes() == b.measures.tobytes() == c.measures.tobytes()


@pytest.mark.slow
def test_each_belief_is_compared_with_the_first(scenario, tmp_path):
    scenario = of_kind(scenario, 'used_up', (RIGHT, STATIC))
    results = run(scenario)
    write_report(results, tmp_path)
    summary = json.loads((tmp_path / 'summary.json').read_text())
    assert (summary['kinds']['first'], summary['kinds']['robots']) == ('used up', [12])
    (row,) = summary['kinds']['rows']
    total = [
        results.series(0.9, 'kappa_bnitp', 'hazard_log_loss', 'target_log_loss', team=team)[:, -1]
        for team in (STATIC, RIGHT)
    ]
    assert row['believed'] == 'static'
    assert row['difference'][0]['mean'] == pytest.approx((total[0] - total[1]).mean(), abs=1e-6)
    for row, team in zip(summary['hazards']['rows'], (RIGHT, STATIC), strict=True):
        series = results.series(0.9, 'kappa_bnitp', 'hazard_log_loss', team=team)
        mean = row['hazard_log_loss'][0]['mean']
        assert mean == pytest.approx(series[:, -1].mean(), abs=1e-6)
    told = [each.table(summary[each.name]).markdown() for each in (OF_HAZARDS, BY_KIND)]
    assert (tmp_path / 'summary.md').read_text().endswith('\n'.join(told))


def test_rows_are_called_by_what_is_believed(scenario):
    scenario = of_kind(scenario, 'used_up')
    labels = 'used up, own paths', 'static, own paths', 'used up, static paths'
    assert tuple(team_labels(scenario).values()) == labels
    clustered = replace(scenario, teams=(RIGHT, Strategy(clustering='learn')))
    assert tuple(team_labels(clustered).values()) == ('independent', 'clustered')


@for_each('key, value, told', [
    ('hazards', {'dynamics': 'odd'}, "'odd': it must be one of static, changing, used_up"),
    ('hazards', {'appear': 0.1}, 'hazards: appear is 0.1: no hazards are changing'),
    ('hazards', {'dynamics': 'changing'}, 'hazards: changing ones need a rate'),
    ('hazards', {'layout': 'odd'}, "'odd': it must be one of independent, blobs, rows"),
    ('hazards', {'dynamics': 'used_up'}, 'hazards: .* does not take hazards that are used_up'),
    ('teams', [{'clustering': 'learn'}], 'hazards: .* does not take clustered hazards'),
    ('teams', [{'objective': 'odd'}], "'odd': it must be one of information, behavioral"),
])  # fmt: skip
def test_what_no_method_takes_is_refused(key, value, told):
    with pytest.raises(ValueError, match=told):
        scenario_of(changed(key, value))


@for_each('lay_out', [blobs, rows])
def test_hazards_lie_closer_than_by_chance(lay_out):
    together = 0
    for seed in range(100):
        hazard = lay_out(Grid(9, 9), 12, np.random.default_rng(seed)).reshape(9, 9)
        assert hazard.sum() == 12
        together += (hazard[1:] & hazard[:-1]).sum() + (hazard[:, 1:] & hazard[:, :-1]).sum()
        together += (hazard[1:, 1:] & hazard[:-1, :-1]).sum()
        together += (hazard[1:, :-1] & hazard[:-1, 1:]).sum()
    # Of 2 * 72 pairs of cells that share a side and 2 * 64 that share a corner.
    assert together / 100 > 1.5 * 272 * (12 / 81) * (11 / 80)


@for_each('layout', ['blobs', 'rows'])
def test_a_layout_moves_hazards_and_nobody_elses_luck(scenario, layout):
    laid_out = replace(scenario, hazards=Hazards(layout=layout))
    truth = scenario.truth(0.9, 0)
    worlds, left = [], []
    for study in (scenario, laid_out):
        rng = np.random.default_rng(3)
        worlds.append(world_of(study, study.field(), truth, rng, 0))
        left.append(rng.random())
    assert left[0] == left[1]
    worlds[1].check(laid_out.field())
    assert not np.array_equal(worlds[0].hazard, worlds[1].hazard)
