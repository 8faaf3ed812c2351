# SPDX-License-Identifier: Apache-2.0
"""Agents and costmap filters of docs/robots.md, with the printed agent."""

import json
from pathlib import Path
import re
import subprocess
import sys

from kbnitp_msgs.msg import BeliefMaps, DeploymentReport
from kbnitp_ros.configuration import node_parameters
from kbnitp_ros.core import Grid
from kbnitp_ros.log.replay import replay
from kbnitp_ros.messages.grids import check_filter, KEEPOUT, SPEED_ABSOLUTE, SPEED_PERCENT
from laws import for_each
import numpy as np
import pytest
import yaml

PAGE = Path(__file__).parents[2] / 'docs/robots.md'
GRID = Grid(4, 3)
AGENT = re.search(r'^```python\n(.*?)^```', PAGE.read_text(), re.MULTILINE | re.DOTALL)[1]


@pytest.fixture
def minimal_agent(tmp_path):
    """Provide a function that starts the printed agent; end it afterwards."""
    started = []

    def start():
        file = tmp_path / 'minimal_agent.py'
        file.write_text(AGENT)
        started.append(subprocess.Popen([sys.executable, file]))

    yield start
    for process in started:
        process.kill()
        process.wait()


def test_the_agent_as_printed_completes_a_mission(field, minimal_agent):
    log = field.folder / 'log' / 'mission.mcap'
    log.parent.mkdir()
    reports = field.listen(DeploymentReport, '/scout_1/report')
    parameters = {'robots': 3, 'file': str(log), 'max_steps': 8, 'recorded': True}
    parameters |= {'silent_loss': True, 'step_period': 0.01}
    minimal_agent()
    for node in ('recorder', 'estimator'):
        field.start(node, parameters)
    # Replay needs the belief before the first deployment.
    waiting = 'waiting for a planner to publish AGENT/path in'
    field.until(lambda: field.state('/recorder').startswith(waiting), 'belief to record')
    field.start('planner', parameters)
    field.until(lambda: field.state('/planner').startswith('done: 3 of 3'), 'end')
    field.until(lambda: len(reports) == 3, 'last report')
    assert [report.survived for report in reports] == [True] * 3
    field.processes.stop()
    replayed = replay(log)
    assert replayed.reproduced
    assert len(replayed.evidence.standings) == 3


# Subscribes like nav2_costmap_2d 1.3, and prints the effect of the mask's values.
NAV2 = """
import json
import sys

from nav2_msgs.msg import CostmapFilterInfo
from nav_msgs.msg import OccupancyGrid
import rclpy
from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy

LATCHED = QoSProfile(
    depth=1,
    durability=DurabilityPolicy.TRANSIENT_LOCAL,
    reliability=ReliabilityPolicy.RELIABLE,
)


def on_info(info):
    global mask_subscription

    def on_mask(mask):
        space = [info.base + info.multiplier * value for value in mask.data]
        told.append({'type': info.type, 'mask': mask.data.tolist(), 'space': space})
        told[0] |= {'frames': [info.header.frame_id, mask.header.frame_id]}

    mask_subscription = node.create_subscription(
        OccupancyGrid, info.filter_mask_topic, on_mask, LATCHED
    )


told = []
rclpy.init()
node = rclpy.create_node('global_costmap')
node.create_subscription(CostmapFilterInfo, sys.argv[1], on_info, LATCHED)
while not told:
    rclpy.spin_once(node)
print(json.dumps(told[0]))
"""


def printed():
    """Return the estimator's parameters and Nav2's filters of each example on the page."""
    examples = []
    for block in re.findall(r'^```yaml\n(.*?)^```', PAGE.read_text(), re.MULTILINE | re.DOTALL):
        nodes = yaml.safe_load(block)
        if 'filter_info_topic' in block:
            estimator = nodes.pop('/mission/estimator')['ros__parameters']
            ((_, costmap),) = nodes.items()
            examples.append((estimator['filter'], costmap['ros__parameters']))
    return examples


PRINTED = printed()


