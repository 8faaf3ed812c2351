# SPDX-License-Identifier: Apache-2.0
"""The page of a mission in a real browser: it shows the log, accessibly."""

import csv
from dataclasses import replace
import gzip
import io
from itertools import product
import json
from pathlib import Path
import re
import shutil
import subprocess
import sys

from extent import FULL, some
from kbnitp_ros.core import Decision, Dynamics, HazardDraws, Observation, Unknowns
from kbnitp_ros.log.configuration import parameters_record
from kbnitp_ros.log.read import PARAMETERS
from kbnitp_ros.log.write import LogWriter
from kbnitp_ros.report.answers import (
    classify_cells,
    expected_losses,
    expected_used_up,
    list_findings,
    used_up_at,
)
from kbnitp_ros.report.mission import read_summary
from kbnitp_ros.report.page import mission_page
from kbnitp_ros.report.tables import mission_curves
from kbnitp_ros.study.scenario import NUMBERS
from laws import for_each
import mission_log
from mission_log import GRID, record, record_to
from missions import sent_by_single, Shown, single, team
import numpy as np
from PIL import Image
from pyproj import Geod
import pytest

# Latitude and longitude in degrees and heading in rad, as in the parameter.
DATUM = (55.944904, -3.186693, 0.4)
EARTH = Geod(ellps='WGS84')

AXE = Path(__file__).parent / 'node_modules/axe-core/axe.min.js'
NAMES = ('hazard', 'target', 'kappa')


def page_file(mission):
    page = mission.log.with_name('report.html')
    page.write_text(mission_page(mission, mission_curves(mission))[0])
    return page


@pytest.fixture(scope='module')
def shown(tmp_path_factory):
    """Return a mission of 30 robots and the file of its page."""
    folder = tmp_path_factory.mktemp('page')
    mission = read_summary(single(folder / 'mission.mcap', 30))
    return mission, page_file(mission)


@pytest.fixture(scope='module')
def tabs(browser):
    """Return an offline tab for each policy, and their console messages."""
    said = []

    def tab(is_strict):
        # Playwright's waits evaluate text, which the page's own policy forbids.
        page = browser.new_context(offline=True, bypass_csp=not is_strict).new_page()
        page.on('console', lambda message: said.append(message.text))
        page.on('pageerror', lambda error: said.append(str(error)))
        page.on('request', lambda request: said.append(request.url) if is_sent(request) else None)
        return page

    return [tab(False), tab(True)], said


@pytest.fixture
def opened(tabs, shown):
    pages, said = tabs

    def open_page(width=1600, height=1000, scheme='light', file=shown[1], is_strict=False):
        page = pages[is_strict]
        page.set_viewport_size({'width': width, 'height': height})
        page.emulate_media(media='screen', color_scheme=scheme)
        page.mouse.move(0, 0)
        page.goto(file.as_uri())
        page.wait_for_selector('html[data-ready]', state='attached')
        return page

    said.clear()
    yield open_page
    assert said == []


def downloaded(page, name, nth=0):
    """Press a button; return the saved file."""
    with page.expect_download() as download:
        page.get_by_role('button', name=name).nth(nth).click()
    return Path(download.value.path())


def rows(file):
    """Return the rows of a table in CSV."""
    with file.open(newline='') as table:
        return list(csv.DictReader(table))


def is_sent(request):
    """Return whether a request leaves the page: not its file, data or blobs."""
    return not request.url.startswith(('file:', 'data:', 'blob:'))


def drawn(page, name):
    """Return the drawn values of a map, shape (cells,); NaN where there is none."""
    rows = page.evaluate(f'document.getElementById("{name}").data[0].z')
    return np.array(rows, dtype=float).ravel()


def coloured(page, name):
    """Return the values of the map that determine its colours."""
    page.check(f'#colour-{name}')
    return drawn(page, 'map')


def marked(page, name, grid):
    marks = f'document.getElementById("map").data.filter((trace) => trace.name === "{name}")'
    points = page.evaluate(f'{marks}.map((trace) => [trace.x, trace.y])')
    if not points:
        return None
    x, y = (np.array(each[::2], dtype=float) for each in points[0])
    columns, rows = ((each - start) / grid.resolution for each, start in zip((x, y), grid.origin))
    return sorted((rows.astype(int) * grid.width + columns.astype(int)).tolist())


def move(page, moment):
    page.evaluate(
        """moment => {
            const slider = document.getElementById('moment');
            slider.value = moment;
            slider.dispatchEvent(new Event('input'));
        }""",
        int(moment),
    )
    assert page.evaluate('document.documentElement.dataset.moment') == str(moment)


def place(page, cell):
    """Return the centre of a cell on the screen."""
    x, y = page.evaluate(
        """cell => {
            const map = maps.get('map');
            const view = map.place(map.box.clientWidth, map.box.clientHeight);
            return map.at(view, ...map.center(cell));
        }""",
        int(cell),
    )
    box = page.locator('#map canvas').bounding_box()
    return box['x'] + x, box['y'] + y


def pixel(page, x, y):
    """Return the red, green and blue of a pixel on the screen."""
    image = page.screenshot(clip={'x': int(x), 'y': int(y), 'width': 1, 'height': 1})
    return np.array(Image.open(io.BytesIO(image)).convert('RGB')).ravel()


