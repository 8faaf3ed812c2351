# SPDX-License-Identifier: Apache-2.0
"""The page of a running mission, in a real browser: it follows the log and shows its state."""

from contextlib import contextmanager
import os
import re
import shutil
import signal
import subprocess
import sys
import time

from kbnitp_ros.cli import watch
from kbnitp_ros.cli.server import Address
from kbnitp_ros.cli.watch import main, serving
from kbnitp_ros.log.history import read_history
from kbnitp_ros.log.write import LogWriter
from launches import nodes_of_demo
from mission_log import record, record_to
from missions import sent_by_single
import numpy as np
import pytest

SENT = sent_by_single(6).sent


@contextmanager
def opened(browser, log):
    asked = []
    with serving(log, None, Address(port=0)) as address:
        page = browser.new_context(bypass_csp=True).new_page()
        page.on('request', lambda request: asked.append(request.url))
        page.goto(address)
        yield page
        page.close()
    elsewhere = [
        each
        for each in asked
        if not each.startswith((address.partition('#')[0], 'data:', 'blob:'))
    ]
    assert elsewhere == []


def until(page, condition):
    page.wait_for_function(condition, timeout=60_000)


def says(page, words):
    until(page, f'document.getElementById("live")?.textContent.includes("{words}")')


def test_the_page_follows_a_log_that_grows(browser, tmp_path, monkeypatch):
    # A slow browser may take longer than the page waits for growth.
    monkeypatch.setattr(watch, 'STILL', np.inf)
    path = tmp_path / 'mission.mcap'
    half = len(SENT) // 2
    with LogWriter(path) as log, opened(browser, path) as page:
        says(page, 'Waiting for the first belief')
        log.add_metadata('parameters/planner', {'robots': '6'})
        record_to(log, SENT[:half], synced=True)
        page.wait_for_selector('html[data-ready]', state='attached', timeout=60_000)
        says(page, 'Following the log')
        until(page, 'Number(document.getElementById("moment").max) > 0')
        assert int(page.get_attribute('#moment', 'max')) < 6
        # Redrawn in place: choices stay.
        page.evaluate('window.chosen = 1')
        page.locator('#deployments th button').nth(3).click()
        page.locator('#deployments th button').nth(3).click()
        page.check('#colour-target')
        page.uncheck('[value=free]')
        page.fill('#x', '-1.25')
        page.press('#x', 'Enter')
        page.locator('#configuration summary').first.click()
        page.click('#way-to')
        record_to(log, SENT[half:], synced=True)
        until(page, 'document.getElementById("moment").max === "6"')
        until(
            page, 'document.getElementById("told").textContent.includes("After the last report")'
        )
        assert page.evaluate('window.chosen') == 1
        assert page.input_value('#x') == '-1.25'
        steps = page.locator('#deployments tbody td:nth-child(4)').all_inner_texts()
        assert steps == sorted(steps, key=int)
        assert len(steps) == 6
        assert page.evaluate('document.activeElement.id') == 'way-to'
        assert page.is_checked('#colour-target')
        assert not page.is_checked('[value=free]')
        assert page.locator('details[open]').count() == 1
        assert page.inner_text('#way').startswith('The safest way from')
        assert 'of 6 robots lost' in page.inner_text('#answers')
        rows = page.evaluate('document.getElementById("map").data[0].z')
        last = read_history(path).beliefs[-1]
        shown = np.array(rows, dtype=float).ravel()
        inside = ~np.isnan(shown)
        np.testing.assert_allclose(shown[inside], last.target[inside], atol=0.5 / 255)
        monkeypatch.setattr(watch, 'STILL', 0.0)
        says(page, 'has not grown for')
        log.close()
        says(page, 'is finished')
        monkeypatch.setattr(watch, 'STILL', np.inf)
        # A resumed mission writes another file.
        with LogWriter(path, resume=True) as resumed:
            record_to(resumed, SENT[-1:], synced=True)
            says(page, 'Following the log')
    assert sorted(file.name for file in tmp_path.iterdir()) == [
        'metadata.yaml',
        'mission.mcap',
        'mission_1.mcap',
    ]


def test_the_token_leaves_the_address_and_a_reload_keeps_it(browser, tmp_path):
    path = record(tmp_path / 'mission.mcap', SENT)
    with serving(path, None, Address(port=0)) as address:
        # The policy of the page is in force.
        page = browser.new_context().new_page()
        problems = []
        page.on('console', lambda each: problems.append(each.text))
        page.on('pageerror', lambda each: problems.append(str(each)))
        page.goto(address)
        for _ in range(2):
            page.wait_for_selector('html[data-ready]', state='attached', timeout=60_000)
            assert page.url == address.partition('#')[0]
            assert page.locator('#map canvas').count()
            page.reload()
        assert problems == []
        other = browser.new_context().new_page()
        other.goto(address.partition('#')[0])
        other.get_by_text('This is not the address').wait_for()
        assert not other.locator('main').is_visible()
        assert SENT[0].topic not in other.content()


