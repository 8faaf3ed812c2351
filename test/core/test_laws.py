# SPDX-License-Identifier: Apache-2.0
"""What is registered keeps the laws of its kind."""

from extent import FULL
from kbnitp_ros.core import ALLOCATIONS, METHODS, PLANNERS
from kbnitp_ros.testing import check_allocation, check_method, check_planner
from laws import for_each
import pytest


@pytest.mark.slow
@for_each('method', METHODS)
def test_methods_keep_their_laws(method):
    check_method(method, cases=40 if FULL else 2)


@pytest.mark.slow
@for_each('planner', [*PLANNERS])
def test_planners_keep_their_laws(planner):
    check_planner(planner, cases=500 if FULL else 15)


@pytest.mark.slow
@for_each('allocation', ALLOCATIONS)
def test_allocations_keep_their_laws(allocation):
    check_allocation(allocation, cases=250 if FULL else 10)