def test_the_maps_of_each_moment_are_the_belief_on_record(opened, shown):
    mission, _ = shown
    page = opened()
    chosen = np.random.default_rng(0).choice(len(mission.moments), 8 if FULL else 3, False)
    for moment in chosen:
        move(page, moment)
        belief, inside = mission.moments[moment].belief, mission.grid.free
        for name in NAMES:
            levels = np.rint(255 * getattr(belief, name))
            # Kappa is shown where a hazard is possible.
            hidden = ~inside | ((name == 'kappa') & (np.rint(255 * belief.hazard) <= 12))
            drawn_as = np.rint(255 * coloured(page, name))
            assert np.array_equal(drawn_as, np.where(hidden, np.nan, levels), equal_nan=True)
            small = np.rint(255 * drawn(page, f'small-{name}'))
            assert np.array_equal(small, drawn_as, equal_nan=True)
        # In steps of 1/255, the resolution of beliefs in the page.
        assert set(marked(page, 'free', GRID)) <= {
            *np.flatnonzero(inside & (belief.hazard <= 0.05))
        }
        assert {*np.flatnonzero(inside & (belief.hazard <= 0.045))} <= set(
            marked(page, 'free', GRID)
        )
    move(page, len(mission.moments) - 1)
    assert marked(page, 'free', GRID) == np.flatnonzero(classify_cells(mission).free).tolist()
    found = [finding for finding in list_findings(mission) if finding['kind'] == 'target']
    for name, is_found in (('found', True), ('target', False)):
        cells = [each['cell'] for each in found if (each['probability'] >= 0.95) == is_found]
        assert marked(page, name, GRID) == sorted(cells)


def test_layers_are_switched_and_the_truth_is_outlined(opened, shown):
    mission, _ = shown
    page = opened()
    move(page, 5)
    assert marked(page, 'true target', GRID) == np.flatnonzero(mission.world.target).tolist()
    # A square within the cell of each hazard, so that those of neighbours do not touch.
    (points,) = page.evaluate(
        """document.getElementById("map").data.filter((trace) => trace.mode === "lines" &&
            trace.line.width === 1.5).map((trace) => [trace.x, trace.y])"""
    )
    squares = np.array(points, dtype=float).T.reshape(-1, 6, 2)[:, :5]
    centers = GRID.centers(np.flatnonzero(mission.world.hazard))
    away = (squares - centers[:, None]) / GRID.resolution
    assert np.all((np.abs(away) > 0.4) & (np.abs(away) < 0.48))
    assert np.array_equal(away[:, 0], away[:, 4])
    for layer, name in (('truth', 'true target'), ('targets', 'target'), ('free', 'free')):
        page.get_by_label(layer, exact=True).uncheck()
        assert marked(page, name, GRID) is None
    walk = 'document.getElementById("map").data[3].x.length'
    assert page.evaluate(walk) > 0
    page.get_by_label('paths', exact=True).uncheck()
    assert page.evaluate(walk) == 0


def test_the_lane_of_a_goal_is_drawn_after_the_last_report(opened, shown, tmp_path):
    mission, _ = shown
    lane = np.array([GRID.base, 1, 0])
    draws = HazardDraws(np.zeros((4, GRID.cells), dtype=bool), 1e6)
    decision = replace(Decision.about('lane', draws, lane, 0.9), path=lane)
    page = opened(file=page_file(replace(mission, decision=decision, log=tmp_path / 'a.mcap')))
    lines = """document.getElementById("map").data.filter((trace) =>
        trace.line?.width === 2.5 && trace.x.length > 1).map((trace) => trace.x.slice(0, -1))"""
    assert page.evaluate(lines) == [pytest.approx(GRID.centers(lane)[:, 0].tolist())]
    move(page, 3)
    assert page.evaluate(lines) == []


def test_lost_at_is_listed_marked_and_stated_consistently(opened, shown):
    mission, _ = shown
    page = opened()
    total = np.zeros(GRID.cells)
    lost = [each for each in mission.deployments if not each.outcome.survived]
    for deployment in lost:
        move(page, deployment.moment)
        table = [row.split('\t') for row in page.locator('#lost tbody').inner_text().split('\n')]
        page.locator('#lost tbody button').first.press('Enter')
        text = f'this robot lost here {table[0][3]}'
        page.wait_for_function(
            'text => document.getElementById("cell").innerText.includes(text)', arg=text
        )
        (x0, y0), side = GRID.origin, GRID.resolution
        places = [(float(x) - x0, float(y) - y0) for x, y, *_ in table]
        listed = [int(y / side) * GRID.width + int(x / side) for x, y in places]
        assert set(listed) == {*deployment.outcome.path[1:].tolist()}
        assert marked(page, 'lost', GRID) == sorted(listed)
        share = [float(row[3]) for row in table]
        assert share == sorted(share, reverse=True)
        assert sum(share) == pytest.approx(1.0, abs=0.01)
        total[listed] += share
    assert total == pytest.approx(expected_losses(mission), abs=0.001 * len(lost))
    assert coloured(page, 'robots-lost')[GRID.free] == pytest.approx(
        expected_losses(mission)[GRID.free], abs=1e-4
    )
    returned = next(each for each in mission.deployments if each.outcome.survived)
    move(page, returned.moment)
    assert not page.locator('#lost').is_visible()


