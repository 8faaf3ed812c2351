# SPDX-License-Identifier: Apache-2.0
"""The statements of people in said.csv and said.geojson, and which of them still hold."""

import csv
from dataclasses import replace
from datetime import datetime
import io
import json

from kbnitp_msgs.msg import Annotation, Finding, Revocation
from kbnitp_ros.base.said import contradictions
from kbnitp_ros.core import Observation
from kbnitp_ros.log.configuration import parameters_record
from kbnitp_ros.log.read import PARAMETERS
from kbnitp_ros.log.write import LogWriter
from kbnitp_ros.messages.headers import header, to_stamp
from kbnitp_ros.messages.operator_actions import Action, operator_action_message, OperatorAction
from kbnitp_ros.messages.remarks import read_remark
from kbnitp_ros.report.mission import read_summary
from kbnitp_ros.report.said import contradiction_notes, said_csv, said_geojson, said_rows
from matplotlib.path import Path as Outline
from mission_log import GRID, Mission, record_to
import numpy as np
from pyproj import Geod

EVIL = '</script>\u2028=1+1,"\n'
DATUM = [52.0, 5.0, 0.3]
TOUR = [2, 7, 12, 7, 2]


class Talked(Mission):
    """A mission of which people say something."""

    def say(self, topic, message, author='Ann', note=''):
        message.header, message.author, message.note = header(self.now), author, note
        self.publish(topic, message)
        remark = read_remark(topic, message)
        remark.record(self.ledger)
        self.publish_standings()
        self.publish_belief()
        return remark.content

    def find(self, cells, **values):
        return self.say('findings', Finding(cells=cells, since=to_stamp(self.now), **values))

    def close(self, action, cells, author='Bob'):
        decided = OperatorAction(self.now, action, 1, cells=cells, reason='wreck', author=author)
        self.publish('operator', operator_action_message(self.grid, decided))


def written(folder, whole, datum=()):
    with LogWriter(folder / 'mission.mcap') as log:
        log.add_metadata(f'{PARAMETERS}/estimator', parameters_record({'datum': list(datum)}))
        record_to(log, whole.sent)
    mission = read_summary(folder / 'mission.mcap')
    table = [*csv.DictReader(io.StringIO(said_csv(mission), newline=''))]
    features = json.loads(said_geojson(mission))['features']
    assert len(table) == len(features) == len(mission.said)
    return mission, table, features


def test_each_statement_has_a_row_and_a_feature(tmp_path):
    whole = Talked()
    key = whole.deploy(Observation(TOUR, False))
    report = whole.ledger.standings[key].report
    where = Annotation(agent=key.agent, deployment=to_stamp(key.stamp), report=report, steps=[2])
    where.kind, where.cause = Annotation.LOCATED, Annotation.HAZARD
    located = whole.say('annotations', where, EVIL, EVIL)
    found = whole.find([3, 4, 7], hazard=Finding.ABSENT, confidence=0.95)
    revoked = whole.say('revocations', Revocation(revokes=found), 'Cleo')
    whole.close(Action.NO_GO, (0, 1))
    whole.close(Action.LIFT, (0,))
    mission, table, features = written(tmp_path, whole)
    assert [each['kind'] for each in table] == [
        *('annotation', 'finding', 'revocation', 'no_go', 'lift')
    ]
    assert [each['holds'] for each in table] == ['True', 'False', 'True', 'True', 'True']
    assert [each['hash'] for each in table] == [*map(str, (located, found, revoked)), '', '']
    note, finding, taken, closed, _ = table
    assert (note['author'], note['note'], note['says']) == (EVIL, EVIL, 'LOCATED')
    assert (note['cells'], note['by_hazard'], note['steps']) == ('12', 'True', '2')
    assert (finding['revoked_by'], finding['revoked_at']) == ('Cleo', taken['time'])
    assert (finding['hazard'], finding['target'], finding['confidence']) == ('False', '', '0.95')
    assert taken['revokes'] == str(found)
    assert (closed['author'], closed['note'], closed['cells']) == ('Bob', 'wreck', '0 1')
    times = [datetime.fromisoformat(each['time']).timestamp() for each in table]
    assert times == sorted(times)
    assert abs(times[0] - mission.said[0].stamp / 1e9) < 1e-3
    for row, feature in zip(table, features):
        shown = feature['properties']
        assert {name: '' if shown.get(name) is None else str(shown[name]) for name in row} == {
            **row, 'polygon': '',
        }  # fmt: skip
        assert (feature['geometry'] is None) == (row['polygon'] == '')


def test_remarks_that_nobody_judged_are_shown_as_such(tmp_path):
    whole = Talked()
    key = whole.deploy(Observation(TOUR, False))
    for topic, message in (
        ('findings', Finding(cells=[3, 20, 2**32 - 1], walked=0.5)),
        ('annotations', Annotation(agent=key.agent, kind=1, report=7, steps=[2, 99])),
        ('revocations', Revocation(revokes=5)),
    ):
        message.header = header(whole.now)
        if topic == 'annotations':
            message.deployment = to_stamp(key.stamp)
        whole.publish(topic, message)
    _, table, _ = written(tmp_path, whole, DATUM)
    assert [each['holds'] for each in table] == ['False'] * 3
    assert [each['cells'] for each in table] == ['3', '12', '']


