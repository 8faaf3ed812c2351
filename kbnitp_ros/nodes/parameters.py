# SPDX-License-Identifier: Apache-2.0
"""
The parameters of all nodes, in one table.

From it the nodes declare them, what users give is checked (`given`), and the reference page is
printed by ``python3 -m kbnitp_ros.nodes.parameters``.
"""

from __future__ import annotations

from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass, fields, replace
from difflib import get_close_matches
import json
import re
from typing import Any

from kbnitp_ros.core import (
    ALLOCATIONS,
    Beta,
    check_team,
    Conduct,
    Estimator,
    Grid,
    Kind,
    METHODS,
    PathFinder,
    PLANNERS,
    SensorModel,
    Unknowns,
)
from kbnitp_ros.files import parse_yaml
from kbnitp_ros.maps import Map, read_map
from kbnitp_ros.messages.grids import told_resolution
from kbnitp_ros.nodes.prior import prior_of
from kbnitp_ros.plugins import Registry
from rcl_interfaces.msg import (
    FloatingPointRange,
    IntegerRange,
    ParameterDescriptor,
    SetParametersResult,
)
from rclpy.node import Node
import rclpy.parameter

NODES = ('planner', 'agent', 'team', 'robot', 'estimator', 'recorder')

# What rclpy gives every node.
ROS_PARAMETERS = ('use_sim_time', 'start_type_description_service', 'qos_overrides')

KINDS = {bool: 'true or false', int: 'a whole number', float: 'a number', str: 'a text'}


@dataclass(frozen=True)
class Parameter:
    """
    One row of the table.

    Attributes
    ----------
    name : str
        As in ROS, the dot a level.
    default : bool, int, float, str or tuple of them
        Its type is the parameter's type.
    description : str
        One sentence, with the unit.
    nodes : tuple of str
        The nodes that have it.
    element : type, optional
        The type of a list's elements.
    limits : tuple of two numbers, optional
        Lowest and highest value allowed.
    choices : collection of str
        The values allowed; empty when any is. Those of a registry grow by what other packages add.
    pattern : str
        What a text must match, as a regular expression; empty when it need not.
    read_only : bool
        Whether it is fixed once the node runs.
    per_agent : bool
        Whether one agent may have another value than the others, as ``robots.AGENT.NAME``.

    """

    name: str
    default: Any
    description: str
    nodes: tuple[str, ...]
    element: type | None = None
    limits: tuple[float, float] | None = None
    choices: Collection[str] = ()
    pattern: str = ''
    read_only: bool = True
    per_agent: bool = False

    @property
    def kind(self) -> str:
        """Return what a value must be, in words."""
        if self.element is None:
            return KINDS[type(self.default)]
        return f'a list, each {KINDS[self.element]}'

    @property
    def allowed(self) -> str:
        """Return what a value of the right type must also be, in words; empty when nothing."""
        if self.limits is not None:
            return f'from {self.limits[0]} to {self.limits[1]}'
        if self.choices != ():
            return f'one of {", ".join(self.choices)}'
        return f'of the form {self.pattern}' if self.pattern else ''

    @property
    def must_be(self) -> str:
        """Return what a value must be, in words."""
        return ', '.join(filter(None, (self.kind, self.allowed)))

    @property
    def changeable(self) -> str:
        """Return whether it can be changed, in words; empty when it cannot."""
        return '' if self.read_only else ' Can be changed while the node runs.'

    @property
    def summary(self) -> str:
        """Return what it is, its default and what it must be."""
        return f'{self.description} Default {json.dumps(self.default)}; {self.must_be}.'

    def read(self, text: str) -> Any:
        """
        Return the value that a text typed on a command line stands for, as `check` does.

        Raises
        ------
        ValueError
            If it stands for none.

        """
        if self.element is None and isinstance(self.default, str):
            return self.check(text)
        try:
            # To YAML, 1e-3 is a text.
            value = float(text) if type(self.default) is float else parse_yaml(text)
        except ValueError:
            value = text
        return self.check(value)

    def check(self, value: Any) -> Any:
        """
        Return `value` as this parameter's type; whole numbers are taken for numbers.

        Raises
        ------
        ValueError
            If it is of another type, out of range or none of the choices.

        """
        if self.element is None:
            return self._check_one(value, type(self.default))
        # rclpy hands an empty YAML list over as None.
        values = () if value is None else value
        if isinstance(values, (str, bytes, Mapping)) or not hasattr(values, '__iter__'):
            raise ValueError(f'parameter {self.name} is {value!r}: it must be {self.kind}')
        return tuple(self._check_one(one, self.element) for one in values)

    def _check_one(self, value: Any, wanted: type[Any]) -> Any:
        if wanted is float and type(value) is int:
            value = float(value)
        if type(value) is not wanted:
            raise ValueError(f'parameter {self.name} is {value!r}: it must be {self.kind}')
        if (
            (self.limits and not self.limits[0] <= value <= self.limits[1])
            or (self.choices != () and value not in self.choices)
            or (self.pattern and not re.fullmatch(self.pattern, value))
        ):
            meant = nearest(value, self.choices) if self.choices else ''
            if isinstance(self.choices, Registry) and value in self.choices.refused:
                meant = f'{self.choices.refused[value]}; '
            raise ValueError(
                f'parameter {self.name} is {value!r}: {meant}it must be {self.allowed}'
            )
        return value

    @property
    def descriptor(self) -> ParameterDescriptor:
        """Return what `ros2 param describe` tells of it."""
        descriptor = ParameterDescriptor(
            description=self.description,
            read_only=self.read_only,
            additional_constraints='' if self.limits else self.allowed,
            # rclpy takes an empty list for a list of bytes, whatever it was declared as.
            dynamic_typing=self.element is not None,
        )
        if self.limits is not None:
            low, high = self.limits
            if isinstance(self.default, int):
                descriptor.integer_range = [IntegerRange(from_value=low, to_value=high)]
            else:
                descriptor.floating_point_range = [
                    FloatingPointRange(from_value=low, to_value=high)
                ]
        return descriptor