@pytest.mark.full
def test_a_replaced_log_is_shown_anew_in_two_tabs_until_the_command_ends(browser, tmp_path):
    path = record(tmp_path / 'mission.mcap', SENT)
    last = browser.new_context(bypass_csp=True).new_page()
    with serving(path, None, Address(port=0)) as address, opened(browser, path) as page:
        last.goto(address)
        for watching in (page, last):
            watching.wait_for_selector('html[data-ready]', state='attached', timeout=60_000)
        (tmp_path / 'other').mkdir()
        shorter = record(tmp_path / 'other' / 'mission.mcap', sent_by_single(3).sent)
        shutil.move(shorter, path)
        for watching in (page, last):
            until(watching, 'document.getElementById("moment")?.max === "3"')
    says(last, 'The command watch has ended')
    # Another start has another token.
    port = int(re.search(r':(\d+)/', address)[1])
    with serving(path, None, Address(port=port)):
        says(last, 'open that one')
    last.close()


@pytest.mark.full
def test_a_demo_is_followed_when_its_recorder_is_killed_and_when_it_is_resumed(browser, tmp_path):
    demo = [sys.executable, '-m', 'kbnitp_ros', 'demo']
    options = ['--robots', '40', '--size', '4', '--max-steps', '6', '--set', 'step_period=0.05']
    log = tmp_path / 'demo' / 'mission.mcap'
    shown = """[document.getElementById("map").data[0].z,
        document.getElementById("answers").innerText, document.getElementById("moment").max]"""
    with subprocess.Popen(
        [*demo, *options, '--out', log.parent], stderr=subprocess.DEVNULL
    ) as running:
        while not log.exists():
            assert running.poll() is None
            time.sleep(0.05)
        with opened(browser, log) as page:
            page.wait_for_selector('html[data-ready]', state='attached', timeout=60_000)
            begun = page.evaluate(shown)
            until(page, f'Number(document.getElementById("moment").max) > {begun[2]} + 2')
            later = page.evaluate(shown)
            os.kill(nodes_of_demo(running)['recorder'], signal.SIGKILL)
            assert running.wait(60) == 1
            says(page, 'its recorder has ended or was killed')
            resumed = subprocess.Popen([*demo, '--resume', log], stderr=subprocess.DEVNULL)
            says(page, 'Following the log')
            assert resumed.wait(120) == 0
            says(page, 'is finished')
            until(page, 'document.getElementById("moment").max === "40"')
            ended = page.evaluate(shown)
    for one, other in ((begun, later), (later, ended)):
        assert all(before != after for before, after in zip(one, other))
    assert 'of 40 robots lost' in ended[1]
    assert {each.name for each in log.parent.iterdir()} == {
        'metadata.yaml',
        'mission.json',
        'mission.mcap',
        'mission.rviz',
        'mission_1.mcap',
        'report',
    }


def test_bad_options_are_refused(tmp_path, monkeypatch, capsys):
    path = record(tmp_path / 'mission.mcap', SENT)
    monkeypatch.chdir(tmp_path)
    (tmp_path / 'empty').mkdir()
    (tmp_path / 'notes.txt').write_text('no robot was lost')
    with serving(path, None, Address(port=0)) as address:
        port = re.search(r':(\d+)/', address)[1]
        for arguments, told in (
            ([], 'no log is in runs/: name the log'),
            (['nowhere'], 'nowhere'),
            (['empty'], 'empty holds no log'),
            (['notes.txt'], 'notes.txt is no MCAP file'),
            ([str(path), '--port', port], f'cannot listen on 127.0.0.1:{port}'),
            (
                [str(path), '--host', 'nonsense'],
                "--host is 'nonsense': it must be an IPv4",
            ),
            ([str(path), '--host', ''], "--host is ''"),
            ([str(path), '--host', '192.0.2.1'], "--host is '192.0.2.1', which others can reach"),
            ([str(path), '--host', '0.0.0.0'], "--host is '0.0.0.0', which others can reach"),
            ([str(path), '--key', 'key.pem'], '--certificate and --key must be given together'),
            (
                [str(path), '--certificate', 'none.pem', '--key', 'none.pem'],
                '--certificate or --key cannot be used: [Errno 2]',
            ),
            ([str(path), '--namespace', '/other'], 'has no readable beliefs: it must have messa'),
            ([str(path), '--port', '70000'], '--port is 70000: it must be from 0 to 65535'),
        ):
            assert main(arguments) == 2, arguments
            assert told in capsys.readouterr().err


def test_the_newest_log_is_taken_by_default(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    for name in ('a', 'b'):
        (tmp_path / 'runs' / name).mkdir(parents=True)
        record(tmp_path / 'runs' / name / 'mission.mcap', SENT[:1])
        time.sleep(0.01)
    assert watch.newest_log().parent.name == 'b'