def area_and_cells(grid, rings):
    """Return the area of rings, counterclockwise, and the cells whose centres they contain."""
    area, inside = 0.0, np.zeros(grid.cells, bool)
    for ring in np.array(rings):
        x, y = (ring - ring[0]).T
        area += (x[:-1] * y[1:] - x[1:] * y[:-1]).sum() / 2.0
        inside |= Outline(ring).contains_points(grid.centers(np.arange(grid.cells)))
    return area, np.flatnonzero(inside).tolist()


def test_polygons_cover_the_cells_in_metres_or_on_the_earth(tmp_path):
    for number, datum in enumerate([(), DATUM]):
        grid = replace(GRID, yaw=0.4)
        whole = Talked(grid=grid)
        # The last cell of a row and the first of the next are not side by side.
        cells = [3, 4, 5, 6, 13, 19]
        whole.find(cells, walked=0.5)
        folder = tmp_path / str(number)
        folder.mkdir()
        _, (row,), (feature,) = written(folder, whole, datum)
        rings = [part[0] for part in feature['geometry']['coordinates']]
        assert len(rings) == 4
        texts = row['polygon'].removeprefix('MULTIPOLYGON (').replace('(', '').replace(')', '')
        read = np.array([[*map(float, each.split())] for each in texts.split(', ')])
        np.testing.assert_array_equal(read, np.concatenate(rings))
        if datum:
            earth, flat = Geod(ellps='WGS84'), []
            for longitude, latitude in np.concatenate(rings).tolist():
                azimuth, _, far = earth.inv(datum[1], datum[0], longitude, latitude)
                at = far * np.exp(1j * (np.radians(90.0 - azimuth) - datum[2]))
                flat.append([at.real, at.imag])
            rings = np.array(flat).reshape(-1, 5, 2).tolist()
        area, inside = area_and_cells(grid, rings)
        assert inside == cells
        np.testing.assert_allclose(area, len(cells) * grid.resolution**2, rtol=1e-6)
        assert row['frame'].startswith('WGS84' if datum else 'map')


def test_findings_contradict_each_other_until_the_field_was_changed(tmp_path):
    whole = Talked()
    there = whole.find([3, 4], hazard=Finding.PRESENT)
    free = whole.find([4, 7], hazard=Finding.ABSENT)
    # Of targets nothing was said so far, and of cell 12 nothing else.
    whole.find([4, 12], target=Finding.ABSENT)
    cleared = whole.find([3, 4], hazard=Finding.ABSENT, changed=True)
    again = whole.find([3], hazard=Finding.PRESENT, confidence=0.5)
    mission, *_ = written(tmp_path, whole)
    assert contradictions(mission.said) == {(there, free): [4], (cleared, again): [3]}
    whole.say('revocations', Revocation(revokes=free))
    (tmp_path / 'later').mkdir()
    mission, *_ = written(tmp_path / 'later', whole)
    assert contradictions(mission.said) == {(cleared, again): [3]}


def test_an_area_holds_until_all_its_cells_are_open_again(tmp_path):
    whole = Talked()
    for action, cells in (
        (Action.NO_GO, (0, 1)), (Action.NO_GO, (3,)), (Action.LIFT, (0, 3)), (Action.LIFT, (1,)),
        (Action.NO_GO, (3,)),
    ):  # fmt: skip
        whole.close(action, cells)
    mission, table, _ = written(tmp_path, whole)
    assert [each.holds for each in mission.said] == [False, False, True, True, True]
    ends = [each.revoked_by and each.revoked_by.stamp for each in mission.said]
    stamps = [each.stamp for each in mission.said]
    assert ends == [stamps[3], stamps[2], None, None, None]
    assert [bool(each['revoked_at']) for each in table] == [True, True, False, False, False]


def test_the_page_lists_statements_and_names_those_that_contradict(tmp_path):
    whole = Talked()
    key = whole.deploy(Observation(TOUR, False))
    report = whole.ledger.standings[key].report
    where = Annotation(agent=key.agent, deployment=to_stamp(key.stamp), report=report, steps=[2])
    where.kind, where.cause = Annotation.LOCATED, Annotation.HAZARD
    whole.say('annotations', where, EVIL, EVIL)
    whole.find([3, 4, 7], hazard=Finding.ABSENT, confidence=0.95)
    found = whole.find([4], hazard=Finding.PRESENT, walked=0.5)
    taken = whole.find([5], target=Finding.PRESENT)
    whole.say('revocations', Revocation(revokes=taken), 'Cleo')
    whole.close(Action.NO_GO, (0, 1))
    mission = written(tmp_path, whole)[0]
    rows = said_rows(mission)
    assert [(each['words'], each['holds'], each['mark'], each['cells']) for each in rows] == [
        ('lost in step 2, by a hazard', 'yes', 'wreck', [12]),
        ('no hazard (0.95)', 'yes', 'finding', [3, 4, 7]),
        ('walked (0.5), a hazard (0.99)', 'yes', 'finding', [4]),
        ('a target (0.99)', 'taken back by Cleo', None, [5]),
        ('takes back: a target (0.99)', 'yes', None, []),
        ('no-go', 'yes', 'closed', [0, 1]),
    ]
    assert [each['number'] for each in rows] == [1, *[None] * 5]
    assert found != taken
    (note,) = contradiction_notes(mission)
    assert note.startswith('Two findings contradict each other in 1 cell: ')
    assert ': no hazard (0.95)) and ' in note
    assert note.endswith(': walked (0.5), a hazard (0.99)). Both count.')
