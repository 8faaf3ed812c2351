# SPDX-License-Identifier: Apache-2.0
"""Print the page of the parameters: ``python3 -m kbnitp_ros.configuration``."""

from kbnitp_ros.configuration.known import reference_page

print(reference_page(), end='')