PROBABILITY = (0.0, 1.0)
MOST_ROBOTS = 20_000
MOST_STEPS = 10_000
LONGEST_SIDE = 1000
MOST_AGENTS = 100
MOST_CELLS = LONGEST_SIDE**2
NAME = '[A-Za-z][A-Za-z0-9_]*'
# The topic of what the operator decides.
OPERATOR = 'operator'
AGENTS = ('agent', 'team')
FIELD = ('planner', *AGENTS, 'estimator')
GRID = (*FIELD, 'robot')

# The numbers that can be learnt: what they are, and what is believed of them at first.
LEARN = {
    'lethality': ('sensor.lethality', (0.0, 1.0)),
    'malfunction': ('sensor.malfunction', (0.0, 1.0, 2.0, 30.0)),
    'hazard_density': ('prior.hazard', (0.0, 1.0, 1.5, 5.0)),
    'kappa': ('prior.kappa', (0.0, 1.0, 4.0, 1.5)),
    'target_background': (
        'the probability of a target where there is no hazard',
        (0.0, 1.0, 1.5, 8.0),
    ),
    'true_positive': ('sensor.true_positive', (0.0, 1.0, 9.0, 1.0)),
    'false_positive': ('sensor.false_positive', (0.0, 1.0, 1.0, 9.0)),
}

