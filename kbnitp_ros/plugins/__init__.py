# SPDX-License-Identifier: Apache-2.0
"""What there is of a kind by name: the package's own, and what other packages add to it."""

from kbnitp_ros.plugins.registry import name_of, PluginError, Registry, takes

__all__ = ['PluginError', 'Registry', 'name_of', 'takes']
