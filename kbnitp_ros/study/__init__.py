# SPDX-License-Identifier: Apache-2.0
"""Experiments over the core, with tables and figures."""

from kbnitp_ros.plugins import extra

with extra('study'):
    from kbnitp_ros.study.comparing import compare
    from kbnitp_ros.study.comparison import figures_of, tables_of
    from kbnitp_ros.study.results import Results, Table

__all__ = ['Results', 'Table', 'compare', 'figures_of', 'tables_of']