def started(field, **parameters):
    """Start an estimator in a field with an obstacle; return its published belief."""
    hazard = np.random.default_rng(1).random((3, 4))
    hazard[0, :3] = 0.0, 1.0, 0.004
    np.save(field.folder / 'hazard.npy', hazard)
    beliefs = field.listen(BeliefMaps, '/mission/belief')
    own = {
        'grid.width': 4, 'grid.height': 3, 'grid.blocked': [7],
        'prior.hazard_map': str(field.folder / 'hazard.npy'), 'await_nodes': ['test'],
    }  # fmt: skip
    field.start('estimator', own | parameters, '/mission')
    field.until(lambda: beliefs, 'belief')
    return np.array(beliefs[-1].hazard)


@for_each('example', range(len(PRINTED)))
def test_a_filter_that_starts_later_gets_the_hazards_back(field, example):
    of_filter, costmap = PRINTED[example]
    hazard = started(field, **{f'filter.{name}': value for name, value in of_filter.items()})
    (name,) = costmap['filters']
    topic = costmap[name]['filter_info_topic']
    done = subprocess.run(
        [sys.executable, '-c', NAV2, topic],
        capture_output=True,
        text=True,
        timeout=120,
        check=True,
    )
    told = json.loads(done.stdout)
    assert told['frames'] == ['map', 'map']
    mask, space = np.array(told['mask']), np.array(told['space'])
    free = np.arange(12) != 7
    assert (mask[~free] == -1).all()
    if told['type'] == KEEPOUT:
        assert (space == mask).all()
        found = space / 100.0
    else:
        # From full speed at 0 to a tenth of it at 1.
        found = (100.0 - space) / 90.0
        assert ((space[free] >= 0.0) & (space[free] <= 100.0)).all()
    np.testing.assert_allclose(found[free], hazard[free], atol=0.005 + 1e-6)
    assert hazard[free].min() < 0.1 < 0.9 < hazard[free].max()


def test_the_examples_name_existing_parameters_and_filters():
    table = node_parameters('estimator')
    plugins = {KEEPOUT: 'KeepoutFilter', SPEED_PERCENT: 'SpeedFilter'}
    assert [of_filter['type'] for of_filter, _ in PRINTED] == list(plugins)
    for of_filter, costmap in PRINTED:
        assert {name: table[f'filter.{name}'].check(of_filter[name]) for name in of_filter}
        named = {'filter_type' if n == 'type' else n: v for n, v in of_filter.items()}
        check_filter(GRID, **named)
        (name,) = costmap['filters']
        assert costmap[name]['plugin'] == f'nav2_costmap_2d::{plugins[of_filter["type"]]}'


def test_without_a_filter_nothing_is_published(field):
    started(field)
    assert not field.node.count_publishers('/mission/belief/costmap_filter_info')


@for_each('filter_type, base, multiplier, why', [
    (KEEPOUT, 0.0, 0.5, 'a KeepoutFilter, they must be 0 and 1'),
    (KEEPOUT, 1.0, 1.0, 'a KeepoutFilter, they must be 0 and 1'),
    (SPEED_PERCENT, 0.0, -1.0, '-1 % at 1 % of hazard and -100 % at 100 %'),
    (SPEED_PERCENT, 101.5, -1.0, '100.5 % at 1 % of hazard .* must be from 0 to 100 %'),
    (SPEED_ABSOLUTE, 1.0, -0.02, '0.98 m/s at 1 % of hazard and -1 m/s at 100 %'),
])  # fmt: skip
def test_limits_without_effect_in_nav2_are_refused(filter_type, base, multiplier, why):
    with pytest.raises(ValueError, match=why):
        check_filter(GRID, filter_type, base, multiplier)


def test_limits_of_nav2_are_allowed():
    check_filter(GRID, KEEPOUT, 0.0, 1.0)
    check_filter(GRID, SPEED_PERCENT, 100.0, -1.0)
    check_filter(GRID, SPEED_ABSOLUTE, 1.5, -0.015)


def test_a_filter_of_a_turned_field_is_refused():
    with pytest.raises(ValueError, match=r'turned by 0.3 rad: Nav2 ignores the turn of a mask'):
        check_filter(Grid(4, 3, yaw=0.3), KEEPOUT, 0.0, 1.0)
