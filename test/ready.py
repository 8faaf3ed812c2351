# SPDX-License-Identifier: Apache-2.0
"""Modules, type supports and compiled kernels that forked nodes start with."""

from importlib import import_module
import inspect
import sys

from kbnitp_ros.core import Belief, Grid, plan, SensorModel
from kbnitp_ros.starting import NODES

for _module in NODES.values():
    import_module(_module)

_GRID = Grid(3, 3)
plan(_GRID, Belief.prior(_GRID, 0.5, 0.45, 0.8), SensorModel(0.5))

for _module in [*sys.modules.values()]:
    for _type in [*vars(_module).values()]:
        if hasattr(type(_type), '__import_type_support__'):
            type(_type).__import_type_support__()

# The first log message of a node would search all modules for its own.
inspect.getmodule(inspect.currentframe())