def test_moments_change_by_keys_on_the_slider_and_without_a_focus_and_the_page_plays(
    opened, shown
):
    mission, _ = shown
    page = opened()
    last = len(mission.moments) - 1
    slider = page.locator('#moment')
    assert slider.input_value() == str(last)
    slider.focus()
    page.keyboard.press('ArrowLeft')
    assert slider.input_value() == str(last - 1)
    told = page.locator('#told').inner_text()
    assert told.startswith(f'{last - 1} of 30 deployments assimilated')
    assert slider.get_attribute('aria-valuetext') == told
    page.keyboard.press('Home')
    assert page.locator('#told').inner_text() == 'Before the first deployment.'
    page.get_by_role('button', name='Play').click()
    page.wait_for_function('document.documentElement.dataset.moment >= 3')
    page.get_by_role('button', name='Pause').click()
    page.get_by_role('button', name='One report on').click()
    assert int(slider.input_value()) > 3
    page = opened()
    page.keyboard.press('ArrowLeft')
    page.keyboard.press('ArrowLeft')
    page.keyboard.press('ArrowRight')
    assert page.evaluate('document.documentElement.dataset.moment') == str(last - 1)
    assert page.evaluate('document.getElementById("map").data[3].x.length') > 0
    page.locator('#x').focus()
    page.keyboard.press('ArrowLeft')
    assert page.evaluate('document.documentElement.dataset.moment') == str(last - 1)
    # Every control is reached by the tab key and shows its focus.
    page.locator('body').click(position={'x': 2, 'y': 2})
    for _ in range(9):
        page.keyboard.press('Tab')
        focus = page.evaluate('getComputedStyle(document.activeElement).outlineStyle')
        assert focus == 'solid'


def test_the_path_and_the_readings_of_a_moment_are_drawn(opened, shown):
    mission, _ = shown
    page = opened()
    for place, moment in enumerate(mission.moments[1:8], start=1):
        move(page, place)
        traces = page.evaluate('document.getElementById("map").data.map(each => each.x)')
        centers = mission.grid.centers(moment.outcome.path)
        assert traces[3][:-1] == pytest.approx(centers[:, 0].tolist())
        read = [] if moment.outcome.readings is None else moment.outcome.readings.tolist()
        assert sum(each is not None for each in traces[4]) == read.count(1)
        assert sum(each is not None for each in traces[5]) == read.count(0)


def test_last_contacts_are_drawn(opened, tmp_path):
    whole, path = sent_by_single(2), [GRID.base, 1, 2, 3, 2, 1, GRID.base]
    whole.deploy(Observation(path, False, lost_at=[0.0, 0.1, 0.6, 1.0, 0.5, 0.2]))
    mission = read_summary(record(tmp_path / 'mission.mcap', whole.sent))
    page = opened(file=page_file(mission))
    drawn = 'document.getElementById("map").data.map(each => [each.x, each.y])[7]'
    move(page, 3)
    x, y = page.evaluate(drawn)
    assert np.column_stack([x, y])[:-1].astype(float) == pytest.approx(
        mission.grid.centers(path[2:6])
    )
    facts = page.locator('#deployment').inner_text()
    assert 'after 1 step' in facts
    assert 'in steps 3 to 5' in facts
    move(page, 1)
    assert page.evaluate(drawn)[0] == []


def test_hazards_believed_used_up_are_drawn_and_listed(opened, shown, tmp_path):
    whole = Shown(dynamics=Dynamics('used_up'))
    for _ in range(6):
        whole.deploy(whole.walk())
    mission = read_summary(record(tmp_path / 'mission.mcap', whole.sent))
    page = opened(file=page_file(mission))
    used_up = np.where(mission.grid.free, expected_used_up(mission), np.nan)
    assert coloured(page, 'used-up') == pytest.approx(used_up, abs=1e-3, nan_ok=True)
    move(page, 3)
    facts = page.locator('#deployment').inner_text()
    assert f'{used_up_at(mission, 3).sum():.2f} expected' in facts
    assert not opened().locator('#colour-used-up').count()


def test_a_cell_whose_target_may_change_shows_how_old_its_last_reading_is(opened, tmp_path):
    whole = Shown(target_dynamics=Dynamics('changing', 0.05, 0.1))
    for cells, readings in (([2, 1, 2], (1, 0)), ([2, 3, 2], (-1, 0)), ([2, 1, 6, 2], (0, -1, 1))):
        whole.deploy(Observation(cells, True, readings))
    whole.deploy(Observation([2, 3, 2], False))
    page = opened(file=page_file(read_summary(record(tmp_path / 'mission.mcap', whole.sent))))
    column, row = page.locator('#x'), page.locator('#y')
    for cell, said in (
        (1, ' No target was read 1 deployment ago; the probability is of now.'),
        (2, ' A target was read 1 deployment ago; the probability is of now.'),
        (6, ' Its target was never read.'),
        (3, ' Its target was never read.'),
    ):
        for field, value in zip((column, row), GRID.centers([cell])[0]):
            field.fill(f'{value:g}')
            field.dispatch_event('change')
        page.wait_for_function(
            'said => document.getElementById("cell").textContent.includes(said)', arg=said
        )


