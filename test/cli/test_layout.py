# SPDX-License-Identifier: Apache-2.0
"""The views that `layout` writes show the topics of their mission, and no others."""

import json
from pathlib import Path
import re

from kbnitp_ros.cli.layout import main
from kbnitp_ros.messages.topics import OF_AGENT, OF_MISSION
from laws import for_each
from mission_log import record
from missions import sent_by_single
import pytest
import yaml

ROOT = Path(__file__).parents[2]
FIVE = ['scout_1', 'scout_2', 'mule', 'drone_a', 'drone_b']

# Displays of RViz by the types of the table; readings are markers of simulated agents.
KINDS = {'nav_msgs/msg/OccupancyGrid': 'Map', 'nav_msgs/msg/Path': 'Path'}


def written(folder, *arguments):
    """Return the two views that the command writes."""
    assert main([*arguments, '--folder', str(folder)]) == 0
    rviz = yaml.safe_load((folder / 'mission.rviz').read_text())['Visualization Manager']
    return rviz, json.loads((folder / 'mission.json').read_text())


def topics_of_foxglove(layout):
    panels = layout['configById'].values()
    shown = {topic for panel in panels for topic in panel.get('topics', ())}
    plotted = {path['value'] for panel in panels for path in panel.get('paths', ())}
    return shown, {value.partition('.')[0] for value in plotted}


@for_each('namespace, agents', [('/north', FIVE), ('a/b', ['scout_1']), ('', FIVE[:2])])
def test_every_topic_is_one_of_the_mission(namespace, agents, tmp_path):
    named = ['--namespace', namespace] if namespace else []
    rviz, layout = written(tmp_path / 'views', *named, '--agents', *agents)
    root = f'/{namespace.strip("/")}'.rstrip('/')
    types = {f'{root}/{name}': topic.type_name for name, topic in OF_MISSION.items()}
    for agent in agents:
        types |= {f'{root}/{agent}/{name}': topic.type_name for name, topic in OF_AGENT.items()}
    readings = {f'{root}/{agent}/readings' for agent in agents}
    assert rviz['Global Options']['Fixed Frame'] == 'map'
    *displays, poses = rviz['Displays']
    assert poses['Class'] == 'rviz_default_plugins/TF'
    shown = {display['Topic']['Value']: display for display in displays}
    assert shown.keys() == {
        *(f'{root}/belief/{name}' for name in ('hazard', 'target', 'kappa')),
        f'{root}/decision/lane',
        *(f'{root}/{agent}/{name}' for agent in agents for name in ('path', 'proposal')),
        *readings,
    }
    for topic, display in shown.items():
        kind = 'Marker' if topic in readings else KINDS[types[topic]]
        assert display['Class'] == f'rviz_default_plugins/{kind}'
        assert display['Enabled']
        # A late joiner sees it.
        assert display['Topic']['Durability Policy'] == 'Transient Local'
        assert display['Topic']['Reliability Policy'] == 'Reliable'
    drawn, plotted = topics_of_foxglove(layout)
    assert drawn == {each for each in shown if not each.endswith('/proposal')}
    assert plotted == {f'{root}/progress'}
    assert plotted <= types.keys()


def test_panels_have_a_title_in_both_viewers(tmp_path):
    _, layout = written(tmp_path, '--agents', 'scout_1')
    titles = {name: panel['foxglovePanelTitle'] for name, panel in layout['configById'].items()}
    assert len({*titles.values()}) == 7
    # PANEL_TITLE_CONFIG_KEY of Lichtblick, and that of Foxglove.
    assert titles == {
        name: panel['lichtblickPanelTitle'] for name, panel in layout['configById'].items()
    }


@for_each('rviz, foxglove, agents', [('mission', 'kbnitp', 1), ('team', 'kbnitp_team', 8)])
def test_the_shipped_views_are_those_of_the_command(rviz, foxglove, agents, tmp_path):
    written(tmp_path, '--agents', *(f'scout_{number + 1}' for number in range(agents)))
    for name, shipped in (('rviz', f'rviz/{rviz}.rviz'), ('json', f'foxglove/{foxglove}.json')):
        made = tmp_path / f'mission.{name}'
        assert made.read_text() == (ROOT / 'config' / shipped).read_text()


def test_a_log_names_namespace_and_agents(tmp_path, capsys):
    log = record(tmp_path / 'mission.mcap', sent_by_single(2).sent)
    of_log = written(tmp_path / 'a', str(log))
    assert of_log == written(tmp_path / 'b', '--agents', 'scout_1')
    assert re.search(r'wrote .*a/mission\.rviz for RViz', capsys.readouterr().out)


@for_each(
    'arguments, told',
    [
        (['nowhere.mcap'], 'nowhere.mcap'),
        (['--agents', 'a b'], 'agents'),
    ],
)
def test_wrong_names_are_refused(arguments, told, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    assert main(arguments) == 2
    assert told in capsys.readouterr().err
    assert [*tmp_path.iterdir()] == []


@for_each('arguments', [[], ['runs/small', '--agents', 'scout_1']])
def test_names_come_from_a_log_or_from_the_line(arguments):
    with pytest.raises(SystemExit):
        main(arguments)
