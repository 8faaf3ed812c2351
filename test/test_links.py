# SPDX-License-Identifier: Apache-2.0
"""The links within the pages lead somewhere, to files and to headings; no network is needed."""

from collections import Counter
import json
from pathlib import Path
import re

from laws import for_each

ROOT = Path(__file__).parents[1]
PAGES = [
    *(path for folder in ('', 'msg_defs') for path in sorted((ROOT / folder).glob('*.md'))),
    *sorted(ROOT.joinpath('docs').rglob('*.md')),
    *sorted(ROOT.joinpath('docs').rglob('*.ipynb')),
]
CODE = re.compile(r'^```.*?^```', re.MULTILINE | re.DOTALL)
LINK = re.compile(r'\]\(<?([^)\s>]+)>?\)')
HEADING = re.compile(r'^#+ (.+?)\s*$', re.MULTILINE)


def text(path):
    """Return what a page says, without its code."""
    said = path.read_text()
    if path.suffix == '.ipynb':
        cells = json.loads(said)['cells']
        said = '\n\n'.join(''.join(e['source']) for e in cells if e['cell_type'] == 'markdown')
    return CODE.sub('', said)


def anchors(said):
    """Yield what the headings of a page are called in links, as GitHub and MyST have it."""
    count = Counter()
    for heading in HEADING.findall(said):
        words = re.sub(r'\[(.*?)\]\(.*?\)', r'\1', heading).lower()
        name = re.sub(r'[^\w\- ]', '', words).replace(' ', '-')
        yield f'{name}-{count[name]}' if count[name] else name
        count[name] += 1


def dead(path):
    """Yield the links of a page that lead nowhere."""
    for link in LINK.findall(text(path)):
        if re.match(r'\w+:', link):
            continue
        file, _, anchor = link.partition('#')
        target = path.parent / file if file else path
        if not target.exists() or (anchor and anchor not in anchors(text(target))):
            yield link


@for_each('path', PAGES)
def test_links_lead_somewhere(path):
    assert list(dead(path)) == []


def test_a_dead_link_is_found(tmp_path):
    page = tmp_path / 'page.md'
    page.write_text(
        '# One & two\n## Again\n## Again\n'
        '[a](#again) [a](#again-1) [a](#one--two) [a](page.md#one--two) '
        '[b](#again-2) [b](#three) [b](gone.md) [b](page.md#four)\n'
        '```\n[c](code.md)\n```\n'
        '[d](https://example.org/#h)\n'
    )
    assert list(dead(page)) == ['#again-2', '#three', 'gone.md', 'page.md#four']
