# SPDX-License-Identifier: Apache-2.0
"""Print the page of the parameters: ``python3 -m kbnitp_ros.nodes.parameters``."""

from kbnitp_ros.nodes.parameters.page import reference_page

print(reference_page(), end='')