TABLE = (
    Parameter(
        'map',
        '',
        'YAML file of a map, as map_server reads it, that gives the field in place of grid.width, '
        'grid.height, grid.origin and grid.blocked; empty for none.',
        GRID,
    ),
    Parameter(
        'map_topic',
        '',
        'Topic that such a map is published on, such as /map, to be waited for; empty for none.',
        GRID,
    ),
    Parameter(
        'unknown_blocks',
        True,
        'Whether robots keep off cells of which the map does not know a part.',
        GRID,
    ),
    Parameter('grid.width', 9, 'Cells along x.', GRID, limits=(1, LONGEST_SIDE)),
    Parameter('grid.height', 9, 'Cells along y.', GRID, limits=(1, LONGEST_SIDE)),
    Parameter(
        'grid.base',
        0,
        'Cell (row * width + column, row 0 at the bottom) that every path starts and ends in.',
        GRID,
        limits=(0, MOST_CELLS - 1),
    ),
    Parameter(
        'grid.base_position',
        (),
        'A point in the cell that every path starts and ends in, x and y in metres in the frame '
        'map, in place of grid.base; empty for none.',
        GRID,
        element=float,
    ),
    Parameter(
        'grid.resolution',
        0.0,
        "Side of a cell in metres, at least the map's; 0 for the map's, without a map 1.",
        GRID,
        limits=(0.0, 1000.0),
    ),
    Parameter(
        'grid.origin',
        (0.0, 0.0),
        'Lower-left corner of cell 0 in metres, x and y in the frame map.',
        GRID,
        element=float,
    ),
    Parameter('grid.blocked', (), 'Cells that no robot can enter.', GRID, element=int),
    Parameter(
        'grid.connectivity',
        8,
        'To how many of the cells around one a step may lead: 8, or the 4 that share a side.',
        GRID,
        limits=(4, 8),
    ),
    Parameter(
        'grid.corners',
        'auto',
        'Whether a diagonal step may touch a blocked cell: cut, as in the paper, or avoid; auto '
        'for avoid on a map and cut without one.',
        GRID,
        choices=('auto', 'avoid', 'cut'),
    ),
    Parameter(
        'max_steps', 18, 'Most steps of a path.', GRID, limits=(1, MOST_STEPS), per_agent=True
    ),
    Parameter(
        'sensor.lethality',
        0.5,
        'Probability that a hazard strikes a robot that steps into its cell. The sensor '
        'parameters of the agent are the truth, those of planner and estimator what they believe.',
        FIELD,
        limits=PROBABILITY,
        per_agent=True,
    ),
    Parameter(
        'sensor.malfunction',
        0.05,
        'Probability that a robot is lost in a step without any hazard.',
        FIELD,
        limits=PROBABILITY,
        per_agent=True,
    ),
    Parameter(
        'sensor.false_negative',
        0.05,
        'Probability that a robot survives a hazard that strikes it.',
        FIELD,
        limits=PROBABILITY,
        per_agent=True,
    ),
    Parameter(
        'sensor.true_positive',
        0.95,
        'Probability that a target is reported where there is one.',
        FIELD,
        limits=PROBABILITY,
        per_agent=True,
    ),
    Parameter(
        'sensor.false_positive',
        0.05,
        'Probability that a target is reported where there is none.',
        FIELD,
        limits=PROBABILITY,
        per_agent=True,
    ),
    Parameter(
        'prior.hazard',
        0.5,
        'Probability of a hazard in each cell before the first deployment.',
        ('estimator',),
        limits=PROBABILITY,
    ),
    Parameter(
        'prior.target',
        0.45,
        'Probability of a target in each cell before the first deployment.',
        ('estimator',),
        limits=PROBABILITY,
    ),
    Parameter(
        'prior.kappa',
        0.8,
        'Probability of a target where there is a hazard, before the first deployment.',
        ('estimator',),
        limits=PROBABILITY,
    ),
    *(
        Parameter(
            f'prior.{name}_map',
            '',
            f'File with prior.{name} of each cell: a map_server map of mode scale, or rows and '
            'columns in .npy; empty for the number, which also holds where the map has nothing.',
            ('estimator',),
        )
        for name in ('hazard', 'target', 'kappa')
    ),
    Parameter(
        'prior.log',
        '',
        'Log of an earlier mission in the same field, whose last belief is the prior; empty for '
        'none.',
        ('estimator',),
    ),
    Parameter(
        'method',
        'kappa_bnitp',
        'How a deployment is turned into belief.',
        ('estimator',),
        choices=METHODS,
    ),
    Parameter(
        'learn',
        (),
        'Numbers that are not known but learnt, by kappa_bnitp_sampled. Robots are then planned '
        'with what is known of them.',
        ('estimator',),
        element=str,
        choices=tuple(LEARN),
    ),
    *(
        Parameter(
            f'learn.{name}',
            interval,
            f'What is believed of {meaning} at first, if it is learnt: low and high, and if not '
            'all between is equally likely a and b of a Beta distribution.',
            ('estimator',),
            element=float,
        )
        for name, (meaning, interval) in LEARN.items()
    ),
    Parameter(
        'agents',
        ('scout_1',),
        f'Names of all agents of the team, at most {MOST_AGENTS}; each has its topics under its '
        'name.',
        FIELD,
        element=str,
        pattern=NAME,
    ),
    Parameter('agent', 'scout_1', 'Name of this agent, one of agents.', ('agent',), pattern=NAME),
    Parameter(
        'agent', 'scout_1', 'Name of the agent that this robot is.', ('robot',), pattern=NAME
    ),
    Parameter(
        'robots',
        100,
        'Robots to deploy, one after another.',
        ('planner',),
        limits=(0, MOST_ROBOTS),
        read_only=False,
    ),
    Parameter(
        'planner',
        'beam',
        'How a path is searched for; random, coverage and shortest_unvisited seek no '
        'information, and are there to be compared with.',
        ('planner',),
        choices=PLANNERS,
        read_only=False,
    ),
    Parameter(
        'beam_width',
        16,
        'Labels the beam planner keeps for each cell and step.',
        ('planner',),
        limits=(1, 10_000),
        read_only=False,
    ),
    Parameter(
        'max_visits',
        3,
        'Most visits of a path to one cell.',
        ('planner',),
        limits=(1, 10_000),
        read_only=False,
    ),
    Parameter(
        'allocation',
        'greedy',
        'How the robots of a round share the field.',
        ('planner',),
        choices=ALLOCATIONS,
        read_only=False,
    ),
    Parameter(
        'loss_cost',
        0.0,
        'What a lost robot is worth, in nats of information.',
        ('planner',),
        limits=(0.0, 1e9),
        read_only=False,
        per_agent=True,
    ),
    Parameter(
        'approval',
        False,
        'Whether robots leave only when the operator has approved of their paths, shown on '
        'AGENT/proposal, by the service approve.',
        ('planner',),
        read_only=False,
    ),
    Parameter(
        'keep_running',
        True,
        'Whether the planner goes on running when the mission is over, and does not end.',
        ('planner',),
    ),
    Parameter(
        'rolling',
        False,
        'Whether a robot leaves whenever its agent is free, and not with all others in rounds.',
        ('planner',),
    ),
    Parameter(
        'step_period',
        0.0,
        'Seconds a robot takes for a step; 0 for as fast as possible.',
        ('planner', *AGENTS),
        limits=(0.0, 1e6),
        per_agent=True,
    ),
    Parameter(
        'detour_probability',
        0.0,
        'Probability that a simulated robot takes a step through a third cell.',
        AGENTS,
        limits=PROBABILITY,
    ),
    Parameter(
        'early_return_probability',
        0.0,
        'Probability that a simulated robot turns back before a step; never before its first.',
        AGENTS,
        limits=PROBABILITY,
    ),
    Parameter(
        'last_contact_probability',
        0.0,
        'Probability that the base hears, after a step, how far a simulated robot is.',
        AGENTS,
        limits=PROBABILITY,
    ),
    Parameter(
        'camera_failure_probability',
        0.0,
        "Probability that a simulated robot's camera fails in a step, for the rest of the way.",
        AGENTS,
        limits=PROBABILITY,
    ),
    Parameter(
        'silent_loss',
        False,
        'Whether a robot that was destroyed is only known by not coming back.',
        ('planner', *AGENTS),
    ),
    Parameter(
        'return_deadline',
        10.0,
        'Seconds of ROS time after the expected return when a silent robot is given up as lost.',
        ('planner',),
        limits=(1e-3, 1e9),
    ),
    Parameter(
        'publish_pose',
        False,
        'Whether robots that are out are shown on /tf, as AGENT/base_link in the frame map.',
        AGENTS,
    ),
    Parameter(
        'await_nodes',
        ('agent', 'estimator'),
        'Who must listen to the paths before the first is sent: '
        'planner, agent, estimator, recorder, whatever their nodes are called, or names of nodes.',
        ('planner',),
        element=str,
        pattern=NAME,
    ),
    Parameter(
        'await_nodes',
        ('planner',),
        'Who must listen to the belief before the first is published: '
        'planner, agent, estimator, recorder, whatever their nodes are called, or names of nodes.',
        ('estimator',),
        element=str,
        pattern=NAME,
    ),
    Parameter(
        'await_nodes',
        ('planner', 'estimator'),
        'Who must listen to the reports before the first robot leaves: '
        'planner, agent, estimator, recorder, whatever their nodes are called, or names of nodes.',
        (*AGENTS, 'robot'),
        element=str,
        pattern=NAME,
    ),
    Parameter(
        'seed',
        0,
        'Seed of the random numbers that the method draws.',
        ('estimator',),
        limits=(0, 2**63 - 1),
    ),
    Parameter(
        'seed',
        0,
        'Seed of the hidden world and of what happens to the robots in it.',
        AGENTS,
        limits=(0, 2**63 - 1),
    ),
    Parameter(
        'world.file',
        '',
        'YAML file with the hidden world; empty to draw one from the seed.',
        AGENTS,
    ),
    Parameter(
        'world.hazard_density',
        0.15,
        'Probability of a hazard in each cell of a drawn world but the base.',
        AGENTS,
        limits=PROBABILITY,
    ),
    Parameter(
        'world.kappa',
        0.8,
        'Probability of a target in a cell of a drawn world that has a hazard.',
        AGENTS,
        limits=PROBABILITY,
    ),
    Parameter(
        'world.target_background',
        0.1,
        'Probability of a target in a cell of a drawn world that has no hazard.',
        AGENTS,
        limits=PROBABILITY,
    ),
    Parameter(
        'publish_truth',
        False,
        'Whether the hidden world is shown on truth/hazard and truth/target.',
        AGENTS,
    ),
    Parameter(
        'recorded',
        False,
        'Whether a robot leaves only when the recorder has its path on disk.',
        ('planner', *AGENTS),
    ),
    Parameter(
        'recorded',
        True,
        'Whether the robot leaves only when the recorder has its path on disk.',
        ('robot',),
    ),
    Parameter(
        'journal',
        '',
        "File on the robot's own disk that keeps its orders, its way and its readings, one for "
        'each mission; empty for AGENT.journal in the folder .ros/kbnitp_ros of the home.',
        ('robot',),
    ),
    Parameter(
        'driver',
        'follow_waypoints',
        'Action of Nav2 that drives the robot.',
        ('robot',),
        choices=('follow_waypoints', 'navigate_through_poses', 'follow_path'),
    ),
    Parameter(
        'nav_namespace',
        '',
        "Namespace of the robot's Nav2, which its actions are in; / for none, empty for that of "
        'this node.',
        ('robot',),
        pattern='/|(/?[A-Za-z][A-Za-z0-9_]*)*',
    ),
    Parameter(
        'base_frame',
        'base_link',
        'Frame of the robot, whose place in the frame map TF tells.',
        ('robot',),
    ),
    Parameter(
        'tf_timeout',
        2.0,
        'Seconds after which a transform or the time of a detection is too old, and for which a '
        'jump of more than a cell must last to count.',
        ('robot',),
        limits=(1e-3, 1e6),
    ),
    Parameter(
        'arrival_tolerance',
        0.5,
        'Metres from the middle of the base within which the robot is home.',
        ('robot',),
        limits=(1e-3, 1e6),
    ),
    Parameter(
        'stay_time',
        2.0,
        'Seconds that a robot waits in a cell where its path stays for a step.',
        ('robot',),
        limits=(0.0, 1e6),
    ),
    Parameter(
        'attempts',
        3,
        'How often a goal is tried that brings the robot to no new cell, before it goes home.',
        ('robot',),
        limits=(1, 1000),
    ),
    Parameter(
        'retry_delay',
        2.0,
        'Seconds after a goal failed until the next.',
        ('robot',),
        limits=(0.0, 1e6),
    ),
    Parameter(
        'server_timeout',
        10.0,
        'Seconds without feedback after which an action server is taken for dead.',
        ('robot',),
        limits=(1e-3, 1e6),
    ),
    Parameter(
        'detection_type',
        'bool',
        'Type of the messages on detections: std_msgs/Bool, or vision_msgs/Detection2DArray where '
        'that package is installed.',
        ('robot',),
        choices=('bool', 'detection2d_array'),
    ),
    Parameter(
        'detection_class',
        '',
        'Class of a detection in an array that is a target; empty for any.',
        ('robot',),
    ),
    Parameter(
        'detection_score',
        0.5,
        'Score that a detection in an array must have to count.',
        ('robot',),
        limits=PROBABILITY,
    ),
    Parameter(
        'resume',
        '',
        'Log of the mission to go on with, its first file or its folder; empty for a new mission.',
        ('planner', *AGENTS, 'estimator', 'recorder'),
    ),
    Parameter(
        'file',
        '',
        'The log to write, which must not exist yet; empty for runs/TIME/mission.mcap. Not used '
        'with resume.',
        ('recorder',),
    ),
    Parameter(
        'compression',
        'none',
        'How the log is compressed.',
        ('recorder',),
        choices=('none', 'zstd'),
    ),
    Parameter(
        'max_file_size',
        2**24,
        'Bytes after which the log goes on in another file beside the first, which frees the '
        'memory that its index takes; 0 for one file.',
        ('recorder',),
        limits=(0, 2**62),
    ),
    Parameter(
        'max_file_duration',
        0.0,
        'Seconds after which the log goes on in another file beside the first; 0 for one file.',
        ('recorder',),
        limits=(0.0, 1e9),
    ),
)