def test_a_clicked_cell_shows_its_numbers_and_history(opened, shown):
    mission, _ = shown
    page = opened()
    width = mission.grid.width
    cell = 2 * width + 1
    page.mouse.click(*place(page, cell))
    x, y = mission.grid.centers([cell])[0]
    page.wait_for_function(f'document.getElementById("x").value === "{x:g}"')
    assert page.locator('#y').input_value() == f'{y:g}'
    hazard = mission.moments[-1].belief.hazard[cell]
    assert f'hazard {hazard:.3f}' in page.locator('#cell').inner_text()
    history = page.evaluate('document.getElementById("cell-plot").data[0].y')
    expected = [moment.belief.hazard[cell] for moment in mission.moments]
    assert history == pytest.approx(expected, abs=0.5 / 255 + 1e-9)
    assert page.locator('#map .tip').text_content().startswith(f'({x:g}, {y:g}): hazard')
    # A frame surrounds it.
    assert page.locator('#cell').inner_text().startswith(f'({x:g}, {y:g}): hazard ')
    assert page.evaluate('document.getElementById("map").layout.frame') == cell
    # Arrow keys go to the next cell.
    page.locator('#x').press('ArrowUp')
    page.locator('#y').press('ArrowDown')
    next_to_it = mission.grid.centers([cell + 1 - width])[0]
    name = f'({next_to_it[0]:g}, {next_to_it[1]:g})'
    page.wait_for_function(
        'name => document.getElementById("cell").innerText.startsWith(name)', arg=name
    )
    page.locator('#x').fill('99')
    page.locator('#x').press('Enter')
    assert 'is not in the field' in page.locator('#cell').inner_text()


def test_what_people_said_is_marked_and_listed(opened, tmp_path):
    recorded = Path(__file__).parents[1] / 'log' / 'recorded' / 'day.mcap.gz'
    tmp_path.joinpath('mission.mcap').write_bytes(gzip.decompress(recorded.read_bytes()))
    mission = read_summary(tmp_path / 'mission.mcap')
    page = opened(file=page_file(mission))
    in_force = [each for each in mission.said if each.holds]
    for mark, kind in (('finding', 'finding'), ('closed', 'no_go')):
        cells = {cell for each in in_force if each.kind == kind for cell in each.cells}
        assert {*marked(page, mark, mission.grid)} == cells
    assert len(page.locator('#said tbody tr').all()) == len(mission.said) == 6
    assert 'walked (0.9)' in page.locator('#said').inner_text()
    page.get_by_label('said', exact=True).uncheck()
    assert marked(page, 'closed', mission.grid) is None


def test_pixels_have_the_colours_of_their_cells(opened, shown):
    mission, _ = shown
    page = opened()
    for layer in ('truth', 'targets', 'free', 'paths'):
        page.get_by_label(layer, exact=True).uncheck()
    first = np.array(page.evaluate('mission.visited'))
    belief = mission.moments[-1].belief.hazard
    levels, colours = zip(*page.evaluate('mission.scales.hazard.light'))
    parts = np.array([[*bytes.fromhex(each[1:])] for each in colours])
    for cell in np.flatnonzero(GRID.free & (first < len(mission.moments))):
        # Beside the sign of a base.
        drawn = pixel(page, *(each + 12 for each in place(page, cell)))
        expected = [np.interp(belief[cell], levels, part) for part in parts.T]
        assert np.abs(drawn - expected).max() <= 3


TWICE_UP = """() => {
    const canvas = document.querySelector('#map canvas');
    const press = () => canvas.dispatchEvent(new KeyboardEvent('keydown', { key: 'ArrowUp' }));
    press();
    press();
}"""


def test_the_map_is_magnified_moved_and_walked_by_keys(opened):
    page = opened()
    chosen = '+document.getElementById("map").layout.frame'
    cell = 2 * GRID.width + 2
    page.mouse.click(*place(page, cell))
    page.wait_for_function(f'document.getElementById("map").layout.frame === {cell}')
    whole = {each: place(page, each) for each in (cell, cell + 1)}
    page.get_by_role('button', name='Magnify the map').click()
    page.locator('#map canvas').press('+')
    page.wait_for_function('!maps.get("map").isDue')
    (x, y), (right, _) = place(page, cell), place(page, cell + 1)
    assert right - x == pytest.approx(2.25 * (whole[cell + 1][0] - whole[cell][0]))
    # The cell under the pointer moves with it.
    page.mouse.move(x, y)
    page.mouse.down()
    page.mouse.move(x - 30, y + 20, steps=3)
    page.mouse.up()
    page.wait_for_function('!maps.get("map").isDue')
    assert place(page, cell) == pytest.approx((x - 30, y + 20))
    assert page.evaluate(chosen) == cell
    page.mouse.click(*place(page, cell + 1))
    page.wait_for_function(f'document.getElementById("map").layout.frame === {cell + 1}')
    for key in ('ArrowUp', 'ArrowLeft', 'ArrowDown', 'ArrowDown', 'ArrowRight'):
        page.locator('#map canvas').press(key)
    # One row below where it was, and no moment was left.
    page.wait_for_function(
        f'document.getElementById("map").layout.frame === {cell + 1 - GRID.width}'
    )
    # Two keys before anything is drawn.
    page.evaluate(TWICE_UP)
    page.wait_for_function(
        f'document.getElementById("map").layout.frame === {cell + 1 + GRID.width}'
    )
    assert page.evaluate('now === last')
    page.locator('#map canvas').press('0')
    page.wait_for_function('!maps.get("map").isDue')
    assert place(page, cell) == pytest.approx(whole[cell])


