# SPDX-License-Identifier: Apache-2.0
"""What is believed before the first deployment comes from numbers, maps or an earlier mission."""

from dataclasses import replace

from kbnitp_ros.configuration import TABLE
from kbnitp_ros.configuration.mission import prior_of
from kbnitp_ros.core import Belief
from laws import for_each
from mission_log import GRID, Mission, mission, record
import numpy as np
from PIL import Image
import pytest

VALUES = {parameter.name: parameter.default for parameter in TABLE}
FIELD = {
    'grid.width': 5, 'grid.height': 4, 'grid.base': 2, 'grid.resolution': 0.1,
    'grid.origin': [-1.3, 0.7], 'grid.blocked': [8, 9],
}  # fmt: skip


def write(path, values):
    """Write probabilities, rows from the bottom, and return the file's name."""
    np.save(path, np.asarray(values, dtype=float))
    return str(path)


@pytest.fixture
def log(tmp_path):
    """Return the log of a mission and its last belief, which is not the one recorded last."""
    whole = mission()
    known = whole.ledger.belief
    whole.start_estimator()
    return str(record(tmp_path / 'mission.mcap', whole.sent)), known


def test_numbers_are_the_same_everywhere():
    prior = prior_of(VALUES, GRID)
    assert prior.joint.tobytes() == Belief.prior(GRID, 0.5, 0.45, 0.8).joint.tobytes()


def test_maps_say_it_cell_by_cell_and_numbers_elsewhere(tmp_path):
    # Seen from above, a map of two by one cells of 0.2 m over the lower left of the grid.
    Image.fromarray(np.array([[255, 51]], dtype=np.uint8)).save(tmp_path / 'hazard.png')
    (tmp_path / 'hazard.yaml').write_text(
        'image: hazard.png\nresolution: 0.2\norigin: [-1.3, 0.7, 0.0]\nnegate: 0\n'
        'occupied_thresh: 1.0\nfree_thresh: 0.0\nmode: scale\n'
    )
    target = np.linspace(0.4, 0.59, 20)
    given = {
        'prior.hazard': 0.3,
        'prior.hazard_map': str(tmp_path / 'hazard.yaml'),
        'prior.target_map': write(tmp_path / 'target.npy', target.reshape(4, 5)),
        'prior.kappa': 0.5,
    }
    hazard = np.full(20, 0.3)
    hazard[[0, 1, 5, 6]] = 0.0
    hazard[[2, 3, 7, 8]] = 0.8
    prior = prior_of(VALUES | given, GRID)
    expected = Belief.prior(GRID, hazard, target, 0.5)
    assert prior.joint == pytest.approx(expected.joint, abs=1e-7)
    assert prior.hazard[GRID.base] == 0.0
    assert prior.joint[8].tolist() == [[1.0, 0.0], [0.0, 0.0]]


def test_a_map_of_hazards_alone_leaves_kappa_and_the_targets_without_hazards(tmp_path):
    hazard = np.linspace(0.0, 0.99, 20)
    given = {'prior.hazard_map': write(tmp_path / 'hazard.npy', hazard.reshape(4, 5))}
    prior = prior_of(VALUES | given, GRID)
    free = GRID.may_be_hazardous & (hazard > 0.0)
    assert prior.hazard[free] == pytest.approx(hazard[free])
    assert prior.kappa[free] == pytest.approx(0.8)
    # The numbers 0.5, 0.45 and 0.8 leave 0.1 for targets where no hazard is.
    background = prior.joint[free, 0, 1] / prior.joint[free, 0].sum(axis=1)
    assert background == pytest.approx(0.1)


def test_an_array_of_another_shape_is_resampled_where_that_is_asked_for(tmp_path):
    given = {
        'prior.kappa_map': write(tmp_path / 'kappa.npy', np.full((8, 10), 0.7)),
        'prior.resample': True,
    }
    assert prior_of(VALUES | given, GRID).kappa[0] == pytest.approx(0.7)


@for_each('name, values, told', [
    ('hazard', [[0.5, 1.5]], '1.5 in row 0, column 1: a probability must be from 0 to 1'),
    ('target', [[float('nan')]], 'nan in row 0'),
    ('kappa', [0.5], 'rows and columns'),
    ('target', np.zeros((4, 5)), 'no joint distribution at cell 0: .*; likewise at cells 1, 2'),
    ('hazard', np.ones((4, 5)), 'hazard of cell 2 is 1: that is a base'),
    ('kappa', np.full((5, 4), 0.8), 'has 5 rows and 4 columns.*: transpose it'),
])  # fmt: skip
def test_what_no_prior_can_be_is_refused(tmp_path, name, values, told):
    given = {f'prior.{name}_map': write(tmp_path / 'prior.npy', values)}
    with pytest.raises(ValueError, match=told):
        prior_of(VALUES | given, GRID)


def test_an_earlier_mission_is_a_prior(log):
    path, known = log
    prior = prior_of(VALUES | {'prior.log': path}, GRID)
    assert prior.joint == pytest.approx(known.joint, abs=1e-15)
    moved = prior_of(VALUES | {'prior.log': path}, replace(GRID, base=12))
    assert moved.hazard[12] == 0.0
    assert moved.target[12] == pytest.approx(known.joint[12, 0, 1] / known.joint[12, 0].sum())
    others = np.arange(20) != 12
    assert moved.joint[others] == pytest.approx(known.joint[others], abs=1e-15)


@pytest.mark.parametrize(
    'change', [{'blocked': (8,)}, {'resolution': 0.2}, {'origin': (0.0, 0.7)}]
)
def test_a_mission_in_another_field_is_none(log, change):
    with pytest.raises(ValueError, match=r'is of a mission on Grid\(.*: the parameters say Grid'):
        prior_of(VALUES | {'prior.log': log[0]}, replace(GRID, **change))


def test_logs_that_tell_no_belief_are_refused(log, tmp_path):
    path, _ = log
    bare = Mission()
    bare.sent.clear()
    bare.send_out([2, 7, 2])
    silent = str(record(tmp_path / 'silent.mcap', bare.sent))
    for file, told in (('nowhere.mcap', 'nowhere.mcap'), (silent, 'no belief on record')):
        with pytest.raises((ValueError, OSError), match=told):
            prior_of(VALUES | {'prior.log': file}, GRID)
    with pytest.raises(ValueError, match='prior.log is given with a map'):
        prior_of(VALUES | {'prior.log': path, 'prior.kappa_map': 'kappa.npy'}, GRID)
