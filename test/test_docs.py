# SPDX-License-Identifier: Apache-2.0
"""The numbers in the pages that are those of the code."""

from pydoc import locate
import re

from demo_mission import demo_mission
from documented import ROOT, rows, words
from kbnitp_ros.configuration import TABLE
from kbnitp_ros.core import log_loss
from kbnitp_ros.log import mcap_file as file_writer
from kbnitp_ros.nodes.runtime import qos
import numpy as np
import pytest

DEFAULTS = {parameter.name: parameter.default for parameter in TABLE}


def says(page, text):
    """See that a page has a text."""
    assert text in words(page), text


def test_what_the_demo_is_said_to_do():
    page = 'README.md'
    says(page, f'of {DEFAULTS["grid.width"]}x{DEFAULTS["grid.height"]} cells')
    says(page, f'The demo deploys {DEFAULTS["robots"]} robots')
    says(page, f'A hundred robots, {100 * DEFAULTS["sensor.lethality"]:.0f} % lethality')
    assert DEFAULTS['robots'] == 100


@pytest.mark.slow
def test_what_the_demo_is_said_to_find():
    first, deployments, world, _ = demo_mission()
    beliefs = [first, *(deployment.belief for deployment in deployments)]
    entropy = [f'{belief.entropy():.1f}' for belief in beliefs]
    loss = [
        f'{log_loss(belief.hazard, world.hazard) + log_loss(belief.target, world.target):.1f}'
        for belief in beliefs
    ]
    lost = [number for number, each in enumerate(deployments, 1) if not each.observation.survived]
    says('README.md', f'Of the robots {len(lost)} were lost')
    says('README.md', f'the entropy fell from {entropy[0]} to {entropy[-1]} nats')
    page = 'docs/reading.md'
    says(page, f'begins with {entropy[0]} nats in both and ends with {entropy[-1]}')
    says(page, f'rises from {entropy[8]} nats after the eighth robot to {entropy[23]} after the')
    assert {*range(9, 24)} <= {*lost}
    says(page, f'from {loss[1]} nats after the first robot to {loss[-1]} after the last')
    for name, words_of in (('lethality', 'with a lethality of'), ('hazard_density', 'ends at')):
        known = deployments[-1].parameters[name]
        low, middle, high = (known.quantile(each) for each in (0.05, 0.5, 0.95))
        says(page, f'{words_of} {middle:.2f}, between {low:.2f} and {high:.2f}')

    def gained(robots):
        before_and_after = ((beliefs[robot - 1], beliefs[robot]) for robot in robots)
        one, two, three = (
            f'{a.joint_entropy() - b.joint_entropy():.1f}' for a, b in before_and_after
        )
        return f'{one}, {two} and {three} nats'

    in_vain, home = (93, 94, 100), (56, 58, 73)
    assert {*in_vain} <= {*lost}
    assert {*home}.isdisjoint(lost)
    says(page, f'robots 93, 94 and 100 were lost and gained next to nothing: {gained(in_vain)}')
    says(page, f'robots 56, 58 and 73 returned and gained {gained(home)}')
    # The dark cells after the eleventh robot.
    dark = np.flatnonzero(beliefs[11].hazard > 0.4)
    assert dark.tolist() == [2, 3, 11, 12, 20, 27, 30, 36, 38]


def test_which_quality_of_service_topics_are_said_to_have():
    topics = rows('docs/topics.md', 'QoS')
    for topic, profile in (
        ('belief', qos.LATCHED),
        ('belief/hazard', qos.LATCHED),
        ('/tf', qos.POSES),
    ):
        (line,) = (cells for head, cells in topics.items() if head.split('`')[0] == topic)
        assert line[-1].endswith(f', {profile.depth}'), topic
        assert ('transient local' in line[-1]) == (profile is qos.LATCHED)


def test_how_much_a_log_is_said_to_lose():
    assert file_writer.CHUNK == 2**20
    says('docs/log.md', 'at most 1 MiB of them')


def test_the_glossary_is_short_and_names_code_that_is_there():
    glossary = ROOT.joinpath('docs/glossary.md').read_text()
    words_explained = re.findall(r'^\| (?!word)[a-z]', glossary, re.MULTILINE)
    assert 0 < len(words_explained) < 25
    names = re.findall(r'`(core\.[\w.]+)`', glossary)
    assert names
    assert [name for name in names if locate(f'kbnitp_ros.{name}') is None] == []