def test_a_turned_field_is_drawn_upright_with_its_positions(opened, surveyed):
    mission, file = surveyed
    grid, page = mission.grid, opened(file=file)
    cell = 2 * grid.width + 1
    for name, value in zip('xy', grid.centers([cell])[0]):
        # Anywhere in the cell.
        page.locator(f'#{name}').evaluate(
            '(field, value) => { field.value = value; }', value + 0.02
        )
    page.locator('#y').dispatch_event('change')
    name = '({}, {})'.format(*(f'{round(each, 3):.12g}' for each in grid.centers([cell])[0]))
    page.wait_for_function(
        'name => document.getElementById("cell").innerText.startsWith(name)', arg=name
    )
    drawn = page.evaluate('document.getElementById("map").layout')
    assert drawn['labels'] == ['along the rows (m)', 'across the rows (m)']
    # The frame's arrows point along rows and columns.
    arrows = {name: np.exp(1j * angle) for name, angle in drawn['arrows']}
    for name, axis in (('x', 1.0), ('y', 1j)):
        assert arrows[name] == pytest.approx(axis * np.exp(-0.7j))
    (base,) = page.evaluate(
        'document.getElementById("map").data.filter((each) => each.marker?.symbol === "pentagon")'
    )
    row, column = divmod(grid.base, grid.width)
    assert (base['x'][0], base['y'][0]) == pytest.approx((0.1 * column + 0.05, 0.1 * row + 0.05))
    # The image of the map lies under the cells.
    site = 'document.getElementById("map").layout.image'
    image = page.evaluate(site)
    assert image['source'] == mission.site.source
    assert (image['width'], image['height']) == pytest.approx((0.5, 0.4))
    opacity = 'document.getElementById("map").data[0].opacity'
    assert page.evaluate(opacity) < 1
    page.get_by_label('image', exact=True).uncheck()
    assert page.evaluate(site) is None
    assert page.evaluate(opacity) == 1


def test_a_learnt_number_of_any_name_is_drawn(opened, tmp_path):
    names = ['$x_{$', '<b>&amp;', '\\frac{', 'a\nb', '%', '\N{BELL}', '']
    learnt_numbers = [each for each in NUMBERS if each not in ('reach', 'duds')]
    unknowns = Unknowns(**dict.fromkeys(learnt_numbers, (0.05, 0.95)))
    whole = mission_log.mission(1, method='kappa_bnitp_sampled', unknowns=unknowns)
    for message in whole.sent:
        if message.topic == '/model':
            message.message.name = names
    learnt = read_summary(record(tmp_path / 'mission.mcap', whole.sent))
    assert list(learnt.moments[-1].state.numbers) == names
    page = opened(file=page_file(learnt))
    # Of a mission without a truth there is no log loss.
    assert page.locator('#curves .plot').count() == 3 + len(names)
    assert not page.get_by_text('Log loss').is_visible()
    titles = page.locator('#curves .ytitle').all_text_contents()
    assert '<b>&amp;' in titles
    low, high, middle = page.evaluate(
        'document.getElementById("curve-3").data.map((each) => each.y)'
    )[:3]
    assert len(low) == 2
    assert all(one < other < third for one, other, third in zip(low, middle, high))


@pytest.fixture(scope='module')
def surveyed(tmp_path_factory):
    """Return a mission on a turned map with a datum, and the file of its page."""
    folder = tmp_path_factory.mktemp('surveyed')
    Image.fromarray(np.full((4, 5), 254, np.uint8)).save(folder / 'map.png')
    (folder / 'map.yaml').write_text(
        'image: map.png\nresolution: 0.1\norigin: [30.0, -8.0, 0.7]\nnegate: 0\n'
        'occupied_thresh: 0.65\nfree_thresh: 0.196\n'
    )
    parameters = {'datum': list(DATUM), 'map': str(folder / 'map.yaml')}
    grid = replace(GRID, origin=(30.0, -8.0), yaw=0.7)
    with LogWriter(folder / 'mission.mcap') as log:
        log.add_metadata(f'{PARAMETERS}/estimator', parameters_record(parameters))
        record_to(log, sent_by_single(12, grid=grid).sent)
    mission = read_summary(folder / 'mission.mcap')
    return mission, page_file(mission)


def test_findings_have_positions_on_the_earth(opened, surveyed):
    mission, file = surveyed
    page = opened(file=file, is_strict=True)
    table = rows(downloaded(page, 'CSV'))
    collection = json.loads(downloaded(page, 'GeoJSON', nth=1).read_text())
    # RFC 7946: coordinates in WGS84 only, and no other frame.
    assert set(collection) == {'type', 'name', 'features'}
    findings = list_findings(mission)
    assert len(findings) == len(collection['features']) == len(table) > 1
    latitude, longitude, heading = DATUM
    for each, feature, row in zip(findings, collection['features'], table):
        azimuth = 90.0 - np.degrees(heading + np.arctan2(each['y'], each['x']))
        x, y = (float(row[f'{axis} (m)']) for axis in 'xy')
        assert (x, y) == (each['x'], each['y'])
        at = EARTH.fwd(longitude, latitude, azimuth, np.hypot(x, y))[:2]
        for found in (
            feature['geometry']['coordinates'],
            (float(row['longitude (°)']), float(row['latitude (°)'])),
        ):
            assert EARTH.inv(*found, *at)[2] < 0.1
    (angle,) = (
        each[1]
        for each in page.evaluate('document.getElementById("map").layout.arrows')
        if each[0] == 'N'
    )
    # East is at the heading clockwise from the frame's x axis.
    assert np.exp(1j * angle) == pytest.approx(1j * np.exp(-1j * (heading + 0.7)))


