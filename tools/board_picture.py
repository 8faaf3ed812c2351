# SPDX-License-Identifier: Apache-2.0
"""
Take the picture of the board that the documentation shows.

``python3 tools/board_picture.py ADDRESS DOCS/images/board.png`` takes it of a mission that runs,
from the address that ``watch --control`` has printed, once something waits for a person.
"""

from __future__ import annotations

from pathlib import Path
import shutil
import sys

from page_pictures import BROWSERS, HEIGHT, WIDTH
from playwright.sync_api import sync_playwright


def main(address: str, picture: Path) -> None:
    """Take the picture, from the board to the orders below the map."""
    with sync_playwright() as playwright:
        program = next(filter(None, map(shutil.which, BROWSERS)))
        browser = playwright.chromium.launch(executable_path=program, args=['--no-sandbox'])
        page = browser.new_page(viewport={'width': WIDTH, 'height': HEIGHT})
        page.goto(address)
        page.wait_for_selector('html[data-ready]', state='attached')
        page.locator('#needs li').wait_for()
        top, bottom = (page.locator(each).bounding_box() for each in ('#board', '#orders'))
        height = bottom['y'] + bottom['height'] - top['y'] + 20
        clip = {'x': 0, 'y': top['y'] - 10, 'width': WIDTH, 'height': height}
        page.screenshot(path=picture, full_page=True, clip=clip)
        browser.close()


if __name__ == '__main__':
    main(sys.argv[1], Path(sys.argv[2]))
