# SPDX-License-Identifier: Apache-2.0
"""Write the log of a team of which a robot that timed out comes home late: late_return.mcap."""

from pathlib import Path
import sys

from kbnitp_ros.core import Observation
from kbnitp_ros.log.configuration import RUN, run_record
from kbnitp_ros.log.write import LogWriter
from mission_log import Mission, record_to


def main():
    whole = Mission('kappa_bnitp')
    orders = [2, 7, 12, 7, 2]
    late = whole.deploy(Observation(orders, False), 'scout_1')
    whole.deploy(Observation([2, 7, 6, 2], False), 'scout_2')
    back = Observation(orders, True, [True, False, True, False])
    whole.assimilate(orders, *whole.come_back(late, back))
    for agent in ('scout_1', 'scout_2', 'scout_1'):
        whole.deploy(Observation([2, 3, 4, 3, 2], True, [False, True, False, False]), agent)
    with LogWriter(Path(sys.argv[1])) as log:
        log.add_metadata(RUN, run_record('rmw_fastrtps_cpp'))
        record_to(log, whole.sent)


if __name__ == '__main__':
    main()