def parameters_of(name: str) -> dict[str, Parameter]:
    """Return the parameters of the node called `name`, by their names."""
    return {parameter.name: parameter for parameter in TABLE if name in parameter.nodes}


def own_name(name: str) -> tuple[str, str] | None:
    """Return the agent and the parameter that ``robots.AGENT.NAME`` names; None of other names."""
    own = re.fullmatch(rf'robots\.({NAME})\.(.+)', name)
    return (own[1], own[2]) if own else None


def parameter_of(node: str, name: str) -> Parameter | None:
    """Return the parameter of a node that has this name, that of one agent too; None if none."""
    known = parameters_of(node)
    own = own_name(name)
    if own is None:
        return known.get(name)
    common = known.get(own[1])
    return replace(common, name=name) if common and common.per_agent else None


def check_known(name: str, nodes: Sequence[str]) -> None:
    """
    Check that a name is one of the parameters of some of these nodes.

    Parameters
    ----------
    name : str
        The parameter's.
    nodes : sequence of str
        One that it is given to, or all that share it.

    Raises
    ------
    ValueError
        If not; names the parameter meant, or the nodes that have this one.

    """
    if name.split('.')[0] in ROS_PARAMETERS or any(parameter_of(node, name) for node in nodes):
        return
    whose = f'the {nodes[0]}' if len(nodes) == 1 else 'every node'
    if others := [node for node in NODES if parameter_of(node, name)]:
        raise ValueError(
            f'parameter {name} is unknown to {whose}: it is one of {", ".join(others)}'
        )
    table = [parameter for node in nodes for parameter in parameters_of(node).values()]
    known = {parameter.name for parameter in table}
    if own := own_name(name):
        agent, meant = own
        known = {f'robots.{agent}.{each.name}' for each in table if each.per_agent}
        if meant in {parameter.name for parameter in table}:
            raise ValueError(f'parameter {name}: all agents have the same {meant}')
    raise ValueError(
        f'parameter {name} is unknown to {whose}: {nearest(name, known)}'
        f'{nodes[0]} --help tells which it has'
    )