def test_nodes_with_different_datums_are_named(surveyed, tmp_path):
    mission, _ = surveyed
    other = [DATUM[0] + 0.1, *DATUM[1:]]
    with LogWriter(tmp_path / 'mission.mcap') as log:
        for node, datum in (('scout_1/robot', other), ('estimator', list(DATUM))):
            given = {'datum': datum, **({'learn.numbers': []} if node == 'estimator' else {})}
            log.add_metadata(f'{PARAMETERS}/{node}', parameters_record(given))
        record_to(log, sent_by_single(3).sent)
    read = read_summary(tmp_path / 'mission.mcap')
    assert read.datum == mission.datum
    (note,) = (each for each in read.notes if each.startswith('Nodes had different datums'))
    assert f'/scout_1/robot {other}; /estimator {list(DATUM)}. ' in note
    assert note.endswith('by the datum of /estimator.')


def test_coordinates_typed_one_after_the_other_name_their_cell(opened, surveyed):
    mission, file = surveyed
    page = opened(file=file, is_strict=True)
    grid = mission.grid
    for start in (0, grid.cells - 1):
        for cell in np.flatnonzero(grid.free)[:: 1 if FULL else 5].tolist():
            (x, y), (begin_x, begin_y) = grid.centers([cell, start]).tolist()
            page.fill('#x', f'{begin_x:.3f}')
            page.fill('#y', f'{begin_y:.3f}')
            for name, value in (('#x', x), ('#y', y)):
                page.fill(name, f'{value:.3f}')
                page.dispatch_event(name, 'change')
                page.evaluate('new Promise(requestAnimationFrame)')
            page.evaluate('new Promise(requestAnimationFrame)')
            assert page.input_value('#x') == f'{x:.3f}'
            told = page.locator('#cell').inner_text().partition(')')[0][1:].split(', ')
            assert [float(each) for each in told] == pytest.approx([x, y], abs=1e-3)


def test_a_missing_map_is_stated(surveyed, tmp_path):
    mission, file = surveyed
    for content, why in ((None, 'cannot be read'), ('origin: [30.0, -8.0, 0.6]', 'has changed')):
        told = file.with_name('map.yaml')
        known = told.read_text()
        told.unlink()
        if content:
            told.write_text(known.replace('origin: [30.0, -8.0, 0.7]', content))
        again = read_summary(mission.log)
        assert again.site is None
        assert any('The map is not shown' in note and why in note for note in again.notes)
        told.write_text(known)


def test_the_table_is_sorted_and_a_row_leads_to_its_moment_and_back(opened, shown):
    mission, _ = shown
    page = opened()
    for number in (0, 29, 11):
        move(page, mission.deployments[number].moment)
        row = page.locator(f'#deployment-{number}').bounding_box()
        box = page.locator('#deployments').locator('xpath=..').bounding_box()
        assert row['y'] >= box['y']
        assert row['y'] + row['height'] <= box['y'] + box['height'] + 1
    assert page.evaluate('scrollY') == 0
    heading = page.locator('#deployments th').nth(3).locator('button')
    cells = page.locator('#deployments tbody tr td:nth-child(4)')
    unsorted = [int(text) for text in cells.all_inner_texts()]
    heading.click()
    assert [int(text) for text in cells.all_inner_texts()] == sorted(unsorted, reverse=True)
    sorting = page.locator('#deployments th:nth-child(4)').get_attribute('aria-sort')
    assert sorting == 'descending'
    heading.click()
    assert [int(text) for text in cells.all_inner_texts()] == sorted(unsorted)
    for number in (3, 17):
        page.locator(f'#deployment-{number} button').click()
        moment = page.evaluate('document.documentElement.dataset.moment')
        assert moment == str(mission.deployments[number].moment)
        assert page.locator('#deployments tr[aria-current]').get_attribute('id') == (
            f'deployment-{number}'
        )


@pytest.mark.parametrize('width', some([390, 800, 1400], 2))
def test_nothing_flows_over_and_nothing_overlaps(opened, width):
    page = opened(width)
    assert page.evaluate('document.documentElement.scrollWidth') == width
    apart = page.evaluate(
        """() => {
            const shown = [...document.querySelectorAll('article, button, figcaption, .plot, h2')]
                .filter((each) => each.offsetParent && !each.closest('#controls, .wide'));
            const overlap = (one, other) => !one.contains(other) && !other.contains(one)
                && !(one.matches('.save') && other.matches('figcaption, .plot'))
                && !(other.matches('.save') && one.matches('figcaption, .plot'));
            const box = (each) => each.getBoundingClientRect();
            return shown.flatMap((one, place) => shown.slice(place + 1).filter((other) => {
                const [a, b] = [box(one), box(other)];
                return overlap(one, other) && a.left < b.right - 1 && b.left < a.right - 1
                    && a.top < b.bottom - 1 && b.top < a.bottom - 1;
            }).map((other) => `${one.outerHTML.slice(0, 80)} | ${other.outerHTML.slice(0, 80)}`));
        }"""
    )
    assert apart == []


