# SPDX-License-Identifier: Apache-2.0
"""A scenario equals its file, or is refused with one error."""

from pathlib import Path

from kbnitp_ros.study.scenario import Strategy
from kbnitp_ros.study.scenario_file import list_names, parse_study, read_changes, read_study
from laws import for_each
import pytest
import small_study
import yaml

SHIPPED = Path(__file__).parents[2] / 'config/scenarios'


def test_a_scenario_equals_its_file(tmp_path):
    content = {**small_study.CONTENT, 'believed_lethality': 1}
    scenario = read_study(small_study.write(tmp_path / 'scenario.yaml', content)).first
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
    ('trials', [1, 2], r'trials is \[1, 2\].*whole number'),
    ('robots', [], r'robots is \[\]: it must be a list of different choices'),
    ('robots', [3, 3], r'robots is \[3, 3\]: it must be a list of different choices'),
    ('robots', [3, 0], 'robots is 0.*from 1'),
    ('prior', [{'hazard': 0.3}, {'target': 0.3}], 'prior.target is missing'),
    ('seed', -1, 'seed is -1.*from 0 to'),
    ('lethalities', [0.5, 1.5], r'lethalities is 1\.5.*from 0\.0 to 1\.0'),
    ('lethalities', [], r'lethalities is \[\].*at least one'),
    ('lethalities', 0.5, 'lethalities is 0.5.*a list'),
    ('lethalities', [0.5, 0.50], 'lethalities.*each entry may occur only once'),
    ('methods', ['magic'], 'methods is .magic.*kappa_bnitp_sampled'),
    ('world.kappa', -0.1, r'world.kappa is -0\.1.*from 0\.0 to 1\.0'),
    ('teams', [{'agents': 0}], 'teams.agents is 0.*from 1'),
    ('teams', [{}, {'planner': 'relaxed'}], 'teams: two teams are the same with the defaults'),
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
        read_study(file)


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
        read_study(file)
    assert '\n' not in str(refusal.value)


def test_teams_are_what_the_file_says_and_robots_go_one_by_one_without(tmp_path, scenario):
    teams = [{'agents': 4, 'allocation': 'voronoi', 'loss_cost': 0.5}, {'agents': 2}, {}]
    content = {**small_study.CONTENT, 'teams': teams}
    read = read_study(small_study.write(tmp_path / 'scenario.yaml', content)).first
    assert read.teams == (Strategy(4, 'voronoi', 0.5), Strategy(2, 'greedy', 0.0), Strategy(1))
    assert len(read.contenders) == 3 * 3
    assert [read.contenders['kappa_bnitp', team] for team in read.teams] == [
        'kappa_bnitp, agents 4, allocation voronoi, loss cost 0.5',
        'kappa_bnitp, agents 2, allocation greedy, loss cost 0.0',
        'kappa_bnitp, agents 1, allocation greedy, loss cost 0.0',
    ]
    assert list(scenario.contenders.values()) == list(scenario.methods)


@for_each('teams, names', [
    ([{}], ['kappa_bnitp']),
    ([{'planner': 'coverage'}], ['kappa_bnitp, coverage']),
    ([{}, {'planner': 'coverage'}], ['kappa_bnitp, relaxed', 'kappa_bnitp, coverage']),
    ([{'dynamics': 'static'}, {}],
     ['kappa_bnitp, dynamics static', 'kappa_bnitp, dynamics used_up']),
    ([{}, {'goal': 'map', 'survey': 0.9}],
     ['kappa_bnitp, survey 0.0', 'kappa_bnitp, survey 0.9']),
])  # fmt: skip
def test_strategies_are_named_by_their_method_planner_and_differences(teams, names):
    changes = {'teams': teams, 'methods': 'kappa_bnitp', 'hazards': {'dynamics': 'used_up'}}
    study = parse_study(small_study.CONTENT, changes)
    assert list(study.first.contenders.values()) == names


def test_lists_are_choices_and_teams_with_lists_are_strategies():
    content = {
        **small_study.CONTENT,
        'robots': [4, 5],
        'prior': [{'hazard': h, 'target': 0.31, 'kappa': 0.8} for h in (0.3, 0.2)],
        'teams': [{'loss_cost': [0, 0.5]}, {'agents': 2}],
    }
    study = parse_study(content)
    assert study.axes == ('robots', 'hazard', 'target', 'prior.kappa')
    assert [(choices[0], choices[1]) for choices in study.scenarios] == [
        (robots, hazard) for robots in (4, 5) for hazard in (0.3, 0.2)
    ]
    for choices, scenario in study.scenarios.items():
        assert (scenario.robots, scenario.prior.hazard) == choices[:2]
        assert [team.loss_cost for team in scenario.teams] == [0.0, 0.5, 0.0]
    assert parse_study(study.content) == study


