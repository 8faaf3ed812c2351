# SPDX-License-Identifier: Apache-2.0
"""Write logs of test_recorded.py: kinds of hazards, located losses, sampling, a late return."""

import json
from pathlib import Path
import sys

from kbnitp_ros.configuration.known import node_parameters
from kbnitp_ros.core import Clustering, Dynamics, Execution, Observation, Unknowns
from kbnitp_ros.log.configuration import run_record
from kbnitp_ros.log.read import PARAMETERS, RUN
from kbnitp_ros.log.write import LogWriter
from mission_log import GRID, MAX_STEPS, Mission, mission, record_to

# Probability that each survived step is received.
HEARD = Execution(contact=0.5)

KINDS = {
    'lost_at': {'conduct': HEARD},
    'changing': {'conduct': HEARD, 'dynamics': Dynamics('changing', appear=0.02, vanish=0.1)},
    'used_up': {'seed': 2, 'conduct': HEARD, 'dynamics': Dynamics('used_up')},
    'clustered': {
        'clustering': Clustering(GRID, 'learn'),
        'unknowns': Unknowns(hazard_density=(0.05, 0.6)),
        'conduct': HEARD,
        'method': 'kappa_bnitp_sampled',
        'method_seed': 5,
    },
    'kappa_bnitp_sampled': {
        'unknowns': Unknowns(lethality=(0.0, 1.0), hazard_density=(0.05, 0.6)),
        'method': 'kappa_bnitp_sampled',
        'method_seed': 3,
    },
}


# Number of robots of each mission, apart from `late_return`.
ROBOTS = 8

METHODS = ('kappa_bnitp', 'kappa_bnitp_published', 'relaxed_bnitp', 'relaxed_itp')


def late_return():
    """Return a mission of a team in which a robot that timed out returns late."""
    whole = Mission('kappa_bnitp')
    orders = [2, 7, 12, 7, 2]
    late = whole.deploy(Observation(orders, False), 'scout_1')
    whole.deploy(Observation([2, 7, 6, 2], False), 'scout_2')
    back = Observation(orders, True, [True, False, True, False])
    whole.assimilate(orders, *whole.come_back(late, back))
    for agent in ('scout_1', 'scout_2', 'scout_1'):
        whole.deploy(Observation([2, 3, 4, 3, 2], True, [False, True, False, False]), agent)
    return whole


def main(folder):
    defaults = {name: each.default for name, each in node_parameters('planner').items()}
    planner = defaults | {'max_steps': MAX_STEPS, 'robots': ROBOTS}
    missions = {method: mission(method=method) for method in METHODS}
    missions |= {kind: mission(**options) for kind, options in KINDS.items()}
    for name, whole in {**missions, 'late_return': late_return()}.items():
        with LogWriter(folder / f'{name}.mcap') as log:
            log.add_metadata(RUN, run_record('rmw_fastrtps_cpp'))
            record = {key: json.dumps(value) for key, value in planner.items()}
            log.add_metadata(f'{PARAMETERS}/planner', record)
            record_to(log, whole.sent)


if __name__ == '__main__':
    main(Path(sys.argv[1]))