def test_answers_come_first(opened):
    """Questions and map are visible without scrolling, and no path is drawn yet."""
    page = opened(1400, 1000)
    tiles = page.locator('#answers article')
    questions = tiles.locator('h3').all_inner_texts()
    assert questions == [*asked_in('docs/reading.md')]
    for tile in tiles.all():
        assert tile.bounding_box()['y'] + tile.bounding_box()['height'] < 1000
    field = page.locator('#map').bounding_box()
    assert field['y'] + field['height'] < 1000
    assert min(field['width'], field['height']) > 500
    assert page.evaluate('document.getElementById("map").data[3].x.length') == 0
    assert 'Lethality: ' in tiles.nth(5).inner_text()


def asked_in(page):
    text = (Path(__file__).parents[2] / page).read_text()
    return dict(re.findall(r'^\| (.*\?(?: \(.*\))?) \| (.*) \|$', text, re.MULTILINE))


@pytest.mark.full
@for_each('scheme, width', product(('light', 'dark'), (1400, 390)))
def test_each_question_leads_to_the_place_that_the_documentation_names(
    opened, shown, scheme, width
):
    page = opened(width, scheme=scheme)
    for question, place in asked_in('docs/reading.md').items():
        tile = page.locator('#answers article').filter(has_text=question)
        assert tile.is_visible()
        for name in re.findall(r'\*(.+?)\*', place):
            named = page.locator('h2, label, button').filter(has_text=re.compile(rf'^\s*{name}$'))
            assert named.is_visible(), name
        link = tile.locator('a')
        assert link.count() == (question != 'What to do next?')
        if link.count():
            link.click()
            target = page.locator(link.get_attribute('href'))
            controls = page.locator('#controls').bounding_box()
            top = target.bounding_box()['y']
            assert controls['y'] + controls['height'] <= top < 1000, question
    assert page.is_checked('#colour-robots-lost')


def test_tiles_agree_with_their_lists(opened):
    page = opened()
    tiles = page.locator('#answers article').all_inner_texts()

    def count(list_name, text=''):
        return page.locator(f'#{list_name} tbody tr').filter(has_text=text).count()

    assert f'{count("safe")} of {GRID.free.sum()} cells' in tiles[0]
    numbers = re.search(r'(\d+) found.*; (\d+) more with 50', tiles[1], re.DOTALL).groups()
    assert sum(map(int, numbers)) == count('findings', 'target')
    assert re.search(r'(\d+) cells?\n', tiles[2])[1] == str(count('findings', 'hazard'))
    lost = count('deployments', 'lost')
    assert f'{lost} of {count("deployments")} robots lost' in tiles[6]
    most, x, y = re.search(r'expected losses: (.*?) at \((.*?), (.*?)\)', tiles[7]).groups()
    losses = coloured(page, 'robots-lost')
    assert np.nanmax(losses) == pytest.approx(float(most), abs=0.05)
    assert GRID.centers([np.nanargmax(losses)])[0] == pytest.approx([float(x), float(y)])


def test_safe_cells_are_listed_and_downloaded_as_polygons(opened, shown):
    mission, _ = shown
    page = opened(is_strict=True)
    free = np.flatnonzero(classify_cells(mission).free)
    hazard = mission.moments[-1].belief.hazard[free]
    table = rows(downloaded(page, 'CSV', nth=1))
    assert [float(row['hazard']) for row in table] == sorted(hazard)
    features = json.loads(downloaded(page, 'GeoJSON', nth=2).read_text())['features']
    assert len(features) == free.size
    side = mission.grid.resolution
    for feature in features:
        (ring,) = feature['geometry']['coordinates']
        assert ring[0] == ring[-1]
        assert np.ptp(np.array(ring), axis=0) == pytest.approx([side, side])
        middle = [feature['properties'][name] for name in ('x (m)', 'y (m)')]
        assert np.mean(ring[:-1], axis=0) == pytest.approx(middle)


def test_the_safest_way_is_that_of_all_ways(opened, shown):
    mission, _ = shown
    page, grid = opened(), mission.grid
    hazard = mission.moments[-1].belief.hazard

    def choose(cell):
        x, y = (f'{each:g}' for each in grid.centers([cell])[0])
        for field, value in (('#x', x), ('#y', y)):
            page.fill(field, value)
            page.press(field, 'Enter')
            page.evaluate('new Promise((done) => requestAnimationFrame(done))')
        return f'({x}, {y})'

    page.click('#way-from')
    base = choose(grid.base)
    page.click('#way-from')
    assert f'No way from {base} to a cell that is not chosen yet' in page.inner_text('#way')
    for to in (0, grid.cells - 1, 11):
        name = choose(to)
        page.click('#way-to')
        said = page.inner_text('#way')
        assert f'from {base} to {name} ' in said
        # The algorithm of Bellman and Ford.
        free = np.zeros(grid.cells)
        free[grid.base] = 1.0 - hazard[grid.base]
        for _ in range(grid.cells):
            for cell in np.flatnonzero(free):
                around = grid.neighbors(cell)
                free[around] = np.maximum(free[around], free[cell] * (1.0 - hazard[around]))
        assert f'free of hazards with {100 * free[to]:.1f} %' in said
        line = json.loads(downloaded(page, 'GeoJSON').read_text())
        ((x, y), *_) = line['features'][0]['geometry']['coordinates']
        assert [x, y] == pytest.approx(grid.centers([grid.base])[0])
    choose(grid.width + 3)
    page.click('#way-to')
    assert 'an obstacle is in one of the two cells' in page.inner_text('#way')
    assert page.get_by_role('button', name='GeoJSON').first.is_disabled()


