# SPDX-License-Identifier: Apache-2.0
"""Experiments over the core, with tables and figures."""

from kbnitp_ros.plugins import extra

with extra('study'):
    from kbnitp_ros.study.charts import curves, differences, final_values, study_figures
    from kbnitp_ros.study.comparing import compare
    from kbnitp_ros.study.results import bootstrap, Results

__all__ = [
    'Results',
    'bootstrap',
    'compare',
    'curves',
    'differences',
    'final_values',
    'study_figures',
]
