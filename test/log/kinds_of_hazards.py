# SPDX-License-Identifier: Apache-2.0
"""Write a log of each kind of hazards, and of losses that are located: FOLDER/KIND.mcap."""

from pathlib import Path
import sys

from kbnitp_ros.core import Clustering, Dynamics, Execution, Unknowns
from kbnitp_ros.log.configuration import RUN, run_record
from kbnitp_ros.log.write import LogWriter
from mission_log import GRID, mission, record_to

# How often each step survived is heard of.
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
}


def main(folder):
    for kind, options in KINDS.items():
        whole = mission(**options)
        with LogWriter(folder / f'{kind}.mcap') as log:
            log.add_metadata(RUN, run_record('rmw_fastrtps_cpp'))
            record_to(log, whole.sent)


if __name__ == '__main__':
    main(Path(sys.argv[1]))
