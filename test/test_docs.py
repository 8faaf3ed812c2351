# SPDX-License-Identifier: Apache-2.0
"""The numbers in the pages that are those of the code."""

from pydoc import locate
import re

from documented import ROOT, rows, words
from kbnitp_ros.core.inference import chain_state, chains, sampled, smoothed, swept, unknowns
from kbnitp_ros.core.planning import fates, greedy, labels, moments, voronoi
from kbnitp_ros.log.bag import part
from kbnitp_ros.nodes import qos
from kbnitp_ros.nodes.parameters import TABLE
from kbnitp_ros.study.scenario import read_scenario
import pytest
import yaml

IN_WORDS = {
    2: 'two',
    4: 'four',
    5: 'five',
    6: 'six',
    8: 'eight',
    9: 'nine',
    10: 'ten',
    30: 'thirty',
}
DEFAULTS = {parameter.name: parameter.default for parameter in TABLE}


def says(page, *parts):
    """See that a page has a text, each number in it in words or in digits as it has them."""
    text = ''.join(IN_WORDS.get(part, str(part)) for part in parts)
    assert text in words(page), text


def test_what_the_method_is_said_to_take():
    page = 'docs/mathematics.md'
    cells = smoothed.CONDITIONED_CELLS
    says(page, 'the ', cells, ' undecided cells that the messages say most about')
    says(page, f'to each of their {2**cells} joint values in turn')
    says(page, f'by more than a part in {1 / smoothed.TOLERANCE:,.0f} tells its factors')
    says(page, 'or for ', smoothed.ROUNDS, ' rounds')
    says(page, 'sent again after each deployment, ', swept.SWEEPS, ' times at most')


def test_what_sampling_is_said_to_take():
    page = 'docs/mathematics.md'
    says(page, f'in each of {chain_state.CHAINS} chains')
    says(page, IN_WORDS[chains.EXCHANGES].capitalize(), ' exchanges: a lost path is drawn')
    says(page, f'one of {unknowns.VALUES} values')
    says(
        page, f'so {chain_state.GROUPS} groups of {chain_state.CHAINS // chain_state.GROUPS} give'
    )
    says(page, f'the variance v / {chain_state.GROUPS}')
    says(page, f'Σ v / ({chain_state.GROUPS} · 2 p)')
    says(page, f'until it is below {sampled.Sampler.settled:.5f} nats')
    says(page, f'below {sampled.Sampler.settled_learning:.3f} where numbers are learnt')
    says(page, f'and {sampled.MOST_SWEEPS} at most')
    says(page, IN_WORDS[sampled.SWEEPS].capitalize(), ' sweeps are made at a time')


def test_what_the_search_is_said_to_take():
    page = 'docs/mathematics.md'
    says(page, 'Values are compared to ', labels.DECIMALS, ' decimals')
    says(page, 'A label carries ', moments.EXPONENTS.size, ' moments')
    says(page, f'exponents from 1 to {moments.EXPONENTS[-1]:.0f}')
    says(page, f'an error of at most {1e5 * moments.ERROR:.3g}e-5 nats')
    says(page, 'the error is as large ', moments.WEIGHTS.size + 1, ' times')
    says(page, f'In the {IN_WORDS[labels.RANKED]} best closed paths, one or two cells in a row')
    says(page, f'So they are in {IN_WORDS[labels.TURNED]} paths that go to a cell')
    says(page, f'In the {IN_WORDS[labels.BEST]} best of all these, up to three cells in a row')
    assert labels.EXCHANGED == 2
    says(page, f'Of more than {fates.MOST_FATES} fates the least probable are merged')
    says(page, 'from the sixth robot on, fates are merged')
    # The fates before robot j are 2^(j-1).
    assert 2 ** (5 - 1) <= fates.MOST_FATES < 2 ** (6 - 1)
    most = greedy.ROBOTS_SIDE_BY_SIDE
    says(page, f'{most // 2} teams of two robots, {most // 4} of four, {most // 8} of eight')
    says(page, 'one of nine and more')
    assert most // 9 == 1 < most // 8
    says(page, 'readings tell in the regions of others counted at a tenth')
    assert voronoi.ELSEWHERE == 0.1


def test_what_the_demo_is_said_to_do():
    page = 'README.md'
    says(page, f'of {DEFAULTS["grid.width"]}x{DEFAULTS["grid.height"]} cells')
    says(page, f'The demo deploys {DEFAULTS["robots"]} robots')
    says(page, f'A hundred robots, {100 * DEFAULTS["sensor.lethality"]:.0f} % lethality')
    assert DEFAULTS['robots'] == 100


def test_what_a_study_is_said_to_take():
    scenario = read_scenario(ROOT / 'scenarios/paper.yaml')
    methods, lethalities = len(scenario.methods), len(scenario.lethalities)
    says('README.md', methods, ' methods, ', lethalities, ' lethalities')
    says('README.md', f'{scenario.trials} worlds, {scenario.robots} robots each')
    field = scenario.grid
    says('docs/results.md', f'A field of {field.width}\N{MULTIPLICATION SIGN}{field.height} cells')
    says('docs/results.md', f'{scenario.robots} robots, {scenario.trials} worlds')
    world = scenario.world.hazard_density
    says('docs/results.md', f'cells for hazardous where {100 * world:.0f} % are')
    says('docs/results.md', f'holds {100 * scenario.prior.hazard:.0f} % of the cells')
    says('docs/results.md', 'kappa says that four of five hazards have one')
    assert scenario.prior.kappa == 4 / 5


def test_what_worlds_and_loss_costs_the_other_studies_are_said_to_have():
    teams, loss_cost = (
        read_scenario(ROOT / f'scenarios/{name}.yaml') for name in ('teams', 'loss_cost')
    )
    says('docs/results.md', 'Ten worlds')
    assert teams.trials == 10
    says('docs/results.md', f'One by one, {loss_cost.trials} worlds')


def test_which_quality_of_service_topics_are_said_to_have():
    topics = rows('README.md', 'QoS')
    for topic, profile in (
        ('belief', qos.LATCHED),
        ('belief/hazard', qos.LATCHED),
        ('/tf', qos.POSES),
    ):
        (line,) = (cells for head, cells in topics.items() if head.split('`')[0] == topic)
        assert line[-1].endswith(f', {profile.depth}'), topic
        assert ('transient local' in line[-1]) == (profile is qos.LATCHED)


def test_how_much_a_log_is_said_to_lose():
    assert part.CHUNK == 2**20
    says('docs/log.md', 'at most 1 MiB of them')


@pytest.mark.parametrize('scenario', ['paper', 'calibrated', 'mismatched'])
def test_the_paper_gives_what_mathematics_says_it_gives(scenario):
    sensor = yaml.safe_load(ROOT.joinpath(f'scenarios/{scenario}.yaml').read_text())['sensor']
    says('docs/mathematics.md', '5 % malfunction and 5 % false negatives a step')
    assert sensor['malfunction'] == sensor['false_negative'] == 0.05


def test_the_glossary_names_code_that_is_there():
    glossary = ROOT.joinpath('docs/glossary.md').read_text()
    names = re.findall(r'`((?:core|log|study)[\w.]*)`', glossary)
    assert len(names) > 20
    assert [name for name in names if locate(f'kbnitp_ros.{name}') is None] == []