def test_every_number_and_name_of_a_scenario_can_be_set(study):
    """By its shortest name; with a list of one it is a choice."""
    for name in list_names():
        section, _, last = name.rpartition('.')
        if section in ('asked', 'teams') or name in ('trials', 'learn', 'asked', 'teams'):
            continue
        value = study.content[section][last] if section else study.content[name]
        if isinstance(value, dict | tuple):
            continue
        changed = parse_study(small_study.CONTENT, {name: [value]})
        assert len(changed.axes) == 1
        assert changed.axes[0] in (name, last)
        assert changed.scenarios == {(value,): study.first}


@for_each('texts, changes', [
    (['max_visits=1,3'], {'max_visits': [1, 3]}),
    (['prior.kappa=0.5', 'ties=random'], {'prior.kappa': 0.5, 'ties': 'random'}),
    (['ties=first,random'], {'ties': ['first', 'random']}),
    (['teams=[{agents: 2}, {loss_cost: 0.1}]'], {'teams': [{'agents': 2}, {'loss_cost': 0.1}]}),
    (['believed_lethality=null,1e-1'], {'believed_lethality': [None, 0.1]}),
])  # fmt: skip
def test_changes_are_read_from_texts(texts, changes):
    assert read_changes(texts) == changes
    parse_study(small_study.CONTENT, changes)


@for_each('changes, complaint', [
    ({'max_visit': 3}, 'max_visit is unknown: did you mean planning.max_visits'),
    ({'widht': 3}, 'widht is unknown: did you mean grid.width or planning.width'),
    ({'kappa': 0.5}, 'kappa may be world.kappa or prior.kappa: give one'),
    ({'zzzzz': 0.5}, 'zzzzz is unknown: see docs/files.md'),
    ({'max_visits': 0}, 'planning.max_visits is 0.*from 1'),
    ('max_visits=3', "changes is 'max_visits=3': it must be a mapping of names to values"),
])  # fmt: skip
def test_a_name_that_nobody_reads_is_refused_with_the_nearest(changes, complaint):
    with pytest.raises((TypeError, ValueError), match=complaint):
        parse_study(small_study.CONTENT, changes)
    with pytest.raises(ValueError, match='paper.yaml with zzzzz=3: zzzzz is unknown'):
        read_study(SHIPPED / 'paper.yaml', {'zzzzz': 3})
    content = {**small_study.CONTENT, 'prior': [{}, {}]}
    with pytest.raises(ValueError, match=r'prior is \[{}, {}\]: set prior.kappa in each of'):
        parse_study(content, {'prior.kappa': 0.5})
    with pytest.raises(ValueError, match='max_visits has no value: write max_visits=VALUE'):
        read_changes(['max_visits'])


@for_each('second, agents, complaint', [
    (11, 1, 'second_base is 11 and agents is 1'), (99, 2, 'base is 99.*from 0 to'),
])  # fmt: skip
def test_a_second_base_must_fit(second, agents, complaint):
    with pytest.raises(ValueError, match=complaint):
        parse_study(small_study.CONTENT, {'teams': [{'agents': agents, 'second_base': second}]})


def test_bases_of_all_teams_are_free_of_hazards_for_all():
    teams = [{'agents': 2}, {'agents': 2, 'second_base': 11}]
    scenario = parse_study(small_study.CONTENT, {'teams': teams}).first
    assert scenario.field().bases == {5, 11}


@for_each('name', ['teams', 'loss_cost', 'last_contact'])
def test_studies_of_teams_are_of_the_calibrated_robots(name):
    scenario, calibrated = (read_study(SHIPPED / f'{n}.yaml').first for n in (name, 'calibrated'))
    for same in ('robots', 'seed', 'grid', 'planning', 'world', 'sensor', 'prior'):
        assert getattr(scenario, same) == getattr(calibrated, same)


def test_the_shipped_scenarios_are_the_experiment_of_the_paper():
    shipped = {
        name: read_study(SHIPPED / f'{name}.yaml').first
        for name in ('calibrated', 'mismatched', 'paper')
    }
    for scenario in shipped.values():
        assert (scenario.grid.width, scenario.grid.height) == (9, 9)
        assert scenario.robots == 100
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
            'reach': 0.0,
            'duds': 0.0,
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
