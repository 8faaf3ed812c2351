# SPDX-License-Identifier: Apache-2.0
"""The table of all parameters: names, types, defaults, ranges and meanings."""

from functools import partial

from kbnitp_ros.configuration.parameter import NAME, Parameter
from kbnitp_ros.core import ALLOCATIONS, METHODS, OBJECTIVES, PLANNERS
from kbnitp_ros.core.decision.goals import GOALS
from kbnitp_ros.core.field.clustering import LEARNT_COUPLING, STRONGEST
from kbnitp_ros.core.field.unknowns import HAZARDS
from kbnitp_ros.core.planning.options import ALPHAS

NODES = ('planner', 'agent', 'robot', 'estimator', 'recorder')
FIELD = ('planner', 'agent', 'estimator')
SENSING = ('agent', 'estimator')
GRID = (*FIELD, 'robot')

PROBABILITY = (0.0, 1.0)
MAX_ROBOTS = 20_000
MAX_STEPS = 10_000
MAX_SIDE = 1000
MAX_AGENTS = 100
MAX_CELLS = MAX_SIDE**2

# The topic of the operator's actions.
OPERATOR = 'operator'

# The numbers that can be learnt: their meanings and their priors.
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
    # a = b = 0 or 1: log-uniform.
    'vanish': ('hazards.vanish', (0.001, 0.1, 0.0, 1.0)),
    'move': ('hazards.move', (0.001, 0.1, 0.0, 1.0)),
}

# The sensors of robots: the defaults, and their meanings.
SENSOR = {
    'lethality': (
        0.5,
        'Probability that a hazard strikes a robot that steps into its cell. The sensor '
        'parameters of the agent are the truth, those of the estimator what estimator and planner '
        'believe.',
    ),
    'malfunction': (0.05, 'Probability that a robot is lost in a step without any hazard.'),
    'false_negative': (0.05, 'Probability that a robot survives a hazard that strikes it.'),
    'true_positive': (0.95, 'Probability that a target is reported where there is one.'),
    'false_positive': (0.05, 'Probability that a target is reported where there is none.'),
}

# Rates of hazards: events per deployment.
RATES = {
    'appear': 'a free cell gets a hazard, for changing hazards; 0 with a learnt hazards.vanish '
    'stands for the rate that keeps the expected number of hazards',
    'vanish': 'a hazard disappears, for changing hazards',
    'move': 'a hazard goes to a free neighbouring cell, for moving hazards',
}

# Probabilities before the first deployment, and in a drawn world: the defaults and the events.
PRIOR = {
    'hazard': (0.5, 'a hazard in each cell'),
    'target': (0.45, 'a target in each cell'),
    'kappa': (0.8, 'a target where there is a hazard,'),
}
DRAWN = {
    'hazard_density': (0.15, 'a hazard in each cell of a drawn world but the bases'),
    'kappa': (0.8, 'a target in a cell of a drawn world that has a hazard'),
    'target_background': (0.1, 'a target in a cell of a drawn world that has no hazard'),
}

# Nodes that wait, those that they wait for, and what these must subscribe to.
AWAITED = (
    (('planner',), ('agent', 'estimator'), 'the paths to await before the first is sent'),
    (('estimator',), ('planner',), 'the belief to await before the first is published'),
    (
        ('agent', 'robot'),
        ('planner', 'estimator'),
        'the reports to await before the first robot leaves',
    ),
)

