# SPDX-License-Identifier: Apache-2.0
"""What is registered keeps the laws of its kind."""

from extent import FULL
from kbnitp_ros.core import METHODS
from kbnitp_ros.testing import check_method
import pytest


@pytest.mark.parametrize('method', METHODS)
def test_methods_keep_their_laws(method):
    check_method(method, cases=40 if FULL else 4)
