# SPDX-License-Identifier: Apache-2.0
"""What goes wrong with a log."""


class LogError(ValueError):
    """A file that is no mission log, a damaged one, or parts that do not make one."""
