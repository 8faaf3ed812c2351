# SPDX-License-Identifier: Apache-2.0
"""The site of docs/ works offline, and its equations are typeset."""

from fcntl import flock, LOCK_EX
from itertools import product
from pathlib import Path
import re
import shutil
import subprocess
import sys

from kbnitp_ros import core
import pytest

ROOT = Path(__file__).parents[1]
DOCS = ROOT / 'docs'
DERIVATIONS = ['mathematics', *sorted(f'mathematics/{p.stem}' for p in DOCS.glob('mathematics/*'))]
# `make docs` fails on warnings by itself.
pytestmark = [pytest.mark.full, pytest.mark.processes]

# Sphinx as on a machine without ROS.
SPHINX = """
import sys
sys.modules.update(dict.fromkeys(('rclpy', 'kbnitp_msgs', 'ament_index_python')))
from sphinx.cmd.build import main
sys.exit(main(sys.argv[1:]))
"""

# Pixels of a phone, a tablet and a desktop; with colour schemes, which change no width.
WIDTHS = 390, 800, 1400
LOOKS = [*product(WIDTHS, ['light']), (WIDTHS[-1], 'dark')]
# Where `make docs` puts the site as well.
PICTURES = ROOT / 'build/docs/pictures'

LOADED = re.compile(r'<(?:script|link|img|iframe|source)\b[^>]*?\b(?:src|href)="([^"]*)"')


@pytest.fixture(scope='module')
def site(tmp_path_factory, worker_id):
    """Return the folder of the site, built like by `make docs` but without ROS, once for all."""
    pytest.importorskip('sphinx', reason='make docs installs what the site needs')
    own = tmp_path_factory.getbasetemp()
    html = (own if worker_id == 'master' else own.parent) / 'site'
    options = ['--fail-on-warning', '--keep-going', '--quiet', '-d', html / '.doctrees']
    sphinx = [sys.executable, '-c', SPHINX, *options, '-b', 'html', DOCS, html]
    with html.with_suffix('.lock').open('w') as lock:
        flock(lock, LOCK_EX)
        if not html.exists():
            made = subprocess.run(sphinx, capture_output=True, text=True, timeout=600)
            assert made.returncode == 0, made.stderr
    return html


def missing(site):
    """Yield resources of pages that are not files of the site."""
    for page in site.rglob('*.html'):
        for source in LOADED.findall(page.read_text()):
            path = page.parent / source.partition('?')[0].partition('#')[0]
            if not source.startswith(('data:', '#')) and not path.is_file():
                yield f'{page.name}: {source}'


def test_pages_load_only_files_of_the_site(site):
    assert list(missing(site)) == []


@pytest.mark.parametrize('name', DERIVATIONS)
def test_every_equation_is_typeset_without_a_network(site, browser, name):
    labels = re.findall(r'^ *:label: (\S+)$', (DOCS / f'{name}.md').read_text(), re.M)
    page = browser.new_context(offline=True).new_page()
    failed = []
    page.on('requestfailed', lambda request: failed.append(request.url))
    page.goto((site / f'{name}.html').as_uri())
    page.evaluate('MathJax.startup.promise')
    typeset = {
        label: page.locator(f'[id="equation-{label}"] mjx-container[display="true"]').count()
        for label in labels
    }
    wrong = page.locator('mjx-merror, [data-mjx-error]').all_inner_texts()
    assert len(labels) >= 6
    assert typeset == dict.fromkeys(labels, 1)
    assert wrong == []
    assert failed == []


# Search terms of users, and the page that answers each.
SOUGHT = {
    'approve': 'operator',
    'blast': 'tutorials/heard',
    'certificate': 'results/goals',
    'GPS': 'maps',
    'lane': 'tutorials/safe_lane',
    'minefield': 'maps',
    'Nav2': 'robots',
    'obstacle': 'maps',
    'RViz': 'commands',
    'survivors': 'mathematics',
}


def test_terms_of_users_are_found_among_the_first_three(site, browser):
    page = browser.new_page()
    found = {}
    for word in SOUGHT:
        page.goto(f'{(site / "search.html").as_uri()}?q={word}')
        page.wait_for_selector('#search-results .search-summary:has-text("found")')
        links = page.locator('#search-results li > a')
        hrefs = links.evaluate_all('links => links.map(a => a.getAttribute("href"))')
        found[word] = list(dict.fromkeys(re.split(r'\.html', href)[0] for href in hrefs))[:3]
    assert {word: page for word, page in SOUGHT.items() if page not in found[word]} == {}, found


def test_no_page_is_wider_than_the_window(site, browser):
    """Images of all pages are kept beside the site of `make docs`."""
    # The pages of objects are made alike: one with many arguments stands for all.
    alike = site / 'api/generated'
    pages = [site / page.relative_to(DOCS).with_suffix('.html') for page in DOCS.rglob('*.md')]
    pages = [page for page in pages if page.parent != alike]
    pages.append(alike / 'kbnitp_ros.core.run_mission.html')
    shutil.rmtree(PICTURES, ignore_errors=True)
    wider = []
    for width, scheme in LOOKS:
        window = {'width': width, 'height': 1000}
        shown = browser.new_context(viewport=window, color_scheme=scheme, offline=True).new_page()
        # Equations take time to render on a busy machine.
        shown.set_default_timeout(300_000)
        for page in pages:
            name = page.relative_to(site).with_suffix('.png')
            shown.goto(page.as_uri())
            if shown.evaluate('document.documentElement.scrollWidth') > width:
                wider.append(f'{name.stem} at {width}')
            picture = PICTURES / f'{width}_{scheme}' / name
            picture.parent.mkdir(parents=True, exist_ok=True)
            shown.screenshot(path=picture)
        shown.close()
    assert wider == []


@pytest.mark.parametrize('width', WIDTHS)
def test_meanings_of_parameters_are_read_without_moving_a_table(site, browser, width):
    page = browser.new_page(viewport={'width': width, 'height': 1000})
    page.goto((site / 'parameters.html').as_uri())
    shown = page.evaluate(
        """() => [...document.querySelectorAll('.table-wrapper')].map((table) => [
            table.scrollWidth - table.clientWidth,
            ...[...table.querySelectorAll('tr:nth-child(2) td')].map((each) => each.clientWidth),
        ])"""
    )
    page.close()
    assert len(shown) > 4
    for hidden, *columns in shown:
        assert hidden <= 0
        assert columns[-1] == max(columns)


def test_every_public_name_of_the_core_is_found_by_search_and_other_projects(site):
    from sphinx.util.inventory import InventoryFile

    with (site / 'objects.inv').open('rb') as file:
        inventory = InventoryFile.load(file, '', lambda base, uri: uri)
    listed = {name for kind in inventory if kind.startswith('py:') for name in inventory[kind]}
    assert [name for name in core.__all__ if f'kbnitp_ros.core.{name}' not in listed] == []
