# SPDX-License-Identifier: Apache-2.0
"""Experiments over the core, with tables and figures."""

from kbnitp_ros.plugins import extra, renamed

with extra('study'):
    from kbnitp_ros.study.comparing import compare
    from kbnitp_ros.study.comparison import study_figures, study_tables
    from kbnitp_ros.study.results import Results, Table

__all__ = ['Results', 'Table', 'compare', 'study_figures', 'study_tables']

__getattr__ = renamed(__name__, {'figures_of': 'study_figures', 'tables_of': 'study_tables'})
