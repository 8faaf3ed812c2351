# SPDX-License-Identifier: Apache-2.0
"""The table of all parameters: names, types, defaults, ranges and meanings."""

from dataclasses import replace
from functools import partial
from itertools import pairwise

from kbnitp_ros.base.preflight import OPTIONAL
from kbnitp_ros.base.state import MAX_ROBOTS
from kbnitp_ros.configuration.parameter import NAME, Parameter
from kbnitp_ros.core import ALLOCATIONS, METHODS, OBJECTIVES, PLANNERS
from kbnitp_ros.core.decision.goals import GOALS
from kbnitp_ros.core.field.clustering import LEARNT_COUPLING, STRONGEST
from kbnitp_ros.core.field.unknowns import HAZARDS, TARGET_KINDS, ZERO

NODES = ('planner', 'agent', 'robot', 'estimator', 'recorder')
FIELD = ('planner', 'agent', 'estimator')
SENSING = ('agent', 'estimator')
GRID = (*FIELD, 'robot')

PROBABILITY = (0.0, 1.0)
MAX_STEPS = 10_000
MAX_SIDE = 1000
MAX_AGENTS = 100
MAX_CELLS = MAX_SIDE**2

# The topic of the operator's actions.
OPERATOR = 'operator'

# How a parameter names nodes.
BY_ROLE = 'by role (planner, agent, estimator, recorder) or by name.'

# Learnable numbers: a description of each and its prior.
LEARN = {
    'lethality': ('sensor.lethality', (0.0, 1.0)),
    'malfunction': ('sensor.malfunction', (0.0, 1.0, 2.0, 30.0)),
    'hazard_density': ('prior.hazard', (0.0, 1.0, 1.5, 5.0)),
    'kappa': ('prior.kappa', (0.0, 1.0, 4.0, 1.5)),
    'target_background': (
        'the probability of a target in a cell without a hazard',
        (0.0, 1.0, 1.5, 8.0),
    ),
    'true_positive': ('sensor.true_positive', (0.0, 1.0, 9.0, 1.0)),
    'false_positive': ('sensor.false_positive', (0.0, 1.0, 1.0, 9.0)),
    'reach': (f'sensor.reach, which is 0 with probability {ZERO["reach"]},', (0.0, 0.6)),
    'duds': (f'sensor.duds, which is 0 with probability {ZERO["duds"]},', (0.0, 1.0)),
    # A Beta distribution with a = 0 and b = 1 is log-uniform.
    'vanish': ('hazards.vanish', (0.001, 0.1, 0.0, 1.0)),
    'move': ('hazards.move', (0.001, 0.1, 0.0, 1.0)),
}

# Numbers that demo and launch files learn by default. A method learns both, or is given both:
# under a wrong density the learnt lethality is wrong as well, since fewer but more lethal hazards
# destroy as many robots.
LEARNT = ('lethality', 'hazard_density')

# Numbers that are learnt with duds: else a higher background of targets is taken for duds.
LEARNT_WITH_DUDS = ('kappa', 'target_background')

# Numbers that are learnt by default in the field, where also targets may change: without the two
# rates of the detector, a poor detector is taken for targets that move.
FIELD_LEARNT = (*LEARNT, 'true_positive', 'false_positive', 'reach')

# Defaults in the field that differ; RViz shows robots at this pace.
IN_FIELD = {
    'sensor.malfunction': 0.001,
    'learn.numbers': FIELD_LEARNT,
    # Log-uniform around the malfunction above.
    'learn.malfunction': (0.0002, 0.2, 0.0, 1.0),
    'silent_loss': True,
    'step_period': 0.2,
    'publish_pose': True,
    'minimum_reach': 0.5,
}

# Constructors of rows for a single node, for planner parameters that can change, for the goal, for
# sensors, and for awaited nodes.
for_planner, for_agent, for_robot, for_estimator, for_recorder = (
    partial(Parameter, nodes=(node,)) for node in NODES
)
changeable = partial(for_planner, read_only=False)
for_goal = partial(Parameter, nodes=('planner', 'estimator'))
sensor = partial(Parameter, nodes=SENSING, limits=PROBABILITY, per_agent=True)
awaits = partial(Parameter, 'await_nodes', element=str, pattern=NAME)