# Rows of one node alone; those of the planner that can change while it runs are `changeable`.
for_planner, for_agent, for_robot, for_estimator, for_recorder = (
    partial(Parameter, nodes=(node,)) for node in NODES
)
changeable = partial(for_planner, read_only=False)

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
        'Topic of the map, such as /map, in place of the parameter map: nodes wait for its first '
        'message; empty for none.',
        GRID,
    ),
    Parameter(
        'unknown_blocks',
        True,
        'Whether robots avoid cells that are partly unknown in the map.',
        GRID,
    ),
    Parameter('grid.width', 9, 'Cells along x.', GRID, limits=(1, MAX_SIDE)),
    Parameter('grid.height', 9, 'Cells along y.', GRID, limits=(1, MAX_SIDE)),
    Parameter(
        'grid.base',
        0,
        'Cell (row * width + column, row 0 at the bottom) that paths start and end in; for one '
        'agent team.AGENT.base.',
        GRID,
        limits=(0, MAX_CELLS - 1),
        per_agent=True,
    ),
    Parameter(
        'grid.base_position',
        (),
        'Point in the base cell, x and y in metres in the frame map, in place of grid.base; empty '
        'for none. For one agent team.AGENT.base_position.',
        GRID,
        element=float,
        per_agent=True,
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
        'Lower-left corner of cell 0 in metres, x and y in the frame map; a third number is the '
        'angle from the x axis of that frame to the rows, counterclockwise, in rad.',
        GRID,
        element=float,
    ),
    Parameter(
        'datum',
        (),
        'Latitude and longitude of the origin of the frame map, WGS84 in degrees, and the angle '
        'from east to its x axis, counterclockwise, in rad, as for robot_localization; empty for '
        'none.',
        ('estimator', 'robot'),
        element=float,
    ),
    Parameter('grid.blocked', (), 'Cells that no robot can enter.', GRID, element=int),
    Parameter(
        'grid.connectivity',
        8,
        'Number of neighbours that a step may lead to: 8, or the 4 that share a side.',
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
        'max_steps', 18, 'Maximum steps of a path.', GRID, limits=(1, MAX_STEPS), per_agent=True
    ),
    changeable(
        'max_distance',
        0.0,
        'Maximum length of a path, metres: a diagonal step is 1.41 times as long as a straight '
        'one, a stay has no length. For the planners beam and relaxed and the goal map; 0 for no '
        'limit.',
        limits=(0.0, 1e9),
        per_agent=True,
    ),
    *(
        Parameter(f'sensor.{name}', default, meaning, SENSING, limits=PROBABILITY, per_agent=True)
        for name, (default, meaning) in SENSOR.items()
    ),
    Parameter(
        'hazards.dynamics',
        'static',
        'Dynamics of hazards: static, changing from one deployment to the next, moving to '
        'neighbouring cells, or used up when they strike; learn to infer the kind from the '
        'evidence. The value of the agent is the truth, that of the estimator the belief of '
        'estimator and planner.',
        SENSING,
        choices=HAZARDS,
    ),
    *(
        Parameter(
            f'hazards.{name}',
            0.0,
            f'Probability per deployment that {event}.',
            SENSING,
            limits=PROBABILITY,
        )
        for name, event in RATES.items()
    ),
    *(
        for_estimator(
            f'prior.{name}',
            default,
            f'Probability of {event} before the first deployment.',
            limits=PROBABILITY,
        )
        for name, (default, event) in PRIOR.items()
    ),
    *(
        for_estimator(
            f'prior.{name}_map',
            '',
            f'File with prior.{name} of each cell: a map_server map of mode scale, or rows and '
            'columns in .npy; empty for the number, which also holds where the map has nothing.',
        )
        for name in PRIOR
    ),
    for_estimator(
        'prior.resample',
        False,
        'Whether a prior map in .npy may have another number of rows and columns than the field: '
        'each cell then takes the mean of the values over it.',
    ),
    for_estimator(
        'prior.clustering',
        0.0,
        'Coupling of hazards in cells that share a side (a Markov random field), for '
        'kappa_bnitp_sampled; 0 for independent hazards, learn for an unknown coupling.',
        limits=(0.0, STRONGEST),
        word=LEARNT_COUPLING,
    ),
    for_estimator(
        'prior.log',
        '',
        'Log of an earlier mission in the same field, whose last belief is the prior; empty for '
        'none.',
    ),
    for_estimator('method', 'kappa_bnitp', 'Inference method of the belief.', choices=METHODS),
    for_estimator(
        'filter.type',
        -1,
        'Type of a costmap filter of Nav2 whose mask is belief/hazard, for the topic '
        'belief/costmap_filter_info: 0 for a KeepoutFilter, 1 for a SpeedFilter in percent, 2 for '
        'one in m/s; -1 for none.',
        limits=(0, 2),
        off=-1,
    ),
    for_estimator(
        'filter.base',
        0.0,
        'What 0 percent of hazard means to that filter: 0 for a KeepoutFilter, or a speed limit.',
        limits=(-1e6, 1e6),
    ),
    for_estimator(
        'filter.multiplier',
        1.0,
        'What each percent of hazard adds to filter.base: 1 for a KeepoutFilter.',
        limits=(-1e6, 1e6),
    ),
    for_estimator(
        'learn.numbers',
        (),
        'Numbers to learn from the evidence, with kappa_bnitp, relaxed_itp (all but kappa) or, in '
        'a static field, kappa_bnitp_sampled. Robots are planned with their current estimates.',
        element=str,
        choices=tuple(LEARN),
    ),
    *(
        for_estimator(
            f'learn.{name}',
            interval,
            f'Prior of {meaning}, if it is learnt: low and high, and unless uniform a and b of a '
            'Beta distribution.',
            element=float,
        )
        for name, (meaning, interval) in LEARN.items()
    ),
    Parameter(
        'agents',
        ('scout_1',),
        f'Names of all agents of the team, at most {MAX_AGENTS}; each has its topics under its '
        'name.',
        (*FIELD, 'recorder'),
        element=str,
        pattern=NAME,
    ),
    for_agent(
        'agent',
        '',
        'The agent whose robots this node simulates, one of agents; empty for all of them.',
        pattern=f'({NAME})?',
    ),
    for_robot('agent', 'scout_1', 'Agent name of this robot.', pattern=NAME),
    changeable('robots', 100, 'Robots to deploy, one after another.', limits=(0, MAX_ROBOTS)),
    changeable(
        'planner',
        'beam',
        'Search for paths; random, coverage and shortest_unvisited seek no information and serve '
        'as baselines.',
        choices=PLANNERS,
    ),
    changeable(
        'beam_width',
        16,
        'Width of the beam planner, which keeps a quarter as many labels for each cell and step.',
        limits=(1, 10_000),
    ),
    for_planner(
        'bound',
        False,
        'Whether to compute, with each plan, an upper bound on the value of any path, for '
        'progress and the report; for a single agent that seeks information.',
    ),
    changeable('max_visits', 3, 'Maximum visits of a path to one cell.', limits=(1, 10_000)),
    changeable(
        'allocation', 'greedy', 'How the robots of a round share the field.', choices=ALLOCATIONS
    ),
    changeable(
        'objective',
        'information',
        'Objective of paths: expected information; behavioral: the fall of behavioral entropies; '
        'information_per_loss: information for each robot expected to be lost. The last two need '
        'the planner beam or relaxed.',
        choices=OBJECTIVES,
    ),
    changeable(
        'alpha',
        1.0,
        'Prelec weight of the objective behavioral: 1 gives the information; below 1 near '
        'certainty counts as less sure, above 1 as surer.',
        limits=ALPHAS,
    ),
    changeable(
        'loss_cost',
        0.0,
        'Cost of a lost robot, in nats of information.',
        limits=(0.0, 1e9),
        per_agent=True,
    ),
    for_planner(
        'goal.kind',
        'map',
        'Goal of the mission: map, the most information; lane, a way from the base to a cell that '
        'is free of hazards; area, cells that are free of hazards.',
        choices=GOALS,
    ),
    for_planner(
        'goal.cells',
        (),
        'Cells of the goal; for a lane the one cell that it leads to.',
        element=int,
    ),
    for_planner(
        'goal.position',
        (),
        'Point in the one cell of the goal, x and y in metres in the frame map, in place of '
        'goal.cells; empty for none.',
        element=float,
    ),
    for_planner(
        'goal.mask',
        '',
        'YAML file of a map, as map_server reads it, with a pixel for each cell of the field: '
        'occupied ones are the goal, in place of goal.cells; empty for none.',
    ),
    changeable(
        'stop.confidence',
        0.0,
        'Probability at which the goal is reached and no more robots leave; 0 for never.',
        limits=(0.0, 1.0 - 1e-6),
    ),
    changeable(
        'stop.gain',
        0.0,
        'Minimum gain of the best deployment for each robot that it is expected to lose, below '
        'which the mission ends: nats, with the goal lane probability; 0 for never.',
        limits=(0.0, 1e9),
    ),
    changeable(
        'stop.losses',
        0,
        'Number of lost robots at which the mission ends; 0 for never.',
        limits=(0, MAX_ROBOTS),
    ),
    changeable(
        'minimum_survival',
        0.0,
        'Paths that a robot survives with a lower probability are refused; the mission is over '
        'when none is left.',
        limits=PROBABILITY,
    ),
    changeable(
        'approval',
        False,
        'Whether robots leave only after the operator has approved their paths, shown on '
        'AGENT/proposal, by the service approve.',
    ),
    for_planner(
        'keep_running', True, 'Whether the planner keeps running when the mission is over.'
    ),
    for_planner(
        'rolling',
        False,
        'Whether each robot leaves as soon as its agent is free, instead of in rounds with all '
        'others.',
    ),
    Parameter(
        'step_period',
        0.0,
        'Seconds a robot takes for a step; 0 for as fast as possible.',
        ('planner', 'agent'),
        limits=(0.0, 1e6),
        per_agent=True,
    ),
    for_agent(
        'detour_probability',
        0.0,
        'Probability that a simulated robot takes a step through a third cell.',
        limits=PROBABILITY,
    ),
    for_agent(
        'early_return_probability',
        0.0,
        'Probability that a simulated robot turns back before a step; never before its first.',
        limits=PROBABILITY,
    ),
    Parameter(
        'contact_probability',
        0.0,
        'Probability that the base receives, after each step survived, how far a robot is, so '
        'that later silence tells where it was lost; 0 infers nothing from silence.',
        ('planner', 'agent'),
        limits=PROBABILITY,
    ),
    for_agent(
        'camera_failure_probability',
        0.0,
        "Probability that a simulated robot's camera fails in a step, for the rest of the way.",
        limits=PROBABILITY,
    ),
    Parameter(
        'silent_loss',
        False,
        'Whether a destroyed robot sends no report, so that only its absence tells of the loss.',
        ('planner', 'agent'),
    ),
    for_planner(
        'return_deadline',
        10.0,
        'Seconds of ROS time after the expected return when a silent robot is given up as lost.',
        limits=(1e-3, 1e9),
    ),
    changeable(
        'presume_departure',
        False,
        'Whether robots count as departed once their paths are sent (with recorded: are on disk), '
        'instead of when their agents report it on AGENT/status. With silent_loss an agent that '
        'never reports departures gets no path.',
    ),
    for_agent(
        'publish_pose',
        False,
        'Whether robots that are out are shown on /tf, as AGENT/base_link in the frame map.',
    ),
    *(
        Parameter(
            'await_nodes',
            default,
            f'Subscribers of {awaited}: planner, agent, estimator, recorder, whatever their nodes '
            'are called, or names of nodes.',
            nodes,
            element=str,
            pattern=NAME,
        )
        for nodes, default, awaited in AWAITED
    ),
    for_estimator(
        'seed', 0, 'Seed of the random numbers that the method draws.', limits=(0, 2**63 - 1)
    ),
    for_agent(
        'seed',
        0,
        'Seed of the hidden world and of what happens to the robots in it.',
        limits=(0, 2**63 - 1),
    ),
    for_agent(
        'world.file', '', 'YAML file with the hidden world; empty to draw one from the seed.'
    ),
    *(
        for_agent(f'world.{name}', default, f'Probability of {event}.', limits=PROBABILITY)
        for name, (default, event) in DRAWN.items()
    ),
    for_agent(
        'publish_truth',
        False,
        'Whether the hidden world is shown on truth/hazard and truth/target.',
    ),
    Parameter(
        'recorded',
        False,
        'Whether a robot leaves only when its path and its departure are on record, and the '
        'estimator accepts recorded paths only.',
        ('planner', 'estimator', 'agent'),
    ),
    for_robot(
        'recorded',
        True,
        'Whether the robot leaves only when its path and its departure are on record.',
    ),
    for_robot(
        'journal',
        '',
        "File on the robot's own disk that keeps its orders, its way and its readings; when a "
        'mission begins, that of the one before is moved to a folder beside. Empty for '
        'AGENT.journal in the folder .ros/kbnitp_ros of the home.',
    ),
    for_robot(
        'driver',
        'follow_waypoints',
        'Action of Nav2 that drives the robot.',
        choices=('follow_waypoints', 'navigate_through_poses', 'follow_path'),
    ),
    for_robot(
        'nav_namespace',
        '',
        "Namespace of the robot's Nav2 and its actions; / for none, empty for that of this node.",
        pattern='/|(/?[A-Za-z][A-Za-z0-9_]*)*',
    ),
    for_robot(
        'position',
        'tf',
        'Source of the robot position: tf for TF, or fix for sensor_msgs/NavSatFix on fix, which '
        'takes a datum.',
        choices=('tf', 'fix'),
    ),
    for_robot(
        'base_frame',
        'base_link',
        'Frame of the robot, whose place in the frame map TF tells, and the frame of fixes.',
    ),
    for_robot(
        'tf_timeout',
        2.0,
        'Maximum age of a transform, a fix or a detection, seconds. A jump of more than a cell '
        'counts if it lasts as long.',
        limits=(1e-3, 1e6),
    ),
    for_robot(
        'max_speed',
        0.0,
        'Maximum speed of the robot, in m/s: after a faster jump its position is uncertain and no '
        'more readings of its walk count; 0 for no check.',
        limits=(0.0, 1e6),
    ),
    for_robot(
        'arrival_tolerance',
        0.5,
        'Metres from the middle of the base within which the robot is home.',
        limits=(1e-3, 1e6),
    ),
    for_robot(
        'stay_time',
        2.0,
        'Seconds that a robot waits in a cell where its path stays for a step.',
        limits=(0.0, 1e6),
    ),
    for_robot(
        'attempts',
        3,
        'Maximum number of goals in a row that bring the robot to no new cell, before it goes '
        'home.',
        limits=(1, 1000),
    ),
    for_robot(
        'time_budget',
        0.0,
        'Maximum seconds from departure to return: the robot turns back when the rest is the time '
        'of the way back, by its steps so far; 0 for no limit.',
        limits=(0.0, 1e9),
    ),
    for_robot(
        'retry_delay', 2.0, 'Seconds from a failed goal to the next one.', limits=(0.0, 1e6)
    ),
    for_robot(
        'server_timeout',
        10.0,
        'Seconds without feedback after which an action server is taken for dead.',
        limits=(1e-3, 1e6),
    ),
    for_robot(
        'detection_type',
        'bool',
        'Type of the messages on detections: std_msgs/Bool, or vision_msgs/Detection2DArray where '
        'that package is installed.',
        choices=('bool', 'detection2d_array'),
    ),
    for_robot(
        'detection_class', '', 'Class of a detection in an array that is a target; empty for any.'
    ),
    for_robot(
        'detection_score',
        0.5,
        'Score that a detection in an array must have to count.',
        limits=PROBABILITY,
    ),
    Parameter(
        'resume',
        '',
        'Log of the mission to resume, its first file or its folder; empty for a new mission.',
        ('planner', 'agent', 'estimator', 'recorder'),
    ),
    for_recorder(
        'file',
        '',
        'The log to write, which must not exist yet; empty for runs/TIME/mission.mcap. Not used '
        'with resume.',
    ),
    for_recorder('compression', 'none', 'How the log is compressed.', choices=('none', 'zstd')),
    for_recorder(
        'max_file_size',
        2**24,
        'Bytes after which the log continues in another file beside the first, which frees the '
        'memory of its index; 0 for one file. What each file starts with, up to '
        '100 kB, does not count.',
        limits=(2**20, 2**62),
        off=0,
    ),
    for_recorder(
        'max_file_duration',
        0.0,
        'Seconds after which the log continues in another file beside the first; 0 for one file.',
        limits=(0.0, 1e9),
    ),
)
