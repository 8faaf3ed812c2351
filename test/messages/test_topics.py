# SPDX-License-Identifier: Apache-2.0
"""The table of topics, and the pages that repeat it."""

from pathlib import Path
import re

from kbnitp_ros.messages.topics import OF_AGENT, OF_MISSION

DOCS = Path(__file__).parents[2] / 'docs'


def rows(page, heading):
    """Yield the names of topics in the first column of a table, and the other columns."""
    text = page.partition(f'\n## {heading}\n')[2].partition('\n## ')[0]
    for line in text.splitlines():
        if line.startswith('| `'):
            names, *rest = (cell.strip() for cell in line.strip('|').split(' | '))
            for name in re.findall('`([^`]+)`', names):
                yield name, rest


def test_the_page_of_security_has_each_topic_with_its_authors():
    stated = dict(rows((DOCS / 'security.md').read_text(), 'What one forged message can do'))
    topics = OF_MISSION | {f'AGENT/{name}': topic for name, topic in OF_AGENT.items()}
    assert {name: authors.split(', ') for name, (authors, _) in stated.items()} == {
        name: [*topic.authors] for name, topic in topics.items()
    }


def test_the_page_of_topics_has_each_topic_with_its_type():
    lines = [line for line in (DOCS / 'topics.md').read_text().splitlines() if line[:2] == '| ']
    own = {f'scout_1/{name}': topic for name, topic in OF_AGENT.items() if name not in OF_MISSION}
    for name, topic in (OF_MISSION | own).items():
        package, _, kind = topic.type_name.split('/')
        assert any(f'`{name}`' in line and f'{package}/{kind}' in line for line in lines), name
