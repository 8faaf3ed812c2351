# SPDX-License-Identifier: Apache-2.0
"""The commands: one file each, run as ``python3 -m kbnitp_ros NAME``."""