def nearest(name: str, known: Iterable[str]) -> str:
    """Return which of the names known may have been meant, as a question; empty when none."""
    # A name within groups, such as lethality, is further from the whole ones than it looks.
    meant = [each for each in sorted(known) if each.rpartition('.')[2] == name]
    meant = meant or get_close_matches(name, sorted(known), n=1, cutoff=0.5)
    return f'did you mean {" or ".join(meant)}? ' if meant else ''


def declare(node: Node, name: str) -> dict[str, Any]:
    """
    Declare the parameters of the node called `name` and return their values.

    The values are kept up to date while the node runs.

    Raises
    ------
    ValueError
        If a value given at start-up has the wrong type, is not allowed, or is for no parameter of
        any node. Those of other nodes are passed over, since nodes often share a section of a
        file.

    """
    mine = parameters_of(name)
    values = {parameter.name: parameter.default for parameter in mine.values()}
    # rclpy has no other way to see what was given for names that are not declared.
    for given, override in node._parameter_overrides.items():
        if parameter := parameter_of(name, given):
            mine[given] = parameter
            values[given] = parameter.check(override.value)
        else:
            check_known(given, NODES)
    # A real robot knows of no other agents.
    if 'agents' in values:
        check_own(values)
    for parameter in mine.values():
        value = values[parameter.name]
        node.declare_parameter(
            parameter.name,
            value if parameter.element is None else list(value),
            parameter.descriptor,
            ignore_override=True,
        )

    def check(changes: list[rclpy.parameter.Parameter]) -> SetParametersResult:
        try:
            for change in changes:
                if change.name in mine:
                    mine[change.name].check(change.value)
        except ValueError as error:
            return SetParametersResult(successful=False, reason=str(error))
        return SetParametersResult(successful=True)

    def keep(changes: list[rclpy.parameter.Parameter]) -> None:
        values.update({change.name: change.value for change in changes if change.name in mine})

    node.add_on_set_parameters_callback(check)
    node.add_post_set_parameters_callback(keep)
    return values


