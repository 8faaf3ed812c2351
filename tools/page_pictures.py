# SPDX-License-Identifier: Apache-2.0
"""
Take the pictures of a report that the documentation shows.

``python3 tools/page_pictures.py REPORT DOCS/images`` takes them of REPORT/report.html in a
browser, Chromium or Chrome. ``python3 tools/page_pictures.py REPORT
DOCS/images KINDS LANE`` also takes the answer of KINDS/report.html on whether it can be trusted,
and the map of LANE/report.html before the first robot and after the last.
"""

from __future__ import annotations

from base64 import b64encode
from pathlib import Path
import shutil
import sys

from playwright.sync_api import Browser, Page, sync_playwright

BROWSERS = ('chromium', 'chromium-browser', 'google-chrome')
WIDTH, HEIGHT = 1280, 900

# The moment of which the documentation tells how to read it.
EARLY = 11

# Buttons, and controls that would stand in front of what is taken lower down.
IN_PRINT = '.save { display: none; } #controls { position: static !important; }'


def main(report: Path, images: Path, kinds: Path | None = None, lane: Path | None = None) -> None:
    """Take all pictures."""
    with sync_playwright() as playwright:
        program = next(filter(None, map(shutil.which, BROWSERS)))
        browser = playwright.chromium.launch(executable_path=program, args=['--no-sandbox'])
        page = opened(browser, report, 'light')
        take_answers(page, images / 'page.png')
        page.add_style_tag(content=IN_PRINT)
        page.locator('#curves').screenshot(path=images / 'page_curves.png')
        move(page, EARLY)
        take_answers(page, images / 'page_early.png')
        take_answers(opened(browser, report, 'dark'), images / 'page_dark.png')
        take_change(browser, report, images / 'before_after.png')
        if kinds is not None:
            tiles = opened(browser, kinds, 'light').locator('#answers article')
            tiles.filter(has_text='Can I trust it').screenshot(path=images / 'page_kinds.png')
        if lane is not None:
            take_change(browser, lane, images / 'page_lane.png')
        browser.close()


def opened(browser: Browser, report: Path, scheme: str) -> Page:
    """Return the page of a report, as it is in the light or in the dark."""
    page = browser.new_page(
        viewport={'width': WIDTH, 'height': HEIGHT}, color_scheme=scheme, offline=True
    )
    page.goto((report / 'report.html').resolve().as_uri())
    page.wait_for_selector('html[data-ready]', state='attached')
    return page


def move(page: Page, moment: int) -> None:
    """Show a moment."""
    page.locator('#moment').fill(str(moment))
    page.locator('#moment').blur()


def take_answers(page: Page, picture: Path) -> None:
    """Take the page from its title to the signs on the map."""
    box = page.locator('.key').bounding_box()
    bottom = box['y'] + box['height'] + 10
    clip = {'x': 0, 'y': 0, 'width': WIDTH, 'height': bottom}
    page.screenshot(path=picture, full_page=True, clip=clip)


def take_change(browser: Browser, report: Path, picture: Path) -> None:
    """Take the map before the first robot beside that after the last."""
    page = opened(browser, report, 'light')
    page.add_style_tag(content=IN_PRINT)
    last = page.locator('#map').screenshot()
    robots = page.get_attribute('#moment', 'max')
    move(page, 0)
    first = page.locator('#map').screenshot()
    figures = ''.join(
        f'<figure style="margin: 0"><figcaption>{caption}</figcaption>'
        f'<img src="data:image/png;base64,{b64encode(taken).decode()}"></figure>'
        for caption, taken in (('before', first), (f'after {robots} robots', last))
    )
    style = 'display: inline-flex; font: 20px sans-serif; text-align: center; background: white'
    both = browser.new_page(viewport={'width': 2 * WIDTH, 'height': HEIGHT}, offline=True)
    both.set_content(f'<div style="{style}">{figures}</div>')
    both.locator('div').screenshot(path=picture)


if __name__ == '__main__':
    main(*map(Path, sys.argv[1:]))