def test_findings_are_sorted_and_downloaded(opened, shown):
    mission, _ = shown
    page = opened(is_strict=True)
    page.locator('#findings th button').nth(1).click()
    table = rows(downloaded(page, 'CSV'))
    findings = list_findings(mission)
    largest_first = sorted((each['x'] for each in findings), reverse=True)
    assert [float(row['x (m)']) for row in table] == largest_first
    features = json.loads(downloaded(page, 'GeoJSON', nth=1).read_text())['features']
    told = {
        (each['properties']['what'], *each['geometry']['coordinates']): each['properties']
        for each in features
    }
    assert len(told) == len(findings)
    for finding in findings:
        values = told[finding['kind'], finding['x'], finding['y']]
        assert values['probability'] == finding['probability']
        assert values['looks'] == finding['looks']
    assert len(rows(downloaded(page, 'CSV', nth=-1))) == len(mission.deployments)
    assert Image.open(downloaded(page, 'Save the map')).format == 'PNG'


def test_a_mission_prints_on_one_sheet_of_a4(opened, shown):
    page = opened(794, 1123, file=shown[1])
    page.emulate_media(media='print')
    assert page.evaluate('document.documentElement.scrollWidth') == 794
    assert not page.locator('#play').is_visible()
    assert page.locator('#map').is_visible()
    printed = page.pdf(prefer_css_page_size=True)
    assert len(re.findall(rb'/Type\s*/Page\b', printed)) == 1


def test_the_colour_scheme_follows_the_reader_and_can_be_changed(opened):
    def paper(page):
        colour = page.evaluate('getComputedStyle(document.body).backgroundColor')
        return [int(each) for each in colour.removeprefix('rgb(').removesuffix(')').split(',')]

    page = opened(scheme='dark')
    assert max(paper(page)) < 60
    box = page.locator('#map canvas').bounding_box()
    assert pixel(page, box['x'] + 2, box['y'] + 2).tolist() == paper(page)
    page.get_by_role('button', name='Light').click()
    assert min(paper(page)) > 200
    assert pixel(page, box['x'] + 2, box['y'] + 2).tolist() == paper(page)


@pytest.mark.processes
@pytest.mark.full
@pytest.mark.usefixtures('browser')
def test_the_pictures_of_the_documentation_can_be_taken(shown, tmp_path):
    report, images = tmp_path / 'report', tmp_path / 'images'
    report.mkdir()
    images.mkdir()
    shutil.copy(shown[1], report / 'report.html')
    tool = Path(__file__).parents[2] / 'tools/page_pictures.py'
    subprocess.run([sys.executable, tool, report, images], check=True)
    taken = {file.stem: Image.open(file) for file in images.iterdir()}
    assert taken.keys() == {
        'page',
        'page_early',
        'page_dark',
        'page_curves',
        'before_after',
    }
    assert taken['page'].size == taken['page_dark'].size
    assert taken['page'].width == taken['page_early'].width
    assert taken['page'].tobytes() != taken['page_early'].tobytes()
    corners = [sum(taken[name].getpixel((0, 0))[:3]) for name in ('page', 'page_dark')]
    assert corners[0] > 700 > 100 > corners[1]


def test_a_team_shows_robots_in_flight(opened, tmp_path):
    log, _ = team(tmp_path / 'mission.mcap')
    mission = read_summary(log)
    page = opened(file=page_file(mission))
    move(page, 1)
    facts = page.locator('#deployment').inner_text()
    assert 'scout_8 (no. 8)' in facts
    late = next(place for place, each in enumerate(mission.moments) if each.is_late)
    move(page, late)
    assert 'returned after it had been given up' in page.locator('#told').inner_text()


@pytest.mark.full
@pytest.mark.skipif(not AXE.exists(), reason=f'npm ci --prefix {AXE.parents[2]} installs axe-core')
@for_each('scheme, width', product(('light', 'dark'), (1400, 390)))
def test_the_page_is_accessible(opened, shown, scheme, width):
    mission, file = shown
    lost = next(each for each in mission.deployments if not each.outcome.survived)
    page = opened(width, scheme=scheme, file=file)
    move(page, lost.moment)
    page.click('#way-to')
    page.add_script_tag(content=AXE.read_text())
    assert [
        (each['id'], each['nodes'][0]['html'], each['nodes'][0]['failureSummary'])
        for each in page.evaluate('axe.run()')['violations']
    ] == []
    assert page.evaluate('document.documentElement.scrollWidth') == width