def check_own(values: Mapping[str, Any]) -> None:
    """
    Check that what agents have of their own is for agents that there are.

    Raises
    ------
    ValueError
        If not; names the agent meant.

    """
    for name in values:
        own = own_name(name)
        if own and own[0] not in values['agents']:
            agents = values['agents']
            raise ValueError(
                f'parameter {name} is for {own[0]}: {nearest(own[0], agents)}the parameter agents '
                f'names {", ".join(agents)}'
            )


def value_for(values: Mapping[str, Any], name: str, agent: str) -> Any:
    """Return the value of a parameter for one agent: its own, or else that of all."""
    return values.get(f'robots.{agent}.{name}', values[name])


def most_steps(values: Mapping[str, Any]) -> int:
    """Return the most steps that the path of any agent's robot may have."""
    most: int = max(value_for(values, 'max_steps', agent) for agent in values['agents'])
    return most


def kind_of(values: Mapping[str, Any], agent: str) -> Kind:
    """Return what an agent's robots have of their own."""
    given = {
        **{each.name: f'sensor.{each.name}' for each in fields(SensorModel)},
        'max_steps': 'max_steps',
        'loss_cost': 'loss_cost',
    }
    return Kind(**{each: values.get(f'robots.{agent}.{name}') for each, name in given.items()})