# Each parameter, followed by its description.
ROWS: tuple[Parameter | str, ...] = (
    Parameter('defaults', 'auto', FIELD, choices=('auto', 'paper', 'field')),
    "Set of defaults: paper, of the paper's study; field, for maps and real robots; auto means "
    'field with a map, and paper without a map. Parameters that are given keep their values.',
    Parameter('map', '', GRID, is_file=True),
    'YAML file of a map in the format of map_server, in place of grid.width, grid.height, '
    'grid.origin and grid.blocked; empty for none.',
    Parameter('map_topic', '', GRID),
    'Topic of the map, such as /map, in place of the parameter map: nodes wait for its first '
    'message; empty for none.',
    Parameter('unknown_blocks', True, GRID),
    'Whether robots avoid cells that are partly unknown in the map.',
    Parameter('occupied_thresh', 0.65, GRID, limits=(0.01, 1.0)),
    'Occupancy from which a pixel of the map is an obstacle, as in map files: 0.65 means values '
    'of 65 and more in nav_msgs/OccupancyGrid.',
    Parameter('robot_radius', 0.0, GRID, limits=(0.0, 1000.0)),
    'Radius of the largest robot in metres: obstacles of the map are widened by what exceeds half '
    'a cell.',
    Parameter('grid.width', 9, GRID, limits=(1, MAX_SIDE)),
    'Width of the field, along x, in cells.',
    Parameter('grid.height', 9, GRID, limits=(1, MAX_SIDE)),
    'Height of the field, along y, in cells.',
    Parameter('grid.base', 0, GRID, limits=(0, MAX_CELLS - 1), per_agent=True),
    'Base cell, where paths start and end, by number: row * width + column, row 0 at the bottom. '
    'Set team.AGENT.base for the base of a single agent.',
    Parameter('grid.base_position', (), GRID, element=float, per_agent=True),
    'Position of the base: x and y of a point in its cell, metres in the frame map, in place of '
    'grid.base; empty for none. Set team.AGENT.base_position for a single agent.',
    Parameter('parking', (), ('planner', 'robot'), element=float, per_agent=True),
    'Home of a robot in the cell of its base: x and y in metres in the frame map, and optionally '
    'its yaw in rad; empty for the middle of the cell. Set team.AGENT.parking for each robot.',
    Parameter('grid.resolution', 0.0, GRID, limits=(0.0, 1000.0)),
    'Side of a cell in metres, at least the resolution of the map; 0 means 1 m, or the '
    'resolution of the map if that is coarser.',
    Parameter('grid.origin', (0.0, 0.0), GRID, element=float),
    'Lower-left corner of the field, x and y in metres in the frame map; an optional third '
    'number is the angle from the x axis of that frame to the rows, counterclockwise, in rad.',
    Parameter('datum', (), ('estimator', 'robot'), element=float),
    'Geographic datum: latitude and longitude of the origin of the frame map, WGS84 in degrees, '
    'and the angle from east to the x axis, counterclockwise, in rad, as for robot_localization; '
    'empty for none.',
    Parameter('grid.blocked', (), GRID, element=int),
    'Cells that no robot can enter.',
    Parameter('grid.connectivity', 8, GRID, limits=(4, 8)),
    'Number of neighbours that a step may lead to: 8, or the 4 that share a side.',
    Parameter('grid.corners', 'auto', GRID, choices=('auto', 'avoid', 'cut')),
    'Whether diagonal steps may touch blocked cells: cut allows such steps, as in the paper; '
    'avoid forbids them; auto means avoid with a map, and cut without a map.',
    Parameter('max_steps', 18, GRID, limits=(1, MAX_STEPS), per_agent=True),
    'Maximum number of steps of a path.',
    changeable('max_distance', 0.0, limits=(0.0, 1e9), per_agent=True),
    'Maximum length of a path in metres: a diagonal step is 1.41 times as long as a straight '
    'step, and a stay has length 0. Only for the planners beam and relaxed with the goal map; 0 '
    'for no limit.',
    sensor('sensor.lethality', 0.5),
    'Probability that a hazard strikes a robot that enters its cell. Sensor parameters of the '
    'agent are the truth; sensor parameters of the estimator are the belief of estimator and '
    'planner.',
    sensor('sensor.malfunction', 0.05),
    'Probability that a robot is lost in a step without any hazard.',
    sensor('sensor.false_negative', 0.05),
    'Probability that a robot survives a hazard that strikes it.',
    sensor('sensor.true_positive', 0.95),
    'Probability that a target in the cell is reported.',
    sensor('sensor.false_positive', 0.05),
    'Probability that a target is reported in a cell without a target.',
    Parameter('sensor.reach', 0.0, SENSING, limits=PROBABILITY),
    'Lethality of a hazard in each of the eight cells around it, as a share of its lethality in '
    'its own cell; 0 if hazards do not reach.',
    Parameter('sensor.duds', 0.0, SENSING, limits=PROBABILITY),
    'Share of the hazards that never strike, such as dead ones and decoys, each for the whole '
    'mission; 0 for none. In a static field, with the methods kappa_bnitp and relaxed_itp.',
    Parameter('hazards.dynamics', 'static', SENSING, choices=HAZARDS),
    'Dynamics of hazards: static, changing from one deployment to the next, moving to '
    'neighbouring cells, or used up when they strike; learn to infer the kind from the evidence. '
    'The value of the agent is the truth, the value of the estimator is the belief of estimator '
    'and planner.',
    Parameter('hazards.appear', 0.0, SENSING, limits=PROBABILITY),
    'Probability per deployment that a cell without a hazard gets one, for changing hazards; if '
    'hazards.vanish is learnt, 0 means the rate that keeps the expected number of hazards '
    'constant.',
    Parameter('hazards.vanish', 0.0, SENSING, limits=PROBABILITY),
    'Probability per deployment that a hazard disappears, for changing hazards.',
    Parameter('hazards.move', 0.0, SENSING, limits=PROBABILITY),
    'Probability per deployment that a hazard goes to a free neighbouring cell, for moving '
    'hazards.',
    Parameter('targets.dynamics', 'static', SENSING, choices=TARGET_KINDS),
    'Dynamics of targets: static, changing from one deployment to the next, or moving to '
    'neighbouring cells; learn, for the estimator, to infer from the evidence if and how fast '
    'they change. Targets that move are learnt as changing ones. The value of the agent is the '
    'truth, the value of the estimator is the belief, in the field learn if learn.numbers is not '
    'given.',
    Parameter('targets.appear', 0.0, SENSING, limits=PROBABILITY),
    'Probability per deployment that a cell without a target gets one, for changing targets.',
    Parameter('targets.vanish', 0.0, SENSING, limits=PROBABILITY),
    'Probability per deployment that a target disappears, for changing targets.',
    Parameter('targets.move', 0.0, SENSING, limits=PROBABILITY),
    'Probability per deployment that a target of the agent goes to a free neighbouring cell, for '
    'moving targets.',
    for_estimator('prior.hazard', 0.5, limits=PROBABILITY),
    'Probability of a hazard in each cell before the first deployment.',
    for_estimator('prior.target', 0.45, limits=PROBABILITY),
    'Probability of a target in each cell before the first deployment.',
    for_estimator('prior.kappa', 0.8, limits=PROBABILITY),
    'Probability of a target in a cell with a hazard, before the first deployment.',
    *(
        for_estimator(
            f'prior.{name}_map',
            '',
            description=f'File with prior.{name} of each cell: a map of map_server in mode scale, '
            f'or a .npy array of rows and columns. Cells without a value have prior.{name}; '
            f'empty for prior.{name} in all cells.',
            is_file=True,
        )
        for name in ('hazard', 'target', 'kappa')
    ),
    for_estimator('prior.resample', False),
    'Whether to resample a prior map in .npy whose numbers of rows and columns differ from the '
    "field's: each cell gets the mean of the values over it.",
    for_estimator('prior.clustering', 0.0, limits=(0.0, STRONGEST), word=LEARNT_COUPLING),
    'Coupling of hazards in cells that share a side (a Markov random field), for the method '
    'kappa_bnitp_sampled; 0 for independent hazards, learn for an unknown coupling.',
    for_estimator('prior.log', ''),
    'Log of an earlier mission in the same field, whose last belief is the prior; empty for none.',
    for_estimator('method', 'kappa_bnitp', choices=METHODS),
    'Inference method of the belief.',
    for_estimator('check_every', 10, limits=(1, MAX_ROBOTS)),
    'Number of deployments from one check of the model to the next; the last belief is always '
    'checked.',
    for_estimator('filter.type', -1, limits=(0, 2), off=-1),
    'Nav2 costmap filter that takes belief/hazard_mask as its mask, announced on '
    'belief/costmap_filter_info: 0 for a KeepoutFilter, 1 for a SpeedFilter in percent, 2 for a '
    'SpeedFilter in m/s; -1 for none.',
    for_estimator('filter.base', 0.0, limits=(-1e6, 1e6)),
    'Value of the Nav2 costmap filter at 0 percent of hazard: 0 for a KeepoutFilter, a speed '
    'limit for a SpeedFilter.',
    for_estimator('filter.multiplier', 1.0, limits=(-1e6, 1e6)),
    'Change of the value of the Nav2 costmap filter for each percent of hazard: 1 for a '
    'KeepoutFilter.',
    for_estimator('learn.numbers', (), element=str, choices=tuple(LEARN)),
    'Numbers to learn from the evidence, with the methods kappa_bnitp, relaxed_itp (all numbers '
    'but kappa) or, in a static field, kappa_bnitp_sampled. With duds, kappa and '
    'target_background are learnt as well. Robots are planned with the current estimates.',
    *(
        for_estimator(
            f'learn.{name}',
            interval,
            description=f'Prior of {meaning} if it is learnt: low and high of a uniform '
            'distribution, or low, high, a and b of a Beta distribution.',
            element=float,
        )
        for name, (meaning, interval) in LEARN.items()
    ),
    Parameter('agents', ('scout_1',), (*FIELD, 'recorder'), element=str, pattern=NAME),
    f'Names of all agents of the team, at most {MAX_AGENTS}; the topics of an agent are below its '
    'name.',
    for_agent('agent', '', pattern=f'({NAME})?'),
    'Agent, one of the parameter agents, whose robots this node simulates; empty for all.',
    for_robot('agent', 'scout_1', pattern=NAME),
    'Agent name of this robot.',
    changeable('robots', 100, limits=(0, MAX_ROBOTS)),
    'Number of robots to deploy.',
    changeable('planner', 'beam', choices=PLANNERS),
    'Planner that searches for paths; random, coverage and shortest_unvisited seek no '
    'information and serve as baselines.',
    changeable('beam_width', 16, limits=(1, 10_000)),
    'Width of the beam planner: it keeps a quarter of this number of labels, at least two, for '
    'each cell and step.',
    changeable('max_visits', 3, limits=(1, 10_000)),
    'Maximum number of visits of a path to a cell.',
    changeable('allocation', 'greedy', choices=ALLOCATIONS),
    'Allocation of paths to the robots of a round.',
    changeable('objective', 'information', choices=OBJECTIVES),
    'Objective of paths: information, the expected information; information_per_loss, the '
    'information for each robot expected to be lost, which needs the planner beam or relaxed.',
    changeable('loss_cost', 0.0, limits=(0.0, 1e9), per_agent=True),
    'Cost of a lost robot, in nats of information.',
    for_goal('goal.kind', 'map', choices=GOALS),
    'Goal of the mission: map, as much information as possible; lane, a way free of hazards from '
    'the base to a cell; area, cells free of hazards.',
    for_goal('goal.cells', (), element=int),
    'Cells of the goal, by number: the cells of an area, or the last cell of a lane.',
    for_goal('goal.position', (), element=float),
    'Position of the goal: x and y of a point in its only cell, metres in the frame map, in '
    'place of goal.cells; empty for none.',
    for_goal('goal.mask', '', is_file=True),
    'YAML file of a map in the format of map_server, with a pixel for each cell of the field: '
    'occupied pixels are the cells of the goal, in place of goal.cells; empty for none.',
    for_goal('stop.confidence', 0.0, limits=(0.0, 1.0 - 1e-6), read_only=False),
    'Probability of the goal at which the mission ends as successful; 0 for never.',
    changeable('stop.gain', 0.0, limits=(0.0, 1e9)),
    'Minimum gain of the best deployment for each robot expected to be lost, in nats (for the '
    'goal lane: a probability). The mission ends when the gain is lower; 0 for never.',
    changeable('stop.losses', 0, limits=(0, MAX_ROBOTS)),
    'Number of lost robots at which the mission ends; 0 for never.',
    changeable('minimum_survival', 0.0, limits=PROBABILITY),
    'Minimum survival probability of a path: paths with a lower probability are not sent, and '
    'the mission ends when no path is left.',
    for_planner('minimum_reach', 0.0, limits=PROBABILITY),
    'Minimum share of the cells connected to the base that paths must reach, for the goal map: '
    'if max_steps is too low for it, no robot leaves; 0 for no minimum.',
    changeable('approval', False),
    'Whether robots leave only after the operator has approved their paths by the service '
    'approve. The paths are proposed on AGENT/proposal.',
    changeable('min_battery', 0.0, limits=PROBABILITY, per_agent=True),
    'Minimum charge of a battery at departure, as a share: a robot with less, or whose charge is '
    'not known, stays at its base while others leave; 0 for no minimum.',
    for_planner('separation', 0.0, limits=(0.0, 1e6)),
    'Metres from the home of a robot that the robot of the same base before it must have reached, '
    'by its last place heard, before it leaves; needs rolling; 0 for no distance.',
    for_planner('ready_topic', '', pattern=f'({NAME}(/{NAME})*)?'),
    'Topic below the name of each agent, a std_msgs/Bool published as hold is, that must be true '
    'for its robot to leave; empty for none.',
    changeable('preflight_skip', (), element=str, choices=OPTIONAL),
    'Checks of preflight whose red does not count, which its option --skip adds: as a change of a '
    'parameter it is on record.',
    for_planner('keep_running', True),
    'Whether the planner keeps running when the mission is over.',
    for_planner('rolling', False),
    'Whether each robot leaves as soon as its agent is free, instead of in rounds with the other '
    'robots.',
    Parameter('step_period', 0.0, ('planner', 'agent'), limits=(0.0, 1e6), per_agent=True),
    'Seconds that a robot takes for a step; 0 for as fast as possible.',
    for_agent('detour_probability', 0.0, limits=PROBABILITY),
    'Probability that a simulated robot makes a detour through a third cell in a step.',
    for_agent('early_return_probability', 0.0, limits=PROBABILITY),
    'Probability that a simulated robot turns back before a step other than its first.',
    Parameter('contact_probability', 0.0, ('planner', 'agent'), limits=PROBABILITY),
    'Probability that the base receives the progress of a robot after a step that the robot '
    'survives, so that the place of a loss can be inferred; 0 to infer nothing from silence.',
    for_agent('camera_failure_probability', 0.0, limits=PROBABILITY),
    "Probability that a simulated robot's camera fails in a step, for the rest of the way.",
    Parameter('silent_loss', False, ('planner', 'agent')),
    'Whether a destroyed robot sends no report, so that the base infers the loss from its '
    'absence.',
    for_planner('return_deadline', 10.0, limits=(1e-3, 1e9)),
    'Seconds from the expected return of a silent robot until it is given up as lost, by the '
    'simulated clock if use_sim_time is true.',
    changeable('presume_departure', False),
    'Whether robots count as departed once their paths are sent (with recorded: are on disk), '
    'instead of when their agents report the departure on AGENT/status. If false, with '
    'silent_loss, an agent that never reports departures gets no path.',
    for_agent('publish_pose', False),
    'Whether robots in flight are shown on /tf, as AGENT/base_link in the frame map.',
    awaits(('agent', 'estimator'), ('planner',)),
    f'Nodes that must subscribe to paths before the planner sends the first path, {BY_ROLE}',
    awaits(('planner',), ('estimator',)),
    'Nodes that must subscribe to beliefs before the estimator publishes the first belief, '
    f'{BY_ROLE}',
    awaits(('planner', 'estimator'), ('agent', 'robot')),
    f'Nodes that must subscribe to reports before the first robot leaves, {BY_ROLE}',
    for_estimator('seed', 0, limits=(0, 2**63 - 1)),
    'Seed of the random numbers that the method draws.',
    for_agent('seed', 0, limits=(0, 2**63 - 1)),
    'Seed of the hidden world and of the outcomes of robots.',
    for_agent('world.file', '', is_file=True),
    'YAML file with the hidden world; empty to draw one from the seed.',
    for_agent('world.hazard_density', 0.15, limits=PROBABILITY),
    'Probability of a hazard in each cell of a drawn world except the bases.',
    for_agent('world.kappa', 0.8, limits=PROBABILITY),
    'Probability of a target in each cell with a hazard, in a drawn world.',
    for_agent('world.target_background', 0.1, limits=PROBABILITY),
    'Probability of a target in each cell without a hazard, in a drawn world.',
    for_agent('publish_truth', False),
    'Whether the hidden world is shown on truth/hazard and truth/target.',
    Parameter('recorded', False, ('planner', 'estimator', 'agent')),
    'Whether a robot leaves only when its path and its departure are on record, and the '
    'estimator accepts recorded paths only.',
    for_robot('recorded', True),
    'Whether the robot leaves only when its path and its departure are on record.',
    for_robot('journal', '', is_file=True),
    'Journal of the robot: a file on its own disk with its orders, its way and its readings. '
    'When a mission begins, the journal of the last mission is moved to a folder beside it. '
    'Empty for .ros/kbnitp_ros/AGENT.journal in the home folder.',
    for_robot(
        'driver',
        'follow_waypoints',
        choices=('follow_waypoints', 'navigate_through_poses', 'follow_path'),
    ),
    'Action of Nav2 that drives the robot.',
    for_robot('nav_namespace', '', pattern='/|(/?[A-Za-z][A-Za-z0-9_]*)*'),
    "Namespace of the robot's Nav2; / for none, empty for the namespace of this node.",
    for_robot('position', 'tf', choices=('tf', 'fix')),
    'Source of the robot position: tf for TF, or fix for sensor_msgs/NavSatFix on the topic fix, '
    'which needs a datum.',
    for_robot('base_frame', 'base_link'),
    'Frame of the robot: TF gives its place in the frame map, and fixes must be in this frame.',
    for_robot('tf_timeout', 2.0, limits=(1e-3, 1e6)),
    'Maximum age of a transform, a fix or a detection, seconds. A jump by more than a cell is '
    'accepted once the new position has lasted for this time.',
    for_robot('max_speed', 0.0, limits=(0.0, 1e6)),
    'Maximum speed of the robot, in m/s, which tells jumps of the localization; 0 for that of '
    'Nav2 or, if Nav2 states none, two cells a second.',
    for_robot('pose_topic', ''),
    'Topic of a geometry_msgs/PoseWithCovarianceStamped in nav_namespace, such as amcl_pose, '
    'with the standard deviation of a position by TF without odometry; empty for none.',
    for_robot('battery_topic', ''),
    'Topic of a sensor_msgs/BatteryState with the charge of the robot; empty for none.',
    for_robot('arrival_tolerance', 0.5, limits=(1e-3, 1e6)),
    'Maximum distance of a robot from its home, where it is at its base, metres.',
    for_robot('stay_time', 2.0, limits=(0.0, 1e6)),
    'Seconds that a robot waits for each step of its path that stays in a cell.',
    for_robot('attempts', 3, limits=(1, 1000)),
    'Maximum number of goals in a row without a new cell, after which the robot goes home.',
    for_robot('time_budget', 0.0, limits=(0.0, 1e9)),
    'Maximum seconds from departure to return; 0 for no limit. The robot turns back when the '
    'rest of the time is needed for the way back, at the pace of its steps so far.',
    for_robot('retry_delay', 2.0, limits=(0.0, 1e6)),
    'Seconds from a failed goal to the next try.',
    for_robot('server_timeout', 10.0, limits=(1e-3, 1e6)),
    'Seconds without feedback after which an action server counts as dead.',
    for_robot('detection_type', 'bool', choices=('bool', 'detection2d_array')),
    'Type of detection messages: bool for std_msgs/Bool, or detection2d_array for '
    'vision_msgs/Detection2DArray where that package is installed.',
    for_robot('detection_class', ''),
    'Class of the detections that are targets, for detection2d_array; empty for any.',
    for_robot('detection_score', 0.5, limits=PROBABILITY),
    'Minimum score of the detections that count, for detection2d_array.',
    for_robot('detections.needed', 1, limits=(1, 1000)),
    'Number of positive detections, of detections.of in a row in a cell, by which a reading is '
    'positive.',
    for_robot('detections.of', 1, limits=(1, 1000)),
    'Number of detections in a row that make a reading; a cell with fewer is not looked at.',
    Parameter('resume', '', ('planner', 'agent', 'estimator', 'recorder'), is_file=True),
    'Log of the mission to resume, its first file or its folder; empty for a new mission.',
    for_recorder('file', '', is_file=True),
    'The log to write, which must not exist yet; empty for runs/TIME/mission.mcap. Not used with '
    'resume.',
)

TABLE = tuple(
    replace(row, description=row.description or str(text), in_field=IN_FIELD.get(row.name))
    for row, text in pairwise((*ROWS, ''))
    if isinstance(row, Parameter)
)
