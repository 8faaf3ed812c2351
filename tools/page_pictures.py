# SPDX-License-Identifier: Apache-2.0
"""
Take the pictures of a report that the documentation shows.

``python3 tools/page_pictures.py REPORT DOCS/images`` takes them of REPORT/report.html in a
browser, Chromium or Chrome, and of REPORT/maps.png. ``python3 tools/page_pictures.py REPORT
DOCS/images KINDS`` also takes the answer of KINDS/report.html on whether it can be trusted.
"""

from __future__ import annotations

from pathlib import Path
import shutil
import sys

from PIL import Image
from playwright.sync_api import Browser, Page, sync_playwright

BROWSERS = ('chromium', 'chromium-browser', 'google-chrome')
WIDTH, HEIGHT = 1280, 900

# The moment of which the documentation tells how to read it.
EARLY = 11


def main(report: Path, images: Path, kinds: Path | None = None) -> None:
    """Take all pictures."""
    with sync_playwright() as playwright:
        program = next(filter(None, map(shutil.which, BROWSERS)))
        browser = playwright.chromium.launch(executable_path=program, args=['--no-sandbox'])
        page = opened(browser, report, 'light')
        take_maps(page, images / 'page.png')
        # The controls would stand in front of what is taken lower down.
        page.add_style_tag(content='#controls { position: static !important; }')
        page.locator('#curves').screenshot(path=images / 'page_curves.png')
        page.locator('#moment').fill(str(EARLY))
        page.locator('#moment').blur()
        take_maps(page, images / 'page_early.png')
        take_maps(opened(browser, report, 'dark'), images / 'page_dark.png')
        if kinds is not None:
            tiles = opened(browser, kinds, 'light').locator('#answers article')
            tiles.filter(has_text='Can I trust it').screenshot(path=images / 'page_kinds.png')
        browser.close()
    with Image.open(report / 'maps.png') as maps:
        maps.thumbnail((1600, 1600))
        maps.convert('RGB').save(images / 'maps.png', optimize=True)


def opened(browser: Browser, report: Path, scheme: str) -> Page:
    """Return the page of a report, as it is in the light or in the dark."""
    page = browser.new_page(
        viewport={'width': WIDTH, 'height': HEIGHT}, color_scheme=scheme, offline=True
    )
    page.goto((report / 'report.html').resolve().as_uri())
    page.wait_for_selector('html[data-ready]', state='attached')
    return page


def take_maps(page: Page, picture: Path) -> None:
    """Take the page from its title to the signs on the maps."""
    box = page.locator('.key').bounding_box()
    bottom = box['y'] + box['height'] + 10
    clip = {'x': 0, 'y': 0, 'width': WIDTH, 'height': bottom}
    page.screenshot(path=picture, full_page=True, clip=clip)


if __name__ == '__main__':
    main(*map(Path, sys.argv[1:]))