def kinds_of(values: Mapping[str, Any]) -> dict[str, Kind]:
    """Return the kinds of the robots of all agents."""
    return {agent: kind_of(values, agent) for agent in values['agents']}


def grid_of(values: Mapping[str, Any], heard: Map | None = None) -> Grid:
    """
    Return the grid that these parameters describe, as beliefs tell it.

    Parameters
    ----------
    values : mapping
        Of all parameters of the field, by name.
    heard : Map, optional
        The one on the parameter `map_topic`.

    Raises
    ------
    ValueError
        If the map cannot be read, the grid is none or larger than `LONGEST_SIDE`, or two
        parameters do not go together.

    """
    position = values['grid.base_position']
    if position and len(position) != 2:
        raise ValueError(
            f'parameter grid.base_position is {list(position)}: it must be x and y, or empty'
        )
    if values['map'] and values['map_topic']:
        raise ValueError('parameters map and map_topic are both given: the field has one map')
    if heard is None and values['map_topic']:
        raise ValueError('parameter map_topic is given, and no map has come on it')
    field = read_map(values['map']) if values['map'] else heard
    side = told_resolution(values['grid.resolution'])
    corners = values['grid.corners']
    steps = {
        'connectivity': values['grid.connectivity'],
        'through_corners': corners == 'cut' or (corners == 'auto' and field is None),
    }
    if field is not None:
        # As wide as it is told, so that all nodes have one grid.
        field = replace(field, resolution=told_resolution(field.resolution))
        grid = field.grid(
            side or None,
            position or None,
            unknown_blocks=values['unknown_blocks'],
            base=values['grid.base'],
            **steps,
        )
        if max(grid.width, grid.height) > LONGEST_SIDE:
            raise ValueError(
                f'the map makes a grid of {grid.width} x {grid.height} cells: at most '
                f'{LONGEST_SIDE} a side may be; set a coarser grid.resolution'
            )
        return grid
    grid = Grid(
        width=values['grid.width'],
        height=values['grid.height'],
        resolution=side or 1.0,
        origin=values['grid.origin'],
    )
    base = int(grid.cells_at([position])[0]) if position else values['grid.base']
    return replace(grid, base=base, blocked=values['grid.blocked'], **steps)


def sensor_model_of(values: Mapping[str, Any]) -> SensorModel:
    """Return the sensor model that these parameters describe."""
    return SensorModel(
        lethality=values['sensor.lethality'],
        malfunction=values['sensor.malfunction'],
        false_negative=values['sensor.false_negative'],
        true_positive=values['sensor.true_positive'],
        false_positive=values['sensor.false_positive'],
    )


