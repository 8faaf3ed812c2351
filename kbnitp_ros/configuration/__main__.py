# SPDX-License-Identifier: Apache-2.0
"""
Print docs/parameters.md, or with the argument ``mission`` config/mission.yaml.

    python3 -m kbnitp_ros.configuration > docs/parameters.md
    python3 -m kbnitp_ros.configuration mission > config/mission.yaml
"""

import sys

from kbnitp_ros.configuration.known import mission_file, reference_page

print(mission_file() if sys.argv[1:] == ['mission'] else reference_page(), end='')
