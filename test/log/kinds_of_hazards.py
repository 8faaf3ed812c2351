# SPDX-License-Identifier: Apache-2.0
"""Write a log of each kind of hazards, and of losses that are located: FOLDER/KIND.mcap."""

from pathlib import Path
import sys

from kbnitp_ros.bag import LogWriter
from kbnitp_ros.core import Clustering, Dynamics, Execution, Unknowns
from kbnitp_ros.log.configuration import RUN, run_record
from mission_log import GRID, mission, record_to

# How often each step survived is heard of.
HEARD = Execution(contact=0.5)
CHANGING = Dynamics('changing', appear=0.02, vanish=0.1)
USED_UP = Dynamics('used_up')
SAMPLED = {'method': 'kappa_bnitp_sampled', 'method_seed': 5}

KINDS = {
    'lost_at': {'conduct': HEARD},
    'lost_at_smoothed': {'conduct': HEARD, 'method': 'kappa_bnitp_smoothed'},
    'changing': {'conduct': HEARD, 'dynamics': CHANGING},
    'changing_sampled': {'conduct': HEARD, 'dynamics': CHANGING, **SAMPLED},
    'used_up': {'seed': 2, 'conduct': HEARD, 'dynamics': USED_UP},
    'used_up_sampled': {'seed': 2, 'conduct': HEARD, 'dynamics': USED_UP, **SAMPLED},
    'clustered': {
        'clustering': Clustering(GRID, 'learn'),
        'unknowns': Unknowns(hazard_density=(0.05, 0.6)),
        'conduct': HEARD,
        **SAMPLED,
    },
}


def main(folder):
    for kind, options in KINDS.items():
        whole = mission(**options)
        with LogWriter(folder / f'{kind}.mcap') as log:
            log.add_metadata(RUN, run_record('rmw_fastrtps_cpp'))
            record_to(log, whole.sent)


if __name__ == '__main__':
    main(Path(sys.argv[1]))