def unknowns_of(values: Mapping[str, Any]) -> Unknowns:
    """
    Return which numbers these parameters leave to be learnt.

    Raises
    ------
    ValueError
        If one is named twice, or what is believed of any at first is no distribution.

    """
    learn = values['learn']
    if len(set(learn)) < len(learn):
        raise ValueError(f'parameter learn is {list(learn)}: it must name each number once')
    priors = {}
    for name in LEARN:
        believed = values[f'learn.{name}']
        try:
            if len(believed) not in (2, 4):
                raise ValueError('it must be low and high, or low, high, a and b')
            priors[name] = Beta(**dict(zip(('low', 'high', 'a', 'b'), believed)))
        except ValueError as error:
            raise ValueError(f'parameter learn.{name} is {list(believed)}: {error}') from error
    return Unknowns(**{name: priors[name] for name in learn})


def estimator_of(values: Mapping[str, Any], grid: Grid) -> Estimator:
    """
    Return the estimator of these parameters on this grid, before the first deployment.

    Raises
    ------
    ValueError
        If there is no such prior, or what is to be learnt cannot be.

    """
    unknowns = unknowns_of(values)
    for name in unknowns.priors:
        if all(getattr(kind, name, None) is not None for kind in kinds_of(values).values()):
            raise ValueError(
                f'parameter learn has {name}: the robots of every agent have one of their own, '
                'which tell nothing of another'
            )
    return Estimator(
        prior_of(values, grid),
        sensor_model_of(values),
        values['method'],
        unknowns,
        values['seed'],
    )


def conduct_of(values: Mapping[str, Any]) -> Conduct:
    """Return how simulated robots depart from their orders."""
    return Conduct(
        detour=values['detour_probability'],
        early_return=values['early_return_probability'],
        last_contact=values['last_contact_probability'],
        camera_failure=values['camera_failure_probability'],
    )


def agents_of(values: Mapping[str, Any], grid: Grid) -> tuple[str, ...]:
    """
    Return the names of the agents, of which robots leave on this grid.

    Raises
    ------
    ValueError
        If there is none, two have one name, or there are more than `MOST_AGENTS` or than free
        cells.

    """
    agents: tuple[str, ...] = values['agents']
    if not agents or len(set(agents)) < len(agents):
        raise ValueError(
            f'parameter agents is {list(agents)}: it must be one or more names, no two alike'
        )
    if OPERATOR in agents:
        raise ValueError(
            f'parameter agents is {list(agents)}: {OPERATOR} is no name for an agent, since a '
            'topic of the planner is called so'
        )
    if len(agents) > MOST_AGENTS:
        raise ValueError(
            f'parameter agents has {len(agents)} names: there can be at most {MOST_AGENTS}'
        )
    free = int(grid.free.sum())
    if len(agents) > free:
        raise ValueError(
            f'parameter agents has {len(agents)} names: there can be at most one for each of the '
            f'{free} free cells'
        )
    return agents


def check_search(values: Mapping[str, Any], grid: Grid) -> None:
    """
    Check that the planner can have the memory that it takes with these parameters on this grid.

    Raises
    ------
    ValueError
        With an estimate, if not.

    """
    limits = (values[name] for name in ('planner', 'max_steps', 'beam_width', 'max_visits'))
    kinds = [kind_of(values, agent) for agent in agents_of(values, grid)]
    check_team(PathFinder(grid, *limits), sensor_model_of(values), kinds)


def reference_page() -> str:
    """Return the page that documents every parameter, in Markdown."""
    lines = [
        '# Parameters',
        '',
        'Printed by `python3 -m kbnitp_ros.nodes.parameters` from the table that the nodes use.',
        'Every node also has `use_sim_time`. A parameter is fixed once its node runs, unless it',
        'says that it can be changed. Other packages may add methods, planners and allocations.',
        '',
        'Of these an agent may have others than the rest, as `robots.AGENT.NAME`; see',
        '[maps.md](maps.md#robots-that-differ): '
        f'{", ".join(dict.fromkeys(f"`{each.name}`" for each in TABLE if each.per_agent))}.',
    ]
    for name in NODES:
        lines += [
            '',
            f'## {name}',
            '',
            '| parameter | default | must be | meaning |',
            '|---|---|---|---|',
        ]
        for parameter in parameters_of(name).values():
            if isinstance(parameter.choices, Registry):
                parameter = replace(parameter, choices=parameter.choices.own)
            lines.append(
                f'| `{parameter.name}` | `{json.dumps(parameter.default)}` | {parameter.must_be} '
                f'| {parameter.description}{parameter.changeable} |'
            )
    return '\n'.join(lines) + '\n'


if __name__ == '__main__':
    print(reference_page(), end='')
