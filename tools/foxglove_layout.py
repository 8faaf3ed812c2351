# SPDX-License-Identifier: Apache-2.0
"""
Make the layout of Foxglove for a mission with so many agents.

``python3 tools/foxglove_layout.py AGENTS`` prints it; those of one agent and of eight are in
config/foxglove/. It takes foxglove-sdk, which requirements/dev.txt pins.
"""

import json
import sys

from foxglove.layouts import (
    BaseRendererPosesTopicSettings,
    BaseRendererRosMarkerTopicSettings,
    BaseRendererRosOccupancyGridTopicSettings,
    DiagnosticsSummaryConfig,
    DiagnosticsSummaryPanel,
    Layout,
    PlotConfig,
    PlotPanel,
    PlotSeries,
    SplitContainer,
    SplitItem,
    ThreeDeeConfig,
    ThreeDeePanel,
)
from kbnitp_ros.figures import SERIES

LINES = {'solid': 'solid', 'dash': 'dashed', 'dot': 'dotted', 'dashdot': 'dashed'}

# What a map is white and full of.
COLOURS = {'hazard': '#67000d', 'target': '#00441b', 'kappa': '#3f007d'}

# The safest lane of a mission with such a goal.
LANE = '#009e73'


def layout(agents: int) -> Layout:
    """Return the layout of a mission: the maps, what is known, and how the nodes are."""
    maps = [SplitItem(content=map_panel(name, agents)) for name in COLOURS]
    plots = [
        plot('entropy (nats)', 'hazard_entropy', 'target_entropy', 'joint_entropy'),
        plot('robots', 'lost', 'out'),
        plot('information (nats)', 'information_expected', 'information_gained'),
    ]
    nodes = DiagnosticsSummaryPanel(
        config=DiagnosticsSummaryConfig(
            topic_to_render='/diagnostics', hardware_id_filter='kbnitp_ros'
        ),
        title='nodes',
    )
    below = [*(SplitItem(content=each) for each in plots), SplitItem(content=nodes)]
    return Layout(
        content=SplitContainer(
            direction='column',
            items=[
                SplitItem(content=SplitContainer(direction='row', items=maps), proportion=2),
                SplitItem(content=SplitContainer(direction='row', items=below)),
            ],
        )
    )


def map_panel(name: str, agents: int) -> ThreeDeePanel:
    """Return a panel with one of the grids, and on it paths, readings and poses."""
    topics = {
        f'/belief/{name}': BaseRendererRosOccupancyGridTopicSettings(
            visible=True,
            color_mode='custom',
            min_color='#ffffff',
            max_color=COLOURS[name],
            unknown_color='#999999',
        )
    }
    for number in range(1, agents + 1):
        colour = SERIES[(number - 1) % len(SERIES)].colour
        topics[f'/scout_{number}/path'] = BaseRendererPosesTopicSettings(
            visible=True, type='line', line_width=0.1, gradient=(colour, colour)
        )
        topics[f'/scout_{number}/readings'] = BaseRendererRosMarkerTopicSettings(visible=True)
    if name == 'hazard':
        topics['/decision/lane'] = BaseRendererPosesTopicSettings(
            visible=True, type='line', line_width=0.2, gradient=(LANE, LANE)
        )
    config = ThreeDeeConfig(follow_tf='map', follow_mode='follow-none', topics=topics)
    return ThreeDeePanel(config=config, title=name)


def plot(title: str, *fields: str) -> PlotPanel:
    """Return a panel with curves of fields of the topic progress."""
    series = [
        PlotSeries(
            value=f'/progress.{field}',
            label=field.replace('_', ' '),
            color=style.colour,
            line_style=LINES[style.plotly_dash],
            enabled=True,
            timestamp_method='receiveTime',
        )
        for field, style in zip(fields, SERIES)
    ]
    return PlotPanel(config=PlotConfig(paths=series, show_legend=True), title=title)


if __name__ == '__main__':
    print(json.dumps(json.loads(layout(int(sys.argv[1])).to_json()), indent=1))
