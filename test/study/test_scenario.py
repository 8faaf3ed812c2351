# SPDX-License-Identifier: Apache-2.0
"""A scenario equals its file, or is refused with one error."""

from pathlib import Path

from kbnitp_ros.study.scenario import ALONE, Strategy, team_labels
from kbnitp_ros.study.scenario_file import read_scenario
from laws import for_each
import pytest
import small_study
import yaml

SHIPPED = Path(__file__).parents[2] / 'config/scenarios'


def test_a_scenario_equals_its_file(tmp_path):
    content = {**small_study.CONTENT, 'believed_lethality': 1}
    scenario = read_scenario(small_study.write(tmp_path / 'scenario.yaml', content))
    assert scenario.trials == 3
    assert scenario.lethalities == (0.2, 0.9)
    assert scenario.grid.base == scenario.field().base == 5
    assert scenario.planning.planner == 'relaxed'
    assert scenario.world.kappa == 0.8
    assert scenario.believed_lethality == 1.0
    assert scenario.model(scenario.truth(0.2, 0)).malfunction == 0.05
    belief = scenario.belief(scenario.truth(0.2, 0))
    assert belief.hazard.tolist() == pytest.approx([0.3] * 5 + [0.0] + [0.3] * 6)


@for_each('key, value, complaint', [
    ('colour', 'red', 'colour is unknown.*seed, trials'),
    ('sensor', None, 'sensor is missing'),
    ('prior', 0.5, 'prior is 0.5.*hazard, target, kappa'),
    ('trials', 0, 'trials is 0.*from 1 to'),
    ('trials', 2.5, 'trials is 2.5.*whole number'),
    ('seed', -1, 'seed is -1.*from 0 to'),
    ('lethalities', [0.5, 1.5], r'lethalities is 1\.5.*from 0\.0 to 1\.0'),
    ('lethalities', [], r'lethalities is \[\].*at least one'),
    ('lethalities', 0.5, 'lethalities is 0.5.*a list'),
    ('lethalities', [0.5, 0.50], 'lethalities.*each entry may occur only once'),
    ('methods', ['magic'], 'methods is .magic.*kappa_bnitp_sampled'),
    ('methods', ['kappa_bnitp_smoothed'], 'methods is .*: it is gone.* 0.3.0 .*use kappa_'),
    ('world.kappa', -0.1, r'world.kappa is -0\.1.*from 0\.0 to 1\.0'),
    ('teams', [{'agents': 0}], 'teams.agents is 0.*from 1'),
    ('teams', [{'robots': 2}], 'teams.robots is unknown: teams has agents'),
    ('teams', [{'agents': 13}], 'teams: agents is 13.*from 1 to 12'),
    ('teams', [{'agents': 2}, {'agents': 2}], 'teams.*each entry may occur only once'),
    ('believed_lethality', 2, 'believed_lethality is 2.*from 0'),
    ('grid.base', 12, 'grid: base is 12.*from 0 to 11'),
    ('prior.target', 0.1, r'prior: .*hazard 0\.3 and kappa 0\.8.*target.*0\.1'),
])  # fmt: skip
def test_one_error_names_the_key_the_value_and_what_is_allowed(tmp_path, key, value, complaint):
    file = small_study.write(tmp_path / 'mine.yaml', small_study.changed(key, value))
    with pytest.raises(ValueError, match=f'mine.yaml: {complaint}'):
        read_scenario(file)


@for_each('text, complaint', [
    (b'seed: [', 'not YAML'),
    (b'seed: 1\nseed: 2', "the key 'seed' appears in line 2 and in line 1"),
    (b'\xff\xfe\xff', 'not YAML'),
    (b'', 'it is None: it must have the keys seed'),
])  # fmt: skip
def test_other_files_are_refused(tmp_path, text, complaint):
    file = tmp_path / 'mine.yaml'
    file.write_bytes(text)
    with pytest.raises(ValueError, match=f'mine.yaml.* {complaint}') as refusal:
        read_scenario(file)
    assert '\n' not in str(refusal.value)


def test_teams_are_what_the_file_says_and_robots_go_one_by_one_without(tmp_path, scenario):
    teams = [{'agents': 4, 'allocation': 'voronoi', 'loss_cost': 0.5}, {'agents': 2}, {}]
    content = {**small_study.CONTENT, 'teams': teams}
    read = read_scenario(small_study.write(tmp_path / 'scenario.yaml', content))
    assert read.teams == (Strategy(4, 'voronoi', 0.5), Strategy(2, 'greedy', 0.0), Strategy(1))
    assert len(read.contenders) == 3 * 3
    labels = team_labels(read)
    assert [*labels] == [*read.teams]
    assert [*labels.values()] == [
        '4 voronoi, loss cost 0.5',
        '2 greedy, loss cost 0',
        'one by one, loss cost 0',
    ]
    assert team_labels(scenario) == {ALONE: ''}


@for_each('name', ['teams', 'loss_cost', 'last_contact'])
def test_studies_of_teams_are_of_the_calibrated_robots(name):
    scenario, calibrated = (read_scenario(SHIPPED / f'{n}.yaml') for n in (name, 'calibrated'))
    for same in ('robots', 'seed', 'grid', 'planning', 'world', 'sensor', 'prior'):
        assert getattr(scenario, same) == getattr(calibrated, same)


def test_the_shipped_scenarios_are_the_experiment_of_the_paper():
    shipped = {
        name: read_scenario(SHIPPED / f'{name}.yaml')
        for name in ('calibrated', 'mismatched', 'paper')
    }
    for scenario in shipped.values():
        assert (scenario.grid.width, scenario.grid.height) == (9, 9)
        assert (scenario.robots, scenario.trials) == (100, 25)
        assert scenario.lethalities == (0.01, 0.1, 0.3, 0.5, 0.6, 0.9)
        assert scenario.methods == (
            'relaxed_itp',
            'relaxed_bnitp',
            'kappa_bnitp_published',
            'kappa_bnitp',
        )
        assert vars(scenario.sensor) == {
            'malfunction': 0.05,
            'false_negative': 0.05,
            'true_positive': 0.95,
            'false_positive': 0.05,
        }
    assert shipped['paper'].prior.hazard == 0.5
    for name in ('calibrated', 'mismatched'):
        world, prior = shipped[name].world, shipped[name].prior
        assert prior.hazard == world.hazard_density
        assert prior.kappa == world.kappa
        background = world.target_background
        assert prior.target == pytest.approx(
            prior.hazard * world.kappa + (1 - prior.hazard) * background
        )
    assert [shipped[name].believed_lethality for name in sorted(shipped)] == [None, 1.0, None]


@for_each('path', sorted(SHIPPED.glob('*.yaml')))
def test_choices_that_the_paper_leaves_open_are_documented(path):
    text = path.read_text()
    said = {line.split(':')[0].strip() for line in text.splitlines() if '# open' in line}
    decided = {'base', 'max_steps', 'width', 'max_visits', *yaml.safe_load(text)['world']}
    assert decided <= said
