# SPDX-License-Identifier: Apache-2.0
"""What goes wrong with a log."""

from __future__ import annotations


class LogError(ValueError):
    """A file that is no mission log, a corrupt one, or parts that do not make one."""
