# SPDX-License-Identifier: Apache-2.0
"""What there is of a kind by name: the package's own, and what others add; what others bring."""

from kbnitp_ros.plugins.extras import extra
from kbnitp_ros.plugins.registry import name_of, PluginError, Registry, takes

__all__ = ['PluginError', 'Registry', 'extra', 'name_of', 'takes']
